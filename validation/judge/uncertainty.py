"""Numerical uncertainty of a gait's metrics, as ``ampm convergence`` stores it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from ampm.exceptions import InputError

if TYPE_CHECKING:
    from validation.trial.plan import Request

FILE = "convergence.json"
_FREE = ("gait.steps",)
"""Keys in which a study and a run may differ: the gait is periodic."""


@dataclass(frozen=True)
class Uncertainty:
    """Numerical uncertainty of a gait's metrics.

    Attributes:
        gait: name.
        steps: walked at every level.
        run: key of the run that was studied.
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
        own = request.run.model_dump()
        for section, entries in self.parameters.items():
            for key, value in entries.items():
                here = own.get(section, {}).get(key)
                if f"{section}.{key}" not in _FREE and _number(value) != here:
                    return f"{section}.{key} = {value}, and here {here}"
        return ""

    def as_dict(self) -> dict[str, Any]:
        """For ``summary.json``."""
        return {
            "gait": self.gait,
            "steps": self.steps,
            "run": self.run,
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
    if not _is_study(table):
        raise InputError(
            f"--uncertainty {file} is no convergence study; give the {FILE} that 'ampm convergence --out' "
            "writes."
        )
    if not table["metrics"]:
        raise InputError(f"--uncertainty {file} holds no metrics: its walk did not complete; study again.")
    values, incomplete = {}, {}
    for name, entry in table["metrics"].items():
        if lacking := tuple(entry["not_studied"]):
            incomplete[name] = lacking
        raw = entry["uncertainty_at_least"]
        if raw is None:
            if lacking:
                continue  # a sum over no study is no zero
            raw = "inf"  # not measured in the study: nothing bounds it
        value = _number(raw)
        if isinstance(value, bool) or not isinstance(value, int | float) or not value >= 0.0:
            raise InputError(
                f"--uncertainty {file}: metrics.{name}.uncertainty_at_least = {raw!r} is no number of at "
                "least 0; correct it, or study the gait again."
            )
        values[name] = float(value)
    return Uncertainty(
        gait=table["gait"],
        steps=table["steps"],
        run=table["run"],
        values=MappingProxyType(values),
        parameters=MappingProxyType(table["parameters"]),
        studies=tuple(table["uncertainty_of"]),
        not_studied=tuple(table["not_studied"]),
        incomplete=MappingProxyType(incomplete),
    )


def _is_study(table: Any) -> bool:
    """Whether it is a ``convergence.json``: a run's ``summary.json`` has metrics too, and no levels."""
    kinds = {
        "gait": str, "steps": int, "run": str, "levels": dict, "metrics": dict, "parameters": dict,
        "uncertainty_of": list, "not_studied": list,
    }  # fmt: skip
    if not isinstance(table, dict) or not all(isinstance(table.get(key), kinds[key]) for key in kinds):
        return False
    entries = table["metrics"].values()
    return all(
        isinstance(entry, dict)
        and "uncertainty_at_least" in entry
        and isinstance(entry.get("not_studied"), list)
        for entry in entries
    ) and all(isinstance(section, dict) for section in table["parameters"].values())


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
    return math.inf if value == "inf" else value
