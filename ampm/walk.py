"""A planned walk as one function of time, and the protocols of planner and controller.

A :class:`WalkPlan` is always complete: centroidal plan, feet, posture. It gives the :class:`Reference` of all
ticks of a controller at once (:meth:`WalkPlan.table`). A :class:`Controller` is handed one reference each
tick and keeps none, so a plan can be replaced at any tick. Axes and order of the feet: :mod:`ampm.reference`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from ampm.exceptions import InputError
from ampm.geometry import Array, Flags
from ampm.parameters import CommandParameters, RunParameters
from ampm.planner.centroidal import PlanSample
from ampm.planner.contacts import times_within
from ampm.planner.feet import FeetPlan, FootSample, foot_turning
from ampm.planner.support import StepPlan
from ampm.reference import FIELDS, PostureState, Reference, Timing


class State(NamedTuple):
    """The measured state of the body.

    Attributes:
        time: [s].
        q: Pinocchio's: the root's place in world [m], quaternion (x, y, z, w), hinges [rad], shape (nq,).
        v: of the root in its own axes [m/s, rad/s], then of the hinges [rad/s], shape (nv,).
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
        contact: sole points in contact, left foot first, each from heel over ball to tip, shape (P,), bool.
        normal_force: latest normal force of every sole point, shape (P,) [N].
        age: how old that force is [s].
        threshold: load below which a touch may be missed [N].
    """

    contact: Flags
    normal_force: Array
    age: float = 0.0
    threshold: float = 0.0


class Posture(Protocol):
    """Whole-body motion of a walk besides COM, momentum and feet."""

    def sample(self, times: ArrayLike) -> PostureState:
        """States at ``times``, shape (T,) [s]; every array with a leading axis of T.

        A walk begins in the state at time 0, which meets the plan's COM, momentum and feet.
        """

    def report(self) -> dict[str, Any]:
        """Values for the summary of a trial, as plain values; may be empty."""


class SampledWalk(NamedTuple):
    """COM and ZMP, both feet and the posture at T times."""

    plan: PlanSample
    feet: tuple[FootSample, FootSample]
    posture: PostureState

    def both_feet(self, name: str) -> Any:
        """One attribute of :class:`~ampm.planner.feet.FootSample` of both feet, shape (T, 2, ...)."""
        return np.stack([getattr(foot, name) for foot in self.feet], axis=1)

    def turning(self, order: int) -> Array:
        """Angular velocity (order 0) or acceleration (1) of both feet, shape (T, 2, 3) [rad/s, rad/s^2]."""
        return np.stack([foot_turning(foot)[order] for foot in self.feet], axis=1)


class Instants(NamedTuple):
    """What the fields of a reference are taken from, at T ticks."""

    times: Array  # shape (T,) [s]
    timing: Timing  # look-ahead of the references
    feet: FeetPlan  # of the plan
    contact: Flags  # groups in contact, shape (T, 2, 3)
    jumps: Flags  # whether accelerations jump, shape (T,)
    now: SampledWalk  # the walk at these times
    held: SampledWalk  # the walk at the middle of the time for which the tick's command acts

    @property
    def yaw_moment(self) -> Array:
        """Rate of the posture's L_z, zero at a single tick, shape (T,) [N m]."""
        momentum = self.now.posture.angular_momentum_z
        return np.gradient(momentum, self.times) if len(self.times) > 1 else np.zeros(len(self.times))

    def contact_within(self, span: float) -> Flags:
        """Contact now or at the end of a time span [s], shape (T, 2, 3)."""
        return self.contact | self.feet.contact(np.minimum(self.times + span, self.feet.duration))


@dataclass(frozen=True)
class WalkPlan(StepPlan):
    """A complete plan of a walk: COM, ZMP, force, momentum and feet, and a posture.

    Attributes:
        posture: motion of the rest of the body.
        command: commanded velocity of a walk without a plan; the plan then only stands.
    """

    posture: Posture
    command: CommandParameters | None = None

    @property
    def judged_from(self) -> float:
        """Begin of what a trial judges [s]; the first step is left out if the walk does not begin at rest."""
        return 0.0 if self.contacts.phases[0].stance == "both" else float(self.contacts.step_ends[0])

    def table(self, times: ArrayLike, timing: Timing = Timing()) -> Reference:
        """References at the ticks of a controller, ascending, shape (T,) [s].

        Times until lift-off count to the first tick without planned contact, within these ticks or after. At
        a single tick they are exact, and the rate of L_z is zero.

        Raises:
            InputError: a time lies outside the plan.
        """
        times = times_within(times, self.duration)
        if not times.size:
            raise InputError("there are no times; give one or more.")
        jumps = np.asarray((np.abs(times[:, None] - self.jump_times) < timing.extrapolation).any(axis=1))
        delay = 0.5 * timing.hold * (jumps if timing.extrapolation else np.ones(len(times)))
        now = held = self._sampled(times)
        if delay.any():
            held = self._sampled(np.minimum(times + delay, self.duration))
        at = Instants(times, timing, self.feet, self.feet.contact(times), jumps, now, held)
        return Reference.of(**{name: field.sample(at) for name, field in FIELDS.items()})

    def _sampled(self, times: Array) -> SampledWalk:
        """Everything at times (T,) [s]."""
        return SampledWalk(self.sample(times), self.feet.sample(times), self.posture.sample(times))


class Planner(Protocol):
    """Makes the plan of a walk; any class with this method is one. A :class:`Replanner` plans on.

    A class may have these attributes; a subclass does not inherit them.

    Attributes:
        tunes: True if values that the run leaves open are found before ``plan`` is called; else the run
            comes as it is.
        plans_footsteps: False if a run with footsteps is to be refused.
        gait_keys: keys that it uses of the section ``gait``, if not all.
    """

    def plan(self, run: RunParameters, robot: Any) -> WalkPlan:
        """Plan a walk.

        Args:
            run: parameters of gait, body, feet and controller.
            robot: the body, :class:`ampm.body.robot.Robot`.

        Raises:
            InputError, MathematicalRefusal, BodilyRefusal: there is no such walk.
        """


class Replanner(Planner, Protocol):
    """A planner that goes on planning while its plan is walked.

    Attributes:
        replan_period: time from one call to the next [s]; without this attribute, or at 0, every control
            tick. The first call is at time 0.
    """

    def replan(self, time: float, state: State, touch: Touch, plan: WalkPlan) -> WalkPlan | None:
        """The plan to follow from the next tick on, or None to keep the one that is valid.

        The walk ends when the plan in force has stepped as often as was asked for, or ends.

        Args:
            time: of this tick on the walk's clock, which all plans share [s].
            state: as the controller gets it at this tick, sensed and maybe old; copy what you keep.
            touch: of the same tick.
            plan: that is valid now. What :meth:`plan` and earlier calls return is never changed.

        Returns:
            A plan on the same clock, which covers ``time`` and what comes after it. With footsteps in the
            run it has at least as many steps, each within 0.2 m of its footstep.
        """


SOLVED, LIMITED, UNSOLVED = 0, 1, 2
"""Status of a tick: solved; solved with torque or joint limits active; unsolved, a fallback was used."""


class ControlOutput(NamedTuple):
    """Output of one tick, vectors in world. Only the torque is needed; the other fields are optional.

    Attributes:
        torque: of the motors, in the order of ``robot.joint_names``, shape (nu,) [N m].
        force: net ground force commanded, shape (3,) [N].
        zmp: ZMP of the wrench commanded, shape (2,) [m].
        angular_momentum: about the COM, commanded, shape (3,) [N m s].
        point_force: force commanded at every sole point, shape (P, 3) [N].
        status: SOLVED, LIMITED or UNSOLVED.
        residual: of its optimisation; NaN without one.
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
    """Makes torques from state, contact and reference, once every 1 / controller.frequency.

    One that has the method ``follow(plan, timing)`` gets the :class:`WalkPlan` and the :class:`Timing` of its
    references before the first tick, and every new plan of a :class:`Replanner` before the tick from which
    it holds. An attribute ``acceleration`` goes to the estimator: accelerations of all coordinates that it
    commanded at the last tick, shape (nv,) [m/s^2, rad/s^2], or None.
    """

    def update(self, state: State, touch: Touch, reference: Reference) -> ControlOutput:
        """One tick.

        Args:
            state: the measured state; its arrays and those of the touch are the controller's own.
            touch: what the soles sense.
            reference: what is planned at this instant.
        """


ControllerFactory = Callable[..., Controller]
"""Makes a controller for a body, :class:`ampm.body.robot.Robot`, and a run, with its ``controller.options``.

A controller's class is such a factory.
"""
