"""Draw the animation of README.md again: ``python docs/images/walk.py RUN`` writes walk.webp.

``RUN`` is the folder of ``ampm validate momentum --set gait.steps=8 --out RUN``. The pictures show one stride
of it from the side, at half speed: shapes of the body, ground force and ZMP as planned and as measured.
"""

import io
import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import mujoco
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.collections import PolyCollection
from PIL import Image
from scipy.spatial import ConvexHull

import validation as val

HERE = Path(__file__).resolve().parent
PLAN, MEASURED, GREY = "#3b9ddb", "#e8590c", "#8a8a8a"
FIRST, STRIDE, FRAMES, PAUSE = 4, 2, 48, 60
"""First switch and number of the steps that are drawn; number of pictures; time of each [ms]."""
FORCE = 1.0 / 550.0  # length of an arrow [m/N]
LABEL = {"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 1}
SIZE, DPI = (9.6, 4.4), 100


def surface(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Points on a shape in its own axes [m], shape (n, 3), whose convex hull is the shape."""
    kind, size = model.geom_type[geom], model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.mesh(model.geom_dataid[geom])
        return model.mesh_vert[mesh.vertadr[0] : mesh.vertadr[0] + mesh.vertnum[0]]
    turn, lift = np.meshgrid(np.linspace(0, 2 * np.pi, 24), np.linspace(-np.pi / 2, np.pi / 2, 13))
    ball = np.stack([np.cos(lift) * np.cos(turn), np.cos(lift) * np.sin(turn), np.sin(lift)], axis=-1)
    ball = ball.reshape(-1, 3)
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return size[0] * ball + np.outer(np.sign(ball[:, 2]), (0, 0, size[1]))
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return size * np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
    return ball * (size if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID else size[0])


class Walker:
    """Outlines of a recorded body from the side."""

    def __init__(self, run: Any) -> None:
        self.model = model = mujoco.MjModel.from_xml_string(run.model_xml)
        self.data = mujoco.MjData(model)
        large = (model.geom_bodyid > 0) & (model.geom_rbound > 0.005)
        self.shapes = {int(geom): surface(model, int(geom)) for geom in np.flatnonzero(large)}
        self.colours = {geom: model.geom_rgba[geom, :3] for geom in self.shapes}
        for geom, colour in self.colours.items():
            far = model.body(model.geom_bodyid[geom]).name.startswith("left")  # the eye is on the right
            self.colours[geom] = colour + (0.5 if far else 0.15) * (1 - colour)

    def outlines(self, q: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Polygons in x and z [m] and their colours, the farthest first."""
        self.data.qpos[:] = q
        mujoco.mj_kinematics(self.model, self.data)
        order = sorted(self.shapes, key=lambda geom: -self.data.geom_xpos[geom, 1])
        return [self.outline(geom) for geom in order], [self.colours[geom] for geom in order]

    def outline(self, geom: int) -> np.ndarray:
        """Convex outline of one shape in x and z [m]."""
        turned = self.data.geom_xmat[geom].reshape(3, 3)
        points = (self.shapes[geom] @ turned.T + self.data.geom_xpos[geom])[:, [0, 2]]
        return points[ConvexHull(points).vertices]


def arrow(axes: Any, zmp: np.ndarray, force: np.ndarray, colour: str, width: float) -> None:
    """The ground force, drawn from the ZMP."""
    tip = (zmp[0] + FORCE * force[0], FORCE * force[2])
    style = {"arrowstyle": "-|>", "color": colour, "lw": width, "mutation_scale": 6 + 4 * width}
    axes.annotate("", tip, (zmp[0], 0), arrowprops={**style, "shrinkA": 0, "shrinkB": 0}, zorder=5)


def curves(axes: Any, time: np.ndarray, planned: np.ndarray, measured: np.ndarray, title: str) -> Any:
    """Plan and measurement of one stride; returns the marker of the present."""
    axes.plot(time, planned, color=PLAN, lw=4, alpha=0.6, solid_capstyle="round")
    axes.plot(time, measured, color=MEASURED, lw=1.3)
    axes.set_title(title, loc="left", fontsize=10)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_xlim(time[0], time[-1])
    return axes.axvline(time[0], color="black", lw=1)


def picture(figure: Any) -> Image.Image:
    """The figure as it is now."""
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=DPI)
    return Image.open(buffer).convert("RGB")


def main(folder: Path) -> None:
    """Draw one stride of a run."""
    run = val.load(folder)
    signals, record, walker = run.signals, run.record, Walker(run)
    begun = signals.switches()[::2]  # a step is a single and a double support
    rows = np.arange(begun[FIRST], begun[FIRST + STRIDE])
    time = signals.time[rows] - signals.time[rows[0]]
    plan_zmp, zmp = signals.vector("plan_zmp", "xy"), signals.vector("measured_zmp", "xy")
    plan_force, force = signals.vector("plan_force", "xyz"), signals.vector("measured_force", "xyz")
    com = signals.vector("plan_com", "xyz")

    figure = plt.figure(figsize=SIZE)
    scene = figure.add_axes((0.0, 0.0, 0.52, 1.0))
    panels = [figure.add_axes((0.60, bottom, 0.38, 0.19)) for bottom in (0.74, 0.43, 0.12)]
    planned, measured = 1e3 * (plan_zmp - com[:, :2])[rows, 0], 1e3 * (zmp - com[:, :2])[rows, 0]
    marks = [
        curves(panels[0], time, planned, measured, "ZMP, ahead of the planned COM [mm]"),
        curves(panels[1], time, plan_force[rows, 0], force[rows, 0], "ground force, forward [N]"),
        curves(panels[2], time, 0 * time, measured - planned, "ZMP along x, measured minus plan [mm]"),
    ]
    panels[2].set_xlabel("time [s]")
    figure.text(0.03, 0.93, "plan", color=PLAN, fontsize=12, weight="bold")
    figure.text(0.085, 0.93, "measured in MuJoCo", color=MEASURED, fontsize=12, weight="bold")
    frames = []
    for row in rows[np.linspace(0, len(rows), FRAMES, endpoint=False).astype(int)]:
        now = signals.time[row]
        state = np.argmin(np.abs(record.state_rows * record.time_step - now))
        row = np.argmin(np.abs(signals.time - record.state_rows[state] * record.time_step))
        scene.clear()
        scene.set_axis_off()
        scene.set_aspect("equal")
        scene.set_xlim(com[row, 0] - 1.05, com[row, 0] + 1.05)
        scene.set_ylim(-0.12, 1.86)
        scene.axhline(0, color=GREY, lw=1, zorder=0)
        polygons, colours = walker.outlines(record.q[state])
        shapes = PolyCollection(polygons, facecolors=colours, edgecolors="white", lw=0.7, zorder=2)
        scene.add_collection(shapes)
        arrow(scene, plan_zmp[row], plan_force[row], PLAN, 5)
        arrow(scene, zmp[row], force[row], MEASURED, 1.8)
        scene.plot(*com[row, [0, 2]], "o", color="black", ms=6, zorder=6)
        text = {"fontsize": 10, "zorder": 6}
        scene.text(com[row, 0] - 0.06, com[row, 2] + 0.02, "COM", ha="right", bbox=LABEL, **text)
        scene.plot(plan_zmp[row, 0], 0, "o", color=PLAN, ms=10, zorder=6)
        scene.plot(zmp[row, 0], 0, "o", color=MEASURED, ms=5, zorder=6)
        scene.text(zmp[row, 0], -0.06, "ZMP", ha="center", va="top", **text)
        for mark in marks:
            mark.set_xdata([now - signals.time[rows[0]]] * 2)
        frames.append(picture(figure))
    first, *rest = frames
    film = {"save_all": True, "append_images": rest, "duration": PAUSE, "loop": 0}
    first.save(HERE / "walk.webp", quality=70, method=6, **film)


if __name__ == "__main__":
    mpl.use("Agg")
    main(Path(sys.argv[1]))
