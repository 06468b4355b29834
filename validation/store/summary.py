"""Types of ``summary.json``, of what reports, comparisons and verdicts read of it; all else is free."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ampm.exceptions import InputError
from ampm.files import read_text

Number = float | Literal["inf", "-inf"] | None
"""A number of a summary: null is NaN, and infinity a word."""


class _Entry(BaseModel):
    model_config = ConfigDict(strict=True, allow_inf_nan=False)


class Displayed(_Entry):
    """A metric in the unit of tables."""

    value: Number
    unit: str
    tolerance: Number
    uncertainty: Number = None


class MetricEntry(_Entry):
    """One metric, see :meth:`validation.judge.verdict.MetricResult.as_dict`."""

    label: str
    kind: Literal["walk", "instrument", "cost"]
    value: Number
    unit: str
    tolerance: Number
    passed: bool | None = Field(alias="pass")
    margin: Number
    first_step: Number
    display: Displayed
    reason: str | None
    uncertainty: Number = None
    spread: Number = None


class Extreme(_Entry):
    """A margin: its least or largest value, and where."""

    value: Number
    time: Number
    where: str


class End(_Entry):
    """How the walk ended."""

    time: Number
    cause: str


class Split(_Entry):
    """What the error of the ZMP is made of."""

    residual: Number
    rmse: Mapping[str, list[Number]]
    share: Mapping[str, list[Number]]
    unit: str


class Ahead(_Entry):
    """Errors of the plan as it stood before."""

    judged: Number
    lead: list[Number]
    rmse: Mapping[str, list[Number]]


class Study(_Entry):
    """The convergence study that gave the uncertainty."""

    gait: str
    steps: int


class Summary(_Entry):
    """The whole file."""

    outcome: str
    steps_completed: int = Field(ge=0)
    end: End
    verdict: Literal["pass", "fail", "undecided", "not_measured"]
    reason: str
    profile: str
    gait: str
    changed: Mapping[str, bool | Number | str] = Field(default_factory=dict)
    planner: str = ""
    controller: str = ""
    disturbances: list[str] = Field(default_factory=list)
    metrics: Mapping[str, MetricEntry] = Field(min_length=1)
    timing: Mapping[str, Number]
    statistics: Mapping[str, Mapping[str, Mapping[str, Number | str]]]
    zmp_error_split: Split
    ahead: Ahead | None = None
    effort: Mapping[str, list[Number]]
    margins: Mapping[str, Extreme | Mapping[str, Number] | Number]
    energy: Mapping[str, Number]
    self_checks: Mapping[str, Any]
    solver: Mapping[str, Number]
    scales: Mapping[str, float]
    environment: Mapping[str, Any]
    uncertainty: Study | None = None
    log: Mapping[str, Any] = Field(default_factory=dict)
    files: Mapping[str, str]


class Baseline(_Entry):
    """A baseline of the pytest plugin."""

    outcome: str
    steps_completed: int
    metrics: Mapping[str, float | None]


def read_json(path: Path, kind: type[BaseModel], way_out: str) -> dict[str, Any]:
    """Contents of a file of JSON as they are, if all that is read of them has the right types.

    Args:
        path: of the file.
        kind: the types.
        way_out: from a damaged file, for the message.

    Raises:
        InputError: it is missing, no JSON, or damaged; names the first entry of another type.
    """
    try:
        found = json.loads(read_text(path))
        kind.model_validate(found)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the file"
        what = first["msg"].lower().removeprefix("input ")
        raise InputError(f"{path} is damaged: {where}: {what}; {way_out}.") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is no JSON ({error}); {way_out}.") from None
    except OSError:
        raise InputError(f"{path} is missing; {way_out}.") from None
    return dict(found)
