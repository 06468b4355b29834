"""Check of a body before it walks: its model, its torques in a periodic step, and whether it stands."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from ampm.body.feasibility import joint_groups
from ampm.body.robot import Robot
from ampm.exceptions import RefusedGait
from ampm.parameters import GRAVITY, NO_PLAN, BodyParameters, RunParameters
from ampm.planners import StandingPlanner
from ampm.tune.gait_limits import step_torques
from ampm.tune.tuning import NoFeasibleChoice
from models.scene import Findings
from validation.judge.margins import largest_tilt, tilt_warnings
from validation.progress import Progress
from validation.trial.bridge import to_mujoco
from validation.trial.plan import PlannedWalk, Request, load_request, make_body, tune_walk
from validation.trial.simulate import simulate

_BENT = 0.6  # flexion of the knees at which the legs are judged [rad]
_GROWTH, _MOST_GROWTH = 1.2, 3.0  # of step or speed from try to try, and at most [1]
_LEAST_SINGULAR = 0.02  # of a leg's Jacobian: below it, the joints hardly move the sole in some direction
_FEET = "lowest point of the feet over their soles"
_STANDING = 1.0  # time for which the body stands, long enough for a simulation to diverge [s]
_OFF = 0.1  # of the feet's lowest point from the soles, over the soles' length: more is a mistake
_GROUPS = ("hip", "knee", "ankle", "toe", "trunk", "arms")


@dataclass(frozen=True)
class BodyCheck:
    """Result of a check.

    Attributes:
        name: of the body.
        facts: quantity to value and unit.
        notes: what is worth knowing, one sentence each.
        torque: group of joints to the largest share of a torque limit, in the best periodic step found [1].
        gait: key to value of the gait that it can walk; empty if it cannot.
        found: what that gait left open, by namespaced key; empty if it cannot walk.
        refusal: why it cannot walk, with a way out; empty if it can.
        reach: ``step_length`` [m] and ``switching_velocity`` [m/s], the largest found; empty if not
            asked for.
    """

    name: str
    facts: Mapping[str, tuple[float, str]]
    notes: tuple[str, ...]
    torque: Mapping[str, float]
    gait: Mapping[str, float]
    found: Mapping[str, float | str]
    refusal: str
    reach: Mapping[str, float]

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return asdict(self)


def check(
    source: str, settings: tuple[str, ...] = (), progress: Progress | None = None, *, reach: bool = False
) -> BodyCheck:
    """Check a body.

    Args:
        source: name or description file.
        settings: ``key=value`` texts, such as those of the gait that it is to walk.
        progress: where to report stages.
        reach: also find the largest step and the highest speed, which takes half a minute.

    Raises:
        InputError: the description or its source is not usable.
    """
    progress = progress or Progress()
    run = RunParameters(body=BodyParameters(source=source))
    with progress.stage("body"):
        body = make_body(run)
    findings, robot, model = body.model.findings, body.robot, body.model.compile()
    facts = _facts(robot, model, findings)
    notes = _notes(robot, findings, facts[_FEET][0])
    torque, gait = dict[str, float](), dict[str, float]()
    found: Mapping[str, float | str] = {}
    refusal = ""
    try:
        request = load_request(None, [f"body.source='{source}'", *settings])
        walk = tune_walk(request, progress)
        torque = _torque_shares(walk)
        keys = "step_length", "switching_velocity", "c_s", "c_y", "com_height", "step_width"
        gait = {key: float(walk.run.value(f"gait.{key}")) for key in keys}
        if walk.tuned is not None:
            found = walk.tuned.values
        motion, nothing = walk.motion, np.zeros((len(walk.motion.q), robot.model.nv))
        tilt = largest_tilt(to_mujoco(motion.q, nothing)[0], motion.time, robot.description, body.shapes)
        facts["largest tilt of pelvis or trunk, as planned"] = (tilt.value, "rad")
        notes = (*notes, *tilt_warnings(tilt.value, tilt.where))
        with progress.stage("standing"):
            refusal = _standing_refusal(walk)
    except NoFeasibleChoice as error:
        refusal = str(error)
        values = error.values
        torque = {name: values[f"{name}_torque"] for name in _GROUPS if f"{name}_torque" in values}
    except RefusedGait as error:
        refusal = str(error)
    if refusal and notes and abs(facts[_FEET][0]) > _OFF * robot.description.sole.length:
        refusal = f"{notes[0]} As it is, {refusal}"  # the cause, then what follows from it
    far = _reach(source, settings, gait, progress) if reach and gait else {}
    return BodyCheck(source, facts, notes, torque, gait, found, refusal, far)


def _torque_shares(walk: PlannedWalk) -> dict[str, float]:
    """Largest share of a torque limit by group of joints, on the grid of the walk's motion."""
    robot, motion = walk.body.robot, walk.motion
    torque, _ = step_torques(motion, motion.time, walk.plan, robot)
    most = (np.abs(torque) / robot.torque_limit).max(axis=0)
    groups = joint_groups(robot.description).items()
    return {name: float(most[robot.velocity_indices(names) - 6].max()) for name, names in groups}


def _standing_refusal(walk: PlannedWalk) -> str:
    """Why the body does not stand under the controller at the height of the walk; empty if it does."""
    height, still = walk.run.gait.com_height, {"command.settling": 0.0, "command.duration": _STANDING}
    run = walk.run.undisturbed.replace({"gait.planner": NO_PLAN, **still})
    plan = StandingPlanner(height).plan(run, walk.body.robot)
    outcome = simulate(PlannedWalk(Request(walk.name, run), plan, walk.body)).outcome
    return "" if outcome.completed else f"it does not stand for {_STANDING:g} s. {outcome.ending}"


def _reach(
    source: str, settings: tuple[str, ...], gait: Mapping[str, float], progress: Progress
) -> dict[str, float]:
    """The largest step, with the speed in proportion, and the highest speed with the gait's step.

    Both grow by :data:`_GROWTH` until nothing walks any more, and once by half of that.
    """

    def walks(keys: tuple[str, ...], factor: float) -> bool:
        grown = [f"gait.{name}={factor * gait[name]:.6g}" for name in keys]
        kept = [text for text in settings if not text.startswith(tuple(f"gait.{name}=" for name in keys))]
        try:
            request = load_request(None, [f"body.source='{source}'", *kept, *grown])
            tune_walk(request, progress, advise=False)
        except RefusedGait:
            return False
        return True

    found = {}
    for keys in (("step_length", "switching_velocity"), ("switching_velocity",)):
        factor = 1.0
        while factor < _MOST_GROWTH and walks(keys, factor * _GROWTH):
            factor *= _GROWTH
        half = factor * math.sqrt(_GROWTH)
        found[keys[0]] = gait[keys[0]] * (half if walks(keys, half) else factor)
    return found


def _facts(robot: Robot, model: mujoco.MjModel, findings: Findings) -> dict[str, tuple[float, str]]:
    """Quantities of the model, with their units."""
    d, sole = robot.description, robot.description.sole
    limits, weight = dict(d.torque_limits), d.mass * GRAVITY
    ankle = max(limits[joint] for joint in d.left_leg.ankle)
    hip = max(limits[joint] for joint in d.left_leg.hip)
    return {
        "mass": (d.mass, "kg"),
        "height of the COM": (d.hip_height + d.com_over_hip, "m"),
        "height of the hips": (d.hip_height, "m"),
        "length of a leg": (d.leg_length, "m"),
        "distance of the hips": (2.0 * d.hip_half_width, "m"),
        "length of a sole": (sole.length, "m"),
        _FEET: (_feet_over_soles(model, robot), "m"),
        "straight knee at": (d.left_leg.straight_knee, "rad"),
        "least singular value of a leg, knee bent by 0.6 rad": (_leg_singular_value(robot), "1"),
        "ZMP from the ankle, as far as its torque reaches": (ankle / weight, "m"),
        "hip torque over weight times half the distance of the hips": (
            hip / (weight * d.hip_half_width),
            "1",
        ),
        "asymmetry of the source: places": (findings.place, "m"),
        "asymmetry of the source: COM": (findings.com, "m"),
        "asymmetry of the source: masses": (findings.mass, "kg"),
    }


def _leg_singular_value(robot: Robot) -> float:
    """Least singular value of the Jacobian of the left sole by its leg's joints [m/rad and 1]."""
    q = pin.neutral(robot.model)
    q[robot.knee_joints + 1] = robot.knee_angles(_BENT)
    jacobian = robot.jacobian(q).jacobian[6:12, robot.leg_joints[0][:6]]
    return float(np.linalg.svd(jacobian, compute_uv=False)[-1])


def _feet_over_soles(model: mujoco.MjModel, robot: Robot) -> float:
    """Height of the lowest point of the feet's shapes over the soles at rest [m]."""
    d, q = robot.description, pin.neutral(robot.model)
    for joint, angle in d.rest:
        q[robot.velocity_indices((joint,)) + 1] = angle
    q[2] -= robot.jacobian(q).sole[:, 2].min()
    data = mujoco.MjData(model)
    data.qpos[:], _ = to_mujoco(q, np.zeros(robot.model.nv))
    mujoco.mj_forward(model, data)
    points = {name for _, _, name in d.sole_points()}
    feet = {model.body(name).id for leg in d.legs for name in (leg.foot_segment, leg.toe_segment) if name}
    shapes = [g for g in range(model.ngeom) if model.geom_bodyid[g] in feet]
    floor, far = model.geom("floor").id, d.height
    gaps = [
        mujoco.mj_geomDistance(model, data, floor, g, far, None)
        for g in shapes
        if model.geom(g).name not in points
    ]
    return float(min(gaps))


def _notes(robot: Robot, findings: Findings, off: float = 0.0) -> tuple[str, ...]:
    """What is worth knowing of the model."""
    d, notes = robot.description, list[str]()
    if abs(off) > _OFF * d.sole.length:
        notes.append(
            f"The feet end {abs(off):.3g} m {'over' if off > 0.0 else 'under'} their soles, or are not "
            "level with all joints at 0: correct sole in the description, which 'ampm body new' proposes, "
            "with pitch where a sole is not level."
        )
    endless = [
        name
        for name, low, high in zip(robot.joint_names, robot.lower, robot.upper, strict=True)
        if not np.isfinite(high - low)
    ]
    if endless:
        notes.append(f"Joints without a range: {', '.join(endless)}.")
    if d.head:
        notes.append(f"Joints of neither leg, trunk nor arm, which rest: {', '.join(d.head)}.")
    if _leg_singular_value(robot) < _LEAST_SINGULAR:
        notes.append("The joints of a leg hardly move its sole in some direction: it cannot be held flat.")
    if not d.trunk:
        notes.append("No joint between pelvis and trunk: legs and arms carry all angular momentum.")
    if d.passive:
        rubbing = ", dry friction" if any(item.friction for item in d.passive) else ""
        notes.append(
            f"{len(d.passive)} joints have dampers or springs{rubbing}: the controller overcomes them."
        )
    if not d.speed_limits:
        notes.append("No joint has a speed limit: speeds are not judged.")
    if findings.bare:
        notes.append(
            f"{findings.bare} segments have no shape: clearance is that of ellipsoids of their inertia."
        )
    if max(findings.place, findings.com, findings.mass) > 1e-6:
        notes.append("Left and right differ in the source: the mean of both walks.")
    return tuple(notes)
