"""Put a controller of your own beside the project's, with and without a push. Takes 10 s."""

import numpy as np
from matplotlib.figure import Figure

import ampm
import validation as val


class Lagging(ampm.TrackingController):
    """The project's controller behind motors whose torque follows with a time constant."""

    TIME_CONSTANT = 0.003  # [s]

    def __init__(self, robot, run):
        """Once a walk: the body and the parameters of the run."""
        super().__init__(robot, run)
        self.torque = None
        self.share = 1.0 - np.exp(-1.0 / (run.controller.frequency * self.TIME_CONSTANT))

    def update(self, state, touch, reference):
        """Once a tick: measured state, contact of the soles, and the plan at this instant."""
        output = super().update(state, touch, reference)
        before = output.torque if self.torque is None else self.torque
        self.torque = before + self.share * (output.torque - before)
        return output._replace(torque=self.torque, rate=None)  # None holds the torque until the next tick


run = ampm.load_run("normal", gait={"steps": 6}, simulation={"time_step": 0.002})
push = val.Push("chest", (0.0, 30.0, 0.0), at=1.5, duration=0.1)  # to the left [N], [s]

figure = Figure(figsize=(8.0, 4.5), layout="constrained")
panels = figure.subplots(2, 1, sharex=True)
for axes, pushes in zip(panels, ([], [push]), strict=True):
    for name, controller in (("the project's", "ampm"), ("lagging", Lagging)):
        trial = val.walk(run, controller=controller, disturbances=pushes)
        x, y = (1e3 * trial.metrics[f"zmp_{axis}_rmse"].value for axis in "xy")
        outcome = trial.record.outcome
        print(f"{name}, {len(pushes)} pushes: {outcome.name}, ZMP RMS error along x {x:.2f}, y {y:.2f} mm")
        error = trial.measured.com - trial.plan.sample(trial.measured.time).com
        axes.plot(trial.measured.time, 1e3 * error[:, 1], label=name)
    axes.set(ylabel="COM off the plan,\nto the left [mm]", title="pushed" if pushes else "not pushed")
    axes.grid(alpha=0.3)
panels[0].legend()
pushed = panels[1].axvspan(push.at, push.at + push.duration, color="tab:red", alpha=0.3, label="push of 30 N")
panels[1].legend(handles=[pushed])
panels[1].set_xlabel("time [s]")
figure.savefig("own_controller.png", dpi=100)
print("wrote own_controller.png")
