"""Report and pictures of two gaits side by side."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from validation.show import style as figures
from validation.show.page import render_page
from validation.store.folders import output_file
from validation.store.json import write_json
from validation.study.compare.pair import EVEN, Pair, Side, counts, facts, known, tables
from validation.study.compare.run import NUMBERS, PICTURE, REPORT

Array = NDArray[np.float64]

REACH = 0.1
"""Time that the pictures show on either side of a switch [s]."""

_PAGE = (figures.PLAN, figures.MEASURED, figures.FAINT)
_FILE = ("#0072b2", "#d55e00", "#5b6270")
"""Colours of both sides and of the plan, on the page and in a file of its own."""
_KINDS = ("single to double support", "double to single support")


def write_pair(pair: Pair, out: Path) -> None:
    """Write report, numbers and picture into a folder."""
    with output_file(out / NUMBERS) as work:
        write_json(work, pair.as_dict())
    with output_file(out / PICTURE) as work:
        draw_file(pair, work)
    with output_file(out / REPORT) as work:
        work.write_text(render(pair), encoding="utf-8")


def render(pair: Pair) -> str:
    """The report as one self-contained page."""
    a, b = pair.a.label, pair.b.label
    with figures.style():
        switches = figures.to_svg(draw_switches(pair), "s", f"{a} and {b} about the switches")
    return render_page(
        "pair.html.j2",
        styles=["report.css"],
        a=a,
        b=b,
        even=EVEN,
        facts=facts(pair),
        parameters=pair.parameters,
        switches=Markup(switches),
        groups=tables(pair),
        known=known(pair),
        counts=counts(pair),
    )


def draw_file(pair: Pair, path: Path) -> None:
    """Save the picture of the switches; the suffix chooses the format."""
    with figures.file_style():
        figure = draw_switches(pair, _FILE)
        figure.patch.set(alpha=1.0, facecolor="white")
        metadata = {"Date": None, "Creator": None} if path.suffix == ".svg" else None
        figure.savefig(path, dpi=110, metadata=metadata)


def draw_switches(pair: Pair, colours: tuple[str, str, str] = _PAGE) -> Figure:
    """Acceleration, ZMP error and torque rate about both kinds of switch, of both sides.

    Args:
        pair: both sides.
        colours: of both sides and of the plan; by default the page's.
    """
    rows = (
        "COM acceleration x\n[m/s²]",
        "ZMP error x\n[mm]",
        "ZMP error y, to\nthe stance foot [mm]",
        "torque rate\n[N m/ms]",
    )
    figure = Figure(figsize=(2 * figures.WIDTH, 8.6))
    axes = figure.subplots(len(rows), 2, sharex=True, sharey="row")
    figure.subplots_adjust(left=0.09, right=0.985, top=0.92, bottom=0.06, hspace=0.16, wspace=0.06)
    figure.patch.set_alpha(0.0)
    *both, ink = colours
    handles = []
    for side, colour in zip((pair.a, pair.b), both, strict=True):
        for kind in (0, 1):
            for row, (planned, values) in enumerate(_series(side)):
                _draw(axes[row, kind], side, kind, values, planned, colour, lateral=row == 2)
        handles += axes[0, 0].plot([], [], color=colour, label=side.label)
    for kind in (0, 1):
        axes[0, kind].set_title(_KINDS[kind])
        axes[-1, kind].set_xlabel("time from the switch [ms]")
        for axis, label in zip(axes[:, kind], rows, strict=True):
            axis.patch.set_alpha(0.0)
            axis.axvline(0.0, color=ink, linewidth=0.8)
            axis.set_xlim(-1e3 * REACH, 1e3 * REACH)
            axis.set_xticks(np.arange(-75, 76, 25))
            if kind == 0:
                axis.set_ylabel(label)
    figure.align_ylabels(axes[:, 0])
    handles += axes[0, 0].plot([], [], color=ink, linestyle=(0, (4, 2)), label="plan")
    figure.legend(handles=handles, loc="upper right", ncols=3, bbox_to_anchor=(0.985, 0.995))
    return figure


def _series(side: Side) -> list[tuple[Array | None, Array]]:
    """Planned (or None) and measured curve of every row of the picture, over the whole run."""
    signals, record = side.saved.signals, side.saved.record
    error = 1e3 * (signals.vector("measured_zmp", "xy") - signals.vector("plan_zmp", "xy"))
    rate = np.abs(np.diff(record.torque, axis=0, append=record.torque[-1:])).max(axis=1) / record.time_step
    measured, planned = signals["measured_force_x"] / record.mass, signals["plan_force_x"] / record.mass
    return [(planned, measured), (None, error[:, 0]), (None, error[:, 1]), (None, rate / 1e3)]


def _draw(
    axis: Axes, side: Side, kind: int, values: Array, planned: Array | None, colour: str, *, lateral: bool
) -> None:
    """Median and band over all switches of one kind but those of the first step."""
    time, dt = side.saved.signals.time, side.saved.record.time_step
    reach = round(REACH / dt)
    # The plan's switches alternate; the first step's are left out.
    switches = side.plan.contacts.switch_times[2 + kind :: 2]
    rows = np.searchsorted(time, switches - 1e-9)
    inside = (rows >= reach) & (rows < len(time) - reach)
    rows, switches = rows[inside], switches[inside]
    if not rows.size:
        return
    # The last row before a switch and the first behind it belong to different phases.
    offset = np.arange(-reach, reach + 1)
    about = rows[:, None] + offset
    stack = values[about]
    if lateral:  # towards the foot that stood: the right foot's switches are the left's, mirrored
        stack = stack * np.where(np.arange(1, len(rows) + 1) % 2 == 0, 1.0, -1.0)[:, None]
    # Sampled times straddle the switch by less than a step: on average by what is shown.
    at = 1e3 * (offset * dt + np.median(time[rows] - switches))
    low, high = np.nanmin(stack, axis=0), np.nanmax(stack, axis=0)
    axis.fill_between(at, low, high, color=colour, alpha=0.22, linewidth=0)
    axis.plot(at, np.nanmedian(stack, axis=0), color=colour, linewidth=1.4)
    if planned is not None:
        median = np.median(planned[about], axis=0)
        axis.plot(at, median, color=colour, linewidth=1.1, linestyle=(0, (4, 2)))
