"""Walk with sensors and estimator for docs/sensors.md; rewrite its table and data/sensors.csv.

    python docs/sensors.py

Rows that the file has are kept, so that a study that was stopped goes on: remove the file to walk all again.
Ten minutes on an idle core. G1 needs the extra `robots`.
"""

import math
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from trials import ending, read_rows, write_rows

import ampm
import validation as val
from benchmarks.page import replace_between
from validation.table import Table

PAGE = Path(__file__).with_suffix(".md")
STEPS = 30
GAITS = ("normal", "momentum", "g1")
KALMAN = {"estimator": "kalman"}
NOISE = {
    "angle_noise": 1e-4,
    "rate_noise": 0.01,
    "gyro_noise": 5e-3,
    "accelerometer_noise": 0.05,
    "force_noise": 2.0,
    "delay": 0.001,
}
SEEDS = (101, 102, 103, 104, 105)  # the filter was tuned with others
ALL = KALMAN | NOISE | {"seed": SEEDS[0]}
BIASES = {"gyro_bias": 2e-4, "accelerometer_bias": 0.02, "force_bias": 2.0}
ROBOT = {
    "force_sensor": "wrench",
    "force_noise": 2.0,
    "moment_noise": 0.05,
    "force_bias": 5.0,
    "force_scale_bias": 0.05,
    "contact_threshold": 15.0,
}
TURNED, OFFSETS = {"imu_angle_bias": math.radians(0.5)}, {"angle_bias": 1e-3}
IMU = {"gyro_bias": 2e-4, "accelerometer_bias": 0.02}
WORN = ALL | ROBOT | TURNED | OFFSETS | IMU | {"stand": 2.0}
TWICE = {
    key: 2.0 * value if key not in ("delay", "stand") and isinstance(value, float) else value
    for key, value in WORN.items()
}
SLOPE = math.radians(1.0)
COLUMNS = (
    "gait",
    "sensors",
    "seed",
    "ZMP x, y [mm]",
    "from the foot x, y [mm]",
    "drift [mm/step]",
    "verdict",
    "reason",
)
ROWS: tuple[tuple[str, str, dict[str, Any], dict[str, Any]], ...] = (
    *((gait, "Kalman, sensors of a robot", WORN | {"seed": seed}, {}) for seed in SEEDS for gait in GAITS),
    ("normal", "Kalman, all these errors twice", TWICE, {}),
    ("momentum", "Kalman, all these errors twice", TWICE, {}),
    ("g1", "Kalman, all these errors twice", TWICE, {}),
    ("normal", "true state", {}, {}),
    ("normal", "true root, the rest as read", NOISE, {}),
    ("normal", "Kalman, biases", ALL | BIASES, {}),
    ("normal", "Kalman, switches at 15 N", ALL | {"contact_threshold": 15.0}, {}),
    ("normal", "Kalman, IMU turned by half a degree", ALL | TURNED, {}),
    ("normal", "Kalman, encoder offsets of 1 mrad", ALL | OFFSETS, {}),
    ("normal", "Kalman, angles in steps of 1 mrad", ALL | {"angle_resolution": 1e-3}, {}),
    ("normal", "Kalman, readings at 250 Hz", ALL | {"rate": 250.0}, {}),
    *((gait, "Kalman, force/torque sensors", ALL | ROBOT, {}) for gait in GAITS),
    ("normal", "Kalman, fixes at 100 Hz", ALL | {"fix_rate": 100}, {}),
    ("normal", "Kalman, masses +2 %", ALL, {"mass_change": 0.02}),
    ("normal", "true state, masses +2 %", {}, {"mass_change": 0.02}),
    *(("normal", "Kalman", ALL | {"seed": seed}, {}) for seed in SEEDS),
    *(("momentum", "Kalman", ALL | {"seed": seed}, {}) for seed in SEEDS),
    ("normal", "true state, 1 degree across", {}, {"slope_across": SLOPE}),
)
SHOWN = (
    "normal, true state",
    "normal, true root, the rest as read",
    "normal, true state, masses +2 %",
    "normal, Kalman",
    "momentum, Kalman",
    "normal, Kalman, fixes at 100 Hz",
    "normal, Kalman, switches at 15 N",
    *(f"{gait}, Kalman, sensors of a robot" for gait in GAITS),
)
"""Rows of the page; the file has all."""


def main() -> None:
    """Walk the rows that the file lacks, and write all."""
    found = {row[:3]: row for row in (tuple(row.values()) for row in read_rows("sensors"))}
    rows: list[tuple[str, ...]] = [COLUMNS]
    for gait, name, sensors, disturbance in ROWS:
        key = gait, name, str(sensors.get("seed", 0))
        rows.append(found[key] if key in found else (*key, *_walked(gait, sensors, disturbance)))
        print(*rows[-1], sep=" | ", file=sys.stderr, flush=True)  # noqa: T201
        write_rows("sensors", [*rows, *(row for old, row in found.items() if row not in rows)])
    write_rows("sensors", rows)
    page = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(replace_between(page, "sensors", _table(rows[1:]).markdown()), encoding="utf-8")


def _table(rows: Sequence[Sequence[str]]) -> Table:
    """The rows of the page, one for all seeds, with the largest values."""
    seeds: dict[str, list[Sequence[str]]] = {}
    for row in rows:
        seeds.setdefault(", ".join(row[:2]), []).append(row)

    def largest(cells: Sequence[str]) -> str:
        columns = zip(*(cell.split(", ") for cell in cells), strict=True)
        return ", ".join(max(values, key=float) for values in columns).replace("nan", "–")

    body = [
        (name, *(largest([row[column] for row in same]) for column in (3, 4, 5)), _verdicts(same))
        for name, same in ((name, seeds[name]) for name in SHOWN)
    ]
    return Table("", ("walk", *COLUMNS[3:7]), body)


def _verdicts(rows: Sequence[Sequence[str]]) -> str:
    """How some walks ended, with their number if they are not one."""
    counts = Counter("fell" if row[6].startswith("fell") else row[6] for row in rows)
    return rows[0][6] if len(rows) == 1 else ", ".join(f"{count} {end}" for end, count in counts.items())


def _walked(gait: str, sensors: dict[str, Any], disturbance: dict[str, Any]) -> tuple[str, ...]:
    """Errors and drift of a walk, and how it ended."""
    body = {"body": {"source": "g1"}} if gait == "g1" else {}
    sections = {"gait": {"steps": STEPS}, "sensors": sensors, "disturbance": disturbance}
    trial = val.walk(ampm.load_run(None if gait == "g1" else gait, **body, **sections))
    metrics, outcome = trial.metrics, trial.record.outcome

    def shown(*names: str) -> str:
        values = [metrics[name].value if name in metrics else math.nan for name in names]  # it fell at once
        return ", ".join(f"{1e3 * value:.2f}" for value in values)

    end = ending(trial.summary)
    return (
        shown("zmp_x_rmse", "zmp_y_rmse"),
        shown("zmp_foot_x_rmse", "zmp_foot_y_rmse"),
        shown("drift_per_step"),
        end if outcome.completed else f"{end} at {outcome.time:.1f} s",
        "" if trial.verdict.passed else trial.verdict.reason,
    )


if __name__ == "__main__":
    main()
