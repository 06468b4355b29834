"""A measured walk, fitted: constants of the AMPM, what they explain, and a gait that can be walked."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from ampm.exceptions import InputError, MathematicalRefusal
from ampm.parameters import GRAVITY, RunParameters
from ampm.planner.periodic import plan
from ampm.run_file import load_run
from validation.judge.compare import SIGNALS
from validation.judge.fit import CONFIDENCE, Constant, Scores, Strides, constants, cut_strides, scores
from validation.judge.metrics import display_unit
from validation.measure.log import HEIGHTS, read_log
from validation.run.judge_log import log_columns
from validation.show.fit import LOOKS, fit_page
from validation.store.folders import check_target
from validation.store.json import write_json
from validation.table import ABSENT, Table, Tabled, format_number, short_unit, with_uncertainty

_FILES = ("fit.json", "gait.toml", "report.html")
_STATURE = 1.70 / 0.865  # stature of the human body over the height of its COM [1]
_LONGEST = 1.5  # step, in heights of the COM: both feet stand at its ends
_LIGHTEST = 15.0  # mass over the cube of H [kg/m^3]: people have 90, robots 60 to 300


@dataclass(frozen=True)
class Fit(Tabled):
    """Constants of the AMPM of a measured walk, and how much of the walk they explain."""

    name: str  # of the log
    strides: Strides = field(repr=False)
    constants: Mapping[str, Constant]  # see :func:`validation.judge.fit.constants`
    scores: Scores = field(repr=False)  # of the models, see :func:`validation.judge.fit.scores`
    gait: RunParameters | None = field(repr=False)  # with these constants, None if there is no such gait
    notes: Sequence[str]  # sentences on log and gait

    @property
    def sentence(self) -> str:
        """What the models explain over whole strides."""

        def share(signal: str, model: str) -> str:
            found = 100.0 * self.scores[signal][model]["stride"]["share"]
            return ABSENT if math.isnan(found) else f"{max(0.0, found):.0f} %"

        def momentum(about: str) -> str:
            found = share(f"angular_momentum_{about}", "ampm")
            return f"L_{about} rests" if found == ABSENT else f"{found} of L_{about}"

        return " ".join(
            f"Along {axis} a rolling ZMP explains {share(f'zmp_{axis}', 'rolling')} of the ZMP and "
            f"{share(f'force_{axis}', 'rolling')} of the force; with angular momentum it is "
            f"{share(f'zmp_{axis}', 'ampm')} and {share(f'force_{axis}', 'ampm')}, and {momentum(about)}."
            for axis, about in ("xy", "yx")
        )

    def tables(self) -> Sequence[Table]:
        """Constants, and what the models explain."""
        rows = [
            [name, with_uncertainty(item.value, item.interval), item.unit, item.meaning]
            for name, item in self.constants.items()
        ]
        shares = []
        for name, models in self.scores.items():
            signal = SIGNALS[name]
            factor, unit = display_unit(signal.unit, self.strides.weight)
            for support in models["ampm"]:
                cells = []
                for model in LOOKS:
                    share, rmse = models[model][support].values()
                    percent = format_number(round(100.0 * share, 1) + 0.0)
                    cells += ["< 0" if share < -0.0005 else percent, format_number(factor * rmse, 3)]
                shares.append([signal.label, support, *cells, short_unit(unit)])
        heads = [head for name, _ in LOOKS.values() for head in (f">{name}: %", ">RMSE")]
        note = "%: share of the variance; a dash: the signal rests. The vertical force is the weight in all."
        columns = ["constant", f">value, {100.0 * CONFIDENCE:.0f} % interval", "unit", "meaning"]
        return [
            Table("Constants", columns, rows, self.notes),
            Table("Explained, of strides not fitted", ["signal", "of", *heads, "unit"], shares, [note]),
        ]

    def as_dict(self) -> dict[str, Any]:
        """Contents of ``fit.json``, in SI units."""
        return {
            "log": self.name,
            "sentence": self.sentence,
            "strides": len(self.strides),
            "weight": self.strides.weight,
            "constants": {name: item._asdict() for name, item in self.constants.items()},
            "explained": self.scores,
            "gait": None if self.gait is None else self.gait.model_dump(include={"gait", "body"}),
            "notes": list(self.notes),
        }

    def save(self, directory: str | Path, *, force: bool = False) -> Path:
        """Write ``fit.json``, ``report.html``, and ``gait.toml`` if there is a gait.

        Raises :class:`InputError` if the folder must not be written.
        """
        target = Path(directory)
        check_target(target, _FILES, force=force, what="fit", marks=("fit.json",))
        (target / "gait.toml").unlink(missing_ok=True)  # of an earlier fit
        write_json(target / "fit.json", self.as_dict())
        if self.gait is not None:
            given = self.gait.model_dump(exclude_unset=True)  # the search finds the others
            (target / "gait.toml").write_text(tomli_w.dumps(given), encoding="utf-8")
        page = fit_page(self.name, self.sentence, self.strides, self.tables())
        (target / "report.html").write_text(page, encoding="utf-8")
        return target


def fit_log(
    table: str | Path | Mapping[str, Any],
    *,
    columns: Mapping[str, str] | None = None,
    mass: float | None = None,
    com_height: float | None = None,
) -> Fit:
    """Find the constants of the AMPM in a measured walk along x, and what they explain.

    Args:
        table: CSV or Parquet file, columns by name (:mod:`validation.measure.log`), or the folder of a run.
        columns: sources of columns that have other names or units, as for :func:`validation.judge_log`.
        mass: of the body [kg]; that of the mean vertical force if None.
        com_height: mean height of the COM over the floor [m], of a log without COM.

    Raises:
        InputError: the log cannot be read, contradicts itself, or has too few strides that are alike.
    """
    for what, value, limit in (("mass", mass, 1e4), ("com_height", com_height, HEIGHTS[1])):
        if value is not None and not 0.0 < value <= limit:
            raise InputError(f"{what} = {value:g} must be greater than 0 and at most {limit:g} in SI units.")
    signals, name = log_columns(table, columns)
    log = read_log(signals, None if mass is None else mass * GRAVITY, name)
    strides, others = cut_strides(log, com_height, weighed=mass is not None)
    found, weighs = constants(strides), strides.weight / GRAVITY
    height = found["com_height"].value
    if mass is None and weighs < _LIGHTEST * height**3:
        raise InputError(
            f"{name}: by its mean vertical force of {strides.weight:.3g} N the body has {weighs:.3g} kg, and "
            f"its COM is at {height:.2f} m; give forces in newtons (--columns force_z=COLUMN[kgf]), lengths "
            "in metres, or the mass (--mass)."
        )
    if (step := found["step_length"].value) > _LONGEST * height:
        raise InputError(
            f"{name}: steps of {step:.3g} m are longer than {_LONGEST:g} times the height of the COM, "
            f"{height:.3g} m; give lengths in metres, and belt_speed in m/s."
        )
    if com_height and found["c_single_x"].value < found["inverse_a_single_x"].value:
        raise InputError(
            f"{name}: by the force along x the COM is pulled back to the standing foot; correct the sign of "
            "force_x (--columns force_x=-COLUMN), or give the COM."
        )
    upward = 100.0 * strides.upward / strides.weight
    error = 1e3 * float(np.sqrt(np.mean(strides.com_error**2)))
    notes = [
        f"{name}: {len(strides)} strides alike, {others} others left out.",
        f"The body has {weighs:.4g} kg; the mean vertical force of a stride is {upward.min():.1f} % to "
        f"{upward.max():.1f} % of its weight.",
        "The COM is the double integral of the force, in strides that are taken to be periodic."
        if com_height
        else f"The double integral of the force is {error:.2g} mm from the measured COM (RMS).",
    ]
    gait, why = _gait(found, weighs)
    notes = [note for note in (*notes, log.unsupported, *why) if note]
    return Fit(name, strides, found, scores(strides), gait, notes)


def _gait(found: Mapping[str, Constant], mass: float) -> tuple[RunParameters | None, list[str]]:
    """The periodic gait of some constants, for a human body of this size; without one, why."""
    names = ("com_height", "step_length", "switching_velocity", "single_support_ratio", "step_width")
    gait = {name: found[name].value for name in names}
    slope = found["inverse_a_single_x"].value
    gait |= {"a_s": 1.0 / slope if slope > 0.0 else math.inf}
    gait |= {"c_s": found["c_single_x"].value, "c_y": found["c_single_y"].value}
    try:
        run = load_run(gait=gait, body={"mass": mass, "height": _STATURE * gait["com_height"]})
        constants = plan(run).constants
    except (InputError, MathematicalRefusal) as error:
        return None, [f"There is no periodic gait with these constants: {error}"]
    single, double = constants.single_support_duration, constants.double_support_duration
    return run, [
        f"The gait has a single support of {single:.3f} s (measured {found['single_support'].value:.3f} s) "
        f"and a double support of {double:.3f} s (measured {found['double_support'].value:.3f} s)."
    ]
