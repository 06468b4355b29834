"""The walk of a study on a worker, with what a user adds to it: classes, sent by value, and files."""

import os
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from ampm.walk import Planner
from validation.judge.profiles import DEFAULT, Profile
from validation.judge.profiles import profile as find_profile
from validation.run.trial import Trial
from validation.run.walk import timed, walk_planned
from validation.trial.outcome import OutcomeName
from validation.trial.plan import Request, plan_walk
from validation.trial.users import CONTROLLER, ESTIMATOR, PLANNER, load_planner


def users_classes(run: RunParameters) -> dict[str, Any]:
    """Controller, planner and estimator of a run that are not the project's own; empty if all are.

    Returns:
        ``controller``: what makes the controller, as :func:`walk_request` takes it.
        ``planner``: the planner, as :func:`walk_request` takes it; of a table its rows.
        ``estimator``: what makes the estimator, as :func:`walk_request` takes it.

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


def walk_request(
    request: Request, profile: Profile | str = DEFAULT, *, planner: Planner | None = None, **users: Any
) -> Trial:
    """Plan, walk and judge one run of a study.

    Args:
        request: parameters and name.
        profile: tolerances, or their name.
        planner: of a user's own; that of the run by default.
        users: other classes of a user, see :func:`users_classes`, and disturbances.

    Raises:
        KeyboardInterrupt: Ctrl-C in this very process: no result.
    """
    seconds: dict[str, float] = {}
    with timed(seconds, "planning"):
        planned = plan_walk(request, planner=planner)
    trial = walk_planned(planned, find_profile(profile), **users)
    if trial.record.outcome.name == OutcomeName.INTERRUPTED:
        raise KeyboardInterrupt
    return replace(trial, seconds={**seconds, **trial.seconds})
