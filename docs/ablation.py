"""Walk with each part of the stepping stabiliser off; rewrite docs/data/ablation.csv.

    python docs/ablation.py

One walk for each of 16 pushes at the centre of mass and of three other disturbances. Every variant compiles
the controller anew, in a process and a cache of its own: half an hour on one core.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import import_module

import numpy as np
from numpy.typing import NDArray
from trials import write_rows

from ampm.run_file import load_run
from validation.run.trial import Trial
from validation.run.walk import walk_planned
from validation.study.robustness.cells import DIRECTIONS, Cell, other_cells, push_cells
from validation.study.robustness.study import AFTER, PUSH_STEP, STEPS, cause_of, disturbance_of
from validation.trial.plan import Request, plan_walk

PUSHES: Mapping[str, Sequence[float]] = {
    "early": (0.8, 0.8, 0.3, 0.2),
    "mid": (0.8, 0.8, 0.3, 0.2),
    "late": (1.0, 0.6, 0.25, 0.25),
    "double": (1.0, 0.7, 0.35, 0.15),
}
"""Velocity change by phase, in the order of :data:`validation.study.robustness.cells.DIRECTIONS` [m/s]."""
OTHERS: Mapping[str, tuple[str, float]] = {
    "floor lower": ("10 mm lower", -0.01),
    "slope uphill": ("3 degrees uphill", np.radians(3.0)),
    "soft floor": ("six times as soft", 6.0),
}
"""Cell of a disturbance: heading and value."""
VARIANTS: Mapping[str, Mapping[str, float | NDArray[np.float64]]] = {
    "stepping": {},
    "fixed": {},
    "places as planned": {
        "stepping.step_choice.FORWARD": 0.0,
        "stepping.step_choice.BACKWARD": 0.0,
        "stepping.step_choice.WIDER": 0.0,
        "stepping.step_choice.NEAR": 10.0,
    },
    "times as planned": {
        "stepping.step_choice.TIMES": np.ones(1),
        "stepping.step_choice.CATCH_UP": 0.0,
        "stepping.walker.HASTE_FROM": 10.0,
    },
    "touch-down as planned": {"stepping.sensed_floor.EARLY": 10.0, "stepping.sensed_floor.GRACE": 10.0},
    "no return to the plan": {
        "stepping.step_choice.RETURN": 0.0,
        "stepping.step_choice.CATCH_UP": 0.0,
        "stepping.tracker.BACK": 0.0,
    },
    "COM not at the floor's height": {"stepping.walker.HEIGHT_RATE": 0.0},
    "trunk righted as on the plan": {"control.tick.RIGHTING": 1.0},
    "sole not shared": {"control.sole.OPEN": 10.0},
    "height not integrated": {"stepping.walker.LIFT": 0.0},
    "slope not checked by heights": {"stepping.sensed_floor.RISE": 10.0},
    "tilt of a sole taken for the floor's": {"stepping.sensed_floor.DEEP_IN": 10.0},
}
"""Constants of a variant, by module and name."""


def row(variant: str) -> list[str]:
    """Pushes survived, and ZMP RMSE of the others; constants are set before anything is compiled."""
    for name, value in VARIANTS[variant].items():
        path, _, constant = name.rpartition(".")
        module = import_module(f"ampm.{path}")
        getattr(module, constant)  # an unknown name would change nothing
        setattr(module, constant, value)
    name = "fixed" if variant == "fixed" else "stepping"
    run = load_run("normal", controller={"stabilizer": name})

    def walk(cell: Cell, value: float) -> tuple[Trial, str]:
        """A trial of one disturbance, and why it does not count as survived."""
        steps = PUSH_STEP + 1 + AFTER if cell.is_push else STEPS
        planned = plan_walk(Request("normal", run.replace({"gait.steps": steps})))
        changed = planned.run.replace(disturbance_of(cell, value, 0, planned))
        trial = walk_planned(replace(planned, request=Request("normal", changed)))
        return trial, cause_of(trial.record, planned.body.model).partition(":")[0]

    count, walks = 0, []
    for cell in push_cells():
        if cell.height == "com":
            value = PUSHES[cell.phase][DIRECTIONS.index(cell.direction)]
            count += not walk(cell, value)[1]
    for cell in other_cells():
        if cell.name in OTHERS:
            trial, cause = walk(cell, OTHERS[cell.name][1])
            errors = [f"{1e3 * trial.metrics[f'zmp_{axis}_rmse'].value:.1f}" for axis in "xy" if not cause]
            walks.append((cell.name, cause or ", ".join(errors)))
    errors = dict(walks)
    return [str(count), *(errors[name] for name in OTHERS)]


def main(arguments: Sequence[str] | None = None) -> None:
    """One variant in this process if it is named, else all, each in its own, and the file."""
    names = sys.argv[1:] if arguments is None else list(arguments)
    if names:
        sys.stdout.write(f"{json.dumps(row(names[0]))}\n")
        return
    rows = []
    for variant in VARIANTS:
        with tempfile.TemporaryDirectory() as cache:
            environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
            command = [sys.executable, __file__, variant]
            answer = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
        rows.append((variant, *json.loads(answer.stdout.splitlines()[-1])))
        print(*rows[-1], sep=" | ", flush=True)  # noqa: T201
    header = (
        "variant",
        f"pushes survived, of {4 * len(PUSHES)}",
        *(heading for heading, *_ in OTHERS.values()),
    )
    write_rows("ablation", [header, *rows])


if __name__ == "__main__":
    main()
