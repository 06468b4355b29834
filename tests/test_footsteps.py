"""Walks over any footsteps: the linear solve, its plan, generators and files."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.image import imread

import ampm
from ampm import BodilyRefusal, Footstep, plan_footsteps
from ampm.planner import routes
from tests.properties import assert_walk
from tests.test_negative_controls import script
from validation.trial.plan import Request, make_body, plan_walk

BODY = make_body(ampm.load_run("normal")).model.description
SOLE = BODY.sole
WIDTH = 0.18
GAITS = {name: ampm.load_run(name, gait={"a_s": 3.0}) for name in ("normal", "momentum")}


def plan(footsteps, gait="normal"):
    return plan_footsteps(footsteps, GAITS[gait].gait, BODY)


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
    "arc": routes.arc(9, 0.4, -1.0, WIDTH),
    "turn": routes.turn(8, math.pi / 2, WIDTH),
    "sidestep": routes.sidestep(10, 0.2, WIDTH),
    "stones": script("footsteps").stones(20, 0.5, WIDTH, seed=3),
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


STEP = st.tuples(st.floats(-0.2, 0.6), st.floats(0.14, 0.3), st.floats(-0.3, 0.3), st.floats(0.6, 1.0))


@settings(max_examples=25, deadline=None)
@given(st.lists(STEP, min_size=2, max_size=12), st.sampled_from(sorted(GAITS)), st.booleans())
def test_any_steps_are_walked_or_refused_by_name(steps, gait, timed):
    x = y = heading = 0.0
    footsteps = [Footstep("right", (0.0, -0.09, 0.0)), Footstep("left", (0.0, 0.09, 0.0))]
    time = 0.8
    for k, (length, width, turn, duration) in enumerate(steps):
        heading += turn
        x, y = x + length * math.cos(heading), y + length * math.sin(heading)
        aside = -0.5 * width if k % 2 == 0 else 0.5 * width
        place = (x - aside * math.sin(heading), y + aside * math.cos(heading), 0.0)
        landing = time + duration if timed else None
        footsteps.append(Footstep("right" if k % 2 == 0 else "left", place, heading, landing))
        time += duration + 0.15
    try:
        walk = plan(footsteps, gait)
    except BodilyRefusal as error:
        known = str(error).startswith("footstep") and math.isfinite(error.value)
    else:
        assert_walk(walk, SOLE)
        landed = walk.contacts.starts[2::2]
        known = not timed or np.abs(landed - [step.time for step in footsteps[2:]]).max() < 1e-12
    assert known


def moved(steps, number, **change):
    """The footsteps, one of them changed."""
    return [step._replace(**change) if step is steps[number] else step for step in steps]


def easier(steps):
    """A walk over footsteps, for its refusal."""
    return plan_walk(Request("normal", GAITS["normal"].replace({}, footsteps=steps)))


@pytest.mark.parametrize("name", WALKS)
def test_eased_footsteps(name):
    """All of them are the walk itself, none is marching in place with the toes turned out as before."""
    walk = WALKS[name]
    width = abs(walk[1].position[1] - walk[0].position[1])

    def eased(share):
        run = GAITS["normal"].replace({}, footsteps=[step._replace(time=k) for k, step in enumerate(walk)])
        steps = routes.eased(run.footsteps, share, width)
        assert [step.time for step in steps] == list(range(len(walk)))
        return steps

    for one, other in zip(eased(1.0), walk, strict=True):
        np.testing.assert_allclose([*one.position, one.heading], [*other.position, other.heading], atol=1e-12)
    still = eased(0.0)
    middle = {np.round(np.add(a.position, b.position), 9).tobytes() for a, b in pairwise(still)}
    assert len(middle) == 1
    assert {(step.foot, step.heading) for step in still} == {(step.foot, step.heading) for step in walk[:2]}


def test_feet_that_are_turned_less_are_a_way_out():
    """As for a body whose thighs meet in turns."""
    run = GAITS["normal"].replace({}, footsteps=routes.turn(6, 0.6, 0.2))

    def plan(run):
        frames = [round(step.heading / 0.12, 6) % 1.0 for step in run.footsteps]
        if any(frames):
            raise BodilyRefusal("a", reason="b", value=0.0, limit=1.0, unit="m", way_out="c")

    assert routes.easier(run, plan) == "turn the toes of either foot in by 0.1 rad"


def test_a_plan_over_a_file_of_footsteps_and_its_picture(tmp_path, ampm):
    """It stands until the time of a landing, as a trial does."""
    path = tmp_path / "walk.csv"
    rows = ("right,0,-0.09,0,", "left,0,0.09,0,", "right,0.3,-0.09,0.1,15", "left,0.3,0.09,0,")
    path.write_text("\n".join(["foot,x,y,heading,time", *rows]), encoding="utf-8")
    answer = ampm("plan", "normal", "--footsteps", path, "--plot", tmp_path / "walk.png", "--json")
    assert answer.status == 0
    assert answer.json["duration"] > 15.0
    assert (tmp_path / "walk.png").stat().st_size > 10_000
    assert imread(tmp_path / "walk.png")[0, 0].tolist() == [1.0] * 4  # on white
