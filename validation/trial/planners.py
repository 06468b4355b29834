"""Planners by name, by file, or of a user's own."""

import inspect
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from ampm.exceptions import InputError
from ampm.planner.step_planners import STEP_PLANNERS
from validation.trial.columns import SUFFIXES, read_columns
from validation.trial.users import check_options, load_object, make_object

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ampm.section import Option
    from ampm.walk import Planner


def load_planner(text: str, options: "Mapping[str, Option]" = MappingProxyType({})) -> "Planner":
    """The planner that a text names.

    Args:
        text: a name of :data:`ampm.planner.step_planners.STEP_PLANNERS`, a table (``.csv`` or ``.parquet``,
            see :mod:`ampm.planner.table`), or ``module:Class``.
        options: keyword arguments of the class.

    Raises:
        InputError: there is no such planner, the table cannot be read, or an option is unknown or missing.
    """
    from ampm.planners import PeriodicPlanner, TablePlanner  # imported here: Pinocchio is slow to load

    path = Path(text)
    if text in STEP_PLANNERS or path.suffix in SUFFIXES:
        check_options("gait.planner", f"the planner {text}", options)
    if text in STEP_PLANNERS:
        return PeriodicPlanner(text)
    if path.suffix in SUFFIXES:
        return TablePlanner(read_columns(path), path.name)
    if ":" not in text:
        raise InputError(
            f"gait.planner = {text!r} is none of {', '.join(STEP_PLANNERS)}; take one of them, a table "
            "FILE.csv or FILE.parquet, or MODULE:CLASS, for example mine:Planner.",
            key="gait.planner",
            value=text,
        )
    planner: Any = make_object("gait.planner", text, options)
    return planner


def check_planner(text: str, options: "Mapping[str, Option]" = MappingProxyType({})) -> None:
    """Refuse a name that is no planner, and options that it does not take, before anything is planned.

    Raises:
        InputError: as :func:`load_planner`.
    """
    if text not in STEP_PLANNERS or options:
        load_planner(text, options)


def planner_file(text: str) -> Path:
    """File that holds a planner that is not the project's own.

    Raises:
        InputError: there is no such planner.
    """
    if Path(text).suffix in SUFFIXES:
        return Path(text)
    return Path(inspect.getfile(load_object("gait.planner", text)))
