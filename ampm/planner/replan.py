"""A walk over footsteps that is changed on a request: it goes on over others, or stops.

The single support goes on as it is; its velocity cannot be changed. The place of the next footstep can, and
all later ones move with it: the velocity that the rest of the walk lacks is affine in this place, so three
solves give the place at which none is lacking. Until the request the walk is the old one, to the last bit.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ampm.description import BodyDescription
from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.parameters import RunParameters
from ampm.planner import footsteps as walks
from ampm.planner.contacts import Contacts, Footstep
from ampm.planner.feet import FeetPlan, FootPath
from ampm.planner.footstep_walk import in_turn, plan_footstep_walk, stands, with_feet
from ampm.planner.heights import uneven
from ampm.planner.rest_to_rest import Problem, Solution, Supports, in_world, single_maps, solve, times
from ampm.planner.routes import as_rows, footsteps_of
from ampm.planner.stride import quintic, shift
from ampm.planner.support import StepPlan

LEAST_LEFT = 0.25
"""Least share of a swing that must be left to move its landing; after it the next step is moved [1]."""
_TRIAL = 0.01  # displacement of the landing in the second and third solve [m]


class LiveWalk(NamedTuple):
    """A walk over footsteps, and what is needed to change it."""

    run: RunParameters  # gait and feet
    body: BodyDescription  # its mass, soles and lengths
    steps: StepPlan  # COM, ZMP, momentum and feet
    walk: walks.Walk  # the solution behind the rest of the walk, and all contacts
    first: int  # number of the first single support of that rest, from 0
    begin: float  # when the rest begins, in that support or with it [s]

    @classmethod
    def of(cls, run: RunParameters, body: BodyDescription) -> "LiveWalk":
        """The walk over the footsteps of a run.

        Raises:
            InputError, MathematicalRefusal, BodilyRefusal: there is no such walk, it stands on the way, or
                its footsteps have heights.
        """
        footsteps, landings = footsteps_of(run)
        if stands(run, landings) != [(0, len(footsteps), 0.0)] or uneven(footsteps):
            raise InputError(
                "a walk that stands on the way, or has heights, takes no requests; leave out the requests."
            )
        walk = walks.solve_walk(footsteps, run.gait, body, landings)
        return cls(run, body, plan_footstep_walk(run, body), walk, 0, float(walk.contacts.starts[1]))

    def changed(self, at: float, ahead: Sequence[Footstep] | None) -> "LiveWalk":
        """The walk, continued over other footsteps from a request on.

        A request in double support, or at the end of a swing, is met by the next swing.

        Args:
            at: time of the request, not before the swing that met the last one [s].
            ahead: from the one on which the foot lands that swings, two or more, left and right in turn. All
                of them are moved by the displacement with which velocities agree. None: the walk stops, the
                other foot beside the next footstep; in the last swing this changes nothing.

        Raises:
            InputError: the time is too early or too late, or the footsteps do not go on.
            BodilyRefusal: feet would cross.
        """
        old, run = self.walk.contacts, self.run
        k = self._swing(at)
        if not at >= 0.0 or k < self.first:
            raise InputError(f"a request at {at:g} s comes before the rest of the walk; ask later.", value=at)
        if ahead is None and k >= old.steps - 1:
            return self
        if k >= old.steps:
            raise InputError(f"a change at {at:g} s comes when the walk has ended; ask earlier.", value=at)
        ahead = self._beside(k) if ahead is None else list(ahead)
        as_rows(ahead)  # rejects malformed footsteps
        if len(ahead) < 2:
            raise InputError(
                f"a change takes at least 2 footsteps, not {len(ahead)}; give where both feet land."
            )
        footsteps = [*old.footsteps[: k + 2], *ahead]
        walks.check_footsteps(footsteps)
        if uneven(footsteps):
            raise InputError("a change takes no footsteps with heights; leave the heights out.")
        landings = [None, None, *old.starts[2 : 2 * k + 3 : 2].tolist(), *[None] * (len(ahead) - 1)]
        begin = max(at, float(old.starts[2 * k + 1]))
        contacts = walks.contacts_over(footsteps, self.walk.nominal, landings)
        solved, by = self._rest(k, begin, footsteps, contacts)
        footsteps[k + 2 :] = [_moved(step, by) for step in ahead]
        walks.refuse_crossing(footsteps[k + 1 :], self.body.sole, k + 2)
        contacts = walks.contacts_over(footsteps, self.walk.nominal, landings)
        kept = [phase for phase in self.steps.phases if phase.start < begin]
        kept[-1] = kept[-1]._replace(duration=begin - kept[-1].start)
        starts = np.array([begin, *contacts.starts[2 * k + 2 :]])
        new = walks.phases_between(starts, solved)
        plan = replace(self.walk.nominal, contacts=contacts, phases=(*kept, *new))
        steps = with_feet(in_turn([(0.0, plan)]), run, self.body)
        before, after, until = self.steps.feet, steps.feet, float(contacts.starts[2 * k + 2])
        feet = joined(before, after, begin, until)
        walk = walks.Walk(self.walk.nominal, contacts, solved)
        return LiveWalk(run, self.body, replace(steps, feet=feet), walk, k, begin)

    def _swing(self, at: float) -> int:
        """Number of the swing that meets a request, from 0."""
        contacts, lead = self.walk.contacts, max(self.run.foot.heel_rise_lead, 0.0)
        single = contacts.starts[2::2] - contacts.starts[1::2]
        return int(np.searchsorted(contacts.starts[1::2] + (1.0 - LEAST_LEFT) * single - lead, at))

    def _beside(self, k: int) -> list[Footstep]:
        """The landing of swing k, and the other foot beside it."""
        here, landing = self.walk.contacts.footsteps[k + 1 : k + 3]
        aside = self.run.gait.step_width * (-1.0 if landing.foot == "left" else 1.0)
        by = np.array([-math.sin(landing.heading), math.cos(landing.heading)]) * aside
        return [landing, _moved(landing, by)._replace(foot=here.foot)]

    def _rest(
        self, k: int, begin: float, footsteps: Sequence[Footstep], contacts: Contacts
    ) -> tuple[Solution, Array]:
        """The rest of the walk from an instant of single support k on, and by how much its footsteps move."""
        old, gait, row = self.walk.solved, self.run.gait, k - self.first
        start = self.begin if row == 0 else float(self.walk.contacts.starts[2 * k + 1])
        inverse_a = np.full(len(footsteps) - k - 2, 1.0 / gait.a_s)
        inverse_a[0] = old.problem.inverse_a[row]
        slopes = np.tile([gait.c_s, gait.c_y], (len(inverse_a), 1))
        slopes[0] = old.problem.slopes[row]
        # State at the request: that at the begin of the support, moved on.
        standing = old.problem._replace(inverse_a=inverse_a[:1], slopes=slopes[:1])
        axes, place = old.problem.supports.axes[row : row + 1], old.problem.supports.place[row]
        move = in_world(single_maps(standing, np.array([begin - start]))[0], axes)[0]
        state = old.state[row].copy()
        state[0] -= place
        state[:4] = times(move, state.ravel()).reshape(4, 2)
        state[0] += place
        supports = Supports(*(values[k:] for values in walks.supports_of(footsteps, contacts, gait)))
        supports.single[0] = float(contacts.starts[2 * k + 2]) - begin
        end = np.mean([step.position[:2] for step in footsteps[-2:]], axis=0)
        ends = np.stack([np.zeros(2), end])
        problem = old.problem._replace(
            supports=supports, inverse_a=inverse_a, slopes=slopes, ends=ends, begin=state
        )

        def solved_with(problem: Problem, by: Array) -> Solution:
            place = supports.place.copy()
            place[1:] += by
            moved = supports._replace(place=place)
            return solve(problem._replace(supports=moved, ends=ends + by))

        def solved_freely(problem: Problem) -> Solution:
            """With the displacement at which no velocity is lacking."""
            trials = np.array([[0.0, 0.0], [_TRIAL, 0.0], [0.0, _TRIAL]])
            lacking = [solved_with(problem, by).nodes[0, 0] for by in trials]
            slope = np.stack([lacking[1] - lacking[0], lacking[2] - lacking[0]], axis=1) / _TRIAL
            return solved_with(problem, -np.linalg.solve(slope, lacking[0]))

        solved = walks.solve_within_limits(solved_freely, problem, self.body.sole, kept=1)
        return solved, solved.problem.ends[0]


def _moved(step: Footstep, by: Array) -> Footstep:
    x, y, z = step.position
    return step._replace(position=(x + float(by[0]), y + float(by[1]), z))


def joined(old: FeetPlan, new: FeetPlan, begin: float, landed: float) -> FeetPlan:
    """Feet that go on otherwise from an instant on; until a landing the difference of both motions fades.

    Args:
        old: motion until then.
        new: motion from then on, with the same feet on the floor at that instant.
        begin: the instant, after the begin of both [s].
        landed: when the foot lands that swings, or the next one if none does [s].
    """
    left = _joined(old.left, new.left, begin, landed)
    return replace(new, left=left, right=_joined(old.right, new.right, begin, landed))


def _joined(old: FootPath, new: FootPath, begin: float, landed: float) -> FootPath:
    """One foot of :func:`joined`."""
    kept, row = old.start < begin, int(new.segments(np.array([begin]))[0])
    start = np.maximum(new.start[row:], begin)
    curves = shift(new.curve[row:], start - new.start[row:])
    last = slice(int(kept.sum()) - 1, int(kept.sum()))
    gap = shift(old.curve[last], begin - old.start[last])[0] - curves[0]
    values = gap[:, :3].T * np.array([[1.0], [1.0], [2.0]])  # with rates and accelerations
    fade = np.zeros_like(gap)
    fade[:, :6] = quintic(values, np.zeros((3, 6)), np.full(6, landed - begin))
    swings = start < landed - 1e-9
    curves[swings] += shift(fade[None].repeat(swings.sum(), axis=0), start[swings] - begin)
    return FootPath(
        start=np.concatenate([old.start[kept], start]),
        pivot=np.concatenate([old.pivot[kept], new.pivot[row:]]),
        contact=np.concatenate([old.contact[kept], new.contact[row:]]),
        curve=np.concatenate([old.curve[kept], curves]),
    )
