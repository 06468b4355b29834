"""Convergence study of a gait: levels of one parameter at a time about the gait's own, and their walks."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, Unpack

from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from validation.judge.profiles import find_profile, own_profile
from validation.judge.uncertainty import CONVERGENCE_FILE
from validation.store.environment import parameter_values
from validation.store.json import write_json
from validation.study.convergence.result import OWN, Convergence, Study, combine
from validation.study.many import Execution, Task, study_folder, walk_many, walk_request
from validation.study.row_file import Row
from validation.study.sweep.design import ENGINE_KEY
from validation.table import package_rows
from validation.trial.engine import check_drake
from validation.trial.plan import Request, load_request, plan_walk

STEPS = 6
"""Walked at every level, by default: the gait is periodic, and a record grows as the time step shrinks."""
LEVELS = 4
"""Levels of a numerical study: two triplets, the least that can confirm an order."""
STUDIES = package_rows("study/convergence/studies.csv")
"""Key of each study. A numerical one has the ratio of neighbouring levels, whose limit is zero.

Others have values: those of the engine, or factors on the own value of a parameter of the contact law. The
stiffness of MuJoCo's contact is proportional to the inverse square of the time constant.
"""


def studies(run: RunParameters) -> list[Study]:
    """Numerical studies, then those of contact law and, with Drake installed, engine."""
    own, found = parameter_values(run), []
    for row in STUDIES:
        if row["engine"] not in ("", run.simulation.engine):
            continue
        key, ratio, values = row["key"], float(row["ratio"] or 0.0), row["values"].split()
        if ratio:  # Rounded, so that a tenth of 5e-5 is written as 5e-6.
            levels = tuple(float(f"{own[key] / ratio**level:.15g}") for level in range(LEVELS))
        else:  # those that the model can have; of an engine those that are installed
            possible = [own[key]]
            for text in values:
                value = text if key == ENGINE_KEY else float(text) * own[key]
                with suppress(InputError):
                    changed = run.replace({key: value})
                    if changed.simulation.engine == "drake":
                        check_drake(changed)
                    possible.append(value)
            levels = tuple(dict.fromkeys(possible))
        found.append(Study(row["name"], key, levels, ratio))
    return [study for study in found if len(study.values) > 1]


def runs_of(run: RunParameters, found: Sequence[Study]) -> dict[str, RunParameters]:
    """Complete parameters of every level, by task; one thing changes at a time."""
    levels = [(study, level) for study in found for level in range(1, len(study.values))]
    changed = {study.tasks[level]: run.replace({study.key: study.values[level]}) for study, level in levels}
    return {OWN: run, **changed}


def walk_level(**options: Any) -> Row:
    """Walk one level; the options are those of :func:`validation.study.many.walk_request`.

    Returns:
        ``outcome`` and ``cause``; ``values`` of all metrics in SI units; ``scales``, reference quantities of
        the walk.
    """
    trial = walk_request(**options)
    return {
        "outcome": str(trial.record.outcome.name),
        "cause": trial.record.outcome.cause,
        "values": {name: metric.value for name, metric in trial.metrics.items()},
        "scales": dict(trial.comparison.scales),
    }


def convergence(
    gait: Request | RunParameters | str,
    *,
    steps: int = STEPS,
    profile: str | None = None,
    **execution: Unpack[Execution],
) -> Convergence:
    """Study one gait.

    Args:
        gait: parameters, preset or TOML file.
        steps: walked at every level.
        profile: name of the tolerance profile, by default the gait's own.
        execution: workers and folder, see :class:`validation.study.many.Execution`.

    Raises:
        InputError, RefusedGait: the request cannot be met, or ``out`` is used otherwise.
        StudyStopped: see :func:`validation.study.many.walk_many`.
    """
    if steps < 2:
        raise InputError(f"--steps {steps}: the first step is not judged; walk 2 or more.", value=steps)
    request, folder = load_request(gait), study_folder(execution)
    limits = find_profile(profile or own_profile(request.run))
    steps = len(request.run.footsteps) - 2 if request.run.footsteps else steps  # from rest to rest
    request = replace(request, run=request.run.replace({"gait.steps": steps}))
    request = plan_walk(request, execution.get("progress")).request  # with all values
    found = studies(request.run)
    runs = runs_of(request.run, found)
    # The finest steps take longest. Started first, they leave no worker idle at the end.
    tasks = [
        Task(task, walk_level, {"request": Request(request.name, runs[task])})
        for task in sorted(runs, key=lambda task: runs[task].simulation.time_step)
    ]
    walks = {row["key"]: row for row in walk_many(tasks, label=f"{request.name}: convergence", **execution)}
    result = combine(request, limits, found, {task: walks[task] for task in runs})
    if folder is not None:
        write_json(folder / CONVERGENCE_FILE, result.as_dict())
    return result
