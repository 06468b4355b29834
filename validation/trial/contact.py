"""Contacts of sole points among MuJoCo's, compiled."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ampm.compiled import compiled
from ampm.geometry import Array
from ampm.vectors import ZERO, cross, dot, minus, plus, times, vector


@compiled
def point_of(geoms: NDArray[np.int32], of_geom: NDArray[np.intp]) -> int:
    """Sole point of a contact by its two geoms, -1 for none."""
    return max(of_geom[geoms[0]], of_geom[geoms[1]])


@compiled
def side_of(geoms: NDArray[np.int32], of_geom: NDArray[np.intp]) -> float:
    """1 if the sole point is the second geom, on which a contact's force acts, or else -1."""
    return 1.0 if of_geom[geoms[1]] >= 0 else -1.0


@compiled
def count_velocity_product(body: Any, contacts: int, reference: Array) -> None:
    """Let contacts count the acceleration ``dJ/dt v`` of their sole points, which MuJoCo leaves out.

    MuJoCo makes ``J dv/dt`` of a point with the Jacobian J follow a reference acceleration, not the point's
    acceleration ``J dv/dt + dJ/dt v``. So what it leaves out is taken off the reference.

    Args:
        body: the state of a :class:`~validation.trial.physics.BodyState` after ``mj_step1``.
        contacts: their number.
        reference: ``efc_aref``, which this changes; ``mj_step2`` reads it [m/s^2].
    """
    of_geom, qvel, center = body.point_of_geom, body.qvel, vector(body.tree_com)
    for i in range(contacts):
        p, first = point_of(body.contact_geom[i], of_geom), body.contact_address[i]
        if p < 0 or first < 0:
            continue
        turn, shift = ZERO, ZERO  # acceleration of the segment at the tree's COM without that of the joints
        for k in range(len(qvel)):
            if body.moves_point[p, k]:
                turn = plus(turn, times(qvel[k], vector(body.axis_rate[k, 0:3])))
                shift = plus(shift, times(qvel[k], vector(body.axis_rate[k, 3:6])))
        velocity = body.segment_velocity[body.segment_of_point[p]]
        rate, arm = vector(velocity[0:3]), minus(vector(body.contact_place[i]), center)
        speed = plus(vector(velocity[3:6]), cross(rate, arm))
        acceleration = plus(plus(shift, cross(turn, arm)), cross(rate, speed))
        side = side_of(body.contact_geom[i], of_geom)
        for axis in range(3):
            along = vector(body.contact_frame[i, 3 * axis : 3 * axis + 3])
            reference[first + axis] -= side * dot(along, acceleration)
