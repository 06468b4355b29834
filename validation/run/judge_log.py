"""A log of measured signals, judged by a plan as a walk of the simulation is; a saved run, judged again."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ampm.exceptions import InputError
from ampm.files import quoted
from ampm.parameters import NO_PLAN, RunParameters
from ampm.section import misspelt
from ampm.walk import WalkPlan
from validation.judge.compare import SIGNALS, compare
from validation.judge.log import (
    PHASES,
    LogFacts,
    MeanStride,
    check_climb,
    find_place,
    find_start,
    mean_stride,
    steps_beside,
)
from validation.judge.metrics import added_metrics, display_unit, evaluate
from validation.judge.profiles import Profile, find_profile, own_profile
from validation.judge.verdict import judge_summary
from validation.measure.log import HOLE, LOADED, NAMES, Log, log_record, map_columns, measure_log, read_log
from validation.measure.readers import reader_of
from validation.progress import Progress
from validation.run.trial import Trial
from validation.run.walk import timed
from validation.store.folders import names_folder
from validation.store.saved import SavedRun, load_saved_run
from validation.trial.files import RunFile
from validation.trial.plan import Request, load_request, plan_walk
from validation.trial.record import FEET
from validation.trial.users import SUFFIXES, read_columns, real_numbers

_OF_WALKS = frozenset({"controller", "disturbance", "sensors", "simulation", "contact"})  # sections
_KNOWN = 0.5  # least share of one kind of phase that a log has, over that of the other kind [1]
_UNEVEN = 0.01  # share of time between rows farther apart than most from which it is told [1]
LEAST_JUDGED = 0.5
"""Duration that a log must share with the judged steps of a plan, about that of a step [s]."""


def judge_log(
    table: str | Path | Mapping[str, Any],
    plan: RunParameters | str | Path = "normal",
    *,
    columns: Mapping[str, str] | None = None,
    settings: Sequence[str] = (),
    start: float | None = None,
    place: tuple[float, float] | None = None,
    strides: bool = False,
    progress: Progress | None = None,
) -> Trial:
    """Compare a log of measured signals with a plan, by the metrics and limits of a walk of its preset.

    Args:
        table: CSV or Parquet file, columns by name (:mod:`validation.measure.log`), or the folder of a run.
        plan: parameters, preset, TOML file, folder of a run, or table of a plan.
        columns: sources of columns that have other names or units, see
            :func:`validation.measure.log.map_columns`.
        settings: ``key=value`` texts that change the plan, not with parameters.
        start: time in the log at which the plan begins [s]; found if None.
        place: what to add to x and y of the log [m]; if None its mean ZMP becomes the plan's.
        strides: compare the mean stride with that of a periodic plan.
        progress: where to report stages.

    Returns:
        The log as a trial. Its record has neither joints nor motors; NaN is what the log does not have.

    Raises:
        InputError: the log cannot be read, or is like the plan nowhere.
        MathematicalRefusal, BodilyRefusal: there is no such plan.
    """
    progress = progress or Progress()
    if strides and (start is not None or place is not None):
        raise InputError(f"--strides takes no --start ({start}) and no --place ({place}); leave them out.")
    for name, given, shape in (("start", start, ()), ("place", place, (2,))):
        try:
            real_numbers(f"--{name} {given}", np.zeros(shape) if given is None else given, shape, finite=True)
        except ValueError as error:
            raise InputError(f"{error}; leave it out to find it.") from None
    request = _request(plan, settings)
    if request.run.gait.planner == NO_PLAN:
        raise InputError(
            "planner none makes no plan for a log; leave out gait.planner, or give another --plan."
        )
    profile = find_profile(own_profile(request.run))
    if idle := [key for key in request.changed if key.partition(".")[0] in _OF_WALKS]:
        progress.say(f"a log is not walked, and does not use: {', '.join(idle)}")
    signals, name = log_columns(table, columns)
    for column, meant in misspelt(signals, NAMES[1:]):
        progress.say(f"{name}: column {column} is not used; did you mean {meant}?")
    planned = plan_walk(request, progress)
    seconds = {"planning": planned.seconds}
    with timed(seconds, "measurement"), progress.stage(f"{planned.name}: log"):
        reference = planned.plan
        raw = read_log(signals, reference.weight, name)
        log, facts = _aligned(raw, reference, start, place, strides=strides)
        measured = measure_log(log, reference.mass, reference.gravity)
        steps, planned_steps = _steps(log, reference), reference.contacts.steps
        comparison = compare(reference, log_record(log, measured, steps), measured, counts=log.counts)
        values = evaluate(comparison)
        if facts.strides is None:
            facts = replace(facts, steps=steps, planned_steps=planned_steps)
        else:  # strides are compared over their share
            stride = 2.0 * reference.constants.step_duration
            values["stride_duration_error"] = abs(facts.strides.duration / stride - 1.0)
    part = f"{steps} of {planned_steps} steps of " if steps < planned_steps and not strides else ""
    planned = replace(planned, request=replace(planned.request, name=f"{log.name} on {part}{planned.name}"))
    extra = {"planner": planned.planner} if planned.planner else {}
    return Trial(planned, comparison, MappingProxyType(values), profile, seconds, extra, log=facts)


def judge_run(directory: str | Path, profile: Profile | str | None = None) -> SavedRun:
    """Judge the folder of a run, or of a log, again by the metrics that it holds; nothing is written.

    The metrics are not computed anew: the folder does not keep every state that they were measured from. The
    profile, or its name, is by default the one by which it was judged. Raises :class:`InputError` if it is
    not a run folder, or the profile or one of the metrics is not known or was not measured.
    """
    saved = load_saved_run(directory)
    if lacking := [item.name for item in added_metrics() if item.name not in saved.summary["metrics"]]:
        raise InputError(f"{directory} has no values of {', '.join(lacking)}; walk it again with --metric.")
    limits = find_profile(saved.summary["profile"] if profile is None else profile)
    return replace(saved, summary=judge_summary(saved.summary, limits, saved.record.outcome.ending))


def log_columns(
    table: str | Path | Mapping[str, Any], mapping: Mapping[str, str] | None = None
) -> tuple[dict[str, Any], str]:
    """Columns of a log by name, after a mapping, and its name; of a run's folder what was measured."""
    if not isinstance(table, str | Path) and hasattr(table, "keys"):
        return map_columns(table, mapping or {}), "the log"
    if not isinstance(table, str | Path) or not (path := Path(table)).exists():
        raise InputError(f"there is no file and no folder {str(table)[:99]!r}; give one, or columns by name.")
    read = _measured if path.is_dir() else reader_of(path) or read_columns
    return map_columns(read(path), mapping or {}), path.name


def _measured(folder: Path) -> dict[str, Any]:
    """What was measured of a run, as a log."""
    signals = load_saved_run(folder).signals.columns
    own = ("time", "command", "measured_", *(f"{foot}_force" for foot in FEET))
    found = {name.removeprefix("measured_"): signals[name] for name in signals if name.startswith(own)}
    return {name: values for name, values in found.items() if not np.isnan(values).all()}  # of a judged log


def _request(plan: RunParameters | str | Path, settings: Sequence[str]) -> Request:
    """The walk that a log is compared with; nothing disturbs it."""
    if isinstance(plan, RunParameters):
        request = load_request(plan, settings)  # which refuses settings
    elif Path(plan).suffix in SUFFIXES:
        planner = f"gait.planner={quoted(str(Path(plan).resolve()))}"
        request = load_request(None, [*settings, planner], walked=False)
    elif names_folder(plan):
        gait = load_saved_run(plan).summary["gait"]
        request = replace(load_request(str(Path(plan) / RunFile.RUN), settings, walked=False), name=gait)
    else:
        request = load_request(str(plan), settings, walked=False)
    return replace(request, run=request.run.undisturbed)


def _steps(log: Log, plan: WalkPlan) -> int:
    """Steps of the plan within a log; at its ends it may lack as little time as is no gap."""
    ends, near = np.array([0.0, *plan.contacts.step_ends]), max(2.0 * log.time_step, HOLE)
    return int(np.count_nonzero((ends[:-1] >= log.time[0] - near) & (ends[1:] <= log.time[-1] + near)))


def _check_phases(log: Log, plan: WalkPlan) -> None:
    """Refuse a log that lacks most of one kind of phase, between its first and last row."""
    time = np.arange(log.time[0], log.time[-1] + 0.5 * log.time_step, log.time_step)
    late = np.searchsorted(log.time, time).clip(1, log.time.size - 1)
    apart = np.minimum(np.abs(time - log.time[late - 1]), np.abs(time - log.time[late]))
    phases = plan.sample(np.minimum(time, plan.duration)).phase_name
    known = {str(kind): float((apart < log.time_step)[phases == kind].mean()) for kind in np.unique(phases)}
    if min(known.values()) < _KNOWN * max(known.values()):
        kinds = " and ".join(f"{100 * share:.0f} % of the {kind}s" for kind, share in known.items())
        way_out = "give a log without such gaps"
        if log.signals.keys() & {"left_force", "right_force"}:
            way_out = "fill its empty cells, with 0 for force and torque of a foot in the air"
        raise InputError(f"{log.name} has force and ZMP in {kinds.replace('_', ' ')} of the plan; {way_out}.")


def _aligned(
    log: Log, plan: WalkPlan, start: float | None, place: tuple[float, float] | None, *, strides: bool
) -> tuple[Log, LogFacts]:
    """A log on clock and floor of a plan, and what was done to it."""
    if log.duration < LEAST_JUDGED:
        raise InputError(
            f"{log.name} lasts {log.duration:.3g} s, and needs {LEAST_JUDGED:g} s; give a longer log."
        )
    raw, notes, mean, correlation, beside = log, _notes_on_rows(log), None, None, None
    if strides:
        check_climb(log, plan, np.linspace(plan.judged_from, plan.duration, PHASES))
        log, mean = mean_stride(log, plan)
        notes.append(_note_on_strides(mean, plan, log.weight))
    else:
        if start is None:
            start, correlation = find_start(log, plan)
            notes.append(f"The plan begins at {start:z.4f} s of the log, by correlation ({correlation:.3f}).")
            beside = steps_beside(log, start - log.time_step, start + plan.duration)
            if beside:
                notes.append(f"Steps of the log before and after the plan, which are not judged: {beside}.")
        time = log.time - start
        log = replace(log, time=time).rows((time >= 0.0) & (time <= plan.duration + 1e-9))
    judged = _judged(log, plan, start or 0.0)
    late = judged.time[0] - max(plan.judged_from, log.time[0])  # of a gap over the begin
    left_out, empty = _missing(raw if strides else judged, late, strides=strides)
    _check_phases(judged, plan)
    if not strides:
        check_climb(judged, plan, judged.time)
    by, mean_of, turn = find_place(judged, plan)
    if place is not None:
        by = np.array(place)
    elif mean_of:
        notes.append(
            f"The log is moved by {by[0]:.4g} m along x and {by[1]:.4g} m along y, to the mean of the plan's "
            f"{mean_of}: its bias is not judged."
        )
    if mean_of and not strides:
        side = "left" if turn > 0.0 else "right"
        notes.append(
            f"Its way is turned by {abs(math.degrees(turn)):.2f} degrees to the {side} of the plan's."
        )
    notes.append(
        f"{log.time.size} instants of the plan are compared, {log.time[0]:.3f} to {log.time[-1]:.3f} s, and "
        f"judged from {judged.time[0]:.3f} s."
    )
    facts = LogFacts(
        rows=raw.time.size,
        rate=1.0 / raw.time_step,
        strides=mean,
        correlation=correlation,
        beside=beside,
        start=start,
        left_out=left_out,
        empty=empty,
        place=(float(by[0]), float(by[1])),
        from_=float(log.time[0]),
        until=float(log.time[-1]),
        notes=notes,
    )
    return log.moved(by), facts


def _judged(log: Log, plan: WalkPlan, start: float) -> Log:
    """The judged rows of a log on the clock of a plan, which began at ``start`` [s]; refused if too few."""
    judged = log.rows(log.time >= plan.judged_from - 1e-9)
    span = judged.duration if judged.time.size else 0.0
    if span < LEAST_JUDGED:
        raise InputError(
            f"{log.name} has {judged.time.size} rows over {span:.3g} s, and needs {LEAST_JUDGED:g} s, "
            f"between {plan.judged_from:.4g} and {plan.duration:.4g} s of the plan, which begins at "
            f"{start:.6g} s; give a longer log, or another start (--start)."
        )
    return judged


def _notes_on_rows(log: Log) -> list[str]:
    """Sentences on rate, force and gaps of a log."""
    share = float(log.signals["force"][:, 2].mean()) / log.weight
    notes = [
        f"{log.name}: {log.time.size} rows at {1.0 / log.time_step:.4g} Hz; the mean vertical force is "
        f"{100 * share:.1f} % of the plan's weight."
    ]
    if (gaps := log.lost[1:][log.lost[1:] > 0.0]).size:
        of = f"{gaps.size} of {gaps.sum():.3g} s in all, the longest {gaps.max():.3g} s"
        notes.append(f"Gaps that are left out: {of}.")
    if (counts := log.counts)[counts > 1.0].sum() > _UNEVEN * counts.sum():
        notes.append("A row counts for the time until the next: give a log of one rate if it has several.")
    return [*notes, log.unsupported] if log.unsupported else notes


def _note_on_strides(mean: MeanStride, plan: WalkPlan, weight: float) -> str:
    """A sentence on the strides of a log, for a body with a weight [N]."""
    spreads = []
    for name, values in mean.spreads.items() if mean.count > 1 else ():
        factor, unit = display_unit(SIGNALS[f"{name}_x"].unit, weight)
        numbers = "/".join(f"{factor * value:.3g}" for value in values)
        spreads.append(f"{SIGNALS[f'{name}_x'].quantity} {numbers} {unit}")
    return (
        f"Mean of {mean.count} stride{'s' * (mean.count > 1)} of {mean.duration:.4g} s at "
        f"{mean.speed:.3g} m/s, over the share of the stride; the plan's have "
        f"{2.0 * plan.constants.step_duration:.4g} s and {plan.constants.mean_velocity:.3g} m/s."
        + f" Standard deviation between strides, x/y/z: {', '.join(spreads)}."
        * bool(spreads)
    )


def _missing(log: Log, late: float, *, strides: bool) -> tuple[float, float]:
    """Shares of a log's time that are left out, and of its rows without angular momentum [1].

    It begins ``late`` [s]. Of strides the time is left out, too, while nothing carries the body.
    """
    lost = log.lost[1:].sum() + min(log.lost[0], max(late, 0.0))
    light = log.counts @ (log.signals["force"][:, 2] < LOADED * log.weight) if strides else 0.0
    empty = np.isnan(log.signals.get("angular_momentum", np.zeros((1, 3)))).any(axis=1)
    left_out = (lost + log.time_step * light) / (log.duration + lost)
    return float(left_out), float(empty.mean())
