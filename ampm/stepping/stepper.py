"""What the stabiliser that steps keeps from tick to tick, and what it knows of its phase and body."""

from typing import Any, NamedTuple

import numpy as np

from ampm.control.workspace import Array, Body, Flags, Wanted

WALKER = [
    ("single", np.bool_),
    ("stance", np.int64),  # foot that stands; in double support the one that leaves
    ("clock", np.float64),  # time since the phase began, by the plan [s]
    ("duration", np.float64),  # of the phase, by the plan [s]
    ("double", np.float64),  # duration of the double support that follows [s]
    ("rate", np.float64),  # of the clock [1]
    ("factor", np.float64),  # duration of the rest of the phase over the planned one [1]
    ("choice", np.int64),  # which of the candidates that is, -1 that which returns to the plan
    ("late", np.float64),  # time behind the plan [s]
    ("waited", np.float64),  # for a late foot [s]
    ("stood", np.float64),  # time since the phase began [s]
    ("step", np.float64, (2,)),  # displacement of the next step from the standing foot's shift [m]
    ("excess", np.float64),  # by which the wanted displacement is beyond its limits [m]
    ("shift", np.float64, (2, 3)),  # of every foot from where it was planned [m]
    ("swing", np.float64, (3, 3)),  # the same of the swing foot: value and two derivatives
    ("slope", np.float64, (2,)),  # of the floor: dz/dx, dz/dy [1]
    ("height", np.float64, (2,)),  # of the COM over its plan, and its rate [m, m/s]
    ("touches", np.int64, (2,)),  # ticks since every foot touched, 0 without contact
    ("sag", np.float64),  # by which the COM goes down for a long step [m]
    ("load", np.float64),  # vertical force that holds the COM's height over the commanded one [1]
    ("width", np.float64),  # planned distance of the next step from the standing foot, across [m]
    ("leaves", np.bool_),  # whether the walk has to leave its plan
    ("away", np.float64),  # largest component of the COM's distance from the plan's [m]
]
"""What a walk keeps from tick to tick. The feet's and points' places are in world."""


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
        walker: table of one entry, see :data:`WALKER`.
        body: placed at this tick.
        contact: sole points that touch at this tick, shape (P,).
        rates: momentum and angular momentum over the mass, shape (6, ...).
        omega: ``sqrt(g / H)`` of the pendulum [1/s].
        tick: control period [s].
        size: of the body, of which a stature of 1.70 m is one [1].
        foot_width: [m].
        curves: of the phase.
        table: references of the phase at equal intervals; arrays have a leading axis of n.
    """

    walker: Any
    body: Body
    contact: Flags
    rates: Array
    omega: float
    tick: float
    size: float
    foot_width: float
    curves: Curves
    table: Wanted
