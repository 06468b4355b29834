"""Planners by name, by file, or of a user's own."""

import inspect
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ampm.exceptions import InputError
from ampm.planner.step_planners import STEP_PLANNERS
from validation.trial.columns import SUFFIXES, read_columns
from validation.trial.users import make_object

if TYPE_CHECKING:
    from ampm.walk import Planner


def load_planner(text: str) -> "Planner":
    """The planner that a text names.

    Args:
        text: a name of :data:`ampm.planner.step_planners.STEP_PLANNERS`, a table (``.csv`` or ``.parquet``,
            see :mod:`ampm.planner.table`), or ``module:Class``.

    Raises:
        InputError: there is no such planner, or the table cannot be read.
    """
    from ampm.planners import PeriodicPlanner, TablePlanner  # imported here: Pinocchio is slow to load

    if text in STEP_PLANNERS:
        return PeriodicPlanner(text)
    if (path := Path(text)).suffix in SUFFIXES:
        return TablePlanner(read_columns(path), path.name)
    if ":" not in text:
        raise InputError(
            f"gait.planner = {text!r} is none of {', '.join(STEP_PLANNERS)}; take one of them, a table "
            "FILE.csv or FILE.parquet, or MODULE:CLASS, for example mine:Planner.",
            key="gait.planner",
            value=text,
        )
    planner: Any = make_object("gait.planner", text)
    return planner


def check_planner(text: str) -> None:
    """Refuse a name that is no planner, before anything is planned.

    Raises:
        InputError: as :func:`load_planner`.
    """
    if text not in STEP_PLANNERS:
        load_planner(text)


def planner_file(text: str) -> Path:
    """File that holds a planner that is not the project's own.

    Raises:
        InputError: there is no such planner.
    """
    if Path(text).suffix in SUFFIXES:
        return Path(text)
    return Path(inspect.getfile(type(load_planner(text))))
