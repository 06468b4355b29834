"""Walk the presets at finer time steps: ``python docs/time_step.py`` writes docs/data/time-step.csv.

Thirty steps each. The error of the ZMP is that of the verdict, which compares row k with the plan at t_k, and
that beside the plan in the middle of the interval over which the row's force acts.
"""

import sys
from collections.abc import Iterator
from math import sqrt

import numpy as np
from trials import write_rows

import ampm
import validation as val
from ampm.geometry import Array
from ampm.presets import PRESETS

STEPS = 30
TIME_STEPS = (0.5e-3, 0.25e-3)
FINEST = 0.125e-3
"""Time step of ``normal`` and ``momentum`` alone [s]."""
COLUMNS = (
    "preset",
    "time step [ms]",
    "ZMP RMSE x [mm]",
    "ZMP RMSE y [mm]",
    "maximum x [mm]",
    "maximum y [mm]",
    "RMSE x, middle [mm]",
    "RMSE y, middle [mm]",
    "maximum x, middle [mm]",
    "maximum y, middle [mm]",
)


def main() -> None:
    """Walk every preset at every time step, and rewrite the table."""
    rows = [(name, *row) for name in PRESETS for row in walked(name)]
    write_rows("time-step", [COLUMNS, *rows])


def walked(name: str) -> Iterator[tuple[str, ...]]:
    """Time step and errors of one preset."""
    for step in (*TIME_STEPS, *((FINEST,) if name in ("normal", "momentum") else ())):
        run = ampm.load_run(name, gait={"steps": STEPS}, simulation={"time_step": step})
        trial = val.walk(run.as_is())
        print(name, step, trial.record.outcome.name, file=sys.stderr, flush=True)  # noqa: T201
        walk = trial.comparison
        time, measured = walk.time[walk.inside], walk.measured.zmp[walk.inside]
        errors = [measured - walk.plan.sample(time + shift).zmp for shift in (0.0, 0.5 * step)]
        yield (f"{1e3 * step:g}", *(f"{1e3 * value:.3f}" for error in errors for value in sizes(error)))


def sizes(error: Array) -> tuple[float, ...]:
    """RMSE along x and y, largest error along x and y [m]."""
    square = np.mean(error**2, axis=0).tolist()
    return (*map(sqrt, square), *np.abs(error).max(axis=0).tolist())


if __name__ == "__main__":
    main()
