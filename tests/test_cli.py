"""The command line as a user meets it: answers, refusals, exit statuses, files."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from ampm import InputError, SolverError, __version__
from ampm.parameters import KEYS, OPTION_TABLES
from validation.cli.app import Status
from validation.show.viewer import viewer_command


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

    [height] = ampm("keys", "gait.com_height", "--set", "gait.com_height=0.8", "--json").json
    facts = [height[name] for name in ("unit", "bounds", "default", "value")]
    assert facts == ["m", "> 0, <= 10", 0.865, 0.8]

    every = list(KEYS)
    assert [key for key in found() if key not in OPTION_TABLES] == every
    assert set(OPTION_TABLES) < set(found())
    assert found("gait") == [key for key in every if key.startswith("gait.")]
    assert found("foot") == [key for key in every if key.startswith("foot.")]  # no "footsteps"
    assert found("Step_Length") == ["gait.step_length"]
    assert "controller.touchdown_damping" in found("damping")
    assert "gait.step_width" in found("lateral distance")  # in its meaning
    assert set(found("controller", "damping")) == set(found("controller")) & set(found("damping"))


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


def script(*arguments: str, **options) -> subprocess.CompletedProcess[str]:
    return subprocess.run([PROGRAM, *arguments], capture_output=True, text=True, **options)


def test_console_script():
    assert "Missing command" in script("body").stderr
    answer = script("validate", "--help", env={**os.environ, "COLUMNS": "200"})
    assert "whether a body with real mass distribution" in answer.stdout  # lines of a paragraph are joined
    assert script("--version").stdout.strip() == f"ampm {__version__}"


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
