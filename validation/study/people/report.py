"""A recorded person beside a run: rows of tables, and a picture."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from validation.judge.compare import SIGNALS
from validation.judge.metrics import display_unit
from validation.show import style
from validation.show.text import format_number
from validation.study.people.compare import PAIRS, PERSON, PLAN, SIMULATION, Difference, People
from validation.study.people.walking import PHASES

_COLOURS: Mapping[str, str] = {PERSON: "#1b1e24", SIMULATION: "#d55e00", PLAN: "#0072b2"}
_PANELS = (
    ("force_x", "force_y", "force_z"),
    ("left_force_x", "left_force_y", "left_force_z"),
    ("com_x", "com_y", "com_z"),
    ("zmp_x", "zmp_y", "angular_momentum_x"),
)


def fact_rows(found: People) -> list[tuple[str, ...]]:
    """Label, one value for every walk, and unit."""
    rows = []
    for label, (unit, values) in found.facts.items():
        factor, shown = _shown(unit, label)
        cells = [format_number(factor * values.get(who, np.nan), 4) for who in found.strides]
        rows.append((label, *cells, shown))
    return rows


def _shown(unit: str, label: str) -> tuple[float, str]:
    """Factor and unit in which a fact is shown."""
    if unit == "m" and label != "length of a step":
        return 1e3, "mm"
    if unit == "body weight":
        return 100.0, "% of weight"
    if label == "time on both feet":
        return 100.0, "%"
    return 1.0, "" if unit == "1" else unit


def difference_rows(found: People) -> list[tuple[str, ...]]:
    """Signal, the person's spread, RMS of every pair, the largest of those with the person, the limit."""
    by_signal: dict[str, list[Difference]] = {}
    for item in found.differences:
        by_signal.setdefault(item.signal, []).append(item)
    rows = []
    for name, items in by_signal.items():
        factor, unit = display_unit(items[0].unit, found.weight)
        person = found.strides[PERSON]
        own = 1.0 if items[0].unit == "m" else found.weight / person.weight
        spread = factor * own * person.spread(name) if name in person.curves else np.nan
        cells = [f"{label_of(name)} [{unit.replace('body ', '')}]", format_number(round(spread, 9), 3)]
        for pair in PAIRS:
            of_pair = [item for item in items if (item.of, item.against) == pair]
            for item in of_pair:
                mark = "" if item.within is None else " ok" if item.within else " out"
                cells.append(f"{factor * item.statistics.rmse:.3g}{mark}")
                if PERSON in pair:
                    cells.append(f"{factor * item.statistics.maximum:.3g} at {100 * item.at:.0f} %")
            if not of_pair:
                cells += ["–", "–"] if PERSON in pair else ["–"]
        limit = items[0].rmse_limit
        rows.append((*cells, "–" if limit is None else f"{factor * limit:.3g}"))
    return rows


def label_of(name: str) -> str:
    """Label of a signal."""
    if name in SIGNALS:
        return SIGNALS[name].label
    return f"force on the left foot along {name[-1]}"


@style.into_file
def draw(found: People) -> Figure:
    """Draw the mean strides with the person's standard deviation, a panel for every signal that it has."""
    curves = found.curves
    panels = [name for row in _PANELS for name in row if name in curves[PERSON]]
    rows = -(-len(panels) // 3)
    figure = Figure(figsize=(10.0, 2.3 * rows + 0.5), dpi=130, layout="constrained")
    axes = np.atleast_1d(figure.subplots(rows, 3, sharex=True)).ravel()
    percent = 100.0 * np.arange(PHASES) / PHASES
    for axis, name in zip(axes, panels, strict=False):
        for who in (PLAN, SIMULATION, PERSON):
            strides = found.strides.get(who)
            if strides is None or name not in curves[who]:
                continue
            unit = SIGNALS[name].unit if name in SIGNALS else "N"
            factor, shown = display_unit(unit, strides.weight)
            if unit == "N m s":
                factor = found.weight / strides.weight
            mean = factor * curves[who][name]
            axis.plot(percent, mean, color=_COLOURS[who], linewidth=1.3, label=who)
            if who == PERSON and strides.count > 1 and name in strides.curves:
                deviation = factor * np.nanstd(strides.curves[name], axis=0, ddof=1)
                axis.fill_between(
                    percent, mean - deviation, mean + deviation, color=_COLOURS[who], alpha=0.15, linewidth=0
                )
            axis.set_title(f"{label_of(name)} [{shown}]")
    for axis in axes[len(panels) :]:
        axis.remove()
    for axis in axes[max(0, len(panels) - 3) : len(panels)]:
        axis.set_xlabel("share of the stride [%]")
        axis.tick_params(labelbottom=True)
    handles, labels = axes[0].get_legend_handles_labels()
    title = f"{found.name}; person: mean of {found.strides[PERSON].count} strides, standard deviation"
    figure.legend(handles, labels, loc="outside lower center", ncols=3, title=title)
    return figure
