"""All pictures of a run's report, by section of the page."""

from __future__ import annotations

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
        for figure in ("rmse", "maximum"):
            metric = summary.get("metrics", {}).get(f"{name}_{figure}", {})
            found[f"tolerance_{figure}"] = (metric.get("display") or metric).get("tolerance")
        return found

    def tracking(curve: Curve, caption: str = "", **options: Any) -> Picture:
        options |= tolerances(curve.name)
        figure = figures.tracking(signals, curve, **options)
        return picture(
            figure, f"{curve.title}: plan, command and measurement over one stride, and the error", caption
        )

    def feet(axis: str) -> Any:
        def draw(axes: Axes, window: Window) -> None:
            for foot, color in (("left", style.LEFT), ("right", style.RIGHT)):
                part = signals[f"{foot}_force_{axis}"][window.rows]
                axes.plot(signals.time[window.rows], part, color=color, linewidth=0.9, label=foot)

        return draw

    zmp_note = (
        "Green band: plus and minus the tolerance of the RMSE. Dashed, where the axis reaches so far: the "
        "largest error allowed."
    )
    pictures = {
        "zmp": [
            tracking(Curve("zmp_x", "ZMP x about the planned COM", "mm", 1e3, about="plan_com_x"), zmp_note),
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
            tracking(
                Curve(
                    f"force_{axis}", f"Ground force {axis}", "N",
                    residual_unit="% BW", residual_scale=100.0 / weight,
                ),
                extra=feet(axis),
            )
            for axis in "xyz"
        ],
        "contact": [
            picture(figures.contact_timeline(saved, plan), "Contact of heel, ball and tip of both feet")
        ],
        "momentum": [
            tracking(Curve(f"angular_momentum_{axis}", f"Angular momentum {axis} about the COM", "N m s"))
            for axis in "xy"
        ],
        "com": [],
        "cost": [],
        "first": [picture(figures.opening(signals, axis), f"ZMP {axis} of the first steps") for axis in "xy"],
    }  # fmt: skip
    if np.isfinite(signals["motion_angular_momentum_z"]).any():
        yaw = Curve("angular_momentum_z", "Angular momentum z about the COM", "N m s")
        pictures["momentum"].append(
            tracking(
                yaw,
                "AMPM does not plan it; the reference is the whole-body motion.",
                reference=("motion", "motion"),
            )
        )
    error = 1e3 * (signals.vector("measured_com") - signals.vector("plan_com"))
    pictures["com"].append(
        picture(
            figures.residuals(signals, dict(zip("xyz", error.T, strict=True)), "mm", "COM error"),
            "COM error in x, y and z",
        )
    )
    both = 1e3 * (signals.vector("measured_zmp_momentum", "xy") - signals.vector("measured_zmp", "xy"))
    pictures["check"] = [
        picture(
            figures.residuals(
                signals, dict(zip("xy", both.T, strict=True)), "mm", "ZMP by momentum − ZMP by contact"
            ),
            "Difference of the two measured ZMPs",
        )
    ]
    feedback = 1e3 * (signals.vector("command_zmp", "xy") - signals.vector("plan_zmp", "xy"))
    pictures["cost"] = [
        picture(figures.torque_use(saved), "Torque of the busiest motors"),
        picture(figures.qp_statistics(saved), "Time and residual of the QP"),
        picture(
            figures.residuals(
                signals, dict(zip("xy", feedback.T, strict=True)), "mm", "Feedback: commanded − planned ZMP"
            ),
            "Commanded minus planned ZMP",
        ),
    ]
    return pictures
