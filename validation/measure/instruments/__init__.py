"""What real instruments would show of a walk: force plate, foot force/torque sensor, IMU.

Names are imported as they are used: who asks for no instrument does not pay for one.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from validation.measure.instruments.columns import instrument_columns, observe_walk
    from validation.measure.instruments.model import PRESETS, Instrument, load_instrument, make_instrument
    from validation.measure.instruments.names import CAUSES, INSTRUMENT_COLUMNS
    from validation.measure.instruments.result import Figures, Observation, observe, run_key

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

_HOMES = {
    "columns": ("instrument_columns", "observe_walk"),
    "model": ("PRESETS", "Instrument", "load_instrument", "make_instrument"),
    "names": ("CAUSES", "INSTRUMENT_COLUMNS"),
    "result": ("Figures", "Observation", "observe", "run_key"),
}


def __getattr__(name: str) -> Any:
    for home, names in _HOMES.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{home}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
