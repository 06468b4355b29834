"""The torque between two ticks: how it goes on, and what the walk gains by it."""

from functools import partial

import numpy as np
import pytest

import validation as val
from ampm.compiled import records
from ampm.control.hold import LARGEST_CHANGE, update_rate
from ampm.control.workspace import LINE, Joints
from ampm.run_file import load_run
from ampm.walk import ControlOutput
from validation.run.walk import walk

LIMIT = np.array([100.0, 50.0])
PERIOD = 0.002
STEP = 0.01 * LIMIT


def contact(touching=True, opening=1.0, planned=True):
    """Planned, touching, opening of a left heel; the right foot stands."""
    return planned, touching, opening


class Hold:
    """Rates from tick to tick."""

    def __init__(self):
        self.lines, self.first = records((2, 3), LINE), True
        self.joints = Joints(*np.zeros((6, 2)))._replace(torque_limit=LIMIT)
        for name in ("planned", "touching", "opening"):
            self.lines[name][1] = 1.0

    def rate(self, torque, heel, jumps):
        for name, value in zip(("planned", "touching", "opening"), heel, strict=True):
            self.lines[name][0, 0] = value
        self.joints.torque[:] = torque
        update_rate(self.joints, 1.0 / PERIOD, self.lines, jumps or self.first)
        self.joints.last_torque[:], self.first = torque, False
        return self.joints.rate.copy()


@pytest.fixture
def rates():
    """A hold that has seen two ticks of a steady slope."""
    it = Hold()
    np.testing.assert_array_equal(it.rate(0.0 * STEP, contact(), False), 0.0)  # nothing is known yet
    np.testing.assert_allclose(it.rate(STEP, contact(), False), STEP / PERIOD)
    return it


def test_a_large_change_is_carried_on_only_in_part(rates):
    rate = rates.rate(STEP - 10.0 * LIMIT, contact(), False)
    np.testing.assert_allclose(rate, -LARGEST_CHANGE * LIMIT / PERIOD)


@pytest.mark.parametrize(
    ("now", "goes_on"),
    [
        (contact(planned=False), True),
        (contact(opening=0.5), True),  # it has begun to open
        (contact(touching=False), False),  # of a line that is fully open it plays no part
    ],
)
def test_where_the_contact_changes_the_earlier_slope_goes_on(rates, now, goes_on):
    slope = STEP if goes_on else 2.0 * STEP
    np.testing.assert_allclose(rates.rate(3.0 * STEP, now, False), slope / PERIOD)
    np.testing.assert_allclose(rates.rate(5.0 * STEP, now, False), 2.0 * STEP / PERIOD)


def test_where_the_plan_jumps_the_torque_is_held(rates):
    np.testing.assert_array_equal(rates.rate(2.0 * STEP, contact(), True), 0.0)
    np.testing.assert_allclose(rates.rate(4.0 * STEP, contact(), False), 2.0 * STEP / PERIOD)


class Ramp:
    """Gives the same torque and rate at every tick."""

    def __init__(self, robot, run, rate):
        self.torque = 0.98 * robot.torque_limit
        self.rate = None if rate is None else np.full(robot.nu, rate)

    def update(self, state, touch, reference):
        return ControlOutput(self.torque, rate=self.rate)


def ramp(rate):
    """Torques of the first milliseconds, over the motors' limits, at four steps a tick."""
    record = walk(short(0.0005, 1), controller=partial(Ramp, rate=rate)).record
    return record.torque[:8] - 0.98 * record.torque_limit, 0.02 * record.torque_limit


def short(time_step, steps, **controller):
    return load_run(
        "normal", gait={"steps": steps}, simulation={"time_step": time_step}, controller=controller
    )


def test_the_torque_goes_on_with_its_rate_within_the_limits():
    above, room = ramp(1e3)
    since = np.array([0.0, 1.0, 2.0, 3.0] * 2)[:, None] * 0.0005
    np.testing.assert_allclose(above, np.minimum(1e3 * since, room), rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(ramp(None)[0], 0.0, rtol=0.0, atol=1e-9)


def test_between_ticks_a_slope_halves_the_error(run_of):
    """At four steps a tick; at one step a tick both are the same."""
    folders = run_of("normal", {"controller.hold": "zero-order"}), run_of()
    held, carried_on = (val.load(folder).summary["metrics"] for folder in folders)
    for name in ("zmp_x_rmse", "zmp_y_rmse"):
        assert carried_on[name]["value"] < 0.6 * held[name]["value"]
    one = [walk(short(0.002, 2, hold=hold)).record.q[300] for hold in ("zero-order", "first-order")]
    np.testing.assert_array_equal(one[0], one[1])
