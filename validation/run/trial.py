"""A judged walk: in memory, and the files of its folder."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from ampm.parameters import RunParameters
from ampm.run_file import dump_run
from ampm.walk import WalkPlan
from validation.judge.compare import Comparison
from validation.judge.log import LogFacts
from validation.judge.profiles import Profile, find_profile
from validation.judge.signals import kept_rows, signals_table
from validation.judge.uncertainty import Uncertainty
from validation.judge.verdict import MetricResult, Verdict, build_summary, judge
from validation.measure.measure import MeasuredGait
from validation.progress import Progress
from validation.show.cost_table import cost_table
from validation.store.environment import describe_environment
from validation.store.folders import run_folder
from validation.store.json import write_json
from validation.store.machine import memory_peak
from validation.store.metric_table import metric_table, walk_sentence
from validation.store.record import save_record
from validation.store.saved import DESCRIPTION, digests, load_saved_run
from validation.store.signals import save_signals
from validation.table import Table, Tabled
from validation.trial.files import RunFile
from validation.trial.plan import PlannedWalk
from validation.trial.record import SimulationRecord


@dataclass(frozen=True)
class Trial(Tabled):
    """One walk, judged."""

    planned: PlannedWalk  # request, plan and body
    comparison: Comparison  # of measurement and plan
    values: Mapping[str, float]  # by metric of this walk, judged or not, in SI units
    profile: Profile  # tolerances
    seconds: Mapping[str, float]  # wall-clock time of `simulation`, `measurement` and `planning`
    extra: Mapping[str, Any]  # entries of the summary beside the usual ones, such as a controller's name
    uncertainty: Uncertainty | None = None  # of the metrics, from a convergence study
    log: LogFacts | None = None  # of which log it is, if it is no walk

    def __repr__(self) -> str:
        """Gait, steps, outcome and verdict."""
        return f"Trial({self.planned.name}, {self.record.outcome.summary}, {self.verdict.name})"

    def __str__(self) -> str:
        """The sentence, and what is out of tolerance."""
        return "\n".join([self.sentence, *(f"  {one.label}: {one.against}" for one in self.verdict.failed)])

    @cached_property
    def verdict(self) -> Verdict:
        """By the profile; ``verdict.passed``: every tolerance is met."""
        scales, ended = self.comparison.scales, self.record.outcome.ending
        return judge(self.values, self.profile, scales, self.uncertainty, ended=ended, log=self.log)

    @property
    def sentence(self) -> str:
        """Gait, steps, outcome, and verdict with its reason."""
        return walk_sentence(self.summary, self.record.outcome)

    def tables(self) -> list[Table]:
        """What was judged; effort and margins."""
        return [self.table(), cost_table(self.summary)]

    @property
    def metrics(self) -> Mapping[str, MetricResult]:
        """Every metric of this walk, judged or not, by name."""
        return {item.name: item for item in self.verdict.metrics}

    @property
    def record(self) -> SimulationRecord:
        """Record of the simulation."""
        return self.comparison.record

    @property
    def plan(self) -> WalkPlan:
        """The plan that was walked."""
        return self.planned.plan

    @property
    def run(self) -> RunParameters:
        """Parameters, with the values that were found."""
        return self.planned.run

    @property
    def measured(self) -> MeasuredGait:
        """Measurement of the record, independent of the plan."""
        return self.comparison.measured

    @property
    def timing(self) -> dict[str, float]:
        """Seconds of every stage, and the closed loop's speed as a multiple of real time, NaN of a log."""
        simulated = float(self.record.time[-1] - self.record.time[0])
        factor = simulated / self.seconds.get("simulation", math.nan)
        return {**self.seconds, "simulated": simulated, "real_time_factor": factor}

    @cached_property
    def summary(self) -> dict[str, Any]:
        """Contents of ``summary.json``, without entries that only a folder has."""
        known = self.uncertainty
        return build_summary(
            self.comparison,
            self.verdict,
            timing=self.timing,
            environment=describe_environment(),
            gait=self.planned.name,
            changed=self.planned.request.changed,
            motion=self.plan.posture.report(),
            memory_peak={"value": memory_peak(), "unit": "MB"},
            **({} if known is None else {"uncertainty": {"gait": known.gait, "steps": known.steps}}),
            **({} if self.log is None else {"log": self.log.as_dict()}),
            **self.extra,
        )

    def table(self) -> Table:
        """Every judged metric with its limit."""
        return metric_table(self.summary)

    def judged(self, profile: Profile | str, uncertainty: Uncertainty | None = None) -> "Trial":
        """The same walk, judged again by a profile, or its name.

        The uncertainty of the metrics is from a convergence study; None keeps what is known. Raises
        :class:`InputError` if there is no such profile.
        """
        return replace(self, profile=find_profile(profile), uncertainty=uncertainty or self.uncertainty)

    def save(self, folder: str | Path, *, force: bool = False, recording: bool = True) -> Path:
        """Keep the trial in a folder, as ``ampm validate`` does, and return the folder.

        ``force`` replaces an earlier run there; ``recording`` writes ``recording.rrd`` and ``report.html``,
        too. Raises :class:`InputError` if the folder must not or cannot be written.
        """
        target = Path(folder)
        with run_folder(target, force=force) as work:
            write_inputs(work, self.planned)
            save_record(self.record, work)
            write_results(work, self)
            if recording:
                draw_run(work)
        return target


def write_inputs(folder: Path, planned: PlannedWalk) -> None:
    """Write parameters, simulated model, description of the body, and environment."""
    (folder / RunFile.RUN).write_text(dump_run(planned.run), encoding="utf-8")
    (folder / RunFile.MODEL).write_text(planned.scene.model.xml, encoding="utf-8")
    (folder / RunFile.BODY).write_bytes(DESCRIPTION.dump_json(planned.body.model.description, indent=1))
    write_json(folder / RunFile.ENVIRONMENT, describe_environment())


def write_results(folder: Path, trial: Trial) -> dict[str, Any]:
    """Write signals and, last, the summary with the digests of all files; return the summary."""
    rows = kept_rows(trial.record.steps, trial.record.time_step)
    save_signals(signals_table(trial.comparison, rows), folder / RunFile.SIGNALS)
    summary = {**trial.summary, "environment": json.loads((folder / RunFile.ENVIRONMENT).read_text())}
    summary["files"] = digests(folder, summary)
    write_json(folder / RunFile.SUMMARY, summary)
    return summary


def draw_run(folder: Path, name: str = "", progress: Progress | None = None) -> None:
    """Write recording and report of a run that was just written into its folder."""
    progress = progress or Progress()
    with progress.stage(f"{name}: recording"):
        # Within the stage: importing the viewer's library takes most of its time.
        from validation.show.rerun.record import write_recording

        saved = load_saved_run(folder, check=False)
        write_recording(saved)
    with progress.stage(f"{name}: report"):
        from validation.show.report import write_report  # draws, which takes long to load

        write_report(saved)
