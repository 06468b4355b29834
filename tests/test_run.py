"""The trial from the command line: folders, contracts, replay, interruption, repeatability."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.records import first_difference
from validation.cli.app import Status, call
from validation.store.folders import INSTRUMENT_FILE, RUN_FILES
from validation.store.record import JOINTS_FILE, load_record

STEPS = 2


@pytest.fixture(scope="module")
def walked(tmp_path_factory):
    """A short trial by the command line, with recording and report, and what it printed."""
    out = tmp_path_factory.mktemp("trial") / "run"
    program = Path(sys.executable).with_name("ampm")
    command = [program, "validate", "normal", "--steps", str(STEPS), "--out", out, "--json"]
    answer = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    return out, answer


def test_trial_passes_and_fills_its_folder(walked):
    out, answer = walked
    assert answer.returncode == Status.PASS, answer.stderr
    assert {path.name for path in out.iterdir()} == RUN_FILES - {INSTRUMENT_FILE, "external.parquet"}
    assert "Traceback" not in answer.stderr


def test_json_is_alone_on_stdout(walked):
    out, answer = walked
    printed = json.loads(answer.stdout)
    assert printed.pop("directory") == str(out)
    assert printed == json.loads((out / "summary.json").read_text())
    assert "simulation" in answer.stderr


def test_summary_follows_the_contract(walked):
    summary = json.loads((walked[0] / "summary.json").read_text())
    assert summary["outcome"] == "completed"
    assert summary["verdict"] == "pass"
    assert summary["steps_completed"] == STEPS
    assert summary["timing"]["simulation"] > 0
    for metric in summary["metrics"].values():
        assert {"value", "unit", "tolerance", "pass"} <= metric.keys()
    text = (walked[0] / "environment.json").read_text()
    assert json.loads(text)["versions"]["mujoco"] == "3.17.0"


def test_signals_follow_the_contract(walked):
    table = pq.read_table(walked[0] / "signals.parquet")
    assert table.schema.field("plan_zmp_x").metadata[b"unit"] == b"m"
    assert table["plan_angular_momentum_z"].null_count == table.num_rows
    assert set(table["phase"].to_pylist()) == {"single_support", "double_support"}
    assert set(table["stance"].to_pylist()) == {"left", "right", "both"}
    assert table["time"][0].as_py() == 0.0
    assert table["plan_zmp_y"][0].as_py() > 0  # left stance


def test_run_toml_is_the_whole_run(walked):
    out, _ = walked
    from ampm.run_file import dump_run, load_run

    text = (out / "run.toml").read_text()
    assert dump_run(load_run(out / "run.toml")) == text
    assert load_run(out / "run.toml").gait.steps == STEPS


def test_an_existing_run_is_not_overwritten(walked, capsys):
    out, _ = walked
    before = (out / "joints.parquet").stat().st_mtime_ns
    assert call(["validate", "normal", "--steps", "1", "--out", str(out)]) == Status.REFUSED
    assert "--force" in capsys.readouterr().err
    assert (out / "joints.parquet").stat().st_mtime_ns == before


def test_replay_is_identical(walked, capsys):
    assert call(["replay", str(walked[0])]) == Status.PASS
    assert capsys.readouterr().out.startswith("identical")


@pytest.mark.parametrize("torque", [lambda old: old + 1e-9, lambda _: 1e30])
def test_replay_stops_at_the_first_difference_and_is_quiet(walked, tmp_path, capfd, monkeypatch, torque):
    """Also where the physics blows up."""
    changed = tmp_path / "changed"
    shutil.copytree(walked[0], changed)
    table = pq.read_table(changed / JOINTS_FILE)
    name = next(name for name in table.column_names if name.startswith("torque_"))
    values = table[name].to_numpy().copy()
    values[200:] = torque(values[200:])
    column = table.schema.get_field_index(name)
    pq.write_table(table.set_column(column, table.schema.field(name), [values]), changed / JOINTS_FILE)
    monkeypatch.chdir(tmp_path)
    assert call(["replay", str(changed)]) == Status.OUT_OF_TOLERANCE
    printed = capfd.readouterr()
    assert "differs first, at 0.402 s" in printed.out
    assert "WARNING" not in printed.out + printed.err
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


def without_rows(path):
    table = pq.read_table(path)
    pq.write_table(table.slice(0, 100), path)


def as_text(path):
    table = pq.read_table(path)
    pq.write_table(table.set_column(1, table.column_names[1], [["x"] * table.num_rows]), path)


@pytest.mark.parametrize("command", ["report", "replay"])
@pytest.mark.parametrize(
    ("file", "damage"),
    [
        ("joints.parquet", without_rows),
        ("joints.parquet", as_text),
        ("joints.parquet", lambda path: path.write_bytes(path.read_bytes()[:-9])),
        ("signals.parquet", without_rows),
        ("run.toml", lambda path: path.write_text(path.read_text().replace("c_y = 1.0", "c_y = 0.9"))),
        ("summary.json", lambda path: path.write_text("[]")),
        ("states.parquet", lambda path: path.unlink()),
    ],
)
def test_a_damaged_or_changed_folder_is_refused(walked, tmp_path, capsys, command, file, damage):
    if command == "replay" and file in ("signals.parquet", "run.toml", "summary.json"):
        pytest.skip("a replay does not read it")
    copy = tmp_path / "copy"
    shutil.copytree(walked[0], copy)
    damage(copy / file)
    assert call([command, str(copy)]) == Status.REFUSED
    err = capsys.readouterr().err
    assert file in err
    assert err.count("\n") == 1


def test_report_can_be_written_again(walked, tmp_path, capsys):
    copy = tmp_path / "copy"
    shutil.copytree(walked[0], copy)
    (copy / "report.html").unlink()
    assert call(["report", str(copy)]) == Status.PASS
    assert (copy / "report.html").stat().st_size > 50_000


def test_the_same_run_has_the_same_bits(walked, tmp_path):
    again = tmp_path / "again"
    assert call(["validate", str(walked[0] / "run.toml"), "--out", str(again)]) == Status.PASS
    assert first_difference(load_record(walked[0]), load_record(again)) is None
    one, two = (pq.read_table(folder / "signals.parquet") for folder in (walked[0], again))
    assert one.equals(two)


def test_several_gaits_get_a_folder_each(tmp_path, capsys):
    out = tmp_path / "both"
    status = call(["validate", "normal", "flat", "--steps", "2", "--out", str(out), "--json"])
    printed = json.loads(capsys.readouterr().out)
    assert status == Status.PASS
    assert [item["gait"] for item in printed] == ["normal", "flat"]
    assert sorted(path.name for path in out.iterdir()) == ["flat", "normal"]


INTERRUPTED_AT_STEP_500 = """
import os, signal, sys
from validation.cli.entry import main
from validation.run import walk as run

simulate = run.simulate

def interrupted(*args, progress, **options):
    def advance(done, total):
        if done == 500:
            os.kill(os.getpid(), signal.SIGINT)
        progress(done, total)
    return simulate(*args, progress=advance, **options)

run.simulate = interrupted
main()
"""


def test_ctrl_c_keeps_what_was_walked(tmp_path):
    out = tmp_path / "run"
    command = [sys.executable, "-c", INTERRUPTED_AT_STEP_500, "validate", "normal", "--out", str(out)]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert answer.returncode == Status.INTERRUPTED, answer.stderr
    summary = json.loads((out / "summary.json").read_text())
    assert summary["outcome"] == "interrupted"
    assert summary["verdict"] == "not_measured"
    assert load_record(out).steps in (500, 501)
    assert "NOT MEASURED" in answer.stdout
    assert "Traceback" not in answer.stderr
    assert call(["replay", str(out)]) == Status.PASS


def test_ctrl_c_before_the_walk_leaves_nothing(tmp_path):
    """A signal from outside, while the program still prepares."""
    out = tmp_path / "run"
    program = Path(sys.executable).with_name("ampm")
    command = [str(program), "validate", "normal", "--steps", "1000", "--out", str(out)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        deadline = time.monotonic() + 60
        while not list(tmp_path.glob("run.partial-*/environment.json")):
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < deadline
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        printed, noise = process.communicate(timeout=120)
    finally:
        process.kill()
    assert process.returncode == Status.INTERRUPTED, noise
    assert printed == ""
    assert noise.endswith("ampm: interrupted\n")
    assert not list(tmp_path.iterdir())


INTERRUPTED_LATER = """
import os, signal, sys
from validation.show.rerun import record as rerun_log
import validation.run.walk as trial
from validation.cli.entry import main

module, name = (trial, "measure") if sys.argv.pop(1) == "measurement" else (rerun_log, "write_recording")
original = getattr(module, name)

class Swallows:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        for _ in range(100):
            pass

def interrupted(*args, **options):
    thing = Swallows()
    del thing
    return original(*args, **options)

setattr(module, name, interrupted)
main()
"""


@pytest.mark.parametrize("when", ["measurement", "recording"])
def test_ctrl_c_after_the_walk_keeps_its_numbers(when, tmp_path):
    """Also where the exception is lost in a callback."""
    out = tmp_path / "run"
    command = [sys.executable, "-c", INTERRUPTED_LATER, when, "validate", "normal", "--steps", "2"]
    answer = subprocess.run([*command, "--out", str(out)], capture_output=True, text=True, timeout=120)
    assert answer.returncode == Status.INTERRUPTED, answer.stderr
    assert "Traceback" not in answer.stderr
    assert "interrupted" in answer.stderr.splitlines()[-1]
    assert json.loads((out / "summary.json").read_text())["outcome"] == "completed"
    assert not (out / "report.html").exists()


def test_a_fall_is_an_outcome(tmp_path, capsys):
    """Hardly any friction: the walk cannot complete, and says so."""
    out = tmp_path / "ice"
    status = call(
        ["validate", "normal", "--steps", "4", "--set", "contact.friction=0.05", "--out", str(out), "--json"]
    )
    summary = json.loads(capsys.readouterr().out)
    assert status == Status.NOT_COMPLETED
    assert summary["outcome"] in ("fell", "diverged", "infeasible")
    assert summary["end"]["cause"]
    assert summary["verdict"] == "not_measured"
