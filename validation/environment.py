"""A walk as a dm_control environment: an agent makes the torques, the reward is the agreement with the plan.

    from validation import environment

    env = environment.load("normal", seed=1)
    step = env.reset()
    while not step.last():
        step = env.step(policy(step.observation))

An episode begins at a random instant of the plan's first stride, and ends with a fall or with the plan. It is
stepped by the loop of every walk, with its disturbances, sensors and engines.
"""

import math
import os
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from numbers import Integral
from typing import Any
from unittest import mock

import numpy as np
from dm_env import specs

from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.parameters import NO_PLAN, RunParameters
from ampm.walk import ControlOutput
from validation.judge.profiles import DEFAULT
from validation.trial.disturbances import Disturbance, check_disturbances
from validation.trial.outcome import Outcome, OutcomeName
from validation.trial.physics import Physics, quiet_mujoco
from validation.trial.plan import PlannedWalk, load_request, plan_walk
from validation.trial.policy import observe
from validation.trial.readings import DivergedEstimate, make_estimator
from validation.trial.references import References
from validation.trial.simulate import ClosedLoop, copied, forces_of, place
from validation.trial.users import real_numbers

# dm_control looks for an OpenGL context when it is imported, and warns or fails where there is none. MuJoCo
# has read the variable at its own import and keeps the caller's choice.
with mock.patch.dict(os.environ, MUJOCO_GL="disable"):
    from dm_control.rl import control
    from dm_control.utils import rewards


REWARDED = ("zmp_x", "zmp_y", "angular_momentum_x", "angular_momentum_y")
"""Signals whose errors make the reward."""
_MARGIN = 10.0  # largest error of a signal without a limit on single instants, in limits of the RMSE [1]


def load(
    source: RunParameters | str | None = None,
    /,
    *,
    seed: int | None = None,
    random_start: bool = True,
    disturbances: Sequence[Disturbance] = (),
    **sections: Mapping[str, Any],
) -> control.Environment:
    """The environment of one gait.

    A step of the environment is a control tick, ``controller.frequency``; the torque is held in between. The
    action is the torque of every motor [N m]; the observation is that of
    :func:`validation.trial.policy.observe`, from the sensors of the run. The reward, 0 ... 1, is the product
    over :data:`REWARDED` of a tolerance: 1 within the limit of the RMSE, 0.1 at that of the largest error,
    both of profile ``default``. The first plan of a planner that goes on planning is followed to its end.

    Args:
        source: parameters, or a preset or TOML file; `normal` by default, or the own gait of another body.
        seed: of the episodes: of the instants at which they begin, and of sensors and faults.
        random_start: begin at a random instant of the first stride; else always with the walk, and with the
            seeds of the run.
        disturbances: external forces, beside those of the run; their times count from the begin of an
            episode, which has copies of its own.
        sections: values by section and key, as :func:`ampm.load_run` takes them.

    Raises:
        InputError, MathematicalRefusal, BodilyRefusal: there is no such walk.
    """
    check_disturbances(disturbances)
    request = load_request(source, sections=sections)
    if request.run.gait.planner == NO_PLAN:
        raise InputError("the reward of an environment is the agreement with a plan; leave out planner none.")
    if request.run.sensors.stand:
        raise InputError("sensors.stand: an episode begins in the walk; leave it out.")
    held = request.run.replace({"controller.hold": "zero-order"})
    walk = FollowedWalk(plan_walk(replace(request, run=held)), disturbances)
    if not (seed is None or (isinstance(seed, Integral) and 0 <= seed < 2**32)):
        raise InputError(f"seed = {seed!r} must be a whole number from 0 to 2^32 - 1, or None.", value=seed)
    if random_start:
        walk.random = np.random.RandomState(seed)
    return control.Environment(walk, walk, n_sub_steps=walk.substeps)


class FollowedWalk(control.Physics, control.Task):
    """The closed loop of a walk as physics and task of dm_control; a step of it is a control tick.

    Args:
        planned: the walk.
        disturbances: external forces.

    Attributes:
        random: draws begin and seeds of an episode; None begins all with the walk, and the run's seeds.
        loop: of this episode.
        first: step of the whole walk at which it began.
        sensed: what a controller gets at this tick.
        end: of the walk, if it fell.
    """

    random: np.random.RandomState | None = None

    def __init__(self, planned: PlannedWalk, disturbances: Sequence[Disturbance]) -> None:
        self.planned, self.physics = planned, Physics(planned.scene, planned.run)
        self.substeps = self.physics.substeps
        self.walk = References(planned.plan, planned.run, self.physics)
        self._forces = forces_of(planned.run, disturbances, self.walk.total * self.timestep())
        robot = planned.body.robot
        scales = {"body_weight": robot.mass * robot.gravity, "foot_length": planned.plan.feet.sole.length}
        limits, self._bounds = DEFAULT.limits(scales), []
        for name in REWARDED:
            mean = float(limits[f"{name}_rmse"])
            self._bounds.append(((0.0, mean), float(limits.get(f"{name}_maximum", _MARGIN * mean)) - mean))
        self.begin(0, planned.run)

    def begin(self, tick: int, run: RunParameters) -> None:
        """Begin an episode at a tick of the walk, with the seeds of a run."""
        self.first = tick * self.substeps
        self.end: Outcome | None = None
        start = place(self.physics, run, self.walk.table[tick])
        course, sensing = self.walk.part(tick), make_estimator(run, self.planned.body, start)
        forces = copied(self._forces)
        self.loop = ClosedLoop(self.physics, None, course, run, estimator=sensing, disturbances=forces)
        self.sensed = self.loop.sense()

    def set_control(self, control: Array) -> None:
        """Torques of the next step, shape (nu,) [N m]; raises InputError if they are no such numbers."""
        nu = self.planned.body.robot.nu
        try:
            self._torque = real_numbers("the action", control, (nu,), finite=True)
        except ValueError as error:
            raise InputError(f"{error}; give {nu} finite torques [N m].") from None

    def step(self, n_sub_steps: int = 1) -> None:
        """One control tick, and what is sensed at the next one if the body stands."""
        with quiet_mujoco():
            self.end = self.loop.act(ControlOutput(self._torque))
            if self.end is None:
                try:
                    self.sensed = self.loop.sense()
                except DivergedEstimate as error:
                    self.end = self.loop.watch.blown_up(self.time(), str(error))
                if self.physics.body.warnings.any():
                    self.end = self.loop.watch.blown_up(self.time())

    def time(self) -> float:
        """Time since the begin of the episode [s]."""
        return self.loop.done * self.timestep()

    def timestep(self) -> float:
        """Time step of the engine [s]."""
        return self.physics.time_step

    def reset(self) -> None:
        """The task begins the episode."""

    def after_reset(self) -> None:
        """All has been computed."""

    def free(self) -> None:
        """Nothing is to be freed; wrappers for Gymnasium ask for it."""

    def initialize_episode(self, physics: "FollowedWalk") -> None:
        """Place the body on the plan."""
        start, run, times = 0.0, self.planned.run, self.walk.table.row["time"]
        if self.random is not None:
            until = min(2.0 * self.planned.plan.constants.step_duration, 0.5 * times[-1])
            start = self.random.uniform(0.0, np.searchsorted(times, until))
            run = run.replace(dict.fromkeys(("sensors.seed", "disturbance.seed"), self.random.randint(2**31)))
        self.begin(int(start), run)

    def before_step(self, action: Array, physics: "FollowedWalk") -> None:
        """Set the torques."""
        self.set_control(action)

    def action_spec(self, physics: "FollowedWalk") -> specs.BoundedArray:
        """Torques [N m], in the order of the joints."""
        robot = self.planned.body.robot
        limit, names = robot.torque_limit, "\t".join(robot.joint_names)
        return specs.BoundedArray((robot.nu,), np.float64, -limit, limit, name=names)

    def get_observation(self, physics: "FollowedWalk") -> OrderedDict[str, Array]:
        """See :func:`validation.trial.policy.observe`."""
        return OrderedDict(observe(*self.sensed))

    def get_reward(self, physics: "FollowedWalk") -> float:
        """Product of the tolerances of the tick's last step, 0 ... 1; 0 where the simulation diverged."""
        if self.end is not None and self.end.name is OutcomeName.DIVERGED:
            return 0.0
        k, record = self.loop.done - 1, self.loop.log.record
        plan, row = self.walk.plans[0].rows, self.first + k
        load = record.point_force[k, :, 2]
        zmp = load @ record.point_position[k, :, :2] / load.sum() if load.any() else np.full(2, np.inf)
        errors = zmp - plan.zmp[row], record.angular_momentum[k, :2] - plan.angular_momentum[row]
        return math.prod(
            float(rewards.tolerance(error, bounds, margin))
            for error, (bounds, margin) in zip(np.abs(np.hstack(errors)), self._bounds, strict=True)
        )

    def get_termination(self, physics: "FollowedWalk") -> float | None:
        """0 after a fall, 1 at the last tick of the plan."""
        if self.end is not None:
            return 0.0
        return 1.0 if self.loop.done + self.substeps >= self.loop.course.total else None
