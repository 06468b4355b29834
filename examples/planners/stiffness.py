"""Closed-form centroidal motion: contacts of constant stiffness, in pieces within which the motion is exact.

Tazaki, "Trajectory generation for legged robots based on a closed-form solution of centroidal dynamics",
IEEE RA-L 9(11), 2024; equations as in the author's library, github.com/ytazz/dymp, src/centroid.cpp.

Foot i pushes the COM c away like a spring of negative stiffness, through its CMP, off its centre of pressure
c_i by r_i: f_i = m l_i^2 (c - c_i - r_i). While these are constant, with the sums l^2 = sum l_i^2 and r = sum
l_i^2 r_i / l^2, and with e = (sum l_i^2 c_i + g) / l^2, COM and angular momentum are, exactly::

    c(t) = e + r + cosh(l t) (c_0 - e - r) + sinh(l t) / l v_0
    L(t) = L_0 + m ((v(t) - v_0) x r + t n),   n = l^2 e x r - sum l_i^2 c_i x r_i

Here l^2 = g / H, so that the COM follows the height H over the ZMP, and r is the same of all feet, so that n
is g x r. The shares l_i^2 / l^2 put the ZMP between the feet. It rests for a piece, an eighth of a support,
and jumps to the next. Pieces, footsteps and costs are those of the pendulum and of the centroidal QP of this
folder; their constants, and the number of pieces, were chosen with `normal` and its pushes in view.
"""

import numpy as np

from examples.planners.centroidal import KNOTS, STRIDE, Centroidal

PIECES = 8  # of each support
JUMP = 2e-6  # duration of a jump of the ZMP, for samples on either side of it [s]


class Stiffness(Centroidal):
    """Centres of pressure, CMP and footsteps, constant in each piece."""

    climbs = True

    def set_steps(self, places, sides, headings, times):
        """Knots of the ZMP, see :meth:`Pendulum.set_steps`: two for each piece, with its mean ZMP."""
        super().set_steps(places, sides, headings, times)
        knot = np.repeat(np.arange(len(self.times) - 1), PIECES)  # before each piece
        share = np.tile((np.arange(PIECES) + 0.5) / PIECES, len(self.times) - 1)
        span = np.diff(self.times)[knot]
        begin = self.times[knot] + (share - 0.5 / PIECES) * span
        self.times = np.column_stack([begin, begin + span / PIECES - JUMP]).ravel()
        self.weights, self.rolls = (
            np.repeat(at[knot] + share[:, None] * (at[knot + 1] - at[knot]), 2, axis=0)
            for at in (self.weights, self.rolls)
        )

    def basis(self, time):
        """Pieces from now on, see :meth:`Centroidal.basis`; the last one, empty, ends the others."""
        begins = self.times[::2]
        ahead = np.append(time, begins[(begins > time + JUMP) & (begins < time + STRIDE * KNOTS)])
        ends = np.append(ahead[1:], np.inf)
        integral = np.tri(len(ahead), k=-1) * np.diff(ahead, append=ahead[-1])
        return ahead, lambda times: 1.0 * ((times[:, None] >= ahead) & (times[:, None] < ends)), integral
