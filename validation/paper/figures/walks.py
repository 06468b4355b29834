"""The walks that the figures are drawn from: each gait is planned, solved and walked once per command."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ampm.body.motion import WholeBodyMotion
from ampm.body.robot import Robot
from ampm.exceptions import SolverError
from ampm.parameters import GaitParameters
from ampm.planner.support import StepPlan
from ampm.walk import PostureState
from validation.judge.profiles import own_profile
from validation.paper.figures.centroidal import Centroidal, DeviationFromPlan, of_motion
from validation.progress import Progress
from validation.run.trial import Trial
from validation.run.walk import walk_planned
from validation.trial.bridge import to_pinocchio
from validation.trial.plan import PlannedWalk, load_request, plan_walk

Array = NDArray[np.float64]

STEPS = 12
"""Steps walked for a figure: five strides beside the first one, to show how far they differ."""

_GRID = 0.002
"""Spacing of the curves of a stride [s]."""


@dataclass(frozen=True)
class Walk:
    """One gait, walked.

    Attributes:
        label: what the figures call it.
        trial: plan, motion, record, measurement, comparison.
    """

    label: str
    trial: Trial

    @property
    def plan(self) -> StepPlan:
        """The closed-form plan, with the body's constant of L_y."""
        return self.trial.planned.plan

    @property
    def gait(self) -> GaitParameters:
        """Parameters of the plan."""
        return self.trial.planned.run.gait

    @property
    def motion(self) -> WholeBodyMotion:
        """The periodic whole-body motion."""
        return self.trial.planned.motion

    @property
    def robot(self) -> Robot:
        """The body."""
        return self.trial.planned.body.robot

    @property
    def stride(self) -> float:
        """Duration of two steps [s]."""
        return 2.0 * float(self.plan.constants.step_duration)

    @cached_property
    def phase(self) -> Array:
        """Times within a stride, from the start of a left stance, shape (n,) [s]."""
        count = int(self.stride / _GRID)
        return np.linspace(0.0, self.stride, count + 1)

    @cached_property
    def stride_starts(self) -> Array:
        """Start of every whole stride that was walked, the one with the first step left out [s]."""
        # The last stride may want for less than a time step.
        count = int((float(self.trial.record.time[-1]) + 2 * self.trial.record.time_step) / self.stride)
        return np.asarray(self.stride * np.arange(min(1, max(count - 1, 0)), max(count, 1)), dtype=np.float64)

    @property
    def middle(self) -> float:
        """Start of a stride in the middle of the walk [s]."""
        return float(self.stride_starts[len(self.stride_starts) // 2])

    @cached_property
    def double_supports(self) -> tuple[tuple[float, float], ...]:
        """Planned double supports of a stride [s]."""
        constants = self.plan.constants
        single, step = constants.single_support_duration, constants.step_duration
        return ((single, step), (step + single, 2 * step))

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
        folds = [
            np.column_stack([np.interp(start + self.phase, at, row) for row in rows])
            for start in self.stride_starts
        ]
        stack = np.stack(folds)
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
    def deviation(self) -> dict[str, DeviationFromPlan]:
        """Distance from the plan, by name: ``com``, ``zmp``, ``force``, ``angular_momentum``."""
        measured, planned = self.trial.measured, self.plan.sample(self.trial.measured.time)
        first = self.plan.sample(self.stride_starts[0] + self.phase)
        both = {
            "com": (self.ik.com - first.com, measured.com - planned.com),
            "zmp": (self.ik.zmp - first.zmp, measured.zmp - planned.zmp),
            "force": (self.ik.force - first.force, measured.force - planned.force),
            "angular_momentum": (
                self.ik.angular_momentum[:, :2] - first.angular_momentum,
                measured.angular_momentum[:, :2] - planned.angular_momentum,
            ),
        }
        return {name: DeviationFromPlan(motion, self.folded(error)) for name, (motion, error) in both.items()}

    def limit(self, metric: str) -> float:
        """Tolerances of the profile that judges this gait, in SI (forces in newton)."""
        profile = own_profile(self.trial.planned.request.name)
        tolerance = next(item for item in profile.tolerances if item.metric == metric)
        weight = self.plan.mass * self.plan.gravity
        return tolerance.limit * (weight if metric.startswith("force_") else 1.0)

    def configuration(self, time: float) -> Array:
        """Simulated configuration, in Pinocchio's coordinates, at the recorded instant next to ``time``."""
        record = self.trial.record
        row = int(np.argmin(np.abs(record.time - time)))
        return to_pinocchio(record.q[row], record.qd[row])[0]


class Walks:
    """Walks on demand; what two figures share is walked once.

    Args:
        steps: of every walk.
        stages: where to report progress.
    """

    def __init__(self, steps: int, stages: Progress | None = None) -> None:
        self.steps, self.stages = steps, stages or Progress()
        self._walks: dict[tuple[str, ...], Walk] = {}

    def plan(self, gait: str, settings: Sequence[str] = ()) -> PlannedWalk:
        """Plan a gait, and solve its motion, without walking it."""
        return plan_walk(load_request(gait, settings), self.stages)

    def walk(
        self, gait: str, settings: Sequence[str] = (), label: str = "", *, steps: int | None = None
    ) -> Walk:
        """Walk a gait, or take the walk that was had before.

        Args:
            gait: preset.
            settings: what to change in it.
            label: what the figures call it.
            steps: to walk, if not as many as every figure.

        Raises:
            InputError, MathematicalRefusal, BodilyRefusal: the gait cannot be walked.
            SolverError: the walk did not come to its end.
        """
        count = self.steps if steps is None else steps
        key = (gait, *settings, f"gait.steps={count}")
        if key not in self._walks:
            request = load_request(gait, key[1:])
            trial = walk_planned(plan_walk(request, self.stages), progress=self.stages)
            outcome = trial.record.outcome
            if not outcome.completed:
                raise SolverError(
                    f"{' '.join(key[:-1])}: {outcome.name} after {outcome.time:.2f} s ({outcome.cause}); "
                    "a figure needs a whole walk. Give fewer --steps, or leave it out with --only."
                )
            self._walks[key] = Walk(label or " ".join(key[:-1]), trial)
        return self._walks[key]
