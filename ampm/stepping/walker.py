"""One tick of a walk that may step elsewhere, earlier or later than planned."""

import math
from typing import Any

from ampm.compiled import compiled
from ampm.control.floor import tilt_sole
from ampm.control.sole import turned_axes
from ampm.control.workspace import Stepper, SteppingState, Workspace
from ampm.geometry import Array
from ampm.stepping.phases import carried_shift, landing_shift
from ampm.stepping.sensed_floor import (
    feel_slope,
    floor_under,
    is_early,
    is_late,
    sense_touch,
    stands_flat,
    step_up,
)
from ampm.stepping.step_choice import (
    choose_step,
    dcm_ahead,
    expected_dcm,
    heading_of,
    phase_interval,
    quintic_tick,
    ramp_share,
)
from ampm.vectors import along_across, clip, minus, plus, times, vector

DISTURBED = 0.006
"""The sole is shared where the DCM is farther than this from its plan, twice as far as undisturbed [m]."""
OFF_PLACE, OFF_HEIGHT, OFF_TILT = 0.015, 0.0015, 0.008
"""The walk leaves its plan where a standing foot is farther than this from it [m, m, rad]."""
FREEZE = 0.05
"""The next step does not change during this time before landing [s]."""
LONGEST_WAIT = 0.15
"""Longest time that the clock waits [s]."""
DROP = 0.3
"""Speed at which a late foot goes down [m/s]."""
RATE_TIME = 0.03
"""Time constant of the clock's rate [s]."""
HASTE_FROM, HASTE = 0.1, 0.1
"""A double support is shortened where the DCM is ahead by the first, and halved by the second more [m]."""
CLOSE = 0.005
"""The COM's position is fed back up to this error; beyond it, only the DCM is [m]."""
HEIGHT_RATE = 6.0
"""Rate of the double pole with which the COM follows the floor's height [1/s]."""
LIFT = 0.5
"""Integral gain of the COM's height, times omega^3 [1]."""
DEAD_BAND, SATURATION = 0.0015, 0.01
"""Error of the COM's height from which on it is fed back, and that counts at most [m]."""
SAG = 0.15
"""The COM goes down by this share of a step's extra length, because a straight leg is late [1]."""


@compiled
def update_reference(work: Workspace, stepper: Stepper) -> None:
    """Decide on the plan whether to leave it; off the plan, replace the plan's reference of this tick."""
    state: SteppingState = work.stepping[0]
    wanted = work.wanted
    sense_touch(work, stepper)
    error = minus(vector(work.body.com), vector(wanted.com))
    state.com_error = max(abs(error[0]), abs(error[1]), abs(error[2]))
    rate_error = minus(vector(work.tasks.rates), vector(wanted.com_velocity))
    dcm_error = plus(error, times(1.0 / stepper.omega, rate_error))
    state.active = state.off_plan or math.hypot(dcm_error[0], dcm_error[1]) > DISTURBED * stepper.size
    if state.off_plan:
        replace_reference(work, stepper)
    else:
        state.heading[:] = wanted.foot_rotation[state.stance, :2, 0]
        state.leaving = is_late(state) or is_early(state) or stands_elsewhere(work, stepper)
        if not state.leaving and state.single and state.duration - state.clock >= FREEZE:
            choose_step(work, stepper)
            state.leaving = bool(state.step.any())
    hold_height(work, stepper)


@compiled
def stands_elsewhere(work: Workspace, stepper: Stepper) -> bool:
    """Whether the foot that stands alone lies flat on a place, height or slope that is not the plan's."""
    state: SteppingState = work.stepping[0]
    if not stands_flat(work):
        return False
    planned = work.wanted.foot_position[state.stance]
    com, place = work.body.com, work.body.feet[state.stance].place
    height, slope_x, slope_y = floor_under(work, stepper.plan_slope, state.stance)
    x, y = com[0] + place[0] - planned[0], com[1] + place[1] - planned[1]
    off = math.hypot(x, y) > OFF_PLACE * stepper.size or abs(height - planned[2]) > OFF_HEIGHT
    return off or math.hypot(slope_x, slope_y) > OFF_TILT


@compiled
def hold_height(work: Workspace, stepper: Stepper) -> None:
    """Integrate how far the COM is under its reference into the commanded force's factor."""
    state: SteppingState = work.stepping[0]
    error = clip(work.wanted.com[2] - work.body.com[2], -SATURATION, SATURATION)
    if state.force_factor != 1.0 or abs(error) > DEAD_BAND:
        change = LIFT * stepper.omega**3 / work.body.gravity * error * stepper.tick
        state.force_factor = clip(state.force_factor + change, 0.9, 1.1)


@compiled
def pass_time(states: Any, tick: float) -> bool:
    """Let the clock run for a tick; whether the phase has ended."""
    state: SteppingState = states[0]
    state.delay += tick
    if is_early(state):
        state.delay -= state.duration - state.clock
        state.clock = state.duration
    if is_late(state) and state.waited < LONGEST_WAIT:
        state.waited += tick
        return False
    state.waited = 0.0
    state.clock_rate += (1.0 / state.stretch - state.clock_rate) * min(tick / RATE_TIME, 1.0)
    state.clock += state.clock_rate * tick
    state.delay -= state.clock_rate * tick
    return bool(state.clock >= state.duration)


@compiled
def read_table(work: Workspace, stepper: Stepper) -> None:
    """Read the planned reference from the phase's table, by the clock; it is still while the clock waits."""
    state: SteppingState = work.stepping[0]
    wanted, table, intervals = work.wanted, stepper.table, len(stepper.curves.r) - 1
    i, part = phase_interval(state, stepper)
    before, after = table.smooth[i], table.smooth[i + 1]
    for k in range(len(wanted.smooth)):
        wanted.smooth[k] = (1.0 - part) * before[k] + part * after[k]
    rate = 0.0 if state.waited > 0.0 else state.clock_rate
    wanted.v[:] *= rate
    wanted.acceleration[:] *= rate * rate
    wanted.foot_velocity[:] *= rate
    wanted.foot_acceleration[:] *= rate * rate
    wanted.foot_angular_velocity[:] *= rate
    wanted.foot_angular_acceleration[:] *= rate * rate
    wanted.foot_toe[:, 1] *= rate
    wanted.foot_toe[:, 2] *= rate * rate
    wanted.jumps[0] = False
    wanted.planned[:], wanted.due[:] = table.planned[i], table.due[i]
    for foot in range(2):
        for line in range(3):
            left = table.until_lift[i, foot, line]
            if left < math.inf:
                left = max(left - part * (state.duration / intervals), 0.0) / max(state.clock_rate, 0.1)
            wanted.until_lift[foot, line] = left


@compiled
def replace_reference(work: Workspace, stepper: Stepper) -> None:
    """Replace the plan's reference of one tick, off the plan."""
    state: SteppingState = work.stepping[0]
    wanted = work.wanted
    read_table(work, stepper)
    wanted.tilt_window[0] = 0.0
    if stands_flat(work):
        feel_slope(work, stepper)
    (slope_x, slope_y), level = state.slope, state.level_slope
    slope = slope_x - clip(slope_x, -level, level), slope_y - clip(slope_y, -level, level)
    state.heading[0], state.heading[1] = heading_of(wanted.foot_rotation[state.stance])
    dcm = _single_support(work, stepper, slope) if state.single else _double_support(work, stepper)
    _replace_com(work, stepper, slope, dcm)
    _replace_feet(state, slope, wanted)


@compiled
def _single_support(work: Workspace, stepper: Stepper, slope: tuple[float, float]) -> Array:
    """Choose the next step and move the swing foot towards it.

    Returns the DCM's reference, in world, shape (2,) [m].
    """
    state: SteppingState = work.stepping[0]
    shift, rest = state.shift[state.stance], state.duration - state.clock
    landing = stepper.table.foot_position[-1]
    reach = landing[1 - state.stance] - landing[state.stance]
    if rest * state.stretch > FREEZE:
        state.length, across = along_across(reach[0], reach[1], state.heading[0], state.heading[1])
        state.width = abs(across)
        choose_step(work, stepper)
    duration = max(rest * state.stretch, 1e-4)
    to_x, to_y = reach[0] + state.step[0], reach[1] + state.step[1]
    x, y, z = landing_shift(state, stepper.plan_slope)
    target = x, y, z + slope[0] * to_x + slope[1] * to_y
    quintic_tick(state.swing, target, duration, stepper.tick)
    state.sag = SAG * max(math.hypot(to_x, to_y) - math.hypot(reach[0], reach[1]), 0.0)
    tau, ramp = stepper.omega * duration, ramp_share(stepper.omega * state.double_duration)
    return dcm_ahead(state, stepper, tau) + (shift[:2] + state.step * ramp * math.exp(-tau))


@compiled
def _double_support(work: Workspace, stepper: Stepper) -> Array:
    """Measure the shift of the landed foot, and adapt the duration.

    Returns the DCM's reference, in world, shape (2,) [m].
    """
    state: SteppingState = work.stepping[0]
    body, wanted, landed = work.body, work.wanted, 1 - state.stance
    new = state.shift[landed]
    if state.touch_ticks[landed] > 0 and state.waited == 0.0:
        new[:2] = body.com[:2] + body.feet[landed].place[:2] - wanted.foot_position[landed, :2]
        floor = stepper.table.foot_position[-1, landed, 2]
        new[2] = step_up(work, stepper.plan_slope, landed, floor)
    tau = stepper.omega * max((state.duration - state.clock) * state.stretch, 1e-4)
    here, dcm = carried_shift(state), dcm_ahead(state, stepper, tau)
    for axis in range(2):
        dcm[axis] += here[axis] + (new[axis] - here[axis]) * (1.0 - ramp_share(tau))
    ahead = turned_axes(expected_dcm(work, stepper.omega) - dcm, state.heading[0], state.heading[1])[0]
    state.stretch = 1.0 / (1.0 + clip((ahead / stepper.size - HASTE_FROM) / HASTE, 0.0, 1.0))
    return dcm


@compiled
def _replace_com(work: Workspace, stepper: Stepper, slope: tuple[float, float], dcm: Array) -> None:
    """Replace the COM's reference: horizontally by the DCM, vertically over the floor."""
    state: SteppingState = work.stepping[0]
    wanted, curves, com, omega = work.wanted, stepper.curves, work.body.com, stepper.omega
    i, part = phase_interval(state, stepper)
    shift = carried_shift(state)
    for axis in range(2):
        r = (1.0 - part) * curves.r[i, axis] + part * curves.r[i + 1, axis] + shift[axis]
        error = com[axis] - wanted.com[axis] - shift[axis]
        wanted.com[axis] += shift[axis] + error - clip(error, -CLOSE * stepper.size, CLOSE * stepper.size)
        wanted.com_velocity[axis] = omega * (dcm[axis] - wanted.com[axis])
        wanted.com_acceleration[axis] = omega * omega * (wanted.com[axis] - r)
        wanted.moment[axis] *= state.clock_rate
    state.floor_rise = shift[2]
    goal = state.floor_rise - state.sag
    if state.single:
        for axis in range(2):
            goal += slope[axis] * (com[axis] - wanted.foot_position[state.stance, axis] - shift[axis])
    climb = slope[0] * work.tasks.rates[0] + slope[1] * work.tasks.rates[1]
    rise = HEIGHT_RATE**2 * (goal - state.height[0]) + 2.0 * HEIGHT_RATE * (climb - state.height[1])
    state.height[0] += stepper.tick * (state.height[1] + 0.5 * stepper.tick * rise)
    state.height[1] += stepper.tick * rise
    wanted.com[2] += state.height[0]
    wanted.com_velocity[2] += state.height[1]
    wanted.com_acceleration[2] += rise


@compiled
def _replace_feet(state: SteppingState, slope: tuple[float, float], wanted: Any) -> None:
    """Replace the reference of both feet: their shifts, the floor's tilt."""
    swing = 1 - state.stance
    for foot in range(2):
        if state.single and foot == swing:
            wanted.foot_position[foot] += state.swing[0]
            wanted.foot_velocity[foot] += state.swing[1]
            wanted.foot_acceleration[foot] += state.swing[2]
        else:
            wanted.foot_position[foot] += state.shift[foot]
        tilt_sole(wanted.foot_rotation[foot], slope[0], slope[1])
    if state.waited > 0.0:
        wanted.planned[swing, :], wanted.due[swing, :] = False, True
        wanted.foot_position[swing, 2] -= DROP * state.waited
        wanted.foot_velocity[swing, 2] = -DROP
