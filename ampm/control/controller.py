"""Torque-level tracking of a planned walk: state, sensed contact and reference in, joint torques out.

Every tick the stabiliser commands a momentum rate (the plan's, plus COM and angular momentum feedback). The
tracker adds accelerations of feet and posture, finds contact forces and accelerations by the QP of
:mod:`ampm.control.wrench_qp`, and turns them into torques by inverse dynamics. It is independent of the
simulator.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ampm.body.inverse_kinematics import POSTURE_WEIGHTS
from ampm.body.robot import LEFT, RIGHT, TASK_ROWS
from ampm.control.contact_gate import TIP, Contact, ContactGate
from ampm.control.forces import ANGULAR, FORCES, NORMALS, ForceMap, without_closed
from ampm.control.hold import FirstOrderHold
from ampm.control.limited_qp import JointLimits, LimitedForm
from ampm.control.stabilizer import Stabilizer, WrenchCommand
from ampm.control.tasks import FootTask, FreeFall, PostureTask, Task, ToeTask
from ampm.control.wrench_qp import L_Z, CondensedForm, Rows
from ampm.qp import QPSettings, QPSolution, QPStatus
from ampm.walk import LIMITED, SOLVED, UNSOLVED, ControlOutput

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.body.robot import Kinematics, Robot
    from ampm.parameters import RunParameters
    from ampm.walk import Reference, State, Touch

    Array = NDArray[np.float64]

_ROW_SCALE = np.concatenate([np.ones(3), np.full(3, ANGULAR), np.ones(TASK_ROWS - 6)])
_END_SOFTNESS = 1e-2  # of the task of a toe that is at the end of its range
_NO_ANSWER = QPSolution(np.full(FORCES, np.nan), QPStatus.UNSOLVED, math.inf, 0, 0.0)


class TrackingController:
    """Whole-body inverse dynamics along the :class:`~ampm.walk.Reference` of each tick.

    Args:
        robot: the body, as the controller knows it.
        run: gains, friction, solver.
    """

    def __init__(self, robot: Robot, run: RunParameters) -> None:
        self.robot = robot
        self.stabilizer = Stabilizer(robot, run.controller)
        self.tracker = Tracker(robot, run)

    def update(self, state: State, touch: Touch, reference: Reference) -> ControlOutput:
        """One control tick.

        Args:
            state: the measured state.
            touch: readings of the soles.
            reference: what is planned at this instant.
        """
        last = self.tracker.acceleration
        last = reference.posture.acceleration if last is None else last
        body = self.robot.kinematics(state.q, state.v, state.v + state.velocity_lag * last)
        command = self.stabilizer.command(body, reference)
        return self.tracker.track(body, command, touch, reference)


class Tracker:
    """Joint torques that give a wrench and follow feet and posture.

    Args:
        robot: the body, as the controller knows it.
        run: gains, friction, solver.

    Attributes:
        acceleration: commanded by the last tick, shape (nv,) [m/s^2, rad/s^2]; None before the first.
        phi: its contact forces, in the unknowns of :mod:`ampm.control.forces`, shape (18,) [m g].
        phi_change: their difference from the tick before, shape (18,) [m g].
    """

    def __init__(self, robot: Robot, run: RunParameters) -> None:
        self.robot, gains, solver = robot, run.controller, run.solver
        self._g, self._weight = robot.gravity, robot.mass * robot.gravity
        weights = robot.by_group(POSTURE_WEIGHTS)
        self._root_weight = np.sqrt(weights)
        self._row_scale = _ROW_SCALE[:, None] / self._root_weight
        self._to_rows = _ROW_SCALE / self._g
        self._to_wrench = [1.0 / self._weight] * 3 + [ANGULAR / self._weight] * 3
        self._torque_limit = robot.torque_limit
        self._period, self._gains = 1.0 / gains.frequency, gains
        first_order = gains.hold == "first-order"
        self.hold = FirstOrderHold(robot.torque_limit, self._period) if first_order else None

        self.gate = ContactGate(robot, self._period, gains.contact_ramp)
        self.forces = ForceMap()
        self.fall = FreeFall(robot)
        self.feet = [FootTask(foot, gains) for foot in (LEFT, RIGHT)]
        self.toes = ToeTask(robot, gains)
        self.posture = PostureTask(gains, self._root_weight / self._g)
        self.limits = JointLimits(robot)
        settings = QPSettings(tolerance=solver.tolerance, max_iterations=solver.max_iterations)
        self.condensed = CondensedForm(solver.qp, settings, gains.friction)
        limit_settings = QPSettings(  # a problem of mixed scales, solved in few ticks: it is equilibrated
            tolerance=2.0 * solver.tolerance,
            max_iterations=4 * solver.max_iterations,
            rho=0.1,
            alpha=1.6,
            scaling=10,
        )
        self.limited = LimitedForm(solver.qp, limit_settings, weights, TASK_ROWS, self.condensed)

        self._softness: dict[tuple[float, ...], Array] = {}
        self.acceleration: Array | None = None
        self.phi, self.phi_change = np.zeros(FORCES), np.zeros(FORCES)
        self._load = np.ones(7)  # net wrench, and one for the rows themselves

    def track(
        self, body: Kinematics, command: WrenchCommand, touch: Touch, reference: Reference
    ) -> ControlOutput:
        """One tick: contact, tasks, forces, accelerations, torques."""
        contact = self.gate.update(reference.contacts, touch.contact)
        forces = self.forces
        forces.update(body, contact.openings)
        feet = reference.feet.values.tolist()
        left, right = self.feet
        tasks = [
            self.fall.task,
            left.at(body, feet[LEFT], contact),
            right.at(body, feet[RIGHT], contact),
            self.toes.at(body, feet),
        ]
        rows = self._stack(body, tasks, self.posture.at(body, reference.posture))
        columns = rows.eliminate()
        if columns is None:  # rows that are dependent or not finite
            alpha, phi, torque = self._hold_last_command(body, forces, contact, reference)
            solution, status = _NO_ANSWER, UNSOLVED
        else:
            wanted = np.multiply(self._to_wrench, command.wrench)
            least = None
            if contact.landing:
                opening = np.array(contact.opening)[self.robot.point_foot, self.robot.point_group]
                least = self._landing_force(opening, touch)
                wanted -= forces.wrench[:, NORMALS] @ self._missing(opening, touch)
            self.condensed.build(
                forces,
                wanted,
                contact.openings,
                least,
                float(reference.right_load),
                columns.item(L_Z, L_Z),
                columns.item(L_Z, 6),
            )
            solution = self.condensed.solve()
            solved, phi = solution.solved, solution.x[:FORCES]
            status = SOLVED if solved else UNSOLVED
            if not (solved or _usable(solution)):  # the accelerations still follow the dynamics
                phi = without_closed(self.phi, contact.openings.limit)
            self._load[:6] = forces.wrench @ phi
            alpha = (rows.posture + (columns @ self._load) @ rows.scaled) / self._root_weight
            torque = self._torque(body, forces, alpha, phi)
            if self.limits.broken(body.q, body.v, alpha, torque):
                limited = self._solve_limited(body, forces, rows)
                if limited.solved:
                    alpha, phi = np.split(limited.x, [self.robot.nv, self.robot.nv + FORCES])[:2]
                    torque = self._torque(body, forces, alpha, phi)
                status = max(status, LIMITED if limited.solved else UNSOLVED)
                solution = _both(solution, limited)
        if self.acceleration is not None:
            self.phi_change = phi - self.phi
        self.phi, self.acceleration = phi, self._g * alpha
        torque = np.minimum(np.maximum(torque, -self._torque_limit), self._torque_limit)
        return ControlOutput(
            torque=torque,
            rate=None if self.hold is None else self.hold.rate(torque, contact, bool(reference.jumps)),
            force=np.array(command.wrench[:3]),
            zmp=command.zmp,
            angular_momentum=np.array(command.angular_momentum),
            point_force=self._weight * forces.point_forces(phi).reshape(-1, 3),
            status=status,
            residual=solution.residual,
            iterations=solution.iterations,
            seconds=solution.seconds,
        )

    # ------------------------------------------------------------------ parts

    def _stack(self, body: Kinematics, tasks: list[Task], posture: Array) -> Rows:
        """Tasks in the order of the Jacobian's rows, in units of the QP."""
        wanted: list[float] = []
        kinds: tuple[float, ...] = ()
        for part, kind in tasks:
            wanted += part
            kinds += (kind,)
        softness = self._softness.get(kinds)
        if softness is None:
            softness = np.concatenate([np.full(len(part), kind) for part, kind in tasks])
            self._softness[kinds] = softness
        return Rows(
            body.jacobian * self._row_scale,
            self._to_rows * (np.array(wanted) - body.drift),
            softness,
            posture,
        )

    def _hold_last_command(
        self, body: Kinematics, forces: ForceMap, contact: Contact, reference: Reference
    ) -> tuple[Array, Array, Array]:
        """Accelerations [g] and forces [m g] of the last tick, and their torques [N m]."""
        last = reference.posture.acceleration if self.acceleration is None else self.acceleration
        alpha, phi = last / self._g, without_closed(self.phi, contact.openings.limit)
        torque = self._torque(body, forces, alpha, phi)
        return alpha, phi, torque if np.isfinite(torque).all() else np.zeros(self.robot.nu)

    def _landing_force(self, opening: Array, touch: Touch) -> Array:
        """Least force of the points of a landing line, shape (P,) [m g].

        The floor pushes as the foot arrives. The QP takes a share of this force as given and shifts the other
        foot's load instead of letting the ZMP jump. A line that has touched has a least force at once, or it
        would bounce.
        """
        gains, below = self._gains, opening < 1.0
        given = gains.landing_share / self._weight * touch.normal_force * (touch.contact & below)
        lands = below & (opening > 0.0) & (self.robot.point_group != TIP)
        return np.maximum(given, gains.landing_force * lands)

    def _missing(self, opening: Array, touch: Touch) -> Array:
        """Expected force of the points of landing lines beyond the QP's forces, (P,) [m g].

        With ``f`` the commanded force of a point when ``s`` was sensed there, it is ``k (s - f)``, with k the
        gain ``landing_compensation``. The net wrench of the QP's forces and of these is the commanded one.
        """
        since = 1.0 - touch.age / self._period if self.hold is not None else 0.0
        asked = self.phi[NORMALS] + since * self.phi_change[NORMALS]
        lands = (opening > 0.0) & (opening < 1.0)
        return self._gains.landing_compensation * lands * (touch.normal_force / self._weight - asked)

    def _torque(self, body: Kinematics, forces: ForceMap, alpha: Array, phi: Array) -> Array:
        """Joint torques ``M qdd + h - J' f`` of accelerations [g] and force unknowns [m g], (nu,) [N m]."""
        robot = self.robot
        total = pin.rnea(robot.model, robot.data, body.q, body.v, self._g * alpha)
        total -= (self._weight * _loads(body, forces, phi)) @ body.jacobian[6:]
        return total[6:]

    def _torque_map(self, body: Kinematics, forces: ForceMap) -> tuple[Array, Array]:
        """Torques as ``map @ (alpha, phi) + bias``, shapes (nu, nv + 18) and (nu,) [N m]."""
        robot = self.robot
        mass = pin.crba(robot.model, robot.data, body.q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        bias = pin.nle(robot.model, robot.data, body.q, body.v)
        loads = np.array([_loads(body, forces, unit) for unit in np.eye(FORCES)])
        by_force = -self._weight * (loads @ body.jacobian[6:]).T
        return np.hstack([self._g * mass[6:], by_force[6:]]), bias[6:]

    def _solve_limited(self, body: Kinematics, forces: ForceMap, rows: Rows) -> QPSolution:
        """The whole problem again, with the limits of torque and joint range as constraints."""
        torque_map, bias = self._torque_map(body, forces)
        low, high = self.limits.acceleration_bounds(body.q, body.v)
        limit, softness, toes = self._torque_limit, rows.softness[6:].copy(), self.robot.toe_joints - 6
        ends = (rows.rhs[-len(toes) :] < low[toes]) | (rows.rhs[-len(toes) :] > high[toes])
        softness[-len(toes) :][ends] = _END_SOFTNESS  # exact rows would contradict the limit
        return self.limited.solve(
            rows.scaled * self._root_weight,
            rows.rhs,
            forces.wrench,
            softness,
            rows.posture / self._root_weight,
            torque_map / limit[:, None],
            bias / limit,
            low,
            high,
        )


def _loads(body: Kinematics, forces: ForceMap, phi: Array) -> Array:
    """Force and moment about the sole of each foot, and the toe moments, shape (14,) [m g, m g m]."""
    left, right = forces.foot_wrenches(phi).tolist()
    (lx, ly, lz), (rx, ry, rz) = body.sole_arm  # moments: from about the COM to about the soles
    fx, fy, fz, mx, my, mz, left_toe = left
    gx, gy, gz, nx, ny, nz, right_toe = right
    return np.array(
        [
            fx,
            fy,
            fz,
            mx / ANGULAR - ly * fz + lz * fy,
            my / ANGULAR - lz * fx + lx * fz,
            mz / ANGULAR - lx * fy + ly * fx,
            gx,
            gy,
            gz,
            nx / ANGULAR - ry * gz + rz * gy,
            ny / ANGULAR - rz * gx + rx * gz,
            nz / ANGULAR - rx * gy + ry * gx,
            left_toe,
            right_toe,
        ]
    )


def _usable(solution: QPSolution) -> bool:
    """Whether an unsolved QP's last iterate is better than the previous solution."""
    return solution.status != QPStatus.INFEASIBLE and bool(np.isfinite(solution.x).all())


def _both(first: QPSolution, second: QPSolution) -> QPSolution:
    """Summed cost of two solves of one tick; the second's solution."""
    return QPSolution(
        second.x,
        second.status,
        max(first.residual, second.residual),
        first.iterations + second.iterations,
        first.seconds + second.seconds,
    )
