"""A sweep survives what kills it: workers, itself, Ctrl-C, a full disk; and its table stays the same bits."""

from __future__ import annotations

import fcntl
import os
import random
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import psutil
import pyarrow as pa
import pytest

from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from tests.sweep_work import act
from validation.study.sweep import workers
from validation.study.sweep.exceptions import SweepStopped
from validation.study.sweep.schema import columns
from validation.study.sweep.table import read_sweep
from validation.study.sweep.task import Task

SWEEP = """
[sweep]
gait = "flat"
steps = 2
recordings = "none"

[[vary]]  # failing, passing, and refused: by the formula, by the body, by a bound
method = "list"
contact.time_constant = [0.08, 0.015, 0.015, 0.015, 0.015, 0.015, 0.015, 0.015, 0.015, 0.015, 0.015, 0.015]
controller.com_damping = [15.0, 15.0, 14.0, 16.0, 15.0, 15.0, 15.0, 15.5, 15.1, 15.2, 15.3, 15.4]
gait.switching_velocity = [0.7, 0.7, 0.7, 0.7, 0.3, 0.7, -1.0, 0.7, 0.7, 0.7, 0.7, 0.7]
gait.com_height = [0.89, 0.89, 0.89, 0.89, 0.89, 1.2, 0.89, 0.89, 0.89, 0.89, 0.89, 0.89]
"""
RUNS = 12
OUT_OF_TOLERANCE, STOPPED, INTERRUPTED = 1, 5, 130


def start(file: Path, out: Path, *extra: str, **options: Any) -> subprocess.Popen[str]:
    """The console script in a process group of its own, as on a terminal."""
    command = [sys.executable, "-m", "validation.cli", "sweep", str(file), "--out", str(out), *extra]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, start_new_session=True, **options)


def finish(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Exit status and stderr."""
    _, error = process.communicate(timeout=600)
    return process.returncode, error


def workers_of(process: subprocess.Popen[str]) -> list[psutil.Process]:
    """Processes of the workers."""
    try:
        children = psutil.Process(process.pid).children()
        return [child for child in children if "spawn_main" in " ".join(child.cmdline())]
    except psutil.NoSuchProcess:
        return []


def times_of(folder: Path) -> dict[int, str]:
    """When each run with a durable row ended, read while rows are written."""
    try:
        table = read_sweep(folder).table
    except InputError:  # no row yet
        return {}
    return dict(zip(table["run"].to_pylist(), table["environment_time"].to_pylist(), strict=True))


def wait_for_rows(process: subprocess.Popen[str], folder: Path, count: int) -> None:
    end = time.monotonic() + 120
    while len(times_of(folder)) < count:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.05)


def same_columns(folder: Path) -> pa.Table:
    """The columns that are the same bits in equal sweeps."""
    names = [item.name for item in columns() if not item.name.startswith(("timing_", "environment_"))]
    return read_sweep(folder).table.select(names)


@pytest.fixture(scope="module")
def file(shared_folder: Path) -> Path:
    path = shared_folder / "killed.toml"
    path.write_text(SWEEP, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def undisturbed(shared_folder: Path, file: Path) -> pa.Table:
    """The table of one worker that nobody disturbs."""
    folder = shared_folder / "undisturbed"
    with (shared_folder / "undisturbed.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "report.html").is_file():
            status, error = finish(start(file, folder, "--workers", "1"))
            assert status == OUT_OF_TOLERANCE, error
    return same_columns(folder)


def test_an_undisturbed_sweep_has_every_kind_of_row(undisturbed):
    rows = undisturbed.to_pylist()
    assert [row["run"] for row in rows] == list(range(RUNS))
    assert [row["verdict"] for row in rows[:4]] == ["fail", *["pass"] * 3]
    assert "zmp_x_rmse" in rows[0]["failed"].split(",")
    refused = {"switching_velocity_too_low": False, "leg_too_short": True, "bad_parameter": False}
    assert {row["reason"]: row["plan_l_s"] is not None for row in rows[4:7]} == refused


def test_killed_workers_change_nothing(undisturbed, file, tmp_path):
    out = tmp_path / "out"
    process = start(file, out, "--workers", "2")
    killed = 0
    end = time.monotonic() + 60
    while killed < 4 and process.poll() is None and time.monotonic() < end:
        if found := workers_of(process):  # those that run and those that are still starting
            found[killed % len(found)].kill()
            killed += 1
        time.sleep(1.0)
    status, error = finish(process)
    assert status == OUT_OF_TOLERANCE, error
    assert killed >= 2
    assert same_columns(out).equals(undisturbed)


def test_a_full_disk_a_killed_program_and_ctrl_c_lose_nothing(undisturbed, file, tmp_path):
    out = tmp_path / "out"

    def small_files() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (70_000, 70_000))

    status, error = finish(start(file, out, "--workers", "1", preexec_fn=small_files))
    assert status == STOPPED, error
    assert "--resume" in error
    kept = times_of(out)

    process = start(file, out, "--resume", "--workers", "2")
    wait_for_rows(process, out, max(4, len(kept) + 1))
    orphans = workers_of(process)
    process.kill()
    assert finish(process)[0] == -signal.SIGKILL
    _, alive = psutil.wait_procs(orphans, timeout=20)
    assert not alive
    assert kept.items() <= times_of(out).items()  # not walked again
    kept = times_of(out)

    process = start(file, out, "--resume", "--workers", "1")
    wait_for_rows(process, out, len(kept) + 1)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to every process
    status, error = finish(process)
    assert status == INTERRUPTED, error
    assert "--resume" in error.splitlines()[-1]
    assert "Traceback" not in error

    status, error = finish(start(file, out, "--resume", "--workers", "2"))
    assert status == OUT_OF_TOLERANCE, error
    assert same_columns(out).equals(undisturbed)
    assert kept.items() <= times_of(out).items()


def test_whatever_a_run_does_it_gets_its_row(tmp_path):
    acts = ["fine", "die", "raise", "hang", "exit", "refuse", "die once", *["sleep"] * 6]

    def task(run: int) -> Task:
        return Task(run, str(run), RunParameters(), acts[run], folder=str(tmp_path), wall_clock=5.0)

    with workers.local_pool(2) as pool:
        rows = [result[0] for result in workers.execute(pool, range(len(acts)), task, act) if result]
    found = {row["run"]: row for row in rows}
    assert len(rows) == len(found) == len(acts)
    ends = {name: (found[i]["outcome"], found[i]["reason"]) for i, name in enumerate(acts)}
    assert ends == {
        "fine": ("completed", None),
        "die": ("crashed", "worker_died"),
        "raise": ("crashed", "ValueError"),
        "hang": ("timed_out", "wall_clock"),
        "exit": ("crashed", "SystemExit"),
        "refuse": ("refused", "leg_too_short"),
        "die once": ("completed", None),
        "sleep": ("completed", None),
    }
    assert found[2]["cause"] == "no good at 0x... in file.py of 2"
    assert found[6]["environment_attempts"] > 1


def test_workers_have_one_thread_whatever_the_shell_says(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "4")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    with workers.local_pool(1) as pool:
        pool.client.wait_for_workers(1, timeout=60)
        assert list(pool.client.run(workers.blas_threads).values()) == [1]
    assert os.environ["OMP_NUM_THREADS"] == "4"
    assert "OPENBLAS_NUM_THREADS" not in os.environ


def test_workers_that_die_at_their_start_end_the_sweep(monkeypatch):
    monkeypatch.setattr(workers, "RESTART_TIMEOUT", 0.5)
    monkeypatch.setattr(workers, "GIVE_UP", 2.0)
    monkeypatch.setenv("PYTHONHOME", "/nowhere")  # no interpreter starts with it
    task = Task(0, "0", RunParameters(), "fine")
    with workers.local_pool(2) as pool, pytest.raises(SweepStopped, match="no worker"):
        list(workers.execute(pool, [0], lambda _: task, act))


SCRIPT = """
from validation.judge.metrics import Metric, register
from validation.study.sweep.run import sweep

register(Metric("seven", "1", "seven", "a constant", "walk", lambda walk: 7.0))
table = sweep({file!r}, workers=2).table
print(table.column("metric_seven").to_pylist()[:3])
"""


def test_a_script_without_a_main_guard_sweeps(file, tmp_path):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(file=str(file)), encoding="utf-8")
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=120)
    assert done.stdout.strip() == "[7.0, 7.0, 7.0]", done.stderr


@pytest.mark.slow
def test_hours_of_bad_luck_change_nothing(tmp_path):
    """Several gaits, some of which fall, with recordings of the failures, and everything killed at random."""
    path = tmp_path / "long.toml"
    path.write_text(
        """
[sweep]
gait = "flat"
steps = 6
recordings = "failures"

[[vary]]
method = "sobol"
count = 32
gait.c_y = { from = 0.6, to = 1.1 }
gait.switching_velocity = { from = 0.5, to = 0.8 }
contact.friction = { from = 0.1, to = 0.8 }
""",
        encoding="utf-8",
    )
    status, error = finish(start(path, tmp_path / "calm", "--workers", "1"))
    assert status in (OUT_OF_TOLERANCE, 3), error
    expected = same_columns(tmp_path / "calm")
    out = tmp_path / "out"
    chance = random.Random(1)
    for _ in range(40):
        process = start(path, out, "--resume", "--workers", str(chance.choice((1, 2, 3))))
        for _ in range(chance.randrange(4)):
            time.sleep(chance.uniform(1.0, 6.0))
            for worker in workers_of(process)[:1]:
                worker.kill()
        if process.poll() is None and chance.random() < 0.7:
            time.sleep(chance.uniform(0.0, 10.0))
            os.killpg(process.pid, chance.choice((signal.SIGKILL, signal.SIGINT, signal.SIGTERM)))
        if finish(process)[0] == status:
            break
    else:
        pytest.fail("the sweep did not come to its end")
    assert same_columns(out).equals(expected)
    kept = {name for name in expected["recording"].to_pylist() if name is not None}
    assert kept
    assert {f"recordings/{item.name}" for item in (out / "recordings").iterdir()} == kept
