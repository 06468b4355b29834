"""The walk of a study on a worker."""

import math
from typing import Any

from validation.run.trial import Trial
from validation.run.walk import walk_planned
from validation.study.row_file import Row
from validation.trial.outcome import OutcomeName
from validation.trial.plan import Request, plan_walk


def walk_request(request: Request, profile: str | None = None) -> Trial:
    """Plan, walk and judge one run, by default by its own profile; KeyboardInterrupt after Ctrl-C."""
    trial = walk_planned(plan_walk(request), profile)
    if trial.record.outcome.name == OutcomeName.INTERRUPTED:
        raise KeyboardInterrupt
    return trial


def keep_run(folder: str, **options: Any) -> Row:
    """Walk one run and write its folder as ``ampm validate`` does; the same options give the same bits."""
    trial = walk_request(**options)
    trial.save(folder, force=True)
    values = {name: metric.value for name, metric in trial.metrics.items() if math.isfinite(metric.value)}
    return {"outcome": str(trial.record.outcome.name), "metrics": values}
