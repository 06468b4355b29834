"""Least squares over the free choices of one gait, each judged by its plan and its periodic step.

The steps are solved on a coarse grid, each from a neighbour's. Its number of intervals is fixed, so that
values of an orbit change smoothly from plan to plan.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from scipy.optimize import least_squares

from ampm.body.inverse_kinematics import InverseKinematics, Unreachable
from ampm.body.orbit import RUNG_TOLERANCE
from ampm.body.return_map import Orbit, StepMap, newton, standing
from ampm.body.step_reference import StepReference, phase_grid, step_reference
from ampm.exceptions import InputError, RefusedGait
from ampm.planner.support import StepPlan, plan_steps
from ampm.tune.gait_limits import LIMITS, orbit_margins, plan_margins

if TYPE_CHECKING:
    from ampm.body.motion import WholeBodyMotion
    from ampm.body.robot import Robot
    from ampm.geometry import Array
    from ampm.parameters import RunParameters
    from ampm.tune.free_choices import FreeChoices

ENOUGH = 0.9
"""Share of the target margins at which a search ends [1]."""
_NODES = (32, 14)  # intervals of the grid in single and double support
_DIFFERENCE = 0.015  # step of finite differences, as a share of a choice's range
_FAILED = 6.0  # residual of a choice for which there is no periodic step
_PULL = 0.06  # weight of the distance to the guess
_SWEEPS = 12  # most Jacobians of one search


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
        lean: float,
        near: Orbit | None = None,
        shift: Array | None = None,
        motion: WholeBodyMotion | None = None,
    ) -> Orbit:
        """The periodic step of a plan.

        Args:
            plan: centroidal motion and feet.
            lean: mean trunk pitch [rad].
            near: orbit of a similar plan; without it, Newton begins from a body that stands upright.
            shift: expected difference from ``near``, see :meth:`difference`.
            motion: the same plan's, on a fine grid, to begin from instead.

        Raises:
            Unreachable: there is none, or none was found.
        """
        reference = step_reference(plan, phase_grid(plan, *self.nodes))
        step_map = StepMap(self.ik, reference, standing(self.ik, reference), plan.contacts.step_length, lean)
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
        return newton(step_map, z, RUNG_TOLERANCE, inverse, rebuilds=2 if near else 4)


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

    def margins(self) -> dict[str, float]:
        """Normalised margins of the limits that have a value."""
        return {name: LIMITS[name].margin(value) for name, value in self.values.items()}

    def worst(self) -> float:
        """Least normalised margin; minus infinity where there is no periodic step."""
        return -math.inf if self.orbit is None else min(self.margins().values())


class ChoiceSearch:
    """Least squares over one space.

    Args:
        space: the free choices.
        base: the guess, for the values that are not free, and for the distance to it.
        orbits: solver of periodic steps of the body.
        report: called with a line of text now and then.
        influence: choice to the change of the orbit per unit of it, as known from other searches.

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
        influence: dict[str, Array] | None = None,
    ) -> None:
        self.space, self.base, self.orbits, self.report = space, base, orbits, report
        self.guess = np.clip([base[name] for name in space.names], space.lower, space.upper)
        self.candidates: list[Candidate] = []
        self.near: Candidate | None = None
        self._kept: dict[bytes, Candidate] = {}
        self._influence = {} if influence is None else influence

    def elsewhere(self, space: FreeChoices, base: Mapping[str, float]) -> ChoiceSearch:
        """A search over another space that shares orbits and the known influence of choices."""
        return ChoiceSearch(space, base, self.orbits, self.report, self._influence)

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
            orbit = self._orbit(x, plan, run.body.lean, near)
        except Unreachable as error:
            return Candidate(x, run, plan, values, why=error)
        return Candidate(x, run, plan, values | orbit_margins(orbit, plan, self.orbits.robot), orbit)

    def _orbit(self, x: Array, plan: StepPlan, lean: float, near: Candidate | None) -> Orbit:
        """The orbit of a choice, starting from its prediction by the known influence, or from the neighbour.

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
            wanted: margin from which a limit has no residual [1].
            pull: weight of the distance to the guess [1].
            sweeps: points at which a Jacobian may be computed.

        Returns:
            The candidate with the least residuals.
        """
        space = self.space

        def residuals(candidate: Candidate) -> Array:
            margins = candidate.margins()
            missing = [_missing(margins[name], wanted) if name in margins else _FAILED for name in LIMITS]
            least = 0.5 * _FAILED if candidate.orbit is None else 0.0
            away = pull * (candidate.x - self.guess) / space.slack
            return np.concatenate([np.maximum(missing, least), away])

        def jacobian(x: Array) -> Array:
            here = self.evaluate(x, self.near)
            if here.orbit is not None:
                self.near = here
            if here.worst() >= ENOUGH * wanted:
                raise SearchFinished(here)
            if self.orbits.ik.integrations >= self.orbits.budget:
                raise SearchFinished(max(self.candidates, key=Candidate.worst))
            columns = self._differences(here, residuals)
            self.report(f"worst margin {here.worst():.2f} after {len(self.candidates)} choices")
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
        except SearchFinished as end:
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
                if (candidate.orbit is None) == (here.orbit is None):
                    jacobian[:, j] = (residuals(candidate) - base) / (sign * step)
                    break
        return jacobian


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


class SearchFinished(Exception):
    """The search is finished: every margin is wide enough, or the budget is spent."""

    def __init__(self, candidate: Candidate) -> None:
        super().__init__()
        self.candidate = candidate


def _moved(orbit: Orbit, reference: StepReference) -> Array:
    """Start configuration of an orbit, moved to where another reference has its COM."""
    q = orbit.trajectory.q[0].copy()
    q[:3] += reference.position[0, 0] - orbit.reference.position[0, 0]
    return q


def _missing(margin: float, wanted: float) -> float:
    """Shortfall of a margin; it grows slowly far from the limit, so that one limit does not dominate."""
    short = max(0.0, wanted - margin)
    return 0.5 * short * (1.0 + short) if short < 2.0 else 3.0 + math.log(short - 1.0)
