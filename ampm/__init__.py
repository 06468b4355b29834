"""AMPM: the gait planner of Kudoh & Komura (IROS 2003) and a controller that tracks its plans.

The package uses Pinocchio and OSQP, but no simulator: a body is given as a description and a Pinocchio model.
Of the names imported here only ``FootstepPlanner``, ``PeriodicPlanner`` and ``TablePlanner`` load Pinocchio.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ampm.exceptions import (
    AmpmError,
    BodilyRefusal,
    InputError,
    MathematicalRefusal,
    RefusedGait,
    SolverError,
)
from ampm.presets import preset_names

if TYPE_CHECKING:
    from ampm.parameters import GaitParameters, RunParameters
    from ampm.planner.centroidal import CentroidalPlan, Law
    from ampm.planner.contacts import Contacts, Footstep, Phase
    from ampm.planner.footsteps import plan_footsteps
    from ampm.planners import FootstepPlanner, PeriodicPlanner, TablePlanner
    from ampm.run_file import dump_run, load_run
    from ampm.walk import Controller, ControlOutput, Planner, Posture, Reference, State, Touch, WalkPlan

__version__ = "0.1.0"

_MODULES = {
    "ampm.parameters": ("GaitParameters", "RunParameters"),
    "ampm.planner.centroidal": ("CentroidalPlan", "Law"),
    "ampm.planner.contacts": ("Contacts", "Footstep", "Phase"),
    "ampm.planner.footsteps": ("plan_footsteps",),
    "ampm.planners": ("FootstepPlanner", "PeriodicPlanner", "TablePlanner"),
    "ampm.run_file": ("dump_run", "load_run"),
    "ampm.walk": (
        "ControlOutput",
        "Controller",
        "Planner",
        "Posture",
        "Reference",
        "State",
        "Touch",
        "WalkPlan",
    ),
}
# Imported when first read: NumPy and pydantic would delay 'ampm --help' by a tenth of a second each.


def plan(run: RunParameters | str | Path) -> CentroidalPlan:
    """Plan a run's gait in closed form, with the mass of its body.

    Args:
        run: parameters, or a preset or TOML file.

    Raises:
        InputError: no such preset or file.
        MathematicalRefusal: the closed form has no solution, or none that can be computed.
    """
    # Imported here because they load NumPy and pydantic.
    from ampm.parameters import RunParameters
    from ampm.planner.periodic import plan_gait
    from ampm.run_file import load_run

    run = run if isinstance(run, RunParameters) else load_run(run)
    return plan_gait(run.gait, run.body.mass)


def __getattr__(name: str) -> Any:
    for module, names in _MODULES.items():
        if name in names:
            return getattr(import_module(module), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


__all__ = [
    "AmpmError",
    "BodilyRefusal",
    "CentroidalPlan",
    "Contacts",
    "ControlOutput",
    "Controller",
    "Footstep",
    "FootstepPlanner",
    "GaitParameters",
    "InputError",
    "Law",
    "MathematicalRefusal",
    "PeriodicPlanner",
    "Phase",
    "Planner",
    "Posture",
    "Reference",
    "RefusedGait",
    "RunParameters",
    "SolverError",
    "State",
    "TablePlanner",
    "Touch",
    "WalkPlan",
    "__version__",
    "dump_run",
    "load_run",
    "plan",
    "plan_footsteps",
    "preset_names",
]
