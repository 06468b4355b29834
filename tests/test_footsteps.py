"""Walks over any footsteps: the linear solve, its plan, generators and files."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ampm
from ampm.exceptions import BodilyRefusal, InputError
from ampm.planner import routes
from ampm.planner.contacts import Footstep
from ampm.planner.footsteps import plan_footsteps
from tests.properties import assert_walk
from validation.trial.plan import make_body

BODY = make_body(ampm.load_run("normal")).model.description
SOLE = BODY.sole
WIDTH = 0.18
GAITS = {name: ampm.load_run(name, gait={"a_s": 3.0}) for name in ("normal", "momentum")}


def plan(footsteps, gait="normal", **more):
    return plan_footsteps(footsteps, GAITS[gait].gait, BODY, **more)


def turned(footsteps, angle, shift=(0.0, 0.0)):
    """The same walk elsewhere: turned about the origin, then shifted."""
    c, s = math.cos(angle), math.sin(angle)
    return [
        Footstep(step.foot, (c * x - s * y + shift[0], s * x + c * y + shift[1], z), step.heading + angle)
        for step in footsteps
        for x, y, z in [step.position]
    ]


WALKS = {
    "straight": routes.straight(10, 0.6, WIDTH),
    "backward": routes.straight(8, -0.3, WIDTH),
    "arc": routes.arc(9, 0.4, 1.0, WIDTH),
    "turn": routes.turn(8, math.pi / 2, WIDTH),
    "sidestep": routes.sidestep(10, 0.2, WIDTH),
    "slalom": routes.slalom(20, 0.4, 0.4, 8, WIDTH, toe_out=0.0),
    "stones": routes.stones(20, 0.5, WIDTH, seed=3),
}


@pytest.mark.parametrize(("gait", "steps"), [("normal", 45), ("momentum", 161)])
def test_the_middle_of_a_long_walk_is_the_closed_form_of_the_paper(gait, steps):
    run = GAITS[gait]
    length, width = run.gait.step_length, run.gait.step_width
    walk = plan(routes.straight(steps, length, width), gait)
    paper = ampm.plan(run)
    singles = walk.contacts.starts[walk.contacts.kind_codes == 0]
    first = steps // 2 + (steps // 2) % 2  # stands on the left foot, as the paper's first step
    times = np.linspace(0.0, 2.0 * paper.constants.step_duration, 101)[:-1]
    there, here = walk.sample(singles[first] + times), paper.sample(times)
    moved = there.com[:, 0] - walk.contacts.placements[walk.contacts.kind_codes == 0][first, 0, 0]
    np.testing.assert_allclose(moved, here.com[:, 0], rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(there.com[:, 1], here.com[:, 1], rtol=0.0, atol=1e-12)
    for name in ("com_velocity", "com_acceleration", "moment", "angular_momentum"):
        np.testing.assert_allclose(getattr(there, name), getattr(here, name), rtol=0.0, atol=1e-11)


@settings(max_examples=25, deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(-0.2, 0.6), st.floats(0.14, 0.3), st.floats(-0.3, 0.3), st.floats(0.6, 1.0)),
        min_size=2,
        max_size=12,
    ),
    st.sampled_from(sorted(GAITS)),
    st.booleans(),
)
def test_any_steps_are_walked_or_refused_by_name(steps, gait, timed):
    x = y = heading = time = 0.0
    footsteps, landings = (
        [Footstep("right", (0.0, -0.09, 0.0)), Footstep("left", (0.0, 0.09, 0.0))],
        [0.0, 0.0],
    )
    time = 0.8
    for k, (length, width, turn, duration) in enumerate(steps):
        heading += turn
        x, y = x + length * math.cos(heading), y + length * math.sin(heading)
        aside = -0.5 * width if k % 2 == 0 else 0.5 * width
        place = (x - aside * math.sin(heading), y + aside * math.cos(heading), 0.0)
        footsteps.append(Footstep("right" if k % 2 == 0 else "left", place, heading))
        landings.append(time + duration)
        time += duration + 0.15
    refusal = None
    try:
        walk = plan(footsteps, gait, landings=landings if timed else None)
    except BodilyRefusal as error:
        refusal = error
    if refusal is not None:
        assert str(refusal).startswith("footstep ")
        assert math.isfinite(refusal.value)
        return
    assert_walk(walk, SOLE)
    if timed:
        reached = walk.contacts.starts[2::2]
        np.testing.assert_allclose(reached, landings[2:], rtol=0.0, atol=1e-12)


def moved(steps, number, **change):
    """The footsteps, one of them changed."""
    return [step._replace(**change) if step is steps[number] else step for step in steps]


FILE = """foot, x, y, heading, time
right, 0, -0.09, 0,
left, 0, 0.09, 0,
right, 0.3, -0.09, 0, 1.5
left, 0.3, 0.09, 0.1,
"""


def test_a_file_of_footsteps(tmp_path, ampm):
    path = tmp_path / "walk.csv"
    path.write_text(FILE, encoding="utf-8")
    rows = routes.read_footsteps(path)
    assert rows[3] == {"foot": "left", "x": 0.3, "y": 0.09, "heading": 0.1}
    assert [row.get("time") for row in rows] == [None, None, 1.5, None]
    answer = ampm("plan", "normal", "--footsteps", path, "--plot", tmp_path / "walk.png", "--json")
    assert answer.status == 0
    assert answer.json["residuals"]["acceleration"] < 1e-12
    assert (tmp_path / "walk.png").stat().st_size > 10_000
    with pytest.raises(InputError, match=r"none\.csv"):
        routes.read_footsteps(tmp_path / "none.csv")
    path.write_text(FILE.replace("1.5", "15"), encoding="utf-8")  # it stands until then, as a trial does
    assert ampm("plan", "normal", "--footsteps", path, "--json").json["duration"] > 15.0


def test_targets_are_stood_at_one_after_the_other():
    generator = np.random.default_rng(5)
    targets = [tuple(generator.uniform(-1.0, 1.0, 3).tolist()) for _ in range(6)]
    footsteps = routes.visit(targets, 0.25, 0.24)
    assert_walk(plan(footsteps), SOLE)
    middle = np.array([step.position[:2] for step in footsteps])
    middle = 0.5 * (middle[1:] + middle[:-1])
    for x, y, _ in targets:
        assert np.hypot(*(middle - (x, y)).T).min() < 1e-12


@pytest.mark.parametrize("seed", range(5))
def test_no_step_to_a_target_goes_farther_aside_or_turns_more_than_it_may(seed):
    generator = np.random.default_rng(seed)
    targets = [tuple(generator.uniform(-1.5, 1.5, 3).tolist()) for _ in range(8)]
    length, width, aside, most = 0.16, 0.28, 0.06, 0.4
    footsteps = routes.visit(targets, length, width, aside=aside, turn=most)
    side = np.array([1.0 if step.foot == "left" else -1.0 for step in footsteps])
    heading = np.array([step.heading for step in footsteps]) - side * routes.TOE_OUT
    turn = np.remainder(np.diff(heading) + np.pi, 2.0 * np.pi) - np.pi
    assert np.abs(turn).max() <= most + 1e-9
    to_left = np.stack([-np.sin(heading), np.cos(heading)], axis=1)
    middle = np.array([step.position[:2] for step in footsteps]) - 0.5 * width * side[:, None] * to_left
    way = np.diff(middle, axis=0)
    left = (way * to_left[:-1]).sum(axis=1)
    assert np.hypot(*way.T).max() <= math.hypot(length, aside) + 1e-9
    outward = side[1:] * left
    assert outward.max() <= aside + 1e-9
    assert outward.min() >= -0.2 * aside - 1e-9
    fewer = routes.visit(targets, 2.0 * length, width, aside=2.0 * aside, turn=most)
    assert len(fewer) < len(footsteps)
