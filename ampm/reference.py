"""What a controller is handed each tick: the reference of one instant, or the table of many.

Vectors are in world: x forward, y left, z up, floor at z = 0. Feet: left first. Contact groups of a foot:
heel, ball, tip.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from ampm.geometry import Array
from ampm.planner.feet import foot_rotation

Scalar = Any  # a float at one instant, an array (T,) at T of them


class PostureState(NamedTuple):
    """Whole-body configuration at one instant, Pinocchio's coordinates; T instants have a leading axis."""

    q: Array  # shape (nq,)
    v: Array  # root part in root axes, shape (nv,)
    acceleration: Array  # likewise
    trunk: Array  # rotation of the trunk segment to world, shape (3, 3)
    angular_momentum_z: Scalar  # about the COM, shape () [N m s]
    # time over which the controller averages the trunk's tilt [s]; 0: not at all, as for a posture that plans
    # the trunk's motion within a step
    tilt_window: Scalar = 0.0


@dataclass
class Field:
    """One quantity of a reference: one row of the table that :class:`Reference` is."""

    shape: tuple[int | str, ...]  # at one instant; "nq" and "nv" are the sizes of Pinocchio's coordinates
    sample: Callable[[Any], ArrayLike]  # from :class:`ampm.walk.Instants`, with a leading axis of T
    kind: type = float  # of its numbers
    smooth: bool = True  # whether the stepping stabiliser interpolates it between the rows of a table

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, reference: Any, owner: type | None = None) -> Any:
        return self if reference is None else reference.row[self.name]


class Reference:
    """Reference of a controller at one instant, or at T instants with a leading axis; read-only.

    Of T instants, ``reference[k]`` is that of one, and ``reference[start:stop]`` those of some, not copied.

    Vectors are in world, of the feet the left one first. The fields below are a table: the row's type, these
    attributes, the arrays of compiled functions and what a :class:`~ampm.walk.WalkPlan` gives follow from it.

    Args:
        row: of :func:`reference_type`; every attribute is a view of it.
    """

    __slots__ = ("row",)

    com = Field((3,), lambda at: at.now.plan.com)
    """Position of the centre of mass, shape (3,) [m]."""
    com_velocity = Field((3,), lambda at: at.now.plan.com_velocity)
    """Velocity of the centre of mass, shape (3,) [m/s]."""
    com_acceleration = Field((3,), lambda at: at.held.plan.com_acceleration)
    """Acceleration of the centre of mass, shape (3,) [m/s^2]."""
    angular_momentum = Field(
        (3,), lambda at: np.column_stack([at.now.plan.angular_momentum, at.now.posture.angular_momentum_z])
    )
    """Angular momentum about the COM; x and y are the plan's, z the posture's, shape (3,) [N m s]."""
    moment = Field((3,), lambda at: np.column_stack([at.held.plan.moment, at.yaw_moment]))
    """Rate of the angular momentum, shape (3,) [N m]."""
    right_load = Field((), lambda at: at.now.plan.right_load)
    """Share of the weight planned on the right foot [1]."""
    foot_position = Field((2, 3), lambda at: at.now.both_feet("position"))
    """Positions of the soles' reference points, shape (2, 3) [m]."""
    foot_velocity = Field((2, 3), lambda at: at.now.both_feet("velocity"))
    """Velocities of these points, shape (2, 3) [m/s]."""
    foot_acceleration = Field((2, 3), lambda at: at.held.both_feet("acceleration"))
    """Accelerations of these points, shape (2, 3) [m/s^2]."""
    foot_rotation = Field(
        (2, 3, 3), lambda at: foot_rotation(*map(at.now.both_feet, ("heading", "pitch", "roll")))
    )
    """Rotations of the soles to world, shape (2, 3, 3)."""
    foot_angular_velocity = Field((2, 3), lambda at: at.now.turning(0))
    """Angular velocities of the soles, shape (2, 3) [rad/s]."""
    foot_angular_acceleration = Field((2, 3), lambda at: at.held.turning(1))
    """Angular accelerations of the soles, shape (2, 3) [rad/s^2]."""
    foot_toe = Field(
        (2, 3),
        lambda at: np.stack(
            [*map(at.now.both_feet, ("toe", "toe_velocity")), at.held.both_feet("toe_acceleration")], axis=2
        ),
    )
    """Angle, velocity and acceleration of the toe joints, shape (2, 3) [rad, rad/s, rad/s^2]."""
    q = Field(("nq",), lambda at: at.now.posture.q)
    """Configuration of the body, as of :class:`~ampm.walk.State`, shape (nq,) [m, rad]."""
    v = Field(("nv",), lambda at: at.now.posture.v)
    """Velocity of the body, root part in root axes, shape (nv,) [m/s, rad/s]."""
    acceleration = Field(("nv",), lambda at: at.held.posture.acceleration)
    """Acceleration of the body, root part in root axes, shape (nv,) [m/s^2, rad/s^2]."""
    trunk = Field((3, 3), lambda at: at.now.posture.trunk)
    """Rotation of the trunk segment to world, shape (3, 3)."""
    time = Field((), lambda at: at.times, smooth=False)
    """Time on the walk's clock [s]."""
    jumps = Field((), lambda at: at.jumps, bool, smooth=False)
    """Whether the plan's acceleration jumps at this tick of a first-order hold, or at the last one."""
    planned = Field((2, 3), lambda at: at.contact_within(at.timing.lead), bool, smooth=False)
    """Groups planned in contact, shape (2, 3), bool."""
    due = Field((2, 3), lambda at: at.contact_within(at.timing.early), bool, smooth=False)
    """Groups in contact now or shortly: what touches early is taken as contact, shape (2, 3), bool."""
    until_lift = Field((2, 3), lambda at: at.feet.until_lift(at.times, at.contact), smooth=False)
    """Time until the group lifts off, infinite if it does not, shape (2, 3) [s]."""
    tilt_window = Field((), lambda at: at.now.posture.tilt_window, smooth=False)
    """Time over which the controller averages the trunk's tilt [s], see :class:`PostureState`."""

    def __init__(self, row: Any) -> None:
        self.row = row

    def __len__(self) -> int:
        return len(self.row)

    def __getitem__(self, ticks: int | slice) -> Self:
        return type(self)(self.row[ticks])

    @classmethod
    def of(cls, **fields: ArrayLike) -> Self:
        """Copy values into a new reference; T instants have a leading axis.

        Args are the attributes of this class. ``time``, ``q`` and ``v`` are needed, what is left out is zero.

        Raises:
            ValueError: there is no such field, or a value has another shape or number of instants.
        """
        kind = reference_type(np.shape(fields["q"])[-1], np.shape(fields["v"])[-1])
        row = np.zeros(np.shape(fields["time"]), kind)
        for name, value in fields.items():
            if np.ndim(value) and np.shape(value) != row[name].shape:
                raise ValueError(
                    f"{name} of a reference has shape {np.shape(value)} and must have {row[name].shape}"
                )
            row[name] = value
        return cls(np.frombuffer(row.tobytes(), kind).reshape(row.shape))  # nothing makes bytes writeable

    def replace(self, **fields: ArrayLike) -> Self:
        """A copy with other values of some fields."""
        return self.of(**{name: self.row[name] for name in FIELDS} | fields)


_TABLE = [field for field in vars(Reference).values() if isinstance(field, Field)]
FIELDS = {field.name: field for field in sorted(_TABLE, key=lambda field: not field.smooth)}
"""The table of :class:`Reference`; the smooth fields come first, as one run of numbers."""


@cache
def reference_type(nq: int, nv: int) -> np.dtype[Any]:
    """One row of a table of references, which a controller copies at once.

    The same object for the same body: NumPy copies a row of the very same type four times as fast.
    ``nq`` and ``nv`` are the sizes of Pinocchio's configuration and velocity.
    """
    sizes: dict[int | str, int | str] = {"nq": nq, "nv": nv}
    shapes = {name: tuple(sizes.get(n, n) for n in field.shape) for name, field in FIELDS.items()}
    return np.dtype([(name, FIELDS[name].kind, shape) for name, shape in shapes.items()], align=True)


class Timing(NamedTuple):
    """Times by which a controller's references look ahead.

    Attributes:
        lead: time by which a foot is let down before its planned contact [s].
        early: time before planned contact from which a touch counts as contact [s].
        hold: how long after the tick the last force of its command acts [s]: zero if every tick makes one
            step of the physics. Where the torque is held, accelerations are those of the middle of that time.
        extrapolation: time for which the torque goes on with its slope, a tick [s]: it is then held only
            where the plan jumps. Zero: it is always held.
    """

    lead: float = 0.0
    early: float = 0.0
    hold: float = 0.0
    extrapolation: float = 0.0
