"""Comparison of two gaits as text, as a page, and as pictures of the switches."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ampm.geometry import Array
from validation.show import style
from validation.show.page import render_page
from validation.show.text import format_number, format_value
from validation.store.folders import output_file
from validation.store.json import write_json
from validation.study.compare.pair import EVEN, NUMBERS, PICTURE, REPORT, Pair, Row, Side

REACH = 0.1
"""Time that the pictures show on either side of a switch [s]."""
_PAGE = (style.PLAN, style.MEASURED, style.FAINT)
_FILE = ("#0072b2", "#d55e00", "#5b6270")
"""Colours of both sides and of the plan, on the page and in a file of its own."""
_KINDS = ("single to double support", "double to single support")
_CURVES = (
    "COM acceleration x\n[m/s²]",
    "ZMP error x\n[mm]",
    "ZMP error y, to\nthe stance foot [mm]",
    "torque rate\n[N m/ms]",
)
_FACTS = {
    "outcome": "{outcome}, {steps_completed} steps",
    "model": "{model}",
    "step length": "{step_length:g} m",
    "speed at a switch": "{switching_velocity:g} m/s",
    "mean speed": "{mean_velocity:.3f} m/s",
    "single support": "{single_support_duration:.3f} s",
    "double support": "{double_support_duration:.3f} s",
    "joint that jumps most": "{joint_acceleration_jump.joint}",
}

# ----------------------------------------------------------------------------------------------- words


def facts(pair: Pair) -> list[tuple[str, ...]]:
    """Facts about both gaits: name of the fact, first side, second side."""
    both = [side.as_dict() for side in (pair.a, pair.b)]
    return [
        (name, *(text.format(**side).replace("_", " ") for side in both)) for name, text in _FACTS.items()
    ]


def tables(pair: Pair) -> dict[str, list[tuple[str, ...]]]:
    """Heading to rows of label, both values, unit, ratio, and which side is better."""
    names = {"a": pair.a.label, "b": pair.b.label, "even": "=", "": ""}
    found: dict[str, list[tuple[str, ...]]] = {}
    for row in pair.rows:
        cells = (row.of.label, shown(row.a), shown(row.b), row.of.unit, _ratio(row), names[row.better])
        found.setdefault(row.of.group, []).append(cells)
    return found


def notes(pair: Pair) -> list[str]:
    """Lines under the tables: how often either side is better, and the largest undecided ratios."""
    words = {
        "a": f"{pair.a.label} is better in",
        "even": "no difference in",
        "b": f"{pair.b.label} is better in",
        "": "undecided:",
    }
    found = [row.better for row in pair.rows]
    lines = [f"{text} {found.count(better)} of {len(found)} quantities" for better, text in words.items()]
    largest = (
        f"undecided, with a ratio of {_ratio(row)}: {row.of.group}, {row.of.label}"
        for row in largest_undecided(pair)
    )
    return [*lines, *first_answer(pair), *largest]


def first_answer(pair: Pair) -> list[str]:
    """Without a study: number of quantities of the walks whose values differ."""
    ratios = [row.ratio for row in pair.rows if row.of.walked and row.ratio]
    if pair.studies or not ratios:
        return []
    less, more = sum(ratio < 1.0 / EVEN for ratio in ratios), sum(ratio > EVEN for ratio in ratios)
    even = len(ratios) - less - more
    return [
        f"first answer, by values alone: of {len(ratios)} quantities of the walks {less} are smaller in "
        f"{pair.b.label}, {more} in {pair.a.label}, {even} differ by less than a ratio of {EVEN:g}"
    ]


def largest_undecided(pair: Pair) -> list[Row]:
    """Rows of the five largest ratios among the undecided ones."""
    ratios = {row: abs(math.log(row.ratio)) for row in pair.rows if row.better == "" and row.ratio}
    return sorted(ratios, key=lambda row: -ratios[row])[:5]


def known(pair: Pair) -> str:
    """Explanation of the thresholds for a difference, in a sentence or two."""
    if not pair.studies:
        return (
            "No convergence study was given (--uncertainty FILE, one per gait): of the walks no value is "
            "called better, only of plan and motion, which are not simulated."
        )
    parts = []
    for side, study in zip((pair.a, pair.b), pair.studies, strict=True):
        inside = " + ".join(study.studies) or "no numerical study"
        lacking = f", not studied: {', '.join(study.not_studied)}" if study.not_studied else ""
        parts.append(f"of {side.label} ({inside}{lacking})")
    return (
        f"A difference within the sum of both numerical uncertainties, {' and '.join(parts)}, is no result, "
        "nor is one of a value whose uncertainty is not known."
    )


def shown(value: float) -> str:
    """A value for a table: rounding errors are 0."""
    return "0" if abs(value) < 1e-9 else format_number(value, 3)


def _ratio(row: Row) -> str:
    """Second over first value, for a table."""
    return "" if row.ratio is None else format_number(row.ratio, 3)


# ---------------------------------------------------------------------------------------- files, pictures


def write_pair(pair: Pair, out: Path) -> None:
    """Write report, numbers and picture into a folder."""
    with output_file(out / NUMBERS) as work:
        write_json(work, pair.as_dict())
    draw_file(pair, out / PICTURE)
    with output_file(out / REPORT) as work:
        work.write_text(render(pair), encoding="utf-8")


def render(pair: Pair) -> str:
    """The report as one self-contained page."""
    a, b = pair.a.label, pair.b.label
    with style.style():
        switches = style.picture(draw_switches(pair, _PAGE), "s", f"{a} and {b} about the switches")
    return render_page(
        "pair.html.j2",
        f"{a} and {b}",
        styles=["report.css"],
        a=a,
        b=b,
        even=EVEN,
        alike=not any(key.startswith(("body.", "controller.name")) for key in pair.parameters),
        facts=facts(pair),
        parameters=[
            (key, format_value(one), format_value(two)) for key, (one, two) in pair.parameters.items()
        ],
        switches=switches.svg,
        groups=tables(pair),
        known=known(pair),
        notes=notes(pair),
    )


@style.into_file
def draw_file(pair: Pair) -> Figure:
    """Draw the switches on white."""
    figure = draw_switches(pair, _FILE)
    figure.set_dpi(110)
    figure.patch.set(alpha=1.0, facecolor="white")
    return figure


def draw_switches(pair: Pair, colours: tuple[str, str, str]) -> Figure:
    """Acceleration, ZMP error and torque rate about both kinds of switch, of both sides.

    Args:
        pair: both sides.
        colours: of both sides and of the plan.
    """
    figure = Figure(figsize=(2 * style.WIDTH, 8.6))
    axes = figure.subplots(len(_CURVES), 2, sharex=True, sharey="row")
    figure.subplots_adjust(left=0.09, right=0.985, top=0.92, bottom=0.06, hspace=0.16, wspace=0.06)
    figure.patch.set_alpha(0.0)
    *both, ink = colours
    handles = []
    for side, colour in zip((pair.a, pair.b), both, strict=True):
        for kind in (0, 1):
            for axis, (time, values, planned) in zip(axes[:, kind], _curves(side, kind), strict=False):
                low, median, high = (f(values, axis=0) for f in (np.nanmin, np.nanmedian, np.nanmax))
                axis.fill_between(time, low, high, color=colour, alpha=0.22, linewidth=0)
                axis.plot(time, median, color=colour, linewidth=1.4)
                if planned is not None:
                    axis.plot(time, np.median(planned, axis=0), color=colour, lw=1.1, ls=(0, (4, 2)))
        handles += axes[0, 0].plot([], [], color=colour, label=side.label)
    for axis in axes.flat:
        axis.patch.set_alpha(0.0)
        axis.axvline(0.0, color=ink, linewidth=0.8)
        axis.set_xlim(-1e3 * REACH, 1e3 * REACH)
        axis.set_xticks(np.arange(-75, 76, 25))
    for first, axis, last in zip(axes[0], axes[-1], _KINDS, strict=True):
        first.set_title(last)
        axis.set_xlabel("time from the switch [ms]")
    for axis, label in zip(axes[:, 0], _CURVES, strict=True):
        axis.set_ylabel(label)
    figure.align_ylabels(axes[:, 0])
    handles += axes[0, 0].plot([], [], color=ink, linestyle=(0, (4, 2)), label="plan")
    figure.legend(handles=handles, loc="upper right", ncols=3, bbox_to_anchor=(0.985, 0.995))
    return figure


def _curves(side: Side, kind: int) -> Iterator[tuple[Array, Array, Array | None]]:
    """Curves about all switches of one kind but those of the first step, in the order of the picture.

    Yields:
        Time from the switch, shape (n,) [ms]; measured values, one row per switch; planned ones, or None.
    """
    signals, record = side.saved.signals, side.saved.record
    time, steps = signals.time, side.saved.signal_steps
    dt = int(steps[1] - steps[0]) * record.time_step
    reach = round(REACH / dt)
    # The plan's switches alternate; those of the first step are omitted.
    switches = side.plan.contacts.switch_times[2 + kind :: 2]
    rows = np.searchsorted(time, switches - 1e-9)
    inside = (rows >= reach) & (rows < len(time) - reach)
    rows, switches = rows[inside], switches[inside]
    if not rows.size:
        return
    # The last row before a switch and the first after it belong to different phases.
    offset = np.arange(-reach, reach + 1)
    about = rows[:, None] + offset
    # Sampled times straddle the switch by less than a step: on average by what is shown.
    at = 1e3 * (offset * dt + np.median(time[rows] - switches))
    error = 1e3 * (signals.vector("measured_zmp", "xy") - signals.vector("plan_zmp", "xy"))
    torque = record.torque_at(steps)
    rate = np.abs(np.diff(torque, axis=0, append=torque[-1:])).max(axis=1) / dt
    # Towards the foot that stood: the right foot's switches are the left's, mirrored.
    sign = np.where(np.arange(1, len(rows) + 1) % 2 == 0, 1.0, -1.0)[:, None]
    yield at, signals["measured_force_x"][about] / record.mass, signals["plan_force_x"][about] / record.mass
    yield at, error[about, 0], None
    yield at, sign * error[about, 1], None
    yield at, rate[about] / 1e3, None
