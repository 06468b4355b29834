"""Readings of an instrument on a walk beside the true values, and the error by each of its faults."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ampm.brief import Brief
from ampm.description import BodyDescription
from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.run_file import load_run
from validation.measure.instruments.chain import BIAS, FILTER
from validation.measure.instruments.model import Instrument, load_instrument
from validation.measure.instruments.names import CAUSES, INSTRUMENT_COLUMNS, METHOD, RUN, STATISTICS, WINDOWS
from validation.measure.instruments.rigs import RIGS, Rig, usable_rows
from validation.store.identity import parameter_values, run_key
from validation.store.record import load_record
from validation.store.saved import BODY_FILE, SUMMARY_FILE, check_files, load_description
from validation.trial.plan import PlannedWalk
from validation.trial.record import SimulationRecord

Windows = Mapping[str, "ErrorStatistics"]
Body = Callable[[], tuple[mujoco.MjModel, BodyDescription]]


@dataclass(frozen=True)
class ErrorStatistics:
    """Error of a ZMP in one window, x and y [m]; NaN where nothing was measured.

    Attributes:
        count: instants that have both ZMPs.
        unmeasured: instants with a true ZMP at which the instrument shows none.
        rmse, maximum, bias: root mean square, largest absolute, mean.
    """

    count: int
    unmeasured: int
    rmse: tuple[float, float]
    maximum: tuple[float, float]
    bias: tuple[float, float]


@dataclass(frozen=True)
class Observation(Brief):
    """Readings of an instrument on a walk, row k for the start of step k; K rows, world frame, SI units.

    Attributes:
        instrument: its specifications.
        key: of the run; with the instrument's seed it fixes all draws.
        time: t_k, shape (K,) [s].
        names, units: of the channels.
        signals: readings of ideal channels, shape (K, C).
        readings: of the channels, shape (K, C).
        true_zmp: shape (K, 2) [m].
        zmp: by the instrument, shape (K, 2) [m]; NaN where it detects no contact.
        zmp_compensated: the same from readings shifted back by ``latency``, shape (K, 2) [m].
        force: net ground force by the instrument, shape (K, 3) [N].
        latency: mean age of a reading of slow signals [s].
        drawn: constants that were drawn, by channel or name.
        errors: window to the error that the instrument adds.
        errors_compensated: the same with the latency taken out.
        errors_of_readings: window to the error beyond that of the method, which ideal readings have too.
        causes: cause to window to the error that it makes alone.
        notes: effects that could not be modelled.
    """

    instrument: Instrument
    key: str
    time: Array
    names: tuple[str, ...]
    units: tuple[str, ...]
    signals: Array
    readings: Array
    true_zmp: Array
    zmp: Array
    zmp_compensated: Array
    force: Array
    latency: float
    drawn: Mapping[str, float]
    errors: Windows
    errors_compensated: Windows
    errors_of_readings: Windows
    causes: Mapping[str, Windows]
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON; lengths in m, two numbers are x and y."""
        channels = {}
        for name, unit, error in zip(self.names, self.units, (self.readings - self.signals).T, strict=True):
            statistics = _statistics(error[:, None])
            channels[name] = {"unit": unit, **{key: value for key, (value,) in statistics.items()}}
        return {
            "name": self.instrument.name,
            "kind": self.instrument.kind,
            "seed": self.instrument.seed,
            "run_key": self.key,
            "figures": self.instrument.model_dump(),
            "unit": "m",
            "zmp_error": _plain(self.errors),
            "zmp_error_delay_compensated": _plain(self.errors_compensated),
            "zmp_error_of_readings": _plain(self.errors_of_readings),
            "latency": {"value": self.latency, "unit": "s"},
            "causes": {cause: _plain(windows) for cause, windows in self.causes.items()},
            "channels": channels,
            "drawn": dict(self.drawn),
            "notes": list(self.notes),
        }

    def signal_columns(self) -> dict[str, NDArray[Any]]:
        """Columns of ``instrument.parquet``: true values and readings at every step, SI units."""
        columns: dict[str, NDArray[Any]] = {"time": self.time}
        for name, values in (
            ("true_zmp", self.true_zmp),
            ("instrument_zmp", self.zmp),
            ("instrument_zmp_compensated", self.zmp_compensated),
            ("instrument_force", self.force),
        ):
            columns |= {f"{name}_{axis}": column for axis, column in zip("xyz", values.T, strict=False)}
        for name, signal, reading in zip(self.names, self.signals.T, self.readings.T, strict=True):
            columns |= {f"true_{name}": signal, f"reading_{name}": reading}
        return columns

    def row(self) -> dict[str, float | None]:
        """A value for every one of :data:`INSTRUMENT_COLUMNS`; None where there is no value."""
        row: dict[str, float | None] = dict.fromkeys(INSTRUMENT_COLUMNS)
        error, late = self.errors[RUN], self.errors_compensated[RUN]
        for index, axis in enumerate("xy"):
            for figure in STATISTICS:
                row[f"instrument_zmp_{axis}_{figure}"] = getattr(error, figure)[index]
                row[f"instrument_zmp_compensated_{axis}_{figure}"] = getattr(late, figure)[index]
            for cause, windows in self.causes.items():
                row[f"instrument_zmp_{cause}_{axis}_rmse"] = windows[RUN].rmse[index]
        row["instrument_latency"] = self.latency
        instants = error.count + error.unmeasured
        row["instrument_unmeasured"] = error.unmeasured / instants if instants else None
        return {
            name: value if value is not None and math.isfinite(value) else None for name, value in row.items()
        }


def observe_folder(directory: Path | str, instrument: Instrument) -> Observation:
    """Observe a finished run, from its folder alone.

    Raises:
        InputError: the folder is no run folder, has changed, or lacks what the instrument needs.
    """
    directory = Path(directory)
    missing = [name for name in ("run.toml", "model.xml", BODY_FILE) if not (directory / name).is_file()]
    if missing:
        raise InputError(f"{directory} has no {missing[0]}; give the folder of a finished run.")
    if (directory / SUMMARY_FILE).is_file():  # a walk that was broken off has none
        check_files(directory)
    run = load_run(directory / "run.toml", ())

    def body() -> tuple[mujoco.MjModel, BodyDescription]:
        xml = (directory / "model.xml").read_text(encoding="utf-8")
        return mujoco.MjModel.from_xml_string(xml), load_description(directory)

    observed = observe(instrument, load_record(directory), run_key(parameter_values(run)), body)
    if observed is None:
        raise InputError(
            f"the walk of {directory} ended before its second time step; there is nothing to observe."
        )
    return observed


def observe_walk(
    instrument: Instrument, planned: PlannedWalk, record: SimulationRecord
) -> Observation | None:
    """Observe a walk in memory; of ``planned`` only body and parameters are used. See :func:`observe`."""
    model = planned.body.model
    key = run_key(parameter_values(planned.run))
    return observe(instrument, record, key, lambda: (model.compile(), model.description))


def instrument_columns(planned: PlannedWalk, record: SimulationRecord, name: str) -> dict[str, float | None]:
    """A value for every one of :data:`INSTRUMENT_COLUMNS`, of one walk in memory; None where there is none.

    Args:
        planned: what was walked.
        record: of the simulation.
        name: preset or TOML file of the instrument.

    Raises:
        InputError: no such instrument.
    """
    observed = observe_walk(_loaded(name), planned, record)
    return dict.fromkeys(INSTRUMENT_COLUMNS) if observed is None else observed.row()


_loaded = lru_cache(maxsize=8)(load_instrument)


def observe(instrument: Instrument, record: SimulationRecord, key: str, body: Body) -> Observation | None:
    """Apply an instrument to a walk.

    Args:
        instrument: which.
        record: of the walk; the plan is not used.
        key: of the run, see :func:`validation.store.identity.run_key`.
        body: gives the compiled model and its description; called only by instruments that need them.

    Returns:
        None if the walk ended before its second time step: accelerations need two.

    Raises:
        InputError: the record lacks what the instrument needs.
    """
    if usable_rows(record) < 2:
        return None
    rig = RIGS[type(instrument)](instrument, record, key, body)
    chain, effects = rig.chain, rig.effects
    rows = _windows(rig)
    readings = chain.read(rig.signals, effects)
    estimated = rig.estimate(readings, effects)
    latency = chain.latency()
    late = rig.estimate(_set_back(readings, rig.time, latency), effects) if latency > 0.0 else estimated
    ideal = rig.estimate(rig.signals, frozenset()).zmp
    causes = {METHOD: _errors(ideal, rig.zmp, rows)}
    for cause in CAUSES:
        if cause in effects:
            alone = frozenset({cause})
            causes[cause] = _errors(rig.estimate(chain.read(rig.signals, alone), alone).zmp, ideal, rows)
    drawn = dict(rig.drawn)
    if BIAS in effects:
        drawn |= {f"bias_{name}": float(v) for name, v in zip(rig.names, chain.bias(), strict=True)}
    return Observation(
        instrument=instrument,
        key=key,
        time=rig.time,
        names=rig.names,
        units=rig.units,
        signals=rig.signals,
        readings=readings,
        true_zmp=rig.zmp,
        zmp=estimated.zmp,
        zmp_compensated=late.zmp,
        force=estimated.force,
        latency=latency,
        drawn=drawn,
        errors=_errors(estimated.zmp, rig.zmp, rows),
        errors_compensated=_errors(late.zmp, rig.zmp, rows),
        errors_of_readings=_errors(estimated.zmp, ideal, rows),
        causes=causes,
        notes=_notes(rig),
    )


def _windows(rig: Rig) -> dict[str, NDArray[np.bool_]]:
    there = np.isfinite(rig.zmp).all(axis=1)
    feet = rig.contact.sum(axis=1)
    return dict(zip(WINDOWS, (there, there & (feet == 1), there & (feet == 2)), strict=True))


def _errors(zmp: Array, reference: Array, windows: Mapping[str, NDArray[np.bool_]]) -> Windows:
    error = zmp - reference
    fine = np.isfinite(error).all(axis=1)
    found = {}
    for window, rows in windows.items():
        part = error[rows & fine]
        found[window] = ErrorStatistics(len(part), int(rows.sum()) - len(part), **_statistics(part))
    return found


def _statistics(error: Array) -> dict[str, Any]:
    """Root mean square, largest and mean of each column; NaN without rows."""
    if not len(error):
        return dict.fromkeys(("rmse", "maximum", "bias"), (math.nan,) * error.shape[1])
    found = {
        "rmse": np.sqrt(np.mean(error**2, axis=0)),
        "maximum": np.abs(error).max(axis=0),
        "bias": error.mean(axis=0),
    }
    return {name: tuple(values.tolist()) for name, values in found.items()}


def _plain(windows: Windows) -> dict[str, Any]:
    return {window: asdict(item) for window, item in windows.items()}


def _set_back(readings: Array, time: Array, latency: float) -> Array:
    """Readings as of ``latency`` earlier; NaN at the end, where they have not arrived."""
    at = time + latency
    return np.column_stack([np.interp(at, time, column, right=np.nan) for column in readings.T])


def _notes(rig: Rig) -> tuple[str, ...]:
    notes = []
    acquisition, dt = rig.chain.acquisition, rig.record.time_step
    cutoff, rate, steps = acquisition.cutoff, acquisition.rate, f"steps of {1e3 * dt:g} ms"
    if cutoff is not None and FILTER not in rig.effects:
        notes.append(
            f"The low-pass of {cutoff:g} Hz is left out: {steps} show nothing above {0.5 / dt:g} Hz."
        )
    if rate is not None and rate > (1.0 + 1e-9) / dt:
        notes.append(f"Sampling at {rate:g} Hz: between the {steps} samples are interpolated.")
    return tuple(notes)
