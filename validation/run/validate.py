"""The trial of one gait: plan, motion, simulation, measurement, comparison, verdict, run folder.

The order of writing is the order of worth: parameters and environment before the walk starts, the record as
soon as it ends, then signals and summary, and last what can be drawn again from the saved files.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ampm.exceptions import InputError
from validation.judge.examine import examine
from validation.judge.profiles import DEFAULT, Profile
from validation.judge.uncertainty import Uncertainty
from validation.judge.verdict import Verdict
from validation.measure.measure import MeasuredGait, measure
from validation.progress import Progress, interruption
from validation.run.files import write_inputs, write_observation, write_signals, write_summary
from validation.store.environment import describe_environment
from validation.store.folders import check_run_folder, run_folder
from validation.store.record import load_record, save_record
from validation.trial.bridge import to_pinocchio
from validation.trial.outcome import OutcomeName
from validation.trial.plan import PlannedWalk, Request, plan_walk
from validation.trial.record import SimulationRecord
from validation.trial.simulate import simulate

if TYPE_CHECKING:
    from validation.measure.instruments.model import Instrument

RUNS = Path("runs")
"""Where runs go that were given no place of their own."""


@dataclass(frozen=True)
class Options:
    """How a trial is judged and kept.

    Attributes:
        profile: tolerances.
        force: replace an earlier run in the same folder.
        recording: write ``recording.rrd`` and ``report.html``; both can be written later from the folder.
        uncertainty: of the metrics, from a convergence study; None judges the values as they are.
        instrument: shown beside the simulator's truth, see :mod:`validation.measure.instruments`; None
        for none.
    """

    profile: Profile = DEFAULT
    force: bool = False
    recording: bool = True
    uncertainty: Uncertainty | None = None
    instrument: Instrument | None = None


@dataclass(frozen=True)
class Trial:
    """A finished trial.

    Attributes:
        planned: plan and motion.
        verdict: of the profile.
        summary: contents of ``summary.json``.
        directory: the run folder.
    """

    planned: PlannedWalk
    verdict: Verdict
    summary: dict[str, Any]
    directory: Path

    @cached_property
    def record(self) -> SimulationRecord:
        """Of the simulation, read back from the folder: nobody else needs its memory until then."""
        return load_record(self.directory)

    @cached_property
    def measured(self) -> MeasuredGait:
        """Blind to the plan; measured again, to the same bits."""
        return measure(self.record, self.planned.body.robot.model, to_pinocchio)


def targets(asked: Sequence[Request], out: Path | None, *, force: bool) -> list[Path]:
    """Folder of every run, all of them checked before anything runs.

    ``out`` itself for one gait, a folder of each gait's name in it for several; without it
    ``runs/<gait>-<time>``.

    Raises:
        InputError: a folder must not be written.
    """
    if out is None:
        stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
        folders = [_unused(RUNS / f"{item.name}-{stamp}") for item in asked]
    elif len(asked) == 1:
        folders = [out]
    else:
        if out.exists() and not out.is_dir():
            raise InputError(f"--out {out} is a file, not a folder; give another folder.")
        if (out / "run.toml").exists():
            raise InputError(f"--out {out} is itself the folder of a run; give another folder.")
        folders = [out / item.name for item in asked]
    for folder in folders:
        check_run_folder(folder, force=force)
    return folders


def validate(
    asked: Request, target: Path, options: Options | None = None, *, stages: Progress | None = None
) -> Trial:
    """Plan, walk, measure and judge one gait, and keep everything in a folder.

    A walk that is interrupted (``KeyboardInterrupt``) is measured and kept as far as it went. One that is
    interrupted after the walk is finished as far as its numbers, without recording and report;
    ``interruption.pending`` tells.

    Args:
        asked: the gait.
        target: the run folder, see :func:`validation.store.folders.run_folder`.
        options: profile and what to keep.
        stages: where to report progress.

    Raises:
        InputError, MathematicalRefusal, BodilyRefusal: the request cannot be met; nothing is written.
    """
    options, stages = options or Options(), stages or Progress()
    clock = _Clock(stages, asked.name)
    check_run_folder(target, force=options.force)
    with clock("planning"):
        planned = plan_walk(asked, stages)
    environment = describe_environment()
    late: BaseException | None = None
    with run_folder(target, force=options.force) as folder:
        write_inputs(folder, asked.run, planned.body.model, environment)
        try:
            verdict, summary = _walk(planned, folder, options, clock, environment)
        finally:
            interruption.release()
        if options.recording and not interruption.pending:
            late = _draw(folder, target, clock)
    if late is not None:
        raise late
    return Trial(planned, verdict, summary, target)


def _walk(
    planned: PlannedWalk, folder: Path, options: Options, clock: _Clock, environment: dict[str, Any]
) -> tuple[Verdict, dict[str, Any]]:
    """Walk, measure and judge, and write all that says so; record and measurement are given up at the end."""
    asked, body = planned.request, planned.body
    with clock.stage("simulation", "steps") as advance:

        def progress(done: int, total: int) -> None:
            interruption.check()
            advance(done, total)

        record = simulate(planned.plan, asked.run, body.model, steps=asked.run.gait.steps, progress=progress)
        if record.outcome.name == OutcomeName.INTERRUPTED:
            interruption.acknowledge()
        else:
            interruption.hold()
    save_record(record, folder)
    known = options.uncertainty
    with clock.stage("measurement"):
        found = examine(planned, record, options.profile, known)
        write_signals(folder, found)
    timing = clock.timing(record)
    more: dict[str, Any] = {} if known is None else {"uncertainty": known.as_dict()}
    if options.instrument is not None:
        with clock.stage("instrument"):
            more["instrument"] = write_observation(folder, options.instrument, planned, record)
    summary = write_summary(
        folder, planned, found, name=asked.name, timing=timing, environment=environment, more=more
    )
    return found.verdict, summary


def _draw(folder: Path, target: Path, clock: _Clock) -> BaseException | None:
    """Write recording and report from the saved files; what goes wrong must not cost the run its folder."""
    try:
        with clock.stage("recording"):
            # In here: importing the viewer's library is most of what the first recording costs.
            from validation.show.rerun.record import record_run
            from validation.store.saved import load_saved_run

            saved = load_saved_run(folder)
            record_run(saved)
        saved.record.forget()
        with clock.stage("report"):
            from validation.show.report import report_run

            report_run(saved)
        interruption.check()
    except (Exception, KeyboardInterrupt) as error:
        error.add_note(f"the run itself is complete in {target}, and 'ampm report' draws it again")
        return error
    return None


class _Clock:
    """Wall-clock time of the stages, reported as they pass."""

    def __init__(self, stages: Progress, name: str) -> None:
        self.stages, self.name = stages, name
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, label: str) -> Iterator[None]:
        """Time a stage that reports for itself."""
        start = time.perf_counter()
        yield
        self.seconds[label] = time.perf_counter() - start

    @contextmanager
    def stage(self, label: str, unit: str = "") -> Iterator[Callable[[int, int], None]]:
        """Time and report a stage; yields its ``advance(done, total)``."""
        with self(label), self.stages.stage(f"{self.name}: {label}", unit) as stage:
            yield stage.advance

    def timing(self, record: SimulationRecord) -> dict[str, float | None]:
        """Seconds of every stage so far, and the closed loop's speed as a multiple of real time."""
        simulated = float(record.time[-1] - record.time[0])
        return {
            **self.seconds,
            "simulated": simulated,
            "real_time_factor": simulated / self.seconds["simulation"],
        }


def _unused(folder: Path) -> Path:
    """The folder, with a number behind it if there is one of that name already."""
    candidate, number = folder, 2
    while candidate.exists():
        candidate = folder.with_name(f"{folder.name}-{number}")
        number += 1
    return candidate
