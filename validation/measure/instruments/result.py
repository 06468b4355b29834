"""An instrument's view of a walk beside the truth, and which of its faults does how much."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Set
from dataclasses import asdict, dataclass
from functools import cached_property
from hashlib import sha256
from typing import TYPE_CHECKING, Any

import numpy as np

from ampm.parameters import RunParameters
from ampm.run_file import dump_run
from validation.measure.instruments.chain import BIAS, FILTER
from validation.measure.instruments.model import Instrument
from validation.measure.instruments.names import CAUSES, METHOD, RUN, WINDOWS
from validation.measure.instruments.rigs import Rig, make_rig

if TYPE_CHECKING:
    import mujoco
    from numpy.typing import NDArray

    from ampm.description import BodyDescription
    from validation.trial.record import SimulationRecord

    Array = NDArray[np.float64]
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
class Observation:
    """Readings of an instrument on a walk, row k for the start of step k; K rows, world frame, SI units.

    Attributes:
        instrument: its figures.
        key: of the run; with the instrument's seed it fixes all draws.
        time: t_k, shape (K,) [s].
        names, units: of the channels.
        signals: what faultless channels read, shape (K, C).
        readings: what the channels read, shape (K, C).
        true_zmp: shape (K, 2) [m].
        zmp: as the instrument shows it, shape (K, 2) [m]; NaN where it sees no contact.
        zmp_compensated: the same from readings set back by ``latency``, shape (K, 2) [m].
        force: net ground force as it shows it, shape (K, 3) [N].
        latency: mean age of a reading of slow signals [s].
        drawn: constants that were drawn, by channel or name.
        errors: window to the error that the instrument adds.
        errors_compensated: the same with the latency taken out.
        errors_of_readings: window to the error beyond that of the method, which faultless readings have too.
        causes: cause to window to the error that it makes alone.
        notes: what could not be shown, in words.
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
    errors: Mapping[str, ErrorStatistics]
    errors_compensated: Mapping[str, ErrorStatistics]
    errors_of_readings: Mapping[str, ErrorStatistics]
    causes: Mapping[str, Mapping[str, ErrorStatistics]]
    notes: tuple[str, ...]

    @cached_property
    def channels(self) -> dict[str, dict[str, Any]]:
        """Error of every channel: unit, RMSE, largest, mean."""
        error = self.readings - self.signals
        return {
            name: {"unit": unit, **{k: v for k, (v,) in _statistics(error[:, index : index + 1]).items()}}
            for index, (name, unit) in enumerate(zip(self.names, self.units, strict=True))
        }

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON; lengths in m, two numbers are x and y."""
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
            "channels": self.channels,
            "drawn": dict(self.drawn),
            "notes": list(self.notes),
        }


def run_key(run: RunParameters) -> str:
    """Identity of a run for an instrument's draws: a hash of its complete parameters."""
    return sha256(dump_run(run).encode()).hexdigest()[:16]


def observe(instrument: Instrument, record: SimulationRecord, key: str, body: Body) -> Observation:
    """Look at a walk with an instrument.

    Args:
        instrument: which.
        record: of the walk; nothing else is used, least of all the plan.
        key: of the run, see :func:`run_key`.
        body: gives the compiled model and its description; called only by instruments that need them.

    Raises:
        InputError: the record lacks what the instrument needs.
    """
    rig = make_rig(instrument, record, key, body)
    truth, chain = rig.truth, rig.chain
    effects = frozenset(rig.effects())
    rows = _windows(truth.foot_contact, truth.zmp)
    readings = chain.read(rig.signals, effects)
    estimated = rig.estimate(readings, effects)
    latency = chain.latency()
    late = rig.estimate(_set_back(readings, truth.time, latency), effects) if latency > 0.0 else estimated
    ideal = rig.estimate(rig.signals, frozenset()).zmp
    causes = {METHOD: _errors(ideal, truth.zmp, rows)}
    for cause in CAUSES:
        if cause in effects:
            alone = frozenset({cause})
            causes[cause] = _errors(rig.estimate(chain.read(rig.signals, alone), alone).zmp, ideal, rows)
    return Observation(
        instrument=instrument,
        key=key,
        time=truth.time,
        names=rig.names,
        units=rig.units,
        signals=rig.signals,
        readings=readings,
        true_zmp=truth.zmp,
        zmp=estimated.zmp,
        zmp_compensated=late.zmp,
        force=estimated.force,
        latency=latency,
        drawn=_drawn(rig, effects),
        errors=_errors(estimated.zmp, truth.zmp, rows),
        errors_compensated=_errors(late.zmp, truth.zmp, rows),
        errors_of_readings=_errors(estimated.zmp, ideal, rows),
        causes=causes,
        notes=_notes(rig, instrument, effects),
    )


def _windows(contact: NDArray[np.bool_], zmp: Array) -> dict[str, NDArray[np.bool_]]:
    there = np.isfinite(zmp).all(axis=1)
    feet = contact.sum(axis=1)
    return {RUN: there, WINDOWS[1]: there & (feet == 1), WINDOWS[2]: there & (feet == 2)}


def _errors(
    zmp: Array, reference: Array, windows: Mapping[str, NDArray[np.bool_]]
) -> dict[str, ErrorStatistics]:
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


def _plain(windows: Mapping[str, ErrorStatistics]) -> dict[str, Any]:
    return {window: asdict(item) for window, item in windows.items()}


def _set_back(readings: Array, time: Array, latency: float) -> Array:
    """Readings as of ``latency`` earlier; NaN at the end, where they have not arrived."""
    at = time + latency
    moved = np.column_stack([np.interp(at, time, column) for column in readings.T])
    if len(time):
        moved[at > time[-1]] = np.nan
    return moved


def _drawn(rig: Rig, effects: Set[str]) -> dict[str, float]:
    drawn = dict(rig.drawn)
    if BIAS in effects:
        drawn |= {f"bias_{n}": float(v) for n, v in zip(rig.names, rig.chain.bias(), strict=True)}
    return drawn


def _notes(rig: Rig, instrument: Instrument, effects: Set[str]) -> tuple[str, ...]:
    notes = []
    cutoff, rate, dt = instrument.acquisition.cutoff, instrument.acquisition.rate, rig.truth.time_step
    steps = f"steps of {1e3 * dt:g} ms"
    if cutoff is not None and FILTER not in effects:
        notes.append(
            f"The low-pass of {cutoff:g} Hz is left out: {steps} show nothing above {0.5 / dt:g} Hz."
        )
    if rate is not None and rate > (1.0 + 1e-9) / dt:
        notes.append(f"Sampling at {rate:g} Hz: between the {steps} samples are interpolated.")
    return tuple(notes)
