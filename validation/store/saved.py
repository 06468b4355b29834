"""A finished run read from its folder, from which recording and report are drawn.

Nothing is simulated or measured here. Only the plan of COM and feet is evaluated again from ``run.toml``: it
is exact, and the support polygons are cheaper to recompute than to store.
"""

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, create_model

from ampm.description import BodyDescription
from ampm.exceptions import AmpmError, InputError
from ampm.files import check_regular
from ampm.geometry import Array, convex_hull
from ampm.parameters import RunParameters
from ampm.planner.footstep_walk import plan_footstep_walk
from ampm.planner.step_planners import STEP_PLANNERS
from ampm.planner.support import StepPlan
from ampm.run_file import load_run
from validation.store.json import dump_json, read_json, write_json
from validation.store.metric_table import metric_table, summary_title, walk_sentence
from validation.store.record import RECORD_FILES, load_record, read_header
from validation.store.signals import Signals, load_signals
from validation.table import Table, Tabled
from validation.trial.files import RunFile
from validation.trial.record import FEET, SimulationRecord

DESCRIPTION = TypeAdapter(BodyDescription)
"""Writes and reads the description of a body."""
_ENTRIES = (
    "outcome steps_completed end verdict reason profile gait metrics timing statistics zmp_error_split "
    "effort margins energy solver scales environment files"
)
SUMMARY: Any = create_model("Summary", **dict.fromkeys(_ENTRIES.split(), Any))  # type: ignore[call-overload]
"""What every summary has; others are free. Its own digest answers for the values."""
_NEEDED = (RunFile.RUN, RunFile.MODEL, RunFile.BODY, RunFile.SIGNALS, RunFile.SUMMARY)


@dataclass(frozen=True)
class SavedRun(Tabled):
    """Contents of a run folder."""

    directory: Path  # the folder
    parameters: RunParameters  # the resolved parameters
    model_xml: str  # the compiled model's source (MJCF)
    body: BodyDescription  # which joint, sole and segment of it is what
    record: SimulationRecord  # states and contact forces every 10 ms, torques of every tick
    signals: Signals  # plan, command and measurement on the common clock
    summary: Mapping[str, Any]  # `summary.json`

    def __repr__(self) -> str:
        """Folder, gait, steps, outcome and verdict."""
        said, outcome = self.summary, self.record.outcome
        return f"SavedRun({self.directory}: {said.get('gait')}, {outcome.summary}, {said.get('verdict')})"

    def model(self) -> mujoco.MjModel:
        """The simulated model; raises InputError if it is damaged or of another body, or the run is a log."""
        record, path = self.record, self.directory / RunFile.MODEL
        if not record.joint_names:
            raise InputError(f"{self.directory} is of a log, which has no joints; give the folder of a walk.")
        try:
            model = mujoco.MjModel.from_xml_string(self.model_xml)
        except ValueError as error:
            raise InputError(f"{path} cannot be read ({error}); give the folder of a run.") from error
        shape = model.nq, model.nv, model.nu
        recorded = record.q.shape[1], record.qd.shape[1], len(record.joint_names)
        if shape != recorded:
            raise InputError(
                f"{path} has (nq, nv, nu) = {shape}, the record {recorded}; "
                "the files are of two runs, give the folder of one."
            )
        return model

    @property
    def signal_steps(self) -> NDArray[np.intp]:
        """Step of the physics of every row of the signals."""
        return np.round(self.signals.time / self.record.time_step).astype(np.intp)

    @property
    def is_log(self) -> bool:
        """Whether it is a log, without joints and contact points; see :mod:`validation.run.judge_log`."""
        return "log" in self.summary

    @property
    def is_free(self) -> bool:
        """Whether the walk had no plan, but a commanded velocity."""
        return "velocity" in self.summary

    @property
    def from_rest(self) -> bool:
        """Whether the walk begins with standing on both feet, as over footsteps, so that steps may differ."""
        return "double_support" in self.signals["phase"][:1]

    @property
    def pushes(self) -> list[tuple[str, float, float, float]]:
        """Segment, begin and end [s], and largest force [N] of every push."""
        found, record = [], self.record
        for k, segment in enumerate(record.external_segments):
            size = np.linalg.norm(record.external_force[:, k], axis=1)
            for a, b in np.flatnonzero(np.diff(size > 0.0, prepend=False, append=False)).reshape(-1, 2):
                found.append((segment, float(record.time[a]), float(record.time[b]), float(size[a:b].max())))
        return found

    def footprints(self) -> list[tuple[str, Array]]:
        """Foot and closed outline, shape (N, 3) [m], of the soles at first and in each single support."""
        record, found = self.record, []
        for begin, end in pairwise([*self.signals.switches().tolist(), len(self.signals)]):
            stance = str(self.signals["stance"][begin])
            standing = FEET if stance == "both" and not begin else {stance} & {*FEET}
            for foot in () if self.is_log else standing:
                row = np.searchsorted(record.state_rows[:-2], self.signal_steps[(begin + end) // 2])
                points = record.point_position[row, record.point_foot == FEET.index(foot)]
                hull = convex_hull(points[:, :2])
                found.append((foot, np.insert(np.vstack([hull, hull[:1]]), 2, points[:, 2].min(), axis=1)))
        return found

    @property
    def planned_timing(self) -> dict[str, float]:
        """Mean durations and speed of whole phases and steps of the plan, by labels with units."""
        signals, found = self.signals, {}
        if len(signals) > 1 and not self.is_free:
            begun = signals.switches()
            kinds, lasting = signals["phase"][begun[:-1]], np.diff(signals.time[begun])
            for name in ("single_support", "double_support"):
                mine = lasting[kinds == name]
                found[f"{name.replace('_', ' ')} [s]"] = float(mine.mean()) if mine.size else math.nan
            ends = begun[::2][[0, -1]]
            way = np.linalg.norm(np.ptp(signals.vector("plan_com", "xy")[ends], axis=0))
            whole = len(begun) > 2  # a step
            found["planned speed [m/s]"] = float(way / np.ptp(signals.time[ends])) if whole else math.nan
        return found

    @property
    def title(self) -> str:
        """Name of the gait, what was changed in it, and its planner if it is not the default one."""
        return summary_title(self.summary)

    @property
    def sentence(self) -> str:
        """Gait, steps, outcome, and verdict with its reason."""
        return walk_sentence(self.summary, self.record.outcome)

    def table(self) -> Table:
        """Every judged metric with its limit."""
        return metric_table(self.summary)

    def tables(self) -> list[Table]:
        """What was judged."""
        return [self.table()]

    def plan(self) -> StepPlan | None:
        """Evaluate the plan of COM and feet again.

        None if a planner of a user's own made the plan, or this version of ours refuses it.
        """
        name = self.summary.get("planner", "ampm")
        run, planner = self.parameters, STEP_PLANNERS.get(name)
        try:
            if name == "footsteps" and run.footsteps:
                return plan_footstep_walk(run, self.body)
            return planner and planner(run.gait, run.body.mass, run.foot, self.body.sole)
        except AmpmError:
            return None


def load_saved_run(directory: str | Path, *, check: bool = True) -> SavedRun:
    """Read a run's parameters, signals, record and summary; ``check`` compares files with their digests.

    Raises :class:`InputError` if folder or file is missing, damaged, or not what the run wrote.
    """
    if not isinstance(directory, str | Path):
        raise InputError(f"{directory!r} names no folder; give that of a finished run.")
    directory = Path(directory)
    if not directory.exists():
        raise InputError(f"there is no folder {str(directory)!r}; give that of a finished run.")
    missing = [name for name in _NEEDED if not (directory / name).is_file()]
    if missing:
        raise InputError(f"{directory} has no {', '.join(missing)}; give the folder of a finished run.")
    if check:
        check_files(directory)
    return SavedRun(
        directory=directory,
        parameters=load_run(directory / RunFile.RUN, ()),
        model_xml=(directory / RunFile.MODEL).read_text(encoding="utf-8"),
        body=read_json(directory / RunFile.BODY, BodyDescription, "walk again")[1],
        record=load_record(directory),
        signals=load_signals(directory / RunFile.SIGNALS),
        summary=read_summary(directory),
    )


def read_summary(directory: Path) -> dict[str, Any]:
    """Contents of ``summary.json`` in a run's folder; raises InputError if it is missing or damaged."""
    return dict(read_json(directory / RunFile.SUMMARY, SUMMARY, "walk the gait again")[0])


def check_files(directory: Path) -> None:
    """Compare all files of a run with the digests in its summary.

    Raises :class:`InputError` if the record has another format, or a file is missing, has no digest, or has
    changed since the run was judged.
    """
    read_header(directory)
    summary = read_summary(directory)
    written, found = summary["files"], digests(directory, summary)
    if RunFile.RECORDING in written:  # it can be drawn again
        found[RunFile.RECORDING] = _digest(directory / RunFile.RECORDING) or written[RunFile.RECORDING]
    for name in sorted({*_NEEDED, *RECORD_FILES, *written, *found}):
        if name not in found:
            what = "is missing"
        elif name not in written:
            what = f"has no digest in {RunFile.SUMMARY}"
        elif found[name] != written[name]:
            what = "has changed since the run was judged"
        else:
            continue
        raise InputError(f"{directory / name} {what}; walk the gait again for a true verdict.")


def digests(directory: Path, summary: Mapping[str, Any]) -> dict[str, str]:
    """SHA-256 of all files of a run, except those drawn from the others; of the summary without ``files``.

    Raises :class:`InputError` if one of them is not a regular file.
    """
    rest = {name: value for name, value in summary.items() if name != "files"}
    found: dict[str, str] = {RunFile.SUMMARY: hashlib.sha256(dump_json(rest).encode()).hexdigest()}
    drawn = {RunFile.RECORDING, RunFile.REPORT, RunFile.EXPLANATION}
    for name in sorted(set(RunFile) - drawn - {RunFile.SUMMARY}):
        if digest := _digest(directory / name):
            found[name] = digest
    return found


def _digest(path: Path) -> str:
    """SHA-256 of a file, empty if there is none; raises InputError if it is not a regular file."""
    check_regular(path)
    if not path.exists():
        return ""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def keep_digest_of_recording(directory: Path) -> None:
    """Enter the digest of a recording that was drawn into the summary of its run."""
    summary = read_summary(directory)
    summary["files"][RunFile.RECORDING] = _digest(directory / RunFile.RECORDING)
    write_json(directory / RunFile.SUMMARY, summary)


def run_events(saved: SavedRun) -> list[tuple[float, str, str]]:
    """List (time [s], level, sentence) of what happened in a run."""
    signals, record = saved.signals, saved.record
    events: list[tuple[float, str, str]] = []
    if len(signals):
        time = signals.time
        for foot in FEET:
            contact = signals[f"{foot}_contact"]
            for row in np.flatnonzero(contact[1:] != contact[:-1]) + 1:
                verb = "touches the floor" if contact[row] else "leaves the floor"
                events.append((float(time[row]), "DEBUG", f"The {foot} foot {verb}."))
        for axis in "xy":
            error = np.abs(signals[f"measured_zmp_{axis}"] - signals[f"plan_zmp_{axis}"])
            first = signals.first_step() if signals.first_step() < len(signals) else 0
            if np.isfinite(error[first:]).any():
                worst = first + int(np.nanargmax(error[first:]))
                text = f"Largest ZMP error along {axis}: {1e3 * error[worst]:.3g} mm."
                events.append((float(time[worst]), "INFO", text))
    for segment, begin, end, size in saved.pushes:
        events.append((begin, "WARN", f"A push of up to {size:.4g} N on {segment} for {end - begin:.3g} s."))
    unsolved = record.tick_time[record.qp_status == 2]
    begins = unsolved[np.r_[True, np.diff(unsolved) > 0.05]] if len(unsolved) else unsolved
    events += [(float(t), "ERROR", "The QP was not solved; the fallback gave the torques.") for t in begins]
    outcome = record.outcome
    level = "INFO" if outcome.name == "completed" else "CRITICAL"
    text = "The log ends." if saved.is_log else f"Outcome: {outcome.name}. {outcome.cause}".strip()
    events.append((float(outcome.time), level, text))
    return events
