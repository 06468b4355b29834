"""What is varied, one thing at a time about the gait's own parameters, and the walk at one level."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from ampm.exceptions import AmpmError, InputError, RefusedGait
from validation.judge.metrics import METRICS
from validation.store.machine import memory_peak
from validation.study.compare.metrics import switch_figures
from validation.trial.plan import Request

if TYPE_CHECKING:
    from ampm.parameters import RunParameters
    from validation.judge.examine import Walk
    from validation.judge.profiles import Profile

LEVELS = 4
"""Of a numerical study, by default: two triplets, the least that can confirm an order."""
STEPS = 6
"""Walked at every level, by default: the gait is periodic, and a record grows as the time step shrinks."""
_REFSAFE = 2.0  # MuJoCo raises a contact's time constant to this many time steps


@dataclass(frozen=True)
class Topic:
    """One thing that can be varied.

    Attributes:
        name: of the study.
        kind: ``numerical``: a step or tolerance whose limit is zero; ``input``: a parameter of the model.
        key: of the run.
        unit: SI unit of its values.
        ratio: of neighbouring levels of a numerical study.
        factors: on the own value, of an input study, the own one among them.
        title: in words.
        shown: factor and unit for people.
    """

    name: str
    kind: Literal["numerical", "input"]
    key: str
    unit: str
    ratio: float
    factors: tuple[float, ...]
    title: str
    shown: tuple[float, str]


_ROOT = math.sqrt(0.5)
_MS, _MM = (1e3, "ms"), (1e3, "mm")

TOPICS: Mapping[str, Topic] = {
    item.name: item
    for item in (
        Topic(
            name="time_step", kind="numerical", key="simulation.time_step", unit="s", ratio=2.0, factors=(),
            title="time step of the physics", shown=_MS,
        ),
        Topic(
            name="ik_grid", kind="numerical", key="solver.ik_time_step", unit="s", ratio=2.0, factors=(),
            title="grid of the inverse kinematics", shown=_MS,
        ),
        Topic(
            name="qp_tolerance", kind="numerical", key="solver.tolerance", unit="1", ratio=10.0, factors=(),
            title="tolerance of the controller's QP", shown=(1.0, ""),
        ),
        # The stiffness of MuJoCo's contact goes with the square of the inverse time constant.
        Topic(
            name="contact_stiffness", kind="input", key="contact.time_constant", unit="s", ratio=0.0,
            factors=(1.0 / _ROOT, 1.0, _ROOT), title="contact half and twice as stiff", shown=_MS,
        ),
        Topic(
            name="contact_depth", kind="input", key="contact.impedance_width", unit="m", ratio=0.0,
            factors=(2.0, 1.0, 0.5), title="contact that hardens over twice and half the depth", shown=_MM,
        ),
    )
}  # fmt: skip
"""All studies. Contact parameters are of the model: none of their values is nearer to a limit than another,
so what they give is a sensitivity, an input uncertainty, and no convergence."""

INSTRUMENT = frozenset(name for name, metric in METRICS.items() if metric.is_self_check)
COUNTS = frozenset(name for name, metric in METRICS.items() if metric.nature == "count")
EXTREME = ("_maximum", "_peak", "margin_", "switch_force_rate", "switch_vertical_force")
"""End or beginning of the names of extremes, which are never extrapolated."""


@dataclass(frozen=True)
class Study:
    """One topic about one run.

    Attributes:
        topic: what is varied.
        values: of the key; of a numerical study from the own value down, of an input study ascending in
            stiffness.
        own: index of the run's own value.
        caution: why its levels are no sequence that has a limit, empty if they are.
    """

    topic: Topic
    values: tuple[float, ...]
    own: int
    caution: str = ""

    def shown(self, value: float) -> str:
        """A level for people, with its unit."""
        factor, unit = self.topic.shown
        return f"{factor * value:.4g} {unit}".rstrip()


def studies(run: RunParameters, names: Sequence[str] = (), *, levels: int = LEVELS) -> list[Study]:
    """Studies of a run, in the order of :data:`TOPICS`.

    Args:
        run: the gait's own parameters.
        names: which, all by default.
        levels: of every numerical study, 3 at least.

    Raises:
        InputError: an unknown study, or too few or too many levels.
    """
    for name in names:
        if name not in TOPICS:
            raise InputError(f"study {name!r} is unknown; use one of {', '.join(TOPICS)}.", value=name)
    if not 3 <= levels <= 6:
        raise InputError(
            f"--levels {levels}: an observed order takes 3 levels, a confirmed one 4, and beyond 6 a record "
            "does not fit into the memory; choose 3 ... 6."
        )
    found = []
    for topic in TOPICS.values():
        if names and topic.name not in names:
            continue
        if topic.name == "qp_tolerance" and run.solver.qp != "osqp":
            continue  # an active-set method stops at the solution: it has no tolerance
        own = _value(run, topic.key)
        if topic.kind == "numerical":
            # Rounded, so that a tenth of 5e-5 is written as 5e-6.
            values = tuple(float(f"{own / topic.ratio**level:.15g}") for level in range(levels))
            found.append(Study(topic, values, 0, _caution(run, topic)))
        else:
            values = tuple(own * factor for factor in topic.factors)
            kept = tuple(value for value in values if value == own or _allowed(run, topic, value))
            found.append(Study(topic, kept, kept.index(own)))
    return [study for study in found if len(study.values) > 1]


def not_studied(name: str, studied: Collection[str], qp: str) -> tuple[str, ...]:
    """Numerical studies that a figure's uncertainty lacks: without them nobody knows how large it is.

    Args:
        name: of the figure.
        studied: names of the studies that were made.
        qp: the run's QP solver.
    """
    return tuple(item for item in inside(name, qp) if item not in studied)


def inside(name: str, qp: str) -> tuple[str, ...]:
    """Numerical studies that a figure's uncertainty is the sum of; none for a count, which is exact.

    Args:
        name: of the figure; empty for any that is neither count nor self-check.
        qp: the run's QP solver.
    """
    if name in COUNTS:
        return ()
    return tuple(
        item.name
        for item in TOPICS.values()
        if item.kind == "numerical"
        and not (item.name == "qp_tolerance" and qp != "osqp")
        and not (item.name == "time_step" and name in INSTRUMENT)
    )


def _value(run: RunParameters, key: str) -> float:
    section, _, leaf = key.partition(".")
    return float(getattr(getattr(run, section), leaf))


def _caution(run: RunParameters, topic: Topic) -> str:
    """Whether MuJoCo would walk another model on a coarse level than on a fine one."""
    constant, step = run.contact.time_constant, run.simulation.time_step
    if topic.name != "time_step" or constant >= _REFSAFE * step:
        return ""
    return (
        f"contact.time_constant = {1e3 * constant:g} ms is below twice the time step, and MuJoCo raises it "
        f"to {1e3 * _REFSAFE * step:g} ms there: the levels are of different contacts"
    )


def _allowed(run: RunParameters, topic: Topic, value: float) -> bool:
    """Whether a level is within the parameter's bounds, and walked as it says."""
    try:
        run.replace({topic.key: value})
    except InputError:
        return False
    return topic.key != "contact.time_constant" or value >= _REFSAFE * run.simulation.time_step


@dataclass(frozen=True)
class Figures:
    """What one walk says.

    Attributes:
        outcome: of the walk, or ``refused``.
        cause: of an early end, empty if there is none.
        values: metric or integral to value in SI units.
        units: SI unit of each.
        limits: metric to the profile's tolerance, in the metric's unit.
        weight: of the body [N].
        seconds: wall-clock time.
        memory: largest resident memory of the process so far [MB], NaN if unknown.
    """

    outcome: str
    cause: str
    values: Mapping[str, float]
    units: Mapping[str, str]
    limits: Mapping[str, float]
    weight: float
    seconds: float
    memory: float

    @property
    def completed(self) -> bool:
        """Whether the walk came to its end."""
        return self.outcome == "completed"


def walk_level(run: RunParameters, name: str, profile: Profile) -> Figures:
    """Plan and walk one level; runs in a worker and returns numbers only."""
    from validation.judge.examine import walk
    from validation.trial.plan import plan_walk

    start = time.perf_counter()
    try:
        result = walk(plan_walk(Request(name, run)), profile)
    except AmpmError as error:
        outcome = "refused" if isinstance(error, RefusedGait | InputError) else "infeasible"
        return Figures(outcome, str(error), {}, {}, {}, 0.0, time.perf_counter() - start, _memory())
    values, units = figures(result)
    end = result.record.outcome
    limits = {
        item.name: item.tolerance for item in result.evaluation.verdict.judged if item.tolerance is not None
    }
    return Figures(
        outcome=str(end.name),
        cause=end.cause,
        values=values,
        units=units,
        limits=limits,
        weight=result.evaluation.comparison.scales["body_weight"],
        seconds=time.perf_counter() - start,
        memory=_memory(),
    )


def figures(walk: Walk) -> tuple[dict[str, float], dict[str, str]]:
    """Value and unit of every metric, and of integral quantities and extremes beside them.

    The latter are named like the columns of a sweep's table; ``zmp_x_single_support_rmse`` and the like are
    the metric within one phase, and ``switch_zmp_x_near`` and the like what ``ampm compare`` shows.
    """
    comparison = walk.evaluation.comparison
    values = {name: metric.value for name, metric in walk.evaluation.metrics.items()}
    units = {name: metric.unit for name, metric in walk.evaluation.metrics.items()}

    def add(name: str, value: float, unit: str) -> None:
        values[name], units[name] = float(value), unit

    for signal in ("zmp_x", "zmp_y", "force_x", "force_y", "force_z"):
        found = comparison.signals[signal]
        for window in ("single_support", "double_support"):
            add(f"{signal}_{window}_rmse", found.windows[window].rmse, found.unit)
        add(f"{signal}_bias", found.run.bias, found.unit)
    if walk.record.outcome.completed:
        for name, value, unit in switch_figures(comparison):
            add(name, value, unit)
    return values, units


def _memory() -> float:
    peak = memory_peak()
    return math.nan if peak is None else peak


Runner = Callable[["RunParameters", str, "Profile"], Figures]
"""What walks one level; tests put their own in its place."""


def as_plain(study: Study) -> dict[str, Any]:
    """A study's description for JSON."""
    topic = study.topic
    return {
        "kind": topic.kind,
        "title": topic.title,
        "key": topic.key,
        "unit": topic.unit,
        "values": list(study.values),
        "own": study.own,
        "ratio": topic.ratio or None,
        "caution": study.caution or None,
    }
