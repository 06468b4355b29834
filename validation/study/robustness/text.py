"""A robustness study as tables."""

from __future__ import annotations

import math

from ampm.planner.capture import DIRECTIONS, PUSH_PHASES
from validation.show.text import ABSENT, markdown_table
from validation.study.robustness.result import CellResult, Robustness

PHASE_NAMES = {
    "early": "12 % of single support", "mid": "50 % of single support", "late": "85 % of single support",
    "double": "mid double support",
}  # fmt: skip
"""When a push begins."""
PUSH_HEADER = ("push at", "begins at", *(f"{name} [m/s]" for name in DIRECTIONS))
OTHER_HEADER = ("disturbance", "unit", "survived", "within tolerance", "ZMP RMSE x, y [mm]", "first failure")


def push_rows(found: Robustness) -> list[tuple[str, ...]]:
    """Rows of :data:`PUSH_HEADER`: survived of the bound, by height and phase."""
    rows = []
    for height in dict.fromkeys(item.cell.height for item in found.pushes):
        for phase in PUSH_PHASES:
            cells = {
                item.cell.direction: item
                for item in found.pushes
                if (item.cell.height, item.cell.phase) == (height, phase)
            }
            if cells:
                rows.append((height, PHASE_NAMES[phase], *(_push(cells.get(name)) for name in DIRECTIONS)))
    return rows


def _push(item: CellResult | None) -> str:
    """Survived of the bound, and the share of it; ``>`` where the end of the ladder was survived."""
    if item is None or not item.levels:
        return ABSENT
    survived = f"{'> ' if item.complete else ''}{item.survived or 0.0:.2f}"
    if item.bound is None or item.share is None:
        return survived
    return f"{survived} of {item.bound:.2f} ({100.0 * item.share:.0f} %)"


def other_rows(found: Robustness) -> list[tuple[str, ...]]:
    """Rows of :data:`OTHER_HEADER`."""
    return [_other(item) for item in found.others]


def _other(item: CellResult) -> tuple[str, ...]:
    angle = item.cell.key.endswith(("slope_along", "slope_across"))
    unit, scale = ("degrees", 180.0 / math.pi) if angle else (item.cell.unit, 1.0)

    def shown(value: float | None) -> str:
        return "none" if value is None else f"{scale * value:.4g}"

    zmp = ABSENT if math.isnan(item.zmp[0]) else ", ".join(f"{1e3 * value:.1f}" for value in item.zmp)
    more = " (all tried)" if item.complete else ""
    cause = item.cause.partition("; ")[0].partition(" at ")[0]
    return item.cell.name, unit, shown(item.survived) + more, shown(item.within), zmp, cause


def title(found: Robustness) -> str:
    """Gait, body, controller and the rule."""
    least = f"{math.ceil(0.8 * found.replicas - 1e-9)} of {found.replicas}"
    return f"{found.gait}, body {found.body}, controller {found.controller}: survived by {least} walks"


def markdown(found: Robustness) -> str:
    """The tables of a study."""
    parts = [f"# Robustness of {title(found)}\n"]
    if found.pushes:
        table = markdown_table(PUSH_HEADER, push_rows(found))
        parts.append(f"Pushes of 0.1 s, survived with all smaller ones.\n\n{table}\n")
    if found.others:
        parts.append(markdown_table(OTHER_HEADER, other_rows(found)) + "\n")
    return "\n".join(parts)
