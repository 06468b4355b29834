"""Walk the league in MuJoCo and Drake; rewrite data/league.csv, and tables and picture of docs/league.md.

    python docs/league.py [page]

Two hours on two idle cores. Finished walks are kept in build/league, so a stopped league goes on. With
``page`` nothing is walked: tables and picture are made from the data. Needs the extras ``drake`` and
``robots``.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from figures import save_figure, style
from matplotlib.figure import Figure
from trials import read_rows, write_rows

import validation as val
from benchmarks.page import replace_between
from validation.cli.console import Narrator
from validation.study.rank import Ranking
from validation.study.sweep.design import ENGINE_KEY, Block, SweepDefinition, load_sweep
from validation.table import ABSENT, Table, format_number

PAGE = Path(__file__).with_suffix(".md")
PICTURE = PAGE.parent / "images" / "league.png"
ROOT = PAGE.parents[1]
KEPT = ROOT / "build" / "league"
LEAGUE = "examples/league/league.toml"
ENGINES = ("mujoco", "drake")
REPLICAS = 4
"""In each engine: a push comes at every phase once."""
TABLES = {"league": False, "league-pushed": True}
"""Tables of the page, and whether their tasks are pushed."""
LIKE_NORMAL = ("slow", "turn", "stop", "stairs")
"""Tasks that the page leaves out: the data file has them."""
COLUMNS = (
    "task",
    "planner",
    "rank",
    "error 0.1 s ahead [mm]",
    "survived",
    "walks",
    "survival, 95 % [%]",
    "cost of transport",
    "notes",
)

Row = Mapping[str, str]


def main() -> None:
    """Walk what is missing, write the data, and from the data page and picture."""
    if sys.argv[1:] != ["page"]:
        os.chdir(ROOT)  # the planners are examples.planners
        val.sweep(league(), out=KEPT, resume=KEPT.exists(), progress=Narrator())
        write_rows("league", [COLUMNS, *rows_of(val.rank(KEPT))])
    found = read_rows("league")
    page = PAGE.read_text(encoding="utf-8")
    for name, pushed in TABLES.items():
        page = replace_between(page, name, overview(found, pushed=pushed).markdown())
    PAGE.write_text(page, encoding="utf-8")
    draw(found, PICTURE)


def league() -> SweepDefinition:
    """The league in both engines, with fewer replicas in each."""
    definition = load_sweep(LEAGUE)
    fields = {name: getattr(definition, name) for name in SweepDefinition.model_fields}
    planners, replicas = definition.vary
    fewer = {key: values[:REPLICAS] for key, values in replicas.keys.items()}
    engines = Block(method="list", count=None, keys={ENGINE_KEY: ENGINES})
    vary = planners, engines, Block(method="list", count=None, keys=fewer)
    return SweepDefinition(**{**fields, "vary": vary})


def rows_of(ranking: Ranking) -> list[tuple[str, ...]]:
    """Data of every cell."""
    return [
        (
            cell.task,
            cell.name,
            str(ranking.ranks.get((cell.task, cell.name), "")),
            format_number(1e3 * cell.error, 3),
            str(cell.survived),
            str(cell.runs),
            "{:.0f}–{:.0f}".format(*(100.0 * end for end in cell.interval())) if cell.runs else "",
            format_number(cell.effort, 3),
            "; ".join(cell.notes),
        )
        for cell in ranking.cells
    ]


def overview(rows: Sequence[Row], *, pushed: bool) -> Table:
    """Rank, error and survival of every planner in every task with a push, or without."""
    tasks, planners = (list(dict.fromkeys(row[name] for row in rows)) for name in ("task", "planner"))
    tasks = [task for task in tasks if task.startswith("push") == pushed and task not in LIKE_NORMAL]
    cells = {(row["planner"], row["task"]): row for row in rows}

    def text(row: Row) -> str:
        if not row["rank"]:
            return ABSENT
        lost = "" if row["survived"] == row["walks"] else f", {row['survived']} of {row['walks']}"
        return f"**{row['rank']}** ({row[COLUMNS[3]]}{lost})"

    body = [(planner, *(text(cells[planner, task]) for task in tasks)) for planner in planners]
    return Table("", ("planner", *tasks), body)


@style()
def draw(rows: Sequence[Row], path: Path) -> None:
    """Error against effort; the size of a mark is the survival."""
    tasks = list(dict.fromkeys(row["task"] for row in rows))
    columns = 5
    figure = Figure(figsize=(10.0, 7.0), dpi=110, layout="constrained")
    plots = figure.subplots(-(-len(tasks) // columns), columns, sharex=True, sharey=True).ravel()
    planners = dict.fromkeys(row["planner"] for row in rows)
    looks = {
        name: {"marker": marker, "facecolors": "none", "edgecolors": f"C{k}", "linewidths": 1.6}
        for k, (name, marker) in enumerate(zip(planners, "osD^vPXh<>pd*8", strict=False))
    }
    for axes, task in zip(plots, tasks, strict=False):
        for row in rows:
            if row["task"] == task and row["survived"] not in ("", "0"):
                share = int(row["survived"]) / int(row["walks"])
                axes.scatter(
                    float(row["cost of transport"]),
                    float(row[COLUMNS[3]]),
                    s=90.0 * share,
                    **looks[row["planner"]],
                )
        axes.set(title=task, yscale="log", xmargin=0.1, ymargin=0.1)
    for axes in plots[len(tasks) :]:
        axes.set_axis_off()
    for axes in plots[len(tasks) - columns : len(tasks)]:
        axes.set_xlabel("cost of transport [1]")
        axes.tick_params(labelbottom=True)
    for axes in plots[::columns]:
        axes.set_ylabel("ZMP error, 0.1 s ahead [mm]")
    handles = [plots[0].scatter([], [], s=90.0, **look) for look in looks.values()]
    said = "area of a mark: share of the walks that survived"
    figure.legend(handles, list(looks), loc="outside lower center", ncols=-(-len(looks) // 2), title=said)
    save_figure(figure, path)


if __name__ == "__main__":
    main()
