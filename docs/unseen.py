"""Walk gaits that nobody tuned; rewrite the tables and picture of docs/unseen.md, and data/unseen.csv.

    python docs/unseen.py [page | DRAW ...]

An hour of one core for all draws. Named draws alone are walked, and replace their rows. Finished walks are
kept in build/unseen, so a draw that was stopped goes on. With ``page`` nothing is walked: tables and picture
are made from the data. Needs the extras ``drake`` and ``robots``.
"""

import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from figures import save_figure, style
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from trials import read_rows, write_rows

import validation as val
from benchmarks.page import replace_between
from validation.cli.console import Narrator
from validation.study.sweep.design import Block, SweepDefinition, load_sweep
from validation.study.sweep.table import RunState, SweepTable
from validation.table import Table, format_number, short_unit

PAGE = Path(__file__).with_suffix(".md")
PICTURE = PAGE.parent / "images" / "unseen.png"
EXAMPLES = PAGE.parent / "examples"
KEPT = PAGE.parents[1] / "build" / "unseen"
SENSED = {
    "sensors.delay": 0.002,  # [s]
    "sensors.angle_noise": 1e-4,  # [rad]
    "sensors.rate_noise": 1e-2,  # [rad/s]
}
"""Late and noisy sensing."""
ESTIMATED = {**SENSED, "sensors.estimator": "kalman", "sensors.fix_rate": 100.0}  # [Hz]
"""The same readings through the filter, with fixes of the position, so that the same profile judges."""
IN_BOTH = 20
"""Gaits of the human that Drake walks, too: the first ones."""
HUMAN, DRAKE, HUMAN_ESTIMATED, G1, G1_ESTIMATED, TALOS = DRAWS = (
    "human",
    "Drake",
    "human, Kalman",
    "G1",
    "G1, Kalman",
    "TALOS",
)
HUMAN_FIRST = f"human, the first {IN_BOTH}"
DRAWN = {
    "gait.step_length": "step [m]",
    "gait.switching_velocity": "v0 [m/s]",
    "gait.c_y": "c_y",
    "gait.c_s": "c_s",
    "body.height": "body [m]",
    "body.mass": "body [kg]",
}
ERRORS = {"zmp_x_rmse": "ZMP RMSE x [mm]", "zmp_y_rmse": "ZMP RMSE y [mm]"}
SHARES = {"zmp_x_rmse": "ZMP RMSE x [limit]", "zmp_y_rmse": "ZMP RMSE y [limit]"}
"""The same over their limits, which grow with the foot [1]."""
OUTCOME, FAILED, REASON = "outcome", "what failed", "refused because of"
COLUMNS = (
    "draw",
    "gait",
    *DRAWN.values(),
    OUTCOME,
    *ERRORS.values(),
    *SHARES.values(),
    FAILED,
    REASON,
    "sentence",
)
QUANTILES = (0.5, 0.9, 1.0)
BINS = np.geomspace(1 / 12, 12.0, 27)
TICKS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
"""Of the picture [limit]."""

Row = Mapping[str, str]


def main() -> None:
    """Walk what is missing, write the data, and from the data page and picture."""
    names = sys.argv[1:] or DRAWS
    if names != ["page"]:
        kept, sweeps = [row for row in read_rows("unseen") if row["draw"] in DRAWS], draws()
        for name in names:
            kept = [row for row in kept if row["draw"] != name] + list(walked(name, sweeps[name]))
        kept.sort(key=lambda row: DRAWS.index(row["draw"]))
        write_rows("unseen", [COLUMNS, *(tuple(row[column] for column in COLUMNS) for row in kept)])
    found = read_rows("unseen")
    page = PAGE.read_text(encoding="utf-8")
    parts = {
        "outcomes": outcomes(found).markdown(),
        "refusals": refusals(found).markdown(),
    }
    for name, part in parts.items():
        page = replace_between(page, name, part)
    PAGE.write_text(page, encoding="utf-8")
    draw_histograms(found, PICTURE)


def draws() -> dict[str, SweepDefinition]:
    """The sweeps, by name."""
    names = "unseen", "unseen-g1", "unseen-talos"
    human, g1, talos = (load_sweep(EXAMPLES / f"{name}.toml") for name in names)
    first = [human.varied(run) for run in range(IN_BOTH)]
    block = Block(method="list", keys={key: tuple(gait[key] for gait in first) for key in human.keys})
    return {
        HUMAN: human,
        DRAKE: changed(human, {"simulation.engine": "drake"}, vary=(block,)),
        HUMAN_ESTIMATED: changed(human, ESTIMATED),
        G1: g1,
        G1_ESTIMATED: changed(g1, ESTIMATED),
        TALOS: talos,
    }


def changed(draw: SweepDefinition, settings: Mapping[str, Any], **fields: Any) -> SweepDefinition:
    """The same draw with other settings for all gaits, and other fields."""
    same = {name: getattr(draw, name) for name in SweepDefinition.model_fields}
    return SweepDefinition(**{**same, "set": {**draw.set, **settings}, **fields})


# ----------------------------------------------------------------------------------------------- data


def walked(name: str, draw: SweepDefinition) -> Iterator[Row]:
    """A row of the data for every gait."""
    folder = KEPT / name.replace(", ", "-").replace(" ", "-")
    table = val.sweep(draw, out=folder, workers=1, resume=True, progress=Narrator())
    drawn = {title: table.numbers(key) for key, title in DRAWN.items() if key in draw.keys}
    zmp = {title: table.shown(metric)[0] for metric, title in ERRORS.items()}
    zmp |= {title: table.used(metric) for metric, title in SHARES.items()}
    for row in range(len(table)):
        yield {
            **dict.fromkeys(COLUMNS, ""),
            "draw": name,
            "gait": str(row),
            **{title: f"{values[row]:.3f}" for title, values in drawn.items()},
            **{title: f"{values[row]:.3f}" for title, values in zmp.items() if np.isfinite(values[row])},
            OUTCOME: table.states[row].label,
            FAILED: "; ".join(what_failed(table, row)),
            REASON: table.words("reason")[row].replace("_", " "),
            "sentence": table.words("cause")[row],
        }


def what_failed(table: SweepTable, row: int) -> Iterator[str]:
    """What a gait exceeded, with its limit, the furthest first."""
    failed = [name for name in table.words("failed")[row].split(",") if name]
    for metric in sorted(failed, key=lambda metric: -table.used(metric)[row]):
        values, limits, unit = table.shown(metric)
        value = f"{format_number(values[row], 3)} {short_unit(unit)}".rstrip(" 1")
        yield f"{metric} {value}, limit {limits[row]:.3g}"


# ----------------------------------------------------------------------------------------------- page


def of_draw(rows: Sequence[Row], name: str) -> list[Row]:
    """Rows of one draw."""
    return [row for row in rows if row["draw"] == name]


def outcomes(rows: Sequence[Row]) -> Table:
    """How many gaits of every draw ended how, and quantiles of the ZMP's errors where they were measured."""
    first = [RunState.REFUSED, RunState.PASS, RunState.OUT_OF_TOLERANCE, RunState.FELL]
    states = first + [state for state in RunState if state not in first and of_state(rows, state)]
    drawn = {name: of_draw(rows, name) for name in DRAWS}
    drawn[HUMAN_FIRST] = drawn[HUMAN][:IN_BOTH]
    body = []
    for name in filter(drawn.get, (HUMAN, HUMAN_FIRST, *DRAWS[1:])):
        counts = [len(of_state(drawn[name], state)) for state in states]
        shown = [quantiles(numbers(drawn[name], title)) for title in ERRORS.values()]
        body.append((name, str(len(drawn[name])), *map(str, counts), *shown))
    columns = ["gaits", *(state.label for state in states), *(f"ZMP {axis} [mm]" for axis in "xy")]
    return Table("", ("draw", *(f">{column}" for column in columns)), body)


def of_state(rows: Sequence[Row], *states: RunState) -> list[Row]:
    """Rows in one of these states."""
    labels = [state.label for state in states]
    return [row for row in rows if row[OUTCOME] in labels]


def numbers(rows: Sequence[Row], column: str) -> list[float]:
    """Numbers of a column, where it has any."""
    return [float(row[column]) for row in rows if row[column]]


def quantiles(values: Sequence[float]) -> str:
    """Median, 90 % quantile and largest of some numbers."""
    return ", ".join(f"{value:.2f}" for value in np.quantile(values, QUANTILES))


def refusals(rows: Sequence[Row]) -> Table:
    """Refused gaits of all bodies by reason; sensing and engine change none."""
    bodies = HUMAN, G1, TALOS
    counts = [Counter(row[REASON] for row in of_draw(rows, name) if row[REASON]) for name in bodies]
    reasons = [reason for reason, _ in sum(counts, Counter()).most_common()]
    return Table(
        "",
        ("refused because of", *(f">{name}" for name in bodies)),
        [(reason, *(str(count[reason]) for count in counts)) for reason in reasons],
    )


class Look(NamedTuple):
    """How a draw is shown: body, label, colour, and whether its bars are filled."""

    body: str
    label: str
    color: str
    filled: bool


LOOKS = {
    HUMAN: Look("human", "MuJoCo, exact sensing", "#1f6fb4", True),
    DRAKE: Look("human", f"Drake, the first {IN_BOTH}", "#2a8c4a", False),
    HUMAN_ESTIMATED: Look("human", "MuJoCo, sensors and Kalman", "#7a3fa0", False),
    G1: Look("G1", "MuJoCo, exact sensing", "#1f6fb4", True),
    G1_ESTIMATED: Look("G1", "MuJoCo, sensors and Kalman", "#7a3fa0", False),
    TALOS: Look("TALOS", "MuJoCo, exact sensing", "#1f6fb4", True),
}


@style()
def draw_histograms(rows: Sequence[Row], path: Path) -> None:
    """Histograms of the ZMP's errors, with their limits."""
    figure = Figure(figsize=(8.0, 6.4), dpi=110, layout="constrained")
    bodies = list(dict.fromkeys(look.body for look in LOOKS.values()))
    plots = figure.subplots(len(bodies), len(ERRORS), sharex=True, sharey="row", squeeze=False)
    for line, body in zip(plots, bodies, strict=True):
        for axes, title in zip(line, SHARES.values(), strict=True):
            for name, look in LOOKS.items():
                if look.body == body:
                    values = numbers(of_draw(rows, name), title)
                    kind = "stepfilled" if look.filled else "step"
                    style = {"color": look.color, "alpha": 0.5 if look.filled else 1.0, "lw": 1.4}
                    axes.hist(values, BINS, histtype=kind, label=look.label, **style)
            axes.axvline(1.0, ls="--", color="#8a93a3", lw=1.2, label="limit")
            axes.set_title(f"{body}: {title.partition(' [')[0]}")
        line[0].set_ylabel("gaits")
        line[0].yaxis.set_major_locator(MaxNLocator(integer=True))
    plots[0, 0].set_xscale("log")
    for axes in plots[-1]:
        axes.set_xlabel("error over its limit [1]")
        axes.set_xticks(TICKS, [f"{tick:g}" for tick in TICKS])
    figure.legend(*plots[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    save_figure(figure, path)


if __name__ == "__main__":
    main()
