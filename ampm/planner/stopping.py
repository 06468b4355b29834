"""A walk over footsteps, stopped on request: the foot that swings lands elsewhere, the other one beside it.

The single support goes on as it is; its velocity cannot be changed. The place of the next footstep can: the
velocity that the rest of the walk lacks is affine in this place, so three solves give the place at which none
is lacking. Until the request the walk is the old one, to the last bit.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ampm.description import BodyDescription
from ampm.exceptions import BodilyRefusal, InputError
from ampm.parameters import RunParameters
from ampm.planner.contacts import Contacts, Footstep, Phase
from ampm.planner.feet import FeetPlan, FootPath
from ampm.planner.footstep_walk import REST, plan_footstep_walk, rest_after
from ampm.planner.footsteps import SOLVES, Walk, largest_inverse_a, phases_between, solve_walk
from ampm.planner.rest_to_rest import (
    SETTLING,
    Problem,
    Solution,
    Supports,
    in_world,
    single_maps,
    solve,
    times,
)
from ampm.planner.routes import footsteps_of
from ampm.planner.stride import quintic, shift
from ampm.planner.support import StepPlan
from ampm.planner.swings import plan_swings

Array = NDArray[np.float64]

LEAST_LEFT = 0.25
"""Least share of a swing that must be left to move its landing; after it the next step is moved [1]."""
_FARTHEST = 0.35  # most by which a landing is moved, as a share of the leg's length [1]
_TRIAL = 0.01  # displacement of the landing in the second and third solve [m]


def plan_stop(run: RunParameters, body: BodyDescription, at: float) -> StepPlan:
    """Plan the walk over the footsteps of a run, stopped on a request.

    A request in double support, or at the end of a swing, is met by the next swing. One during the last
    swing changes nothing.

    Args:
        run: gait, feet, and at least four footsteps.
        body: its mass, soles and lengths.
        at: time of the request [s].

    Raises:
        InputError: the time is negative, or no number; or there is no such walk.
        MathematicalRefusal: the gait has no closed form.
        BodilyRefusal: the landing would have to move too far.
    """
    if not at >= 0.0:
        raise InputError(f"a stop at {at:g} s is before the walk; give a time from 0 s on.", value=at)
    before = plan_footstep_walk(run, body)
    footsteps, landings = footsteps_of(run)
    walk = solve_walk(footsteps, run.gait, body, landings)
    starts, n = walk.contacts.starts[1::2], len(walk.supports.single)
    latest = starts + (1.0 - LEAST_LEFT) * walk.supports.single - max(run.foot.heel_rise_lead, 0.0)
    k = int(np.searchsorted(latest, at))
    if k >= n - 1:
        return before
    begin = max(at, float(starts[k]))
    supports, problem, solved, ahead = _solve_stop(walk, k, begin, run, body)
    contacts = _contacts(walk, k, ahead)
    old = tuple(phase for phase in before.phases if phase.start < begin)
    cut = old[-1]._replace(duration=begin - old[-1].start)
    rest = phases_between(
        np.array([begin, *contacts.starts[2 * k + 2 :]]), supports, problem, solved, body.mass
    )
    plan = replace(walk.nominal, contacts=contacts, phases=(*old[:-1], cut, *rest))
    plan = rest_after(plan, REST)
    feet = plan_swings(plan, run.foot, body.sole, run.gait.step_length)
    side = footsteps[k].foot
    joined = {
        foot: _joined(
            getattr(before.feet, foot), getattr(feet, foot), begin, contacts.starts[2 * k + 2], foot == side
        )
        for foot in ("left", "right")
    }
    return StepPlan.of(plan, feet=FeetPlan(body.sole, joined["left"], joined["right"], plan.duration))


def _solve_stop(
    walk: Walk, k: int, begin: float, run: RunParameters, body: BodyDescription
) -> tuple[Supports, Problem, Solution, tuple[Footstep, Footstep]]:
    """The rest of single support k, one step, and the two footsteps ahead."""
    supports, steps = walk.supports, walk.contacts.footsteps
    start, single = float(walk.contacts.starts[2 * k + 1]), float(supports.single[k])
    left = start + single - begin
    # State at the request: that at the begin of the support, moved on.
    passed = np.array([begin - start])
    inverse_a = np.array([walk.solved.inverse_a[k], 1.0 / run.gait.a_s])
    move = in_world(single_maps(walk.problem, inverse_a[:1], passed)[0], supports.axes[k : k + 1])
    place, state = supports.place[k], walk.solved.state[k]
    moved = times(move[0], np.concatenate([[state[0] - place], state[1:]]).ravel()).reshape(4, 2)
    moved[0] += place
    here, landing = steps[k + 1], steps[k + 2]
    heading = landing.heading
    side = 1.0 if landing.foot == "left" else -1.0
    across = np.array([-math.sin(heading), math.cos(heading)])
    beside = -side * run.gait.step_width * across
    nominal = np.array(landing.position[:2])
    new = Supports(
        place=np.stack([place, nominal]),
        axes=np.stack([supports.axes[k], supports.axes[k + 1]]),
        single=np.array([left, supports.single[k + 1]]),
        double=supports.double[k : k + 1],
        between=supports.between[k : k + 1],
        blend=supports.blend[k : k + 1],
    )
    given = np.concatenate([moved, state[4:5]])

    def solve_at(point: Array, slopes: Array) -> tuple[Supports, Problem, Solution]:
        tried = new._replace(place=np.stack([place, point]))
        ends = np.stack([point, point + 0.5 * beside])
        problem = walk.problem._replace(ends=ends, begin=given)
        return tried, problem, solve(tried, problem, slopes)

    for _ in range(SOLVES):
        lacking = [
            solve_at(nominal + shifted, inverse_a)[2].nodes[0, 0]
            for shifted in ((0.0, 0.0), (_TRIAL, 0.0), (0.0, _TRIAL))
        ]
        slope = np.stack([lacking[1] - lacking[0], lacking[2] - lacking[0]], axis=1) / _TRIAL
        point = nominal - np.linalg.solve(slope, lacking[0])
        tried, problem, solved = solve_at(point, inverse_a)
        largest = largest_inverse_a(tried, solved, body.sole)
        if inverse_a[1] * (1.0 - 1e-3) <= largest[1]:
            break
        inverse_a = np.array([inverse_a[0], min(inverse_a[1], float(largest[1]))])
    distance, most = float(np.hypot(*(point - nominal))), _FARTHEST * body.leg_length
    if not distance <= most:
        raise BodilyRefusal(
            f"a stop at {begin:.3f} s moves footstep {k + 3} by {distance:.3g} m, more than {most:.3g} m",
            reason="stop_out_of_reach", value=distance, limit=most, unit="m", way_out="walk slower",
        )  # fmt: skip
    ahead = (
        Footstep(landing.foot, (float(point[0]), float(point[1]), 0.0), heading),
        Footstep(here.foot, (*map(float, point + beside), 0.0), heading),
    )
    return tried, problem, solved, ahead


def _contacts(walk: Walk, k: int, ahead: tuple[Footstep, Footstep]) -> Contacts:
    """Contacts of the walk up to single support k, then of the two footsteps ahead."""
    old, (landing, closing) = walk.contacts, ahead
    phases = list(old.phases[: 2 * k + 2])
    here = old.footsteps[k + 1]
    for step, duration in ((landing, walk.supports.double[k]), (closing, SETTLING)):
        if step is closing:
            start = phases[-1].start + phases[-1].duration
            phases.append(_phase(start, float(walk.supports.single[k + 1]), landing))
            here = landing
        start = phases[-1].start + phases[-1].duration
        phases.append(_phase(start, float(duration), here, step))
    return Contacts((*old.footsteps[: k + 2], landing, closing), tuple(phases))


def _phase(start: float, duration: float, *standing: Footstep) -> Phase:
    feet = {step.foot: step for step in standing}
    return Phase(start, duration, feet.get("left"), feet.get("right"))


def _joined(old: FootPath, new: FootPath, begin: float, landed: float, swings: bool) -> FootPath:
    """The old path until the request, then the new one; a swing under way is bent to the new landing."""
    tiny = 1e-9
    kept, later = old.start < begin - tiny, new.start > begin - tiny
    pieces = [(old, np.flatnonzero(kept), old.start[kept], None)]
    if swings:
        later = new.start > landed - tiny
        after = np.flatnonzero((old.start > begin - tiny) & (old.start < landed - tiny))
        rows = np.concatenate([np.flatnonzero(kept)[-1:], after])
        since = np.concatenate([[begin], old.start[after]])
        gap = _curve_at(new, landed - 1e-12) - _curve_at(old, landed - 1e-12)
        bend = quintic(np.zeros_like(gap), gap, np.full(gap.shape[1:], landed - begin))
        pieces.append((old, rows, since, bend))
    pieces.append((new, np.flatnonzero(later), new.start[later], None))
    parts = []
    for path, rows, since, bend in pieces:
        curves = np.concatenate(
            [path.path[rows], *(values[rows][:, None] for values in (path.pitch, path.toe, path.heading))],
            axis=1,
        )
        if bend is not None:
            curves = shift(curves, since - path.start[rows])
            bent = np.zeros((len(rows), *curves.shape[1:]))
            bent[:, :, : bend.shape[-1]] = bend
            curves = curves + shift(bent, since - begin)
        parts.append((since, path.pivot[rows], curves, path.contact[rows]))
    start, pivot, curve, contact = (np.concatenate(values) for values in zip(*parts, strict=True))
    return FootPath(
        start=start, pivot=pivot, path=curve[:, :3].copy(), pitch=curve[:, 3].copy(), toe=curve[:, 4].copy(),
        contact=contact, heading=curve[:, 5].copy(),
    )  # fmt: skip


def _curve_at(path: FootPath, time: float) -> Array:
    """Value, rate and acceleration of x, y, z, pitch, toe and heading of a path, shape (3, 6)."""
    row = int(np.searchsorted(path.start, time, side="right")) - 1
    curves = np.concatenate([path.path[row], [path.pitch[row], path.toe[row], path.heading[row]]])
    local = np.array([time - path.start[row]])
    moved = shift(curves[None], local)[0]
    return np.asarray(moved[:, :3].T * np.array([1.0, 1.0, 2.0])[:, None])
