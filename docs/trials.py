"""Trials for the tables of this folder, and the cells that they have in common."""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import ampm
import validation as val

DATA = Path(__file__).with_name("data")
AGREEMENT = (
    "ZMP RMSE x, y [mm]",
    "maximum x, y [mm]",
    "F RMSE x, y, z [% weight]",
    "L RMSE x, y [N m s]",
)


def read_rows(name: str) -> list[dict[str, str]]:
    """Rows of ``data/NAME.csv`` by column; none if there is no such file."""
    path = DATA / f"{name}.csv"
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def write_rows(name: str, rows: Sequence[Sequence[str]]) -> None:
    """Write ``data/NAME.csv``."""
    with DATA.joinpath(f"{name}.csv").open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


def walk(
    gait: str, settings: Sequence[str] = (), *, profile: str = "default", tune: bool = False
) -> val.Trial | ampm.AmpmError:
    """The trial of a gait, or its refusal; ``tune`` finds the values that it leaves open."""
    run = ampm.load_run(gait, settings)
    try:
        found = val.walk(run if tune else run.as_is()).judged(profile)
    except ampm.AmpmError as error:
        return error
    finally:
        print(gait, *settings, file=sys.stderr, flush=True)  # noqa: T201
    return found


def agreement(metrics: Mapping[str, Any]) -> Iterator[str]:
    """Cells of :data:`AGREEMENT` from the metrics of a summary."""

    def shown(decimals: int, *names: str) -> str:
        return ", ".join(f"{metrics[name]['display']['value']:.{decimals}f}" for name in names)

    yield shown(2, "zmp_x_rmse", "zmp_y_rmse")
    yield shown(1, "zmp_x_maximum", "zmp_y_maximum")
    yield shown(2, "force_x_rmse", "force_y_rmse", "force_z_rmse")
    yield shown(3, "angular_momentum_x_rmse", "angular_momentum_y_rmse")


def ending(summary: Mapping[str, Any]) -> str:
    """The verdict of a walk that completed, how the others ended."""
    return str(summary["verdict"] if summary["outcome"] == "completed" else summary["outcome"])
