"""A control tick as compiled functions: what lies between ``mj_step1`` and ``mj_step2``, and after them.

Any controller's tick is :func:`sense`, its ``update`` in Python, and :func:`act`. For our own controller
:class:`OwnTick` takes these together, with the same bits.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from ampm.compiled import Bundle, bound, compiled
from ampm.control.controller import TrackingController
from ampm.control.tick import RATE, V, observe, prepare, respond
from ampm.vectors import put, turned, vector
from ampm.walk import SOLVED
from validation.trial.log import gap_of, keep_command, keep_step, read_touch
from validation.trial.watch import stands

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.walk import Controller, ControlOutput, Reference, ReferenceTable

    Array = NDArray[np.float64]

_UPDATE = TrackingController.update  # as it is here, to notice a replaced one
_FLAGS = "jumps", "planned", "due"


@compiled
def sense(own: Any, log: Any, contacts: int) -> None:
    """Read which sole points touch, and the state in Pinocchio's coordinates, after ``mj_step1``.

    Args:
        own: see :class:`~validation.trial.simulate.ClosedLoop`.
        log: see :func:`validation.trial.log.keep_step`.
        contacts: how many there are.
    """
    read_touch(log, contacts)
    qpos, qvel, q, v = own.qpos, own.qvel, own.q, own.v
    q[:] = qpos
    q[3], q[4], q[5], q[6] = qpos[4], qpos[5], qpos[6], qpos[3]
    v[:] = qvel
    put(v[0:3], turned(own.root_rotation.T, vector(qvel[0:3])))


@compiled
def act(
    own: Any, log: Any, k: int, centre: Array, trunk: Array, feet: Array, torque: Array, rate: Array,
    zmp: Array, force: Array, momentum: Array, status: int, residual: float, iterations: int, seconds: float,
) -> float:  # fmt: skip
    """Let the torque of a tick act, keep its command, and take over the planned COM, trunk axis and soles.

    Returns:
        Distance of the ZMP of the step before from the commanded one [m].
    """
    solution = status, residual, iterations, seconds
    keep_command(log, k, centre[0], rate, zmp, force, momentum, *solution)
    for j in range(len(torque)):
        own.ctrl[j], own.torque[j], own.rate[j] = torque[j], torque[j], rate[j]
    for axis in range(3):
        own.planned[0, axis], own.planned[1, axis] = centre[0, axis], trunk[axis, 2]
        own.planned[2, axis], own.planned[3, axis] = feet[0, axis], feet[1, axis]
    return gap_of(log, k)


@compiled
def carry_on(torque: Array, rate: Array, limit: Array, ctrl: Array, since: float) -> None:
    """Let the torque go on with its rate, within the motors' limits.

    Args:
        torque: of the tick, shape (nu,) [N m].
        rate: NaN holds the torque, shape (nu,) [N m/s].
        limit: of the motors, shape (nu,) [N m].
        ctrl: written, shape (nu,) [N m].
        since: time since the tick [s].
    """
    for j in range(len(torque)):
        if np.isnan(rate[j]):
            ctrl[j] = torque[j]
        else:
            ctrl[j] = min(max(torque[j] + since * rate[j], -limit[j]), limit[j])


@compiled
def end_step(own: Any, log: Any, k: int, contacts: int, efc_force: Array) -> bool:
    """Keep a step, and set the torques of the next one if no tick does.

    Args:
        own: see :class:`~validation.trial.simulate.ClosedLoop`.
        log: see :func:`validation.trial.log.keep_step`.
        k: step.
        contacts: how many there are.
        efc_force: forces of all constraints.

    Returns:
        Whether the walk may go on: the body stands, and MuJoCo has warned of nothing.
    """
    keep_step(log, k, contacts, efc_force)
    soles = log.foot_position[k]
    since = (k + 1) % log.substeps
    if since:
        carry_on(own.torque, own.rate, own.limit, own.ctrl, since * own.time_step)
    planned = own.planned[0], own.planned[1], own.planned[2:]
    going = k % log.substeps == 0 or stands(own.com, own.trunk, soles, *planned, own.scale)
    for warning in own.warnings:  # MuJoCo has reset the state instead of stepping it
        going = going and warning == 0
    return going


@compiled
def begin_tick(own: Any, log: Any, control: Any, table: Any, row: int, k: int, contacts: int) -> bool:
    """Sense, and a tick of our own controller up to its QP; false if that has no solution.

    Args:
        own: see :class:`~validation.trial.simulate.ClosedLoop`.
        log: see :func:`validation.trial.log.keep_step`.
        control: see :mod:`ampm.control.tick`.
        table: references, see :func:`_rows`.
        row: that of this tick.
        k: its step.
        contacts: how many there are.
    """
    sense(own, log, contacts)
    control.q[:], control.motion[V] = own.q, own.v
    control.sensed[:], control.touching[:] = log.normal_force, log.touching
    control.centre[:], control.feet_values[:] = table.centre[row], table.feet[row]
    control.planned[:], control.due[:] = table.planned[row], table.due[row]
    control.until_lift[:], control.posture_trunk[:] = table.until_lift[row], table.trunk[row]
    control.posture_q[:], control.posture_v[:] = table.q[row], table.v[row]
    control.posture_a[:] = table.acceleration[row]
    observe(control, 0.5 * own.time_step)
    # This is never the first tick, but a function is compiled once more for a constant.
    return prepare(control, own.time_step, k == 0, table.right_load[row], table.tilt_window[row])


@compiled
def end_tick(
    own: Any, log: Any, control: Any, table: Any, row: int, k: int, x: Array, residual: float,
    iterations: int, seconds: float,
) -> tuple[bool, float]:  # fmt: skip
    """Torques of the QP's solution, which then act; arguments as in :func:`begin_tick` and :func:`act`.

    Returns:
        Whether they are within all limits, else nothing is done; the distance of :func:`act`.
    """
    control.forces[:] = x[: len(control.forces)]
    if not respond(control, table.jumps[row], k == 0, own.torque, own.point_force):
        return False, 0.0
    command, rate = control.command, own.no_rate
    if control.extrapolates:
        rate = control.hinges[RATE]
    planned = table.centre[row], table.trunk[row], table.feet[row]
    wrench = command[9:11], command[0:3], command[6:9]
    return True, act(own, log, k, *planned, own.torque, rate, *wrench, SOLVED, residual, iterations, seconds)


def _rows(table: ReferenceTable) -> Bundle:
    """The arrays of T references as compiled functions take them, with a leading axis of T."""
    rows = table.rows
    parts = {
        "centre": rows.centre, "feet": rows.feet.values, "right_load": rows.right_load, "jumps": rows.jumps,
        **rows.contacts._asdict(), **rows.posture._asdict(),
    }  # fmt: skip
    for name, part in parts.items():
        parts[name] = np.ascontiguousarray(part, np.bool_ if name in _FLAGS else np.float64).view()
        parts[name].setflags(write=False)  # one type, whether it is a copy or not
    return Bundle(**parts)


class OwnTick:
    """Ticks of our own controller from the sensors to the record, without objects of Python.

    Args:
        controller: which has made its first tick.
        own: see :class:`~validation.trial.simulate.ClosedLoop`.
        log: see :func:`validation.trial.log.keep_step`.
        table: whose first reference was followed by the first tick.
        tables: those that follow it.
    """

    def __init__(
        self,
        controller: TrackingController,
        own: Any,
        log: Any,
        table: ReferenceTable,
        tables: Iterator[ReferenceTable],
    ) -> None:
        self.controller, self._tables, self._fixed = controller, tables, (own, log, controller.own)
        self._row = 0
        self._bind(table)

    def _bind(self, table: ReferenceTable) -> None:
        """Take the arrays of a table."""
        fixed, self._table = (*self._fixed, _rows(table)), table
        self._begin = bound(begin_tick, fixed, 0, 0, 0)
        self._end = bound(end_tick, fixed, 0, 0, np.empty(len(self.controller.condensed.q)), 0.0, 0, 0.0)

    @classmethod
    def of(cls, controller: Controller, *loop: Any) -> OwnTick | None:
        """For a controller that is ours and follows the references given; None for any other."""
        if type(controller) is not TrackingController or controller.makes_references:
            return None
        replaced = getattr(controller.update, "__func__", None) is not _UPDATE
        return None if replaced else cls(controller, *loop)

    def __call__(self, k: int, contacts: int) -> float | tuple[ControlOutput, Reference]:
        """A tick at step k.

        Returns:
            The distance of :func:`act`; or output and reference of a tick whose QP was not solved, or whose
            torques would break a limit: it has yet to act.
        """
        self._row += 1
        if self._row == len(self._table):
            table, self._row = next(self._tables), 0
            if table is not self._table:
                self._bind(table)
        solution, row, controller = None, self._row, self.controller
        if self._begin(row, k, contacts):
            solution = controller.condensed.solve()
            if solution.solved:
                done, gap = self._end(row, k, solution.x, *solution[2:])
                if done:
                    return gap
        reference = self._table[row]
        return controller.complete(solution, reference), reference
