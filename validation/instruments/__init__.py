"""What real instruments would show of a walk: force plate, foot force/torque sensor, IMU."""

from validation.instruments.columns import INSTRUMENT_COLUMNS, instrument_columns, observe_walk
from validation.instruments.model import PRESETS, Instrument, load_instrument, make_instrument
from validation.instruments.result import CAUSES, Figures, Observation, observe, run_key

__all__ = [
    "CAUSES",
    "INSTRUMENT_COLUMNS",
    "PRESETS",
    "Figures",
    "Instrument",
    "Observation",
    "instrument_columns",
    "load_instrument",
    "make_instrument",
    "observe",
    "observe_walk",
    "run_key",
]
