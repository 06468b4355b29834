"""Types of the entries of ``summary.json`` that reports, comparisons and verdicts read; others are free."""

import json
from collections.abc import Mapping
from pathlib import Path
from types import GenericAlias
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, create_model

from ampm.exceptions import InputError
from ampm.files import read_text

Number = float | Literal["inf", "-inf"] | None
"""A number of a summary: null is NaN, and infinity a word."""
_List = list[Number]
_Pair = Annotated[_List, Field(min_length=2, max_length=2)]
_Triple = Annotated[_List, Field(min_length=3, max_length=3)]
_Positive = Annotated[float, Field(gt=0)]


def entries(**kinds: Any) -> type[BaseModel]:
    """A table with some entries at least: by name their types, and maybe a default behind them."""
    return create_model("Entries", __config__=ConfigDict(strict=True, allow_inf_nan=False), **kinds)


_DISPLAYED = entries(value=Number, unit=str, tolerance=Number, uncertainty=(Number, None))
_METRIC = entries(  # see `validation.judge.verdict.MetricResult.as_dict`
    label=str,
    kind=Literal["walk", "instrument", "cost"],
    value=Number,
    unit=str,
    tolerance=Number,
    passed=(bool | None, Field(alias="pass")),
    margin=Number,
    display=_DISPLAYED,
    reason=str | None,
    uncertainty=(Number, None),
    spread=(Number, None),
)
_EXTREME = entries(value=Number, time=Number, where=str)
_EXTREMES = ("torque", "friction", "joint", "knee", "tilt", "clearance", "penetration")
_MARGINS = entries(
    **dict.fromkeys((*_EXTREMES, "plan_polygon", "measured_polygon"), _EXTREME),
    torque_by_joint=Mapping[str, Number],
    speed=(_EXTREME, None),  # of a body with limits of speed
    saturated=Number,
    friction_available=Number,
)
_SPLIT = entries(residual=Number, rmse=Mapping[str, _Pair], share=Mapping[str, _Pair], unit=str)
_AHEAD = entries(judged=Number, lead=_List, rmse=Mapping[str, _List])
SUMMARY = entries(
    outcome=str,
    steps_completed=Annotated[int, Field(ge=0)],
    end=entries(time=Number, cause=str),
    verdict=Literal["pass", "fail", "undecided", "partial", "not_measured"],
    reason=str,
    profile=str,
    gait=str,
    changed=(Mapping[str, bool | Number | str], {}),
    planner=(str, ""),
    controller=(str, ""),
    disturbances=(list[str], []),
    metrics=(GenericAlias(dict, (str, _METRIC)), Field(min_length=1)),
    timing=entries(simulated=Number, real_time_factor=Number),
    statistics=Mapping[str, Mapping[str, Mapping[str, Number | str]]],
    zmp_error_split=_SPLIT,
    ahead=(_AHEAD, None),
    velocity=(Mapping[str, _Triple], {}),
    effort=entries(force=_Triple, angular_momentum=_Pair, zmp=_Pair),
    margins=_MARGINS,
    energy=entries(positive_work=Number, negative_work=Number, distance=Number, cost_of_transport=Number),
    solver=entries(ticks=Number, unsolved=Number, time_median=Number, time_p99=Number),
    scales=entries(body_weight=_Positive, foot_length=_Positive, mass_height_velocity=_Positive),
    environment=Mapping[str, Any],
    uncertainty=(entries(gait=str, steps=int) | None, None),
    log=(Mapping[str, Any], {}),
    files=Mapping[str, str],
)
"""The whole file."""


def read_json(path: Path, kind: Any, way_out: str) -> tuple[Any, Any]:
    """Contents of a JSON file as they are, and as a type, which has all that is read of them.

    An :class:`InputError` names the first entry of another type and the way out.
    """
    try:
        found = json.loads(read_text(path))
        return found, TypeAdapter(kind).validate_python(found)
    except ValidationError as error:
        first = error.errors()[0]
        named = (str(part) for part in first["loc"] if part not in ("float", "str"))  # not pydantic's types
        where = ".".join(named) or "the file"
        what = first["msg"].lower().removeprefix("input ")
        raise InputError(f"{path} is damaged: {where}: {what}; {way_out}.") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is not JSON ({error}); {way_out}.") from None
    except OSError:
        raise InputError(f"{path} is missing; {way_out}.") from None
