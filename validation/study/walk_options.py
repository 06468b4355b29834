"""A user's controller and planner as options of a task: workers elsewhere get them by value."""

from typing import Any

from ampm.parameters import RunParameters
from ampm.planner.zmp_laws import STEP_PLANNERS
from validation.trial.controllers import CONTROLLERS, find_controller
from validation.trial.planners import load_planner


def users_classes(run: RunParameters) -> dict[str, Any]:
    """Controller and planner of a run that are not the project's own; empty if both are.

    Returns:
        ``controller``: what makes the controller, as :func:`validation.run.walk.walk_planned` takes it.
        ``planner``: the planner, as :func:`validation.trial.plan.plan_walk` takes it; of a table its rows.

    Raises:
        InputError: there is no such controller or planner.
    """
    found: dict[str, Any] = {}
    if run.controller.name not in CONTROLLERS:
        found["controller"] = find_controller(run.controller.name)
    if run.gait.planner not in STEP_PLANNERS:
        found["planner"] = load_planner(run.gait.planner)
    return found
