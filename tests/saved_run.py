"""A run folder without a simulation: the plan as the measurement, with known errors, for recording and report."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ampm.gait import plan_gait
from ampm.parameters import RunParameters, dump_run, load_run
from models.human import build
from validation.record import Outcome, OutcomeName, SimulationRecord, save_record

ZMP_ERROR = (1.5e-3, 0.7e-3)
"""Amplitude of the error that is put on the measured ZMP [m]."""


def make_run(directory: Path, *, steps: int = 4, seconds: float | None = None, name: str = "completed") -> Path:
    """Write a run folder that looks like a simulated walk.

    Args:
        directory: folder to fill.
        steps: planned steps.
        seconds: length of the record, the whole plan if None.
        name: the outcome.
    """
    run = load_run("normal", [f"gait.steps={steps}"])
    body = build(run.body, run.contact, run.simulation)
    model = body.compile()
    plan = plan_gait(run.gait, mass=run.body.mass, foot=run.foot, sole=body.description.sole)
    dt = run.simulation.time_step
    count = round((plan.duration if seconds is None else seconds) / dt)
    count = min(count, int(plan.duration / dt))
    time = dt * np.arange(count + 1)
    sample = plan.sample(np.minimum(time, plan.duration))
    left, right = plan.feet.sample(np.minimum(time, plan.duration))

    q = np.tile(_neutral(model), (count + 1, 1))
    q[:, 0:2] = sample.com[:, :2]
    swing = np.sin(np.pi * time / plan.constants.step_duration)
    names = [model.joint(j).name for j in range(1, model.njnt)]
    for index, joint in enumerate(names):
        sign = -1.0 if joint.startswith("right") else 1.0
        if joint.endswith("hip_pitch"):
            q[:, 7 + index] = -0.15 + 0.35 * sign * swing
        elif joint.endswith("knee"):
            q[:, 7 + index] = 0.4 - 0.2 * sign * swing
        elif joint.endswith("shoulder_pitch"):
            q[:, 7 + index] = -0.3 * sign * swing
    nv, nu = model.nv, model.nu
    rng = np.random.default_rng(0)

    point = np.concatenate([left.sole_points, right.sole_points], axis=1)[:count]
    contact = np.concatenate([np.repeat(f.contact, 2, axis=1) for f in (left, right)], axis=1)[:count]
    force = np.zeros((count, 12, 3))
    share = contact / np.maximum(contact.sum(axis=1, keepdims=True), 1)
    force[:] = share[..., None] * sample.force[:count, None, :]
    wobble = np.sin(2 * np.pi * 3.0 * time[:count])[:, None]
    zmp_error = np.asarray(ZMP_ERROR) * wobble
    limit = np.abs(model.actuator_ctrlrange[:, 1]) if model.actuator_ctrllimited.any() else np.full(nu, 100.0)
    limit = np.where(limit > 0, limit, 100.0)
    momentum = np.column_stack([sample.angular_momentum, np.sin(5 * time)])
    outcome = Outcome(
        OutcomeName(name),
        float(time[-1]),
        "" if name == "completed" else "The pelvis sank below half of its <height> & stayed there.",
        int(time[-1] / plan.constants.step_duration + 1e-9),
    )
    record = SimulationRecord(
        time=time, q=q, qd=np.zeros((count + 1, nv)),
        torque=limit * 0.6 * np.sin(np.outer(time[:count], 1 + np.arange(nu) / nu)),
        warmstart=np.zeros((count, nv)),
        point_force=force, point_position=point, point_penetration=np.where(contact, 5e-4, 0.0),
        point_velocity=np.zeros((count, 12, 3)),
        point_foot=np.repeat([0, 1], 6), point_group=np.tile(np.repeat([0, 1, 2], 2), 2),
        com=sample.com, angular_momentum=momentum,
        foot_position=np.stack([left.position, right.position], axis=1),
        foot_rotation=np.tile([1.0, 0.0, 0.0, 0.0], (count + 1, 2, 1)),
        sensors={},
        command_com=sample.com[:count], command_zmp=sample.zmp[:count] + 0.5 * zmp_error,
        command_force=sample.force[:count], command_angular_momentum=momentum[:count],
        command_point_force=force,
        tick_time=time[:count], qp_status=np.where(np.arange(count) % 97 == 5, 1, 0),
        qp_residual=10.0 ** rng.uniform(-9, -6, count), qp_iterations=np.full(count, 25),
        qp_time=1e-6 * rng.gamma(16.0, 1.2, count),
        outcome=outcome, mass=run.body.mass, gravity=9.81, time_step=dt,
        torque_limit=limit, joint_range=model.jnt_range[1:], joint_names=tuple(names), friction=0.8,
    )  # fmt: skip
    directory.mkdir(parents=True, exist_ok=True)
    save_record(record, directory)
    (directory / "model.xml").write_text(body.xml, encoding="utf-8")
    (directory / "run.toml").write_text(dump_run(run), encoding="utf-8")
    _write_signals(directory, record, plan, sample, zmp_error)
    (directory / "summary.json").write_text(json.dumps(_summary(record, run)), encoding="utf-8")
    return directory


def _neutral(model: mujoco.MjModel) -> np.ndarray:
    return np.array(model.qpos0, dtype=float)


def _write_signals(directory: Path, record: SimulationRecord, plan, sample, zmp_error: np.ndarray) -> None:
    count = record.steps
    phase = np.array(["single_support", "double_support"])[sample.phase[:count]]
    stance = np.array(["left", "right", "both"])[sample.stance[:count]]
    table: dict[str, np.ndarray | pa.Array] = {
        "time": record.time[:count],
        "phase": phase,
        "stance": stance,
    }

    def put(name: str, values: np.ndarray) -> None:
        for index, axis in enumerate("xyz"[: values.shape[1]]):
            table[f"{name}_{axis}"] = values[:, index]

    rng = np.random.default_rng(1)
    noise = rng.normal(size=(count, 3))
    put("plan_zmp", sample.zmp[:count])
    put("command_zmp", record.command_zmp)
    put("measured_zmp", sample.zmp[:count] + zmp_error)
    put("measured_zmp_momentum", sample.zmp[:count] + zmp_error + 2e-4 * noise[:, :2])
    put("plan_force", sample.force[:count])
    put("command_force", record.command_force)
    put("measured_force", sample.force[:count] + 2.0 * noise)
    put("plan_com", sample.com[:count])
    put("command_com", record.command_com)
    put("measured_com", sample.com[:count] + 1e-4 * noise)
    put("plan_angular_momentum", sample.angular_momentum[:count])
    table["plan_angular_momentum_z"] = pa.nulls(count, pa.float64())
    put("command_angular_momentum", record.command_angular_momentum)
    put("measured_angular_momentum", record.angular_momentum[:count] + 0.03 * noise)
    table["motion_angular_momentum_z"] = record.angular_momentum[:count, 2]
    for foot, name in enumerate(("left", "right")):
        force = record.point_force[:, record.point_foot == foot].sum(axis=1)
        put(f"{name}_force", force)
        table[f"{name}_contact"] = force[:, 2] > 0
    pq.write_table(pa.table(table), directory / "signals.parquet")


def _summary(record: SimulationRecord, run: RunParameters) -> dict:
    completed = record.outcome.completed
    return {
        "outcome": str(record.outcome.name),
        "verdict": "pass" if completed else "fail",
        "steps_completed": record.outcome.steps_completed,
        "metrics": {
            "zmp_x_rmse": {"value": 1.06, "unit": "mm", "tolerance": 2.0, "pass": True},
            "zmp_y_rmse": {"value": 1.2, "unit": "mm", "tolerance": 1.0, "pass": False},
            "zmp_x_max": {"value": 1.5, "unit": "mm", "tolerance": 15.0, "pass": True},
            "force_z_rmse": {"value": None, "unit": "% of body weight", "tolerance": 0.7, "pass": None},
        },
        "timing": {"simulation": 2.5, "real_time_factor": 8.0},
    }
