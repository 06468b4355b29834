"""Walk the gaits of docs/engines.md in both engines; rewrite its table and data/engines.csv.

    python docs/engines.py

Rows that the file has are kept, so that a study that was stopped goes on: remove the file to walk all again.
Half an hour on an idle core, most of it Drake's walks at 0.5 ms. G1 needs the extra `robots`.
"""

import sys
from itertools import product
from pathlib import Path

from trials import AGREEMENT, agreement, ending, read_rows, write_rows

import validation as val
from ampm.presets import preset_names
from benchmarks.page import replace_between
from validation.table import Table
from validation.trial.plan import load_request

PAGE = Path(__file__).with_suffix(".md")
STEPS = 30
TIME_STEPS = (0.002, 0.0005)
ENGINES = {"mujoco": "MuJoCo", "drake": "Drake"}
FIRST = ("normal", "momentum", "flat")
GAITS = (*FIRST, *(name for name in preset_names() if name not in FIRST), "g1", "suite-humanoid")
SHOWN = ("normal", "momentum", "flat", "pitch", "ipm", "g1", "suite-humanoid")
"""On the page, at the smallest time step."""
KEYS = ("gait", "time step [s]", "engine")
COLUMNS = (*KEYS, "verdict", *AGREEMENT, "reason")

Row = dict[str, str]


def main() -> None:
    """Walk what the file lacks, and rewrite the page's table."""
    rows: dict[tuple[str, ...], Row] = {tuple(row[key] for key in KEYS): row for row in read_rows("engines")}
    for time_step, gait, engine in product(TIME_STEPS, GAITS, ENGINES):
        key = (gait, str(time_step), engine)
        if key not in rows:
            rows[key] = dict(zip(COLUMNS, (*key, *_walked(gait, time_step, engine)), strict=True))
            print(*rows[key].values(), sep=" | ", file=sys.stderr, flush=True)  # noqa: T201
            write_rows("engines", [COLUMNS, *(tuple(row.values()) for row in rows.values())])
    page = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(replace_between(page, "engines", _table(rows).markdown()), encoding="utf-8")


def _walked(gait: str, time_step: float, engine: str) -> tuple[str, ...]:
    """Verdict, agreement and what failed."""
    preset = gait in preset_names()
    settings = [f"simulation.time_step={time_step}", f"simulation.engine={engine}", f"gait.steps={STEPS}"]
    settings += [] if preset else [f"body.source={gait}"]
    request = load_request(gait if preset else None, settings)
    trial = val.walk(request.run, name=gait)
    reason = "" if trial.verdict.passed else trial.verdict.reason
    return ending(trial.summary), *agreement(trial.summary["metrics"]), reason


def _table(rows: dict[tuple[str, ...], Row]) -> Table:
    """ZMP of some gaits at the smallest time step, along x and y in both engines."""
    errors = [f">RMSE {axis}, {name} [mm]" for axis, name in product("xy", ENGINES.values())]
    body = []
    for gait in SHOWN:
        both = [rows[gait, str(min(TIME_STEPS)), engine] for engine in ENGINES]
        x, y = zip(*(row[AGREEMENT[0]].split(", ") for row in both), strict=True)
        body.append((gait, *x, *y, both[1]["verdict"]))
    return Table("", ("gait", *errors, "verdict, Drake"), body)


if __name__ == "__main__":
    main()
