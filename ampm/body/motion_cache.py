"""Solved motions on disk, by a hash of all that they depend on."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import tempfile
import zipfile
import zlib
from dataclasses import fields
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ampm.body.motion import MotionReport, WholeBodyMotion
from ampm.body.step_reference import step_grid, step_reference

if TYPE_CHECKING:
    from ampm.body.robot import Robot
    from ampm.parameters import RunParameters
    from ampm.planner.support import StepPlan

_DAMAGED = (ValueError, KeyError, TypeError, AttributeError, EOFError, zipfile.BadZipFile, zlib.error)


def known_motion(
    plan: StepPlan, run: RunParameters, robot: Robot, folder: Path | None
) -> WholeBodyMotion | None:
    """The motion of a plan that a folder keeps, None if there is none."""
    return None if folder is None else find_motion(folder, motion_key(plan, run, robot))


def find_motion(folder: Path, key: str) -> WholeBodyMotion | None:
    """The motion stored under a key (:func:`motion_key`), bit for bit.

    Returns:
        None if there is no such file, or it cannot be read, is damaged, or was stored for other inputs: the
        motion is then solved again and overwritten.
    """
    try:
        # Opened here because numpy does not close a damaged archive.
        with _path(folder, key).open("rb") as file, np.load(file, allow_pickle=False) as stored:
            meta = json.loads(str(stored["meta"]))
            arrays = {name: stored[name] for name in stored.files if name != "meta"}
        if meta.pop("key") != key:
            return None
        names = tuple(meta.pop("joint_names"))
        report = MotionReport.from_dict(meta.pop("report"))
        return WholeBodyMotion(joint_names=names, report=report, **meta, **arrays)
    except (OSError, *_DAMAGED):
        return None


def keep_motion(motion: WholeBodyMotion, folder: Path, key: str) -> None:
    """Store a motion. Where the folder cannot be written, the next call solves the motion again."""
    values = {field.name: getattr(motion, field.name) for field in fields(motion)}
    arrays = {name: values.pop(name) for name in list(values) if isinstance(values[name], np.ndarray)}
    meta = json.dumps(values | {"report": motion.report.as_dict(), "key": key})
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        # Written under another name and renamed, so that readers see whole files only, also with several
        # writers.
        with tempfile.TemporaryDirectory(dir=folder, prefix=".") as beside:
            partial = Path(beside, "motion.npz")
            np.savez(partial, allow_pickle=False, meta=np.array(meta), **arrays)
            os.replace(partial, _path(folder, key))


def _path(folder: Path, key: str) -> Path:
    return folder / f"motion-{key}.npz"


def motion_key(plan: StepPlan, run: RunParameters, robot: Robot) -> str:
    """Hash of everything that a motion depends on: inputs, body, and the code and libraries that solve it."""
    sections = {
        "code": _code_hash(),
        "versions": [np.__version__, pin.__version__, *map(metadata.version, ("osqp", "numba"))],
        "plain": os.environ.get("NUMBA_DISABLE_JIT", "0"),  # plain Python rounds in other places
        "gait": run.gait.model_dump(exclude={"steps"}),
        "body": run.body.model_dump(),
        "foot": run.foot.model_dump(),
        "grid": run.solver.ik_time_step,
        "mass": plan.mass,
        "gravity": plan.gravity,
        "joints": robot.joint_names,
        "body_description": repr(robot.description),
        "shapes": robot.shapes.digest,
    }
    digest = hashlib.sha256(json.dumps(sections, sort_keys=True).encode())
    model = robot.model
    for inertia, placement in zip(model.inertias, model.jointPlacements, strict=True):
        digest.update(inertia.toDynamicParameters().tobytes() + placement.homogeneous.tobytes())
    for frame in model.frames:
        digest.update(frame.placement.homogeneous.tobytes())
    digest.update(robot.lower.tobytes() + robot.upper.tobytes())
    # Planners differ in the motion of the COM alone.
    reference = step_reference(plan, step_grid(plan, run.solver.ik_time_step))
    for values in (reference.time, reference.position, reference.velocity, reference.acceleration):
        digest.update(values.tobytes())
    return digest.hexdigest()[:24]


@cache
def _code_hash() -> str:
    """Hash of the source files that compute a motion."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for pattern in ("*.py", "planner/**/*.py", "body/**/*.py"):
        for path in sorted(package.glob(pattern)):
            digest.update(path.read_bytes())
    return digest.hexdigest()
