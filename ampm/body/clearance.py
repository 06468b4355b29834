"""Joint ranges, torques and distances of the parts of a body over a walk, before anything is simulated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ampm.body.constant_posture import ConstantPosture
from ampm.body.feasibility import CLEARANCE
from ampm.body.inverse_kinematics import InverseKinematics, Unreachable
from ampm.body.robot import Robot
from ampm.body.step_reference import step_reference
from ampm.exceptions import BodilyRefusal
from ampm.parameters import RunParameters
from ampm.planner.support import StepPlan

Array = NDArray[np.float64]

_INSTANTS = 7  # of every swing
_BEYOND = 0.05
"""How far an upright body may be beyond a joint's range [rad]: a pelvis that tilts makes up for as much."""


def check_clearance(plan: StepPlan, posture: ConstantPosture, run: RunParameters, robot: Robot) -> None:
    """Refuse footsteps at which a joint leaves its range, or parts of the body come too near to each other.

    The body is upright at seven instants of every swing. Instants that a leg does not reach are left out: a
    pelvis that tilts may reach them.

    Args:
        plan: of COM and feet.
        posture: gives heading and rest of the joints.
        run: gains of the inverse kinematics.
        robot: the body.

    Raises:
        BodilyRefusal: a joint of the standing leg has too little torque or is too far beyond its range, or
            parts come nearer than :data:`ampm.body.feasibility.CLEARANCE`.
    """
    swings = [phase for phase in plan.contacts.phases if phase.kind == "single_support"]
    times = np.concatenate(
        [swing.start + swing.duration * np.linspace(0.0, 1.0, _INSTANTS) for swing in swings]
    )
    ik, q = InverseKinematics(robot, run), posture.q.copy()
    reached, configurations = [], []
    reference = step_reference(plan, times).turned(posture.heading(times)[0])
    for index, place in enumerate(reference.position):
        q[:3] += place[0] - robot.jacobian(q).com
        try:
            found = ik.upright(reference, index, q)
        except Unreachable:
            continue
        q = found.copy()
        q[3:7] = 0.0, 0.0, 0.0, 1.0
        reached.append(index)
        configurations.append(found)
    if not configurations:
        return
    _check_torque(plan, times[reached], posture, configurations, robot)
    angles = np.array(configurations)[:, 7:]
    beyond = np.maximum(robot.lower - angles, angles - robot.upper)
    row, joint = divmod(int(beyond.argmax()), robot.nu)
    if beyond[row, joint] > _BEYOND:
        at = reached[row]
        raise BodilyRefusal(
            f"footstep {at // _INSTANTS + 3}: {robot.model.names[joint + 2]} would be "
            f"{beyond[row, joint]:.2g} rad beyond its range at {times[at]:.3f} s, more than {_BEYOND:g} rad",
            reason="joint_limits", value=float(beyond[row, joint]), limit=_BEYOND, unit="rad",
            way_out="shorten the steps about it, or put the feet nearer to each other",
        )  # fmt: skip
    gaps = robot.shapes.gaps(np.array(configurations))
    worst = int(gaps.distance.argmin())
    if not gaps.distance[worst] >= CLEARANCE:
        at = reached[worst]
        raise BodilyRefusal(
            f"footstep {at // _INSTANTS + 3}: {gaps.parts[worst]} come within "
            f"{1e3 * gaps.distance[worst]:.3g} mm at {times[at]:.3f} s, nearer than {1e3 * CLEARANCE:g} mm",
            reason="self_collision", value=float(gaps.distance[worst]), limit=CLEARANCE, unit="m",
            way_out="turn the toes out, by 0.1 rad for example, or put the feet further apart",
        )  # fmt: skip


def _check_torque(
    plan: StepPlan, times: Array, posture: ConstantPosture, configurations: Sequence[Array], robot: Robot
) -> None:
    """Refuse a planned force that the upright body, without velocity, has no torque for in the standing leg.

    A walk needs more: the trunk turns about.

    Raises:
        BodilyRefusal: the share of a torque limit is above 1.
    """
    sample, still = plan.sample(times), np.zeros(robot.nv)
    heading, floor = posture.heading(times)[0], np.broadcast_to(sample.floor, times.shape)
    worst = 0.0, "", 0.0
    for k, q in enumerate(configurations):
        terms, leg = robot.jacobian(q), int(sample.right_load[k] > 0.5)
        c, s = np.cos(heading[k]), np.sin(heading[k])
        turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        force = turn @ sample.force[k]
        arm = terms.com - terms.sole[leg] + turn @ (np.append(sample.zmp[k], floor[k]) - sample.com[k])
        load = np.concatenate([force, np.cross(arm, force)])
        rows = terms.jacobian[6 + 6 * leg : 12 + 6 * leg, 6:]
        torque = pin.rnea(robot.model, robot.data, q, still, still)[6:] - rows.T @ load
        share = np.abs(torque) / robot.torque_limit
        joint = int(share.argmax())
        worst = max(worst, (float(share[joint]), robot.joint_names[joint], float(times[k])))
    if worst[0] > 1.0:
        raise BodilyRefusal(
            f"{worst[1]} would need {worst[0]:.4g} of its torque at {worst[2]:.3f} s, standing upright",
            reason="torque", value=worst[0], limit=1.0, unit="1",
            way_out="shorten the steps about it, raise gait.a_s, or put the feet nearer to each other",
        )  # fmt: skip
