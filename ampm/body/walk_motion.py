"""A body over a whole walk, by inverse kinematics on a coarse grid: what it cannot walk is refused.

Posture gains and slow feedback of the trunk's tilt are the controller's, so that trunk and arms move as in
the walk.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ampm.body.constant_posture import ConstantPosture, turned
from ampm.body.feasibility import CLEARANCE, joint_groups
from ampm.body.inverse_kinematics import InverseKinematics, StepTrajectory, Unreachable
from ampm.body.rigid_body import passive_torques
from ampm.body.robot import Robot
from ampm.body.step_reference import StepReference, step_reference
from ampm.exceptions import BodilyRefusal
from ampm.parameters import RunParameters
from ampm.planner.support import StepPlan

Array = NDArray[np.float64]

_PIECE, _INTERVALS = 0.04, 5
"""Longest time for which heading and feedback are held [s], and intervals of the grid in it."""
_FASTEST = 100.0  # fastest rate of the posture that the grid follows [1/s]
_LOST = 0.1  # longest time of a step in which a leg may not reach [s]: the controller gives way for so long
_WINDOW = 0.06  # time over which a torque is averaged [s]
_MOST = 1.1  # largest mean share of a torque limit [1]
_SPIKE = 3.0  # share that counts at most [1]: next to a straight leg it has no bound
_NEARER = 5e-4  # by which parts may come nearer in the walk [m]: .43 mm at most in 40 walks
_INSTANTS = 7  # of every swing at which the upright body's ranges are checked
_BEYOND = 0.05
"""How far an upright body may be beyond a joint's range [rad]: a pelvis that tilts makes up for as much."""
_LONG, _ANKLE, _LACK = 0.15, 0.04, 0.022
"""Time over which an ankle's sideward angle beyond its range is averaged [s], and the largest mean [rad]: no
pelvis that tilts makes up for it. The largest integral over this time of the share beyond 1 of a torque of
trunk or arms [s]. Shares of both limits add up. Chosen on random walks of the G1: most of those with more
than 1 fell, or their arms came into their legs."""
_WAYS_OUT = {
    "hip": "shorten or narrow the steps about it, lower gait.c_y, or raise gait.switching_velocity",
    "ankle": "shorten the steps about it, or raise gait.a_s",
}


class _Followed(NamedTuple):
    """A followed walk; NaN where it is not known.

    Attributes:
        time: shape (T,) [s].
        share: torques of the hinges over their limits, in double support of trunk and arms only, (T, nu) [1].
        rate: of the hinges, shape (T, nu) [rad/s].
        beyond: sideward angle of the ankles beyond their range, of others 0, shape (T, nu) [rad].
        gap: of the body's parts at the start, then at every other instant until a leg does not reach, (K,)
            [m].
        parts: names of those that are next to each other, K texts.
        lost: pieces in which a leg does not reach: begin and end [s], and why.
    """

    time: Array
    share: Array
    rate: Array
    beyond: Array
    gap: Array
    parts: tuple[str, ...]
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
        BodilyRefusal: ``joint_limits``, ``leg_too_short``, ``self_collision``, ``arm_collision``,
            ``speed_limits`` or ``torque_limits``.
    """
    _check_ranges(plan, posture, run, robot)
    walk = _follow(plan, posture, run, robot)
    contacts, step = plan.contacts, plan.constants.step_duration
    swings = contacts.starts[contacts.kind_codes == 0]

    def footstep(time: float) -> str:
        return f"footstep {max(int(np.searchsorted(swings, time + 1e-6, side='right')), 1) + 2}"

    for begin, _, cause in walk.lost:
        lost = sum(end - start for start, end, _ in walk.lost if begin <= start < begin + step)
        if lost > _LOST:
            raise BodilyRefusal(
                f"{footstep(begin)}: {cause.what} from {begin:.3f} s on, for {lost:.2g} s of a step, longer "
                f"than {_LOST:g} s",
                reason="leg_too_short", value=lost, limit=_LOST, unit="s",
                way_out="shorten or narrow the steps about it, or lower gait.com_height",
            )  # fmt: skip
    k = int(walk.gap.argmin())
    time = float(walk.time[max(2 * k - 2, 0)])
    if walk.gap[k] < CLEARANCE + _NEARER:
        arms = any(part in walk.parts[k] for part in ("arm", "hand", "elbow", "wrist"))
        raise BodilyRefusal(
            f"{footstep(time)}: {walk.parts[k]} come within {1e3 * walk.gap[k]:.3g} mm at "
            f"{time:.3f} s, nearer than {1e3 * (CLEARANCE + _NEARER):g} mm",
            reason="arm_collision" if arms else "self_collision",
            value=float(walk.gap[k]), limit=CLEARANCE + _NEARER, unit="m",
            way_out=("raise body.arm_abduction, or " if robot.description.spread else "")
            + "shorten or narrow the steps about it" if arms
            else "turn the toes out, by 0.1 rad for example, put the feet further apart, or turn less",
        )  # fmt: skip
    fastest = np.full(robot.nu, math.inf)
    for name, speed in robot.description.speed_limits:
        fastest[robot.velocity_indices((name,)) - 6] = speed
    k, joint = _largest(np.abs(walk.rate) / fastest)
    name, rate = robot.joint_names[joint], float(abs(walk.rate[k, joint]))
    if rate > fastest[joint]:
        raise BodilyRefusal(
            f"{footstep(walk.time[k])}: {name} would turn at {rate:.4g} rad/s at {walk.time[k]:.3f} s, "
            f"faster than its limit, {fastest[joint]:.4g} rad/s",
            reason="speed_limits", value=rate, limit=float(fastest[joint]), unit="rad/s",
            way_out="shorten the steps about it, or give them more time",
        )  # fmt: skip
    mean = _means(walk.time, np.minimum(walk.share, _SPIKE), _WINDOW)
    k, joint = _largest(mean)
    if mean[k, joint] > _MOST:
        name = robot.joint_names[joint]
        group = next((g for g, names in joint_groups(robot.description).items() if name in names), "")
        raise BodilyRefusal(
            f"{footstep(walk.time[k])}: {name} would need {mean[k, joint]:.3g} of its torque for "
            f"{1e3 * _WINDOW:g} ms from {walk.time[k]:.3f} s on, more than {_MOST:g}",
            reason="torque_limits", value=float(mean[k, joint]), limit=_MOST, unit="1",
            way_out=_WAYS_OUT.get(group, "shorten the steps about it, or take lower ones"),
        )  # fmt: skip
    first = np.searchsorted(walk.time, swings)
    mean = _means(walk.time, walk.beyond, _LONG)
    lacking = _LONG * _means(walk.time, np.maximum(np.minimum(walk.share, _SPIKE) - 1.0, 0.0), _LONG)
    lacking[:, np.concatenate(robot.leg_joints) - 6] = 0.0
    worst = [np.maximum.reduceat(values, first) for values in (mean, lacking)]
    angle, lack = (values.max(axis=1) for values in worst)
    burden = angle / _ANKLE + lack / _LACK
    k = int(burden.argmax())
    if burden[k] > 1.0:
        ankles = angle[k] / _ANKLE > lack[k] / _LACK
        ankle, other = (robot.joint_names[int(values[k].argmax())] for values in worst)
        what = f"{ankle} would be {angle[k]:.2g} rad beyond its range for {1e3 * _LONG:g} ms"
        also = f"{other} would lack {lack[k]:.2g} s of its torque"
        both = " and ".join([what] * bool(angle[k]) + [also] * bool(lack[k]))
        raise BodilyRefusal(
            f"footstep {k + 3}: {both}, {burden[k]:.3g} times what the walk makes up for, "
            f"{_ANKLE:g} rad or {_LACK:g} s",
            reason="joint_limits" if ankles else "torque_limits", value=float(burden[k]), limit=1.0, unit="1",
            way_out="shorten the steps about it, or put the feet nearer to each other" if ankles
            else "shorten the steps about it, or take lower ones",
        )  # fmt: skip


def _check_ranges(plan: StepPlan, posture: ConstantPosture, run: RunParameters, robot: Robot) -> None:
    """Refuse footsteps at which a joint of the upright body is too far beyond its range.

    Instants that a leg does not reach are left out: a pelvis that tilts may reach them.
    """
    swings = [phase for phase in plan.contacts.phases if phase.kind == "single_support"]
    times = np.concatenate(
        [swing.start + swing.duration * np.linspace(0.0, 1.0, _INSTANTS) for swing in swings]
    )
    ik, q = InverseKinematics(robot, run), posture.q.copy()
    reference = step_reference(plan, times).turned(posture.heading(times)[0])
    beyond = np.full((len(times), robot.nu), -math.inf)
    for index, place in enumerate(reference.position):
        q[:3] += place[0] - robot.jacobian(q).com
        try:
            found = ik.upright(reference, index, q)
        except Unreachable:
            continue
        beyond[index] = np.maximum(robot.lower - found[7:], found[7:] - robot.upper)
        q = found.copy()
        q[3:7] = 0.0, 0.0, 0.0, 1.0
    row, joint = divmod(int(beyond.argmax()), robot.nu)
    if beyond[row, joint] > _BEYOND:
        raise BodilyRefusal(
            f"footstep {row // _INSTANTS + 3}: {robot.joint_names[joint]} would be "
            f"{beyond[row, joint]:.2g} rad beyond its range at {times[row]:.3f} s, more than {_BEYOND:g} rad",
            reason="joint_limits", value=float(beyond[row, joint]), limit=_BEYOND, unit="rad",
            way_out="shorten the steps about it, put the feet nearer to each other, or raise gait.com_height",
        )  # fmt: skip


def _largest(values: Array) -> tuple[int, int]:
    """Row and column of the largest value, NaN being the least."""
    row, column = divmod(int(np.where(np.isnan(values), -1.0, values).argmax()), values.shape[1])
    return row, column


def _means(time: Array, values: Array, window: float) -> Array:
    """Means over a window [s] that begins at each instant, NaN counting as zero, shape (T, nu)."""
    values, total = np.nan_to_num(values), np.zeros_like(values)
    total[1:] = np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time)[:, None], axis=0)
    later = [np.interp(time + window, time, joint) for joint in total.T]
    return np.asarray((np.stack(later, axis=1) - total) / window)


def _follow(plan: StepPlan, posture: ConstantPosture, run: RunParameters, robot: Robot) -> _Followed:
    """Follow a walk up to its last stop."""
    gains, nodes = run.controller, _INTERVALS + 1
    ankles = np.isin(robot.joint_names, joint_groups(robot.description)["ankle"])
    ankles &= (np.abs(robot.jacobian(posture.q).jacobian[[9, 15], 6:]) > math.sqrt(0.5)).any(axis=0)
    ik = InverseKinematics(
        robot,
        run.replace(
            {
                "body.angular_momentum_z": "free",
                "body.posture_stiffness": min(max(gains.posture_stiffness, 1.0), _FASTEST**2),
                "body.posture_damping": min(max(gains.posture_damping, 1.0), _FASTEST),
            }
        ),
    )
    *phases, last = plan.contacts.phases
    counts = [math.ceil(phase.duration / _PIECE) for phase in phases]
    stance = np.repeat(plan.contacts.stance_codes[:-1], counts)
    begins = [
        phase.start + phase.duration * np.arange(n) / n for phase, n in zip(phases, counts, strict=True)
    ]
    edges = np.append(np.concatenate(begins), last.start)
    length = np.diff(edges)
    time = edges[:-1, None] + length[:, None] * np.linspace(0.0, 1.0, nodes)
    time[:, -1] -= 1e-9  # before a foot lifts
    time = time.ravel()
    heading, turning, bend = posture.heading(0.5 * (edges[1:] + edges[:-1]))
    lead = (ik.damping * turning + bend) / ik.stiffness  # the pull of a posture at rest lags
    heading = heading + lead
    reference = step_reference(plan, time).turned(np.repeat(heading, nodes))
    share, rate, beyond = np.full((3, len(time), robot.nu), np.nan)
    lost, window = [], 2.0 * plan.constants.step_duration
    tilts, (integral, tilt, given), axes = np.zeros((len(length), 2)), np.zeros((3, 2)), 0.0
    configurations = [posture.start[0][None]]
    q, v = posture.start
    for k, part in enumerate(length):
        rows = slice(k * nodes, (k + 1) * nodes)
        q, axes = turned(q, axes - heading[k]), heading[k]
        recent = edges[1 : k + 1] > edges[k] - window
        mean = (length[:k, None] * tilts[:k])[recent].sum(axis=0) / window
        integral = integral + mean * part
        wanted = gains.trunk_gain * (mean + gains.trunk_integral * integral) / robot.mass
        piece = reference.part(rows)
        velocity = piece.velocity.copy()
        given += (1.0 - math.exp(-gains.momentum_gain * part)) * (wanted - given)
        velocity[:, 3:5] -= given @ _turn(lead[k])
        piece = replace(piece, velocity=velocity)
        try:
            found = ik.integrate(piece, q, v, 0.0, draft=True)
        except Unreachable as error:
            lost.append((float(edges[k]), float(edges[k + 1]), error))
            q, v = _upright(ik, piece, posture, robot)
        else:
            q, v = found.q[-1], found.v[-1]
            tilt = pin.log3(robot.trunk_rotations(q[None])[0] @ posture.trunk.T)[:2] @ _turn(-lead[k])
            rate[rows], angle = found.v[:, 6:], found.q[:, 7:]
            out = np.maximum(robot.lower - angle, angle - robot.upper)
            beyond[rows] = np.where(ankles, np.maximum(out, 0.0), 0.0)
            configurations += [] if lost else [found.q[::2]]
            share[rows] = _shares(found, int(stance[k]), robot)
        tilts[k] = tilt
    gaps = robot.shapes.gaps(np.concatenate(configurations))
    return _Followed(time, share, rate, beyond, gaps.distance, gaps.parts, lost)


def _turn(angle: float) -> Array:
    """Matrix by which a row of components is multiplied for axes turned by an angle [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s], [s, c]])


def _upright(
    ik: InverseKinematics, piece: StepReference, posture: ConstantPosture, robot: Robot
) -> tuple[Array, Array]:
    """State from which to go on after a piece: upright, and at rest where the legs do not reach there."""
    end, still, q = len(piece.time) - 1, np.zeros(robot.nv), posture.q.copy()
    q[:3] += piece.position[end, 0] - robot.jacobian(q).com
    try:
        return ik.project(piece, end, ik.upright(piece, end, q), still, 0.0)
    except Unreachable:
        return q, still


def _shares(found: StepTrajectory, stance: int, robot: Robot) -> Array:
    """Torques over their limits on the foot that stands, 0 or 1; on both feet those of the legs are NaN."""
    torque, own = np.empty((len(found.q), robot.nu)), np.empty(robot.nu)
    for k, (q, v, a) in enumerate(zip(found.q, found.v, found.acceleration, strict=True)):
        total = pin.rnea(robot.model, robot.data, q, v, a)
        passive_torques(robot.passive, q, v, v, own)
        torque[k] = total[6:] + own
        if stance < 2:
            terms = robot.jacobian(q)
            rows = terms.jacobian[6 + 6 * stance : 12 + 6 * stance, 6:]
            wrench = robot.floor_wrench(terms, q, total, stance)
            wrench[5] = -(wrench[:2] @ wrench[3:5]) / wrench[2]  # a sole does not twist the floor
            torque[k] -= rows.T @ wrench
    if stance == 2:
        torque[:, np.concatenate(robot.leg_joints) - 6] = np.nan
    return np.abs(torque) / robot.torque_limit
