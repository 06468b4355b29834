"""Example of an own planner: COM and ZMP from a table, for example of a preview controller or an MPC.

    ampm plan momentum --no-body --samples plan.parquet --rate 5000
    python docs/examples/sampled_plan.py momentum plan.parquet

The table needs the columns time, stance, com_x, com_y, zmp_x, zmp_y, left_placement_x and so on, in SI units.
With com_acceleration_x and com_acceleration_y the force need not pass through the COM. Feet and posture are
those of the named gait. A switch is known to one row: with 1000 rows per second a touch-down may be
planned one tick late.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow.parquet as pq

import ampm
import validation as val
from ampm.planner.sampled import sampled_contacts, sampled_plan
from ampm.planner.stride import plan_feet
from ampm.planners import AmpmPeriodic, WalkRequest
from ampm.walk import Boundary, WalkPlan


class TablePlanner:
    """Planner of the COM and ZMP of a table.

    Args:
        table: columns of shape (N,).
    """

    def __init__(self, table: Mapping[str, Any]) -> None:
        self.table = table

    def plan(self, request: WalkRequest, begin: Boundary | None = None) -> WalkPlan:
        """Plan the walk of the table, from its first row; ``begin`` is not read."""
        run, table, time = request.run, self.table, self.table["time"]
        com, zmp, left, right = (
            np.column_stack([table[f"{name}_{axis}"] for axis in "xy"])
            for name in ("com", "zmp", "left_placement", "right_placement")
        )
        columns = [table[f"com_acceleration_{axis}"] for axis in "xy" if f"com_acceleration_{axis}" in table]
        angular_momentum = [table[f"angular_momentum_{axis}"][0] for axis in "xy"] if columns else (0.0, 0.0)
        contacts = sampled_contacts(time, table["stance"], left, right)
        plan = sampled_plan(
            time,
            com,
            zmp,
            contacts,
            mass=run.body.mass,
            com_height=run.gait.com_height,
            acceleration=np.column_stack(columns) if columns else None,
            angular_momentum=(float(angular_momentum[0]), float(angular_momentum[1])),
        )
        speed = plan.constants.l_s / plan.constants.single_support_duration
        feet = plan_feet(contacts, run.foot, request.robot.description.sole, speed)
        return WalkPlan.of(plan, feet=feet, posture=AmpmPeriodic().plan(request).posture)


def main(gait: str, path: str) -> None:
    """Walk a table and print the ZMP's error."""
    columns = pq.read_table(path)
    table = {name: columns[name].to_numpy() for name in columns.column_names}
    steps = int(np.count_nonzero(np.diff(table["stance"] == "both")) + 1) // 2
    trial = val.walk(ampm.load_run(gait, gait={"steps": steps}), planner=TablePlanner(table))
    x, y = (1000.0 * trial.metrics[f"zmp_{axis}_rmse"].value for axis in "xy")
    sys.stdout.write(f"{trial.record.outcome.name}, RMSE of the ZMP {x:.2f} and {y:.2f} mm\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
