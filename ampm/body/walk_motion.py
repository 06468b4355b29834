"""A body over a whole walk, by inverse kinematics on a coarse grid: what it cannot walk is refused.

Posture gains and slow feedback of the trunk's tilt are the controller's, so that trunk and arms move as in
the walk.
"""

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ampm.body.constant_posture import ConstantPosture, turned
from ampm.body.feasibility import joint_groups
from ampm.body.inverse_kinematics import InverseKinematics, Unreachable
from ampm.body.limits import AT_LEAST, AT_MOST, CLEARANCE, Limit, check
from ampm.body.motion import Extreme
from ampm.body.robot import ROLLS, Robot
from ampm.body.step_kinematics import StepTrajectory
from ampm.body.step_reference import StepReference, step_reference
from ampm.controller_parameters import ControllerParameters
from ampm.geometry import Array, rotations
from ampm.parameters import FootParameters, RunParameters
from ampm.planner.contacts import Phase
from ampm.planner.support import StepPlan

_PIECE, _INTERVALS = 0.04, 5
"""Longest time for which heading and feedback are held [s], and intervals of the grid in it."""
_FASTEST = 100.0  # fastest rate of the posture that the grid follows [1/s]
_LOST, _LOST_STANDING = 0.05, 0.125
"""Longest time of a step in which a leg may not reach, and after a stand [s]: the controller gives way for so
long, and toes bend. Of 11 climbs of the human with 0.06 to 0.1 s 10 failed. A foot without toes lifts as a
whole: 42 of 42 walks of the G1 and TALOS with less than 0.1 s failed."""
_WINDOW = 0.06  # time over which a torque is averaged [s]
_MOST = 1.1  # largest mean share of a torque limit [1]
_SPIKE = 3.0  # share that counts at most [1]: next to a straight leg it has no bound
_STRAIGHTENS = 6.5
"""Rate of a knee in double support from which the leg is straight and does not reach [rad/s]. Chosen on walks
of the G1: of 5 with more 4 failed, of 48 with less 2. Of other walks of the G1, 31 are accepted and pass."""
_NEARER = 5e-4  # by which parts may come nearer in the walk [m]: .43 mm at most in 40 walks
_INSTANTS = 7  # of every swing at which the upright body's ranges are checked
_BEYOND = 0.05
"""How far an upright body may be beyond a joint's range [rad]: a pelvis that tilts makes up for as much."""
_LONG, _ANKLE, _LACK = 0.15, 0.04, 0.022
"""Time over which an ankle's sideward angle beyond its range is averaged [s], and the largest mean [rad]: no
pelvis that tilts makes up for it. The largest integral over this time of the share beyond 1 of a torque of
trunk or arms [s]. Shares of both limits add up. Chosen on random walks of the G1: most of those with more
than 1 fell, or their arms came into their legs."""
_NO_ROLL = Limit(
    "if ankles do not roll, a start over footsteps sways the trunk too far: the number of hinges in each leg",
    "1",
    6.0,
    AT_LEAST,
    "ankles_do_not_roll",
    "walk equal steps, without footsteps",
)
"""Of legs without a roll of the ankle: four bodies of this kind could walk none of 70 lists of footsteps."""
_QUICK, _SLOW = 0.8, 1.2  # durations of a swing over the gait's beyond which a refusal blames them [1]
_WAYS_OUT = {
    "hip": "shorten or narrow the steps about it, lower gait.c_y, or raise gait.switching_velocity",
    "ankle": "shorten the steps about it, or raise gait.a_s",
}


class _WalkMotion(NamedTuple):
    """A followed walk; NaN where it is not known."""

    time: Array  # shape (T,) [s]
    # torques of the hinges over their limits, in double support of trunk and arms only, (T, nu) [1]
    share: Array
    rate: Array  # rates of the hinges, shape (T, nu) [rad/s]
    beyond: Array  # sideward angle of the ankles beyond their range, 0 of other hinges, shape (T, nu) [rad]
    closest: Extreme  # least distance of two parts until a leg does not reach [m]
    # pieces in which a leg does not reach: begin and end [s], and why
    lost: list[tuple[float, float, Unreachable]]


def check_walk(plan: StepPlan, posture: ConstantPosture, run: RunParameters, robot: Robot) -> None:
    """Refuse a walk for ranges of joints, reach of the legs, distances of parts, speeds or torques.

    The mean share of a torque limit over 60 ms may be 1.1, as the controller shares out what a joint lacks:
    walks up to 1.14 keep within 2.5 mm of ZMP, from 1.15 some fall.

    Args:
        plan: from rest to rest.
        posture: gives start, heading and rest of the joints.
        run: gains.
        robot: the body.

    Raises:
        BodilyRefusal: ``ankles_do_not_roll``, ``joint_limits``, ``leg_too_short``, ``self_collision``,
            ``arm_collision``, ``speed_limits`` or ``torque_limits``.
    """
    if robot.description.upright:
        raise _NO_ROLL.refusal(float(len(robot.description.left_leg.joints)))
    check([_range_limit(plan, posture, run, robot)])
    check(_walk_limits(plan, _follow(plan, posture, run, robot), robot))


def _range_limit(
    plan: StepPlan, posture: ConstantPosture, run: RunParameters, robot: Robot
) -> tuple[Limit, float]:
    """Largest angle by which a joint of the upright body is beyond its range in the swings, and its limit.

    Instants at which a leg does not reach are left out: with a tilted pelvis it may.
    """
    swings = [phase for phase in plan.contacts.phases if phase.kind == "single_support"]
    times = np.concatenate([part.start + part.duration * np.linspace(0.0, 1.0, _INSTANTS) for part in swings])
    ik, q = InverseKinematics(robot, run), posture.q.copy()
    reference = step_reference(plan, times).turned(posture.heading(times)[0])
    beyond = np.full((len(times), robot.nu), -math.inf)
    for index, place in enumerate(reference.position):
        q[:3] += place[0] - robot.jacobian(q).com
        try:
            upright, _ = ik.upright(reference, index, q)
        except Unreachable:
            continue
        beyond[index] = np.maximum(robot.lower - upright[7:], upright[7:] - robot.upper)
        q = upright.copy()
        q[3:7] = 0.0, 0.0, 0.0, 1.0
    row, joint = divmod(int(beyond.argmax()), robot.nu)
    where = f"footstep {row // _INSTANTS + 3}: at {times[row]:.3f} s {robot.joint_names[joint]}"
    what = f"{where} would pass its range: its angle beyond it"
    less = "shorten the steps about it, put the feet nearer to each other, or raise gait.com_height"
    if run.foot.swing_height > FootParameters().swing_height:
        less = "lower foot.swing_height"
    less = _retimed(plan, times[row]) + less
    return Limit(what, "rad", _BEYOND, AT_MOST, "joint_limits", less), float(beyond[row, joint])


def _walk_limits(plan: StepPlan, walk: _WalkMotion, robot: Robot) -> Iterator[tuple[Limit, float]]:
    """Limits and values of a followed walk, those first that make others meaningless."""
    contacts, step = plan.contacts, plan.constants.step_duration
    landings, shorten = contacts.starts[contacts.kind_codes == 1][1:], "shorten the steps about it"

    def at(time: float) -> str:
        footstep = min(int(np.searchsorted(landings, time + 1e-6, side="right")), len(landings) - 1) + 3
        return f"footstep {footstep}: at {time:.3f} s"

    for begin, _, cause in walk.lost:
        lost = sum(end - start for start, end, _ in walk.lost if begin <= start < begin + step)
        what = f"{at(begin)} {cause.what}; the time without reach in this step"
        less = f"{_retimed(plan, begin)}shorten or narrow the steps about it, or lower gait.com_height"
        stands = _phase(plan, begin).duration > step
        most = (_LOST_STANDING if stands else _LOST) if robot.description.sole.has_toes else 0.0
        yield Limit(what, "s", most, AT_MOST, "leg_too_short", less), lost

    distance, when, parts = walk.closest.value, walk.closest.time or 0.0, walk.closest.where
    what, reason = f"{at(when)} {parts} come too close: their distance", "self_collision"
    turn = "turn the toes out, by 0.1 rad for example, or in if they are out, "
    turn_less = ", or turn less" if np.ptp(contacts.headings) else ""
    less = f"{_retimed(plan, when)}{turn}put the feet further apart{turn_less}"
    if robot.of_arm(parts):
        wider = "raise body.arm_abduction, or " if robot.description.spread else ""
        reason, less = "arm_collision", f"{wider}shorten or narrow the steps about it"
    yield Limit(what, "m", CLEARANCE + _NEARER, AT_LEAST, reason, less), distance

    k, joint = divmod(int(np.nan_to_num(np.abs(walk.rate) / robot.speed_limit, nan=-1.0).argmax()), robot.nu)
    fastest, less = float(robot.speed_limit[joint]), f"{shorten}, or give them more time"
    what = f"{at(walk.time[k])} {robot.joint_names[joint]} would turn too fast: its rate"
    yield Limit(what, "rad/s", fastest, AT_MOST, "speed_limits", less), float(abs(walk.rate[k, joint]))

    mean = _means(walk.time, np.minimum(walk.share, _SPIKE), _WINDOW)
    k, joint = divmod(int(mean.argmax()), robot.nu)
    name = robot.joint_names[joint]
    group = next((g for g, names in joint_groups(robot.description).items() if name in names), "")
    what = f"{at(walk.time[k])} {name} is too weak: its torque over its limit, mean of {1e3 * _WINDOW:g} ms,"
    less = _retimed(plan, walk.time[k]) + _WAYS_OUT.get(group, f"{shorten}, or take lower ones")
    yield Limit(what, "1", _MOST, AT_MOST, "torque_limits", less), float(mean[k, joint])

    yield _burden_limit(contacts.starts[contacts.kind_codes == 0], walk, robot)


def _burden_limit(starts: Array, walk: _WalkMotion, robot: Robot) -> tuple[Limit, float]:
    """Largest sum of what ankles and motors lack in a step, in shares of their limits, by the starts [s]."""
    first = np.searchsorted(walk.time, starts)
    mean = _means(walk.time, walk.beyond, _LONG)
    lacking = _LONG * _means(walk.time, np.maximum(np.minimum(walk.share, _SPIKE) - 1.0, 0.0), _LONG)
    lacking[:, np.concatenate(robot.leg_joints) - 6] = 0.0
    worst = [np.maximum.reduceat(values, first) for values in (mean, lacking)]
    angle, lack = (values.max(axis=1) for values in worst)
    burden = angle / _ANKLE + lack / _LACK
    k = int(burden.argmax())
    ankle, other = (robot.joint_names[int(values[k].argmax())] for values in worst)
    parts = {
        f"{ankle} would be {angle[k]:.2g} rad beyond its range ({_ANKLE:g} rad at most)": angle[k],
        f"{other} would lack {lack[k]:.2g} s of its torque ({_LACK:g} s at most)": lack[k],
    }
    said = " and ".join(part for part, size in parts.items() if size > 0.0)
    what = f"footstep {k + 3}: for {1e3 * _LONG:g} ms {said}: the sum of the shares"
    ankles = angle[k] / _ANKLE > lack[k] / _LACK
    reason = "joint_limits" if ankles else "torque_limits"
    less = "put the feet nearer to each other" if ankles else "take lower ones"
    return Limit(what, "1", 1.0, AT_MOST, reason, f"shorten the steps about it, or {less}"), float(burden[k])


def _phase(plan: StepPlan, time: float) -> Phase:
    """The phase of a plan at some time [s]."""
    return next(part for part in plan.contacts.phases if time < part.start + part.duration)


def _retimed(plan: StepPlan, time: float) -> str:
    """A way out for a swing at some time [s] that is quick or slow, as its landing was given a time."""
    phase = _phase(plan, time)
    if phase.kind != "single_support":
        return ""
    share = phase.duration / plan.constants.single_support_duration
    return "let it land earlier, " if share > _SLOW else "let it land later, " if share < _QUICK else ""


def _means(time: Array, values: Array, window: float) -> Array:
    """Means over a window [s] that begins at each instant, NaN counting as zero, shape (T, nu)."""
    values, total = np.nan_to_num(values), np.zeros_like(values)
    total[1:] = np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time)[:, None], axis=0)
    later = [np.interp(time + window, time, joint) for joint in total.T]
    return np.asarray((np.stack(later, axis=1) - total) / window)


class _TrunkFeedback:
    """The controller's slow feedback of the trunk's tilt (:mod:`ampm.control.trunk`), along the heading."""

    def __init__(self, gains: ControllerParameters, window: float, mass: float) -> None:
        self.gains, self.window, self.mass = gains, window, mass
        self.past: list[tuple[float, Array]] = []  # of every piece its end [s], and its tilt times duration
        self.integral, self.momentum = np.zeros((2, 2))

    def angular_momentum(self, begin: float, duration: float) -> Array:
        """Angular momentum over the mass that rights the trunk in the next piece, shape (2,) [m^2/s]."""
        self.past = [(end, tilt) for end, tilt in self.past if end > begin - self.window]
        mean = sum((tilt for _, tilt in self.past), np.zeros(2)) / self.window
        self.integral = self.integral + mean * duration
        righting = self.gains.trunk_gain * (mean + self.gains.trunk_integral * self.integral) / self.mass
        share = 1.0 - math.exp(-self.gains.momentum_gain * duration)
        self.momentum = self.momentum + share * (righting - self.momentum)
        return self.momentum


def _follow(plan: StepPlan, posture: ConstantPosture, run: RunParameters, robot: Robot) -> _WalkMotion:
    """Follow a walk up to its last stop, piece by piece, each in axes along its heading, and measure it."""
    gains, nodes = run.controller, _INTERVALS + 1
    upright = {"body.angular_momentum_z": "free", "body.pelvis_list": 0.0, "body.pelvis_rotation": 0.0}
    soft = {
        "body.posture_stiffness": min(max(gains.posture_stiffness, 1.0), _FASTEST**2),
        "body.posture_damping": min(max(gains.posture_damping, 1.0), _FASTEST),
    }
    ik = InverseKinematics(robot, run.replace(upright | soft))
    edges, stance, time = _pieces(plan)
    heading, rate_of_heading, acceleration = posture.heading(0.5 * (edges[1:] + edges[:-1]))
    # The pull of a posture at rest lags.
    lead = (ik.body.damping * rate_of_heading + acceleration) / ik.body.stiffness
    heading = heading + lead
    reference = step_reference(plan, time).turned(np.repeat(heading, nodes))
    feedback = _TrunkFeedback(gains, 2.0 * plan.constants.step_duration, robot.mass)
    share, rate, angle = np.full((3, len(time), robot.nu), np.nan)
    lost, reached = [], [posture.start[0][None]]
    (q, v), axes, tilt = posture.start, 0.0, np.zeros(2)
    for k, (begin, end) in enumerate(pairwise(edges.tolist())):
        rows = slice(k * nodes, (k + 1) * nodes)
        q, axes = turned(q, axes - heading[k]), heading[k]
        righting = feedback.angular_momentum(begin, end - begin) @ rotations(lead[k])
        piece = reference.part(rows).with_angular_momentum(-righting)
        try:
            step = ik.integrate(piece, q, v)
            if stance[k] == 2 and np.abs(step.v[:, robot.knee_joints]).max() > _STRAIGHTENS:
                raise Unreachable(begin, "a standing leg is straight")
        except Unreachable as error:
            lost.append((begin, end, error))
            q, v = _upright(ik, piece, posture, robot)
        else:
            q, v = step.q[-1], step.v[-1]
            tilt = pin.log3(robot.trunk_rotations(q[None])[0] @ posture.trunk.T)[:2] @ rotations(-lead[k])
            rate[rows], angle[rows] = step.v[:, 6:], step.q[:, 7:]
            share[rows] = _shares(step, piece, int(stance[k]), robot)
            reached += [] if lost else [step.q[::2]]
        feedback.past.append((end, (end - begin) * tilt))
    sideward = np.isin(robot.joint_names, joint_groups(robot.description)["ankle"])
    sideward &= (np.abs(robot.jacobian(posture.q).jacobian[ROLLS, 6:]) > math.sqrt(0.5)).any(axis=0)
    beyond = np.where(sideward, np.maximum(np.maximum(robot.lower - angle, angle - robot.upper), 0.0), 0.0)
    closest = Extreme.of_gaps(robot.gaps(np.concatenate(reached)), np.append(time[:1], time[::2]))
    return _WalkMotion(time, share, rate, beyond, closest, lost)


def _pieces(plan: StepPlan) -> tuple[Array, Array, Array]:
    """Pieces of a walk up to its last stop: edges (K + 1,) [s], stance (K,), instants of all (T,) [s]."""
    *phases, last = plan.contacts.phases
    counts = [math.ceil(phase.duration / _PIECE) for phase in phases]
    begins = [p.start + p.duration * np.arange(n) / n for p, n in zip(phases, counts, strict=True)]
    edges = np.append(np.concatenate(begins), last.start)
    time = edges[:-1, None] + np.diff(edges)[:, None] * np.linspace(0.0, 1.0, _INTERVALS + 1)
    time[:, -1] -= 1e-9  # before a foot lifts
    return edges, np.repeat(plan.contacts.stance_codes[:-1], counts), time.ravel()


def _upright(
    ik: InverseKinematics, piece: StepReference, posture: ConstantPosture, robot: Robot
) -> tuple[Array, Array]:
    """State from which to go on after a piece: upright, and at rest where the legs do not reach there."""
    end, q = len(piece.time) - 1, posture.q.copy()
    q[:3] += piece.position[end, 0] - robot.jacobian(q).com
    try:
        return ik.upright(piece, end, q)
    except Unreachable:
        return q, np.zeros(robot.nv)


def _shares(step: StepTrajectory, piece: StepReference, stance: int, robot: Robot) -> Array:
    """Torques over their limits on the foot that stands, 0 or 1; on both feet those of the legs are NaN."""
    unsupported = robot.unsupported(step.q, step.v, step.acceleration)
    torque, force, moment, _ = unsupported
    if stance < 2:
        moment = moment - np.cross(piece.position[:, 1 + stance], force)
        # A sole does not twist the floor.
        moment[:, 2] = -(force[:, :2] * moment[:, :2]).sum(axis=1) / force[:, 2]
        torque -= unsupported.taken(stance, force, moment)
    else:
        torque[:, np.concatenate(robot.leg_joints) - 6] = np.nan
    return np.abs(torque) / robot.torque_limit
