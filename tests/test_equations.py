"""The equations of motion of recorded steps, against bodies and forces that are known."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from tests.saved_run import walked
from tests.tiny import CORNERS, pinocchio_model, simulate, swinging
from tests.walk import without_point
from validation.measure.equations import Equations, check_equations
from validation.trial import bridge
from validation.trial.coordinates import PassiveJoints

ZERO = np.zeros(7)
NOTHING = PassiveJoints(damping=ZERO, stiffness=ZERO, rest=ZERO, friction=ZERO, implicit=False)


@pytest.fixture(scope="module")
def block():
    """A block that swings an arm between its stops, and its model written by hand."""
    model = pinocchio_model()
    names = [f"p{i}" for i in range(4)]
    for name, corner in zip(names, CORNERS, strict=True):
        place = pin.SE3(np.eye(3), np.array([*corner, 0.001]))
        model.addFrame(pin.Frame(name, 1, 0, place, pin.FrameType.OP_FRAME))
    record = simulate(500, torque=lambda time: 0.1 * np.sin(2 * np.pi * 1.5 * time), sink=0.0005)
    return replace(record, point_sites=tuple(names)), model


def check(record, model, passive=NOTHING) -> Equations:
    return check_equations(record, model, passive)


def test_the_block_obeys_them(block):
    found = check(*block)
    assert found.steps == 101  # one every 10 ms of a second, and the last
    assert found.largest < 1e-9 < 1e-4 < found.change


def test_a_joint_at_its_stop_shows(block):
    record, model = block
    found = check(replace(swinging(), point_sites=record.point_sites), model)
    assert found.coordinate == "swing"
    assert found.largest > 0.1
    assert found.median < 1e-9


def test_a_spring_that_a_torque_balances_changes_nothing(block):
    record, model = block
    stiffness, rest = 3.0 * np.eye(7)[6], 0.2 * np.eye(7)[6]  # [N m/rad], [rad]
    torque = record.tick_torque + 3.0 * (record.q[:-1, 7:] - 0.2)
    spring = NOTHING._replace(stiffness=stiffness, rest=rest)
    assert check(replace(record, tick_torque=torque), model, spring).largest < 1e-9


def test_what_is_missing_shows(block):
    record, model = block
    arm = model.joints[model.getJointId("swing")].idx_v
    damping = np.zeros(7)
    damping[arm] = 1.0  # [N m s/rad]
    damped = NOTHING._replace(damping=damping)
    turned = check(replace(record, tick_torque=record.tick_torque + 0.1), model)
    for wrong in (check(without_point(record), model), turned, check(record, model, damped)):
        assert wrong.median > 1e-3 * wrong.change
    assert turned.coordinate == "swing"


@pytest.mark.parametrize(
    "settings",
    [(), ("disturbance.push_y=40.0", "disturbance.push_at=0.5", "disturbance.joint_damping=1.0")],
    ids=["undisturbed", "pushed and damped"],
)
def test_a_walk_obeys_them(settings):
    planned, record = walked(2, settings, None)
    model = planned.scene.model.compile()

    def of(record, passive):
        twin = bridge.pinocchio_model(model)
        return check_equations(record, twin, passive)

    passive = bridge.passive_joints(model)
    found = of(record, passive)
    assert found.median < 1e-9 * found.change
    assert found.largest < 1e-2 * found.change  # MuJoCo's solver stops early at a light toe
    assert of(without_point(record), passive).median > 0.01 * found.change
    if settings:
        assert of(record, passive._replace(implicit=False)).median > 1e-3 * found.change
        unpushed = replace(record, external_force=np.zeros_like(record.external_force))
        assert of(unpushed, passive).largest > 1e-3
