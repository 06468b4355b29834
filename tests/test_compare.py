"""Comparison on hand-made measurements: a perfect one scores zero, a known error comes back as itself."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from tests.walk import perfect_walk, with_state
from validation.judge.compare import PARTS, RUN, compare
from validation.judge.metrics import evaluate
from validation.judge.profiles import find_profile
from validation.judge.signals import kept_rows, signals_table
from validation.store.signals import COLUMNS, load_signals, save_signals


@pytest.fixture(scope="module")
def walk():
    return perfect_walk()


def moving(walk, **change):
    """Comparison with another state."""
    plan, record, measured = walk
    return compare(plan, record, with_state(measured, **change))


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
    comparison = moving(walk, com_shift=(0.002, -0.001, 0.0))
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
    split = moving(walk, **change).zmp_split
    assert split.residual < 1e-12
    for name in PARTS:
        largest = np.abs(split.parts[name]).max()
        assert (largest > 1e-5) if name == part else (largest < 1e-12), name
    np.testing.assert_allclose(split.share[part], 1.0)


def test_the_split_is_exact_for_large_and_mixed_errors(walk):
    rng, k = np.random.default_rng(4), walk[2].time.size
    comparison = moving(
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


def recovery_time(found, profile="default"):
    limits = find_profile(profile).limits(found.scales)
    return evaluate(replace(found, unpushed_limits=limits))["recovery_time"]


def test_recovery_lasts_from_the_last_push_to_the_last_error(walk):
    plan, record, measured = walk
    force, zmp = np.zeros((record.steps, 1, 3)), measured.zmp.copy()
    step = round(plan.constants.step_duration / record.time_step)
    force[[100, 200]], zmp[210:250, 1] = 10.0, 0.5
    pushed = replace(record, external_segments=("thorax",), external_force=force)
    recovery = recovery_time(compare(plan, pushed, replace(measured, zmp=zmp)))
    assert recovery == pytest.approx(49 * record.time_step)
    again = zmp.copy()
    again[-step:, 1] = 0.5  # in the last step
    assert np.isnan(recovery_time(compare(plan, pushed, replace(measured, zmp=again))))
    flown = measured.zmp.copy()
    flown[210:230], flown[230:, 1] = np.nan, flown[230:, 1] + 0.012  # within the largest error, not its RMS
    assert np.isnan(recovery_time(compare(plan, pushed, replace(measured, zmp=flown))))
    still = replace(plan.constants, single_support_duration=0.0, double_support_duration=0.0)
    found = compare(replace(plan, constants=still), pushed, replace(measured, zmp=zmp))
    assert recovery_time(found) == recovery
    assert recovery_time(found, "jumps") == recovery
    zmp = measured.zmp.copy()
    zmp[230, 1] += 0.05  # more than `default` allows, less than `jumps`
    found = compare(plan, pushed, replace(measured, zmp=zmp))
    times = [recovery_time(found, name) for name in ("default", "jumps")]
    assert times == pytest.approx([30 * record.time_step, 0.0])
    late = np.arange(len(zmp))[:, None] > 210  # to the end, which comes before the limit on the recovery
    zmp = np.where(late, 0.5, zmp)
    assert np.isnan(recovery_time(compare(plan, pushed, replace(measured, zmp=zmp))))


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


def test_a_walk_that_ends_in_its_first_step_keeps_its_rows():
    assert kept_rows(0, 0.01) == slice(None, None, 1)


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
