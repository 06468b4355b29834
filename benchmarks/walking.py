"""The closed loop: control ticks, their parts, the physics alone, and all of it against real time."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ampm.body.robot import Robot
from ampm.control.controller import TrackingController
from ampm.parameters import RunParameters, steps_per_tick
from ampm.walk import LIMITED, UNSOLVED, ControlOutput, WalkPlan
from benchmarks.clock import Statistics, Stopwatch, least
from models.human import BodyModel
from validation.trial.outcome import OutcomeName
from validation.trial.record import SimulationRecord
from validation.trial.simulate import simulate

Progress = Callable[[int, int], None]

PARTS = {
    "references": "commands: momentum rate, posture, feet, contact gating",
    "terms": "kinematics, Jacobians, drift, sole points",
    "assembly": "force map, condensation on the contact forces, the QP's matrices",
    "solve": "the QP",
    "torque": "inverse dynamics, limits",
}
"""Parts of a control tick, in its order."""


@dataclass(frozen=True)
class WalkTiming:
    """One walk's figures; times in seconds, of every tick the least of several equal walks.

    Attributes:
        outcome: how the walk ended.
        steps_completed: walking steps.
        walks: how many equal walks were made.
        same_walk: whether all of them, with and without clocks, and the physics alone agree in every bit.
        control_tick: the controller, state to torques.
        parts: the same by :data:`PARTS`, from walks of their own; their clocks take about 5 us of a tick.
        closed_loop_tick: from one control tick to the next: controller, physics, record.
        physics_tick: the physics of one control period alone, stepped again with the recorded torques.
        qp: update and solve of the QP, all solves of a tick.
        iterations: of the QP [1].
        unsolved: ticks whose QP was not solved.
        limited: ticks that needed the form with torque and joint limits.
        times_real_time: simulated over wall-clock time of the fastest closed loop.
        times_real_time_whole: the same with what is done before and after: compiling, references, record.
        times_real_time_undisturbed: the same from ``closed_loop_tick``: on a machine with nothing else to do.
        physics_times_real_time: simulated time over that of ``physics_tick``.
    """

    outcome: str
    steps_completed: int
    walks: int
    same_walk: bool
    control_tick: Statistics
    parts: dict[str, Statistics]
    closed_loop_tick: Statistics
    physics_tick: Statistics
    qp: Statistics
    iterations: Statistics
    unsolved: int
    limited: int
    times_real_time: float
    times_real_time_whole: float
    times_real_time_undisturbed: float
    physics_times_real_time: float

    @property
    def ratios(self) -> dict[str, float]:
        """Medians within the run, which compare between machines better than times do."""
        loop, tick = self.closed_loop_tick.median, self.control_tick.median
        return {
            "closed_loop_to_physics": loop / self.physics_tick.median,
            "control_to_physics": tick / self.physics_tick.median,
            "control_to_closed_loop": tick / loop,
            "physics_to_closed_loop": self.physics_tick.median / loop,
            "qp_to_control": self.qp.median / tick,
            **{f"{name}_to_control": part.median / tick for name, part in self.parts.items()},
        }

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        answer = {
            name: value.as_dict() if isinstance(value, Statistics) else value
            for name, value in vars(self).items()
        }
        answer["parts"] = {name: part.as_dict() for name, part in self.parts.items()}
        answer["ratios"] = self.ratios
        return answer


class WalkBenchmark:
    """One walk with one QP solver, several times over; it is the same walk every time.

    Args:
        plan: of the walk.
        run: controller, solver, time step.
        body_model: the simulated body.
        steps: walking steps.
        walks: how many equal walks are made.
    """

    def __init__(
        self,
        plan: WalkPlan,
        run: RunParameters,
        body_model: BodyModel,
        *,
        steps: int,
        walks: int,
    ) -> None:
        self.plan, self.run = plan, run
        self.body_model, self.steps, self.walks = body_model, steps, walks

    def time_all(self, progress: Progress | None = None) -> WalkTiming:
        """Walk plainly, walk again with the parts timed, step the physics alone; all of it several times."""
        plain, watches, whole, qp, same = [], [], [], [], True
        record: SimulationRecord | None = None
        for round_ in range(2 * self.walks):
            watch = Stopwatch() if round_ >= self.walks else None
            ticks = _Ticks(watch)
            start = time.perf_counter()
            walked = self._walk(ticks, progress)
            span = time.perf_counter() - start
            record = record or walked
            same = same and _same_bits(record, walked)
            if watch is not None:
                watches.append(watch)
            else:
                plain.append(ticks)
                whole.append(span)
                qp.append(walked.qp_time)
        if record is None:
            raise ValueError("at least one walk has to be made")
        alone = [self.time_physics(record) for _ in range(self.walks)]
        period = 1.0 / self.run.controller.frequency
        between = [np.diff(ticks.starts) for ticks in plain]
        loop, physics = least(between), least([spans for spans, _ in alone])
        return WalkTiming(
            outcome=str(record.outcome.name),
            steps_completed=record.outcome.steps_completed,
            walks=self.walks,
            same_walk=same and all(same_states for _, same_states in alone),
            control_tick=Statistics.of(least([ticks.spans for ticks in plain])),
            parts={name: Statistics.of(least([watch.rounds[name] for watch in watches])) for name in PARTS},
            closed_loop_tick=Statistics.of(loop),
            physics_tick=Statistics.of(physics),
            qp=Statistics.of(least(qp)),
            iterations=Statistics.of(record.qp_iterations),
            unsolved=int(np.count_nonzero(record.qp_status == UNSOLVED)),
            limited=int(np.count_nonzero(record.qp_status == LIMITED)),
            times_real_time=max(_speed(period, spans) for spans in between),
            times_real_time_whole=float(record.time[-1] - record.time[0]) / min(whole),
            times_real_time_undisturbed=_speed(period, loop),
            physics_times_real_time=_speed(period, physics),
        )

    def _walk(self, ticks: _Ticks, progress: Progress | None) -> SimulationRecord:
        record = simulate(
            self.plan,
            self.run,
            self.body_model,
            controller=ticks.controller,
            steps=self.steps,
            progress=progress,
        )
        if record.outcome.name == OutcomeName.INTERRUPTED:  # which the simulation keeps to itself
            raise KeyboardInterrupt
        return record

    def time_physics(self, record: SimulationRecord) -> tuple[NDArray[np.float64], bool]:
        """Step the physics again with the recorded torques.

        Returns:
            Time of every control period [s], and whether its states are the recorded ones to the bit.
        """
        model = self.body_model.compile()
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = record.q[0], record.qd[0]
        spans = np.empty(record.steps)
        if record.steps:
            data.qacc_warmstart[:] = record.warmstart[0]
        for k in range(record.steps):
            data.ctrl[:] = record.torque[k]
            start = time.perf_counter()
            mujoco.mj_step(model, data)
            spans[k] = time.perf_counter() - start
        same = bool(np.array_equal(data.qpos, record.q[-1]) and np.array_equal(data.qvel, record.qd[-1]))
        substeps = steps_per_tick(self.run.controller.frequency, record.time_step)
        return spans[: record.steps // substeps * substeps].reshape(-1, substeps).sum(axis=1), same


class _Ticks:
    """Makes controllers that note when they are called and how long they take."""

    def __init__(self, watch: Stopwatch | None = None) -> None:
        self.watch = watch
        self.starts: list[float] = []
        self.spans: list[float] = []

    def controller(self, robot: Robot, run: RunParameters) -> TrackingController:
        """A controller that is timed."""
        controller = TrackingController(robot, run)
        if self.watch is not None:
            time_parts(self.watch, controller)
        update, clock = controller.update, time.perf_counter

        def timed(*state: Any) -> ControlOutput:
            start = clock()
            output = update(*state)
            self.spans.append(clock() - start)
            self.starts.append(start)
            if self.watch is not None:
                self.watch.end_round()
            return output

        setattr(controller, "update", timed)  # noqa: B010  # which a type checker would not let pass otherwise
        return controller


def time_parts(watch: Stopwatch, controller: TrackingController) -> None:
    """Count a controller's methods as the parts of its tick; its own lines are assembly."""
    tracker = controller.tracker
    watch.time("references", controller.stabilizer, "command")
    for task in (*tracker.feet, tracker.toes, tracker.posture):
        watch.time("references", task, "at")
    watch.time("references", tracker.gate, "update")
    watch.time("terms", controller.robot, "kinematics")
    watch.time("assembly", tracker.forces, "update")
    watch.time("assembly", tracker.condensed, "build")
    watch.time("assembly", controller, "update")
    watch.time("solve", tracker.condensed, "solve")
    watch.time("solve", tracker, "_solve_limited")
    watch.time("torque", tracker, "_torque")
    watch.time("torque", tracker.limits, "broken")


def _speed(period: float, spans: NDArray[np.float64]) -> float:
    """How many times faster than real time ticks of that period were."""
    return float(period * spans.size / spans.sum()) if spans.size else float("nan")


def _same_bits(one: SimulationRecord, other: SimulationRecord) -> bool:
    return np.array_equal(one.q, other.q) and np.array_equal(one.torque, other.torque)
