"""The periodic whole-body step: a fixed point of the inverse kinematics' mirrored one-step map.

Unknowns are the state at the start of the step and the constant of L_y, which AMPM leaves free; equations are
the mirrored return of the state and the mean pitch of the trunk.

The search runs on a coarse grid and ends on the fine one. Where it fails from a standing start, it begins
with an easier gait (the COM a little lower, no angular momentum) and continues the orbit from there to the
requested gait.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from ampm.body.continuation import Continuation
from ampm.body.feasibility import LESS, check_motion
from ampm.body.inverse_kinematics import InverseKinematics, StepTrajectory, Unreachable
from ampm.body.motion import Extreme, MotionReport, WholeBodyMotion
from ampm.body.return_map import Orbit, StepMap, leading_multipliers, newton, standing
from ampm.body.step_reference import StepReference, step_grid, step_reference
from ampm.exceptions import BodilyRefusal, InputError

if TYPE_CHECKING:
    from ampm.body.robot import Robot
    from ampm.geometry import Array
    from ampm.parameters import RunParameters
    from ampm.planner.support import StepPlan

TOLERANCE = 1e-9
"""Largest component of the mirrored return's residual [rad, m, rad/s, m/s]."""
COARSE_STEP = 0.008
"""Largest step of the grid on which the orbit is searched [s]."""

_STABLE = 0.8  # largest product of a posture gain's rate and the grid's step that integrates well
_COARSE_TOLERANCE = 1e-7
RUNG_TOLERANCE = 1e-5
"""Tolerance of the orbits on the way to the requested one [rad, m, rad/s, m/s]."""
_DROPS = (0.03, 0.06, 0.1)  # by how much the COM of a body of 1.70 m is lowered to find a first orbit [m]
_BUDGET = 700  # coarse steps that a search may take


def solve_motion(
    plan: StepPlan,
    run: RunParameters,
    robot: Robot,
    *,
    progress: Callable[[str], None] | None = None,
) -> WholeBodyMotion:
    """Solve the periodic whole-body motion of a plan.

    Args:
        plan: centroidal motion and feet.
        run: posture gains, lean, the choice for L_z, the grid.
        robot: the body.
        progress: called with a line of text after every Newton step.

    Returns:
        One step whose mirrored end is its start.

    Raises:
        BodilyRefusal: no orbit, a knee too straight, or a joint beyond its limits.
        InputError: the grid is too coarse for the posture's gains.
    """
    motion = _Search(plan, run, robot, progress).solve()
    check_motion(motion.report, robot.description)
    return motion


class _Search:
    """From a plan and a body to the periodic step, or to the reason why there is none."""

    def __init__(
        self, plan: StepPlan, run: RunParameters, robot: Robot, progress: Callable[[str], None] | None
    ) -> None:
        self.plan, self.lean, self.robot, self.progress = plan, run.body.lean, robot, progress
        self.ik = InverseKinematics(robot, run)
        fine = run.solver.ik_time_step
        longest = _STABLE / max(run.body.posture_damping, math.sqrt(run.body.posture_stiffness))
        if fine > longest:
            raise InputError(
                f"solver.ik_time_step = {fine:g} s is too long for the gains of the posture; take at most "
                f"{longest:.2g} s, or lower body.posture_damping and body.posture_stiffness."
            )
        coarse = min(COARSE_STEP, longest)
        self.fine = step_reference(plan, step_grid(plan, fine))
        self.coarse = self.fine if fine >= coarse else step_reference(plan, step_grid(plan, coarse))
        self.origin = standing(self.ik, self.coarse)

    def _map(self, reference: StepReference) -> StepMap:
        return StepMap(self.ik, reference, self.origin, self.plan.contacts.step_length, self.lean)

    # --------------------------------------------------------------- search

    def solve(self) -> WholeBodyMotion:
        """The motion on the fine grid."""
        rough = self._rough()
        fine = self._map(self.fine)
        try:
            orbit = newton(fine, rough.z, TOLERANCE, rough.inverse, report=self._report)
            fine.draft = False  # the returned step has every acceleration from OSQP
            orbit = newton(fine, orbit.z, TOLERANCE, orbit.inverse, report=self._report)
        except Unreachable as error:
            raise self._refusal(error) from error
        return self._motion(fine, orbit)

    def _rough(self) -> Orbit:
        """Orbit on the coarse grid: from a standing start, else along a path from an easier one."""
        coarse = self._map(self.coarse)
        try:
            return newton(coarse, coarse.guess(), _COARSE_TOLERANCE, report=self._report)
        except Unreachable as error:
            failed = error
        spins = bool(np.abs(self.coarse.acceleration[:, 3:6]).max() > 1e-9)
        refusal = self._refusal(failed)
        for drop in (self.robot.description.scale * drop for drop in _DROPS):
            eased = self._map(self.coarse.eased(drop, 0.0))
            try:
                orbit = newton(eased, eased.guess(), RUNG_TOLERANCE, report=self._report)
            except Unreachable:
                continue
            if spins:
                orbit, way, cause = self._follow(orbit, (drop, 0.0), (drop, 1.0))
                if way < 1.0:  # a lower COM may allow all of the angular momentum
                    refusal = self._refusal(cause, share=way)
                    continue
            orbit, way, cause = self._follow(orbit, (drop, 1.0), (0.0, 1.0))
            if way < 1.0:
                raise self._refusal(cause, drop=drop * (1.0 - way))
            return orbit
        raise refusal from failed

    def _follow(
        self, orbit: Orbit, begin: tuple[float, float], end: tuple[float, float]
    ) -> tuple[Orbit, float, Unreachable]:
        """Continue the orbit from one easing (drop of the COM [m], share of angular momentum) to another."""
        way = Continuation(shrink=0.4, grow=1.6)
        before: tuple[float, Array] | None = None
        failed = Unreachable(0.0, "no step is tried", 0.0, 0.0, "1")
        while way.open:
            there, guess = way.ahead, orbit.z
            if before is not None:  # along the chord
                guess = guess + (guess - before[1]) * ((there - way.share) / (way.share - before[0]))
            drop, share = ((1.0 - there) * a + there * b for a, b in zip(begin, end, strict=True))
            eased = self._map(self.coarse.eased(drop, share))
            self._report(f"{there:.0%} of the way")
            try:
                found = newton(eased, guess, RUNG_TOLERANCE, orbit.inverse, rebuilds=2)
            except Unreachable as error:
                failed = error
                if self.ik.integrations > _BUDGET:
                    break
                way.tried(reached=False)
                continue
            before, orbit = (way.share, orbit.z), found
            way.tried(reached=True)
        return orbit, way.share, failed

    def _refusal(self, cause: Unreachable, *, drop: float = 0.0, share: float = 1.0) -> BodilyRefusal:
        """Error for a missing orbit; ``drop`` and ``share`` describe the nearest one found."""
        value, limit, unit = cause.value, cause.limit, cause.unit
        why, way_out, height = str(cause), LESS, self.plan.com_height
        if drop > 0.0:
            why += f"; one is found only with the COM {1000.0 * drop:.3g} mm lower"
            value, limit, unit = height, height - drop, "m"
            way_out = f"lower gait.com_height below {height - drop:.3f} m, or shorten gait.step_length"
        elif share < 1.0:
            why += f"; one is found only with {share:.0%} of the planned angular momentum"
            value, limit, unit = 1.0, share, "1"
        return BodilyRefusal(
            f"this body has no periodic motion for this plan: {why}",
            reason="no_periodic_motion",
            value=float(value),
            limit=float(limit),
            unit=unit,
            way_out=way_out,
        )

    def _report(self, text: str) -> None:
        if self.progress is not None:
            self.progress(f"{text} after {self.ik.integrations} steps")

    # --------------------------------------------------------------- result

    def _motion(self, fine: StepMap, orbit: Orbit) -> WholeBodyMotion:
        robot, trajectory, time = self.robot, orbit.trajectory, np.array(fine.reference.time)
        offset = orbit.offset
        value = fine.returned(trajectory, offset) - fine.encode(trajectory.q[0], trajectory.v[0], offset)
        fine.draft = True
        angles = trajectory.q[:, 7:]
        margins = np.minimum(angles - robot.lower, robot.upper - angles)
        single = self.plan.constants.single_support_duration
        gaps = robot.shapes.gaps(trajectory.q)
        closest = int(gaps.distance.argmin())
        report = MotionReport(
            angular_momentum_y_offset=offset,
            residual=fine.size(value),
            mean_trunk_pitch=fine.mean_pitch(trajectory),
            multipliers=leading_multipliers(fine, orbit),
            constraint_position=trajectory.constraint_position,
            constraint_velocity=trajectory.constraint_velocity,
            constraint_acceleration=trajectory.constraint_acceleration,
            knee_minimum=_least(robot.knee_flexion(trajectory.q), time, ("left", "right")),
            joint_limit_margin=_least(margins, time, robot.joint_names),
            clearance=Extreme(float(gaps.distance[closest]), float(time[closest]), gaps.parts[closest]),
            acceleration_jump=self._jump(trajectory, int(np.searchsorted(time, single - 1e-12))),
            evaluations=self.ik.integrations,
        )
        return WholeBodyMotion(
            robot.joint_names,
            time,
            trajectory.q,
            trajectory.v,
            trajectory.acceleration,
            trajectory.trunk_pitch,
            trajectory.angular_momentum_z,
            self.plan.contacts.step_length,
            float(single),
            report,
        )

    def _jump(self, trajectory: StepTrajectory, switch: int) -> float:
        """Largest change of a joint's acceleration over one grid interval on either side of both switches."""
        a = trajectory.acceleration[:, 6:]
        before_start = self.robot.mirror_joints(a[-2])  # the interval before the step's start, mirrored
        pairs = (a[switch], a[switch - 1]), (a[switch + 1], a[switch]), (a[0], before_start), (a[1], a[0])
        return max(float(np.abs(after - before).max()) for after, before in pairs)


def _least(values: Array, time: Array, names: tuple[str, ...]) -> Extreme:
    """Smallest of values, shape (n+1, k), of k names."""
    when, which = np.unravel_index(int(np.argmin(values)), values.shape)
    return Extreme(float(values[when, which]), float(time[when]), names[int(which)])
