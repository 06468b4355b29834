"""Walk a planner of your own, a linear inverted pendulum, beside the AMPM. Takes 5 s."""

import numpy as np
from matplotlib.figure import Figure

import ampm
import validation as val

GRAVITY, RATE = 9.81, 200  # [m/s^2], rows a second
ROLL = 0.09  # in single support the ZMP goes from this far behind the sole's origin to as far ahead [m]


def lipm(steps, length, width, height, single, double):
    """Columns of COM, ZMP and footsteps; lengths in m, durations of single and double support in s."""
    period = single + double
    number = np.arange(-8, steps + 9)  # more footsteps before and after the walk: it has no ends
    switches = np.stack([number * period, number * period + single], axis=1).ravel()
    forward = np.stack([number * length - ROLL, number * length + ROLL], axis=1).ravel()
    across = np.repeat(0.5 * width * (-1.0) ** number, 2)
    time = np.arange(-4 * RATE, (steps * period + 4) * RATE) / RATE
    zmp = np.stack([np.interp(time, switches, forward), np.interp(time, switches, across)])
    weight = np.exp(-np.sqrt(GRAVITY / height) * np.abs(np.arange(-4 * RATE, 4 * RATE + 1)) / RATE)
    com = np.stack([np.convolve(axis, weight / weight.sum(), mode="same") for axis in zmp])
    walked = (time >= 0.0) & (time < steps * period)
    time, com, zmp = time[walked], com[:, walked], zmp[:, walked]
    step = (time / period).astype(int)  # the left foot stands in step 0, on x = 0
    foot = np.where(step % 2, "right", "left")
    table = {"time": time, "stance": np.where(time - step * period < single, foot, "both")}
    table |= {"com_x": com[0], "com_y": com[1], "zmp_x": zmp[0], "zmp_y": zmp[1]}
    side = np.full(len(time), 0.5 * width)  # placements: where a foot stands, or will land if it swings
    table |= {"left_placement_x": length * (step + step % 2), "left_placement_y": side}
    return table | {"right_placement_x": length * (step + 1 - step % 2), "right_placement_y": -side}


class Lipm:
    """The pendulum over the footsteps of a run's gait, with the durations of the AMPM."""

    def plan(self, run, robot):
        """Plan the walk of a run and a body."""
        gait, timing = run.gait, ampm.plan(run).constants
        durations = timing.single_support_duration, timing.double_support_duration
        table = lipm(gait.steps, gait.step_length, gait.step_width, gait.com_height, *durations)
        return ampm.TablePlanner(table).plan(run, robot)


run = ampm.load_run("momentum", gait={"steps": 6}, simulation={"time_step": 0.002})
figure = Figure(figsize=(8.0, 5.5), layout="constrained")
error, momentum = figure.subplots(2, 1, sharex=True)
for name, planner in (("AMPM", "ampm"), ("LIPM", Lipm())):
    trial = val.walk(run, planner=planner)
    print(f"{name}: ZMP, RMS error along x {1e3 * trial.metrics['zmp_x_rmse'].value:.2f} mm")
    time, planned = trial.measured.time, trial.plan.sample(trial.measured.time)
    error.plot(time, 1e3 * (trial.measured.zmp - planned.zmp)[:, 0], linewidth=0.8)
    momentum.plot(time, trial.measured.angular_momentum[:, 0], label=f"{name}, measured")
    momentum.plot(time, planned.angular_momentum[:, 0], "k:", label="planned" if name == "LIPM" else "")
error.set(ylabel="ZMP error along x [mm]")
momentum.set(ylabel="angular momentum\nabout x [N m s]", xlabel="time [s]", ylim=(-10.0, 18.0))
momentum.legend(ncols=3)
figure.savefig("own_planner.png", dpi=100)
