"""The curves of a walk, drawn alike by report and recording: what they are, and in which unit."""

from typing import NamedTuple

import numpy as np

from ampm.geometry import Array
from validation.judge.compare import SIGNALS
from validation.store.signals import Signals


class Curve(NamedTuple):
    """A signal of which plan, command and measurement are drawn."""

    column: str  # its name, without the kind before it, such as `zmp_x`
    title: str  # what it is
    unit: str  # in which it is drawn
    scale: float = 1.0  # drawn value per SI value
    about: str = ""  # column that is subtracted, if it is known, because the travel would flatten the curve

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
    unit: str = "mm"  # in which they are drawn

    def values(self, signals: Signals, weight: float) -> Array:
        """Drawn values, shape (N, len(axes)), of a body with a weight [N]."""
        scale = {"mm": 1e3, "% of body weight": 100.0 / weight}.get(self.unit, 1.0)
        return scale * (signals.vector(self.minuend, self.axes) - signals.vector(self.subtrahend, self.axes))


CURVES = {
    curve.column: curve
    for curve in (
        Curve("zmp_x", "ZMP along x, from the planned COM", "mm", 1e3, about="plan_com_x"),
        Curve("zmp_y", "ZMP along y", "mm", 1e3),
        *(Curve(f"force_{axis}", f"Ground force along {axis}", "N") for axis in "xyz"),
        *(Curve(f"angular_momentum_{axis}", f"Angular momentum about {axis}", "N m s") for axis in "xyz"),
        Curve("com_x", "COM along x, from the plan", "m", about="plan_com_x"),
        Curve("com_y", "COM along y", "m"),
        Curve("com_z", "COM along z", "m"),
    )
}
"""By the name of their column."""

VELOCITIES = {
    "velocity_x": ("Velocity of the COM along the heading", "m/s"),
    "velocity_y": ("Velocity of the COM across the heading, to the left", "m/s"),
    "yaw_rate": ("Rate of the heading, to the left", "rad/s"),
}
"""Title and unit of what a walk without a plan is asked for, by the name of its column."""

DIFFERENCES = {
    "residual/zmp": Difference("ZMP error, measured - plan", "measured_zmp", "plan_zmp", "xy"),
    "residual/force": Difference(
        "Ground force error", "measured_force", "plan_force", "xyz", "% of body weight"
    ),
    "residual/angular_momentum": Difference(
        "Angular momentum error", "measured_angular_momentum", "plan_angular_momentum", "xy", "N m s"
    ),
    "residual/com": Difference("COM error", "measured_com", "plan_com", "xyz"),
    "feedback/zmp": Difference("Feedback, commanded - planned ZMP", "command_zmp", "plan_zmp", "xy"),
    "selfcheck/zmp": Difference(
        "Self-check, ZMP by momentum - by contact", "measured_zmp_momentum", "measured_zmp", "xy"
    ),
}
"""By their entity in a recording."""
