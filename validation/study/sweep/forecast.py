"""Forecast of a sweep: number of runs, refusals with reasons, and estimated duration.

One run is walked, to time it. Bounds and formula are checked for every run, soles and legs for a sample.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ampm.body.feasibility import check_body
from ampm.exceptions import InputError, RefusedGait
from ampm.parameters import RELATIONS, RunParameters, steps_per_tick
from ampm.planner import rules
from ampm.planner.gaits import Gaits
from ampm.planner.periodic import plan_gait
from ampm.planner.support import plan_steps
from ampm.run_file import key_info
from validation.progress import Progress
from validation.study.sweep.design import STEPS_KEY, SweepDefinition
from validation.study.sweep.task import Task, keep_run

REASONS = (*rules.REASONS, "bad_parameter")
"""Results of :func:`screen` for a run; its numbers are indices into this."""
ACCEPTED, BAD = 0, len(REASONS) - 1
CHECKED = 128
"""Different gaits that are checked against soles and legs at most; 5 to 45 ms each."""
TIMED_STEPS = 10
"""Steps of the walk that is timed, at most."""

_TIMED = 8  # gaits that are tried until one of them can be walked and timed
_CHUNK = 16_384  # runs at a time: their arrays stay in the processor's cache
_CHECKED_KEYS = ("gait.", "body.", "foot.", "controller.frequency", "simulation.time_step")


@dataclass(frozen=True)
class Refused:
    """Runs that are refused for one reason.

    Attributes:
        reason: short name.
        runs: how many.
        example: one of the refusals, as text.
    """

    reason: str
    runs: int
    example: str


@dataclass(frozen=True)
class Forecast:
    """Forecast of a sweep.

    Attributes:
        definition: the sweep.
        runs: all of them.
        refused: by bounds, formula and clock, of all runs.
        gaits: different whole-body motions among the others.
        checked: how many of these were checked against soles and legs.
        body_refused: by soles and legs, of the runs that share a checked gait.
        motion_refused: refusals by the whole-body motion before the timed run.
        walking: upper bound of runs that walk, estimated from the checked share if not all were checked.
        seconds: of one run, from a timed walk; None if none could be walked [s].
        recording: of a run's folder with recording and report, as ``seconds``; 0 where no run keeps one [s].
        workers: processes.
    """

    definition: SweepDefinition
    runs: int
    refused: tuple[Refused, ...]
    gaits: int
    checked: int
    body_refused: tuple[Refused, ...]
    motion_refused: tuple[str, ...]
    walking: int
    seconds: float | None
    recording: float | None
    workers: int

    @property
    def exact(self) -> bool:
        """Whether every gait was checked."""
        return self.checked == self.gaits

    @property
    def all_refused(self) -> bool:
        """Whether it is certain that nothing walks."""
        return self.exact and self.walking == 0

    @property
    def wall_clock(self) -> float | None:
        """Estimated duration of the sweep [s]; None if no walk was timed."""
        return None if self.seconds is None else self.seconds * -(-self.walking // self.workers)

    @property
    def kept(self) -> int:
        """Most runs that keep a folder."""
        some = {"none": 0, "all": self.walking}.get(self.definition.recordings, self.definition.worst)
        return min(some, self.walking)

    @property
    def keeping(self) -> float | None:
        """Longest time for these folders [s]; the worst runs are walked again. None if no walk was timed."""
        if self.seconds is None or self.recording is None:
            return None
        again = 0.0 if self.definition.recordings == "all" else self.seconds
        return (again + self.recording) * -(-self.kept // self.workers)

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready, times in s."""
        answer = asdict(self)
        del answer["definition"]
        own = {"sweep": self.definition.name, "varied": list(self.definition.keys)}
        derived = {name: getattr(self, name) for name in ("exact", "wall_clock", "kept", "keeping")}
        return {**own, **answer, **derived}


def forecast(definition: SweepDefinition, workers: int, *, progress: Progress | None = None) -> Forecast:
    """Count, screen and time a sweep.

    Args:
        definition: the sweep.
        workers: processes that it would have.
        progress: where to report stages.

    Raises:
        InputError: fewer than one worker, or ranges of a grid that leave equal values.
    """
    if workers < 1:
        raise InputError(f"--workers {workers} must be at least 1.", value=workers)
    code = screen(definition)
    refused = [
        Refused(REASONS[number], int(count), str(refusal(definition, int(first))))
        for number, first, count in zip(*np.unique(code, return_index=True, return_counts=True), strict=True)
        if number != ACCEPTED
    ]
    numbers = np.flatnonzero(code == ACCEPTED)
    _, first, sharing = np.unique(_motions(definition, numbers), return_index=True, return_counts=True)
    # A random sample: the first of a grid are its corner.
    chosen = np.random.default_rng(definition.seed).permutation(len(first))[:CHECKED]
    passing: list[int] = []
    found: dict[str, Refused] = {}
    for index in chosen.tolist():
        run = int(numbers[first[index]])
        error = None if definition.tune else refusal(definition, run, with_body=True)
        if error is None:
            passing.append(run)
        else:
            reason = getattr(error, "reason", REASONS[BAD])
            known = found.get(reason, Refused(reason, 0, str(error)))
            found[reason] = Refused(reason, known.runs + int(sharing[index]), known.example)
    share = 1.0 - sum(item.runs for item in found.values()) / max(int(sharing[chosen].sum()), 1)
    motions = len(first) / max(len(numbers), 1)
    seconds, recording, motion_refused = _time_walk(
        definition, passing[:_TIMED], motions, progress or Progress()
    )
    return Forecast(
        definition=definition,
        runs=len(definition),
        refused=tuple(refused),
        gaits=len(first),
        checked=len(chosen),
        body_refused=tuple(found.values()),
        motion_refused=tuple(motion_refused),
        walking=round(share * len(numbers)),
        seconds=seconds,
        recording=recording,
        workers=workers,
    )


def screen(definition: SweepDefinition) -> NDArray[np.int8]:
    """Which runs bounds and formula refuse, without planning them: a million in seconds.

    Returns:
        Of every run the place of its reason in :data:`REASONS`, :data:`ACCEPTED` if there is none, shape
        (N,). A sweep that tunes skips the formula, as tuning may make a gait feasible.
    """
    code = np.full(len(definition), ACCEPTED, dtype=np.int8)
    for start in range(0, len(code), _CHUNK):
        runs = np.arange(start, min(start + _CHUNK, len(code)))
        part = code[start : start + _CHUNK]  # a view
        for key in definition.keys:
            part[~key_info(key).inside(definition.column(key, runs))] = BAD
        for relation in RELATIONS:
            both = definition.column(relation.key, runs), definition.column(relation.other, runs)
            with np.errstate(over="ignore"):
                part[~relation.holds(*both)] = BAD
        if not definition.tune:
            left = np.flatnonzero(part == ACCEPTED)
            names = (field.name for field in fields(Gaits))
            part[left] = rules.screen(
                Gaits(*(definition.column(f"gait.{name}", runs[left]) for name in names))
            )
    return code


def refusal(
    definition: SweepDefinition, run: int, *, with_body: bool = False
) -> InputError | RefusedGait | None:
    """Refusal of a run by bounds or formula, or also by control period, soles and legs; None without one."""
    try:
        parameters = definition.parameters(run)
        plan_gait(parameters.gait, parameters.body.mass)
        if with_body:
            _check_body(parameters)
    except (InputError, RefusedGait) as error:
        return error
    return None


def _check_body(run: RunParameters) -> None:
    """Check control period, soles and legs, as planning does before it solves the motion."""
    from models.build import build_body  # imported here: loads the simulator

    steps_per_tick(run.controller.frequency, run.simulation.time_step)
    description = build_body(run.body, run.contact, run.simulation).description
    gait = run.gait.model_copy(update={"steps": min(run.gait.steps, 2)})  # all steps are equal
    check_body(plan_steps(gait, run.body.mass, run.foot, description.sole), description)


def _motions(definition: SweepDefinition, runs: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of the whole-body motion of some runs: equal for runs with the same motion."""
    motion = np.zeros(len(runs), dtype=np.int64)
    for key in definition.keys:
        if key.startswith(_CHECKED_KEYS):
            _, value = np.unique(definition.column(key, runs), return_inverse=True)
            both = motion * (value.max(initial=0) + 1) + value
            _, motion = np.unique(both, return_inverse=True)  # keep the codes small for any number of keys
    return motion


def _time_walk(
    definition: SweepDefinition, candidates: list[int], share: float, progress: Progress
) -> tuple[float | None, float | None, list[str]]:
    """Time a walk of few steps, and its folder if runs keep one.

    Args:
        definition: the sweep.
        candidates: runs; the first that can be walked is timed.
        share: of the runs that solve a motion of their own [1].
        progress: where to report stages.

    Returns:
        Wall-clock time of one run and of one folder, None if none of them can be walked [s]; the refusals
        before it, in words.
    """
    steps = min(TIMED_STEPS, definition.steps)
    refused: list[str] = []
    start = time.perf_counter()
    for run in candidates:
        task = Task.of(
            definition, run, Path(), parameters=definition.parameters(run).replace({STEPS_KEY: steps})
        )
        with progress.stage(f"walk of run {task.name}, to time it"):
            try:
                planned = task.plan()
            except (InputError, RefusedGait) as error:
                refused.append(str(error))
                continue
            ready = time.perf_counter()
            trial = task.walk(planned)
            walked, folder = time.perf_counter() - ready, 0.0
            if definition.recordings != "none":
                with TemporaryDirectory(prefix="ampm-sweep-") as place:
                    keep_run(trial, replace(task, folder=place))
                folder = time.perf_counter() - ready - walked
            planning = (ready - start) / (len(refused) + 1)  # includes the time of refusals
            longer = definition.steps / steps
            return share * planning + walked * longer, folder * longer, refused
    return None, None, refused
