"""Numerical uncertainty of a gait's metrics, as ``ampm convergence`` stores it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, NonNegativeFloat, ValidationError

from ampm.exceptions import InputError
from ampm.parameters import OPTION_TABLES
from validation.store.json import json_ready

if TYPE_CHECKING:
    from validation.trial.plan import Request

FILE = "convergence.json"
_FREE = "gait.steps"
"""Key in which a study and a run may differ: the gait is periodic."""


@dataclass(frozen=True)
class Uncertainty:
    """Numerical uncertainty of a gait's metrics.

    Attributes:
        gait: name.
        steps: walked at every level.
        run: key of the run that was studied.
        values: metric to uncertainty in its SI unit; infinite where there is no bound. Of a metric that is
            ``incomplete``, the sum of the studies that were made; no entry if none was.
        parameters: of the run, by section.
        studies: inside the uncertainty.
        not_studied: numerical studies of the gait that were not made.
        incomplete: metric to the studies that its uncertainty lacks.
        spreads: metric to its largest change by another contact law or engine, in its SI unit; infinite where
            a walk with one did not complete.
    """

    gait: str
    steps: int
    run: str
    values: Mapping[str, float]
    parameters: Mapping[str, Mapping[str, Any]]
    studies: tuple[str, ...] = ()
    not_studied: tuple[str, ...] = ()
    incomplete: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    spreads: Mapping[str, float] = field(default_factory=dict)

    @property
    def bounds(self) -> Mapping[str, float]:
        """Metric to the least difference that is a result; infinite where studies are lacking."""
        return {**self.values, **dict.fromkeys(self.incomplete, math.inf)}

    def difference(self, request: Request) -> str:
        """First key in which a run differs from the studied one, with both values; empty if none does."""
        own = json_ready(request.run.model_dump())
        if own.pop("footsteps", None):
            return "it walks over footsteps"
        studied = json_ready(self.parameters)
        for section, _, name in (table.partition(".") for table in OPTION_TABLES):
            studied[section] = {name: None, **studied.get(section, {})}
        for section, entries in studied.items():
            for key, value in entries.items():
                here = own.get(section, {}).get(key)
                if f"{section}.{key}" != _FREE and value != here:
                    return f"{section}.{key} = {value}, and here {here}"
        return ""

    def as_dict(self) -> dict[str, Any]:
        """Description of the study, for ``summary.json``."""
        return {key: getattr(self, key) for key in ("gait", "steps", "run", "studies", "not_studied")}


class _Metric(BaseModel):
    """Entries read for a metric from the file; other keys are ignored, here and below."""

    uncertainty_at_least: NonNegativeFloat | None
    not_studied: tuple[str, ...]
    spread: NonNegativeFloat | None = None


class _File(BaseModel):
    gait: str
    steps: int
    run: str
    levels: dict[str, Any]  # a run's summary.json has metrics too, and no levels
    metrics: dict[str, _Metric]
    parameters: dict[str, dict[str, Any]]
    studies: tuple[str, ...]
    not_studied: tuple[str, ...]


def load_uncertainty(path: Path) -> Uncertainty:
    """Read what ``ampm convergence`` wrote.

    Args:
        path: ``convergence.json``, or the folder that holds it.

    Raises:
        InputError: there is no such file, or it holds no convergence study.
    """
    file = path / FILE if path.is_dir() else path
    try:
        table = _File.model_validate_json(file.read_bytes())
    except OSError as error:
        raise InputError(
            f"--uncertainty {file} cannot be read ({error.strerror}); give the {FILE} of 'ampm convergence'."
        ) from None
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise InputError(
            f"--uncertainty {file} is no convergence study ({where}{': ' if where else ''}{first['msg']}); "
            f"give the {FILE} that 'ampm convergence --out' writes."
        ) from None
    if not table.metrics:
        raise InputError(f"--uncertainty {file} holds no metrics: its walk did not complete; study again.")
    # A metric that the study did not measure has no bound; without a study there is no value, not zero.
    values = {
        name: math.inf if item.uncertainty_at_least is None else item.uncertainty_at_least
        for name, item in table.metrics.items()
        if item.uncertainty_at_least is not None or not item.not_studied
    }
    return Uncertainty(
        table.gait,
        table.steps,
        table.run,
        values,
        table.parameters,
        table.studies,
        table.not_studied,
        {name: item.not_studied for name, item in table.metrics.items() if item.not_studied},
        {name: item.spread for name, item in table.metrics.items() if item.spread is not None},
    )


def matching(known: Sequence[Uncertainty], request: Request) -> Uncertainty:
    """The study of this gait.

    Raises:
        InputError: none of them is.
    """
    differences = [item.difference(request) for item in known]
    if "" in differences:
        return known[differences.index("")]
    listed = "; ".join(f"{item.gait} ({text})" for item, text in zip(known, differences, strict=True))
    raise InputError(
        f"--uncertainty: no study is of {request.name}, they are of {listed}; run 'ampm convergence' with "
        f"the gait and the --set of this run, and give its {FILE}."
    )
