"""Model predictive control over the footsteps of `normal`, pushed and not, beside the AMPM. Takes TODO s.

The DCM planner makes the first plan. Every 50 ms, a QP finds how far the ZMP and the next footsteps must
deviate from it for the measured error of the divergent component of motion (DCM) to stay bounded::

    error = integral of omega exp(-omega t) (d(t) - a(t)) over 0 ... T  +  exp(-omega T) last

The ZMP deviates by d, which is the displacement of the standing feet and a rest within the sole. The force line
misses the COM by a more than planned, until the measured surplus of angular momentum is gone. After the
horizon T all feet are displaced by `last` (Scianca et al., "MPC for humanoid gait generation: stability and
feasibility", IEEE T-RO 36(4), 2020).
"""

from dataclasses import replace

import numpy as np
import osqp
from scipy import sparse

import ampm
from ampm.planner.centroidal import CentroidalPhase
from ampm.planner.contacts import contacts_in_turn
from ampm.planner.feet import FeetPlan
from ampm.planner.replan import joined
from ampm.planner.sampled import SampledLaw
from ampm.planner.stride import plan_feet

HORIZON, NODE, GRID = 1.6, 0.05, 0.005  # of the QP, between its ZMPs, between the samples of a plan [s]
AHEAD, NODES = np.arange(321) * GRID, np.arange(33) * NODE  # [s]
HATS = np.maximum(1.0 - np.abs(AHEAD[:, None] - NODES) / NODE, 0.0)  # of a ZMP that is linear between nodes
MARGIN, FREEZE = 0.005, 0.08  # from the edges of a sole [m]; no landing is moved later before it [s]
LONGER, SHORTER, WIDER, NARROWER = 0.28, 0.6, 0.4, 0.08  # by which a step may change [m]
STEP_COST, RATE_COST, BOUND_COST = 0.3, 0.01, 1e3  # over that of the ZMP in the sole [s, s^2, s]
MOMENTUM_RATE = 15.0  # at which a surplus of angular momentum dies out [1/s]


class Mpc:
    """Plans as the DCM planner does, then again every 50 ms from the measured state."""

    replan_period = 0.05  # [s]

    def plan(self, run, robot):
        """The walk without disturbances."""
        self.run, self.robot, self.base = run, robot, ampm.PeriodicPlanner("dcm").plan(run, robot)
        contacts, w = self.base.contacts, np.sqrt(self.base.gravity / self.base.com_height)
        self.omega, self.places = w, np.array([step.position[:2] for step in contacts.footsteps])
        self.landing = np.concatenate([[-1.0, -1.0], contacts.starts[1::2]])  # of every footstep [s]
        # COM and its velocity by the points r where the force line passes: x'' = omega^2 (x - r).
        since = w * np.maximum(AHEAD[:, None] - AHEAD, 0.0)
        weights = w * GRID * np.where(AHEAD[:, None] >= AHEAD, 1.0, 0.0)
        weights[:, 0] *= 0.5
        weights[np.diag_indices(len(AHEAD))] *= 0.5
        self.com_by_point, self.velocity_by_point = -weights * np.sinh(since), -w * weights * np.cosh(since)
        self.weights = weights[-1] * np.exp(-w * AHEAD)  # of r in the DCM
        return self.base

    def replan(self, time, state, touch, plan):
        """The walk from the measured state on."""
        if time == 0.0:
            return None  # it has just been planned
        base, w = self.base, self.omega
        terms, now = self.robot.jacobian(state.q), base.sample([time])
        rates = terms.jacobian @ state.v
        off, speed = terms.com[:2] - now.com[0, :2], rates[:2] - now.com_velocity[0, :2]
        surplus = self.robot.mass * rates[3:5] - now.angular_momentum[0]
        pull = MOMENTUM_RATE / base.weight * np.exp(-MOMENTUM_RATE * AHEAD)
        arm = pull[:, None] * [surplus[1], -surplus[0]]
        # Which footstep is loaded: from one to the next in double support.
        edges = np.append(base.contacts.starts, base.duration)
        loaded = np.interp(time + AHEAD, edges, 1 + np.arange(len(edges)) // 2)
        shares = np.maximum(1.0 - np.abs(loaded[:, None] - np.arange(len(self.places))), 0.0)
        displaced = np.array([step.position[:2] for step in plan.contacts.footsteps]) - self.places
        error, zmp = off + speed / w + self.weights @ arm, np.empty_like(arm)
        for axis in (0, 1):
            displaced[:, axis], zmp[:, axis] = self.solve(axis, time, shares, displaced[:, axis], error[axis])
        # The pendulum over this ZMP; after the horizon what is left dies out.
        t = np.concatenate([time + AHEAD, base.contacts.starts, np.arange(time, base.duration, GRID)])
        t = np.unique(np.append(t[(t >= time) & (t < base.duration)], base.duration).round(9))
        s, later = base.sample(t), np.exp(-w * np.maximum(t - time - HORIZON, 0.0))[:, None]
        com = np.cosh(w * AHEAD)[:, None] * off + np.sinh(w * AHEAD)[:, None] * speed / w
        com += self.com_by_point @ (zmp - arm)
        velocity = w * np.sinh(w * AHEAD)[:, None] * off + np.cosh(w * AHEAD)[:, None] * speed
        velocity += self.velocity_by_point @ (zmp - arm)
        laws = []
        for axis in (0, 1):
            x, v, p, q = (np.interp(t, time + AHEAD, part[:, axis]) for part in (com, velocity, zmp, arm))
            last, fade = displaced[-1, axis], later[:, 0]
            x, v, p, q = last + fade * (x - last), np.where(fade < 1.0, w * fade * (last - x), v), p, q
            acceleration = s.com_acceleration[:, axis] + w * w * (x - p + q)
            laws.append(SampledLaw(t - time, s.com[:, axis] + x, s.com_velocity[:, axis] + v, acceleration, s.zmp[:, axis] + p, q))
        momentum = now.angular_momentum[0] + surplus - [0.0, base.constants.angular_momentum_y_offset]
        phase = CentroidalPhase(time, base.duration - time, (0.0, 0.0), *laws, tuple(momentum))
        past = [p._replace(duration=min(p.duration, time - p.start)) for p in base.phases if p.start < time]
        return replace(plan, phases=(*past, phase), **self.stepped(time, plan, displaced))

    def stepped(self, time, plan, displaced):
        """Contacts and feet with displaced footsteps."""
        old = plan.contacts
        places = np.column_stack([self.places + displaced, np.zeros(len(displaced))]).tolist()
        footsteps = [step._replace(position=tuple(p)) for step, p in zip(old.footsteps, places, strict=True)]
        contacts = contacts_in_turn(footsteps, old.starts.tolist(), [phase.duration for phase in old.phases])
        new, landed = plan_feet(contacts, self.run.foot, plan.feet.sole, 0.0), np.append(self.landing, plan.duration)
        landed = landed[np.searchsorted(landed, time + 1e-9)]
        left = joined(plan.feet.left, new.left, time, landed)
        right = joined(plan.feet.right, new.right, time, landed)
        return {"contacts": contacts, "feet": FeetPlan(new.sole, left, right, plan.feet.duration)}

    def solve(self, axis, time, shares, displaced, error):
        """Displacements of all footsteps, shape (F,), and deviation of the ZMP ahead, (321,), along an axis [m]."""
        free = np.flatnonzero((self.landing > time + FREEZE) & (self.landing < time + HORIZON))
        n, m, sole = len(NODES), len(free), self.base.feet.sole
        moved = np.zeros((len(displaced), m))  # displacement of all by the free ones; the last moves all after it
        moved[free, np.arange(m)] = 1.0
        moved[max([*free, 0]) :, m - 1 :] = 1.0
        fixed = np.where(moved.any(axis=1), 0.0, displaced)
        shift = self.weights @ shares
        shift[-1] += np.exp(-self.omega * HORIZON)
        # Room of the ZMP within the sole; in double support between that of both.
        at = np.minimum(time + NODES, self.base.duration)
        inside = self.base.sample(at).zmp[:, axis] - shares[:: n // 3 - 1] @ self.places[:, axis]
        width = 0.5 * (sole.heel_half_width + sole.ball_half_width)
        low, high = ((sole.heel_x, sole.ball_x), (-width, width))[axis]
        low, high = np.minimum(low + MARGIN - inside, 0.0), np.maximum(high - MARGIN - inside, 0.0)
        outward = np.sign(self.places[free, 1])
        limits = np.sort([-NARROWER * outward, WIDER * outward], axis=0) if axis else np.array([[-SHORTER], [LONGER]])
        change, before = moved[free] - moved[free - 1], fixed[free] - fixed[free - 1]
        P, A = np.zeros((n + m + 1, n + m + 1)), np.zeros((1 + n + m, n + m + 1))
        rate = np.diff(np.eye(n), axis=0) / NODE
        P[:n, :n] = NODE * (np.eye(n) + RATE_COST * rate.T @ rate)
        P[n:-1, n:-1], P[-1, -1] = STEP_COST * (np.eye(m) + change.T @ change), BOUND_COST
        q = np.concatenate([np.zeros(n), STEP_COST * change.T @ before, [0.0]])
        A[0] = np.concatenate([self.weights @ HATS, shift @ moved, [1.0]])
        A[1 : n + 1, :n], A[n + 1 :, n:-1] = np.eye(n), change
        lower, upper = ([error - shift @ fixed], low, limits[0] - before), ([error - shift @ fixed], high, limits[1] - before)
        solver = osqp.OSQP()
        solver.setup(sparse.csc_matrix(P), q, sparse.csc_matrix(A), np.concatenate(lower), np.concatenate(upper), verbose=False, eps_abs=1e-5, eps_rel=1e-5)
        x = solver.solve().x
        displaced = fixed + moved @ x[n:-1]
        return displaced, HATS @ x[:n] + shares @ displaced
