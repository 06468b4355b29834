"""Types of ``summary.json``, of what reports, comparisons and verdicts read of it; all else is free."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from ampm.exceptions import InputError
from ampm.files import read_text

Number = float | Literal["inf", "-inf"] | None
"""A number of a summary: null is NaN, and infinity a word."""
_Numbers = list[Number]
_Pair = Annotated[list[Number], Field(min_length=2, max_length=2)]
_Triple = Annotated[list[Number], Field(min_length=3, max_length=3)]
_Positive = Annotated[float, Field(gt=0)]


class _Entry(BaseModel):
    model_config = ConfigDict(strict=True, allow_inf_nan=False)


def _has(*names: str) -> AfterValidator:
    """Refuse a table that lacks an entry."""

    def check(table: Mapping[str, Any]) -> Mapping[str, Any]:
        if missing := [name for name in names if name not in table]:
            raise ValueError(f"should have {missing[0]!r}")
        return table

    return AfterValidator(check)


class _Displayed(_Entry):
    value: Number
    unit: str
    tolerance: Number
    uncertainty: Number = None


class _Metric(_Entry):  # see `validation.judge.verdict.MetricResult.as_dict`
    label: str
    kind: Literal["walk", "instrument", "cost"]
    value: Number
    unit: str
    tolerance: Number
    passed: bool | None = Field(alias="pass")
    margin: Number
    display: _Displayed
    reason: str | None
    uncertainty: Number = None
    spread: Number = None


class _Extreme(_Entry):
    value: Number
    time: Number
    where: str


class _Margins(_Entry):
    torque: _Extreme
    torque_by_joint: Mapping[str, Number]
    saturated: Number
    friction: _Extreme
    friction_available: Number
    joint: _Extreme
    knee: _Extreme
    clearance: _Extreme
    plan_polygon: _Extreme
    measured_polygon: _Extreme
    penetration: _Extreme


class _Effort(_Entry):
    force: _Triple
    angular_momentum: _Pair
    zmp: _Pair


class _End(_Entry):
    time: Number
    cause: str


class _Split(_Entry):
    residual: Number
    rmse: Mapping[str, _Pair]
    share: Mapping[str, _Pair]
    unit: str


class _Ahead(_Entry):
    judged: Number
    lead: _Numbers
    rmse: Mapping[str, _Numbers]


class _Study(_Entry):
    gait: str
    steps: int


class Summary(_Entry):
    """The whole file."""

    outcome: str
    steps_completed: int = Field(ge=0)
    end: _End
    verdict: Literal["pass", "fail", "undecided", "partial", "not_measured"]
    reason: str
    profile: str
    gait: str
    changed: Mapping[str, bool | Number | str] = Field(default_factory=dict)
    planner: str = ""
    controller: str = ""
    disturbances: list[str] = Field(default_factory=list)
    metrics: Mapping[str, _Metric] = Field(min_length=1)
    timing: Annotated[Mapping[str, Number], _has("simulated", "real_time_factor")]
    statistics: Mapping[str, Mapping[str, Mapping[str, Number | str]]]
    zmp_error_split: _Split
    ahead: _Ahead = _Ahead(judged=0.0, lead=[], rmse={})
    velocity: Mapping[str, _Triple] = Field(default_factory=dict)
    effort: _Effort
    margins: _Margins
    energy: Annotated[
        Mapping[str, Number], _has("positive_work", "negative_work", "distance", "cost_of_transport")
    ]
    solver: Annotated[Mapping[str, Number], _has("ticks", "unsolved", "time_median", "time_p99")]
    scales: Annotated[Mapping[str, _Positive], _has("body_weight", "foot_length", "mass_height_velocity")]
    environment: Mapping[str, Any]
    uncertainty: _Study | None = None
    log: Mapping[str, Any] = Field(default_factory=dict)
    files: Mapping[str, str]


def read_json(path: Path, kind: type[BaseModel], way_out: str) -> dict[str, Any]:
    """Contents of a file of JSON as they are, if all that is read of them has the right types.

    An :class:`InputError` names the first entry of another type and the way out.
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
        raise InputError(f"{path} is not JSON ({error}); {way_out}.") from None
    except OSError:
        raise InputError(f"{path} is missing; {way_out}.") from None
    return dict(found)
