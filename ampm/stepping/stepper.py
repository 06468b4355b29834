"""What the stabiliser that steps reads beside the workspace of a tick."""

from typing import Any, NamedTuple

from ampm.geometry import Array


class Curves(NamedTuple):
    """Horizontal curves of a phase at equal intervals, shapes (n, 2) [m]."""

    r: Array  # `c - cdd / omega^2`
    xi: Array  # DCM
    zmp: Array  # ZMP


class Stepper(NamedTuple):
    """Constants and phase of a walk that may leave its plan."""

    omega: float  # `sqrt(g / H)` of the pendulum [1/s]
    tick: float  # control period [s]
    size: float  # size of the body, 1 for a stature of 1.70 m [1]
    foot_width: float  # [m]
    slope: Array  # of the plan's floor: dz/dx, dz/dy, shape (2,) [1]
    curves: Curves  # of the phase
    table: Any  # references of the phase at equal intervals, see `rows_of`
