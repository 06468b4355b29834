"""A walk over footsteps that is changed on request, also in mid-swing: other footsteps, or a stop.

The single support goes on as it is; its velocity cannot be changed. The place of the next footstep can: the
velocity that the rest of the walk lacks is affine in this place, so three solves give the place at which none
is lacking. Until the request the walk is the old one, to the last bit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ampm.brief import Brief
from ampm.description import BodyDescription
from ampm.exceptions import BodilyRefusal, InputError
from ampm.parameters import RunParameters
from ampm.planner.contacts import Contacts, Footstep
from ampm.planner.feet import FeetPlan, FootPath
from ampm.planner.footstep_walk import REST, plan_footstep_walk, rest_after, stands
from ampm.planner.footsteps import (
    SOLVES,
    Walk,
    check_footsteps,
    contacts_over,
    gentler,
    largest_inverse_a,
    phases_between,
    refuse_crossing,
    solve_walk,
    supports_of,
)
from ampm.planner.heights import uneven
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
from ampm.planner.routes import as_rows, footsteps_of
from ampm.planner.stride import quintic, shift
from ampm.planner.support import StepPlan
from ampm.planner.swings import plan_swings

Array = NDArray[np.float64]

LEAST_LEFT = 0.25
"""Least share of a swing that must be left to move its landing; after it the next step is moved [1]."""
_FARTHEST = 0.35  # most by which a landing is moved, as a share of the leg's length [1]
_TRIAL = 0.01  # displacement of the landing in the second and third solve [m]


@dataclass(frozen=True)
class LiveWalk(Brief):
    """A walk over footsteps, and what is needed to change it.

    Attributes:
        run: gait and feet.
        body: its mass, soles and lengths.
        steps: COM, ZMP, momentum and feet.
        walk: the solution behind them.
    """

    run: RunParameters
    body: BodyDescription
    steps: StepPlan
    walk: Walk

    @classmethod
    def of(cls, run: RunParameters, body: BodyDescription) -> LiveWalk:
        """The walk over the footsteps of a run.

        Raises:
            InputError, MathematicalRefusal, BodilyRefusal: there is no such walk, or it stands on the way.
        """
        footsteps, landings = footsteps_of(run)
        if stands(run, landings) != [(0, len(footsteps), 0.0)]:
            raise InputError(
                "a walk that stands on the way takes no requests; leave out the requests, or the times."
            )
        _refuse_heights(footsteps)
        return cls(run, body, plan_footstep_walk(run, body), solve_walk(footsteps, run.gait, body, landings))

    def stopped(self, at: float) -> LiveWalk:
        """The walk, stopped on a request: the other foot lands beside the next footstep.

        A request in double support, or at the end of a swing, is met by the next swing. One during the last
        swing changes nothing.

        Args:
            at: time of the request [s].

        Raises:
            InputError: the time is negative, or no number.
            BodilyRefusal: the landing would have to move too far.
        """
        k = self._swing(at)
        if k >= self.walk.contacts.steps - 1:
            return self
        here, landing = self.walk.contacts.footsteps[k + 1 : k + 3]
        aside = self.run.gait.step_width * (-1.0 if landing.foot == "left" else 1.0)
        x, y, _ = landing.position
        place = x - aside * math.sin(landing.heading), y + aside * math.cos(landing.heading), 0.0
        return self._changed(k, at, [landing, Footstep(here.foot, place, landing.heading)], whole=True)

    def changed(self, at: float, footsteps: Sequence[Footstep], *, whole: bool = False) -> LiveWalk:
        """The walk, continued over other footsteps from a request on.

        The request is met as one to stop. The first footstep is moved so that velocities agree. The others
        stay where they are asked for, or move with it.

        Args:
            at: time of the request [s].
            footsteps: from the one on which the foot lands that swings, two or more, left and right in turn.
            whole: move all of them.

        Raises:
            InputError: the time is negative, no number, or too late; or the footsteps do not go on.
            BodilyRefusal: the landing would have to move too far, or feet would cross.
        """
        as_rows(footsteps)  # refuses what is none
        k = self._swing(at)
        if self.ends_before(at):
            raise InputError(f"a change at {at:g} s comes when the walk has ended; ask earlier.", value=at)
        return self._changed(k, at, list(footsteps), whole=whole)

    def again(self, footsteps: Sequence[Footstep]) -> LiveWalk:
        """Another walk, from standing where this one ends; its time begins at 0.

        Args:
            footsteps: two or more, left and right in turn; the foot that landed last but one swings first.

        Raises:
            InputError, BodilyRefusal: there is no such walk.
        """
        run = self.run.replace({}, footsteps=as_rows([*self.walk.contacts.footsteps[-2:], *footsteps]))
        return LiveWalk.of(run, self.body)

    def ends_before(self, at: float) -> bool:
        """Whether a time [s] is too late for any swing to meet a request."""
        return self._swing(at) >= self.walk.contacts.steps

    @property
    def rests_from(self) -> float:
        """When the walk has come to rest [s]."""
        return float(self.walk.contacts.starts[-1]) + SETTLING

    def next_landing(self, at: float) -> int:
        """Number of the footstep, from 0, that a request at a time [s] moves first."""
        return self._swing(at) + 2

    def _swing(self, at: float) -> int:
        """Number of the swing that meets a request, from 0."""
        if not at >= 0.0:
            raise InputError(f"a request at {at:g} s is not in the walk; give a time from 0 s on.", value=at)
        lead = max(self.run.foot.heel_rise_lead, 0.0)
        latest = self.walk.contacts.starts[1::2] + (1.0 - LEAST_LEFT) * self.walk.supports.single - lead
        return int(np.searchsorted(latest, at))

    def _changed(self, k: int, at: float, ahead: list[Footstep], *, whole: bool) -> LiveWalk:
        """Continue over footsteps ahead; the landing moves, or the ``whole`` rest of the walk."""
        old = self.walk.contacts
        footsteps = [*old.footsteps[: k + 2], *ahead]
        if len(ahead) < 2:
            raise InputError(
                f"a change takes at least 2 footsteps, not {len(ahead)}; give where both feet land."
            )
        check_footsteps(footsteps)
        _refuse_heights(footsteps)
        landings = [None, None, *old.starts[2 : 2 * k + 3 : 2].tolist(), *[None] * (len(ahead) - 1)]
        begin = max(at, float(old.starts[2 * k + 1]))
        rest, moved = self._solved(
            k, begin, footsteps, contacts_over(footsteps, self.walk.nominal, landings), whole
        )
        footsteps[k + 2] = _moved(footsteps[k + 2], moved)
        if whole:
            footsteps[k + 3 :] = [_moved(step, moved) for step in footsteps[k + 3 :]]
        refuse_crossing(footsteps[k + 1 :], self.body.sole, k + 2)
        contacts = contacts_over(footsteps, self.walk.nominal, landings)
        supports, problem, solved = rest
        kept = tuple(phase for phase in self.steps.phases if phase.start < begin)
        cut = kept[-1]._replace(duration=begin - kept[-1].start)
        new = phases_between(
            np.array([begin, *contacts.starts[2 * k + 2 :]]), supports, problem, solved, self.body.mass
        )
        nominal = self.walk.nominal
        plan = rest_after(replace(nominal, contacts=contacts, phases=(*kept[:-1], cut, *new)), REST)
        feet = plan_swings(plan, self.run.foot, self.body.sole, self.run.gait.step_length)
        landed, swings = float(contacts.starts[2 * k + 2]), footsteps[k].foot
        left, right = (
            _joined(getattr(self.steps.feet, foot), getattr(feet, foot), begin, landed, foot == swings)
            for foot in ("left", "right")
        )
        steps = StepPlan.of(plan, feet=FeetPlan(self.body.sole, left, right, plan.duration))
        walk = Walk(
            nominal,
            contacts,
            supports_of(footsteps, contacts, self.run.gait),
            self.walk.problem._replace(
                ends=problem.ends, slopes=np.concatenate([self.walk.problem.slopes[:k], problem.slopes])
            ),
            Solution._make(
                [
                    *(
                        np.concatenate([before[: k + 1], after[1:]])
                        for before, after in zip(self.walk.solved[:4], solved[:4], strict=True)
                    ),
                    solved.nodes,
                ]
            ),
        )
        return replace(self, steps=steps, walk=walk)

    def _solved(
        self, k: int, begin: float, footsteps: Sequence[Footstep], contacts: Contacts, whole: bool
    ) -> tuple[tuple[Supports, Problem, Solution], Array]:
        """The rest of the walk from an instant of single support k on, and by how much its landing moves."""
        walk, run = self.walk, self.run
        start, state = float(walk.contacts.starts[2 * k + 1]), walk.solved.state[k]
        place, axes = walk.supports.place[k], walk.supports.axes[k : k + 1]
        inverse_a = np.full(len(footsteps) - k - 2, 1.0 / run.gait.a_s)
        inverse_a[0] = walk.solved.inverse_a[k]
        # State at the request: that at the begin of the support, moved on.
        slopes = np.tile([run.gait.c_s, run.gait.c_y], (len(inverse_a), 1))
        slopes[0] = walk.problem.slopes[k]
        standing = walk.problem._replace(slopes=slopes[:1])
        move = in_world(single_maps(standing, inverse_a[:1], np.array([begin - start]))[0], axes)
        here = times(move[0], np.concatenate([[state[0] - place], state[1:]]).ravel()).reshape(4, 2)
        here[0] += place
        given = np.concatenate([here, state[4:5]])
        supports = Supports(*(values[k:] for values in supports_of(footsteps, contacts, run.gait)))
        supports.single[0] = start + supports.single[0] - begin
        ends = np.array([step.position[:2] for step in footsteps[-2:]])
        moves = np.zeros((len(inverse_a), 1))
        moves[1] = 1.0
        if whole:
            moves[1:] = 1.0
        last = np.array([1.0 if whole or len(inverse_a) == 2 else 0.0, 1.0 if whole else 0.0])[:, None]

        def solve_moved(by: Array) -> tuple[Supports, Problem, Solution]:
            tried = supports._replace(place=supports.place + moves * by)
            to = np.stack([by, (ends + last * by).mean(axis=0)])
            problem = walk.problem._replace(slopes=slopes, ends=to, begin=given)
            return tried, problem, solve(tried, problem, inverse_a)

        for _ in range(SOLVES):
            trials = np.array([[0.0, 0.0], [_TRIAL, 0.0], [0.0, _TRIAL]])
            lacking = [solve_moved(by)[2].nodes[0, 0] for by in trials]
            slope = np.stack([lacking[1] - lacking[0], lacking[2] - lacking[0]], axis=1) / _TRIAL
            by = -np.linalg.solve(slope, lacking[0])
            found = solve_moved(by)
            largest = largest_inverse_a(found[0], found[2], self.body.sole)[1:]
            share = gentler(*found)[1:]
            if (inverse_a[1:] * (1.0 - 1e-3) <= largest).all() and (share == 1.0).all():
                break
            inverse_a = np.concatenate([inverse_a[:1], np.minimum(inverse_a[1:], largest)])
            slopes = np.concatenate([slopes[:1], 1.0 + share[:, None] * (slopes[1:] - 1.0)])
        distance, most = float(np.hypot(*by)), _FARTHEST * self.body.leg_length
        if not distance <= most:
            raise BodilyRefusal(
                f"the request at {begin:.3f} s moves footstep {k + 3} by {distance:.3g} m, more than "
                f"{most:.3g} m",
                reason="change_out_of_reach", value=distance, limit=most, unit="m",
                way_out="walk slower, or ask for footsteps nearer to those before",
            )  # fmt: skip
        return found, by


def _refuse_heights(footsteps: Sequence[Footstep]) -> None:
    if uneven(footsteps):
        raise InputError(
            "a walk over footsteps with heights takes no requests; leave out the requests, or the heights."
        )


def _moved(step: Footstep, by: Array) -> Footstep:
    x, y, z = step.position
    return step._replace(position=(x + float(by[0]), y + float(by[1]), z))


def _joined(old: FootPath, new: FootPath, begin: float, landed: float, swings: bool) -> FootPath:
    """The old path until the request, then the new one; a swing under way is bent to the new landing."""
    tiny = 1e-9
    kept, later = old.start < begin - tiny, new.start > begin - tiny
    pieces: list[tuple[FootPath, NDArray[np.intp], Array, Array | None]]
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
    for path, rows, since, bending in pieces:
        curves = np.concatenate(
            [path.path[rows], *(values[rows][:, None] for values in (path.pitch, path.toe, path.heading))],
            axis=1,
        )
        if bending is not None:
            curves = shift(curves, since - path.start[rows])
            bent = np.zeros((len(rows), *curves.shape[1:]))
            bent[:, :, : bending.shape[-1]] = bending
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
