"""Parameters of sensors and estimator."""

from typing import Any

from ampm.exceptions import InputError
from ampm.section import Options, Real, Section, Whole, options_of, parameter, whole

EXACT = "exact"
"""Name of the estimator that knows the true state of the root."""


def _noise(what: str, unit: str, most: float) -> Any:
    return parameter(0.0, f"standard deviation of white noise of {what}, at every tick", unit, ge=0, le=most)


def _bias(what: str, unit: str, most: float) -> Any:
    return parameter(0.0, f"constant error of {what}; its signs are random", unit, ge=0, le=most)


class SensorParameters(Section, section="sensors"):
    """What the sensors read, and what makes the state that the controller gets from it."""

    estimator: str = parameter(
        EXACT,
        "makes the state of the readings: exact, the true place, attitude and velocity of the root, all else "
        "as read; kalman, from joints, IMU and soles; or MODULE:CLASS",
        min_length=1,
    )
    options: Options = options_of("sensors", "sensors.estimator")
    delay: Real = parameter(0.0, "delay of all readings, in whole steps of the physics", "s", ge=0, le=0.2)
    angle_noise: Real = _noise("joint angles", "rad", 0.5)
    angle_bias: Real = _bias("every joint angle", "rad", 0.5)
    rate_noise: Real = _noise("joint rates", "rad/s", 50)
    rate_bias: Real = _bias("every joint rate", "rad/s", 50)
    gyro_noise: Real = _noise("the root's rate", "rad/s", 50)
    gyro_bias: Real = _bias("the root's rate, each axis", "rad/s", 50)
    accelerometer_noise: Real = _noise("the root's acceleration less gravity", "m/s^2", 100)
    accelerometer_bias: Real = _bias("the root's acceleration less gravity, each axis", "m/s^2", 100)
    force_noise: Real = _noise("the normal force of every sole point", "N", 1e4)
    force_bias: Real = _bias("the normal force of every loaded sole point", "N", 1e4)
    fix_rate: Real = parameter(
        0.0, "fixes of the root's position per second, as by motion capture; 0: none", "Hz", ge=0, le=1e4
    )
    fix_noise: Real = parameter(
        0.001, "standard deviation of a fix of the root's position, each axis", "m", gt=0, le=10
    )
    seed: Whole = parameter(0, "seed of noise and signs of biases", ge=0, le=2**31 - 1)

    @property
    def relative(self) -> bool:
        """Whether the place in the world is unknown to the controller: an estimator without fixes."""
        return self.estimator != EXACT and not self.fix_rate

    @property
    def perfect(self) -> bool:
        """Whether the controller gets the true state, without delay."""
        names = [name for name in type(self).model_fields if name.endswith(("_noise", "_bias"))]
        worn = any(getattr(self, name) for name in names if name != "fix_noise")
        return self.estimator == EXACT and not self.delay and not worn

    @property
    def known(self) -> "SensorParameters":
        """What an estimator knows: all but biases and seed."""
        kept = {name: value for name, value in self if not name.endswith("_bias") and name != "seed"}
        return SensorParameters(**kept)

    def steps_late(self, time_step: float) -> int:
        """The delay in steps of the physics [s].

        Raises:
            InputError: it is no whole number.
        """
        steps = whole(self.delay / time_step)
        if steps is None:
            why = f"{self.delay:g} s is no multiple of simulation.time_step = {time_step:g} s"
            raise _uneven("sensors.delay", self.delay, why, round(self.delay / time_step) * time_step)
        return steps

    def ticks_per_fix(self, frequency: float) -> int:
        """Control ticks [Hz] from one fix of the position to the next; 0 without fixes.

        Raises:
            InputError: they are no whole number.
        """
        if not self.fix_rate:
            return 0
        ticks = whole(frequency / self.fix_rate)
        if not ticks:
            why = f"{self.fix_rate:g} Hz does not divide controller.frequency = {frequency:g} Hz"
            nearest = frequency / max(1, round(frequency / self.fix_rate))
            raise _uneven("sensors.fix_rate", self.fix_rate, why, nearest)
        return ticks


def _uneven(key: str, value: float, why: str, nearest: float) -> InputError:
    return InputError(f"{key} = {why}; choose for example {nearest:.12g}.", key=key, value=value)
