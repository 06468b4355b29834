"""The mirrored one-step map of the inverse kinematics, and Newton's method for its fixed point.

Only a few modes of the map are slow. Newton's method therefore evaluates the Jacobian of ``return - start``
on a small Krylov space and takes it as minus the identity elsewhere.
"""

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ampm.body.inverse_kinematics import InverseKinematics, Unreachable
from ampm.body.step_kinematics import StepTrajectory
from ampm.body.step_reference import StepReference
from ampm.geometry import Array
from ampm.planner.contacts import Contacts

_MULTIPLIERS = 4  # of the return map, reported at most
_SLOW = 0.05  # magnitude from which a multiplier is reported; modes below it are gone within a step

_VELOCITY_SCALE = 0.1  # weighs velocities against positions in the Krylov norm [s]
_MAX_STEP = 0.5  # of a Newton step, in scaled units
_DIFFERENCE = 1e-5  # step of finite differences, in scaled units
_KRYLOV = 10  # largest dimension of the Krylov space
_LEFT = 0.9  # share of the residual after a step above which the Jacobian, ten steps, is built anew [1]
_PATHS = (((0.06, 1.0),), ((0.1, 1.0),), ((0.06, 0.5), (0.03, 0.75)))
"""Paths to a step from easier ones: how much lower the COM of a body of 1.70 m is [m], and the share of the
angular momentum."""
_EASIER_TOLERANCE = 1e-5  # of an easier step [rad, m, rad/s, m/s]


class StepMap:
    """The mirrored one-step map of one reference, in scaled unknowns ``z``.

    ``z`` holds the start configuration as a tangent vector at a body that stands upright at the planned COM,
    the start velocity and the constant of L_y, each times ``scale``; that of L_y is 1.

    Args:
        ik: integrates the step.
        reference: the step.
        contacts: their step is its way.
        lean: mean pitch of the trunk over the step [rad].
    """

    def __init__(
        self, ik: InverseKinematics, reference: StepReference, contacts: Contacts, lean: float
    ) -> None:
        self.ik, self.reference, self.origin = ik, reference, standing(ik, reference)
        self.contacts, self.lean = contacts, lean
        nv = self.ik.robot.nv
        self.n = 2 * nv + 1
        self.scale = np.repeat([1.0, _VELOCITY_SCALE, 1.0], [nv, nv, 1])

    def easier(self, drop: float, share: float) -> "StepMap":
        """The map of the same step with the COM lower by ``drop`` [m] and a share of the angular momentum."""
        return StepMap(self.ik, self.reference.easier(drop, share), self.contacts, self.lean)

    def encode(self, q: Array, v: Array, offset: float) -> Array:
        """Unknowns of a start state and a constant of L_y [N m s]."""
        tangent = pin.difference(self.ik.robot.model, self.origin, q)
        return np.concatenate([tangent, v, [offset]]) * self.scale

    def decode(self, z: Array) -> tuple[Array, Array, float]:
        """Start configuration, start velocity, constant of L_y [N m s]."""
        plain, nv = z / self.scale, self.ik.robot.nv
        return pin.integrate(self.ik.robot.model, self.origin, plain[:nv]), plain[nv:-1], float(plain[-1])

    def step(self, z: Array) -> StepTrajectory:
        """Integrate the step; raises Unreachable if the body cannot follow."""
        q, v, offset = self.decode(z)
        return self.ik.integrate(self._with(offset), q, v)

    def _with(self, offset: float) -> StepReference:
        """The reference with a constant of L_y [N m s]."""
        return self.reference.with_angular_momentum((0.0, offset / self.ik.robot.mass))

    def returned(self, trajectory: StepTrajectory, offset: float = 0.0) -> Array:
        """Unknowns of the step's mirrored end, and a constant of L_y [N m s]."""
        robot, way = self.ik.robot, self.contacts
        q = robot.mirror_q(trajectory.q[-1], -way.step_length, -way.step_rise)
        return self.encode(q, robot.mirror_v(trajectory.v[-1]), offset)

    def mean_pitch(self, trajectory: StepTrajectory) -> float:
        """Mean pitch of the trunk over the step [rad]."""
        time = self.reference.time
        return float(np.trapezoid(trajectory.trunk_pitch, time) / time[-1])

    def residual(self, z: Array, trajectory: StepTrajectory) -> Array:
        """Mirrored return minus start, and mean trunk pitch minus lean; scaled."""
        out = self.returned(trajectory) - z
        out[-1] = self.mean_pitch(trajectory) - self.lean
        return out

    def size(self, value: Array) -> float:
        """Largest component of a residual [rad, m, rad/s, m/s]."""
        return float(np.abs(value / self.scale).max())

    def guess(self) -> Array:
        """First guess: a few plain steps damp the fast modes; the slow mean trunk pitch is set directly.

        Raises Unreachable if the body cannot even stand at the start of the step, or walk these steps.
        """
        robot = self.ik.robot
        body = robot.description
        # The usual L_y of a human of 60 kg and 1.70 m, which scales as m (g h^3)^1/2.
        nv, offset = robot.nv, 0.4 * (body.mass / 60.0) * body.scale**1.5
        q, v = self.ik.upright(self._with(offset), 0, self.origin)
        z = self.encode(q, v, offset)
        for _ in range(5):
            trajectory = self.step(z)
            z = self.returned(trajectory, offset)
            change = trajectory.trunk_pitch[-1] - trajectory.trunk_pitch[0]
            z[4] += self.lean - self.mean_pitch(trajectory)
            z[nv + 4] -= change / self.reference.time[-1] * _VELOCITY_SCALE
        return z


def standing(ik: InverseKinematics, reference: StepReference) -> Array:
    """Origin of the unknowns: upright at the planned COM, knees bent, arms at rest."""
    robot = ik.robot
    q = pin.neutral(robot.model)
    q[7:] = ik.rest
    q[robot.knee_joints + 1] = robot.knee_angles(0.6)
    q[:3] += reference.position[0, 0] - robot.jacobian(q).com
    return q


class BroydenInverse:
    """Inverse of a Jacobian that is minus the identity off a small known space, with Broyden's updates.

    Args:
        basis: orthonormal vectors, shape (k, n).
        images: of the Jacobian, shape (k, n).
    """

    def __init__(self, basis: Array, images: Array) -> None:
        self._updates: list[tuple[Array, Array]] = []
        for direction, image in zip(basis, images, strict=True):
            self.update(direction, image)

    def __call__(self, value: Array) -> Array:
        """The inverse times a residual, shape (n,)."""
        out = -value
        for left, right in self._updates:
            out = out + left * (right * out).sum()
        return out

    def update(self, step: Array, change: Array) -> None:
        """Make the inverse map ``change`` to ``step``."""
        image = self(change)
        denominator = float((step * image).sum())
        if abs(denominator) > 1e-300:
            self._updates.append(((step - image) / denominator, step))


@dataclass
class Orbit:
    """A periodic step: a fixed point of one map."""

    reference: StepReference  # tasks of the body, on the grid
    z: Array  # unknowns of the map, see `StepMap`
    trajectory: StepTrajectory  # the step
    inverse: BroydenInverse | None  # approximate inverse Jacobian, for the next search nearby


def newton(
    step_map: StepMap, z: Array, tolerance: float, inverse: BroydenInverse | None = None, *, rebuilds: int = 4
) -> Orbit:
    """Fixed point of a map near ``z``.

    Args:
        step_map: the map.
        z: first guess.
        tolerance: of the residual [rad, m, rad/s, m/s].
        inverse: of the Jacobian at a neighbour; built here if it is missing or too inaccurate.
        rebuilds: how many times it may be built.

    Raises:
        Unreachable: the guess itself, or its neighbourhood, cannot be walked, or Newton does not converge.
    """

    def stalled(residual: float) -> Unreachable:
        return Unreachable(0.0, f"no state was found that returns mirrored (residual {residual:.2g})")

    trajectory = step_map.step(z)
    value = step_map.residual(z, trajectory)
    best = step_map.size(value)
    cause: Unreachable | None = None
    while not best <= tolerance:  # a NaN is not an orbit
        fresh = inverse is None
        if inverse is None:
            if rebuilds == 0:
                raise cause or stalled(best)
            rebuilds -= 1
            inverse = _approximate_inverse(step_map, z, value)
        step = -inverse(value)
        largest = float(np.abs(step[: step_map.ik.robot.nv]).max())
        damping = min(1.0, _MAX_STEP / largest)
        for _ in range(5):
            trial = z + damping * step
            try:
                moved = step_map.step(trial)
                new = step_map.residual(trial, moved)
                size = step_map.size(new)
                if size < (1.0 - 0.2 * damping) * best:
                    break
            except Unreachable as error:
                cause = error
            damping *= 0.4
        else:
            if fresh:
                raise cause or stalled(best)
            inverse = None
            continue
        if damping == 1.0 and size < _LEFT * best:
            inverse.update(trial - z, new - value)
        else:
            inverse = None
        z, trajectory, value, best = trial, moved, new, size
    return Orbit(step_map.reference, z, trajectory, inverse)


def start_orbit(step_map: StepMap, tolerance: float) -> Orbit:
    """Fixed point of a map from a body that stands upright, else from the periodic steps of easier ones.

    The tolerance is that of the residual [rad, m, rad/s, m/s]. Raises Unreachable if none was found; its
    ``drop`` is by how much lower the COM of one is.
    """
    try:
        return newton(step_map, step_map.guess(), tolerance)
    except Unreachable as error:
        cause = error
    scale, enough = step_map.ik.robot.description.scale, max(tolerance, _EASIER_TOLERANCE)
    for path in _PATHS:
        first, *others = (step_map.easier(scale * drop, share) for drop, share in path)
        try:
            z = first.guess()
            for easier in others[:1]:  # from a guess that cannot walk the next step no orbit leads there
                easier.step(z)
            orbit = newton(first, z, enough)
            for easier in others:
                orbit = newton(easier, orbit.z, enough, orbit.inverse)
        except Unreachable:
            continue
        try:
            return newton(step_map, orbit.z, tolerance, orbit.inverse)
        except Unreachable as error:
            if not others and not cause.drop:
                error.drop = scale * path[0][0]
                cause = error
    raise cause


def _approximate_inverse(step_map: StepMap, z: Array, value: Array) -> BroydenInverse:
    """Inverse Jacobian from directional differences along a Krylov space grown from the residual."""
    basis, images = np.zeros((2, _KRYLOV, step_map.n))
    direction = np.zeros(step_map.n)
    direction[-1] = 1.0  # the constant of L_y always matters
    for k in range(_KRYLOV):
        moved = z + _DIFFERENCE * direction
        image = (step_map.residual(moved, step_map.step(moved)) - value) / _DIFFERENCE
        basis[k], images[k] = direction, image
        known = basis[: k + 1]
        # The image under the map itself, without the minus identity.
        direction = image + direction if k else value
        for _ in range(2):  # orthogonalised twice because of rounding
            direction = direction - np.einsum("kn,k", known, np.einsum("kn,n", known, direction))
        norm = _length(direction)
        if norm < 1e-12:
            break
        direction = direction / norm
    return BroydenInverse(known, images[: len(known)])


def leading_multipliers(step_map: StepMap, orbit: Orbit) -> tuple[tuple[float, float], ...]:
    """Slow eigenvalues of the return map at a fixed constant of L_y, largest first, by Arnoldi's method.

    Eigenvalues below :data:`_SLOW` are left out, because they are not computed accurately.
    """
    most, n = 12, step_map.n - 1
    base = step_map.returned(orbit.trajectory)
    basis, hessenberg = np.zeros((most + 1, n)), np.zeros((most + 1, most))
    start = np.random.default_rng(0).normal(size=n)
    basis[0] = start / _length(start)
    slow = np.zeros(0, dtype=complex)
    for k in range(most):
        moved = orbit.z.copy()
        moved[:-1] += _DIFFERENCE * basis[k]
        image = (step_map.returned(step_map.step(moved)) - base)[:-1] / _DIFFERENCE
        for j in range(k + 1):
            hessenberg[j, k] = (basis[j] * image).sum()
            image = image - hessenberg[j, k] * basis[j]
        rest = _length(image)
        hessenberg[k + 1, k] = rest
        values, vectors = np.linalg.eig(hessenberg[: k + 1, : k + 1])
        order = np.argsort(-np.abs(values), kind="stable")[:_MULTIPLIERS]
        order = order[np.abs(values[order]) > _SLOW]
        slow = values[order]
        # A Ritz value's residual is what the next direction would add to its vector.
        if rest < 1e-8 or (k + 1 >= _MULTIPLIERS and (rest * np.abs(vectors[-1, order]) < 1e-5).all()):
            break
        basis[k + 1] = image / rest
    return tuple((float(x.real), float(x.imag)) for x in slow)


def _length(a: Array) -> float:
    return math.sqrt((a * a).sum())
