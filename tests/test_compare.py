"""Comparison on hand-made measurements: a perfect one scores zero, a known error comes back as itself."""

from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest

from tests.walk import MASS, perfect_walk, with_state
from validation.judge.compare import PARTS, RUN, SIGNALS, compare, statistics_table
from validation.judge.metrics import evaluate
from validation.judge.signals import signals_table
from validation.store.signals import COLUMNS, column_of, load_signals, save_signals

WEIGHT = MASS * 9.81


@pytest.fixture(scope="module")
def walk():
    return perfect_walk()


def recorded(walk, **change):
    """Comparison with something else in the record."""
    plan, record, measured = walk
    return compare(plan, replace(record, **change), measured)


def measuring(walk, **change):
    """Comparison with something else in the measurement."""
    plan, record, measured = walk
    return compare(plan, record, replace(measured, **change))


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
    assert evaluate(comparison)["zmp_agreement_rmse"].value < 1e-12


def test_windows_divide_the_run_and_leave_out_only_the_first_step(walk):
    plan, _, measured = walk
    rows, step = compare(*walk).rows, plan.constants.step_duration
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
    assert statistics_table(comparison)["zmp_x"][RUN]["bias"] == zmp_x.bias


def test_r2_is_null_where_the_plan_does_not_vary(walk):
    plan, _, measured = walk
    signals = compare(*walk).signals
    for name in ("force_z", "com_z"):
        assert signals[name][RUN].r2 is None
    assert signals["zmp_x"][RUN].r2 == pytest.approx(1.0)
    assert signals["zmp_x"]["measured_flight"].r2 is None
    force = measured.force.copy()  # an error as large as the signal
    force[:, 0] = plan.sample(measured.time).force[measured.time >= plan.constants.step_duration, 0].mean()
    assert measuring(walk, force=force).signals["force_x"][RUN].r2 == pytest.approx(0.0)


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
    zmp, other = walk[2].zmp.copy(), walk[2].zmp_momentum.copy()
    zmp[-5:], other[-5:] = np.nan, np.nan
    comparison = measuring(walk, zmp=zmp, zmp_momentum=other)
    assert comparison.signals["zmp_x"][RUN].unmeasured == 5
    assert evaluate(comparison)["unsupported_instants"].value == 5
    assert comparison.zmp_split.residual < 1e-12
    assert signals_table(comparison).column("measured_zmp_x").null_count == 5


def test_effort_is_command_minus_plan_after_the_first_step(walk):
    plan, record, measured = walk
    force, momentum = record.command_force.copy(), record.command_angular_momentum.copy()
    first = measured.time < plan.constants.step_duration - 1e-9
    force[~first] += [6.0, -3.0, 12.0]
    force[first] += 100.0
    momentum[:, 0] += 0.25
    comparison = recorded(walk, command_force=force, command_angular_momentum=momentum)
    effort = comparison.costs["effort"]
    np.testing.assert_allclose(effort["force"], [6.0, 3.0, 12.0])
    np.testing.assert_allclose(effort["angular_momentum"], [0.25, 0.0], rtol=0.0, atol=1e-12)


def test_margins_name_where_and_when(walk):
    plan, record, measured = walk
    torque, q = np.zeros_like(record.torque), record.q.copy()
    torque[300, 1] = -0.8 * record.torque_limit[1]
    torque[400, 0] = record.torque_limit[0]
    q[250, -1] = record.joint_range[1, 1] - 0.05
    margins = recorded(walk, torque=torque, q=q).costs["margins"]
    assert (margins["torque"].value, margins["torque"].where, margins["torque"].time) == (
        1.0,
        "knee",
        record.time[400],
    )
    assert margins["torque_by_joint"] == {"knee": 1.0, "hip": pytest.approx(0.8)}
    assert margins["saturated"] == pytest.approx(1.0 / record.steps)
    assert margins["joint"].value == pytest.approx(0.05)
    assert (margins["joint"].where, margins["joint"].time) == ("hip", record.time[250])
    planned = plan.least_zmp_margin(measured.time[-1])
    assert (margins["plan_polygon"].value, margins["plan_polygon"].time) == planned
    assert planned[0] <= plan.zmp_margin(measured.time).min()


def test_friction_counts_loaded_feet_only(walk):
    foot = np.zeros_like(walk[2].foot_force)
    foot[:, 0], foot[:, 1] = [30.0, 40.0, 500.0], [9.0, 0.0, 10.0]
    margins = measuring(walk, foot_force=foot).costs["margins"]
    assert (margins["friction"].value, margins["friction"].where) == (pytest.approx(0.1), "left")
    assert margins["friction_available"] == walk[1].friction


def test_work_of_a_constant_torque(walk):
    plan, record, measured = walk
    torque, qd = np.zeros_like(record.torque), np.zeros_like(record.qd)
    torque[:, 0], qd[:, -2] = 2.0, 3.0
    torque[:, 1], qd[:, -1] = 1.0, -1.0
    spent = recorded(walk, torque=torque, qd=qd).costs["energy"]
    seconds = (measured.time >= plan.constants.step_duration - 1e-9).sum() * record.time_step
    assert spent["positive_work"] == pytest.approx(6.0 * seconds)
    assert spent["negative_work"] == pytest.approx(-1.0 * seconds)
    assert spent["cost_of_transport"] == pytest.approx(spent["positive_work"] / (WEIGHT * spent["distance"]))
    aside = record.com[:, [1, 0, 2]]  # and a way back and forth counts twice
    assert recorded(walk, com=aside).costs["energy"]["distance"] == pytest.approx(spent["distance"])
    back = record.com * np.where(np.arange(len(record.com)) % 2, -1.0, 1.0)[:, None]
    assert recorded(walk, com=back).costs["energy"]["distance"] > 100.0 * spent["distance"]


def test_the_posture_gives_the_reference_of_yaw_momentum_only(walk):
    off = walk[2].angular_momentum + np.array([0.0, 0.0, 0.2])
    signals = measuring(walk, angular_momentum=off).signals
    assert SIGNALS["angular_momentum_z"].reference == "motion"
    assert signals["angular_momentum_z"][RUN].bias == pytest.approx(0.2)
    assert SIGNALS["angular_momentum_x"].reference == "plan"


@pytest.mark.parametrize("steps", [0, 40])
def test_a_run_of_less_than_a_step_is_compared_as_far_as_it_went(steps):
    comparison = compare(*perfect_walk(count=steps))
    assert comparison.signals["zmp_x"][RUN].count == 0
    assert np.isnan(evaluate(comparison)["zmp_x_rmse"].value)
    assert comparison.rows["first_step"].sum() == steps
    assert signals_table(comparison).num_rows == steps


def test_signals_are_read_back_with_units_and_frames(walk, tmp_path):
    plan, record, measured = walk
    table = signals_table(compare(*walk))
    others = {
        item
        for item in COLUMNS
        if "first_plan" in item.pattern or item.meaning.endswith("of a walk without a plan")
    }
    assert {column_of(name) for name in table.column_names} == set(COLUMNS) - others
    assert table.column("plan_angular_momentum_z").null_count == record.steps
    save_signals(table, tmp_path / "signals.parquet")
    schema = pq.read_schema(tmp_path / "signals.parquet")
    known = {b"unit": b"N", b"frame": b"world", b"meaning": b"planned ground force at t_k"}
    assert schema.field("plan_force_x").metadata == known
    arrays = load_signals(tmp_path / "signals.parquet")
    assert set(arrays["phase"]) == {"single_support", "double_support"}
    assert set(arrays["stance"]) == {"left", "right", "both"}
    assert arrays["left_contact"].dtype == bool
    np.testing.assert_array_equal(arrays["measured_zmp_x"], measured.zmp[:, 0])
    np.testing.assert_array_equal(arrays["plan_force_x"], plan.sample(measured.time).force[:, 0])
    parts = sum(arrays[f"zmp_error_{part}_y"] for part in PARTS)
    np.testing.assert_allclose(parts, arrays["measured_zmp_y"] - arrays["plan_zmp_y"], rtol=0.0, atol=1e-9)
