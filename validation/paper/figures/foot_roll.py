"""Figure 7: the key-frames of the foot, and what the paper's swing costs beside a swing that is C2.

Both forms pass the same key-frames. The paper's lifts a resting foot at ``l_s / T_swing``: its velocity jumps
there, and its cubic pieces let the acceleration jump at every key-frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ampm.body.motion import WholeBodyMotion
from ampm.body.robot import Robot
from ampm.planner.feet import FootSample
from validation.paper.figures.accelerations import joint_accelerations
from validation.paper.figures.canvas import (
    FAINT,
    GRID,
    INK,
    MEASURED,
    MOTION,
    TRUNK,
    inches,
    legend_above,
    shade,
)
from validation.paper.figures.walks import Walk, Walks

Array = NDArray[np.float64]

GRIDS = (0.004, 0.002, 0.001)
"""Largest steps of the inverse kinematics' grid that are compared [s]."""

FORMS: Mapping[str, tuple[str, ...]] = {"quintic": (), "paper": ("foot.swing=paper",)}
"""Forms of the swing and the settings that give them."""

_COLORS = {"quintic": MOTION, "paper": MEASURED}


def figure_7(walks: Walks) -> tuple[Figure, dict[str, Any]]:
    """Key-frames, swing, joint accelerations and ZMP of both forms of the normal gait."""
    both = {form: walks.walk("normal", settings) for form, settings in FORMS.items()}
    jumps = {
        form: {f"{grid:g}": _jumps(walks, (*settings, f"solver.ik_time_step={grid}")) for grid in GRIDS}
        for form, settings in FORMS.items()
    }
    figure = Figure(figsize=(9.6, 10.2))
    _key_frames(inches(figure, 0.75, 0.52, 8.65, 2.7), both)
    _speed(inches(figure, 0.75, 4.3, 3.85, 2.1), both)
    _knee(inches(figure, 5.55, 4.3, 3.85, 2.1), both)
    _grid(inches(figure, 0.75, 7.45, 3.85, 2.25), jumps)
    _zmp(inches(figure, 5.55, 7.45, 3.85, 2.25), both)
    return figure, {form: {"walk": _cost(walk), "jumps": jumps[form]} for form, walk in both.items()}


def _jumps(walks: Walks, settings: Sequence[str]) -> dict[str, float]:
    """Changes of the joints over the grid intervals next to the switches."""
    planned = walks.plan("normal", settings)
    return joint_jumps(planned.motion, planned.body.robot)


def joint_jumps(motion: WholeBodyMotion, robot: Robot) -> dict[str, float]:
    """Largest changes of any joint's velocity and acceleration over one grid interval beside a switch.

    Returns:
        ``velocity`` [rad/s], ``acceleration`` [rad/s²] (of the solved accelerations), and ``difference``
        [rad/s²]: the largest acceleration that the velocities themselves give.
    """
    switch = int(np.searchsorted(motion.time, motion.double_support_start - 1e-12))
    last = len(motion.time) - 1
    # Mirrored, the end of a step is the start of the next one.
    before = robot.mirror_v(motion.acceleration[last - 1])
    pairs = [(switch - 1, switch), (switch, switch + 1), (last - 1, last), (0, 1)]
    velocity = [np.abs(motion.v[b, 6:] - motion.v[a, 6:]).max() for a, b in pairs]
    rate = [v / (motion.time[b] - motion.time[a]) for v, (a, b) in zip(velocity, pairs, strict=True)]
    change = [np.abs(motion.acceleration[b, 6:] - motion.acceleration[a, 6:]).max() for a, b in pairs]
    change.append(np.abs(motion.acceleration[0, 6:] - before[6:]).max())
    return {
        "velocity": float(max(velocity)),
        "acceleration": float(max(change)),
        "difference": float(max(rate)),
    }


def _cost(walk: Walk) -> dict[str, float]:
    """How well the gait was walked."""
    metrics = walk.trial.summary["metrics"]
    names = [f"zmp_{axis}_{what}" for what in ("rmse", "maximum") for axis in "xy"]
    names += [f"force_{axis}_rmse" for axis in "xyz"]
    limits = walk.trial.record.torque_limit
    torque = np.abs(walk.trial.record.torque) / limits
    rate = np.abs(np.diff(walk.trial.record.torque, axis=0)) / walk.trial.record.time_step
    return {
        **{name: float(metrics[name]["display"]["value"]) for name in names},
        "torque_share_percent": float(100.0 * torque.max()),
        "torque_rate_peak_kNm_per_s": float(1e-3 * rate.max()),
        "completed": float(walk.trial.record.outcome.completed),
    }


def _right_swing(walk: Walk) -> tuple[Array, FootSample]:
    """Right foot from heel rise to full contact: its times from lift-off [s], and its sample."""
    feet = walk.plan.feet
    constants = walk.plan.constants
    lift = 2.0 * constants.step_duration
    time = np.linspace(-constants.double_support_duration, constants.step_duration, 1200)
    return time, feet.sample(lift + time)[1]


def _key_frames(axis: Axes, both: Mapping[str, Walk]) -> None:
    """The foot in side view: at its key-frames, and the ball's way between them in both forms."""
    walk = both["quintic"]
    constants, foot = walk.plan.constants, walk.trial.planned.request.run.foot
    single, double = constants.single_support_duration, constants.double_support_duration
    for form, item in both.items():
        time, sample = _right_swing(item)
        inside = (time >= 0) & (time <= single)
        ball = sample.sole_points[inside][:, 2:4].mean(axis=1)
        axis.plot(
            ball[:, 0], ball[:, 2], color=_COLORS[form], linewidth=1.3, label=f"path of the ball, {form}"
        )
        heel = sample.sole_points[inside][:, 0:2].mean(axis=1)
        axis.plot(heel[:, 0], heel[:, 2], color=_COLORS[form], linewidth=0.8, linestyle=(0, (3, 2)))
    time, sample = _right_swing(walk)
    frames = (
        ("heel rise", -double - min(foot.heel_rise_lead, 0.0), 0.25),
        ("toe off", 0.0, 1.0),
        ("", 0.3 * single, 0.4),
        ("", 0.65 * single, 0.4),
        ("initial contact", single, 1.0),
        ("full contact", single + foot.full_contact * double, 0.25),
    )
    for name, at, weight in frames:
        row = int(np.argmin(np.abs(time - at)))
        points = sample.sole_points[row].reshape(3, 2, 3).mean(axis=1)[:, [0, 2]]
        c, s = np.cos(sample.pitch[row]), np.sin(sample.pitch[row])
        sole = walk.robot.description.sole
        ankle = sample.position[row, [0, 2]] + [
            sole.ankle_x * c + sole.ankle_height * s,
            -sole.ankle_x * s + sole.ankle_height * c,
        ]
        outline = np.array([points[0], points[1], ankle])
        axis.fill(*outline.T, facecolor=TRUNK, alpha=0.35 * weight, linewidth=0)
        axis.plot(*np.vstack([outline, outline[:1]]).T, color=TRUNK, alpha=0.4 + 0.6 * weight, linewidth=1.3)
        axis.plot(*points[1:].T, color=TRUNK, alpha=0.4 + 0.6 * weight, linewidth=2.2)
        if name:
            drop = -0.03 if name in ("toe off", "initial contact") else -0.075
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
    constants = walk.plan.constants
    v = constants.l_s / constants.single_support_duration
    axis.annotate(
        f"$l_s / T_{{swing}}$ = {v:.2f} m/s,\nat once", (0.0, v), (0.1, v - 0.15), fontsize=8, va="center",
        arrowprops={"arrowstyle": "-", "color": INK, "linewidth": 0.6},
    )  # fmt: skip
    _swing_axis(axis, walk)
    axis.set_title("(b) forward speed of the ball")
    axis.set_ylabel("[m/s]")
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
    axis.set_title("(c) knee acceleration")
    axis.set_ylabel("[rad/s²]")
    legend_above(axis, 2)


def _swing_axis(axis: Axes, walk: Walk) -> None:
    constants = walk.plan.constants
    single, double = constants.single_support_duration, constants.double_support_duration
    shade(axis, ((-double, 0.0), (single, single + double)))
    axis.set_xlim(-double, single + double)
    axis.axhline(0.0, color=FAINT, linewidth=0.6)
    axis.set_xlabel("time from lift-off [s]")


def _grid(axis: Axes, jumps: Mapping[str, Mapping[str, Mapping[str, float]]]) -> None:
    """Largest jumps at the switches against the grid of the inverse kinematics."""
    for form, by_grid in jumps.items():
        steps = 1e3 * np.array([float(grid) for grid in by_grid])
        for key, line, marker, what in (
            ("acceleration", "-", "o", "acceleration"),
            ("difference", (0, (3, 2)), "s", "Δ velocity / Δ t"),
        ):
            axis.plot(
                steps, [item[key] for item in by_grid.values()], color=_COLORS[form], linestyle=line,
                marker=marker, markersize=4, linewidth=1.2, label=f"{form}, {what}",
            )  # fmt: skip
    axis.set_xscale("log", base=2)
    axis.set_yscale("log")
    ticks = [1e3 * grid for grid in GRIDS]
    axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.minorticks_off()
    axis.grid(True, which="both", color=GRID)
    axis.set_xlim(max(ticks) * 1.2, min(ticks) / 1.2)
    axis.set_xlabel("largest step of the grid [ms]")
    axis.set_ylabel("[rad/s²]")
    axis.set_title("(d) largest jump of a joint at a switch")
    legend_above(axis, 2)


def _zmp(axis: Axes, both: Mapping[str, Walk]) -> None:
    """ZMP error along x over a stride, every stride."""
    for form, walk in both.items():
        measured = walk.trial.measured
        planned = walk.plan.sample(measured.time).zmp
        error = walk.folded(1e3 * (measured.zmp[:, 0] - planned[:, 0]))
        time = walk.phase
        axis.plot(time, error.T, color=_COLORS[form], linewidth=0.5, alpha=0.35)
        axis.plot(time, error.mean(axis=0), color=_COLORS[form], linewidth=1.2, label=form)
    walk = both["quintic"]
    shade(axis, walk.double_supports)
    axis.axhline(0.0, color=FAINT, linewidth=0.6)
    axis.set_xlim(0.0, walk.stride)
    axis.set_xlabel("time from the start of left single support [s]")
    axis.set_ylabel("[mm]")
    axis.set_title("(e) simulated less planned ZMP, along x")
    legend_above(axis)
