"""Forces on a walking body besides its own motors and the floor, and faults of motors.

What else disturbs a walk is in :mod:`validation.trial.scene` (world and body) and
:mod:`validation.trial.readings` (sensors).
"""

import math
from collections import deque
from dataclasses import dataclass
from numbers import Real
from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.parameters import DisturbanceParameters, RunParameters
from ampm.section import unknown
from validation.trial.physics import Physics
from validation.trial.record import SimulationRecord
from validation.trial.users import UsersCode, load_object, real_numbers

_CLOCK = 1e-9  # tolerance of the start of a push, for rounding [s]


class Plant:
    """Interface of the simulated body for disturbances, at the start of a step; vectors in world.

    Segments have their names in the model; ``chest`` is the trunk, ``com`` the body at its centre of mass.
    """

    def __init__(self, physics: Physics) -> None:
        self._model, self._data, description = physics.model, physics.data, physics.robot.description
        names = {self._model.body(i).name: i for i in range(1, self._model.nbody)}
        self._root = names[description.root_segment]
        self._segments = {**names, "chest": names[description.trunk_segment], "com": self._root}
        self.pushes: dict[str, Array] = {}
        """Force, moment and point of every segment that was pushed in this step, shape (9,)."""

    def segment(self, segment: str) -> int:
        """Number of a segment in the model; raises InputError if there is no such segment."""
        if segment not in self._segments:
            raise unknown(segment, self._segments, "segment")
        return self._segments[segment]

    def position(self, segment: str) -> Array:
        """Centre of mass of a segment, shape (3,) [m]."""
        if segment == "com":
            return np.array(self._data.subtree_com[self._root])
        return np.array(self._data.xipos[self.segment(segment)])

    def velocity(self, segment: str) -> Array:
        """Velocity of a segment's centre of mass, of ``com`` the body's, shape (3,) [m/s]."""
        if segment == "com":
            jacobian = np.zeros((3, self._model.nv))
            mujoco.mj_jacSubtreeCom(self._model, self._data, jacobian, self._root)
            return np.asarray(jacobian @ self._data.qvel)
        result, kind = np.zeros(6), mujoco.mjtObj.mjOBJ_BODY
        mujoco.mj_objectVelocity(self._model, self._data, kind, self.segment(segment), result, 0)
        return result[3:]

    def push(self, segment: str, force: ArrayLike, moment: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        """Push a segment during this step at its centre of mass; pushes add up.

        Force [N] and moment [N m] have shape (3,). Raises InputError if there is no such segment, and
        ValueError if they are not three finite numbers.
        """
        body, parts = self.segment(segment), {"force": force, "moment": moment}.items()
        wrench = np.concatenate([real_numbers(name, value, (3,), finite=True) for name, value in parts])
        wrench = wrench.astype(np.float64)
        if segment == "com":  # acts on the root, with the moment of the same force at the centre of mass
            wrench[3:] += np.cross(self.position("com") - self._data.xipos[body], wrench[:3])
        self._data.xfrc_applied[body] += wrench
        name = self._model.body(body).name
        self.pushes[name] = np.concatenate([self._data.xfrc_applied[body], self._data.xipos[body]])


def release(plant: Plant) -> None:
    """End all pushes; no method, as a disturbance may not end those of others."""
    plant._data.xfrc_applied[:] = 0.0
    plant.pushes.clear()


class Disturbance(Protocol):
    """Anything that pushes the body."""

    def apply(self, time: float, plant: Plant) -> None:
        """Push the body during the step that begins at a time [s]; every step of the physics calls it."""


def check_disturbances(given: Any) -> None:
    """Refuse what is not a list of objects with a method apply, by an InputError."""
    listed = given if isinstance(given, list | tuple) else [None]
    if not all(hasattr(one, "apply") and not isinstance(one, type) for one in listed):
        wanted = "a list of objects with a method apply(time, plant)"
        raise InputError(f"{given!r:.60} cannot be the disturbances; give {wanted}.")


@dataclass(frozen=True)
class Push:
    """A constant force on one segment for some time.

    Attributes:
        segment: its name; ``chest`` is the trunk's, ``com`` the whole body's centre of mass.
        force: in world, at the segment's centre of mass, three numbers [N].
        at: when it begins, not below 0 [s].
        duration: above 0 [s].

    Raises:
        InputError: the force is no three finite numbers or is zero, or a time is out of its bounds.
    """

    segment: str
    force: tuple[float, float, float]
    at: float
    duration: float

    def __post_init__(self) -> None:
        """Refuse invalid values."""
        real = all(isinstance(part, Real) for part in np.ravel(self.force))
        if not (real and np.shape(self.force) == (3,) and np.isfinite(self.force).all() and any(self.force)):
            raise InputError(f"a push of force {self.force} needs three finite numbers, not all 0 [N].")
        numbers = isinstance(self.at, Real) and isinstance(self.duration, Real)
        if not (numbers and math.isfinite(self.at) and self.at >= 0.0 and self.duration > 0.0):
            raise InputError(
                f"invalid push at {self.at!r} s for {self.duration!r} s; give numbers, 0 or more and above 0."
            )
        object.__setattr__(self, "force", tuple(map(float, self.force)))  # of an array, too

    def __str__(self) -> str:
        """In words."""
        force = ", ".join(f"{value:g}" for value in self.force)
        return f"push of ({force}) N on {self.segment} from {self.at:g} s for {self.duration:g} s"

    def apply(self, time: float, plant: Plant) -> None:
        """Push while it lasts."""
        if self.at - _CLOCK <= time < self.at + self.duration - _CLOCK:
            plant.push(self.segment, self.force)


@dataclass(frozen=True)
class Recorded:
    """The forces of an earlier walk again, at the same times."""

    record: SimulationRecord

    def apply(self, time: float, plant: Plant) -> None:
        """Push what was pushed at this time then."""
        record, step = self.record, math.floor(time / self.record.time_step + _CLOCK)
        pushed = record.external_position[step].any(axis=1) if step < record.steps else ()
        for row in np.flatnonzero(pushed).tolist():
            force, moment = record.external_force[step, row], record.external_moment[step, row]
            plant.push(record.external_segments[row], force, moment)


def parse_push(text: str) -> Push:
    """A push from ``SEGMENT,FX,FY,FZ,AT,DURATION``; another text raises InputError."""
    segment, *parts = (part.strip() for part in text.split(","))
    try:
        x, y, z, at, duration = (float(part) for part in parts)
    except ValueError:
        raise InputError(
            f"the push {text!r} must be SEGMENT,FX,FY,FZ,AT,DURATION; write for example chest,50,0,0,2.0,0.1."
        ) from None
    return Push(segment, (x, y, z), at, duration)


def load_disturbance(text: str) -> Disturbance:
    """A disturbance of a user's own, from ``MODULE:CLASS``; raises InputError without a method apply."""
    factory = load_object("--disturbance", text)
    with UsersCode("disturbance", factory):
        made: Disturbance = factory()
    if not callable(getattr(made, "apply", None)):
        raise InputError(f"--disturbance {text!r} has no method apply(time, plant); add it.")
    return made


def describe(disturbance: Disturbance) -> str:
    """In words, or as Python writes it; module and class where that would only be an address."""
    kind, plain = type(disturbance), object.__repr__
    with UsersCode("disturbance", disturbance):
        return f"{kind.__module__}:{kind.__qualname__}" if kind.__repr__ is plain else str(disturbance)


def pushes_of(disturbance: DisturbanceParameters) -> list[Push]:
    """The push of a run's section ``disturbance``, if there is one."""
    force = disturbance.push_x, disturbance.push_y, disturbance.push_z
    if not any(force):
        return []
    return [Push(disturbance.push_segment, force, disturbance.push_at, disturbance.push_duration)]


class MotorFaults:
    """Motors (nu) that act late and with a bias; controllers get no information on it."""

    def __init__(self, run: RunParameters, motors: int) -> None:
        fault = run.disturbance
        self._bias = fault.torque_bias * np.random.default_rng([fault.seed, 1]).choice([-1.0, 1.0], motors)
        late = run.count("disturbance.actuation_delay")
        self._commanded: deque[tuple[Array, Array]] = deque(maxlen=1 + late)

    def act(self, torque: Array, rate: Array) -> None:
        """Turn what was commanded in a tick into what acts in it: torques [N m] and rates [N m/s], (nu,)."""
        self._commanded.append((torque.copy(), rate.copy()))
        torque[:], rate[:] = self._commanded[0]
        torque += self._bias
