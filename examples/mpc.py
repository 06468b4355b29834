"""Model predictive control over `normal`'s footsteps, pushed and not, beside the AMPM. Takes TODO s.

A linear inverted pendulum over the footsteps is planned once. Every 50 ms a QP finds how the ZMP and the next
footsteps must deviate from it, so that the measured error of the divergent component of motion (DCM) dies out::

    error = integral of omega exp(-omega t) d(t) over 0 ... T  +  exp(-omega T) (last displacement)

Here d is the deviation of the ZMP: that of the feet, and what is left within the sole. After the horizon T the
walk goes on as planned on the displaced feet (Scianca et al., "MPC for humanoid gait generation: stability and
feasibility", IEEE T-RO 36(4), 2020, with this tail).
"""

from dataclasses import replace

import numpy as np
import osqp
from scipy import sparse

import ampm
from ampm.planner.centroidal import CentroidalPhase
from ampm.planner.feet import FeetPlan
from ampm.planner.replan import joined
from ampm.planner.sampled import SampledLaw
from ampm.planner.stride import plan_feet

HORIZON, NODE, GRID = 1.6, 0.05, 0.005  # [s]: of the QP, between its ZMPs, between samples of a plan
MARGIN = 0.01  # of the ZMP from the edges of a sole [m]
FREEZE = 0.08  # a foot that lands sooner is not moved any more [s]
LONGER, SHORTER, WIDER, NARROWER = 0.28, 0.5, 0.25, 0.03  # limits of a step's change [m]
FOOT_COST, RATE_COST = 0.3, 0.01  # per squared ZMP deviation [1], [s^2]


class Mpc:
    """Plans once by the DCM planner, then again every 50 ms from the measured COM."""

    replan_period = 0.05  # [s]

    def plan(self, run, robot):
        """The walk without disturbances."""
        self.run, self.robot = run, robot
        base = ampm.PeriodicPlanner("dcm").plan(run, robot)
        self.base, self.omega = base, np.sqrt(base.gravity / base.com_height)
        grid = np.arange(0.0, base.duration, GRID)
        self.grid = np.unique(np.concatenate([grid, base.contacts.starts, [base.duration]]).round(9))
        self.sample = base.sample(np.minimum(self.grid, base.duration))
        self.places = np.array([step.position[:2] for step in base.contacts.footsteps])
        starts = np.append(base.contacts.starts, base.duration)
        # Number of the loaded footstep; in double support it goes from one to the next.
        self.loaded = starts, 1 + np.arange(len(starts)) // 2
        self.landing = np.concatenate([[-np.inf, -np.inf], base.contacts.starts[1::2]])  # of every footstep
        return self._walk(base.feet, base.contacts, *np.zeros((4, len(self.grid), 2)))

    def replan(self, time, state, touch, plan):
        """The walk from the measured COM on."""
        terms = self.robot.jacobian(state.q)
        planned = self.base.sample([time])
        off = terms.com[:2] - planned.com[0, :2]
        off_velocity = (terms.jacobian @ state.v)[:2] - planned.com_velocity[0, :2]
        shifts = np.array([step.position[:2] for step in plan.contacts.footsteps]) - self.places
        # Shares of the displacements of all footsteps in the ZMP, over the horizon.
        t = np.arange(0.0, HORIZON + 0.5 * GRID, GRID)
        shares = np.interp(time + t, *self.loaded)[:, None] - np.arange(len(shifts))
        shares = np.maximum(1.0 - np.abs(shares), 0.0)
        error = off + off_velocity / self.omega
        deviation = np.empty((len(t), 2))
        for axis in (0, 1):
            shifts[:, axis], deviation[:, axis] = self._solve(axis, time, t, shares, shifts[:, axis], error[axis])
        footsteps = tuple(
            step._replace(position=(*(place + shift).tolist(), 0.0))
            for step, place, shift in zip(plan.contacts.footsteps, self.places, shifts, strict=True)
        )
        return self._moved(time, plan, footsteps, shifts, deviation, off, off_velocity)

    def _solve(self, axis, time, t, shares, shift, error):
        """Displacements of all footsteps and deviation of the ZMP along one axis."""
        w = self.omega
        free = np.flatnonzero((self.landing > time + FREEZE) & (self.landing < time + HORIZON))
        nodes = np.arange(0.0, HORIZON + 0.5 * NODE, NODE)
        n, m = len(nodes), len(free)
        hats = np.maximum(1.0 - np.abs(t[:, None] - nodes) / NODE, 0.0)
        # Displacements: those that are fixed, and by the free ones; the last one moves all that follow.
        moved = np.zeros((len(shift), m))
        moved[free, np.arange(m)] = 1.0
        if m:
            moved[free[-1] :, -1] = 1.0
        fixed = np.where(moved.any(axis=1), 0.0, shift)
        weight = w * GRID * np.exp(-w * t)
        weight[[0, -1]] *= 0.5
        last = np.exp(-w * HORIZON)
        row = np.concatenate([weight @ hats, weight @ shares @ moved + last * moved[-1], [1.0]])
        known = weight @ shares @ fixed + last * fixed[-1]
        # Room of the ZMP in the sole, in double support between those of both.
        at = np.minimum(time + nodes, self.base.duration)
        rolled = self.base.sample(at).zmp[:, axis] - shares[:: round(NODE / GRID)] @ self.places[:, axis]
        sole = self.base.feet.sole
        low, high = ((sole.heel_x, sole.ball_x), (-sole.heel_half_width, sole.heel_half_width))[axis]
        low, high = np.minimum(low + MARGIN - rolled, 0.0), np.maximum(high - MARGIN - rolled, 0.0)
        # Change of each free step from the planned one.
        steps = moved[free] - moved[free - 1]
        before = fixed[free] - fixed[free - 1]
        outward = np.where(self.places[free, 1] > 0.0, 1.0, -1.0)
        if axis == 0:
            least, most = np.full(m, -SHORTER), np.full(m, LONGER)
        else:
            least, most = np.minimum(-NARROWER * outward, WIDER * outward), np.maximum(-NARROWER * outward, WIDER * outward)
        rate = np.diff(np.eye(n), axis=0) / NODE
        P = np.zeros((n + m + 1, n + m + 1))
        P[:n, :n] = NODE * (np.eye(n) + RATE_COST * rate.T @ rate)
        P[n:-1, n:-1] = FOOT_COST * (np.eye(m) + steps.T @ steps)
        P[-1, -1] = 1e5
        q = np.concatenate([np.zeros(n), FOOT_COST * steps.T @ before, [0.0]])
        A = np.zeros((1 + n + m, n + m + 1))
        A[0], A[1 : n + 1, :n], A[n + 1 :, n:-1] = row, np.eye(n), steps
        lower = np.concatenate([[error - known], low, least - before])
        upper = np.concatenate([[error - known], high, most - before])
        solver = osqp.OSQP()
        solver.setup(sparse.csc_matrix(np.triu(P)), q, sparse.csc_matrix(A), lower, upper, verbose=False, eps_abs=1e-6, eps_rel=1e-6, max_iter=4000)
        x = solver.solve().x
        shift = fixed + moved @ x[n:-1]
        return shift, hats @ x[:n] + shares @ shift

    def _moved(self, time, plan, footsteps, shifts, deviation, off, off_velocity):
        """The plan with other footsteps and another ZMP from a time on."""
        w, grid = self.omega, self.grid
        contacts = replace(plan.contacts, footsteps=footsteps, phases=tuple(
            phase._replace(**{step.foot: step for step in footsteps[k // 2 + 1 : (k + 1) // 2 + 2]})
            for k, phase in enumerate(plan.contacts.phases)
        ))
        new = plan_feet(contacts, self.run.foot, self.base.feet.sole, 0.0)
        landed = self.landing[np.searchsorted(self.landing, time + 1e-9)] if time < self.landing[-1] else self.base.duration
        feet = FeetPlan(new.sole, joined(plan.feet.left, new.left, time, landed), joined(plan.feet.right, new.right, time, landed), plan.feet.duration)
        # COM of the pendulum by its modes that grow and decay, over a ZMP that is linear between the samples.
        motion, rise = [(off, off_velocity)], (np.cosh(w * GRID), np.sinh(w * GRID))
        for before, after in zip(deviation[:-1], deviation[1:], strict=True):
            x, v = motion[-1]
            slope = (after - before) / GRID
            x1 = after + (x - before) * rise[0] + (v - slope) / w * rise[1]
            motion.append((x1, slope + (x - before) * w * rise[1] + (v - slope) * rise[0]))
        x, v = np.array(motion).swapaxes(0, 1)
        t = time + GRID * np.arange(len(x))
        t, x, v, d = (np.asarray(values) for values in (t, x, v, deviation))
        # After the horizon what is left decays.
        later = np.maximum(grid - t[-1], 0.0)[:, None]
        tail = np.exp(-w * later) * (x[-1] - shifts[-1])
        inside = (grid <= t[-1])[:, None]

        def over(values, after):
            return np.where(inside, np.stack([np.interp(grid, t, column) for column in values.T], axis=1), after)

        x, v, d = over(x, shifts[-1] + tail), over(v, -w * tail), over(d, shifts[-1] + 0.0 * tail)
        past = grid < time - 1e-9
        old = plan.phases[0]
        return self._walk(feet, contacts, x, v, w * w * (x - d), d, old, past)

    def _walk(self, feet, contacts, x, v, a, d, old=None, past=None):
        s, weight = self.sample, self.base.weight
        arm = np.stack([-s.moment[:, 1], s.moment[:, 0]], axis=1) / weight
        laws = []
        for k in (0, 1):
            columns = [s.com[:, k] + x[:, k], s.com_velocity[:, k] + v[:, k], s.com_acceleration[:, k] + a[:, k], s.zmp[:, k] + d[:, k], arm[:, k]]
            if old is not None:
                law = (old.x, old.y)[k]
                columns = [np.where(past, was, now) for was, now in zip((law.position, law.velocity, law.acceleration, law.zmp, law.moment_arm), columns, strict=True)]
            laws.append(SampledLaw(self.grid, *columns))
        phase = CentroidalPhase(0.0, self.base.duration, (0.0, 0.0), *laws, self.base.phases[0].angular_momentum)
        return replace(self.base, feet=feet, contacts=contacts, phases=(phase,))
