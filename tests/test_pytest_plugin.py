"""The pytest plugin, on the example project and on small test files."""

import shutil
from pathlib import Path

import platformdirs
import pytest

pytest_plugins = ["pytester"]

ROOT = Path(__file__).resolve().parents[1]
EXAMPLE = ROOT / "docs" / "examples" / "own_controller"
CACHE = platformdirs.user_cache_path()  # pytester has a home of its own

FILE = """
import os
import pytest
from pathlib import Path
from docs.examples.joint_pd import JointPD

COARSE = dict(gait={"steps": 2}, solver={"ik_time_step": 0.01}, simulation={"time_step": 0.002})

class Counted(JointPD):
    def __init__(self, robot, run):
        super().__init__(robot, run)
        with open(os.environ["COUNT"], "a") as file:
            file.write("walked\\n")
"""


@pytest.fixture
def run(pytester, monkeypatch):
    """Run a test file with the plugin in a process of its own."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("XDG_CACHE_HOME", str(CACHE))
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    monkeypatch.setenv("COUNT", str(pytester.path / "count"))

    def call(text, *arguments):
        pytester.makepyfile(FILE + text)
        pytester.makefile(".toml", gait="")
        return pytester.runpytest_subprocess("-p", "validation.pytest_plugin", *arguments)

    return call


@pytest.mark.slow
def test_the_example_gates_its_controller(run, pytester):
    for name in ("controller.py", "test_controller.py"):
        shutil.copy(EXAMPLE / name, pytester.path)
    assert len((EXAMPLE / "test_controller.py").read_text(encoding="utf-8").splitlines()) <= 19
    run("").assert_outcomes(passed=5)


@pytest.mark.slow
def test_equal_inputs_are_walked_once(run, pytester):
    run("""
@pytest.mark.parametrize("number", range(4))
def test_equal(walked, number):
    trial = walked("normal", controller=Counted, **COARSE)
    assert trial.record.q.flags.writeable is False
    assert trial.record.outcome.name == "fell"

def test_another(walked):
    trial = walked("normal", controller=Counted, body={"mass": 61.0}, **COARSE)
    assert trial.record.mass == pytest.approx(61.0)
""").assert_outcomes(passed=5)
    assert (pytester.path / "count").read_text(encoding="utf-8").count("walked") == 2


@pytest.mark.slow
def test_objects_that_were_changed_are_walked_again(run):
    run("""
from dataclasses import dataclass
import numpy as np

@dataclass
class Kick:
    force: np.ndarray
    sign = 1.0

    def apply(self, time, plant):
        plant.push("chest", self.sign * self.force)

def test_changed(walked, monkeypatch):
    kick, controller = Kick(np.zeros(3)), {"stabilizer": "stepping"}
    plain = walked("normal", disturbances=[kick], controller=controller, **COARSE)
    assert walked("normal", disturbances=[Kick(np.zeros(3))], controller=controller, **COARSE) is plain
    kick.force[0] = 5.0
    pushed = walked("normal", disturbances=[kick], controller=controller, **COARSE)
    assert (pushed.record.external_force[..., 0].max(), plain.record.external_force.max()) == (5.0, 0.0)
    monkeypatch.setattr(Kick, "sign", -1.0)
    pushed = walked("normal", disturbances=[kick], controller=controller, **COARSE)
    assert pushed.record.external_force[..., 0].min() == -5.0
""").assert_outcomes(passed=1)


def test_failures_say_what_is_wrong(run, tmp_path):
    result = run(
        """
@pytest.mark.parametrize("c_s", ["c_s<1", "c_s>1"])
def test_falls(walked, assert_within, c_s, monkeypatch):
    monkeypatch.chdir("/")
    trial = walked(Path("gait.toml"), controller=JointPD, **COARSE)
    assert_within(*[trial] * (c_s == "c_s<1"))

@pytest.mark.parametrize("trials", [["strict"], ["strict", [3.5]]])
def test_nothing(assert_within, trials):
    assert_within(*trials)

def test_unknown_gait(walked):
    walked("nromal")
""",
        f"--basetemp={tmp_path / 'runs'}",
    )
    result.assert_outcomes(failed=5)
    result.stdout.no_fnmatch_line("*cannot be saved*")
    result.stdout.fnmatch_lines(
        [
            "gait with docs.examples.joint_pd:JointPD: not measured (default). The body fell*",
            f"*ampm view {tmp_path / 'runs'}/ampm-runs/*test_falls-c_s-1/0-gait",
            "*ampm view */ampm-runs/*test_falls-c_s-1+/0-gait",
            "this test walked nothing; call walked() first, or give the trials.",
            "[[]3.5] is no trial; give trials one by one.",
            "*did you mean 'normal'*",
        ]
    )
