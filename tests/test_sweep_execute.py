"""What ``ampm sweep`` does around the walks: folders, resume, rows that need no walk, recordings."""

from __future__ import annotations

import errno
import json
import shlex
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, cast

import pytest

from ampm.exceptions import BodilyRefusal, InputError
from validation.cli import app as cli
from validation.study.sweep import cluster, execute, identity, rows, store, work
from validation.study.sweep.columns import TABLE_METADATA
from validation.study.sweep.execute import Execution
from validation.study.sweep.progress import SweepProgress, duration, state_of
from validation.study.sweep.rows import one_line
from validation.study.sweep.summary import status_of

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


class Direct(Execution):
    """Walks in this process, and not really."""

    sent: list[int] = []
    outcome: dict[int, dict[str, Any]] = {}

    def run(self) -> None:
        for item in self._todo:
            if isinstance(item, work.Task):
                self.sent.append(item.run)
                columns = self.outcome.get(item.run, {})
                if isinstance(columns, BaseException):
                    self._flush()
                    raise columns
                self._answer(work.answer_of(item, partial(_walk, columns), "0"))
            else:
                self._keep(item)
        self._flush()


def _walk(found: dict[str, Any], task: work.Task, timing: dict[str, float]) -> dict[str, Any]:
    if "raise" in found:
        raise found["raise"]
    return {"outcome": "completed", "verdict": "pass", "failed": "", "steps_completed": 3, **found}


@pytest.fixture
def direct(monkeypatch: pytest.MonkeyPatch) -> type[Direct]:
    """No cluster, no physics."""

    @contextmanager
    def nobody(workers: int, say: object) -> Iterator[None]:
        yield None

    def start(self: Direct, crew: object, todo: Any, sink: Any, watcher: Any) -> None:
        self._todo, self._sink, self._watcher = todo, sink, watcher
        self._rows, self._oldest = [], 0.0

    monkeypatch.setattr(Direct, "__init__", start)
    monkeypatch.setattr(Direct, "sent", [])
    monkeypatch.setattr(Direct, "outcome", {})
    monkeypatch.setattr(cluster, "local_crew", nobody)
    monkeypatch.setattr(execute, "Execution", Direct)
    return Direct


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "sweep.toml"
    path.write_text(SWEEP, encoding="utf-8")
    return path


def call(file: Path, out: Path, *extra: str) -> int:
    return cli.call(["sweep", str(file), "--out", str(out), *extra])


def test_rows_of_refused_runs_need_no_worker(direct, file, tmp_path, capsys):
    assert call(file, tmp_path / "out", "--json") == 0
    assert direct.sent == [1, 4, 7]
    told = json.loads(capsys.readouterr().out)
    assert told["outcomes"] == {"completed": 3, "refused": 6}
    assert told["refusals"] == {"switching_velocity_too_low": 3, "bad_parameter": 3}
    assert told["directory"] == str(tmp_path / "out")
    results = store.load_results(tmp_path / "out")
    assert results.complete
    found = results.table.to_pylist()
    assert [row["name"] for row in found] == list("012345678")
    assert found[2]["gait.switching_velocity"] == -1.0
    assert found[2]["cause"].startswith("gait.switching_velocity = -1 m/s must be greater than 0")
    assert found[0]["cause"].startswith("gait.switching_velocity = 0.3 m/s is too slow")
    assert len({row["key"] for row in found}) == 9
    assert all(row["environment_code"] == identity.code_hash() for row in found)
    assert (tmp_path / "out" / "report.html").is_file()
    assert TABLE_METADATA in results.table.schema.metadata


def test_resume_walks_what_has_no_answer(direct, file, tmp_path, capsys):
    out = tmp_path / "out"
    direct.outcome = {
        1: {"outcome": "timed_out", "verdict": None},
        4: {"outcome": "crashed", "reason": "worker_died", "verdict": None},
        7: {"raise": ZeroDivisionError("by 0x12ab")},
    }
    assert call(file, out, "--json") == 4
    assert json.loads(capsys.readouterr().out)["unfinished"] == 2
    assert "ZeroDivisionError" in (out / "crashes" / "7.txt").read_text(encoding="utf-8")
    direct.sent.clear()
    direct.outcome = {4: {"outcome": "fell", "verdict": "not_measured"}}
    assert call(file, out, "--resume") == 4
    assert direct.sent == [1, 4]  # what raised would raise again
    table = store.load_results(out).table.to_pylist()
    assert [table[run]["outcome"] for run in (1, 4, 7)] == ["completed", "fell", "crashed"]
    assert (table[7]["reason"], table[7]["cause"]) == ("ZeroDivisionError", "by 0x...")
    direct.sent.clear()
    assert call(file, out, "--resume") == 4
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
def test_what_the_machine_did_is_walked_again(direct, file, tmp_path, capsys, error, reason):
    out = tmp_path / "out"
    beside = InputError("the file cannot be read")
    beside.__context__ = error
    direct.outcome = {1: {"raise": error}, 4: {"raise": beside}, 7: {"raise": OSError(errno.ENOENT, "no")}}
    assert call(file, out) == 4
    assert "2 runs have no answer yet: --resume walks them again" in capsys.readouterr().out
    table = store.load_results(out).table.to_pylist()
    assert [table[run]["reason"] for run in (1, 4, 7)] == [reason, reason, "FileNotFoundError"]
    direct.sent.clear()
    direct.outcome = {4: {"raise": error}}
    assert call(file, out, "--resume") == 4
    assert "1 run has no answer yet: --resume walks it again" in capsys.readouterr().out
    assert direct.sent == [1, 4]


def test_crashes_are_walked_again_when_asked(direct, file, tmp_path, capsys):
    out = tmp_path / "out"
    direct.outcome = {
        1: {"raise": ValueError("a bug")},
        4: {"outcome": "fell", "verdict": "not_measured"},
        7: {"outcome": "crashed", "reason": "ValueError", "verdict": None},
    }
    assert call(file, out) == 4
    (out / "recordings" / "4").mkdir(parents=True)
    direct.sent.clear()
    direct.outcome = {7: {"outcome": "crashed", "reason": "ValueError", "verdict": None}}
    assert call(file, out, "--resume", "--retry", "crashed") == 4
    assert direct.sent == [1, 7]
    assert not (out / "crashes" / "1.txt").exists()
    assert (out / "recordings" / "4").exists()
    direct.outcome = {}
    assert call(file, out, "--resume", "--retry", "crashed, timed-out,fell") == 0
    assert direct.sent == [1, 7, 4, 7]
    assert not (out / "recordings" / "4").exists()
    for extra, words in (
        (("--resume", "--retry", "crash"), "'crash' must be of fell, "),
        (("--retry", "crashed"), "--retry goes with --resume"),
    ):
        assert call(file, out, *extra) == 2
        assert words in capsys.readouterr().err


def test_any_text_of_an_error_can_be_kept(direct, file, tmp_path):
    out = tmp_path / "out"
    direct.outcome = {1: {"raise": ValueError("b\udcffd")}, 4: {"failed": "\ud800", "outcome": "fell"}}
    assert call(file, out) == 4
    table = store.load_results(out).table.to_pylist()
    assert (table[1]["cause"], table[4]["failed"]) == ("b\\udcffd", "\\ud800")
    assert "\\udcff" in (out / "crashes" / "1.txt").read_text(encoding="utf-8")


def test_a_scheduler_that_does_not_answer_leaves_nothing(direct, file, tmp_path, monkeypatch, capsys):
    @contextmanager
    def silent(address: str, say: object) -> Iterator[None]:
        raise InputError("no dask scheduler answers")
        yield

    monkeypatch.setattr(cluster, "remote_crew", silent)
    out = tmp_path / "new" / "out"
    for _ in range(2):
        assert call(file, out, "--scheduler", "tcp://localhost:1") == 2
        assert "no dask scheduler answers" in capsys.readouterr().err
    assert not out.parent.exists()
    assert call(file, out) == 0
    assert call(file, out, "--resume", "--scheduler", "tcp://localhost:1") == 0  # nothing is left to walk


def test_a_sweep_may_be_renamed(direct, file, tmp_path, capsys):
    out = tmp_path / "out"
    assert call(file, out) == 0
    renamed = file.rename(tmp_path / "other.toml")
    assert call(renamed, out, "--resume") == 0
    assert store.load_results(out).definition.name == "other"
    # A folder of before, when the name was part of the hash.
    kept = json.loads((out / "identity.json").read_text(encoding="utf-8"))
    (out / "identity.json").write_text(json.dumps({**kept, "cases": "old"}), encoding="utf-8")
    assert call(renamed, out, "--resume") == 0
    for before, after, told in (
        ("steps = 3", "steps = 4", "sweep.steps = 3 in the folder, 4 in the file"),
        (
            "0.8]",
            "0.9]",
            "contact.friction of [[vary]] block 1 = [0.6, 0.7, 0.8] in the folder, [0.6, 0.7, 0.",
        ),
        ('"flat"', '"normal"', "sweep.gait = 'flat' in the folder, 'normal' in the file; "),
        (
            "\n[[vary",
            "\n[set]\nbody.mass = 60\n[[vary",
            "body.mass under [set] = nothing in the folder, 60.0",
        ),
    ):
        renamed.write_text(SWEEP.replace(before, after), encoding="utf-8")
        assert call(renamed, out, "--resume") == 2
        assert told in capsys.readouterr().err
    lines = SWEEP.splitlines()
    turned = "\n".join([*lines[:-2], lines[-1], lines[-2]])
    renamed.write_text(turned, encoding="utf-8")
    assert call(renamed, out, "--resume") == 2
    assert "order of the varied keys" in capsys.readouterr().err


def test_workers_with_several_threads_are_told_of_once(monkeypatch):
    said: list[str] = []
    crew = cluster.Crew(cast(Any, None), said.append)
    for threads in (None, 1, 4, 8):
        crew.saw(threads)
    assert len(said) == 1
    assert "4 BLAS threads" in said[0]
    for variables, threads in (
        ({"OMP_NUM_THREADS": "4"}, 4),
        ({"OMP_NUM_THREADS": "4", "OPENBLAS_NUM_THREADS": "1"}, 1),
        ({"OMP_NUM_THREADS": "3,2"}, 3),
    ):
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "GOTO_NUM_THREADS"):
            monkeypatch.delenv(name, raising=False)
        for name, value in variables.items():
            monkeypatch.setenv(name, value)
        assert work.blas_threads() == threads


@pytest.mark.parametrize(
    "last", ["OSError: [Errno 28] No space left", "OSError 28", "RuntimeError: io (os error 28)"]
)
def test_a_full_disk_is_told_while_a_recording_is_drawn(tmp_path, monkeypatch, last):
    from validation.study.sweep import recording
    from validation.study.sweep.exceptions import SweepStopped

    monkeypatch.setattr(recording, "_write", lambda *_: None)
    code = f"import sys; sys.stderr.buffer.write(b'\\xff\\n' + {last!r}.encode()); sys.exit(1)"
    monkeypatch.setattr(recording, "_DRAW", code)
    with pytest.raises(SweepStopped, match=r"no room is left for recording and report .*free some space"):
        recording.keep_run(cast(Any, None), tmp_path, "0", {})
    monkeypatch.setattr(recording, "_DRAW", "raise ValueError('4280')")
    with pytest.raises(SweepStopped, match="could not be drawn"):
        recording.keep_run(cast(Any, None), tmp_path, "0", {})


def test_an_interrupted_sweep_goes_on(direct, file, tmp_path, capsys):
    out = tmp_path / "out"
    direct.outcome = {4: KeyboardInterrupt()}
    assert call(file, out) == 130
    told = capsys.readouterr().err.splitlines()[-1]
    assert told == (
        "ampm: interrupted; every finished row is kept; go on with: "
        f"ampm sweep {shlex.quote(str(file))} --out {shlex.quote(str(out))} --resume"
    )
    assert not store.load_results(out).complete
    direct.outcome = {}
    assert call(file, out, "--resume") == 0
    assert direct.sent == [1, 4, 4, 7]


def test_folders_are_never_replaced(direct, file, tmp_path, capsys):
    out = tmp_path / "out"
    assert call(file, out) == 0
    for extra, words in (
        ((), "exists and is not empty"),
        (("--force",), "--force goes with --resume"),
        (("--resume", "--workers", "0"), "must be at least 1"),
        (("--workers", "2", "--scheduler", "tcp://localhost:1"), "exclude each other"),
    ):
        assert call(file, out, *extra) == 2
        assert words in capsys.readouterr().err
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "thesis.tex").touch()
    assert call(file, foreign, "--resume") == 2
    assert "thesis.tex" in capsys.readouterr().err
    assert call(file, file) == 2
    assert cli.call(["sweep", str(file)]) == 2
    assert "give --out DIR" in capsys.readouterr().err


def test_resume_begins_where_nothing_is(direct, file, tmp_path, capsys):
    assert call(file, tmp_path / "out", "--resume") == 0
    assert "nothing to resume" in capsys.readouterr().err
    assert direct.sent == [1, 4, 7]


def test_another_definition_is_refused_but_another_guard_is_not(direct, file, tmp_path, capsys):
    out = tmp_path / "out"
    assert call(file, out) == 0
    file.write_text(SWEEP.replace("0.8]", "0.9]"), encoding="utf-8")
    assert call(file, out, "--resume") == 2
    assert "holds another sweep" in capsys.readouterr().err
    file.write_text("[limits]\nwall_clock = 1e4\n" + SWEEP, encoding="utf-8")
    assert call(file, out, "--resume") == 0


def test_other_code_is_mixed_only_by_force(direct, file, tmp_path, monkeypatch, capsys):
    out = tmp_path / "out"
    direct.outcome = {4: KeyboardInterrupt()}
    assert call(file, out) == 130
    newer = {**identity.code(), "mujoco": "9.9.9", "sources": "other"}
    monkeypatch.setattr(identity, "code", lambda: newer)
    direct.outcome = {}
    assert call(file, out, "--resume") == 2
    told = capsys.readouterr().err
    assert "the sources, mujoco 3.17.0 -> 9.9.9" in told or "-> 9.9.9, the sources" in told
    monkeypatch.setattr(rows, "code_hash", lambda: "other")
    rows._constant_environment.cache_clear()
    assert call(file, out, "--resume", "--force") == 0
    assert "mixes rows of different code" in capsys.readouterr().err
    rows._constant_environment.cache_clear()


def test_the_worst_runs_are_walked_again_for_their_folders(direct, file, tmp_path, capsys):
    out = tmp_path / "out"
    file.write_text(SWEEP.replace('recordings = "none"', 'recordings = "worst"\nworst = 2'), encoding="utf-8")
    direct.outcome = {
        1: {"metric_zmp_x_rmse": 1e-3},
        4: {"outcome": "fell", "verdict": "not_measured", "steps_completed": 1},
        7: {"metric_zmp_x_rmse": 2e-3},
    }
    assert call(file, out) == 3
    assert direct.sent == [1, 4, 7, 4, 7]
    table = store.load_results(out).table
    kept = [None] * 4 + ["recordings/4", None, None, "recordings/7", None]
    assert table["recording"].to_pylist() == kept
    assert "gave another" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("outcomes", "verdicts", "status"),
    [
        ({"completed": 2, "refused": 3}, {"pass": 2}, 0),
        ({"completed": 2}, {"pass": 1, "fail": 1}, 1),
        ({"refused": 2}, {}, 2),
        ({"completed": 2, "fell": 1}, {"pass": 2, "not_measured": 1}, 3),
        ({"completed": 2, "timed_out": 1}, {"pass": 2}, 3),
        ({"completed": 2, "crashed": 1, "fell": 1}, {"pass": 2}, 4),
    ],
)
def test_the_status_is_that_of_the_worst_walk(outcomes, verdicts, status):
    assert status_of({"outcomes": outcomes, "verdicts": verdicts}) == status


def test_a_worker_of_other_code_is_refused():
    from ampm.parameters import RunParameters
    from validation.study.sweep.exceptions import SweepStopped

    with pytest.raises(SweepStopped, match="other code or versions"):
        work.walk_task(work.Task(0, "0", RunParameters(), "default", code="other"))


def test_a_refusal_of_the_body_still_has_the_plan():
    from ampm.parameters import load_run

    error = BodilyRefusal("no", reason="leg_too_short", value=1.0, limit=0.5, unit="m", way_out="bend")

    def refuse(task: work.Task, timing: dict[str, float]) -> dict[str, Any]:
        raise error

    row = work.answer_of(work.Task(3, "3", load_run("flat"), "default"), refuse, None).row
    assert (row["outcome"], row["reason"], row["cause"]) == ("refused", "leg_too_short", "no; bend.")
    assert row["plan_l_s"] == pytest.approx(0.1185)
    assert row["plan_angular_momentum_y_offset"] is None


def test_a_worker_loads_no_viewer_and_no_pictures():
    code = (
        "import sys, validation.study.sweep.work, validation.trial.plan, validation.judge.examine; "
        "print([name for name in ('rerun', 'matplotlib', 'typer') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_words_for_errors_name_no_place():
    text = one_line(OSError(2, "No such file", "/home/somebody/x/y.toml"))
    assert text == "[Errno 2] No such file: 'y.toml'"
    assert one_line(ValueError("a 1/2 m/s\n  of <obj at 0xdeadbeef>")) == "a 1/2 m/s of <obj at 0x...>"


def test_progress_in_words(capsys):
    from rich.console import Console

    shown = SweepProgress(10, 8, {"pass": 1}, Console(stderr=True, width=120))
    with shown:
        shown.row({"outcome": "refused", "verdict": None, "timing_total": None})
        for verdict in ("pass", "fail", "pass"):
            shown.row({"outcome": "completed", "verdict": verdict, "timing_total": 1.0})
        shown.row({"outcome": "fell", "verdict": "not_measured", "timing_total": 1.0})
        shown.tick(2)
        text = shown.text()
    assert text.startswith("3 pass, 1 fail, 1 fell, 1 refused, ")
    assert text.endswith(" left")
    assert (shown.done, shown.walked) == (6, 4)
    assert state_of({"outcome": "timed_out", "verdict": None}) == "timed out"
    assert [duration(s) for s in (7, 187, 7387)] == ["0:07", "3:07", "2:03:07"]


def test_a_run_keeps_its_folder(tmp_path):
    from ampm.parameters import load_run

    run = load_run("flat", ["gait.steps=2"])
    task = work.Task(0, "0", run, "default", recordings="all", folder=str(tmp_path))
    row = work.walk_task(task).row
    folder = tmp_path / str(row["recording"])
    assert row["recording"] == "recordings/0"
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert summary["metrics"]["zmp_x_rmse"]["value"] == row["metric_zmp_x_rmse"]
    assert (folder / "recording.rrd").is_file()
    assert (folder / "report.html").is_file()
    assert row["timing_recording"] > 0.0
