"""The walk of a study on a worker, with what a user adds to it: classes, sent by value, and files."""

import math
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any

from ampm.exceptions import InputError
from ampm.parameters import OPTION_TABLES, RunParameters
from validation.judge.profiles import find_profile
from validation.run.trial import Trial
from validation.run.walk import walk_planned
from validation.study.row_file import Row
from validation.trial.outcome import OutcomeName
from validation.trial.plan import Request, plan_walk
from validation.trial.users import ROLES


def users_classes(value: Any) -> dict[str, Any]:
    """Users' classes and tables that the runs in a value name, by these names.

    Raises :class:`InputError` if there is no such controller, planner or estimator.
    """
    if isinstance(value, RunParameters):
        named = ((role, *role.named(value)) for role in ROLES)
        return {name: role.find(name, options) for role, name, options in named if name not in role.known}
    if is_dataclass(value):
        value = vars(value)
    items = value.values() if isinstance(value, Mapping) else value if isinstance(value, list | tuple) else ()
    return {name: thing for item in items for name, thing in users_classes(item).items()}


def users_files(run: RunParameters) -> list[Path]:
    """A user's own body and its model, without meshes, and files that options name, such as a policy."""
    options = map(run.value, OPTION_TABLES)
    values = [value for table in options for value in table.values() if isinstance(value, str)]
    files = [Path(value) for value in (run.body.source, *values) if os.path.isfile(value)]
    if Path(run.body.source) in files:
        from models.source import read_body_file, source_path  # loads the simulator

        with suppress(InputError):  # its runs will say what is wrong
            files.append(source_path(read_body_file(files[0]).source, files[0].parent))
    return files


def walk_request(request: Request, profile: str = "default") -> Trial:
    """Plan, walk and judge one run of a study; KeyboardInterrupt after Ctrl-C, which leaves no result."""
    trial = walk_planned(plan_walk(request), find_profile(profile))
    if trial.record.outcome.name == OutcomeName.INTERRUPTED:
        raise KeyboardInterrupt
    return trial


def keep_run(folder: str, **options: Any) -> Row:
    """Walk one run and write its folder as ``ampm validate`` does; the same options give the same bits."""
    trial = walk_request(**options)
    trial.save(folder, force=True)
    values = {name: metric.value for name, metric in trial.metrics.items() if math.isfinite(metric.value)}
    return {"outcome": str(trial.record.outcome.name), "metrics": values}
