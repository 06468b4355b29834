"""AMPM: the gait planner of Kudoh & Komura (IROS 2003) and a controller that tracks its plans.

The package uses Pinocchio and OSQP, but no simulator: a body is given as a description and a Pinocchio model.
Of the names imported here only ``FootstepPlanner``, ``PeriodicPlanner``, ``TablePlanner``,
``TrackingController`` and ``make_plan`` load Pinocchio.
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

if TYPE_CHECKING:
    from ampm.control.controller import TrackingController
    from ampm.parameters import GaitParameters, RunParameters
    from ampm.planner.centroidal import CentroidalPlan, Law
    from ampm.planner.contacts import Contacts, Footstep, Phase
    from ampm.planner.footsteps import plan_footsteps
    from ampm.planners import FootstepPlanner, PeriodicPlanner, TablePlanner, make_plan
    from ampm.presets import preset_names
    from ampm.reference import Reference, Timing
    from ampm.run_file import dump_run, load_run
    from ampm.walk import Controller, ControlOutput, Planner, Posture, Replanner, State, Touch, WalkPlan

__version__ = "0.1.0"

__all__ = ["__version__", "plan", "preset_names"]
__all__ += ["AmpmError", "BodilyRefusal", "InputError", "MathematicalRefusal", "RefusedGait", "SolverError"]
__all__ += ["GaitParameters", "RunParameters", "dump_run", "load_run"]
__all__ += ["CentroidalPlan", "Contacts", "Footstep", "Law", "Phase", "plan_footsteps"]
__all__ += ["ControlOutput", "Controller", "Planner", "Posture", "Replanner", "State", "Touch", "WalkPlan"]
__all__ += ["Reference", "Timing"]
__all__ += ["FootstepPlanner", "PeriodicPlanner", "TablePlanner", "TrackingController", "make_plan"]

_MODULES = (
    "presets",
    "parameters",
    "run_file",
    "planner.contacts",
    "planner.centroidal",
    "planner.footsteps",
    "reference",
    "walk",
    "planners",
    "control.controller",
)
"""Imported when a name is first read: NumPy and pydantic would delay 'ampm --help' by .1 s each."""


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
    if name in __all__:
        for path in _MODULES:
            if hasattr(module := import_module(f"ampm.{path}"), name):
                return getattr(module, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
