"""Wanted momentum rate of the body, which is the net wrench of the ground."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ampm.compiled import compiled
from ampm.vectors import Vector, column, cross, minus, plus, put, times, vector

Array = NDArray[np.float64]


@compiled
def rotation_error(wanted: Array, actual: Array) -> Vector:
    """Small rotation vector in world axes that takes ``actual`` to ``wanted``, shapes (3, 3) [rad].

    Half the sum of ``a x w`` over the axes of both: the skew part of ``wanted actual^T``.
    """
    total = cross(column(actual, 0), column(wanted, 0))
    for k in (1, 2):
        total = plus(total, cross(column(actual, k), column(wanted, k)))
    return times(0.5, total)


@compiled
def command_wrench(
    gains: Any,
    mass: float,
    gravity: float,
    centre: Array,
    tilt: Vector,
    com: Vector,
    rates: Array,
    out: Array,
) -> None:
    """Net ground wrench: the plan's, plus feedback of COM, momentum and trunk.

    With c the COM, p and L momentum and angular momentum about it, and bars for the plan::

        f = m (cdd_bar + g e_z) + com_damping (p_bar - p) + m com_stiffness (c_bar - c)
        n = Ld_bar + momentum_gain (L_wanted - L),    L_wanted = L_bar + trunk_gain (tilt_bar - tilt)_xy

    The periodic motion is an unstable orbit: a trunk that has tilted is brought back by a little more or less
    angular momentum than planned, slowly.

    Args:
        gains: of the controller.
        mass: [kg].
        gravity: [m/s^2].
        centre: of the :class:`~ampm.walk.Reference`, shape (5, 3).
        tilt: rotation from the trunk to the planned one [rad].
        com: [m].
        rates: momentum and angular momentum over the mass, shape (6, ...).
        out: f [N], n [N m], L_wanted [N m s] and the ZMP on the floor of this wrench [m], shape (11,).
    """
    gain = gains[0]
    planned, velocity, acceleration = vector(centre[0]), vector(centre[1]), vector(centre[2])
    force = plus(acceleration, (0.0, 0.0, gravity))
    force = plus(force, times(gain.com_damping, minus(velocity, vector(rates[0:3]))))
    force = times(mass, plus(force, times(gain.com_stiffness, minus(planned, com))))
    wanted = plus(vector(centre[3]), times(gain.trunk_gain, (tilt[0], tilt[1], 0.0)))
    momentum = times(mass, vector(rates[3:6]))
    moment = plus(vector(centre[4]), times(gain.momentum_gain, minus(wanted, momentum)))
    put(out[0:3], force)
    put(out[3:6], moment)
    put(out[6:9], wanted)
    out[9] = com[0] - (com[2] * force[0] + moment[1]) / force[2]
    out[10] = com[1] - (com[2] * force[1] - moment[0]) / force[2]
