"""Study the gaits of docs/uncertainty.md again; rewrite its tables, its picture and their files in data.

    python docs/uncertainty.py
One ``ampm convergence GAIT`` for every preset, each half a minute on two idle cores. data/uncertainty.csv has
the numerical studies, data/contact-laws.csv the others.
"""

import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from figures import save_figure, style
from matplotlib.figure import Figure
from numpy.typing import NDArray
from trials import write_rows

from ampm.presets import PRESETS
from ampm.run_file import key_info
from benchmarks.page import replace_between
from validation.judge.metrics import METRICS
from validation.judge.uncertainty import rounding
from validation.judge.verdict import MetricResult
from validation.study.convergence.result import Convergence
from validation.study.convergence.study import convergence
from validation.table import Table, format_number, short_unit

PAGE = Path(__file__).with_suffix(".md")
PICTURE = PAGE.parent / "images" / "convergence.svg"
GAITS = ("normal", "momentum")
"""Of which the page has the numerical uncertainty."""
LAWS = (
    "gait",
    "ZMP RMSE x, own [mm]",
    "ZMP RMSE x, worst law [mm]",
    "ZMP RMSE y, own [mm]",
    "ZMP RMSE y, worst law [mm]",
    "largest ZMP error x, own [mm]",
    "largest ZMP error x, worst law [mm]",
    "worst law for the largest error",
    "undecided metrics",
)
"""Columns of data/contact-laws.csv."""
SHOWN = ("zmp_x_rmse", "zmp_y_rmse", "zmp_x_maximum")
"""On the page."""
INTEGRALS = ("energy_positive_work", "energy_cost_of_transport", "effort_zmp_x")
"""In the file beside what is judged."""


def main() -> None:
    """Study every gait, and write the tables."""
    studies = {gait: convergence(gait) for gait in PRESETS if gait != "roll-1.0"}  # roll-1.0 is normal
    for gait, found in studies.items():
        print(gait, found.verdict.name, found.verdict.reason, file=sys.stderr, flush=True)  # noqa: T201
    write_rows("contact-laws", [LAWS, *(_laws(gait, found) for gait, found in studies.items())])
    numerical = {gait: studies[gait] for gait in GAITS}
    draw(numerical["normal"], PICTURE)
    page = replace_between(PAGE.read_text(encoding="utf-8"), "uncertainty", _table(numerical).markdown())
    PAGE.write_text(page, encoding="utf-8")
    rows = [row for found in numerical.values() for row in _levels(found)]
    header = ("gait", "study", "metric", "unit", "levels", "values", "orders", "u")
    write_rows("uncertainty", [header, *rows])


def _laws(gait: str, found: Convergence) -> tuple[str, ...]:
    """Row of a gait: its own value and the largest over all contact laws, and the metrics left undecided."""
    laws = [study.name for study in found.studies if not study.numerical]
    values: list[str] = []
    for name in ("zmp_x_rmse", "zmp_y_rmse", "zmp_x_maximum"):
        item, levels = found.metrics[name], found.studied[name].levels
        by_law = [(value * item.factor, study) for study in laws for value in levels[study]]
        worst = max(by_law, key=lambda pair: math.inf if math.isnan(pair[0]) else pair[0])
        values += [
            format_number(item.value * item.factor, 2),
            "fell" if math.isnan(worst[0]) else format_number(worst[0], 2),
        ]
    undecided = [
        METRICS[item.name].label
        for item in found.metrics.values()
        if item.tolerance is not None
        and item.spread is not None
        and abs(item.tolerance - item.value) < item.spread
    ]
    return (gait, *values, worst[1].replace("_", " "), "; ".join(undecided))


def _table(studies: Mapping[str, Convergence]) -> Table:
    """Limit, and of each gait the value with its numerical uncertainty."""
    rows = []
    for name in SHOWN:
        first, *others = (found.metrics[name] for found in studies.values())
        limit = "" if first.tolerance is None else f"{first.tolerance * first.factor:.3g}"
        values = (item.quoted for item in (first, *others))
        rows.append((f"{METRICS[name].label} [{short_unit(first.display_unit)}]", limit, *values))
    return Table("", ("metric", ">limit", *(f">`{gait}`" for gait in studies)), rows)


def _levels(found: Convergence) -> Iterator[tuple[str, ...]]:
    """One line for every metric in every numerical study, in SI units."""
    items = [item for item in found.metrics.values() if item.tolerance is not None or item.name in INTEGRALS]
    for study in found.studies:
        if not study.numerical:
            continue
        for item in items:
            studied = found.studied[item.name]
            one = studied.estimates[study.name]
            yield (
                found.request.name,
                study.name,
                item.name,
                METRICS[item.name].unit,
                "; ".join(f"{value:g}" for value in study.values),
                " ".join(f"{value:.6g}" for value in studied.levels[study.name]),
                " ".join(f"{order:.2f}" for order in one.orders),
                f"{one.uncertainty:.3g}",
            )


def shown_changes(item: MetricResult, levels: Sequence[float]) -> NDArray[np.float64]:
    """Changes to the next finer level over the value; NaN where they are rounding."""
    changes = np.abs(np.diff(levels))
    changes[~(changes > rounding(item.value, METRICS[item.name].unit))] = np.nan
    return changes / abs(item.value)


@style()
def draw(result: Convergence, path: Path) -> None:
    """Draw a plot for every numerical study, side by side, and the legend below, without self-checks.

    Changes that are rounding are gaps, and dots are a change in proportion to the level.
    """
    found = [study for study in result.studies if study.numerical]
    changes = {
        study.name: {
            item.label: shown_changes(item, result.studied[item.name].levels[study.name])
            for item in result.metrics.values()
            if item.tolerance is not None and item.value and not METRICS[item.name].is_self_check
        }
        for study in found
    }
    known = {label for curves in changes.values() for label, curve in curves.items() if (curve > 0.0).any()}
    labels = [label for label in changes[found[0].name] if label in known]
    figure = Figure(figsize=(12.4, 6.0), dpi=110, layout="constrained")
    steps = result.request.run.gait.steps
    figure.suptitle(f"{result.request.title}: change to the next finer level, {steps} steps a level")
    plots = figure.subplots(1, len(found), squeeze=False)[0]
    for axes, study in zip(plots, found, strict=True):
        at = np.array(study.values)
        axes.set_prop_cycle(color=mpl.colormaps["tab20"].colors)  # type: ignore[attr-defined]
        for label in labels:
            axes.loglog(at[:-1], changes[study.name][label], "o-", lw=1.2, ms=4.5, label=label)
        largest = float(np.nanmax([changes[study.name][label] for label in labels], initial=0.0))
        axes.loglog(at, 2.5 * (largest or np.nan) * at / at[0], ":", color="0.6", label="order 1")
        axes.set_title("" if largest else "no change but rounding", fontsize=9)
        axes.set_xlabel(f"{study.key} [{key_info(study.key).unit}]")
        axes.set_xticks(at, [f"{value:g}" for value in at])
        axes.minorticks_off()
    plots[0].set_ylabel("change, over the gait's own value [1]")
    figure.legend(*plots[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    save_figure(figure, path)


if __name__ == "__main__":
    main()
