"""Disturbances of a run as parameters: the section ``disturbance`` of a run file.

Plan and controller are made from ``RunParameters.undisturbed``, so they get no information on it. All keys
combine; with their defaults nothing is disturbed.
"""

from ampm.exceptions import InputError
from ampm.section import Real, Section, Whole, parameter


class DisturbanceParameters(Section, section="disturbance"):
    """Differences of the simulated world and body from those that planner and controller know."""

    seed: Whole = parameter(0, "seed of all random numbers below", ge=0, le=2**31 - 1)
    start_velocity: Real = parameter(
        0.0, "standard deviation of the root's velocity at the start, each axis", "m/s", ge=0, le=1
    )
    push_segment: str = parameter(
        "chest", "segment that is pushed at its centre of mass; com: that of the body", min_length=1
    )
    push_x: Real = parameter(0.0, "force of the push along x", "N", ge=-1e5, le=1e5)
    push_y: Real = parameter(0.0, "force of the push along y", "N", ge=-1e5, le=1e5)
    push_z: Real = parameter(0.0, "force of the push along z", "N", ge=-1e5, le=1e5)
    push_at: Real = parameter(1.0, "time at which the push begins", "s", ge=0, le=1e5)
    push_duration: Real = parameter(0.1, "duration of the push", "s", gt=0, le=1e5)
    floor_height: Real = parameter(0.0, "height of the floor; the body starts on it", "m", ge=-0.5, le=0.5)
    step_height: Real = parameter(
        0.0, "height of the floor under one footstep over the rest", "m", ge=-0.5, le=0.5
    )
    step_number: Whole = parameter(
        4, "number of that footstep; the walk starts from 1 and 2", ge=3, le=100_000
    )
    slope_along: Real = parameter(
        0.0, "slope of the floor along the walk after footstep 2; positive rises", "rad", ge=-0.3, le=0.3
    )
    slope_across: Real = parameter(
        0.0,
        "slope of the floor across the walk after footstep 2; positive rises left",
        "rad",
        ge=-0.3,
        le=0.3,
    )
    origin: Real = parameter(
        0.0, "distance along x by which the walk is moved from the world's origin", "m", ge=-1e6, le=1e6
    )
    friction_factor: Real = parameter(1.0, "friction of the floor over contact.friction", gt=0, le=100)
    softness_factor: Real = parameter(
        1.0, "time constant of contacts over contact.time_constant", ge=1, le=100
    )
    mass_segment: str = parameter(
        "all", "segments of mass_change, separated by commas, or all; chest: the trunk", min_length=1
    )
    mass_change: Real = parameter(0.0, "relative change of their mass and inertia", ge=-0.9, le=10)
    joint_damping: Real = parameter(0.0, "further damping of every joint", "N m s/rad", ge=0, le=1e3)
    sensing_delay: Real = parameter(
        0.0, "delay of sensed state and contact, in whole ticks of the controller", "s", ge=0, le=0.2
    )
    actuation_delay: Real = parameter(0.0, "delay of the torques, likewise", "s", ge=0, le=0.2)
    angle_noise: Real = parameter(
        0.0, "standard deviation of white noise on sensed joint angles, at every tick", "rad", ge=0, le=0.5
    )
    rate_noise: Real = parameter(
        0.0, "standard deviation of white noise on sensed joint rates, at every tick", "rad/s", ge=0, le=50
    )
    torque_bias: Real = parameter(
        0.0, "constant error of every motor's torque; its signs are random", "N m", ge=0, le=1e3
    )

    def delays(self, frequency: float) -> tuple[int, int]:
        """Delays of sensing and actuation in ticks of a controller [Hz].

        Raises:
            InputError: one is no whole number.
        """
        sensing, actuation = self.sensing_delay * frequency, self.actuation_delay * frequency
        for key, ticks in (("sensing_delay", sensing), ("actuation_delay", actuation)):
            if whole(ticks) is None:
                raise InputError(
                    f"disturbance.{key} = {ticks / frequency:g} s is no multiple of the controller's tick of "
                    f"{1.0 / frequency:g} s; choose for example {round(ticks) / frequency:.12g}.",
                    key=f"disturbance.{key}",
                    value=ticks / frequency,
                )
        return round(sensing), round(actuation)


def whole(number: float) -> int | None:
    """The whole number that a number is but for rounding, or None."""
    nearest = round(number)
    return nearest if abs(number - nearest) <= 1e-9 * max(1.0, number) else None
