"""A log of measured signals, judged by a plan as a walk of the simulation is; a saved run, judged again."""

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
from validation.judge.compare import compare
from validation.judge.log import align, whole_steps
from validation.judge.metrics import added_metrics, evaluate
from validation.judge.profiles import Profile, find_profile, own_profile
from validation.judge.verdict import judge_summary
from validation.measure.log import NAMES, log_record, map_columns, measure_log, read_log
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
_REPEATED = 1e-6  # largest difference of a plan's COM from the recorded one of equal code [m]


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
    if not (isinstance(plan, RunParameters) or settings) and names_folder(plan):
        _check_recorded(load_saved_run(plan), planned.plan)
    seconds = {"planning": planned.seconds}
    with timed(seconds, "measurement"), progress.stage(f"{planned.name}: log"):
        reference = planned.plan
        raw = read_log(signals, reference.weight, name)
        log, facts = align(raw, reference, start, place, strides=strides)
        measured = measure_log(log, reference.mass, reference.gravity)
        steps, planned_steps = whole_steps(log, reference), reference.contacts.steps
        comparison = compare(reference, log_record(log, measured, steps), measured, counts=log.counts)
        values = evaluate(comparison)
        if facts.strides is not None:  # which are compared over their share
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


def _check_recorded(saved: SavedRun, plan: WalkPlan) -> None:
    """Refuse the plan of a run, made anew, if it is not the recorded one: a table or class has changed."""
    if saved.record.changes:  # other plans were recorded, too
        return
    now = plan.sample(np.minimum(saved.signals.time, plan.duration)).com
    off = float(np.abs(now - saved.signals.vector("plan_com", "xyz")).max())
    if off > _REPEATED:
        raise InputError(
            f"{saved.directory}: its plan, made anew, is {1e3 * off:.3g} mm from the recorded one: a table, "
            "its class or ampm has changed; walk it again."
        )
