"""Levels of the studies, one parameter at a time about the gait's own, and the walk of one level."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from validation.judge.metrics import evaluate
from validation.store.environment import parameter_values
from validation.study.row_file import Row
from validation.study.walk_options import walk_request
from validation.trial.engine import check_drake

LEVELS = 4
"""Levels of a numerical study by default: two triplets, the least that can confirm an order."""
OWN = "own"
"""Task of the walk at the gait's own values, which all studies share."""
NUMERICAL: Mapping[str, tuple[str, float]] = {
    "time_step": ("simulation.time_step", 2.0),
    "ik_grid": ("solver.ik_time_step", 2.0),
    "qp_tolerance": ("solver.tolerance", 10.0),
}
"""Key of a step or tolerance whose limit is zero, and ratio of neighbouring levels, by study."""
CONTACT_MODELS: Mapping[str, tuple[str, tuple[float, ...]]] = {
    # The stiffness of MuJoCo's contact is proportional to the inverse square of the time constant.
    "contact_stiffness": ("contact.time_constant", (2.0**0.5, 0.5**0.5)),
    "contact_depth": ("contact.impedance_width", (2.0, 0.5)),
    "contact_damping": ("contact.damping_ratio", (0.5, 2.0)),
    "contact_impedance": ("contact.impedance_min", (0.5, 1.5)),
    "drake_stiffness": ("drake.stiffness", (0.5, 2.0)),
    "drake_dissipation": ("drake.dissipation", (0.5, 2.0)),
}
"""Key of a parameter of the contact law, and factors on its own value, by study.

It belongs to the model: its values approach no limit, so they give a spread, and no order. MuJoCo and Drake
have parameters of their own.
"""
ENGINES = ("mujoco", "drake")


@dataclass(frozen=True)
class Study:
    """Levels of one parameter."""

    name: str  # of the study
    key: str  # of the parameter
    # of the key in its unit, the gait's own one first; those of a numerical study fall
    values: tuple[Any, ...]
    ratio: float = 0.0  # of neighbouring levels of a numerical study, 0 of a contact law or the engine

    @property
    def numerical(self) -> bool:
        """Whether its levels approach a limit."""
        return self.ratio > 0.0

    @property
    def tasks(self) -> tuple[str, ...]:
        """Task of each level."""
        return OWN, *(f"{self.key}={value}" for value in self.values[1:])


def studies(run: RunParameters, levels: int = LEVELS) -> list[Study]:
    """Numerical studies of a run, then those of its contact law and, if Drake is installed, of the engine.

    Args:
        run: the gait's own parameters.
        levels: of every numerical study, 3 ... 6.

    Raises:
        InputError: too few or too many levels.
    """
    if not 3 <= levels <= 6:
        raise InputError(
            f"--levels {levels}: an observed order takes 3 levels, a confirmed one 4, and beyond 6 a record "
            "does not fit into the memory; choose 3 ... 6."
        )
    own = parameter_values(run)
    found = []
    for name, (key, ratio) in NUMERICAL.items():
        # Rounded, so that a tenth of 5e-5 is written as 5e-6.
        values = tuple(float(f"{own[key] / ratio**level:.15g}") for level in range(levels))
        found.append(Study(name, key, values, ratio))
    for name, (key, factors) in CONTACT_MODELS.items():
        if key.startswith("drake.") == (run.simulation.engine == "drake"):
            found.append(Study(name, key, _possible(run, key, [factor * own[key] for factor in factors])))
    found.append(Study("engine", "simulation.engine", _possible(run, "simulation.engine", ENGINES)))
    return [study for study in found if len(study.values) > 1]


def _possible(run: RunParameters, key: str, values: Sequence[Any]) -> tuple[Any, ...]:
    """The own value of a key, and others that the model can have; of an engine those that are installed."""
    found = [parameter_values(run)[key]]
    for value in values:
        with suppress(InputError):
            changed = run.replace({key: value})
            if changed.simulation.engine == "drake":
                check_drake(changed)
            if value not in found:
                found.append(value)
    return tuple(found)


def runs_of(run: RunParameters, found: Sequence[Study]) -> dict[str, RunParameters]:
    """Complete parameters of every level, by task; one thing changes at a time."""
    runs = {OWN: run}
    for study in found:
        for task, value in zip(study.tasks[1:], study.values[1:], strict=True):
            runs[task] = run.replace({study.key: value})
    return runs


def walk_level(**options: Any) -> Row:
    """Walk one level; the options are those of :func:`validation.study.walk_options.walk_request`.

    Returns:
        ``outcome`` and ``cause``; ``values`` of all metrics in SI units; ``scales``, reference quantities of
        the walk.
    """
    walk = walk_request(**options).comparison
    end = walk.record.outcome
    return {
        "outcome": str(end.name),
        "cause": end.cause,
        "values": {name: metric.value for name, metric in evaluate(walk).items()},
        "scales": dict(walk.scales),
    }
