"""A planned walk as one function of time, and the protocols of planner and controller.

A :class:`WalkPlan` is always complete: centroidal plan, feet, posture. It gives the :class:`Reference` of all
ticks of a controller at once (:meth:`WalkPlan.table`). A :class:`Controller` is handed one reference each
tick and keeps none, so a plan can be replaced at any tick.

Vectors are in world: x forward, y left, z up, floor at z = 0. Feet: left first. Contact groups of a foot:
heel, ball, tip.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, Protocol, overload

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
        values: position, velocity and acceleration of the sole's reference point (9), rotation of the sole to
            world by rows (9), angular velocity and acceleration (6), angle, velocity and acceleration of the
            toe joint (3); shape (2, 27) [m, rad, s]. One row, so that a tick unpacks it at once.
    """

    values: Array

    @classmethod
    def of(cls, linear: Array, rotation: Array, angular: Array, toe: Array) -> FeetState:
        """From its parts, shapes (..., 2, 3, 3), (..., 2, 3, 3), (..., 2, 2, 3), (..., 2, 3)."""
        parts = linear, rotation, angular, toe
        return cls(np.concatenate([part.reshape(*toe.shape[:-1], -1) for part in parts], axis=-1))

    @property
    def position(self) -> Array:
        """Of the soles' reference points, shape (2, 3) [m]."""
        return self.values[..., 0:3]

    @property
    def velocity(self) -> Array:
        """Shape (2, 3) [m/s]."""
        return self.values[..., 3:6]

    @property
    def acceleration(self) -> Array:
        """Shape (2, 3) [m/s^2]."""
        return self.values[..., 6:9]

    @property
    def rotation(self) -> Array:
        """Of the soles to world, shape (2, 3, 3)."""
        return self.values[..., 9:18].reshape(*self.values.shape[:-1], 3, 3)

    @property
    def angular_velocity(self) -> Array:
        """Shape (2, 3) [rad/s]."""
        return self.values[..., 18:21]

    @property
    def angular_acceleration(self) -> Array:
        """Shape (2, 3) [rad/s^2]."""
        return self.values[..., 21:24]

    @property
    def toe(self) -> Array:
        """Angle, velocity and acceleration of the toe joints, shape (2, 3) [rad, rad/s, rad/s^2]."""
        return self.values[..., 24:27]


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
    angular_momentum_z: Array
    tilt_window: Scalar = 0.0


class Reference(NamedTuple):
    """Reference of a controller at one instant; T instants have a leading axis.

    Attributes:
        time: [s].
        centre: rows com, com_velocity, com_acceleration, angular_momentum, moment, shape (5, 3).
        right_load: share of the weight planned on the right foot [1].
        feet: pose and motion of both feet.
        jumps: whether the plan's acceleration jumps at this tick of a first-order hold, or at the last one.
        contacts: which groups carry load.
        posture: of the whole body.
    """

    time: Scalar
    centre: Array
    right_load: Scalar
    jumps: Scalar
    feet: FeetState
    contacts: ContactState
    posture: PostureState

    @property
    def com(self) -> Array:
        """Centre of mass, shape (3,) [m]."""
        return self.centre[..., 0, :]

    @property
    def com_velocity(self) -> Array:
        """Shape (3,) [m/s]."""
        return self.centre[..., 1, :]

    @property
    def com_acceleration(self) -> Array:
        """Shape (3,) [m/s^2]."""
        return self.centre[..., 2, :]

    @property
    def angular_momentum(self) -> Array:
        """About the COM; x and y are the plan's, z the posture's, shape (3,) [N m s]."""
        return self.centre[..., 3, :]

    @property
    def moment(self) -> Array:
        """Rate of the angular momentum, shape (3,) [N m]."""
        return self.centre[..., 4, :]


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


class ReferenceTable(Sequence[Reference]):
    """References at T instants, evaluated at once.

    Args:
        rows: a reference whose arrays have a leading axis of T; they become read-only.

    Raises:
        ValueError: an array is shorter or longer; compiled functions would read beyond its end.
    """

    def __init__(self, rows: Reference) -> None:
        self.rows = rows
        lengths = set()
        for part in (
            [rows.time, rows.centre, rows.right_load, rows.jumps],
            rows.feet,
            rows.contacts,
            rows.posture,
        ):
            for array in part:
                array.setflags(write=False)
                lengths.add(len(array))
        if len(lengths) > 1:
            raise ValueError(f"arrays of {' and '.join(map(str, sorted(lengths)))} instants in one table")

    def __len__(self) -> int:
        return len(self.rows.centre)

    @overload
    def __getitem__(self, k: int) -> Reference: ...
    @overload
    def __getitem__(self, k: slice) -> ReferenceTable: ...
    def __getitem__(self, k: int | slice) -> Reference | ReferenceTable:
        """The reference at tick k, in views of the table's arrays."""
        rows = self.rows
        row = Reference(
            time=rows.time[k],
            centre=rows.centre[k],
            right_load=rows.right_load[k],
            jumps=rows.jumps[k],
            feet=FeetState._make(array[k] for array in rows.feet),
            contacts=ContactState._make(array[k] for array in rows.contacts),
            posture=PostureState._make(array[k] for array in rows.posture),
        )
        return ReferenceTable(row) if isinstance(k, slice) else row

    def __iter__(self) -> Iterator[Reference]:
        """The references one after another, several times faster than by index."""
        new = tuple.__new__  # a named tuple's own constructor costs more than the rest
        rows = self.rows
        plain = rows.time.tolist(), rows.centre, rows.right_load.tolist(), rows.jumps.tolist()
        feet, contacts, posture = (
            map(partial(new, type(part)), zip(*part, strict=True))
            for part in (rows.feet, rows.contacts, rows.posture)
        )
        return map(partial(new, Reference), zip(*plain, feet, contacts, posture, strict=True))


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

        return ReferenceTable(
            Reference(
                time=times,
                centre=np.stack(
                    [
                        now.plan.com,
                        now.plan.com_velocity,
                        held.plan.com_acceleration,
                        np.hstack([now.plan.angular_momentum, momentum_z[:, None]]),
                        np.hstack([held.plan.moment, yaw_moment[:, None]]),
                    ],
                    axis=1,
                ),
                right_load=now.plan.right_load,
                jumps=jumps,
                feet=_feet_state(now.feet, held.feet),
                contacts=ContactState(
                    planned=within(timing.lead),
                    due=within(timing.early),
                    until_lift=self.feet.until_lift(times, contact),
                ),
                posture=now.posture._replace(
                    acceleration=held.posture.acceleration,
                    tilt_window=np.broadcast_to(now.posture.tilt_window, times.shape),
                ),
            )
        )

    def _instants(self, times: Array) -> _Instants:
        """Everything at times (T,) [s]; postures as compiled functions take them."""
        posture = PostureState(*(np.asarray(part, np.float64) for part in self.posture.sample(times)))
        return _Instants(self.sample(times), self.feet.sample(times), posture)


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
            state: the measured state; its arrays are overwritten by the next tick.
            touch: what the soles sense.
            reference: what is planned at this instant.
        """
        ...


class ControllerFactory(Protocol):
    """Makes a controller; a controller's class is such a factory."""

    def __call__(self, robot: Any, run: RunParameters, /) -> Controller:
        """Make one for a body, :class:`ampm.body.robot.Robot`, and a run."""
        ...


def _feet_state(feet: tuple[FootSample, FootSample], held: tuple[FootSample, FootSample]) -> FeetState:
    """Both feet as one; accelerations are those of ``held``."""
    both = list(zip(feet, held, strict=True))
    linear = np.array([(now.position, now.velocity, later.acceleration) for now, later in both])
    angular = np.array([(foot_turning(now)[0], foot_turning(later)[1]) for now, later in both])
    toe = np.array([(now.toe, now.toe_velocity, later.toe_acceleration) for now, later in both])
    rotation = np.stack([foot_rotation(foot.heading, foot.pitch) for foot in feet], axis=1)
    return FeetState.of(
        linear.transpose(2, 0, 1, 3), rotation, angular.transpose(2, 0, 1, 3), toe.transpose(2, 0, 1)
    )
