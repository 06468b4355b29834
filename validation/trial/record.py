"""Record of a simulation: one frozen :class:`SimulationRecord`."""

from __future__ import annotations

import math
import mmap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from ampm.exceptions import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from validation.trial.followed import Followed
    from validation.trial.outcome import Outcome

    Array = NDArray[np.float64]

FEET = ("left", "right")


def _of(shape: str, kind: Any = np.float64, *, logged: bool = False) -> dict[str, Any]:
    """Metadata of an array: its shape in symbols, its type, and whether it is filled step by step."""
    return {"shape": shape, "kind": kind, "logged": logged}


FLOOR = "floor"
"""Key of the metadata that has the heights of a floor's surfaces, ascending, separated by spaces [m]."""

PLANS = "plans"
"""Key of the metadata that has the number of plans followed after the first one, if there were any."""

STATE_INTERVAL = 0.01
"""Time between the states, and between the contacts, on disk [s]."""


def state_steps(time_step: float) -> int:
    """Steps of the physics from one state on disk to the next."""
    return max(1, round(STATE_INTERVAL / time_step))


def stored_rows(steps: int, time_step: float) -> NDArray[np.intp]:
    """Instants of the states on disk: one every :data:`STATE_INTERVAL`, and the last one."""
    return np.append(np.arange(0, steps, state_steps(time_step)), steps)


def shape_of(name: str, sizes: Mapping[str, int]) -> tuple[int, ...]:
    """Shape of an array of the record; ``sizes`` has what its symbols stand for."""
    return tuple(sizes[symbol] if symbol in sizes else int(symbol) for symbol in SHAPES[name].split())


@dataclass(frozen=True, eq=False)
class SimulationRecord:
    """Everything one simulation produced: K steps of ``time_step``, P sole points, T control ticks.

    Rows that belong to an instant have K + 1 entries (t_0 ... t_K); rows that belong to a step have K, row
    k acts over [t_k, t_(k+1)]. Vectors are in the world frame (x forward, y left, z up, floor at z = 0). All
    arrays are read-only; floats are float64. Arrays are copied, unless they and their bases are read-only
    already; then a long walk does not need its memory twice.

    Attributes:
        time: t_k, shape (K + 1,) [s].
        q: MuJoCo ``qpos``, root position [m], root quaternion wxyz, hinges [rad], shape (K + 1, nq).
        qd: MuJoCo ``qvel``, root velocity in world [m/s], root angular velocity in the root [rad/s], hinges
            [rad/s], shape (K + 1, nv).
        torque: applied joint torque, actuator order, shape (K, nu) [N m].
        torque_rate: rate at which the torques of a tick go on until the next one, NaN where they are held,
            shape (T, nu) [N m/s].
        point_force: force of the floor on the body at each sole point, shape (K, P, 3) [N].
        point_position: where it acts, shape (K, P, 3) [m].
        point_penetration: depth under the floor, >= 0, shape (K, P) [m].
        point_place: the sole points themselves, shape (K + 1, P, 3) [m].
        point_foot: foot of each point, 0 left, 1 right, shape (P,).
        point_group: 0 heel, 1 ball, 2 tip, shape (P,).
        com: COM as the simulator reports it, shape (K + 1, 3) [m].
        angular_momentum: about the COM, as the simulator reports it, shape (K + 1, 3) [N m s].
        foot_position: reference points of both soles, left first, shape (K + 1, 2, 3) [m].
        foot_forward: direction of their x axes, shape (K + 1, 2, 3).
        command_com: the controller's COM reference, held over the tick, shape (K, 3) [m].
        command_zmp: ZMP commanded, shape (K, 2) [m].
        command_force: net ground force commanded, shape (K, 3) [N].
        command_angular_momentum: angular momentum about the COM commanded, shape (K, 3) [N m s].
        tick_time: time of each control tick, shape (T,) [s].
        qp_status: 0 solved, 1 solved in the form with limits, 2 unsolved, shape (T,).
        qp_residual: largest constraint or stationarity residual of the tick's QP, shape (T,).
        qp_iterations: iterations, shape (T,).
        qp_time: wall-clock time of the solve, shape (T,) [s]; the one column that equal runs differ in.
        tick_plan: number of the plan followed, 0 the first one, shape (T,);
            :data:`validation.trial.followed.STEPPING` where the stabiliser stepped off the plan.
        outcome: how the run ended.
        mass: total mass [kg].
        gravity: g, positive [m/s^2].
        time_step: dt [s].
        friction: friction coefficient between sole and floor [1], NaN if unknown.
        torque_limit: largest torque per actuator, shape (nu,) [N m].
        joint_range: lower and upper limit per hinge, shape (nu, 2) [rad].
        joint_names: the hinges in actuator order, nu names.
        external_segments: the segments that anything but the floor pushed, S names.
        external_force: force on each of them, shape (K, S, 3) [N].
        external_moment: moment on each of them, shape (K, S, 3) [N m].
        external_position: where the force acts, the segment's COM, shape (K, S, 3) [m].
        point_sites: sites of the sole points in the model, P names.
        metadata: further identification of the run, text to text; :data:`FLOOR`, if the floor has steps, and
            :data:`PLANS`, if the plan moved.
        followed: what the plans that were followed said, not on disk; None of a log.
    """

    time: Array = field(metadata=_of("K+1"))
    q: Array = field(metadata=_of("K+1 nq", logged=True))
    qd: Array = field(metadata=_of("K+1 nv", logged=True))
    torque: Array = field(metadata=_of("K nu", logged=True))
    torque_rate: Array = field(metadata=_of("T nu", logged=True))
    point_force: Array = field(metadata=_of("K P 3", logged=True))
    point_position: Array = field(metadata=_of("K P 3", logged=True))
    point_penetration: Array = field(metadata=_of("K P", logged=True))
    point_place: Array = field(metadata=_of("K+1 P 3", logged=True))
    point_foot: NDArray[np.int8] = field(metadata=_of("P", np.int8))
    point_group: NDArray[np.int8] = field(metadata=_of("P", np.int8))
    com: Array = field(metadata=_of("K+1 3", logged=True))
    angular_momentum: Array = field(metadata=_of("K+1 3", logged=True))
    foot_position: Array = field(metadata=_of("K+1 F 3", logged=True))
    foot_forward: Array = field(metadata=_of("K+1 F 3", logged=True))
    command_com: Array = field(metadata=_of("K 3", logged=True))
    command_zmp: Array = field(metadata=_of("K 2", logged=True))
    command_force: Array = field(metadata=_of("K 3", logged=True))
    command_angular_momentum: Array = field(metadata=_of("K 3", logged=True))
    tick_time: Array = field(metadata=_of("T"))
    qp_status: NDArray[np.int8] = field(metadata=_of("T", np.int8, logged=True))
    qp_residual: Array = field(metadata=_of("T", logged=True))
    qp_iterations: NDArray[np.int32] = field(metadata=_of("T", np.int32, logged=True))
    qp_time: Array = field(metadata=_of("T", logged=True))
    outcome: Outcome
    mass: float
    gravity: float
    time_step: float
    torque_limit: Array = field(metadata=_of("nu"))
    joint_range: Array = field(metadata=_of("nu 2"))
    joint_names: tuple[str, ...]
    friction: float = math.nan
    external_segments: tuple[str, ...] = ()
    external_force: Array = field(metadata=_of("K S 3"), default_factory=lambda: np.zeros((0, 0, 3)))
    external_moment: Array = field(metadata=_of("K S 3"), default_factory=lambda: np.zeros((0, 0, 3)))
    external_position: Array = field(metadata=_of("K S 3"), default_factory=lambda: np.zeros((0, 0, 3)))
    point_sites: tuple[str, ...] = ()
    metadata: Mapping[str, str] = field(default_factory=dict)
    tick_plan: NDArray[np.int32] = field(
        metadata=_of("T", np.int32), default_factory=lambda: np.zeros(0, np.int32)
    )
    followed: Followed | None = None

    def __post_init__(self) -> None:
        sizes = {
            "K+1": len(self.time),
            "K": len(self.time) - 1,
            "nq": self.q.shape[1],
            "nv": self.qd.shape[1],
            "P": len(self.point_foot),
            "F": 2,
            "T": len(self.tick_time),
            "nu": len(self.joint_names),
            "S": len(self.external_segments),
        }
        for name, symbols in SHAPES.items():
            shape, given = shape_of(name, sizes), getattr(self, name)
            if name.startswith("external_") and not sizes["S"]:
                given = np.zeros(shape)
            if name == "tick_plan" and not len(given):
                given = np.zeros(shape, np.int32)
            value = _frozen(given, INTEGERS.get(name, np.float64))
            if value.shape != shape:
                raise InputError(f"record: {name} has shape {value.shape}, expected {symbols} = {shape}.")
            object.__setattr__(self, name, value)
        object.__setattr__(self, "metadata", MappingProxyType(dict(self.metadata)))

    def __repr__(self) -> str:
        """Outcome and time, without the arrays."""
        return f"SimulationRecord({self.outcome.summary} at {self.outcome.time:g} s)"

    @property
    def steps(self) -> int:
        """Number K of simulation steps."""
        return self.time.size - 1

    @property
    def substeps(self) -> int:
        """Steps of a control tick."""
        return (
            round(float(self.tick_time[1]) / self.time_step)
            if len(self.tick_time) > 1
            else max(self.steps, 1)
        )

    @property
    def state_rows(self) -> NDArray[np.intp]:
        """Instants of the rows of ``q`` and ``qd``: all of them."""
        return np.arange(self.time.size)

    def torque_at(self, rows: Sequence[int] | NDArray[np.intp]) -> Array:
        """Torques of some steps, shape (n, nu) [N m]."""
        return self.torque[np.asarray(rows, dtype=np.intp)]

    @property
    def hinge_q(self) -> NDArray[np.float64]:
        """Hinge angles in actuator order, shape (K + 1, nu) [rad]: the last columns of ``q``."""
        return self.q[:, self.q.shape[1] - len(self.joint_names) :]

    @property
    def hinge_qd(self) -> NDArray[np.float64]:
        """Hinge rates in actuator order, shape (K + 1, nu) [rad/s]."""
        return self.qd[:, self.qd.shape[1] - len(self.joint_names) :]


_ARRAYS = {item.name: item.metadata for item in fields(SimulationRecord) if item.metadata}
SHAPES: dict[str, str] = {name: of["shape"] for name, of in _ARRAYS.items()}
"""Shape of every array: K steps, P sole points, T control ticks, S pushed segments."""
INTEGERS: dict[str, Any] = {name: of["kind"] for name, of in _ARRAYS.items() if of["kind"] is not np.float64}
"""Types of the arrays that are not float64."""
LOGGED = tuple(name for name, of in _ARRAYS.items() if of["logged"])
"""Arrays that are filled step by step."""


def support_height(metadata: Mapping[str, str], height: Array, load: Array) -> Array:
    """Height of the floor under points, each on the surface nearest to it, averaged by their loads.

    Args:
        metadata: of a record.
        height: of the points, shape (..., P) [m].
        load: vertical force on each, shape (..., P) [N].

    Returns:
        Shape (...) [m]; the lowest level where there is no load.
    """
    surface = np.array([float(level) for level in metadata.get(FLOOR, "0").split()])
    if len(surface) == 1:
        return np.full(height.shape[:-1], surface[0])
    under = surface[np.abs(height[..., None] - surface).argmin(axis=-1)]
    load = np.maximum(load, 0.0)
    total = load.sum(axis=-1)
    mean = (under * load).sum(axis=-1) / np.where(total > 0.0, total, 1.0)
    return np.asarray(np.where(total > 0.0, mean, surface[0]))


def _frozen(value: Any, dtype: Any) -> NDArray[Any]:
    """Read-only: unchanged if it cannot be written to, else a C-contiguous copy."""
    if isinstance(value, np.ndarray) and value.dtype == dtype:
        owner: Any = value
        while isinstance(owner, np.ndarray) and not owner.flags.writeable:
            owner = owner.base
        if owner is None or isinstance(owner, mmap.mmap):  # of validation.trial.spill
            return value
    array: NDArray[Any] = np.array(value, dtype=dtype, order="C")
    array.setflags(write=False)
    return array
