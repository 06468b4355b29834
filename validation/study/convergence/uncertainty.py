"""Reading ``convergence.json`` back: the numerical uncertainty of a run's metrics, for its verdict."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from ampm.exceptions import InputError
from validation.study.convergence.studies import TOPICS, inside, not_studied
from validation.trial.plan import Request

FILE = "convergence.json"
_FREE = ("gait.steps",)
"""Keys in which a study and a run may differ: the gait is periodic."""


@dataclass(frozen=True)
class Uncertainty:
    """Numerical uncertainty of a gait's metrics.

    Attributes:
        gait: name.
        steps: walked at every level; 0 if the file does not say.
        run: key of the run that was studied, empty if the file does not say.
        values: metric to uncertainty in its SI unit; infinite where there is no bound. Of a metric that is
            ``incomplete`` what the studies that were made leave, and nothing if none was.
        parameters: of the run, by section.
        studies: inside the uncertainty.
        not_studied: numerical studies of the gait that were not made.
        incomplete: metric to the studies that its uncertainty lacks.
    """

    gait: str
    steps: int
    run: str
    values: Mapping[str, float]
    parameters: Mapping[str, Mapping[str, Any]]
    studies: tuple[str, ...] = ()
    not_studied: tuple[str, ...] = ()
    incomplete: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def bounds(self) -> Mapping[str, float]:
        """Metric to what a difference must exceed; infinite where studies are lacking."""
        return {**self.values, **dict.fromkeys(self.incomplete, math.inf)}

    def difference(self, request: Request) -> str:
        """First key in which a run is not the one that was studied, with both values; empty if it is."""
        asked = request.run.model_dump()
        for section, entries in self.parameters.items():
            for key, value in entries.items():
                name = f"{section}.{key}"
                own = asked.get(section, {}).get(key)
                if name not in _FREE and _number(value) != own:
                    return f"{name} = {value}, and here {own}"
        return ""

    def as_dict(self) -> dict[str, Any]:
        """For ``summary.json``."""
        return {
            "gait": self.gait,
            "steps": self.steps,
            "run": self.run or None,
            "studies": list(self.studies),
            "not_studied": list(self.not_studied),
        }


def load_uncertainty(path: Path) -> Uncertainty:
    """Read what ``ampm convergence`` wrote.

    Args:
        path: ``convergence.json``, or the folder that holds it.

    Raises:
        InputError: there is no such file, or it holds no convergence study.
    """
    file = path / FILE if path.is_dir() else path
    try:
        table = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            f"--uncertainty {file} cannot be read ({error.strerror}); give the {FILE} of 'ampm convergence'."
        ) from None
    except ValueError as error:
        raise InputError(f"--uncertainty {file} is no JSON ({error}); give a {FILE}.") from None
    study = _study(table)
    if study is None:
        raise InputError(
            f"--uncertainty {file} is no convergence study; give the {FILE} that 'ampm convergence --out' "
            "writes."
        )
    metrics, made, qp = study
    if not metrics:
        raise InputError(f"--uncertainty {file} holds no metrics: its walk did not complete; study again.")
    values, incomplete = {}, {}
    for name, entry in metrics.items():
        lacking = not_studied(name, made, qp)
        if lacking:
            incomplete[name] = lacking
        if lacking and not set(made) & set(inside(name, qp)):
            continue  # a sum over no study is no zero
        raw = entry.get("uncertainty_at_least", entry.get("uncertainty"))
        if raw is None:
            raw = "inf"  # not measured in the study: nothing bounds it
        value = _number(raw)
        if isinstance(value, bool) or not isinstance(value, int | float) or not value >= 0.0:
            raise InputError(
                f"--uncertainty {file}: metrics.{name}.uncertainty = {raw!r} is no number of at least 0; "
                "correct it, or study the gait again."
            )
        values[name] = float(value)
    return Uncertainty(
        gait=table["gait"],
        steps=table["steps"],
        run=str(table.get("run") or ""),
        values=MappingProxyType(values),
        parameters=MappingProxyType(table["parameters"]),
        studies=tuple(name for name in inside("", qp) if name in made),
        not_studied=not_studied("", made, qp),
        incomplete=MappingProxyType(incomplete),
    )


def _study(table: Any) -> tuple[Mapping[str, Mapping[str, Any]], tuple[str, ...], str] | None:
    """Metrics, names of the studies and QP solver of what may be a ``convergence.json``; None if it is none.

    A run's ``summary.json`` has metrics too, and no levels.
    """
    if not isinstance(table, dict):
        return None
    kinds = {"gait": str, "steps": int, "levels": dict, "metrics": dict, "parameters": dict}
    if not all(isinstance(table.get(key), kind) for key, kind in kinds.items()) or table["steps"] < 1:
        return None
    entries = (table["levels"], table["metrics"], table["parameters"])
    if not all(isinstance(item, dict) for part in entries for item in part.values()):
        return None
    qp = table["parameters"].get("solver", {}).get("qp")
    if not isinstance(qp, str) or not set(table["levels"]) <= set(TOPICS):
        return None
    return table["metrics"], tuple(table["levels"]), qp


def matching(known: Sequence[Uncertainty], request: Request) -> Uncertainty:
    """The study of this very gait.

    Raises:
        InputError: none of them is.
    """
    differences = []
    for item in known:
        difference = item.difference(request)
        if not difference:
            return item
        differences.append(f"{item.gait} ({difference})")
    raise InputError(
        f"--uncertainty: no study is of {request.name}, they are of {'; '.join(differences)}; run "
        f"'ampm convergence' with the gait and the --set of this run, and give its {FILE}."
    )


def _number(value: Any) -> Any:
    """JSON has no infinity; the project writes it as a word."""
    if value == "inf":
        return math.inf
    return value
