"""Capture steps with times, over the steps of `normal`, pushed and not, beside the AMPM. Takes 20 s.

Khadiv et al., "Walking control based on step timing adaptation", IEEE T-RO 36(3), 2020: place and time of the
next footstep are found so that the divergent component of motion (DCM) is where it has to be after the step.
Here a search over times replaces their QP in exp(w T), feet roll and double supports last. The inverted
pendulum com'' = w^2 (com - p) has a part that diverges and one that converges (Englsberger et al., IEEE T-RO
31(2), 2015)::

    dcm = com + com' / w,   dcm' = w (dcm - p);      ccm = com - com' / w,   ccm' = -w (ccm - p)

The ZMP p is linear between the switches of support. So both have closed forms: the DCM backward from the end,
the other forward from the measurement. Every 50 ms the DCM of the plan is compared with the measured one. The
ankle makes up for the difference, then the place of the next footstep and its time. All constants were chosen
with `normal`, pushed and not, in view.
"""

import numpy as np
from matplotlib.figure import Figure

import ampm
import validation as val

RATE = 200.0  # samples a second
MORE, BEYOND = 4, 8  # steps planned after the last one asked for; before and after the plan, where it repeats
SAME, FREEZE, SWING = 0.004, 0.08, 0.32  # error without an answer [m]; time to land; shortest swing [s]
ANKLE = np.array([[-0.1, -0.03], [0.09, 0.03]])  # of the ZMP from the sole's origin [m]
# Least and largest change of a step of the left foot along x and y, and of the right foot [m].
REACH = np.array([[[-0.6, -0.08], [0.28, 0.4]], [[-0.6, -0.4], [0.28, 0.08]]])
EARLIER = np.arange(0.0, 0.25, 0.025)  # by which a landing may come sooner [s]


class Capture:
    """Plans equal steps, and steps elsewhere and sooner when the measured DCM is off."""

    replan_period = 0.05  # [s]

    def plan(self, run, robot):
        """The walk without disturbances, and some steps more than are asked for."""
        if run.footsteps:
            raise ampm.InputError("footsteps: this planner makes equal steps of the gait; leave them out.")
        gait, timing = run.gait, ampm.plan(run).constants
        roll = timing.l_s * timing.inverse_a_s  # of the ZMP, behind and ahead of the sole's origin [m]
        single, period = timing.single_support_duration, timing.step_duration
        self.run, self.robot, self.w = run, robot, np.sqrt(9.81 / gait.com_height)
        number = np.arange(-BEYOND, gait.steps + MORE + BEYOND + 1)
        self.places = np.column_stack([gait.step_length * number, 0.5 * gait.step_width * (-1.0) ** number])
        self.steps = np.diff(self.places, axis=0, prepend=np.nan)  # as they are planned without a push
        self.times = period * number[:, None] + [0.0, single]  # each stands alone from, and until [s]
        self.zmp = self.places[:, None] + np.array([[-roll, 0.0], [roll, 0.0]])
        return self.made(self.times[0, 0], self.zmp[0, 0])

    def made(self, begin, ccm, ankle=0.0, after=None):
        """The plan of these footsteps, with the converging part at the begin of the pendulum's motion."""
        knots, zmp = self.knots(begin, self.times, self.zmp)
        zmp[0] += ankle
        walk = self.times.ravel()[2 * BEYOND : -2 * BEYOND - 1]  # its switches of support
        times = np.unique(np.append(np.arange(max(begin, 0.0), walk[-1], 1.0 / RATE), knots).round(9))
        zmp = np.column_stack([np.interp(times, knots, axis) for axis in zmp.T])
        dcm, ccm = self.dcm(times, zmp), self.dcm(-times[::-1], zmp[::-1], ccm)[::-1]
        now = (times >= max(begin, 0.0)) & (times <= walk[-1])
        places = enumerate(self.places[BEYOND - 1 : -BEYOND].tolist())
        feet = [ampm.Footstep("left" if n % 2 else "right", (x, y, 0.0)) for n, (x, y) in places]
        contacts = ampm.Contacts.in_turn(feet, walk)
        motion = {"times": times[now], "com": 0.5 * (dcm + ccm)[now], "zmp": zmp[now]}
        return ampm.make_plan(self.run, self.robot, **motion, contacts=contacts, after=after)

    def knots(self, begin, times, values):
        """Times from the begin on between which values are linear, and the values."""
        times, values = times.ravel(), values.reshape(times.size, -1)
        first = [np.interp(begin, times, axis) for axis in values.T]
        return np.append(begin, times[times > begin]), np.vstack([first, values[times > begin]])

    def dcm(self, times, zmp, end=None):
        """The DCM from its end back, that of the ZMP by default; back in time it is the converging part."""
        dcm, steps = zmp + 0.0, np.diff(times)[:, None]
        dcm[-1] = zmp[-1] if end is None else end
        leads, decays = np.diff(zmp, axis=0) / steps / self.w, np.exp(-self.w * steps)
        for i in range(len(steps) - 1, -1, -1):
            dcm[i] = zmp[i] + leads[i] + (dcm[i + 1] - zmp[i + 1] - leads[i]) * decays[i]
        return dcm

    def replan(self, time, state, touch, plan):
        """The walk from the measured COM on, or None while its DCM is that of the plan."""
        body = self.robot.jacobian(state.q)
        com, lead = body.com[:2], (body.jacobian @ state.v)[:2] / self.w
        if time == 0.0 or np.linalg.norm(com + lead - plan.sample(time).dcm[0]) < SAME:
            return None
        tried = filter(None, [self.solve(time, sooner, com + lead) for sooner in EARLIER])
        _, left, self.times, by, ankle = min(tried, key=lambda found: found[0])
        self.places, self.zmp = self.places + by, self.zmp + by[:, None]
        return self.made(time, com - lead + left, ankle, after=plan)

    def solve(self, time, sooner, measured):
        """Cost, DCM that is left, times, displacements of all footsteps (F, 2) and of the ZMP now (2,)."""
        stands = int(np.searchsorted(self.times[:, 0], time + 1e-9)) - 1
        begin, landing = self.times[stands]
        if sooner and landing - sooner < max(begin + SWING, time + FREEZE):
            return None
        times = np.where(self.times > time, self.times - sooner, self.times)
        knots, zmp = self.knots(time, times, self.zmp)
        left, ankle = measured - self.dcm(knots, zmp)[0], np.zeros(2)
        if time < landing:  # the ZMP moves by the ankle, and returns until the landing
            by_ankle = self.dcm(knots, np.eye(len(knots))[:, :1])[0]
            least, most = self.places[stands] + ANKLE - zmp[0]
            ankle = np.clip(left / by_ankle, np.minimum(least, 0.0), np.maximum(most, 0.0))
            left = left - by_ankle * ankle
        free = stands + 1 + int(times[stands, 1] < time + FREEZE)  # the next footstep that can be moved
        moved = (np.arange(len(times)) >= free)[:, None]
        by_step = self.dcm(*self.knots(time, times, np.repeat(moved, 2, axis=1) + 0.0))[0]
        change = self.places[free] - self.places[free - 1] - self.steps[free]
        step = np.clip(left / by_step, *(REACH[free % 2] - change))
        left = left - by_step * step
        return step @ step + 50.0 * left @ left + 0.02 * sooner, left, times, moved * step, ankle


if __name__ == "__main__":
    axes = (figure := Figure(figsize=(8.0, 4.0), layout="constrained")).subplots()
    run = ampm.load_run("normal", gait={"steps": 10}, simulation={"time_step": 0.002})
    for name, planner in (("AMPM", "ampm"), ("capture steps", Capture())):
        for force in ((0.0, 0.0), (200.0, 0.0), (-200.0, 0.0), (0.0, 150.0), (0.0, -100.0)):
            # Forward and to the left [N], [s].
            pushes = [val.Push("chest", (*force, 0.0), at=2.3, duration=0.1)] if any(force) else []
            trial = val.walk(run, planner=planner, disturbances=pushes)
            print(f"{name}, {force} N: {trial.record.outcome.name}")
        axes.plot(trial.measured.time, trial.measured.com[:, 1], label=f"{name}, 100 N to the right")
    axes.set(xlabel="time [s]", ylabel="COM, to the left [m]")
    axes.legend()
    figure.savefig("capture.png", dpi=100)
