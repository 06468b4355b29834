"""Study the gaits of docs/convergence.md again and rewrite its tables: ``python docs/convergence.py``.

Each study is one ``ampm convergence GAIT``, half a minute on two idle cores.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

from pages import between

from validation.study.convergence.command import Options, run
from validation.study.convergence.picture import draw
from validation.study.convergence.result import Convergence
from validation.study.convergence.studies import COUNTS
from validation.study.convergence.table import levels_table, summary_lines

PAGE = Path(__file__).with_suffix(".md")
PICTURE = PAGE.parent / "images" / "convergence.svg"
STUDIES = {
    "normal": ("time_step", "qp_tolerance", "contact_stiffness", "contact_depth"),
    "momentum": ("time_step",),
}
"""Gait to the studies whose levels the page has; the rest is in what ``--out`` keeps."""
ROUNDING = ("com_agreement_maximum", "angular_momentum_agreement_maximum", "standing_weight_error")
"""The same on all levels but for the arithmetic."""
INTEGRALS = (
    "zmp_x_single_support_rmse", "zmp_x_double_support_rmse", "energy_positive_work",
    "energy_cost_of_transport", "effort_zmp_x",
)  # fmt: skip
"""Shown beside what is judged."""


def main() -> None:
    """Study every gait and rewrite the tables of the page, and the picture of the first gait."""
    page = PAGE.read_text(encoding="utf-8")
    for gait in STUDIES:
        found = run(gait, (), Options())
        print(gait, found.verdict, found.verdict_reason, file=sys.stderr, flush=True)  # noqa: T201
        page = between(page, gait, "\n".join(_tables(found)))
        if gait == "normal":
            draw(found, PICTURE)
    PAGE.write_text(page, encoding="utf-8")


def _tables(found: Convergence) -> Iterator[str]:
    judged = [item for item in found.metrics.values() if item.tolerance is not None]
    items = judged + [found.metrics[name] for name in INTEGRALS]
    yield from summary_lines(found, items)
    shown = [item for item in items if item.name not in COUNTS and item.name not in ROUNDING]
    for study in found.studies:
        if study.topic.name in STUDIES[found.request.name]:
            yield from ("", f"`{study.topic.name}`: {study.topic.title}", "")
            yield from levels_table(found, study, shown)


if __name__ == "__main__":  # the workers of the studies import this file
    main()
