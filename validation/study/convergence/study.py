"""Convergence study of a gait: which walks it takes, and the files of its result."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Unpack

from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from validation.judge import profiles
from validation.judge.uncertainty import FILE
from validation.study.convergence.levels import LEVELS, runs_of, studies, walk_level
from validation.study.convergence.result import Convergence, combine
from validation.study.many import Execution, Task, open_study, walk_many, write_study
from validation.study.walk_options import users_classes
from validation.trial.plan import Request, load_request, plan_walk

STEPS = 6
"""Walked at every level, by default: the gait is periodic, and a record grows as the time step shrinks."""
PICTURE = "convergence.svg"


def convergence(
    gait: Request | RunParameters | str | None = None,
    settings: Sequence[str] = (),
    *,
    steps: int = STEPS,
    levels: int = LEVELS,
    profile: str = "default",
    **execution: Unpack[Execution],
) -> Convergence:
    """Study one gait.

    Args:
        gait: parameters, preset or TOML file; normal by default.
        settings: ``key=value`` texts, for a preset or file.
        steps: walked at every level.
        levels: of every numerical study.
        profile: name of the tolerance profile.
        execution: workers and folder, see :class:`validation.study.many.Execution`.

    Raises:
        InputError, RefusedGait: the request cannot be met, or ``out`` is used otherwise.
        StudyStopped: see :func:`validation.study.many.walk_many`.
    """
    if steps < 2:
        raise InputError(f"--steps {steps}: the first step is in no metric; walk 2 at least.", value=steps)
    limits, (folder, pool) = profiles.profile(profile), open_study(execution)
    request = load_request(gait, settings)
    request = replace(request, run=request.run.replace({"gait.steps": steps}))
    studies(request.run, levels)  # refuse before anything is planned
    users = users_classes(request.run)
    planned = plan_walk(request, pool.get("progress"), planner=users.get("planner"))
    request = planned.request  # with all values
    found = studies(request.run, levels)
    runs = runs_of(request.run, found)
    # The finest steps take longest. Started first, they leave no worker idle at the end.
    order = sorted(runs, key=lambda task: runs[task].simulation.time_step)
    tasks = [
        Task(task, walk_level, {"request": Request(request.name, runs[task]), **users}) for task in order
    ]
    label = f"{request.name}: convergence"
    rows = walk_many(tasks, folder, label=label, **pool)
    walks = {row["key"]: row for row in rows}
    result = combine(request, limits, found, {task: walks[task] for task in runs})
    if folder is not None:
        from validation.study.convergence.picture import draw  # loads matplotlib

        draw(result, folder / PICTURE)
        write_study(result, folder / FILE)
    return result
