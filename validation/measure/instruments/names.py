"""Names of windows, causes and columns of instruments; imports nothing, so that schemas load fast."""

from __future__ import annotations

from collections.abc import Mapping

RUN = "run"
WINDOWS = (RUN, "measured_single_support", "measured_double_support")
"""The whole walk, and by true contact of the feet."""

METHOD = "method"
"""Error of the method without faults of the instrument: threshold, compensation, a point mass for a body."""

CAUSES: Mapping[str, str] = {
    METHOD: "the method, with faultless readings",
    "noise": "noise, as the low-pass lets it through",
    "bias": "bias",
    "cross_talk": "cross-talk",
    "filter": "low-pass",
    "sampling": "sampling",
    "delay": "delay",
    "quantisation": "quantisation",
    "saturation": "range",
    "kinematics": "pose by encoders",
    "tilt": "tilt of the orientation estimate",
}
"""Causes of the error that an instrument adds, and their labels."""

STATISTICS = {"rmse": "root mean square", "maximum": "largest"}

INSTRUMENT_COLUMNS: Mapping[str, tuple[str, str]] = {
    **{
        f"instrument_zmp_{axis}_{figure}": (
            "m", f"{words} error that the instrument adds to the ZMP, {axis}, over the whole walk"
        )
        for axis in "xy" for figure, words in STATISTICS.items()
    },
    **{
        f"instrument_zmp_compensated_{axis}_{figure}": (
            "m", f"the same with the instrument's mean latency taken out: {words}, {axis}"
        )
        for axis in "xy" for figure, words in STATISTICS.items()
    },
    **{
        f"instrument_zmp_{cause}_{axis}_rmse": (
            "m", f"root mean square error in {axis} by one cause alone: {words}; null if it has none"
        )
        for cause, words in CAUSES.items() for axis in "xy"
    },
    "instrument_latency": ("s", "mean age of the instrument's readings of slow signals"),
    "instrument_unmeasured": ("1", "share of the instants with a ZMP at which the instrument shows none"),
}  # fmt: skip
"""Columns that an instrument adds to a row: name to unit and meaning."""
