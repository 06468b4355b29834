"""Draw the diagrams of ``docs/theory.md`` again: ``python docs/images/theory.py``.

Some lengths in the sketches are exaggerated to be visible; the curves are those of the planner.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt

from ampm.planner.centroidal import CentroidalPlan
from ampm.planner.periodic import plan_gait
from ampm.run_file import load_run

HERE = Path(__file__).resolve().parent
COM, ZMP, FORCE, GREY, WRONG = "#1f5fa8", "#c2410c", "#2e7d32", "#8a8a8a", "#b00020"
STYLE = {
    "font.size": 9,
    "svg.hashsalt": "ampm",
    "svg.fonttype": "path",
    "mathtext.fontset": "dejavusans",
    "axes.spines.top": False,
    "axes.spines.right": False,
}


def save(figure: Any, name: str) -> None:
    """Write a picture whose bytes depend only on its content."""
    figure.savefig(HERE / f"{name}.svg", metadata={"Date": None}, bbox_inches="tight", pad_inches=0.05)
    plt.close(figure)


def measure(axes: Any, start: float, end: float, height: float, label: str, colour: str = GREY) -> None:
    """A dimension line with its name under it."""
    axes.annotate(
        "",
        (end, height),
        (start, height),
        arrowprops={"arrowstyle": "<->", "color": colour, "shrinkA": 0, "shrinkB": 0, "lw": 0.9},
    )
    axes.text(0.5 * (start + end), height - 0.02, label, ha="center", va="top", color=colour)


def stage(axes: Any, title: str, left: float, right: float) -> None:
    """Floor and frame of a sketch."""
    axes.plot([left, right], [0, 0], color="black", lw=1.2)
    axes.set_xlim(left, right)
    axes.set_title(title, fontsize=9.5)
    axes.set_aspect("equal")
    axes.axis("off")


def force_line(axes: Any, zmp: float, meets: float, height: float) -> None:
    """Force from the ZMP to where its line meets the COM's height."""
    axes.annotate(
        "",
        (zmp + 0.62 * (meets - zmp), 0.62 * height),
        (zmp, 0),
        arrowprops={"arrowstyle": "-|>", "color": FORCE, "lw": 1.8, "shrinkA": 0, "shrinkB": 0},
    )
    reach = 1.12
    axes.plot([zmp, zmp + reach * (meets - zmp)], [0, reach * height], color=FORCE, lw=0.8, ls="--")


def point(
    axes: Any, x: float, z: float, label: str, colour: str, dx: float = 0.0, dz: float = 0.03, **kw: Any
) -> None:
    """A point with its name."""
    axes.plot([x], [z], "o", color=colour, ms=6)
    axes.text(x + dx, z + dz, label, color=colour, ha=kw.get("ha", "center"), va=kw.get("va", "bottom"))


def law() -> None:
    """One axis, one phase."""
    figure, axes = plt.subplots(figsize=(5.4, 3.9))
    stage(axes, "", -0.12, 1.0)
    H, u, zmp, meets = 0.72, 0.52, 0.28, 0.80
    axes.plot([-0.1, 0.98], [H, H], color=GREY, lw=0.7, ls=":")
    axes.text(-0.1, H + 0.015, "height $H$", color=GREY)
    axes.plot([u, u], [H, H + 0.15], color=GREY, lw=0.6, ls=":")
    axes.plot([meets, meets], [H, H + 0.15], color=GREY, lw=0.6, ls=":")
    force_line(axes, zmp, meets, H)
    point(axes, u, H, "COM $(u, H)$", COM, dx=-0.02, dz=-0.03, va="top", ha="right")
    point(axes, zmp, 0, "ZMP $(u/a + b,\\,0)$", ZMP, dx=-0.02, dz=-0.03, va="top", ha="right")
    axes.plot([meets], [H], "o", color=FORCE, ms=4)
    axes.text(meets + 0.02, H - 0.02, "$c u + b$", color=FORCE, va="top")
    axes.plot([u, u], [0, H], color=GREY, lw=0.6, ls=":")
    measure(axes, u, meets, H + 0.13, "lever $r$", GREY)
    axes.plot([meets, meets], [-0.14, H], color=GREY, lw=0.6, ls=":")
    measure(axes, zmp, meets, -0.1, "$(c - 1/a)\\,u$", FORCE)
    axes.text(0.40, 0.42 * H, "$F \\parallel ((c - 1/a)\\,u,\\ H)$", color=FORCE, ha="right")
    axes.annotate("", (0.0, 0.14), (0.0, 0), arrowprops={"arrowstyle": "->", "color": "black"})
    axes.annotate("", (0.14, 0.0), (0.0, 0), arrowprops={"arrowstyle": "->", "color": "black"})
    axes.text(0.15, 0.015, "$u$")
    axes.text(0.012, 0.14, "$z$")
    axes.set_ylim(-0.2, 0.9)
    save(figure, "theory-law")


def sagittal() -> None:
    """Fig. 4 of the paper: both supports of the sagittal plane."""
    figure, panels = plt.subplots(1, 2, figsize=(10.2, 3.9), width_ratios=(1.24, 1.56))
    H, l_s, l_d = 0.62, 0.34, 0.20
    slope_s, c_s = 0.42, 1.28
    inverse_a_d = 1.0 + (1.0 - slope_s) * l_s / l_d
    c_d = 1.0 - (c_s - 1.0) * l_s / l_d
    axes = panels[0]
    stage(axes, "(a) single support, from the stance foot", -0.62, 0.62)
    foot = [(-0.17, 0), (0.22, 0), (0.24, 0.03), (0.02, 0.09), (-0.16, 0.07)]
    axes.fill(*zip(*foot, strict=True), color="#e8e2d8", zorder=0)
    axes.plot([-l_s, l_s], [H, H], color=COM, lw=2.2)
    axes.plot([-l_s * slope_s, l_s * slope_s], [0, 0], color=ZMP, lw=4, solid_capstyle="butt")
    for sign, name in ((-1, "0"), (1, "1")):
        axes.plot([sign * l_s], [H], "|", color=COM, ms=10)
        axes.text(sign * l_s, H + 0.035, f"$P_{name}$", color=COM, ha="center")
        axes.text(sign * l_s * slope_s, -0.03, f"$Z_{name}$", color=ZMP, ha="center", va="top")
    x = 0.21
    force_line(axes, slope_s * x, c_s * x, H)
    axes.plot([x], [H], "o", color=COM, ms=6)
    axes.text(x - 0.01, H - 0.035, "$u$", color=COM, ha="right", va="top")
    axes.text(c_s * x + 0.03, H - 0.05, "$c_s u$", color=FORCE, va="top")
    axes.text(slope_s * x + 0.03, 0.035, "$u/a_s$", color=ZMP)
    axes.plot([0, 0], [0, H], color=GREY, lw=0.7, ls=":")
    measure(axes, -l_s, 0, H + 0.17, "")
    measure(axes, 0, l_s, H + 0.17, "")
    for at in (-0.5 * l_s, 0.5 * l_s):
        axes.text(at, H + 0.18, "$l_s$", ha="center", color=GREY)
    axes.set_ylim(-0.25, 0.9)

    axes = panels[1]
    stage(axes, "(b) double support, from the middle of both feet", -0.78, 0.78)
    half = l_s + l_d
    for at in (-half, half):
        shape = [(at + u, w) for u, w in foot]
        axes.fill(*zip(*shape, strict=True), color="#e8e2d8", zorder=0)
        axes.plot([at], [0], "^", color=GREY, ms=4)
    axes.plot([-l_d, l_d], [H, H], color=COM, lw=2.2)
    reach = l_d * inverse_a_d
    axes.plot([-reach, reach], [0, 0], color=ZMP, lw=4, solid_capstyle="butt")
    for sign, com, zmp in ((-1, "P_1", "Z_1"), (1, "P_0'", "Z_0'")):
        axes.plot([sign * l_d], [H], "|", color=COM, ms=10)
        axes.text(sign * l_d, H + 0.035, f"${com}$", color=COM, ha="center")
        axes.text(sign * reach, -0.03, f"${zmp}$", color=ZMP, ha="center", va="top")
    x = -0.14
    force_line(axes, inverse_a_d * x, c_d * x, H)
    axes.plot([x], [H], "o", color=COM, ms=6)
    axes.text(x + 0.0, H - 0.035, "$u$", color=COM, ha="center", va="top")
    axes.text(c_d * x + 0.045, H + 0.045, "$c_d u$", color=FORCE, va="bottom", ha="left")
    axes.text(inverse_a_d * x - 0.02, 0.035, "$u/a_d$", color=ZMP, ha="right")
    axes.plot([0, 0], [0, H], color=GREY, lw=0.7, ls=":")
    measure(axes, -half, 0, -0.115, "$l_s + l_d$")
    measure(axes, 0, half, -0.115, "$l_s + l_d$")
    measure(axes, -l_d, 0, H + 0.17, "")
    measure(axes, 0, l_d, H + 0.17, "")
    for at in (-0.5 * l_d, 0.5 * l_d):
        axes.text(at, H + 0.18, "$l_d$", ha="center", color=GREY)
    axes.set_ylim(-0.25, 0.9)
    figure.tight_layout()
    save(figure, "theory-sagittal")


def frontal() -> None:
    """Fig. 5 of the paper: both supports of the frontal plane, seen from behind."""
    figure, panels = plt.subplots(1, 2, figsize=(10.2, 4.1), width_ratios=(0.94, 1.32))
    H, s, beta, c_y = 0.62, 0.34, 0.13, 0.62
    axes = panels[0]
    stage(axes, "(a) single support, from the stance foot", -0.22, 0.72)
    axes.fill([-0.07, 0.07, 0.06, -0.06], [0, 0, 0.05, 0.05], color="#e8e2d8")
    turn = 0.20
    axes.plot([turn, s], [H, H], color=COM, lw=2.2)
    axes.plot([turn], [H], "|", color=COM, ms=10)
    axes.plot([s], [H], "|", color=COM, ms=10)
    axes.annotate(
        "",
        (turn + 0.005, H + 0.05),
        (s, H + 0.05),
        arrowprops={"arrowstyle": "->", "color": COM, "lw": 1.0},
    )
    axes.annotate(
        "",
        (s, H + 0.085),
        (turn + 0.005, H + 0.085),
        arrowprops={"arrowstyle": "->", "color": COM, "lw": 1.0},
    )
    y = 0.28
    force_line(axes, 0, c_y * y, H)
    axes.plot([y], [H], "o", color=COM, ms=6)
    axes.text(y, H - 0.035, "$u$", color=COM, ha="center", va="top")
    axes.text(c_y * y - 0.045, H - 0.02, "$c_y u$", color=FORCE, va="top", ha="right")
    point(axes, 0, 0, "ZMP at 0", ZMP, dz=-0.035, va="top")
    axes.plot([s, s], [0, H], color=GREY, lw=0.6, ls=":")
    axes.plot([s + beta] * 2, [0, H + 0.1], color=GREY, lw=0.9, ls="-.")
    axes.text(s + beta + 0.015, 0.3 * H, "midline", color=GREY, rotation=90, va="center")
    measure(axes, 0, s, -0.125, "$s$")
    measure(axes, s, s + beta, -0.125, "$\\beta$")
    axes.set_ylim(-0.24, 0.8)

    axes = panels[1]
    stage(axes, "(b) double support, from the midline", -0.66, 0.66)
    for at in (-(s + beta), s + beta):
        axes.fill([at - 0.07, at + 0.07, at + 0.06, at - 0.06], [0, 0, 0.05, 0.05], color="#e8e2d8")
    axes.plot([-beta, beta], [H, H], color=COM, lw=2.2)
    for at, name in ((-beta, r"$-\beta$"), (beta, r"$\beta$")):
        axes.plot([at], [H], "|", color=COM, ms=10)
        axes.text(at, H + 0.035, name, color=COM, ha="center")
    axes.plot([-(s + beta), s + beta], [0, 0], color=ZMP, lw=4, solid_capstyle="butt")
    y = -0.09
    zmp = (beta + s) / beta * y
    force_line(axes, zmp, zmp + c_y * (y - zmp), H)
    axes.plot([y], [H], "o", color=COM, ms=6)
    axes.text(y + 0.02, H - 0.035, "$u$", color=COM, va="top")
    axes.text(
        zmp + c_y * (y - zmp) - 0.05,
        H - 0.02,
        "$p + c_y (u - p)$",
        color=FORCE,
        va="top",
        ha="right",
    )
    axes.text(zmp + 0.03, 0.06, r"$p = \frac{\beta + s}{\beta}\, u$", color=ZMP)
    axes.plot([0, 0], [0, H + 0.1], color=GREY, lw=0.9, ls="-.")
    measure(axes, -(s + beta), 0, -0.125, r"$s + \beta$")
    measure(axes, 0, s + beta, -0.125, r"$s + \beta$")
    axes.set_ylim(-0.24, 0.8)
    figure.tight_layout()
    save(figure, "theory-frontal")


def plan_of(name: str, *settings: str) -> CentroidalPlan:
    """Plan of a preset."""
    run = load_run(name, settings)
    return plan_gait(run.gait, run.body.mass)


def switches() -> None:
    """Effect of the misprints of Eqs. 4, 6 and 7 at the first switch, against the plan."""
    figure, panels = plt.subplots(1, 3, figsize=(10.2, 2.9))
    plan = plan_of("momentum")
    gait, constants = load_run("momentum").gait, plan.constants
    t_ss, t_ds = constants.single_support_duration, constants.double_support_duration
    rate = plan.gravity / gait.com_height
    before = np.linspace(t_ss - 0.12, t_ss, 80)
    after = np.linspace(t_ss, t_ss + t_ds, 80)
    time = np.concatenate([before, after])
    sample = plan.sample(time)
    local = after - t_ss

    c_d = constants.l_d / (constants.l_s + constants.l_d - constants.l_s / gait.c_s)
    bracket = 1.0 / constants.a_d - c_d
    k = math.sqrt(rate * bracket)
    x = -constants.l_d * np.cos(k * local) + gait.switching_velocity / k * np.sin(k * local)
    _pair(panels[0], time, sample.com_acceleration[:, 0], after, -rate * bracket * x)
    panels[0].set_title("Eq. 4 (E4)", fontsize=9.5)
    panels[0].set_ylabel(r"$\ddot{x}$ [m/s$^2$]")

    t_l = 1.0 / math.sqrt(gait.c_y * rate)
    v_ex = constants.lateral_switching_velocity * t_l
    w_d = math.sqrt(gait.c_y * rate * constants.s / constants.beta)
    _pair(
        panels[1],
        time,
        -sample.com_velocity[:, 1],
        after,
        w_d * (constants.beta * np.sin(w_d * local) + v_ex * np.cos(w_d * local)),
    )
    panels[1].set_title(r"$v_{ex}$ before the sine (E6)", fontsize=9.5)
    panels[1].set_ylabel(r"$\dot{y}$ to the midline [m/s]")

    width = constants.s + constants.beta
    _pair(panels[2], time, sample.zmp[:, 1], after, constants.beta / width * sample.com[80:, 1])
    panels[2].set_title("$z_y$ inverted (E7)", fontsize=9.5)
    panels[2].set_ylabel("ZMP $y$ [m]")
    for axes in panels:
        axes.axvline(t_ss, color=GREY, lw=0.7, ls=":")
        axes.set_xlabel("time [s]")
    panels[0].legend(frameon=False, fontsize=8)
    figure.tight_layout()
    save(figure, "theory-switches")


def _pair(axes: Any, time: Any, right: Any, after: Any, wrong: Any) -> None:
    axes.plot(time, right, color=COM, lw=1.8, label="corrected")
    axes.plot(after, wrong, color=WRONG, lw=1.4, ls="--", label="as printed")


def momentum() -> None:
    """Angular momentum about both horizontal axes over a stride, for several c_y and c_s."""
    figure, panels = plt.subplots(1, 2, figsize=(9.2, 3.0))
    colours = mpl.colormaps["viridis"](np.linspace(0.05, 0.85, 4))
    for axes, axis, key, values in (
        (panels[0], 0, "c_y", (0.1, 0.4, 0.7, 1.0)),
        (panels[1], 1, "c_s", (0.6, 0.8, 1.2, 1.4)),
    ):
        for value, colour in zip(values, colours, strict=True):
            plan = plan_of("normal", f"gait.{key}={value}")
            time = np.linspace(0.0, 2.0 * plan.constants.step_duration, 601)
            axes.plot(
                time / plan.constants.step_duration,
                plan.sample(time).angular_momentum[:, axis],
                color=colour,
                label=f"${key[0]}_{key[2]}$ = {value:g}",
            )
        share = plan.constants.single_support_duration / plan.constants.step_duration
        for step in (0, 1):
            axes.axvspan(step + share, step + 1, color="#eeeeee", lw=0)
        axes.set_xlabel("time [steps], double support shaded")
        axes.set_ylabel(f"$L_{'xy'[axis]}$ [N m s]")
        axes.legend(
            frameon=False, fontsize=8, loc="upper center", ncols=4, handlelength=1.2, columnspacing=1.2
        )
        axes.set_xlim(0, 2)
        low, high = axes.get_ylim()
        axes.set_ylim(low, high + 0.2 * (high - low))
    panels[0].set_title("frontal plane (E12, E24)", fontsize=9.5)
    panels[1].set_title("sagittal plane, mean zero (E13)", fontsize=9.5)
    figure.tight_layout()
    save(figure, "theory-momentum")


if __name__ == "__main__":
    mpl.use("Agg")
    with mpl.rc_context(STYLE):
        for draw in (law, sagittal, frontal, switches, momentum):
            draw()
