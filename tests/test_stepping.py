"""The stepping stabiliser: walks that are pushed or find the floor elsewhere; golden.csv has its figures."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from ampm.planner import routes
from ampm.planner.newton import zmp_of_com
from tests.records import first_difference
from validation.judge.built_in import rms
from validation.judge.compare import compare
from validation.judge.metrics import evaluate
from validation.measure.measure import measure
from validation.trial.disturbances import Push
from validation.trial.followed import LEADS, STEPPING
from validation.trial.plan import load_request, plan_walk
from validation.trial.shapes import Shapes
from validation.trial.simulate import simulate

AT = 1.64
"""Middle of the third single support of ``normal``, on the left foot [s]."""
SHOVES = {"forward": (300, 0, 0), "backward": (-300, 0, 0), "wider": (0, -150, 0), "narrower": (0, 105, 0)}
"""Pushes at the chest for 0.1 s that the fixed stabiliser does not survive [N]."""


@cache
def planned(stabilizer):
    settings = ["gait.steps=9", "simulation.time_step=0.002", f"controller.stabilizer={stabilizer}"]
    return plan_walk(load_request("normal", settings))


@cache
def walked(stabilizer, force):
    return simulate(planned(stabilizer), disturbances=[Push("chest", force, AT, 0.1)])


@pytest.mark.parametrize(
    "direction", [name if name == "wider" else pytest.param(name, marks=pytest.mark.slow) for name in SHOVES]
)
def test_a_push_that_is_too_much_for_planned_steps_is_survived_by_other_steps(direction):
    force = SHOVES[direction]
    assert not walked("fixed", force).outcome.completed
    record = walked("stepping", force)
    assert record.outcome.completed, record.outcome.cause
    legs = Shapes(planned("stepping").body.model.compile(), only_legs=True)
    assert legs.recorded_gaps(record.q[::8]).distance.min() > 0.0


def test_feet_that_turn_do_not_meet():
    """A push narrows a step of a turn in place, where feet beside each other take more than their widths."""
    request = load_request("normal", ["simulation.time_step=0.002", "controller.stabilizer=stepping"])
    rows = routes.as_rows(routes.turn(10, 2.2, 0.22))
    walk = plan_walk(replace(request, run=request.run.replace({}, footsteps=rows)))
    heading = walk.plan.contacts.headings[5]
    force = (120.0 * np.sin(heading), -120.0 * np.cos(heading), 0.0)
    record = simulate(walk, disturbances=[Push("chest", force, 2.36, 0.1)])
    assert record.outcome.completed
    assert record.changes == 1
    assert walk.body.shapes.recorded_gaps(record.q[::4]).distance.min() > 0.01


def test_steps_elsewhere_are_judged_by_what_was_planned_then():
    """Against the first plan a walk that steps 0.2 m elsewhere is wrong for good."""
    walk, record = planned("stepping"), walked("stepping", SHOVES["wider"])
    measured = measure(record, walk.body.robot.model)
    judged = compare(walk.plan, record, measured)
    metrics = evaluate(judged)
    assert judged.first is not None
    first = rms((measured.zmp - judged.first.zmp)[judged.inside, 1])
    assert metrics["zmp_y_rmse"] < 0.5 * first
    assert 0.05 < metrics["plan_moved_zmp_maximum"] < 1.0
    assert metrics["plan_changes"] >= 1.0
    assert (record.tick_plan == STEPPING).any()
    assert not record.tick_plan[record.tick_time < AT].any()
    own = judged.sample.time[np.repeat(record.tick_plan, record.substeps)[: record.steps] == STEPPING]
    sample = judged.followed.at(own)
    # What the stabiliser plans is a motion: its ZMP is that of its COM, moment and force.
    assert np.median(np.abs(zmp_of_com(sample) - sample.zmp)) < 1e-3
    # What it said before of the same instants is near.
    off = [rms(judged.followed.at(own, lead).zmp[:, 1] - sample.zmp[:, 1]) for lead in LEADS]
    assert off[0] == 0.0 < off[1] < max(off) < 0.1
    # It stands on its feet, and does not follow the COM.
    assert np.abs(judged.followed.at(own).feet[:, [2, 5]]).min() > -0.02
    assert np.abs(sample.com - measured.com[np.isin(judged.time, own)]).max() > 0.02


@pytest.mark.parametrize("floor", [-0.01, 0.006])
def test_a_floor_at_another_height_is_found_by_the_feet(floor):
    record = walk_over("gait.steps=9", f"disturbance.floor_height={floor}")
    assert record.outcome.completed, record.outcome.cause
    height = record.com[record.time > 2.0, 2].mean()
    assert height - planned("stepping").run.gait.com_height == pytest.approx(floor, abs=0.003)


def test_a_pushed_walk_returns_to_its_planned_places_and_times():
    pushes = "disturbance.push_y=-150", "disturbance.push_at=1.64", "disturbance.push_segment=com"
    pushed, still = walk_over("gait.steps=13", *pushes), walk_over("gait.steps=13")
    off = np.abs(pushed.com - still.com)
    assert off[pushed.time < 3.0].max() > 0.05
    assert off[pushed.time > 7.5].max() < 0.005


def walk_over(*settings, footsteps=()):
    settings = ("simulation.time_step=0.002", "controller.stabilizer=stepping", *settings)
    request = load_request("normal", settings, sections={"footsteps": footsteps} if footsteps else {})
    return simulate(plan_walk(request))


@pytest.mark.parametrize("footsteps", [(), routes.as_rows(routes.arc(5, 0.4, 1.0, 0.2))], ids=len)
def test_an_undisturbed_walk_is_the_fixed_stabilisers_to_the_bit(footsteps):
    names = ("fixed", "stepping")
    walks = (walk_over(f"controller.stabilizer={n}", "gait.steps=4", footsteps=footsteps) for n in names)
    assert first_difference(*walks) is None
