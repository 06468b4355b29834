"""Variations for the studies, one at a time about the gait's own parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from validation.store.identity import parameter_values

LEVELS = 4
"""Levels of a numerical study by default: two triplets, the least that can confirm an order."""


@dataclass(frozen=True)
class Topic:
    """One variable of a study: a step or tolerance whose limit is zero, or a parameter of the model.

    Attributes:
        name: of the study.
        key: of the run.
        unit: SI unit of its values.
        title: as text.
        ratio: of neighbouring levels of a numerical study, 0 of a parameter of the model.
        factors: on the own value, of a parameter of the model, the own one among them.
    """

    name: str
    key: str
    unit: str
    title: str
    ratio: float = 0.0
    factors: tuple[float, ...] = ()

    @property
    def numerical(self) -> bool:
        """Whether its levels approach a limit."""
        return self.ratio > 0.0

    @property
    def display(self) -> tuple[float, str]:
        """Factor and unit for display."""
        return {"s": (1e3, "ms"), "m": (1e3, "mm")}.get(self.unit, (1.0, ""))

    def shown(self, value: float) -> str:
        """A value as text, with its unit."""
        factor, unit = self.display
        return f"{factor * value:.4g} {unit}".rstrip()

    def applies(self, qp: str) -> bool:
        """Whether it is a parameter of the run's QP solver: an active-set method has no tolerance."""
        return self.name != "qp_tolerance" or qp != "daqp"


_ROOT = math.sqrt(0.5)
_TOPICS = (
    Topic("time_step", "simulation.time_step", "s", "time step of the physics", 2.0),
    Topic("ik_grid", "solver.ik_time_step", "s", "grid of the inverse kinematics", 2.0),
    Topic("qp_tolerance", "solver.tolerance", "1", "tolerance of the controller's QP", 10.0),
    # The stiffness of MuJoCo's contact is proportional to the inverse square of the time constant.
    Topic("contact_stiffness", "contact.time_constant", "s", "contact half and twice as stiff",
          factors=(1.0 / _ROOT, 1.0, _ROOT)),
    Topic("contact_depth", "contact.impedance_width", "m",
          "contact that hardens over twice and half the depth", factors=(2.0, 1.0, 0.5)),
)  # fmt: skip
TOPICS: Mapping[str, Topic] = {item.name: item for item in _TOPICS}
"""All studies. Contact parameters belong to the model: their values approach no limit, so they give a
sensitivity, an input uncertainty, and no convergence."""


@dataclass(frozen=True, kw_only=True)
class Study(Topic):
    """One topic about one run.

    Attributes:
        values: of the key; of a numerical study from the own value down, of a parameter of the model
            ascending in stiffness.
        runs: complete parameters of every value; all studies share the run's own.
        own: index of the run's own value.
    """

    values: tuple[float, ...]
    runs: tuple[RunParameters, ...]
    own: int


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
        if (names and topic.name not in names) or not topic.applies(run.solver.qp):
            continue
        own = parameter_values(run)[topic.key]
        values = [own * factor for factor in topic.factors]
        if topic.numerical:  # rounded, so that a tenth of 5e-5 is written as 5e-6
            values = [own, *(float(f"{own / topic.ratio**level:.15g}") for level in range(1, levels))]
        runs: dict[float, RunParameters] = {}
        for value in values:
            try:
                runs[value] = run if value == own else run.replace({topic.key: value})
            except InputError:
                if topic.numerical:
                    raise
        if len(runs) > 1:  # a parameter of the model that can be varied within its bounds
            place = list(runs).index(own)
            found.append(Study(**vars(topic), values=tuple(runs), runs=tuple(runs.values()), own=place))
    return found


def numerical_studies(qp: str) -> tuple[str, ...]:
    """Names of the studies that a numerical uncertainty is the sum of.

    Args:
        qp: the run's QP solver.
    """
    return tuple(item.name for item in TOPICS.values() if item.numerical and item.applies(qp))
