"""Plans whose COM rises and sinks."""

import numpy as np
import pytest

import ampm
import validation as val
from ampm.planner.newton import check_newton
from tests.solved import COARSE, walk_of

RISE = 0.005
"""Amplitude of the height [m]: once up and down a step, highest in mid-stance."""


class Bounce:
    """The AMPM's COM across the floor, over a height that varies; the ZMP follows by Newton's law."""

    plans_footsteps = False

    def __init__(self, rise=RISE, **changed):
        self.rise, self.changed = rise, changed

    def plan(self, run, robot):
        base = ampm.plan(run)
        single, period = base.constants.single_support_duration, base.constants.step_duration
        times = np.linspace(0.0, base.duration, int(200 * base.duration) + 1)
        sample, omega = base.sample(times), 2.0 * np.pi / period
        high = run.gait.com_height + self.rise * (np.cos(omega * (times - 0.5 * single)) - 1.0)
        motion = {"com": np.column_stack([sample.com[:, :2], high])}
        motion |= {"com_acceleration": sample.com_acceleration[:, :2]}
        return ampm.make_plan(run, robot, times=times, contacts=base.contacts, **motion | self.changed)


def test_force_and_zmp_follow_the_height():
    bouncing = plan()
    times = np.linspace(0.05, bouncing.duration - 0.05, 501)
    sample, omega = bouncing.sample(times), 2.0 * np.pi / bouncing.constants.step_duration
    lift = sample.force[:, 2] / bouncing.weight - 1.0
    assert np.ptp(lift) == pytest.approx(2.0 * RISE * omega**2 / 9.81, rel=0.01)
    line = sample.com[:, :2] - sample.com[:, 2:] * sample.force[:, :2] / sample.force[:, 2:]
    np.testing.assert_allclose(sample.zmp, line, atol=1e-12)  # the force passes through the COM
    assert check_newton(bouncing) < 1e-4


class Careless(Bounce):
    """Changes its robot, which is its own."""

    def plan(self, run, robot):
        plan = super().plan(run, robot)
        robot.model.gravity.linear = np.zeros(3)
        robot.shapes.boxes[0][:] = 0.0
        return plan


def test_a_walk_with_a_varying_height_is_met():
    run = ampm.load_run("normal", gait={"steps": 3}, simulation={"time_step": 0.002}).as_is()
    trial = val.walk(run, planner=Careless())
    assert trial.run.gait.planner == f"{__name__}:Careless"
    assert type(trial.plan.posture).__name__ == "PeriodicPosture"
    assert trial.verdict.passed, trial.verdict.reason
    assert trial.summary["margins"]["clearance"]["value"] < 0.05
    assert np.ptp(trial.measured.com[:, 2]) == pytest.approx(2.0 * RISE, rel=0.1)


def plan(slope=0.0, **changed):
    """Plan of the walk that all tests share."""
    return Bounce(**changed).plan(walk_of(COARSE).run.replace({"gait.slope": slope}), walk_of(COARSE).robot)
