"""The whole-body motion of one step, and the posture of a walk that tiles it by mirroring, at any pace.

The one-step map of the inverse kinematics is unstable: an error grows with every step. Therefore only one
step is solved, as a periodic orbit (:mod:`ampm.body.orbit`). Every later step is its mirror image, moved
forward by a step length.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ampm.brief import Brief
from ampm.exceptions import InputError
from ampm.geometry import Array, ReadOnly
from ampm.planner.contacts import read_only
from ampm.walk import Posture, PostureState

if TYPE_CHECKING:
    from ampm.body.robot import Gaps, Robot


@dataclass(frozen=True)
class Extreme:
    """A smallest or largest value, and where and when it occurred."""

    value: float  # in the unit of the quantity; NaN if nothing was measured
    time: float | None = None  # when, in the step or the walk [s]; None if nothing was measured
    where: str = ""  # side, joint, foot, or both parts of the body; empty if there is none to name

    @classmethod
    def of(cls, values: Array, time: Array, names: Sequence[str] = (), *, largest: bool = False) -> Extreme:
        """Smallest or largest finite entry of (N,) or (N, M) at N times, and the name of its column."""
        values = values if values.ndim == 2 else values[:, None]
        known = np.isfinite(values)
        if not known.any():
            return cls(math.nan)
        filled = np.where(known, values, -np.inf if largest else np.inf)
        row, column = divmod(int(filled.argmax() if largest else filled.argmin()), values.shape[1])
        return cls(float(values[row, column]), float(time[row]), names[column] if names else "")

    @classmethod
    def of_gaps(cls, gaps: Gaps, time: Array) -> Extreme:
        """Least distance of two parts of a body at T times [m]."""
        closest = int(gaps.distance.argmin())
        return cls(float(gaps.distance[closest]), float(time[closest]), gaps.parts[closest])


@dataclass(frozen=True)
class MotionReport:
    """Quantities of a periodic step."""

    angular_momentum_y_offset: float  # constant of L_y that makes the step periodic [N m s]
    residual: float  # largest difference of the mirrored return, q and qd [rad, m, rad/s, m/s]
    mean_trunk_pitch: float  # over the step [rad]
    # eigenvalues of the one-step return map above 0.05 in magnitude, largest first, as (real, imaginary)
    multipliers: tuple[tuple[float, float], ...]
    knee_minimum: Extreme  # smallest knee flexion, and its side; the left foot stands [rad]
    joint_limit_margin: Extreme  # smallest distance of any joint from its limits, negative beyond them [rad]
    clearance: Extreme  # smallest distance of two parts of the body, negative where they overlap [m]


@dataclass(frozen=True)
class WholeBodyMotion(Brief, ReadOnly):
    """One periodic step of a body: left stance, from the start of single support to the next one."""

    joint_names: tuple[str, ...]  # hinges in the order of `v[6:]`
    time: Array  # grid, shape (n+1,) [s]
    q: Array  # Pinocchio configurations (root quaternion x, y, z, w), shape (n+1, nq)
    v: Array  # Pinocchio velocities, shape (n+1, nv)
    acceleration: Array  # Pinocchio accelerations, shape (n+1, nv)
    trunk_pitch: Array  # shape (n+1,) [rad]
    angular_momentum_z: Array  # about the COM, shape (n+1,) [N m s]; not part of a plan
    step_length: float  # way of a step along x [m]
    step_rise: float  # the same along z [m]
    report: MotionReport  # constant of L_y, residuals, multipliers, margins

    @property
    def step_duration(self) -> float:
        """Duration of the step [s]."""
        return float(self.time[-1])

    @cached_property
    def _rates(self) -> Array:
        """Time derivative of q at the grid's nodes, shape (n+1, nq)."""
        return read_only(_configuration_rate(self.q, self.v))

    def sample(self, times: ArrayLike, robot: Robot) -> PostureState:
        """Evaluate the tiled motion by cubic Hermite interpolation between grid nodes.

        Times count from the start of the first step, shape (N,) [s]; a negative one raises InputError. The
        body has the mirror map and the trunk.
        """
        t = np.atleast_1d(np.asarray(times, dtype=np.float64))
        if t.size and t.min() < -1e-9:
            raise InputError(f"time {t.min():g} s lies before the motion's start at 0 s; give later times.")
        step = np.maximum(np.floor(t / self.step_duration + 1e-9), 0.0)
        local = np.clip(t - step * self.step_duration, 0.0, self.step_duration)
        index = np.clip(np.searchsorted(self.time, local + 1e-12, side="right") - 1, 0, len(self.time) - 2)
        h = (self.time[index + 1] - self.time[index])[:, None]
        s = (local - self.time[index])[:, None] / h
        rates = self._rates
        q = _hermite(s, h, self.q[index], self.q[index + 1], rates[index], rates[index + 1])
        q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
        rates = self.acceleration
        v = _hermite(s, h, self.v[index], self.v[index + 1], rates[index], rates[index + 1])
        acceleration = (1.0 - s) * rates[index] + s * rates[index + 1]
        yaw = (1.0 - s[:, 0]) * self.angular_momentum_z[index] + s[:, 0] * self.angular_momentum_z[index + 1]
        odd = np.mod(step, 2.0) == 1.0
        q[odd] = robot.mirror_q(q[odd])
        v[odd], acceleration[odd] = robot.mirror_v(v[odd]), robot.mirror_v(acceleration[odd])
        q[:, 0] += step * self.step_length
        q[:, 2] += step * self.step_rise
        trunk, window = robot.trunk_rotations(q), np.zeros(len(t))
        state = PostureState(q, v, acceleration, trunk, np.where(odd, -yaw, yaw), window)
        for array in state:
            array.setflags(write=False)
        return state

    def table(self) -> dict[str, Array]:
        """Columns for a table: time, root pose and velocity, every joint's angle, velocity, acceleration."""
        columns = {"time": self.time}
        columns |= {f"root_position_{axis}": self.q[:, i] for i, axis in enumerate("xyz")}
        columns |= {f"root_quaternion_{axis}": self.q[:, 3 + i] for i, axis in enumerate("xyzw")}
        for i, axis in enumerate("xyz"):
            columns[f"root_linear_velocity_local_{axis}"] = self.v[:, i]
            columns[f"root_angular_velocity_local_{axis}"] = self.v[:, 3 + i]
        for i, name in enumerate(self.joint_names):
            columns[f"q_{name}"] = self.q[:, 7 + i]
            columns[f"qd_{name}"] = self.v[:, 6 + i]
            columns[f"qdd_{name}"] = self.acceleration[:, 6 + i]
        columns["trunk_pitch"] = self.trunk_pitch
        columns["angular_momentum_z"] = self.angular_momentum_z
        return columns


@dataclass(frozen=True)
class PeriodicPosture(Brief):
    """A periodic whole-body step as the posture of a walk."""

    motion: WholeBodyMotion  # one step
    robot: Robot  # the body
    start: tuple[Array, Array] | None = None  # configuration and velocity at time 0, if not those of the step

    def report(self) -> dict[str, Any]:
        """Values of the periodic motion, see :class:`MotionReport`."""
        return asdict(self.motion.report)

    def sample(self, times: ArrayLike) -> PostureState:
        """States at ``times``, shape (T,) [s]; see :meth:`WholeBodyMotion.sample`."""
        state = self.motion.sample(times, self.robot)
        if self.start is None:
            return state
        first = (np.atleast_1d(times) <= 0.0)[:, None]
        q, v = (np.where(first, *pair) for pair in zip(self.start, (state.q, state.v), strict=True))
        return state._replace(q=q, v=v)


@dataclass(frozen=True)
class RetimedPosture:
    """A posture whose phases have other durations; both clocks run alike before and after the given times."""

    posture: Posture  # on its own clock
    times: Array  # ascending, shape (K,) [s]
    posture_times: Array  # the same instants on the clock of the posture, shape (K,) [s]

    def sample(self, times: ArrayLike) -> PostureState:
        """States at ``times``, shape (T,) [s]."""
        time = np.atleast_1d(np.asarray(times, dtype=np.float64))
        beyond = time - np.clip(time, self.times[0], self.times[-1])
        state = self.posture.sample(np.interp(time, self.times, self.posture_times) + beyond)
        phase = np.clip(np.searchsorted(self.times, time, "right") - 1, 0, len(self.times) - 2)
        pace = np.where(beyond, 1.0, (np.diff(self.posture_times) / np.diff(self.times))[phase])
        return state._replace(
            v=pace[:, None] * state.v,
            acceleration=pace[:, None] ** 2 * state.acceleration,
            angular_momentum_z=pace * state.angular_momentum_z,
        )

    def report(self) -> dict[str, Any]:
        """The posture's report."""
        return self.posture.report()


def _configuration_rate(q: Array, v: Array) -> Array:
    """Time derivative of configurations (n, nq): root velocity in world, quaternion rate, joint rates."""
    rate = np.empty_like(q)
    vector, w = q[:, 3:6], q[:, 6:7]
    # R u = u + 2 r x (r x u + w u), and for the quaternion half its product with the angular velocity.
    turned = np.cross(vector, v[:, :3]) + w * v[:, :3]
    rate[:, :3] = v[:, :3] + 2.0 * np.cross(vector, turned)
    omega = v[:, 3:6]
    rate[:, 3:6] = 0.5 * (w * omega + np.cross(vector, omega))
    rate[:, 6] = -0.5 * np.sum(vector * omega, axis=1)
    rate[:, 7:] = v[:, 6:]
    return rate


def _hermite(s: Array, h: Array, p0: Array, p1: Array, d0: Array, d1: Array) -> Array:
    """Cubics at shares s of intervals h, by values p and rates d at their ends."""
    s2, s3 = s * s, s * s * s
    return (
        (2 * s3 - 3 * s2 + 1) * p0 + (s3 - 2 * s2 + s) * h * d0 + (3 * s2 - 2 * s3) * p1 + (s3 - s2) * h * d1
    )
