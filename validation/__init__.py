"""The trial of a planned gait: walked in MuJoCo, measured, compared with its plan, judged.

Public interface: ``import ampm, validation as val``. Names are imported when first used, so importing the
package is fast.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from validation.judge.compare import Comparison as Comparison
    from validation.judge.compare import Statistics as Statistics
    from validation.judge.metrics import Metric as Metric
    from validation.judge.metrics import register as register
    from validation.judge.metrics import unregister as unregister
    from validation.judge.uncertainty import load_uncertainty as load_uncertainty
    from validation.progress import Progress as Progress
    from validation.run.judge_log import judge_log as judge_log
    from validation.run.judge_log import judge_run as judge_run
    from validation.run.replay import replay as replay
    from validation.run.trial import Trial as Trial
    from validation.run.walk import walk as walk
    from validation.show.report import write_report as report
    from validation.show.viewer import show_recording as view
    from validation.store.saved import load_saved_run as load
    from validation.study.explain import explain as explain
    from validation.study.many import Task as Task
    from validation.study.many import walk_many as walk_many
    from validation.study.robustness.study import robustness as robustness
    from validation.study.sweep.design import SweepDefinition as SweepDefinition
    from validation.study.sweep.run import sweep as sweep
    from validation.trial.disturbances import Disturbance as Disturbance
    from validation.trial.disturbances import Plant as Plant
    from validation.trial.disturbances import Push as Push

_HOMES = {
    "Comparison": "judge.compare.Comparison",
    "Disturbance": "trial.disturbances.Disturbance",
    "Metric": "judge.metrics.Metric",
    "Plant": "trial.disturbances.Plant",
    "Progress": "progress.Progress",
    "Push": "trial.disturbances.Push",
    "Statistics": "judge.compare.Statistics",
    "SweepDefinition": "study.sweep.design.SweepDefinition",
    "Task": "study.many.Task",
    "Trial": "run.trial.Trial",
    "explain": "study.explain.explain",
    "judge_log": "run.judge_log.judge_log",
    "judge_run": "run.judge_log.judge_run",
    "load": "store.saved.load_saved_run",
    "load_uncertainty": "judge.uncertainty.load_uncertainty",
    "register": "judge.metrics.register",
    "replay": "run.replay.replay",
    "report": "show.report.write_report",
    "robustness": "study.robustness.study.robustness",
    "sweep": "study.sweep.run.sweep",
    "unregister": "judge.metrics.unregister",
    "view": "show.viewer.show_recording",
    "walk": "run.walk.walk",
    "walk_many": "study.many.walk_many",
}

__all__ = [
    "Comparison",
    "Disturbance",
    "Metric",
    "Plant",
    "Progress",
    "Push",
    "Statistics",
    "SweepDefinition",
    "Task",
    "Trial",
    "explain",
    "judge_log",
    "judge_run",
    "load",
    "load_uncertainty",
    "register",
    "replay",
    "report",
    "robustness",
    "sweep",
    "unregister",
    "view",
    "walk",
    "walk_many",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home, _, original = _HOMES[name].rpartition(".")
    value = getattr(import_module(f"{__name__}.{home}"), original)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
