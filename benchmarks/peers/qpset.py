"""The control QPs of recorded walks as one small file.

Each is ``min 1/2 x'Px + q'x`` with ``l <= Ax <= u``; ``-inf`` is no bound. All arrays but the last two have
one row for every QP:

    P, q, A, l, u       the problems
    x, y                solutions and multipliers, exact to 1e-14; forces in x in units of the weight
    sequence, time      number of the walk, time [s]
    weight, com_height  of each walk [N, m]
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ampm.body.robot import Robot
from ampm.control.controller import TrackingController
from ampm.control.workspace import ANGULAR, Problem
from ampm.geometry import Array
from ampm.parameters import RunParameters
from ampm.qp import QPBackend, QPSolution
from validation.progress import Progress
from validation.trial.plan import load_request, plan_walk
from validation.trial.simulate import simulate

FILE = Path(__file__).resolve().parents[1] / "data" / "control_qps.npz"
GAITS, TICKS = ("normal", "momentum"), 600
"""Gaits of the file, and ticks of each from the start of its walk."""

_EXACT = 1e-8  # residuals that a reference solution may leave


class Accuracy(NamedTuple):
    """Errors of solutions of T problems, each shape (T,).

    Attributes:
        primal: largest violation of a row.
        dual: largest entry of ``P x + q + A' y``.
        force: largest error of a point's normal force, or of a foot's force along the floor [N].
        zmp: distance from the ZMP of the reference solution [m].
    """

    primal: Array
    dual: Array
    force: Array
    zmp: Array


def load_set(file: Path = FILE) -> dict[str, Array]:
    """The arrays of a recorded set by name."""
    with np.load(file) as data:
        return {name: data[name] for name in data.files}


def save_set(file: Path, problems: dict[str, Array]) -> None:
    """Write a recorded set; equal sets give equal files."""
    with file.open("wb") as stream:
        np.savez_compressed(stream, **problems)  # type: ignore[arg-type]  # its stub takes them for a flag


def accuracy(problems: dict[str, Array], x: Array, y: Array) -> Accuracy:
    """Errors of solutions x (T, n) with multipliers y (T, m); infinite where there is none."""
    rows = np.einsum("tij,tj->ti", problems["A"], x)
    outside = np.maximum(problems["l"] - rows, rows - problems["u"])
    gradient = np.einsum("tij,tj->ti", problems["P"], x) + problems["q"]
    gradient += np.einsum("tji,tj->ti", problems["A"], y)
    forces, weight = x.shape[1] - 6, problems["weight"][problems["sequence"]]
    error = weight[:, None, None] * (x - problems["x"])[:, :forces].reshape(len(x), 2, -1)
    error[:, :, -1] = 0.0  # the twist is no force
    shift = _zmp(problems, x) - _zmp(problems, problems["x"])
    return Accuracy(
        primal=np.nan_to_num(outside.max(axis=1).clip(0.0), nan=np.inf),
        dual=np.nan_to_num(np.abs(gradient).max(axis=1), nan=np.inf),
        force=np.nan_to_num(np.abs(error).max(axis=(1, 2)), nan=np.inf),
        zmp=np.nan_to_num(np.hypot(*shift.T), nan=np.inf),
    )


def _zmp(problems: dict[str, Array], x: Array) -> Array:
    """ZMP of the contact forces relative to the COM, shape (T, 2) [m]."""
    forces = x.shape[1] - 6
    wrench = np.einsum("tij,tj->ti", problems["A"][:, :6, :forces], x[:, :forces])
    force, moment, height = (
        wrench[:, :3],
        wrench[:, 3:] / ANGULAR,
        problems["com_height"][problems["sequence"]],
    )
    lever = [-moment[:, 1] - height * force[:, 0], moment[:, 0] - height * force[:, 1]]
    return np.stack(lever, axis=1) / force[:, 2:]


def record_set(progress: Progress, gaits: tuple[str, ...] = GAITS, ticks: int = TICKS) -> dict[str, Array]:
    """Walk, and keep every QP as the controller hands it to its solver, with a reference solution.

    Raises:
        RuntimeError: the recorded problems, solved again in a new workspace, do not give the controller's
            solutions to the bit, or a reference solution leaves a residual of 1e-8.
    """
    parts = [_walk(gait, ticks, progress) for gait in gaits]
    problems = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    problems["sequence"] = np.repeat(np.arange(len(gaits)), ticks)
    answers = [_reference(*problem) for problem in zip(*(problems[name] for name in "PqAlu"), strict=True)]
    problems["x"], problems["y"] = (np.stack(values) for values in zip(*answers, strict=True))
    worst = max(float(error.max()) for error in accuracy(problems, problems["x"], problems["y"])[:2])
    if not worst < _EXACT:
        raise RuntimeError(f"a reference solution leaves a residual of {worst:.2g}, more than {_EXACT:g}")
    return problems


@dataclass
class _Recorder:
    """A backend that keeps its problems and answers."""

    backend: QPBackend
    problems: list[Problem] = field(default_factory=list)
    answers: list[Array] = field(default_factory=list)

    def solve(self, P: Array, q: Array, A: Array, lower: Array, upper: Array) -> QPSolution:
        """See :class:`ampm.qp.QPBackend`."""
        self.problems.append(Problem(P.copy(), q.copy(), A.copy(), lower.copy(), upper.copy()))
        solution = self.backend.solve(P, q, A, lower, upper)
        self.answers.append(solution.x)
        return solution


def _walk(gait: str, ticks: int, progress: Progress) -> dict[str, Array]:
    """The first QPs of a walk."""
    walk = plan_walk(load_request(gait, ["gait.steps=4", "solver.qp=osqp"]), progress)
    recorders: list[_Recorder] = []

    def recorded(robot: Robot, run: RunParameters) -> TrackingController:
        controller = TrackingController(robot, run)
        recorders.append(_Recorder(controller.contact_qp.backend))
        controller.contact_qp.backend = recorders[0]
        return controller

    with progress.stage(f"{gait}: {ticks} control QPs"):
        simulate(walk.plan, walk.run, walk.body.model, controller=recorded)
        fresh, kept = TrackingController(walk.body.robot, walk.run).contact_qp.backend, recorders[0]
        for problem, answer in zip(kept.problems, kept.answers, strict=True):
            if not np.array_equal(fresh.solve(*problem).x, answer):
                raise RuntimeError(f"{gait}: a recorded QP has another solution than the controller's")
    problems = [np.stack(values[:ticks]) for values in zip(*kept.problems, strict=True)]
    return dict(zip("PqAlu", problems, strict=True)) | {
        "time": np.arange(ticks) / walk.run.controller.frequency,
        "weight": np.array([walk.plan.weight]),
        "com_height": np.array([walk.plan.com_height]),
    }


def _reference(P: Array, q: Array, A: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Solution and multipliers by an active-set solver with tight tolerances."""
    import daqp  # an optional package

    sense = np.where(lower == upper, 5, 0).astype(np.int32)
    tight = {"primal_tol": 1e-11, "dual_tol": 1e-12, "progress_tol": 1e-14, "iter_limit": 10_000}
    x, _, flag, info = daqp.solve(P, q, A, upper.clip(max=1e30), lower.clip(min=-1e30), sense, **tight)
    if flag != 1:
        raise RuntimeError(f"DAQP does not solve a recorded QP (status {flag})")
    return np.array(x), np.array(info["lam"])
