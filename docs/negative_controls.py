"""Walk plans that are wrong on purpose; rewrite the table of docs/negative-controls.md and its data.

    python docs/negative_controls.py
docs/data/negative-controls.csv has one row for every trial of thirty steps, about ten minutes in all.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from trials import write_rows

import ampm
import validation as val
from ampm.body.robot import Robot
from ampm.parameters import RunParameters
from ampm.planner.pendulum import AffineLaw
from ampm.planner.table import plan_table, sample_times
from ampm.walk import Planner, WalkPlan
from benchmarks.page import replace_between
from validation.table import Table

PAGE = Path(__file__).with_name("negative-controls.md")
STEPS = 30
ROWS = 200.0
"""Rows of a table [Hz]."""
COLUMNS = (
    "falsehood",
    "gait",
    "size",
    "unit",
    "outcome",
    "steps completed",
    "verdict",
    "ZMP RMSE x [mm]",
    "ZMP RMSE y [mm]",
    "what the trial says",
)


class FalsePlanner:
    """The paper's plan with its periodic motion, of which the plan alone is then changed.

    Args:
        change: the false plan, from the right one and the run.
    """

    def __init__(self, change: Callable[[WalkPlan, RunParameters], WalkPlan]) -> None:
        self.change = change

    def plan(self, run: RunParameters, robot: Robot) -> WalkPlan:
        """Plan a walk."""
        return self.change(ampm.PeriodicPlanner().plan(run, robot), run)


def sampled(run: RunParameters, rate: float = ROWS) -> dict[str, Any]:
    """Columns of the right plan at a rate [Hz]."""
    plan = ampm.plan(run)
    return plan_table(plan, sample_times(plan.duration, rate))


def shifted_zmp(run: RunParameters, millimetres: float) -> ampm.TablePlanner:
    """A table whose ZMP lies ahead of its place; COM and acceleration are right."""
    table = sampled(run)
    return ampm.TablePlanner(table | {"zmp_x": table["zmp_x"] + 1e-3 * millimetres})


def shifted_zmp_alone(run: RunParameters, millimetres: float) -> Planner:
    """The same without accelerations, which then follow from COM and ZMP."""
    table = shifted_zmp(run, millimetres).table
    return ampm.TablePlanner({name: values for name, values in table.items() if "acceleration" not in name})


def coarse_table(run: RunParameters, rate: float) -> Planner:
    """A table of the right plan with few rows."""
    return ampm.TablePlanner(sampled(run, rate))


def wrong_constant(run: RunParameters, change: float) -> Planner:
    """Another constant of L_y than that of the periodic motion."""

    def changed(plan: WalkPlan, run: RunParameters) -> WalkPlan:
        offset = plan.constants.angular_momentum_y_offset
        return plan.with_angular_momentum_offset(offset + change)

    return FalsePlanner(changed)


def other_mass(run: RunParameters, percent: float) -> Planner:
    """The plan of a heavier body."""

    def changed(plan: WalkPlan, run: RunParameters) -> WalkPlan:
        heavier = ampm.plan(run.replace({"body.mass": plan.mass * (1.0 + 0.01 * percent)}))
        return replace(plan, mass=heavier.mass, phases=heavier.phases)

    return FalsePlanner(changed)


def other_c_y(run: RunParameters, percent: float) -> Planner:
    """The plan of another c_y; the whole-body motion is that of the gait's own."""

    def changed(plan: WalkPlan, run: RunParameters) -> WalkPlan:
        other = run.replace({"gait.c_y": run.gait.c_y * (1.0 + 0.01 * percent)})
        return replace(plan, phases=ampm.plan(other).phases)

    return FalsePlanner(changed)


def false_moment(run: RunParameters, percent: float) -> Planner:
    """The moment about the COM of another c_y; COM and ZMP are right."""
    c_y = run.gait.c_y
    factor = (c_y * (1.0 + 0.01 * percent) - 1.0) / (c_y - 1.0)

    def changed(plan: WalkPlan, run: RunParameters) -> WalkPlan:
        phases = [
            phase._replace(
                y=replace(phase.y, force_slope=1.0 + factor * (phase.y.force_slope - 1.0)),
                angular_momentum=(factor * phase.angular_momentum[0], phase.angular_momentum[1]),
            )
            for phase in plan.phases
        ]
        return replace(plan, phases=tuple(phases))

    return FalsePlanner(changed)


def in_double_support(
    change: Callable[[WalkPlan, AffineLaw, AffineLaw], tuple[AffineLaw, AffineLaw]],
) -> Planner:
    """A planner with other laws in double support, made from the plan and its laws along both axes."""

    def changed(plan: WalkPlan, run: RunParameters) -> WalkPlan:
        phases = list(plan.phases)
        for k in range(1, len(phases), 2):
            x, y = change(plan, phases[k].x, phases[k].y)
            phases[k] = phases[k]._replace(x=x, y=y)
        return replace(plan, phases=tuple(phases))

    return FalsePlanner(changed)


def from_switch(law: AffineLaw, position: float, velocity: float) -> AffineLaw:
    """The law's oscillation that begins in a state [m, m/s] at the switch to double support."""
    k = math.sqrt(-law.rate)
    cosine, sine = math.cos(0.5 * k * law.duration), math.sin(0.5 * k * law.duration)
    even, odd = position * cosine + velocity / k * sine, velocity / k * cosine - position * sine
    return replace(law, even=even, odd=odd)


def erratum_4(run: RunParameters, _: float) -> Planner:
    """c_d of the printed Eq. 4: ``l_s/c_s + l_d/c_d = l_s + l_d``."""

    def changed(plan: WalkPlan, x: AffineLaw, y: AffineLaw) -> tuple[AffineLaw, AffineLaw]:
        l_s, l_d = plan.constants.l_s, plan.constants.l_d
        c_d = l_d / (l_s + l_d - l_s / run.gait.c_s)
        rate = plan.gravity / plan.com_height * (c_d - x.zmp_slope)
        return from_switch(replace(x, rate=rate, force_slope=c_d), -l_d, plan.switching_velocity), y

    return in_double_support(changed)


def erratum_6(run: RunParameters, _: float) -> Planner:
    """v_ex before the sine of double support, as if it were the velocity there."""

    def changed(plan: WalkPlan, x: AffineLaw, y: AffineLaw) -> tuple[AffineLaw, AffineLaw]:
        start = y.evaluate(0.0)
        faster = math.sqrt(plan.constants.s / plan.constants.beta)
        return x, from_switch(y, float(start.position), faster * float(start.velocity))

    return in_double_support(changed)


def erratum_7(run: RunParameters, _: float) -> Planner:
    """The inverted slope of the lateral ZMP, ``z_y = beta/(beta + s) y``; the COM is right."""

    def changed(plan: WalkPlan, x: AffineLaw, y: AffineLaw) -> tuple[AffineLaw, AffineLaw]:
        return x, replace(y, zmp_slope=1.0 / y.zmp_slope)

    return in_double_support(changed)


class Kind(NamedTuple):
    """One kind of falsehood.

    Attributes:
        name: for tables.
        unit: of the sizes, empty for an erratum.
        planner: makes the false plan of a run, from the size.
        sizes: that are walked, from right to most wrong.
        gait: preset.
        settings: of the gait, ``key=value``.
    """

    name: str
    unit: str
    planner: Callable[[RunParameters, float], Planner]
    sizes: Sequence[float] = (1.0,)
    gait: str = "normal"
    settings: Sequence[str] = ()


KINDS = (
    Kind("ZMP ahead", "mm", shifted_zmp, (0, 0.01, 0.02, 0.03, 0.05, 0.1, 0.2, 0.5, 1, 2, 3, 5)),
    Kind("ZMP ahead, no accelerations", "mm", shifted_zmp_alone, (0, 0.1, 0.15, 0.2, 0.5, 1, 2, 5)),
    Kind("constant of L_y", "N m s", wrong_constant, (0, 0.1, 0.14, 0.15, 0.2, 0.5, 1, 2)),
    Kind("mass", "%", other_mass, (0, 0.5, 0.9, 1, 2, 5)),
    Kind("c_y of the plan", "%", other_c_y, (0, 5, 10, 14, 15, 20, 30), "momentum"),
    Kind("c_y of the moment", "%", false_moment, (0, 2, 5, 6, 10, 20), "momentum"),
    Kind("E4", "", erratum_4, gait="momentum"),
    Kind("E4, c_s 1.4", "", erratum_4, settings=("gait.c_s=1.4",)),
    Kind("E6", "", erratum_6, gait="momentum"),
    Kind("E7", "", erratum_7, gait="momentum"),
    Kind("rows of a table", "Hz", coarse_table, (200, 100, 50, 40, 30, 20, 10, 5)),
)


def main() -> None:
    """Walk every size of every kind, and rewrite data and table."""
    kinds = [list(trials(kind)) for kind in KINDS]
    write_rows("negative-controls", [COLUMNS, *(row for rows in kinds for row in rows)])
    table = Table(
        "",
        ("wrong", ">passes at", ">fails at", "what the trial then says"),
        [summary(rows) for rows in kinds],
    )
    page = replace_between(PAGE.read_text(encoding="utf-8"), "controls", table.markdown())
    PAGE.write_text(page, encoding="utf-8")


def trials(kind: Kind) -> Iterator[tuple[str, ...]]:
    """One row of the data for every size."""
    run = ampm.load_run(kind.gait, kind.settings, gait={"steps": STEPS}).as_is()
    for size in kind.sizes:
        shown = f"{size:g}" if kind.unit else "as printed"
        name = (kind.name, ", ".join([kind.gait, *kind.settings]), shown, kind.unit)
        print(*name, file=sys.stderr, flush=True)  # noqa: T201
        try:
            trial = val.walk(run, planner=kind.planner(run, size)).judged("default")
        except ampm.AmpmError as refusal:
            yield (*name, "refused", "", "", "", "", str(refusal))
            continue
        reason = trial.verdict.reason
        outcome, errors = trial.record.outcome, (trial.metrics[f"zmp_{axis}_rmse"].value for axis in "xy")
        yield (
            *name,
            outcome.name,
            str(outcome.steps_completed),
            trial.verdict.name,
            *(f"{1e3 * value:.2f}" for value in errors),
            reason.partition("; the ")[2] if outcome.completed else reason,
        )


def summary(rows: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """Largest size up to which all pass, the next one, and what its trial says."""
    failed = next((k for k, row in enumerate(rows) if row[6] != "pass"), len(rows))
    passes = " ".join(rows[failed - 1][2:4]).strip() if failed else ""
    name = rows[0][0]
    if failed == len(rows):
        return name, passes, "", ""
    *_, outcome, steps, _, _, _, says = row = rows[failed]
    if outcome == "refused":
        said = says.removeprefix("the planner FalsePlanner failed (ValueError: ")
        said = f"refused: {said.partition(':')[0].partition(', more')[0]}"
    elif outcome == "fell":
        said = f"fell after {steps} steps"
    else:
        said = says.removeprefix("furthest is ").partition(", limit")[0]
    return name, passes, " ".join(row[2:4]).strip(), said


if __name__ == "__main__":
    main()
