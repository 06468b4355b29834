"""Walk with sensors and estimator for docs/sensors.md; rewrite its table and data/sensors.csv.

    python docs/sensors.py

Five minutes on an idle core.
"""

import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from trials import ending, write_rows

import ampm
import validation as val
from validation.show.text import replace_between
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
WORN = ALL | ROBOT | TURNED | OFFSETS | IMU
TWICE = {
    key: 2.0 * value if key != "delay" and isinstance(value, float) else value for key, value in WORN.items()
}
SLOPE = math.radians(1.0)
ONLY_IN_FILE = (
    ("normal", "Kalman, no noise"),
    ("normal", "Kalman, no noise, 1 ms late"),
    ("normal", "Kalman, 2 ms late"),
    ("momentum", "Kalman, fixes at 100 Hz"),
    ("normal", "Kalman, masses -2 %"),
    ("normal", "Kalman, 1 degree up"),
    ("normal", "true state, 1 degree up"),
    ("normal", "Kalman, 1 degree across"),
)
COLUMNS = (
    "gait",
    "sensors",
    "seed",
    "ZMP x, y [mm]",
    "from the foot x, y [mm]",
    "drift [mm/step]",
    "verdict",
)
ROWS: tuple[tuple[str, str, dict[str, Any], dict[str, Any]], ...] = (
    ("normal", "true state", {}, {}),
    ("normal", "true root, the rest as read", NOISE, {}),
    ("normal", "Kalman, no noise", KALMAN, {}),
    ("normal", "Kalman, no noise, 1 ms late", KALMAN | {"delay": 0.001}, {}),
    *(("normal", "Kalman", ALL | {"seed": seed}, {}) for seed in SEEDS),
    *(("momentum", "Kalman", ALL | {"seed": seed}, {}) for seed in SEEDS),
    ("normal", "Kalman, 2 ms late", ALL | {"delay": 0.002}, {}),
    ("normal", "Kalman, biases", ALL | BIASES, {}),
    ("normal", "Kalman, switches at 15 N", ALL | {"contact_threshold": 15.0}, {}),
    ("normal", "Kalman, IMU turned by half a degree", ALL | TURNED, {}),
    ("normal", "Kalman, encoder offsets of 1 mrad", ALL | OFFSETS, {}),
    ("normal", "Kalman, angles in steps of 1 mrad", ALL | {"angle_resolution": 1e-3}, {}),
    ("normal", "Kalman, readings at 250 Hz", ALL | {"rate": 250.0}, {}),
    *((gait, "Kalman, force/torque sensors", ALL | ROBOT, {}) for gait in GAITS),
    *((gait, "Kalman, sensors of a robot but offsets", WORN | {"angle_bias": 0.0}, {}) for gait in GAITS),
    *(("normal", "Kalman, sensors of a robot", WORN | {"seed": seed}, {}) for seed in SEEDS),
    *((gait, "Kalman, sensors of a robot", WORN, {}) for gait in GAITS[1:]),
    ("normal", "Kalman, sensors of a robot, all errors twice", TWICE, {}),
    ("normal", "Kalman, fixes at 100 Hz", ALL | {"fix_rate": 100}, {}),
    ("momentum", "Kalman, fixes at 100 Hz", ALL | {"fix_rate": 100}, {}),
    ("normal", "Kalman, masses +2 %", ALL, {"mass_change": 0.02}),
    ("normal", "Kalman, masses -2 %", ALL, {"mass_change": -0.02}),
    ("normal", "true state, masses +2 %", {}, {"mass_change": 0.02}),
    ("normal", "Kalman, 1 degree up", ALL, {"slope_along": SLOPE}),
    ("normal", "true state, 1 degree up", {}, {"slope_along": SLOPE}),
    ("normal", "Kalman, 1 degree across", ALL, {"slope_across": SLOPE}),
    ("normal", "true state, 1 degree across", {}, {"slope_across": SLOPE}),
)


def main() -> None:
    """Walk all rows, and write them."""
    rows = [COLUMNS, *_rows()]
    write_rows("sensors", rows)
    page = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(replace_between(page, "sensors", _table(rows[1:]).markdown()), encoding="utf-8")


def _table(rows: Sequence[Sequence[str]]) -> Table:
    """One row for all seeds, with the largest values."""
    seeds: dict[tuple[str, str], list[Sequence[str]]] = {}
    for row in rows:
        seeds.setdefault((row[0], row[1]), []).append(row)

    def largest(cells: Sequence[str]) -> str:
        return ", ".join(
            max(values, key=float) for values in zip(*(c.split(", ") for c in cells), strict=True)
        )

    body = [
        (", ".join(walk), *(largest([row[column] for row in same]) for column in (3, 4, 5)), same[0][6])
        for walk, same in seeds.items()
        if walk not in ONLY_IN_FILE
    ]
    return Table("", ("walk", *COLUMNS[3:]), body)


def _rows() -> Iterator[tuple[str, ...]]:
    for gait, name, sensors, disturbance in ROWS:
        name_of = {"body": {"source": "g1"}} if gait == "g1" else {}
        run = ampm.load_run(
            None if gait == "g1" else gait,
            **name_of,
            gait={"steps": STEPS},
            sensors=sensors,
            disturbance=disturbance,
        )
        trial = val.walk(run)
        metrics, outcome = trial.metrics, trial.record.outcome

        def shown(*names: str, of: Any = metrics) -> str:
            values = [of[name].value if name in of else math.nan for name in names]  # it fell at once
            return ", ".join(f"{1e3 * value:.2f}" for value in values)

        end = ending(trial.summary)
        row = (
            gait,
            name,
            str(sensors.get("seed", 0)),
            shown("zmp_x_rmse", "zmp_y_rmse"),
            shown("zmp_foot_x_rmse", "zmp_foot_y_rmse"),
            shown("drift_per_step"),
            end if outcome.completed else f"{end} at {outcome.time:.1f} s",
        )
        print(*row, trial.verdict.reason, sep=" | ", file=sys.stderr, flush=True)  # noqa: T201
        yield row


if __name__ == "__main__":
    main()
