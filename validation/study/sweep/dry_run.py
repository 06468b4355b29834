"""What a sweep would be, without walking a step: how many runs, which are refused and why, how much time."""

from __future__ import annotations

import math
import os
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ampm.exceptions import InputError
from validation.progress import Progress
from validation.study.sweep.closed_form import BAD_PARAMETER
from validation.study.sweep.definition import SweepDefinition
from validation.study.sweep.probing import (
    PROBED,
    SOLVED,
    Probe,
    Solved,
    motion_numbers,
    probe_bodies,
    solve_motions,
)
from validation.study.sweep.sampling import Cases
from validation.study.sweep.sampling import cases as cases_of
from validation.study.sweep.screening import Refusal, Screening, screen

if TYPE_CHECKING:
    from numpy.typing import NDArray

UNSEEN = (
    "knees too straight, joint limits and motions that do not close show only when the whole-body motion is "
    "solved (--probe N), falls only when it is walked"
)
"""What a dry run without solved motions does not see."""
UNSEEN_FALLS = "falls show only when it is walked"
"""What no dry run sees."""
CONFIDENCE = 0.95
"""Of the interval for the runs that get as far as walking."""

MEMORY_BASE = 320.0
MEMORY_PER_STEP = 0.006
"""Memory of a worker, and what a time step of its walk adds [MB]: a bound for 30 steps of ``normal`` at 2, 1,
0.5 and 0.25 ms, 332, 431, 499 and 718 MB."""
MEMORY_NOTED = 500.0
"""From which on a dry run says so [MB]."""


@dataclass(frozen=True)
class Rates:
    """What a run costs one worker [s]; measured on one core of a 2-core AMD EPYC server, one BLAS thread.

    Attributes:
        run: fixed: body, compilation, comparison, verdict.
        motion: solving one new whole-body motion (0.7 of an easy gait, 2.4 of a hard one).
        tick: one control tick.
        step: one step of the physics: stepping, recording, measuring.
        standing: simulated time of the still body that every run weighs.
        efficiency: share of its core that a worker gets for runs, the others and the scheduler beside it.
        start: starting the workers.
    """

    run: float = 0.45
    motion: float = 1.0
    tick: float = 290e-6
    step: float = 80e-6
    standing: float = 2.3
    efficiency: float = 0.93
    start: float = 5.0

    def real_time_factor(self, frequency: float = 500.0, time_step: float = 0.002) -> float:
        """Simulated time over processor time of a walk, its measurement included [1].

        Args:
            frequency: control ticks per second [Hz].
            time_step: of the physics [s].
        """
        return 1.0 / (frequency * self.tick + self.step / time_step)


@dataclass(frozen=True)
class DryRun:
    """A sweep that was not walked.

    Attributes:
        definition: the sweep.
        screening: the formula's answer to every run.
        refusals: runs refused by bounds, formula, or clock, with what would pass.
        probe: what soles and legs say, of all or some.
        solved: what the motions of some of those say.
        longest: time steps of the longest walk [1].
        simulated: simulated time of the runs that are expected to walk [s].
        processor: processor time of them [s].
        wall_clock: expected duration of the sweep [s].
        workers: processes.
        rates: what the estimate rests on.
    """

    definition: SweepDefinition
    screening: Screening
    refusals: tuple[Refusal, ...]
    probe: Probe
    solved: Solved
    longest: int
    simulated: float
    processor: float
    wall_clock: float
    workers: int
    rates: Rates

    @property
    def runs(self) -> int:
        """All runs."""
        return len(self.screening)

    @property
    def refused(self) -> int:
        """Runs that are sure to be refused, whatever the body."""
        return sum(refusal.count for refusal in self.refusals)

    @property
    def accepted(self) -> int:
        """Runs that bounds, formula and clock accept."""
        return self.runs - self.refused

    def refused_by_reason(self) -> dict[str, int]:
        """Runs that are sure to be refused, by reason."""
        found: dict[str, int] = {}
        for item in self.refusals:
            found[item.reason] = found.get(item.reason, 0) + item.count
        return found

    @property
    def walking(self) -> int:
        """Runs that walk, at most: what falls is among them, and if no motion was solved also what refuses
        there. An estimate of two digits, if only some were looked at.
        """
        number = self.accepted * self.probe.passing * self.solved.passing
        if self.exact or number < 10:
            return round(number)
        unit = 10 ** (math.floor(math.log10(number)) - 1)
        return round(number / unit) * unit

    @property
    def exact(self) -> bool:
        """Whether :attr:`walking` rests on every motion."""
        return self.probe.complete and (self.solved.complete or not self.solved.motions)

    @property
    def interval(self) -> tuple[int, int]:
        """Where :attr:`walking` is, with :data:`CONFIDENCE`."""
        sampled = (not self.probe.complete) + (self.solved.motions > 0 and not self.solved.complete)
        each = 1.0 - (1.0 - CONFIDENCE) / max(sampled, 1)  # both shall hold
        low, high = np.multiply(self.probe.interval(each), self.solved.interval(each)) * self.accepted
        return (self.walking, self.walking) if not sampled else (math.floor(low), math.ceil(high))

    @property
    def unseen(self) -> str:
        """What this has not seen."""
        return UNSEEN_FALLS if self.solved.motions else UNSEEN

    @property
    def all_refused(self) -> bool:
        """Whether it is sure that nothing walks."""
        return self.accepted == 0 or (self.exact and self.walking == 0)

    @property
    def memory(self) -> float:
        """What a worker needs for the longest walk, from above [MB]."""
        return MEMORY_BASE + MEMORY_PER_STEP * self.longest

    def notes(self) -> tuple[str, ...]:
        """What a user should know."""
        notes = list(self.definition.notes())
        if self.memory > MEMORY_NOTED and not self.all_refused:
            notes.append(
                f"the longest walk has {self.longest:,} time steps, for which a worker may need "
                f"{self.memory:.0f} MB: take fewer sweep.steps, a longer simulation.time_step, or fewer "
                "--workers if memory is short"
            )
        return tuple(notes)

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready, times in s."""
        definition, probe, solved = self.definition, self.probe, self.solved
        return {
            "sweep": definition.name,
            "gait": definition.gait,
            "steps": definition.steps,
            "seed": definition.seed,
            "profile": definition.profile,
            "recordings": definition.recordings,
            "varied": list(definition.keys),
            "runs": self.runs,
            "accepted": self.accepted,
            "refused": self.refused,
            "refused_by_reason": self.refused_by_reason(),
            "refusals": [{**asdict(item), "way_out": item.way_out()} for item in self.refusals],
            "body": {
                "motions": probe.motions,
                "probed_motions": probe.probed,
                "probed_runs": probe.runs,
                "complete": probe.complete,
                "refused": dict(probe.refused),
                "examples": dict(probe.examples),
            },
            "solved": {
                "motions": solved.motions,
                "runs": solved.runs,
                "complete": solved.complete,
                "refused": dict(solved.refused),
                "examples": dict(solved.examples),
                "seconds": solved.seconds,
            },
            "walk_at_most": {
                "estimate": self.walking,
                "interval": list(self.interval),
                "confidence": CONFIDENCE,
                "exact": self.exact,
            },
            "unseen": self.unseen,
            "notes": list(self.notes()),
            "memory": {"steps": self.longest, "value": self.memory, "unit": "MB"},
            "time": {
                "workers": self.workers,
                "simulated": self.simulated,
                "processor": self.processor,
                "wall_clock": self.wall_clock,
                "real_time_factor": self.simulated / self.processor if self.processor else None,
                "assumed": asdict(self.rates),
            },
        }


def plan_dry_run(
    definition: SweepDefinition,
    workers: int | None = None,
    *,
    rates: Rates | None = None,
    probed: int = PROBED,
    solve: int | None = 0,
    stages: Progress | None = None,
) -> DryRun:
    """Count, screen and estimate a sweep.

    Args:
        definition: the sweep.
        workers: processes; one per core by default.
        rates: what a run costs, if it has been measured.
        probed: different motions that are held against soles and legs at most.
        solve: how many of those that pass are solved; None for
        :data:`~validation.study.sweep.probing.SOLVED` of a
            sweep of more runs than that, and else none.
        stages: where to report progress.

    Raises:
        InputError: fewer than one worker.
    """
    workers = (os.cpu_count() or 1) if workers is None else workers
    if workers < 1:
        raise InputError(f"--workers {workers} must be at least 1.")
    rates = rates or Rates()
    cases = cases_of(definition)
    screening = screen(definition, cases)
    late, walking = _clock(cases, screening)
    numbers = np.flatnonzero(walking)
    probe, passed = probe_bodies(cases, numbers, motion_numbers(cases, numbers), probed)
    if solve is None:
        solve = SOLVED if len(numbers) > SOLVED else 0
    solved = Solved()
    if solve and passed:
        solved = solve_motions(cases, passed, solve, all_probed=probe.complete, stages=stages or Progress())
    simulated, processor, longest = _cost(cases, screening, numbers, rates)
    share = probe.passing * solved.passing
    processor = share * processor + probe.passing * probe.motions * rates.motion
    return DryRun(
        definition=definition,
        screening=screening,
        refusals=(*screening.refusals(), *late),
        probe=probe,
        solved=solved,
        longest=longest,
        simulated=share * simulated,
        processor=processor,
        wall_clock=rates.start + processor / (min(workers, max(len(numbers), 1)) * rates.efficiency),
        workers=workers,
        rates=rates,
    )


def _clock(cases: Cases, screening: Screening) -> tuple[list[Refusal], NDArray[np.bool_]]:
    """Runs whose control period is no multiple of their time step, and all that are still to walk.


    The simulation refuses them before its first step, by the rule of
    :class:`validation.trial.simulate.Physics`.
    """
    accepted = screening.accepted
    if not {"controller.frequency", "simulation.time_step"} & set(cases.keys):
        numbers = np.arange(1)
    else:
        numbers = np.arange(len(cases))
    frequency = cases.column("controller.frequency", numbers)
    with np.errstate(divide="ignore", over="ignore"):
        ratio = 1.0 / (frequency * cases.column("simulation.time_step", numbers))
        bad = (np.rint(ratio) < 1.0) | (np.abs(ratio - np.rint(ratio)) > 1e-9 * ratio)
    bad = accepted & bad
    if not bad.any():
        return [], accepted
    asked = frequency[bad] if len(numbers) > 1 else frequency
    refusal = Refusal(
        BAD_PARAMETER,
        "the control period is no whole number of time steps",
        int(bad.sum()),
        key="controller.frequency",
        unit="Hz",
        asked=(float(asked.min()), float(asked.max())),
    )
    return [refusal], accepted & ~bad


def _cost(
    cases: Cases, screening: Screening, numbers: NDArray[np.int64], rates: Rates
) -> tuple[float, float, int]:
    """Simulated and processor time of some cases, motions left out [s]; time steps of the longest walk."""
    simulated = cases.definition.steps * screening.step_duration[numbers]
    ticks = cases.column("controller.frequency", numbers)
    steps = 1.0 / cases.column("simulation.time_step", numbers)
    seconds = rates.run + simulated * ticks * rates.tick + (simulated + rates.standing) * steps * rates.step
    longest = np.ceil(simulated * steps).max(initial=0.0)
    return float(simulated.sum()), float(seconds.sum()), int(longest) if np.isfinite(longest) else 0
