"""Study the gaits of docs/uncertainty.md again; rewrite its table, its picture and data/uncertainty.csv.

    python docs/uncertainty.py [contact]
Each study is one ``ampm convergence GAIT``, half a minute on two idle cores. With ``contact`` only the table
of contact laws is written.
"""

import csv
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from ampm.presets import PRESETS
from validation.judge.metrics import metric_label
from validation.show.text import replace_between
from validation.study.convergence.levels import STUDIES
from validation.study.convergence.picture import draw
from validation.study.convergence.result import Convergence
from validation.study.convergence.study import convergence
from validation.table import Table, format_number, short_unit

PAGE = Path(__file__).with_suffix(".md")
PICTURE = PAGE.parent / "images" / "convergence.svg"
DATA = PAGE.parent / "data" / "uncertainty.csv"
GAITS = ("normal", "momentum")
LAWS = (
    "gait",
    ">ZMP x, RMSE: own [mm]",
    ">largest",
    ">ZMP y, RMSE: own [mm]",
    ">largest",
    ">ZMP x, largest error: own [mm]",
    ">largest",
    "by",
    "undecided",
)
"""Columns of the table of contact laws."""
SHOWN = (
    "zmp_x_rmse",
    "zmp_y_rmse",
    "zmp_x_maximum",
    "force_x_rmse",
    "angular_momentum_y_rmse",
    "zmp_agreement_rmse",
)
"""On the page."""
INTEGRALS = ("energy_positive_work", "energy_cost_of_transport", "effort_zmp_x")
"""In the file beside what is judged."""


def main() -> None:
    """Study every gait, and write the tables."""
    laws = Table("", LAWS, [_laws(gait) for gait in PRESETS if gait != "roll-1.0"])  # that is normal
    page = replace_between(PAGE.read_text(encoding="utf-8"), "contact laws", laws.markdown())
    PAGE.write_text(page, encoding="utf-8")
    if "contact" in sys.argv[1:]:
        return
    studies = [convergence(gait) for gait in GAITS]
    for gait, found in zip(GAITS, studies, strict=True):
        print(gait, found.verdict.name, found.verdict.reason, file=sys.stderr, flush=True)  # noqa: T201
    draw(studies[0], PICTURE)
    page = replace_between(PAGE.read_text(encoding="utf-8"), "uncertainty", _table(studies).markdown())
    PAGE.write_text(page, encoding="utf-8")
    rows = [row for found in studies for row in _levels(found)]
    with DATA.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows(
            [("gait", "study", "metric", "unit", "levels", "values", "orders", "u"), *rows]
        )


def _laws(gait: str) -> tuple[str, ...]:
    """Row of a gait: least and largest value over all contact laws, and what that leaves of the verdict."""
    names = [study.name for study in STUDIES if not study.numerical]
    found = convergence(gait, only=names)
    values: list[str] = []
    for name in ("zmp_x_rmse", "zmp_y_rmse", "zmp_x_maximum"):
        item, levels = found.metrics[name], found.studied[name].levels
        by_law = [(value * item.factor, study) for study in levels for value in levels[study]]
        worst = max(by_law, key=lambda pair: math.inf if math.isnan(pair[0]) else pair[0])
        values += [
            format_number(item.value * item.factor, 2),
            "fell" if math.isnan(worst[0]) else format_number(worst[0], 2),
        ]
    undecided = [
        metric_label(item.name)
        for item in found.metrics.values()
        if item.tolerance is not None
        and item.spread is not None
        and abs(item.tolerance - item.value) < item.spread
    ]
    return (f"`{gait}`", *values, worst[1].replace("_", " "), "; ".join(undecided) or "none")


def _table(studies: Sequence[Convergence]) -> Table:
    """Limit, and of each gait the value with its numerical uncertainty."""
    rows = []
    for name in SHOWN:
        first, *others = (found.metrics[name] for found in studies)
        limit = "" if first.tolerance is None else f"{first.tolerance * first.factor:.3g}"
        values = (item.quoted for item in (first, *others))
        rows.append((f"{metric_label(name)} [{short_unit(first.display_unit)}]", limit, *values))
    return Table("", ("metric", ">limit", *(f">`{gait}`" for gait in GAITS)), rows)


def _levels(found: Convergence) -> Iterator[tuple[str, ...]]:
    """One line for every metric in every study, in SI units."""
    items = [item for item in found.metrics.values() if item.tolerance is not None or item.name in INTEGRALS]
    for study in found.studies:
        for item in items:
            studied = found.studied[item.name]
            orders, u = "", studied.spreads.get(study.name, math.nan)
            if study.numerical:
                one = studied.estimates[study.name]
                orders, u = " ".join(f"{order:.2f}" for order in one.orders), one.uncertainty
            levels = "; ".join(study.shown)
            values = " ".join(f"{value:.6g}" for value in studied.levels[study.name])
            yield found.request.name, study.name, item.name, item.of.unit, levels, values, orders, f"{u:.3g}"


if __name__ == "__main__":
    main()
