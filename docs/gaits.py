"""Walk the gaits of docs/gaits.md again: ``python docs/gaits.py`` writes docs/data/gaits.csv.

Every row is one trial, about eight seconds; the two long walks take a minute each. ``python docs/gaits.py
unseen`` finds and walks the gaits of docs/examples/unseen.toml instead, and writes docs/data/unseen.csv;
``campaign`` does so for docs/examples/campaign.toml.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

from trials import AGREEMENT, agreement, ending, walk, write_rows

import ampm
from validation.run.walk import walk_planned
from validation.study.sweep.design import SweepDefinition, load_sweep
from validation.trial.plan import Request, tune_walk

COLUMNS = (
    "steps",
    "gait",
    *AGREEMENT,
    "verdict",
    "feedback on the ZMP x, y [mm]",
    "feedback on F x, y, z [% weight]",
    "torque [% of limit]",
    "friction of 0.8",
    "slip [mm]",
    "knee [rad]",
    "QPs with limits, unsolved",
)
ONE_BY_ONE = [f"gait.c_y={value}" for value in (0.2, 0.4, 0.7, 1.2)]
ONE_BY_ONE += [f"gait.c_s={value}" for value in (0.8, 1.2, 1.4)]


DRAWN = {
    "gait.step_length": "step [m]",
    "gait.switching_velocity": "v0 [m/s]",
    "gait.c_y": "c_y",
    "gait.c_s": "c_s",
    "body.height": "body [m]",
    "body.mass": "body [kg]",
}
FOUND = ("outcome", "ZMP RMSE x, y [mm]", "QPs unsolved", "least margin", "to find [s of CPU]", "certificate")


def main() -> None:
    """Walk every gait and rewrite the table."""
    rows = [_row(30, gait) for gait in ("normal", "momentum", "flat")]
    rows += [_row(30, "normal", setting) for setting in ONE_BY_ONE]
    rows += [_row(200, gait) for gait in ("normal", "momentum")]
    write_rows("gaits", [COLUMNS, *rows])


def _row(steps: int, gait: str, *settings: str) -> tuple[str, ...]:
    """Agreement and cost of a gait."""
    trial = walk(gait, [*settings, f"gait.steps={steps}"])
    if isinstance(trial, Exception):
        raise trial
    summary = trial.summary
    margins, effort, solver = summary["margins"], summary["effort"], summary["solver"]
    weight = summary["scales"]["body_weight"]
    return (
        str(steps),
        *(settings or [gait]),
        *agreement(summary["metrics"]),
        ending(summary),
        ", ".join(f"{1e3 * value:.2f}" for value in effort["zmp"]),
        ", ".join(f"{100 * value / weight:.2f}" for value in effort["force"]),
        f"{100 * margins['torque']['value']:.0f}",
        f"{margins['friction']['value']:.2f}",
        f"{1e3 * summary['metrics']['slip_maximum']['value']:.1f}",
        f"{margins['knee']['value']:.2f}",
        f"{solver['solved_with_limits']}, {solver['unsolved']}",
    )


def walk_draw(name: str) -> None:
    """Find and walk every gait of a draw and rewrite its table."""
    draw = load_sweep(Path(__file__).parent / "examples" / f"{name}.toml")
    write_rows(name, [("gait", *DRAWN.values(), *FOUND), *(_drawn(draw, run) for run in range(len(draw)))])


def _drawn(draw: SweepDefinition, number: int) -> tuple[str, ...]:
    """A gait of the draw, and what came of it."""
    run, start = draw.parameters(number), time.process_time()
    row = (str(number), *(f"{run.value(key):.3f}" for key in DRAWN))
    try:
        planned = tune_walk(Request(str(number), run))
    except ampm.AmpmError as refusal:
        row += ("refused", "", "", "", f"{time.process_time() - start:.1f}", str(refusal))
    else:
        seconds = f"{time.process_time() - start:.1f}"
        summary = walk_planned(planned).summary
        rmse, *_ = agreement(summary["metrics"]) if summary["outcome"] == "completed" else ("",)
        unsolved = str(summary["solver"]["unsolved"])
        row += (summary["outcome"], rmse, unsolved, f"{planned.tuned.worst():.2f}", seconds, "")
    print(*row, file=sys.stderr, flush=True)  # noqa: T201
    return row


if __name__ == "__main__":
    walk_draw(sys.argv[1]) if sys.argv[1:] else main()
