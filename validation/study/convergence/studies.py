"""What is varied, one thing at a time about the gait's own parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from ampm.exceptions import InputError

if TYPE_CHECKING:
    from ampm.parameters import RunParameters

LEVELS = 4
"""Of a numerical study, by default: two triplets, the least that can confirm an order."""

Level = tuple[str, float]
"""Key and value; the run's own parameters are :data:`OWN`."""
OWN: Level = ("", 0.0)


@dataclass(frozen=True)
class Topic:
    """One thing that can be varied.

    Attributes:
        name: of the study.
        kind: ``numerical``: a step or tolerance whose limit is zero; ``input``: a parameter of the model.
        key: of the run.
        unit: SI unit of its values.
        title: in words.
        shown: factor and unit for people.
        ratio: of neighbouring levels of a numerical study.
        factors: on the own value, of an input study, the own one among them.
    """

    name: str
    kind: Literal["numerical", "input"]
    key: str
    unit: str
    title: str
    shown: tuple[float, str]
    ratio: float = 0.0
    factors: tuple[float, ...] = ()


_ROOT = math.sqrt(0.5)
_MS = (1e3, "ms")
TOPICS: Mapping[str, Topic] = {
    item.name: item
    for item in (
        Topic("time_step", "numerical", "simulation.time_step", "s", "time step of the physics", _MS, 2.0),
        Topic("ik_grid", "numerical", "solver.ik_time_step", "s", "grid of the inverse kinematics", _MS, 2.0),
        Topic(
            "qp_tolerance", "numerical", "solver.tolerance", "1", "tolerance of the controller's QP",
            (1.0, ""), 10.0,
        ),
        # The stiffness of MuJoCo's contact goes with the square of the inverse time constant.
        Topic(
            "contact_stiffness", "input", "contact.time_constant", "s", "contact half and twice as stiff",
            _MS, factors=(1.0 / _ROOT, 1.0, _ROOT),
        ),
        Topic(
            "contact_depth", "input", "contact.impedance_width", "m",
            "contact that hardens over twice and half the depth", (1e3, "mm"), factors=(2.0, 1.0, 0.5),
        ),
    )
}  # fmt: skip
"""All studies. Contact parameters are of the model: none of their values is nearer to a limit than another,
so what they give is a sensitivity, an input uncertainty, and no convergence."""


@dataclass(frozen=True)
class Study:
    """One topic about one run.

    Attributes:
        topic: what is varied.
        values: of the key; of a numerical study from the own value down, of an input study ascending in
            stiffness.
        own: index of the run's own value.
    """

    topic: Topic
    values: tuple[float, ...]
    own: int

    @property
    def name(self) -> str:
        """The topic's name."""
        return self.topic.name

    @property
    def numerical(self) -> bool:
        """Whether its levels approach a limit."""
        return self.topic.kind == "numerical"

    @property
    def levels(self) -> tuple[Level, ...]:
        """The walk of every value: all studies share the one at the run's own parameters."""
        return tuple(
            OWN if index == self.own else (self.topic.key, value) for index, value in enumerate(self.values)
        )

    def shown(self, value: float) -> str:
        """A value for people, with its unit."""
        factor, unit = self.topic.shown
        return f"{factor * value:.4g} {unit}".rstrip()

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        topic = self.topic
        return {
            "kind": topic.kind,
            "title": topic.title,
            "key": topic.key,
            "unit": topic.unit,
            "values": list(self.values),
            "own": self.own,
            "ratio": topic.ratio or None,
        }


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
        if (names and topic.name not in names) or not _applies(topic, run.solver.qp):
            continue
        section, _, leaf = topic.key.partition(".")
        own = float(getattr(getattr(run, section), leaf))
        if topic.kind == "numerical":
            # Rounded, so that a tenth of 5e-5 is written as 5e-6.
            values = tuple(float(f"{own / topic.ratio**level:.15g}") for level in range(levels))
            found.append(Study(topic, values, 0))
        else:
            values = tuple(own * factor for factor in topic.factors)
            kept = tuple(value for value in values if value == own or _allowed(run, topic, value))
            found.append(Study(topic, kept, kept.index(own)))
    return [study for study in found if len(study.values) > 1]


def numerical_studies(qp: str) -> tuple[str, ...]:
    """Names of the studies that a numerical uncertainty is the sum of.

    Args:
        qp: the run's QP solver.
    """
    return tuple(item.name for item in TOPICS.values() if item.kind == "numerical" and _applies(item, qp))


def runs_of(run: RunParameters, found: Sequence[Study]) -> dict[Level, RunParameters]:
    """Every walk that the studies need, once, the costliest first."""
    levels = dict.fromkeys(level for study in found for level in study.levels if level != OWN)
    runs = {OWN: run} | {(key, value): run.replace({key: value}) for key, value in levels}

    def cost(item: tuple[Level, RunParameters]) -> float:
        return 1.0 / item[1].simulation.time_step + 1.0 / item[1].solver.ik_time_step

    # The finest steps last longest: begun first, they leave no worker idle at the end.
    return dict(sorted(runs.items(), key=cost, reverse=True))


def _applies(topic: Topic, qp: str) -> bool:
    """An active-set method stops at the solution: it has no tolerance."""
    return topic.name != "qp_tolerance" or qp == "osqp"


def _allowed(run: RunParameters, topic: Topic, value: float) -> bool:
    """Whether a level is within the parameter's bounds."""
    try:
        run.replace({topic.key: value})
    except InputError:
        return False
    return True
