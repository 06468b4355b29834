"""A run folder without a simulation: the plan taken as the measurement, with known errors.

The recording and the report only read a folder, so their tests need one of the right shape, not a walk.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ampm.planner.support import plan_steps
from ampm.run_file import dump_run, load_run
from ampm.walk import WalkPlan
from models.human import build
from tests.walk import PlannedMomentum
from validation.judge.compare import compare
from validation.judge.metrics import evaluate
from validation.judge.profiles import DEFAULT
from validation.judge.signals import signals_table
from validation.judge.verdict import build_summary, judge
from validation.measure.measure import measure
from validation.store.environment import describe_environment
from validation.store.record import save_record
from validation.store.saved import digests
from validation.store.signals import save_signals
from validation.trial.bridge import pinocchio_model, to_pinocchio
from validation.trial.outcome import Outcome, OutcomeName
from validation.trial.record import SimulationRecord
from validation.trial.shapes import Shapes

ZMP_ERROR = (1.5e-3, 0.7e-3)
"""Amplitude of the error that is put on the measured ZMP [m]."""


def make_run(
    directory: Path,
    *,
    steps: int = 4,
    seconds: float = np.inf,
    outcome: Outcome | None = None,
    settings: Sequence[str] = (),
    angles: Mapping[str, float] = MappingProxyType({}),
) -> Path:
    """Write a run folder that looks like a simulated walk.

    Args:
        directory: folder to fill.
        steps: planned steps.
        seconds: length of the record, the whole plan at most.
        outcome: how it ended; completed if None.
        settings: changes of the gait, ``key=value``.
        angles: joints that are bent all the time [rad].
    """
    run = load_run("normal", [f"gait.steps={steps}", *settings])
    body = build(run.body, run.contact, run.simulation)
    model = body.compile()
    plan = plan_steps(run.gait, run.body.mass, run.foot, body.description.sole)
    dt = run.simulation.time_step
    count = int(min(seconds, plan.duration) / dt)
    time = np.asarray(dt * np.arange(count + 1), dtype=np.float64)
    sample = plan.sample(time)
    feet = plan.feet.sample(time)

    names = [leg.joints for leg in body.description.legs]
    joints = [model.joint(j).name for j in range(1, model.njnt)]
    q = np.tile(model.qpos0, (count + 1, 1))
    q[:, :2] = sample.com[:, :2]
    swing = np.sin(np.pi * time / plan.constants.step_duration)
    for leg, sign in zip(names, (1.0, -1.0), strict=True):
        for joint, (mean, amplitude) in zip((leg[0], leg[3]), ((-0.15, 0.35), (0.4, -0.2)), strict=True):
            q[:, 7 + joints.index(joint)] = mean + sign * amplitude * swing

    for joint, angle in angles.items():
        q[:, 7 + joints.index(joint)] = angle

    rows = slice(0, count)
    wobble = np.asarray(ZMP_ERROR) * np.sin(2 * np.pi * 3.0 * time[rows])[:, None]
    point = np.concatenate([foot.sole_points[rows] for foot in feet], axis=1)
    contact = np.concatenate([np.repeat(foot.contact[rows], 2, axis=1) for foot in feet], axis=1)
    share = _shares(point[..., :2], contact, sample.zmp[rows] + wobble)
    force = share[..., None] * sample.force[rows, None, :]
    limit = np.array([value for _, value in body.description.torque_limits])
    momentum = np.column_stack([sample.angular_momentum, np.sin(5 * time)])
    ends = outcome or Outcome(OutcomeName.COMPLETED, float(time[-1]), "", steps)
    rng = np.random.default_rng(0)
    record = SimulationRecord(
        time=time, q=q, qd=np.gradient(q, dt, axis=0)[:, 1:] if count else np.zeros((1, model.nv)),
        torque=limit * 0.6 * np.sin(np.outer(time[rows], 1 + np.arange(model.nu) / model.nu)),
        warmstart=np.zeros((count, model.nv)),
        point_force=force, point_position=point, point_penetration=np.where(contact, 5e-4, 0.0),
        point_velocity=np.zeros((count, 12, 3)),
        point_foot=np.repeat([0, 1], 6), point_group=np.tile(np.repeat([0, 1, 2], 2), 2),
        com=sample.com, angular_momentum=momentum,
        foot_position=np.stack([foot.position for foot in feet], axis=1),
        foot_rotation=np.tile([1.0, 0.0, 0.0, 0.0], (count + 1, 2, 1)),
        sensors={},
        command_com=sample.com[rows], command_zmp=sample.zmp[rows] + 0.5 * wobble,
        command_force=sample.force[rows], command_angular_momentum=momentum[rows],
        command_point_force=force,
        tick_time=time[rows], qp_status=np.where(np.arange(count) % 97 == 5, 1, 0),
        qp_residual=10.0 ** rng.uniform(-9, -6, count), qp_iterations=np.full(count, 25),
        qp_time=1e-6 * rng.gamma(16.0, 1.2, count),
        outcome=ends, mass=run.body.mass, gravity=9.81, time_step=dt,
        torque_limit=limit, joint_range=model.jnt_range[1:], joint_names=tuple(joints), friction=0.8,
    )  # fmt: skip
    measured = measure(record, pinocchio_model(model), to_pinocchio)
    noise = 2e-4 * rng.normal(size=(count, 2))
    # The legs swing as they like here; what they would tell of the momentum is replaced by the plan's.
    measured = replace(
        measured,
        com=sample.com[rows],
        zmp_momentum=measured.zmp + noise,
        momentum_force=measured.force,
        angular_momentum_rate=_moment(sample.com[rows], measured.zmp + noise, measured.force),
    )
    walk = WalkPlan.of(plan, posture=PlannedMomentum(lambda t: np.sin(5 * t)))
    comparison = compare(walk, record, measured, description=body.description, shapes=Shapes(model))
    verdict = judge(evaluate(comparison), DEFAULT, measured.weight, ended=ends.ending)
    directory.mkdir(parents=True, exist_ok=True)
    save_record(record, directory)
    save_signals(signals_table(comparison), directory / "signals.parquet")
    (directory / "model.xml").write_text(body.xml, encoding="utf-8")
    (directory / "run.toml").write_text(dump_run(run), encoding="utf-8")
    summary = build_summary(
        comparison, verdict,
        timing={"simulation": 2.5, "real_time_factor": 8.0},
        environment=describe_environment(),
        gait="normal", motion={"angular_momentum_y_offset": 0.406, "residual": 3e-11},
    )  # fmt: skip
    summary["files"] = digests(directory)
    (directory / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    return directory


def make_study(folder: Path, metrics: Mapping[str, Any], **more: Any) -> Path:
    """Write a ``convergence.json`` of the numerical uncertainties that it is given."""
    entries = {name: {"uncertainty_at_least": value, "not_studied": []} for name, value in metrics.items()}
    table = {
        "gait": "normal", "steps": 6, "run": "abc", "levels": {}, "metrics": entries, "parameters": {},
        "uncertainty_of": ["time_step", "ik_grid", "qp_tolerance"], "not_studied": [], **more,
    }  # fmt: skip
    path = folder / "convergence.json"
    path.write_text(json.dumps(table), encoding="utf-8")
    return path


def _shares(points: np.ndarray, contact: np.ndarray, zmp: np.ndarray) -> np.ndarray:
    """Shares (N, 12) of the load that put the centre of pressure at ``zmp``, spread as evenly as can be."""
    shares = np.zeros(contact.shape)
    for row in range(len(contact)):
        active = np.flatnonzero(contact[row])
        matrix = np.vstack([np.ones(len(active)), points[row, active].T])
        even = np.full(len(active), 1.0 / len(active))
        want = np.array([1.0, *zmp[row]])
        shares[row, active] = even + np.linalg.pinv(matrix) @ (want - matrix @ even)
    return shares


def _moment(com: np.ndarray, zmp: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Moment about the COM (N, 3) of a force that acts at the ZMP."""
    return np.cross(np.column_stack([zmp, np.zeros(len(zmp))]) - com, force)
