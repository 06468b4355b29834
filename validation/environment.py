"""A walk as a dm_control environment: an agent makes the torques, the reward is the agreement with the plan.

    from validation import environment

    env = environment.load("normal", seed=1)
    step = env.reset()
    while not step.last():
        step = env.step(policy(step.observation))

An episode begins at a random instant of the plan's first stride, and ends with a fall or with the plan.
"""

import math
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import dm_env
import mujoco
import numpy as np
from dm_env import specs
from numpy.typing import NDArray

from ampm.description import BodyDescription
from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from ampm.physics_parameters import steps_per_tick
from ampm.walk import Reference, State, Timing, Touch
from validation.judge.metrics import METRICS
from validation.judge.profiles import DEFAULT, Profile
from validation.judge.profiles import profile as named_profile
from validation.store.machine import set_variables
from validation.trial.bridge import to_mujoco, to_pinocchio
from validation.trial.physics import SolePoints, point_forces, quiet_mujoco
from validation.trial.plan import PlannedWalk, load_request, plan_walk
from validation.trial.policy import observe
from validation.trial.watch import Stance

# dm_control looks for an OpenGL context when it is imported, and warns or fails where there is none. MuJoCo
# has read the variable at its own import and keeps the caller's choice.
with set_variables({"MUJOCO_GL": "disable"}):
    from dm_control.mujoco import engine
    from dm_control.rl import control
    from dm_control.utils import rewards

Array = NDArray[np.float64]

REWARDED = ("zmp_x", "zmp_y", "angular_momentum_x", "angular_momentum_y")
"""Signals whose errors make the reward."""
_MARGIN = 10.0
"""Of signals without a limit on single instants: their largest error, in limits of the RMSE [1]."""


def load(
    source: RunParameters | str | None = None,
    /,
    body: Mapping[str, Any] | str | None = None,
    *,
    seed: int | None = None,
    profile: Profile | str = DEFAULT,
    **sections: Mapping[str, Any],
) -> control.Environment:
    """The environment of one gait.

    A step of the environment is a control tick, ``controller.frequency``; the torque is held in between. The
    action is the share of every motor's largest torque, -1 ... 1; the observation is that of
    :func:`validation.trial.policy.observe`. The reward, 0 ... 1, is the product over :data:`REWARDED` of
    a tolerance: 1 within the profile's limit of the RMSE, 0.1 at that of the largest error.

    Args:
        source: parameters, or a preset or TOML file; `normal` by default, or the own gait of another body.
        body: its name (``body.source``), or values of the section ``body``.
        seed: of the instants at which episodes begin.
        profile: tolerances, or their name.
        sections: values by section and key, as :func:`ampm.load_run` takes them.

    Raises:
        InputError, MathematicalRefusal, BodilyRefusal: there is no such walk.
    """
    request = load_request(source, body=body, sections=sections)
    if unusual := request.run.disturbance.model_dump(exclude_defaults=True):
        keys = ", ".join(f"disturbance.{key}" for key in unusual)
        raise InputError(f"an environment has no disturbances; leave out {keys}.")
    if not request.run.sensors.perfect:
        raise InputError("an environment has no sensors; leave out the section sensors.")
    if request.run.simulation.engine != "mujoco":
        raise InputError("an environment is stepped by MuJoCo; leave out simulation.engine.")
    if isinstance(profile, str):
        profile = named_profile(profile)
    held = request.run.replace({"controller.hold": "zero-order"})
    planned = plan_walk(replace(request, run=held))
    physics = WalkPhysics.from_xml_string(planned.body.model.xml)
    physics.mark(planned.body.model.description)
    task = FollowPlan(planned, profile, np.random.default_rng(seed))
    return WalkEnvironment(physics, task, n_sub_steps=task.substeps)


class WalkPhysics(engine.Physics):
    """The physics, which reads the load of every sole point as a controller senses it."""

    def mark(self, description: BodyDescription) -> None:
        """Find the sole points of a body."""
        sites = tuple(site for _, _, site in description.sole_points())
        soles = tuple(leg.sole_frame for leg in description.legs)
        self._points = SolePoints(self.model.ptr, sites, soles)
        self.force, self.place = np.zeros((2, len(sites), 3))

    def step(self, nstep: int = 1) -> None:
        """Step, and keep force [N] and place [m] of every sole point in the last step, shape (P, 3)."""
        model, data = self.model.ptr, self.data.ptr
        with self.check_invalid_state(), quiet_mujoco():
            for _ in range(nstep - 1):
                mujoco.mj_step2(model, data)
                mujoco.mj_step1(model, data)
            mujoco.mj_step2(model, data)
            self.force, self.place = point_forces(data, self._points)
            mujoco.mj_step1(model, data)

    def touch(self) -> Touch:
        """What the soles sense."""
        points = self._points.of_geom[self.data.ptr.contact.geom].max(axis=1)
        contact = np.zeros(len(self.force), dtype=bool)
        contact[points[points >= 0]] = True
        return Touch(contact, self.force[:, 2].copy(), self.timestep())

    def sensor(self, name: str) -> Array:
        """Value of a sensor of the model."""
        return np.asarray(self.data.ptr.sensor(name).data)

    def axes(self, segment: str) -> Array:
        """Axes of a segment to world, shape (3, 3)."""
        return np.asarray(self.data.ptr.body(segment).xmat.reshape(3, 3))


class FollowPlan(control.Task):
    """Walk as planned.

    Args:
        planned: the walk.
        profile: tolerances.
        random: draws the instants at which episodes begin.
    """

    def __init__(self, planned: PlannedWalk, profile: Profile, random: np.random.Generator) -> None:
        self.planned, self.random = planned, random
        self.run, self.robot = planned.run, planned.body.robot
        plan, dt = planned.plan, self.run.simulation.time_step
        self.substeps = steps_per_tick(self.run.controller.frequency, dt)
        gains = self.run.controller
        timing = Timing(gains.touchdown_lead, gains.touchdown_window, (self.substeps - 1) * dt)
        total = int(np.floor(plan.contacts.step_ends[-1] / dt + 1e-9))
        times = np.arange(0, total, self.substeps, dtype=np.float64) * dt
        self.references, self.times = plan.table(times, timing), times
        # The load after a tick's last step is that over this step, from its begin on.
        before = plan.sample(np.maximum(times - dt, 0.0))
        self._signals = np.hstack([before.zmp, plan.sample(times).angular_momentum])
        stride = min(2.0 * plan.constants.step_duration, 0.5 * times[-1])
        self._starts = int(np.searchsorted(times, stride))
        weight = self.robot.mass * self.robot.gravity
        scales = {"body_weight": weight, "foot_length": plan.feet.sole.length}
        limits = [_limits(name, profile, scales) for name in REWARDED]
        self._bounds = [((0.0, mean), largest - mean) for mean, largest in limits]
        self.tick = 0

    @property
    def reference(self) -> Reference:
        """The plan at this tick."""
        return self.references[self.tick]

    def state(self, physics: WalkPhysics) -> State:
        """The measured state."""
        q, v = to_pinocchio(physics.data.qpos, physics.data.qvel)
        return State(float(self.times[self.tick]), q, v, 0.5 * physics.timestep())

    def initialize_episode(self, physics: WalkPhysics) -> None:
        """Place the body on the plan at a random instant."""
        self.tick = int(self.random.integers(self._starts))
        q = self.reference.q.copy()
        q[2] -= self.run.simulation.start_depth  # the soles carry weight from the first instant
        physics.data.qpos[:], physics.data.qvel[:] = to_mujoco(q, self.reference.v)
        physics.force[:] = 0.0

    def before_step(self, action: Array, physics: WalkPhysics) -> None:
        """Set the torques."""
        physics.set_control(self.robot.torque_limit * np.clip(action, -1.0, 1.0))

    def after_step(self, physics: WalkPhysics) -> None:
        """Go on to the next tick, and measure."""
        self.tick += 1
        load = physics.force[:, 2]
        zmp = load @ physics.place[:, :2] / load.sum() if load.any() else np.full(2, np.inf)
        momentum = physics.sensor("angular_momentum")[:2]
        self._error = np.abs(np.hstack([zmp, momentum]) - self._signals[self.tick])

    def action_spec(self, physics: WalkPhysics) -> specs.BoundedArray:
        """Shares of the torques, in the order of the joints."""
        names = "\t".join(self.robot.joint_names)
        return specs.BoundedArray((self.robot.nu,), np.float64, -1.0, 1.0, name=names)

    def get_observation(self, physics: WalkPhysics) -> OrderedDict[str, Array]:
        """See :func:`validation.trial.policy.observe`."""
        return OrderedDict(observe(self.state(physics), physics.touch(), self.reference))

    def get_reward(self, physics: WalkPhysics) -> float:
        """Product of the tolerances, 0 ... 1."""
        return math.prod(
            float(rewards.tolerance(error, bounds, margin))
            for error, (bounds, margin) in zip(self._error, self._bounds, strict=True)
        )

    def get_termination(self, physics: WalkPhysics) -> float | None:
        """0 after a fall, 1 at the end of the plan."""
        reference, description = self.reference, self.robot.description
        trunk = physics.axes(description.trunk_segment)[:, 2]
        soles = np.array([physics.data.ptr.site(leg.sole_frame).xpos for leg in description.legs])
        planned = reference.com, reference.trunk[:, 2], reference.foot_position
        if Stance(physics.sensor("com"), trunk, soles, *planned).fallen(description.scale):
            return 0.0
        return 1.0 if self.tick == len(self.references) - 1 else None


class WalkEnvironment(control.Environment):
    """The environment; a simulation that diverges ends the episode without a reward."""

    def step(self, action: Array) -> dm_env.TimeStep:
        """One control tick."""
        try:
            self._last = super().step(action)
        except control.PhysicsError:
            self._reset_next_step = True
            return dm_env.termination(reward=0.0, observation=self._last.observation)
        return self._last

    def reset(self) -> dm_env.TimeStep:
        """Begin an episode."""
        self._last = super().reset()
        return self._last


def _limits(signal: str, profile: Profile, scales: Mapping[str, float]) -> tuple[float, float]:
    """Limits of a signal's RMSE and of its largest error, in its SI unit."""
    mean, largest = (profile.tolerance(METRICS[f"{signal}_{name}"]) for name in ("rmse", "maximum"))
    if mean is None:
        raise ValueError(f"profile {profile.name} has no limit for {signal}")
    limit = float(mean.limit_for(scales))
    return limit, _MARGIN * limit if largest is None else float(largest.limit_for(scales))
