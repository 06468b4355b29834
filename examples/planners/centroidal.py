"""Model predictive control of the centroidal motion: ZMP, angular momentum and footsteps together, by OSQP.

The COM stays at the height H. With m the mass, L the angular momentum about the COM and q the arm by which
the force line misses it, deviations from the plan without disturbances obey, for the COM's c, the ZMP's p and
w = sqrt(g / H)::

    c'' = w^2 (c - p + q),   J' = q,   J_x = -L_y / (m g),   J_y = L_x / (m g)

The divergent component c + c'/w stays bounded if it is what p - q asks for now, a linear condition on p and q
ahead. Every 50 ms a QP for each axis finds p and q, linear between knots every 50 ms for 1.6 s, and the
footsteps that land in this time. It minimises p^2, J^2, q^2 and the changes of footsteps. p stays in the
sole, |L| below a limit, and L ends as planned. So the trunk gives way where that costs less than a step.

The model is that of Wieber (Humanoids 2006), with footsteps (Herdt et al., Advanced Robotics 24, 2010), the
boundedness as in Scianca et al. (IEEE T-RO 36(4), 2020), and L as a variable (centroidal dynamics: Orin,
Goswami & Lee, Autonomous Robots 35, 2013). Costs and limits were chosen with the pushes of `normal` in view.
"""

import numpy as np
import osqp
from scipy import sparse

import ampm
from examples.planners.pendulum import FREEZE, REACH, Pendulum

KNOTS, STRIDE, MARGIN = 33, 0.05, 0.005  # of the QP; from one to the next [s]; of the ZMP in the sole [m]
MOST_L, MOST_MOMENT = 3.0, 100.0  # surplus of angular momentum [N m s], and moment [N m] of the human
STEP_COST, MOMENTUM_COST, MOMENT_COST, BOUND_COST = 0.6, 400.0, 0.05, 2e4  # over that of the ZMP in the sole
SETTINGS = {"verbose": False, "eps_abs": 1e-6, "eps_rel": 1e-6, "max_iter": 4000}


class Centroidal(Pendulum):
    """Moves ZMP, trunk and footsteps."""

    def plan(self, run, robot):
        """The walk without disturbances."""
        if any(step.heading for step in run.footsteps):
            raise ampm.InputError("footsteps.heading: the soles of this planner point along x; leave it out.")
        return super().plan(run, robot)

    def basis(self, time):
        """Instants of what is found, its values between them by those there, and integrals up to there."""
        ahead = time + STRIDE * np.arange(KNOTS)
        integral = STRIDE * (np.tri(KNOTS) - 0.5 * np.eye(KNOTS))
        integral[:, 0] -= 0.5 * STRIDE
        integral[0] = 0.0
        return ahead, lambda times: np.maximum(1.0 - np.abs(times[:, None] - ahead) / STRIDE, 0.0), integral

    def deviate(self, time, off, surplus):
        """What the QPs find, see :meth:`Pendulum.deviate`."""
        weight = self.first.weight
        ahead, between, integral = self.basis(time)
        times = self.samples(time, self.times[-1], np.append(self.times, ahead))
        shares = np.column_stack([np.interp(times, self.times, column) for column in self.weights.T])
        hats = between(times)
        needed = self.bounded(times, np.hstack([hats, shares]))[0]  # DCM now, by knot and by footstep
        found = [
            self.solve(k, time, off[0, k] + off[1, k] / self.w, surplus, needed, ahead, integral)
            for k in (0, 1)
        ]
        p, q, self.moved = (np.column_stack(columns) for columns in zip(*found, strict=True))
        zmp, arm = hats @ p + shares @ self.moved, hats @ q
        walked, moves = times <= self.switches[-1], self.motion(times, zmp - arm, off)
        return times[walked], moves[:, walked], zmp[walked], weight * (arm[:, ::-1] * [1.0, -1.0])[walked]

    def solve(self, axis, time, dcm, surplus, needed, ahead, integral):
        """ZMP and arm at the n instants (n,), and displacements of all footsteps (F,), along an axis [m]."""
        moved, weight, n = self.moved[:, axis], self.first.weight, len(ahead)
        lands = np.append([-1.0, -1.0], self.alone[1:-1, 1])  # when each footstep is landed on
        free = np.flatnonzero((lands > time + FREEZE) & (lands < ahead[-1]))
        by = np.zeros((len(moved), len(free)))
        by[free, np.arange(len(free))] = 1.0
        by[free[-1] if len(free) else len(moved) :, -1:] = 1.0  # the last one displaces all after it
        fixed = np.where(by.any(axis=1), 0.0, moved) if len(free) else moved
        begun = (surplus[::-1] * [-1.0, 1.0] / weight)[axis]
        sole, off_place = self.first.feet.sole, np.interp(ahead, self.times, self.rolls[:, axis])
        half = min(sole.heel_half_width, sole.ball_half_width) - MARGIN
        back, front = ((sole.heel_x + MARGIN, sole.ball_x - MARGIN), (-half, half))[axis]
        low, high = np.minimum(back - off_place, 0.0), np.maximum(front - off_place, 0.0)
        low[-1] = high[-1] = 0.0
        most_q = np.append(np.full(n - 1, MOST_MOMENT / weight), 0.0)
        most_j = np.append(np.full(n - 1, max(MOST_L / weight, abs(begun))), 0.0)
        change, reach = by[free] - by[free - 1], REACH[self.sides[free], :, axis]
        before = fixed[free] - fixed[free - 1]
        rows = sparse.bmat(
            [
                [needed[None, :n], -needed[None, :n], (needed[n:] @ by)[None], np.ones((1, 1))],
                [np.eye(n), None, None, None],
                [None, np.eye(n), None, None],
                [None, integral, None, None],
                [None, None, change, None],
            ]
        )
        bound = dcm - needed[n:] @ fixed
        lower = np.concatenate([[bound], low, -most_q, -most_j - begun, reach[:, 0] - before])
        upper = np.concatenate([[bound], high, most_q, most_j - begun, reach[:, 1] - before])
        squares = MOMENT_COST * np.eye(n) + MOMENTUM_COST * integral.T @ integral
        steps = STEP_COST * np.eye(len(free))
        costs = sparse.block_diag([np.eye(n), squares, steps, [[BOUND_COST]]])
        linear = np.zeros(costs.shape[0])
        linear[n : 2 * n] = MOMENTUM_COST * begun * integral.sum(axis=0)
        solver = osqp.OSQP()
        upper_half = sparse.csc_matrix(sparse.triu(costs))
        solver.setup(upper_half, linear, sparse.csc_matrix(rows), lower, upper, **SETTINGS)
        x = solver.solve().x
        return x[:n], x[n : 2 * n], fixed + by @ x[2 * n : -1]
