"""A walk over any footsteps, from rest to rest.

Every single support keeps the paper's law in the axes of its foot; every double support blends to the next
one (:mod:`ampm.planner.blend`). One banded linear solve joins them (:mod:`ampm.planner.rest_to_rest`).
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain, pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ampm.description import BodyDescription, SoleGeometry
from ampm.exceptions import BodilyRefusal, InputError
from ampm.geometry import Array, hull_distance, rotations
from ampm.parameters import GRAVITY, GaitParameters
from ampm.planner.blend import BlendLaw
from ampm.planner.centroidal import CentroidalPhase, CentroidalPlan, Law, PlanConstants
from ampm.planner.contacts import Contacts, Footstep, footprint, mean_heading
from ampm.planner.heights import uneven, vertical_laws
from ampm.planner.pendulum import AffineLaw, double_support_root, solution
from ampm.planner.periodic import plan_gait
from ampm.planner.rest_to_rest import SETTLING, Problem, Solution, solve

LARGEST_TILT = 0.6
"""Largest angle by which the angular momentum may turn the trunk [rad]; from 0.68 hands meet thighs."""
_TRUNK_INERTIA = 0.076  # of what turns with the trunk, as a share of mass times the COM's height squared
_BETWEEN_SOLES = 0.01  # least distance of the lines along the soles' inner edges [m]
_STEEPEST = 2.6  # largest k T of a blend: beyond, it is hardly monotone [1]
_GENTLE = 0.95  # of the largest tilt, asked for where a support exceeds it [1]
_NEAR = 3  # supports before and after that share a support's angular momentum
_ROOM = 2e-4  # by which 1/a_s keeps the ZMP further inside than the margin asks [m]
SOLVES = 10
"""Most solves of a walk until ``1/a_s`` keeps the ZMP inside."""


def plan_footsteps(
    footsteps: Sequence[Footstep], gait: GaitParameters, body: BodyDescription, *, first: int = 1
) -> CentroidalPlan:
    """Plan a walk over footsteps, from rest to rest.

    The gait gives the COM's height, the slopes of the force line, the durations of both supports and the
    ZMP's travel (``1/a_s``, less where a step would take the ZMP to the edge of the sole). Position, velocity
    and acceleration of the COM, ZMP and moment are continuous at every switch. The walk begins and ends with
    both feet on the floor, the COM at rest midway between them, and no angular momentum.

    Args:
        footsteps: where both feet stand at first, from 0 s, then where each lands; left and right in turn,
            the foot that swings first is in the first row. At least three.
        gait: see above; its step length and steps count only for the durations.
        body: its mass, soles and lengths.
        first: number of the first footstep, for errors.

    Raises:
        InputError: the list is not a walk, or a time leaves no time to swing.
        MathematicalRefusal: the gait has no closed form.
        BodilyRefusal: feet would cross, the ZMP would leave the soles, or the angular momentum would turn the
            trunk too far.
    """
    check_footsteps(footsteps)
    nominal = plan_gait(gait.model_copy(update={"steps": 1}), body.mass)
    swings = swing_times(footsteps, nominal.constants)
    switches = np.array([0.0, *chain(*swings), swings[-1][1] + SETTLING])
    placed = tuple(step._replace(time=None) for step in footsteps)  # the switches have the times
    contacts = Contacts(placed, switches, nominal.contacts.slope)
    solved = solve_within_limits(problem_of(footsteps, contacts, gait, body.mass * GRAVITY), body.sole)
    phases = _phases(contacts.starts.tolist(), solved)
    if uneven(footsteps):
        zmp = solved.stands.sum(axis=2)  # r + q
        laws = vertical_laws(footsteps, solved.problem, zmp, gait.com_height)
        phases = [phase._replace(z=law) for phase, law in zip(phases, laws, strict=True)]
    plan = replace(nominal, contacts=contacts, phases=tuple(phases))
    _refuse(footsteps, solved, body, plan, first)
    return plan


def solve_within_limits(problem: Problem, sole: SoleGeometry) -> Solution:
    """Solve with less of ``1/a_s`` and of the slopes until the ZMP stays inside and the trunk upright."""
    for _ in range(SOLVES):
        solved = solve(problem)
        largest, share = _largest_inverse_a(solved, sole), _gentler(solved)
        if (problem.inverse_a * (1.0 - 1e-3) <= largest).all() and (share == 1.0).all():
            break
        problem = problem._replace(
            inverse_a=np.minimum(problem.inverse_a, largest),
            slopes=1.0 + share[:, None] * (problem.slopes - 1.0),
        )
    return solved


def check_footsteps(footsteps: Sequence[Footstep]) -> None:
    """Refuse a list that is not a walk."""
    if len(footsteps) < 3:
        raise InputError(f"a walk takes at least 3 footsteps, not {len(footsteps)}: both feet, then steps.")
    for number, (here, ahead) in enumerate(pairwise(footsteps), start=2):
        if here.foot == ahead.foot:
            raise InputError(
                f"footsteps {number - 1} and {number} are of the {here.foot} foot; alternate left and right."
            )
    for number, step in enumerate(footsteps, start=1):
        if not all(map(math.isfinite, (*step.position, step.heading, step.time or 0.0))):
            raise InputError(f"footstep {number} has a value that is not a finite number; correct it.")


def swing_times(footsteps: Sequence[Footstep], gait: PlanConstants) -> list[tuple[float, float]]:
    """Lift-off and landing of every swing [s]: by the gait's durations, or at the footstep's time.

    Raises InputError if a time leaves a swing less than the gait's double support.
    """
    single, double = gait.single_support_duration, gait.double_support_duration
    swings, lifted = [], SETTLING
    for number, step in enumerate(footsteps[2:], start=3):
        landing = lifted + single if step.time is None else step.time
        if not landing - lifted >= double:
            raise InputError(
                f"footstep {number} is reached at {landing:g} s, but its swing begins at {lifted:.4g} s; "
                f"give a time such as the gait's, {lifted + single:.4g} s, {lifted + double:.4g} s at least."
            )
        swings.append((lifted, landing))
        lifted = landing + double
    return swings


def problem_of(
    footsteps: Sequence[Footstep], contacts: Contacts, gait: GaitParameters, weight: float
) -> Problem:
    """The problem of a walk of a body with a weight [N]."""
    w, singles = math.sqrt(GRAVITY / gait.com_height), len(footsteps) - 2
    place = np.array([step.position[:2] for step in footsteps])
    heading = np.array([step.heading for step in footsteps[1:-1]])
    duration = np.array([phase.duration for phase in contacts.phases])
    single, double = duration[1::2], duration[2:-1:2]
    # Rates of the paper's double support of these durations.
    share, rate = gait.single_support_ratio, w * math.sqrt(gait.c_y)
    along = w * math.sqrt((gait.c_s - 1.0 / gait.a_s) * share / (1.0 - share))
    across = rate / double_support_root(np.tanh(0.5 * rate * single[:-1]), 0.5 * rate * double)
    blend = np.stack([np.full_like(double, along), across], axis=1)
    return Problem(
        place=place[1:-1],
        axes=rotations(heading),
        single=single,
        double=double,
        between=rotations(mean_heading(heading[:-1], heading[1:])),
        blend=np.minimum(blend, _STEEPEST / double[:, None]),
        frequency=w,
        inverse_a=np.full(singles, 1.0 / gait.a_s),
        slopes=np.tile([gait.c_s, gait.c_y], (singles, 1)),
        ends=np.stack([place[:2].mean(axis=0), place[-2:].mean(axis=0)]),
        weight=weight,
    )


def _largest_inverse_a(solved: Solution, sole: SoleGeometry) -> Array:
    """The ``1/a_s`` of every support that keeps the ZMP of a solution from heel and tip, shape (N,) [1]."""
    problem = solved.problem
    room = zmp_margin(sole) + _ROOM
    ahead, behind = sole.tip_x - room, -sole.heel_x - room
    from_foot = np.stack([solved.state[:, 0], solved.end[:, 0]], axis=1) - problem.place[:, None]
    along = (from_foot * problem.axes[:, None, :, 0]).sum(axis=2)
    with np.errstate(divide="ignore", over="ignore"):
        at_tip, at_heel = np.maximum(along.max(axis=1), 0.0), np.maximum(-along.min(axis=1), 0.0)
        return np.asarray(np.minimum(ahead / at_tip, behind / at_heel))


def _gentler(solved: Solution) -> Array:
    """Share of ``c_s - 1`` and ``c_y - 1`` of every support that keeps the trunk upright enough, (N,) [1].

    The supports before and after one share its angular momentum.
    """
    tilt = trunk_tilt(solved)
    share = np.where(tilt > LARGEST_TILT, _GENTLE * LARGEST_TILT / np.maximum(tilt, LARGEST_TILT), 1.0)
    around = sliding_window_view(np.pad(share, _NEAR, constant_values=1.0), 2 * _NEAR + 1)
    return around.min(axis=1)


def trunk_tilt(solved: Solution) -> Array:
    """Largest angle by which every support's angular momentum turns the trunk, shape (N,) [rad].

    About zero in the middle of double support, Theta is largest about the middle of single support.
    """
    height = GRAVITY / solved.problem.frequency**2
    return np.asarray(GRAVITY / (_TRUNK_INERTIA * height**2) * np.sqrt((solved.halfway**2).sum(axis=1)))


def _phases(starts: Sequence[float], solved: Solution) -> list[CentroidalPhase]:
    """Phases of a walk whose supports start at some times [s]; both stands have four."""
    problem = solved.problem
    phases = [*_stand_phases(starts[0], 0, solved), _single_phase(starts[1], 0, solved)]
    for k, duration in enumerate(problem.double.tolist()):
        signal = np.stack([solved.signal[k, 1], solved.signal[k + 1, 0]])
        begin, rate, axes = starts[2 * k + 2], problem.blend[k], problem.between[k]
        phases.append(_blend_phase(begin, duration, rate, axes, signal, solved.end[k], problem))
        phases.append(_single_phase(starts[2 * k + 3], k + 1, solved))
    return phases + _stand_phases(starts[-1], 1, solved)


def _single_phase(start: float, k: int, solved: Solution) -> CentroidalPhase:
    """Single support k; its offset d moves the origin of the law off the foot."""
    problem, state = solved.problem, solved.state[k]
    place, axes = problem.place[k], problem.axes[k]
    duration, square = float(problem.single[k]), problem.frequency**2
    zmp_slope, slope = np.array([problem.inverse_a[k], 0.0]), problem.slopes[k]
    rate = square * (slope - zmp_slope)
    moved = -square / rate * (state[4] @ axes)
    root = np.sqrt(np.abs(rate))
    even, odd = solution(rate, (state[0] - place) @ axes - moved, state[1] @ axes / root, 0.5 * duration)
    columns = rate, zmp_slope, slope, np.full(2, duration), even, odd / root, (zmp_slope - 1.0) * moved
    laws = [AffineLaw(*law) for law in np.array(columns).T.tolist()]
    return _phase(start, duration, place + axes @ moved, axes, laws, state[2], problem.weight)


def _blend_phase(
    start: float, duration: float, rate: Array, axes: Array, signal: Array, state: Array, problem: Problem
) -> CentroidalPhase:
    """A blend from (c, v, J, ...) at its begin; its origin is between both points r.

    Rates k, shape (2,), are along the axes; (r, q) at begin and end, shape (2, 2, 2), in world.
    """
    origin = signal[:, 0].mean(axis=0)
    position, velocity = (state[0] - origin) @ axes, state[1] @ axes
    point, arm = (signal[:, 0] - origin) @ axes, signal[:, 1] @ axes
    w, columns = problem.frequency, np.stack([rate, position, velocity]).T.tolist()
    laws = [
        BlendLaw(w, k, duration, c, v, tuple(point[:, i].tolist()), tuple(arm[:, i].tolist()))
        for i, (k, c, v) in enumerate(columns)
    ]
    return _phase(start, duration, origin, axes, laws, state[2], problem.weight)


def _phase(
    start: float, duration: float, origin: Array, axes: Array, laws: Sequence[Law], J: Array, weight: float
) -> CentroidalPhase:
    """A phase of the laws along both axes, with the angular momentum at its begin."""
    momentum = float(weight * J[1]), float(-weight * J[0])
    heading = math.atan2(axes[1, 0], axes[0, 0])
    place = float(origin[0]), float(origin[1])
    return CentroidalPhase(start, duration, place, laws[0], laws[1], momentum, heading)


def _stand_phases(start: float, end: int, solved: Solution) -> list[CentroidalPhase]:
    """Four linear blends in a row: the first (0) or the last (1) double support."""
    problem, signal, part = solved.problem, solved.stands[end], 0.25 * SETTLING
    state = solved.end[-1, :3] if end else np.stack([problem.ends[0], np.zeros(2), np.zeros(2)])
    phases = []
    for i in range(4):
        ends = signal[i : i + 2]
        phases.append(_blend_phase(start + i * part, part, np.zeros(2), np.eye(2), ends, state, problem))
        along = [law.evaluate(part) for law in (phases[-1].x, phases[-1].y)]
        gained = np.array([[at.position, at.velocity, at.moment_arm_integral] for at in along]).T
        state = gained + np.stack([phases[-1].origin, np.zeros(2), state[2]])
    return phases


def _refuse(
    footsteps: Sequence[Footstep], solved: Solution, body: BodyDescription, plan: CentroidalPlan, first: int
) -> None:
    """Refuse feet that cross, a ZMP near an edge, and a trunk that turns too far."""
    refuse_crossing(footsteps, body.sole, first)
    number, margin = _least_margin(footsteps, body.sole, plan)
    if not margin >= (least := zmp_margin(body.sole)):
        raise BodilyRefusal(
            f"footsteps {first - 1 + number} and {first + number}: the ZMP comes to {1e3 * margin:.3g} mm "
            f"from the edge of the flat soles, nearer than {1e3 * least:.3g} mm",
            reason="zmp_margin_too_small",
            value=margin,
            limit=least,
            unit="m",
            way_out="shorten or narrow the steps there, or give them more time; places are in metres",
        )
    tilt = trunk_tilt(solved)
    worst = int(tilt.argmax())
    if not tilt[worst] <= LARGEST_TILT:
        raise BodilyRefusal(
            f"footstep {worst + 1 + first}: the angular momentum turns the trunk by about {tilt[worst]:.2g} "
            f"rad, more than {LARGEST_TILT:g} rad",
            reason="trunk_tilt_too_large",
            value=float(tilt[worst]),
            limit=LARGEST_TILT,
            unit="rad",
            way_out="take gait.c_y and gait.c_s nearer to 1, or narrow the steps",
        )


def refuse_crossing(footsteps: Sequence[Footstep], sole: SoleGeometry, first: int = 1) -> None:
    """Refuse a foot that lands across the other one; ``first`` is the number of the first footstep."""
    place = np.array([step.position[:2] for step in footsteps])
    heading = np.array([step.heading for step in footsteps])
    turns = np.abs(np.diff(heading, prepend=0.0 if first == 1 else heading[0]))
    if not turns.max() <= 2.0 * math.tau:
        number = int(turns.argmax())
        raise InputError(
            f"footstep {number + first} has a heading of {heading[number]:g} rad, over two turns from "
            "the one before, or from 0; give headings in radians."
        )
    axes = rotations(mean_heading(heading[:-1], heading[1:]))
    side = np.array([1.0 if step.foot == "left" else -1.0 for step in footsteps[1:]])
    apart = side * (np.diff(place, axis=0) * axes[:, :, 1]).sum(axis=1)
    worst, least = int(apart.argmin()), 2.0 * sole.half_width + _BETWEEN_SOLES
    if not apart[worst] >= least:
        raise BodilyRefusal(
            f"footsteps {worst + first} and {worst + 1 + first}: the {footsteps[worst + 1].foot} foot is "
            f"{apart[worst]:.3g} m to its own side of the other, less than the {least:.3g} m of two soles",
            reason="feet_too_close",
            value=float(apart[worst]),
            limit=least,
            unit="m",
            way_out="exchange left and right, or the sign of y"
            if apart.max() < 0.0
            else "put it further out on its own side, and give headings in radians",
        )


def zmp_margin(sole: SoleGeometry) -> float:
    """Least distance of the ZMP from the edge of the flat soles that stand, less of narrow ones [m]."""
    return min(0.015, 0.6 * sole.half_width)


def _least_margin(steps: Sequence[Footstep], sole: SoleGeometry, plan: CentroidalPlan) -> tuple[int, float]:
    """Least distance of the ZMP from the edge of the flat soles, and the footstep before that step, from 1.

    Evaluated at the quarters of every phase: on a straight way the distance is least at an end.
    """
    outlines, phases = np.stack([footprint(sole, step)[:-1] for step in steps]), plan.contacts.phases
    standing = np.empty((len(phases), 2 * outlines.shape[1], 2))
    standing[0::2] = np.concatenate([outlines[:-1], outlines[1:]], axis=1)
    standing[1::2] = np.concatenate([outlines[1:-1], outlines[1:-1]], axis=1)
    start, duration = np.array([phase[:2] for phase in phases]).T
    instants = start[:, None] + duration[:, None] * np.linspace(0.0, 1.0, 5)
    margin = hull_distance(standing.repeat(5, axis=0), plan.sample(instants.ravel()).zmp)
    margin = margin.reshape(-1, 5).min(axis=1)
    worst = int(margin.argmin())
    return 2 + max(worst - 1, 0) // 2, float(margin[worst])
