"""Folders of short real runs, each walked once per process, and files of convergence studies."""

import json
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any
from unittest.mock import patch

from validation.judge.uncertainty import Uncertainty
from validation.run.walk import walk_planned
from validation.trial.outcome import Outcome
from validation.trial.plan import PlannedWalk, load_request, plan_walk
from validation.trial.record import SimulationRecord
from validation.trial.simulate import simulate


def make_run(
    directory: Path,
    *,
    steps: int = 4,
    outcome: Outcome | None = None,
    settings: tuple[str, ...] = (),
    angles: Mapping[str, float] = MappingProxyType({}),
    uncertainty: Uncertainty | None = None,
) -> Path:
    """Write the folder of a walk of ``normal``, without recording and report.

    Args:
        directory: folder to fill.
        steps: planned steps.
        outcome: how and when it ends; completed if None.
        settings: changes of the run, ``key=value``.
        angles: joints that are recorded as bent all the time [rad].
        uncertainty: of the metrics.
    """
    planned, record = walked(steps, settings, outcome)
    q = record.q.copy()
    for joint, angle in angles.items():
        q[:, 7 + record.joint_names.index(joint)] = angle
    with patch("validation.run.walk.simulate", lambda *_, **__: replace(record, q=q)):
        trial = walk_planned(planned, uncertainty=uncertainty)
    return trial.save(directory, recording=False)


@cache
def walked(
    steps: int, settings: tuple[str, ...], outcome: Outcome | None
) -> tuple[PlannedWalk, SimulationRecord]:
    planned = plan_walk(load_request("normal", [f"gait.steps={steps}", *settings], as_is=True))

    def stop(done: int, _: int) -> None:
        if outcome is not None and done * planned.run.simulation.time_step >= outcome.time:
            raise KeyboardInterrupt

    record = simulate(planned.plan, planned.run, planned.body.model, progress=stop)
    return planned, replace(record, outcome=outcome or record.outcome)


def make_study(folder: Path, metrics: Mapping[str, Any], **more: Any) -> Path:
    """Write a ``convergence.json`` of the numerical uncertainties that it is given."""
    known = {"gait": "normal", "steps": 6, "values": metrics, **more}
    path = folder / "convergence.json"
    path.write_text(json.dumps({"uncertainty": known}), encoding="utf-8")
    return path
