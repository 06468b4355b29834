"""Execution of a sweep: folders, resume, rows that need no walk, recordings, exit statuses."""

from __future__ import annotations

import errno
import json
import shlex
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from validation.study.sweep.exceptions import SweepStopped
from validation.study.sweep.store import ROWS

from ampm.exceptions import BodilyRefusal, InputError
from ampm.parameters import RunParameters
from ampm.run_file import load_run
from validation.cli import app as cli
from validation.progress import Progress, Stage
from validation.store import identity
from validation.study.sweep import report, schema, store, task, workers
from validation.study.sweep import run as sweep_run
from validation.study.sweep.design import parse_sweep
from validation.study.sweep.report import repeat_command
from validation.study.sweep.run import sweep
from validation.study.sweep.table import read_sweep

SWEEP = """
[sweep]
gait = "flat"
steps = 3
recordings = "none"

[[vary]]
method = "grid"
contact.friction = [0.6, 0.7, 0.8]
gait.switching_velocity = [0.3, 0.7, -1.0]
"""


class Direct:
    """``ampm sweep`` of one file into one folder, walked in this process, and not really.

    Attributes:
        sent: runs that were walked by the last call.
        outcome: of runs; those without one pass.
    """

    def __init__(self, folder: Path) -> None:
        self.file, self.out = folder / "sweep.toml", folder / "out"
        self.file.write_text(SWEEP, encoding="utf-8")
        self.sent: list[int] = []
        self.outcome: dict[int, Any] = {}

    def __call__(self, *options: str) -> int:
        self.sent = []
        return cli.call(["sweep", str(self.file), "--out", str(self.out), *options])

    def rows(self) -> list[dict[str, Any]]:
        return read_sweep(self.out).table.to_pylist()

    def execute(self, _: object, runs: list[int], make: Callable[[int], task.Task]) -> Iterator[task.Result]:
        for run in runs:
            self.sent.append(run)
            found = self.outcome.get(run, {})
            if isinstance(found, KeyboardInterrupt):
                raise found
            yield task.walk_task(replace(make(run), wall_clock=None), partial(_walk, found))


def _walk(found: Any, job: task.Task, timing: dict[str, float]) -> dict[str, Any]:
    if isinstance(found, Exception):
        raise found
    recording = f"recordings/{job.name}" if job.keep else None
    row = {
        "outcome": "completed",
        "verdict": "pass",
        "failed": "",
        "steps_completed": 3,
        "foot_length": 0.258,
    }
    return row | {"recording": recording} | found


@pytest.fixture
def direct(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Direct:
    """No processes, no physics, no drawing."""
    found = Direct(tmp_path)
    monkeypatch.setattr(report, "write_sweep_report", lambda folder: (folder / "report.html").touch())
    monkeypatch.setattr(workers, "local_pool", lambda count: nullcontext(SimpleNamespace(size=lambda: 1)))
    monkeypatch.setattr(workers, "execute", found.execute)
    return found


CRASH = {"outcome": "crashed", "reason": "ValueError", "verdict": None}
FELL = {"outcome": "fell", "verdict": "not_measured"}


def test_rows_of_refused_runs_need_no_worker(direct, capsys):
    assert direct("--json") == 0
    assert direct.sent == [1, 4, 7]
    summary = json.loads(capsys.readouterr().out)
    assert summary["states"] == {"pass": 3, "refused": 6}
    assert summary["refusals"] == {"switching_velocity_too_low": 3, "bad_parameter": 3}
    assert summary["directory"] == str(direct.out)
    assert read_sweep(direct.out).complete
    found = direct.rows()
    assert [row["name"] for row in found] == list("012345678")
    assert found[2]["gait.switching_velocity"] == -1.0
    assert "gait.switching_velocity = -1 m/s" in found[2]["cause"]
    assert len({row["key"] for row in found}) == 9
    assert all(row["environment_code"] == identity.code_hash() for row in found)
    assert (direct.out / "report.html").is_file()
    memory = sweep(parse_sweep(SWEEP))  # without a folder
    assert memory.directory is None
    assert memory.table["outcome"].to_pylist().count("completed") == 3
    assert sweep(direct.file).table.num_rows == 9


def test_resume_walks_what_has_no_answer(direct, capsys):
    direct.outcome = {
        1: {"outcome": "timed_out", "verdict": None},
        4: {"outcome": "crashed", "reason": "worker_died", "verdict": None},
        7: ZeroDivisionError("by 0x12ab b\udcffd"),
    }
    assert direct("--json") == 4
    assert json.loads(capsys.readouterr().out)["unfinished"] == 2
    assert r"by 0x12ab b\udcff" in (direct.out / "crashes" / "7.txt").read_text(encoding="utf-8")
    direct.outcome = {4: FELL | {"failed": "\ud800"}}
    assert direct("--resume") == 4
    assert direct.sent == [1, 4]  # what raised would raise again
    table = direct.rows()
    assert [table[run]["outcome"] for run in (1, 4, 7)] == ["completed", "fell", "crashed"]
    assert (table[7]["reason"], table[7]["cause"]) == ("ZeroDivisionError", r"by 0x... b\udcffd")
    assert table[4]["failed"] == r"\ud800"  # any text can be kept
    assert direct("--resume") == 4
    assert direct.sent == []


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (MemoryError(), "MemoryError"),
        (type("_ArrayMemoryError", (MemoryError,), {})("no room"), "MemoryError"),
        (OSError(errno.EMFILE, "Too many open files"), "EMFILE"),
        (OSError(errno.EIO, "Input/output error"), "EIO"),
    ],
)
def test_faults_of_the_host_are_walked_again(direct, error, reason):
    beside = InputError("the file cannot be read")
    beside.__context__ = error
    direct.outcome = {1: error, 4: beside, 7: OSError(errno.ENOENT, "no")}
    assert direct() == 4
    found = read_sweep(direct.out)
    assert [found.words("reason")[run] for run in (1, 4, 7)] == [reason, reason, "FileNotFoundError"]
    assert direct("--resume") == 4
    assert direct.sent == [1, 4]


def test_outcomes_are_walked_again_on_request(direct):
    direct.outcome = {1: ValueError("a bug"), 4: FELL | {"recording": "recordings/4"}, 7: CRASH}
    assert direct() == 4
    (direct.out / "recordings" / "4").mkdir(parents=True)
    direct.outcome = {7: CRASH}
    assert direct("--resume", "--retry", "crashed") == 4
    assert direct.sent == [1, 7]
    assert not (direct.out / "crashes" / "1.txt").exists()
    assert (direct.out / "recordings" / "4").exists()
    direct.outcome = {}
    assert direct("--resume", "--retry", "crashed, timed-out,fell") == 0
    assert direct.sent == [4, 7]
    assert not (direct.out / "recordings" / "4").exists()


@pytest.mark.parametrize(
    ("extra", "words"),
    [
        (("--resume", "--retry", "crash"), "'crash' must be of fell, "),
        (("--retry", "crashed"), "--force and --retry go with --resume"),
        ((), "exists and is not empty"),
        (("--force",), "--force and --retry go with --resume"),
        (("--resume", "--workers", "0"), "must be at least 1"),
        (("--workers", "2", "--scheduler", "tcp://localhost:1"), "exclude each other"),
        (("--resume", "--out", "{foreign}"), "holds no sweep"),
        (("--out", "{file}"), "is a file"),
    ],
)
def test_options_that_do_not_fit_are_refused(direct, tmp_path, capsys, extra, words):
    for folder, name in ((direct.out, "sweep.toml"), (tmp_path / "foreign", "thesis.tex")):
        folder.mkdir()
        (folder / name).touch()
    assert direct(*(item.format(foreign=tmp_path / "foreign", file=direct.file) for item in extra)) == 2
    assert words in capsys.readouterr().err
    assert direct.sent == []


def test_resume_begins_where_nothing_is(direct, capsys):
    assert cli.call(["sweep", str(direct.file)]) == 2
    assert "give --out DIR" in capsys.readouterr().err
    assert direct("--resume") == 0
    assert "nothing to resume" in capsys.readouterr().err
    assert direct.sent == [1, 4, 7]


def test_a_scheduler_that_does_not_answer_leaves_nothing(direct, monkeypatch, capsys):
    def silent(address: str, say: object) -> None:
        raise InputError("no dask scheduler answers")

    monkeypatch.setattr(workers, "remote_pool", silent)
    for _ in range(2):
        assert direct("--scheduler", "tcp://localhost:1") == 2
        assert "answers" in capsys.readouterr().err
    assert not direct.out.exists()
    assert direct() == 0
    assert direct("--resume", "--scheduler", "tcp://localhost:1") == 0  # nothing is left to walk


def test_a_folder_takes_only_its_own_sweep(direct, tmp_path, capsys):
    assert direct() == 0
    direct.file = tmp_path / "other.toml"
    direct.file.write_text(SWEEP.replace("steps = 3", "steps = 3\nwall_clock = 1e4"), encoding="utf-8")
    assert direct("--resume") == 0
    assert read_sweep(direct.out).name == "other"
    *head, one, two = SWEEP.splitlines()
    for old, new, words in (
        ("steps = 3", "steps = 4", "sweep.steps is 3 in the folder and 4 in the file"),
        ("0.8]", "0.9]", "vary.1.contact.friction is [0.6, 0.7, 0.8] in the folder and [0.6, 0.7, 0.9]"),
        ('"flat"', '"normal"', "sweep.gait is 'flat' in the folder and 'normal' in the file"),
        ("\n[[vary", "\n[set]\nbody.mass = 60\n[[vary", "set.body.mass is another in the folder and 60.0"),
        (SWEEP, "\n".join([*head, two, one]), "order of keys"),
    ):
        direct.file.write_text(SWEEP.replace(old, new), encoding="utf-8")
        assert direct("--resume") == 2
        assert words in capsys.readouterr().err


def test_other_code_is_mixed_only_by_force(direct, monkeypatch, capsys):
    direct.outcome = {4: KeyboardInterrupt()}
    assert direct() == 130
    newer = {**identity.code(), "mujoco": "9.9.9"}
    monkeypatch.setattr(store, "code", lambda: newer)
    direct.outcome = {}
    assert direct("--resume") == 2
    assert "-> 9.9.9" in capsys.readouterr().err
    monkeypatch.setattr(schema, "code_hash", lambda: "other")
    schema._constant_environment.cache_clear()
    assert direct("--resume", "--force") == 0
    assert "different code" in capsys.readouterr().err
    schema._constant_environment.cache_clear()


def test_an_interrupted_sweep_goes_on(direct, capsys):
    direct.outcome = {4: KeyboardInterrupt()}
    assert direct() == 130
    told = capsys.readouterr().err.splitlines()[-1]
    assert told.endswith(
        f"ampm sweep {shlex.quote(str(direct.file))} --out {shlex.quote(str(direct.out))} --resume"
    )
    assert not read_sweep(direct.out).complete
    assert (direct.out / ROWS).exists()
    direct.outcome = {}
    assert direct("--resume") == 0
    assert direct.sent == [4, 7]
    assert not (direct.out / ROWS).exists()


@pytest.mark.parametrize(
    ("recordings", "kept"),
    [
        ('"failures"', [4]),  # the others pass
        ('"worst"\nworst = 2', [4, 7]),
    ],
)
def test_the_worst_runs_are_walked_again_for_their_folders(direct, capsys, recordings, kept):
    direct.file.write_text(SWEEP.replace('"none"', recordings), encoding="utf-8")
    direct.outcome = {1: {"metric_zmp_x_rmse": 1e-3}, 4: FELL, 7: {"metric_zmp_x_rmse": 2e-3}}
    assert direct() == 3
    assert direct.sent == [1, 4, 7, *kept]
    found = read_sweep(direct.out)
    assert found.words("recording") == [f"recordings/{run}" if run in kept else "" for run in range(9)]
    assert found.worst[:3] == [4, 7, 1]
    assert direct("--resume") == 3  # no report is there: they are walked for it again
    assert direct.sent == kept
    assert "gave another" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("outcomes", "status"),
    [
        ([{}, {}, {}], 0),
        ([{}, {"verdict": "fail"}, {}], 1),
        ([BodilyRefusal("a", reason="b", value=1.0, limit=1.0, unit="m", way_out="c")] * 3, 2),
        ([{}, FELL, {}], 3),
        ([{}, {"outcome": "timed_out", "verdict": None}, {}], 3),
        ([{}, CRASH, FELL], 4),
    ],
)
def test_the_status_is_that_of_the_worst_walk(direct, outcomes, status):
    direct.outcome = dict(zip((1, 4, 7), outcomes, strict=True))
    assert direct() == status


def test_what_stops_the_sweep(tmp_path, monkeypatch):
    trial = cast(Any, SimpleNamespace(save=lambda *_, **__: None))
    code = r"import sys; sys.stderr.buffer.write(b'\xff\nOSError: [Errno 28] No space left'); sys.exit(1)"
    monkeypatch.setattr(task, "_DRAW", code)
    job = task.Task(0, "0", RunParameters(), "default", folder=str(tmp_path))
    with pytest.raises(SweepStopped, match="No space left"):
        task.keep_run(trial, job)
    with pytest.raises(SweepStopped, match="other code"):
        task.walk_task(replace(job, code="other"))


def test_a_refusal_of_the_body_still_has_the_plan():
    error = BodilyRefusal("no", reason="leg_too_short", value=1.0, limit=0.5, unit="m", way_out="bend")
    row, _ = task.walk_task(task.Task(3, "3", load_run("flat"), "default"), partial(_walk, error))
    assert (row["outcome"], row["reason"], row["cause"]) == ("refused", "leg_too_short", "no; bend.")
    assert row["plan_l_s"] == pytest.approx(0.1185)
    assert row["plan_angular_momentum_y_offset"] is None


def test_words_for_errors_name_no_place():
    text = schema.one_line(OSError(2, "No such file", "/home/somebody/x/y.toml"))
    assert text == "[Errno 2] No such file: 'y.toml'"
    assert schema.one_line(ValueError("a 1/2 m/s\n  of <obj at 0xdeadbeef>")) == "a 1/2 m/s of <obj at 0x...>"


def test_progress_in_words():
    counts = sweep_run.Counter({sweep_run.State.PASS: 1})
    kept = cast(Any, SimpleNamespace(append=list))
    shown = sweep_run._Keeper(kept, Stage(), Progress(), 10, 8, counts)
    ends = [("refused", None), *(("completed", verdict) for verdict in ("pass", "fail", "pass"))]
    for outcome, verdict in [*ends, ("fell", "not_measured")]:
        attempts = int(outcome != "refused")
        row = {"outcome": outcome, "verdict": verdict, "environment_attempts": attempts}
        shown.take((row, ""), 2)
    assert shown.text().startswith("3 pass, 1 out of tolerance, 1 fell, 1 refused, ")
    assert shown.text().endswith(" left")
    assert shown.done == 6


def test_a_run_keeps_its_folder(tmp_path):
    run = load_run("flat", ["gait.steps=2"])
    row, _ = task.walk_task(task.Task(0, "0", run, "default", keep=True, folder=str(tmp_path)))
    folder = tmp_path / str(row["recording"])
    assert row["recording"] == "recordings/0"
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert summary["metrics"]["zmp_x_rmse"]["value"] == row["metric_zmp_x_rmse"]
    assert (folder / "recording.rrd").is_file()
    assert (folder / "report.html").is_file()
    assert row["timing_recording"] > 0.0


OWN = """
[sweep]
gait = "flat"
steps = 2
recordings = "none"
push = ["chest,20,0,0,0.5,0.1"]

[set]
controller.name = "tests.test_api:{name}"

[[vary]]
method = "list"
contact.friction = [0.8]
"""


def test_a_controller_and_pushes_of_ones_own_walk_every_run(tmp_path):
    limp, broken = (parse_sweep(OWN.format(name=name)) for name in ("Limp", "Broken"))
    row, _ = task.walk_task(task.Task.of(limp, 0, tmp_path, keep=True, wall_clock=None))
    assert row["outcome"] == "fell"
    summary = json.loads((tmp_path / "recordings" / "0" / "summary.json").read_text(encoding="utf-8"))
    assert summary["controller"] == "tests.test_api:Limp"
    assert "force=(20.0, 0.0, 0.0)" in summary["disturbances"][0]
    row, trace = task.walk_task(task.Task.of(broken, 0, tmp_path, wall_clock=None))
    assert (row["outcome"], row["reason"]) == ("crashed", "UsersError")
    assert "Broken" in row["cause"]
    assert "Traceback" in trace
    late = parse_sweep(OWN.format(name="Late"))
    row, trace = task.walk_task(task.Task.of(late, 0, tmp_path, wall_clock=None))
    assert (row["outcome"], row["reason"]) == ("crashed", "UsersError")
    assert "Late failed (KeyError: 'late') in test_api.py" in row["cause"]
    assert "Traceback" in trace


def test_a_controller_and_pushes_are_part_of_the_sweeps_identity(direct, tmp_path, monkeypatch, capsys):
    mine = tmp_path / "own_controller.py"
    mine.write_text("class Limp: ...\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    text = OWN.format(name="Limp").replace("tests.test_api", "own_controller")
    direct.file.write_text(text, encoding="utf-8")
    assert direct() == 0
    table = read_sweep(direct.out)
    assert table.metadata["options"] == ["--push", "chest,20,0,0,0.5,0.1"]
    assert "--set controller.name=own_controller:Limp" in repeat_command(table)[0]
    direct.file.write_text(text.replace("20,0", "30,0"), encoding="utf-8")
    assert direct("--resume") == 2
    assert "sweep.push" in capsys.readouterr().err
    direct.file.write_text(text, encoding="utf-8")
    mine.write_text("class Limp:\n    changed = True\n", encoding="utf-8")
    assert direct("--resume") == 2
    assert "controller own_controller:Limp" in capsys.readouterr().err


@pytest.mark.parametrize("address", ["nohost", "foo://host:1", "none.json"])
def test_a_scheduler_that_cannot_be_is_refused_at_once(address, capfd):
    with pytest.raises(InputError, match=f"no dask scheduler answers at --scheduler {address}"):
        workers.remote_pool(address, print, timeout=0.2).__enter__()
    assert not capfd.readouterr().err
