"""Walk a biped of your own from its URDF and eight lines; its gait is found. Takes 5 s."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import ampm
import validation as val

BODY = Path(__file__).parents[1] / "docs/examples/biped.toml"  # root, trunk, feet, knees, soles; and the URDF
run = ampm.load_run(gait={"steps": 6}, body={"source": str(BODY)}, simulation={"time_step": 0.002})
trial = val.walk(run, name="biped")
robot, gait, length = trial.planned.body.robot, trial.run.gait, trial.comparison.scales["foot_length"]
print(f"{robot.mass:.1f} kg, {len(robot.joint_names)} joints, feet of {1e3 * length:.0f} mm")
print(f"its gait: steps of {gait.step_length:.3f} m with the COM at {gait.com_height:.3f} m")
for axis in "xy":
    value = trial.metrics[f"zmp_{axis}_rmse"].value
    print(f"ZMP {axis}, RMSE: {1e3 * value:.2f} mm, {100 * value / length:.2f} % of the foot's length")
print(f"{trial.verdict.name}: {trial.verdict.reason}")

share = np.abs(trial.record.torque / robot.torque_limit)  # of every motor's limit, (time steps, motors)
order = np.argsort(share.max(axis=0))
figure = Figure(figsize=(8.0, 5.0), layout="constrained")
axes = figure.subplots()
names = [robot.joint_names[joint] for joint in order]
axes.barh(names, 100 * share.max(axis=0)[order], color="0.8", label="largest")
axes.barh(names, 100 * np.sqrt(np.mean(share**2, axis=0))[order], label="RMS")
axes.set(xlabel="torque [% of the motor's limit]", xlim=(0.0, 100.0))
axes.legend()
figure.savefig("own_robot.png", dpi=100)
print("wrote own_robot.png")
