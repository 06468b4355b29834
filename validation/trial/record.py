"""Record of a simulation, in memory or from a folder, and what it shows without a plan."""

# ruff: noqa: RUF009, since what is called makes a field

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import grey_closing, grey_opening

from ampm.exceptions import InputError
from ampm.geometry import Array, blocks
from validation.trial.files import RunFile

if TYPE_CHECKING:
    from validation.trial.followed import Followed
    from validation.trial.outcome import Outcome


FEET = ("left", "right")


def _array(
    shape: str, kind: Any = np.float64, *, logged: bool = False, file: str = "", optional: bool = False
) -> Any:
    """Field of an array with a shape in symbols, of which the first is its rate.

    ``logged`` is filled step by step, ``file`` is where it is on disk, ``optional`` is zero if left out.
    """
    metadata = {"shape": shape, "kind": kind, "logged": logged, "file": file, "optional": optional}
    return field(metadata=metadata, default_factory=lambda: None) if optional else field(metadata=metadata)


_SHORTEST = 0.05  # time up to which a contact, or a gap in it, is a bounce and no support or swing [s]
_STATE_INTERVAL = 0.01  # time between the states, and between the contacts, on disk [s]


def state_steps(time_step: float) -> int:
    """Steps of the physics from one state on disk to the next."""
    return max(1, round(_STATE_INTERVAL / time_step))


def stored_rows(steps: int, time_step: float) -> NDArray[np.intp]:
    """Instants of the states on disk: one every 10 ms, and the last one."""
    return np.append(np.arange(0, steps, state_steps(time_step)), steps)


def shape_of(name: str, sizes: Mapping[str, int]) -> tuple[int, ...]:
    """Shape of an array of the record; ``sizes`` has what its symbols stand for."""
    return tuple(sizes[symbol] if symbol in sizes else int(symbol) for symbol in SHAPES[name].split())


@dataclass(frozen=True, eq=False, kw_only=True)
class SimulationRecord:
    """Everything one simulation produced: K steps of ``time_step``, P sole points, T control ticks.

    Rows that belong to an instant have K + 1 entries (t_0 ... t_K); rows that belong to a step have K, row
    k acts over [t_k, t_(k+1)]. Vectors are in the world frame (x forward, y left, z up, floor at z = 0). All
    arrays are read-only; floats are float64. Arrays are copied, unless they and their bases are read-only
    already; then a long walk does not need its memory twice.

    The first argument of an array is its shape: T control ticks, nq and nv of MuJoCo's state, nu hinges, F
    feet, left first, S segments that anything but the floor pushed, L surfaces of the floor.

    States and contacts have a row for each of R instants, ``state_rows``, contacts without the last one.
    These are all instants, or in a folder one every 10 ms. What a folder lacks is None.
    """

    time: Array = _array("K+1")  # t_k [s]
    state_rows: NDArray[np.int64] = _array("R", np.int64)  # instants of the states, ascending
    # MuJoCo `qpos`, root position [m], root quaternion wxyz, hinges [rad]
    q: Array = _array("R nq", logged=True, file=RunFile.JOINTS)
    # MuJoCo `qvel`, root velocity in world [m/s], root angular velocity in the root [rad/s], hinges [rad/s]
    qd: Array = _array("R nv", logged=True, file=RunFile.JOINTS)
    # joint torque with which a tick begins, within the motors' limits, actuator order [N m]
    tick_torque: Array = _array("T nu", logged=True, file=RunFile.TICKS)
    # rate at which the torques of a tick go on until the next one, NaN where they are held [N m/s]
    torque_rate: Array = _array("T nu", logged=True, file=RunFile.TICKS)
    # force of the floor on the body at each sole point [N]
    point_force: Array = _array("R-1 P 3", logged=True, file=RunFile.CONTACTS)
    point_position: Array = _array("R-1 P 3", logged=True, file=RunFile.CONTACTS)  # where it acts [m]
    point_penetration: Array = _array("K P", logged=True)  # depth under the floor, >= 0 [m]
    point_place: Array = _array("K+1 P 3", logged=True)  # the sole points themselves [m]
    point_foot: NDArray[np.int8] = _array("P", np.int8)  # foot of each point, 0 left, 1 right
    point_group: NDArray[np.int8] = _array("P", np.int8)  # 0 heel, 1 ball, 2 tip
    com: Array = _array("K+1 3", logged=True)  # COM as the simulator reports it [m]
    # about the COM, as the simulator reports it [N m s]
    angular_momentum: Array = _array("K+1 3", logged=True)
    foot_position: Array = _array("K+1 F 3", logged=True)  # reference points of both soles, left first [m]
    foot_forward: Array = _array("K+1 F 3", logged=True)  # direction of their x axes
    command_com: Array = _array("K 3", logged=True)  # the controller's COM reference, held over the tick [m]
    command_zmp: Array = _array("K 2", logged=True)  # ZMP commanded [m]
    command_force: Array = _array("K 3", logged=True)  # net ground force commanded [N]
    # angular momentum about the COM commanded [N m s]
    command_angular_momentum: Array = _array("K 3", logged=True)
    tick_time: Array = _array("T")  # time of each control tick [s]
    # 0 solved, 1 solved in the form with limits, 2 unsolved
    qp_status: NDArray[np.int8] = _array("T", np.int8, logged=True, file=RunFile.TICKS)
    # largest constraint or stationarity residual of the tick's QP
    qp_residual: Array = _array("T", logged=True, file=RunFile.TICKS)
    qp_iterations: NDArray[np.int32] = _array("T", np.int32, logged=True, file=RunFile.TICKS)  # of the QP
    # wall-clock time of the solve [s]; the one column that equal runs differ in
    qp_time: Array = _array("T", logged=True, file=RunFile.TICKS)
    # number of the plan followed, 0 the first one; `STEPPING` where the stabiliser stepped off the plan
    tick_plan: NDArray[np.int32] = _array("T", np.int32, file=RunFile.TICKS, optional=True)
    outcome: Outcome  # how the run ended
    mass: float  # total mass [kg]
    gravity: float  # g, positive [m/s^2]
    time_step: float  # dt [s]
    friction: float = math.nan  # friction coefficient between sole and floor [1], NaN if unknown
    floor: Array = _array("L", optional=True)  # heights of its surfaces, ascending; empty if it slopes [m]
    torque_limit: Array = _array("nu")  # largest torque per actuator [N m]
    joint_range: Array = _array("nu 2")  # lower and upper limit per hinge [rad]
    joint_names: tuple[str, ...]  # the hinges in actuator order, nu names
    external_segments: tuple[str, ...] = ()  # the segments that anything but the floor pushed, S names
    external_force: Array = _array("K S 3", file=RunFile.EXTERNAL, optional=True)  # force on each of them [N]
    # moment on each of them [N m]
    external_moment: Array = _array("K S 3", file=RunFile.EXTERNAL, optional=True)
    # where the force acts, the segment's COM [m]
    external_position: Array = _array("K S 3", file=RunFile.EXTERNAL, optional=True)
    point_sites: tuple[str, ...] = ()  # sites of the sole points in the model, P names
    changes: int = 0  # number of plans followed after the first one
    controller: str = ""  # name of a user's, empty for the project's own
    followed: Followed | None = None  # what the plans that were followed said, not on disk; None of a log

    def __post_init__(self) -> None:
        sizes = {
            "K+1": len(self.time),
            "K": len(self.time) - 1,
            "R": len(self.state_rows),
            "R-1": len(self.state_rows) - 1,
            "nq": self.q.shape[1],
            "nv": self.qd.shape[1],
            "P": len(self.point_foot),
            "F": 2,
            "T": len(self.tick_time),
            "nu": len(self.joint_names),
            "S": len(self.external_segments),
            "L": 1 if self.floor is None else len(self.floor),
        }
        for name, symbols in SHAPES.items():
            shape, given = shape_of(name, sizes), getattr(self, name)
            if _ARRAYS[name]["optional"] and (given is None or not np.size(given)):
                given = np.zeros(shape)
            elif given is None and name not in STORED:
                continue
            value = _frozen(given, INTEGERS.get(name, np.float64))
            if value.shape != shape:
                raise InputError(f"record: {name} has shape {value.shape}, expected {symbols} = {shape}.")
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        """Outcome and time, without the arrays."""
        return f"{type(self).__name__}({self.outcome.summary} at {self.outcome.time:g} s)"

    @property
    def steps(self) -> int:
        """Number K of simulation steps."""
        return self.time.size - 1

    @property
    def substeps(self) -> int:
        """Steps of a control tick."""
        if len(self.tick_time) < 2:
            return max(self.steps, 1)
        return round(float(self.tick_time[1]) / self.time_step)

    @property
    def torque(self) -> Array:
        """Torque of every step, shape (K, nu) [N m]; computed anew at each call."""
        return self.torque_at(np.arange(self.steps))

    def torque_at(self, rows: Sequence[int] | NDArray[np.intp]) -> Array:
        """Torques of some steps, shape (n, nu) [N m]."""
        ticks, since = np.divmod(np.minimum(np.asarray(rows, dtype=np.intp), self.steps - 1), self.substeps)
        torque = self.tick_torque[ticks]
        for part in blocks(len(ticks) if since.any() else 0):  # as end_step of validation.trial.log does it
            rate, limit = self.torque_rate[ticks[part]], self.torque_limit
            moved = np.clip(torque[part] + (since[part] * self.time_step)[:, None] * rate, -limit, limit)
            goes_on = ~np.isnan(rate) & (since[part] > 0)[:, None]
            torque[part] = np.where(goes_on, moved, torque[part])
        return torque


_ARRAYS = {item.name: item.metadata for item in fields(SimulationRecord) if item.metadata}
SHAPES: dict[str, str] = {name: of["shape"] for name, of in _ARRAYS.items()}
"""Shape of every array, in symbols of :class:`SimulationRecord`."""
INTEGERS: dict[str, Any] = {name: of["kind"] for name, of in _ARRAYS.items() if of["kind"] is not np.float64}
"""Types of the arrays that are not float64."""
LOGGED = tuple(name for name, of in _ARRAYS.items() if of["logged"])
"""Arrays that are filled step by step."""
STORED = {name: of["file"] for name, of in _ARRAYS.items() if of["file"]}
"""File of every array that is on disk."""
_RATES = ("K", "K+1", "R", "R-1", "T")
CONSTANTS = tuple(
    item.name
    for item in fields(SimulationRecord)
    if item.name != "followed" and SHAPES.get(item.name, "").partition(" ")[0] not in _RATES
)
"""Fields of a :class:`SimulationRecord` that are no series of instants, steps or ticks."""


def support_height(floor: Array, height: Array, load: Array) -> Array:
    """Height of the floor under points, each on the surface nearest to it, averaged by their loads.

    The floor has surfaces of ascending heights, shape (L,), none if it slopes: then points are on it [m].
    Heights of the points have shape (..., P) [m], as the vertical force on each [N]. Shape (...) [m]; of the
    lowest surface, or point, where there is no load.
    """
    if len(floor) == 1:
        return np.full(height.shape[:-1], floor[0])
    under = floor[np.abs(height[..., None] - floor).argmin(axis=-1)] if len(floor) else height
    load = np.maximum(load, 0.0)
    total = load.sum(axis=-1)
    mean = (under * load).sum(axis=-1) / np.where(total > 0.0, total, 1.0)
    return np.asarray(np.where(total > 0.0, mean, floor[0] if len(floor) else height.min(axis=-1)))


def measured_supports(record: SimulationRecord) -> tuple[NDArray[np.int8], int]:
    """What stands at K steps of the physics, and how often a foot touched down, by the forces on the soles.

    The first has shape (K,): 0 left, 1 right, 2 both; in flight that of before.
    """
    loaded = record.point_force[:, :, 2] > 0.0
    down = np.stack([loaded[:, record.point_foot == foot].any(axis=1) for foot in (0, 1)])
    size = 1, 2 * round(0.5 * _SHORTEST / record.time_step) + 1
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


def _frozen(value: Any, dtype: Any) -> NDArray[Any]:
    """Read-only: unchanged if it cannot be written to, else a C-contiguous copy."""
    if isinstance(value, np.ndarray) and value.dtype == dtype:
        owner: Any = value
        while isinstance(owner, np.ndarray) and not owner.flags.writeable:
            owner = owner.base
        if owner is None:
            return value
    array: NDArray[Any] = np.array(value, dtype=dtype, order="C")
    array.setflags(write=False)
    return array
