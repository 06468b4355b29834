"""Step placement by the angular momentum about the contact (ALIP).

Gong & Grizzle, "Zero dynamics, pendulum models, and angular momentum in feedback control of bipedal
locomotion", ASME Journal of Dynamic Systems, Measurement, and Control 144(12), 2022.

State are the COM x from the contact and the angular momentum L about the contact, of the whole body::

    x' = L / (m H),   L' = m g x,   w = sqrt(g / H)

(L as it stands here turns the body forward; sideways the signs change.) It is continuous when the contact
changes on level floor. At the end of the next step of duration T it will be, with x from the old contact and
the new contact u ahead of it::

    L(T) = m H w sinh(w T) (x - u) + cosh(w T) L

So one step brings it to what is wanted: u = x + L coth(w T) / (m H w). Here x and L are deviations from the
walk without disturbances, L is wanted to be that walk's, the contact changes in the middle of the double
support, and the sole rolls as that of the other planners. L has the angular momentum about the COM in it,
whose surplus dies out in the plan (`MOMENTUM_RATE` of steps.py).

It has no constants of its own.
"""

import numpy as np

from examples.planners.steps import Steps


def wanted_step(w, duration, x, speed):
    """Step after which, a duration later [s], L is zero; of x [m] and L / (m H) at the change of contact."""
    return x + speed / np.tanh(w * duration) / w


class Alip(Steps):
    """Steps where the angular momentum about the contact will be that of the plan at the end of the step."""

    regards_momentum = True

    def change(self, n, state):
        """Change of the step from footstep n to the next one, see :meth:`Steps.change`."""
        (_, lifts), (begins, ends) = self.alone[n : n + 2]
        half = 0.5 * (begins - lifts)
        x, speed = self.after(state, 0.0, 0.0, half)
        return wanted_step(self.w, ends - begins + 2.0 * half, x, speed)
