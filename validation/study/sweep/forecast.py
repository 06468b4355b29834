"""Forecast of a sweep: how many runs, which are refused and why, and about how long it takes.

One run is walked, to time it. Bounds and formula are checked for every run, soles and legs for a sample.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from ampm.exceptions import InputError, RefusedGait
from ampm.parameters import RELATIONS, steps_per_tick
from ampm.planner import rules
from ampm.planner.periodic import plan_gait
from ampm.run_file import key_info
from validation.judge.profiles import profile as find_profile
from validation.progress import Progress
from validation.study.sweep.design import STEPS_KEY, SweepDefinition
from validation.study.sweep.sampling import Cases
from validation.study.sweep.sampling import cases as cases_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.parameters import RunParameters

REASONS = (*rules.REASONS, "bad_parameter")
"""Results of :func:`screen` for a run; its numbers are indices into this."""
ACCEPTED, BAD = 0, len(REASONS) - 1
CHECKED = 128
"""Different gaits that are checked against soles and legs at most; 5 to 45 ms each."""
TIMED_STEPS = 10
"""Steps of the walk that is timed, at most."""

_TIMED = 8  # gaits that are tried until one of them can be walked and timed
_GAIT = tuple(field.name for field in fields(rules.Gaits))
_CHUNK = 16_384  # runs at a time: their arrays stay in the processor's cache
_CHECKED_KEYS = ("gait.", "body.", "foot.", "controller.frequency", "simulation.time_step")


@dataclass(frozen=True)
class Refused:
    """Runs that are refused for one reason.

    Attributes:
        reason: short name.
        runs: how many.
        example: one of the refusals, in words.
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
        motion_refused: what the whole-body motion of gaits refused that were tried before the timed one.
        walking: runs that can walk at most, estimated from the share of checked ones if not all were.
        seconds: of one run, from a timed walk; None if none could be walked [s].
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
    workers: int

    @property
    def exact(self) -> bool:
        """Whether every gait was checked."""
        return self.checked == self.gaits

    @property
    def all_refused(self) -> bool:
        """Whether it is sure that nothing walks."""
        return self.exact and self.walking == 0

    @property
    def wall_clock(self) -> float | None:
        """About how long the sweep takes [s]; None if no walk was timed."""
        return None if self.seconds is None else self.seconds * -(-self.walking // self.workers)

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready, times in s."""
        answer = asdict(self)
        del answer["definition"]
        own = {"sweep": self.definition.name, "varied": list(self.definition.keys)}
        return {**own, **answer, "exact": self.exact, "wall_clock": self.wall_clock}


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
    progress = progress or Progress()
    cases = cases_of(definition)
    code = screen(cases)
    refused = [
        Refused(REASONS[number], int(count), str(_refusal(cases, int(first))))
        for number, first, count in zip(*np.unique(code, return_index=True, return_counts=True), strict=True)
        if number != ACCEPTED
    ]
    numbers = np.flatnonzero(code == ACCEPTED)
    _, first, sharing = np.unique(_gaits(cases, numbers), return_index=True, return_counts=True)
    # At random: the first of a grid are its corner.
    chosen = np.random.default_rng(definition.seed).permutation(len(first))[:CHECKED]
    passing: list[int] = []
    found: dict[str, Refused] = {}
    for index in chosen.tolist():
        case, runs = int(numbers[first[index]]), int(sharing[index])
        error = None if definition.tune else _refusal(cases, case, with_body=True)
        if error is None:
            passing.append(case)
        else:
            reason = getattr(error, "reason", REASONS[BAD])
            known = found.get(reason, Refused(reason, 0, str(error)))
            found[reason] = Refused(reason, known.runs + runs, known.example)
    looked_at = int(sharing[chosen].sum())
    share = 1.0 - sum(item.runs for item in found.values()) / max(looked_at, 1)
    seconds, motion_refused = _time_walk(cases, passing[:_TIMED], len(first) / max(len(numbers), 1), progress)
    return Forecast(
        definition=definition,
        runs=len(cases),
        refused=tuple(refused),
        gaits=len(first),
        checked=len(chosen),
        body_refused=tuple(found.values()),
        motion_refused=tuple(motion_refused),
        walking=round(share * len(numbers)),
        seconds=seconds,
        workers=workers,
    )


def screen(cases: Cases) -> NDArray[np.int8]:
    """Which runs bounds and formula refuse, without planning them: a million in seconds.

    Returns:
        Of every run the place of its reason in :data:`REASONS`, :data:`ACCEPTED` if there is none, shape
        (N,). A sweep that tunes skips the formula: the choices that are found may make it feasible.
    """
    code = np.full(len(cases), ACCEPTED, dtype=np.int8)
    inside = [(axis, key_info(axis.key).inside(axis.values)) for axis in cases.axes]
    for start in range(0, len(cases), _CHUNK):
        numbers = np.arange(start, min(start + _CHUNK, len(cases)), dtype=np.int64)
        part = code[start : start + _CHUNK]  # a view
        for axis, good in inside:
            part[~good[axis.index(numbers)]] = BAD
        for relation in RELATIONS:
            both = cases.column(relation.key, numbers), cases.column(relation.other, numbers)
            with np.errstate(over="ignore"):
                part[~relation.holds(*both)] = BAD
        if not cases.definition.tune:
            left = np.flatnonzero(part == ACCEPTED)
            columns = (cases.column(f"gait.{name}", numbers[left]) for name in _GAIT)
            part[left] = rules.screen(rules.Gaits(*columns))
    return code


def _refusal(cases: Cases, case: int, *, with_body: bool = False) -> InputError | RefusedGait | None:
    """Why a run is refused before its motion is solved.

    Args:
        cases: of the sweep.
        case: number of the run.
        with_body: check soles and legs, too.
    """
    try:
        run = cases.run(case)
        steps_per_tick(run.controller.frequency, run.simulation.time_step)
        plan_gait(run.gait, run.body.mass)
        if with_body:
            _check_body(run)
    except (InputError, RefusedGait) as error:
        return error
    return None


def _check_body(run: RunParameters) -> None:
    """Check soles and legs, as planning does before it solves the motion.

    Raises:
        InputError, RefusedGait: the body cannot walk the plan.
    """
    # Here, not above: the simulator takes a second to load.
    from ampm.body.feasibility import check_body
    from ampm.planner.support import plan_steps
    from models.human import build

    description = build(run.body, run.contact, run.simulation).description
    gait = run.gait.model_copy(update={"steps": min(run.gait.steps, 2)})  # the first step stands for all
    check_body(plan_steps(gait, run.body.mass, run.foot, description.sole), description)


def _gaits(cases: Cases, numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of the whole-body motion of some runs: equal where all that it depends on is."""
    motion = np.zeros(len(numbers), dtype=np.int64)
    for axis in cases.axes:
        if axis.key.startswith(_CHECKED_KEYS):
            _, value = np.unique(axis.values, return_inverse=True)
            motion = motion * (int(value.max()) + 1) + value[axis.index(numbers)]
            _, motion = np.unique(motion, return_inverse=True)  # small again, whatever the number of axes
    return motion


def _time_walk(
    cases: Cases, candidates: Iterable[int], share: float, progress: Progress
) -> tuple[float | None, list[str]]:
    """Time a walk of few steps.

    Args:
        cases: of the sweep.
        candidates: runs of which the first that can be walked is.
        share: of the runs that solve a motion of their own [1].
        progress: where to report stages.

    Returns:
        Wall-clock time of one run, None if none of them can be walked [s]; the refusals before it, in words.
    """
    # Here, not above: simulator and Pinocchio take a second to load.
    from validation.run.walk import walk_planned
    from validation.trial.plan import Request, plan_walk
    from validation.trial.tune import tune_walk

    definition = cases.definition
    steps = min(TIMED_STEPS, definition.steps)
    refused: list[str] = []
    start = time.perf_counter()
    for case in candidates:
        request = Request(cases.name(case), cases.run(case).replace({STEPS_KEY: steps}))
        with progress.stage(f"walk of run {request.name}, to time it"):
            try:
                planned = tune_walk(request) if definition.tune else plan_walk(request)
            except (InputError, RefusedGait) as error:
                refused.append(str(error))
                continue
            ready = time.perf_counter()
            walk_planned(planned, find_profile(definition.profile))
            walked = time.perf_counter() - ready
            planning = (ready - start) / (len(refused) + 1)  # refusals take their time, too
            return share * planning + walked * definition.steps / steps, refused
    return None, refused
