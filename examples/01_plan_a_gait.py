"""Plan a gait in closed form and draw what it predicts; no simulator is loaded. Takes 1 s."""

import numpy as np
from matplotlib.figure import Figure

import ampm

# The force line misses the COM: c_s along the way, c_y across it. With 1 it passes through the COM.
run = ampm.load_run("normal", gait={"c_s": 1.2, "c_y": 0.4, "steps": 4})
plan = ampm.plan(run)
time = np.linspace(0.0, plan.duration, 1000)
sample = plan.sample(time)

constants = plan.constants
print(f"{constants.mean_velocity:.2f} m/s, {constants.step_duration:.2f} s a step")
print(f"angular momentum, peak to peak: {np.ptp(sample.angular_momentum, axis=0).round(1)} N m s")
print(f"largest jump at a switch of support, relative: {max(plan.residuals().values()):.0e}")

figure = Figure(figsize=(8.0, 6.5), layout="constrained")
way, across, momentum = figure.subplots(3, 1, sharex=True)
for axes, axis, name in ((way, 0, "forward"), (across, 1, "to the left")):
    axes.plot(time, sample.com[:, axis], label="COM")
    axes.plot(time, sample.zmp[:, axis], label="ZMP")
    axes.set_ylabel(f"{name} [m]")
    axes.legend()
momentum.plot(time, sample.angular_momentum, label=["about x", "about y"])
momentum.set(xlabel="time [s]", ylabel="angular momentum\nabout the COM [N m s]")
momentum.legend()
for axes in (way, across, momentum):
    axes.fill_between(time, 0, 1, sample.phase == 1, color="0.9", transform=axes.get_xaxis_transform())
    axes.grid(alpha=0.3)
figure.suptitle("planned in closed form; grey: double support")
figure.savefig("plan_a_gait.png", dpi=100)
print("wrote plan_a_gait.png")
