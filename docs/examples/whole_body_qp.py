"""A whole-body QP: accelerations and contact forces that follow the plan, with OSQP.

ampm validate normal --controller whole_body_qp:WholeBodyQP --set controller.options.posture=2e-3
"""

import numpy as np
import osqp
import pinocchio as pin
from scipy.linalg import block_diag
from scipy.sparse import csc_matrix

from ampm.walk import SOLVED, UNSOLVED, ControlOutput

POSTURE = {"root_linear": 1e-3, "root_angular": 1.0, "trunk": 1.0, "arms": 0.3, "legs": 1e-3}


class WholeBodyQP:
    """Unknowns are the accelerations over g and the forces on the sole points over the weight."""

    def __init__(self, robot, run, posture: float = 1e-3, roll: float = 1e-2, share: float = 1e-3):
        self.robot, self.gain, self.data = robot, run.controller, robot.model.createData()
        self.posture, self.roll, self.share = posture * robot.by_group(POSTURE), roll, share
        self.acceleration, self.stands, self.solver = np.zeros(robot.nv), None, osqp.OSQP()
        points, mu = len(robot.point_frames), run.controller.friction / np.sqrt(2)
        pyramid = np.array([[1, 0, -mu], [-1, 0, -mu], [0, 1, -mu], [0, -1, -mu], [0, 0, 1]])
        self.faces = np.hstack([np.zeros((5 * points, robot.nv)), np.kron(np.eye(points), pyramid)])
        A = np.ones((6 + 5 * points, robot.nv + 3 * points))  # patterns; every tick gives the values
        P, c, free = np.triu(np.ones((A.shape[1],) * 2)), np.zeros(A.shape[1]), np.full(len(A), np.inf)
        settings = {"eps_abs": 1e-5, "eps_rel": 1e-5, "verbose": False}
        self.solver.setup(csc_matrix(P), c, csc_matrix(A), -free, free, **settings)

    def update(self, state, touch, plan):
        """One tick."""
        robot, gain, model, data = self.robot, self.gain, self.robot.model, self.data
        q, v = state.q, state.v + state.velocity_lag * self.acceleration
        nv, g, weight = robot.nv, robot.gravity, robot.mass * robot.gravity
        inertia, bias = pin.crba(model, data, q), pin.nonLinearEffects(model, data, q, v)
        pin.computeJointJacobians(model, data, q)
        pin.forwardKinematics(model, data, q, v, np.zeros(nv))
        pin.updateFramePlacements(model, data)
        points = [(model, data, frame, pin.LOCAL_WORLD_ALIGNED) for frame in robot.point_frames]
        jacobian = np.vstack([pin.getFrameJacobian(*point)[:3] for point in points])
        swerve = np.concatenate([pin.getFrameClassicalAcceleration(*point).linear for point in points])
        terms, drift = robot.jacobian(q), robot.drift(q, v)
        rates = terms.jacobian @ v  # of COM, angular momentum over the mass, soles
        # A point stands from its touch to its planned lift-off, before which its force fades out.
        touching = np.zeros((2, 3), bool)  # foot; heel, ball, tip
        np.logical_or.at(touching, group := (robot.point_foot, robot.point_group), touch.contact)
        before = plan.planned if self.stands is None else self.stands
        self.stands = plan.due & (touching | before)
        limit = (self.stands * np.minimum(plan.until_lift / gain.contact_ramp, 1))[group]
        # Tasks of the accelerations: soles (less of those that stand), points that stand, posture.
        turn = [pin.log3(a @ b.T) for a, b in zip(plan.foot_rotation, terms.sole_turn, strict=True)]
        off = np.hstack([plan.foot_position - terms.sole, turn]).ravel()
        rate = np.hstack([plan.foot_velocity, plan.foot_angular_velocity]).ravel() - rates[6:18]
        feet = np.hstack([plan.foot_acceleration, plan.foot_angular_acceleration]).ravel() - drift[6:18]
        feet = feet + gain.swing_stiffness * off + gain.swing_damping * rate
        posture = gain.posture_stiffness * pin.difference(model, q, plan.q)
        posture = posture + gain.posture_damping * (plan.v - v) + plan.acceleration
        P_a, c_a = squares(
            (np.where(self.stands.any(axis=1), self.roll, 1).repeat(6), terms.jacobian[6:18], feet / g),
            (self.stands[group].repeat(3), jacobian, (-gain.stance_damping * jacobian @ v - swerve) / g),
            (self.posture, np.eye(nv), posture / g),
        )
        # Tasks of the forces: the plan's wrench with feedback of COM, momentum and trunk; the points' shares.
        tilt = pin.log3(plan.trunk @ data.oMf[robot.trunk_frame].rotation.T)
        momentum = plan.angular_momentum + gain.trunk_gain * tilt * [1, 1, 0] - robot.mass * rates[3:6]
        force = plan.com_acceleration + gain.com_damping * (plan.com_velocity - rates[:3]) + [0, 0, g]
        force = robot.mass * (force + gain.com_stiffness * (plan.com - terms.com))
        wrench = np.append(force, plan.moment + gain.momentum_gain * momentum) / weight
        arms = [data.oMf[frame].translation - terms.com for frame in robot.point_frames]
        effect = np.hstack([np.vstack([np.eye(3), pin.skew(arm)]) for arm in arms])
        load = np.kron(limit * abs(1 - plan.right_load - robot.point_foot), [0, 0, 1])
        P_f, c_f = squares(
            (np.array([1, 1, 1, 9, 9, 9]), effect, wrench),
            (np.full(len(load), self.share), np.eye(len(load)), load / load.sum()),
        )
        # Constraints: Newton and Euler at the root, friction pyramids, limits of the points.
        A = np.vstack([np.hstack([inertia[:6] / robot.mass, -jacobian[:, :6].T]), self.faces])
        low = np.append(-bias[:6] / weight, np.tile([-np.inf] * 4 + [0], len(arms)))
        high = np.append(-bias[:6] / weight, np.kron(limit, [0, 0, 0, 0, 1]))
        P, c = block_diag(P_a, P_f), np.append(c_a, c_f)
        self.solver.update(q=c, l=low, u=high, Px=P[np.tril_indices(len(c))], Ax=A.T.ravel())
        answer = self.solver.solve(raise_error=False)
        self.acceleration, forces = g * answer.x[:nv], weight * answer.x[nv:]
        torque = (inertia @ self.acceleration + bias - jacobian.T @ forces)[6:]
        torque = np.clip(torque, -robot.torque_limit, robot.torque_limit)
        status = SOLVED if answer.info.status_val == 1 else UNSOLVED
        return ControlOutput(torque, status=status, seconds=answer.info.run_time)


def squares(*tasks):
    """Matrix and vector of the sum of weights (A x - wanted)^2 / 2."""
    matrix = sum((A.T * weights) @ A for weights, A, _ in tasks)
    return matrix, -sum(A.T @ (weights * wanted) for weights, A, wanted in tasks)
