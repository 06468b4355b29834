"""Log of a running walk: the record's own arrays, and the views that compiled functions fill them from."""

from __future__ import annotations

from collections import namedtuple
from typing import TYPE_CHECKING, Any, NamedTuple

import mujoco
import numpy as np

from ampm.compiled import compiled, refer
from ampm.vectors import put, vector
from validation.trial import spill
from validation.trial.record import INTEGERS, LOGGED, SHAPES, shape_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from validation.trial.physics import Body, Physics
    from validation.trial.watch import Stance

    Array = NDArray[np.float64]

# Code for a class of a function would be compiled by every process.
Recorded: Any = namedtuple("Recorded", LOGGED)  # type: ignore[misc]


class Command(NamedTuple):
    """What a controller commands at a tick; NaN where it says nothing.

    Attributes:
        torque: shape (nu,) [N m].
        rate: at which the torques go on, NaN holds them, shape (nu,) [N m/s].
        force: of the ground, shape (3,) [N].
        zmp: shape (2,) [m].
        angular_momentum: about the COM, shape (3,) [N m s].
        com: of the reference that it follows, shape (3,) [m].
    """

    torque: Array
    rate: Array
    force: Array
    zmp: Array
    angular_momentum: Array
    com: Array


class Log(NamedTuple):
    """What the compiled functions of a step read and write.

    Attributes:
        record: arrays of :data:`validation.trial.record.LOGGED`.
        body: of this step.
        command: of the last tick.
        stance: of body and command.
        normal_force: of every sole point in the last step, shape (P,) [N].
        touching: sole points that touch, shape (P,).
        substeps: steps of a control tick.
    """

    record: Any
    body: Body
    command: Command
    stance: Stance
    normal_force: Array
    touching: NDArray[np.bool_]
    substeps: int


@compiled
def keep_instant(log: Log, k: int) -> None:
    """Copy the places of sole points and soles, COM and angular momentum at t_k."""
    record, body = log.record, log.body
    sites, place = body.sites, body.site_place
    point_place, foot_position = record.point_place[k], record.foot_position[k]
    points = len(point_place)
    for i in range(points):  # a row copied as an array takes ten times as long
        put(point_place[i], vector(place[sites[i]]))
    for i in range(2):
        put(foot_position[i], vector(place[sites[points + i]]))
        rotation = body.site_rotation[sites[points + i]]
        put(record.foot_forward[k, i], (rotation[0], rotation[3], rotation[6]))
    put(record.com[k], vector(body.com))
    put(record.angular_momentum[k], vector(body.angular_momentum))


class RunLog:
    """The arrays of a record of K steps at most. Memory is allocated when it is written.

    Args:
        steps: K.
        physics: of the walk.
        command: of its controller.
        stance: of body and command.

    Attributes:
        record: the arrays; rows beyond the steps done have no meaning.
        handle: reference to the :class:`Log`, for compiled functions.
    """

    def __init__(self, steps: int, physics: Physics, command: Command, stance: Stance) -> None:
        self.physics, self.command, self.stance = physics, command, stance
        self.substeps = physics.substeps
        model, points = physics.model, len(physics.points.names)
        sizes = {
            "K": steps,
            "K+1": steps + 1,
            "T": -(-steps // self.substeps),
            "P": points,
            "F": 2,
            "nq": model.nq,
            "nv": model.nv,
            "nu": model.nu,
        }
        self.record: Any = Recorded(
            *(spill.zeros(shape_of(name, sizes), INTEGERS.get(name, np.float64)) for name in LOGGED)
        )
        self.external: dict[str, Array] = {}  # pushes of every segment that was pushed, shape (K, 9)
        self.touching, self.normal_force = np.zeros(points, dtype=bool), np.zeros(points)
        self.parts = Log(
            record=self.record,
            body=physics.body,
            command=command,
            stance=stance,
            normal_force=self.normal_force,
            touching=self.touching,
            substeps=self.substeps,
        )
        self.handle = refer(self.parts)

    def keep_pushes(self, k: int, pushes: Mapping[str, Array]) -> None:
        """Copy force, moment and point of every segment that is pushed in step k, shape (9,)."""
        for segment, push in pushes.items():
            self.external.setdefault(segment, spill.zeros((len(self.record.torque), 9)))[k] = push

    def extended(self, steps: int) -> RunLog:
        """The log with room for more steps, twice as many as now or more."""
        log = RunLog(max(steps, 2 * len(self.record.torque)), self.physics, self.command, self.stance)
        log.external = {segment: spill.zeros((len(log.record.torque), 9)) for segment in self.external}
        arrays = [*zip(log.record, self.record, strict=True)]
        arrays += [(log.external[segment], push) for segment, push in self.external.items()]
        arrays += [(log.touching, self.touching), (log.normal_force, self.normal_force)]
        for array, before in arrays:
            array[: len(before)] = before
        return log

    def close(self, done: int) -> dict[str, Any]:
        """Add the instant at which the last step ends, and return the record's arrays.

        Args:
            done: whole steps.

        Returns:
            Name to array, read-only and without a copy: ``done + 1`` rows of instants, ``done`` of steps, and
            the ticks that began in them. An incomplete step has no tick either.
        """
        data, record = self.physics.data, self.record
        # The same whatever ended the walk: no push, the last torques, and no warm start.
        data.qpos[:], data.qvel[:] = record.q[done], record.qd[done]
        data.xfrc_applied[:], data.qacc_warmstart[:] = 0.0, 0.0
        data.ctrl[:] = record.torque[done - 1] if done else 0.0
        mujoco.mj_forward(self.physics.model, data)
        keep_instant(self.handle, done)
        rows = {"K+1": done + 1, "K": done, "T": -(-done // self.substeps)}
        result: dict[str, Any] = {}
        for name, array in zip(LOGGED, record, strict=True):
            array.setflags(write=False)
            result[name] = array[: rows[SHAPES[name].split()[0]]]
        if self.external:
            pushes = np.stack([push[:done] for push in self.external.values()], axis=1)
            result["external_force"] = pushes[..., :3]
            result["external_moment"] = pushes[..., 3:6]
            result["external_position"] = pushes[..., 6:]
            result["external_segments"] = tuple(self.external)
        return result
