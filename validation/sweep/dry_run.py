"""What a sweep would be, without walking a step: how many runs, which are refused and why, how much time."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.markup import escape

from ampm.exceptions import InputError, RefusedGait
from ampm.gait import plan_gait
from validation.console import print_line, print_table
from validation.sweep.closed_form import BAD_PARAMETER
from validation.sweep.definition import SweepDefinition
from validation.sweep.sampling import Cases
from validation.sweep.sampling import cases as cases_of
from validation.sweep.screening import Refusal, Screening, screen

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.body import BodyDescription
    from ampm.parameters import BodyParameters, RunParameters

_EXAMPLES = 3  # bodily refusals told in full

PROBED = 128
"""Different motions that are held against soles and legs at most; 5 to 45 ms each."""
MOTION_SECTIONS = ("gait", "body", "foot")
MOTION_KEYS = ("solver.ik_time_step",)
"""Sections and keys that a whole-body motion depends on; runs that agree in them share one."""
UNSEEN = (
    "knees too straight, joint limits and motions that do not close show only when the whole-body motion is "
    "solved; falls only when it is walked"
)
"""What no dry run sees."""


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
class Probe:
    """Plans held against soles and legs, as every run is before its motion is solved.

    Attributes:
        motions: different motions among the accepted runs.
        probed: how many of them were looked at.
        runs: accepted runs that have one of the probed motions.
        refused: of these runs, by reason.
        examples: of every reason, one refusal in words.
    """

    motions: int
    probed: int
    runs: int
    refused: Mapping[str, int]
    examples: Mapping[str, str]

    @property
    def complete(self) -> bool:
        """Whether every motion was looked at."""
        return self.probed == self.motions

    @property
    def passing(self) -> float:
        """Share of the probed runs that the body takes [1]."""
        return 1.0 - sum(self.refused.values()) / self.runs if self.runs else 0.0


@dataclass(frozen=True)
class DryRun:
    """A sweep that was not walked.

    Attributes:
        definition: the sweep.
        screening: the formula's answer to every run.
        refusals: runs refused by bounds, formula, or clock, with what would pass.
        probe: what soles and legs say, of all or some.
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
        """Runs expected to get as far as their whole-body motion; two digits, if only some were looked at."""
        number = self.accepted * self.probe.passing
        if self.probe.complete or number < 10:
            return round(number)
        unit = 10 ** (math.floor(math.log10(number)) - 1)
        return round(number / unit) * unit

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready, times in s."""
        definition, probe = self.definition, self.probe
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
                "expected_to_walk": self.walking,
            },
            "unseen": UNSEEN,
            "notes": list(definition.notes()),
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
) -> DryRun:
    """Count, screen and estimate a sweep.

    Args:
        definition: the sweep.
        workers: processes; one per core by default.
        rates: what a run costs, if it has been measured.
        probed: different motions that are held against soles and legs at most.

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
    motion = _motions(cases, numbers)
    probe = _probe(cases, numbers, motion, probed)
    simulated, processor = _cost(cases, screening, numbers, rates)
    share = probe.passing
    processor = share * (processor + probe.motions * rates.motion)
    return DryRun(
        definition=definition,
        screening=screening,
        refusals=(*screening.refusals(), *late),
        probe=probe,
        simulated=share * simulated,
        processor=processor,
        wall_clock=rates.start + processor / (min(workers, max(len(numbers), 1)) * rates.efficiency),
        workers=workers,
        rates=rates,
    )


def _clock(cases: Cases, screening: Screening) -> tuple[list[Refusal], NDArray[np.bool_]]:
    """Runs whose control period is no multiple of their time step, and all that are still to walk.

    The simulation refuses them before its first step, by the rule of :class:`validation.simulate.Physics`.
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


def _motions(cases: Cases, numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of the whole-body motion of each of some cases: equal where all that it depends on is."""
    motion = np.zeros(len(numbers), dtype=np.int64)
    for axis in cases.axes:
        if axis.key.partition(".")[0] in MOTION_SECTIONS or axis.key in MOTION_KEYS:
            _, value = np.unique(axis.values, return_inverse=True)
            motion = motion * (int(value.max()) + 1) + value[axis.index(numbers)]
            _, motion = np.unique(motion, return_inverse=True)  # small again, whatever the number of axes
    return motion


def _probe(cases: Cases, numbers: NDArray[np.int64], motion: NDArray[np.int64], most: int) -> Probe:
    """Hold one run of every motion, or of some drawn at random, against soles and legs."""
    _, first, count = np.unique(motion, return_index=True, return_counts=True)
    chosen = np.arange(len(first))
    if len(first) > most:
        # At random: every so manieth of a grid would always have the same value of the last key.
        generator = np.random.default_rng([cases.definition.seed, len(cases.definition.vary)])
        chosen = np.sort(generator.choice(len(first), size=most, replace=False))
    refused: dict[str, int] = {}
    examples: dict[str, str] = {}
    bodies: dict[BodyParameters, BodyDescription] = {}
    for index in chosen:
        run = cases.run(int(numbers[first[index]]))
        try:
            _hold_against_body(run, bodies)
        except InputError as error:
            reason, words = BAD_PARAMETER, str(error)
        except RefusedGait as error:
            reason, words = error.reason, str(error)
        else:
            continue
        refused[reason] = refused.get(reason, 0) + int(count[index])
        examples.setdefault(reason, words)
    return Probe(len(first), len(chosen), int(count[chosen].sum()), refused, examples)


def _hold_against_body(run: RunParameters, bodies: dict[BodyParameters, BodyDescription]) -> None:
    """What planning asks of a body before it solves the motion.

    Raises:
        InputError, RefusedGait: as planning does.
    """
    from ampm.feasibility import check_body
    from models.human import build

    if run.body not in bodies:
        bodies[run.body] = build(run.body, run.contact, run.simulation).description
    description = bodies[run.body]
    # The first step stands for all.
    gait = run.gait.model_copy(update={"steps": min(run.gait.steps, 2)})
    plan = plan_gait(gait, mass=run.body.mass, foot=run.foot, sole=description.sole)
    check_body(plan, description)


def _cost(
    cases: Cases, screening: Screening, numbers: NDArray[np.int64], rates: Rates
) -> tuple[float, float]:
    """Simulated and processor time of some cases, motions left out [s]."""
    simulated = cases.definition.steps * screening.step_duration[numbers]
    ticks = cases.column("controller.frequency", numbers)
    steps = 1.0 / cases.column("simulation.time_step", numbers)
    seconds = rates.run + simulated * ticks * rates.tick + (simulated + rates.standing) * steps * rates.step
    return float(simulated.sum()), float(seconds.sum())


# ------------------------------------------------------------------------- words


def print_dry_run(dry: DryRun) -> None:
    """Print a dry run for a reader."""
    definition, probe, rates = dry.definition, dry.probe, dry.rates
    rows = [("runs", _count(dry.runs), "", f"of {escape(definition.gait)}, {definition.steps} steps each")]
    for item in dry.refusals:
        share = _share(item.count, dry.runs)
        rows.append((f"refused: {item.reason}", _count(item.count), share, _hint(item)))
    rows.append(("accepted by the formula", _count(dry.accepted), _share(dry.accepted, dry.runs), ""))
    of = "" if probe.complete else f"of {_count(probe.runs)} looked at"
    body = sorted(probe.refused.items(), key=lambda item: -item[1])
    for reason, count in body:
        rows.append((f"  the body refuses: {reason}", _count(count), _share(count, probe.runs), of))
    about = "" if probe.complete else "about "
    rows.append(("expected to walk", about + _count(dry.walking), _share(dry.walking, dry.runs), ""))
    print_table(
        f"dry run of {escape(definition.name)}: {', '.join(definition.keys)}",
        (("", "left"), ("runs", "right"), ("share", "right"), ("", "left")),
        rows,
    )
    for reason, _ in body[:_EXAMPLES]:
        print_line(f"  {reason}, for example: {escape(probe.examples[reason])}")
    print_line(
        f"  time              {duration_text(dry.wall_clock)} with {dry.workers} "
        f"worker{'s' if dry.workers > 1 else ''}: {duration_text(dry.processor)} of processor time for "
        f"{duration_text(dry.simulated)} of walking and at most {_count(probe.motions)} new "
        f"motion{'' if probe.motions == 1 else 's'}"
    )
    print_line(
        f"  assumed           {rates.real_time_factor():.1f} times real time at 500 Hz and 2 ms, "
        f"{rates.motion:g} s for a new motion, {rates.run:g} s for the rest of a run, on one core of a "
        "server; recordings come on top"
    )
    print_line(f"  not seen          {UNSEEN}")
    for note in definition.notes():
        print_line(f"  note              {note}")


def _hint(item: Refusal) -> str:
    """What was asked for, and what would pass."""
    asked = "" if item.asked is None else f"{item.key} is {_span(item.asked)}"
    way_out = item.way_out()
    if not way_out:
        return f"{item.meaning}; {asked}" if asked else item.meaning
    return f"{asked}; passes if {way_out.removeprefix(f'{item.key} ')}"


def duration_text(seconds: float) -> str:
    """A time in two words: ``3 h 20 min``."""
    if not math.isfinite(seconds):
        return "for ever"
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    if minutes < 90:
        return f"{minutes} min"
    hours, minutes = divmod(minutes, 60)
    if hours < 48:
        return f"{hours} h {minutes} min" if minutes else f"{hours} h"
    return f"{seconds / 86400:.1f} days"


def _count(number: int) -> str:
    return f"{number:,}"


def _share(number: int, total: int) -> str:
    return f"{100.0 * number / total:.3g} %" if total else "-"


def _span(ends: tuple[float, float]) -> str:
    low, high = (f"{value:.4g}" for value in ends)
    return low if low == high else f"{low} ... {high}"
