"""Decide by whole-body trajectory optimisation whether refused gaits can be walked; write data/referee.csv.

    python docs/referee.py [human | g1] [GAIT ...]

Half a minute for a gait. Plan, feet and limits are those of the search; its inverse kinematics is not used.
Free are all joints at the nodes of one step, whose end mirrors its start, and timing, heights and angles
of the feet. Pinocchio gives inverse dynamics and derivatives; Gauss and Newton (Levenberg, Marquardt)
minimise the squares of all violations over their tolerances. ``motion found`` means that none is above its
tolerance, at the nodes. ``none found`` proves nothing, as the problem is not convex. Motions that are found
are walked in ten steps.
"""

import sys
import time
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from referee_walk import Found
from scipy.linalg import cho_factor, cho_solve
from trials import DATA, read_rows, write_rows

import validation as val
from ampm.body.inverse_kinematics import InverseKinematics
from ampm.body.limits import CLEARANCE, KNEE_MINIMUM, LIMITS
from ampm.body.robot import Robot
from ampm.body.step_reference import phase_grid, step_reference
from ampm.exceptions import InputError, RefusedGait
from ampm.geometry import Array
from ampm.parameters import RunParameters
from ampm.planner.support import StepPlan, plan_steps
from ampm.tune import gait_limits
from ampm.tune.first_gait import easy_gait
from ampm.tune.free_choices import FreeChoices
from ampm.tune.search import rough_orbit
from ampm.tune.tuning import tune
from validation.judge.verdict import VerdictName
from validation.study.sweep.design import load_sweep
from validation.trial.plan import make_body, own_gait

NODES = (22, 10)
"""Intervals in single and in double support."""
TOLERANCES = {
    "com [m]": 1e-3,
    "feet [m]": 1e-3,
    "soles [rad]": 3e-3,
    "toes [rad]": 1e-2,
    "momentum [m^2/s]": 1e-3,  # angular momentum over the mass
    "knee [rad]": 0.01,
    "joint [rad]": 0.01,
    "tilt [rad]": 0.02,
    "speed [1]": 0.02,
    "torque [1]": 0.02,
    "twist [m]": 3e-3,
    "gap [m]": 1e-3,
    "plan [1]": 0.1,  # normalised margin of what plan and feet alone decide
}
"""Of what is violated."""
_EQUAL = {"com [m]", "feet [m]", "soles [rad]", "toes [rad]", "momentum [m^2/s]"}
_TWIST = (
    LIMITS["twist"].bound * gait_limits._TWIST_LEVER
)  # largest moment about the vertical over the force [m]
_TILT = 0.6  # most of pelvis and trunk from upright: what tilts more is no walk [rad]
_SMOOTH, _POSTURE, _CHOICES = 1e-3, 0.02, 0.02  # weights of accelerations, of angles, of changes of a choice
_WITHIN = 0.3  # tolerances inside a limit at which its violation begins [1]
_NEAR = 0.02  # distance of parts from which its slope is taken [m]
_STEPS, _LEAST = 50, 4e-3  # iterations of one start, and the least progress of each over eight of them [1]
_RENEWED = 3  # iterations after which the slopes by the choices are taken again
_OF_POSTURE = ("lean", "spread")  # choices of which the plan is independent
_ROOM = 0.025  # between parts of a motion that is walked, as the posture is followed softly [m]
_WALKED = 10  # steps of a motion that is walked
STARTS = 3
"""Choices at first: those of the search's guess, and others that are spread about it."""
REFUSED = {
    "human": ("unseen", (1, 9, 15, 17, 19, 22, 24, 32, 34, 57, 64, 65, 72, 82, 91, 99)),
    "g1": ("unseen-g1", (1, 2, 4, 5, 7, 8, 12, 16, 17, 18)),
}
"""Draw of a body, and its gaits that were refused before the referee was asked."""
COLUMNS = "body", "gait", "verdict", "largest violation", "over its tolerance", "start", "seconds", "its walk"


class Tasks(NamedTuple):
    """What a plan asks of the body at the N nodes."""

    time: Array  # with the step's end, shape (N + 1,) [s]
    com: Array  # shape (N, 3) [m]
    place: Array  # of the soles, shape (N, 2, 3) [m]
    turn: Array  # of the soles to world, shape (N, 2, 3, 3)
    toe: Array  # shape (N, 2) [rad]
    momentum: Array  # angular, over the mass, about x and y, shape (N, 2) [m^2/s]
    load: Array  # force and moment about the world's origin of each foot without twist, shape (N, 2, 6)
    share: Array  # of the load on each foot, shape (N, 2) [1]
    untwisted: Array  # rate of L_z without a twist, shape (N,) [N m]
    weight: Array  # vertical force, shape (N,) [N]
    on_toe: Array  # torque of the toe joints by the load before them, shape (N, 2) [N m]
    broken: Array  # shortfall of the margins of the plan [1]


def tasks_of(plan: StepPlan, run: RunParameters, robot: Robot) -> Tasks:
    """Tasks of a plan."""
    grid = phase_grid(plan, *NODES)
    reference, at = step_reference(plan, grid[:-1]), plan.sample(grid[:-1])
    feet, right = plan.feet.sample(grid[:-1]), at.right_load
    right, points = gait_limits.shared_load(feet, at.zmp, right, robot.description.sole)
    share = np.stack([1.0 - right, right], axis=1)
    load, on_toe = np.zeros((len(right), 2, 6)), np.zeros((len(right), 2))
    for foot in (0, 1):
        force = share[:, foot, None] * at.force
        load[:, foot] = np.hstack([force, np.cross(points[foot], force)])
        axis = feet[foot].position[:, 0] + robot.description.sole.ball_x * np.cos(feet[foot].pitch)
        on_toe[:, foot] = np.maximum(0.0, points[foot][:, 0] - axis) * force[:, 2]
    arm = np.concatenate([at.zmp, np.zeros((len(right), 1))], axis=1) - at.com
    margins = [
        LIMITS[name].margin(float(value))
        for name, values in gait_limits.plan_margins(plan, run, robot.description).items()
        for value in values
    ]
    return Tasks(
        grid,
        reference.position[:, 0],
        reference.position[:, 1:],
        reference.rotation,
        reference.toe,
        reference.velocity[:, 3:5],
        load,
        share,
        np.cross(arm, at.force)[:, 2],
        at.force[:, 2],
        on_toe,
        np.maximum(0.0, 0.05 - np.array(margins)) / TOLERANCES["plan [1]"],
    )


@dataclass
class Motion:
    """Unknowns: configurations at the nodes, the constant of L_y over the mass, the free choices."""

    q: Array  # shape (N, nq)
    offset: float  # [m^2/s]
    x: Array  # see :class:`ampm.tune.free_choices.FreeChoices`


class Problem:
    """A periodic step of one gait and body.

    Args:
        run: the gait.
        robot: the body.
        clearance: least distance of its parts [m].
    """

    def __init__(self, run: RunParameters, robot: Robot, clearance: float) -> None:
        self.robot, self.model, self.data = robot, robot.model, robot.model.createData()
        self.space = FreeChoices(run, run.given, robot.description)
        self.base, self.clearance = self.space.guess(), clearance
        self.mirror = robot.mirror_v(np.eye(robot.nv)).T
        pin.framesForwardKinematics(self.model, self.data, pin.neutral(self.model))
        frames = self.model.getFrameId(self.model.names[1]), robot.trunk_frame
        self.upright = [(frame, self.data.oMf[frame].rotation[2].copy()) for frame in frames]
        self.fastest = np.full(robot.nu, np.inf)
        for name, speed in robot.description.speed_limits:
            self.fastest[robot.velocity_indices((name,)) - 6] = speed
        self.guess = np.clip(
            [self.base[name] for name in self.space.names], self.space.lower, self.space.upper
        )

    def planned(self, x: Array) -> tuple[RunParameters, StepPlan]:
        """Complete run and plan of a choice.

        Raises:
            RefusedGait, InputError: the formula has no solution.
        """
        run = self.space.parameters({**self.base, **dict(zip(self.space.names, x.tolist(), strict=True))})
        gait = run.gait.model_copy(update={"steps": 2})
        return run, plan_steps(gait, run.body.mass, run.foot, self.space.sole)

    def tasks(self, x: Array) -> Tasks:
        """Tasks of a choice; raises as :meth:`planned`."""
        run, plan = self.planned(x)
        self.way = plan.contacts.step_length
        return tasks_of(plan, run, self.robot)

    def linearised(self, at: Motion, tasks: Tasks, *, slopes: bool = True) -> tuple[Array, list[Array]]:
        """Residuals of every node over their tolerances, shape (N, R), and their slopes.

        Returns:
            The slopes by the configurations before, at and after each node and by the constant of L_y, a list
            of N arrays of shape (R, 3 nv + 1); empty without ``slopes``.
        """
        model, way = self.model, self.way
        q = [self.robot.mirror_q(at.q[-1], -way), *at.q, self.robot.mirror_q(at.q[0], way)]
        h = np.diff(np.concatenate([[tasks.time[-2] - tasks.time[-1]], tasks.time]))
        rate = [pin.difference(model, a, b) / dt for a, b, dt in zip(q, q[1:], h, strict=False)]
        gaps = self.robot.gaps(at.q).distance
        values, found = [], []
        for k, place in enumerate(at.q):
            before, after = h[k], h[k + 1]
            both = before + after
            v = (before * rate[k + 1] + after * rate[k]) / both
            a = 2.0 * (rate[k + 1] - rate[k]) / both
            value, by_q, by_v, by_a, by_offset = self._node(k, place, v, a, at.offset, tasks, gaps[k], slopes)
            values.append(value)
            if not slopes:
                continue
            back, here = (pin.dDifference(model, q[k], place, end) / before for end in (pin.ARG0, pin.ARG1))
            there, ahead = (
                pin.dDifference(model, place, q[k + 2], end) / after for end in (pin.ARG0, pin.ARG1)
            )
            earlier, later = (after * by_v - 2.0 * by_a) / both, (before * by_v + 2.0 * by_a) / both
            first, last = earlier @ back, later @ ahead
            first = first @ self.mirror if k == 0 else first
            last = last @ self.mirror if k == len(at.q) - 1 else last
            found.append(np.hstack([first, by_q + earlier @ here + later @ there, last, by_offset[:, None]]))
        return np.array(values), found

    def _node(
        self, k: int, q: Array, v: Array, a: Array, offset: float, tasks: Tasks, gap: float, slopes: bool
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Residuals at node k over tolerances, and their slopes by q, v, a and the constant of L_y."""
        robot, model, data, nv, m = self.robot, self.model, self.data, self.robot.nv, self.robot.mass
        terms = []

        def term(
            name: str, value: Array, by_q: Any = 0.0, by_v: Any = 0.0, by_a: Any = 0.0, by: Any = 0.0
        ) -> None:
            size = TOLERANCES.get(name, 1.0)
            blocks = [
                np.broadcast_to(slope, (len(value), nv)) / size for slope in (by_q, by_v, by_a) if slopes
            ]
            terms.append((name, value / size, *blocks, np.broadcast_to(by, len(value)) / size))

        def at_most(name: str, value: Array, bound: float, *by: Any) -> None:
            excess = value - bound + _WITHIN * TOLERANCES[name]
            broken = (excess > 0.0)[:, None]
            term(name, np.maximum(excess, 0.0), *(broken * slope for slope in by))

        eye = np.eye(nv)
        by_q, by_v, by_a = np.zeros((3, robot.nu, nv))
        h_q, r_q, r_v, r_a = np.zeros((4, 6, nv))
        torque = pin.rnea(model, data, q, v, a)[6:].copy()
        pin.computeCentroidalMomentumTimeVariation(model, data, q, v, a)
        spin, rate = data.hg.angular[:2] / m, data.dhg.angular[2]
        if slopes:
            pin.computeRNEADerivatives(model, data, q, v, a)
            by_q, by_v = data.dtau_dq[6:].copy(), data.dtau_dv[6:].copy()
            by_a = (np.triu(data.M) + np.triu(data.M, 1).T)[6:]
            h_q, r_q, r_v, r_a = pin.computeCentroidalDynamicsDerivatives(model, data, q, v, a)
        h_v, by_com = r_a[3:5], pin.jacobianCenterOfMass(model, data, q)
        term("com [m]", data.com[0] - tasks.com[k], by_com)
        constant = np.array([0.0, offset])
        term("momentum [m^2/s]", spin - tasks.momentum[k] - constant, h_q[3:5] / m, h_v / m, 0.0, [0.0, -1.0])
        twist, sign = rate - tasks.untwisted[k], np.sign(rate - tasks.untwisted[k]) / tasks.weight[k]
        at_most(
            "twist [m]", np.array([twist * sign]), _TWIST, *(sign * slope[5:] for slope in (r_q, r_v, r_a))
        )
        damping, stiffness, spring, friction = robot.passive.T
        torque += damping * v[6:] + stiffness * (q[7:] - spring) + friction * np.tanh(v[6:] / 0.1)
        by_q[:, 6:] += np.diag(stiffness)
        by_v[:, 6:] += np.diag(damping)
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        for foot, frame in enumerate(robot.sole_frames):
            pose, share, load = data.oMf[frame], tasks.share[k, foot], tasks.load[k, foot].copy()
            local = pin.getFrameJacobian(model, data, frame, pin.LOCAL)
            term("feet [m]", pose.translation - tasks.place[k, foot], pose.rotation @ local[:3])
            term("soles [rad]", pin.log3(tasks.turn[k, foot].T @ pose.rotation), local[3:])
            load[5] += share * twist
            s = pin.getJointJacobian(model, data, model.frames[frame].parentJoint, pin.WORLD)
            torque -= s[:, 6:].T @ load
            if len(robot.toe_joints):
                torque[robot.toe_joints[foot] - 6] += tasks.on_toe[k, foot]
            if not slopes:
                continue
            for own, slope in ((by_q, r_q), (by_v, r_v), (by_a, r_a)):
                own -= share * np.outer(s[5, 6:], slope[5])
            linear, angular = s[:3].T, s[3:].T  # of joint i, row; it turns with every joint j before it
            moving = np.cross(angular[None], linear[:, None]) + np.cross(linear[None], angular[:, None])
            turning = np.cross(angular[None], angular[:, None])
            by_q -= np.tril(moving @ load[:3] + turning @ load[3:])[6:]
        for frame, up in self.upright:
            turn = data.oMf[frame].rotation
            tilt = np.arccos(np.clip((turn @ up)[2], -1.0, 1.0))
            by = (turn @ pin.skew(up))[2] @ pin.getFrameJacobian(model, data, frame, pin.LOCAL)[3:]
            at_most("tilt [rad]", np.array([tilt]), _TILT, by[None] / max(np.sin(tilt), 1e-3))
        limit = robot.torque_limit
        signs = (np.sign(torque) / limit)[:, None]
        at_most("torque [1]", np.abs(torque) / limit, 1.0, signs * by_q, signs * by_v, signs * by_a)
        term(
            "toes [rad]",
            q[robot.toe_joints + 1] - tasks.toe[k, : len(robot.toe_joints)],
            eye[robot.toe_joints],
        )
        bent, knees = robot.knee_flexion(q), robot.knee_joints
        signs = (robot.knee_flexion(np.ones(robot.nq)) - robot.knee_flexion(np.zeros(robot.nq)))[:, None]
        at_most("knee [rad]", -bent, -KNEE_MINIMUM, -signs * eye[knees])
        at_most("joint [rad]", q[7:] - robot.upper, 0.0, eye[6:])
        at_most("joint [rad]", robot.lower - q[7:], 0.0, -eye[6:])
        signs = (np.sign(v[6:]) / self.fastest)[:, None]
        at_most("speed [1]", np.abs(v[6:]) / self.fastest, 1.0, 0.0, signs * eye[6:])
        nearer = np.zeros((1, nv))
        if slopes and gap < _NEAR:
            moved = np.array([pin.integrate(model, q, 1e-5 * direction) for direction in eye])
            nearer = ((gap - robot.gaps(moved).distance) / 1e-5)[None]
        at_most("gap [m]", np.array([-gap]), -self.clearance, nearer)
        term("", _SMOOTH * a, 0.0, 0.0, _SMOOTH * eye)
        term("", _POSTURE * np.append(pin.log3(pin.Quaternion(q[3:7]).matrix()), q[7:]), _POSTURE * eye[3:])
        self.names = np.concatenate([[name] * len(value) for name, value, *_ in terms])
        if not slopes:
            return (np.concatenate([item[1] for item in terms]),) * 5
        return tuple(np.concatenate([item[i] for item in terms]) for i in range(1, 6))

    def violations(self, values: Array, tasks: Tasks) -> dict[str, float]:
        """The largest violation by name [tolerances]."""
        worst = np.abs(values).max(axis=0)
        inside = {name: 0.0 if name in _EQUAL else _WITHIN for name in TOLERANCES}
        found = {
            name: max(worst[self.names == name].max(initial=0.0) - inside[name], 0.0) for name in TOLERANCES
        }
        return {**found, "plan [1]": float(tasks.broken.max(initial=0.0))}

    def solve(self, at: Motion) -> tuple[Motion, dict[str, float]]:
        """Least squares from a motion, and what it violates [tolerances].

        Raises:
            RefusedGait, InputError: there is no plan for its choices.
        """
        nv, count, n = self.robot.nv, len(at.x), len(at.q)
        size, damping, costs = n * nv + 1 + count, 1e-2, list[float]()
        tasks = self.tasks(at.x)
        values, slopes = self.linearised(at, tasks)

        def cost(at: Motion, values: Array, tasks: Tasks) -> float:
            own = _CHOICES * (at.x - self.guess) / self.space.slack
            return float((values**2).sum() + (tasks.broken**2).sum() + own @ own)

        best = cost(at, values, tasks)
        while len(costs) < _STEPS and max(self.violations(values, tasks).values()) > 1.0:
            square, slope = np.zeros((size, size)), np.zeros(size)
            if len(costs) % _RENEWED == 0:
                by_choice, by_broken = self._by_choices(at, values, tasks)
            for k in range(n):
                near = [(k + shift) % n * nv + np.arange(nv) for shift in (-1, 0, 1)]
                columns = np.concatenate([*near, np.arange(n * nv, size)])
                jacobian = np.hstack([slopes[k], by_choice[k]])
                square[np.ix_(columns, columns)] += jacobian.T @ jacobian
                slope[columns] += jacobian.T @ values[k]
            square[-count:, -count:] += by_broken.T @ by_broken + np.diag((_CHOICES * np.ones(count)) ** 2)
            slope[-count:] += (
                by_broken.T @ tasks.broken + _CHOICES**2 * (at.x - self.guess) / self.space.slack
            )
            free = np.ones(size, dtype=bool)
            free[-count:] = ~(
                (at.x <= self.space.lower) & (slope[-count:] > 0.0)
                | (at.x >= self.space.upper) & (slope[-count:] < 0.0)
            )
            moved = None
            while damping < 1e6:
                factor = cho_factor((square + damping * np.eye(size))[np.ix_(free, free)], overwrite_a=True)
                change = np.zeros(size)
                change[free] = -cho_solve(factor, slope[free])
                change *= min(
                    1.0, 0.3 / np.abs(change[: n * nv]).max(), 1.0 / np.abs(change[-count:]).max(initial=1e-9)
                )
                trial = self._moved(at, change)
                try:
                    wanted = self.tasks(trial.x)
                except (RefusedGait, InputError):
                    damping *= 10.0
                    continue
                new, slopes_there = self.linearised(trial, wanted)
                if (moved := cost(trial, new, wanted)) < best:
                    break
                damping *= 10.0
            else:
                break
            costs.append(best)
            at, values, slopes, tasks, best = trial, new, slopes_there, wanted, moved
            damping = max(0.2 * damping, 1e-6)
            if len(costs) > 8 and best > (1.0 - _LEAST) ** 8 * costs[-8]:
                break
        return at, self.violations(values, tasks)

    def _by_choices(self, at: Motion, values: Array, tasks: Tasks) -> tuple[Array, Array]:
        """Slopes of the residuals, shape (N, R, choices), and of the plan's shortfalls, per slack."""
        by_choice = np.zeros((*values.shape, len(at.x)))
        by_broken = np.zeros((len(tasks.broken), len(at.x)))
        for j, (name, slack) in enumerate(zip(self.space.names, self.space.slack, strict=True)):
            for step in () if name in _OF_POSTURE else (0.01, -0.01):
                x = at.x.copy()
                x[j] += step * slack
                try:
                    wanted = self.tasks(x)
                except (RefusedGait, InputError):
                    continue
                by_choice[:, :, j] = (
                    self.linearised(Motion(at.q, at.offset, x), wanted, slopes=False)[0] - values
                ) / step
                by_broken[:, j] = (wanted.broken - tasks.broken) / step
                break
        return by_choice, by_broken

    def _moved(self, at: Motion, change: Array) -> Motion:
        """The motion after a change of all unknowns; choices stay within their ranges."""
        nv, count, space = self.robot.nv, len(at.x), self.space
        steps = change[: len(at.q) * nv].reshape(-1, nv)
        q = np.array([pin.integrate(self.model, a, b) for a, b in zip(at.q, steps, strict=True)])
        x = np.clip(at.x + change[-count:] * space.slack, space.lower, space.upper)
        return Motion(q, at.offset + float(change[-count - 1]), x)


def easy_motion(run: RunParameters, robot: Robot) -> Array:
    """Configurations of the body's easy gait at the nodes, shape (N, nq)."""
    easy = tune(run.replace(easy_gait(run, robot.description)), robot, advise=False).run
    gait = easy.gait.model_copy(update={"steps": 2})
    plan = plan_steps(gait, easy.body.mass, easy.foot, robot.description.sole)
    return rough_orbit(InverseKinematics(robot, easy), plan, easy, nodes=NODES).trajectory.q[:-1]


def judged(
    run: RunParameters, robot: Robot, clearance: float = CLEARANCE
) -> tuple[Problem, Motion, dict[str, float], int]:
    """The best motion of a few starts, what it violates [tolerances], and the number of its start."""
    problem, found = Problem(run, robot, clearance), []
    easy = easy_motion(run, robot)
    spread = problem.space.spread(problem.guess, 16)
    for number, x in enumerate([problem.guess, *spread]):
        try:
            tasks = problem.tasks(x)
        except (RefusedGait, InputError):
            continue
        q = easy.copy()
        for k, place in enumerate(q):
            place[:3] += tasks.com[k] - pin.centerOfMass(robot.model, problem.data, place)
        motion, violated = problem.solve(Motion(q, 0.0, x))
        found.append((max(violated.values()), number, motion, violated))
        if found[-1][0] <= 1.0 or len(found) == STARTS:
            break
    _, number, motion, violated = min(found, key=lambda item: item[:2])
    return problem, motion, violated, number


def walked(problem: Problem, motion: Motion, run: RunParameters) -> str:
    """How the walk of a motion ends, and which limits it breaks; of one with more room if there is one."""
    other, roomy, violated, _ = judged(run, problem.robot, _ROOM)
    found = Found(other, roomy) if max(violated.values()) <= 1.0 else Found(problem, motion)
    trial = val.walk(found.run(_WALKED), planner=found)
    if trial.verdict.name is not VerdictName.FAIL:
        return str(trial.verdict.name if trial.verdict.passed else trial.record.outcome.cause)
    return "; ".join(f"{item.label} {item.against}" for item in trial.verdict.failed)


def main() -> None:
    """Judge the refused gaits that are named, and replace their rows."""
    names = sys.argv[1:2] or REFUSED
    for name in names:
        draw = load_sweep(DATA.parent / "examples" / f"{REFUSED[name][0]}.toml")
        for number in map(int, sys.argv[2:] or REFUSED[name][1]):
            run = own_gait(draw.parameters(number))
            robot, begun = make_body(run).robot, time.process_time()
            try:
                problem, motion, violated, start = judged(run, robot)
            except RefusedGait as error:  # no choice at all has a plan
                row = name, number, "proved", error.args[0], "", "", f"{time.process_time() - begun:.0f}", ""
            else:
                what = max(violated, key=lambda item: violated[item])
                seconds, keeps = time.process_time() - begun, violated[what] <= 1.0
                said = walked(problem, motion, run) if keeps else ""
                value = f"{violated[what] * TOLERANCES[what]:.3g} {what}"
                row = (
                    name,
                    number,
                    "motion found" if keeps else "none found",
                    value,
                    f"{violated[what]:.2f}",
                    start,
                )
                row = *row, f"{seconds:.0f}", said
            write(tuple(map(str, row)))


def write(row: tuple[str, ...]) -> None:
    """Replace or add a row of the data."""
    rows = {line[:2]: line for line in (tuple(line.values()) for line in read_rows("referee"))}
    rows[row[:2]] = row
    ordered = sorted(rows.values(), key=lambda line: (line[0] != "human", int(line[1])))
    write_rows("referee", [COLUMNS, *ordered])


if __name__ == "__main__":
    main()
