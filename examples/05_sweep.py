"""Sweep speed and width of the steps for two planners, and draw a scatter. Takes 15 s on two cores."""

from pathlib import Path

from matplotlib.figure import Figure

import validation as val

DEFINITION = """
[sweep]
gait = "normal"
steps = 3
recordings = "none"

[set]
simulation.time_step = 0.002

[[vary]]
method = "grid"
gait.planner = ["ampm", "ipm"]  # ipm: the plain inverted pendulum, whose ZMP jumps

[[vary]]
method = "sobol"
count = 6
gait.switching_velocity = { from = 0.9, to = 1.1 }
gait.step_width = { from = 0.16, to = 0.22 }
"""

if __name__ == "__main__":  # the processes of a sweep import this file
    Path("speeds.toml").write_text(DEFINITION)
    result = val.sweep("speeds.toml", out="sweeps/speeds", resume=Path("sweeps/speeds").exists())
    rows = result.table.to_pylist()
    print(f"{sum(row['verdict'] == 'pass' for row in rows)} of {len(rows)} runs pass")
    figure = Figure(figsize=(8.0, 4.5), layout="constrained")
    axes = figure.subplots()
    for planner, marker in (("ampm", "o"), ("ipm", "s")):
        walked = [row for row in rows if row["gait.planner"] == planner and row["metric_zmp_x_rmse"]]
        speed, error, width = (
            [row[key] for row in walked]
            for key in ("gait.switching_velocity", "metric_zmp_x_rmse", "gait.step_width")
        )
        dots = axes.scatter(speed, [1e3 * value for value in error], c=width, marker=marker, label=planner)
    figure.colorbar(dots, label="width of the steps [m]")
    axes.axhline(2.5, color="tab:red", linestyle="--", label="tolerance")  # of the profile "default"
    axes.set(xlabel="speed at a switch of support [m/s]", ylabel="ZMP, RMS error along x [mm]", yscale="log")
    axes.grid(alpha=0.3, which="both")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    figure.savefig("sweep.png", dpi=100)
    print("wrote sweep.png; the sweep's own report is sweeps/speeds/report.html")
