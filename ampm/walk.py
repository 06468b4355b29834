"""A planned walk as one function of time, and the protocols of planner and controller.

A :class:`WalkPlan` is always complete: centroidal plan, feet, posture. It gives the :class:`Reference` of all
ticks of a controller at once (:meth:`WalkPlan.table`). A :class:`Controller` is handed one reference each
tick and keeps none, so a plan can be replaced at any tick.

Vectors are in world: x forward, y left, z up, floor at z = 0. Feet: left first. Contact groups of a foot:
heel, ball, tip.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ampm.parameters import RunParameters
from ampm.planner.centroidal import PlanSample
from ampm.planner.feet import FootSample, foot_rotation, foot_turning
from ampm.planner.support import StepPlan

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Scalar = Any  # a float at one instant, an array (T,) at T of them


class FeetState(NamedTuple):
    """Both feet at one instant; T instants have a leading axis.

    Attributes:
        position: of the soles' reference points, shape (2, 3) [m].
        velocity: shape (2, 3) [m/s].
        acceleration: shape (2, 3) [m/s^2].
        rotation: of the soles to world, shape (2, 3, 3).
        angular_velocity: shape (2, 3) [rad/s].
        angular_acceleration: shape (2, 3) [rad/s^2].
        toe: angle, velocity and acceleration of the toe joints, shape (2, 3) [rad, rad/s, rad/s^2].
    """

    position: Array
    velocity: Array
    acceleration: Array
    rotation: Array
    angular_velocity: Array
    angular_acceleration: Array
    toe: Array


class ContactState(NamedTuple):
    """Planned contact at one instant; T instants have a leading axis.

    Attributes:
        planned: groups in contact, shape (2, 3), bool.
        due: groups in contact now or shortly: what touches early is taken as contact, shape (2, 3), bool.
        until_lift: time until the group lifts off, infinite if it does not, shape (2, 3) [s].
    """

    planned: Flags
    due: Flags
    until_lift: Array


class PostureState(NamedTuple):
    """Whole-body configuration at one instant, Pinocchio's coordinates; T instants have a leading axis.

    Attributes:
        q: shape (nq,).
        v, acceleration: root part in root axes, shape (nv,).
        trunk: rotation of the trunk segment to world, shape (3, 3).
        angular_momentum_z: about the COM, shape () [N m s].
        tilt_window: time over which the controller averages the trunk's tilt [s]; 0: not at all, as for a
            posture that plans the trunk's motion within a step.
    """

    q: Array
    v: Array
    acceleration: Array
    trunk: Array
    angular_momentum_z: Scalar
    tilt_window: Scalar = 0.0


@cache
def reference_type(nq: int, nv: int) -> np.dtype[Any]:
    """One row of a table of references, which a controller copies at once.

    The same object for the same body: NumPy copies a row of the very same type four times as fast.

    Args:
        nq: size of Pinocchio's configuration.
        nv: size of its velocity.
    """
    feet = [(f"foot_{name}", float, (2, 3)) for name in FeetState._fields if name != "rotation"]
    fields = [
        ("time", float),
        ("com", float, (3,)),
        ("com_velocity", float, (3,)),
        ("com_acceleration", float, (3,)),
        ("angular_momentum", float, (3,)),
        ("moment", float, (3,)),
        ("right_load", float),
        ("jumps", bool),
        *feet,
        ("foot_rotation", float, (2, 3, 3)),
        ("planned", bool, (2, 3)),
        ("due", bool, (2, 3)),
        ("until_lift", float, (2, 3)),
        ("q", float, (nq,)),
        ("v", float, (nv,)),
        ("acceleration", float, (nv,)),
        ("trunk", float, (3, 3)),
        ("tilt_window", float),
    ]
    return np.dtype(fields, align=True)


class Reference:
    """Reference of a controller at one instant; T instants have a leading axis, see :class:`ReferenceTable`.

    Args:
        row: of :func:`reference_type`; every property is a view of it.
    """

    __slots__ = ("row",)

    def __init__(self, row: Any) -> None:
        self.row = row

    @classmethod
    def of(
        cls,
        *,
        time: ArrayLike,
        com: ArrayLike,
        com_velocity: ArrayLike,
        com_acceleration: ArrayLike,
        angular_momentum: ArrayLike,
        moment: ArrayLike,
        right_load: ArrayLike,
        feet: FeetState,
        contacts: ContactState,
        posture: PostureState,
        jumps: ArrayLike = False,
    ) -> Self:
        """Copy the parts into a new reference; T instants have a leading axis.

        Args are the properties of this class.

        Raises:
            ValueError: a part has another shape, or another number of instants.
        """
        parts: dict[str, Any] = {
            "time": time,
            "com": com,
            "com_velocity": com_velocity,
            "com_acceleration": com_acceleration,
            "angular_momentum": angular_momentum,
            "moment": moment,
            "right_load": right_load,
            "jumps": jumps,
            **{f"foot_{name}": part for name, part in feet._asdict().items()},
            **contacts._asdict(),
            **posture._asdict(),
        }
        del parts["angular_momentum_z"]  # is in the angular momentum
        row = np.zeros(np.shape(time), reference_type(np.shape(posture.q)[-1], np.shape(posture.v)[-1]))
        for name, part in parts.items():
            if np.ndim(part) and np.shape(part) != row[name].shape:
                raise ValueError(
                    f"{name} of a reference has shape {np.shape(part)} and must have {row[name].shape}"
                )
            row[name] = part
        return cls(row)

    def replace(self, **fields: ArrayLike) -> Self:
        """A copy with other values of some fields, by the names of :func:`reference_type`."""
        row = self.row.copy()  # np.array() would share the memory of one row
        for name, value in fields.items():
            row[name] = value
        return type(self)(row)

    @property
    def time(self) -> Scalar:
        """[s]."""
        return self.row["time"]

    @property
    def com(self) -> Array:
        """Centre of mass, shape (3,) [m]."""
        return self.row["com"]

    @property
    def com_velocity(self) -> Array:
        """Shape (3,) [m/s]."""
        return self.row["com_velocity"]

    @property
    def com_acceleration(self) -> Array:
        """Shape (3,) [m/s^2]."""
        return self.row["com_acceleration"]

    @property
    def angular_momentum(self) -> Array:
        """About the COM; x and y are the plan's, z the posture's, shape (3,) [N m s]."""
        return self.row["angular_momentum"]

    @property
    def moment(self) -> Array:
        """Rate of the angular momentum, shape (3,) [N m]."""
        return self.row["moment"]

    @property
    def right_load(self) -> Scalar:
        """Share of the weight planned on the right foot [1]."""
        return self.row["right_load"]

    @property
    def jumps(self) -> Scalar:
        """Whether the plan's acceleration jumps at this tick of a first-order hold, or at the last one."""
        return self.row["jumps"]

    @property
    def feet(self) -> FeetState:
        """Pose and motion of both feet."""
        return FeetState(*(self.row[f"foot_{name}"] for name in FeetState._fields))

    @property
    def contacts(self) -> ContactState:
        """Which groups carry load."""
        return ContactState(self.row["planned"], self.row["due"], self.row["until_lift"])

    @property
    def posture(self) -> PostureState:
        """Of the whole body."""
        row = self.row
        return PostureState(
            row["q"],
            row["v"],
            row["acceleration"],
            row["trunk"],
            row["angular_momentum"][..., 2],
            row["tilt_window"],
        )


class Timing(NamedTuple):
    """Times by which a controller's references look ahead.

    Attributes:
        lead: time by which a foot is let down before its planned contact [s].
        early: time before planned contact from which a touch counts as contact [s].
        hold: how long after the tick the last force of its command acts [s]: zero if every tick makes one
            step of the physics. Where the torque is held, accelerations are those of the middle of that time.
        slope: period of ticks between which the torque goes on with its slope [s]: it is then held only where
            the plan jumps. Zero: it is always held.
    """

    lead: float = 0.0
    early: float = 0.0
    hold: float = 0.0
    slope: float = 0.0


SHARP = Timing()
"""No look-ahead."""


class ReferenceTable(Reference):
    """References at T instants, evaluated at once: arrays have a leading axis of T.

    Args:
        row: array of :func:`reference_type`, shape (T,); it becomes read-only.
    """

    __slots__ = ()

    def __init__(self, row: Any) -> None:
        row.setflags(write=False)
        super().__init__(row)

    def __len__(self) -> int:
        return len(self.row)

    def __getitem__(self, k: int) -> Reference:
        """The reference at tick k."""
        return Reference(self.row[k])

    def __iter__(self) -> Iterator[Reference]:
        return map(Reference, self.row)

    def part(self, start: int, stop: int) -> ReferenceTable:
        """The references of ticks start ... stop - 1, without a copy."""
        return ReferenceTable(self.row[start:stop])


class Posture(Protocol):
    """Whole-body motion of a walk besides COM, momentum and feet."""

    def sample(self, times: ArrayLike) -> PostureState:
        """States at ``times``, shape (T,) [s]; every array with a leading axis of T.

        A walk begins in the state at time 0, which meets the plan's COM, momentum and feet.
        """
        ...

    def report(self) -> dict[str, Any]:
        """Values for the summary of a trial, as plain values; may be empty."""
        ...


@dataclass(frozen=True)
class WalkPlan(StepPlan):
    """A complete plan of a walk: COM, ZMP, force, momentum and feet, and a posture.

    Attributes:
        posture: motion of the rest of the body.
    """

    posture: Posture

    @property
    def judged_from(self) -> float:
        """Begin of what a trial judges [s]: without the first step of a walk that does not begin at rest."""
        return 0.0 if self.contacts.phases[0].stance == "both" else self.constants.step_duration

    def table(self, times: ArrayLike, timing: Timing = SHARP) -> ReferenceTable:
        """References at the ticks of a controller, ascending, shape (T,) [s].

        Times until lift-off count to the first tick without planned contact, within these ticks or after. At
        a single tick they are exact, and the rate of L_z is zero.

        Raises:
            InputError: a time lies outside the plan.
        """
        times = np.array(times, dtype=np.float64)
        jumps = (np.abs(times[:, None] - self.jump_times) < timing.slope).any(axis=1)
        delay = 0.5 * timing.hold * (jumps if timing.slope else np.ones(len(times)))
        now = held = self._instants(times)
        if delay.any():
            held = self._instants(np.minimum(times + delay, self.duration))
        momentum_z = now.posture.angular_momentum_z
        yaw_moment = np.gradient(momentum_z, times) if len(times) > 1 else np.zeros(len(times))
        contact = self.feet.contact(times)

        def within(span: float) -> Flags:
            """Contact now or at the end of a time span."""
            return contact | self.feet.contact(np.minimum(times + span, self.feet.duration))

        return ReferenceTable.of(
            time=times,
            com=now.plan.com,
            com_velocity=now.plan.com_velocity,
            com_acceleration=held.plan.com_acceleration,
            angular_momentum=np.hstack([now.plan.angular_momentum, momentum_z[:, None]]),
            moment=np.hstack([held.plan.moment, yaw_moment[:, None]]),
            right_load=now.plan.right_load,
            jumps=jumps,
            feet=_feet_state(now.feet, held.feet),
            contacts=ContactState(
                planned=within(timing.lead),
                due=within(timing.early),
                until_lift=self.feet.until_lift(times, contact),
            ),
            posture=now.posture._replace(acceleration=held.posture.acceleration),
        )

    def _instants(self, times: Array) -> _Instants:
        """Everything at times (T,) [s]."""
        return _Instants(self.sample(times), self.feet.sample(times), self.posture.sample(times))


class _Instants(NamedTuple):
    """COM and ZMP, both feet and the posture at some times."""

    plan: PlanSample
    feet: tuple[FootSample, FootSample]
    posture: PostureState


class Planner(Protocol):
    """Makes the plan of a walk; any class with this method is one."""

    def plan(self, run: RunParameters, robot: Any) -> WalkPlan:
        """Plan a walk.

        Args:
            run: parameters of gait, body, feet and controller.
            robot: the body, :class:`ampm.body.robot.Robot`.

        Raises:
            InputError, MathematicalRefusal, BodilyRefusal: there is no such walk.
        """
        ...


class State(NamedTuple):
    """The measured state of the body.

    Attributes:
        time: [s].
        q: Pinocchio configuration, shape (nq,).
        v: Pinocchio velocity, shape (nv,).
        velocity_lag: how much older ``v`` is than ``q`` [s]. A difference quotient, and a semi-implicit
            integrator's velocity, is the mean over the last step: half a step old.
    """

    time: float
    q: Array
    v: Array
    velocity_lag: float = 0.0


class Touch(NamedTuple):
    """Contact readings of the soles.

    Attributes:
        contact: sole points in contact, shape (P,), bool.
        normal_force: latest normal force of every sole point, shape (P,) [N].
        age: how old that force is [s].
    """

    contact: Flags
    normal_force: Array
    age: float = 0.0


SOLVED, LIMITED, UNSOLVED = 0, 1, 2
"""Status of a tick: solved; solved with torque or joint limits active; unsolved, a fallback was used."""


class ControlOutput(NamedTuple):
    """Output of one tick. Only the torque is needed; the others may stay None or NaN.

    Attributes:
        torque: joint torques, shape (nu,) [N m].
        force: net ground force commanded, shape (3,) [N].
        zmp: ZMP of the wrench commanded, shape (2,) [m].
        angular_momentum: about the COM, commanded, shape (3,) [N m s].
        point_force: force commanded at every sole point, shape (P, 3) [N].
        status: SOLVED, LIMITED or UNSOLVED.
        residual: of its optimisation; NaN where there is none.
        iterations: of its optimisation.
        seconds: wall-clock time of its optimisation [s].
        rate: at which the torques go on until the next tick, shape (nu,) [N m/s]; None holds them.
        reference: what the controller followed, if it steps differently from the plan; None if it does not.
    """

    torque: Array
    force: Array | None = None
    zmp: Array | None = None
    angular_momentum: Array | None = None
    point_force: Array | None = None
    status: int = SOLVED
    residual: float = math.nan
    iterations: int = 0
    seconds: float = math.nan
    rate: Array | None = None
    reference: Reference | None = None


class Controller(Protocol):
    """Makes torques from state, contact and reference, once every 1 / controller.frequency."""

    def update(self, state: State, touch: Touch, reference: Reference) -> ControlOutput:
        """One tick.

        Args:
            state: the measured state.
            touch: what the soles sense; the next tick overwrites its arrays and those of the state.
            reference: what is planned at this instant.
        """
        ...


class ControllerFactory(Protocol):
    """Makes a controller; a controller's class is such a factory."""

    def __call__(self, robot: Any, run: RunParameters, /) -> Controller:
        """Make one for a body, :class:`ampm.body.robot.Robot`, and a run."""
        ...


def _both(feet: tuple[FootSample, FootSample], name: str) -> Any:
    """One array of both feet, left first, shape (T, 2, ...)."""
    return np.stack([getattr(foot, name) for foot in feet], axis=1)


def _feet_state(feet: tuple[FootSample, FootSample], held: tuple[FootSample, FootSample]) -> FeetState:
    """Both feet as one; accelerations are those of ``held``."""
    turning = np.stack([foot_turning(foot)[0] for foot in feet], axis=1)
    changing = np.stack([foot_turning(foot)[1] for foot in held], axis=1)
    return FeetState(
        position=_both(feet, "position"),
        velocity=_both(feet, "velocity"),
        acceleration=_both(held, "acceleration"),
        rotation=foot_rotation(_both(feet, "heading"), _both(feet, "pitch")),
        angular_velocity=turning,
        angular_acceleration=changing,
        toe=np.stack(
            [_both(feet, "toe"), _both(feet, "toe_velocity"), _both(held, "toe_acceleration")], axis=2
        ),
    )
