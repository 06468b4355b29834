"""The trial from the command line: folders, contracts, replay, interruption, repeatability."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from ampm.run_file import dump_run, load_run
from tests.records import first_difference
from tests.saved_run import forge, with_column
from validation.cli.app import Status, call
from validation.store.folders import RUN_FILES
from validation.store.record import TICKS_FILE, load_record

STEPS = 2


@pytest.fixture(scope="module")
def walked(tmp_path_factory):
    """A short trial by the command line, with recording and report, and what it printed."""
    out = tmp_path_factory.mktemp("trial") / "run"
    program = Path(sys.executable).with_name("ampm")
    command = [program, "validate", "normal", "--steps", str(STEPS), "--out", out, "--json"]
    answer = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    return out, answer


def test_a_trial_fills_its_folder_and_prints_its_summary_alone(walked):
    out, answer = walked
    assert answer.returncode == Status.PASS, answer.stderr
    assert {path.name for path in out.iterdir()} == RUN_FILES - {"explain.json", "external.parquet"}
    assert "Traceback" not in answer.stderr
    assert "simulation" in answer.stderr
    summary = json.loads((out / "summary.json").read_text())
    assert json.loads(answer.stdout) == summary | {"directory": str(out)}
    assert (summary["outcome"], summary["verdict"], summary["steps_completed"]) == ("completed", "pass", 2)
    assert summary["timing"]["simulation"] > 0
    for metric in summary["metrics"].values():
        assert {"value", "unit", "tolerance", "pass"} <= metric.keys()
    assert json.loads((out / "environment.json").read_text())["versions"]["mujoco"] == "3.17.0"
    assert dump_run(load_run(out / "run.toml")) == (out / "run.toml").read_text()
    assert load_run(out / "run.toml").gait.steps == STEPS


@pytest.mark.parametrize("torque", [lambda old: old + 1e-9, lambda _: 1e30])
def test_replay_stops_at_the_first_difference_and_is_quiet(walked, tmp_path, capfd, monkeypatch, torque):
    """Also where the physics blows up."""

    def change(values):
        values[51:] = torque(values[51:])
        return values

    def of_a_joint(table):
        name = next(name for name in table.column_names if name.startswith("torque_"))
        return with_column(table, name, change)

    changed = forge(walked[0], tmp_path / "changed", TICKS_FILE, of_a_joint)
    monkeypatch.chdir(tmp_path)
    assert call(["replay", str(changed)]) == Status.OUT_OF_TOLERANCE
    printed = capfd.readouterr()
    assert "signals.parquet differs first, at 0.102 s" in printed.out  # the forces of the step itself
    assert "WARNING" not in printed.out + printed.err
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


def test_the_same_run_has_the_same_bits(walked, tmp_path):
    again = tmp_path / "again"
    assert call(["validate", str(walked[0] / "run.toml"), "--out", str(again)]) == Status.PASS
    assert first_difference(load_record(walked[0]), load_record(again)) is None
    one, two = (pq.read_table(folder / "signals.parquet") for folder in (walked[0], again))
    assert one.equals(two)


@pytest.mark.slow
def test_several_gaits_get_a_folder_each(tmp_path, capsys):
    out = tmp_path / "both"
    status = call(["validate", "normal", "flat", "--steps", "2", "--out", str(out), "--json"])
    printed = json.loads(capsys.readouterr().out)
    assert status == Status.PASS
    assert [item["gait"] for item in printed] == ["normal", "flat"]
    assert sorted(path.name for path in out.iterdir()) == ["flat", "normal"]


INTERRUPTED = """
import os, signal, sys
import validation.run.walk as trial
from validation.cli.entry import main

when = sys.argv.pop(1)

class Swallows:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        for _ in range(100):
            pass

def swallowed(*args, **options):
    thing = Swallows()
    del thing
    return original(*args, **options)

def at_step_500(*args, progress, **options):
    def advance(done, total):
        if done == 500:
            os.kill(os.getpid(), signal.SIGINT)
        progress(done, total)
    return original(*args, progress=advance, **options)

module, name, new = {
    "walk": (trial, "simulate", at_step_500),
    "measurement": (trial, "measure", swallowed),
}[when]
original = getattr(module, name)
setattr(module, name, new)
main()
"""


@pytest.mark.parametrize("when", ["walk", pytest.param("measurement", marks=pytest.mark.slow)])
def test_ctrl_c_keeps_what_was_walked_and_measured(when, tmp_path):
    """Also where the exception is lost in a callback."""
    out = tmp_path / "run"
    command = [sys.executable, "-c", INTERRUPTED, when, "validate", "normal", "--steps", "2"]
    answer = subprocess.run([*command, "--out", str(out)], capture_output=True, text=True, timeout=120)
    assert answer.returncode == Status.INTERRUPTED, answer.stderr
    summary = json.loads((out / "summary.json").read_text())
    if when == "walk":
        assert "Traceback" not in answer.stderr
        assert (summary["outcome"], summary["verdict"]) == ("interrupted", "not_measured")
        assert load_record(out).steps in (500, 501)
        assert "NOT MEASURED" in answer.stdout
        assert call(["replay", str(out)]) == Status.PASS
    else:
        assert summary["outcome"] == "completed"
        assert "interrupted" in answer.stderr.splitlines()[-1]
        assert not (out / "report.html").exists()


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
