"""Torque-level tracking of a planned walk: state, sensed contact and reference in, joint torques out.

Every tick commands a momentum rate (the plan's, plus feedback of COM and angular momentum) and accelerations
of feet and posture. The QP of :mod:`ampm.control.contact_qp` finds contact forces, which give the
accelerations, and inverse dynamics the torques; :mod:`ampm.control.tick` is the tick in compiled functions.
The controller is independent of the simulator.
"""

import math
from typing import Any

import numpy as np

from ampm.body.robot import Robot
from ampm.compiled import bound, refer
from ampm.control.contact_qp import ContactQP
from ampm.control.forces import share_forces, without_closed
from ampm.control.limited_qp import LimitedQP
from ampm.control.qp import QPSettings, QPSolution
from ampm.control.tick import keep_tick, prepare_qp, take_forces, update_torques
from ampm.control.workspace import SteppingState, make_workspace
from ampm.geometry import Array
from ampm.parameters import RunParameters
from ampm.reference import reference_type
from ampm.stepping.tracker import StepTracker
from ampm.walk import LIMITED, SOLVED, UNSOLVED, ControlOutput, Reference, State, Timing, Touch, WalkPlan


class TrackingController:
    """Whole-body inverse dynamics along the :class:`~ampm.walk.Reference` of each tick.

    Args:
        robot: the body, as the controller knows it.
        run: gains, friction, solver.

    Attributes:
        workspace: all arrays of a tick, by their names; a tick overwrites those of the last one.
        contact_qp: the QP of every tick.
        limited: the QP of a tick that would break a limit.
    """

    def __init__(self, robot: Robot, run: RunParameters) -> None:
        self.robot, gains, solver = robot, run.controller, run.solver
        settings = QPSettings(tolerance=solver.tolerance, max_iterations=solver.max_iterations)
        self.contact_qp = ContactQP(settings, gains, robot.point_group.reshape(len(robot.sole_frames), -1))
        self._row = np.zeros(1, reference_type(robot.nq, robot.nv))
        self.workspace = work = make_workspace(robot, gains, self._row, self.contact_qp.problem)
        limit_settings = QPSettings(  # a problem of mixed scales, solved in few ticks: it is equilibrated
            tolerance=2.0 * solver.tolerance,
            max_iterations=4 * solver.max_iterations,
            rho=0.1,
            alpha=1.6,
            rho_interval=1000,  # with 50, hard problems took 25,000 to 75,000 iterations instead of 8,000
            scaling=10,
        )
        self.limited = LimitedQP(limit_settings, robot, self.contact_qp)
        self._first, self._steps = True, gains.stabilizer == "stepping"
        self._tracker: StepTracker | None = None
        self._handle = refer(work)
        self._prepare: Any = None
        self._take_forces = bound(take_forces, (self._handle,))
        self._torques = bound(update_torques, (self._handle,))
        self._keep = bound(keep_tick, (self._handle,), True)

    @property
    def acceleration(self) -> Array | None:
        """Accelerations commanded by the last tick, shape (nv,) [m/s^2, rad/s^2]; None before the first."""
        return None if self._first else self.workspace.motion.last_acceleration

    @property
    def stepped(self) -> SteppingState | None:
        """State of the stepping stabiliser before the last tick; None on the plan, and without it."""
        return None if self._tracker is None else self._tracker.stepped

    def follow(self, plan: WalkPlan, timing: Timing) -> None:
        """Take a plan that holds from the next tick on; only the stepping stabiliser needs it, and its steps.

        Args:
            plan: the first one of the walk, or a new one.
            timing: look-ahead of its references.
        """
        if self._steps and plan.contacts.steps:
            self._tracker = StepTracker(plan, timing, self.robot, self.workspace)
            self._prepare = None  # bound anew at the next tick, to a stepper

    def update(self, state: State, touch: Touch, reference: Reference) -> ControlOutput:
        """One control tick.

        Args:
            state: the measured state.
            touch: readings of the soles.
            reference: what is planned at this instant.

        Returns:
            Torque and command, in arrays of the caller's own, to keep or change.

        Raises:
            ValueError: an array has another shape.
        """
        work, first = self.workspace, self._first
        stepper = None if self._tracker is None else self._tracker.begin(state.time)
        self._row[0] = reference.row
        sensed = work.sensed
        sensed.q[:], sensed.v[:], sensed.velocity_lag[0] = state.q, state.v, state.velocity_lag
        sensed.normal_force[:], sensed.force_age[0] = touch.normal_force, touch.age
        sensed.contact[:], sensed.threshold[0] = touch.contact, touch.threshold
        if first:
            work.motion.last_acceleration[:] = work.wanted.acceleration
        if self._prepare is None:
            self._prepare = bound(prepare_qp, (self._handle,), stepper, True)
        if self._prepare(stepper, first):
            solution = self.contact_qp.solver.solve()
            status = SOLVED if solution.solved else UNSOLVED
            if solution.solved or np.isfinite(solution.x).all():
                forces = solution.x[: self.contact_qp.forces]
            else:  # infeasible: those of the last tick
                forces = without_closed(work.body.points, work.contact.forces)
            work.contact.solution[:] = forces  # which the accelerations follow by the dynamics in any case
            if not self._take_forces():
                solution, status = self._solve_limited(solution, status)
        else:
            solution, status = self._repeat_command(), UNSOLVED
        self._keep(first)
        self._first = False
        return ControlOutput(
            work.joints.torque.copy(),
            work.command.force.copy(),
            work.command.zmp.copy(),
            work.command.angular_momentum.copy(),
            work.contact.point_force.copy(),
            status,
            solution.residual,
            solution.iterations,
            solution.seconds,
            work.joints.rate.copy() if work.extrapolates else None,
            Reference(self._row[0].copy()) if work.stepping["off_plan"][0] else None,
        )

    def _repeat_command(self) -> QPSolution:
        """Write the command of a tick without a QP, from accelerations and forces of the last tick."""
        work = self.workspace
        share_forces(work.body.points, work.contact.forces, False)
        work.motion.acceleration[:] = work.motion.last_acceleration
        work.contact.solution[:] = without_closed(work.body.points, work.contact.forces)
        self._torques()
        if not np.isfinite(work.joints.torque).all():
            work.joints.torque[:] = 0.0
        return QPSolution(work.contact.solution, False, math.inf, 0, 0.0)

    def _solve_limited(self, solution: QPSolution, status: int) -> tuple[QPSolution, int]:
        """Solve the whole problem again, with the limits of torque and joint range as constraints.

        Args:
            solution: of the QP without these limits; its torques stay if there is no other solution.
            status: status of the tick so far.

        Returns:
            Solution, with iterations and time of both solves added; status of the tick.
        """
        work, robot, forces = self.workspace, self.robot, self.contact_qp.forces
        limited = self.limited.solve(work, *self._torque_map())
        if limited.solved:
            work.motion.acceleration[:] = robot.gravity * limited.x[: robot.nv]
            work.contact.solution[:] = limited.x[robot.nv : robot.nv + forces]
            self._torques()
        both = limited._replace(
            residual=max(solution.residual, limited.residual),
            iterations=solution.iterations + limited.iterations,
            seconds=solution.seconds + limited.seconds,
        )
        return both, max(status, LIMITED if limited.solved else UNSOLVED)

    def _torque_map(self) -> tuple[Array, Array]:
        """Torques as ``map @ (acceleration / g, forces) + bias``, shapes (nu, nv + U) and (nu,) [N m]."""
        work, nv, gravity = self.workspace, self.robot.nv, self.robot.gravity
        motion, contact = work.motion, work.contact
        kept = motion.acceleration.copy(), contact.solution.copy()
        units = np.eye(nv + self.contact_qp.forces + 1)  # with the last one, all unknowns are zero
        columns = np.empty((len(units), self.robot.nu))
        for unit, column in zip(units, columns, strict=True):
            motion.acceleration[:], contact.solution[:] = gravity * unit[:nv], unit[nv:-1]
            self._torques()
            column[:] = work.joints.torque
        motion.acceleration[:], contact.solution[:] = kept
        self._torques()
        return (columns[:-1] - columns[-1]).T, columns[-1]
