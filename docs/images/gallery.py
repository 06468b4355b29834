"""Draw the moving pictures of ``docs/gallery.md`` again: ``python docs/images/gallery.py [NAME ...]``.

Each shows bodies, footsteps and ground force of one or two walks at half speed. ``g1`` needs the extra
``robots``, ``drake`` the extra ``drake``.
"""

import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from PIL import Image, ImageDraw
from scipy.spatial import ConvexHull
from walk import MEASURED, PLAN, surface

import ampm
import validation as val
from ampm.planner import routes
from ampm.planner.contacts import footprint

HERE = Path(__file__).resolve().parent
FINE = {"time_step": 0.002}
SIZE, SCALE, SHARP = (440, 400), 175.0, 2
"""Width and height of a body's picture [px], pixels of a metre, and by how much finer it is drawn."""
FRAMES, SLOWER = 36, 2.0
AZIMUTH, ELEVATION = np.radians([-62.0, 14.0])
"""Direction from which the body is seen, about the vertical from behind, and over the horizon."""
FORCE = 1.0 / 550.0
"""Length of an arrow for a body of 60 kg [m/N]."""
PAPER, GRID, INK = "#ffffff", "#dfe3e8", "#20242a"

Walks = Sequence[tuple[str, val.Trial]]


class Film:
    """Pictures of one walk."""

    def __init__(self, trial: val.Trial, folder: Path) -> None:
        trial.save(folder, recording=False)
        self.run, self.plan = val.load(folder), trial.plan
        self.model = mujoco.MjModel.from_xml_string(self.run.model_xml)
        self.data = mujoco.MjData(self.model)
        large = (self.model.geom_bodyid > 0) & (self.model.geom_rbound > 0.005)
        self.shapes = {int(geom): surface(self.model, int(geom)) for geom in np.flatnonzero(large)}
        self.time = self.run.record.state_rows * self.run.record.time_step
        c, s, up = np.cos(AZIMUTH), np.sin(AZIMUTH), np.sin(ELEVATION)
        self.axes = np.array([[-s, -c, 0.0], [up * c, -up * s, np.cos(ELEVATION)]])
        self.depth = np.cross(self.axes[0], self.axes[1])

    def picture(self, now: float, title: str) -> Image.Image:
        """The walk at a time [s]."""
        run, signals = self.run, self.run.signals
        state = int(np.abs(self.time - now).argmin())
        row = int(np.abs(signals.time - self.time[state]).argmin())
        self.data.qpos[:] = run.record.q[state]
        mujoco.mj_forward(self.model, self.data)
        com, size = self.data.subtree_com[0].copy(), run.record.mass / 60.0
        image = Image.new("RGB", tuple(SHARP * side for side in SIZE), PAPER)
        self.draw, self.centre = ImageDraw.Draw(image), self.axes @ [com[0], com[1], 0.0]
        self.unit = SHARP * SCALE * min(1.75 / (1.85 * com[2]), 1.6)
        near = np.array([*np.round(2 * com[:2]) / 2, 0.0])  # lines half a metre apart
        for at in 0.5 * np.arange(-4, 5):
            for ends in ([[-2, at, 0], [2, at, 0]], [[at, -2, 0], [at, 2, 0]]):
                self.line(near + ends, GRID, 1)
        for geom in range(self.model.ngeom):
            if self.model.geom(geom).name.startswith("floor_"):
                self.polygon(self.top(geom), "#eef1f4", GRID)
        for step in self.plan.contacts.footsteps:
            sole = footprint(self.plan.feet.sole, step)
            self.line(np.column_stack([sole, np.full(len(sole), step.position[2])]), PLAN, 1)
        for geom in sorted(self.shapes, key=lambda geom: float(self.data.geom_xpos[geom] @ self.depth)):
            points = self.shapes[geom] @ self.data.geom_xmat[geom].reshape(3, 3).T + self.data.geom_xpos[geom]
            flat = points @ self.axes.T
            colour = tuple(int(255 * (0.25 + 0.75 * part)) for part in self.model.geom_rgba[geom, :3])
            self.polygon(points[ConvexHull(flat).vertices], colour, PAPER)
        floor = run.record.point_position[state, :, 2].min() if len(run.record.floor) != 1 else 0.0
        for kind, colour, width in (("plan", PLAN, 5), ("measured", MEASURED, 2)):
            force, zmp = signals.vector(f"{kind}_force", "xyz")[row], signals.vector(f"{kind}_zmp", "xy")[row]
            if np.isfinite([*force, *zmp]).all():
                foot = np.array([*zmp, max(floor, 0.0)])
                self.line([foot, foot + FORCE / size * force], colour, width)
                self.dot(foot, colour, 2 + width)
        self.dot(com, INK, 4)
        self.draw.text((14, 10), title, INK, font_size=15 * SHARP)
        self.draw.text((14, SHARP * SIZE[1] - 40), f"{now:.2f} s", INK, font_size=13 * SHARP)
        return image.resize(SIZE, Image.Resampling.LANCZOS)

    def top(self, geom: int) -> np.ndarray:
        """Corners of the upper face of a box [m]."""
        half, turned = self.model.geom_size[geom].clip(max=3.0), self.data.geom_xmat[geom].reshape(3, 3)
        corners = [(x * half[0], y * half[1], half[2]) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        return np.array(corners) @ turned.T + self.data.geom_xpos[geom]

    def seen(self, points: Any) -> list[tuple[float, float]]:
        """Points (n, 3) [m] in the picture [px]."""
        flat = (np.asarray(points) @ self.axes.T - self.centre) * self.unit
        left, low = 0.5 * SHARP * SIZE[0], 0.86 * SHARP * SIZE[1]
        return [(left + x, low - y) for x, y in flat.tolist()]

    def line(self, points: Any, colour: str, width: int) -> None:
        """A line through points [m] of a width [px]."""
        self.draw.line(self.seen(points), colour, width * SHARP, joint="curve")

    def polygon(self, points: Any, colour: Any, edge: str) -> None:
        """An area with an edge."""
        self.draw.polygon(self.seen(points), colour, edge, SHARP)

    def dot(self, point: Any, colour: str, radius: int) -> None:
        """A dot at a point [m]."""
        self.draw.circle(self.seen([point])[0], radius * SHARP, colour)


def film(name: str, walks: Walks, begin: float, end: float) -> None:
    """Write the picture of walks side by side between two times [s]."""
    with tempfile.TemporaryDirectory() as folder:
        films = [(title, Film(trial, Path(folder) / str(k))) for k, (title, trial) in enumerate(walks)]
        frames = []
        for now in np.linspace(begin, end, FRAMES, endpoint=False):
            frame = Image.new("RGB", (SIZE[0] * len(films), SIZE[1]))
            for k, (title, part) in enumerate(films):
                last = part.run.record.outcome.time
                frame.paste(part.picture(min(now, last), title), (k * SIZE[0], 0))
            frames.append(frame)
    pause = int(1000 * SLOWER * (end - begin) / FRAMES)
    first, *rest = frames
    more = {"save_all": True, "append_images": rest, "duration": pause, "loop": 0}
    first.save(HERE / f"gallery-{name}.webp", quality=50, method=6, **more)


def gait(name: str, steps: int = 6, **sections: Any) -> val.Trial:
    """A preset with settings by section."""
    return val.walk(ampm.load_run(name, gait={"steps": steps}, simulation=FINE, **sections))


def engine(name: str) -> val.Trial:
    """``normal`` in an engine."""
    settings = {"gait": {"steps": 5}, "simulation": {**FINE, "engine": name}}
    return val.walk(ampm.load_run("normal", **settings))


def planned(name: str) -> val.Trial:
    """``normal`` by a planner."""
    return val.walk(ampm.load_run("normal", gait={"planner": name, "steps": 6}, simulation=FINE))


def over(footsteps: list[ampm.Footstep]) -> val.Trial:
    """A walk over footsteps."""
    return val.walk(ampm.load_run("normal", simulation=FINE), footsteps=footsteps)


def pushed(**controller: str) -> val.Trial:
    """A push of 200 N for 0.1 s to the left."""
    push = val.Push("chest", (0.0, 200.0, 0.0), at=1.8, duration=0.1)
    run = ampm.load_run("normal", gait={"steps": 8}, simulation=FINE, controller=controller)
    return val.walk(run, disturbances=[push])


PICTURES: dict[str, tuple[Callable[[], Walks], float, float]] = {
    "normal": (lambda: [("normal", gait("normal"))], 1.36, 2.72),
    "momentum": (lambda: [("momentum", gait("momentum"))], 1.44, 2.88),
    "turn": (lambda: [("", over(routes.arc(12, 0.4, 1.2, 0.18)))], 2.0, 6.0),
    "platform": (lambda: [("", over(routes.platform(8, 0.4, 0.18, 0.08)))], 1.5, 6.0),
    "push": (lambda: [("fixed", pushed()), ("stepping", pushed(stabilizer="stepping"))], 1.6, 4.2),
    "g1": (lambda: [("", val.walk(ampm.load_run(body={"source": "g1"}, simulation=FINE)))], 1.5, 3.2),
    "drake": (lambda: [("MuJoCo", engine("mujoco")), ("Drake", engine("drake"))], 1.36, 2.72),
    "planner": (lambda: [("lipm fails", planned("lipm")), ("ampm passes", planned("ampm"))], 1.4, 2.8),
}
"""Name of a picture; its walks with their titles, begin and end [s]."""


if __name__ == "__main__":
    for name in sys.argv[1:] or PICTURES:
        make, begin, end = PICTURES[name]
        film(name, make(), begin, end)
