"""Least squares over the free choices of one gait, each judged by its plan and its periodic step.

The steps are solved on a coarse grid, each from a neighbour's. Its number of intervals is fixed, so that
values of an orbit change smoothly from plan to plan.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ampm.body.inverse_kinematics import InverseKinematics, Unreachable
from ampm.body.return_map import Orbit, StepMap, newton, standing
from ampm.body.step_reference import StepReference, phase_grid, step_reference
from ampm.exceptions import InputError, RefusedGait
from ampm.planner.support import StepPlan, plan_steps
from ampm.tune.gait_limits import LIMITS, least, orbit_margins, plan_margins

if TYPE_CHECKING:
    from ampm.body.motion import WholeBodyMotion
    from ampm.body.robot import Robot
    from ampm.geometry import Array
    from ampm.parameters import RunParameters
    from ampm.tune.free_choices import FreeChoices

ENOUGH = 0.9
"""Share of the target margins at which a search ends [1]."""
_NODES = (32, 14)  # intervals of the grid in single and double support
_TOLERANCE = 1e-4  # of a periodic step [rad, m, rad/s, m/s]
_DIFFERENCE = 0.015  # step of finite differences, as a share of a choice's range
_PULL = 0.06  # weight of the distance to the guess
_TRIES = 30  # most steps of one search
_RADIUS, _LEAST_RADIUS = 0.3, 0.02  # trust region at first, and that at which a search ends [slacks]
_LITTLE = 0.02  # share of the residuals' squares that is worth another step
_PROGRESS = 0.8  # what must be left of them at most to compute the slopes again


class RoughOrbits:
    """Solver of periodic steps of one body.

    Args:
        robot: the body.
        run: posture gains and the choice for L_z, the same for all plans.
        nodes: intervals of the grid in single and in double support.
        budget: integrated steps after which a search ends.
    """

    def __init__(
        self, robot: Robot, run: RunParameters, nodes: tuple[int, int] = _NODES, budget: float = math.inf
    ) -> None:
        self.robot, self.nodes, self.budget = robot, nodes, budget
        self.ik = InverseKinematics(robot, run)

    def difference(self, a: Orbit, b: Orbit) -> Array:
        """Difference between two orbits.

        Returns:
            (2 nv + 1,) tangent of the start configuration, both bodies brought to one place, change of the
            start velocity, and of the constant of L_y [N m s].
        """
        tangent = pin.difference(self.robot.model, _moved(a, b.reference), b.trajectory.q[0])
        return np.concatenate([tangent, b.trajectory.v[0] - a.trajectory.v[0], [b.offset - a.offset]])

    def solve(
        self,
        plan: StepPlan,
        run: RunParameters,
        near: Orbit | None = None,
        shift: Array | None = None,
        motion: WholeBodyMotion | None = None,
    ) -> Orbit:
        """The periodic step of a plan.

        Args:
            plan: centroidal motion and feet.
            run: supplies lean and rest of the arms.
            near: orbit of a similar plan; without it, Newton begins from a body that stands upright.
            shift: expected difference from ``near``, see :meth:`difference`.
            motion: the same plan's, on a fine grid, to begin from instead.

        Raises:
            Unreachable: there is none, or none was found.
        """
        self.ik.spread_arms(run)
        reference = step_reference(plan, phase_grid(plan, *self.nodes))
        origin, length = standing(self.ik, reference), plan.contacts.step_length
        step_map = StepMap(self.ik, reference, origin, length, run.body.lean)
        inverse = None
        if motion is not None:
            z = step_map.encode(motion.q[0], motion.v[0], motion.report.angular_momentum_y_offset)
        elif near is None:
            z = step_map.guess()
        else:
            q, v, offset = _moved(near, reference), near.trajectory.v[0], near.offset
            if shift is not None:
                nv = self.robot.nv
                q = pin.integrate(self.robot.model, q, shift[:nv])
                v, offset = v + shift[nv:-1], offset + shift[-1]
            z, inverse = step_map.encode(q, v, offset), near.inverse
        return newton(step_map, z, _TOLERANCE, inverse, rebuilds=1 if near else 4, left=0.9)


@dataclass
class Candidate:
    """One choice that was evaluated.

    Attributes:
        x: free unknowns.
        run: complete, if there is a plan.
        plan: None where the formula has no solution.
        values: limit to value; those of the orbit are missing where there is none.
        detail: normalised margins of every joint and phase; empty where there is no periodic step.
        orbit: the periodic step, if there is one.
        why: why there is none.
    """

    x: Array
    run: RunParameters
    plan: StepPlan | None = None
    values: dict[str, float] = field(default_factory=dict)
    detail: Array = field(default_factory=lambda: np.empty(0))
    orbit: Orbit | None = None
    why: Unreachable | None = None

    def margins(self) -> dict[str, float]:
        """Normalised margins of the limits that have a value."""
        return {name: LIMITS[name].margin(value) for name, value in self.values.items()}

    def worst(self) -> float:
        """Least normalised margin; minus infinity where there is no periodic step."""
        return -math.inf if self.orbit is None else min(self.margins().values())


class ChoiceSearch:
    """Least squares over one space.

    Margins and orbit are taken as linear in the choices within a trust region. Their slopes come from
    differences once, and from then on from every choice that is evaluated (Broyden), so that most choices
    cost one periodic step.

    Args:
        space: the free choices.
        base: the guess, for the values that are not free, and for the distance to it.
        orbits: solver of periodic steps of the body.
        report: called with a line of text now and then.
        slopes: as known from a search nearby, shape (limits + orbit, choices), per slack.

    Attributes:
        candidates: all choices that were evaluated.
        near: the one whose orbit is the start for others.
    """

    def __init__(
        self,
        space: FreeChoices,
        base: Mapping[str, float],
        orbits: RoughOrbits,
        report: Callable[[str], None],
        slopes: Array | None = None,
    ) -> None:
        self.space, self.base, self.orbits, self.report = space, base, orbits, report
        self.guess = np.clip([base[name] for name in space.names], space.lower, space.upper)
        self.candidates: list[Candidate] = []
        self.near: Candidate | None = None
        self.slopes = slopes
        self._kept: dict[bytes, Candidate] = {}

    def elsewhere(self, space: FreeChoices, base: Mapping[str, float]) -> ChoiceSearch:
        """A search over another space that shares orbits and the slopes that are known."""
        slopes = None if self.slopes is None else self.slopes.copy()
        return ChoiceSearch(space, base, self.orbits, self.report, slopes)

    def best_with_orbit(self) -> Candidate | None:
        """The candidate with the widest least margin, of those that have a periodic step."""
        walked = [candidate for candidate in self.candidates if candidate.orbit is not None]
        return max(walked, key=Candidate.worst, default=None)

    def evaluate(self, x: Array, near: Candidate | None, *, again: bool = False) -> Candidate:
        """Evaluate one choice, from the orbit of another; ``again`` to evaluate it from another orbit."""
        kept = self._kept.get(x.tobytes())
        if kept is not None and not (again and kept.orbit is None):
            return kept
        candidate = self._judged(np.array(x), near)
        self._kept[x.tobytes()] = candidate
        self.candidates.append(candidate)
        return candidate

    def _judged(self, x: Array, near: Candidate | None) -> Candidate:
        space = self.space
        try:
            run = space.parameters({**self.base, **dict(zip(space.names, x.tolist(), strict=True))})
            gait = run.gait.model_copy(update={"steps": 2})
            plan = plan_steps(gait, run.body.mass, run.foot, space.sole)
        except (RefusedGait, InputError):  # given values may not fit those tried
            return Candidate(x, space.run)
        values = plan_margins(plan, run, space.description)
        try:
            orbit = self._orbit(x, plan, run, near)
        except Unreachable as error:
            return Candidate(x, run, plan, least(values), why=error)
        values |= orbit_margins(orbit, plan, self.orbits.robot)
        detail = [LIMITS[name].margin(value) for name, every in values.items() for value in every.tolist()]
        return Candidate(x, run, plan, least(values), np.array(detail), orbit)

    def _orbit(self, x: Array, plan: StepPlan, run: RunParameters, near: Candidate | None) -> Orbit:
        """The orbit of a choice, starting from its prediction by the slopes, or from the neighbour.

        Raises:
            Unreachable: there is none, or none was found.
        """
        if near is None:
            return self.orbits.solve(plan, run)
        step = (x - near.x) / self.space.slack
        shift = None if self.slopes is None else self.slopes[len(near.detail) :] @ step
        return self.orbits.solve(plan, run, near.orbit, shift)

    def minimise(
        self, start: Candidate, *, wanted: float = 1.0, pull: float = _PULL, enough: float = ENOUGH
    ) -> Candidate:
        """Least squares from a choice that has an orbit.

        Args:
            start: the choice.
            wanted: margin from which a limit has no residual [1].
            pull: weight of the distance to the guess [1].
            enough: least margin at which the search ends [1].

        Returns:
            The candidate with the least residuals.
        """
        space, here, radius, misses = self.space, start, _RADIUS, 0
        stale, fresh, at_slopes = False, False, math.inf

        def away(candidate: Candidate) -> Array:
            return pull * (candidate.x - self.guess) / space.slack

        def cost(candidate: Candidate) -> float:
            if candidate.orbit is None:
                return math.inf
            return float((_missing(candidate.detail, wanted) ** 2).sum() + (away(candidate) ** 2).sum())

        for _ in range(_TRIES):
            self.near, before = here, cost(here)
            if here.worst() >= enough or self.orbits.ik.integrations >= self.orbits.budget:
                break
            if stale or self.slopes is None:
                if before > _PROGRESS * at_slopes:
                    break
                self.slopes = self._differences(here)
                stale, fresh, at_slopes = False, True, before
            bounds = (
                np.maximum((space.lower - here.x) / space.slack, -radius),
                np.minimum((space.upper - here.x) / space.slack, radius),
            )
            slopes = self.slopes[: len(here.detail)]
            step, expected = _linear_step(here.detail, slopes, away(here), pull, wanted, bounds)
            if expected < _LITTLE * before:
                if fresh:
                    break
                stale = True
                continue
            trial = self.evaluate(here.x + step * space.slack, here)
            gain = (before - cost(trial)) / expected
            self.report(f"worst margin {trial.worst():.2f} after {len(self.candidates)} choices")
            if gain > -1.0:
                missed = self._change(here, trial) - self.slopes @ step
                self.slopes = self.slopes + np.outer(missed, step / (step @ step))  # Broyden
            if gain > 0.75:
                radius *= 2.0
            elif gain < 0.25:
                radius = 0.4 * float(np.abs(step).max())
            if gain > 0.0:
                here, fresh, misses = trial, False, 0
            else:
                misses += 1
            if radius < _LEAST_RADIUS:
                if fresh:
                    break
                radius = _RADIUS
                stale = True
            stale = stale or (misses > 1 and not fresh)
        return here

    def _change(self, here: Candidate, there: Candidate) -> Array:
        """Change of margins and orbit from one choice to another."""
        a, b = here.orbit, there.orbit
        turned = np.empty(0) if a is None or b is None else self.orbits.difference(a, b)
        return np.concatenate([there.detail - here.detail, turned])

    def _differences(self, here: Candidate) -> Array:
        """Slopes by differences, per slack; zero where a choice has no periodic step on either side."""
        space, x = self.space, here.x
        slopes = np.zeros((len(here.detail) + 2 * self.orbits.robot.nv + 1, len(x)))
        for j in range(len(x)):
            step = _DIFFERENCE * (space.upper[j] - space.lower[j])
            for sign in (1.0, -1.0) if x[j] + step <= space.upper[j] else (-1.0,):
                moved = x.copy()
                moved[j] += sign * step
                if not space.lower[j] <= moved[j] <= space.upper[j]:
                    continue
                candidate = self.evaluate(moved, here)
                if candidate.orbit is not None:
                    slopes[:, j] = self._change(here, candidate) * (space.slack[j] / (sign * step))
                    break
        return slopes


@dataclass
class Approach:
    """Result of the continuation from an easy neighbour.

    Attributes:
        share: of the way [1].
        search: at that place.
        candidate: the choice there.
        why: what ended it.
    """

    share: float
    search: ChoiceSearch
    candidate: Candidate
    why: Unreachable | None = None


def _moved(orbit: Orbit, reference: StepReference) -> Array:
    """Start configuration of an orbit, moved to where another reference has its COM."""
    q = orbit.trajectory.q[0].copy()
    q[:3] += reference.position[0, 0] - orbit.reference.position[0, 0]
    return q


def _linear_step(
    margins: Array, slopes: Array, away: Array, pull: float, wanted: float, bounds: tuple[Array, Array]
) -> tuple[Array, float]:
    """Step within bounds with the least residuals where margins are linear, and how much less (Levenberg)."""

    def residuals(step: Array) -> Array:
        return np.concatenate([_missing(margins + slopes @ step, wanted), away + pull * step])

    low, high = bounds
    step, damping = np.zeros(len(low)), 1e-3
    r = first = residuals(step)
    for _ in range(40):
        slope = _slope(margins + slopes @ step, wanted)
        columns = np.vstack([slope[:, None] * slopes, pull * np.eye(len(low))]).T
        down = -columns @ r
        free = ~((step <= low) & (down < 0.0) | (step >= high) & (down > 0.0))
        if not free.any():
            break
        part, moved = columns[free], step.copy()
        damped = part @ part.T + damping * np.eye(len(part))
        moved[free] += np.linalg.solve(damped, down[free])
        moved = np.clip(moved, low, high)
        new = residuals(moved)
        before, after = r @ r, new @ new
        if after < before:
            small = after > 0.999 * before
            step, r, damping = moved, new, 0.3 * damping
            if small:
                break
        else:
            damping *= 5.0
            if damping > 1e3:
                break
    return step, float(first @ first - r @ r)


def _missing(margins: Array, wanted: float) -> Array:
    """Shortfall of margins; it grows slowly far from the limit, so that one limit does not dominate."""
    short = np.maximum(0.0, wanted - margins)
    return np.where(short < 2.0, 0.5 * short * (1.0 + short), 3.0 + np.log(np.maximum(short - 1.0, 1.0)))


def _slope(margins: Array, wanted: float) -> Array:
    """Derivative of :func:`_missing` by the margins."""
    short = np.maximum(0.0, wanted - margins)
    return -np.where(short < 2.0, 0.5 + short, 1.0 / np.maximum(short - 1.0, 1.0)) * (short > 0.0)
