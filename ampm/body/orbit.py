"""The periodic whole-body step: a fixed point of the inverse kinematics' mirrored one-step map.

Unknowns are the state at the start of the step and the constant of L_y, which AMPM leaves free; equations are
the mirrored return of the state and the mean pitch of the trunk.

The search runs on a coarse grid and ends on the fine one. It starts from a body that stands upright, and
where that fails from the periodic steps of easier plans: with a lower COM, or with less angular momentum.
"""

import math

import numpy as np

from ampm.body.feasibility import LESS, check_motion
from ampm.body.inverse_kinematics import InverseKinematics, Unreachable
from ampm.body.limits import AT_LEAST, AT_MOST, CLEARANCE, Limit, check
from ampm.body.motion import Extreme, MotionReport, PeriodicPosture, WholeBodyMotion
from ampm.body.return_map import Orbit, StepMap, leading_multipliers, newton, start_orbit
from ampm.body.robot import Robot
from ampm.body.step_reference import step_grid, step_reference
from ampm.exceptions import BodilyRefusal, InputError
from ampm.geometry import Array
from ampm.parameters import RunParameters
from ampm.planner.support import StepPlan

TOLERANCE = 1e-9
"""Largest component of the mirrored return's residual [rad, m, rad/s, m/s]."""
COARSE_STEP = 0.008
"""Largest step of the grid on which the orbit is searched [s]."""

_STABLE = 0.8  # largest product of a posture gain's rate and the grid's step that integrates well
_COARSE_TOLERANCE = 1e-7
_LOST = 0.06
"""Longest time of two steps across a slope in which a leg may not reach [s]: the controller gives way for so
long. Of nine walks the three with more fail, and two with less pass."""


def solve_motion(plan: StepPlan, run: RunParameters, robot: Robot) -> WholeBodyMotion:
    """Solve the periodic whole-body motion of a plan.

    Args:
        plan: centroidal motion and feet.
        run: posture gains, lean, the choice for L_z, the grid.
        robot: the body.

    Returns:
        One step whose mirrored end is its start.

    Raises:
        BodilyRefusal: no orbit, a knee too straight, or a joint beyond its limits.
        InputError: the grid is too coarse for the posture's gains.
    """
    ik, fine_step = InverseKinematics(robot, run), run.solver.ik_time_step
    longest = _STABLE / max(run.body.posture_damping, math.sqrt(run.body.posture_stiffness))
    if fine_step > longest:
        raise InputError(
            f"solver.ik_time_step = {fine_step:g} s is too long for the gains of the posture; take at most "
            f"{longest:.2g} s, or lower body.posture_damping and body.posture_stiffness."
        )

    def map_on(grid_step: float) -> StepMap:
        reference = step_reference(plan, step_grid(plan, grid_step))
        return StepMap(ik, reference, plan.contacts, run.body.lean)

    coarse, fine = map_on(max(fine_step, min(COARSE_STEP, longest))), map_on(fine_step)
    try:
        rough = start_orbit(coarse, _COARSE_TOLERANCE)
        orbit = newton(fine, rough.z, TOLERANCE, rough.inverse)
    except Unreachable as error:
        raise _refusal(error, plan.com_height) from error
    # The multipliers hardly depend on the grid.
    motion = _motion(plan, fine, orbit, leading_multipliers(coarse, rough))
    check_motion(motion.report, robot)
    return motion


def start_across(steps: StepPlan, posture: PeriodicPosture, run: RunParameters) -> tuple[Array, Array]:
    """State at the start of a walk across a slope, whose posture is that of level ground.

    One leg is longer than the other there, so no step is the mirror image of the one before: two are checked.
    Raises BodilyRefusal if a leg does not reach the start, or others for too long, or parts come too close.
    """
    robot, ik = posture.robot, InverseKinematics(posture.robot, run)
    times = np.arange(0.0, min(2.0 * steps.constants.step_duration, steps.duration), COARSE_STEP)
    reference, level = step_reference(steps, times), posture.sample(times)
    states, lost = [], []
    for k in range(len(times)):
        try:
            states.append(ik.project(reference, k, level.q[k], level.v[k]))
        except Unreachable as error:
            lost.append(error)
    across, less = f"gait.cross_slope = {run.gait.cross_slope:g}: ", "make gait.cross_slope smaller, or "
    if lost:
        what = f"{across}at {lost[0].time:.3f} s {lost[0].what}; the time without reach in two steps"
        longest, less_high = _LOST if lost[0].time else 0.0, f"{less}lower gait.com_height"
        reach = Limit(what, "s", longest, AT_MOST, "leg_too_short", less_high)
        check([(reach, COARSE_STEP * len(lost))])
    gaps = robot.gaps(np.stack([q for q, _ in states]))
    what = f"{across}{gaps.parts[k := int(gaps.distance.argmin())]} come too close: their distance"
    gap = Limit(what, "m", CLEARANCE, AT_LEAST, "self_collision", f"{less}raise gait.step_width")
    check([(gap, float(gaps.distance[k]))])
    return states[0]


def _refusal(cause: Unreachable, height: float) -> BodilyRefusal:
    """Error for a missing orbit of a plan with the COM at a height [m]."""
    why, way_out, drop = str(cause), LESS, cause.drop
    if drop > 0.0:
        why += f"; one was found only with the COM {1000.0 * drop:.3g} mm lower"
        way_out = f"lower gait.com_height, {height - drop:.3f} m is enough, or shorten gait.step_length"
    return BodilyRefusal(
        f"this body has no periodic motion for this plan: {why}",
        reason="no_periodic_motion",
        value=height,
        limit=height - drop,
        unit="m",
        way_out=way_out,
    )


def _motion(
    plan: StepPlan, step_map: StepMap, orbit: Orbit, multipliers: tuple[tuple[float, float], ...]
) -> WholeBodyMotion:
    """The motion of an orbit, with its report."""
    robot, step, time = step_map.ik.robot, orbit.trajectory, step_map.reference.time
    angles = step.q[:, 7:]
    margins = np.minimum(angles - robot.lower, robot.upper - angles)
    report = MotionReport(
        angular_momentum_y_offset=step_map.decode(orbit.z)[2],
        residual=step_map.size(step_map.residual(orbit.z, step)),
        mean_trunk_pitch=step_map.mean_pitch(step),
        multipliers=multipliers,
        knee_minimum=Extreme.of(robot.knee_flexion(step.q), time, ("left", "right")),
        joint_limit_margin=Extreme.of(margins, time, robot.joint_names),
        clearance=Extreme.of_gaps(robot.step_gaps(step.q[::2]), time[::2]),
    )
    contacts = plan.contacts
    return WholeBodyMotion(robot.joint_names, time, *step, contacts.step_length, contacts.step_rise, report)
