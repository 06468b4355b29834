"""The curves of a walk, drawn alike by report and recording: what they are, and in which unit."""

from typing import NamedTuple

import numpy as np

from ampm.geometry import Array
from validation.judge.compare import SIGNALS
from validation.store.signals import Signals, changes
from validation.table import package_rows


class Curve(NamedTuple):
    """A signal of which plan, command and measurement are drawn."""

    column: str  # its name, without the kind before it, such as `zmp_x`
    title: str  # what it is
    unit: str  # in which it is drawn
    scale: float  # drawn value per SI value
    about: str  # column that is subtracted, because the travel would flatten the curve; empty for none

    @property
    def reference(self) -> str:
        """What the measurement is compared with: ``plan`` or ``motion``."""
        return SIGNALS[self.column].reference

    def values(self, signals: Signals, kind: str) -> Array:
        """Drawn values of the plan, the command or the measurement, shape (N,)."""
        values = signals[f"{kind}_{self.column}"]
        return self.scale * (values - np.nan_to_num(signals[self.about]) if self.about else values)


class Difference(NamedTuple):
    """The difference of two vectors."""

    title: str  # what it is
    minuend: str  # columns without their axis
    subtrahend: str  # likewise
    axes: str  # that are drawn
    unit: str  # in which they are drawn

    def values(self, signals: Signals, weight: float) -> Array:
        """Drawn values, shape (N, len(axes)), of a body with a weight [N].

        As a command is held until the next one, its difference is held, too.
        """
        scale = {"mm": 1e3, "% of body weight": 100.0 / weight}.get(self.unit, 1.0)
        minuend = signals.vector(self.minuend, self.axes)
        gap = scale * (minuend - signals.vector(self.subtrahend, self.axes))
        if not self.minuend.startswith("command"):
            return gap
        new = changes(minuend)
        return np.repeat(gap[new], np.diff(new, append=len(gap)), axis=0)


CURVES = {
    row["column"]: Curve(row["column"], row["title"], row["unit"], float(row["scale"]), row["about"])
    for row in package_rows("show/curves.csv")
}
"""By the name of their column."""

VELOCITIES = {
    "velocity_x": ("Velocity of the COM along the heading", "m/s"),
    "velocity_y": ("Velocity of the COM across the heading, to the left", "m/s"),
    "yaw_rate": ("Rate of the heading, to the left", "rad/s"),
}
"""Title and unit of what a walk without a plan is asked for, by the name of its column."""

DIFFERENCES = {row.pop("entity"): Difference(**row) for row in package_rows("show/differences.csv")}
"""By their entity in a recording."""
