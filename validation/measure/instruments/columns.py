"""Observations of walks in memory and of run folders, and their numbers as columns of tables."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from ampm.exceptions import InputError
from ampm.run_file import load_run
from validation.measure.instruments.model import Instrument, load_instrument
from validation.measure.instruments.names import INSTRUMENT_COLUMNS, RUN, STATISTICS
from validation.measure.instruments.result import Observation, observe, run_key

if TYPE_CHECKING:
    from pathlib import Path

    import mujoco
    from numpy.typing import NDArray

    from ampm.description import BodyDescription
    from validation.trial.plan import PlannedWalk
    from validation.trial.record import SimulationRecord


def instrument_columns(planned: PlannedWalk, record: SimulationRecord, name: str) -> dict[str, float | None]:
    """Columns of one walk in memory.

    Args:
        planned: what was walked.
        record: of the simulation.
        name: preset or TOML file of the instrument.

    Returns:
        A value for every one of :data:`INSTRUMENT_COLUMNS`; None where there is no value.

    Raises:
        InputError: no such instrument.
    """
    return columns_of(observe_walk(_loaded(name), planned, record))


def observe_walk(instrument: Instrument, planned: PlannedWalk, record: SimulationRecord) -> Observation:
    """Observe a walk in memory with an instrument; of ``planned`` only body and parameters are used."""
    model = planned.body.model
    key = run_key(planned.request.run)
    return observe(instrument, record, key, lambda: (model.compile(), model.description))


def observe_folder(directory: Path, instrument: Instrument) -> Observation:
    """Observe a finished run, from its folder alone.

    Raises:
        InputError: the folder is no run folder, or lacks what the instrument needs.
    """
    missing = [name for name in ("run.toml", "model.xml") if not (directory / name).is_file()]
    if missing:
        raise InputError(f"{directory} has no {missing[0]}; give the folder of a finished run.")
    run = load_run(directory / "run.toml", ())

    # Here, not above: simulator and body take long to load.
    import mujoco

    from models.human import build
    from validation.store.record import load_record

    def body() -> tuple[mujoco.MjModel, BodyDescription]:
        xml = (directory / "model.xml").read_text(encoding="utf-8")
        return mujoco.MjModel.from_xml_string(xml), build(run.body, run.contact, run.simulation).description

    return observe(instrument, load_record(directory), run_key(run), body)


def observation_columns(observation: Observation) -> dict[str, NDArray[Any]]:
    """Columns of ``instrument.parquet``: truth and what the instrument shows, at every step, SI units."""
    columns: dict[str, NDArray[Any]] = {"time": observation.time}
    for name, values in (
        ("true_zmp", observation.true_zmp),
        ("instrument_zmp", observation.zmp),
        ("instrument_zmp_compensated", observation.zmp_compensated),
        ("instrument_force", observation.force),
    ):
        for index, axis in enumerate("xyz"[: values.shape[1]]):
            columns[f"{name}_{axis}"] = values[:, index]
    for index, name in enumerate(observation.names):
        columns[f"true_{name}"] = observation.signals[:, index]
        columns[f"reading_{name}"] = observation.readings[:, index]
    return columns


def columns_of(observation: Observation) -> dict[str, float | None]:
    """Columns of an observation."""
    row: dict[str, float | None] = dict.fromkeys(INSTRUMENT_COLUMNS)
    error, late = observation.errors[RUN], observation.errors_compensated[RUN]
    for index, axis in enumerate("xy"):
        for figure in STATISTICS:
            row[f"instrument_zmp_{axis}_{figure}"] = _finite(getattr(error, figure)[index])
            row[f"instrument_zmp_compensated_{axis}_{figure}"] = _finite(getattr(late, figure)[index])
        for cause, windows in observation.causes.items():
            row[f"instrument_zmp_{cause}_{axis}_rmse"] = _finite(windows[RUN].rmse[index])
    row["instrument_latency"] = observation.latency
    instants = error.count + error.unmeasured
    row["instrument_unmeasured"] = error.unmeasured / instants if instants else None
    return row


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


@lru_cache(maxsize=8)
def _loaded(name: str) -> Instrument:
    return load_instrument(name)
