"""Wanted momentum rate of the body, which is the net wrench of the ground."""

from ampm.compiled import compiled
from ampm.control.workspace import Workspace, Wrench
from ampm.geometry import Array
from ampm.vectors import Vector, column, cross, minus, plus, put, times, vector


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
def command_wrench(work: Workspace, tilt: Vector) -> None:
    """Write the net ground wrench: the plan's, plus feedback of COM, momentum and trunk.

    With c the COM, p and L momentum and angular momentum about it, and bars for the plan::

        f = m (cdd_bar + g e_z) + com_damping (p_bar - p) + m com_stiffness (c_bar - c)
        n = Ld_bar + momentum_gain (L_wanted - L),    L_wanted = L_bar + trunk_gain (tilt_bar - tilt)_xy

    The periodic motion is an unstable orbit: a trunk that has tilted is brought back by a little more or less
    angular momentum than planned, slowly.

    ``tilt`` takes the trunk to the planned one [rad]. Written are f, n, L_wanted and the ZMP on z = 0.
    """
    gains, body, wanted, rates, command = work.gains, work.body, work.wanted, work.tasks.rates, work.command
    mass, com = body.mass, vector(body.com)
    force = plus(vector(wanted.com_acceleration), (0.0, 0.0, body.gravity))
    off_rate = minus(vector(wanted.com_velocity), vector(rates[0:3]))
    force = plus(force, times(gains.com_damping, off_rate))
    force = times(mass, plus(force, times(gains.com_stiffness, minus(vector(wanted.com), com))))
    upright = times(gains.trunk_gain, (tilt[0], tilt[1], 0.0))
    momentum = plus(vector(wanted.angular_momentum), upright)
    error = minus(momentum, times(mass, vector(rates[3:6])))
    moment = plus(vector(wanted.moment), times(gains.momentum_gain, error))
    put(command.force, force)
    put(command.moment, moment)
    put(command.angular_momentum, momentum)
    write_zmp(body.com, command)


@compiled
def write_zmp(com: Array, command: Wrench) -> None:
    """Write the ZMP on z = 0 of a commanded force and moment about the COM."""
    force, moment = command.force, command.moment
    command.zmp[0] = com[0] - (com[2] * force[0] + moment[1]) / force[2]
    command.zmp[1] = com[1] - (com[2] * force[1] - moment[0]) / force[2]
