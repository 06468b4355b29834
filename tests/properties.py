"""Properties of every plan, whatever made it: of its centroidal motion and of its feet."""

import numpy as np
import pinocchio as pin

from ampm.geometry import polygon_margin
from ampm.planner.contacts import footprint
from ampm.planner.feet import foot_rotation, foot_turning
from ampm.planner.footsteps import zmp_margin


def inside(plan, count=40):
    """Times within every phase, none on a switch."""
    share = (np.arange(count) + 0.5) / count
    return np.concatenate([phase.start + phase.duration * share for phase in plan.contacts.phases])


def assert_newton_euler(plan, times):
    """``F = m (a + g)`` and ``M = (p - c) x F`` for the ZMP p on the floor."""
    sample = plan.sample(times)
    lever = np.column_stack([sample.zmp, sample.floor]) - sample.com
    weight = np.array([0.0, 0.0, plan.gravity])
    np.testing.assert_allclose(sample.force, plan.mass * (sample.com_acceleration + weight), atol=1e-9)
    np.testing.assert_allclose(np.cross(lever, sample.force)[:, :2], sample.moment, atol=1e-6)


def assert_rates(plan, h=1e-6):
    """Velocity, acceleration and moment are the rates of position, velocity and angular momentum."""
    low, here, high = (plan.sample(inside(plan) + shift) for shift in (-h, 0.0, h))
    for name, rate, tolerance in (
        ("com", "com_velocity", 1e-7),
        ("com_velocity", "com_acceleration", 1e-3),
        ("angular_momentum", "moment", 0.05),
    ):
        change = (getattr(high, name) - getattr(low, name)) / (2 * h)
        np.testing.assert_allclose(change, getattr(here, rate), atol=tolerance, err_msg=rate)


def assert_mirrored(plan, tolerance=1e-9):
    """A step is the mirror image of the one before it."""
    step, times = plan.constants.step_duration, inside(plan)
    times = times[times < plan.duration - step]
    now, later = plan.sample(times), plan.sample(times + step)
    image = now.com * [1.0, -1.0, 1.0] + [plan.contacts.step_length, 0.0, 0.0]
    np.testing.assert_allclose(later.com, image, rtol=0.0, atol=tolerance)
    np.testing.assert_allclose(later.zmp[:, 1], -now.zmp[:, 1], rtol=0.0, atol=tolerance)
    turn = [-1.0, 1.0]
    np.testing.assert_allclose(later.angular_momentum, turn * now.angular_momentum, atol=1e3 * tolerance)


def assert_from_rest_to_rest(plan, height):
    """It begins and ends at rest in the middle of both feet, the COM at a height over them [m]."""
    ends = plan.sample([0.0, plan.duration])
    feet = np.array([step.position for step in plan.contacts.footsteps])
    middle = np.array([feet[:2].mean(axis=0), feet[-2:].mean(axis=0)])
    np.testing.assert_allclose(ends.com - [0.0, 0.0, height], middle, rtol=0.0, atol=1e-10)
    for value in (ends.com_velocity, ends.com_acceleration, ends.moment, ends.angular_momentum):
        np.testing.assert_allclose(value, 0.0, rtol=0.0, atol=1e-9)


def assert_zmp_in_soles(plan, sole):
    """The ZMP keeps the planned margin to the edge of the soles that are in contact."""
    times = inside(plan, 20)
    zmp = plan.sample(times).zmp.reshape(len(plan.contacts.phases), -1, 2)
    for phase, points in zip(plan.contacts.phases, zmp, strict=True):
        feet = [step for step in (phase.left, phase.right) if step]
        outline = np.concatenate([footprint(sole, step) for step in feet])
        outlines = np.broadcast_to(outline, (len(points), *outline.shape))
        margin = polygon_margin(outlines, np.ones(outlines.shape[:2], bool), points)
        assert margin.min() > zmp_margin(sole) - 1e-6


def assert_feet_move(plan, h=1e-5):
    """Rates of the feet and of their turns are derivatives; nothing jumps at a key-frame.

    In the air the acceleration does not either.
    """
    for index, path in enumerate((plan.feet.left, plan.feet.right)):
        frames = path.start[path.start > 0.0]
        times = np.linspace(0.01, plan.duration - 0.01, 400)
        times = times[np.abs(times[:, None] - path.start).min(axis=1) > 3 * h]
        low, here, high = (plan.feet.sample(times + shift)[index] for shift in (-h, 0.0, h))
        before, after = (plan.feet.sample(frames + shift)[index] for shift in (-2e-12, 0.0))
        swings = ~(before.contact.any(axis=1) | after.contact.any(axis=1))
        for name, start in (("position", ""), ("pitch", "pitch_"), ("toe", "toe_")):
            velocity, acceleration = f"{start}velocity", f"{start}acceleration"
            for value, rate, tolerance in ((name, velocity, 1e-5), (velocity, acceleration, 1e-3)):
                change = (getattr(high, value) - getattr(low, value)) / (2 * h)
                np.testing.assert_allclose(change, getattr(here, rate), atol=tolerance, err_msg=rate)
            for value, tolerance, rows in (
                (name, 1e-9, ...),
                (velocity, 1e-8, ...),
                (acceleration, 1e-6, swings),
            ):
                one, other = (getattr(sample, value)[rows] for sample in (before, after))
                np.testing.assert_allclose(one, other, atol=tolerance, err_msg=value)
        turned = [foot_rotation(foot.heading, foot.pitch, foot.roll) for foot in (low, high)]
        spin = [pin.log3(two @ one.T) / (2 * h) for one, two in zip(*turned, strict=True)]
        np.testing.assert_allclose(spin, foot_turning(here)[0], atol=1e-6)
        change = (foot_turning(high)[0] - foot_turning(low)[0]) / (2 * h)
        np.testing.assert_allclose(change, foot_turning(here)[1], atol=1e-4)


def assert_feet_stand(plan, ground=None, *, over=True):
    """Lines in contact rest where they are on the floor, and nothing is under it where ``over`` says so."""
    feet, times = plan.feet, np.linspace(0.0, plan.duration, 1501)
    for side, path, foot in zip(("left", "right"), (feet.left, feet.right), feet.sample(times), strict=True):
        floor = 0.0 if ground is None else ground.at(foot.sole_points[..., :2])
        above, contact = foot.sole_points[..., 2] - floor, foot.contact.repeat(2, axis=1)
        assert not over or above.min() > -5e-5
        assert np.abs(above[contact]).max() < 1e-9
        segment = np.searchsorted(path.start, times + 1e-12, side="right")
        rests = contact[:-1] & (np.diff(segment) == 0)[:, None]
        assert np.abs(np.diff(foot.sole_points, axis=0)).max(axis=2)[rests].max() < 1e-11
        for phase in plan.contacts.phases:
            step = getattr(phase, side)
            (middle,) = plan.feet.sample([phase.start + 0.999 * phase.duration])[side == "right" :][:1]
            if step is not None and middle.contact[0, 0] and middle.contact[0, 1]:
                np.testing.assert_allclose(middle.position[0], step.position, rtol=0.0, atol=1e-12)
                assert np.cos(middle.heading[0] - step.heading) > 1.0 - 1e-9


def assert_walk(plan, sole):
    """All of a walk over footsteps."""
    assert max(plan.residuals().values()) < 1e-11
    assert_newton_euler(plan, inside(plan))
    assert_rates(plan)
    assert_from_rest_to_rest(plan, plan.com_height)
    assert_zmp_in_soles(plan, sole)
