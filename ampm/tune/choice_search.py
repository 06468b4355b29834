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

    from ampm.body.robot import Robot
    from ampm.parameters import RunParameters
    from ampm.tune.free_choices import FreeChoices
    from ampm.tune.rough_orbits import RoughOrbit, RoughOrbits

    Array = NDArray[np.float64]

ENOUGH = 0.9
"""Share of the target margins at which a search ends [1]."""
_DIFFERENCE = 0.015  # step of finite differences, as a share of a choice's range
_FAILED = 6.0  # residual of a choice for which there is no periodic step
_PULL = 0.06  # weight of the distance to the guess
_SWEEPS = 12  # points at which one search may ask for a Jacobian


@dataclass
class Trial:
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
    orbit: RoughOrbit | None = None
    why: Unreachable | None = None

    @property
    def whole(self) -> bool:
        """Whether all limits have a value."""
        return self.orbit is not None

    def margins(self) -> dict[str, float]:
        """Normalised margins of the limits that have a value."""
        return {name: LIMITS[name].margin(value) for name, value in self.values.items()}

    def worst(self) -> float:
        """Least normalised margin; minus infinity where there is no periodic step."""
        return min(self.margins().values()) if self.whole else -math.inf


class ChoiceSearch:
    """Least squares over one space.

    Args:
        space: the free choices.
        base: the guess, for what is not free, and to stay near to.
        orbits: solver of periodic steps.
        robot: the body.
        say: called with a line of text now and then.

    Attributes:
        trials: all choices that were evaluated.
        near: the one from whose orbit others are sought.
    """

    def __init__(
        self,
        space: FreeChoices,
        base: Mapping[str, float],
        orbits: RoughOrbits,
        robot: Robot,
        say: Callable[[str], None],
    ) -> None:
        self.space, self.base, self.orbits, self.robot, self.say = space, base, orbits, robot, say
        self.guess = np.clip([base[name] for name in space.names], space.lower, space.upper)
        self.trials: list[Trial] = []
        self.near: Trial | None = None
        self._kept: dict[bytes, Trial] = {}
        # Choice to the change of the orbit per unit of it, as far as it is known.
        self._influence: dict[str, Array] = {}

    def elsewhere(self, space: FreeChoices, base: Mapping[str, float]) -> ChoiceSearch:
        """A search over another space that shares orbits and what is known of the choices' influence."""
        other = ChoiceSearch(space, base, self.orbits, self.robot, self.say)
        other._influence = self._influence
        return other

    def best_whole(self) -> Trial | None:
        """The trial with the widest least margin, of those that have a periodic step."""
        return max((trial for trial in self.trials if trial.whole), key=Trial.worst, default=None)

    def look(self, x: Array, near: Trial | None, *, again: bool = False) -> Trial:
        """Evaluate one choice, from the orbit of another; ``again`` if that may lead where others did not."""
        key = x.tobytes()
        if key in self._kept and not (again and not self._kept[key].whole):
            return self._kept[key]
        trial = self._evaluated(Trial(np.array(x), self.space.run), near)
        self._kept[key] = trial
        self.trials.append(trial)
        return trial

    def _evaluated(self, trial: Trial, near: Trial | None) -> Trial:
        space = self.space
        try:
            run = space.parameters(space.values(trial.x, self.base))
            gait = run.gait.model_copy(update={"steps": 2})
            plan = plan_steps(gait, run.body.mass, run.foot, space.sole)
        except (RefusedGait, InputError):  # what is named may not fit what is tried
            return trial
        trial.run, trial.plan = run, plan
        trial.values = plan_margins(plan, run, space.description)
        try:
            trial.orbit = self._orbit(trial.x, plan, run.body.lean, near)
        except Unreachable as error:
            trial.why = error
        else:
            trial.values |= orbit_margins(trial.orbit, plan, self.robot)
        return trial

    def _orbit(self, x: Array, plan: StepPlan, lean: float, near: Trial | None) -> RoughOrbit:
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
    ) -> Trial:
        """Least squares from a start that has an orbit.

        Args:
            start: free unknowns.
            wanted: margin at which a limit asks for no more [1].
            pull: weight of the distance to the guess [1].
            sweeps: points at which a Jacobian may be computed.

        Returns:
            The trial with the least residuals.
        """
        space = self.space

        def residuals(trial: Trial) -> Array:
            margins = trial.margins()
            missing = [_missing(margins[name], wanted) if name in margins else _FAILED for name in LIMITS]
            least = 0.0 if trial.whole else 0.5 * _FAILED
            away = pull * (trial.x - self.guess) / space.slack
            return np.concatenate([np.maximum(missing, least), away])

        def jacobian(x: Array) -> Array:
            here = self.look(x, self.near)
            if here.whole:
                self.near = here
            if here.worst() >= ENOUGH * wanted:
                raise _Ended(here)
            if self.orbits.spent:
                raise _Ended(max(self.trials, key=Trial.worst))
            columns = self._differences(here, residuals)
            self.say(f"worst margin {here.worst():.2f} after {len(self.trials)} choices")
            return columns

        try:
            found = least_squares(
                lambda x: residuals(self.look(x, self.near)),
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
            return end.trial
        return self.look(found.x, self.near)

    def _differences(self, here: Trial, residuals: Callable[[Trial], Array]) -> Array:
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
                trial = self.look(moved, self.near)
                if trial.orbit is not None and here.orbit is not None:
                    shift = self.orbits.difference(here.orbit, trial.orbit)
                    self._influence[name] = shift / (sign * step)
                if trial.whole == here.whole:
                    jacobian[:, j] = (residuals(trial) - base) / (sign * step)
                    break
        return jacobian


class _Ended(Exception):
    """The search may end: every margin is wide enough, or the budget is spent."""

    def __init__(self, trial: Trial) -> None:
        super().__init__()
        self.trial = trial


def _missing(margin: float, wanted: float) -> float:
    """Shortfall of a margin; far ones grow slowly, so that one hopeless limit does not drown the others."""
    short = max(0.0, wanted - margin)
    return 0.5 * short * (1.0 + short) if short < 2.0 else 3.0 + math.log(short - 1.0)
