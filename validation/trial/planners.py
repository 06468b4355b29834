"""Planners by name, by file, or of a user's own."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from ampm.planner.centroidal import CentroidalPlan
from ampm.planner.support import StepPlan
from validation.trial.columns import SUFFIXES, read_columns
from validation.trial.users import PLANNER, UsersCode

if TYPE_CHECKING:
    from ampm.section import Option
    from ampm.walk import Planner


def load_planner(text: str, options: "Mapping[str, Option]" = MappingProxyType({})) -> "Planner":
    """The planner that a text names.

    Args:
        text: a name of :data:`ampm.planner.step_planners.STEP_PLANNERS`, a table (``.csv`` or ``.parquet``,
            see :mod:`ampm.planner.table`), a name of an installed package, or ``module:Class``.
        options: keyword arguments of the class.

    Raises:
        InputError: there is no such planner, the table cannot be read, or an option is unknown or missing.
    """
    from ampm.planners import PeriodicPlanner, TablePlanner  # imported here: Pinocchio is slow to load

    path = Path(text)
    if path.suffix in SUFFIXES:
        PLANNER.check_options(text, None, options)
        return TablePlanner(read_columns(path), path.name)
    factory = PLANNER.find(text, options)
    if factory is None:
        return PeriodicPlanner(text)
    with UsersCode("planner", factory):
        planner: Planner = factory(**options)
    return planner


def check_planner(text: str, options: "Mapping[str, Option]") -> None:
    """Refuse a name that is no planner, and options that it does not take, before anything is planned.

    A user's planner is not made for it.

    Raises:
        InputError: as :func:`load_planner`.
    """
    if Path(text).suffix in SUFFIXES:
        load_planner(text, options)
    else:
        PLANNER.check(text, options)


def no_walk(made: Any) -> str:
    """What a planner made instead of a WalkPlan, and what completes it."""
    text = f"a {type(made).__name__}, not a WalkPlan"
    if isinstance(made, StepPlan):
        return f"{text}; ampm.WalkPlan.of(plan, posture=...) adds the posture"
    if isinstance(made, CentroidalPlan):
        return (
            f"{text}; it lacks feet and posture. Return ampm.PeriodicPlanner().plan(run, robot), or make a "
            "plan of your own by ampm.make_plan"
        )
    return text
