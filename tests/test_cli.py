"""The command line as a user meets it: answers, refusals, exit statuses, folders of trials, interruption.

What once passed silently, ran foreign code, hung or crashed is refused in one sentence.
"""

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import ampm
from ampm import InputError, SolverError, __version__, dump_run, load_run
from ampm.parameters import KEYS, OPTION_TABLES
from ampm.planner.table import table_motion
from tests.saved_run import forge, with_column
from tests.test_bad_input import LOG, PLAN
from validation.cli.app import Status, call
from validation.measure.log import read_log
from validation.show.viewer import viewer_command
from validation.store.record import load_record
from validation.trial.files import RunFile
from validation.trial.plan import Request, plan_walk


def test_plan_json_has_the_contract(ampm):
    answer = ampm("plan", "normal", "--no-body", "--json", "--set", "gait.a_s=inf", "--set", "body.mass=61")
    assert answer.status == Status.PASS
    assert answer.json["parameters"]["gait"]["step_length"] == 0.6
    assert (answer.json["inverse_a_s"], answer.json["parameters"]["gait"]["a_s"]) == (0.0, "inf")
    assert answer.json["parameters"]["body"]["mass"] == 61.0
    assert answer.json["angular_momentum_y_offset"] == 0.0
    assert max(answer.json["residuals"].values()) <= 1e-9


def test_keys_by_section_by_word_and_by_both(ampm):
    def found(*words: str) -> list[str]:
        return [item["key"] for item in ampm("keys", *words, "--json").json]

    settings = "--set", "gait.com_height=0.8", "--set", "controller.name=absent:Class"  # is not imported
    [height] = ampm("keys", "gait.com_height", *settings, "--json").json
    facts = [height[name] for name in ("unit", "bounds", "default", "value")]
    assert facts == ["m", "> 0, <= 10", 0.865, 0.8]

    assert [key for key in found() if key not in OPTION_TABLES] == list(KEYS)
    assert set(OPTION_TABLES) < set(found())
    assert found("gait") == [key for key in KEYS if key.startswith("gait.")]
    assert found("foot") == [key for key in KEYS if key.startswith("foot.")]  # no "footsteps"
    assert found("Step_Length") == ["gait.step_length"]
    assert "controller.touchdown_damping" in found("damping")
    assert "gait.step_width" in found("lateral distance")  # in its meaning
    assert set(found("controller", "damping")) == set(found("controller")) & set(found("damping"))


@pytest.mark.parametrize(
    ("arguments", "found"),
    [
        (["--as-is", "--set=gait.switching_velocity=0.3"], {"kind": "mathematical", "unit": "m/s"}),
        (["--as-is", "--set", "gait.step_width=0.02"], {"kind": "bodily", "reason": "soles_overlap"}),
        (["--save", "a\udcff.toml"], {"kind": "input", "value": "a\udcff.toml"}),
        (["--set", "body.mass=-60"], {"kind": "input", "value": -60, "limit": "must be at least 0.1 kg"}),
        (["--set", "gait.C_S=1"], {"key": "gait.C_S", "nearest": "gait.c_s"}),
    ],
)
def test_a_refusal_in_json_is_an_object_alone(ampm, arguments, found):
    answer = ampm("plan", "--json", *arguments)
    assert answer.status == Status.REFUSED
    error = answer.json["error"]
    assert {name: error[name] for name in found} == found
    assert error["kind"] == "input" or error["way_out"] in error["message"]
    assert ("leave out --as-is" in answer.err) == (error["kind"] != "input")


def test_the_viewer_stays_on_this_machine_and_needs_a_display(ampm, tmp_path, monkeypatch):
    monkeypatch.setenv("DISPLAY", ":0")
    recording = tmp_path / "recording.rrd"
    recording.write_bytes(b"")
    for web in (False, True):
        command = viewer_command(recording, web=web)
        assert command[command.index("--bind") + 1] == "127.0.0.1"
    monkeypatch.delenv("DISPLAY")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    answer = ampm("view", recording)
    assert answer.status == Status.REFUSED
    assert "--web" in answer.err
    for ended, status in ((0, Status.PASS), (1, Status.REFUSED)):
        program = [sys.executable, "-c", f"raise SystemExit({ended})"]
        monkeypatch.setattr("validation.show.viewer.viewer_command", lambda *_, web, run=program: run)
        answer = ampm("view", recording, "--web")
        assert (answer.status, "close another one" in answer.err) == (status, bool(ended))


@pytest.fixture
def failing(monkeypatch):
    """Let planning raise an error."""

    def fail(error: BaseException) -> None:
        def broken(*_: object, **__: object) -> None:
            raise error

        monkeypatch.setattr("validation.trial.plan.load_request", broken)

    return fail


def test_a_crash_has_its_traceback_and_a_sentence(ampm, failing):
    """Other errors have theirs with --debug."""
    failing(ZeroDivisionError("by zero"))
    answer = ampm("plan", "--json")
    assert answer.status == Status.CRASH
    assert answer.json["error"]["kind"] == "crash"
    assert "Traceback" in answer.err
    assert answer.err.splitlines()[-1].startswith("ampm: crash of ampm itself (ZeroDivisionError: by zero)")
    failing(InputError("no."))
    assert ampm("plan").err == "ampm: no.\n"
    assert "Traceback" in ampm("plan", "--debug").err


def noted(error: Exception, note: str) -> Exception:
    error.add_note(note)
    return error


FULL = OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize(
    ("error", "status", "kind", "words"),
    [
        (noted(InputError("No."), "or leave it open"), Status.REFUSED, "input", "No; or leave it open."),
        (noted(FULL, "the record is in /elsewhere"), Status.STOPPED, "stopped", "/elsewhere"),
        (KeyboardInterrupt(), Status.INTERRUPTED, "interrupted", "interrupted"),
        (SolverError("not convex"), Status.NOT_COMPLETED, "solver", "not convex."),
    ],
)
def test_other_errors_have_a_status_of_their_own(ampm, failing, error, status, kind, words):
    failing(error)
    answer = ampm("plan", "--json")
    assert (answer.status, answer.json["error"]["kind"]) == (status, kind)
    assert words in answer.err


PROGRAM = Path(sys.executable).with_name("ampm")


def script(command: str, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options):
    """Run ``ampm`` as its own program."""
    words = [str(PROGRAM), *command.split()]
    return subprocess.run(words, stdout=stdout, stderr=stderr, text=True, timeout=120, check=False, **options)


def test_console_script():
    assert "Missing command" in script("body").stderr
    answer = script("validate --help", env={**os.environ, "COLUMNS": "200"})
    assert "whether a body with real mass distribution" in answer.stdout  # lines of a paragraph are joined
    assert script("--version").stdout.strip() == f"ampm {__version__}"
    answer = script("body check human", env={**os.environ, "MUJOCO_GL": "nonsense"})
    assert (answer.returncode, "MUJOCO_GL" in answer.stderr) == (2, True)  # no such renderer: no crash


def test_reader_that_leaves_early_is_no_crash():
    command = f"{PROGRAM} plan --no-body --json | head -c 1"
    answer = subprocess.run(["bash", "-c", command], capture_output=True, text=True)
    assert answer.stderr == ""


SIGNAL_IN_AN_IMPORT = """
import os, signal, sys

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            try:
                os.kill(os.getpid(), signal.SIGINT)
            except KeyboardInterrupt:
                {answer}

sys.meta_path.insert(0, Finder())
from validation.cli.entry import main
sys.argv = ["ampm", "plan", "--no-body", "--json"]
main()
"""


@pytest.mark.parametrize("answer", ["raise", "raise ImportError(name)", "pass"])
def test_ctrl_c_during_an_import(answer):
    """Passed on, turned into another error, or swallowed: 130 all the same, and one line."""
    code = SIGNAL_IN_AN_IMPORT.format(module="numpy", answer=answer)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == Status.INTERRUPTED, done.stderr
    assert done.stderr == "ampm: interrupted\n"


STEPS = 2
SHORT = ("--steps", str(STEPS), "--set", "simulation.time_step=0.002")


@pytest.fixture(scope="module")
def walked(tmp_path_factory):
    """A short trial by the command line, with recording and report, and what it printed."""
    out = tmp_path_factory.mktemp("trial") / "run"
    return out, script(f"validate normal {' '.join(SHORT)} --out {out} --json")


def test_a_trial_fills_its_folder_and_prints_its_summary_alone(walked, ampm, tmp_path, monkeypatch):
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
    assert "report.html" not in ampm("judge", out).out  # which it does not write
    monkeypatch.setattr("validation.run.validate.read_summary", lambda _: summary)  # of another program
    late = ampm("validate", "normal", *SHORT, "--set", "sensors.delay=0.002", "--out", tmp_path / "late")
    assert late.status == Status.OUT_OF_TOLERANCE, late.out


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

def in_simulate(*args, progress, **options):
    def advance(done, total):
        if done == 500:
            os.kill(os.getpid(), signal.SIGINT)
        progress(done, total)
    return original(*args, progress=advance, **options)

def in_measure(*args):
    os.kill(os.getpid(), signal.SIGINT)
    return original(*args)

original, trial.{name} = trial.{name}, in_{name}
main()
"""
ENDED = {"simulate": ("interrupted", "not_measured"), "measure": ("completed", "pass")}


@pytest.mark.parametrize("name", ENDED)
def test_ctrl_c_keeps_what_was_walked(tmp_path, name):
    out, code = tmp_path / "run", INTERRUPTED.format(name=name)
    command = [sys.executable, "-c", code, "validate", "normal", *SHORT, "--out", str(out)]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert answer.returncode == Status.INTERRUPTED, answer.stderr
    assert "Traceback" not in answer.stderr
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["outcome"], summary["verdict"]) == ENDED[name]
    assert (load_record(out).steps in (500, 501)) is (name == "simulate")
    assert call(["replay", str(out)]) == Status.PASS


def test_a_planner_of_a_user_does_not_get_the_name_of_ours():
    named = type("ampm", (ampm.PeriodicPlanner,), {"__module__": "mine"})
    run = ampm.load_run("normal", gait={"steps": 2})
    assert plan_walk(Request("normal", run), planner=named("dcm")).planner == "mine:<object of ampm>"


def columns_of(text, statement):
    """Columns of a table, changed by a statement on them."""
    names, *rows = [line.split(",") for line in text.splitlines()]
    cells = dict(zip(names, map(np.array, zip(*rows, strict=True)), strict=True))
    columns = {name: cell if name == "stance" else cell.astype(float) for name, cell in cells.items()}
    exec(statement, {"np": np}, columns)
    return columns


def log(statement):
    return read_log(columns_of(LOG, statement), 588.6)


def test_the_tables_that_are_changed_are_read():
    log("com_y = com_y + 1e-3")
    flight = log("force_z[5:11] = 0.0; zmp_x[5:11] = np.nan")
    # Nothing carries there.
    assert (flight.time.size, flight.lost.any(), "zmp" in flight.signals) == (40, False, True)
    table_motion(columns_of(PLAN, ""))


@pytest.mark.parametrize("command", ["report .", "compare . .", "view . --save a.rrd"])
def test_the_results_of_a_sweep_are_read_without_its_code(command, ampm, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    vary = '[[vary]]\nmethod = "list"\ngait.c_y = [0.8, 1.0]\n'
    Path("sweep.toml").write_text(f'set.gait.planner = "own_code:Planner"\n{vary}')
    Path("own_code.py").write_text("open('imported', 'w').close()\n")
    assert ampm(*command.split()).status == 2
    assert not Path("imported").exists()


def test_a_full_disk_behind_standard_output():
    with open("/dev/full", "w") as full:
        answer = script("keys gait.steps --json", stdout=full)
        assert answer.returncode == 5
        assert answer.stderr.count("\n") == 1
        assert "the disk is full" in answer.stderr
        assert script("plan nope", stderr=full).returncode == 2


def test_users_print_to_standard_error(tmp_path):
    (tmp_path / "loud.py").write_text("import os\nprint('python')\nos.write(1, b'descriptor\\n')\n")
    answer = script("plan normal --set gait.planner=loud:None --json", cwd=tmp_path)
    assert json.loads(answer.stdout)["error"]["kind"] == "input"
    assert "python" in answer.stderr
    assert "descriptor" in answer.stderr
