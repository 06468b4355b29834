"""dm_control without a display.

dm_control looks for an OpenGL context when it is imported, and warns or fails where there is none. Neither
writing MJCF nor stepping needs a picture, so the search is switched off for the time of the import; mujoco's
own renderer, which reads the setting at its own import, keeps the caller's choice.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import mujoco  # noqa: F401  (first, see above)


@contextmanager
def without_display() -> Iterator[None]:
    """Import dm_control within."""
    chosen = os.environ.get("MUJOCO_GL")
    os.environ["MUJOCO_GL"] = "disable"
    try:
        yield
    finally:
        if chosen is None:
            del os.environ["MUJOCO_GL"]
        else:
            os.environ["MUJOCO_GL"] = chosen


with without_display():
    from dm_control import mjcf

__all__ = ["mjcf", "without_display"]
