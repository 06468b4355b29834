"""What a walk leaves behind while it runs: arrays filled step by step, sorted out when it is over."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import mujoco
    from numpy.typing import NDArray

_FRICTION_ROWS = 3  # of a contact of a point on the floor: normal and two tangents
_LIMIT_ROWS = 2  # of a joint at its limits
_BLOCK = 1024  # steps whose contacts are kept as MuJoCo has them; all of a long walk would fill the memory


@dataclass
class RunLog:
    """Preallocated arrays of K steps with P sole points; rows beyond the steps done have no meaning.

    Attributes:
        q, qd: MuJoCo's state where every step starts and the last one ends, (K + 1, nq), (K + 1, nv).
        torque: (K, nu) [N m].
        warmstart: what the constraint solver starts from, (K, nv).
        sites: positions of all sites, (K + 1, nsite, 3) [m].
        rotation: of both soles, (K + 1, 2, 9).
        sensors: all readings, (K + 1, nsensordata).
        force, position, depth: of the sole points, (K, P, 3) [N], (K, P, 3) [m], (K, P) [m]; sorted so far.
        point, address: sole point and first constraint row of every contact of the block of B steps that is
            not sorted yet, -1 for none, (B, P).
        frame, place, distance: of every contact, (B, P, 9), (B, P, 3), (B, P).
        constraint_force: of all constraints, (B, rows) [N].
        sorted: steps whose contacts are sorted.
    """

    q: NDArray[np.float64]
    qd: NDArray[np.float64]
    torque: NDArray[np.float64]
    warmstart: NDArray[np.float64]
    sites: NDArray[np.float64]
    rotation: NDArray[np.float64]
    sensors: NDArray[np.float64]
    force: NDArray[np.float64]
    position: NDArray[np.float64]
    depth: NDArray[np.float64]
    point: NDArray[np.intp]
    address: NDArray[np.intp]
    frame: NDArray[np.float64]
    place: NDArray[np.float64]
    distance: NDArray[np.float64]
    constraint_force: NDArray[np.float64]
    sorted: int = 0

    @classmethod
    def empty(cls, steps: int, model: mujoco.MjModel, points: int) -> RunLog:
        """Room for that many steps."""
        block = min(steps, _BLOCK)
        return cls(
            q=np.empty((steps + 1, model.nq)),
            qd=np.empty((steps + 1, model.nv)),
            torque=np.empty((steps, model.nu)),
            warmstart=np.empty((steps, model.nv)),
            sites=np.empty((steps + 1, model.nsite, 3)),
            rotation=np.empty((steps + 1, 2, 9)),
            sensors=np.empty((steps + 1, model.nsensordata)),
            force=np.zeros((steps, points, 3)),
            position=np.zeros((steps, points, 3)),
            depth=np.zeros((steps, points)),
            point=np.full((block, points), -1, dtype=np.intp),
            address=np.full((block, points), -1, dtype=np.intp),
            frame=np.zeros((block, points, 9)),
            place=np.zeros((block, points, 3)),
            distance=np.zeros((block, points)),
            constraint_force=np.zeros((block, _FRICTION_ROWS * points + _LIMIT_ROWS * model.njnt)),
        )

    def keep_contacts(self, k: int, data: mujoco.MjData, point: NDArray[np.intp]) -> NDArray[np.float64]:
        """Copy the contacts of step k as they are; they are sorted out block by block.

        Args:
            k: step.
            data: after ``mj_step2``.
            point: sole point of every contact, -1 for none.

        Returns:
            The sole points' normal forces, shape (P,) [N].
        """
        if k - self.sorted >= len(self.point):
            self._sort(k)
        row = k - self.sorted
        n, rows = data.ncon, data.nefc
        normal = np.zeros(self.point.shape[1] + 1)
        if n:
            contact = data.contact
            address = contact.efc_address
            self.point[row, :n], self.address[row, :n] = point, address
            self.frame[row, :n], self.place[row, :n] = contact.frame, contact.pos
            self.distance[row, :n] = contact.dist
            self.constraint_force[row, :rows] = data.efc_force
            normal[point] = self.constraint_force[row].take(address)
        return normal[:-1]  # the last stands for all that is no sole point

    def sole_contacts(
        self, done: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Force (K, P, 3) [N], place (K, P, 3) and depth (K, P) [m] of every sole point in the steps done."""
        self._sort(done)
        return self.force[:done], self.position[:done], self.depth[:done]

    def _sort(self, end: int) -> None:
        """Sort out the contacts of the block, up to but without step ``end``, and clear it."""
        count = max(end - self.sorted, 0)
        force, place, depth = (a[self.sorted :] for a in (self.force, self.position, self.depth))
        step, slot = np.nonzero((self.point[:count] >= 0) & (self.address[:count] >= 0))
        point = self.point[step, slot]
        rows = self.address[step, slot, None] + np.arange(_FRICTION_ROWS)
        local = self.constraint_force[step[:, None], rows]
        # A point is a sphere over a plane: one contact at most.
        force[step, point] = np.einsum("ck,ckj->cj", local, self.frame[step, slot].reshape(-1, 3, 3))
        place[step, point], depth[step, point] = self.place[step, slot], -self.distance[step, slot]
        self.point[:count] = -1
        self.sorted += count
