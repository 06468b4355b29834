"""What the stabiliser that steps knows of its phase and body, besides its state."""

from typing import Any, NamedTuple

from ampm.control.workspace import Array, Flags, PlacedBody


class Curves(NamedTuple):
    """Horizontal curves of a phase at equal intervals, shapes (n, 2) [m].

    Attributes:
        r: ``c - cdd / omega^2``.
        xi: DCM.
        zmp: ZMP.
    """

    r: Array
    xi: Array
    zmp: Array


class Stepper(NamedTuple):
    """A walk that may leave its plan.

    Attributes:
        state: table of one :class:`~ampm.control.workspace.SteppingState`.
        body: placed at this tick.
        contact: sole points that touch at this tick, shape (P,).
        rates: momentum and angular momentum over the mass, shape (6, ...).
        omega: ``sqrt(g / H)`` of the pendulum [1/s].
        tick: control period [s].
        size: size of the body, 1 for a stature of 1.70 m [1].
        foot_width: [m].
        curves: of the phase.
        table: references of the phase at equal intervals, see :func:`~ampm.control.workspace.rows_of`.
    """

    state: Any
    body: PlacedBody
    contact: Flags
    rates: Array
    omega: float
    tick: float
    size: float
    foot_width: float
    curves: Curves
    table: Any
