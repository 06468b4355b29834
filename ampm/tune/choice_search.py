"""Least squares over the free choices of one gait: every choice judged by its plan and its periodic step."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import least_squares

from ampm.body.inverse_kinematics import Unreachable
from ampm.exceptions import InputError, RefusedGait
from ampm.planner.support import StepPlan, plan_steps
from ampm.tune.gait_limits import LIMITS, orbit_margins, plan_margins

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.body.return_map import Orbit
    from ampm.parameters import RunParameters
    from ampm.tune.free_choices import FreeChoices
    from ampm.tune.rough_orbits import RoughOrbits

    Array = NDArray[np.float64]

ENOUGH = 0.9
"""Share of the target margins at which a search ends [1]."""
_DIFFERENCE = 0.015  # step of finite differences, as a share of a choice's range
_FAILED = 6.0  # residual of a choice for which there is no periodic step
_PULL = 0.06  # weight of the distance to the guess
_SWEEPS = 12  # points at which one search may ask for a Jacobian


@dataclass
class Candidate:
    """One choice that was evaluated.

    Attributes:
        x: free unknowns.
        run: complete, if there is a plan.
        plan: None where the formula has no solution.
        values: limit to value; those of the orbit are missing where there is none.
        orbit: the periodic step, if there is one.
        why: why there is none.
    """

    x: Array
    run: RunParameters
    plan: StepPlan | None = None
    values: dict[str, float] = field(default_factory=dict)
    orbit: Orbit | None = None
    why: Unreachable | None = None

    @property
    def has_orbit(self) -> bool:
        """Whether all limits have a value."""
        return self.orbit is not None

    def margins(self) -> dict[str, float]:
        """Normalised margins of the limits that have a value."""
        return {name: LIMITS[name].margin(value) for name, value in self.values.items()}

    def worst(self) -> float:
        """Least normalised margin; minus infinity where there is no periodic step."""
        return min(self.margins().values()) if self.has_orbit else -math.inf


class ChoiceSearch:
    """Least squares over one space.

    Args:
        space: the free choices.
        base: the guess, for what is not free, and to stay near to.
        orbits: solver of periodic steps of the body.
        say: called with a line of text now and then.

    Attributes:
        candidates: all choices that were evaluated.
        near: the one from whose orbit others are sought.
    """

    def __init__(
        self, space: FreeChoices, base: Mapping[str, float], orbits: RoughOrbits, say: Callable[[str], None]
    ) -> None:
        self.space, self.base, self.orbits, self.say = space, base, orbits, say
        self.guess = np.clip([base[name] for name in space.names], space.lower, space.upper)
        self.candidates: list[Candidate] = []
        self.near: Candidate | None = None
        self._kept: dict[bytes, Candidate] = {}
        # Choice to the change of the orbit per unit of it, as far as it is known.
        self._influence: dict[str, Array] = {}

    def elsewhere(self, space: FreeChoices, base: Mapping[str, float]) -> ChoiceSearch:
        """A search over another space that shares orbits and what is known of the choices' influence."""
        other = ChoiceSearch(space, base, self.orbits, self.say)
        other._influence = self._influence
        return other

    def best_with_orbit(self) -> Candidate | None:
        """The candidate with the widest least margin, of those that have a periodic step."""
        walked = [candidate for candidate in self.candidates if candidate.has_orbit]
        return max(walked, key=Candidate.worst, default=None)

    def evaluate(self, x: Array, near: Candidate | None, *, again: bool = False) -> Candidate:
        """Evaluate one choice, from the orbit of another; ``again`` if that may lead where others did not."""
        key = x.tobytes()
        if key in self._kept and not (again and not self._kept[key].has_orbit):
            return self._kept[key]
        candidate = self._judged(Candidate(np.array(x), self.space.run), near)
        self._kept[key] = candidate
        self.candidates.append(candidate)
        return candidate

    def _judged(self, candidate: Candidate, near: Candidate | None) -> Candidate:
        space = self.space
        try:
            run = space.parameters(space.values(candidate.x, self.base))
            gait = run.gait.model_copy(update={"steps": 2})
            plan = plan_steps(gait, run.body.mass, run.foot, space.sole)
        except (RefusedGait, InputError):  # what is named may not fit what is tried
            return candidate
        candidate.run, candidate.plan = run, plan
        candidate.values = plan_margins(plan, run, space.description)
        try:
            candidate.orbit = self._orbit(candidate.x, plan, run.body.lean, near)
        except Unreachable as error:
            candidate.why = error
        else:
            candidate.values |= orbit_margins(candidate.orbit, plan, self.orbits.robot)
        return candidate

    def _orbit(self, x: Array, plan: StepPlan, lean: float, near: Candidate | None) -> Orbit:
        """The orbit of a choice, from where the choices' known influence puts it, or else from the neighbour.

        Raises:
            Unreachable: there is none, or none was found.
        """
        if near is None:
            return self.orbits.solve(plan, lean)
        moved = [(name, dx) for name, dx in zip(self.space.names, x - near.x, strict=True) if dx]
        if moved and all(name in self._influence for name, _ in moved):
            shift = np.sum([dx * self._influence[name] for name, dx in moved], axis=0)
            with contextlib.suppress(Unreachable):
                return self.orbits.solve(plan, lean, near.orbit, shift)
        return self.orbits.solve(plan, lean, near.orbit)

    def minimise(
        self, start: Array, *, wanted: float = 1.0, pull: float = _PULL, sweeps: int = _SWEEPS
    ) -> Candidate:
        """Least squares from a start that has an orbit.

        Args:
            start: free unknowns.
            wanted: margin at which a limit asks for no more [1].
            pull: weight of the distance to the guess [1].
            sweeps: points at which a Jacobian may be computed.

        Returns:
            The candidate with the least residuals.
        """
        space = self.space

        def residuals(candidate: Candidate) -> Array:
            margins = candidate.margins()
            missing = [_missing(margins[name], wanted) if name in margins else _FAILED for name in LIMITS]
            least = 0.0 if candidate.has_orbit else 0.5 * _FAILED
            away = pull * (candidate.x - self.guess) / space.slack
            return np.concatenate([np.maximum(missing, least), away])

        def jacobian(x: Array) -> Array:
            here = self.evaluate(x, self.near)
            if here.has_orbit:
                self.near = here
            if here.worst() >= ENOUGH * wanted:
                raise _Ended(here)
            if self.orbits.spent:
                raise _Ended(max(self.candidates, key=Candidate.worst))
            columns = self._differences(here, residuals)
            self.say(f"worst margin {here.worst():.2f} after {len(self.candidates)} choices")
            return columns

        try:
            found = least_squares(
                lambda x: residuals(self.evaluate(x, self.near)),
                np.clip(start, space.lower + 1e-9, space.upper - 1e-9),
                jac=jacobian,
                bounds=(space.lower, space.upper),
                x_scale=space.slack,
                method="trf",
                ftol=5e-3,
                xtol=1e-3,
                gtol=1e-6,
                max_nfev=sweeps,
            )
        except _Ended as end:
            return end.candidate
        return self.evaluate(found.x, self.near)

    def _differences(self, here: Candidate, residuals: Callable[[Candidate], Array]) -> Array:
        """Jacobian of the residuals by differences; learns the choices' influence on the orbit."""
        space, x, base = self.space, here.x, residuals(here)
        jacobian = np.zeros((len(base), len(x)))
        for j, name in enumerate(space.names):
            step = _DIFFERENCE * (space.upper[j] - space.lower[j])
            for sign in (1.0, -1.0) if x[j] + step <= space.upper[j] else (-1.0,):
                moved = x.copy()
                moved[j] += sign * step
                if not space.lower[j] <= moved[j] <= space.upper[j]:
                    continue
                candidate = self.evaluate(moved, self.near)
                if candidate.orbit is not None and here.orbit is not None:
                    shift = self.orbits.difference(here.orbit, candidate.orbit)
                    self._influence[name] = shift / (sign * step)
                if candidate.has_orbit == here.has_orbit:
                    jacobian[:, j] = (residuals(candidate) - base) / (sign * step)
                    break
        return jacobian


class _Ended(Exception):
    """The search may end: every margin is wide enough, or the budget is spent."""

    def __init__(self, candidate: Candidate) -> None:
        super().__init__()
        self.candidate = candidate


def _missing(margin: float, wanted: float) -> float:
    """Shortfall of a margin; far ones grow slowly, so that one hopeless limit does not drown the others."""
    short = max(0.0, wanted - margin)
    return 0.5 * short * (1.0 + short) if short < 2.0 else 3.0 + math.log(short - 1.0)
