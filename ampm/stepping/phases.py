"""Phases of a plan at a clock of their own, and how the plan moves with the feet that stand.

Every foot has a shift from its planned place. In single support the standing foot's shift moves everything,
in double support from one to the other; the swing foot's path moves to where the next step must be.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampm.compiled import compiled
from ampm.control.workspace import SteppingState
from ampm.geometry import Array, Flags
from ampm.planner.contacts import Contacts
from ampm.vectors import Vector, clip, minus, plus, put, times, vector

CYCLE = 4
"""Phases after which a periodic walk repeats."""
STILL = 0.05
"""Speed up to which a COM is at rest [m/s]."""


class Phases(NamedTuple):
    """The P phases of a plan. After the end of one that walks on, its last two steps are repeated."""

    start: Array  # shape (P,) [s]
    # as in :class:`~ampm.control.workspace.SteppingState`, shape (P,)
    single: Flags
    stance: NDArray[np.int8]
    duration: Array
    walks_on: bool  # whether the COM still moves at the plan's end
    stride: Array  # from one repetition to the next, shape (3,) [m]
    slope: Array  # of the plan's floor: dz/dx, dz/dy, shape (2,) [1]

    @classmethod
    def of(cls, contacts: Contacts, com_velocity: Array) -> "Phases":
        """Phases of contacts; the velocity is that of the COM at their end [m/s]."""
        duration, single, stance = np.diff(contacts.switches), contacts.kind_codes == 0, contacts.stance_codes
        stance = np.where(single, stance, 1 - np.append(stance[1:], 1 - stance[-2]))  # feet come in turn
        slope = np.array(contacts.slope)
        walks_on = bool(np.abs(com_velocity).max() > STILL) and len(duration) > CYCLE
        stride = contacts.placements[-1, 0] - contacts.placements[-1 - CYCLE * walks_on, 0]
        stride[2] += stride[:2] @ slope
        return cls(contacts.starts, single, stance, duration, walks_on, stride, slope)


@compiled
def repeated(phases: Phases, number: int) -> tuple[int, int]:
    """Phase of the plan that a phase repeats, and how many strides away."""
    strides = max(number - len(phases.start), -1) // CYCLE + 1
    return number - CYCLE * strides, strides


@compiled
def begin_phase(state: SteppingState, phases: Phases, number: int) -> None:
    """Begin a phase: until it is measured, the foot that swung is where it was sent."""
    if state.single:
        put(state.shift[1 - state.stance], vector(state.swing[0]))
    k, _ = repeated(phases, number)
    state.phase, state.single, state.stance = number, phases.single[k], phases.stance[k]
    state.duration, state.double_duration = phases.duration[k], phases.duration[k + 1 if state.single else k]
    state.clock = state.elapsed = state.waited = 0.0
    state.step[:], state.stretch, state.choice = 0.0, 1.0, -1
    state.swing[:] = 0.0
    put(state.swing[0], vector(state.shift[1 - state.stance]))


@compiled
def landing_shift(state: SteppingState, plan_slope: Array) -> Vector:
    """Shift with which the swing foot is to land on the plan's floor: the standing foot's plus the step."""
    (x, y, z), step = vector(state.shift[state.stance]), state.step
    return x + step[0], y + step[1], z + (plan_slope[0] * step[0] + plan_slope[1] * step[1])


@compiled
def carried_shift(state: SteppingState) -> Vector:
    """Shift of what the feet carry: the standing foot's, in double support on its way to the other's [m]."""
    old = vector(state.shift[state.stance])
    if state.single:
        return old
    moved = clip(state.clock / state.duration, 0.0, 1.0)
    return plus(old, times(moved, minus(vector(state.shift[1 - state.stance]), old)))


@compiled
def go_on(state: SteppingState, phases: Phases, time: float) -> None:
    """Let a state go on to a time [s] as if nothing disturbed it, each foot landing where it is sent."""
    left, begun, rest = time - state.time, state.clock, (state.duration - state.clock) / state.clock_rate
    while left > rest and (phases.walks_on or state.phase + 1 < len(phases.start)):
        put(state.swing[0], landing_shift(state, phases.slope))
        begin_phase(state, phases, state.phase + 1)
        left, begun, rest, state.clock_rate = left - rest, 0.0, state.duration, 1.0
    state.clock = min(state.clock + state.clock_rate * left, state.duration)
    swung, shift = (state.clock - begun) / max(state.duration - begun, 1e-9), vector(state.swing[0])
    put(state.swing[0], plus(shift, times(swung, minus(landing_shift(state, phases.slope), shift))))


@compiled
def forecast(states: Any, phases: Phases, instants: Array) -> tuple[Array, Array, Array, Array]:
    """Let states, shape (N,), go on to instants (N,) [s], and return how the plan is moved then.

    Nothing follows the COM: the reference that the controller tracks (:mod:`ampm.stepping.walker`) lets the
    COM's error fade, and has another acceleration.

    Returns:
        Instants of the plan (N,) [s], shifts of the feet (N, 2, 3) [m], and shift and rate of the COM (N, 3)
        [m, m/s]: horizontally, the ZMP moves with it.
    """
    n = len(states)
    time, feet, com, rate = np.empty(n), np.empty((n, 2, 3)), np.empty((n, 3)), np.zeros((n, 3))
    for i in range(n):
        state = states[i]
        go_on(state, phases, instants[i])
        k, strides = repeated(phases, state.phase)
        time[i] = phases.start[k] + min(state.clock, phases.duration[k])
        way, old, new = times(strides, vector(phases.stride)), state.stance, 1 - state.stance
        put(feet[i, old], plus(vector(state.shift[old]), way))
        put(feet[i, new], plus(vector(state.swing[0] if state.single else state.shift[new]), way))
        if not state.single:
            transfer = minus(vector(state.shift[new]), vector(state.shift[old]))
            put(rate[i], times(state.clock_rate / state.duration, transfer))
        put(com[i], plus(carried_shift(state), way))
        # The COM's height has a state of its own.
        com[i, 2], rate[i, 2] = way[2] + state.height[0], state.height[1]
    return time, feet, com, rate
