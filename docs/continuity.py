"""Walk the comparisons of docs/paper.md on continuity again; rewrite its picture and data/continuity.csv.

    python docs/continuity.py
Seven walks of thirty steps: about two minutes.
"""

import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from trials import write_rows

import validation as val
from ampm.geometry import Array
from ampm.run_file import dump_run, load_run
from validation.cli.console import Narrator
from validation.judge.built_in import rms
from validation.store.saved import SavedRun, load_saved_run

PICTURE = Path(__file__).parent / "images" / "continuity.png"
FASTER = "gait.switching_velocity=1.0808"
"""The plain pendulum slows down more over the foot: this v0 gives it the normal gait's mean speed."""
RESTING = "gait.a_s=inf"
"""On flat feet the ZMP rests in single support, so that both models differ in double support alone."""
REACH = 0.1
"""Time that the picture shows on either side of a switch [s]."""
NEAR = 0.05
"""Half-width of the window about a switch [s]."""
Side = tuple[str, SavedRun]
"""Label and finished run."""
COLOURS = ("#0072b2", "#d55e00", "#5b6270")
"""Of both sides and of the plan."""
SWITCHES = ("single to double support", "double to single support")
CURVES = {
    "COM acceleration x\n[m/s²]": (-3.5, 3.5),
    "ZMP error x\n[mm]": (-40, 60),
    "ZMP error y, to\nthe stance foot [mm]": (-30, 25),
    "torque rate\n[N m/ms]": (0, 25),
}
"""Label and range of each curve; single switches go beyond, and the picture says how far."""


def main() -> None:
    """Walk all pairs, and rewrite the values and the picture of the page."""
    with tempfile.TemporaryDirectory() as folder:

        def walked(label: str, preset: str, *settings: str, like: str) -> Side:
            """A preset with the controller of another one."""
            path, run = Path(folder) / f"{label}.toml", load_run(preset, settings)
            run = run.model_copy(update={"controller": load_run(like).controller})
            path.write_text(dump_run(run), encoding="utf-8")
            trial = val.walk(path, progress=Narrator())
            return label, load_saved_run(trial.save(path.with_suffix(""), recording=False))

        sides = [
            walked("normal", "normal", like="normal"),
            walked("ipm-gentle", "ipm", like="normal"),
            walked("normal-quick", "normal", like="ipm"),
            walked("ipm", "ipm", like="ipm"),
            walked("ipm-faster", "ipm", FASTER, like="ipm"),
            walked("flat-quick", "flat", RESTING, like="ipm"),
            walked("flat-ipm", "flat", RESTING, "gait.planner=lipm", like="ipm"),
        ]
        draw(sides[2:4]).savefig(PICTURE, dpi=110)
        columns = [values(run) for _, run in sides]
        rows = [(name, *(f"{column[name]:.3g}" for column in columns)) for name in columns[0]]
        write_rows("continuity", [("quantity", *(label for label, _ in sides)), *rows])


def values(run: SavedRun) -> dict[str, float]:
    """What the switches of a walk do to it, by name with unit; the first step is left out."""
    signals, record = run.signals, run.record
    time, rows = signals.time, switch_rows(run)
    x, begins = signals["plan_com_x"][rows[::2]], time[rows[::2]]
    acceleration = signals.vector("plan_force", "xy") / record.mass
    zmp = signals.vector("plan_zmp", "xy")
    found = {
        "mean speed [m/s]": (x[-1] - x[0]) / (begins[-1] - begins[0]),
        "planned COM acceleration, jump at a switch [m/s^2]": jump(acceleration, rows),
        "planned ZMP, jump at a switch [mm]": 1e3 * jump(zmp, rows),
    }
    is_near = np.abs(time[:, None] - time[rows]).min(axis=1) <= NEAR
    judged = np.arange(len(time)) >= signals.first_step()
    error = 1e3 * (signals.vector("measured_zmp", "xy") - zmp)
    torque = record.torque_at(run.signal_steps)
    rate = np.diff(torque, axis=0, append=torque[-1:]) / (time[1] - time[0])
    for place, inside in (("within 50 ms", judged & is_near), ("elsewhere", judged & ~is_near)):
        found[f"ZMP, RMS error along x {place} [mm]"] = rms(error[inside, 0])
        found[f"ZMP, RMS error along y {place} [mm]"] = rms(error[inside, 1])
        found[f"torque rate, RMS of all joints {place} [N m/s]"] = rms(rate[inside])
    return found


def jump(values: Array, rows: NDArray[np.intp]) -> float:
    """Largest change of a vector, shape (n, 2), in the time step before one of the rows."""
    return float(np.linalg.norm(values[rows] - values[rows - 1], axis=1).max())


def switch_rows(run: SavedRun) -> NDArray[np.intp]:
    """First row after each planned switch of support, without the switches of the first step."""
    return run.signals.switches()[2:]


def draw(sides: Sequence[Side]) -> Figure:
    """Acceleration, ZMP error and torque rate about both kinds of switch, of both sides."""
    figure = Figure(figsize=(10.4, 8.6), facecolor="white")
    axes = figure.subplots(len(CURVES), 2, sharex=True, sharey="row")
    figure.subplots_adjust(left=0.09, right=0.985, top=0.92, bottom=0.06, hspace=0.16, wspace=0.06)
    *both, ink = COLOURS
    handles = []
    for (label, run), colour in zip(sides, both, strict=True):
        for kind in (0, 1):
            for axis, (time, values, planned) in zip(axes[:, kind], curves(run, kind), strict=True):
                low, median, high = (f(values, axis=0) for f in (np.nanmin, np.nanmedian, np.nanmax))
                axis.fill_between(time, low, high, color=colour, alpha=0.22, linewidth=0)
                axis.plot(time, median, color=colour, linewidth=1.4)
                if planned is not None:
                    axis.plot(time, np.median(planned, axis=0), color=colour, lw=1.1, ls=(0, (4, 2)))
        handles += axes[0, 0].plot([], [], color=colour, label=label)
    for axis in axes.flat:
        axis.axvline(0.0, color=ink, linewidth=0.8)
        axis.set_xlim(-1e3 * REACH, 1e3 * REACH)
        axis.set_xticks(np.arange(-75, 76, 25))
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(linewidth=0.4, alpha=0.5)
    for first, last, title in zip(axes[0], axes[-1], SWITCHES, strict=True):
        first.set_title(title)
        last.set_xlabel("time from the switch [ms]")
    for row, (label, shown) in zip(axes, CURVES.items(), strict=True):
        row[0].set_ylabel(label)
        row[0].set_ylim(*shown)
        for axis in row:
            low, high = axis.dataLim.intervaly
            if low < shown[0] or high > shown[1]:
                said = f"all switches: {low:.3g} to {high:.3g}"
                axis.text(0.88, 0.9, said, transform=axis.transAxes, ha="right", fontsize=8)
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
    rows = switch_rows(run)[1 - kind :: 2]  # the first begins the single support of the second step
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
