"""A sample of a sweep's gaits, held against soles and legs, and some of them solved."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np

from ampm.exceptions import InputError, RefusedGait
from ampm.planner.support import plan_steps
from validation.progress import Progress
from validation.study.sweep.closed_form import BAD_PARAMETER
from validation.study.sweep.sampling import Cases

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.description import BodyDescription
    from ampm.parameters import BodyParameters, RunParameters

PROBED = 128
"""Different motions that are held against soles and legs at most; 5 to 45 ms each."""
MOTION_SECTIONS = ("gait", "body", "foot")
MOTION_KEYS = ("solver.ik_time_step",)
"""Sections and keys that a whole-body motion depends on; runs that agree in them share one."""
SOLVED = 20
"""Motions that are solved of a sweep that is larger than that; 1 to 3 s each."""


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

    def interval(self, confidence: float) -> tuple[float, float]:
        """Where that share is in the whole sweep [1]; it is known if every motion was looked at."""
        if self.complete:
            return self.passing, self.passing
        return wilson(self.passing, self.probed, confidence)


@dataclass(frozen=True)
class Solved:
    """Whole-body motions that were solved to see whether they close, with straight knees and limits.

    Attributes:
        motions: how many were tried, of those that soles and legs take.
        runs: accepted runs that have one of them.
        refused: of these runs, by reason.
        examples: of every reason, one refusal in words.
        seconds: what it took [s].
        complete: whether these are all that the sweep has.
    """

    motions: int = 0
    runs: int = 0
    refused: Mapping[str, int] = field(default_factory=dict)
    examples: Mapping[str, str] = field(default_factory=dict)
    seconds: float = 0.0
    complete: bool = False

    @property
    def passing(self) -> float:
        """Share of these runs whose motion can be made; 1 if none was tried [1]."""
        return 1.0 - sum(self.refused.values()) / self.runs if self.runs else 1.0

    def interval(self, confidence: float) -> tuple[float, float]:
        """Where that share is in the whole sweep [1]; it is only bounded by 1 if none was tried."""
        if self.complete or not self.motions:
            return self.passing, self.passing
        return wilson(self.passing, self.motions, confidence)


def motion_numbers(cases: Cases, numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of the whole-body motion of each of some cases: equal where all that it depends on is."""
    motion = np.zeros(len(numbers), dtype=np.int64)
    for axis in cases.axes:
        if axis.key.partition(".")[0] in MOTION_SECTIONS or axis.key in MOTION_KEYS:
            _, value = np.unique(axis.values, return_inverse=True)
            motion = motion * (int(value.max()) + 1) + value[axis.index(numbers)]
            _, motion = np.unique(motion, return_inverse=True)  # small again, whatever the number of axes
    return motion


def probe_bodies(
    cases: Cases, numbers: NDArray[np.int64], motion: NDArray[np.int64], most: int
) -> tuple[Probe, list[tuple[int, int]]]:
    """Hold one run of every motion, or of some drawn at random, against soles and legs.

    Returns:
        What was found; and of the motions that passed, a case each and how many runs share it.
    """
    _, first, count = np.unique(motion, return_index=True, return_counts=True)
    # At random: every so manieth of a grid would always have the same value of the last key.
    chosen = _drawn(len(first), most, cases.definition.seed, len(cases.definition.vary))
    refused: dict[str, int] = {}
    examples: dict[str, str] = {}
    passed = []
    bodies: dict[BodyParameters, BodyDescription] = {}
    for index in chosen:
        case, runs = int(numbers[first[index]]), int(count[index])
        try:
            _hold_against_body(cases.run(case), bodies)
        except InputError as error:
            reason, words = BAD_PARAMETER, str(error)
        except RefusedGait as error:
            reason, words = error.reason, str(error)
        else:
            passed.append((case, runs))
            continue
        refused[reason] = refused.get(reason, 0) + runs
        examples.setdefault(reason, words)
    return Probe(len(first), len(chosen), int(count[chosen].sum()), refused, examples), passed


def solve_motions(
    cases: Cases, passed: list[tuple[int, int]], most: int, *, all_probed: bool, stages: Progress
) -> Solved:
    """Solve the whole-body motion of some of the gaits that soles and legs take.

    Args:
        cases: of the sweep.
        passed: case and number of runs of each motion, see :func:`probe_bodies`.
        most: motions that are solved at most.
        all_probed: whether these are all motions of the sweep.
        stages: where to report progress.
    """
    from validation.trial import plan

    chosen = _drawn(len(passed), most, cases.definition.seed, len(cases.definition.vary), 1)
    refused: dict[str, int] = {}
    examples: dict[str, str] = {}
    runs = 0
    start = time.perf_counter()
    told = "motion of 1 gait" if len(chosen) == 1 else f"motions of {len(chosen)} gaits"
    with stages.stage(f"{told}, as a sample", "gaits") as stage:
        for done, index in enumerate(chosen, start=1):
            case, count = passed[index]
            runs += count
            try:
                plan.plan_walk(plan.Request(cases.name(case), cases.run(case)))
            except InputError as error:
                reason, words = BAD_PARAMETER, str(error)
            except RefusedGait as error:
                reason, words = error.reason, str(error)
            except Exception as error:  # as in a sweep, where this run would be one row
                reason, words = f"crashed ({type(error).__name__})", str(error)
            else:
                reason, words = "", ""
            if reason:
                refused[reason] = refused.get(reason, 0) + count
                examples.setdefault(reason, " ".join(words.split()))
            stage.advance(done, len(chosen))
    seconds = time.perf_counter() - start
    return Solved(len(chosen), runs, refused, examples, seconds, all_probed and len(chosen) == len(passed))


def wilson(share: float, number: int, confidence: float) -> tuple[float, float]:
    """Wilson's interval of a share that was seen in a sample [1].

    Args:
        share: in the sample.
        number: size of the sample; nothing is known from 0.
        confidence: of the interval, both sides.
    """
    if number <= 0:
        return 0.0, 1.0
    z = NormalDist().inv_cdf(0.5 + confidence / 2.0)
    middle = (share + z * z / (2.0 * number)) / (1.0 + z * z / number)
    half = z / (1.0 + z * z / number) * math.sqrt(share * (1.0 - share) / number + (z / (2.0 * number)) ** 2)
    return max(middle - half, 0.0), min(middle + half, 1.0)


def _drawn(number: int, most: int, *seed: int) -> NDArray[np.int64]:
    """Numbers under ``number``: all, or ``most`` of them at random; ascending."""
    if number <= most:
        return np.arange(number)
    return np.sort(np.random.default_rng(seed).choice(number, size=most, replace=False))


def _hold_against_body(run: RunParameters, bodies: dict[BodyParameters, BodyDescription]) -> None:
    """What planning asks of a body before it solves the motion.

    Raises:
        InputError, RefusedGait: as planning does.
    """
    from ampm.body.feasibility import check_body
    from models.human import build

    if run.body not in bodies:
        bodies[run.body] = build(run.body, run.contact, run.simulation).description
    description = bodies[run.body]
    # The first step stands for all.
    gait = run.gait.model_copy(update={"steps": min(run.gait.steps, 2)})
    plan = plan_steps(gait, run.body.mass, run.foot, description.sole)
    check_body(plan, description)
