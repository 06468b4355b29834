"""The closed loop beside the bare physics: how long one control period of a walk takes."""

import contextlib
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any
from unittest import mock

import mujoco
import numpy as np

from ampm.geometry import Array
from ampm.walk import ControlOutput
from validation.progress import Progress, interruption
from validation.table import Table, format_duration
from validation.trial.engine import make_engine
from validation.trial.outcome import Outcome, OutcomeName
from validation.trial.plan import PlannedWalk
from validation.trial.record import SimulationRecord
from validation.trial.simulate import ClosedLoop, simulate


@dataclass(frozen=True)
class LoopTimes:
    """Times of one walk; medians over its control periods, unless said otherwise."""

    time_step: float  # of the physics [s]
    period: float  # one control period of the closed loop, recording included [s]
    tick: float  # of that the control tick, from sensors to torques [s]
    tick_p99: float  # 99th percentile of the same [s]
    solve: float  # of that the QP, update and solve [s]; NaN for a controller that does not report it
    physics: float  # the physics of one control period alone [s]
    ending: str  # how the walk ended; empty if it was completed


def time_loop(planned: PlannedWalk, walks: int, progress: Progress) -> LoopTimes:
    """Make the same walk several times and step its physics alone; of each period the least time counts.

    Another process rarely interrupts the same period in all walks.
    """
    run = planned.run
    periods, ticks, solves, physics = [], [], [], []
    label = f"{walks} walks at {1e3 * run.simulation.time_step:g} ms"
    with progress.stage(label, "steps") as stage:
        for _ in range(walks):
            with timed_ticks() as (starts, spans):
                record = simulate(planned, progress=stage.advance)
            if record.outcome.name == OutcomeName.INTERRUPTED:  # simulate keeps the record instead of raising
                interruption.acknowledge()
                raise KeyboardInterrupt
            periods.append(np.diff(starts))
            ticks.append(spans)
            solves.append(record.qp_time)
            physics.append(time_physics(record, planned))
    return LoopTimes(
        time_step=run.simulation.time_step,
        period=float(np.median(np.min(periods, axis=0))),
        tick=float(np.median(np.min(ticks, axis=0))),
        tick_p99=float(np.percentile(np.min(ticks, axis=0), 99)),
        solve=float(np.median(np.min(solves, axis=0))),
        physics=float(np.median(np.min(physics, axis=0))),
        ending="" if record.outcome.completed else record.outcome.ending,
    )


def time_physics(record: SimulationRecord, planned: PlannedWalk) -> Array:
    """Step the physics of a walk again with the recorded torques: time of each control period, (T,) [s]."""
    model = planned.body.model.compile()
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = record.q[0], record.qd[0]
    engine = make_engine(model, data, planned.run)
    spans = np.empty(record.steps)
    for k, torque in enumerate(record.torque):
        data.ctrl[:] = torque
        start = time.perf_counter()
        engine.step1()
        engine.step2()
        spans[k] = time.perf_counter() - start
    whole = record.steps // record.substeps * record.substeps
    return np.asarray(spans[:whole].reshape(-1, record.substeps).sum(axis=1))


@contextlib.contextmanager
def timed_ticks() -> Iterator[tuple[list[float], list[float]]]:
    """When each control tick of the walks made meanwhile begins, and how long it takes [s]."""
    read, apply, clock = ClosedLoop.read, ClosedLoop.apply, time.perf_counter
    starts: list[float] = []
    spans: list[float] = []

    def begun(loop: ClosedLoop) -> Any:
        starts.append(clock())
        return read(loop)

    def ended(loop: ClosedLoop, output: ControlOutput) -> Outcome | None:
        end = apply(loop, output)
        spans.append(clock() - starts[-1])
        return end

    with mock.patch.multiple(ClosedLoop, read=begun, apply=ended):
        yield starts, spans


_COLUMNS = {
    "control period": "period",
    "control tick": "tick",
    "99th percentile": "tick_p99",
    "QP alone": "solve",
    "physics alone": "physics",
}
"""Times in the table, and their fields."""


def loop_table(walks: Sequence[LoopTimes]) -> Table:
    """One row for each time step."""
    columns = ("time step", *(f">{name}" for name in _COLUMNS), ">period / physics")
    rows = []
    for walk in walks:
        times = (format_duration(getattr(walk, field)) for field in _COLUMNS.values())
        rows.append((f"{1e3 * walk.time_step:g} ms", *times, f"{walk.period / walk.physics:.2f}"))
    endings = [f"{1e3 * walk.time_step:g} ms: {walk.ending}" for walk in walks if walk.ending]
    return Table("closed loop", columns, rows, endings)
