"""Steps by the step-to-step dynamics of the hybrid linear inverted pendulum (H-LIP).

Xiong & Ames, "3-D underactuated bipedal walking via H-LIP based gait synthesis and stepping stabilization",
IEEE T-RO 38(4), 2022.

On one foot x'' = w^2 x, with x of the COM from the foot; on both feet x'' = 0. From the end of one single
support to the end of the next one, after a double support of T_D, a step u and a single support of T_S::

    (x, v) <- A (x, v) + B u,   A = S [[1, T_D], [0, 1]],   B = S (-1, 0),
    S = [[cosh(w T_S), sinh(w T_S) / w], [w sinh(w T_S), cosh(w T_S)]]

The robot's own steps obey this but for an error. Feedback u = u* + K ((x, v) - (x*, v*)) on the deviation
from the walk that is wanted keeps the error within a bound. Two gains of the paper:

- deadbeat: K = (1, T_D + coth(w T_S) / w) brings the pendulum back in two steps;
- LQR: K of the discrete Riccati equation, softer.

Here the walk that is wanted is the plan without disturbances. In double support its ZMP moves linearly, which
is the error of the model. The weights of the LQR give 1 m of COM, 1 m of v / w and 1 m of step the same cost;
they were not tuned.
"""

import numpy as np
from scipy import linalg

from examples.planners.steps import Steps


def step_to_step(w, single, double):
    """A (2, 2) and B (2,) of the dynamics from one end of single support to the next one [s, 1/s]."""
    cosh, sinh = np.cosh(w * single), np.sinh(w * single)
    support = np.array([[cosh, sinh / w], [w * sinh, cosh]])
    return support @ [[1.0, double], [0.0, 1.0]], -support[:, 0]


def deadbeat(w, single, double):
    """Gain of the feedback that needs two steps, shape (2,) [1, s]."""
    return np.array([1.0, double + 1.0 / np.tanh(w * single) / w])


def regulator(w, single, double):
    """Gain of the linear quadratic regulator, shape (2,) [1, s]."""
    A, B = step_to_step(w, single, double)
    Q, R, B = np.diag([1.0, w**-2]), np.eye(1), B[:, None]
    P = linalg.solve_discrete_are(A, B, Q, R)
    return -np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)[0]


class Deadbeat(Steps):
    """H-LIP with the feedback that needs two steps."""

    gain = staticmethod(deadbeat)

    def change(self, n, state):
        """Change of the step from footstep n to the next one, see :meth:`Steps.change`."""
        (_, lifts), (begins, ends) = self.alone[n : n + 2]
        return self.gain(self.w, ends - begins, begins - lifts) @ state


class Lqr(Deadbeat):
    """H-LIP with the linear quadratic regulator."""

    gain = staticmethod(regulator)
