"""What a run leaves in its folder, the same for a trial and for a run of a sweep."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ampm.run_file import dump_run
from validation.judge.signals import signals_table
from validation.judge.verdict import build_summary
from validation.store.folders import INSTRUMENT_FILE, RUN_FILES
from validation.store.json import json_ready
from validation.store.machine import memory_peak
from validation.store.signals import SIGNALS_FILE, save_signals

if TYPE_CHECKING:
    from ampm.parameters import RunParameters
    from models.human import BodyModel
    from validation.judge.examine import Evaluation
    from validation.measure.instruments.model import Instrument
    from validation.trial.plan import PlannedWalk
    from validation.trial.record import SimulationRecord


def write_inputs(folder: Path, run: RunParameters, model: BodyModel, environment: Mapping[str, Any]) -> None:
    """What a run starts from: parameters, model, environment."""
    (folder / "run.toml").write_text(dump_run(run), encoding="utf-8")
    (folder / "model.xml").write_text(model.xml, encoding="utf-8")
    _write_json(folder / "environment.json", environment)


def write_signals(folder: Path, found: Evaluation) -> None:
    """Plan, command and measurement on the physics' time steps."""
    save_signals(signals_table(found.comparison), folder / SIGNALS_FILE)


def write_summary(
    folder: Path,
    planned: PlannedWalk,
    found: Evaluation,
    *,
    name: str,
    timing: Mapping[str, float | None],
    environment: Mapping[str, Any],
    more: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """What is said of a run, and what it was made with.

    Args:
        folder: of the run.
        planned: plan and body.
        found: in its walk.
        name: of the gait or run.
        timing: wall-clock times [s], and the speed as a multiple of real time.
        environment: where it ran.
        more: entries of the summary beside the usual ones.

    Returns:
        The contents of ``summary.json``.
    """
    standing = found.comparison.standing
    summary = build_summary(
        found.comparison,
        found.verdict,
        timing=dict(timing),
        environment=dict(environment),
        extra={
            "gait": name,
            "motion": planned.plan.posture.report(),
            "standing": None if standing is None else asdict(standing),
            "memory_peak": {"value": memory_peak(), "unit": "MB"},
            **(more or {}),
        },
    )
    _write_json(folder / "summary.json", summary)
    return summary


def write_observation(
    folder: Path, instrument: Instrument, planned: PlannedWalk, record: SimulationRecord
) -> dict[str, Any]:
    """The walk as an instrument shows it: readings into a file.

    Returns:
        Its errors, for the summary.
    """
    from validation.measure.instruments.columns import observation_columns, observe_walk
    from validation.store.tables import write_columns

    seen = observe_walk(instrument, planned, record)
    write_columns(observation_columns(seen), folder / INSTRUMENT_FILE)
    return seen.as_dict()


def _write_json(path: Path, value: Any) -> None:
    if path.name not in RUN_FILES:
        raise ValueError(f"{path.name} is no file of a run folder")
    path.write_text(json.dumps(json_ready(value), indent=2, allow_nan=False) + "\n", encoding="utf-8")
