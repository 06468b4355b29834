"""Parameters of sensors and estimator."""

from typing import Annotated, Any, Literal

from pydantic import AfterValidator

from ampm.section import Options, Real, Section, Whole, options_of, parameter

EXACT = "exact"
"""Name of the estimator that knows the true state of the root."""
WRENCH = "wrench"
"""Name of the sensors of force that tell one wrench of every foot."""


def _off_or_read(rate: float) -> float:
    if 0.0 < rate < 10.0:
        raise ValueError("it should be 0, or at least 10 Hz")
    return rate


def _noise(what: str, unit: str, most: float) -> Any:
    return parameter(0.0, f"standard deviation of white noise of {what}, at every tick", unit, ge=0, le=most)


def _bias(what: str, unit: str, most: float) -> Any:
    return parameter(0.0, f"constant error of {what}; its signs are random", unit, ge=0, le=most)


def _drift(what: str, unit: str, most: float) -> Any:
    return parameter(0.0, f"random walk of the error of {what}, after 1 s", unit, ge=0, le=most)


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
    rate: Annotated[Real, AfterValidator(_off_or_read)] = parameter(
        0.0,
        "readings per second, at least 10, whole steps of the physics apart; 0: one for every control tick",
        "Hz",
        ge=0,
        le=1e5,
    )
    angle_noise: Real = _noise("joint angles", "rad", 0.5)
    angle_bias: Real = _bias("every joint angle", "rad", 0.5)
    angle_resolution: Real = parameter(
        0.0, "joint angles are read as multiples of it; 0: as they are", "rad", ge=0, le=0.5
    )
    rate_noise: Real = _noise("joint rates", "rad/s", 50)
    rate_bias: Real = _bias("every joint rate", "rad/s", 50)
    gyro_noise: Real = _noise("the root's rate", "rad/s", 50)
    gyro_bias: Real = _bias("the root's rate, each axis", "rad/s", 50)
    gyro_drift: Real = _drift("the root's rate, each axis", "rad/s", 50)
    accelerometer_noise: Real = _noise("the root's acceleration less gravity", "m/s^2", 100)
    accelerometer_bias: Real = _bias("the root's acceleration less gravity, each axis", "m/s^2", 100)
    accelerometer_drift: Real = _drift("the root's acceleration less gravity, each axis", "m/s^2", 100)
    imu_angle_bias: Real = _bias("the attitude of the IMU in the root, about each axis", "rad", 0.5)
    force_sensor: Literal["points", "wrench"] = parameter(
        "points",
        "what reads the floor's force: points, the normal force of every sole point and its switch; wrench, "
        "force and moment of every foot about its sole's reference point, in its own axes",
    )
    force_noise: Real = _noise("the normal force of every sole point, or the forces of a wrench", "N", 1e4)
    force_bias: Real = _bias("the normal force of each loaded sole point, or forces of a wrench", "N", 1e4)
    force_drift: Real = _drift("the same", "N", 1e4)
    force_scale_bias: Real = _bias("every sensor of force, as a share of what it reads", "1", 0.5)
    moment_noise: Real = _noise("the moments of a wrench", "N m", 1e4)
    moment_bias: Real = _bias("the moments of a wrench", "N m", 1e4)
    contact_threshold: Real = parameter(
        0.0,
        "a switch closes at this force of its sole point, or with wrenches of its line of points, and opens "
        "at half of it; 0: the points' read the true contact, the lines' close at 0.001 of the weight",
        "N",
        ge=0,
        le=1e4,
    )
    fix_rate: Real = parameter(
        0.0, "fixes of the root's position per second, as by motion capture; 0: none", "Hz", ge=0, le=1e4
    )
    fix_noise: Real = parameter(
        0.001, "standard deviation of a fix of the root's position, each axis", "m", gt=0, le=10
    )
    stand: Real = parameter(
        0.0,
        "time for which the body stands before the walk, so that an estimator with begin() finds errors",
        "s",
        ge=0,
        le=60,
    )
    seed: Whole = parameter(0, "seed of noise and signs of biases", ge=0, le=2**31 - 1)

    @property
    def relative(self) -> bool:
        """Whether the place in the world is unknown to the controller: an estimator without fixes."""
        return self.estimator != EXACT and not self.fix_rate

    @property
    def perfect(self) -> bool:
        """Whether the controller gets the true state, without delay."""
        spared = {"estimator", "options", "fix_rate", "fix_noise", "stand", "seed"}
        return self.estimator == EXACT and not self.model_dump(exclude=spared, exclude_defaults=True)

    @property
    def known(self) -> "SensorParameters":
        """What an estimator knows: how large all errors are; the seed would tell it their signs."""
        return self.model_copy(update={"seed": 0})
