"""What of a user decides on a walk: controller, planner, estimator, sent by value, and body files."""

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


def body_files(run: RunParameters) -> tuple[Path, ...]:
    """Description of a user's own body, and its model; meshes are not among them."""
    path = Path(run.body.source)
    if not path.is_file():
        return ()
    from models.source import read_body_file, source_path  # loads the simulator

    with suppress(InputError):  # its runs will say what is wrong
        return path, source_path(read_body_file(path).source, path.parent)
    return (path,)
