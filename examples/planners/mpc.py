"""Model predictive control over the footsteps of `normal`, pushed and not, beside the AMPM. Takes 15 s.

The DCM planner makes the first plan. Every 50 ms QPs find how far ZMP and footsteps must deviate from it for
the measured divergent component of motion (DCM) to stay bounded (Scianca et al., IEEE T-RO 36(4), 2020)::

    dcm = integral of omega exp(-omega t) (p(t) - a(t)) over 0 ... T  +  exp(-omega T) (dcm_1 + last)

The ZMP p is the first plan's, displaced with the feet and moved within the sole (Wieber, Humanoids 2006). The
force line misses the COM by a, until the measured surplus of angular momentum is gone. After the horizon T
the first plan goes on, displaced by `last`; dcm_1 is its DCM there. A swing is shortened where that costs
less. All constants were chosen with `normal`, pushed and not, in view.
"""

import numpy as np
import osqp
from matplotlib.figure import Figure
from scipy import linalg, sparse

import ampm
import validation as val

GRID, STRIDE = 0.005, 10  # samples of the horizon [s]; how many from one ZMP of the QP to the next
AHEAD = GRID * np.arange(321)  # the horizon [s], where the ZMP is linear in between
HATS = np.maximum(1.0 - np.abs(AHEAD[:, None] - AHEAD[::STRIDE]) / (GRID * STRIDE), 0.0)
MARGIN, FREEZE = 0.005, 0.08  # of the ZMP in a sole [m]; a foot that lands sooner is not moved [s]
# Least and largest change of a step of either foot along x and y [m].
LEFT, RIGHT = np.array([[[-0.6, -0.08], [0.28, 0.4]], [[-0.6, -0.4], [0.28, 0.08]]])
SWING, SHARES = 0.32, (1.0, 0.9, 0.8, 0.65, 0.5)  # shortest swing [s]; shares of its rest that are tried
STEP_COST, BOUND_COST, TIME_COST = 0.6, 2e4, 0.04  # over that of the ZMP in the sole
MOMENTUM_RATE = 15.0  # at which a surplus of angular momentum dies out [1/s]


class Mpc:
    """Plans as the DCM planner does, then again every 50 ms from the measured state."""

    replan_period = 0.05  # [s]

    def plan(self, run, robot):
        """The walk without disturbances, and four steps more than are asked for."""
        if run.footsteps:
            raise ampm.InputError("footsteps: this planner makes equal steps of the gait; leave them out.")
        run = run.replace({"gait.steps": run.gait.steps + 4})
        self.base, self.run, self.robot = ampm.PeriodicPlanner("dcm").plan(run, robot), run, robot
        self.places = np.array([step.position for step in self.base.contacts.footsteps])
        self.edges = self.base.contacts.switches
        self.clock = self.edges, self.edges  # times, and the same instants of the first plan [s]
        # COM of the pendulum x'' = omega^2 (x - r) that starts at 0, by r and its first speed.
        self.omega = w = np.sqrt(self.base.gravity / self.base.com_height)
        weights, since = GRID * w * (np.tri(321) - 0.5 * np.eye(321)), w * (AHEAD[:, None] - AHEAD)
        weights[:, 0] *= 0.5
        linear = (4.0 * np.eye(321) + np.eye(321, k=1) + np.eye(321, k=-1)) / 6.0  # between the samples
        linear[0, :2] = 2.0 / 3.0, 1.0 / 3.0
        self.com_by_r, self.com_by_speed = -weights * np.sinh(since) @ linear, np.sinh(since[:, :1]) / w
        self.dcm_by_r, self.decay = weights[-1] * np.exp(-w * AHEAD), np.exp(-w * AHEAD[-1])
        return self.base

    def replan(self, time, state, touch, plan):
        """The walk from the measured state on; what this plan says of earlier times has no meaning."""
        if time == 0.0:
            return None
        base, w, body = self.base, self.omega, self.robot.jacobian(state.q)
        com, rates = body.com[:2], body.jacobian @ state.v
        momentum = self.robot.mass * rates[3:5]
        surplus = momentum - [0.0, base.constants.angular_momentum_y_offset]
        moment = -MOMENTUM_RATE * np.exp(-MOMENTUM_RATE * AHEAD)[:, None] * surplus
        arm = moment[:, ::-1] * [-1.0, 1.0] / base.weight
        dcm = com + rates[:2] / w + self.dcm_by_r @ arm
        moved = np.array([step.position for step in plan.contacts.footsteps]) - self.places
        tried = [self.solve(time, cost, clock, moved, com, dcm) for cost, clock in self.clocks(time)]
        _, self.clock, moved[:, :2], zmp = min(tried, key=lambda result: result[0])
        last, clock, edges = moved[-1, :2], self.clock, np.interp(self.edges, *self.clock[::-1])
        x = com + self.com_by_speed * rates[:2] + self.com_by_r @ (zmp - arm - com)  # the COM over this ZMP
        r = x - zmp + arm
        v = (x[-1] - x[-2]) / GRID + w * w * GRID / 6.0 * (2.0 * r[-1] + r[-2])
        t = np.arange(time + AHEAD[-1], edges[-1], GRID)
        later, s = base.sample(np.interp(t, *clock)), w * (t - t[0])[:, None]
        # What QPs cannot bound is taken from the speed. After the horizon the rest of ZMP and COM dies out.
        x -= w * self.decay * self.com_by_speed * (x[-1] + v / w - later.dcm[0] - last)
        of_zmp, of_com = zmp[-1] - later.zmp[0] - last, x[-1] - later.com[0, :2] - last
        x = np.vstack([x, (later.com[:, :2] + last + np.exp(-s) * (of_com - 0.5 * s * s * of_zmp))[1:]])
        zmp = np.vstack([zmp, (later.zmp + last + np.exp(-s) * (1.0 - 2.0 * s) * of_zmp)[1:]])
        pairs = zip(base.contacts.footsteps, (self.places + moved).tolist(), strict=True)
        footsteps = [step._replace(position=tuple(place)) for step, place in pairs]
        return ampm.make_plan(
            self.run,
            self.robot,
            times=np.append(time + AHEAD, t[1:]),
            com=x,
            zmp=zmp,
            moment=np.pad(moment, ((0, len(t) - 1), (0, 0))),
            angular_momentum=momentum,
            contacts=ampm.Contacts.in_turn(footsteps, edges),
            after=plan,
        )

    def clocks(self, time):
        """Costs and clocks: the valid plan's, and those with shorter rests of the present swing."""
        (t, first), edges = self.clock, np.interp(self.edges, *self.clock[::-1])
        k, past = np.searchsorted(edges, time + 1e-9), t < time + 1e-9
        first = np.concatenate([first[past], [np.interp(time, t, first)], first[~past]])
        for share in SHARES:
            end = time + share * (edges[k] - time)
            if share == 1.0 or (k % 2 and end - time > FREEZE and end - edges[k - 1] > SWING):
                times = np.concatenate([t[past], [time], t[~past] - edges[k] + end])
                yield -TIME_COST * np.log(share), (times, first)

    def solve(self, time, cost, clock, moved, com, dcm):
        """Cost, clock, displacements of all footsteps (F, 2) and ZMP ahead (321, 2) [m]."""
        edges, ahead = np.interp(self.edges, *clock[::-1]), self.base.sample(np.interp(time + AHEAD, *clock))
        loaded = np.interp(time + AHEAD, edges, 1 + np.arange(len(edges)) // 2)  # number of the footstep
        shares = np.maximum(1.0 - np.abs(loaded[:, None] - np.arange(len(moved))), 0.0)
        landing = np.append([-1.0, -1.0], edges[1::2])
        free = np.flatnonzero((landing > time + FREEZE) & (landing < time + AHEAD[-1]))
        by = np.zeros((len(moved), len(free)))  # the last free one displaces all after it
        by[free, np.arange(len(free))] = by[free[-1] :, -1] = 1.0
        fixed = np.where(by.any(axis=1, keepdims=True), 0.0, moved[:, :2])
        inside, zmp = (ahead.zmp - shares @ self.places[:, :2])[::STRIDE], ahead.zmp + shares @ fixed
        error = dcm - com - self.dcm_by_r @ (zmp - com) - self.decay * (ahead.dcm[-1] - com)
        row = np.concatenate([self.dcm_by_r @ HATS, self.dcm_by_r @ shares @ by + self.decay * by[-1], [1.0]])
        change, before = by[free] - by[free - 1], fixed[free] - fixed[free - 1]
        n = len(inside)  # ZMPs come first, then footsteps; the last variable is what is left of the error
        rows = sparse.csc_matrix(np.vstack([row, linalg.block_diag(np.eye(n), change, np.zeros((0, 1)))]))
        costs = sparse.diags([1.0] * n + [STEP_COST] * len(free) + [BOUND_COST], format="csc")
        sole, is_left = self.base.feet.sole, self.places[free, 1, None] > 0.0
        width = 0.5 * (sole.heel_half_width + sole.ball_half_width)
        back, front = np.array([sole.heel_x, -width]) + MARGIN, np.array([sole.ball_x, width]) - MARGIN
        least, most = np.where(is_left, LEFT[:, None], RIGHT[:, None]) - before
        low = np.vstack([error, np.minimum(back - inside, 0.0), least])  # of DCM, ZMP in the soles, steps
        high = np.vstack([error, np.maximum(front - inside, 0.0), most])
        for k in (0, 1):
            solver = osqp.OSQP()
            solver.setup(costs, None, rows, low[:, k], high[:, k], verbose=False, eps_abs=1e-5, eps_rel=1e-5)
            found = solver.solve()
            cost, fixed[:, k] = cost + found.info.obj_val, fixed[:, k] + by @ found.x[n:-1]
            zmp[:, k] += HATS @ found.x[:n] + shares @ by @ found.x[n:-1]
        return cost, clock, fixed, zmp


if __name__ == "__main__":
    push = val.Push("chest", (0.0, -120.0, 0.0), at=2.3, duration=0.1)  # to the right [N], [s]
    axes = (figure := Figure(figsize=(8.0, 4.0), layout="constrained")).subplots()
    for name, planner in (("AMPM", "ampm"), ("MPC", Mpc())):
        run = ampm.load_run("normal", gait={"steps": 10}, simulation={"time_step": 0.002})
        for pushes in ([], [push]):
            trial = val.walk(run, planner=planner, disturbances=pushes)
            x, y = (1e3 * trial.metrics[f"zmp_{axis}_rmse"].value for axis in "xy")  # from the valid plan's
            print(f"{name}, {len(pushes)} pushes: {trial.record.outcome.name}, ZMP RMSE {x:.2f}, {y:.2f} mm")
        axes.plot(trial.measured.time, trial.measured.com[:, 1], label=f"{name}, {push.force[1]:g} N")
    axes.set(xlabel="time [s]", ylabel="COM, to the left [m]", ylim=(-0.4, 0.1))
    axes.legend()
    figure.savefig("mpc.png", dpi=100)
