"""Phase, body and state of the stabiliser that steps."""

from typing import Any, NamedTuple

from ampm.control.workspace import PlacedBody
from ampm.geometry import Array, Flags


class Curves(NamedTuple):
    """Horizontal curves of a phase at equal intervals, shapes (n, 2) [m]."""

    r: Array  # `c - cdd / omega^2`
    xi: Array  # DCM
    zmp: Array  # ZMP


class Stepper(NamedTuple):
    """Body and phase of a walk that may leave its plan, and its state."""

    state: Any  # table of one `SteppingState`
    body: PlacedBody  # placed at this tick
    contact: Flags  # sole points that touch at this tick, shape (P,)
    rates: Array  # momentum and angular momentum over the mass, shape (6, ...)
    omega: float  # `sqrt(g / H)` of the pendulum [1/s]
    tick: float  # control period [s]
    size: float  # size of the body, 1 for a stature of 1.70 m [1]
    foot_width: float  # [m]
    slope: Array  # of the plan's floor: dz/dx, dz/dy, shape (2,) [1]
    curves: Curves  # of the phase
    table: Any  # references of the phase at equal intervals, see `rows_of`
