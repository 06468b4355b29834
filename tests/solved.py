"""Bodies, plans and periodic steps that several test modules share; each is made once per process."""

from functools import cache
from typing import Any, NamedTuple

from ampm import PeriodicPlanner, Replanner, RunParameters, WalkPlan, load_run
from ampm.body.motion import PeriodicPosture, WholeBodyMotion
from ampm.body.orbit import solve_motion
from ampm.body.robot import Robot
from ampm.planner.support import StepPlan, plan_steps
from models.load import build_body
from models.scene import BodyModel
from tests.records import same_bits
from validation.run.replay import step_again
from validation.trial.physics import Physics
from validation.trial.plan import Body, PlannedWalk, Request
from validation.trial.record import SHAPES, SimulationRecord
from validation.trial.simulate import simulate

WALK = (
    "gait.com_height=0.875",
    "gait.step_length=0.6",
    "gait.switching_velocity=1.0",
    "gait.steps=4",
    "foot.swing_height=0.05",
    "foot.swing_lag=0.05",
    "foot.toe_return=0.8",
    "foot.toe_off_angle=0.45",
    "foot.toe_off_rate=6.5",
    "foot.heel_strike_angle=0.175",
    "simulation.time_step=0.002",
)
"""A walk well within the body's reach, whatever the presets are tuned to, a step of the physics per tick."""

QUICK = {"gait": {"steps": 2}, "solver": {"ik_time_step": 0.01}, "simulation": {"time_step": 0.002}}
"""Sections of a short walk, for tests that need no accuracy."""

COARSE = "solver.ik_time_step=0.004"
"""Half the default's instants, for tests that need no more."""


class Walk(NamedTuple):
    """A gait, its plan with feet, and the body that is to walk it."""

    run: RunParameters
    plan: StepPlan
    robot: Robot


class Changed:
    """A planner of a user's own: ours with other keys, its plan changed by a function."""

    def __init__(self, change=lambda plan: plan, **keys):
        self.change, self.keys = change, {f"gait.{name}": value for name, value in keys.items()}

    def plan(self, run, robot):
        return self.change(PeriodicPlanner().plan(run.replace(self.keys), robot))


@cache
def walk_of(*overrides: str) -> Walk:
    """The walk :data:`WALK` with some settings changed."""
    run = load_run(None, [*WALK, *overrides])
    model = build_body(run)
    robot = Body.of(model).robot
    return Walk(run, plan_steps(run.gait, run.body.mass, run.foot, model.description.sole), robot)


@cache
def motion_of(*overrides: str) -> WholeBodyMotion:
    """Its periodic step."""
    walk = walk_of(*overrides)
    return solve_motion(walk.plan, walk.run, walk.robot)


@cache
def planned_walk(*overrides: str) -> WalkPlan:
    """Its complete plan; the periodic step is that of :data:`COARSE`, whatever is changed."""
    walk, motion = walk_of(COARSE, *overrides), motion_of(COARSE)
    steps = walk.plan.with_angular_momentum_offset(motion.report.angular_momentum_y_offset)
    return WalkPlan.of(steps, posture=PeriodicPosture(motion, walk.robot))


@cache
def body_of(*overrides: str) -> BodyModel:
    """The simulated body, with some settings changed."""
    return build_body(walk_of(COARSE, *overrides).run)


def replays(record: SimulationRecord, *overrides: str) -> bool:
    """Whether a walk under these settings gives every bit of states, contacts and pushes again."""
    again = step_again(Physics(Body.of(body_of(*overrides)), walk_of(COARSE, *overrides).run), record)
    names = [name for name in SHAPES if not name.startswith(("command_", "qp_", "tick_plan"))]
    return all(same_bits(getattr(record, name), getattr(again, name)) for name in names)


def simulated(*overrides: str, steps: int = 2, **options: Any) -> SimulationRecord:
    """A short walk under some settings; the motion does not depend on controller and contact."""
    overrides = (*overrides, f"gait.steps={steps}")
    return simulate_plan(planned_walk(*overrides), *overrides, **options)


def simulate_plan(
    plan: WalkPlan,
    *overrides: str,
    body: BodyModel | None = None,
    planner: Replanner | None = None,
    **options: Any,
) -> SimulationRecord:
    """A plan walked under some settings."""
    run, model = walk_of(COARSE, *overrides).run, Body.of(body or body_of(*overrides))
    return simulate(PlannedWalk(Request("walk", run), plan, model, replanner=planner), **options)
