"""The walks that the figures are drawn from: each gait is planned, solved and walked once per command."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ampm.body.robot import Robot
from ampm.exceptions import SolverError
from ampm.geometry import Array
from ampm.planner.support import StepPlan
from ampm.walk import PostureState
from validation.judge.profiles import own_profile
from validation.progress import Progress
from validation.run.trial import Trial
from validation.run.walk import walk_planned
from validation.trial.bridge import to_pinocchio
from validation.trial.plan import PlannedWalk, load_request, plan_walk

Numbers = dict[str, dict[str, float | str]]
"""Distances of two curves, by name."""

STEPS = 12
"""Steps walked for a figure: five strides beside the first one, to show how far they differ."""

_GRID = 0.002
"""Spacing of the curves of a stride [s]."""


class Centroidal(NamedTuple):
    """Centre of mass and momentum of a body's motion, at n times.

    The motion has no contact forces. The ground force follows from its own momentum rates, so its ZMP is
    independent of the plan's.

    Attributes:
        com: shape (n, 3) [m].
        acceleration: of the COM, shape (n, 3) [m/s²].
        force: ground force that the motion needs, shape (n, 3) [N].
        zmp: on the floor z = 0, shape (n, 2) [m].
        angular_momentum: about the COM, shape (n, 3) [N m s].
    """

    com: Array
    acceleration: Array
    force: Array
    zmp: Array
    angular_momentum: Array


def of_motion(sample: PostureState, robot: Robot, plan: StepPlan) -> Centroidal:
    """Evaluate a sampled motion of a body; of the plan only mass and gravity are used."""
    model, data = robot.model, robot.model.createData()
    com, rate, momentum, turning = (np.empty((len(sample.q), 3)) for _ in range(4))
    for row, (q, v, a) in enumerate(zip(sample.q, sample.v, sample.acceleration, strict=True)):
        pin.computeCentroidalMomentumTimeVariation(model, data, q, v, a)
        com[row], momentum[row] = data.com[0], data.hg.angular
        rate[row], turning[row] = data.dhg.linear, data.dhg.angular
    force = rate + np.array([0.0, 0.0, plan.mass * plan.gravity])
    # About the ZMP the ground force has no horizontal moment.
    zmp = com[:, :2] - com[:, 2:] * force[:, :2] / force[:, 2:]
    zmp += np.column_stack([-turning[:, 1], turning[:, 0]]) / force[:, 2:]
    return Centroidal(com, rate / plan.mass, force, zmp, momentum)


def agreement(error: Array, unit: str) -> dict[str, float | str]:
    """RMSE and largest value of an error, for the figures' numbers."""
    rmse, maximum = float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())
    return {"rmse": rmse, "maximum": maximum, "unit": unit}


def less_plan(name: str, motion: Array, simulation: Array, unit: str) -> Numbers:
    """:func:`agreement` of motion and of simulation with the plan."""
    both = (("motion", motion), ("simulation", simulation))
    return {f"{name}: {who} less plan": agreement(error, unit) for who, error in both}


class Walk:
    """One gait, walked.

    Attributes:
        label: name in the figures.
        trial: plan, motion, record, measurement, comparison.
        plan: the closed-form plan, with the body's constant of L_y.
        gait: parameters of the plan.
        motion: the periodic whole-body motion.
        robot: the body.
        single, double: durations of single and of double support [s].
        stride: duration of two steps [s].
        double_supports: begin and end of the planned double supports of a stride [s].
    """

    def __init__(self, label: str, trial: Trial) -> None:
        self.label, self.trial = label, trial
        planned = trial.planned
        self.plan: StepPlan = planned.plan
        self.gait, self.motion, self.robot = planned.run.gait, planned.motion, planned.body.robot
        constants = self.plan.constants
        self.single = float(constants.single_support_duration)
        self.double = float(constants.double_support_duration)
        step = float(constants.step_duration)
        self.stride = 2.0 * step
        self.double_supports = ((self.single, step), (step + self.single, 2 * step))

    @cached_property
    def phase(self) -> Array:
        """Times within a stride, from the start of a left stance, shape (n,) [s]."""
        return np.linspace(0.0, self.stride, int(self.stride / _GRID) + 1)

    @cached_property
    def stride_starts(self) -> Array:
        """Start of every whole stride that was walked, the one with the first step left out [s]."""
        # The last stride may be short by less than a time step.
        count = int((float(self.trial.record.time[-1]) + 2 * self.trial.record.time_step) / self.stride)
        return np.asarray(self.stride * np.arange(min(1, max(count - 1, 0)), max(count, 1)), dtype=np.float64)

    @property
    def middle(self) -> float:
        """Start of a stride in the middle of the walk [s]."""
        return float(self.stride_starts[len(self.stride_starts) // 2])

    def folded(self, values: Array, time: Array | None = None) -> Array:
        """Recorded values of every stride on the stride's own times.

        Args:
            values: by row of the record, shape (K,) or (K, d).
            time: of the rows, shape (K,) [s]; starts of the steps if not given.

        Returns:
            Shape (strides, n) or (strides, n, d).
        """
        rows = np.atleast_2d(values.T)
        at = self.trial.record.time[: rows.shape[1]] if time is None else time
        stack = np.stack(
            [
                np.column_stack([np.interp(s + self.phase, at, row) for row in rows])
                for s in self.stride_starts
            ]
        )
        return stack[..., 0] if values.ndim == 1 else stack

    @cached_property
    def motion_sample(self) -> PostureState:
        """The body's planned motion over a stride."""
        return self.motion.sample(self.phase, self.robot)

    @cached_property
    def ik(self) -> Centroidal:
        """COM, momentum, force and ZMP of the whole-body motion over the first stride of the figures."""
        sample = self.motion.sample(self.stride_starts[0] + self.phase, self.robot)
        return of_motion(sample, self.robot, self.plan)

    @cached_property
    def deviation(self) -> dict[str, tuple[Array, Array]]:
        """Distance of motion (n, d) and simulation (strides, n, d) from the plan over a stride, by name.

        Names are ``com``, ``zmp``, ``force``, ``angular_momentum`` (about x and y).
        """
        measured, found = self.trial.measured, {}
        planned, first = self.plan.sample(measured.time), self.plan.sample(self.stride_starts[0] + self.phase)
        for name in ("com", "zmp", "force", "angular_momentum"):
            target = getattr(planned, name)
            columns = target.shape[1]
            motion = getattr(self.ik, name)[:, :columns] - getattr(first, name)
            found[name] = motion, self.folded(getattr(measured, name)[:, :columns] - target)
        return found

    def away(self, name: str, index: int) -> tuple[Array, Array]:
        """One component of a :attr:`deviation`: of the motion (n,), of the simulation (strides, n)."""
        motion, simulation = self.deviation[name]
        return motion[:, index], simulation[..., index]

    def limit(self, metric: str) -> float:
        """Tolerance of the profile that judges this gait, in SI (forces in newton)."""
        limits = {item.metric: item for item in own_profile(self.trial.planned.request.name).tolerances}
        return float(limits[metric].limit_for(self.trial.comparison.scales))

    def configuration(self, row: int | NDArray[np.intp]) -> Array:
        """Simulated configurations, in Pinocchio's coordinates, of a row or of several rows of the record."""
        record = self.trial.record
        return to_pinocchio(record.q[row], record.qd[row])[0]

    def row(self, time: float) -> int:
        """Row of the record next to a time [s]."""
        return int(np.argmin(np.abs(self.trial.record.time - time)))


class Walks:
    """Walks on demand; a walk that two figures share is made once.

    Args:
        steps: of every walk.
        stages: where to report progress.
    """

    def __init__(self, steps: int, stages: Progress | None = None) -> None:
        self.steps, self.stages = steps, stages or Progress()
        self._walks: dict[tuple[str, ...], Walk] = {}

    def plan(self, gait: str, settings: Sequence[str] = ()) -> PlannedWalk:
        """Plan a gait, and solve its motion, without walking it."""
        return plan_walk(load_request(gait, settings, as_is=True), self.stages)

    def walk(self, gait: str, settings: Sequence[str] = (), *, steps: int | None = None) -> Walk:
        """Walk a gait, or return the earlier walk of it.

        Args:
            gait: preset.
            settings: what to change in it.
            steps: to walk, if not as many as every figure.

        Raises:
            InputError, MathematicalRefusal, BodilyRefusal: the gait cannot be walked.
            SolverError: the walk did not complete.
        """
        key = (gait, *settings, f"gait.steps={self.steps if steps is None else steps}")
        if key not in self._walks:
            label = " ".join(key[:-1])
            trial = walk_planned(self.plan(gait, key[1:]), progress=self.stages)
            outcome = trial.record.outcome
            if not outcome.completed:
                raise SolverError(
                    f"{label}: {outcome.name} after {outcome.time:.2f} s ({outcome.cause}); "
                    "a figure needs a whole walk. Give fewer --steps, or leave it out with --only."
                )
            self._walks[key] = Walk(label, trial)
        return self._walks[key]
