"""The closed loop: control ticks, their parts, the physics alone, and all of it against real time."""

import contextlib
import time
from collections.abc import Callable, Iterator
from typing import Any
from unittest import mock

import mujoco
import numpy as np

from ampm.geometry import Array
from ampm.parameters import RunParameters
from ampm.physics_parameters import steps_per_tick
from ampm.walk import LIMITED, UNSOLVED, WalkPlan
from benchmarks.clock import Line, least
from models.scene import BodyModel
from validation.trial.outcome import OutcomeName
from validation.trial.record import SimulationRecord
from validation.trial.simulate import ClosedLoop, simulate
from validation.trial.watch import End


def time_walk(
    plan: WalkPlan, run: RunParameters, body: BodyModel, walks: int, progress: Callable[[int, int], None]
) -> tuple[str, list[Line]]:
    """Walk, and step the physics alone; each several times.

    Returns:
        How the walk went; its times, of every tick the least of several equal walks.
    """
    whole: list[float] = []
    solves: list[Array] = []

    def walk(one: _Ticks) -> SimulationRecord:
        start = time.perf_counter()
        with one.timed():
            record = simulate(plan, run, body, progress=progress)
        whole.append(time.perf_counter() - start)
        solves.append(record.qp_time)
        if record.outcome.name == OutcomeName.INTERRUPTED:  # Ctrl-C raises no exception there
            raise KeyboardInterrupt
        return record

    ticks = [_Ticks() for _ in range(walks)]
    record, same, period = walk(ticks[0]), True, 1.0 / run.controller.frequency
    for one in ticks[1:]:  # no more than two records at a time, for the memory
        last, record = record, walk(one)
        same &= np.array_equal(last.q, record.q) and np.array_equal(last.torque, record.torque)
    alone = [time_physics(record, run, body) for _ in range(walks)]
    between = [np.diff(one.starts) for one in ticks]
    loops, physics = least(between), least([spans for spans, _ in alone])
    loop = float(np.median(loops))
    unsolved, limited = (int(np.count_nonzero(record.qp_status == status)) for status in (UNSOLVED, LIMITED))
    notes = {
        f"{record.outcome.steps_completed} steps": True,
        str(record.outcome.name): record.outcome.name != OutcomeName.COMPLETED,
        f"{unsolved} QPs unsolved": unsolved,
        f"{limited} ticks at a torque or joint limit": limited,
        "NOT the same walk each time": not (same and all(same_states for _, same_states in alone)),
    }
    spans = [one.spans for one in ticks]
    in_loop = {
        "closed loop, one control period": loops,
        "control tick": least(spans),
        "control tick, all but the QP": least([np.subtract(*of) for of in zip(spans, solves, strict=True)]),
        "QP: update and solve": least(solves),
        "physics alone, one control period": physics,
    }
    simulated = float(record.time[-1] - record.time[0])
    speeds = {
        "closed loop, times real time": max(period * spans.size / spans.sum() for spans in between),
        "the same with set-up and record": simulated / min(whole),
        "the same undisturbed": period * loops.size / loops.sum(),
        "physics alone, times real time": period * physics.size / physics.sum(),
    }
    return ", ".join(note for note, there in notes.items() if there), [
        *(Line.of(name, spans, loop=loop) for name, spans in in_loop.items()),
        Line.of("QP: iterations", record.qp_iterations, "1"),
        *(Line.of(name, speed, "1") for name, speed in speeds.items()),
    ]


def time_physics(record: SimulationRecord, run: RunParameters, body: BodyModel) -> tuple[Array, bool]:
    """Step the physics again with the recorded torques.

    Returns:
        Time of every control period [s], and whether its states are the recorded ones to the bit.
    """
    model = body.compile()
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = record.q[0], record.qd[0]
    spans = np.empty(record.steps)
    for k in range(record.steps):
        data.ctrl[:] = record.torque[k]
        start = time.perf_counter()
        mujoco.mj_step(model, data)
        spans[k] = time.perf_counter() - start
    same = bool(np.array_equal(data.qpos, record.q[-1]) and np.array_equal(data.qvel, record.qd[-1]))
    substeps = steps_per_tick(run.controller.frequency, record.time_step)
    return spans[: record.steps // substeps * substeps].reshape(-1, substeps).sum(axis=1), same


class _Ticks:
    """When each control tick of a walk begins and how long it takes, with sensing and acting [s]."""

    def __init__(self) -> None:
        self.starts: list[float] = []
        self.spans: list[float] = []

    @contextlib.contextmanager
    def timed(self) -> Iterator[None]:
        """Time the ticks of the walks made meanwhile."""
        tick, clock = ClosedLoop.tick, time.perf_counter

        def timed(*step: Any) -> End | None:
            start = clock()
            end = tick(*step)
            self.spans.append(clock() - start)
            self.starts.append(start)
            return end

        with mock.patch.object(ClosedLoop, "tick", timed):
            yield
