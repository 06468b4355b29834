"""Figures 9 and 10: accelerations of the COM and of hip and knee, in plan, motion and physics."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from validation.paper.figures.canvas import MEASURED, inches, legend_above, shade
from validation.paper.figures.centroidal import agreement, peak
from validation.paper.figures.panels import band_legend, curves, difference
from validation.paper.figures.walks import Walk

Array = NDArray[np.float64]

SMOOTHING = 0.01
"""Interval over which differences of recorded joint velocities are taken for the dark curve [s]."""


Numbers = dict[str, dict[str, float | str]]
"""How far two curves are apart, by name."""


def com_accelerations(walk: Walk) -> tuple[Array, Array, Array]:
    """COM acceleration of plan and motion over a stride, (n, 3), and measured ones, (strides, n, 3) [m/s^2].

    The measured one is the net contact force over the mass, less gravity: no derivative is taken.
    """
    planned = walk.plan.sample(walk.stride_starts[0] + walk.phase).com_acceleration
    measured = walk.trial.measured
    force = walk.folded(measured.force / measured.mass)
    return planned, walk.ik.acceleration, force - np.array([0.0, 0.0, measured.gravity])


def figure_9(walk: Walk) -> tuple[Figure, Numbers]:
    """COM acceleration along the forward and the lateral axis over one stride."""
    planned, motion, measured = com_accelerations(walk)
    figure, axes = _paper()
    answers: Numbers = {}
    for row, (axis, letter, name) in enumerate((("x", "a", "forward"), ("y", "b", "lateral"))):
        upper, lower = axes[2 * row], axes[2 * row + 1]
        tolerance = walk.limit(f"force_{axis}_rmse") / walk.plan.mass
        away, error = motion[:, row] - planned[:, row], measured[..., row] - planned[:, row]
        for panel in (upper, lower):
            shade(panel, walk.double_supports)
        curves(
            upper, walk.phase, planned[:, row], motion[:, row], measured[..., row], tolerance=tolerance,
            source=f"simulation (contact force / m), mean of {len(measured)} strides",
        )  # fmt: skip
        upper.set_title(f"({letter}) COM acceleration along the {name} axis")
        upper.set_ylabel(f"$\\ddot{{{axis}}}_g$ [m/s²]")
        if row == 0:
            legend_above(upper)
        difference(lower, walk.phase, away, error, tolerance=tolerance, unit="m/s²")
        lower.set_ylabel("less plan")
        band_legend(lower)
        answers |= peak({f"COM acceleration {axis}": (away, error)}, "m/s²")
    _time_axis(axes, walk)
    return figure, answers


def joint_accelerations(walk: Walk, joint: str, sign: float) -> tuple[Array, Array, Array]:
    """Acceleration of one hinge: of the motion (n,), and of the simulation, raw and smoothed (strides, n).

    The recorded velocities are differenced over one time step, and over :data:`SMOOTHING`; both are central.
    """
    record = walk.trial.record
    index = record.joint_names.index(joint)
    velocity = sign * record.qd[:, 6 + index]
    dt = record.time_step
    raw = np.diff(velocity) / dt
    wide = max(2, round(SMOOTHING / dt))
    smooth = (velocity[wide:] - velocity[:-wide]) / (wide * dt)
    time = record.time
    motion = sign * walk.motion_sample.acceleration[:, walk.robot.velocity_indices((joint,))[0]]
    between = 0.5 * (time[1:] + time[:-1]), 0.5 * (time[wide:] + time[:-wide])
    return motion, walk.folded(raw, between[0]), walk.folded(smooth, between[1])


def figure_10(walk: Walk) -> tuple[Figure, Numbers]:
    """Flexion accelerations of the left hip and knee over one stride."""
    leg = walk.robot.description.left_leg
    figure, axes = _paper()
    answers: Numbers = {}
    # A positive turn about +y takes a hanging thigh back, and flexes the knee.
    for row, (name, joint, sign) in enumerate((("hip", leg.hip[0], -1.0), ("knee", leg.knee, 1.0))):
        motion, raw, smooth = joint_accelerations(walk, joint, sign)
        upper, lower = axes[2 * row], axes[2 * row + 1]
        for panel in (upper, lower):
            shade(panel, walk.double_supports)
        upper.plot(walk.phase, raw[len(raw) // 2], color=MEASURED, linewidth=0.5, alpha=0.5,
                   label="simulation, per time step")  # fmt: skip
        curves(upper, walk.phase, None, motion, smooth, source=f"simulation, over {1e3 * SMOOTHING:.0f} ms")
        upper.plot([], [], linestyle="", label="(no plan: it has no joints)")
        reach = 1.35 * max(float(np.abs(smooth).max()), float(np.abs(motion).max()))
        upper.set_ylim(-reach, reach)
        letter = "ab"[row]
        upper.set_title(f"({letter}) angular acceleration of flexion of the left {name}")
        upper.set_ylabel(f"{name} [rad/s²]")
        if row == 0:
            legend_above(upper)
        error = smooth - motion
        difference(lower, walk.phase, None, error)
        lower.set_ylabel("less IK")
        band_legend(lower)
        what = f"{name} acceleration: simulation ({1e3 * SMOOTHING:.0f} ms) less IK"
        answers[what] = agreement(error, "rad/s²")
    _time_axis(axes, walk)
    return figure, answers


def _paper() -> tuple[Figure, list[Axes]]:
    """Two curves, each over its own error, on common times."""
    figure = Figure(figsize=(8.4, 8.0))
    axes = [
        inches(figure, 0.8, top, 7.45, height)
        for top, height in ((0.52, 2.0), (2.82, 0.85), (4.25, 2.0), (6.55, 0.85))
    ]
    for axis in axes[:3]:
        axis.tick_params(labelbottom=False)
    for axis in axes:
        axis.yaxis.set_label_coords(-0.072, 0.5)
    return figure, axes


def _time_axis(axes: list[Axes], walk: Walk) -> None:
    for axis in axes:
        axis.set_xlim(0.0, walk.stride)
    axes[-1].set_xlabel("time from the start of left single support [s]; double support shaded")
