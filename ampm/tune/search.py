"""Least squares over the free choices of one gait, each judged by its plan and its periodic step.

The steps are solved on a coarse grid, each from a neighbour's. Its number of intervals is fixed, so that
values of an orbit change smoothly from plan to plan.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from ampm.body.inverse_kinematics import InverseKinematics, Unreachable
from ampm.body.limits import LIMITS
from ampm.body.return_map import Orbit, StepMap, newton, start_orbit
from ampm.body.robot import Robot
from ampm.body.step_reference import phase_grid, step_reference
from ampm.exceptions import InputError, RefusedGait
from ampm.geometry import Array
from ampm.linear import add_gram, solved
from ampm.parameters import RunParameters
from ampm.planner.support import StepPlan
from ampm.tune.free_choices import FreeChoices
from ampm.tune.gait_limits import least_margin, orbit_margins, plan_margins, tightest


@dataclass(frozen=True)
class Effort:
    """When a search ends."""

    choices: int = 120  # number of choices after which it ends
    enough: float = 0.9  # least margin at which it ends [1]
    starts: int = 0  # number of further starts, spread over the ranges, where the first search finds nothing


_NODES = (32, 14)  # intervals of the grid in single and double support
_TOLERANCE = 1e-4  # of a periodic step [rad, m, rad/s, m/s]
_DIFFERENCE = 0.015  # step of finite differences, as a share of a choice's range
_PULL = 0.06  # weight of the distance to the guess
_TRIES = 30  # steps after which a search ends
_RADIUS, _LEAST_RADIUS = 0.3, 0.02  # trust region at first, and that at which slopes are renewed [slacks]
_ENOUGH_ORBITS = 12  # of starts that are spread over the ranges
_NO_ORBIT = 32  # starts without one after which it ends: the drawn gaits that have one have it by the 14th
_AMPLE = 1e6  # margin of a joint without a range
_LITTLE = 0.02  # share of the residuals' squares that is worth another step
_PROGRESS = 0.8  # what must be left of them at most to compute the slopes again


def rough_orbit(
    ik: InverseKinematics,
    plan: StepPlan,
    run: RunParameters,
    near: Orbit | None = None,
    shift: Array | float = 0.0,
    nodes: tuple[int, int] = _NODES,
) -> Orbit:
    """The periodic step of a plan on a coarse grid.

    Args:
        ik: of the body and the run.
        plan: centroidal motion and feet.
        run: supplies the lean.
        near: orbit of a similar plan; without it, Newton begins from a body that stands upright.
        shift: expected change of the unknowns from ``near``.
        nodes: intervals of the grid in single and in double support.

    Raises:
        Unreachable: there is none, or none was found.
    """
    reference = step_reference(plan, phase_grid(plan, *nodes))
    step_map = StepMap(ik, reference, plan.contacts, run.body.lean)
    if near is None:
        return start_orbit(step_map, _TOLERANCE)
    return newton(step_map, near.z + shift, _TOLERANCE, near.inverse, rebuilds=1)


@dataclass
class Candidate:
    """One choice that was evaluated."""

    x: Array  # free unknowns, shape (n,)
    run: RunParameters  # with these choices, if there is a plan
    plan: StepPlan | None = None  # None where the formula has no solution
    # limit to value, and normalised margins of every joint and phase; empty where there is no periodic step
    values: dict[str, float] = field(default_factory=dict)
    detail: Array = field(default_factory=lambda: np.empty(0))
    orbit: Orbit | None = None  # the periodic step, if there is one
    why: Unreachable | None = None  # why there is none

    def margins(self) -> dict[str, float]:
        """Normalised margins of the limits that have a value."""
        return {name: LIMITS[name].margin(value) for name, value in self.values.items()}

    def worst(self) -> float:
        """Least normalised margin; minus infinity where there is no periodic step."""
        return -math.inf if self.orbit is None else least_margin(self.values)

    def cost(self, wanted: float) -> float:
        """Squares of the shortfalls of all margins from a wanted one; infinite without a periodic step."""
        return math.inf if self.orbit is None else float((_shortfall(self.detail, wanted) ** 2).sum())

    def state(self) -> Array:
        """Margins and unknowns of the periodic step, which the search takes as linear in the choices."""
        return self.detail if self.orbit is None else np.concatenate([self.detail, self.orbit.z])


class ChoiceSearch:
    """Least squares over one space.

    Margins and orbit are taken as linear in the choices within a trust region. Their slopes come from
    differences once, and from then on from every choice that is evaluated (Broyden), so that most choices
    cost one periodic step.

    Args:
        space: the free choices.
        robot: the body.
        report: called with a line of text now and then.
        effort: how far it goes.

    Attributes:
        candidates: all choices that were evaluated.

    Raises:
        MathematicalRefusal: there is no guess.
    """

    def __init__(
        self, space: FreeChoices, robot: Robot, report: Callable[[str], None], effort: Effort
    ) -> None:
        self.space, self.robot, self.report, self.effort = space, robot, report, effort
        self.base: Mapping[str, float] = space.guess()
        self.guess = np.clip([self.base[name] for name in space.names], space.lower, space.upper)
        self.candidates: list[Candidate] = []
        self._slopes: Array | None = None  # of the states, shape (limits + orbit, choices), per slack

    def best(self) -> Candidate:
        """The candidate with the widest least margin, the last one where none has a periodic step."""
        return max(reversed(self.candidates), key=Candidate.worst)

    def evaluate(self, x: Array, near: Candidate | None = None) -> Candidate:
        """Evaluate one choice, from the orbit of another if there is one."""
        candidate = self._judged(np.array(x), near)
        self.candidates.append(candidate)
        return candidate

    def spread(self, starts: int) -> Candidate:
        """The choice with the least residuals among those, spread over the ranges, that have a periodic step.

        Where none has one, the last choice that was tried.
        """
        found: list[Candidate] = []
        for x in self.space.spread(self.guess, starts):
            candidate = self.evaluate(x)
            if candidate.orbit is not None:
                found.append(candidate)
            if len(found) == _ENOUGH_ORBITS or (not found and len(self.candidates) == _NO_ORBIT):
                break
        return min(found, key=lambda candidate: candidate.cost(1.0), default=self.candidates[-1])

    def _judged(self, x: Array, near: Candidate | None) -> Candidate:
        """Plan, periodic step and margins of one choice, as far as there are any."""
        space = self.space
        try:
            run = space.parameters({**self.base, **dict(zip(space.names, x.tolist(), strict=True))})
            plan = space.first_steps(run)
        except (RefusedGait, InputError):  # values that were set may not fit those tried
            return Candidate(x, space.run)
        ik = InverseKinematics(self.robot, run)
        try:
            if near is None or near.orbit is None:
                orbit = rough_orbit(ik, plan, run)
            else:
                step = (x - near.x) / space.slack
                shift = 0.0 if self._slopes is None else _times(self._slopes[len(near.detail) :], step)
                orbit = rough_orbit(ik, plan, run, near.orbit, shift)
        except Unreachable as error:
            return Candidate(x, run, plan, why=error)
        values = plan_margins(plan, run, space.description) | orbit_margins(orbit, plan, self.robot)
        detail = [LIMITS[name].margin(value) for name, every in values.items() for value in every.tolist()]
        return Candidate(x, run, plan, tightest(values), np.minimum(detail, _AMPLE), orbit)

    def minimise(
        self, start: Candidate, *, wanted: float = 1.0, pull: float = _PULL, enough: float = math.inf
    ) -> Candidate:
        """Least squares from a choice that has an orbit, by Gauss and Newton in a trust region.

        Slopes are computed again where they promise no progress any more, unless there has been little since
        they were computed last: then the search ends.

        Args:
            start: the choice to begin with.
            wanted: margin from which a limit has no residual [1].
            pull: weight of the distance to the guess [1].
            enough: least margin at which it ends, at most that of the effort [1].

        Returns:
            The candidate with the least residuals.
        """
        space, here, radius, stale, cost_at_slopes = self.space, start, _RADIUS, False, math.inf
        enough = min(enough, self.effort.enough)

        def away(candidate: Candidate) -> Array:
            return pull * (candidate.x - self.guess) / space.slack

        def cost(candidate: Candidate) -> float:
            return candidate.cost(wanted) + float((away(candidate) ** 2).sum())

        for _ in range(_TRIES):
            before = cost(here)
            if here.worst() >= enough or len(self.candidates) >= self.effort.choices:
                break
            if stale or self._slopes is None:
                if before > _PROGRESS * cost_at_slopes:
                    break
                self._slopes = self._differences(here)
                radius, stale, cost_at_slopes = _RADIUS, False, before
            bounds = (
                np.maximum((space.lower - here.x) / space.slack, -radius),
                np.minimum((space.upper - here.x) / space.slack, radius),
            )
            slopes = self._slopes[: len(here.detail)]
            step, expected = _linear_step(here.detail, slopes, away(here), pull, wanted, bounds)
            if expected < _LITTLE * before:
                stale = True
                continue
            x = np.clip(here.x + step * space.slack, space.lower, space.upper)  # for rounding
            trial = self.evaluate(x, here)
            self.report(f"worst margin {trial.worst():.2f} after {len(self.candidates)} choices")
            gain = (before - cost(trial)) / expected
            if gain > -1.0:
                missed = trial.state() - here.state() - _times(self._slopes, step)
                self._slopes = self._slopes + np.outer(missed, step / (step**2).sum())  # Broyden
            if gain > 0.75:
                radius *= 2.0
            elif gain < 0.25:
                radius = 0.4 * float(np.abs(step).max())
            here = trial if gain > 0.0 else here
            stale = radius < _LEAST_RADIUS
        return here

    def _differences(self, here: Candidate) -> Array:
        """Slopes by differences, per slack; zero where a choice has no periodic step on either side."""
        space, x, state = self.space, here.x, here.state()
        slopes = np.zeros((len(state), len(x)))
        for j in range(len(x)):
            step = _DIFFERENCE * (space.upper[j] - space.lower[j])
            for change in (step, -step):
                moved = x.copy()
                moved[j] += change
                if not space.lower[j] <= moved[j] <= space.upper[j]:
                    continue
                candidate = self.evaluate(moved, here)
                if candidate.orbit is not None:
                    slopes[:, j] = (candidate.state() - state) * (space.slack[j] / change)
                    break
        return slopes


def _linear_step(
    margins: Array, slopes: Array, away: Array, pull: float, wanted: float, bounds: tuple[Array, Array]
) -> tuple[Array, float]:
    """Step within bounds that minimises the residuals of linear margins, and by how much (Levenberg)."""

    def residuals(step: Array) -> Array:
        return np.concatenate([_shortfall(margins + _times(slopes, step), wanted), away + pull * step])

    low, high = bounds
    step, damping = np.zeros(len(low)), 1e-3
    r = first = residuals(step)
    for _ in range(40):
        factor = _shortfall_slope(margins + _times(slopes, step), wanted)
        columns = np.vstack([factor[:, None] * slopes, pull * np.eye(len(low))]).T
        down = -_times(columns, r)
        free = ~((step <= low) & (down < 0.0) | (step >= high) & (down > 0.0))
        if not free.any():
            break
        part, moved = columns[free], step.copy()
        gram = np.zeros((len(part), len(part)))
        add_gram(part.T, part.T, gram)
        moved[free] += solved(gram + damping * np.eye(len(part)), down[free])
        moved = np.clip(moved, low, high)
        new = residuals(moved)
        before, after = (r**2).sum(), (new**2).sum()
        if after < before:
            step, r, damping = moved, new, 0.3 * damping
            if after > 0.999 * before:
                break
        else:
            damping *= 5.0
            if damping > 1e3:
                break
    return step, float((first**2).sum() - (r**2).sum())


def _times(matrix: Array, x: Array) -> Array:
    """``matrix x``, with the same bits on every processor, unlike BLAS."""
    return np.asarray(np.einsum("ij,j", matrix, x))


def _shortfall(margins: Array, wanted: float) -> Array:
    """Shortfall of margins; it grows slowly far from the limit, so that one limit does not dominate."""
    short = np.maximum(0.0, wanted - margins)
    return np.where(short < 2.0, 0.5 * short * (1.0 + short), 3.0 + np.log(np.maximum(short - 1.0, 1.0)))


def _shortfall_slope(margins: Array, wanted: float) -> Array:
    """Derivative of :func:`_shortfall` by the margins."""
    short = np.maximum(0.0, wanted - margins)
    return -np.where(short < 2.0, 0.5 + short, 1.0 / np.maximum(short - 1.0, 1.0)) * (short > 0.0)
