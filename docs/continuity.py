"""Walk the comparisons of docs/paper.md on continuity again; rewrite its picture and data/continuity.csv.

    python docs/continuity.py
Four times ``ampm compare --quick`` with eight walks in all: about two minutes.
"""

import csv
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ampm.geometry import Array
from ampm.run_file import dump_run, load_run
from validation.cli.console import Narrator
from validation.store.saved import SavedRun, load_saved_run
from validation.study.compare.comparison import WalkComparison
from validation.study.compare.metrics import switch_rows
from validation.study.compare.walks import compare_walks

HERE = Path(__file__).parent
PICTURE = HERE / "images" / "continuity.png"
DATA = HERE / "data" / "continuity.csv"
FASTER = "gait.switching_velocity=1.0808"
"""The plain pendulum slows down more over the foot: this v0 gives it the normal gait's mean speed."""
RESTING = "gait.a_s=inf"
"""On flat feet the ZMP rests in single support, so that both models differ in double support alone."""
REACH = 0.1
"""Time that the picture shows on either side of a switch [s]."""
COLOURS = ("#0072b2", "#d55e00", "#5b6270")
"""Of both sides and of the plan."""
SWITCHES = ("single to double support", "double to single support")
CURVES = (
    "COM acceleration x\n[m/s²]",
    "ZMP error x\n[mm]",
    "ZMP error y, to\nthe stance foot [mm]",
    "torque rate\n[N m/ms]",
)


def main() -> None:
    """Walk all pairs, and rewrite the values and the picture of the page."""
    with tempfile.TemporaryDirectory() as folder:

        def gait(name: str, preset: str, *settings: str, like: str) -> str:
            """A preset with the controller of another one."""
            path, run = Path(folder) / f"{name}.toml", load_run(preset, settings)
            run = run.model_copy(update={"controller": load_run(like).controller})
            path.write_text(dump_run(run), encoding="utf-8")
            return str(path)

        gaits = [
            ("normal", gait("ipm-gentle", "ipm", like="normal")),
            (gait("normal-quick", "normal", like="ipm"), "ipm"),
            ("normal", gait("ipm-faster", "ipm", FASTER, like="ipm")),
            (
                gait("flat-quick", "flat", RESTING, like="ipm"),
                gait("flat-ipm", "flat", RESTING, "gait.planner=lipm", like="ipm"),
            ),
        ]
        pairs = [
            compare_walks(both, half_step=False, folder=Path(folder) / str(number), progress=Narrator())
            for number, both in enumerate(gaits)
        ]
        draw(pairs[1]).savefig(PICTURE, dpi=110)
        with DATA.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file).writerows(table(pairs))


def table(pairs: list[WalkComparison]) -> Iterator[tuple[str, ...]]:
    """Header, outcome, mean speed, and all quantities of all pairs: group, name, unit, values."""
    sides = [side for pair in pairs for side in pair.sides]
    yield ("group", "quantity", "unit", *(side.label for side in sides))
    yield ("gait", "outcome", "", *(side.outcome for side in sides))
    yield ("gait", "mean speed", "m/s", *(f"{mean_speed(load_saved_run(side.folder)):.3f}" for side in sides))
    for same in zip(*(pair.rows for pair in pairs), strict=True):
        cells = [pair.cells(row) for pair, row in zip(pairs, same, strict=True)]
        yield (same[0].of.group, cells[0][0], cells[0][3], *(value for row in cells for value in row[1:3]))


def mean_speed(run: SavedRun) -> float:
    """Speed of the planned COM from the second step to the last switch [m/s]."""
    rows = switch_rows(run.signals)[::2]
    x, time = run.signals["plan_com_x"][rows], run.signals.time[rows]
    return float((x[-1] - x[0]) / (time[-1] - time[0]))


def draw(pair: WalkComparison) -> Figure:
    """Acceleration, ZMP error and torque rate about both kinds of switch, of both sides."""
    figure = Figure(figsize=(10.4, 8.6), facecolor="white")
    axes = figure.subplots(len(CURVES), 2, sharex=True, sharey="row")
    figure.subplots_adjust(left=0.09, right=0.985, top=0.92, bottom=0.06, hspace=0.16, wspace=0.06)
    *both, ink = COLOURS
    handles = []
    for side, colour in zip(pair.sides, both, strict=True):
        run = load_saved_run(side.folder)
        for kind in (0, 1):
            for axis, (time, values, planned) in zip(axes[:, kind], curves(run, kind), strict=True):
                low, median, high = (f(values, axis=0) for f in (np.nanmin, np.nanmedian, np.nanmax))
                axis.fill_between(time, low, high, color=colour, alpha=0.22, linewidth=0)
                axis.plot(time, median, color=colour, linewidth=1.4)
                if planned is not None:
                    axis.plot(time, np.median(planned, axis=0), color=colour, lw=1.1, ls=(0, (4, 2)))
        handles += axes[0, 0].plot([], [], color=colour, label=side.label)
    for axis in axes.flat:
        axis.axvline(0.0, color=ink, linewidth=0.8)
        axis.set_xlim(-1e3 * REACH, 1e3 * REACH)
        axis.set_xticks(np.arange(-75, 76, 25))
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(linewidth=0.4, alpha=0.5)
    for first, last, title in zip(axes[0], axes[-1], SWITCHES, strict=True):
        first.set_title(title)
        last.set_xlabel("time from the switch [ms]")
    for axis, label in zip(axes[:, 0], CURVES, strict=True):
        axis.set_ylabel(label)
    figure.align_ylabels(axes[:, 0])
    handles += axes[0, 0].plot([], [], color=ink, linestyle=(0, (4, 2)), label="plan")
    figure.legend(handles=handles, loc="upper right", ncols=3, bbox_to_anchor=(0.985, 0.995))
    return figure


def curves(run: SavedRun, kind: int) -> Iterator[tuple[Array, Array, Array | None]]:
    """Curves about all switches of one kind but those of the first step, in the order of the picture.

    Yields:
        Time from the switch, shape (n,) [ms]; measured values, one row per switch; planned ones, or None.
    """
    signals, record = run.signals, run.record
    time, steps = signals.time, run.signal_steps
    dt = int(steps[1] - steps[0]) * record.time_step
    reach = round(REACH / dt)
    rows = switch_rows(signals)[
        1 - kind :: 2
    ]  # the first of them begins the single support of the second step
    rows = rows[(rows >= reach) & (rows < len(time) - reach)]
    offset = np.arange(-reach, reach + 1)
    about = rows[:, None] + offset
    at = 1e3 * offset * dt
    error = 1e3 * (signals.vector("measured_zmp", "xy") - signals.vector("plan_zmp", "xy"))
    torque = record.torque_at(steps)
    rate = np.abs(np.diff(torque, axis=0, append=torque[-1:])).max(axis=1) / dt
    # Towards the foot that stood: the right foot's switches are the left's, mirrored.
    sign = np.where(np.arange(1, len(rows) + 1) % 2 == 0, 1.0, -1.0)[:, None]
    yield at, signals["measured_force_x"][about] / record.mass, signals["plan_force_x"][about] / record.mass
    yield at, error[about, 0], None
    yield at, sign * error[about, 1], None
    yield at, rate[about] / 1e3, None


if __name__ == "__main__":
    sys.exit(main())
