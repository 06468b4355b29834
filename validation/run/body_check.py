"""Check of a body before it walks: its model, its torques in a periodic step, and whether it stands."""

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
import pinocchio as pin

from ampm.body.feasibility import joint_groups
from ampm.body.robot import Robot
from ampm.exceptions import BodilyRefusal, RefusedGait
from ampm.files import quoted
from ampm.parameters import NO_PLAN, BodyParameters, RunParameters
from ampm.planners import StandingPlanner
from ampm.tune.gait_limits import step_torques
from ampm.tune.tuning import NoFeasibleChoice
from models.scene import Findings
from validation.judge.margins import largest_tilt, tilt_warnings
from validation.progress import Progress
from validation.trial.coordinates import to_mujoco
from validation.trial.physics import firm_dampers
from validation.trial.plan import PlannedWalk, Request, load_request, make_body, tune_walk
from validation.trial.simulate import simulate

_BENT = 0.6  # flexion of the knees at which the legs are judged [rad]
_SINGULAR = 0.02  # of a leg's Jacobian: below it, the joints hardly move the sole in some direction
_FEET = "lowest point of the feet over their soles"
_UNLIKE = "largest distance of the right foot's extent from the left one's mirror image"
_LEG = f"least singular value of a leg, knee bent by {_BENT} rad"
_STANDING = 1.0  # time for which the body stands, long enough for a simulation to diverge [s]
_OFF = 0.1  # most distance of the feet's lowest point from the soles, over the soles' length [1]
_UNALIKE = 0.05  # most distance of the feet's extents, over the soles' length [1]
_RUBBING = 0.05  # dry friction over a torque limit beyond which walks were seen to fail [1]
_GAIT = ("step_length", "switching_velocity", "c_s", "c_y", "com_height", "step_width")


@dataclass(frozen=True)
class BodyCheck:
    """Result of a check."""

    name: str  # of the body
    facts: Mapping[str, tuple[float, str]]  # quantity to value and unit
    notes: tuple[str, ...]  # what is worth knowing, one sentence each
    torque: Mapping[str, float]  # by joints, largest share of a limit in the best periodic step found [1]
    gait: Mapping[str, float]  # key to value of the gait that it can walk; empty if it cannot
    found: Mapping[str, float | str]  # what that gait left open, by namespaced key
    refusal: str  # why it cannot walk, with a way out; empty if it can


def check(source: str, settings: tuple[str, ...] = (), progress: Progress | None = None) -> BodyCheck:
    """Check a body, by its name or description file; raises InputError if it is not usable.

    The settings are ``key=value`` texts, such as those of the gait that it is to walk.
    """
    progress = progress or Progress()
    with progress.stage("body"):
        body = make_body(RunParameters(body=BodyParameters(source=source)))
    robot = body.robot
    facts = _facts(robot, body.model.compile(), body.model.findings)
    notes = _notes(robot, body.model.findings, facts)
    torque, gait = dict[str, float](), dict[str, float]()
    found: Mapping[str, float | str] = {}
    refusal = ""
    try:
        walk = tune_walk(load_request(None, [f"body.source={quoted(source)}", *settings]), progress)
        motion, nothing = walk.motion, np.zeros((len(walk.motion.q), robot.model.nv))
        planned, _ = step_torques(motion, motion.time, walk.plan, robot)
        most = (np.abs(planned) / robot.torque_limit).max(axis=0)
        groups = joint_groups(robot.description).items()
        torque = {name: float(most[robot.velocity_indices(names) - 6].max()) for name, names in groups}
        if over := [f"{name} {share:.2f}" for name, share in torque.items() if share > 1.0]:
            notes.append(f"The plan exceeds a torque limit, which the simulation keeps: {', '.join(over)}.")
        gait = {key: float(walk.run.value(f"gait.{key}")) for key in _GAIT}
        found = walk.tuned.values if walk.tuned is not None else {}
        tilt = largest_tilt(to_mujoco(motion.q, nothing)[0], motion.time, robot.description, body.shapes)
        facts["largest tilt of pelvis or trunk, as planned"] = (tilt.value, "rad")
        notes += tilt_warnings(tilt.value, tilt.where)
        with progress.stage("standing"):
            try:
                refusal = _standing_refusal(walk)
            except BodilyRefusal as error:  # steps bend the joints otherwise, so that it may walk
                notes.append(f"It does not stand with its COM as high as in the walk: {error.args[0]}.")
    except RefusedGait as error:
        refusal = str(error)
        values = error.values if isinstance(error, NoFeasibleChoice) else {}
        torque |= {key.removesuffix("_torque"): values[key] for key in values if key.endswith("_torque")}
    if refusal and notes and abs(facts[_FEET][0]) > _OFF * robot.description.sole.length:
        refusal = f"{notes[0]} As it is, {refusal}"  # the cause, then what follows from it
    return BodyCheck(source, facts, tuple(notes), torque, gait, found, refusal)


def _standing_refusal(walk: PlannedWalk) -> str:
    """Why the body diverges, or does not stand at the height of the walk; empty if it does."""
    if firm := firm_dampers(walk.body.model.compile()):
        return f"{firm}."
    height, still = walk.run.gait.com_height, {"command.settling": 0.0, "command.duration": _STANDING}
    run = walk.run.undisturbed.replace({"gait.planner": NO_PLAN, **still})
    plan = StandingPlanner(height).plan(run, walk.body.robot)
    outcome = simulate(PlannedWalk(Request(walk.name, run), plan, walk.body)).outcome
    return "" if outcome.completed else f"it does not stand for {_STANDING:g} s. {outcome.ending}"


def _facts(robot: Robot, model: mujoco.MjModel, findings: Findings) -> dict[str, tuple[float, str]]:
    """Quantities of the model, with their units."""
    d, sole = robot.description, robot.description.sole
    q = pin.neutral(robot.model)
    q[robot.knee_joints + 1] = robot.knee_angles(_BENT)
    leg = robot.jacobian(q).jacobian[6:12, robot.leg_joints[0][:6]]  # of the left sole [m/rad and 1]
    return {
        "mass": (d.mass, "kg"),
        "height of the COM": (d.hip_height + d.com_over_hip, "m"),
        "height of the hips": (d.hip_height, "m"),
        "length of a leg": (d.leg_length, "m"),
        "distance of the hips": (2.0 * d.hip_half_width, "m"),
        "length of a sole": (sole.length, "m"),
        **_feet(model, robot, findings),
        "straight knee at": (d.left_leg.straight_knee, "rad"),
        _LEG: (float(np.linalg.svd(leg, compute_uv=False)[-1]), "1"),
        "asymmetry of the source: places": (findings.place, "m"),
        "asymmetry of the source: COM": (findings.com, "m"),
        "asymmetry of the source: masses": (findings.mass, "kg"),
    }


def _feet(model: mujoco.MjModel, robot: Robot, findings: Findings) -> dict[str, tuple[float, str]]:
    """What the feet's shapes show with all joints at 0; NaN without such shapes."""
    d, data = robot.description, mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    points = [model.geom(name).id for _, _, name in d.sole_points()]
    bare = {number + 1 for number in findings.bare}  # the world is MuJoCo's first body
    floor, gaps, extents = model.geom("floor").id, [np.nan], []
    for leg, side in zip(d.legs, (1.0, -1.0), strict=True):
        feet = {model.body(name).id for name in (leg.foot_segment, leg.toe_segment) if name} - bare
        own = [geom for geom in range(model.ngeom) if model.geom_bodyid[geom] in feet and geom not in points]
        gaps += [mujoco.mj_geomDistance(model, data, floor, geom, d.height, None) for geom in own]
        centre, radius = data.geom_xpos[own] * (1.0, side, 1.0), model.geom_rbound[own, None]
        extents += [np.hstack([radius - centre, radius + centre]).max(axis=0)] if own else []
    unlike = np.abs(extents[0] - extents[1]).max() if len(extents) == 2 else np.nan
    over = np.fmin.reduce(gaps) - data.geom_xpos[points, 2].min()
    return {_FEET: (float(over), "m"), _UNLIKE: (float(unlike), "m")}


def _notes(robot: Robot, findings: Findings, facts: Mapping[str, tuple[float, str]]) -> list[str]:
    """What is worth knowing of the model."""
    d, off, unlike = robot.description, facts[_FEET][0], facts[_UNLIKE][0]
    limits = {name: limit for name, limit in d.torque_limits if name in d.left_leg.joints}
    friction = max((p.friction / limits[p.joint] for p in d.passive if p.joint in limits), default=0.0)
    known = {
        f"The feet end {abs(off):.3g} m {'over' if off > 0.0 else 'under'} their soles: correct sole in the "
        "description, with pitch where a sole is not level with all joints at 0, or the angles of the model "
        "if the body then does not stand upright.": abs(off) > _OFF * d.sole.length,
        f"Joints of neither leg, trunk nor arm, which rest: {', '.join(d.head)}.": d.head,
        "A leg hardly moves its sole in some direction: it cannot be held flat.": facts[_LEG][0] < _SINGULAR,
        "No joint between pelvis and trunk: legs and arms carry all angular momentum.": not d.trunk,
        f"Joints with damper, spring or dry friction, known to the controller: {len(d.passive)}.": d.passive,
        f"Dry friction takes {friction:.2g} of a leg's torque; walks may fail by it.": friction > _RUBBING,
        "No joint has a speed limit: speeds are not judged.": not d.speed_limits,
        f"Ellipsoids of inertia stand for segments without a shape: {len(findings.bare)}.": findings.bare,
        "Left and right differ in the source: the body has the mean of places and masses.": (
            max(findings.place, findings.com, findings.mass) > 1e-6
        ),
        "Feet differ in shape: the right sole mirrors the left one.": unlike > _UNALIKE * d.sole.length,
        findings.of_sides: findings.unlike,
    }
    return [note for note, holds in known.items() if holds]
