"""Walks over footsteps: their feet, their files, and the trial from standing to standing."""

import math

import numpy as np
import pytest

import ampm
import validation as val
from ampm import FootstepPlanner, plan_footsteps
from ampm.body.constant_posture import ConstantPosture
from ampm.planner import routes
from ampm.planner.footstep_walk import plan_footstep_walk
from ampm.planner.periodic import plan_gait
from ampm.planner.rest_to_rest import SETTLING
from ampm.planner.support import plan_steps
from ampm.planner.swings import plan_swings
from tests.test_footsteps import BODY, WALKS, turned
from validation.trial.plan import Request, load_request, plan_walk

RUN = ampm.load_run("normal")
CONSTANTS = plan_gait(RUN.gait, 60.0).constants


def over(footsteps, run=RUN):
    return run.replace({}, footsteps=footsteps)


def plan(footsteps, run=RUN):
    return plan_footstep_walk(over(footsteps, run), BODY)


class Changed:
    """Walks other footsteps than those of the run."""

    def __init__(self, *rows):
        self.rows = rows

    def plan(self, run, robot):
        return FootstepPlanner().plan(run.replace({}, footsteps=self.rows), robot)


ROWS = RUN.replace({}, footsteps=routes.straight(4, 0.3, 0.2)).model_dump()["footsteps"]
ROWS[3]["time"] = 2.2  # [s]


def strayed(*rows, **keys):
    """The footsteps :data:`ROWS` of a run, for which a planner plans others."""
    run = RUN.replace(keys) if keys else RUN.replace({}, footsteps=ROWS)
    plan_walk(Request("walk", run), planner=Changed(*rows))


@pytest.mark.parametrize("gait", ["normal", "momentum"])
def test_a_walk_is_the_same_wherever_it_begins(gait):
    angle, shift, run = 2.0, np.array([3.0, -4.0, 0.0]), ampm.load_run(gait, gait={"a_s": 3.0})
    here, there = (plan(turned(WALKS["stones"], *to), run) for to in ((0.0,), (angle, shift)))
    times = np.linspace(0.0, here.duration, 300)
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    one, other = here.sample(times), there.sample(times)
    np.testing.assert_allclose(one.com @ turn.T + shift, other.com, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(one.zmp @ turn[:2, :2].T + shift[:2], other.zmp, rtol=0.0, atol=1e-10)
    for name in ("com_velocity", "com_acceleration", "moment", "angular_momentum"):
        turned_one = getattr(one, name)[:, :2] @ turn[:2, :2].T
        np.testing.assert_allclose(turned_one, getattr(other, name)[:, :2], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(one.right_load, other.right_load, rtol=0.0, atol=1e-9)
    for one, other in zip(here.feet.sample(times), there.feet.sample(times), strict=True):
        for name in ("velocity", "acceleration"):
            np.testing.assert_allclose(getattr(one, name) @ turn.T, getattr(other, name), atol=1e-8)
        np.testing.assert_allclose(one.sole_points @ turn.T + shift, other.sole_points, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(one.pitch, other.pitch, rtol=0.0, atol=1e-9)


def test_equal_steps_have_the_feet_of_the_periodic_gait():
    gait = RUN.gait.model_copy(update={"a_s": 2.8, "steps": 2})
    centroidal = plan_footsteps(routes.straight(24, gait.step_length, gait.step_width), gait, BODY)
    feet = plan_swings(centroidal, RUN.foot, BODY.sole, gait.step_length)
    periodic = plan_steps(gait, BODY.mass, RUN.foot, BODY.sole)
    first = 12  # stands on the left foot, as the first periodic step does
    times = np.linspace(0.0, 2.0 * periodic.constants.step_duration, 200)[:-1]
    shift = [centroidal.contacts.placements[1 + 2 * first, 0, 0], 0.0, 0.0]
    there = feet.sample(centroidal.contacts.starts[1::2][first] + times)
    for one, other in zip(there, periodic.feet.sample(times), strict=True):
        np.testing.assert_allclose(one.position - shift, other.position, rtol=0.0, atol=1e-9)
        for name in ("pitch", "toe", "contact"):
            np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=0.0, atol=1e-9)


def stop_and_go(pause=1.0):
    """Four steps of 0.5 m, a stand, as many again, of which the first has a time."""
    footsteps = routes.route([(0.5 * k, 0.0, 0.0) for k in (0, 1, 2, 3, 3, 4, 5, 6)], 0.2)
    stopped = SETTLING + 4.0 * CONSTANTS.step_duration - CONSTANTS.double_support_duration
    landing = stopped + 2.0 * SETTLING + pause + CONSTANTS.single_support_duration
    footsteps[6] = footsteps[6]._replace(time=landing)
    return footsteps


def test_a_landing_that_leaves_the_time_is_waited_for_on_both_feet():
    footsteps = stop_and_go(0.7)
    again = footsteps[6].time + 3.0 - SETTLING - CONSTANTS.single_support_duration
    footsteps[2] = footsteps[2]._replace(time=3.0)  # it starts late, too
    footsteps[6] = footsteps[6]._replace(time=again)
    walk = plan_footstep_walk(RUN.replace({}, footsteps=footsteps), BODY)
    landed = [phase.start for phase in walk.contacts.phases[2::2]]
    assert landed[0] == pytest.approx(3.0)
    assert landed[4] == pytest.approx(again)
    assert max(walk.residuals().values()) < 1e-9
    stand = walk.sample(landed[3] + SETTLING + np.linspace(0.0, 0.7, 20))
    np.testing.assert_allclose(stand.com_velocity, 0.0, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(stand.com[:, 0], 1.5, rtol=0.0, atol=1e-9)


def after_a_stand(number, **change):
    """A plan of footsteps with a stand, one of them changed."""
    rows = [*RUN.replace({}, footsteps=stop_and_go()).model_dump()["footsteps"]]
    rows[number] |= change
    return plan_footstep_walk(RUN.replace({}, footsteps=rows), BODY)


SHORT = """foot,x,y,heading,z,time
right,0,-0.1,0,,
left,0,0.1,0,,
right,0.4,-0.1,0,,1.4
left,0.8,0.1,0,0.05,
right,0.8,-0.1,0,0.05,
"""


def test_footsteps_of_a_file_walk_and_are_read_back(tmp_path, ampm):
    path, out = tmp_path / "walk.csv", tmp_path / "run"
    path.write_text(SHORT, encoding="utf-8")
    disturbed = ["--set", "disturbance.start_velocity=1e-6"]
    answer = ampm("validate", "normal", "--footsteps", path, *disturbed, "--out", out, "--json")
    assert answer.status in (0, 1), answer.err
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "Disturbed, unknown to plan and controller: disturbance.start_velocity = 1e-06." in page
    assert "stride" not in page  # steps differ
    facts = [answer.json[name] for name in ("outcome", "planner", "steps_completed")]
    assert facts == ["completed", "footsteps", 3]
    for axis in "xy":  # everything from the first motion on
        assert answer.json["metrics"][f"zmp_{axis}_rmse"]["value"] < 1.5e-3
    saved = val.load(out)
    assert saved.parameters.footsteps == RUN.replace({}, footsteps=routes.read_footsteps(str(path))).footsteps
    walk = saved.plan()
    assert walk is not None
    zmp = walk.sample(saved.signals.time).zmp
    np.testing.assert_allclose(zmp[:, 0], saved.signals["plan_zmp_x"], rtol=0.0, atol=1e-12)
    assert ampm("replay", out).status == 0
    assert "walks its footsteps" in ampm("plan", out / "run.toml", "--set", "gait.steps=7").err


@pytest.mark.parametrize("heading", [3.0, 6.9])
def test_a_walk_may_begin_in_any_heading(heading):
    run = RUN.replace({"simulation.time_step": 2e-3})
    assert val.walk(run, footsteps=turned(routes.straight(4, 0.4, 0.2), heading)).verdict.passed


def test_posture_follows_the_heading_of_the_feet():
    footsteps = turned(WALKS["turn"], 0.7)
    walk = plan_walk(load_request("normal", sections={"footsteps": footsteps})).plan
    posture, h = walk.posture, 1e-5
    assert isinstance(posture, ConstantPosture)
    times = np.linspace(0.1, walk.duration - 0.1, 200)
    low, mid, high = (posture.heading(times + shift) for shift in (-h, 0.0, h))
    np.testing.assert_allclose((high[0] - low[0]) / (2 * h), mid[1], atol=1e-7)
    np.testing.assert_allclose((high[1] - low[1]) / (2 * h), mid[2], atol=1e-5)
    ends = posture.heading(np.array([0.0, walk.duration]))[0]  # the mean of feet that are turned out
    np.testing.assert_allclose(ends, [0.7, 0.7 + math.pi / 2], rtol=0.0, atol=1e-12)
