"""The command line as a user meets it: answers, refusals, exit statuses, files."""

import errno
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import typer

from ampm import __version__
from ampm.exceptions import InputError, SolverError
from ampm.parameters import OPTION_TABLES, keys
from validation.cli import app as cli
from validation.cli.app import Status
from validation.show.viewer import viewer_command
from validation.trial.plan import load_request

COLUMNS = (
    "time phase stance phase_start com_x com_y com_z com_velocity_x com_velocity_y com_velocity_z "
    "com_acceleration_x com_acceleration_y com_acceleration_z dcm_x dcm_y zmp_x zmp_y "
    "force_x force_y force_z moment_x moment_y angular_momentum_x angular_momentum_y"
).split()
SLOW = "--set gait.step_length=0.75 --set gait.switching_velocity=0.2 --set gait.c_s=1.8"
CONSTANTS = (
    "l_s l_d inverse_a_s a_d c_d single_support_duration double_support_duration s beta "
    "lateral_switching_velocity mean_velocity angular_momentum_y_offset"
).split()


# ---------------------------------------------------------------- plan


def test_plan_json_has_the_contract(ampm):
    answer = ampm("plan", "normal", "--no-body", "--json", "--set", "gait.a_s=inf", "--set", "body.mass=61")
    assert answer.status == Status.PASS
    assert set(CONSTANTS) <= answer.json.keys()
    assert answer.json["parameters"]["gait"]["step_length"] == 0.6
    assert answer.json["inverse_a_s"] == 0.0
    assert answer.json["parameters"]["gait"]["a_s"] == "inf"
    assert answer.json["parameters"]["body"]["mass"] == 61.0
    assert answer.json["angular_momentum_y_offset"] == 0.0
    assert max(answer.json["residuals"].values()) <= 1e-9


def test_samples_follow_the_contract_and_csv_keeps_every_bit(ampm, tmp_path):
    paths = [tmp_path / f"samples.{suffix}" for suffix in ("parquet", "csv")]
    for path in paths:
        answer = ampm(
            "plan", "--no-body", "--set", "gait.steps=3", "--samples", path, "--rate", 1000, "--json"
        )
        assert answer.status == Status.PASS
    table = pq.read_table(paths[0])
    assert table.column_names[: len(COLUMNS)] == COLUMNS
    times = table["time"].to_numpy()
    np.testing.assert_array_equal(times, np.arange(len(times)) / 1000)
    duration = 3 * (answer.json["single_support_duration"] + answer.json["double_support_duration"])
    assert times[-1] <= duration < times[-1] + 1e-3
    first = table.slice(0, 1).to_pylist()[0]
    assert (first["phase"], first["stance"]) == ("single_support", "left")
    assert (first["zmp_y"], first["left_placement_y"]) == (pytest.approx(0.09), pytest.approx(0.09))
    assert first["left_placement_x"] == 0.0
    header, *lines = [line.split(",") for line in paths[1].read_text().splitlines()]
    assert header == table.column_names
    for name in ("time", "com_x", "force_z"):
        column = header.index(name)
        np.testing.assert_array_equal(table[name].to_numpy(), [float(line[column]) for line in lines])


def test_a_plan_for_readers_and_its_picture(ampm, tmp_path):
    path = tmp_path / "plan.png"
    answer = ampm("plan", "--no-body", "--plot", path)
    assert answer.status == Status.PASS
    assert path.read_bytes().startswith(b"\x89PNG")
    assert path.stat().st_size > 50_000


# ------------------------------------------------------------- bad input


def test_other_commands_than_the_trial_take_a_body(ampm):
    answer = ampm("plan", "--body", "suite-humanoid", "--no-body", "--json")
    assert answer.json["parameters"]["body"]["source"] == "suite-humanoid"
    assert answer.json["parameters"]["gait"]["step_length"] == pytest.approx(0.3 * 0.82, abs=0.001)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("plan --no-body norml", "did you mean 'normal'"),
        ("plan --no-body --set gait.switching_velocity=0.3", "the least is"),
        ("plan --no-body --rate 0", "give --samples FILE"),
        ("plan --no-body --rate nan --samples x.csv", "--rate"),
        ("plan --no-body --rate 1e308 --samples x.csv", "lower rate"),
        ("plan --no-body --samples x.txt", ".parquet"),
        ("plan --no-body --plot x.jpeg2", ".png"),
        ("plan --no-body --planner dcm", "leave out --no-body"),
        ("plan --no-body --samples=none/x.csv", "there is no folder none"),
        ("plan --no-body --samples=file/x.csv", "x.csv"),
        ("plan --no-body --bogus", "See 'ampm plan --help'."),
        ("plan --no-body --rate fast", "--rate 'fast' must be a number; write for example --rate 10."),
        ("compare --body no-such", "no-such"),
        ("validate normal normal --out out", "'normal'"),
        ("validate normal --profile lenient --out out", "wide, jumps, footsteps, odometry, pushed.\n"),
        ("validate normal --set simulation.integrator=magic --out out", "implicitfast"),
        ("validate normal bad.toml --out out", "gait.c_y"),
        ("validate normal --controller mine --out out", "MODULE:CLASS"),
        ("validate normal --planner json:Planner --out out", "Planner"),
        ("validate normal --planner kajita --out out", "none of ampm, lipm, ipm, preview, dcm;"),
        ("validate normal --push chest,1,2,x,1,1 --out out", "SEGMENT"),
        ("validate normal --push chest,10,0,0,-0.5,-0.1 --out out", "-0.5"),
        ("validate normal --footsteps walk.csv --planner dcm --out out", "dcm does not plan footsteps"),
        (
            "validate normal --footsteps walk.csv --steps 4 --out out",
            "--steps counts the steps of a",
        ),
        ("plan --save gait.txt", ".toml"),
        ("plan --save bad.toml", "--force"),
        ("plan --motion motion.csv --no-body", "--motion is of a periodic gait of a body"),
        ("plan --set gait.c_y=-1", "gait.c_y = -1 must be greater than 0"),
        (f"convergence normal {SLOW}", "too slow"),
        ("convergence normal --steps 1", "walk 2 at least"),
        ("convergence normal --levels 2", "choose 3"),
        (
            "convergence normal --workers -1",
            "--workers '-1' must be at least 0; write for example --workers 10.",
        ),
        (
            "convergence normal --levels four",
            "--levels 'four' must be a whole number; write for example --levels 4.",
        ),
        (
            "validate normal --steps ten",
            "--steps 'ten' must be a whole number; write for example --steps 10.",
        ),
        (
            "validate normal --set gait.steps=ten",
            "gait.steps = 'ten' must be a whole number; the default is 30.",
        ),
        ("keys xyzzy", "no key fits 'xyzzy'; sections are gait, planner, body,"),
        ("keys stp_length", "did you mean 'gait.step_length'?"),
        ("keys gait friction", "no key fits 'gait' and 'friction'"),
        ("convergence normal --set simulation.time_step=0.0015", "must be a whole number"),
        ("replay nothing", "nothing"),
        ("view nothing", "nothing"),
    ],
)
def test_bad_input_is_one_sentence_before_anything_is_done(ampm, line, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    (tmp_path / "bad.toml").write_text("[gait]\nc_y = -1.0\n")
    (tmp_path / "walk.csv").write_text("foot,x,y,heading\n" + "right,0,-0.1,0\nleft,0,0.1,0\n" * 2)
    given = {*tmp_path.iterdir()}
    answer = ampm(*line.split())
    assert (answer.status, answer.out) == (Status.REFUSED, "")
    assert answer.err.startswith("ampm: ")
    assert answer.err.count("\n") == 1
    assert words in answer.err
    assert {*tmp_path.iterdir()} == given


def test_help_groups_the_commands_in_lines_of_their_own(ampm, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    text = ampm("--help").out
    assert re.findall(r"╭─ ([\w ]+) ─", text)[1:] == ["Walk", "Look", "Check", "Bodies and gaits"]
    shown = [line.strip("│ ") for line in text.partition("╭─ Walk")[2].splitlines() if line.startswith("│")]
    known = typer.main.get_group(cli.app).commands
    assert len(shown) == len(known) <= 14
    for line in shown:
        name, _, words = line.partition(" ")
        assert words.endswith(".")
        assert str(known[name].help).startswith(words.strip())


def test_keys_by_section_by_word_and_by_both(ampm):
    def found(*words: str) -> list[str]:
        return [item["key"] for item in ampm("keys", *words, "--json").json]

    every = list(keys())
    assert [key for key in found() if key not in OPTION_TABLES] == every
    assert set(OPTION_TABLES) < set(found())
    assert found("gait") == [key for key in every if key.startswith("gait.")]
    assert found("foot") == [key for key in every if key.startswith("foot.")]  # no "footsteps"
    assert found("Step_Length") == ["gait.step_length"]
    assert "controller.touchdown_damping" in found("damping")
    assert "gait.step_width" in found("lateral distance")  # in its meaning
    both = found("controller", "damping")
    assert both
    assert set(both) == set(found("controller")) & set(found("damping"))


def test_keys_are_whole_and_have_values_of_a_gait(ampm, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr("validation.table._FILE_WIDTH", 80)
    rows = [[cell.strip() for cell in line.split("│")[1:-1]] for line in ampm("keys").out.splitlines()]
    assert set(keys()) <= {row[0] for row in rows if row}
    text = ampm("keys", "touchdown_damping", "--gait", "ipm").out
    assert re.search(r"│ controller.touchdown_damping │ 700.0 │ 1/s", text)
    assert "default 200.0" in text


def test_a_title_names_what_was_changed_but_for_the_number_of_steps():
    request = load_request(
        "normal", ["gait.steps=4", "gait.c_y = 0.93", "simulation.integrator=implicitfast"]
    )
    assert request.title.split(", ") == ["normal", "gait.c_y 0.93", "simulation.integrator implicitfast"]
    assert load_request("normal", ["gait.steps=4"]).title == "normal"


@pytest.mark.parametrize(
    ("arguments", "found"),
    [
        (["--as-is", "--set=gait.switching_velocity=0.3"], {"kind": "mathematical", "unit": "m/s"}),
        (["--as-is", "--set", "gait.step_width=0.02"], {"kind": "bodily", "reason": "soles_overlap"}),
        (["--bogus"], {"kind": "input"}),
        (["--set", "body.mass=-60"], {"kind": "input", "value": -60, "limit": "must be at least 1 kg"}),
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


@pytest.mark.parametrize(("options", "words"), [((), "--force"), (("--force",), "notes.txt")])
def test_out_is_never_overwritten(ampm, tmp_path, options, words):
    notes = tmp_path / "notes.txt"
    notes.write_text("mine")
    answer = ampm("validate", "normal", "--out", tmp_path, *options)
    assert (answer.status, notes.read_text()) == (Status.REFUSED, "mine")
    assert words in answer.err


def test_the_viewer_stays_on_this_machine_and_needs_a_display(ampm, tmp_path, monkeypatch):
    monkeypatch.setenv("DISPLAY", ":0")
    recording = tmp_path / "recording.rrd"
    recording.write_bytes(b"")
    for web in (False, True):
        command = viewer_command(recording, web=web)
        assert command[command.index("--bind") + 1] == "127.0.0.1"
    monkeypatch.delenv("DISPLAY")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    answer = ampm("view", tmp_path)
    assert answer.status == Status.REFUSED
    assert "--web" in answer.err


# ------------------------------------------------------------ our crash


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


def noted() -> InputError:
    error = InputError("the value is too large; lower it.")
    error.add_note("or leave it open")
    return error


def full_disk() -> OSError:
    error = OSError(errno.ENOSPC, "No space left on device")
    error.add_note("the record is in /elsewhere")
    return error


@pytest.mark.parametrize(
    ("error", "status", "kind", "words"),
    [
        (noted(), Status.REFUSED, "input", "lower it; or leave it open."),
        (full_disk(), Status.STOPPED, "stopped", "/elsewhere"),
        (KeyboardInterrupt(), Status.INTERRUPTED, "interrupted", "interrupted"),
        (SolverError("not convex"), Status.NOT_COMPLETED, "solver", "not convex."),
    ],
)
def test_other_errors_have_a_status_of_their_own(ampm, failing, error, status, kind, words):
    failing(error)
    answer = ampm("plan", "--json")
    assert (answer.status, answer.json["error"]["kind"]) == (status, kind)
    assert words in answer.err


# ------------------------------------------------------- as a subprocess


def script(*arguments: object, **options) -> subprocess.CompletedProcess[str]:
    program = Path(sys.executable).with_name("ampm")
    return subprocess.run([str(program), *map(str, arguments)], capture_output=True, text=True, **options)


def test_console_script():
    answer = script("plan", "--no-body", "--json", "--set", "gait.switching_velocity=0.3")
    assert answer.returncode == Status.REFUSED
    assert json.loads(answer.stdout)["error"]["reason"] == "switching_velocity_too_low"
    assert "heading [m, rad]" in " ".join(script("plan", "--help").stdout.replace("│", " ").split())
    assert "Missing command" in script("body").stderr
    answer = script("validate", "--help", env={**os.environ, "COLUMNS": "200"})
    assert "whether a body with real mass distribution" in answer.stdout  # lines of a paragraph are joined
    assert script("--version").stdout.strip() == f"ampm {__version__}"


def test_reader_that_leaves_early_is_no_crash():
    program = Path(sys.executable).with_name("ampm")
    command = f"{program} plan --no-body --json | head -c 1"
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
