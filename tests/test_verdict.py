"""Verdicts: limits of the profiles, what passes, what fails, what nobody can say, and the summary."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ampm import dump_run, load_run, preset_names
from models.human import sole_geometry
from tests.walk import APART, perfect_walk, with_state
from validation.judge.compare import compare
from validation.judge.metric import DEFAULT_BODY
from validation.judge.metrics import evaluate
from validation.judge.profiles import DEFAULT, STRICT, Profile, find_profile, own_profile
from validation.judge.uncertainty import Uncertainty
from validation.judge.verdict import VerdictName, judge
from validation.trial.disturbances import Push
from validation.trial.outcome import Outcome, OutcomeName
from validation.trial.plan import load_request


@pytest.fixture(scope="module")
def walk():
    return perfect_walk()


def compared(walk, **change):
    """The walk with another state, and a body that was weighed right."""
    plan, record, measured = walk
    return compare(plan, record, with_state(measured, **change), shapes=APART)


def verdict_of(comparison, limits, known=None, **values):
    """Verdict; numerical uncertainties and other values of single metrics."""
    metrics = evaluate(comparison) | values
    study = None if known is None else Uncertainty("x", 6, known)
    return judge(metrics, limits, comparison.scales, study, ended=comparison.record.outcome.ending)


def named(verdict, name="zmp_x_rmse"):
    return next(item for item in verdict.metrics if item.name == name)


def test_a_perfect_walk_passes_the_strict_profile(walk):
    verdict = verdict_of(compared(walk), STRICT)
    assert verdict.passed
    assert len(verdict.judged) == len(STRICT.tolerances) - 5  # speed limits, command, strides
    assert all(item.passed and (item.margin or 0.0) > 0.99 for item in verdict.judged)
    assert f"All {len(verdict.judged)} tolerances met" in verdict.reason
    assert verdict.reason.endswith(" Profile: strict.")
    assert verdict_of(compared(walk), STRICT, zmp_x_rmse=2.0e-3).passed  # the limit itself


def test_a_limit_of_zero_may_be_the_only_one(walk):
    leaves_out = tuple(item.metric for item in DEFAULT.tolerances if item.limit)
    verdict = verdict_of(compared(walk), Profile("zero", DEFAULT, leaves_out))
    assert verdict.passed
    assert all(item.tolerance == 0.0 for item in verdict.judged)


def test_an_error_between_the_profiles_passes_one_and_fails_the_other(walk):
    off = compared(walk, com_shift=(0.0022, 0.0, 0.0))
    assert verdict_of(off, DEFAULT).name is VerdictName.PASS
    verdict = verdict_of(off, STRICT)
    assert [item.name for item in verdict.failed] == ["zmp_x_rmse"]
    assert verdict.failed[0].margin == pytest.approx(-0.1)
    both = verdict_of(off, STRICT, failed_qp=1.0).reason
    assert "the furthest is ZMP, RMS error along x: 2.2 mm, limit 2, and unsolved QPs: 1, limit 0." in both


@pytest.mark.parametrize(
    ("status", "instrument", "failed"),
    [
        (2, (0.0, 0.0), ["failed_qp"]),
        (1, (0.0, 0.0), []),  # solved, in its second form
        (0, (0.002, 0.001), ["zmp_agreement_rmse"]),
    ],
)
def test_one_unsolved_qp_or_two_disagreeing_measurements_fail_the_run(walk, status, instrument, failed):
    plan, record, measured = walk
    ticks = record.qp_status.copy()
    ticks[7] = status
    spoilt = compared((plan, replace(record, qp_status=ticks), measured), instrument=instrument)
    verdict = verdict_of(spoilt, DEFAULT)
    assert [item.name for item in verdict.failed] == failed
    assert all((item.margin == -math.inf) == (item.tolerance == 0.0) for item in verdict.failed)


@pytest.mark.parametrize("name", [name for name in OutcomeName if name != "completed"])
def test_what_did_not_complete_has_no_verdict(walk, name):
    plan, record, measured = walk
    record = replace(record, outcome=Outcome(name, 1.234, "The left knee went straight.", 2))
    verdict = verdict_of(compared((plan, record, measured)), DEFAULT, {"zmp_x_rmse": math.inf})
    assert verdict.name is VerdictName.NOT_MEASURED
    assert all(item.passed is None and item.margin is None for item in verdict.metrics)
    assert not verdict.undecided
    assert "1.234 s" in verdict.reason
    assert record.outcome.cause in verdict.reason


def test_a_walk_of_one_step_has_nothing_to_judge():
    walk = perfect_walk(steps=1)
    assert walk[1].outcome.summary == "1 step, completed"
    verdict = verdict_of(compared(walk), DEFAULT)
    assert verdict.name is VerdictName.NOT_MEASURED
    assert "first step" in verdict.reason


@pytest.mark.parametrize(
    ("shift", "known", "name"),
    [
        (0.0018, {"zmp_x_rmse": 0.0003}, VerdictName.UNDECIDED),
        (0.0018, {"zmp_x_rmse": 0.0001}, VerdictName.PASS),
        (0.0022, {"zmp_x_rmse": 0.0003}, VerdictName.UNDECIDED),  # a failure below the uncertainty, too
        (0.0022, {"zmp_x_rmse": 0.0001, "zmp_y_rmse": math.inf}, VerdictName.FAIL),
    ],
)
def test_a_value_closer_to_its_limit_than_its_uncertainty_is_undecided(walk, shift, known, name):
    verdict = verdict_of(compared(walk, com_shift=(shift, 0.0, 0.0)), STRICT, known)
    assert verdict.name is name
    assert ("1 undecided" in verdict.reason) == (name is VerdictName.FAIL)
    item = named(verdict)
    if name is VerdictName.UNDECIDED:
        assert (item.passed, item.margin, item.undecided) == (None, None, True)
        assert (item.uncertainty, item.displayed(item.uncertainty)) == (0.0003, pytest.approx(0.3))
        assert f"{1e3 * shift:.2f} ± 0.30 mm" in verdict.reason
        assert [one.name for one in verdict.undecided] == ["zmp_x_rmse"]


def test_the_longest_slip_after_the_first_step_is_judged(walk):
    plan, record, measured = walk
    slip = np.zeros((record.steps, 2))
    slip[3, 0], slip[-1, 1] = 0.5, 12e-3  # in the first step, and in the last one
    least = compare(plan, record, replace(measured, slip=slip * (10.0002 / 12.0)), shapes=APART)
    assert named(verdict_of(least, STRICT), "slip_maximum").against == "10.0002 mm, limit 10"
    comparison = compare(plan, record, replace(measured, slip=slip), shapes=APART)
    verdicts = [verdict_of(comparison, limits) for limits in (DEFAULT, STRICT)]
    assert [named(verdict, "slip_maximum").value for verdict in verdicts] == [12e-3, 12e-3]
    assert [[item.name for item in verdict.failed] for verdict in verdicts] == [[], ["slip_maximum"]]


def test_limits_grow_with_foot_and_weight():
    """Those of the default body are exact; half as long a foot halves those of lengths."""
    sole = sole_geometry(1.70)
    assert {"body_weight": 60.0 * 9.81, "foot_length": sole.length} == DEFAULT_BODY
    limits = {item.metric: item for item in DEFAULT.tolerances}
    half = {"body_weight": 0.5 * DEFAULT_BODY["body_weight"], "foot_length": 0.5 * sole.length}
    found = {name: limits[name].limit_for(half) for name in ("zmp_x_rmse", "com_agreement_maximum")}
    assert found == {"zmp_x_rmse": 1.25e-3, "com_agreement_maximum": 1e-9}
    momentum = limits["angular_momentum_x_rmse"].limit_for(half)
    assert momentum == pytest.approx(0.15 * 0.5**2.5, abs=1e-9)
    many = {"body_weight": np.full(2, 588.6), "foot_length": np.array([0.258, 0.129])}
    np.testing.assert_allclose(limits["zmp_x_rmse"].limit_for(many), [2.5e-3, 1.25e-3])


def test_profiles_are_found_by_name_and_by_preset(tmp_path):
    assert find_profile("strict") is STRICT
    gait, file = load_run("pitch"), tmp_path / "pitch.toml"
    file.write_text(dump_run(gait))
    own = {name: own_profile(name, load_run(name)).name for name in preset_names()}
    own["file"] = own_profile(load_request(str(file)).name, gait).name
    special = {name: found for name, found in own.items() if found != DEFAULT.name}
    assert special == {"ipm": "jumps"}  # no other demo may take wider limits
    steps = [{"foot": foot, "x": 0.0, "y": 0.0} for foot in ("left", "right") * 2]
    over_footsteps = gait.replace({}, footsteps=steps)
    assert own_profile("pitch", over_footsteps).name == "footsteps"
    estimating = own_profile("pitch", over_footsteps.replace({"sensors.estimator": "kalman"}))
    limits, steps_limits, odometry = (
        {item.metric: item.limit for item in find_profile(profile).tolerances}
        for profile in (estimating, "footsteps", "odometry")
    )
    of_steps = {name: steps_limits[name] for name in ("angular_momentum_x_rmse", "angular_momentum_y_rmse")}
    assert limits == {**odometry, **of_steps}
    assert own_profile("pitch", gait, [Push("chest", (1.0, 0.0, 0.0), 1.0, 0.1)]).name == "pushed"
    estimated, fixed = {"estimator": "kalman"}, {"estimator": "kalman", "fix_rate": 100}
    runs = [load_run("pitch", sensors=keys) for keys in ({}, estimated, fixed, {"rate_noise": 0.01})]
    assert [own_profile("pitch", run).name for run in runs] == ["default", "odometry", "default", "default"]
