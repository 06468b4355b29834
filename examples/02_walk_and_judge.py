"""Walk a gait in MuJoCo, judge it, and draw plan, measurement and error of the ZMP. Takes 5 s."""

from matplotlib.figure import Figure
from rich import print

import ampm
import validation as val

# A step of 2 ms is enough to try things; the default of 0.5 ms takes about three times as long.
run = ampm.load_run("normal", gait={"c_y": 0.6, "steps": 6}, simulation={"time_step": 0.002})
trial = val.walk(run, name="own")  # finds the values that the gait leaves open
print(trial.table())
print(f"{trial.verdict.name}: {trial.verdict.reason}")

measured = trial.measured
planned = trial.plan.sample(measured.time)
error = 1e3 * (measured.zmp - planned.zmp)  # [mm]
figure = Figure(figsize=(8.0, 6.5), layout="constrained")
above, *below = figure.subplots(3, 1)
above.plot(*planned.com[:, :2].T, color="0.6", label="COM, planned")
above.plot(*planned.zmp.T, label="ZMP, planned")
above.plot(*measured.zmp.T, "--", label="ZMP, measured")
above.set(xlabel="forward [m]", ylabel="to the left [m]", title="seen from above", ylim=(-0.12, 0.2))
above.legend(ncols=3, loc="upper center")
for axes, axis in zip(below, (0, 1), strict=True):
    axes.plot(measured.time, error[:, axis], color="tab:red", linewidth=0.8)
    rms = 1e3 * trial.metrics[f"zmp_{'xy'[axis]}_rmse"].value
    axes.axhspan(-rms, rms, color="tab:red", alpha=0.15, label=f"RMS {rms:.2f} mm")
    axes.axvline(trial.plan.judged_from, color="0.5", linestyle=":", label="judged from here")
    axes.set(xlabel="time [s]", ylabel=f"ZMP error\nalong {'xy'[axis]} [mm]")
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right", ncols=2)
figure.savefig("walk_and_judge.png", dpi=100)
print("wrote walk_and_judge.png")
