"""The linear inverted pendulum over a run's footsteps: what the planners of this folder deviate from.

The force passes through the COM, which stays at the height H, and the ZMP p is linear between knots::

    com'' = w^2 (com - p),   w = sqrt(g / H)

In single support the ZMP goes from heel to ball of the standing foot, as far as in the AMPM's plan, in double
support to the other foot. Of all motions over this ZMP the first plan is the one that stays bounded. Before
and after a walk over footsteps, and where a landing comes late, the ZMP rests between both feet. SAME, FREEZE
and REACH were chosen with `normal`, pushed and not, in view.
"""

import numpy as np

import ampm

RATE, GRAVITY = 200.0, 9.81  # samples a second; [m/s^2]
MORE, BEYOND = 4, 8  # steps planned after the last one asked for; before and after, where the plan repeats
STAND, SHIFT = 1.6, 0.4  # of a walk from standing: before the first swing; ZMP from the middle to a foot [s]
SAME, FREEZE = 0.004, 0.08  # DCM error that is not answered [m]; a foot that lands sooner stays [s]
# Least and largest change of a step of the left foot along x and y, and of the right foot [m].
REACH = np.array([[[-0.6, -0.08], [0.28, 0.4]], [[-0.6, -0.4], [0.28, 0.08]]])


class Pendulum:
    """Plans the pendulum over the footsteps of a run; a subclass says how to deviate while walking."""

    replan_period = 0.05  # [s]
    climbs = False  # whether the COM follows footsteps of different heights

    def deviate(self, time, off, surplus):
        """How the walk goes on from a deviation of COM and velocity, (2, 2), and of the momentum (2,).

        It may move footsteps in `self.moved`. Returns times (n,), deviations of COM and velocity (2, n, 2),
        of the ZMP (n, 2), and the moment of the ground force about the COM (n, 2), None for none.
        """
        raise NotImplementedError

    def plan(self, run, robot):
        """The walk without disturbances; of equal steps some more than are asked for."""
        if not self.climbs and any(step.z for step in run.footsteps):
            raise ampm.InputError("footsteps.z: the COM of this planner stays at one height; leave out z.")
        self.run, self.robot, self.w = run, robot, np.sqrt(GRAVITY / run.gait.com_height)
        timing = ampm.plan(run.replace({}, footsteps=())).constants
        self.single, self.double = timing.single_support_duration, timing.double_support_duration
        self.roll = timing.l_s * timing.inverse_a_s  # of the ZMP, behind and ahead of the sole's origin [m]
        self.set_steps(*(self.given() if run.footsteps else self.repeated()))
        self.heights = np.array([step.z for step in run.footsteps] or [0.0] * len(self.places))
        zmp = np.column_stack([self.weights @ self.places + self.rolls, self.weights @ self.heights])
        times = self.samples(self.times[0], self.times[-1], self.times)
        zmp = np.column_stack([np.interp(times, self.times, axis) for axis in zmp.T])
        dcm, ccm = self.bounded(times, zmp), self.bounded(-times[::-1], zmp[::-1])[::-1]
        com = 0.5 * (dcm + ccm)
        motion = {"times": times, "com_velocity": 0.5 * self.w * (dcm - ccm)}
        motion["com_acceleration"] = self.w**2 * (com - zmp)
        motion["com"] = com + np.array([0.0, 0.0, run.gait.com_height])  # vertically as horizontally
        motion["com"][:, 2] += com[:, :2] @ run.gait.slopes
        walked = (times >= 0.0) & (times <= self.switches[-1])
        motion = {name: rows[walked] for name, rows in motion.items()}
        self.moved = np.zeros_like(self.places)  # of the footsteps, while walking [m]
        self.first = ampm.make_plan(run, robot, **motion, contacts=self.contacts())
        return self.first

    def repeated(self):
        """Equal steps: footsteps, their sides (0 left), headings, and when each stands alone."""
        gait, period = self.run.gait, self.single + self.double
        number = np.arange(-BEYOND, gait.steps + MORE + BEYOND + 1)
        places = np.column_stack([gait.step_length * number, 0.5 * gait.step_width * (-1.0) ** number])
        times = period * number[:, None] + [0.0, self.single]
        self.walked = slice(BEYOND - 1, len(number) - BEYOND)
        self.switches = times.ravel()[2 * BEYOND : -2 * BEYOND - 1]
        return places, number % 2, 0.0 * number, times

    def given(self):
        """The run's footsteps from standing to standing; the first and the last never stand alone."""
        steps, times, lift = self.run.footsteps, [], STAND
        for step in steps[2:]:
            begin = max(lift, (step.time or 0.0) - self.single)
            times.append((begin, step.time or begin + self.single))
            lift = times[-1][1] + self.double
        self.walked = slice(0, len(steps))
        self.switches = np.array([0.0, *np.ravel(times), lift - self.double + STAND])
        alone = np.array([(0.0, 0.0), *times, (self.switches[-1],) * 2])
        sides = np.array([step.foot == "right" for step in steps], int)
        return np.array([(s.x, s.y) for s in steps]), sides, np.array([s.heading for s in steps]), alone

    def set_steps(self, places, sides, headings, times):
        """Knots of the ZMP: their times, and what it is there: `weights @ places + rolls`."""
        self.places, self.sides, self.headings = places, sides, headings
        self.alone, each = times, np.eye(len(places))
        ahead = self.roll * np.column_stack([np.cos(headings), np.sin(headings)])
        knots, self.lands, self.stands = [], {}, set()  # footstep whose support ends, by knot; first knots
        for n, (begin, end) in enumerate(times):
            if end > begin:
                knots += [(begin, each[n], -ahead[n]), (end, each[n], ahead[n])]
            if n + 1 == len(times):
                break
            if end > begin:
                self.lands[len(knots) - 1] = n
            if times[n + 1, 0] - end > 2.0 * SHIFT - 1e-9:  # both feet stand
                middle, last = 0.5 * (each[n] + each[n + 1]), times[n + 1, 0]
                rests = [end + SHIFT * (end > begin), last - SHIFT * (times[n + 1, 1] > last)]
                self.stands.add(len(knots))
                knots += [(at, middle, np.zeros(2)) for at in rests]
        self.times, self.weights, self.rolls = (np.array(column) for column in zip(*knots, strict=True))

    def contacts(self):
        """Contacts of the whole walk with the footsteps where they are now."""
        places = np.column_stack([self.places + self.moved, self.heights]).tolist()
        rows = list(zip(self.sides, places, self.headings.tolist(), strict=True))[self.walked]
        feet = [ampm.Footstep("right" if side else "left", place, turn) for side, place, turn in rows]
        return ampm.Contacts.in_turn(feet, self.switches)

    def samples(self, begin, end, knots):
        """Times at RATE, and the knots among them."""
        between = knots[(knots > begin) & (knots < end)]
        times = np.unique(np.concatenate([np.arange(begin, end, 1.0 / RATE), between, [end]]))
        return times[np.diff(times, prepend=-np.inf) > 1e-6]

    def bounded(self, times, zmp, end=None):
        """The DCM com + com'/w that ends on the ZMP or as given; back in time the converging com - com'/w."""
        dcm, steps = zmp + 0.0, np.diff(times)[:, None]
        dcm[-1] = zmp[-1] if end is None else end
        leads, decays = np.diff(zmp, axis=0) / steps / self.w, np.exp(-self.w * steps)
        for i in range(len(steps) - 1, -1, -1):
            dcm[i] = zmp[i] + leads[i] + (dcm[i + 1] - zmp[i + 1] - leads[i]) * decays[i]
        return dcm

    def motion(self, times, zmp, off):
        """Bounded deviations of COM and velocity (2, n, 2) over those of the ZMP, from a measured one (2, 2).

        The COM begins where it was measured; the part of its speed that would diverge is left out.
        """
        dcm = self.bounded(times, zmp)
        left = off[0] + off[1] / self.w - dcm[0]
        ccm = self.bounded(-times[::-1], zmp[::-1], off[0] - off[1] / self.w + left)[::-1]
        return np.array([0.5 * (dcm + ccm), 0.5 * self.w * (dcm - ccm)])

    def replan(self, time, state, touch, plan):
        """The walk from the measured state on, or None while its DCM is that of the plan."""
        body = self.robot.jacobian(state.q)
        rates = body.jacobian @ state.v
        com, velocity, momentum = body.com[:2], rates[:2], self.robot.mass * rates[3:5]
        walking = 0.0 < time < self.times[-1]
        if not walking or np.linalg.norm(com + velocity / self.w - plan.sample(time).dcm[0]) < SAME:
            return None
        first, before = self.first.sample(time), self.moved.copy()
        off = np.array([com - first.com[0, :2], velocity - first.com_velocity[0, :2]])
        times, moves, zmp, moment = self.deviate(time, off, momentum - first.angular_momentum[0])
        ahead, level = self.first.sample(times), ((0, 0), (0, 1))
        motion = {"com": ahead.com + np.pad(moves[0], level), "zmp": ahead.zmp + zmp}
        motion["com_velocity"] = ahead.com_velocity + np.pad(moves[1], level)
        if moment is not None:
            motion |= {"moment": moment, "angular_momentum": momentum}
        motion |= {"times": times, "contacts": self.contacts(), "after": plan}
        try:
            return ampm.make_plan(self.run, self.robot, **motion)
        except (ampm.InputError, ampm.RefusedGait):  # there is no such walk: keep the plan
            self.moved = before
            return None
