"""The engine of many walks: every task once, whatever ends a worker or the program; no row differs.

Under ``kill -9``, Ctrl-C and a full disk, too.
"""

import importlib
import json
import math
import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import field, make_dataclass
from fractions import Fraction
from functools import cache, partial
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import psutil
import pytest

import validation as val
from ampm.exceptions import StudyStopped
from ampm.parameters import RunParameters
from tests.test_body_files import write
from validation.cli import console
from validation.progress import Stage
from validation.store.machine import hidden_main
from validation.study.many import Task, study_folder, walk_many
from validation.study.row_file import ROWS, RowFile, read_rows
from validation.study.sweep.table import SweepTable, read_sweep

RUNS, EVERY = 24, 4
SWEEP = f"""
[sweep]
gait = "flat"
steps = 2
recordings = "none"
[[vary]]
method = "grid"
contact.friction = {{ from = 0.7, to = 0.8, count = {RUNS} }}
"""
PROGRAM = """
import sys
from tests.test_study_kills import gated
from validation.cli.entry import main
from validation.run import walk
from validation.study.sweep import run

walk.compile_once = lambda: None
run.write_sweep_report = lambda folder: None
run.walk_run = gated
main()
"""
GATES = "AMPM_TEST_GATES"
HANG = 900.0
"""Guard against a test that waits for ever [s]; no measure."""


def gated(**options: Any) -> dict[str, Any]:
    """A walk without physics; every fourth waits for its gate, a file, so that a sweep stops where it is."""
    run = int(options["request"].name)
    while run % EVERY == EVERY - 1 and not (Path(os.environ[GATES]) / str(run)).exists():
        time.sleep(0.02)
    return {"outcome": "completed", "verdict": "pass", "failed": "", "metric_zmp_x_rmse": run / 7.0}


class Program:
    """``ampm sweep`` with two workers in a process group of its own, as on a terminal."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "gates").mkdir()
        (folder / "sweep.toml").write_text(SWEEP, encoding="utf-8")

    def start(self, *options: str) -> None:
        words = ["sweep", str(self.folder / "sweep.toml"), "--out", str(self.folder / "out")]
        self.process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, *words, "--workers", "2", *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            env={**os.environ, GATES: str(self.folder / "gates")},
        )

    def open_gates(self, below: int) -> None:
        for run in range(below):
            (self.folder / "gates" / str(run)).touch()

    def rows(self) -> int:
        path = self.folder / "out" / ROWS
        return path.read_bytes().count(b"\n") if path.exists() else 0

    def workers(self) -> list[psutil.Process]:
        try:
            children = psutil.Process(self.process.pid).children()
            return [child for child in children if "spawn_main" in " ".join(child.cmdline())]
        except psutil.NoSuchProcess:
            return []

    def wait(self, event: Callable[[], object]) -> None:
        end = time.monotonic() + HANG
        while not event():
            assert self.process.poll() is None, self.process.communicate()
            assert time.monotonic() < end
            time.sleep(0.05)

    def wait_for_rows(self, count: int) -> None:
        self.wait(lambda: self.rows() >= count)

    def kill_worker(self) -> None:
        """Kill one that walks; wait for the one that takes its place."""
        before = {worker.pid for worker in self.workers()}
        self.workers()[0].kill()
        self.wait(lambda: len([w for w in self.workers() if w.pid not in before]) > 0)

    def finish(self) -> tuple[int, str]:
        _, error = self.process.communicate(timeout=HANG)
        return self.process.returncode, error


@pytest.fixture
def program(tmp_path: Path) -> Iterator[Program]:
    found = Program(tmp_path)
    yield found
    if found.process.poll() is None:
        os.killpg(found.process.pid, signal.SIGKILL)


def test_kills_and_ctrl_c_lose_nothing_and_walk_nothing_twice(program):
    program.start()
    program.wait_for_rows(6)  # both workers wait at the gates of runs 3 and 7
    program.kill_worker()
    program.open_gates(8)
    program.wait_for_rows(14)
    program.kill_worker()
    program.kill_worker()
    assert program.rows() == 14
    orphans = program.workers()
    program.process.kill()
    assert program.finish()[0] == -signal.SIGKILL
    _, alive = psutil.wait_procs(orphans, timeout=HANG)
    assert not alive
    kept = (program.folder / "out" / ROWS).read_bytes()
    assert len(read_sweep(program.folder / "out")) == 14

    program.start("--resume")
    program.open_gates(12)
    program.wait_for_rows(17)  # runs 15 and 19 wait
    program.kill_worker()
    os.killpg(program.process.pid, signal.SIGINT)  # as a terminal does: to every process
    status, error = program.finish()
    assert status == 130, error
    assert error.splitlines()[-1].endswith("; go on by the same command")  # which has --resume
    assert "Traceback" not in error

    program.open_gates(RUNS)
    program.start("--resume")
    status, error = program.finish()
    assert status == 0, error
    found = (program.folder / "out" / ROWS).read_bytes()
    assert found.startswith(kept)
    keys = [json.loads(line)["key"] for line in found.splitlines()]
    assert len(keys) == len(set(keys)) == RUNS
    table = read_sweep(program.folder / "out").table
    assert table["metric_zmp_x_rmse"].to_pylist() == [run / 7.0 for run in range(RUNS)]


def number(value: int) -> dict[str, object]:
    return {"outcome": "completed", "text": "x" * 200, "number": value}


def test_a_full_disk_keeps_every_whole_row(tmp_path):
    """No file may be larger than 4000 bytes: writes are cut short, then fail."""
    tasks = [Task(str(value), number, {"value": value}) for value in range(40)]
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4000, before[1]))
    try:
        with pytest.raises(StudyStopped, match=r"the disk is full .* free some space"):
            list(walk_many(tasks, out=tmp_path, workers=0))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    kept = [row["number"] for row in read_rows(tmp_path)]
    assert kept == list(range(len(kept)))
    assert 5 < len(kept) < 20
    rows = walk_many(tasks, out=tmp_path, resume=True, workers=0)
    assert [row["number"] for row in rows] == list(range(40))
    assert len(list(read_rows(tmp_path))) == 40


class OnlyHere:
    """What only the process that made it can load."""

    def __init__(self, pid: int) -> None:
        if pid != os.getpid():
            raise ImportError("No module named 'not_here'")

    def __reduce__(self) -> Any:
        return OnlyHere, (os.getpid(),)


def test_a_worker_that_cannot_load_a_class_stops_the_study(tmp_path):
    task = Task("a", number, {"value": OnlyHere(os.getpid())})
    with pytest.raises(StudyStopped, match=r"cannot load a class .*not_here.*install what it needs"):
        list(walk_many([task], out=tmp_path, resume=True, workers=1))
    assert list(read_rows(tmp_path)) == []


@contextmanager
def started_elsewhere(folder: Path) -> Iterator[str]:
    """Scheduler file of a scheduler with two workers, which run in a folder of their own."""
    elsewhere, file = folder / "elsewhere", folder / "scheduler.json"
    elsewhere.mkdir()
    starts = [
        ["scheduler", "--scheduler-file", str(file), "--host", "127.0.0.1", "--port", "0", "--no-dashboard"],
        *[["worker", "--scheduler-file", str(file), "--nthreads", "1", "--no-dashboard"]] * 2,
    ]
    processes = []
    try:
        for name, *options in starts:
            words = [sys.executable, "-m", f"distributed.cli.dask_{name}", *options]
            processes.append(
                subprocess.Popen(words, cwd=elsewhere, stderr=subprocess.DEVNULL, start_new_session=True)
            )
            while not file.exists():
                assert processes[0].poll() is None
                time.sleep(0.1)
        yield str(file)
    finally:
        for process in processes:
            os.killpg(process.pid, signal.SIGTERM)
        for process in processes:
            process.wait(timeout=HANG)


@pytest.fixture
def here(tmp_path, monkeypatch):
    """The user's folder, from which modules are imported afresh."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(folder)
    yield folder
    forget(folder)


def forget(folder: Path) -> None:
    """Forget the modules of a folder, as a new program would."""
    for path in folder.glob("*.py"):
        sys.modules.pop(path.stem, None)
    importlib.invalidate_caches()


def test_a_worker_of_this_machine_imports_the_users_modules(here):
    """What one of them changes in another is seen there."""
    (here / "own.py").write_text("VALUE = 0\nread = lambda: VALUE\n", encoding="utf-8")
    work = "import own\ndef work(value):\n  own.VALUE = value\n  return {'value': own.read()}"
    (here / "own_work.py").write_text(work, encoding="utf-8")
    work = importlib.import_module("own_work").work
    (row,) = walk_many([Task("a", work, {"value": 3})], workers=1)
    assert row["value"] == 3


WEAK = """
import ampm
from own_factor import FACTOR
from validation.judge.metrics import Metric
from validation.judge.profiles import DEFAULT, Profile

OWN = Profile("own", DEFAULT)
HIGHEST = Metric(
    "highest", "m", "largest height of the COM", "walk",
    lambda walk: float(walk.measured.com[:, 2].max()), {"default": 2.0, OWN.name: 1.0},
    reason="No body is that tall.",
)

class Weak(ampm.TrackingController):
    def __init__(self, robot, run, *, gain, held=False):
        super().__init__(robot, run)
        self.gain, self.held = gain, held

    def update(self, state, touch, reference):
        output = super().update(state, touch, reference)
        rate = None if self.held else output.rate
        return output._replace(torque=FACTOR * self.gain * output.torque, rate=rate)


class Shorter(ampm.PeriodicPlanner):
    def __init__(self, ratio=1.0):
        super().__init__()
        self.ratio = ratio

    def plan(self, run, robot):
        return super().plan(run.replace({"gait.step_width": self.ratio * run.gait.step_width}), robot)
"""
OPTIONS = """
[sweep]
gait = "flat"
steps = 2
recordings = "none"

[set]
disturbance.push_x = 5
controller.name = "own_weak:Weak"
controller.options.held = true
gait.planner = "own_weak:Shorter"

[[vary]]
method = "grid"
controller.options.gain = [1, 0.999]
planner.options.ratio = [1.0, 1.01]
"""


@pytest.mark.slow
def test_options_and_imported_modules_travel_to_workers_started_elsewhere(tmp_path, here):
    """Workers have never seen the user's controller, planner and metric."""
    (here / "own_weak.py").write_text(WEAK, encoding="utf-8")
    (here / "own_factor.py").write_text("FACTOR = 1.0\n", encoding="utf-8")
    (here / "options.toml").write_text(OPTIONS, encoding="utf-8")

    def walked(folder: str, **how: Any) -> tuple[SweepTable, list[str]]:
        highest = val.register(importlib.import_module("own_weak").HIGHEST)
        try:
            found = val.sweep("options.toml", out=tmp_path / folder, **how)
        finally:
            val.unregister(highest.name)
            forget(here)
        return found, [row["digest"] for row in read_rows(tmp_path / folder)]

    with started_elsewhere(tmp_path) as scheduler:
        far, digests = walked("far", scheduler=scheduler)
        near, _ = walked("near", workers=2)
        (here / "own_factor.py").write_text("FACTOR = 0.9995\n", encoding="utf-8")
        changed, more = walked("far", scheduler=scheduler, resume=True)
    assert far.words("outcome") == ["completed"] * 4
    assert far.numbers("controller.options.gain").tolist() == [1, 1, 0.999, 0.999]
    assert far.words("controller.options.held") == ["true"] * 4
    assert len(set(far.numbers("metric_zmp_x_rmse"))) == 4
    assert far.numbers("metric_highest").min() > 0.8
    cost = ["worker", "timing_total"]
    assert far.table.drop_columns(cost).equals(near.table.drop_columns(cost))
    assert len({*digests, *more}) == 8
    assert not set(changed.numbers("metric_zmp_x_rmse")) & set(far.numbers("metric_zmp_x_rmse"))


def square(number: int) -> dict[str, object]:
    return {"outcome": "completed", "square": number**2}


def fail(number: int) -> dict[str, object]:
    if number == 0:
        raise ValueError("no square")
    if number == 1:
        os._exit(0)
    time.sleep(1000.0)
    return {}


SQUARES = [Task(str(n), square, {"number": n}) for n in range(4)]


def test_other_options_are_another_run(tmp_path):
    for number in (2, 3, 2):  # the last again: a run's folder has been written by another one since
        rows = walk_many([Task("a", square, {"number": number})], out=tmp_path, resume=True, workers=0)
        assert [row["square"] for row in rows] == [number**2]
    assert len(list(read_rows(tmp_path))) == 3


def test_rows_are_json_for_every_reader(tmp_path):
    task = Task("a", square, known={"metric_height": math.inf, "metric_width": math.nan})
    assert list(walk_many([task], out=tmp_path, workers=0))
    (row,) = read_rows(tmp_path)
    assert (row["metric_height"], row["metric_width"]) == ("inf", None)


def test_bad_runs_are_rows_and_the_others_go_on(tmp_path):
    items = [*(Task(f"bad {n}", fail, {"number": n}) for n in range(3)), *SQUARES]
    rows = {row["key"]: row for row in walk_many(items, out=tmp_path, workers=2, limit=8.0)}
    assert [rows[f"bad {n}"]["outcome"] for n in range(3)] == ["crashed", "crashed", "timed_out"]
    assert [rows[f"bad {n}"]["reason"] for n in range(3)] == ["ValueError", "worker_died", "wall_clock"]
    assert "test_study_kills.py" in rows["bad 0"]["traceback"]
    assert [rows[str(n)]["square"] for n in range(4)] == [0, 1, 4, 9]
    # What crashed is no result.
    stored = RowFile(tmp_path)
    assert not stored.get("bad 0", items[0].digest)
    assert stored.get("0", items[3].digest)
    stored.close()


def test_what_a_function_or_an_object_holds_decides_on_the_digest():
    makers: Any = (lambda n: lambda: n, lambda n: lambda m=n: m, lambda n: Fraction(n).limit_denominator)
    hidden = make_dataclass("Hidden", [("gain", float, field(repr=False))], slots=True)
    held = (partial(partial, square), type("Real", (float,), {}), hidden, lambda n: n * np.eye(1, 5000, 2500))
    for make in (*makers, *held, lambda n: cache(lambda: n)):
        assert Task("a", make(1)).digest == Task("a", make(1)).digest != Task("a", make(2)).digest
    assert Task("a", square, {"of": {0, 8}}).digest == Task("a", square, {"of": {8, 0}}).digest


def test_the_digest_of_a_scripts_function_is_the_same_while_workers_run(tmp_path, monkeypatch):
    script = tmp_path / "script.py"
    script.write_text("def work():\n    from .helper import gain\n    return gain\n")  # it has no package
    main: Any = ModuleType("__main__")
    main.__file__ = str(script)
    exec(script.read_text(), vars(main))
    monkeypatch.setitem(sys.modules, "__main__", main)
    before = Task("a", main.work).digest
    with hidden_main():
        assert Task("a", main.work).digest == before
    script.write_text("def work():\n    return {'outcome': 'completed'}\n")
    study_folder({})
    assert Task("a", main.work).digest != before
    main.__file__ = "<stdin>"
    assert len({(study_folder({}), Task("a", main.work).digest) for _ in range(2)}) == 2  # nobody can read it


def test_digest_is_of_all_that_decides_on_a_row(tmp_path):
    body, policy = write(tmp_path), tmp_path / "policy.onnx"
    policy.write_text("1")
    run = RunParameters().replace({"body.source": str(body), "controller.options.file": str(policy)})
    digests = {Task("a", square, {"run": run}).digest}
    for file in (tmp_path / "biped.urdf", body, policy):
        file.write_text(file.read_text() + "\n")
        digests.add(Task("a", square, {"run": run}).digest)
    assert len(digests) == 4


def test_a_log_gets_lines_with_the_count_the_time_that_is_left_and_the_note(capsys, monkeypatch):
    monkeypatch.setattr(console, "_LINE_EVERY", -1.0)
    with console.Narrator().stage("walks", "runs") as stage:
        stage.note("90 completed")
        stage.advance(90, 100)  # stored ones say nothing about the speed
        stage.advance(95, 100)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "walks: 90 of 100 runs, 90 completed"
    assert re.fullmatch(r"walks: 95 of 100 runs, about [\d.]+ \w+ left, 90 completed", lines[1])
    assert re.fullmatch(r"walks: \d+\.\d s", lines[2])


def test_a_study_counts_its_tasks():
    seen: list[tuple[int, int]] = []
    stage = Stage(lambda done, total: seen.append((done, total)))
    progress: Any = SimpleNamespace(stage=lambda label, unit: nullcontext(stage))
    assert len(list(walk_many(SQUARES, workers=0, progress=progress))) == 4
    assert seen == sorted(seen)
    assert (seen[0], seen[-1]) == ((0, 4), (4, 4))
