"""Control of the pendulum by its steps: a base for planners that know what the next step should change.

Every 50 ms the deviation of the measured state from the first plan goes through the same pendulum to the end
of the single support. There :meth:`Steps.change` says by how much the next step deviates, and so for the step
after it. Where the body stands on both feet, the ZMP goes off their middle so that the DCM ends between them
again. The new plan is the bounded motion over these steps; what they cannot bound is taken from its speed.

The constants were chosen with `normal`, pushed and not, in view.
"""

import numpy as np

from examples.planners.pendulum import FREEZE, REACH, Pendulum

CHANGES = 2  # steps that are changed at once; those after them are moved as far as the last one
LEAN = 0.05  # farthest that the ZMP goes off the middle of both feet [m]
MOMENTUM_RATE = 15.0  # at which a surplus of angular momentum dies out, where a planner regards it [1/s]


class Steps(Pendulum):
    """Changes the steps of the pendulum while walking; a subclass says by how much."""

    regards_momentum = False

    def change(self, n, state):
        """Change of the step from footstep n to the next one, shape (2,) [m].

        Of the state at the end of the support on n: deviation of the COM from that of the footstep, and of
        its velocity, shape (2, 2) [m, m/s].
        """
        raise NotImplementedError

    def after(self, state, zmp, rate, time):
        """Position and velocity, each (2,) or (n, 2), some time later over a ZMP that moves at a rate."""
        cosh, sinh = np.cosh(self.w * time), np.sinh(self.w * time) / self.w
        x, v = state[0] - zmp, state[1] - rate
        return np.array([zmp + rate * time + x * cosh + v * sinh, rate + x * self.w**2 * sinh + v * cosh])

    def deviate(self, time, off, surplus):
        """The closed loop from here on, see :meth:`Pendulum.deviate`."""
        moment = -MOMENTUM_RATE * self.regards_momentum * surplus  # dies out; so does the COM that it forces
        arm = moment[::-1] * [-1.0, 1.0] / self.first.weight
        forced = arm / ((MOMENTUM_RATE / self.w) ** 2 - 1.0)
        begins, zmp = self.closed_loop(time, off - np.array([forced, -MOMENTUM_RATE * forced]))
        times = self.samples(time, self.switches[-1], begins)
        zmp = np.column_stack([np.interp(times, begins, axis) for axis in zmp.T])
        fade = np.exp(-MOMENTUM_RATE * (times - time))[:, None]
        moves = self.motion(times, zmp - arm * fade, off)
        return times, moves, zmp, moment * fade if self.regards_momentum else None

    def closed_loop(self, time, state):
        """Move footsteps and ZMP from a deviation on; times of the knots (K,), the ZMP's own (K, 2)."""
        k = int(np.searchsorted(self.times, time, side="right"))
        share = (time - self.times[k - 1]) / (self.times[k] - self.times[k - 1])
        at = (1.0 - share) * self.weights[k - 1] + share * self.weights[k]
        times, zmps, changes = [time], [at @ self.moved], 0
        leant = np.zeros_like(self.rolls)
        for knot in range(k, len(self.times)):
            within = knot == k and knot - 1 in self.stands
            if knot in self.stands or within:
                begin = knot - within
                leant[begin : begin + 2] = lean = self.lean(begin, times[-1], state, zmps[-1])
                zmps[-1] = zmps[-1] + within * lean
            zmp, span = self.weights[knot] @ self.moved + leant[knot], self.times[knot] - times[-1]
            state = self.after(state, zmps[-1], (zmp - zmps[-1]) / span, span)
            times, zmps = [*times, self.times[knot]], [*zmps, zmp]
            n = self.lands.get(knot, -1)
            lands = n >= 0 and knot + 1 not in self.stands and (knot > k or span > FREEZE)
            if lands and changes < CHANGES:
                changes += 1
                change = self.change(n, state - [self.moved[n], np.zeros(2)])
                self.moved[n + 1 :] = self.moved[n] + self.limited(n + 1, change)
        return np.array(times), np.array(zmps)

    def lean(self, stand, time, state, zmp):
        """How far the ZMP goes off the middle of a stand for the DCM to end where the ZMP is, (2,) [m]."""
        ahead = np.arange(len(self.times))[stand : stand + 3]
        ahead = ahead[self.times[ahead] > time]
        times = np.append(time, self.times[ahead])
        wanted = self.bounded(times, np.vstack([zmp, self.weights[ahead] @ self.moved]))[0]
        leant = np.append(self.times[stand] <= time, ahead < stand + 2)[:, None] + np.zeros(2)
        by_lean = self.bounded(times, leant)[0]
        return np.clip((state[0] + state[1] / self.w - wanted) / by_lean, -LEAN, LEAN)

    def limited(self, n, change):
        """The change of the step to a footstep within the reach of its foot, shape (2,) [m]."""
        c, s = np.cos(self.headings[n]), np.sin(self.headings[n])
        turn = np.array([[c, -s], [s, c]])
        return turn @ np.clip(turn.T @ change, *REACH[self.sides[n]])
