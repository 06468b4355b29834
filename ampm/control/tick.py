"""One control tick: :func:`prepare_qp`, the QP of the contact forces, :func:`take_forces`, :func:`keep_tick`.

With task rows B (momentum over the mass, soles, toes), accelerations a, contact forces f, their wrench map W:

    momentum      B_c a + drift_c = W f - g e_z        exact
    soles, toes   B_f a + drift_f ~ wanted             with a softness
    posture       a ~ wanted                           in the metric of the posture weights
    wrench        W f ~ command                        the QP's cost, under friction and unilateral contact

:func:`prepare_qp` eliminates ``a = map @ W f + bias`` and states the QP in f. :func:`take_forces` takes a
and, by inverse dynamics, the torques from f. Task-space inverse dynamics of this kind: Wensing & Orin, ICRA
2013; Del Prete & Mansard, T-RO 2016; reduced on the contact forces: Herzog et al., Autonomous Robots 2016.
"""

import numpy as np

from ampm.body.rigid_body import com_of, joint_torques, passive_torques, place_body, place_of, task_drift
from ampm.compiled import compiled
from ampm.control.contact_gate import land, update_contacts
from ampm.control.contact_qp import eliminate_tasks, fill_qp
from ampm.control.floor import follow_floor
from ampm.control.forces import point_forces, share_forces, wrench_map
from ampm.control.hold import update_rate
from ampm.control.limited_qp import limit_broken
from ampm.control.sole import share_sole
from ampm.control.stabilizer import command_wrench, rotation_error
from ampm.control.tasks import posture_task, sole_task, toe_task
from ampm.control.trunk import RIGHTING, fed_back_tilt
from ampm.control.workspace import Stepper, Workspace
from ampm.linear import add_combination
from ampm.stepping.walker import update_reference
from ampm.vectors import minus, multiply, plus, put, times, vector


@compiled
def prepare_qp(work: Workspace, stepper: Stepper | None, first: bool) -> bool:
    """Set up the QP of the contact forces from what is sensed and wanted.

    Args:
        work: all that the tick reads and writes.
        stepper: of a walk that may leave its plan; None for one that may not, and is not compiled then.
        first: whether this is the first tick of a run.

    Returns:
        Whether there is a QP: the task rows are independent, and all numbers finite.
    """
    update_kinematics(work)
    if stepper is not None:
        update_reference(work, stepper)
    else:
        follow_floor(work)
    update_contacts(work, first)
    update_command(work, stepper)
    update_tasks(work)
    scale_tasks(work)
    if not eliminate_tasks(work.tasks):
        return False
    set_up_qp(work)
    return True


@compiled
def take_forces(work: Workspace) -> bool:
    """Take accelerations and torques from the contact forces ``work.contact.solution``.

    Returns:
        Whether the torques and joint rates are within their limits.
    """
    update_accelerations(work)
    update_torques(work)
    return not limit_broken(work.sensed.q, work.sensed.v, work.motion.acceleration, work.joints)


@compiled
def update_kinematics(work: Workspace) -> None:
    """Write places, task Jacobian B' and rates B v, drift and COM of the measured state.

    A velocity that is older than the configuration is brought to its instant: ``v + lag a``, with the
    acceleration commanded at the last tick.
    """
    body, motion, tasks, sensed = work.body, work.motion, work.tasks, work.sensed
    v, acceleration, lag = motion.v, motion.last_acceleration, sensed.velocity_lag[0]
    for j in range(len(v)):
        v[j] = sensed.v[j] + lag * acceleration[j]
    link = body.rigid.link
    place_body(body.rigid, sensed.q)
    task_drift(body.rigid, sensed.v, v, tasks.drift)
    tasks.rates[:] = 0.0
    add_combination(1.0, body.rigid.columns, v, tasks.rates)
    from_root = com_of(link)
    put(body.com, plus(vector(sensed.q), from_root))
    for i in range(len(body.feet)):
        foot = body.feet[i]
        put(foot.place, minus(place_of(link, foot), from_root))
        multiply(link[foot.joint].turn, foot.turn, foot.rotation)
    for i in range(len(body.points)):
        put(body.points[i].arm, minus(place_of(link, body.points[i]), from_root))


@compiled
def update_command(work: Workspace, stepper: Stepper | None) -> None:
    """Write the net wrench of the ground: the plan's, plus feedback of COM, momentum and trunk."""
    body, state, force = work.body, work.stepping[0], work.command.force
    trunk, rotation = body.rigid.trunk[0], np.empty((3, 3))
    multiply(body.rigid.link[trunk.joint].turn, trunk.turn, rotation)
    error = rotation_error(work.wanted.trunk, rotation)
    tilt = fed_back_tilt(work, error)
    if state.off_plan:
        tilt = times(RIGHTING, tilt)
    command_wrench(work, tilt)
    if stepper is not None:
        put(force, times(state.force_factor, vector(force)))
        share_sole(work, stepper.plan_slope, error)


@compiled
def update_tasks(work: Workspace) -> None:
    """Write the accelerations wanted of soles, toes and posture; the momentum's row gets gravity alone.

    The QP adds the contact forces to the momentum's row.
    """
    body, tasks, wanted, sensed = work.body, work.tasks, work.wanted, work.sensed
    tasks.softness[:] = 0.0
    tasks.wanted[:6] = 0.0
    tasks.wanted[2] = -body.gravity
    for i in range(len(body.feet)):
        sole_task(work, i)
        toe_task(work, i)
    posture_task(work)
    # A constant posture plans no rates of the hinges.
    direction = wanted.v if wanted.v[6:].any() else work.motion.v
    passive_torques(body.passive, sensed.q, sensed.v, direction, work.motion.passive_torque)


@compiled
def scale_tasks(work: Workspace) -> None:
    """Scale to the QP's units: accelerations in g, and ``x = W_p^1/2 a / g`` by the posture weights W_p."""
    motion, tasks, gravity = work.motion, work.tasks, work.body.gravity
    tasks.posture[:] = motion.posture * (motion.sqrt_weight / gravity)
    jacobian, columns = tasks.jacobian, work.body.rigid.columns
    by_row, by_column = 1.0 / motion.sqrt_weight, tasks.scale
    for j in range(len(by_row)):
        for e in range(len(by_column)):
            jacobian[j, e] = columns[j, e] * (by_column[e] * by_row[j])
    tasks.rhs[:] = tasks.scale / gravity * (tasks.wanted - tasks.drift)


@compiled
def set_up_qp(work: Workspace) -> None:
    """Fill in the QP: wanted wrench, friction, shares and force limits of the points."""
    body, contact, tasks, wrench = work.body, work.contact, work.tasks, work.command
    weight = body.mass * body.gravity
    share_forces(body.points, contact.forces, work.stepping[0].off_plan)
    wrench_map(body.points, contact.wrench_map)
    contact.wrench[:3] = tasks.scale[:3] * wrench.force / weight
    contact.wrench[3:] = tasks.scale[3:6] * wrench.moment / weight
    land(work)
    fill_qp(work)


@compiled
def update_accelerations(work: Workspace) -> None:
    """Write ``a = g W_p^-1/2 (posture + B' y (W f, 1))``, y the last seven columns of the system."""
    motion, tasks, contact = work.motion, work.tasks, work.contact
    rows = len(tasks.system)
    net_wrench = np.zeros(6)
    add_combination(1.0, contact.wrench_map.T, contact.solution, net_wrench)
    pull = tasks.system[:, rows + 6].copy()
    add_combination(1.0, tasks.system[:, rows : rows + 6].T, net_wrench, pull)
    scaled = tasks.posture.copy()
    add_combination(1.0, tasks.jacobian.T, pull, scaled)
    motion.acceleration[:] = work.body.gravity * scaled / motion.sqrt_weight


@compiled
def update_torques(work: Workspace) -> None:
    """Write the torques of the accelerations under the contact forces, and what passive joints take."""
    body, motion, force, torque = work.body, work.motion, work.contact.point_force, work.joints.torque
    point_forces(body.points, work.contact.solution, body.mass * body.gravity, force)
    joint_torques(body.rigid, body.points, body.gravity, work.sensed.v, motion.acceleration, force, torque)
    torque += motion.passive_torque


@compiled
def keep_tick(work: Workspace, first: bool) -> None:
    """Clip the torques to the motors' limits, give them their rates, and keep what the next tick needs."""
    joints, contact = work.joints, work.contact
    joints.torque[:] = np.minimum(np.maximum(joints.torque, -joints.torque_limit), joints.torque_limit)
    update_rate(work, first)
    joints.last_torque[:] = joints.torque
    if not first:
        contact.change[:] = contact.solution - contact.forces
    contact.forces[:] = contact.solution
    contact.last[:] = contact.lines
    work.motion.last_acceleration[:] = work.motion.acceleration
