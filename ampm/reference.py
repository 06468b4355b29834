"""What a controller is handed each tick: the reference of one instant, or the table of many.

Vectors are in world: x forward, y left, z up, floor at z = 0. Feet: left first. Contact groups of a foot:
heel, ball, tip.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Scalar = Any  # a float at one instant, an array (T,) at T of them


class FeetState(NamedTuple):
    """Both feet at one instant; T instants have a leading axis.

    Attributes:
        position: of the soles' reference points, shape (2, 3) [m].
        velocity: shape (2, 3) [m/s].
        acceleration: shape (2, 3) [m/s^2].
        rotation: of the soles to world, shape (2, 3, 3).
        angular_velocity: shape (2, 3) [rad/s].
        angular_acceleration: shape (2, 3) [rad/s^2].
        toe: angle, velocity and acceleration of the toe joints, shape (2, 3) [rad, rad/s, rad/s^2].
    """

    position: Array
    velocity: Array
    acceleration: Array
    rotation: Array
    angular_velocity: Array
    angular_acceleration: Array
    toe: Array


class ContactState(NamedTuple):
    """Planned contact at one instant; T instants have a leading axis.

    Attributes:
        planned: groups in contact, shape (2, 3), bool.
        due: groups in contact now or shortly: what touches early is taken as contact, shape (2, 3), bool.
        until_lift: time until the group lifts off, infinite if it does not, shape (2, 3) [s].
    """

    planned: Flags
    due: Flags
    until_lift: Array


class PostureState(NamedTuple):
    """Whole-body configuration at one instant, Pinocchio's coordinates; T instants have a leading axis.

    Attributes:
        q: shape (nq,).
        v, acceleration: root part in root axes, shape (nv,).
        trunk: rotation of the trunk segment to world, shape (3, 3).
        angular_momentum_z: about the COM, shape () [N m s].
        tilt_window: time over which the controller averages the trunk's tilt [s]; 0: not at all, as for a
            posture that plans the trunk's motion within a step.
    """

    q: Array
    v: Array
    acceleration: Array
    trunk: Array
    angular_momentum_z: Scalar
    tilt_window: Scalar = 0.0


@cache
def reference_type(nq: int, nv: int) -> np.dtype[Any]:
    """One row of a table of references, which a controller copies at once.

    The same object for the same body: NumPy copies a row of the very same type four times as fast.

    Args:
        nq: size of Pinocchio's configuration.
        nv: size of its velocity.
    """
    feet = [(f"foot_{name}", float, (2, 3)) for name in FeetState._fields if name != "rotation"]
    fields = [
        ("time", float),
        ("com", float, (3,)),
        ("com_velocity", float, (3,)),
        ("com_acceleration", float, (3,)),
        ("angular_momentum", float, (3,)),
        ("moment", float, (3,)),
        ("right_load", float),
        ("jumps", bool),
        *feet,
        ("foot_rotation", float, (2, 3, 3)),
        ("planned", bool, (2, 3)),
        ("due", bool, (2, 3)),
        ("until_lift", float, (2, 3)),
        ("q", float, (nq,)),
        ("v", float, (nv,)),
        ("acceleration", float, (nv,)),
        ("trunk", float, (3, 3)),
        ("tilt_window", float),
    ]
    return np.dtype(fields, align=True)


class _Field:
    """A field of a reference's row as its attribute."""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, reference: Reference, owner: type | None = None) -> Any:
        return reference.row[self.name]


class Reference:
    """Reference of a controller at one instant; T instants have a leading axis, see :class:`ReferenceTable`.

    Args:
        row: of :func:`reference_type`; every attribute is a view of it.

    Attributes:
        time: [s].
        com: centre of mass, shape (3,) [m].
        com_velocity: shape (3,) [m/s].
        com_acceleration: shape (3,) [m/s^2].
        angular_momentum: about the COM; x and y are the plan's, z the posture's, shape (3,) [N m s].
        moment: rate of the angular momentum, shape (3,) [N m].
        right_load: share of the weight planned on the right foot [1].
        jumps: whether the plan's acceleration jumps at this tick of a first-order hold, or at the last one.
    """

    __slots__ = ("row",)

    time = _Field()
    com = _Field()
    com_velocity = _Field()
    com_acceleration = _Field()
    angular_momentum = _Field()
    moment = _Field()
    right_load = _Field()
    jumps = _Field()

    def __init__(self, row: Any) -> None:
        self.row = row

    @classmethod
    def of(
        cls,
        *,
        time: ArrayLike,
        com: ArrayLike,
        com_velocity: ArrayLike,
        com_acceleration: ArrayLike,
        angular_momentum: ArrayLike,
        moment: ArrayLike,
        right_load: ArrayLike,
        feet: FeetState,
        contacts: ContactState,
        posture: PostureState,
        jumps: ArrayLike = False,
    ) -> Self:
        """Copy the parts into a new reference; T instants have a leading axis.

        Args are the attributes of this class.

        Raises:
            ValueError: a part has another shape, or another number of instants.
        """
        parts: dict[str, Any] = {
            "time": time,
            "com": com,
            "com_velocity": com_velocity,
            "com_acceleration": com_acceleration,
            "angular_momentum": angular_momentum,
            "moment": moment,
            "right_load": right_load,
            "jumps": jumps,
            **{f"foot_{name}": part for name, part in feet._asdict().items()},
            **contacts._asdict(),
            **posture._asdict(),
        }
        del parts["angular_momentum_z"]  # is in the angular momentum
        row = np.zeros(np.shape(time), reference_type(np.shape(posture.q)[-1], np.shape(posture.v)[-1]))
        for name, part in parts.items():
            if np.ndim(part) and np.shape(part) != row[name].shape:
                raise ValueError(
                    f"{name} of a reference has shape {np.shape(part)} and must have {row[name].shape}"
                )
            row[name] = part
        return cls(row)

    def replace(self, **fields: ArrayLike) -> Self:
        """A copy with other values of some fields, by the names of :func:`reference_type`."""
        row = self.row.copy()  # np.array() would share the memory of one row
        for name, value in fields.items():
            row[name] = value
        return type(self)(row)

    @property
    def feet(self) -> FeetState:
        """Pose and motion of both feet."""
        return FeetState(*(self.row[f"foot_{name}"] for name in FeetState._fields))

    @property
    def contacts(self) -> ContactState:
        """Which groups carry load."""
        return ContactState(self.row["planned"], self.row["due"], self.row["until_lift"])

    @property
    def posture(self) -> PostureState:
        """Whole-body posture."""
        row = self.row
        return PostureState(
            row["q"],
            row["v"],
            row["acceleration"],
            row["trunk"],
            row["angular_momentum"][..., 2],
            row["tilt_window"],
        )


class Timing(NamedTuple):
    """Times by which a controller's references look ahead.

    Attributes:
        lead: time by which a foot is let down before its planned contact [s].
        early: time before planned contact from which a touch counts as contact [s].
        hold: how long after the tick the last force of its command acts [s]: zero if every tick makes one
            step of the physics. Where the torque is held, accelerations are those of the middle of that time.
        slope: period of ticks between which the torque goes on with its slope [s]: it is then held only where
            the plan jumps. Zero: it is always held.
    """

    lead: float = 0.0
    early: float = 0.0
    hold: float = 0.0
    slope: float = 0.0


SHARP = Timing()
"""No look-ahead."""


class ReferenceTable(Reference):
    """References at T instants, evaluated at once: arrays have a leading axis of T.

    Args:
        row: array of :func:`reference_type`, shape (T,); it becomes read-only.
    """

    __slots__ = ()

    def __init__(self, row: Any) -> None:
        row.setflags(write=False)
        super().__init__(row)

    def __len__(self) -> int:
        return len(self.row)

    def __getitem__(self, k: int) -> Reference:
        """The reference at tick k."""
        return Reference(self.row[k])

    def __iter__(self) -> Iterator[Reference]:
        return map(Reference, self.row)

    def part(self, start: int, stop: int) -> ReferenceTable:
        """The references of ticks start ... stop - 1, without a copy."""
        return ReferenceTable(self.row[start:stop])
