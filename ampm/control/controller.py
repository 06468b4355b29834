"""Torque-level tracking of a planned walk: state, sensed contact and reference in, joint torques out.

Every tick commands a momentum rate (the plan's, plus feedback of COM and angular momentum) and accelerations
of feet and posture. The QP of :mod:`ampm.control.wrench_qp` finds contact forces, which give the
accelerations, and inverse dynamics the torques; :mod:`ampm.control.tick` is the tick in compiled functions.
The controller is independent of the simulator.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ampm.body.inverse_kinematics import POSTURE_WEIGHTS
from ampm.body.robot import Robot
from ampm.compiled import Bundle, bound, records
from ampm.control.forces import ANGULAR, share_forces, without_closed
from ampm.control.limited_qp import LimitedForm, acceleration_bounds
from ampm.control.live import LiveReference
from ampm.control.records import LINE, PHI, feet_of, gains_of, points_of
from ampm.control.tick import (
    ALPHA,
    HIGH,
    LAST,
    LIMIT,
    LOW,
    POSTURE,
    RATE,
    RATES,
    RHS,
    SCALE,
    SOFTNESS,
    V,
    keep,
    observe,
    prepare,
    respond,
    torques,
)
from ampm.control.trunk import LONGEST
from ampm.control.wrench_qp import CondensedForm
from ampm.parameters import RunParameters
from ampm.qp import QPSettings, QPSolution, QPStatus
from ampm.walk import LIMITED, SOLVED, UNSOLVED, ControlOutput, Reference, State, Timing, Touch, WalkPlan

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_END_SOFTNESS = 1e-2  # of the task of a toe that is at the end of its range


class TrackingController:
    """Whole-body inverse dynamics along the :class:`~ampm.walk.Reference` of each tick.

    Args:
        robot: the body, as the controller knows it.
        run: gains, friction, solver.

    Attributes:
        condensed: the QP of every tick.
        limited: the QP of a tick that would break a limit.
        own: all arrays of a tick, as compiled functions take them.
    """

    def __init__(self, robot: Robot, run: RunParameters) -> None:
        self.robot, gains, solver = robot, run.controller, run.solver
        body = robot.rigid_body
        self._gains, self._lines = gains_of(gains), records((len(robot.sole_frames), 3), LINE)
        self._feet, self._points = feet_of(robot), points_of(robot)
        self._extrapolates = gains.hold == "first-order"
        weights = robot.by_group(POSTURE_WEIGHTS)
        self._root_weight = np.sqrt(weights)
        rows = body.columns.shape[1]
        self._q, self._motion, self._tasks = np.zeros(robot.nq), np.zeros((7, robot.nv)), np.zeros((6, rows))
        self._tasks[SCALE] = 1.0
        self._tasks[SCALE, 3:6] = ANGULAR
        self._hinges = np.zeros((5, robot.nu))
        self._hinges[[LIMIT, LOW, HIGH]] = robot.torque_limit, robot.lower, robot.upper
        settings = QPSettings(tolerance=solver.tolerance, max_iterations=solver.max_iterations)
        groups = self._points["line"].reshape(len(self._feet), -1)
        qp = self.condensed = CondensedForm(solver.qp, settings, gains.friction, groups)
        limit_settings = QPSettings(  # a problem of mixed scales, solved in few ticks: it is equilibrated
            tolerance=2.0 * solver.tolerance,
            max_iterations=4 * solver.max_iterations,
            rho=0.1,
            alpha=1.6,
            scaling=10,
        )
        self.limited = LimitedForm(solver.qp, limit_settings, weights, rows, qp)
        self._phi, self._wrench = np.zeros((2, qp.forces)), np.zeros((6, qp.forces))
        self._scaled = np.zeros((robot.nv, rows))
        count = len(self._points)
        self._sensed, self._touching = np.zeros(count), np.zeros(count, dtype=bool)
        self._first, self._command = True, np.zeros(11)
        tilts = np.zeros((math.ceil(LONGEST * gains.frequency), 2)), np.zeros(4)
        self._stabilizer = gains.stabilizer
        self._com, self._share = np.zeros(3), np.zeros(6)
        self._live: LiveReference | None = None
        flags, lines = np.zeros((2, *self._lines.shape), dtype=bool), np.zeros(self._lines.shape)
        self._reference = (
            np.zeros((5, 3)), np.zeros((len(self._feet), 27)), *flags, lines,
            np.zeros(robot.nq), *np.zeros((2, robot.nv)), np.zeros((3, 3)),
        )  # fmt: skip
        self._forces = np.zeros(qp.forces)
        parts = "centre feet_values planned due until_lift posture_q posture_v posture_a posture_trunk"
        self.own = Bundle(
            tree=body.tree, link=body.link, feet=self._feet, trunk=body.trunk, points=self._points,
            lines=self._lines, gains=self._gains, gravity=robot.gravity, armature=body.armature,
            root_weight=self._root_weight, passive=robot.passive, q=self._q, motion=self._motion,
            tasks=self._tasks, hinges=self._hinges, columns=body.columns, com=self._com, share=self._share,
            scaled=self._scaled, system=np.zeros((rows, rows + 7)), phi=self._phi, wrench=self._wrench,
            forces=self._forces, P=qp.P, gradient=qp.q, A=qp.A, lower=qp.lower, upper=qp.upper,
            command=self._command, past=tilts[0], memory=tilts[1],
            extrapolates=self._extrapolates, sensed=self._sensed, touching=self._touching,
            **dict(zip(parts.split(), self._reference, strict=True)),
        )  # fmt: skip
        self._measured = self._q, self._motion[V], self._sensed, self._touching
        own, output = (self.own,), (np.zeros(robot.nu), np.zeros((count, 3)))
        self._observe = bound(observe, own, 0.0)
        self._prepare = bound(prepare, own, 0.0, True, 0.0, 0.0)
        self._respond = bound(respond, own, True, True, *output)

    @property
    def acceleration(self) -> Array | None:
        """Commanded by the last tick, shape (nv,) [m/s^2, rad/s^2]; None before the first."""
        return None if self._first else self._motion[LAST]

    @property
    def phi(self) -> Array:
        """Contact forces of the last tick in the unknowns of :mod:`ampm.control.forces`, shape (U,) [m g]."""
        return self._phi[PHI]

    def follow(self, plan: WalkPlan, timing: Timing) -> None:
        """Take notice of the plan whose references will come, for a stabiliser that steps.

        Args:
            plan: of the walk.
            timing: with which its references are made.
        """
        if self._stabilizer == "stepping":
            own = self._feet, self._points, self._touching, self._com, self._tasks[RATES]
            body = self.robot.mass, self.robot.gravity, 1.0 / float(self._gains["frequency"][0])
            described = self.robot.description
            shape = described.scale, 2.0 * described.sole.half_width
            self._live = LiveReference(plan, timing, *own, *body, *shape, self._share)

    def update(self, state: State, touch: Touch, reference: Reference) -> ControlOutput:
        """One control tick.

        Args:
            state: the measured state.
            touch: readings of the soles.
            reference: what is planned at this instant.
        """
        first = self._first
        if first:
            self._motion[LAST] = reference.posture.acceleration
        _copy((state.q, state.v, touch.normal_force, touch.contact), self._measured)
        self._observe(state.velocity_lag)
        if self._live is not None:
            reference = self._live.reference(state.time, reference)
        body = reference.posture
        _copy((reference.centre, reference.feet.values, *reference.contacts, *body[:4]), self._reference)
        has_qp = self._prepare(touch.age, first, reference.right_load, body.tilt_window)
        return self.complete(self.condensed.solve() if has_qp else None, reference)

    @property
    def makes_references(self) -> bool:
        """Whether it may follow other references than those given."""
        return self._live is not None

    def complete(self, solution: QPSolution | None, reference: Reference) -> ControlOutput:
        """The rest of a tick after its QP.

        Args:
            solution: of the QP; None if it has none.
            reference: of the tick.
        """
        torque, point_force = np.empty(self.robot.nu), np.empty((len(self._points), 3))
        solution, status = self._find_torques(solution, bool(reference.jumps), torque, point_force)
        self._first, command = False, self._command.copy()
        return ControlOutput(
            torque,
            command[0:3],
            command[9:11],
            command[6:9],
            point_force,
            status,
            solution.residual,
            solution.iterations,
            solution.seconds,
            self._hinges[RATE].copy() if self._extrapolates else None,
            reference,
        )

    # ------------------------------------------------------------------ parts

    def _find_torques(
        self, solution: QPSolution | None, still: bool, torque: Array, point_force: Array
    ) -> tuple[QPSolution, int]:
        """Torques of a solution, or of the QP with limits if they break one; solution and status."""
        if solution is None:
            return self._hold_last_command(still, torque, point_force), UNSOLVED
        status, forces = SOLVED if solution.solved else UNSOLVED, solution.x[: self.condensed.forces]
        if not solution.solved and (
            solution.status == QPStatus.INFEASIBLE or not np.isfinite(solution.x).all()
        ):  # otherwise the last iterate; the accelerations follow the dynamics in any case
            forces = without_closed(len(self._feet), self._points, self.phi)
        self._forces[...] = forces
        if self._respond(still, self._first, torque, point_force):
            return solution, status
        limited = self._solve_limited()
        if limited.solved:
            nv = self.robot.nv
            self._motion[ALPHA] = self.robot.gravity * limited.x[:nv]
            forces = limited.x[nv : nv + self.condensed.forces]
            torques(self.own, forces, torque, point_force)
        keep(self.own, forces, still, self._first, torque)
        return _both(solution, limited), max(status, LIMITED if limited.solved else UNSOLVED)

    def _hold_last_command(self, still: bool, torque: Array, point_force: Array) -> QPSolution:
        """Accelerations and forces of the last tick, and their torques; the solution that there is not."""
        self._motion[ALPHA] = self._motion[LAST]
        share_forces(len(self._feet), self._points, self.phi, False)
        forces = without_closed(len(self._feet), self._points, self.phi)
        torques(self.own, forces, torque, point_force)
        if not np.isfinite(torque).all():
            torque[:] = 0.0
        keep(self.own, forces, still, self._first, torque)
        return QPSolution(forces, QPStatus.UNSOLVED, math.inf, 0, 0.0)

    def _torque_map(self) -> tuple[Array, Array]:
        """Torques as ``map @ (alpha, phi) + bias``, shapes (nu, nv + U) and (nu,) [N m]."""
        kept, (nu, nv, count) = self._motion.copy(), (self.robot.nu, self.robot.nv, self.condensed.forces)
        point_force, by_unknown = np.empty((len(self._points), 3)), np.zeros((nv + count + 1, nu))
        for column, unit in zip(
            by_unknown, np.eye(nv + count + 1), strict=True
        ):  # the last one is none of them
            self._motion[ALPHA] = self.robot.gravity * unit[:nv]
            torques(self.own, unit[nv:-1], column, point_force)
        self._motion[:] = kept
        return (by_unknown[:-1] - by_unknown[-1]).T, by_unknown[-1]

    def _solve_limited(self) -> QPSolution:
        """The whole problem again, with the limits of torque and joint range as constraints."""
        torque_map, bias = self._torque_map()
        low, high = acceleration_bounds(self.robot, self._q, self._motion[V])
        limit, rhs, softness = self.robot.torque_limit, self._tasks[RHS], self._tasks[SOFTNESS].copy()
        for foot in self._feet:
            row, toe = foot["toe_row"], foot["toe"] - 6
            if row >= 0 and not low[toe] <= rhs[row] <= high[toe]:  # an exact row would contradict the limit
                softness[row] = _END_SOFTNESS
        return self.limited.solve(
            self._scaled.T * self._root_weight,
            rhs,
            self._wrench,
            softness[6:],
            self._motion[POSTURE] / self._root_weight,
            torque_map / limit[:, None],
            bias / limit,
            low,
            high,
        )


def _copy(given: tuple[ArrayLike, ...], own: tuple[NDArray[Any], ...]) -> None:
    """Copy what comes from outside, of any type and layout, to where compiled functions read it.

    Raises:
        ValueError: a shape does not fit.
    """
    for array, one in zip(own, given, strict=True):
        array[...] = one


def _both(first: QPSolution, second: QPSolution) -> QPSolution:
    """Summed cost of two solves of one tick; the second's solution."""
    return QPSolution(
        second.x,
        second.status,
        max(first.residual, second.residual),
        first.iterations + second.iterations,
        first.seconds + second.seconds,
    )
