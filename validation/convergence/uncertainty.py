"""Reading ``convergence.json`` back: the numerical uncertainty of a run's metrics, for its verdict."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from ampm.exceptions import InputError
from validation.planning import Request

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
        values: metric to uncertainty in its SI unit; infinite where there is no bound.
        parameters: of the run, by section; empty if the file does not say.
    """

    gait: str
    steps: int
    run: str
    values: Mapping[str, float]
    parameters: Mapping[str, Mapping[str, Any]]

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
        return {"gait": self.gait, "steps": self.steps, "run": self.run or None}


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
    metrics = table.get("metrics") if isinstance(table, Mapping) else None
    if not isinstance(metrics, Mapping) or not metrics:
        raise InputError(f"--uncertainty {file} holds no metrics; give the {FILE} of 'ampm convergence'.")
    values = {}
    for name, entry in metrics.items():
        raw = entry.get("uncertainty") if isinstance(entry, Mapping) else None
        if raw is None:
            continue  # not measured: nothing is known of it
        value = _number(raw)
        if isinstance(value, bool) or not isinstance(value, int | float) or not value >= 0.0:
            raise InputError(
                f"--uncertainty {file}: metrics.{name}.uncertainty = {raw!r} is no number of at least 0; "
                "correct it, or study the gait again."
            )
        values[str(name)] = float(value)
    parameters = table.get("parameters")
    return Uncertainty(
        gait=str(table.get("gait", "gait")),
        steps=int(table.get("steps") or 0),
        run=str(table.get("run") or ""),
        values=MappingProxyType(values),
        parameters=MappingProxyType(parameters if isinstance(parameters, dict) else {}),
    )


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
