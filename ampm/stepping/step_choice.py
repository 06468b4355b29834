"""Formulas of the stepping stabiliser: where and when to step, and what the sole can give.

With c the COM, ``omega^2 = g / H`` and ``r = c - cdd / omega^2`` (the ZMP of a walk without angular
momentum), the divergent component of motion ``xi = c + cd / omega`` obeys ``xid = omega (xi - r)``: it
grows from whatever r does not hold. A push moves it. What the ankle cannot take out until the next switch, a
step must.
Vectors are horizontal, in the axes of the standing foot: along, and to the left.
"""

import math

import numpy as np

from ampm.compiled import compiled
from ampm.control.sole import sole_of
from ampm.control.workspace import Stepper, SteppingState, Workspace
from ampm.geometry import Array
from ampm.vectors import along_across, clip

FORWARD, BACKWARD, WIDER = 0.28, 0.8, 0.40
"""A step may be displaced this far [m]. All lengths and times here hold for a body of 1.70 m: lengths grow
with its size, times with the square root of it."""
IN_LINE, NEAR, GAP = 0.5, 0.02, 0.05
"""Least distance of two soles' middles across with one ahead of the other, in widths of a foot [1]; what is
added to it or, beside each other, to what both take, and the gap between toe and heel from which one is ahead
[m]."""
SHORTEST, LONGEST = 0.32, 1.8
"""Least duration of a single support [s], and longest over the planned one [1]."""
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
OVERSHOOT = 1.05
"""Factor on lateral displacements, because the step after a narrow one is the harder one [1]."""
SOLE_SHARE = 0.8
"""Share of the sole that counts for what the ankle can do until the next switch [1]."""

_NODES, _WEIGHTS = (
    0.5 * (values + shift)
    for values, shift in zip(np.polynomial.legendre.leggauss(8), (1.0, 0.0), strict=True)
)
"""Gauss's nodes and weights on 0 ... 1."""


@compiled
def ramp_share(x: float) -> float:
    """``(1 - exp(-x)) / x``: weight of the beginning of a linear change over a time ``x / omega``."""
    return 1.0 - 0.5 * x if x < 1e-6 else -math.expm1(-x) / x


@compiled
def phase_position(state: SteppingState, stepper: Stepper) -> float:
    """Place of the clock in the curves of its phase, in intervals from the first row on."""
    return clip(state.clock / state.duration, 0.0, 1.0) * (len(stepper.curves.r) - 1)


@compiled
def phase_interval(state: SteppingState, stepper: Stepper) -> tuple[int, float]:
    """Number of the interval in which the clock is, and the share of it that has passed."""
    position = phase_position(state, stepper)
    i = min(int(position), len(stepper.curves.r) - 2)
    return i, position - i


@compiled
def dcm_ahead(state: SteppingState, stepper: Stepper, x: float, out: Array) -> None:
    """Write the DCM from which the rest of its phase leads to the planned end, shape (2,) [m].

    The rest of r takes the time D, whatever it would take in the plan; ``x`` is omega D::

        xi = exp(-omega D) xi_end + omega int_0^D exp(-omega t) r(t) dt
    """
    r, end, begin = stepper.curves.r, stepper.curves.xi[-1], phase_position(state, stepper)
    last, decay = len(r) - 1, math.exp(-x)
    out[0], out[1] = decay * end[0], decay * end[1]
    for k in range(len(_NODES)):
        at = begin + _NODES[k] * (last - begin)
        i = min(int(at), last - 1)
        share, weight = at - i, _WEIGHTS[k] * x * math.exp(-x * _NODES[k])
        for axis in range(2):
            out[axis] += weight * ((1.0 - share) * r[i, axis] + share * r[i + 1, axis])


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
def quintic_tick(motion: Array, target: Array, remaining: float, tick: float) -> None:
    """Advance an offset by one tick of the quintic that ends at rest at a target.

    Args:
        motion: value, rate and acceleration, which are replaced, shape (3, k).
        target: shape (k,).
        remaining: time until the end [s].
        tick: [s].
    """
    for axis in range(motion.shape[1]):
        x, v, a = motion[0, axis], motion[1, axis], motion[2, axis]
        T = remaining
        if tick >= T:
            motion[0, axis], motion[1, axis], motion[2, axis] = target[axis], 0.0, 0.0
            continue
        dp, dv, da = target[axis] - x - v * T - 0.5 * a * T * T, (-v - a * T) * T, -a * T * T
        c3 = (10.0 * dp - 4.0 * dv + 0.5 * da) / T**3
        c4 = (-15.0 * dp + 7.0 * dv - da) / T**4
        c5 = (6.0 * dp - 3.0 * dv + 0.5 * da) / T**5
        t = tick
        motion[0, axis] = x + t * (v + t * (0.5 * a + t * (c3 + t * (c4 + t * c5))))
        motion[1, axis] = v + t * (a + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5)))
        motion[2, axis] = a + t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5))


@compiled
def mean_zmp(state: SteppingState, stepper: Stepper, x: float) -> tuple[float, float]:
    """Mean ZMP of the rest of a phase by its weight ``exp(-omega t)`` in the DCM; ``x`` is omega D [m]."""
    zmp, begin = stepper.curves.zmp, phase_position(state, stepper)
    mean_x = mean_y = total = 0.0
    for k in range(5):
        i = int(begin + 0.25 * k * (len(zmp) - 1 - begin))
        weight = math.exp(-0.25 * k * x) * (0.5 if k in (0, 4) else 1.0)
        mean_x, mean_y, total = mean_x + weight * zmp[i, 0], mean_y + weight * zmp[i, 1], total + weight
    return mean_x / total, mean_y / total


@compiled
def heading_of(rotation: Array) -> tuple[float, float]:
    """Cosine and sine of a foot's heading, from its rotation to world."""
    size = max(math.hypot(rotation[0, 0], rotation[1, 0]), 1e-9)
    return rotation[0, 0] / size, rotation[1, 0] / size


@compiled
def expected_dcm(work: Workspace, omega: float) -> tuple[float, float]:
    """Measured DCM, with what taking out the surplus of angular momentum will cost it [m]."""
    com, rates, mass, momentum = work.body.com, work.tasks.rates, work.body.mass, work.wanted.angular_momentum
    lever = omega / (mass * work.body.gravity)
    surplus_x = mass * rates[3] - momentum[0]
    surplus_y = mass * rates[4] - momentum[1]
    return com[0] + rates[0] / omega + lever * surplus_y, com[1] + rates[1] / omega - lever * surplus_x


@compiled
def plan_step(work: Workspace, stepper: Stepper) -> bool:
    """Choose place and time of the next step, and whether they differ from the plan.

    For each time of the rest of the single support the displacement follows in closed form. As long as it is
    easy, steps return to the places and times of the plan; else a cost weighs displacement, time and limits.
    Only off the plan may the time be changed.

    Args:
        work: of this tick, with the plan's reference. Of the state ``length`` and ``width`` are those of the
            planned step; ``step``, ``factor`` and ``choice`` are replaced.
        stepper: with the phase.
    """
    state: SteppingState = work.stepping[0]
    body, wanted, omega, size = work.body, work.wanted, stepper.omega, stepper.size
    shift, side = state.shift[state.stance], 1.0 if state.stance == 1 else -1.0
    rest = state.duration - state.clock
    cos, sin = heading_of(wanted.foot_rotation[state.stance])
    sole, dcm_wanted, best_step = np.empty(4), np.empty(2), np.zeros(2)
    sole_of(state.stance, body.points, body.com, cos, sin, sole)
    dcm_x, dcm_y = expected_dcm(work, omega)
    sole_length, shortest = sole[1] - sole[0], SHORTEST * math.sqrt(size)
    beside = stepper.foot_width
    if state.off_plan:  # a foot that is turned takes more
        to_cos, to_sin = heading_of(stepper.table.foot_rotation[-1, 1 - state.stance])
        beside += 0.5 * sole_length * abs(cos * to_sin - sin * to_cos)
    ramp, most_back = ramp_share(omega * state.double), RETURN_MOST * size
    least_cost, best_factor, best = math.inf, 1.0, -1
    for k in range(-1, len(TIMES) if state.off_plan else 0):  # -1 returns to the plan
        factor = clip(1.0 - state.late / rest, 1.0 - CATCH_UP, 1.0 + CATCH_UP) if k < 0 else TIMES[k]
        if k >= 0 and (factor * state.duration < shortest or factor > LONGEST):
            continue
        x = omega * max(rest * factor, 1e-4)
        if state.off_plan:
            dcm_ahead(state, stepper, x, dcm_wanted)
        else:
            dcm_wanted[0] = wanted.com[0] + wanted.com_velocity[0] / omega
            dcm_wanted[1] = wanted.com[1] + wanted.com_velocity[1] / omega
        back_along = back_across = 0.0
        if k < 0:
            shift_along, shift_across = along_across(shift[0], shift[1], cos, sin)
            back_along = clip(-RETURN * shift_along, -most_back, most_back)
            back_across = clip(-RETURN * shift_across, -most_back, most_back)
        decay = math.exp(-x)
        error_x, error_y = dcm_x - dcm_wanted[0] - shift[0], dcm_y - dcm_wanted[1] - shift[1]
        error_along, error_across = along_across(error_x, error_y, cos, sin)
        error_along -= ramp * decay * back_along
        error_across -= ramp * decay * back_across
        zmp_x, zmp_y = mean_zmp(state, stepper, x)
        zmp_along, zmp_across = along_across(zmp_x + shift[0], zmp_y + shift[1], cos, sin)
        low, high = SOLE_SHARE * (sole[0] - zmp_along), SOLE_SHARE * (sole[1] - zmp_along)
        forward = back_along + step_change(error_along, decay, ramp, low, high)
        low, high = SOLE_SHARE * (sole[2] - zmp_across), SOLE_SHARE * (sole[3] - zmp_across)
        wider = side * (OVERSHOOT * step_change(error_across, decay, ramp, low, high) + back_across)
        # What the legs allow of it.
        longer = clip(forward, -size * BACKWARD, size * FORWARD)
        in_line = abs(state.length + longer) >= sole_length + GAP * size
        narrowest = (IN_LINE * stepper.foot_width if in_line else beside) + NEAR * size
        aside = clip(wider, min(narrowest - state.width, 0.0), size * WIDER)
        cost = max(abs(longer) - size * EASY_LENGTH, 0.0) + max(abs(aside) - size * EASY_WIDTH, 0.0)
        cost += LIMIT_COST * (abs(forward - longer) + abs(wider - aside))
        cost += size * (TIME_COST * abs(math.log(factor)) - (CHANGE_COST if k == state.choice else 0.0))
        if cost < least_cost:
            least_cost, best_factor, best = cost, factor, k
            best_step[0], best_step[1] = longer, side * aside
    if least_cost < math.inf:
        state.step[0], state.step[1] = along_across(best_step[0], best_step[1], cos, -sin)
        state.factor, state.choice = best_factor, best
    return state.step[0] != 0.0 or state.step[1] != 0.0
