"""Folders of short real runs, each walked once per process, and files of convergence studies."""

import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any
from unittest.mock import patch

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from validation.judge.profiles import DEFAULT
from validation.judge.uncertainty import Uncertainty
from validation.run.walk import walk_planned
from validation.store.json import write_json
from validation.store.saved import digests
from validation.trial.outcome import Outcome
from validation.trial.plan import PlannedWalk, load_request, plan_walk
from validation.trial.record import SimulationRecord
from validation.trial.simulate import simulate

TWO_MS = ("simulation.time_step=0.002",)


def make_run(
    directory: Path,
    *,
    steps: int = 4,
    outcome: Outcome | None = None,
    settings: tuple[str, ...] = TWO_MS,
    angles: Mapping[str, float] = MappingProxyType({}),
    uncertainty: Uncertainty | None = None,
) -> Path:
    """Write the folder of a walk of ``normal``, without recording and report.

    ``outcome`` says how and when it ends, ``settings`` are ``key=value``, and the joints in ``angles`` are
    recorded as bent all the time [rad].
    """
    planned, record = walked(steps, settings, outcome)
    q = record.q.copy()
    for joint, angle in angles.items():
        q[:, 7 + record.joint_names.index(joint)] = angle
    with patch("validation.run.walk.simulate", lambda *_, **__: replace(record, q=q)):
        trial = walk_planned(planned).judged(DEFAULT, uncertainty).judged(DEFAULT)
    return trial.save(directory, recording=False)


@cache
def walked(
    steps: int, settings: tuple[str, ...], end: Outcome | None
) -> tuple[PlannedWalk, SimulationRecord]:
    planned = plan_walk(load_request("normal", [f"gait.steps={steps}", *settings], as_is=True))

    def stop(done: int, _: int) -> None:
        if end is not None and done * planned.run.simulation.time_step >= end.time:
            raise KeyboardInterrupt

    record = simulate(planned, progress=stop)
    return planned, replace(record, outcome=end or record.outcome)


def forge(source: Path, target: Path, file: str, change: Callable[[pa.Table], pa.Table]) -> Path:
    """Copy a run with one of its tables changed, and with digests that fit."""
    shutil.copytree(source, target)
    pq.write_table(change(pq.read_table(target / file)), target / file)
    summary = json.loads((target / "summary.json").read_text(encoding="utf-8"))
    write_json(target / "summary.json", summary | {"files": digests(target, summary)})
    return target


def with_column(table: pa.Table, name: str, change: Callable[[np.ndarray], Any]) -> pa.Table:
    """A table with other numbers in one column; they are NaN where it has none."""
    place = table.schema.get_field_index(name)
    values = table[name].to_numpy().copy()
    changed = pa.array(change(values), from_pandas=True)
    return table.set_column(place, table.schema.field(place), changed)


def described(**changes: Any) -> Callable[[pa.Table], pa.Table]:
    """Change constants in a table's description of the run."""

    def change(table: pa.Table) -> pa.Table:
        header = json.loads(table.schema.metadata[b"ampm_record"]) | changes
        return table.replace_schema_metadata({"ampm_record": json.dumps(header)})

    return change


def make_study(folder: Path, metrics: Mapping[str, Any], **more: Any) -> Path:
    """Write a ``convergence.json`` of the numerical uncertainties that it is given."""
    known = {"gait": "normal", "steps": 6, "values": metrics, **more}
    path = folder / "convergence.json"
    path.write_text(json.dumps({"uncertainty": known}), encoding="utf-8")
    return path
