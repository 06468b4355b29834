"""An instrument's figures as columns of a sweep's table."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

from validation.measure.instruments.model import Instrument, load_instrument
from validation.measure.instruments.names import FIGURES, INSTRUMENT_COLUMNS, RUN
from validation.measure.instruments.result import Observation, observe, run_key

if TYPE_CHECKING:
    from validation.judge.examine import Walk
    from validation.trial.plan import PlannedWalk
    from validation.trial.record import SimulationRecord


def instrument_columns(walk: Walk, name: str) -> dict[str, float | None]:
    """Columns of one walk in memory.

    Args:
        walk: see :func:`validation.judge.examine.walk`.
        name: preset or TOML file of the instrument.

    Returns:
        A value for every one of :data:`INSTRUMENT_COLUMNS`; None where there is nothing to tell.

    Raises:
        InputError: no such instrument.
    """
    return columns_of(observe_walk(_loaded(name), walk.planned, walk.record))


def observe_walk(instrument: Instrument, planned: PlannedWalk, record: SimulationRecord) -> Observation:
    """Look at a walk in memory with an instrument; of ``planned`` only body and parameters are used."""
    model = planned.body.model
    key = run_key(planned.request.run)
    return observe(instrument, record, key, lambda: (model.compile(), model.description))


def columns_of(seen: Observation) -> dict[str, float | None]:
    """Columns of an observation."""
    row: dict[str, float | None] = dict.fromkeys(INSTRUMENT_COLUMNS)
    error, late = seen.errors[RUN], seen.errors_compensated[RUN]
    for index, axis in enumerate("xy"):
        for figure in FIGURES:
            row[f"instrument_zmp_{axis}_{figure}"] = _finite(getattr(error, figure)[index])
            row[f"instrument_zmp_compensated_{axis}_{figure}"] = _finite(getattr(late, figure)[index])
        for cause, windows in seen.causes.items():
            row[f"instrument_zmp_{cause}_{axis}_rmse"] = _finite(windows[RUN].rmse[index])
    row["instrument_latency"] = seen.latency
    instants = error.count + error.unmeasured
    row["instrument_unmeasured"] = error.unmeasured / instants if instants else None
    return row


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


@lru_cache(maxsize=8)
def _loaded(name: str) -> Instrument:
    return load_instrument(name)
