"""From parameters to a plan: phases over footsteps, each with its closed-form laws.

A :class:`GaitPlan` is a list of phases with explicit origins, so that footsteps of unequal length, starts,
stops and turns can be added as other lists of phases. It is evaluated at any array of times, vectorised, and
states its own residuals.

Conventions: world x forward, y left, z up, floor z = 0; t = 0 is the start of the first single support, on
the left foot, whose reference point is at (0, +w); forces and moments act on the body.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ampm.description import SoleGeometry
from ampm.exceptions import InputError, MathematicalRefusal
from ampm.geometry import convex_hull, polygon_margin
from ampm.parameters import GRAVITY, FootParameters, GaitParameters
from ampm.planner.pendulum import (
    AffineLaw,
    FrontalPlane,
    LawState,
    SagittalPlane,
    frontal_plane,
    odd_double_integral,
    plain_frontal_plane,
    plain_sagittal_plane,
    sagittal_plane,
    sagittal_time_constant,
)

if TYPE_CHECKING:
    from ampm.planner.feet import FeetPlan

Array = NDArray[np.float64]

PHASE_NAMES = ("single_support", "double_support")
"""Names of :attr:`PlanSample.phase`."""
STANCE_NAMES = ("left", "right", "both")
"""Names of :attr:`PlanSample.stance`."""
LEAST_MID_STANCE_SHARE = 0.2
"""Least speed over the foot, as a share of v0: below it the pendulum nearly stops and every error grows."""
RESIDUAL_LIMIT = 1e-9
"""Largest relative jump at a switch that a plan may have."""
CONTINUOUS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "ampm": ("position", "velocity", "acceleration", "zmp", "moment", "angular_momentum"),
        "ipm": ("position", "velocity", "moment", "angular_momentum"),
    }
)
"""Residuals that a plan of each model must keep below :data:`RESIDUAL_LIMIT`. The plain inverted pendulum is
the documented exception: acceleration and ZMP jump at every switch, and its residuals say by how much."""

_TIME_TOLERANCE = 1e-9  # times this far outside the plan are taken as its ends [s]
_SWITCH_TOLERANCE = 1e-12  # times this close before a switch belong to the phase that begins [s]
_BESIDE_JUMP = 1e-9  # how far beside a jump of the support its two sides are looked at [s]
_MARGIN_GRID = 24  # instants between two jumps, and in every refinement
_MARGIN_REFINEMENTS = 4
_MARGIN_BLOCK = 4096  # instants whose polygons are held at a time
_LARGEST_ANGLE = 300.0  # k T_SS / 2 whose cosh still has room in a double


@dataclass(frozen=True)
class Footstep:
    """One placement of one foot.

    Attributes:
        foot: which foot.
        position: reference point (x, y) in world [m].
        heading: yaw of the foot [rad].
    """

    foot: Literal["left", "right"]
    position: tuple[float, float]
    heading: float = 0.0


@dataclass(frozen=True)
class Phase:
    """One phase of the plan: who stands, when, and the law of each axis about an explicit origin.

    Attributes:
        start: [s].
        duration: [s].
        kind: single or double support.
        stance: the foot that stands, ``both`` in double support.
        origin: world (x, y) from which both laws count [m].
        x: law along x.
        y: law along y.
        footsteps: indices into :attr:`GaitPlan.footsteps` of the left and the right foot's placement in
            force; of a swinging foot, the placement it goes to.
        angular_momentum: (L_x, L_y) about the COM at the start, L_y without the plan's constant [N m s].
    """

    start: float
    duration: float
    kind: Literal["single_support", "double_support"]
    stance: Literal["left", "right", "both"]
    origin: tuple[float, float]
    x: AffineLaw
    y: AffineLaw
    footsteps: tuple[int, int]
    angular_momentum: tuple[float, float]


@dataclass(frozen=True)
class PlanConstants:
    """Derived constants of a periodic gait, symbols of the paper.

    Attributes:
        l_s: half the COM's travel in single support [m].
        l_d: half the COM's travel in double support [m].
        inverse_a_s: ZMP travel over COM travel in single support [1].
        a_d: COM travel over ZMP travel in double support [1].
        c_d: force slope in double support [1].
        single_support_duration: T_SS [s].
        double_support_duration: T_DS [s].
        s: lateral distance of COM and stance foot at a switch [m].
        beta: lateral distance of COM and midline at a switch [m].
        lateral_switching_velocity: lateral speed at a switch [m/s].
        mean_velocity: step length over step duration [m/s].
        angular_momentum_y_offset: mean of L_y over a step [N m s].
    """

    l_s: float
    l_d: float
    inverse_a_s: float
    a_d: float
    c_d: float
    single_support_duration: float
    double_support_duration: float
    s: float
    beta: float
    lateral_switching_velocity: float
    mean_velocity: float
    angular_momentum_y_offset: float

    @property
    def step_duration(self) -> float:
        """T_SS + T_DS [s]."""
        return self.single_support_duration + self.double_support_duration


@dataclass(frozen=True)
class PlanResiduals:
    """Largest jump over all switches, relative to H, v0, g, H, m g H and m H v0.

    Attributes:
        position: of the COM, over H [1].
        velocity: of the COM, over v0 [1].
        acceleration: of the COM, over g [1].
        zmp: of the ZMP, over H [1].
        moment: about the COM, over m g H [1].
        angular_momentum: about the COM, over m H v0 [1].
    """

    position: float
    velocity: float
    acceleration: float
    zmp: float
    moment: float
    angular_momentum: float

    @property
    def largest(self) -> float:
        """The largest of them [1]; infinite if one is not a number."""
        return self.largest_of([f.name for f in fields(self)])

    def largest_of(self, names: Iterable[str]) -> float:
        """The largest of those named [1]; infinite if one is not a number."""
        values = [getattr(self, name) for name in names]
        return max(math.inf if math.isnan(v) else v for v in values)


@dataclass(frozen=True)
class PlanSample:
    """The plan at N times; all vectors in world, all arrays read-only.

    Attributes:
        time: shape (N,) [s].
        phase: 0 single support, 1 double support, shape (N,), int8.
        stance: 0 left, 1 right, 2 both, shape (N,), int8.
        com: shape (N, 3) [m].
        com_velocity: shape (N, 3) [m/s].
        com_acceleration: shape (N, 3) [m/s^2].
        dcm: divergent component of motion, com + com_velocity sqrt(H/g), shape (N, 2) [m].
        zmp: shape (N, 2) [m].
        force: ground reaction on the body, shape (N, 3) [N].
        moment: moment (x, y) of that force about the COM, shape (N, 2) [N m].
        angular_momentum: (L_x, L_y) about the COM, shape (N, 2) [N m s].
        left_placement: left foot's placement in force, the next one while it swings, shape (N, 2) [m].
        right_placement: the same of the right foot, shape (N, 2) [m].
    """

    time: Array
    phase: NDArray[np.int8]
    stance: NDArray[np.int8]
    com: Array
    com_velocity: Array
    com_acceleration: Array
    dcm: Array
    zmp: Array
    force: Array
    moment: Array
    angular_momentum: Array
    left_placement: Array
    right_placement: Array

    def __post_init__(self) -> None:
        for value in vars(self).values():
            value.setflags(write=False)

    def __len__(self) -> int:
        return len(self.time)

    @property
    def phase_name(self) -> NDArray[np.str_]:
        """``single_support`` or ``double_support``, shape (N,)."""
        return np.array(PHASE_NAMES)[self.phase]

    @property
    def stance_name(self) -> NDArray[np.str_]:
        """``left``, ``right`` or ``both``, shape (N,)."""
        return np.array(STANCE_NAMES)[self.stance]


@dataclass(frozen=True)
class _Table:
    """The plan's phases as arrays over P phases: what sampling gathers from."""

    start: Array
    duration: Array
    phase: NDArray[np.int8]
    stance: NDArray[np.int8]
    origin: Array
    law: AffineLaw
    placement: Array
    angular_momentum: Array


@dataclass(frozen=True)
class GaitPlan:
    """A gait in closed form.

    Attributes:
        parameters: what was asked for.
        mass: of the body [kg].
        gravity: [m/s^2].
        constants: what follows from the parameters.
        footsteps: placements in order of time; the first two are those before and at t = 0.
        phases: consecutive phases.
        feet: planned motion of both feet, or None without a sole.
    """

    parameters: GaitParameters
    mass: float
    gravity: float
    constants: PlanConstants
    footsteps: tuple[Footstep, ...]
    phases: tuple[Phase, ...]
    feet: FeetPlan | None = field(default=None, compare=False)

    @property
    def duration(self) -> float:
        """End of the last phase [s]."""
        last = self.phases[-1]
        return last.start + last.duration

    @property
    def weight(self) -> float:
        """Weight of the body, m g [N]."""
        return self.mass * self.gravity

    @cached_property
    def switch_times(self) -> Array:
        """Times at which the support changes, without the plan's ends, shape (P - 1,) [s]."""
        times = self._table.start[1:].copy()
        times.setflags(write=False)
        return times

    @cached_property
    def _table(self) -> _Table:
        phases = self.phases
        names = [f.name for f in fields(AffineLaw)]
        # Phases share few laws: each is unpacked once.
        laws = list({id(law): law for p in phases for law in (p.x, p.y)}.values())
        number = {id(law): i for i, law in enumerate(laws)}
        law = np.array([[getattr(law, n) for n in names] for law in laws])[
            [[number[id(p.x)], number[id(p.y)]] for p in phases]
        ]
        position = np.array([f.position for f in self.footsteps])
        return _Table(
            start=np.array([p.start for p in phases]),
            duration=np.array([p.duration for p in phases]),
            phase=np.array([PHASE_NAMES.index(p.kind) for p in phases], dtype=np.int8),
            stance=np.array([STANCE_NAMES.index(p.stance) for p in phases], dtype=np.int8),
            origin=np.array([p.origin for p in phases]),
            law=AffineLaw(*(law[:, :, i] for i in range(len(names)))),
            placement=position[np.array([p.footsteps for p in phases])],
            angular_momentum=np.array([p.angular_momentum for p in phases]),
        )

    def _evaluate(self, index: NDArray[np.intp], local: Array) -> tuple[LawState, Array, Array, Array, Array]:
        """Laws at phases ``index`` and times since their starts; then com, zmp, moment, momentum, (N, 2)."""
        table = self._table
        law = AffineLaw(*(getattr(table.law, f.name)[index] for f in fields(AffineLaw)))
        state = law.evaluate(local[:, None])
        origin = table.origin[index]
        # The y axis' force line turns the body about +x, the x axis' about -y.
        turn = self.weight * np.array([1.0, -1.0])
        momentum = table.angular_momentum[index] + turn * state.moment_arm_integral[:, ::-1]
        momentum[:, 1] += self.constants.angular_momentum_y_offset
        return (
            state,
            origin + state.position,
            origin + state.zmp,
            turn * state.moment_arm[:, ::-1],
            momentum,
        )

    def _clipped(self, times: ArrayLike) -> Array:
        """Times as an array (N,), those within the tolerance moved onto the plan's ends."""
        time = np.atleast_1d(np.asarray(times, dtype=np.float64))
        if time.ndim != 1:
            raise InputError(f"times have the shape {time.shape}; give one number or a sequence of numbers.")
        outside = ~((time >= -_TIME_TOLERANCE) & (time <= self.duration + _TIME_TOLERANCE))
        if outside.any():
            raise InputError(
                f"time {time[outside][0]:g} s lies outside the plan's 0 ... {self.duration:g} s; "
                "ask for times within it or plan more steps."
            )
        return np.clip(time, 0.0, self.duration)

    def sample(self, times: ArrayLike) -> PlanSample:
        """Evaluate the plan.

        Args:
            times: one time or N times [s], in any order. At a switch the phase that begins holds.

        Raises:
            InputError: a time lies outside the plan or is not a number.
        """
        table = self._table
        time = self._clipped(times)
        index = np.maximum(np.searchsorted(table.start, time + _SWITCH_TOLERANCE, side="right") - 1, 0)
        state, com, zmp, moment, momentum = self._evaluate(index, time - table.start[index])
        n = len(time)
        position, velocity, acceleration = np.empty((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
        position[:, :2], position[:, 2] = com, self.parameters.com_height
        velocity[:, :2] = state.velocity
        acceleration[:, :2] = state.acceleration
        force = self.mass * acceleration
        force[:, 2] = self.weight
        return PlanSample(
            time=time,
            phase=table.phase[index],
            stance=table.stance[index],
            com=position,
            com_velocity=velocity,
            com_acceleration=acceleration,
            dcm=com + state.velocity * math.sqrt(self.parameters.com_height / self.gravity),
            zmp=zmp,
            force=force,
            moment=moment,
            angular_momentum=momentum,
            left_placement=table.placement[index, 0],
            right_placement=table.placement[index, 1],
        )

    def residuals(self) -> PlanResiduals:
        """Largest jumps over all switches: end of every phase against start of the next."""
        table = self._table
        before = np.arange(len(self.phases) - 1)
        end = self._evaluate(before, table.duration[before])
        begin = self._evaluate(before + 1, np.zeros(len(before)))
        gait = self.parameters
        height, speed, weight = gait.com_height, gait.switching_velocity, self.weight

        def jump(a: Array, b: Array, scale: float) -> float:
            return float(np.max(np.abs(b - a), initial=0.0)) / scale

        return PlanResiduals(
            position=jump(end[1], begin[1], height),
            velocity=jump(end[0].velocity, begin[0].velocity, speed),
            acceleration=jump(end[0].acceleration, begin[0].acceleration, self.gravity),
            zmp=jump(end[2], begin[2], height),
            moment=jump(end[3], begin[3], weight * height),
            angular_momentum=jump(end[4], begin[4], self.mass * height * speed),
        )

    def with_angular_momentum_offset(self, offset: float) -> GaitPlan:
        """The same plan with another mean of L_y over a step [N m s].

        Raises:
            InputError: the offset is not finite.
        """
        if not math.isfinite(offset):
            raise InputError(f"the angular momentum offset is {offset}; give a finite number [N m s].")
        return replace(self, constants=replace(self.constants, angular_momentum_y_offset=float(offset)))

    def _points_in_contact(self, time: Array) -> tuple[Array, NDArray[np.bool_]]:
        """World (x, y) of all twelve sole points, (N, 12, 2), and which are in contact, (N, 12)."""
        if self.feet is None:
            raise InputError("the plan has no soles to stand on; plan the gait with a sole geometry.")
        left, right = self.feet.sample(time)
        points = np.concatenate([left.sole_points[:, :, :2], right.sole_points[:, :, :2]], axis=1)
        contact = np.concatenate([left.contact.repeat(2, axis=1), right.contact.repeat(2, axis=1)], axis=1)
        return points, contact

    def support_polygon(self, time: float) -> Array:
        """Convex hull of the sole points planned in contact at one time.

        Returns:
            Corners in world, anticlockwise, shape (k, 2) [m]; two where only a line touches the floor.

        Raises:
            InputError: the plan has no soles, or the time lies outside it.
        """
        points, contact = self._points_in_contact(self._clipped(time))
        return convex_hull(points[0, contact[0]])

    def zmp_margin(self, times: ArrayLike) -> Array:
        """Signed distance of the planned ZMP to the edge of the support polygon.

        Args:
            times: shape (N,) [s].

        Returns:
            Positive inside, negative outside, shape (N,) [m].

        Raises:
            InputError: the plan has no soles, or a time lies outside it.
        """
        time = self._clipped(times)
        margin = np.empty(len(time))
        for first in range(0, max(len(time), 1), _MARGIN_BLOCK):
            block = slice(first, first + _MARGIN_BLOCK)
            points, contact = self._points_in_contact(time[block])
            distance = polygon_margin(points, contact, self.sample(time[block]).zmp)
            margin[block] = np.where(contact.any(axis=1), distance, -np.inf)
        return margin

    def least_zmp_margin(self, until: float | None = None) -> tuple[float, float]:
        """The least of :meth:`zmp_margin`, and its time.

        The polygon jumps where a contact changes, so a grid alone misses the least: here both sides of every
        jump are looked at, and what is least in between is narrowed down.

        Args:
            until: end of the search [s]; the plan's own by default.

        Returns:
            Margin [m] and time [s].

        Raises:
            InputError: the plan has no soles, or ends earlier.
        """
        if self.feet is None:
            raise InputError("the plan has no soles to stand on; plan the gait with a sole geometry.")
        end = self.duration if until is None else float(self._clipped(until)[0])
        jumps = np.concatenate([[0.0, end], self.switch_times, self.feet.left.start, self.feet.right.start])
        jumps = np.unique(jumps[(jumps >= 0.0) & (jumps <= end)])
        inside = jumps[:-1, None] + np.diff(jumps)[:, None] * np.linspace(0.0, 1.0, _MARGIN_GRID)[1:-1]
        times = np.concatenate([jumps, jumps - _BESIDE_JUMP, jumps + _BESIDE_JUMP, inside.ravel()])
        times = np.unique(np.clip(times, 0.0, end))
        margin = self.zmp_margin(times)
        worst = int(margin.argmin())
        least, at = float(margin[worst]), float(times[worst])
        low, high = float(times[max(worst - 1, 0)]), float(times[min(worst + 1, len(times) - 1)])
        for _ in range(_MARGIN_REFINEMENTS):
            times = np.linspace(low, high, _MARGIN_GRID)
            margin = self.zmp_margin(times)
            worst = int(margin.argmin())
            if margin[worst] < least:
                least, at = float(margin[worst]), float(times[worst])
            low, high = float(times[max(worst - 1, 0)]), float(times[min(worst + 1, len(times) - 1)])
        return least, at


def plan_gait(
    gait: GaitParameters,
    *,
    mass: float = 60.0,
    foot: FootParameters | None = None,
    sole: SoleGeometry | None = None,
    angular_momentum_y_offset: float = 0.0,
) -> GaitPlan:
    """Plan a periodic straight gait in closed form.

    Args:
        gait: what to walk.
        mass: of the body [kg].
        foot: key-frames of the feet; the defaults, if only a sole is given.
        sole: outline of a sole; with it the plan has feet, support polygons and ZMP margins.
        angular_momentum_y_offset: mean of L_y over a step [N m s]. The AMPM leaves it free; only a body fixes
            it (the periodic whole-body motion), and a plan without one takes zero.

    Raises:
        InputError: mass or offset is no usable number.
        MathematicalRefusal: the closed form has no solution, or none that can be computed.
    """
    if not (math.isfinite(mass) and mass > 0.0):
        raise InputError(f"the mass is {mass:g} kg; it must be a finite number greater than 0 kg.")
    if not math.isfinite(angular_momentum_y_offset):
        raise InputError(
            f"the angular momentum offset is {angular_momentum_y_offset}; give a finite number [N m s]."
        )
    try:
        with np.errstate(all="ignore"):  # what overflows is refused below, by its residual
            sagittal, frontal = _solve(gait)
            plan = _assemble(gait, float(mass), sagittal, frontal, float(angular_momentum_y_offset))
            residual = plan.residuals().largest_of(CONTINUOUS[gait.model])
    except (OverflowError, ValueError, ZeroDivisionError):
        residual = math.inf
    if not residual <= RESIDUAL_LIMIT:
        raise MathematicalRefusal(
            f"the gait's numbers are too far apart to be computed: the plan would jump by {residual:.1e} of "
            f"its own scale at a switch, more than {RESIDUAL_LIMIT:g}",
            reason="ill_conditioned",
            value=residual,
            limit=RESIDUAL_LIMIT,
            unit="1",
            way_out="bring gait.com_height, gait.step_length, gait.step_width and gait.c_y nearer to each "
            "other, and gait.single_support_ratio away from 0 and 1",
        )
    if sole is None:
        return plan
    from ampm.planner.feet import plan_feet  # the feet need the plan: only here does the arrow point back

    return replace(plan, feet=plan_feet(plan, foot or FootParameters(), sole))


def _solve(gait: GaitParameters) -> tuple[SagittalPlane, FrontalPlane]:
    """Both planes' closed forms, or the refusal that says why there is none."""
    if gait.model == "ipm":
        _check_plain(gait)
    inverse_a_s = 1.0 / gait.a_s
    bracket = gait.c_s - inverse_a_s
    if not bracket > 0.0:
        raise MathematicalRefusal(
            f"gait.c_s - 1/gait.a_s = {bracket:.6g} must be greater than 0: the COM would not be driven off "
            "the stance foot",
            reason="single_support_not_driven",
            value=bracket,
            limit=0.0,
            unit="1",
            way_out=f"raise gait.c_s above {inverse_a_s:.6g}"
            + (f" or gait.a_s above {1.0 / gait.c_s:.6g}" if gait.c_s > 0.0 else ""),
        )
    if not gait.c_y > 0.0:
        raise MathematicalRefusal(
            f"gait.c_y = {gait.c_y:.6g} must be greater than 0: the COM would not be driven back from the "
            "stance foot to the midline",
            reason="c_y_not_positive",
            value=gait.c_y,
            limit=0.0,
            unit="1",
            way_out="choose gait.c_y greater than 0, for example 0.4",
        )
    l_s = 0.5 * gait.step_length * gait.single_support_ratio
    least = l_s / sagittal_time_constant(gait.com_height, bracket, GRAVITY)
    v0 = gait.switching_velocity
    # The mid-stance rule asks for a little more; the way out names the speed that satisfies both.
    enough = least / math.sqrt(1.0 - LEAST_MID_STANCE_SHARE**2)
    slower = "or shorten gait.step_length"
    if not v0 > least:
        raise MathematicalRefusal(
            f"gait.switching_velocity = {v0:.6g} m/s is too slow to pass over the foot: the least is "
            f"l_s/T_s = {least:.6g} m/s",
            reason="switching_velocity_too_low",
            value=v0,
            limit=least,
            unit="m/s",
            way_out=f"raise gait.switching_velocity to {_rounded_up(enough)} m/s {slower}",
        )
    mid_stance = math.sqrt((v0 - least) * (v0 + least))
    floor = LEAST_MID_STANCE_SHARE * v0
    if mid_stance < floor:
        raise MathematicalRefusal(
            f"the COM would pass over the foot at {mid_stance:.6g} m/s, less than {floor:.6g} m/s, "
            f"{LEAST_MID_STANCE_SHARE:.0%} of gait.switching_velocity = {v0:.6g} m/s (it passes at all from "
            f"{least:.6g} m/s)",
            reason="mid_stance_too_slow",
            value=mid_stance,
            limit=floor,
            unit="m/s",
            way_out=f"raise gait.switching_velocity to {_rounded_up(enough)} m/s {slower}",
        )
    if gait.model == "ipm":
        sagittal = plain_sagittal_plane(
            com_height=gait.com_height,
            step_length=gait.step_length,
            single_support_ratio=gait.single_support_ratio,
            switching_velocity=v0,
            gravity=GRAVITY,
        )
    else:
        sagittal = sagittal_plane(
            com_height=gait.com_height,
            step_length=gait.step_length,
            single_support_ratio=gait.single_support_ratio,
            switching_velocity=v0,
            inverse_a_s=inverse_a_s,
            c_s=gait.c_s,
            gravity=GRAVITY,
        )
    angle = 0.5 * math.sqrt(gait.c_y * GRAVITY / gait.com_height) * sagittal.single.duration
    if not angle <= _LARGEST_ANGLE:
        raise MathematicalRefusal(
            f"single support lasts {2.0 * angle:.4g} time constants of the lateral pendulum, more than "
            f"{2.0 * _LARGEST_ANGLE:g}: no side to side motion of that period can be computed",
            reason="single_support_too_long",
            value=2.0 * angle,
            limit=2.0 * _LARGEST_ANGLE,
            unit="1",
            way_out="raise gait.switching_velocity, shorten gait.step_length or lower gait.c_y",
        )
    if gait.model == "ipm":
        return sagittal, plain_frontal_plane(
            com_height=gait.com_height,
            half_width=0.5 * gait.step_width,
            single_support_duration=sagittal.single.duration,
            double_support_duration=sagittal.double.duration,
            gravity=GRAVITY,
        )
    return sagittal, frontal_plane(
        com_height=gait.com_height,
        half_width=0.5 * gait.step_width,
        c_y=gait.c_y,
        single_support_duration=sagittal.single.duration,
        double_support_duration=sagittal.double.duration,
        gravity=GRAVITY,
    )


def _check_plain(gait: GaitParameters) -> None:
    """Refuse slopes that the plain inverted pendulum does not have, rather than ignore them."""
    for key, fixed in (("a_s", math.inf), ("c_s", 1.0), ("c_y", 1.0)):
        value = getattr(gait, key)
        if value != fixed:
            raise MathematicalRefusal(
                f"gait.{key} = {value:.6g} is no choice of the plain inverted pendulum (gait.model = ipm): "
                "its ZMP rests under the foot and its force passes through the COM, so that "
                f"gait.{key} = {fixed:g}",
                reason="not_the_plain_pendulum",
                value=value,
                limit=fixed,
                unit="1",
                way_out=f"set gait.{key} to {fixed:g}, take the preset ipm, or gait.model = ampm",
            )


def _rounded_up(value: float) -> str:
    """``value`` with four digits, never below it."""
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    unit = 10.0 ** (math.floor(math.log10(value)) - 3)
    return f"{math.ceil(value / unit * (1.0 + 1e-12)) * unit:.4g}"


def _assemble(
    gait: GaitParameters, mass: float, sagittal: SagittalPlane, frontal: FrontalPlane, offset: float
) -> GaitPlan:
    """Lay the closed form out over the footsteps."""
    t_ss, t_ds = sagittal.single.duration, sagittal.double.duration
    step, length, w = t_ss + t_ds, gait.step_length, 0.5 * gait.step_width
    weight = mass * GRAVITY

    # L_x(t + T) = -L_x(t): half of what one single support adds; double support adds nothing.
    gained_x = weight * float(frontal.single.evaluate(t_ss).moment_arm_integral)
    # L_y returns to its start at every switch; its mean over a step is taken off.
    drift = (sagittal.single.force_slope - 1.0) * odd_double_integral(
        sagittal.single.rate, sagittal.single.odd, t_ss
    ) + (sagittal.double.force_slope - 1.0) * odd_double_integral(
        sagittal.double.rate, sagittal.double.odd, t_ds
    )
    start_y = weight * drift / step

    feet: tuple[Literal["left", "right"], Literal["left", "right"]] = ("left", "right")
    laws = ((frontal.single, frontal.double), frontal.mirrored())
    footsteps = tuple(
        Footstep(feet[k % 2], (k * length, w if k % 2 == 0 else -w)) for k in range(-1, gait.steps + 1)
    )
    phases: list[Phase] = []
    for k in range(gait.steps):
        side = k % 2
        sign = 1.0 - 2.0 * side
        single_y, double_y = laws[side]
        start, x = k * step, k * length
        # Footstep k + 1 stands, k + 2 is where the other foot goes.
        placements = (k + 1, k + 2) if side == 0 else (k + 2, k + 1)
        phases.append(
            Phase(
                start=start,
                duration=t_ss,
                kind="single_support",
                stance=feet[side],
                origin=(x, sign * w),
                x=sagittal.single,
                y=single_y,
                footsteps=placements,
                angular_momentum=(-0.5 * sign * gained_x, start_y),
            )
        )
        phases.append(
            Phase(
                start=start + t_ss,
                duration=t_ds,
                kind="double_support",
                stance="both",
                origin=(x + 0.5 * length, 0.0),
                x=sagittal.double,
                y=double_y,
                footsteps=placements,
                angular_momentum=(0.5 * sign * gained_x, start_y),
            )
        )
    constants = PlanConstants(
        l_s=sagittal.l_s,
        l_d=sagittal.l_d,
        inverse_a_s=sagittal.inverse_a_s,
        a_d=sagittal.a_d,
        c_d=sagittal.c_d,
        single_support_duration=t_ss,
        double_support_duration=t_ds,
        s=frontal.s,
        beta=frontal.beta,
        lateral_switching_velocity=frontal.velocity,
        mean_velocity=length / step,
        angular_momentum_y_offset=offset,
    )
    return GaitPlan(gait, mass, GRAVITY, constants, footsteps, tuple(phases))
