"""The stepping stabiliser: its formulas, and walks that are pushed or find the floor elsewhere."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from ampm.compiled import fields_of, records
from ampm.control.workspace import PlacedBody, SteppingState
from ampm.planner import routes
from ampm.stepping.floor import hold_height
from ampm.stepping.step_choice import dcm_ahead, quintic_tick, ramp_share, step_change
from ampm.stepping.stepper import Stepper
from tests.records import first_difference
from validation.judge.built_in import rms
from validation.judge.compare import compare
from validation.judge.metrics import evaluate
from validation.measure.measure import measure
from validation.run.walk import walk_planned
from validation.trial.bridge import to_pinocchio
from validation.trial.disturbances import Push
from validation.trial.followed import LEADS, STEPPING
from validation.trial.plan import Body as TrialBody
from validation.trial.plan import load_request, plan_walk
from validation.trial.simulate import simulate

OMEGA = 3.37
AT = 1.64
"""Middle of the third single support of ``normal``, on the left foot [s]."""
SHOVES = {"forward": (300, 0, 0), "backward": (-300, 0, 0), "wider": (0, -150, 0), "narrower": (0, 105, 0)}
"""Pushes at the chest for 0.1 s that the fixed stabiliser does not survive [N]."""


@cache
def planned(stabilizer, gait="normal"):
    settings = ["gait.steps=9", "simulation.time_step=0.002", f"controller.stabilizer={stabilizer}"]
    return plan_walk(load_request(gait, settings))


@cache
def walked(stabilizer, force=None, floor=0.0, steps=9):
    walk = planned(stabilizer)
    if floor:
        body = walk.body.model
        xml = body.xml.replace('<geom name="floor"', f'<geom name="floor" pos="0 0 {floor}"')
        assert xml != body.xml
        walk = replace(walk, body=TrialBody.of(replace(body, xml=xml)))
    pushes = [Push("chest", force, AT, 0.1)] if force else []
    return simulate(walk, disturbances=pushes, steps=steps)


# ------------------------------------------------------------------ formulas


def phase():
    """r and DCM of a phase in which r is quadratic in time, the DCM found by small steps."""
    t = np.linspace(0.0, 0.55, 401)
    r = np.stack([0.1 * t - 0.3 * t**2, 0.05 - 0.2 * t], axis=1)
    xi = np.empty_like(r)
    xi[0], fine = (0.02, -0.01), 200
    for k in range(len(t) - 1):
        x, h = xi[k], (t[1] - t[0]) / fine
        for j in range(fine):
            here = r[k] + (r[k + 1] - r[k]) * (j + 0.5) / fine
            x = here + (x - here) * math.exp(OMEGA * h)
        xi[k + 1] = x
    return t, r, xi


def stepper(**fields):
    """A stepper of which only some fields matter."""
    none = np.empty(0)
    body = PlacedBody(none, none, none, none, none, none, none, np.array([0.0, 0.0, 0.87]), 60.0, 9.81)
    fields = {"body": body, "contact": np.empty(0, dtype=bool), "omega": OMEGA, "tick": 0.002, **fields}
    state = records(1, fields_of(SteppingState))
    return Stepper(**{**dict.fromkeys(Stepper._fields, none), "state": state, **fields})


@pytest.mark.parametrize("begin", [0, 123, 390])
def test_the_dcm_ahead_is_the_plans_own_where_the_time_is_not_changed(begin):
    t, r, xi = phase()
    out = np.empty(2)
    dcm_ahead(r, xi[-1], float(begin), OMEGA * (t[-1] - t[begin]), out)
    np.testing.assert_allclose(out, xi[begin], atol=1e-7)


@pytest.mark.parametrize("error", [-0.3, -0.05, -0.01, 0.0, 0.01, 0.05, 0.2])
def test_ankle_and_step_together_bring_the_dcm_to_the_end_that_moved_with_the_step(error):
    low, high, single, double = -0.03, 0.05, 0.4, 0.12
    decay, ramp = math.exp(-OMEGA * single), ramp_share(OMEGA * double)
    u = step_change(error, decay, ramp, low, high)
    d = min(max(error / (1.0 - decay), low), high)
    assert (u == 0.0) == (d not in (low, high))
    # The error until the switch with the shift d of the ZMP, then with one that goes linearly to u.
    at_switch = d + (error - d) / decay
    steps = 20_000
    h = double / steps
    for k in range(steps):
        zmp = u * (k + 0.5) / steps
        at_switch = zmp + (at_switch - zmp) * math.exp(OMEGA * h)
    assert at_switch == pytest.approx(u, abs=1e-6)


def test_the_swing_foots_offset_goes_smoothly_to_a_target_that_moves():
    motion, target, tick, steps = np.zeros((3, 1)), np.array([0.2]), 0.002, 200
    motion[:, 0] = 0.05, 0.1, 0.0
    path = [motion.copy()]
    for k in range(steps):
        if k == 80:
            target[0] = -0.1
        quintic_tick(motion, target, (steps - k) * tick, tick)
        path.append(motion.copy())
    values = np.array(path)[:, :, 0]
    assert values[-1] == pytest.approx([-0.1, 0.0, 0.0], abs=1e-9)
    for order in (0, 1):  # each is the integral of the next; only the acceleration jumps with the target
        largest = tick * np.abs(values[:, order + 1]).max()
        assert np.abs(np.diff(values[:, order])).max() < 1.01 * largest


# ------------------------------------------------------------------ walks


def test_an_undisturbed_walk_is_the_fixed_stabilisers_to_the_bit():
    fixed, stepping = walked("fixed", steps=4), walked("stepping", steps=4)
    assert fixed.outcome.completed
    np.testing.assert_array_equal(fixed.q, stepping.q)
    np.testing.assert_array_equal(fixed.torque, stepping.torque)


@pytest.mark.parametrize(
    "direction", [name if name == "wider" else pytest.param(name, marks=pytest.mark.slow) for name in SHOVES]
)
def test_a_push_that_is_too_much_for_planned_steps_is_survived_by_other_steps(direction):
    force = SHOVES[direction]
    assert not walked("fixed", force).outcome.completed
    record = walked("stepping", force)
    assert record.outcome.completed, record.outcome.cause
    gaps = planned("stepping").body.shapes.recorded_gaps(record.q[::8])
    legs = [
        gap
        for gap, parts in zip(gaps.distance, gaps.parts, strict=True)
        if not {"trunk", "forearm", "hand", "arm"} & set(parts.split())
    ]
    assert len(legs) > 100
    assert min(legs) > 0.0


def test_steps_elsewhere_are_judged_by_what_was_planned_then():
    """Against the first plan a walk that steps 0.2 m elsewhere is wrong for good."""
    walk, record = planned("stepping"), walked("stepping", SHOVES["wider"])
    measured = measure(record, walk.body.robot.model, to_pinocchio)
    judged = compare(walk.plan, record, measured)
    metrics = evaluate(judged)
    assert judged.first is not None
    first = rms((measured.zmp - judged.first.zmp)[judged.inside, 1])
    assert metrics["zmp_y_rmse"].value < 0.5 * first
    assert 0.05 < metrics["plan_moved_footsteps"].value < 1.0
    assert metrics["plan_changes"].value >= 1.0
    assert (record.tick_plan == STEPPING).any()
    assert not record.tick_plan[record.tick_time < AT].any()
    own = judged.sample.time[np.repeat(record.tick_plan, record.substeps)[: record.steps] == STEPPING]
    sample = judged.followed.at(own).sample
    # What the stabiliser plans is a motion: its ZMP is that of its COM, moment and force.
    height = sample.com[:, 2] - sample.floor
    arm = height[:, None] * sample.force[:, :2] / sample.force[:, 2:]
    turn = sample.moment[:, ::-1] * (-1.0, 1.0) / sample.force[:, 2:]
    gap = np.abs(sample.com[:, :2] - arm + turn - sample.zmp)
    assert np.median(gap) < 1e-3
    # What it said before of the same instants is near.
    off = [rms(judged.followed.at(own, lead).zmp[:, 1] - sample.zmp[:, 1]) for lead in LEADS]
    assert off[0] == 0.0
    assert 0.0 < off[1] < 0.03
    assert max(off) < 0.1
    # It stands on its feet, and does not follow the COM.
    assert np.abs(judged.followed.at(own).feet[:, [2, 5]]).min() > -0.02
    assert np.abs(sample.com - measured.com[np.isin(judged.time, own)]).max() > 0.02


@pytest.mark.parametrize("floor", [-0.01, 0.006])
def test_a_floor_at_another_height_is_found_by_the_feet(floor):
    record = walked("stepping", floor=floor, steps=6)
    assert record.outcome.completed, record.outcome.cause
    height = record.com[record.time > 2.0, 2].mean()
    assert height - planned("stepping").run.gait.com_height == pytest.approx(floor, abs=0.003)


def test_a_walk_over_footsteps_is_the_fixed_stabilisers_and_steps_when_pushed():
    rows = routes.as_rows(routes.arc(5, 0.4, 1.0, 0.2))
    still, fixed = (
        walk_over(f"controller.stabilizer={name}", footsteps=rows) for name in ("stepping", "fixed")
    )
    assert first_difference(still, fixed) is None
    push = "disturbance.push_segment=com", "disturbance.push_x=150", "disturbance.push_at=2.5"
    assert walk_over(*push, footsteps=rows).outcome.completed


def test_a_pushed_walk_returns_to_its_planned_places_and_times():
    pushes = "disturbance.push_y=-150", "disturbance.push_at=1.64", "disturbance.push_segment=com"
    pushed, still = walk_over(*pushes, "gait.steps=13"), walk_over("gait.steps=13")
    off = np.abs(pushed.com - still.com)
    assert off[pushed.time < 3.0].max() > 0.05
    assert off[pushed.time > 7.5].max() < 0.005


@pytest.mark.parametrize(
    ("disturbance", "zmp_x"),
    [
        ("softness_factor=3", 0.003),  # a sole that tilts in it is not a slope
        ("softness_factor=6", math.inf),
        ("mass_segment=thorax mass_change=0.1", 0.01),
        ("mass_segment=all mass_change=-0.1", 0.025),
    ],
)
def test_a_softer_floor_and_other_masses_are_survived(disturbance, zmp_x):
    trial = walk_planned(plan_over(*(f"disturbance.{setting}" for setting in disturbance.split())))
    assert trial.record.outcome.completed
    judged = trial.comparison  # as far from the first plan as if it had not stepped
    assert rms((judged.measured.zmp - (judged.first or judged.sample).zmp)[judged.inside, 0]) < zmp_x


def test_a_com_that_sinks_for_lack_of_force_is_brought_back_to_its_height():
    it, speed, below = stepper(), 0.0, []
    it.state["force_factor"], com = 1.0, it.body.com
    for _ in range(4000):  # 3 % too little force, beside the controller's own spring and damper
        hold_height(it, 0.87)
        force = it.state["force_factor"][0] - 1.03
        speed += it.tick * (9.81 * force - 60.0 * (com[2] - 0.87) - 15.0 * speed)
        com[2] += it.tick * speed
        below.append(0.87 - com[2])
    assert max(below) > 0.003
    assert abs(below[-1]) < 0.1 * max(below)


def plan_over(*settings, footsteps=()):
    settings = ("simulation.time_step=0.002", "gait.steps=9", "controller.stabilizer=stepping", *settings)
    request = load_request("normal", settings, sections={"footsteps": footsteps} if footsteps else {})
    return plan_walk(request)


def walk_over(*settings, footsteps=()):
    walk = plan_over(*settings, footsteps=footsteps)
    return simulate(walk)
