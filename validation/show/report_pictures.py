"""All pictures of a run's report, by section of the page."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ampm.planner.support import StepPlan
from validation.show import run_figures as figures
from validation.show import style
from validation.show.run_figures import Curve, Window
from validation.show.style import Picture
from validation.store.saved import SavedRun


def pictures_of(saved: SavedRun, plan: StepPlan | None) -> dict[str, list[Picture]]:
    """All figures, by section of the page."""
    signals, summary = saved.signals, saved.summary
    weight = saved.record.mass * saved.record.gravity
    counter = iter(range(1000))

    def picture(figure: Figure, label: str, caption: str = "", *, wide: bool = False) -> Picture:
        return style.picture(figure, f"f{next(counter)}", label, caption, wide=wide)

    def tolerances(name: str) -> dict[str, float | None]:
        found = {}
        for kind in ("rmse", "maximum"):
            metric = summary.get("metrics", {}).get(f"{name}_{kind}", {})
            found[f"tolerance_{kind}"] = (metric.get("display") or metric).get("tolerance")
        return found

    def tracking(curve: Curve, caption: str = "", **options: Any) -> Picture:
        figure = figures.tracking(signals, curve, **options | tolerances(curve.name))
        label = f"{curve.title}: plan, command and measurement over one stride, and the error"
        return picture(figure, label, caption)

    def feet(axis: str) -> Callable[[Axes, Window], None]:
        def draw(axes: Axes, window: Window) -> None:
            for foot, color in (("left", style.LEFT), ("right", style.RIGHT)):
                part = signals[f"{foot}_force_{axis}"][window.rows]
                axes.plot(signals.time[window.rows], part, color=color, linewidth=0.9, label=foot)

        return draw

    def gap(measured: str, planned: str, axes: str, title: str, label: str) -> Picture:
        error = 1e3 * (signals.vector(measured, axes) - signals.vector(planned, axes))
        columns = dict(zip(axes, error.T, strict=True))
        return picture(figures.residuals(signals, columns, "mm", title), label)

    def force(axis: str) -> Curve:
        title, share = f"Ground force {axis}", 100.0 / weight
        return Curve(f"force_{axis}", title, "N", residual_unit="% BW", residual_scale=share)

    pictures = {
        "zmp": [
            tracking(
                Curve("zmp_x", "ZMP x about the planned COM", "mm", 1e3, about="plan_com_x"),
                "Green band: plus and minus the tolerance of the RMSE. Dashed, where the axis reaches so "
                "far: the largest error allowed.",
            ),
            tracking(Curve("zmp_y", "ZMP y", "mm", 1e3)),
        ],
        "split": [
            picture(figures.zmp_error_split(signals, axis), f"Causes of the ZMP error in {axis}, stacked")
            for axis in "xy"
        ],
        "above": [
            picture(
                figures.top_view(saved, plan), "ZMP and COM over the footprints, seen from above",
                "Four steps from the middle of the run.", wide=True,
            )
        ],
        "force": [
            tracking(force(axis), extra=feet(axis)) for axis in "xyz"
        ],
        "contact": [
            picture(figures.contact_timeline(saved, plan), "Contact of heel, ball and tip of both feet")
        ],
        "momentum": [
            tracking(Curve(f"angular_momentum_{axis}", f"Angular momentum {axis} about the COM", "N m s"))
            for axis in "xy"
        ],
        "com": [gap("measured_com", "plan_com", "xyz", "COM error", "COM error in x, y and z")],
        "check": [
            gap(
                "measured_zmp_momentum", "measured_zmp", "xy", "ZMP by momentum − ZMP by contact",
                "Difference of the two measured ZMPs",
            )
        ],
        "cost": [
            picture(figures.torque_use(saved), "Torque of the busiest motors"),
            picture(figures.qp_statistics(saved), "Time and residual of the QP"),
            gap(
                "command_zmp", "plan_zmp", "xy", "Feedback: commanded − planned ZMP",
                "Commanded minus planned ZMP",
            ),
        ],
        "first": [picture(figures.opening(signals, axis), f"ZMP {axis} of the first steps") for axis in "xy"],
    }  # fmt: skip
    if np.isfinite(signals["motion_angular_momentum_z"]).any():
        yaw = tracking(
            Curve("angular_momentum_z", "Angular momentum z about the COM", "N m s"),
            "AMPM does not plan it; the reference is the whole-body motion.",
            reference="motion",
        )
        pictures["momentum"].append(yaw)
    if not np.isfinite(saved.record.qp_time).any():  # a controller of one's own may have no QP
        del pictures["cost"][1]
    return pictures
