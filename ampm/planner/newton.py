"""Whether a plan's ZMP, acceleration and moment agree with each other and with the motion of its COM."""

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.planner.centroidal import CentroidalPlan, PlanSample

ALLOWED = 2e-4
"""Largest contradiction that a plan may have, as a distance of its ZMP [m]."""
WINDOW, SHORTEST = 0.1, 0.05
"""Least length of windows where a phase has several, and of a phase that has one [s]."""
_INTERVAL = 1e-3  # between the times at which the ZMP is compared [s]
_PIECE = 0.02  # of a window, with instants by Gauss and Legendre [s]
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(6)


def check_newton(plan: CentroidalPlan, or_else: str = "") -> float:
    """Check a plan against Newton's law, from its first phase to its end.

    Every millisecond the ZMP is compared with that of force and moment. Acceleration and velocity are
    compared with the COM, and the moment with the angular momentum, as means over windows within each phase
    of contact: ``mean(w a) = mean(w'' x)`` for a weight w that fades at both ends. Nothing is differentiated.

    Args:
        plan: with all of its motion.
        or_else: is appended to the way out of a refusal.

    Returns:
        The largest contradiction, as a distance of its ZMP [m].

    Raises:
        InputError: it is larger than :data:`ALLOWED`.
    """
    begin, end = plan.phases[0].start, plan.duration
    now = plan.sample(np.append(np.arange(begin, end, _INTERVAL), end))
    found = [("ZMP", zmp_of_com(now) - now.zmp, now.time)]
    if windows := _windows(plan, begin, end):
        first = np.cumsum([0, *(window.shape[1] for window in windows[:-1])])
        time, weight, rate, bend = np.concatenate(windows, axis=1)[:, :, None]
        at, fall = plan.sample(time[:, 0]), plan.com_height / plan.gravity
        means = {
            "acceleration": fall * (at.com_acceleration * weight - at.com * bend),
            "velocity": math.sqrt(fall) * (at.com_velocity * weight + at.com * rate),
            "moment": (at.moment * weight + at.angular_momentum * rate) / plan.weight,
        }
        middle = np.add.reduceat(time * weight, first)[:, 0]
        found += [(what, np.add.reduceat(mean, first), middle) for what, mean in means.items()]
    sizes = [np.nan_to_num(np.abs(off).max(axis=1), nan=np.inf) for _, off, _ in found]
    size, (what, _, when) = max(zip(sizes, found, strict=True), key=lambda item: float(item[0].max()))
    if not math.isfinite(size.max()):
        raise InputError(f"the plan is not finite at {when[size.argmax()]:.4g} s; give finite com and zmp.")
    if size.max() > ALLOWED:
        raise InputError(
            f"the plan contradicts itself at {when[size.argmax()]:.4g} s: its {what} differs from that of "
            f"its COM by {1e3 * size.max():.3g} mm of ZMP, more than {1e3 * ALLOWED:g} mm; correct com, zmp, "
            f"height or units (m, s), or give the acceleration that belongs to them{or_else}."
        )
    return float(size.max())


def zmp_of_com(sample: PlanSample) -> Array:
    """ZMP by Newton's law from COM, force and moment of N samples, shape (N, 2) [m]."""
    height = sample.com[:, 2:] - sample.floor[:, None]
    arm = height * sample.force[:, :2] + sample.moment[:, ::-1] * [1.0, -1.0]
    return sample.com[:, :2] - arm / sample.force[:, 2:]


def _windows(plan: CentroidalPlan, begin: float, end: float) -> list[NDArray[np.float64]]:
    """Instants of every window, and there (1 - u^2)^4 and two derivatives, of mean one; (4, n) each."""
    # A law of samples bends or jumps at each of them.
    parts = [phase.start + np.append(0.0, getattr(phase.x, "time", ())) for phase in plan.phases]
    bends, windows = np.concatenate(parts), []
    for phase in plan.contacts.phases:
        a, b = max(phase.start, begin), min(phase.start + phase.duration, end)
        ends = np.linspace(a, b, max(int((b - a) / WINDOW), 1) + 1).tolist() if b - a >= SHORTEST else []
        for left, right in pairwise(ends):
            pieces = np.linspace(left, right, math.ceil((right - left) / _PIECE) + 1)
            edges = np.union1d(pieces, bends[(bends > left) & (bends < right)])
            half, reach = 0.5 * np.diff(edges)[:, None], 0.5 * (right - left)
            time = (edges[:-1, None] + half * (1.0 + _NODES)).ravel()
            u = (time - left) / reach - 1.0
            v, area = 1.0 - u * u, (half * _WEIGHTS).ravel() / (256.0 / 315.0 * reach)
            weights = v**4, -8.0 * u * v**3 / reach, (56.0 * u * u - 8.0) * v**2 / reach**2
            windows.append(np.vstack([time, area * np.array(weights)]))
    return windows
