"""Whole-body motion from a plan: accelerations that meet the plan's constraints and keep the body upright.

At every instant (paper, section 2.3, Eqs. 8-12)

    minimise    1/2 || qdd + k (q - q0) + d qd ||^2_W
    subject to  J qdd + dJ/dt qd = lambda,

where the rows of J are the COM (3), the angular momentum about it (2, or 3 with L_z held at zero), both feet
(6 each) and both toes (2, if there are any). The sign of k is corrected: with the printed sign the posture is
unstable. The printed cost weighs loins and chest only, which leaves 40 - 20 directions with several
minimisers; here every coordinate has a weight (:data:`POSTURE_WEIGHTS`), so the minimiser is unique. Limits
of the joints are no constraints, so it has a closed form; the solved motion is checked for them instead.

The grid divides both phases exactly. After every step of the grid the state is projected back on the
constraints (position and velocity), in the metric of the same weights, which prevents drift.
"""

import numpy as np

from ampm.body.robot import L_Z, Robot
from ampm.body.step_kinematics import (
    EXACT,
    Kinematics,
    StepTrajectory,
    correct,
    follow,
    nearest,
    tasks_of,
    upright,
)
from ampm.body.step_reference import StepReference
from ampm.geometry import Array
from ampm.parameters import RunParameters

POSTURE_WEIGHTS = {"root_linear": 1e-3, "root_angular": 1.0, "trunk": 1.0, "arms": 0.3, "legs": 1e-3}
"""Weights W of the posture form by group of coordinates [1]; the legs and the root's position follow from
feet and COM; their small weights only make the minimiser unique."""

ARM_BEND = 0.3
"""How far the arms' rest posture stays inside the joint limits [rad]: hanging, with slightly bent elbows."""
WIDEST = 1.2
"""Largest abduction of the arms' rest posture [rad]."""


class Unreachable(Exception):
    """The body cannot follow at one instant; a search may try elsewhere.

    Attributes:
        time: of the step [s].
        what: clause on what cannot be done at that time.
        drop: by how much lower the COM is with which the step has a periodic motion, if one was found [m].
    """

    drop = 0.0

    def __init__(self, time: float, what: str) -> None:
        super().__init__(f"at {time:.3f} s of the step {what}")
        self.time, self.what = time, what


class InverseKinematics:
    """Integrates one step of a plan for one body.

    Args:
        robot: the body.
        run: supplies posture gains, rest of pelvis and arms, and the choice for L_z.

    Attributes:
        rest: angles of the hinges at rest, shape (nu,) [rad].
    """

    def __init__(self, robot: Robot, run: RunParameters) -> None:
        self.robot = robot
        arms = robot.arm_joints - 6
        inside = np.minimum(ARM_BEND, 0.5 * (robot.upper - robot.lower))
        self.rest = np.zeros(robot.nu)
        self.rest[arms] = np.clip(0.0, (robot.lower + inside)[arms], (robot.upper - inside)[arms])
        spread = run.body.arm_abduction + run.body.arm_abduction_roll * (1.0 - run.gait.c_y) ** 2
        angles = {joint: sign * min(spread, WIDEST) for joint, sign in robot.description.spread}
        for joint, angle in (angles | dict(robot.description.rest)).items():
            self.rest[robot.velocity_indices((joint,)) - 6] = angle
        free = np.ones(robot.nu, dtype=bool)
        free[np.concatenate(robot.leg_joints) - 6] = False
        rows = np.delete(np.arange(robot.task_rows), robot.roll_rows)
        self.body = Kinematics(
            rigid=robot.rigid_body,
            rows=rows if run.body.angular_momentum_z == "zero" else np.delete(rows, L_Z),
            position_rows=np.delete(rows, [3, 4, 5]),  # a configuration has no angular momentum
            roll_rows=robot.roll_rows,
            toes=robot.toe_joints + 1,
            miss=np.zeros(robot.task_rows),
            weight=robot.by_group(POSTURE_WEIGHTS),
            rest=self.rest,
            free=free,
            pelvis=np.array([run.body.pelvis_list, run.body.pelvis_rotation]),
            stiffness=run.body.posture_stiffness,
            damping=run.body.posture_damping,
        )

    def project(self, reference: StepReference, k: int, q: Array, v: Array) -> tuple[Array, Array]:
        """Nearest state on the constraints at grid node k, by Newton in the metric of the posture weights.

        Raises Unreachable if Newton does not converge, as with legs that are too short for this instant.
        """
        q = q.copy()
        try:
            if not correct(self.body, reference, k, q, EXACT, np.inf):
                raise self._miss(float(reference.time[k]))
            v = nearest(tasks_of(self.body, self.body.rows), v, reference.velocity[k][self.body.rows])
        except np.linalg.LinAlgError as error:
            raise _dependent(float(reference.time[k])) from error
        self._check_knees(reference.time[k : k + 1], q[None])
        return q, v

    def upright(self, reference: StepReference, k: int, q: Array) -> tuple[Array, Array]:
        """State on the constraints at grid node k that is nearest to standing upright, from a first guess q.

        Raises Unreachable if none was found.
        """
        return self.project(reference, k, upright(self.body, reference, k, q), np.zeros(self.robot.nv))

    def integrate(self, reference: StepReference, q: Array, v: Array) -> StepTrajectory:
        """Integrate a step from a state that is projected on the constraints first.

        The reference has the step's tasks on its grid; the state is q, shape (nq,), and v, shape (nv,).
        Raises Unreachable if the legs cannot follow.
        """
        n, nv = len(reference.time), self.robot.nv
        step = StepTrajectory(
            q=np.empty((n, nv + 1)),
            v=np.empty((n, nv)),
            acceleration=np.empty((n, nv)),
            trunk_pitch=np.full(n, np.nan),
            angular_momentum_z=np.empty(n),
        )
        step.q[0], step.v[0] = q, v
        try:
            reached = follow(self.body, reference, step)
        except np.linalg.LinAlgError as error:
            raise _dependent(float(reference.time[np.isnan(step.trunk_pitch)][0])) from error
        self._check_knees(reference.time, step.q[:reached])
        if reached < n:
            raise self._miss(float(reference.time[reached]))
        return step

    def _miss(self, time: float) -> Unreachable:
        """Message for the errors of the state that was placed last."""
        of_legs = np.delete(self.body.miss[:18], self.body.roll_rows)[6:]
        left, right = np.abs(of_legs).reshape(2, -1).max(axis=1)
        side = "left" if left >= right else "right"
        return Unreachable(time, f"no angles were found that put the {side} foot where it is planned")

    def _check_knees(self, time: Array, q: Array) -> None:
        """Refuse the first of some configurations, shape (n, nq), with a knee that is bent backwards."""
        flexion = self.robot.knee_flexion(q)
        for k, foot in np.argwhere(flexion < 0.0):
            back = f"bend backwards by {-flexion[k, foot]:.2g} rad"
            what = f"the {('left', 'right')[foot]} knee would {back}: the leg is too short"
            raise Unreachable(float(time[k]), what)


def _dependent(time: float) -> Unreachable:
    return Unreachable(time, "a leg is straight: feet, COM and angular momentum depend on each other")
