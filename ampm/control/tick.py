"""One control tick as compiled functions: :func:`observe` and :func:`prepare` before the QP, :func:`respond`
after it.

:class:`ampm.control.controller.TrackingController` owns the arrays, ``own``, and calls them.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ampm.body.rigid_body import (
    joint_torques,
    passive_torques,
    place_body,
    place_of,
    task_drift,
)
from ampm.compiled import compiled
from ampm.control.contact_gate import land, update_gate
from ampm.control.forces import point_forces, share_forces, wrench_map
from ampm.control.hold import update_rate
from ampm.control.limited_qp import limit_broken
from ampm.control.records import CHANGE, PHI
from ampm.control.sole import share_sole
from ampm.control.stabilizer import command_wrench, rotation_error
from ampm.control.tasks import HURRIED, SWING, foot_task, posture_task, toe_task
from ampm.control.trunk import fed_back_tilt
from ampm.control.wrench_qp import L_Z, eliminate, fill_qp
from ampm.vectors import minus, multiply, plus, put, times, vector

Array = NDArray[np.float64]

V, NOW, LAST, STILL, POSTURE, ALPHA, PASSIVE = range(7)
"""Rows of ``motion``, shape (7, nv): measured velocity, the same at the instant of q, the last tick's
acceleration [m/s^2], zeros, wanted acceleration in the metric of the posture [g], this tick's [m/s^2], torque
that overcomes the passive ones [N m]."""

SCALE, RATES, DRIFT, WANTED, SOFTNESS, RHS = range(6)
"""Rows of ``tasks``, shape (6, R): scale in the QP, rate, drift, wanted acceleration, softness, right-hand
side of the elimination."""

LIMIT, LOW, HIGH, TORQUE, RATE = range(5)
"""Rows of ``hinges``, shape (5, nu): torque limit [N m], range [rad], last torque [N m], its rate [N m/s]."""


@compiled
def observe(own: Any, lag: float) -> None:
    """The body of this tick: places, task Jacobian and rates, of a velocity that is so old [s]."""
    tree, link, feet, points, q, motion = own.tree, own.link, own.feet, own.points, own.q, own.motion
    tasks, columns, com = own.tasks, own.columns, own.com
    v, now, last, still = motion[V], motion[NOW], motion[LAST], motion[STILL]
    rates, drift = tasks[RATES], tasks[DRIFT]
    for j in range(len(v)):
        now[j] = v[j] + lag * last[j]
    place_body(tree, link, feet, q, columns)
    task_drift(tree, link, feet, v, now, still, drift)
    rates[:] = 0.0
    for j in range(len(v)):
        for e in range(len(rates)):
            rates[e] += columns[j, e] * now[j]
    from_root = times(1.0 / link[0].mass, vector(link[0].first))
    put(com, plus((q[0], q[1], q[2]), from_root))
    for i in range(len(feet)):
        put(feet[i].place, minus(place_of(link, feet[i]), from_root))
        multiply(link[feet[i].joint].turn, feet[i].turn, feet[i].pose)
    for i in range(len(points)):
        put(points[i].arm, minus(place_of(link, points[i]), from_root))


@compiled
def prepare(own: Any, age: float, first: bool, right_load: float, tilt_window: float) -> bool:
    """One tick from the body to the QP, which it fills in; false if that has no solution or no finite one."""
    link, feet, points, lines, gains = own.link, own.feet, own.points, own.lines, own.gains
    gravity, root_weight, q, motion, tasks = own.gravity, own.root_weight, own.q, own.motion, own.tasks
    columns, share, scaled, system, phi = own.columns, own.share, own.scaled, own.system, own.phi
    wrench, command, posture_trunk = own.wrench, own.command, own.posture_trunk
    v, now, posture = motion[V], motion[NOW], motion[POSTURE]
    rates, drift, wanted, softness = tasks[RATES], tasks[DRIFT], tasks[WANTED], tasks[SOFTNESS]
    for i in range(len(points)):
        points[i].sensed, points[i].touching = own.sensed[i], own.touching[i]
    passive_torques(own.passive, q, v, own.posture_v, motion[PASSIVE, 6:])
    mass, com = link[0].mass, vector(own.com)

    # What is wanted.
    pose = np.empty((3, 3))
    multiply(link[own.trunk[0].joint].turn, own.trunk[0].turn, pose)
    tilt = rotation_error(posture_trunk, pose)
    tilt = fed_back_tilt(gains, tilt, posture_trunk, tilt_window, own.past, own.memory)
    command_wrench(gains, mass, gravity, own.centre, tilt, com, rates, command)
    gain = gains[0]
    rate = 1.0 / (gain.frequency * gain.contact_ramp)
    steps = share[0] != 0.0 or share[1] != 0.0
    strict = steps and share[5] == 0.0
    contacts = own.planned, own.due, own.until_lift
    landing = update_gate(*contacts, rate, gain.contact_ramp, first, strict, points, lines)
    if steps:
        share_sole(gravity, share, own.centre, own.com, points, command, mass)
    put(wanted[0:3], (0.0, 0.0, -gravity))  # the momentum rate without contact forces; the QP adds them
    wanted[3:6] = 0.0
    softness[:] = 0.0
    per_foot = len(points) // len(feet)
    for i in range(len(feet)):
        foot, held, rows = feet[i], points[per_foot * i : per_foot * (i + 1)], slice(6 + 6 * i, 12 + 6 * i)
        task = own.feet_values[i], rates[rows], wanted[rows]
        soft = foot_task(gains, foot, lines[i], held, com, *task)
        softness[rows] = HURRIED if soft == SWING and share[5] > 0.0 else soft
        if foot.toe_row >= 0:
            state = q[foot.toe + 1], rates[foot.toe_row]
            wanted[foot.toe_row] = toe_task(gains, own.feet_values[i], *state)
    posture_task(gains, q, now, own.posture_q, own.posture_v, own.posture_a, posture)

    # In units of the QP.
    for j in range(len(v)):
        posture[j] *= root_weight[j] / gravity
        per_weight = 1.0 / root_weight[j]
        for e in range(len(drift)):
            scaled[j, e] = columns[j, e] * (tasks[SCALE, e] * per_weight)
    for e in range(len(drift)):
        tasks[RHS, e] = tasks[SCALE, e] / gravity * (wanted[e] - drift[e])
    if not eliminate(scaled, softness, tasks[RHS], posture, system):
        return False
    share_forces(len(feet), points, phi[PHI], share[5] > 0.0)
    wrench_map(len(feet), points, wrench)
    weight, momentum = mass * gravity, np.empty(6)
    for e in range(6):
        momentum[e] = tasks[SCALE, e] * command[e] / weight
    if landing:
        since = 1.0 - age * gain.frequency if own.extrapolates else 0.0
        land(gain, len(feet), points, weight, phi, since, wrench, momentum)
    yaw = system[L_Z, len(drift) + L_Z], system[L_Z, len(drift) + 6]
    qp = own.P, own.gradient, own.A, own.lower, own.upper
    fill_qp(len(feet), points, wrench, momentum, right_load, *yaw, gain.friction, *qp)
    return True


@compiled
def respond(own: Any, still: bool, first: bool, torque: Array, point_force: Array) -> bool:
    """Accelerations and torques of the forces found; false, with nothing kept, if they break a limit."""
    gravity, root_weight, motion, hinges = own.gravity, own.root_weight, own.motion, own.hinges
    scaled, system, wrench, forces = own.scaled, own.system, own.wrench, own.forces
    rows, posture, alpha = len(system), motion[POSTURE], motion[ALPHA]
    total = np.empty(rows)  # per task, what the net wrench and the tasks themselves add
    net = np.empty(6)
    for e in range(6):
        net[e] = 0.0
        for k in range(len(forces)):
            net[e] += wrench[e, k] * forces[k]
    for e in range(rows):
        total[e] = system[e, rows + 6]
        for k in range(6):
            total[e] += system[e, rows + k] * net[k]
    for j in range(len(alpha)):
        pull = posture[j]
        for e in range(rows):
            pull += scaled[j, e] * total[e]
        alpha[j] = gravity * pull / root_weight[j]
    torques(own, forces, torque, point_force)
    limits = hinges[LIMIT], hinges[LOW], hinges[HIGH]
    if limit_broken(own.q, motion[V], alpha, torque, *limits):
        return False
    keep(own, forces, still, first, torque)
    return True


@compiled
def torques(own: Any, forces: Array, torque: Array, point_force: Array) -> None:
    """Joint torques of accelerations and force unknowns [m g], and the forces at the points [N]."""
    link, points, motion, gravity = own.link, own.points, own.motion, own.gravity
    point_forces(len(own.feet), points, forces, link[0].mass * gravity, point_force)
    moved = motion[V], motion[ALPHA], gravity
    joint_torques(own.tree, own.armature, link, *moved, points, point_force, torque)
    for j in range(len(torque)):
        torque[j] += motion[PASSIVE, 6 + j]


@compiled
def keep(own: Any, forces: Array, still: bool, first: bool, torque: Array) -> None:
    """Clip the torques to the motors' limits, give them their rates, and keep what the next tick needs."""
    hinges, phi, motion = own.hinges, own.phi, own.motion
    for j in range(len(torque)):
        torque[j] = min(max(torque[j], -hinges[LIMIT, j]), hinges[LIMIT, j])
    last = hinges[TORQUE]
    update_rate(torque, last, hinges[LIMIT], own.gains[0].frequency, own.lines, still or first, hinges[RATE])
    last[:] = torque
    for k in range(len(forces)):
        if not first:
            phi[CHANGE, k] = forces[k] - phi[PHI, k]
        phi[PHI, k] = forces[k]
    motion[LAST] = motion[ALPHA]
