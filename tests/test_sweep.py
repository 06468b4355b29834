"""A sweep from its definition to its folder: rows, resume, recordings, dry run, exit statuses."""

import errno
import json
import math
from types import SimpleNamespace
from typing import Any

import pyarrow as pa
import pytest

import validation as val
from ampm.exceptions import BodilyRefusal, InputError, StudyStopped
from ampm.parameters import RunParameters
from tests.sweep_table import make_table, parse_sweep
from validation.cli.app import call
from validation.store.environment import parameter_values, run_key
from validation.study import many
from validation.study.row_file import ROWS, RowFile
from validation.study.sweep import report, run
from validation.study.sweep.design import load_sweep
from validation.study.sweep.schema import schema
from validation.study.sweep.table import SweepTable, read_sweep

SWEEP = """
[sweep]
gait = "flat"
steps = 3
recordings = "none"

[[vary]]
method = "grid"
contact.friction = [0.6, 0.7, 0.8]

[[vary]]
method = "list"
gait.switching_velocity = [0.3, 0.7, 0.7]
sensors.delay = [0.0, 0.0, 0.0003]
"""
"""Nine runs, of which 1, 4, 7 can walk; the formula refuses a speed of 0.3, the time step a delay."""
PASS = {"outcome": "completed", "verdict": "pass", "failed": "", "steps_completed": 3, "foot_length": 0.26}
FELL = {"outcome": "fell", "verdict": "not_measured"}
CRASH = {"outcome": "crashed", "reason": "ValueError", "cause": "a bug"}
REFUSAL = BodilyRefusal("a", reason="leg_too_short", value=1.0, limit=1.0, unit="m", way_out="bend it")
COST = ["worker", "timing_total"]

ENDS: dict[int, Any] = {}
"""What walking a run gives or raises; other runs pass."""
WALKED: list[int] = []
"""Runs that were walked, kept ones with a minus."""


def pretend(**options):
    number = int(options["request"].name)
    WALKED.append(number)
    end = ENDS.get(number, {})
    if isinstance(end, BaseException):
        raise end
    return PASS | end


def pretend_to_keep(folder, **options):
    number = int(options["request"].name)
    WALKED.append(-number)
    if ENDS.get(-number):
        raise ENDS[-number]
    (run.Path(folder)).mkdir(parents=True)
    (run.Path(folder) / "report.html").touch()
    return {"outcome": "kept"}


@pytest.fixture
def command(tmp_path, monkeypatch):
    """``ampm sweep`` of :data:`SWEEP` in this process, without physics and pictures; returns its status."""
    monkeypatch.setattr(run, "walk_run", pretend)
    monkeypatch.setattr(run, "keep_run", pretend_to_keep)
    monkeypatch.setattr(report, "write_sweep_report", lambda folder: (folder / "report.html").touch())
    ENDS.clear()

    def sweep(*options, text=SWEEP):
        WALKED.clear()
        (tmp_path / "sweep.toml").write_text(text, encoding="utf-8")
        words = [str(tmp_path / "sweep.toml"), "--out", str(tmp_path / "out"), "--workers", "0"]
        return call(["sweep", *words, *options])

    return sweep


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out"


def results(folder) -> pa.Table:
    """Table of a sweep without its cost, which is another in every call."""
    return read_sweep(folder).table.drop_columns(COST)


def test_rows_become_a_table_and_refusals_need_no_walk(command, out, capsys):
    ENDS[4] = {"metric_zmp_x_rmse": 0.1 + 0.2, "gait.a_s": 1.5, "failed": ""}  # a value that was found
    assert command("--json") == 0
    assert WALKED == [1, 4, 7]
    said = json.loads(capsys.readouterr().out)
    assert said["states"] == {"pass": 3, "refused": 6}
    assert said["refusals"] == {"switching_velocity_too_low": 3, "bad_parameter": 3}
    assert json.loads((out / "sweep.json").read_text())["runs"] == 9
    table = read_sweep(out).table
    assert table.schema.remove_metadata().equals(schema(), check_metadata=True)
    rows = table.to_pylist()
    assert [row["run"] for row in rows] == list(range(9))
    assert len({row["key"] for row in rows}) == 9
    assert rows[2]["sensors.delay"] == 0.0003
    assert "sensors.delay = 0.0003 s gives 0.6 steps" in rows[2]["cause"]
    assert rows[0]["metric_zmp_x_rmse"] is None
    assert rows[4]["metric_zmp_x_rmse"] == 0.1 + 0.2
    assert [row["gait.a_s"] for row in rows[3:5]] == [2.63, 1.5]
    memory = val.sweep(parse_sweep(SWEEP), workers=0)  # without a folder
    assert memory.directory is None
    assert memory.counts == read_sweep(out).counts


def test_every_parameter_and_metric_has_its_column_with_unit_and_meaning():
    names = schema().names
    assert len(names) == len(set(names))
    assert parameter_values(RunParameters()).keys() <= set(names)
    for item in schema():
        assert item.metadata[b"meaning"], item.name
        assert bool(item.metadata[b"unit"]) != pa.types.is_string(item.type), item.name
    sweep = SweepTable(make_table(2), None, "x")
    assert (sweep.unit("gait.step_length"), sweep.unit("outcome")) == ("m", "1")
    assert sweep.metadata["tolerances"]["zmp_x_rmse"]["unit"] == "foot length"


def test_the_key_of_a_run_is_of_what_is_not_at_its_default():
    base = RunParameters()
    keys = {run_key(parameter_values(item)) for item in (base, base.replace({"gait.c_s": 1.0 + 2.3e-16}))}
    assert len(keys) == 2
    assert run_key({}) in keys


def test_resume_walks_what_is_missing_and_gives_the_same_table(command, out, capsys):
    ENDS[4] = FELL | {"metric_zmp_x_rmse": 0.1}
    assert command() == 3
    whole = results(out)
    lines = (out / ROWS).read_text().splitlines(keepends=True)
    (out / ROWS).write_text("".join(lines[:4]) + lines[4][:20])  # killed while it wrote the row of run 4
    assert command("--resume") == 3
    assert WALKED == [4, 7]
    assert results(out).equals(whole)
    assert command("--resume") == 3
    assert WALKED == []
    assert command("--resume", "--dry-run") == 0
    assert "nothing is left to walk" in capsys.readouterr().out


def test_an_interrupted_sweep_can_be_read_and_goes_on(command, out, capsys, monkeypatch):
    ENDS[1], ENDS[4] = {"gait.a_s": math.inf}, KeyboardInterrupt()
    assert command() == 130
    assert "--resume" in capsys.readouterr().err.splitlines()[-1]
    ongoing = read_sweep(out)
    assert math.inf in ongoing.numbers("gait.a_s")
    assert (len(ongoing), ongoing.planned) == (6, 9)  # refusals are found ahead of the walks
    monkeypatch.undo()
    assert call(["report", str(out)]) == 0
    assert "3 of 9 runs are missing" in (out / "report.html").read_text(encoding="utf-8")


def test_a_walk_that_ctrl_c_ends_in_this_process_is_no_row(monkeypatch):
    interrupted = SimpleNamespace(record=SimpleNamespace(outcome=SimpleNamespace(name="interrupted")))
    monkeypatch.setattr(many, "plan_walk", lambda *_, **__: None)
    monkeypatch.setattr(many, "walk_planned", lambda *_, **__: interrupted)
    with pytest.raises(KeyboardInterrupt):
        run.walk_run(request=None)


@pytest.mark.parametrize(
    ("old", "new", "walked"),
    [
        ('[[vary]]\nmethod = "grid"', '[set]\nbody.mass = 66.0\n[[vary]]\nmethod = "grid"', [1, 4, 7]),
        ("steps = 3", 'steps = 3\nprofile = "strict"', [1, 4, 7]),
        ("0.8]", "0.9]", [7]),
        ("steps = 3", "steps = 3\nwall_clock = 9.0", []),
    ],
)
def test_a_changed_definition_walks_what_it_changes(command, out, old, new, walked):
    assert command() == 0
    assert command("--resume", text=SWEEP.replace(old, new)) == 0
    assert walked == WALKED
    assert load_sweep(out / "sweep.toml").keys == read_sweep(out).varied
    (out / "results.parquet").unlink()
    assert len(read_sweep(out)) == 9  # rows of the other definition do not count
    (out / ROWS).unlink()
    with pytest.raises(InputError, match=r"no result yet; .* --resume"):
        read_sweep(out)


def test_crashes_are_walked_again(command, out):
    ENDS[4] = ValueError("at 0x12ab in /home/x/y.py b\udcff")
    assert command() == 4
    row = read_sweep(out).table.to_pylist()[4]
    assert (row["outcome"], row["reason"]) == ("crashed", "ValueError")
    assert row["cause"] == r"at 0x12ab in /home/x/y.py b\udcff"
    assert "Traceback" in row["traceback"]
    assert command("--resume") == 4
    assert WALKED == [4]


def test_a_folder_in_use_keeps_its_definition(command, out, capsys):
    assert command() == 0
    writing = RowFile(out)
    assert command("--resume", text=SWEEP.replace("0.8]", "0.9]")) == 2
    assert "another program" in capsys.readouterr().err
    writing.close()
    assert load_sweep(out / "sweep.toml").vary == parse_sweep(SWEEP).vary
    assert len(read_sweep(out)) == 9


@pytest.mark.parametrize(("recordings", "kept"), [('"failures"', [4]), ('"worst"\nworst = 2', [4, 7])])
def test_the_worst_runs_are_kept(command, out, recordings, kept):
    ENDS.update({1: {"metric_zmp_x_rmse": 1e-3}, 4: FELL, 7: {"metric_zmp_x_rmse": 2e-3}})
    text = SWEEP.replace('"none"', recordings)
    assert command(text=text) == 3
    assert [1, 4, 7, *(-number for number in kept)] == WALKED
    sweep = read_sweep(out)
    assert sweep.words("recording") == [f"recordings/{n}" if n in kept else "" for n in range(9)]
    assert sweep.worst[:3] == [4, 7, 1]
    assert command("--resume", text=text) == 3
    assert WALKED == []


def test_a_recording_that_cannot_be_written_does_not_cost_the_table(command, out, capsys):
    ENDS.update({4: FELL, -4: ValueError("no picture")})
    assert command(text=SWEEP.replace('"none"', '"failures"')) == 3
    assert "was not written (no picture)" in capsys.readouterr().err
    assert read_sweep(out).words("recording") == [""] * 9


@pytest.mark.parametrize(
    ("ends", "status"),
    [
        ([{}, {}, {}], 0),
        ([{}, {"verdict": "fail"}, {}], 1),
        ([REFUSAL, REFUSAL, REFUSAL], 2),
        ([{}, FELL, {"verdict": "fail"}], 3),
        ([CRASH, FELL, {}], 4),
        ([{}, StudyStopped("a worker cannot load a class", "install it"), {}], 5),
        ([{}, OSError(errno.ENOSPC, "No space left on device"), {}], 5),
    ],
)
def test_the_status_is_that_of_the_worst_walk(command, capsys, ends, status):
    ENDS.update(zip((1, 4, 7), ends, strict=True))
    assert command() == status
    assert status != 5 or "--resume" in capsys.readouterr().err


def test_a_dry_run_counts_refusals_and_times_one_walk(command, capsys, monkeypatch):
    tried = []

    def walk(request, **_):
        tried.append(request.name)
        if len(tried) == 1:
            raise REFUSAL

    monkeypatch.setattr(run, "walk_request", walk)
    assert command("--dry-run", "--json") == 0
    said = json.loads(capsys.readouterr().out)
    assert said["refused"] == {"switching_velocity_too_low": 3, "bad_parameter": 3, "leg_too_short": 1}
    assert (said["runs"], said["walking"]) == (9, 2)
    assert said["wall_clock"] >= said["seconds"] >= 0.0
    assert len(tried) == 2
    monkeypatch.setattr(run, "_CHECKED", 3)
    assert command("--dry-run", "--json") == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["runs"], said["checked"], said["walking"]) == (9, 3, 3)
    assert command("--dry-run", text=SWEEP.replace("0.7, 0.7", "0.2, 0.2")) == 2
    assert "finds others\nno run that was tried can be walked" in capsys.readouterr().out
