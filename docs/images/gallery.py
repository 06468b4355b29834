"""Draw the pictures of ``docs/gallery.md`` again: ``python docs/images/gallery.py [NAME ...]``.

Each is the view of the body in the recording of a walk, at one instant. Needs a Vulkan driver, as ``make.py``
does, and for ``g1`` and ``talos`` the extra ``robots``.
"""

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from make import HERE, picture_of_recording

import ampm
import validation as val
from ampm.planner import routes

FINE = {"time_step": 0.002}
BODY = (100, 31, 859, 570)
"""Where the view of the body is in the viewer [px]: left, top, right, bottom."""
COLUMNS = 640
"""Width of a picture [px]."""


def gait(name: str) -> val.Trial:
    """A preset."""
    return val.walk(ampm.load_run(name, gait={"steps": 6}, simulation=FINE))


def body(name: str) -> val.Trial:
    """Another body, with a gait of its size."""
    return val.walk(ampm.load_run(body={"source": name}, gait={"steps": 6}, simulation=FINE))


def push() -> val.Trial:
    """A push that the stabiliser survives that steps."""
    settings = {"gait": {"steps": 8}, "simulation": FINE, "controller": {"stabilizer": "stepping"}}
    shove = val.Push("chest", (0, 200, 0), at=1.8, duration=0.1)
    return val.walk(ampm.load_run("normal", **settings), disturbances=[shove])


def footsteps(steps: list[ampm.Footstep]) -> val.Trial:
    """A walk over footsteps."""
    return val.walk(ampm.load_run("normal", simulation=FINE), footsteps=steps)


PICTURES: dict[str, tuple[Callable[[], val.Trial], float]] = {
    "normal": (lambda: gait("normal"), 2.0),
    "momentum": (lambda: gait("momentum"), 2.75),
    "roll-0.1": (lambda: gait("roll-0.1"), 2.2),
    "push": (push, 2.6),
    "arc": (lambda: footsteps(routes.arc(12, 0.4, 1.2, 0.18)), 3.0),
    "platform": (lambda: footsteps(routes.platform(8, 0.4, 0.18, 0.08)), 4.0),
    "suite-humanoid": (lambda: body("suite-humanoid"), 1.5),
    "g1": (lambda: body("g1"), 1.5),
    "talos": (lambda: body("talos"), 2.0),
}
"""Name of a picture, its walk, and the instant [s]."""


if __name__ == "__main__":
    for name in sys.argv[1:] or PICTURES:
        make, instant = PICTURES[name]
        with tempfile.TemporaryDirectory() as folder:
            saved = Path(folder) / name
            make().save(saved)
            target = HERE / f"gallery-{name}.png"
            picture_of_recording(saved / "recording.rrd", instant, target, box=BODY, width=COLUMNS)
