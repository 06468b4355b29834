"""A walk without a plan, as its record alone shows it: what stands, and the velocity in its own heading."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import grey_closing, grey_opening

from ampm.geometry import Array
from validation.trial.record import SimulationRecord

SHORTEST = 0.05
"""Time up to which a contact, or a gap in it, is a bounce and no support or swing [s]."""


def measured_supports(record: SimulationRecord) -> tuple[NDArray[np.int8], int]:
    """What stands at K steps of the physics, and how often a foot touched down, by the forces on the soles.

    The first has shape (K,): 0 left, 1 right, 2 both; in flight that of before.
    """
    loaded = record.point_force[:, :, 2] > 0.0
    down = np.stack([loaded[:, record.point_foot == foot].any(axis=1) for foot in (0, 1)])
    size = 1, 2 * round(0.5 * SHORTEST / record.time_step) + 1
    down = grey_opening(grey_closing(down, size, mode="nearest"), size, mode="nearest")
    landings = int(np.count_nonzero(~down[:, :-1] & down[:, 1:]))
    last = np.maximum.accumulate(np.where(down.any(axis=0), np.arange(down.shape[1]), 0))
    left, right = down[:, last]
    return np.where(left & right, 2, np.where(right, 1, 0)).astype(np.int8), landings


def heading_velocity(record: SimulationRecord) -> Array:
    """Velocity of the COM along and across the root's heading, and the heading's rate, over every step.

    The heading counts from that at the start. Shape (K, 3) [m/s, m/s, rad/s].
    """
    w, x, y, z = record.q[:, 3:7].T
    heading = np.unwrap(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
    turned = heading[:-1] - heading[:1]
    vx, vy = (np.diff(record.com[:, :2], axis=0) / record.time_step).T
    c, s = np.cos(turned), np.sin(turned)
    return np.column_stack([c * vx + s * vy, c * vy - s * vx, np.diff(heading) / record.time_step])
