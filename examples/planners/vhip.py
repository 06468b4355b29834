"""Linear feedback of the variable-height inverted pendulum (VHIP): the ankle first, then the COM's height.

Caron, "Biped stabilization by linear feedback of the variable-height inverted pendulum model", ICRA 2020.

The force passes through the COM c. Its stiffness l is an input beside the ZMP r, and the DCM has a fourth
coordinate, its rate w::

    c'' = l (c - r) + g,   d = c + c' / w,   w' = w^2 - l

Feedback places all four poles at (1 - K) w. Of the deviations from the plan (l = w^2) it asks, linearised::

    K Dd = Dr + (r - d) Dl / l + (d - v) Dw / w + s,   Dl = w (1 + K) Dw,   Dd = Dc + Dc' / w - c' Dw / w^2

with v = (r_x, r_y, H). Best effort: Dr keeps the ZMP in the soles, Dl the force, s the height of the DCM
within limits, and a violation s across the floor costs more than one of the height. While the sole suffices
this is the linear pendulum's feedback by the ankle. Where it does not, the COM sinks or rises: the force that
it needs for that pushes the COM back. Here Dr follows from Dw, so that one unknown is left, and is searched.

Footsteps and times stay. K, the weight and the limits were chosen with `normal`, pushed and not, in view.
"""

import numpy as np

import ampm
from examples.planners.pendulum import GRAVITY, SAME, Pendulum

K, HEIGHT_WEIGHT, BEYOND_WEIGHT = 3.0, 1e-3, 1e3  # gain; cost along z, and out of the limits of height [1]
SOLE = np.array([[-0.09, -0.03], [0.08, 0.03]])  # of the ZMP from the sole's origin [m]
STIFFNESS = (0.6, 1.5)  # least and largest l, of the plan's w^2
LOW, HIGH, SOON = -0.05, 0.02, 0.05  # of the height of the DCM from the plan [m], so much later [s]

LOST = 0.3  # distance of the COM from the plan's at its end, where the feedback cannot bound it [m]


def feedback(w, height, error, velocity, ahead, low, high):
    """Changes of the ZMP (2,) [m] and of the stiffness, of w^2 [1].

    Args:
        w: rate of the planned pendulum [1/s].
        height: of its COM [m].
        error: deviation of the DCM c + c'/w, (3,) [m].
        velocity: of the COM, (3,) [m/s].
        ahead: how far the planned DCM is ahead of the planned ZMP, (2,) [m].
        low: least change of the ZMP, (2,) [m].
        high: largest change, (2,) [m].
    """
    least, most = ((share - 1.0) * w / (1.0 + K) for share in STIFFNESS)
    # What is asked of ZMP and height, and the height to come, at no change Dw and by Dw.
    asked, by = K * error, K * (np.append(ahead, 0.0) / w - velocity / w**2)
    by[2] += height * (1.0 + K) / w
    step = w * SOON
    coming = error[2] * (1.0 + step * (1.0 - K)) + step * asked[2]
    by_coming = -velocity[2] / w**2 * (1.0 + step * (1.0 - K)) + step * by[2]
    values, rates = np.append(asked[:2], coming), np.append(by[:2], by_coming)
    limits, costs = np.array([[*low, LOW], [*high, HIGH]]), np.array([1.0, 1.0, BEYOND_WEIGHT])
    with np.errstate(divide="ignore", invalid="ignore"):
        bends = np.nan_to_num((limits - values) / rates)  # of the cost's slope
    tried = np.unique(np.clip([least, most, *bends.ravel()], least, most))
    found = values + rates * tried[:, None]
    slopes = (costs * rates * (found - np.clip(found, *limits))).sum(axis=1)
    slopes += HEIGHT_WEIGHT * by[2] * (asked[2] + by[2] * tried)
    rate = np.interp(0.0, slopes, tried)  # the slope of the cost is linear in between, and rises
    return np.clip(asked[:2] + by[:2] * rate, low, high), (1.0 + K) * rate / w


class Vhip(Pendulum):
    """Answers by the ZMP in the soles and by the height of the COM."""

    def plan(self, run, robot):
        """The walk without disturbances."""
        if any(step.heading for step in run.footsteps):
            raise ampm.InputError("footsteps.heading: this planner walks straight on; leave out heading.")
        return super().plan(run, robot)

    def force(self, wanted, foot, i, com, velocity):
        """Acceleration of the COM by the feedback at a sample of the plan, (3,) [m/s^2]."""
        error = com - wanted.com[i] + (velocity - wanted.com_velocity[i]) / self.w
        low, high = foot[i] + SOLE - wanted.zmp[i]
        ahead = wanted.dcm[i] - wanted.zmp[i]
        limits = np.minimum(low, 0.0), np.maximum(high, 0.0)
        change, share = feedback(self.w, self.first.com_height, error, velocity, ahead, *limits)
        zmp = np.append(wanted.zmp[i] + change, 0.0)
        return self.w**2 * (1.0 + share) * (com - zmp) - [0.0, 0.0, GRAVITY]

    def replan(self, time, state, touch, plan):
        """The walk from the measured state on by the feedback, or None while its DCM is that of the plan."""
        body = self.robot.jacobian(state.q)
        com, velocity, walking = body.com, (body.jacobian @ state.v)[:3], 0.0 < time < self.times[-1]
        now = plan.sample(time)
        if not walking or np.linalg.norm((com + velocity / self.w)[:2] - now.dcm[0]) < SAME:
            return None
        times = self.samples(time, self.switches[-1], self.times)
        wanted, spans = self.first.sample(times), np.diff(times)
        # The sole's origin; in double support it goes from foot to foot.
        foot = np.column_stack([np.interp(times, self.times, p) for p in (self.weights @ self.places).T])
        force, rows = self.force(wanted, foot, 0, com, velocity), []
        for i, span in enumerate(spans):
            rows.append([com, velocity, force])
            ahead = self.force(
                wanted, foot, i + 1, com + span * velocity + 0.5 * span**2 * force, velocity + span * force
            )
            com = com + span * velocity + span**2 * (2.0 * force + ahead) / 6.0  # over a linear force
            velocity, force = velocity + 0.5 * span * (force + ahead), ahead
        if np.linalg.norm(com - wanted.com[-1]) > LOST:
            return None
        com, velocity, force = np.swapaxes([*rows, [com, velocity, force]], 0, 1)
        motion = {"com": com, "com_velocity": velocity, "com_acceleration": force}
        try:
            return ampm.make_plan(
                self.run, self.robot, times=times, **motion, contacts=plan.contacts, after=plan
            )
        except (ampm.InputError, ampm.RefusedGait):  # there is no such walk: keep the plan
            return None
