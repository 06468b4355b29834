"""The trial from the command line: folders, contracts, replay, interruption, repeatability."""

import json
import subprocess
import sys

import pytest

from ampm.run_file import dump_run, load_run
from tests.saved_run import forge, with_column
from tests.test_cli import PROGRAM
from validation.cli.app import Status, call
from validation.store.record import load_record
from validation.trial.files import RunFile

STEPS = 2
SHORT = ("--steps", str(STEPS), "--set", "simulation.time_step=0.002")


@pytest.fixture(scope="module")
def walked(tmp_path_factory):
    """A short trial by the command line, with recording and report, and what it printed."""
    out = tmp_path_factory.mktemp("trial") / "run"
    command = [PROGRAM, "validate", "normal", *SHORT, "--out", out, "--json"]
    answer = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    return out, answer


def test_a_trial_fills_its_folder_and_prints_its_summary_alone(walked, ampm):
    out, answer = walked
    assert answer.returncode == Status.PASS, answer.stderr
    assert {path.name for path in out.iterdir()} == set(RunFile) - {"explain.json", "external.parquet"}
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
    assert "report.html" not in ampm("judge", out).out  # which it does not write


def test_replay_stops_at_the_first_difference_and_is_quiet(walked, tmp_path, capfd, monkeypatch):
    """Also where the physics blows up."""

    def change(values):
        values[51:] = 1e30
        return values

    def of_a_joint(table):
        name = next(name for name in table.column_names if name.startswith("torque_"))
        return with_column(table, name, change)

    changed = forge(walked[0], tmp_path / "changed", RunFile.TICKS, of_a_joint)
    monkeypatch.chdir(tmp_path)
    assert call(["replay", str(changed)]) == Status.OUT_OF_TOLERANCE
    printed = capfd.readouterr()
    assert "signals.parquet differs first, at 0.102 s" in printed.out  # the forces of the step itself
    assert "WARNING" not in printed.out + printed.err
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


INTERRUPTED = """
import os, signal, sys
import validation.run.walk as trial
from validation.cli.entry import main

def at_step_500(*args, progress, **options):
    def advance(done, total):
        if done == 500:
            os.kill(os.getpid(), signal.SIGINT)
        progress(done, total)
    return original(*args, progress=advance, **options)

original, trial.simulate = trial.simulate, at_step_500
main()
"""


def test_ctrl_c_keeps_what_was_walked(tmp_path):
    out = tmp_path / "run"
    command = [sys.executable, "-c", INTERRUPTED, "validate", "normal", *SHORT, "--out", str(out)]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert answer.returncode == Status.INTERRUPTED, answer.stderr
    assert "Traceback" not in answer.stderr
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["outcome"], summary["verdict"]) == ("interrupted", "not_measured")
    assert load_record(out).steps in (500, 501)
    assert call(["replay", str(out)]) == Status.PASS
