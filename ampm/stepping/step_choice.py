"""Formulas of the stepping stabiliser: where and when to step, and what the sole can give.

With c the COM, ``omega^2 = g / H`` and ``r = c - cdd / omega^2`` (the ZMP of a walk without angular
momentum), the divergent component of motion ``xi = c + cd / omega`` obeys ``xid = omega (xi - r)``: it
grows from whatever r does not hold. A push moves it. What the ankle cannot take out until the next switch, a
step must.

Vectors are horizontal: in world, or along the heading of the standing foot and to its left. Times in which a
DCM grows are given as ``tau``, omega times the time.
"""

import math

import numpy as np

from ampm.compiled import compiled
from ampm.control.sole import places_of, turned_axes
from ampm.control.workspace import Stepper, SteppingState, Workspace
from ampm.geometry import Array
from ampm.vectors import Vector, along_across, clip

FORWARD, BACKWARD, WIDER = 0.28, 0.8, 0.40
"""A step may be displaced this far [m]. All lengths and times here hold for a body of 1.70 m: lengths grow
with its size, times with the square root of it."""
IN_LINE, NEAR, GAP = 0.5, 0.02, 0.05
"""Least distance of two soles' middles across with one ahead of the other, in widths of a foot [1]; what is
added to it or, beside each other, to what both take, and the gap between toe and heel from which one is ahead
[m]."""
SHORTEST = 0.32
"""Least duration of a single support [s]."""
TIMES = np.array([0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.2, 1.5, 1.8])
"""Candidates for the rest of a single support, per planned rest [1]."""
EASY_LENGTH, EASY_WIDTH = 0.15, 0.06
"""The time does not change for displacements up to these [m]."""
TIME_COST, LIMIT_COST, CHANGE_COST = 0.03, 2.5, 0.01
"""Costs of another time, per its logarithm [m], of a metre beyond the limits [1], and of another choice than
at the last tick [m]."""
RETURN, RETURN_MOST, CATCH_UP = 0.5, 0.05, 0.05
"""Share of its displacement by which the next step returns to its planned place [1], at most so far along and
across [m], and how much longer or shorter a single support may be to return to its planned time [1]."""
OVERSHOOT = (1.0, 1.05)
"""Factors on displacements along and across, because the step after a narrow one is the harder one [1]."""
SOLE_SHARE = 0.8
"""Share of the sole that counts for what the ankle can do until the next switch [1]."""

_NODES, _WEIGHTS = (
    0.5 * (values + shift)
    for values, shift in zip(np.polynomial.legendre.leggauss(8), (1.0, 0.0), strict=True)
)
"""Gauss's nodes and weights on 0 ... 1."""


@compiled
def choose_step(work: Workspace, stepper: Stepper) -> None:
    """Choose place and time of the next step: ``step``, ``stretch`` and ``choice`` of the state.

    For each time of the rest of the single support the displacement follows in closed form. As long as it is
    easy, steps return to the places and times of the plan; else a cost weighs displacement, time and limits.
    Only off the plan may the time be changed.

    Args:
        work: of this tick, with the plan's reference. Of the state ``length`` and ``width`` are those of the
            planned step, ``choice`` the candidate of the last tick.
        stepper: with the phase.
    """
    state: SteppingState = work.stepping[0]
    size, rest, shortest = stepper.size, state.duration - state.clock, SHORTEST * math.sqrt(stepper.size)
    cos, sin = heading_of(work.wanted.foot_rotation[state.stance])
    count = len(work.body.points) // 2
    points = work.body.points[count * state.stance : count * (state.stance + 1)]
    places, sole = places_of(points, work.body.com, cos, sin), np.empty((2, 2))
    for axis in range(2):
        sole[0, axis], sole[1, axis] = places[:, axis].min(), places[:, axis].max()
    dcm = expected_dcm(work, stepper.omega)
    shift, most = turned_axes(state.shift[state.stance], cos, sin), size * RETURN_MOST
    least_cost, choice, stretch, chosen = math.inf, -1, 1.0, (0.0, 0.0)
    for k in range(-1, len(TIMES) if state.off_plan else 0):
        if k < 0:
            factor = clip(1.0 - state.delay / rest, 1.0 - CATCH_UP, 1.0 + CATCH_UP)
            back = np.clip(-RETURN * shift, -most, most)
        else:
            factor, back = TIMES[k], np.zeros(2)
            if factor * state.duration < shortest:
                continue
        tau = stepper.omega * max(rest * factor, 1e-4)
        needed = needed_step(work, stepper, sole, dcm, tau, back)
        step = allowed_step(work, stepper, sole, needed)
        cost = max(abs(step[0]) - size * EASY_LENGTH, 0.0) + max(abs(step[1]) - size * EASY_WIDTH, 0.0)
        cost += LIMIT_COST * (abs(needed[0] - step[0]) + abs(needed[1] - step[1]))
        cost += size * (TIME_COST * abs(math.log(factor)) - (CHANGE_COST if k == state.choice else 0.0))
        if cost < least_cost:
            least_cost, choice, stretch, chosen = cost, k, factor, step
    state.choice, state.stretch = choice, stretch
    state.step[0], state.step[1] = along_across(chosen[0], chosen[1], cos, -sin)


@compiled
def needed_step(work: Workspace, stepper: Stepper, sole: Array, dcm: Array, tau: float, back: Array) -> Array:
    """Displacement of the next step that brings the DCM to its plan, along and across, shape (2,) [m].

    The DCM is that of :func:`expected_dcm`, ``tau`` the rest of the single support. ``sole`` has the least
    and largest place of the standing foot's points, (2, 2) [m]. The step moves ``back`` in any case [m].
    """
    state: SteppingState = work.stepping[0]
    wanted, shift, omega = work.wanted, state.shift[state.stance, :2], stepper.omega
    cos, sin = heading_of(wanted.foot_rotation[state.stance])
    decay, ramp = math.exp(-tau), ramp_share(omega * state.double_duration)
    planned = wanted.com[:2] + wanted.com_velocity[:2] / omega
    if state.off_plan:
        planned = dcm_ahead(state, stepper, tau)
    error = turned_axes(dcm - planned - shift, cos, sin) - ramp * decay * back
    zmp, step = turned_axes(mean_zmp(state, stepper, tau) + shift, cos, sin), back.copy()
    for axis in range(2):
        low, high = SOLE_SHARE * (sole[0, axis] - zmp[axis]), SOLE_SHARE * (sole[1, axis] - zmp[axis])
        step[axis] += OVERSHOOT[axis] * step_change(error[axis], decay, ramp, low, high)
    return step


@compiled
def allowed_step(work: Workspace, stepper: Stepper, sole: Array, step: Array) -> tuple[float, float]:
    """What the legs allow of a displacement, both along and across [m]; see :func:`needed_step`."""
    state: SteppingState = work.stepping[0]
    size, length, beside = stepper.size, sole[1, 0] - sole[0, 0], stepper.foot_width
    if state.off_plan:  # a foot that is turned takes more
        cos, sin = heading_of(work.wanted.foot_rotation[state.stance])
        to_cos, to_sin = heading_of(stepper.table.foot_rotation[-1, 1 - state.stance])
        beside += 0.5 * length * abs(cos * to_sin - sin * to_cos)
    along = clip(step[0], -size * BACKWARD, size * FORWARD)
    in_line = abs(state.length + along) >= length + GAP * size
    narrowest = (IN_LINE * stepper.foot_width if in_line else beside) + NEAR * size
    side = 1.0 if state.stance == 1 else -1.0  # of the swing foot
    return along, side * clip(side * step[1], min(narrowest - state.width, 0.0), size * WIDER)


@compiled
def step_change(error: float, decay: float, ramp: float, low: float, high: float) -> float:
    """How far the next step must be displaced along one axis [m].

    The ankle can shift the ZMP by a constant d between ``low`` and ``high`` until the switch. If all steps
    that follow are displaced by u, and r goes over to them linearly in double support, the DCM's reference is
    displaced by ``u ramp decay``. Zero as long as the ankle can do it alone.

    Args:
        error: of the DCM [m].
        decay: ``exp(-omega D)``, D until the switch.
        ramp: :func:`ramp_share` of the double support.
        low: least shift, if it is negative [m].
        high: largest shift, if it is positive [m].
    """
    d = clip(error / max(1.0 - decay, 1e-9), min(low, 0.0), max(high, 0.0))
    left = error - (1.0 - decay) * d
    return left / (decay * ramp) if abs(left) > 1e-12 else 0.0


@compiled
def expected_dcm(work: Workspace, omega: float) -> Array:
    """Measured DCM, with what the surplus of angular momentum will cost it, in world, shape (2,) [m]."""
    com, rates, mass = work.body.com, work.tasks.rates, work.body.mass
    surplus = mass * rates[3:5] - work.wanted.angular_momentum[:2]
    lever = omega / (mass * work.body.gravity)
    return com[:2] + rates[:2] / omega + lever * np.array([surplus[1], -surplus[0]])


@compiled
def dcm_ahead(state: SteppingState, stepper: Stepper, tau: float) -> Array:
    """DCM from which the rest of its phase leads to the planned end, in world, shape (2,) [m].

    The rest of r takes the time D of ``tau``, whatever it would take in the plan::

        xi = exp(-omega D) xi_end + omega int_0^D exp(-omega t) r(t) dt
    """
    r, begin = stepper.curves.r, phase_position(state, stepper)
    last, xi = len(r) - 1, math.exp(-tau) * stepper.curves.xi[-1]
    for k in range(len(_NODES)):
        at = begin + _NODES[k] * (last - begin)
        i = min(int(at), last - 1)
        share, weight = at - i, _WEIGHTS[k] * tau * math.exp(-tau * _NODES[k])
        for axis in range(2):
            xi[axis] += weight * ((1.0 - share) * r[i, axis] + share * r[i + 1, axis])
    return xi


@compiled
def mean_zmp(state: SteppingState, stepper: Stepper, tau: float) -> Array:
    """Mean ZMP of the rest of a phase by its weight ``exp(-omega t)`` in the DCM, shape (2,) [m]."""
    zmp, begin = stepper.curves.zmp, phase_position(state, stepper)
    mean, total = np.zeros(2), 0.0
    for k in range(5):
        i = int(begin + 0.25 * k * (len(zmp) - 1 - begin))
        weight = math.exp(-0.25 * k * tau) * (0.5 if k in (0, 4) else 1.0)
        mean[0], mean[1], total = mean[0] + weight * zmp[i, 0], mean[1] + weight * zmp[i, 1], total + weight
    return mean / total


@compiled
def ramp_share(tau: float) -> float:
    """``(1 - exp(-tau)) / tau``: weight of the beginning of a linear change over the time ``tau``."""
    return 1.0 - 0.5 * tau if tau < 1e-6 else -math.expm1(-tau) / tau


@compiled
def phase_interval(state: SteppingState, stepper: Stepper) -> tuple[int, float]:
    """Number of the interval in which the clock is, and the share of it that has passed."""
    position = phase_position(state, stepper)
    i = min(int(position), len(stepper.curves.r) - 2)
    return i, position - i


@compiled
def phase_position(state: SteppingState, stepper: Stepper) -> float:
    """Place of the clock in the curves of its phase, in intervals from the first row on."""
    return clip(state.clock / state.duration, 0.0, 1.0) * (len(stepper.curves.r) - 1)


@compiled
def heading_of(rotation: Array) -> tuple[float, float]:
    """Cosine and sine of a foot's heading, from its rotation to world."""
    size = max(math.hypot(rotation[0, 0], rotation[1, 0]), 1e-9)
    return rotation[0, 0] / size, rotation[1, 0] / size


@compiled
def quintic_tick(motion: Array, target: Vector, remaining: float, tick: float) -> None:
    """Advance an offset by one tick of the quintic that ends at rest at a target.

    Args:
        motion: value, rate and acceleration, which are replaced, shape (3, 3).
        target: where it ends.
        remaining: time until the end [s].
        tick: [s].
    """
    t, T = tick, remaining
    for axis in range(3):
        x, v, a = motion[0, axis], motion[1, axis], motion[2, axis]
        if tick >= T:
            motion[0, axis], motion[1, axis], motion[2, axis] = target[axis], 0.0, 0.0
            continue
        dp, dv, da = target[axis] - x - v * T - 0.5 * a * T * T, (-v - a * T) * T, -a * T * T
        c3 = (10.0 * dp - 4.0 * dv + 0.5 * da) / T**3
        c4 = (-15.0 * dp + 7.0 * dv - da) / T**4
        c5 = (6.0 * dp - 3.0 * dv + 0.5 * da) / T**5
        motion[0, axis] = x + t * (v + t * (0.5 * a + t * (c3 + t * (c4 + t * c5))))
        motion[1, axis] = v + t * (a + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5)))
        motion[2, axis] = a + t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5))
