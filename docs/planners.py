"""Walk the planners of docs/gaits.md again: ``python docs/planners.py`` writes docs/data/planners.csv.

Every row is one trial of thirty steps of ``normal`` at one speed, with the values of the preset. All planners
have the AMPM's footsteps, times and feet.
"""

from __future__ import annotations

import time

from trials import AGREEMENT, agreement, ending, write_rows

import ampm
import validation as val
from ampm.planner.step_planners import STEP_PLANNERS

SPEEDS = (0.8, 1.0, 1.2)
COLUMNS = (
    "v0 [m/s]",
    "planner",
    "mean speed [m/s]",
    *AGREEMENT,
    "verdict",
    "feedback on the ZMP x, y [mm]",
    "torque [% of limit]",
    "friction of 0.8",
    "cost of transport",
    "largest jump of the acceleration [m/s^2]",
    "to plan COM and feet [ms of CPU]",
)
QUICK = "ipm, quick contacts"
"""The plain pendulum with the controller's settings of its preset, which open and close contacts at once."""


def main() -> None:
    """Walk every planner at every speed and rewrite the table."""
    rows = [_row(speed, name) for speed in SPEEDS for name in ("ampm", "ipm", "preview", "dcm", QUICK)]
    write_rows("planners", [COLUMNS, *rows])


def _row(speed: float, name: str) -> tuple[str, ...]:
    """Agreement and cost of one walk."""
    planner = name.partition(",")[0]
    settings = {"gait": {"switching_velocity": speed}}
    if name == QUICK:
        settings["controller"] = ampm.load_run("ipm").controller.model_dump()
    trial = val.walk(ampm.load_run("normal", **settings).as_is(), planner=planner).judged("default")
    run, plan, summary = trial.planned.run, trial.plan, trial.summary
    start = time.process_time()
    STEP_PLANNERS[planner](run.gait, run.body.mass, run.foot, plan.feet.sole)
    seconds = time.process_time() - start
    margins = summary["margins"]
    return (
        f"{speed:g}",
        name,
        f"{plan.constants.mean_velocity:.3f}",
        *agreement(summary["metrics"]),
        ending(summary),
        ", ".join(f"{1e3 * value:.2f}" for value in summary["effort"]["zmp"]),
        f"{100 * margins['torque']['value']:.0f}",
        f"{margins['friction']['value']:.2f}",
        f"{summary['energy']['cost_of_transport']:.3f}",
        f"{plan.gravity * plan.residuals()['com_acceleration']:.1g}",
        f"{1e3 * seconds:.1f}",
    )


if __name__ == "__main__":
    main()
