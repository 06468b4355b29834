"""The periodic whole-body step: a fixed point of the inverse kinematics' mirrored one-step map.

Unknowns are the state at the start of the step and the constant of L_y, which AMPM leaves free; equations are the
mirrored return of the state and the mean pitch of the trunk. Only a few modes of the map are slow (trunk pitch,
trunk roll), all others die within a step, so Newton works on a small Krylov space: where the map forgets, the
Jacobian of ``return - start`` is minus the identity, and Broyden's updates keep the rest up to date.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ampm.exceptions import BodilyRefusal
from ampm.inverse_kinematics import (
    KNEE_MINIMUM,
    InverseKinematics,
    StepReference,
    StepTrajectory,
    Unreachable,
    step_grid,
    step_reference,
)
from ampm.motion import MotionReport, WholeBodyMotion

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.gait import GaitPlan
    from ampm.parameters import RunParameters
    from ampm.robot import Robot

TOLERANCE = 1e-9
"""Largest component of the mirrored return's residual [rad, m, rad/s, m/s]."""

_CACHE_VERSION = 1  # raise when the solution for the same inputs changes
_VELOCITY_SCALE = 0.1  # weighs velocities against positions in the Krylov norm [s]
_OFFSET_SCALE = 1.0  # likewise for the constant of L_y [1/(N m s)]
_MAX_STEP = 0.5  # of a Newton step, in scaled units


def solve_motion(
    plan: GaitPlan,
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
    """
    path = None
    if cache is not None:
        path = cache / f"motion-{_fingerprint(plan, run, robot)}.npz"
        if path.exists():
            try:
                motion = WholeBodyMotion.load(path)
            except (OSError, ValueError, KeyError, TypeError):  # unreadable: solve again and write over it
                motion = None
            if motion is not None:
                _check(motion.report)
                return motion
    motion = _Orbit(plan, run, robot, progress).solve()
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        motion.save(path)
    _check(motion.report)
    return motion


def _fingerprint(plan: GaitPlan, run: RunParameters, robot: Robot) -> str:
    """Hash of everything that the motion depends on."""
    digest = hashlib.sha256()
    sections = {
        "version": _CACHE_VERSION,
        "gait": {k: v for k, v in run.gait.model_dump().items() if k != "steps"},
        "body": run.body.model_dump(),
        "foot": run.foot.model_dump(),
        "grid": run.solver.ik_time_step,
        "mass": plan.mass,
        "joints": robot.joint_names,
        "body_description": repr(robot.description),
    }
    digest.update(json.dumps(sections, sort_keys=True).encode())
    model = robot.model
    for inertia, placement in zip(model.inertias, model.jointPlacements, strict=True):
        digest.update(inertia.toDynamicParameters().tobytes() + placement.homogeneous.tobytes())
    digest.update(robot.lower.tobytes() + robot.upper.tobytes() + robot.torque_limit.tobytes())
    return digest.hexdigest()[:24]


def _check(report: MotionReport) -> None:
    """Refuse motions that the body's joints cannot make."""
    if report.knee_minimum < KNEE_MINIMUM:
        raise BodilyRefusal(
            f"the knee straightens to {report.knee_minimum:.3f} rad, under the least flexion of {KNEE_MINIMUM} rad",
            reason="knee_too_straight",
            value=report.knee_minimum,
            limit=KNEE_MINIMUM,
            unit="rad",
            way_out="lower gait.com_height, shorten gait.step_length or raise foot.toe_off_angle",
        )
    if report.joint_limit_margin < 0.0:
        raise BodilyRefusal(
            f"joint {report.joint_limit_joint} would pass its limit by {-report.joint_limit_margin:.3f} rad",
            reason="joint_limits",
            value=report.joint_limit_margin,
            limit=0.0,
            unit="rad",
            way_out="plan less angular momentum (c_s, c_y nearer to 1), shorter steps or a lower gait.com_height",
        )


class _Orbit:
    """Newton on the return map of one plan and body."""

    def __init__(
        self, plan: GaitPlan, run: RunParameters, robot: Robot, progress: Callable[[str], None] | None
    ) -> None:
        self.plan, self.run, self.robot = plan, run, robot
        self.progress = progress
        self.ik = InverseKinematics(robot, run)
        self.reference: StepReference = step_reference(plan, step_grid(plan, run.solver.ik_time_step))
        self.n = 2 * robot.nv + 1
        self.scale = np.concatenate(
            [np.ones(robot.nv), np.full(robot.nv, _VELOCITY_SCALE), [_OFFSET_SCALE]]
        )
        self.evaluations = 0
        self.origin = self._standing()
        self.trajectory: StepTrajectory | None = None

    # ------------------------------------------------------------- unknowns

    def _standing(self) -> NDArray[np.float64]:
        """Start configuration of Newton: upright over the planned COM, knees bent, arms at rest."""
        robot, body = self.robot, self.robot.description
        q = pin.neutral(robot.model)
        q[7:] = self.ik.rest
        bend = 0.3
        for leg in body.legs:
            knee = robot.velocity_indices((leg.knee,))[0] + 1
            q[knee] = 2.0 * bend
        robot.jacobian(q, np.zeros(robot.nv))
        q[:3] += self.reference.position[0, 0] - robot._terms.com
        return q

    def _encode(self, q: NDArray[np.float64], v: NDArray[np.float64], offset: float) -> NDArray[np.float64]:
        return np.concatenate([pin.difference(self.robot.model, self.origin, q), v, [offset]]) * self.scale

    def _decode(self, z: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
        plain = z / self.scale
        nv = self.robot.nv
        return pin.integrate(self.robot.model, self.origin, plain[:nv]), plain[nv:-1], float(plain[-1])

    def _step(self, z: NDArray[np.float64]) -> StepTrajectory:
        self.evaluations += 1
        return self.ik.integrate(self.reference, *self._decode(z))

    def _returned(self, trajectory: StepTrajectory, offset: float) -> NDArray[np.float64]:
        robot = self.robot
        q = robot.mirror_q(trajectory.q[-1])
        q[0] -= self.plan.parameters.step_length
        return self._encode(q, robot.mirror_v(trajectory.v[-1]), offset)

    def _mean_pitch(self, trajectory: StepTrajectory) -> float:
        time = self.reference.time
        return float(np.trapezoid(trajectory.trunk_pitch, time) / time[-1])

    def residual(self, z: NDArray[np.float64]) -> NDArray[np.float64]:
        """Mirrored return minus start, and mean trunk pitch minus lean; scaled."""
        trajectory = self._step(z)
        self.trajectory = trajectory
        out = self._returned(trajectory, 0.0) - z
        out[-1] = self._mean_pitch(trajectory) - self.run.body.lean
        return out

    # --------------------------------------------------------------- Newton

    def solve(self) -> WholeBodyMotion:
        try:
            z = self._newton(self._guess())
        except (Unreachable, np.linalg.LinAlgError) as error:
            raise self._no_orbit(str(error)) from error
        trajectory = self.trajectory
        if trajectory is None:
            raise self._no_orbit("no step was integrated")
        return self._motion(z, trajectory)

    def _no_orbit(self, why: str) -> BodilyRefusal:
        error = getattr(self, "best", np.inf)
        return BodilyRefusal(
            f"the body finds no periodic motion for this plan: {why} (residual {error:.2g} after "
            f"{self.evaluations} steps, limit {TOLERANCE:g})",
            reason="no_periodic_motion",
            value=float(error),
            limit=TOLERANCE,
            unit="rad",
            way_out="plan less angular momentum (c_s, c_y nearer to 1), shorter steps or a lower gait.com_height",
        )

    def _guess(self) -> NDArray[np.float64]:
        """A few plain steps let the fast modes settle; the trunk's mean pitch, which is slow, is set by hand."""
        robot, lean, nv = self.robot, self.run.body.lean, self.robot.nv
        offset = 0.4
        q = self.ik.upright(self.reference, 0, self.origin)
        q, v = self.ik.project(self.reference, 0, q, np.zeros(nv), offset)
        z = self._encode(q, v, offset)
        for _ in range(5):
            trajectory = self._step(z)
            z = self._returned(trajectory, offset)
            change = trajectory.trunk_pitch[-1] - trajectory.trunk_pitch[0]
            z[4] += lean - self._mean_pitch(trajectory)
            z[nv + 4] -= change / self.reference.time[-1] * _VELOCITY_SCALE
        return z

    def _newton(self, z: NDArray[np.float64]) -> NDArray[np.float64]:
        value = self.residual(z)
        self.best = self._size(value)
        inverse = None
        rebuilt = 0
        for iteration in range(60):
            self._say(f"residual {self.best:.2e} after {self.evaluations} steps")
            if self.best <= TOLERANCE:
                return z
            if inverse is None:
                inverse = self._approximate_inverse(z, value)
                rebuilt = iteration
            step = -inverse(value)
            largest = float(np.abs(step[: self.robot.nv]).max())
            damping = min(1.0, _MAX_STEP / largest)
            for _ in range(6):
                try:
                    trial = z + damping * step
                    new = self.residual(trial)
                    if self._size(new) < max(1.0, 3.0 * damping) * self.best:
                        break
                except Unreachable:
                    pass
                damping *= 0.4
            else:
                if rebuilt == iteration:
                    raise self._no_orbit("Newton's steps no longer shrink the residual")
                inverse = None
                continue
            size = self._size(new)
            if size > 0.3 * self.best and damping == 1.0 or damping < 1.0:
                inverse = None
            else:
                inverse.update(trial - z, new - value)
            z, value, self.best = trial, new, size
        raise self._no_orbit("Newton did not converge")

    def _size(self, value: NDArray[np.float64]) -> float:
        return float(np.abs(value / self.scale).max())

    def _approximate_inverse(self, z: NDArray[np.float64], value: NDArray[np.float64]) -> _BroydenInverse:
        """Inverse Jacobian from directional differences along a Krylov space grown from the residual."""
        n = self.n
        offset_axis = np.zeros(n)
        offset_axis[-1] = 1.0
        basis = [offset_axis]
        images = [self._derivative(z, value, offset_axis)]
        direction = value.copy()
        for _ in range(9):
            for b in basis:
                direction = direction - (b @ direction) * b
            for b in basis:
                direction = direction - (b @ direction) * b
            norm = float(np.linalg.norm(direction))
            if norm < 1e-12:
                break
            direction /= norm
            image = self._derivative(z, value, direction)
            basis.append(direction)
            images.append(image)
            direction = image + direction  # the part that the map remembers
        return _BroydenInverse(np.array(basis).T, np.array(images).T)

    def _derivative(
        self, z: NDArray[np.float64], value: NDArray[np.float64], direction: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        h = 1e-5
        kept = self.trajectory
        image = (self.residual(z + h * direction) - value) / h
        self.trajectory = kept
        return image

    def _say(self, text: str) -> None:
        if self.progress is not None:
            self.progress(text)

    # --------------------------------------------------------------- result

    def _multipliers(self, z: NDArray[np.float64], trajectory: StepTrajectory) -> tuple[tuple[float, float], ...]:
        """Leading eigenvalues of the return map at fixed offset, by Arnoldi from a fixed start vector."""
        m, n = 10, self.n - 1
        offset = float(z[-1] / self.scale[-1])
        base = self._returned(trajectory, offset)
        basis = np.zeros((m + 1, n))
        hessenberg = np.zeros((m + 1, m))
        start = np.random.default_rng(0).normal(size=n)
        basis[0] = start / np.linalg.norm(start)
        h = 1e-5
        for k in range(m):
            moved = z.copy()
            moved[:-1] += h * basis[k]
            image = (self._returned(self._step(moved), offset) - base)[:-1] / h
            for j in range(k + 1):
                hessenberg[j, k] = basis[j] @ image
                image = image - hessenberg[j, k] * basis[j]
            hessenberg[k + 1, k] = np.linalg.norm(image)
            if hessenberg[k + 1, k] < 1e-8:
                m = k + 1
                break
            basis[k + 1] = image / hessenberg[k + 1, k]
        values = np.linalg.eigvals(hessenberg[:m, :m])
        values = values[np.argsort(-np.abs(values), kind="stable")][:4]
        return tuple((float(x.real), float(x.imag)) for x in values)

    def _motion(self, z: NDArray[np.float64], trajectory: StepTrajectory) -> WholeBodyMotion:
        robot = self.robot
        value = self._returned(trajectory, float(z[-1])) - self._encode(
            trajectory.q[0], trajectory.v[0], float(z[-1])
        )
        knees = trajectory.q[:, robot.knee_joints + 1]
        angles = trajectory.q[:, 7:]
        margins = np.minimum(angles - robot.lower, robot.upper - angles).min(axis=0)
        closest = int(np.argmin(margins))
        switch = int(np.searchsorted(self.reference.time, self.plan.constants.single_support_duration - 1e-12))
        report = MotionReport(
            angular_momentum_y_offset=float(z[-1] / self.scale[-1]),
            residual=float(np.abs(value[:-1] / self.scale[:-1]).max()),
            mean_trunk_pitch=self._mean_pitch(trajectory),
            multipliers=self._multipliers(z, trajectory),
            constraint_position=trajectory.constraint_position,
            constraint_velocity=trajectory.constraint_velocity,
            constraint_acceleration=trajectory.constraint_acceleration,
            knee_minimum=float(knees.min()),
            joint_limit_margin=float(margins[closest]),
            joint_limit_joint=robot.joint_names[closest],
            acceleration_jump=self._jump(trajectory, switch),
            evaluations=self.evaluations,
        )
        return WholeBodyMotion(
            joint_names=robot.joint_names,
            time=np.array(self.reference.time),
            q=trajectory.q,
            v=trajectory.v,
            acceleration=trajectory.acceleration,
            trunk_pitch=trajectory.trunk_pitch,
            angular_momentum_z=trajectory.angular_momentum_z,
            step_length=self.plan.parameters.step_length,
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


class _BroydenInverse:
    """Inverse of a Jacobian that is minus the identity off a small known space, with Broyden's good updates."""

    def __init__(self, basis: NDArray[np.float64], images: NDArray[np.float64]) -> None:
        # J = -I + (images + basis) basis^T, inverted by Woodbury.
        self._U, self._V = images + basis, basis
        small = np.eye(basis.shape[1]) - self._V.T @ self._U
        self._core = np.linalg.solve(small, self._V.T)
        self._updates: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []

    def __call__(self, value: NDArray[np.float64]) -> NDArray[np.float64]:
        out = -(value + self._U @ (self._core @ value))
        for left, right in self._updates:
            out = out + left * (right @ out)
        return out

    def update(self, step: NDArray[np.float64], change: NDArray[np.float64]) -> None:
        """Make the inverse map ``change`` to ``step``."""
        image = self(change)
        denominator = float(step @ image)
        if abs(denominator) > 1e-300:
            self._updates.append(((step - image) / denominator, step))
