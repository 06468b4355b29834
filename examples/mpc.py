"""Model predictive control over the footsteps of `normal`, pushed and not, beside the AMPM. Takes TODO s.

The DCM planner makes the first plan. Every 50 ms a QP finds how far the ZMP and the next footsteps must
deviate from it for the measured divergent component of motion (DCM) to stay bounded::

    dcm = integral of omega exp(-omega t) (p(t) - a(t)) over 0 ... T  +  exp(-omega T) (dcm_1 + last)

The ZMP p is the first plan's, displaced as the feet are, and moved within the sole. The force line misses the COM
by a, until the measured surplus of angular momentum is gone. After the horizon T the walk goes on as in the first
plan, where the DCM is dcm_1, displaced by `last` (Scianca et al., "MPC for humanoid gait generation: stability
and feasibility", IEEE T-RO 36(4), 2020). A swing is shortened where that costs less.
"""

from dataclasses import replace
from types import SimpleNamespace

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

GRID = 0.005  # between the samples of a plan [s]
AHEAD, NODES = np.arange(321) * GRID, np.arange(33) * 10 * GRID  # the horizon: samples, ZMPs of the QP [s]
HATS = np.maximum(1.0 - np.abs(AHEAD[:, None] - NODES) / NODES[1], 0.0)  # a ZMP that is linear in between
MARGIN, FREEZE = 0.005, 0.08  # from the edges of a sole [m]; a foot that lands sooner is not moved [s]
LONGER, SHORTER, WIDER, NARROWER = 0.28, 0.6, 0.4, 0.08  # by which a step may change [m]
SWING, SHARES = 0.32, (1.0, 0.9, 0.8, 0.65, 0.5)  # least duration [s]; rests of a swing that are tried
STEP_COST, RATE_COST, BOUND_COST, TIME_COST = 0.03, 0.01, 1e3, 0.002  # over that of the ZMP in the sole
MOMENTUM_RATE = 15.0  # at which a surplus of angular momentum dies out [1/s]


class Mpc:
    """Plans as the DCM planner does, then again every 50 ms from the measured state."""

    replan_period = 0.05  # [s]

    def plan(self, run, robot):
        """The walk without disturbances, and some steps more."""
        self.run, self.robot = run.replace({"gait.steps": run.gait.steps + 4}), robot
        self.base = ampm.PeriodicPlanner("dcm").plan(self.run, robot)
        contacts, w = self.base.contacts, np.sqrt(self.base.gravity / self.base.com_height)
        self.omega, self.places = w, np.array([step.position[:2] for step in contacts.footsteps])
        self.edges = np.append(contacts.starts, self.base.duration)
        self.clock = self.edges, self.edges  # times, and the same instants of the first plan [s]
        # The pendulum x'' = omega^2 (x - r) by the trapezoidal rule: COM and velocity by r, from rest at 0.
        since, weights = w * np.maximum(AHEAD[:, None] - AHEAD, 0.0), w * GRID * np.tri(len(AHEAD))
        weights[:, 0] *= 0.5
        weights[np.diag_indices(len(AHEAD))] *= 0.5
        self.com_by_r, self.velocity_by_r = -weights * np.sinh(since), -w * weights * np.cosh(since)
        self.dcm_by_r, self.decay = weights[-1] * np.exp(-w * AHEAD), np.exp(-w * AHEAD[-1])
        return self.base

    def replan(self, time, state, touch, plan):
        """The walk from the measured state on."""
        if time == 0.0:
            return None
        base, w, terms = self.base, self.omega, self.robot.jacobian(state.q)
        com, rates = terms.com[:2], terms.jacobian @ state.v
        surplus = self.robot.mass * rates[3:5] - [0.0, base.constants.angular_momentum_y_offset]
        fading = MOMENTUM_RATE / base.weight * np.exp(-MOMENTUM_RATE * AHEAD)
        arm = fading[:, None] * [surplus[1], -surplus[0]]
        dcm = com + rates[:2] / w + self.dcm_by_r @ arm
        moved = np.array([step.position[:2] for step in plan.contacts.footsteps]) - self.places
        tried = [self.best(time, *clock, moved, com, dcm) for clock in self.clocks(time)]
        _, clock, moved, zmp = min(tried, key=lambda item: item[0])
        self.clock, edges = clock, np.interp(self.edges, *clock[::-1])
        # The pendulum over this ZMP; after the horizon what is left of its motion dies out.
        r, speed, angle = zmp - com - arm, rates[:2], w * AHEAD[:, None]
        x = com + np.sinh(angle) * speed / w + self.com_by_r @ r
        v = np.cosh(angle) * speed + self.velocity_by_r @ r
        t = np.arange(time + AHEAD[-1], edges[-1] + 2 * GRID, GRID)
        later = base.sample(np.interp(t, *clock))
        left = np.exp(w * (t[0] - t))[:, None] * (x[-1] - later.com[0, :2] - moved[-1])
        t = np.append(AHEAD, t[1:] - time)
        x = np.vstack([x, (later.com[:, :2] + moved[-1] + left)[1:]])
        v = np.vstack([v, (later.com_velocity[:, :2] - w * left)[1:]])
        zmp = np.vstack([zmp, later.zmp[1:] + moved[-1]])
        arm = np.vstack([arm, np.zeros((len(t) - len(arm), 2))])
        motion = x, v, w * w * (x - zmp + arm), zmp, arm
        laws = [SampledLaw(t, *(part[:, axis] for part in motion)) for axis in (0, 1)]
        phase = CentroidalPhase(time, edges[-1] - time, (0.0, 0.0), *laws, tuple(surplus))
        past = [p._replace(duration=min(p.duration, time - p.start)) for p in base.phases if p.start < time]
        places = np.column_stack([self.places + moved, np.zeros(len(moved))]).tolist()
        footsteps = [
            step._replace(position=tuple(place))
            for step, place in zip(plan.contacts.footsteps, places, strict=True)
        ]
        contacts = contacts_in_turn(footsteps, edges[:-1].tolist(), np.diff(edges).tolist())
        new, ends = plan_feet(contacts, self.run.foot, plan.feet.sole, 0.0), np.append(edges[1::2], edges[-1])
        landed = ends[np.searchsorted(ends, time + 1e-9)]
        left, right = (
            joined(getattr(plan.feet, side), getattr(new, side), time, landed) for side in ("left", "right")
        )
        posture = SimpleNamespace(
            sample=lambda t: base.posture.sample(np.interp(t, *clock)), report=base.posture.report
        )
        return replace(
            plan,
            phases=(*past, phase),
            contacts=contacts,
            feet=FeetPlan(new.sole, left, right, contacts.duration),
            posture=posture,
        )

    def clocks(self, time):
        """The valid plan's clock, and those with shorter rests of the present swing, each after its cost."""
        t, first = self.clock
        k = np.searchsorted(t, time + 1e-9)
        edge = np.searchsorted(self.edges, first[k] - 1e-9)
        rest, swung = t[k] - time, time - np.interp(self.edges[edge - 1], first, t)
        for share in SHARES if edge % 2 and rest > FREEZE else SHARES[:1]:
            if share == 1.0:
                yield 0.0, (t, first)
            elif swung + share * rest > SWING and share * rest > FREEZE:
                later = t[k:] - (1.0 - share) * rest
                hurried = np.concatenate([t[:k], [time], later])
                yield -TIME_COST * np.log(share), (hurried, np.insert(first, k, np.interp(time, t, first)))

    def best(self, time, haste, clock, moved, com, dcm):
        """Cost, clock, displacements of all footsteps (F, 2) and ZMP ahead (321, 2) [m]."""
        edges, ahead = np.interp(self.edges, *clock[::-1]), self.base.sample(np.interp(time + AHEAD, *clock))
        loaded = np.interp(time + AHEAD, edges, 1 + np.arange(len(edges)) // 2)  # number of the footstep
        shares = np.maximum(1.0 - np.abs(loaded[:, None] - np.arange(len(moved))), 0.0)
        landing = np.concatenate([[-1.0, -1.0], edges[1::2]])
        free = np.flatnonzero((landing > time + FREEZE) & (landing < time + AHEAD[-1]))
        error = dcm - com - self.dcm_by_r @ (ahead.zmp - com) - self.decay * (ahead.dcm[-1] - com)
        inside = (ahead.zmp - shares @ self.places)[:: len(AHEAD) // len(NODES) + 1]
        parts = [self.solve(k, free, shares, moved[:, k], inside[:, k], error[k]) for k in (0, 1)]
        cost, moved, by = (np.stack(part, axis=-1) for part in zip(*parts, strict=True))
        return haste + cost.sum(), clock, moved, ahead.zmp + by

    def solve(self, axis, free, shares, moved, inside, error):
        """Cost, displacements (F,) and change of the ZMP (321,) along one axis."""
        n, m, sole = len(NODES), len(free), self.base.feet.sole
        by = np.zeros((len(moved), m))  # displacements by the free ones; the last one moves all after it
        by[free, np.arange(m)] = 1.0
        by[free[-1] :, -1] = 1.0
        fixed = np.where(by.any(axis=1), 0.0, moved)
        total = self.dcm_by_r @ shares
        total[-1] += self.decay
        # Room of the ZMP within the sole; in double support between that of both.
        width = 0.5 * (sole.heel_half_width + sole.ball_half_width)
        low, high = ((sole.heel_x, sole.ball_x), (-width, width))[axis]
        low, high = np.minimum(low + MARGIN - inside, 0.0), np.maximum(high - MARGIN - inside, 0.0)
        outward = np.sign(self.places[free, 1])
        limits = np.sort([-NARROWER * outward, WIDER * outward], axis=0)
        if axis == 0:
            limits = np.array([[-SHORTER], [LONGER]])
        change, before = by[free] - by[free - 1], fixed[free] - fixed[free - 1]
        rate = np.diff(np.eye(n), axis=0) / NODES[1]
        P, A = np.zeros((n + m + 1, n + m + 1)), np.zeros((1 + n + m, n + m + 1))
        P[:n, :n] = NODES[1] * (np.eye(n) + RATE_COST * rate.T @ rate)
        P[n:-1, n:-1], P[-1, -1] = STEP_COST * (np.eye(m) + change.T @ change), BOUND_COST
        q = np.concatenate([np.zeros(n), STEP_COST * change.T @ before, [0.0]])
        A[0] = np.concatenate([self.dcm_by_r @ HATS, total @ by, [1.0]])
        A[1 : n + 1, :n], A[n + 1 :, n:-1] = np.eye(n), change
        lower, upper = (
            np.concatenate([[error - total @ fixed], room, limit - before])
            for room, limit in ((low, limits[0]), (high, limits[1]))
        )
        solver = osqp.OSQP()
        solver.setup(
            sparse.csc_matrix(P),
            q,
            sparse.csc_matrix(A),
            lower,
            upper,
            verbose=False,
            eps_abs=1e-5,
            eps_rel=1e-5,
        )
        found = solver.solve()
        moved = fixed + by @ found.x[n:-1]
        return (
            found.info.obj_val + 0.5 * STEP_COST * before @ before,
            moved,
            HATS @ found.x[:n] + shares @ moved,
        )
