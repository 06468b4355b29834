"""Foot paths: derivatives, smoothness over key-frames, pivots that rest, soles over the floor."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ampm.description import SoleGeometry
from ampm.exceptions import InputError
from ampm.parameters import FootParameters
from ampm.planner.contacts import Contacts, Footstep
from ampm.planner.feet import FootSample
from ampm.planner.stride import plan_feet, quintic
from ampm.planner.support import plan_steps
from ampm.presets import preset_names
from ampm.run_file import load_run
from models.human import sole_geometry

SOLE = SoleGeometry(-0.1, 0.09, 0.16, 0.03, 0.04, 0.035, -0.035, 0.066)
SCHEDULES = {
    "flat": FootParameters(schedule="flat"),
    "roll": FootParameters(swing_height=0.08, swing_lag=0.05, toe_return=0.8, heel_strike_rate=0.0),
    "turning": FootParameters(
        swing_height=0.08, swing_lag=-0.1, toe_return=1.0, heel_strike_rate=2.0, full_contact=1.0
    ),
    "early": FootParameters(swing_height=0.08, toe_return=0.3, heel_rise_lead=0.05, full_contact=0.5),
}
STEPS = 5


def gait(**values):
    return load_run("normal", [f"gait.steps={STEPS}"]).gait.model_copy(update=values)


def planned(foot, **values):
    return plan_steps(gait(**values), 60.0, foot, SOLE)


@pytest.fixture(scope="module", params=SCHEDULES)
def plan(request):
    return planned(SCHEDULES[request.param])


def between_key_frames(plan):
    """Times that are no nearer than 0.2 ms to any key-frame."""
    frames = np.concatenate([plan.feet.left.start, plan.feet.right.start])
    times = np.linspace(0.01, plan.duration - 0.01, 400)
    return times[np.abs(times[:, None] - frames).min(axis=1) > 2e-4]


def same(one: FootSample, other: FootSample, names: str, tolerance: float):
    for name in names.split():
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=tolerance, err_msg=name)


@pytest.mark.parametrize("foot", SCHEDULES.values(), ids=SCHEDULES)
def test_derivatives_are_those_of_the_values(foot):
    plan = planned(foot)
    times, h = between_key_frames(plan), 1e-5
    for before, here, after in zip(
        plan.feet.sample(times - h), plan.feet.sample(times), plan.feet.sample(times + h), strict=True
    ):
        for names in (
            ("position", "velocity", "acceleration"),
            ("pitch", "pitch_velocity", "pitch_acceleration"),
            ("toe", "toe_velocity", "toe_acceleration"),
        ):
            for name, derivative, tolerance in zip(names, names[1:], (1e-5, 1e-3), strict=False):
                slope = (getattr(after, name) - getattr(before, name)) / (2 * h)
                np.testing.assert_allclose(slope, getattr(here, derivative), atol=tolerance)


def test_paths_are_c2_over_every_key_frame(plan):
    for index, path in enumerate((plan.feet.left, plan.feet.right)):
        frames = path.start[path.start > 0.0]
        before = plan.feet.sample(frames - 2e-12)[index]  # evaluates the segment that ends
        after = plan.feet.sample(frames)[index]
        same(before, after, "position pitch toe sole_points", 1e-9)
        same(before, after, "velocity pitch_velocity toe_velocity", 1e-8)
        same(before, after, "acceleration pitch_acceleration toe_acceleration", 1e-6)


def test_points_in_contact_rest_on_the_floor(plan):
    """Also the pivot: the heel while the foot rolls down, ball and tip while the heel rises."""
    times = np.linspace(0.0, plan.duration, 3001)
    for index, path in enumerate((plan.feet.left, plan.feet.right)):
        sample = plan.feet.sample(times)[index]
        contact = sample.contact.repeat(2, axis=1)
        np.testing.assert_allclose(sample.sole_points[..., 2][contact], 0.0, rtol=0.0, atol=1e-12)
        segment = np.searchsorted(path.start, times + 1e-12, side="right")
        same = np.diff(segment) == 0
        moved = np.abs(np.diff(sample.sole_points, axis=0)).max(axis=2)
        assert moved[same][contact[:-1][same]].max() < 1e-12


@pytest.mark.parametrize("name", preset_names())
def test_soles_stay_over_the_floor(name):
    run = load_run(name, ["gait.steps=4"])
    plan = plan_steps(run.gait, 60.0, run.foot, sole_geometry(run.body.height))
    for foot in plan.feet.sample(np.linspace(0.0, plan.duration, 20001)):
        assert foot.sole_points[..., 2].min() > -1e-12


@pytest.mark.parametrize("schedule", SCHEDULES.values(), ids=SCHEDULES)
def test_feet_stand_on_their_placements_and_unequal_ones_need_no_other_code(schedule):
    plan = planned(schedule)
    moves = np.array([0.0, 0.02, -0.05, 0.07, 0.01, -0.03, 0.04])
    steps = tuple(
        Footstep(f.foot, (f.position[0] + m, f.position[1] + 0.2 * m, 0.0))
        for f, m in zip(plan.contacts.footsteps, moves, strict=True)
    )
    moved = {None: None, **dict(zip(plan.contacts.footsteps, steps, strict=True))}
    phases = [p._replace(left=moved[p.left], right=moved[p.right]) for p in plan.contacts.phases]
    feet = plan_feet(Contacts(steps, tuple(phases)), schedule, SOLE)
    for k, step in enumerate(steps[1:-1]):
        foot = feet.sample((k + 0.3) * plan.constants.step_duration)[0 if step.foot == "left" else 1]
        np.testing.assert_allclose(foot.position[0], step.position, rtol=0.0, atol=1e-12)
        assert foot.pitch[0] == foot.toe[0] == 0.0


@given(
    values=st.lists(st.floats(-3, 3), min_size=6, max_size=6),
    durations=st.lists(st.floats(0.05, 3.0), min_size=2, max_size=2),
)
def test_quintics_meet_both_ends(values, durations):
    start, end = np.reshape(values, (2, 3))
    both = quintic(np.stack([start, start], axis=1), np.stack([end, end], axis=1), durations)
    assert both.shape == (2, 6)
    for coefficients, duration in zip(both, durations, strict=True):
        polynomial = np.polynomial.Polynomial(coefficients)
        size = (1.0 + np.abs(values).max() * (1.0 + duration**2)) * max(1.0, duration**-2)
        for time, wanted in ((0.0, start), (duration, end)):
            found = [polynomial.deriv(k)(time) if k else polynomial(time) for k in range(3)]
            np.testing.assert_allclose(found, wanted, atol=1e-11 * size)


def test_what_has_no_feet_is_refused():
    foot = SCHEDULES["roll"]
    plan = planned(foot)
    contacts, steps = plan.contacts, plan.contacts.footsteps
    turned = (*steps[:-1], steps[-1]._replace(heading=0.1))
    for wrong in (replace(contacts, phases=contacts.phases[1:]), replace(contacts, footsteps=turned)):
        with pytest.raises(InputError):
            plan_feet(wrong, foot, SOLE)
    for lead in (0.9, -0.9):
        with pytest.raises(InputError, match=rf"foot\.heel_rise_lead = {lead:g} s"):
            planned(FootParameters(heel_rise_lead=lead))
    for time in (-0.1, 100.0, np.nan):
        with pytest.raises(InputError, match="outside the plan"):
            plan.feet.sample(time)


# --------------------------------------------------------------------------------- the support polygon


def test_the_support_polygon_of_flat_feet():
    plan = planned(SCHEDULES["flat"], step_length=0.4, switching_velocity=0.8)
    single = plan.support_polygon(0.1)
    np.testing.assert_allclose([single[:, 0].min(), single[:, 0].max()], [-0.1, 0.16])
    np.testing.assert_allclose([single[:, 1].min(), single[:, 1].max()], [0.05, 0.13])
    double = plan.support_polygon(plan.contacts.starts[1] + 0.01)
    np.testing.assert_allclose([double[:, 0].min(), double[:, 0].max()], [-0.1, 0.56])
    times = np.linspace(0.0, plan.duration, 300)
    margin = plan.zmp_margin(times)
    assert margin.min() > 0.0
    # In single support the nearest edge is the heel, the toe or a side.
    middle = plan.zmp_margin(plan.constants.single_support_duration / 2)[0]
    assert 0.03 < middle < 0.04


def test_no_instant_undercuts_the_least_margin(plan):
    least, time = plan.least_zmp_margin()
    assert plan.zmp_margin(time)[0] == least
    beside = np.concatenate([plan.contacts.starts[1:] + shift for shift in (-1e-9, 0.0, 1e-9)])
    assert least <= plan.zmp_margin(beside).min() + 1e-12
    # What a grid sees approaches it from above.
    grid = plan.zmp_margin(np.linspace(0.0, plan.duration, 20001)).min()
    assert least - 1e-12 <= grid
    part, time = plan.least_zmp_margin(0.1)
    assert 0.0 <= time <= 0.1
    assert part >= least
    assert np.isfinite(plan.least_zmp_margin(0.0)[0])
    with pytest.raises(InputError, match="outside"):
        plan.least_zmp_margin(plan.duration + 1.0)
