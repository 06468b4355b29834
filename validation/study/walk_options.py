"""What of a user decides on a walk: controller, planner, estimator, sent by value, and files."""

import os
from contextlib import suppress
from pathlib import Path
from typing import Any

from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from validation.trial.planners import load_planner
from validation.trial.users import CONTROLLER, ESTIMATOR, PLANNER


def users_classes(run: RunParameters) -> dict[str, Any]:
    """Controller, planner and estimator of a run that are not the project's own; empty if all are.

    Returns:
        ``controller``: what makes the controller, as :func:`validation.run.walk.walk_planned` takes it.
        ``planner``: the planner, as :func:`validation.trial.plan.plan_walk` takes it; of a table its rows.
        ``estimator``: what makes the estimator, as :func:`validation.run.walk.walk_planned` takes it.

    Raises:
        InputError: there is no such controller, planner or estimator.
    """
    found: dict[str, Any] = {}
    if run.controller.name not in CONTROLLER.known:
        found["controller"] = CONTROLLER.find(run.controller.name, run.controller.options)
    if run.gait.planner not in PLANNER.known:
        found["planner"] = load_planner(run.gait.planner, run.planner.options)
    if run.sensors.estimator not in ESTIMATOR.known:
        found["estimator"] = ESTIMATOR.find(run.sensors.estimator, run.sensors.options)
    return found


def users_files(run: RunParameters) -> list[Path]:
    """A user's own body and its model, without meshes, and files that options name, such as a policy."""
    options = (run.controller.options, run.planner.options, run.sensors.options)
    values = [value for table in options for value in table.values() if isinstance(value, str)]
    files = [Path(value) for value in (run.body.source, *values) if os.path.isfile(value)]
    if Path(run.body.source) in files:
        from models.source import read_body_file, source_path  # loads the simulator

        with suppress(InputError):  # its runs will say what is wrong
            files.append(source_path(read_body_file(files[0]).source, files[0].parent))
    return files
