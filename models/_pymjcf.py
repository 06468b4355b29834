"""PyMJCF without a display.

dm_control looks for an OpenGL context when it is imported, and warns or fails where there is none. Writing
MJCF needs no picture, so the search is switched off for the time of the import; mujoco's own renderer, which
reads the setting at its own import, keeps the caller's choice.
"""

from __future__ import annotations

import os

import mujoco  # noqa: F401  (first, see above)

_chosen = os.environ.get("MUJOCO_GL")
os.environ["MUJOCO_GL"] = "disable"
try:
    from dm_control import mjcf
finally:
    if _chosen is None:
        del os.environ["MUJOCO_GL"]
    else:
        os.environ["MUJOCO_GL"] = _chosen

__all__ = ["mjcf"]
