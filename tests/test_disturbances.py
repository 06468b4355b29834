"""Pushes and other disturbances of a walk, and the stabiliser that steps; golden.csv has its figures."""

import json
from functools import cache

import numpy as np
import pytest

import validation as val
from ampm.planner import routes
from ampm.planner.newton import zmp_of_com
from docs.examples.joint_pd import JointPD
from tests.records import first_difference, same_bits, stored
from tests.solved import COARSE, body_of, simulated, walk_of
from tests.test_golden import definition
from validation.judge.built_in import rms
from validation.judge.compare import compare
from validation.judge.metrics import evaluate
from validation.measure.measure import measure
from validation.run.replay import replay
from validation.trial import scene
from validation.trial.disturbances import Push, Recorded
from validation.trial.followed import LEADS, STEPPING
from validation.trial.plan import load_request, plan_walk
from validation.trial.shapes import Shapes
from validation.trial.simulate import simulate

SHOVE = Push("chest", (0.0, 30.0, 0.0), at=0.6, duration=0.1)


@cache
def walk(*disturbances, **options):
    return simulated(disturbances=disturbances, **options)


def test_a_push_is_recorded_where_and_when_it_acts(tmp_path):
    record = walk(SHOVE)
    assert Push("chest", np.array([0, 30, 0]), 0.6, 0.1) == SHOVE  # type: ignore[arg-type]
    assert record.outcome.completed
    assert record.external_segments == ("thorax",)
    pushed = (record.time[:-1] > 0.5999) & (record.time[:-1] < 0.6999)
    assert (record.external_force[pushed, 0] == SHOVE.force).all()
    assert not record.external_force[~pushed].any()
    assert not record.external_moment.any()
    assert (walk().external_segments, walk().controller) == ((), "")
    measured = measure(record, walk_of(COARSE).robot.model)  # left out, the push would move this ZMP by 56 mm
    np.testing.assert_allclose(measured.zmp, measured.zmp_momentum, rtol=0.0, atol=1e-6)
    gained = (record.com - walk().com)[record.time.searchsorted(0.8)]
    assert gained[1] > 1e-3
    assert first_difference(record, stored(record, body_of().xml, tmp_path)) is None


class Once:
    left = 50

    def apply(self, time, plant):
        self.left -= 1
        if self.left >= 0:
            plant.push("chest", (0.0, 30.0, 0.0))


def test_every_walk_begins_with_a_disturbance_as_it_was_given():
    once = Once()
    forces = [simulated(steps=1, disturbances=[once]).external_force for _ in range(2)]
    assert same_bits(*forces)
    assert (np.count_nonzero(forces[0]), once.left) == (50, 50)


def test_pushes_add_up_and_a_force_lifts():
    up = Push("chest", (0.0, 0.0, 20.0), at=0.0, duration=10.0)
    record = walk(up, up, steps=1)
    np.testing.assert_array_equal(record.external_force[:, 0, 2], 40.0)
    measured = measure(record, walk_of(COARSE).robot.model)
    assert measured.force[100:, 2].mean() == pytest.approx(measured.weight - 40.0, rel=0.02)
    assert abs(measured.self_checks.impulse_residual) < 1e-3


@cache
def disturbed(steps=2, **values):
    """A short walk with some keys of the section ``disturbance``."""
    return simulated(*(f"disturbance.{key}={value}" for key, value in values.items()), steps=steps)


def test_a_com_push_adds_momentum_and_no_angular_momentum():
    plain, record = walk(), walk(Push("com", (60.0, 0.0, 0.0), at=0.3, duration=0.02), steps=1)
    assert record.external_segments == ("pelvis",)
    k = record.time.searchsorted(0.31)
    lever = record.com[k] - record.external_position[k, 0]
    np.testing.assert_allclose(
        record.external_moment[k, 0], np.cross(lever, record.external_force[k, 0]), rtol=0.0, atol=1e-9
    )
    assert abs(lever[2]) > 0.02
    gained = record.com[:, 0] - plain.com[: len(record.com), 0]
    rows = record.time.searchsorted([0.3199, 0.3239])
    speed = np.diff(gained[rows]) / np.diff(record.time[rows])
    assert speed == pytest.approx(60.0 * 0.02 / record.mass, rel=0.3)
    measured = measure(record, walk_of(COARSE).robot.model)
    assert same_bits(simulated(disturbances=[Recorded(record)], steps=1).q, record.q)
    # Without the push they would be 40 mm apart, without its moment 4 mm.
    np.testing.assert_allclose(measured.zmp, measured.zmp_momentum, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(measured.force, measured.momentum_force, rtol=0.0, atol=1e-2)


class Speed:
    read: list = []

    def apply(self, time, plant):
        self.read.append([of(name) for of in (plant.position, plant.velocity) for name in ("com", "chest")])


def test_velocities_are_the_rates_of_positions_and_reading_them_changes_no_bit():
    record = simulated(disturbances=[Speed()], steps=1)
    assert same_bits(record.q, simulated(steps=1).q)
    read = np.array(Speed.read)
    rates = np.diff(read[:, :2], axis=0) / record.time_step
    np.testing.assert_allclose(rates, read[1:, 2:], rtol=0.0, atol=4e-3)


def test_the_velocity_at_the_start_repeats_with_its_seed():
    starts = [disturbed(steps=1, start_velocity=0.02, seed=seed).qd[0] - walk().qd[0] for seed in (0, 1)]
    for start in starts:
        assert 1e-3 < np.abs(start[:3]).max() < 0.08
        assert not start[3:].any()
    assert (starts[0] != starts[1]).any()


def test_the_controller_gets_no_information_on_disturbances():
    class Spy(JointPD):
        runs: list = []

        def __init__(self, robot, run):
            super().__init__(robot, run)
            self.runs.append((run, robot.mass))

    record = simulated("disturbance.mass_change=0.2", "sensors.angle_noise=1e-3", controller=Spy, steps=1)
    run, mass = Spy.runs[0]
    assert run.disturbance == type(run.disturbance)()
    assert run.sensors == type(run.sensors)()
    assert mass == pytest.approx(walk().mass)
    assert record.mass == pytest.approx(1.2 * mass)


def test_all_disturbances_together_replay_to_the_bit_from_their_folder(run_of):
    """The walk in golden.csv has nearly every key of the section."""
    folder = run_of(**definition("disturbed"))
    assert replay(folder).identical
    known = json.loads((folder / "summary.json").read_text())["disturbances"]
    assert "disturbance.slope_along = 0.005" in known


AT = 1.64
"""Middle of the third single support of ``normal``, on the left foot [s]."""
SHOVES = {"forward": (300, 0, 0), "backward": (-300, 0, 0), "wider": (0, -150, 0), "narrower": (0, 105, 0)}
"""Pushes at the chest for 0.1 s that the fixed stabiliser does not survive [N]."""


@cache
def planned(stabilizer, slope=0.0):
    settings = f"gait.cross_slope={slope} simulation.time_step=0.002 controller.stabilizer={stabilizer}"
    return plan_walk(load_request("normal", ["gait.steps=9", *settings.split()]))


@cache
def walked(stabilizer, force, slope=0.0):
    return simulate(planned(stabilizer, slope), disturbances=[Push("chest", force, AT, 0.1)])


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


def test_steps_elsewhere_are_judged_by_what_was_planned_then():
    """Against the first plan a walk that steps 0.2 m elsewhere is wrong for good."""
    walk, record = planned("stepping", 0.05), walked("stepping", SHOVES["wider"], 0.05)
    measured = measure(record, walk.body.robot.model)
    judged = compare(walk.plan, record, measured)
    metrics = evaluate(judged)
    assert judged.first is not None
    assert metrics["zmp_y_rmse"] < 0.5 * rms((measured.zmp - judged.first.zmp)[judged.inside, 1])
    assert 0.05 < metrics["plan_moved_zmp_maximum"] < 1.0
    assert (record.tick_plan == STEPPING).any()
    assert not record.tick_plan[record.tick_time < AT].any()
    own = judged.sample.time[np.repeat(record.tick_plan, record.substeps)[: record.steps] == STEPPING]
    sample = judged.followed.at(own)
    # What the stabiliser plans is a motion: its ZMP is that of its COM, moment and force.
    assert np.median(np.abs(zmp_of_com(sample) - sample.zmp)) < 1e-3
    # What it said before of the same instants is near.
    off = [rms(judged.followed.at(own, lead).zmp[:, 1] - sample.zmp[:, 1]) for lead in LEADS]
    assert off[0] == 0.0 < off[1] < max(off) < 0.1
    # It stands on the slope of the floor, and does not follow the COM.
    ahead = judged.followed.at(own, max(LEADS))
    stands = ahead.feet.reshape(-1, 2, 3)[ahead.phase == 0, ahead.stance[ahead.phase == 0]]
    assert np.abs(stands[:, 2] - 0.05 * stands[:, 1]).mean() < 5e-4
    assert np.abs(sample.com - measured.com[np.isin(judged.time, own)]).max() > 0.02


@pytest.mark.parametrize(("floor", "step"), [(-0.01, 0.0), (0.006, -0.004)])
def test_a_floor_at_another_height_is_found_by_the_feet(floor, step):
    heights = f"disturbance.floor_height={floor}", f"disturbance.step_height={step}"
    record = walk_over("gait.steps=9", *heights)
    np.testing.assert_allclose(record.floor, sorted({floor, floor + step}))
    world = plan_walk(load_request("normal", heights)).scene.model.compile()
    half, at = (values[world.geom_bodyid == 0, :2] for values in (world.geom_size, world.geom_pos))
    whole = np.ptp(np.vstack([at - half, at + half]), axis=0)
    assert 4.0 * half.prod(axis=1).sum() == pytest.approx(whole.prod(), abs=1e-4, rel=0.0)  # no gap
    assert record.outcome.completed, record.outcome.cause
    height = record.com[record.time > 2.0, 2].mean()
    loaded = record.point_force[..., 2] > 5.0
    assert np.median(record.point_position[..., 2][loaded]) == pytest.approx(floor, abs=1e-3)
    assert height - planned("stepping").run.gait.com_height == pytest.approx(floor, abs=0.003)


@pytest.mark.parametrize(
    ("stabilizer", "floor", "limit"),
    [
        ("fixed", "slope_along=0.0349", 0.0075),
        ("fixed", "step_height=0.01", 0.02),
        ("stepping", "slope_along=0.0185 disturbance.slope_across=0.0185", 0.006),
        ("stepping", "step_height=0.01", 0.02),
    ],
)
def test_a_slope_is_one_if_the_feet_rise_by_it(stabilizer, floor, limit, monkeypatch):
    def under_ball(body, step, *rest):  # a stone that tilts the foot and hardly lifts it
        low, high = place(body, step, *rest)
        low[0] = step.position[0] + body.description.sole.heel_x + 0.65 * body.description.sole.length
        return low, high

    place = scene._place
    monkeypatch.setattr(scene, "_place", under_ball)
    settings = (
        f"simulation.time_step=0.002 controller.stabilizer={stabilizer} gait.steps=9 disturbance.{floor}"
    )
    assert val.walk(load_request("normal", settings.split()).run).metrics["zmp_x_rmse"].value < limit


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


@pytest.mark.parametrize("footsteps", [(), routes.arc(5, 0.4, 1.0, 0.2)], ids=len)
def test_an_undisturbed_walk_is_the_fixed_stabilisers_to_the_bit(footsteps):
    names = ("fixed", "stepping")
    walks = (walk_over(f"controller.stabilizer={n}", "gait.steps=4", footsteps=footsteps) for n in names)
    assert first_difference(*walks) is None
