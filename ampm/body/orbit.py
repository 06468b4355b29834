"""The periodic whole-body step: a fixed point of the inverse kinematics' mirrored one-step map.

Unknowns are the state at the start of the step and the constant of L_y, which AMPM leaves free; equations are
the mirrored return of the state and the mean pitch of the trunk. Only a few modes of the map are slow (trunk
pitch, trunk roll), all others die within a step, so Newton works on a small Krylov space: where the map
forgets, the Jacobian of ``return - start`` is minus the identity, and Broyden's updates keep the rest up to
date.

The search runs on a coarse grid and ends on the fine one. Where it fails from a standing start, it begins
with an easier neighbour (the COM a little lower, no angular momentum) and follows the orbit from there to the
gait that was asked for.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import osqp
import pinocchio as pin

from ampm.body.inverse_kinematics import (
    KNEE_MINIMUM,
    InverseKinematics,
    StepReference,
    StepTrajectory,
    Unreachable,
    step_grid,
    step_reference,
)
from ampm.body.motion import MotionReport, WholeBodyMotion
from ampm.body.return_map import Solution, Stalled, StepMap, leading_multipliers, newton, standing
from ampm.exceptions import BodilyRefusal, InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.body.robot import Robot
    from ampm.parameters import RunParameters
    from ampm.planner.support import StepPlan

TOLERANCE = 1e-9
"""Largest component of the mirrored return's residual [rad, m, rad/s, m/s]."""

COARSE_STEP = 0.008
"""Largest step of the grid on which the orbit is searched [s]."""

_LESS = "bring gait.c_s and gait.c_y nearer to 1, lower gait.com_height or shorten gait.step_length"
_WAYS_OUT = {
    "knee": "lower gait.com_height, shorten gait.step_length or raise foot.toe_off_angle",
    "ankle": "raise gait.com_height, shorten gait.step_length or raise foot.heel_rise_lead",
    "toe": "lower foot.toe_off_angle",
    "trunk": "bring gait.c_s and gait.c_y nearer to 1",
    "arms": "bring gait.c_s and gait.c_y nearer to 1",
}
_STABLE = 0.8  # largest product of a posture gain's rate and the grid's step that integrates well
_COARSE_TOLERANCE = 1e-7
_RUNG_TOLERANCE = 1e-5  # of the orbits on the way to the one that was asked for
_DROPS = (0.03, 0.06, 0.1)  # by how much the COM is lowered to find a first orbit [m]
_FIRST_RUNG, _LAST_RUNG = 0.5, 0.02  # share of the way gone at a time, at first and at least
_BUDGET = 700  # coarse steps that a search may take
_SOURCES = ("planner/*.py", "body/*.py", "qp.py")


def solve_motion(
    plan: StepPlan,
    run: RunParameters,
    robot: Robot,
    *,
    progress: Callable[[str], None] | None = None,
    cache: Path | None = None,
) -> WholeBodyMotion:
    """Solve the periodic whole-body motion of a plan.

    Args:
        plan: made with the body's sole, so that it has feet.
        run: posture gains, lean, the choice for L_z, the grid.
        robot: the body.
        progress: called with a line of text after every Newton step.
        cache: folder that keeps solutions by their inputs; None keeps nothing.

    Returns:
        One step whose mirrored end is its start.

    Raises:
        BodilyRefusal: no orbit, a knee too straight, or a joint beyond its limits.
        InputError: the plan has no feet, or the grid is too coarse for the posture's gains.
    """
    path = None if cache is None else cache / f"motion-{_fingerprint(plan, run, robot)}.npz"
    motion = None if path is None else _cached(path)
    if motion is None:
        motion = _Search(plan, run, robot, progress).solve()
        if path is not None:
            _keep(motion, path)
    _check(motion.report)
    return motion


@dataclass(frozen=True)
class RoughOrbit:
    """A periodic step on a coarse grid: enough for a search over many plans, not to be walked.

    Attributes:
        reference: what was asked of the body, on the grid.
        trajectory: the step.
        offset: constant of L_y [N m s].
        known: what Newton knew of the map, for the next search nearby.
    """

    reference: StepReference
    trajectory: StepTrajectory
    offset: float
    known: Any


class RoughOrbits:
    """Periodic steps of many plans for one body, each sought from a neighbour's.

    Args:
        robot: the body.
        run: posture gains and the choice for L_z, the same for all plans.
        nodes: intervals of the grid in single and in double support; fixed, so that what is read off an orbit
            changes smoothly from plan to plan.
        budget: integrated steps that may be spent in all; who searches looks at :attr:`spent`.
    """

    def __init__(
        self, robot: Robot, run: RunParameters, nodes: tuple[int, int], budget: float = math.inf
    ) -> None:
        self.robot, self.nodes, self.budget = robot, nodes, budget
        self.ik = InverseKinematics(robot, run)
        self.evaluations = 0

    @property
    def spent(self) -> bool:
        """Whether the budget is used up: a limit to a search that knows no clock."""
        return self.evaluations >= self.budget

    def difference(self, a: RoughOrbit, b: RoughOrbit) -> NDArray[np.float64]:
        """What leads from one orbit to another.

        Returns:
            (2 nv + 1,) tangent of the start configuration, both bodies brought to one place, change of the
            start velocity, and of the constant of L_y [N m s].
        """
        q = _brought(a, b.reference)
        tangent = pin.difference(self.robot.model, q, b.trajectory.q[0])
        return np.concatenate([tangent, b.trajectory.v[0] - a.trajectory.v[0], [b.offset - a.offset]])

    def solve(
        self,
        plan: StepPlan,
        lean: float,
        near: RoughOrbit | None = None,
        shift: NDArray[np.float64] | None = None,
        motion: WholeBodyMotion | None = None,
    ) -> RoughOrbit:
        """The periodic step of a plan.

        Args:
            plan: with feet.
            lean: mean trunk pitch [rad].
            near: orbit of a similar plan; without it, Newton begins from a body that stands upright.
            shift: what is expected to lead there from ``near``, see :meth:`difference`.
            motion: the same plan's, on a fine grid, to begin from instead.

        Raises:
            Unreachable: there is none, or none was found.
        """
        single, double = plan.constants.single_support_duration, plan.constants.double_support_duration
        n1, n2 = self.nodes
        time = np.concatenate([single * np.arange(n1) / n1, single + double * np.arange(n2 + 1) / n2])
        reference = step_reference(plan, time)
        origin = standing(self.ik, reference)
        step_map = StepMap(self, reference, origin, plan.contacts.step_length, lean)
        if motion is not None:
            z = step_map.encode(motion.q[0], motion.v[0], motion.report.angular_momentum_y_offset)
            known = None
        elif near is None:
            z, known = step_map.guess(), None
        else:
            q, v, offset = _brought(near, reference), near.trajectory.v[0], near.offset
            if shift is not None:
                nv = self.robot.nv
                q = pin.integrate(self.robot.model, q, shift[:nv])
                v, offset = v + shift[nv:-1], offset + shift[-1]
            z, known = step_map.encode(q, v, offset), near.known
        try:
            found = newton(step_map, z, _RUNG_TOLERANCE, known, rebuilds=2 if near else 4)
        except Stalled as error:
            if error.cause is not None:
                raise error.cause from error
            raise Unreachable(0.0, "no periodic motion is found", error.residual, 0.0, "rad") from error
        return RoughOrbit(reference, found.trajectory, step_map.offset(found.z), found.inverse)


def _brought(orbit: RoughOrbit, reference: StepReference) -> NDArray[np.float64]:
    """Start configuration of an orbit, moved to where another reference has its COM."""
    q = orbit.trajectory.q[0].copy()
    q[:3] += reference.position[0, 0] - orbit.reference.position[0, 0]
    return q


def _cached(path: Path) -> WholeBodyMotion | None:
    """A stored motion; None if there is none that can be read: it is solved again and written over."""
    try:
        return WholeBodyMotion.load(path)
    except (OSError, InputError):
        return None


def _keep(motion: WholeBodyMotion, path: Path) -> None:
    """Store a motion; a folder that cannot be written costs time at the next call, nothing else."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        motion.save(path)
    except OSError:
        return


def _fingerprint(plan: StepPlan, run: RunParameters, robot: Robot) -> str:
    """Hash of all that the motion depends on: inputs, body, and the code and libraries that solve it."""
    sections = {
        "versions": [np.__version__, osqp.__version__, pin.__version__],
        "gait": {k: v for k, v in run.gait.model_dump().items() if k != "steps"},
        "body": run.body.model_dump(),
        "foot": run.foot.model_dump(),
        "grid": run.solver.ik_time_step,
        "mass": plan.centroidal.mass,
        "gravity": plan.centroidal.gravity,
        "joints": robot.joint_names,
        "body_description": repr(robot.description),
    }
    digest = hashlib.sha256(json.dumps(sections, sort_keys=True).encode())
    for pattern in _SOURCES:
        for path in sorted(Path(__file__).parents[1].glob(pattern)):
            digest.update(path.read_bytes())
    model = robot.model
    for inertia, placement in zip(model.inertias, model.jointPlacements, strict=True):
        digest.update(inertia.toDynamicParameters().tobytes() + placement.homogeneous.tobytes())
    for frame in model.frames:
        digest.update(frame.placement.homogeneous.tobytes())
    digest.update(robot.lower.tobytes() + robot.upper.tobytes())
    return digest.hexdigest()[:24]


def _check(report: MotionReport) -> None:
    """Refuse motions that the body's joints cannot make."""
    if report.knee_minimum < KNEE_MINIMUM:
        raise BodilyRefusal(
            f"the {report.knee_minimum_side} knee straightens to {report.knee_minimum:.3f} rad at "
            f"{report.knee_minimum_time:.3f} s of the step; it must stay bent by {KNEE_MINIMUM} rad",
            reason="knee_too_straight",
            value=report.knee_minimum,
            limit=KNEE_MINIMUM,
            unit="rad",
            way_out=_WAYS_OUT["knee"],
        )
    if report.joint_limit_margin < 0.0:
        raise BodilyRefusal(
            f"joint {report.joint_limit_joint} would pass its limit by {-report.joint_limit_margin:.3f} rad "
            f"at {report.joint_limit_time:.3f} s of the step",
            reason="joint_limits",
            value=report.joint_limit_margin,
            limit=0.0,
            unit="rad",
            way_out=_WAYS_OUT.get(report.joint_limit_group, _LESS),
        )


class _Search:
    """From a plan and a body to the periodic step, or to the reason why there is none."""

    def __init__(
        self, plan: StepPlan, run: RunParameters, robot: Robot, progress: Callable[[str], None] | None
    ) -> None:
        self.plan, self.run, self.robot = plan, run, robot
        self.progress = progress
        self.ik = InverseKinematics(robot, run)
        self.evaluations = 0
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
        return StepMap(self, reference, self.origin, self.plan.contacts.step_length, self.run.body.lean)

    # --------------------------------------------------------------- search

    def solve(self) -> WholeBodyMotion:
        """The motion.

        Raises:
            BodilyRefusal: there is none.
        """
        rough = self._rough()
        fine = self._map(self.fine)
        try:
            solution = newton(fine, rough.z, TOLERANCE, rough.inverse, say=self._say)
            solution = self._by_osqp(fine, solution)
        except (Unreachable, Stalled) as error:
            raise self._refusal(error) from error
        return self._motion(fine, solution)

    def _by_osqp(self, fine: StepMap, solution: Solution) -> Solution:
        """The step that is handed out has every acceleration from OSQP."""
        fine.draft = False
        return newton(fine, solution.z, TOLERANCE, solution.inverse, say=self._say)

    def _rough(self) -> Solution:
        """Orbit on the coarse grid: from a standing start, else along a path from an easier one.

        Raises:
            BodilyRefusal: there is none, or none that was found.
        """
        coarse = self._map(self.coarse)
        try:
            return newton(coarse, coarse.guess(), _COARSE_TOLERANCE, say=self._say)
        except (Unreachable, Stalled) as error:
            failed: Unreachable | Stalled = error
        spins = bool(np.abs(self.coarse.acceleration[:, 3:6]).max() > 1e-9)
        refusal = self._refusal(failed)
        for drop in _DROPS:
            eased = self._map(self.coarse.eased(drop, 0.0))
            try:
                solution = newton(eased, eased.guess(), _RUNG_TOLERANCE, say=self._say)
            except (Unreachable, Stalled):
                continue
            if spins:
                solution, way, cause = self._follow(solution, (drop, 0.0), (drop, 1.0))
                if way < 1.0:  # lower still, there may be room for all of it
                    refusal = self._refusal(cause, share=way)
                    continue
            solution, way, cause = self._follow(solution, (drop, 1.0), (0.0, 1.0))
            if way < 1.0:
                raise self._refusal(cause, drop=drop * (1.0 - way))
            return solution
        raise refusal from failed

    def _follow(
        self, solution: Solution, begin: tuple[float, float], end: tuple[float, float]
    ) -> tuple[Solution, float, Unreachable | Stalled | None]:
        """Follow the orbit from one easing of the reference towards another.

        Args:
            solution: at ``begin``.
            begin: COM's drop [m] and share of the angular momentum.
            end: the same.

        Returns:
            The farthest solution, how much of the way it has come, and why no farther.
        """
        here, stride = 0.0, _FIRST_RUNG
        before: tuple[float, NDArray[np.float64]] | None = None
        failed: Unreachable | Stalled | None = None
        while here < 1.0:
            there = min(1.0, here + stride)
            guess = solution.z
            if before is not None:  # along the chord
                guess = guess + (guess - before[1]) * ((there - here) / (here - before[0]))
            drop, share = ((1.0 - there) * a + there * b for a, b in zip(begin, end, strict=True))
            eased = self._map(self.coarse.eased(drop, share))
            self._say(f"{there:.0%} of the way")
            try:
                found = newton(eased, guess, _RUNG_TOLERANCE, solution.inverse, rebuilds=2)
            except (Unreachable, Stalled) as error:
                failed = error
                stride *= 0.4
                if stride < _LAST_RUNG or self.evaluations > _BUDGET:
                    return solution, here, failed
                continue
            before, solution, here = (here, solution.z), found, there
            stride *= 1.6
        return solution, 1.0, None

    def _refusal(
        self, error: Unreachable | Stalled | None, *, drop: float = 0.0, share: float = 1.0
    ) -> BodilyRefusal:
        """Why there is no orbit; ``drop`` and ``share`` say how near the search came."""
        cause = error.cause if isinstance(error, Stalled) and error.cause is not None else error
        if isinstance(cause, Unreachable):
            value, limit, unit = cause.value, cause.limit, cause.unit
        elif isinstance(cause, Stalled):
            value, limit, unit = cause.residual, TOLERANCE, "rad"
        else:
            value, limit, unit = 1.0, TOLERANCE, "1"
        why = str(cause)
        height = self.plan.centroidal.com_height
        way_out = _LESS
        if drop > 0.0:
            why += f", and one is found only with the COM {1000.0 * drop:.0f} mm lower"
            value, limit, unit = height, height - drop, "m"
            way_out = f"lower gait.com_height below {height - drop:.3f} m, or shorten gait.step_length"
        elif share < 1.0:
            why += f", and one is found only with {share:.0%} of the planned angular momentum"
            value, limit, unit = 1.0, share, "1"
        return BodilyRefusal(
            f"the body finds no periodic motion for this plan: {why}",
            reason="no_periodic_motion",
            value=float(value),
            limit=float(limit),
            unit=unit,
            way_out=way_out,
        )

    def _say(self, text: str) -> None:
        if self.progress is not None:
            self.progress(f"{text} after {self.evaluations} steps")

    # --------------------------------------------------------------- result

    def _motion(self, fine: StepMap, solution: Solution) -> WholeBodyMotion:
        robot, trajectory, z = self.robot, solution.trajectory, solution.z
        offset = fine.offset(z)
        value = fine.returned(trajectory, offset) - fine.encode(trajectory.q[0], trajectory.v[0], offset)
        fine.draft = True
        multipliers = leading_multipliers(fine, solution)
        knees = trajectory.q[:, robot.knee_joints + 1]
        when, side = np.unravel_index(int(np.argmin(knees)), knees.shape)
        angles = trajectory.q[:, 7:]
        margins = np.minimum(angles - robot.lower, robot.upper - angles)
        closest = int(np.argmin(margins.min(axis=0)))
        joint = robot.joint_names[closest]
        switch = int(
            np.searchsorted(fine.reference.time, self.plan.constants.single_support_duration - 1e-12)
        )
        report = MotionReport(
            angular_momentum_y_offset=offset,
            residual=fine.size(value),
            mean_trunk_pitch=fine.mean_pitch(trajectory),
            multipliers=multipliers,
            constraint_position=trajectory.constraint_position,
            constraint_velocity=trajectory.constraint_velocity,
            constraint_acceleration=trajectory.constraint_acceleration,
            knee_minimum=float(knees[when, side]),
            knee_minimum_time=float(fine.reference.time[when]),
            knee_minimum_side=("left", "right")[int(side)],
            joint_limit_margin=float(margins[:, closest].min()),
            joint_limit_joint=joint,
            joint_limit_group=_group(robot, joint),
            joint_limit_time=float(fine.reference.time[margins[:, closest].argmin()]),
            acceleration_jump=self._jump(trajectory, switch),
            evaluations=self.evaluations,
        )
        return WholeBodyMotion(
            joint_names=robot.joint_names,
            time=np.array(fine.reference.time),
            q=trajectory.q,
            v=trajectory.v,
            acceleration=trajectory.acceleration,
            trunk_pitch=trajectory.trunk_pitch,
            angular_momentum_z=trajectory.angular_momentum_z,
            step_length=self.plan.contacts.step_length,
            double_support_start=float(self.plan.constants.single_support_duration),
            report=report,
        )

    def _jump(self, trajectory: StepTrajectory, switch: int) -> float:
        """Largest change of a joint's acceleration over one grid interval on either side of both switches."""
        a = trajectory.acceleration[:, 6:]
        after_mirror = self.robot.mirror_joints(a[-2])  # the interval before the step's start, mirrored
        return float(
            max(
                np.abs(a[switch] - a[switch - 1]).max(),
                np.abs(a[switch + 1] - a[switch]).max(),
                np.abs(a[0] - after_mirror).max(),
                np.abs(a[1] - a[0]).max(),
            )
        )


def _group(robot: Robot, joint: str) -> str:
    """Where a joint is: hip, knee, ankle, toe, trunk or arms."""
    for leg in robot.description.legs:
        groups = {"hip": leg.hip, "knee": (leg.knee,), "ankle": leg.ankle, "toe": (leg.toe,)}
        for name, joints in groups.items():
            if joint in joints:
                return name
    return "trunk" if joint in robot.description.trunk else "arms"
