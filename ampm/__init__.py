"""AMPM: the gait planner of Kudoh & Komura (IROS 2003) and a controller that walks its plans.

The package knows Pinocchio and OSQP, but no simulator: a body comes in as a description and a ready model.
"""

from __future__ import annotations

from ampm.exceptions import (
    AmpmError,
    BodilyRefusal,
    InputError,
    MathematicalRefusal,
    RefusedGait,
    SolverError,
)
from ampm.parameters import GaitParameters, RunParameters
from ampm.run_file import dump_run, load_run, preset_names

__version__ = "0.1.0"

__all__ = [
    "AmpmError",
    "BodilyRefusal",
    "GaitParameters",
    "InputError",
    "MathematicalRefusal",
    "RefusedGait",
    "RunParameters",
    "SolverError",
    "__version__",
    "dump_run",
    "load_run",
    "preset_names",
]
