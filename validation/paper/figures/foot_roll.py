"""Figure 7: the key-frames of the foot, and the effect of the paper's swing compared with one that is C2.

Both forms pass the same key-frames. The paper's form lifts a resting foot at ``l_s / T_swing``, so its
velocity jumps there; with its cubic pieces the acceleration jumps at every key-frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ampm.body.motion import WholeBodyMotion
from ampm.body.robot import Robot
from ampm.geometry import Array
from ampm.planner.feet import FootSample
from validation.paper.figures.accelerations import joint_accelerations
from validation.paper.figures.canvas import (
    DASHED,
    FAINT,
    GRID,
    INK,
    MEASURED,
    MOTION,
    TRUNK,
    inches,
    legend_above,
    shade,
    zero_line,
)
from validation.paper.figures.walks import Walk, Walks

GRIDS = (0.004, 0.002, 0.001)
"""Largest steps of the inverse kinematics' grid that are compared [s]."""

FORMS: Mapping[str, tuple[str, ...]] = {
    "quintic": (),
    "paper": ("foot.swing=paper",),
    "paper, ankle": ("foot.swing=paper", "foot.v_swing_of=ankle"),
}
"""Forms of the swing and the settings that give them; the last is only in the numbers."""

_COLORS = {"quintic": MOTION, "paper": MEASURED}


def figure_7(walks: Walks) -> tuple[Figure, dict[str, Any]]:
    """Key-frames, swing, joint accelerations and ZMP of both forms of the normal gait."""
    every = {form: walks.walk("normal", settings) for form, settings in FORMS.items()}
    numbers: dict[str, Any] = {form: {"walk": _cost(walk), "jumps": {}} for form, walk in every.items()}
    for form, settings in FORMS.items():
        for grid in GRIDS:
            planned = walks.plan("normal", (*settings, f"solver.ik_time_step={grid}"))
            numbers[form]["jumps"][f"{grid:g}"] = joint_jumps(planned.motion, planned.body.robot)
    both = {form: every[form] for form in _COLORS}
    figure = Figure(figsize=(9.6, 10.2))
    _key_frames(inches(figure, 0.75, 0.52, 8.65, 2.7), both)
    _speed(inches(figure, 0.75, 4.3, 3.85, 2.1), both)
    _knee(inches(figure, 5.55, 4.3, 3.85, 2.1), both)
    _grid(inches(figure, 0.75, 7.45, 3.85, 2.25), numbers)
    _zmp(inches(figure, 5.55, 7.45, 3.85, 2.25), both)
    return figure, numbers


def joint_jumps(motion: WholeBodyMotion, robot: Robot) -> dict[str, float]:
    """Largest changes of any joint's velocity and acceleration over one grid interval beside a switch.

    Returns:
        ``velocity`` [rad/s], ``acceleration`` [rad/s²] (of the solved accelerations), and ``difference``
        [rad/s²]: the largest acceleration by differences of the velocities.
    """
    switch = int(np.searchsorted(motion.time, motion.double_support_start - 1e-12))
    last = len(motion.time) - 1
    before = np.array([switch - 1, switch, last - 1, 0])
    velocity = np.abs(motion.v[before + 1] - motion.v[before])[:, 6:].max(axis=1)
    change = np.abs(motion.acceleration[before + 1] - motion.acceleration[before])[:, 6:].max()
    # Mirrored, the end of a step is the start of the next one.
    across = motion.acceleration[0] - robot.mirror_v(motion.acceleration[last - 1])
    return {
        "velocity": float(velocity.max()),
        "acceleration": float(max(change, np.abs(across[6:]).max())),
        "difference": float((velocity / (motion.time[before + 1] - motion.time[before])).max()),
    }


def _cost(walk: Walk) -> dict[str, float]:
    """How well the gait was walked."""
    metrics, record = walk.trial.summary["metrics"], walk.trial.record
    names = [f"zmp_{axis}_{what}" for what in ("rmse", "maximum") for axis in "xy"]
    names += [f"force_{axis}_rmse" for axis in "xyz"]
    rate = np.abs(np.diff(record.torque, axis=0)) / record.time_step
    return {
        **{name: float(metrics[name]["display"]["value"]) for name in names},
        "torque_share_percent": float(100.0 * (np.abs(record.torque) / record.torque_limit).max()),
        "torque_rate_peak_kNm_per_s": float(1e-3 * rate.max()),
        "completed": float(record.outcome.completed),
    }


def _right_swing(walk: Walk) -> tuple[Array, FootSample]:
    """Right foot from heel rise to full contact: its times from lift-off [s], and its sample."""
    time = np.linspace(-walk.double, walk.plan.constants.step_duration, 1200)
    return time, walk.plan.feet.sample(walk.stride + time)[1]


def _key_frames(axis: Axes, both: Mapping[str, Walk]) -> None:
    """The foot in side view: at its key-frames, and the ball's way between them in both forms."""
    for form, walk in both.items():
        time, sample = _right_swing(walk)
        points = sample.sole_points[(time >= 0) & (time <= walk.single)]
        for part, width, line, label in (
            (slice(2, 4), 1.3, "-", f"path of the ball, {form}"),
            (slice(0, 2), 0.8, DASHED, None),
        ):
            x, _, z = points[:, part].mean(axis=1).T
            axis.plot(x, z, color=_COLORS[form], linewidth=width, linestyle=line, label=label)
    walk = both["quintic"]
    foot, sole = walk.trial.planned.request.run.foot, walk.robot.description.sole
    time, sample = _right_swing(walk)
    for name, at, weight, drop in (
        ("heel rise", -walk.double - min(foot.heel_rise_lead, 0.0), 0.25, -0.075),
        ("toe off", 0.0, 1.0, -0.03),
        ("", 0.3 * walk.single, 0.4, 0.0),
        ("", 0.65 * walk.single, 0.4, 0.0),
        ("initial contact", walk.single, 1.0, -0.03),
        ("full contact", walk.single + foot.full_contact * walk.double, 0.25, -0.075),
    ):
        row = int(np.argmin(np.abs(time - at)))
        heel, ball, tip = sample.sole_points[row].reshape(3, 2, 3).mean(axis=1)[:, [0, 2]]
        c, s = np.cos(sample.pitch[row]), np.sin(sample.pitch[row])
        ankle = sample.position[row, [0, 2]] + [
            sole.ankle_x * c + sole.ankle_height * s,
            -sole.ankle_x * s + sole.ankle_height * c,
        ]
        alpha = 0.4 + 0.6 * weight
        axis.fill(*np.transpose([heel, ball, ankle]), facecolor=TRUNK, alpha=0.35 * weight, linewidth=0)
        for chain, width in (([heel, ball, ankle, heel], 1.3), ([ball, tip], 2.2)):
            axis.plot(*np.transpose(chain), color=TRUNK, alpha=alpha, linewidth=width)
        axis.text(float(ankle[0]), drop, name, ha="center", va="top", fontsize=8, color=INK)
    axis.axhline(0.0, color=FAINT, linewidth=0.8)
    axis.set_aspect("equal")
    axis.set_ylim(-0.13, 0.36)
    axis.set_yticks([0.0, 0.1, 0.2, 0.3])
    axis.set_xlabel("x [m]", loc="right")
    axis.set_ylabel("z [m]")
    axis.set_title("(a) key-frames of the foot (heel dashed)")
    legend_above(axis)


def _speed(axis: Axes, both: Mapping[str, Walk]) -> None:
    """Forward speed of the ball about lift-off and landing."""
    for form, walk in both.items():
        time, sample = _right_swing(walk)
        x = walk.robot.description.sole.ball_x
        speed = sample.velocity[:, 0] - x * np.sin(sample.pitch) * sample.pitch_velocity
        axis.plot(time, speed, color=_COLORS[form], label=form)
    walk = both["paper"]
    v = walk.plan.constants.l_s / walk.single
    axis.annotate(
        f"$l_s / T_{{swing}}$ = {v:.2f} m/s,\nat once", (0.0, v), (0.1, v - 0.15), fontsize=8, va="center",
        arrowprops={"arrowstyle": "-", "color": INK, "linewidth": 0.6},
    )  # fmt: skip
    _swing_axis(axis, walk)
    axis.set(title="(b) forward speed of the ball", ylabel="[m/s]")
    legend_above(axis)


def _knee(axis: Axes, both: Mapping[str, Walk]) -> None:
    """Knee acceleration of the swinging leg, in the motion and in the simulation."""
    for form, walk in both.items():
        # Left leg: its lift-off is in the middle of the stride.
        motion, _, smooth = joint_accelerations(walk, walk.robot.description.left_leg.knee, 1.0)
        time = walk.phase - 0.5 * walk.stride
        axis.plot(time, smooth.mean(axis=0), color=_COLORS[form], linewidth=0.8, alpha=0.6,
                  label=f"{form}, simulation")  # fmt: skip
        axis.plot(time, motion, color=_COLORS[form], linewidth=1.5, label=f"{form}, IK")
    _swing_axis(axis, both["paper"])
    axis.set(title="(c) knee acceleration", ylabel="[rad/s²]")
    legend_above(axis, 2)


def _swing_axis(axis: Axes, walk: Walk) -> None:
    end = walk.single + walk.double
    shade(axis, ((-walk.double, 0.0), (walk.single, end)))
    axis.set_xlim(-walk.double, end)
    zero_line(axis)
    axis.set_xlabel("time from lift-off [s]")


def _grid(axis: Axes, numbers: Mapping[str, Any]) -> None:
    """Largest jumps at the switches against the grid of the inverse kinematics."""
    steps = [1e3 * grid for grid in GRIDS]
    for form in _COLORS:
        found = numbers[form]
        for key, line, marker, what in (
            ("acceleration", "-", "o", "acceleration"),
            ("difference", DASHED, "s", "Δ velocity / Δ t"),
        ):
            axis.plot(
                steps, [item[key] for item in found["jumps"].values()], color=_COLORS[form], linestyle=line,
                marker=marker, markersize=4, linewidth=1.2, label=f"{form}, {what}",
            )  # fmt: skip
    axis.set_xscale("log", base=2)
    axis.set_yscale("log")
    axis.set_xticks(steps, [f"{step:g}" for step in steps])
    axis.minorticks_off()
    axis.grid(True, which="both", color=GRID)
    axis.set_xlim(max(steps) * 1.2, min(steps) / 1.2)
    axis.set(xlabel="largest step of the grid [ms]", ylabel="[rad/s²]")
    axis.set_title("(d) largest jump of a joint at a switch")
    legend_above(axis, 2)


def _zmp(axis: Axes, both: Mapping[str, Walk]) -> None:
    """ZMP error along x over a stride, every stride."""
    for form, walk in both.items():
        error = 1e3 * walk.away("zmp", 0)[1]
        axis.plot(walk.phase, error.T, color=_COLORS[form], linewidth=0.5, alpha=0.35)
        axis.plot(walk.phase, error.mean(axis=0), color=_COLORS[form], linewidth=1.2, label=form)
    walk = both["quintic"]
    shade(axis, walk.double_supports)
    zero_line(axis)
    axis.set_xlim(0.0, walk.stride)
    axis.set(xlabel="time from the start of left single support [s]", ylabel="[mm]")
    axis.set_title("(e) simulated less planned ZMP, along x")
    legend_above(axis)
