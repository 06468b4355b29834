"""A recorded person beside a run: facts of the strides, and differences in the signals that metrics judge."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ampm.brief import Brief
from ampm.exceptions import AmpmError, InputError
from ampm.geometry import Array
from ampm.parameters import GRAVITY
from ampm.planner.periodic import plan_gait
from ampm.run_file import load_run
from validation.judge.compare import SIGNALS, Statistics, statistics
from validation.judge.metrics import METRICS, rms
from validation.judge.profiles import DEFAULT, Profile
from validation.store.saved import load_saved_run
from validation.store.tables import write_columns
from validation.study.people.benchmark import read_benchmark
from validation.study.people.walking import PHASES, Strides, Walking, of_run, of_table
from validation.trial.columns import SUFFIXES, read_columns

PERSON, SIMULATION, PLAN = "person", "simulation", "plan"
PAIRS = ((SIMULATION, PLAN), (PERSON, PLAN), (PERSON, SIMULATION))
_FOOT_FORCES = tuple(f"left_force_{axis}" for axis in "xyz")
_COMPARED = (*(name for name in SIGNALS if "foot" not in name), *_FOOT_FORCES)
_ALIKE = 0.02  # share by which speed and step of person and run may differ without a note [1]


@dataclass(frozen=True)
class Difference:
    """Difference of the mean strides of two walks in one signal.

    Attributes:
        signal: its name, as in :data:`validation.judge.compare.SIGNALS`, or ``left_force_x`` ...
        unit: SI unit.
        of, against: the walks: ``person``, ``simulation``, ``plan``.
        statistics: of the first less the second. Forces and momenta of a person are scaled by the weights.
        at: instant of the largest, as share of the stride; it begins when the left foot takes half of the
            weight [1].
        rmse_limit, maximum_limit: of the profile, for the body of the run; None if it has none.
    """

    signal: str
    unit: str
    of: str
    against: str
    statistics: Statistics
    at: float
    rmse_limit: float | None
    maximum_limit: float | None

    @property
    def within(self) -> bool | None:
        """Whether all limits are kept; None if there is none."""
        pairs = (self.statistics.rmse, self.rmse_limit), (self.statistics.maximum, self.maximum_limit)
        judged = [value <= limit for value, limit in pairs if limit is not None]
        return all(judged) if judged else None


@dataclass(frozen=True)
class People(Brief):
    """A recorded person, and the run beside.

    Attributes:
        name: of the recording.
        beside: name of the run; empty without one.
        profile: name of the tolerances.
        strides: walk to its strides: ``person``, and ``simulation`` and ``plan`` of the run.
        curves: walk to its mean strides by name of the signal, shape (PHASES,) each; the COM by the force
            where none was recorded.
        facts: quantity to unit, and to walk to value.
        differences: of all :data:`PAIRS`.
        notes: what to know, one sentence each.
    """

    name: str
    beside: str
    profile: str
    strides: Mapping[str, Strides]
    curves: Mapping[str, Mapping[str, Array]]
    facts: Mapping[str, tuple[str, Mapping[str, float]]]
    differences: tuple[Difference, ...]
    notes: tuple[str, ...]

    @property
    def weight(self) -> float:
        """Body weight of the run, or of the person without one [N]."""
        return self.strides.get(PLAN, self.strides[PERSON]).weight

    def kept(self, of: str, against: str) -> tuple[int, int]:
        """How many signals keep the limits, and how many have limits."""
        judged = [item.within for item in self.differences if (item.of, item.against) == (of, against)]
        known = [item for item in judged if item is not None]
        return sum(known), len(known)

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {
            "name": self.name,
            "beside": self.beside,
            "profile": self.profile,
            "facts": {name: {"unit": unit, **values} for name, (unit, values) in self.facts.items()},
            "differences": [{**asdict(item), "within": item.within} for item in self.differences],
            "notes": self.notes,
        }


def people(file: str | Path, beside: str | Path | None = None, *, profile: Profile = DEFAULT) -> People:
    """Compare a recorded person with a run.

    Args:
        file: table of a recording (CSV or Parquet, see :mod:`validation.study.people.walking`), or a JSON
            file of the benchmark of :mod:`validation.study.people.benchmark`.
        beside: folder of a run; without one only facts of the person are found.
        profile: whose limits are shown beside the differences.

    Raises:
        InputError: the file or the folder cannot be read, or holds no whole stride.
    """
    path = Path(file)
    walks: dict[str, Walking] = {PERSON: of_table(read_recording(path), path.name)}
    foot = math.nan
    if beside is not None:
        saved = load_saved_run(beside)
        by_foot = "left_force_z" in walks[PERSON].signals
        walks[SIMULATION], walks[PLAN] = of_run(saved, by_foot=by_foot)
        foot = saved.body.sole.length
    strides = {name: walk.strides for name, walk in walks.items()}
    curves = {name: _curves(found) for name, found in strides.items()}
    differences = tuple(_differences(strides, curves, profile, foot)) if beside is not None else ()
    notes = _notes(strides[PERSON], strides.get(SIMULATION))
    name = "" if beside is None else str(beside)
    facts = _facts(strides, curves)
    return People(path.name, name, profile.name, strides, curves, facts, differences, notes)


def read_recording(path: Path) -> dict[str, Array]:
    """Columns of a recording.

    Raises:
        InputError: it cannot be read.
    """
    if path.suffix == ".json":
        return read_benchmark(path)
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path} must end in .csv, .parquet or .json (a file of the benchmark).")
    if not path.is_file():
        raise InputError(f"there is no file {str(path)!r}; correct the name.")
    return read_columns(path)


def convert(source: Path, target: Path) -> None:
    """Write a recording as a table of our columns.

    Raises:
        InputError: the source cannot be read, or the target is no CSV or Parquet file.
    """
    write_columns(read_recording(source), target)


def _curves(strides: Strides) -> dict[str, Array]:
    """Mean strides by name; the COM by the force where none was recorded."""
    found = {name: strides.mean(name) for name in strides.curves}
    return strides.com_by_force() | found


def _differences(
    strides: Mapping[str, Strides], curves: Mapping[str, Mapping[str, Array]], profile: Profile, foot: float
) -> Iterator[Difference]:
    weight = strides[PLAN].weight
    scales = {"body_weight": weight, "foot_length": foot}
    for of, against in PAIRS:
        for name in _COMPARED:
            if name not in curves[of] or name not in curves[against]:
                continue
            unit = SIGNALS[name].unit if name in SIGNALS else "N"
            factors = {who: 1.0 if unit == "m" else weight / strides[who].weight for who in (of, against)}
            reference = factors[against] * curves[against][name]
            error = factors[of] * curves[of][name] - reference
            found = statistics(error, reference, weight if unit == "N" else 1.0, unit)
            if not math.isfinite(found.rmse):
                continue
            limits = [_limit(f"{name}_{kind}", profile, scales) for kind in ("rmse", "maximum")]
            at = float(np.nanargmax(np.abs(error))) / PHASES
            yield Difference(name, unit, of, against, found, at, *limits)


def _limit(metric: str, profile: Profile, scales: Mapping[str, float]) -> float | None:
    tolerance = profile.tolerance(METRICS[metric]) if metric in METRICS else None
    return None if tolerance is None else float(tolerance.limit_for(scales))


def _facts(
    strides: Mapping[str, Strides], curves: Mapping[str, Mapping[str, Array]]
) -> dict[str, tuple[str, Mapping[str, float]]]:
    """Quantities of every walk, NaN where not known."""
    found: dict[str, tuple[str, dict[str, float]]] = {}

    def add(label: str, unit: str, value: Callable[[Strides, Mapping[str, Array]], float]) -> None:
        found[label] = unit, {who: value(strides[who], curves[who]) for who in strides}

    add("mass", "kg", lambda of, _: of.weight / GRAVITY)
    add("strides", "1", lambda of, _: float(of.count))
    add("time of a stride", "s", lambda of, _: of.duration)
    add("mean speed", "m/s", lambda of, _: of.speed)
    add("length of a step", "m", lambda of, _: 0.5 * of.speed * of.duration)
    add("time on both feet", "1", lambda of, _: of.both)
    for label, name in (
        ("COM, forward about its mean way", "com_x"),
        ("COM, sideways", "com_y"),
        ("COM, vertical", "com_z"),
        ("ZMP, sideways", "zmp_y"),
    ):
        add(f"range of the {label}", "m", partial(_range, name=name))
    add("largest vertical force", "body weight", lambda of, of_curves: of_curves["force_z"].max() / of.weight)
    add("least vertical force", "body weight", lambda of, of_curves: of_curves["force_z"].min() / of.weight)
    add("mean forward force", "body weight", lambda of, of_curves: of_curves["force_x"].mean() / of.weight)
    person = strides[PERSON]
    if "com_x" in person.curves:
        by_force = person.com_by_force()
        for axis in "xyz":
            off = person.mean(f"com_{axis}") - by_force[f"com_{axis}"]
            found[f"COM by markers less by force, {axis}, RMS"] = "m", {PERSON: rms(off)}
    return {
        label: (unit, {who: float(v) for who, v in values.items()}) for label, (unit, values) in found.items()
    }


def _range(_: Strides, curves: Mapping[str, Array], name: str) -> float:
    values = curves[name][np.isfinite(curves[name])] if name in curves else np.zeros(0)
    return float(np.ptp(values)) if values.size else math.nan


def _notes(person: Strides, run: Strides | None) -> tuple[str, ...]:
    """What the comparison leaves out, and how to walk as the person does."""
    notes = []
    if "zmp_x" not in person.curves:
        notes.append("The recording has no centre of pressure: the ZMP is not compared.")
    if "com_x" not in person.curves:
        notes.append("The recording has no COM: it is that of the force, integrated twice.")
    if not math.isfinite(person.speed):
        return (*notes, "The recording has neither place nor belt_speed: its speed is not known.")
    pairs = () if run is None else ((person.speed, run.speed), (person.duration, run.duration))
    if run is None or any(abs(a - b) > _ALIKE * abs(b) for a, b in pairs):
        notes.append(matching_gait(person))
    return tuple(notes)


def matching_gait(person: Strides) -> str:
    """How to walk with the steps, the speed and the mass of a person, as one sentence."""
    step, mass = 0.5 * person.speed * person.duration, person.weight / GRAVITY
    normal = load_run("normal").gait

    def speed(v0: float) -> float:
        gait = normal.model_copy(update={"step_length": step, "switching_velocity": v0, "steps": 2})
        try:
            return plan_gait(gait, mass).constants.mean_velocity
        except AmpmError:
            return 0.0  # too slow to pass over the foot

    low, high = person.speed, 3.0 * person.speed
    if not speed(high) > person.speed > 0.0:
        return f"The plan has no gait of {person.speed:.3g} m/s with steps of {step:.3g} m."
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if speed(middle) < person.speed else (low, middle)
    if speed(high) > (1.0 + _ALIKE) * person.speed:
        return (
            f"The slowest gait of the plan with steps of {step:.3g} m has {speed(high):.3g} m/s, the person "
            f"{person.speed:.3g} m/s."
        )
    settings = (
        f"gait.step_length={step:.4g}",
        f"gait.switching_velocity={high:.4g}",
        f"body.mass={mass:.4g}",
    )
    return f"With the person's steps, speed and mass: ampm validate normal --set {' --set '.join(settings)}"
