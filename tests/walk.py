"""A walk that follows its plan to the last bit, and ways to spoil it by a known amount."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from ampm.body.robot import Gaps
from ampm.description import SoleGeometry
from ampm.planner.support import plan_steps
from ampm.run_file import load_run
from ampm.walk import UNSOLVED, PostureState, WalkPlan
from tests.records import blank
from validation.measure.measure import Equations, MeasuredGait, SelfChecks, centre_of_pressure
from validation.run.trial import Trial
from validation.trial.outcome import Outcome, OutcomeName
from validation.trial.record import SimulationRecord

MASS = 60.0
EXACT = Equations(steps=1, median=0.0, largest=0.0, coordinate="", time=0.0, change=1.0)
"""Steps that obey the equations of motion."""
APART: Any = SimpleNamespace(
    recorded_gaps=lambda q: Gaps(np.full(len(q), 0.1), ("",) * len(q), np.full((len(q), 2, 3), np.nan))
)
"""Two shapes that never come near each other."""
SOLE = SoleGeometry(-0.107, 0.083, 0.151, 0.03, 0.045, 0.03, -0.042, 0.066)


def planned_momentum(times):
    """L_z, all that is known of the posture."""
    times = np.asarray(times)
    nothing, trunk = np.zeros((len(times), 0)), np.zeros((len(times), 3, 3))
    return PostureState(nothing, nothing, nothing, trunk, 0.5 * np.sin(3 * times))


def perfect_walk(steps=4, count=None):
    """Plan, record and measurement; ``count`` cuts the run short."""
    run, dt = load_run("momentum", [f"gait.steps={steps}"]), 0.002
    plan = plan_steps(run.gait, MASS, run.foot, SOLE)
    whole = int(plan.duration / dt)
    k = whole if count is None else count
    time = dt * np.arange(k + 1)
    sample = plan.sample(time)
    left, right = plan.feet.sample(time)
    contact = np.concatenate([np.repeat(foot.contact, 2, axis=1) for foot in (left, right)], axis=1)[:k]
    share = contact / np.maximum(contact.sum(axis=1, keepdims=True), 1)
    force = share[..., None] * sample.force[:k, None]
    places = np.concatenate([left.sole_points, right.sole_points], axis=1)
    momentum = np.column_stack([sample.angular_momentum, 0.5 * np.sin(3 * time)])
    name = OutcomeName.COMPLETED if k == whole else OutcomeName.FELL
    known: dict[str, Any] = {"mass": MASS, "gravity": 9.81, "time_step": dt}
    twice: dict[str, Any] = dict.fromkeys(("com", "com_pin"), sample.com[:k])
    twice |= dict.fromkeys(("zmp", "zmp_momentum"), sample.zmp[:k])
    twice |= dict.fromkeys(("force", "momentum_force"), sample.force[:k])
    twice |= dict.fromkeys(("slip", "penetration"), np.zeros((k, 2)))
    feet = np.stack([left.position, right.position], axis=1)
    record = blank(
        k,
        point_force=force,
        point_position=places[:k],
        point_place=places,
        point_foot=np.repeat([0, 1], 6),
        point_group=np.tile(np.repeat([0, 1, 2], 2), 2),
        com=sample.com,
        angular_momentum=momentum,
        foot_position=feet,
        command_com=sample.com[:k],
        command_zmp=sample.zmp[:k],
        command_force=sample.force[:k],
        command_angular_momentum=momentum[:k],
        outcome=Outcome(name, float(time[-1]), "" if name == "completed" else "The test ended it.", steps),
        friction=0.8,
        torque_limit=np.array([100.0, 50.0]),
        joint_range=np.array([[-1.0, 2.0], [-2.0, 2.0]]),
        joint_names=("knee", "hip"),
        **known,
    )
    foot_force = np.stack([force[:, :6].sum(axis=1), force[:, 6:].sum(axis=1)], axis=1)
    measured = MeasuredGait(
        time=time[:k],
        foot_force=foot_force,
        foot_torque=np.zeros((k, 2, 3)),
        floor=np.zeros(k),
        angular_momentum=momentum[:k],
        angular_momentum_rate=np.column_stack([sample.moment[:k], np.zeros(k)]),
        foot_contact=foot_force[:, :, 2] > 0,
        point_contact=contact,
        foot_position=feet[:k],
        polygon_margin=np.full(k, 0.01),
        self_checks=SelfChecks(0.0, 0.0, 0.0, EXACT),
        **twice,
        **known,
    )
    return (WalkPlan.of(plan, posture=SimpleNamespace(sample=planned_momentum)), record, measured)


def with_state(measured, com_shift=0.0, force_shift=0.0, moment_shift=0.0, instrument=0.0):
    """The same walk with another COM [m], force [N], moment [N m] and contact ZMP [m]: always consistent."""
    com = measured.com + com_shift
    force = measured.momentum_force + force_shift
    rate = measured.angular_momentum_rate + moment_shift
    zmp = centre_of_pressure(force, rate + np.cross(com, force), 0.0)
    states = {"com": com, "com_pin": com, "force": force, "momentum_force": force}
    zmps = {"zmp": zmp + instrument, "zmp_momentum": zmp}
    return replace(measured, angular_momentum_rate=rate, **states, **zmps)


def assert_follows(trial: Trial, limit: float) -> None:
    """Completed, every QP solved, within a limit of the RMS error of the ZMP [m]."""
    assert trial.record.outcome.completed, trial.record.outcome.cause
    assert not (trial.record.qp_status == UNSOLVED).any()
    error = trial.measured.zmp - trial.comparison.sample.zmp
    assert np.sqrt((error**2).mean(axis=0)).max() < limit


def without_point(record: SimulationRecord, index: int | None = None) -> SimulationRecord:
    """The same run with one sole point, or the one that carried the most, missing from the force log."""
    if index is None:
        index = int(np.argmax(record.point_force[:, :, 2].sum(axis=0)))
    force = record.point_force.copy()
    force[:, index] = 0.0
    return replace(record, point_force=force)
