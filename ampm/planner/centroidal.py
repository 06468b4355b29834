"""The plan of the centre of mass: phases of closed-form or sampled laws over contacts.

A :class:`CentroidalPlan` gives COM, ZMP, force and angular momentum about the COM for arrays of times, and
its own residuals.

Conventions: world x forward, y left, z up, floor z = 0 except on a slope and under footsteps of another
height; forces and moments act on the body.

On a slope the COM moves parallel to the floor. Its motion along x and y, the moments and the
angular momentum are those of the walk on level ground: ``z = H + k x`` gives ``F_z = m (g + k x'')``, and the
pendulum along x keeps its law (Kajita et al., "The 3D Linear Inverted Pendulum Mode", IROS 2001).
"""

import math
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ampm.brief import Brief
from ampm.exceptions import InputError
from ampm.geometry import Array, ReadOnly, rotations
from ampm.planner.contacts import LEVEL, PHASE_NAMES, STANCE_NAMES, Contacts, read_only, times_within
from ampm.planner.pendulum import LawState

_SWITCH_TOLERANCE = 1e-12  # times this close before a switch belong to the phase that begins [s]


class Law(Protocol):
    """One axis of the centroidal motion during one phase."""

    def evaluate(self, time: Any) -> LawState:
        """State at times since the start of the phase [s]; every field has the shape of the times."""


class CentroidalPhase(NamedTuple):
    """One phase of the centroidal motion: the law of each axis about an explicit origin and heading."""

    start: float  # [s]
    duration: float  # [s]
    origin: tuple[float, float]  # world (x, y) from which both laws count [m]
    x: Law  # law along the heading
    y: Law  # law across it, to the left
    # (L_x, L_y) about the COM at the start, L_y without the plan's constant [N m s]
    angular_momentum: tuple[float, float]
    heading: float = 0.0  # of the laws' axes [rad]
    z: Law | None = None  # upward law, its ZMP at the support's height; None: the plan's height over z = 0


def _constant(unit: str, meaning: str) -> Any:
    return field(default=0.0, metadata={"unit": unit, "meaning": meaning})


JUMP = 0.01
"""Relative jump at a switch from which a plan is not continuous to a controller [1]."""
MAY_JUMP = ("com_acceleration", "zmp", "moment")
"""What jumps at the switches of the plain inverted pendulum."""


@dataclass(frozen=True)
class PlanConstants:
    """Constants of a gait, symbols of the paper; the metadata of each field give its unit and meaning.

    All are zero while they are still to be read from the motion of a plan.
    """

    l_s: float = _constant("m", "half the COM's travel in single support")
    l_d: float = _constant("m", "half the COM's travel in double support")
    inverse_a_s: float = _constant("1", "ZMP travel over COM travel in single support")
    a_d: float = _constant("1", "COM travel over ZMP travel in double support")
    c_d: float = _constant("1", "slope of the force line in double support")
    single_support_duration: float = _constant("s", "duration of a single support")
    double_support_duration: float = _constant("s", "duration of a double support")
    s: float = _constant("m", "lateral distance of COM and stance foot at a switch")
    beta: float = _constant("m", "lateral distance of COM and midline at a switch")
    lateral_switching_velocity: float = _constant("m/s", "lateral speed of the COM at a switch")
    mean_velocity: float = _constant("m/s", "mean forward speed")
    angular_momentum_y_offset: float = _constant("N m s", "mean of L_y about the COM")

    @property
    def step_duration(self) -> float:
        """T_SS + T_DS [s]."""
        return self.single_support_duration + self.double_support_duration


@dataclass(frozen=True)
class PlanSample(Brief, ReadOnly):
    """The plan at N times; all vectors in world, all arrays read-only."""

    time: Array  # shape (N,) [s]
    phase: NDArray[np.int8]  # 0 single support, 1 double support, shape (N,), int8
    stance: NDArray[np.int8]  # 0 left, 1 right, 2 both, shape (N,), int8
    com: Array  # shape (N, 3) [m]
    com_velocity: Array  # shape (N, 3) [m/s]
    com_acceleration: Array  # shape (N, 3) [m/s^2]
    dcm: Array  # divergent component of motion, com + com_velocity sqrt(H/g), shape (N, 2) [m]
    zmp: Array  # on the level plane of height `floor`, shape (N, 2) [m]
    # height of the support: of the standing foot, in double support of a point on the line between the feet;
    # on a slope of the floor under the ZMP, shape (N,) [m]
    floor: Array
    force: Array  # ground reaction on the body, shape (N, 3) [N]
    moment: Array  # moment (x, y) of that force about the COM, shape (N, 2) [N m]
    angular_momentum: Array  # (L_x, L_y) about the COM, shape (N, 2) [N m s]
    left_placement: Array  # left foot's placement in force, the next one while it swings, shape (N, 2) [m]
    right_placement: Array  # the same of the right foot, shape (N, 2) [m]
    heading: Array  # mean of these placements' headings, shape (N,) [rad]

    def __len__(self) -> int:
        return len(self.time)

    @property
    def right_load(self) -> Array:
        """Share of the right foot, by the ZMP between the centre lines of both feet, shape (N,) [1]."""
        across = rotations(self.heading)[:, :, 1]
        left, right, zmp = (
            (place * across).sum(axis=1) for place in (self.left_placement, self.right_placement, self.zmp)
        )
        share = (left - zmp) / (left - right)
        return np.where(self.stance == 0, 0.0, np.where(self.stance == 1, 1.0, np.clip(share, 0.0, 1.0)))

    @property
    def phase_name(self) -> NDArray[np.str_]:
        """``single_support`` or ``double_support``, shape (N,)."""
        return np.array(PHASE_NAMES)[self.phase]

    @property
    def stance_name(self) -> NDArray[np.str_]:
        """``left``, ``right`` or ``both``, shape (N,)."""
        return np.array(STANCE_NAMES)[self.stance]


@dataclass(frozen=True)
class CentroidalPlan(Brief):
    """Motion of COM and ZMP over contacts.

    Attributes:
        mass: of the body [kg].
        gravity: [m/s^2].
        com_height: height of the COM over the floor, H; between uneven footsteps it varies about H [m].
        switching_velocity: forward speed of the COM at a switch, v0, the scale of jumps [m/s].
        contacts: which foot stands where, and when.
        phases: consecutive phases of the motion, as long as the contacts.
        constants: what follows from the parameters.
    """

    mass: float
    gravity: float
    com_height: float
    switching_velocity: float
    contacts: Contacts
    phases: tuple[CentroidalPhase, ...]
    constants: PlanConstants

    @classmethod
    def of(cls, plan: "CentroidalPlan", **more: Any) -> Self:
        """A plan of this class with the fields of another plan and further ones."""
        names = {f.name for f in fields(plan)} & {f.name for f in fields(cls)}
        return cls(**{name: getattr(plan, name) for name in names} | more)

    @property
    def duration(self) -> float:
        """End of the last phase [s]."""
        return self.contacts.duration

    @property
    def weight(self) -> float:
        """Weight of the body, m g [N]."""
        return self.mass * self.gravity

    @cached_property
    def _starts(self) -> Array:
        return np.array([phase.start for phase in self.phases])

    @cached_property
    def _frames(self) -> tuple[Array, Array, Array]:
        """Origins (P, 2), axes of the laws by columns (P, 2, 2), and L_x and L_y (P, 2) of all phases."""
        origin, heading, momentum = zip(
            *((phase.origin, phase.heading, phase.angular_momentum) for phase in self.phases), strict=True
        )
        return np.array(origin), rotations(heading), np.array(momentum)

    @cached_property
    def _laws(self) -> tuple[list[Law], NDArray[np.intp]]:
        """The different laws, and which of them holds along each axis in every phase, shape (P, 2)."""
        laws = list({id(law): law for phase in self.phases for law in (phase.x, phase.y)}.values())
        number = {id(law): i for i, law in enumerate(laws)}
        return laws, np.array([[number[id(phase.x)], number[id(phase.y)]] for phase in self.phases])

    def _states(self, index: NDArray[np.intp], local: Array) -> LawState:
        """Both axes' laws at phases ``index`` and times since their starts, each field (N, 2)."""
        laws, numbers = self._laws
        states, used = LawState(*np.empty((len(LawState._fields), len(local), 2))), numbers[index]
        for number in sorted(set(used.ravel().tolist())):
            rows, axes = np.nonzero(used == number)
            for column, values in zip(states, laws[number].evaluate(local[rows]), strict=True):
                column[rows, axes] = values
        return states

    def _evaluate(self, index: NDArray[np.intp], local: Array) -> dict[str, Array]:
        """Motion at phases ``index`` and times since their starts, by names of :class:`PlanSample`."""
        origin, axes, momentum = (part[index] for part in self._frames)
        along, across = np.moveaxis(axes, 2, 0)
        state = LawState._make(v[:, :1] * along + v[:, 1:] * across for v in self._states(index, local))
        # The y axis' force line turns the body about +x, the x axis' about -y.
        turn = self.weight * np.array([1.0, -1.0])
        momentum = momentum + turn * state.moment_arm_integral[:, ::-1]
        momentum[:, 1] += self.constants.angular_momentum_y_offset
        moment = turn * state.moment_arm[:, ::-1]
        moved = np.zeros((3, len(index), 3))
        moved[0, :, :2], moved[1, :, :2], moved[2, :, :2] = origin + state.position, *state[1:3]
        moved[0, :, 2], zmp, floor = self.com_height, origin + state.zmp, np.zeros(len(index))
        if self.climbs:
            for number in np.unique(index):
                rows, law = index == number, self.phases[number].z
                if law is not None:
                    upward = law.evaluate(local[rows])
                    moved[:, rows, 2], floor[rows] = upward[:3], upward.zmp
            force = self.mass * (moved[2] + np.array([0.0, 0.0, self.gravity]))
            arm = (moved[0, :, 2] - floor)[:, None] * force[:, :2] + moment[:, ::-1] * np.array([1.0, -1.0])
            zmp = moved[0, :, :2] - arm / force[:, 2:]
        if (slope := self.contacts.slope) != LEVEL:
            # With heights that grow by the slopes, horizontal force, moment and rise from ZMP to COM remain.
            away = moved[0, :, :2] - zmp
            rise = away @ slope
            moved[:, :, 2] += moved[:, :, :2] @ slope
            lever = away * self.gravity + rise[:, None] * moved[2, :, :2]
            zmp = moved[0, :, :2] - lever / (self.gravity + moved[2, :, 2])[:, None]
            floor = zmp @ slope
        motion = {"com": moved[0], "com_velocity": moved[1], "com_acceleration": moved[2], "zmp": zmp}
        return motion | {"moment": moment, "angular_momentum": momentum, "floor": floor}

    @cached_property
    def climbs(self) -> bool:
        """Whether footsteps have different heights over the plane of the floor."""
        return any(phase.z is not None for phase in self.phases)

    def sample(self, times: ArrayLike) -> PlanSample:
        """Evaluate the plan.

        Args:
            times: one time or N times [s], in any order. At a switch the phase that begins holds.

        Raises:
            InputError: a time lies outside the plan or is not a number.
        """
        time = times_within(times, self.duration)
        contacts = self.contacts
        index = phase_of(self._starts, time)
        support = phase_of(contacts.starts, time)
        motion = self._evaluate(index, time - self._starts[index])
        force = self.mass * motion["com_acceleration"]
        force[:, 2] += self.weight
        lead = motion["com_velocity"][:, :2] * math.sqrt(self.com_height / self.gravity)
        return PlanSample(
            time=time,
            phase=contacts.kind_codes[support],
            stance=contacts.stance_codes[support],
            dcm=motion["com"][:, :2] + lead,
            force=force,
            left_placement=contacts.placements[support, 0, :2],
            right_placement=contacts.placements[support, 1, :2],
            heading=contacts.headings[support],
            **motion,
        )

    def residuals(self) -> dict[str, float]:
        """Largest jump of each quantity over all switches, from the end of a phase to the start of the next.

        In units of its scale [1]: ``com`` and ``zmp`` H, ``com_velocity`` v0, ``com_acceleration`` g,
        ``moment`` m g H, ``angular_momentum`` m H v0.
        """
        return {name: float(np.max(jump, initial=0.0)) for name, jump in self._switch_jumps.items()}

    @cached_property
    def jump_times(self) -> Array:
        """Switches at which acceleration, ZMP or moment jump by more than :data:`JUMP`, shape (J,) [s]."""
        jumps = np.stack([self._switch_jumps[name] for name in MAY_JUMP])
        return read_only(self._starts[1:][(jumps > JUMP).any(axis=0)])

    @cached_property
    def _switch_jumps(self) -> dict[str, Array]:
        """Jumps at every switch by the names and in the scales of :meth:`residuals`, (S,) each [1]."""
        before = np.arange(len(self.phases) - 1)
        end = self._evaluate(before, np.array([phase.duration for phase in self.phases[:-1]]))
        begin = self._evaluate(before + 1, np.zeros(len(before)))
        height, speed, weight = self.com_height, self.switching_velocity, self.weight
        scales = {"com": height, "com_velocity": speed, "com_acceleration": self.gravity, "zmp": height}
        scales |= {"moment": weight * height, "angular_momentum": self.mass * height * speed}
        return {name: np.abs(begin[name] - end[name]).max(axis=1) / scale for name, scale in scales.items()}

    def with_angular_momentum_offset(self, offset: float) -> Self:
        """The same motion of the COM with another mean of L_y over a step [N m s], which must be finite."""
        if not math.isfinite(offset):
            raise InputError(f"the angular momentum offset is {offset}; give a finite number [N m s].")
        if offset == self.constants.angular_momentum_y_offset:
            return self
        return replace(self, constants=replace(self.constants, angular_momentum_y_offset=float(offset)))


def phase_of(starts: Array, time: Array) -> NDArray[np.intp]:
    """Index of the phase that holds at each time; at a switch the one that begins."""
    return np.maximum(np.searchsorted(starts, time + _SWITCH_TOLERANCE, side="right") - 1, 0)
