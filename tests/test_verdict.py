"""Comparison and verdict of hand-made measurements: a known error comes back as itself, limits decide.

A perfect walk scores zero; what passes, what fails, what nobody can say, and the summary.
"""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from ampm import load_run, preset_names
from models.human import sole_geometry
from tests.walk import APART, perfect_walk, with_state
from validation.judge.compare import PARTS, RUN, compare
from validation.judge.metrics import DEFAULT_BODY, evaluate
from validation.judge.profiles import DEFAULT, PUSHED, STRICT, Profile, find_profile, own_profile
from validation.judge.signals import signals_table
from validation.judge.uncertainty import Uncertainty
from validation.judge.verdict import VerdictName, judge
from validation.store.signals import COLUMNS, load_signals, save_signals
from validation.trial.disturbances import Push
from validation.trial.followed import Followed, FrozenPlan
from validation.trial.outcome import Outcome, OutcomeName


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
    assert len(verdict.judged) == len(STRICT.tolerances) - 2  # speed limits, strides
    assert all(item.passed and (item.margin or 0.0) > 0.99 for item in verdict.judged)
    assert f"All {len(verdict.judged)} tolerances met" in verdict.reason
    assert verdict.reason.endswith(" Profile: strict.")
    assert verdict_of(compared(walk), STRICT, zmp_x_rmse=2.0e-3).passed  # the limit itself


def test_a_limit_of_zero_may_be_the_only_one(walk):
    leaves_out = tuple(name for name, item in DEFAULT.tolerances.items() if item.limit)
    verdict = verdict_of(compared(walk), Profile("zero", DEFAULT, leaves_out))
    assert verdict.passed
    assert all(item.tolerance == 0.0 for item in verdict.judged)
    assert verdict_of(compared(walk), Profile("own", PUSHED)).reason.startswith("Nothing pushed the body")


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
    assert all((item.passed, item.margin, item.undecided) == (None, None, False) for item in verdict.metrics)
    assert "1.234 s" in verdict.reason
    assert record.outcome.cause in verdict.reason


def test_a_walk_of_one_step_has_nothing_to_judge():
    walk = perfect_walk(steps=1)
    assert walk[1].outcome.summary == "1 step, completed"
    verdict = verdict_of(compared(walk), DEFAULT)
    assert verdict.name is VerdictName.NOT_MEASURED
    assert verdict.reason.endswith("Walk longer than a step.")


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
        assert [one.name for one in verdict.metrics if one.undecided] == ["zmp_x_rmse"]


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
    limits = DEFAULT.tolerances
    half = {"body_weight": 0.5 * DEFAULT_BODY["body_weight"], "foot_length": 0.5 * sole.length}
    found = {name: limits[name].limit_for(half) for name in ("zmp_x_rmse", "com_agreement_maximum")}
    assert found == {"zmp_x_rmse": 1.25e-3, "com_agreement_maximum": 1e-9}
    momentum = limits["angular_momentum_x_rmse"].limit_for(half)
    assert momentum == pytest.approx(0.15 * 0.5**2.5, abs=1e-9)
    many = {"body_weight": np.full(2, 588.6), "foot_length": np.array([0.258, 0.129])}
    np.testing.assert_allclose(limits["zmp_x_rmse"].limit_for(many), [2.5e-3, 1.25e-3])


def test_profiles_are_found_by_name_and_by_run():
    assert find_profile("strict") is STRICT
    gait, jumps = load_run("pitch"), load_run("ipm")
    own = {name: own_profile(load_run(name)).name for name in preset_names()}
    changes = {"gait.planner": "ampm", "controller.contact_ramp": 0.03}.items()
    own |= {key: own_profile(jumps.replace({key: value})).name for key, value in changes}
    special = {name: found for name, found in own.items() if found != DEFAULT.name}
    assert special == {"ipm": "jumps"}  # no other demo, plan or contact may take wider limits
    steps = [{"foot": foot, "x": 0.0, "y": 0.0} for foot in ("left", "right") * 2]
    over_footsteps = gait.replace({}, footsteps=steps)
    assert own_profile(over_footsteps).name == "footsteps"
    estimating = own_profile(over_footsteps.replace({"sensors.estimator": "kalman"}))
    limits, steps_limits, odometry = (
        {name: item.limit for name, item in find_profile(profile).tolerances.items()}
        for profile in (estimating, "footsteps", "odometry")
    )
    of_steps = {name: steps_limits[name] for name in ("angular_momentum_x_rmse", "angular_momentum_y_rmse")}
    assert limits == {**odometry, **of_steps}
    assert own_profile(gait, [Push("chest", (1.0, 0.0, 0.0), 1.0, 0.1)]).name == "pushed"
    estimated, fixed = {"estimator": "kalman"}, {"estimator": "kalman", "fix_rate": 100}
    runs = [load_run("pitch", sensors=keys) for keys in ({}, estimated, fixed, {"rate_noise": 0.01})]
    assert [own_profile(run).name for run in runs] == ["default", "odometry", "default", "default"]


def test_a_perfect_walk_has_no_error(walk):
    comparison = compare(*walk)
    for name, windows in comparison.signals.items():
        for window, statistics in windows.items():
            if statistics.count:
                assert statistics.maximum < 1e-9, (name, window)
                assert statistics.r2 is None or statistics.r2 == pytest.approx(1.0)
    assert comparison.zmp_split.residual < 1e-12
    assert max(comparison.costs["effort"]["force"]) < 1e-9
    assert evaluate(comparison)["zmp_agreement_rmse"] < 1e-12


def test_windows_divide_the_run_and_leave_out_only_the_first_step(walk):
    plan, record, measured = walk
    claim = replace(plan, constants=replace(plan.constants, single_support_duration=2.0))  # is not used
    rows, step = compare(claim, record, measured).rows, plan.constants.step_duration
    np.testing.assert_array_equal(rows[RUN], measured.time >= step - 1e-9)
    assert (rows[RUN] ^ rows["first_step"]).all()
    for names in (list(rows)[2:4], [name for name in rows if name.startswith("measured_")]):
        np.testing.assert_array_equal(sum(rows[name].astype(int) for name in names), rows[RUN])
    share = plan.constants.single_support_duration / step
    assert rows["single_support"].sum() == pytest.approx(rows[RUN].sum() * share, rel=0.02)


def test_a_constant_error_is_bias(walk):
    comparison = compared(walk, com_shift=(0.002, -0.001, 0.0))
    zmp_x = comparison.signals["zmp_x"][RUN]
    assert (zmp_x.rmse, zmp_x.maximum, zmp_x.bias) == (pytest.approx(0.002),) * 3
    assert comparison.signals["zmp_y"][RUN].bias == pytest.approx(-0.001)
    assert zmp_x.r2 == pytest.approx(1.0 - 0.002**2 / comparison.sample.zmp[comparison.inside, 0].var())


@pytest.mark.parametrize(
    ("change", "part"),
    [
        ({"com_shift": (0.003, 0.002, 0.0)}, "com_position"),
        ({"com_shift": (0.0, 0.0, 0.01)}, "com_position"),
        ({"force_shift": (4.0, -3.0, 0.0)}, "com_acceleration"),
        ({"force_shift": (0.0, 0.0, 25.0)}, "vertical_force"),
        ({"moment_shift": (1.5, -2.0, 0.3)}, "momentum_rate"),
        ({"instrument": (0.001, -0.002)}, "instrument"),
    ],
)
def test_each_cause_lands_in_its_own_part(walk, change, part):
    split = compared(walk, **change).zmp_split
    assert split.residual < 1e-12
    for name in PARTS:
        largest = np.abs(split.parts[name]).max()
        assert (largest > 1e-5) if name == part else (largest < 1e-12), name
    np.testing.assert_allclose(split.share[part], 1.0)


def test_the_split_is_exact_for_large_and_mixed_errors(walk):
    rng, k = np.random.default_rng(4), walk[2].time.size
    comparison = compared(
        walk,
        com_shift=rng.normal(0.0, 0.05, (k, 3)),
        force_shift=rng.normal(0.0, 80.0, (k, 3)),
        moment_shift=rng.normal(0.0, 30.0, (k, 3)),
        instrument=rng.normal(0.0, 0.01, (k, 2)),
    )
    split = comparison.zmp_split
    assert split.residual < 1e-12
    error = comparison.measured.zmp - comparison.sample.zmp
    np.testing.assert_allclose(sum(split.parts.values()), error, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(np.sum(list(split.share.values()), axis=0), 1.0)
    assert comparison.signals["zmp_x"][RUN].rmse > 0.02


def test_an_instant_without_support_is_counted_not_dropped_silently(walk):
    plan, record, measured = walk
    zmp, other, force = (getattr(measured, name).copy() for name in ("zmp", "zmp_momentum", "force"))
    zmp[-5:], other[-5:], force[-5:] = np.nan, np.nan, 0.0
    comparison = compare(plan, record, replace(measured, zmp=zmp, zmp_momentum=other, force=force))
    assert comparison.rows["measured_flight"].nonzero()[0].tolist() == [*range(len(zmp))[-5:]]
    assert comparison.signals["zmp_x"][RUN].unmeasured == 5
    assert evaluate(comparison)["unsupported_instants"] == 5
    assert comparison.zmp_split.residual < 1e-12
    assert signals_table(comparison).column("measured_zmp_x").null_count == 5


def test_margins_of_a_knee_that_bends_backwards_and_of_its_motor(walk):
    """It is straight at -0.3 rad."""
    leg = SimpleNamespace(knee="knee", knee_sign=-1.0, straight_knee=-0.3)
    body: Any = SimpleNamespace(legs=[leg], speed_limits=[("knee", 4.0)], sole=SimpleNamespace(length=0.2))
    plan, record, measured = walk
    q, qd, torque = record.q.copy(), record.qd.copy(), record.tick_torque.copy()
    q[:, 7], q[40, 7], qd[60, 6], torque[:10, 0] = -0.9, -0.5, -3.0, -100.0
    bent = replace(record, q=q, qd=qd, tick_torque=torque)
    found = compare(plan, bent, measured, description=body)
    margins, length = found.costs["margins"], found.scales["foot_length"]
    assert (margins["knee"].value, margins["knee"].time) == (pytest.approx(0.2), record.time[40])
    assert (margins["speed"].value, margins["speed"].time) == (0.75, record.time[60])
    assert margins["joint"].value == pytest.approx(0.1)
    assert (margins["saturated"], length) == (10 / record.steps, 0.2)
    for limit, excess in ((4.0, 0.0), (2.0, 0.5)):
        body.speed_limits = [("knee", limit)]
        assert evaluate(compare(plan, bent, measured, description=body))["speed_excess"] == excess


BOTH = (100, 200)
"""Two pushes less than a step apart, as rows; a step has 360."""


@pytest.mark.parametrize(
    ("pushes", "errors", "rows", "profile"),
    [
        (BOTH, [(210, 250, 0.5)], 49, "default"),
        (BOTH, [(210, 250, 0.5)], 49, "jumps"),
        (BOTH, [(210, 250, 0.5), (-360, None, 0.5)], math.nan, "default"),  # in the last step, too
        (BOTH, [(210, None, 0.5)], math.nan, "default"),  # the end comes before the limit on the recovery
        (BOTH, [(210, 230, math.nan), (230, None, 0.012)], math.nan, "default"),  # flown, then the RMS error
        (BOTH, [(230, 231, 0.05)], 30, "default"),
        (BOTH, [(230, 231, 0.05)], 0, "jumps"),  # which allows more
        (BOTH, [(110, 150, 0.5)], 0, "default"),  # between both
        ((100, 560), [(110, 150, 0.5)], 49, "default"),  # of which each counts
        ((820, 920), [(470, 510, 0.5)], math.inf, "default"),  # before the first push
        (BOTH, [(210, 600, 0.008)], 387, "default"),  # by the RMS error, which later steps do not lower
        (BOTH, [(-360, None, 0.0018)], 0, "default"),  # over the limit of RMS errors in the last step alone
        ((10,), [(900, 1000, 0.0055)], 963, "default"),  # 1.93 times that limit in a later step
    ],
)
def test_recovery_lasts_from_the_last_push_to_the_last_error(walk, pushes, errors, rows, profile):
    plan, record, measured = walk
    constants = replace(plan.constants, single_support_duration=0.0)  # are not used
    force, zmp = np.zeros((record.steps, 1, 3)), measured.zmp.copy()
    force[[*pushes]] = 10.0
    for begin, end, off in errors:
        zmp[begin:end, 1] += off
    for wind in (0.0, 1.0):  # is no push
        pushed = replace(record, external_segments=("thorax",), external_force=force + wind)
        found = compare(replace(plan, constants=constants), pushed, replace(measured, zmp=zmp))
        limits = {**PUSHED.limits(found.scales), **find_profile(profile).limits(found.scales)}
        found = replace(found, recovery_limits=limits)
        time = evaluate(found)["recovery_time"]
        assert time == pytest.approx(rows * record.time_step, nan_ok=True)


def test_the_judged_time_begins_with_the_first_step_that_is_walked(walk):
    plan, record, measured = walk
    ours = FrozenPlan.of(plan, record.time[:-1])
    begun: Any = SimpleNamespace(judged_from=math.inf, command=None)
    late = replace(ours, plan=begun)
    again = replace(record, followed=Followed((late, replace(ours, since=record.time_step))))
    np.testing.assert_array_equal(compare(plan, again, measured).inside, compare(*walk).inside)


def test_effort_is_command_minus_plan_after_the_first_step(walk):
    plan, record, measured = walk
    force, momentum = record.command_force.copy(), record.command_angular_momentum.copy()
    first = measured.time < plan.constants.step_duration - 1e-9
    force[~first] += [6.0, -3.0, 12.0]
    force[first] += 100.0
    momentum[:, 0] += 0.25
    force[1::3] = force[0::3][: len(force[1::3])]  # held, while the plan goes on
    momentum[1::3] = momentum[0::3][: len(momentum[1::3])]
    other = replace(record, command_force=force, command_angular_momentum=momentum)
    effort = compare(plan, other, measured).costs["effort"]
    np.testing.assert_allclose(effort["force"], [6.0, 3.0, 12.0])
    np.testing.assert_allclose(effort["angular_momentum"], [0.25, 0.0], rtol=0.0, atol=1e-12)


def test_a_body_that_stands_has_no_cost_of_transport(walk):
    plan, record, measured = walk
    costs = [compare(plan, replace(record, com=way * record.com), measured).costs for way in (1.0, 0.01)]
    assert [math.isnan(of["energy"]["cost_of_transport"]) for of in costs] == [False, True]


def test_signals_are_read_back_with_units_and_frames(walk, tmp_path):
    plan, _, measured = walk
    table = signals_table(comparison := compare(*walk))
    expected = [name for name, kind in COLUMNS.items() if not kind.source.startswith(("first.", "heading."))]
    assert table.column_names == expected
    save_signals(table, tmp_path / "signals.parquet")
    schema = pq.read_schema(tmp_path / "signals.parquet")
    known = {b"unit": b"N", b"frame": b"world", b"meaning": b"planned ground force at t_k"}
    assert schema.field("plan_force_x").metadata == known
    arrays = load_signals(tmp_path / "signals.parquet")
    assert arrays["left_contact"].dtype == bool
    np.testing.assert_array_equal(arrays["measured_zmp_x"], measured.zmp[:, 0])
    np.testing.assert_array_equal(arrays["plan_force_x"], plan.sample(measured.time).force[:, 0])
    for part in PARTS:
        one = comparison.zmp_split.parts[part][:, 1]
        np.testing.assert_array_equal(arrays[f"zmp_error_{part}_y"], one)
    parts = sum(arrays[f"zmp_error_{part}_y"] for part in PARTS)
    np.testing.assert_allclose(parts, arrays["measured_zmp_y"] - arrays["plan_zmp_y"], rtol=0.0, atol=1e-9)
