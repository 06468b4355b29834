"""Plans that are wrong on purpose fail; docs/negative_controls.py walks more of them, for thirty steps.

The referee of refused gaits (docs/referee.py) finds an easy gait, with slopes as by differences.
"""

import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import ampm
import validation as val
from ampm.run_file import load_run
from validation.judge.metrics import METRICS
from validation.study.sweep.design import load_sweep
from validation.trial.plan import make_body

DOCS = Path(__file__).resolve().parents[1] / "docs"


def script(name):
    """A script of docs, which imports others beside it."""
    sys.path.insert(0, str(DOCS))
    try:
        return import_module(name)
    finally:
        sys.path.remove(str(DOCS))


def walked(make, size, gait="normal", steps=3):
    """Judgement of a plan that a function of the script makes."""
    run = ampm.load_run(gait, gait={"steps": steps}).as_is()
    return val.walk(run, planner=getattr(script("negative_controls"), make)(run, size)).judged("default")


@pytest.mark.parametrize("make", ["shifted_zmp", "other_mass"])
def test_the_same_ways_of_planning_pass_without_a_falsehood(make):
    assert walked(make, 0.0).verdict.passed


def test_a_shifted_zmp_makes_the_body_fall():
    outcome = walked("shifted_zmp", 5.0).record.outcome
    assert outcome.name == "fell"
    assert outcome.steps_completed == 2


def test_the_plan_of_a_heavier_body_is_weighed():
    verdict = walked("other_mass", 2.0).verdict
    assert [item.name for item in verdict.failed] == ["force_z_rmse"]
    assert verdict.failed[0].value / (60.0 * 9.81) == pytest.approx(0.02, abs=0.001)


def test_too_little_friction_is_failed_for_slip_alone():
    """The controller takes the floor's friction of 0.22 for 0.8, and keeps every other limit of the walk."""
    run = ampm.load_run("flat", gait={"steps": 6}, disturbance={"friction_factor": 0.22 / 0.8})
    failed = [METRICS[item.name] for item in val.walk(run).verdict.failed]
    assert [metric.name for metric in failed if metric.kind == "walk"] == ["slip_maximum"]


def test_the_page_shows_the_data_which_are_of_the_draw():
    unseen = script("unseen")
    page, rows = unseen.PAGE.read_text(encoding="utf-8"), unseen.read_rows("unseen")
    for table in (unseen.outcomes(rows), unseen.refusals(rows)):
        assert table.markdown() in page
    draw = load_sweep(DOCS / "examples" / "unseen.toml")
    sensed = unseen.changed(draw, unseen.SENSED)
    counts = {unseen.HUMAN: 100, unseen.HUMAN_ESTIMATED: 100, unseen.DRAKE: unseen.IN_BOTH}
    for name, count in counts.items():
        found = unseen.of_draw(rows, name)
        assert len(found) == count
        for row in found:
            values = draw.varied(int(row["gait"]))
            assert values == sensed.varied(int(row["gait"]))
            for key, title in unseen.DRAWN.items():
                assert float(row[title]) == pytest.approx(values[key], abs=6e-4)
    assert all(sensed.parameters(0).value(key) == value for key, value in unseen.SENSED.items())


@pytest.mark.slow
def test_an_easy_gait_walks_and_slopes_are_those_of_differences():
    run = load_run(None, ["gait.step_length=0.5", "gait.steps=2"])
    referee = script("referee")
    problem, motion, violated, _ = referee.judged(run, make_body(run).robot)
    assert max(violated.values()) <= 1.0
    assert referee.walked(problem, motion, run) == "pass"
    tasks, nv, n = problem.tasks(motion.x), problem.robot.nv, len(motion.q)
    values, slopes = problem.linearised(motion, tasks)
    change = 1e-6 * np.random.default_rng(0).normal(size=(n, nv))
    step = np.concatenate([change.ravel(), [1e-6], np.zeros(len(motion.x))])
    moved, _ = problem.linearised(problem._moved(motion, step), tasks)
    for k in range(n):
        near = np.concatenate([change[k - 1], change[k], change[(k + 1) % n], [1e-6]])
        steady = (values[k] > 0.1) | (values[k] < 0.0)  # where no limit begins to be broken
        np.testing.assert_allclose((moved - values)[k][steady], (slopes[k] @ near)[steady], atol=1e-5)
