"""Measurement and equations of motion against bodies whose forces, momenta and ZMP are known."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from tests.saved_run import walked
from tests.tiny import ARM_MASS, CORNERS, GRAVITY, MASS, pinocchio_model, simulate, swinging
from tests.walk import without_point
from validation.judge.built_in import rms
from validation.measure.measure import Equations, centre_of_pressure, check_equations, measure
from validation.trial import bridge
from validation.trial.coordinates import PassiveJoints

WEIGHT = (MASS + ARM_MASS) * GRAVITY


def measured_of(record, **changed):
    return measure(replace(record, **changed), pinocchio_model())


@pytest.fixture(scope="module")
def swing():
    record = swinging()
    return record, measured_of(record)


def zmp_gap(measured):
    """RMS distance of the two measured ZMPs [m]."""
    return rms(np.linalg.norm(measured.zmp - measured.zmp_momentum, axis=1))


def force_gap(measured):
    """RMS distance of force and m (a + g) [N]."""
    return rms(np.linalg.norm(measured.force - measured.momentum_force, axis=1))


def test_a_still_block_weighs_its_weight_under_its_com():
    still = measured_of(simulate(steps=2000))
    rest = still.time >= 3.5
    force = still.force[rest].mean(axis=0)
    np.testing.assert_allclose(force, [0.0, 0.0, WEIGHT], rtol=0.0, atol=1e-6 * WEIGHT)
    # The hinge has no damping, so the arm must hang plumb for the block to be still: it does.
    np.testing.assert_allclose(still.zmp[rest].mean(axis=0), still.com[rest, :2].mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(still.zmp[-1], [0.0, 0.02 * ARM_MASS / (MASS + ARM_MASS)], atol=1e-5)
    assert abs(still.self_checks.impulse_residual) < 1e-6


def test_falling_body_has_no_zmp_and_loses_momentum_by_its_weight():
    measured = measured_of(simulate(steps=50, height=1.0))
    for name in ("zmp", "zmp_momentum", "polygon_margin"):
        assert np.isnan(getattr(measured, name)).all(), name
    np.testing.assert_allclose(measured.momentum_force, 0.0, rtol=0.0, atol=1e-9)
    assert not measured.foot_contact.any()


def test_contact_zmp_of_hand_made_forces(swing):
    record = swing[0]
    force = np.zeros_like(record.point_force)
    position = np.zeros_like(record.point_position)
    force[:, 0], force[:, 3] = [10.0, -5.0, 90.0], [0.0, 5.0, 30.0]
    position[:, 0], position[:, 3] = [0.3, 0.2, 0.0], [-0.1, -0.4, -0.01]
    made = measured_of(record, point_force=force, point_position=position)
    # A force under the floor is carried up its own line of action: (0, 5, 30) moves by 0.01 / 6 in y.
    np.testing.assert_allclose(made.zmp[:, 0], (0.3 * 90 - 0.1 * 30) / 120)
    np.testing.assert_allclose(made.zmp[:, 1], (0.2 * 90 + (-0.4 + 0.01 * 5 / 30) * 30) / 120)
    np.testing.assert_allclose(made.foot_force[:, 1], np.tile([0.0, 5.0, 30.0], (record.steps, 1)))


def test_the_two_zmps_agree_while_the_zmp_moves_by_centimetres(swing):
    _, measured = swing
    assert np.ptp(measured.zmp[:, 0]) > 0.05
    checks = measured.self_checks
    assert zmp_gap(measured) < 1e-6
    assert force_gap(measured) < 1e-5 * WEIGHT
    assert max(checks.com_agreement, checks.angular_momentum_agreement) < 1e-12
    assert abs(checks.impulse_residual) < 1e-6


def test_the_gap_of_the_two_zmps_does_not_depend_on_the_time_step():
    for dt in (0.004, 0.002, 0.0005):
        assert zmp_gap(measured_of(swinging(steps=round(0.6 / dt), dt=dt))) < 1e-6


@pytest.mark.parametrize("index", [None, 0, 1, 2, 3])
def test_a_contact_left_out_of_the_log_breaks_the_agreement(swing, index):
    broken = measured_of(without_point(swing[0], index))
    assert zmp_gap(broken) > 5e-3
    assert force_gap(broken) > 0.05 * WEIGHT
    assert abs(broken.self_checks.impulse_residual) > 0.05


def test_zmp_lies_in_the_hull_of_the_loaded_points(swing):
    _, measured = swing
    loaded = measured.point_contact.sum(axis=1) == 4
    assert loaded.any()
    assert measured.polygon_margin[loaded].min() > 0.0
    x, y = np.abs(np.array(CORNERS)[0])
    shift = np.abs(measured.zmp - swing[0].q[:-1, :2])
    rectangle = np.minimum(x - shift[:, 0], y - shift[:, 1])
    np.testing.assert_allclose(measured.polygon_margin[loaded], rectangle[loaded], atol=2e-3)


def test_slip_is_the_way_slid_since_touch_down(swing):
    record = swing[0]
    place, force = np.zeros_like(record.point_place), np.zeros_like(record.point_force)
    place[..., 0], place[..., 1] = 0.03 * record.time[:, None], 0.04 * record.time[:, None]
    force[10:60, 0, 2] = force[100:150, 0, 2] = 50.0
    made = measured_of(record, point_place=place, point_force=force)
    np.testing.assert_allclose(made.slip[[9, 59, 60, 149], 0], [0.0, 0.005, 0.0, 0.005], rtol=0.0, atol=1e-12)
    assert made.slip[:, 1].max() == 0.0


def test_a_centre_of_pressure_is_where_a_force_meets_its_floor():
    place, force = np.random.default_rng(0).normal(size=(2, 9, 3))
    force[:, 2] = 1.0 + np.abs(force[:, 2])
    found = centre_of_pressure(force, np.cross(place, force), 1.0, place[:, 2])
    np.testing.assert_allclose(found, place[:, :2], rtol=0.0, atol=1e-12)


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
    jammed = replace(record, joint_range=record.q[[0, 0], 7:].T)  # after the first step
    assert check(jammed, model).change == np.abs(record.qd[1] - record.qd[0]).max()


def test_a_spring_that_a_torque_balances_changes_nothing(block):
    record, model = block
    stiffness, rest = 3.0 * np.eye(7)[6], 0.2 * np.eye(7)[6]  # [N m/rad], [rad]
    torque = record.tick_torque + 3.0 * (record.q[:-1, 7:] - 0.2)
    spring = NOTHING._replace(stiffness=stiffness, rest=rest)
    assert check(replace(record, tick_torque=torque), model, spring).largest < 1e-9


def test_what_is_missing_shows(block):
    record, model = block
    damped = NOTHING._replace(damping=np.eye(7)[6])  # [N m s/rad]
    turned = check(replace(record, tick_torque=record.tick_torque + 0.1), model)
    for wrong in (check(without_point(record), model), turned, check(record, model, damped)):
        assert wrong.median > 1e-3 * wrong.change
    assert turned.coordinate == "swing"


PUSHED = ("disturbance.push_y=40.0", "disturbance.push_at=0.5", "disturbance.joint_damping=1.0")


@pytest.mark.parametrize("settings", [(), PUSHED], ids=["undisturbed", "pushed and damped"])
def test_a_walk_obeys_them(settings):
    planned, record = walked(2, settings, None)
    model = planned.scene.model.compile()

    def of(record, passive):
        return check_equations(record, bridge.pinocchio_model(model), passive)

    passive = bridge.passive_joints(model)
    found = of(record, passive)
    assert found.median < 1e-9 * found.change
    assert found.largest < 1e-2 * found.change  # MuJoCo's solver stops early at a light toe
    assert of(without_point(record), passive).median > 0.01 * found.change
    if settings:
        assert of(record, passive._replace(implicit=False)).median > 1e-3 * found.change
        unpushed = replace(record, external_force=np.zeros_like(record.external_force))
        assert of(unpushed, passive).largest > 1e-3
