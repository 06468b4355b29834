"""How far the plan of a walk moved while it was walked, and how often; no metric of a plan that stayed."""

from functools import partial

import numpy as np

from ampm.geometry import Array
from ampm.planner.centroidal import PlanSample
from validation.judge.compare import Comparison
from validation.judge.metric import Metric
from validation.judge.sizes import FOOT_LENGTH, share_of_default


def zmp_distance(walk: Comparison) -> Array | None:
    """Distance of the ZMP of the plan then valid from that of the first plan in the window, (n,) [m]."""
    if walk.first is None:
        return None
    return np.asarray(np.linalg.norm((walk.sample.zmp - walk.first.zmp)[walk.inside], axis=1))


def stances(sample: PlanSample) -> list[tuple[Array, Array]]:
    """When each stance of a foot begins (n,) [s], and where it stands (n, 2) [m]; left foot first."""
    found = []
    for foot, places in enumerate((sample.left_placement, sample.right_placement)):
        stands = (sample.stance == foot) | (sample.stance == 2)
        edges = np.diff(stands, prepend=False, append=False).nonzero()[0]
        found.append((sample.time[edges[::2]], places[edges[1::2] - 1]))
    return found


def _footsteps(walk: Comparison, which: int) -> float | None:
    """Largest difference of the stances' begins (0) [s], or places (1) [m], of first plan and plan."""
    if walk.first is None:
        return None
    largest = 0.0
    for first, then in zip(stances(walk.first), stances(walk.sample), strict=True):
        for one, other in zip(first[which], then[which], strict=False):
            largest = max(largest, float(np.linalg.norm(other - one)))
    return largest


def _largest(walk: Comparison) -> float | None:
    distance = zmp_distance(walk)
    return None if distance is None else float(distance.max(initial=0.0))


def _rms(walk: Comparison) -> float | None:
    distance = zmp_distance(walk)
    return None if distance is None else float(np.sqrt(np.mean(distance**2))) if len(distance) else np.nan


def _changes(walk: Comparison) -> float | None:
    return None if walk.first is None else float(walk.followed.changes)


def _rate(walk: Comparison) -> float | None:
    changes = _changes(walk)
    return None if changes is None else changes / float(walk.time[-1] + walk.record.time_step)


_FAR = 1.0  # [m]
_FAR_ON_REQUEST = 5.0
_WHY = (
    "A plan that moves wherever the body goes would agree with any walk. The stabiliser that steps moved ZMP "
    "and footsteps of walks by at most 0.58 m, landings by 0.46 s, after pushes of 15 to 30 N s. "
    "Over footsteps a request may stop or turn the walk: 5 m."
)
_LIMITS = {
    name: share_of_default(limit, FOOT_LENGTH)
    for name, limit in (("default", _FAR), ("footsteps", _FAR_ON_REQUEST))
}

PLAN_MOVED = (
    Metric(
        "plan_moved_zmp_maximum",
        "m",
        "largest distance of the planned ZMP from that of the first plan",
        "walk",
        _largest,
        _LIMITS,
        tolerance_unit=FOOT_LENGTH,
        label="plan moved, largest distance of its ZMP",
        reason=_WHY,
        nature="extreme",
    ),
    Metric(
        "plan_moved_footsteps",
        "m",
        "largest distance of a planned footstep from that of the first plan",
        "walk",
        partial(_footsteps, which=1),
        _LIMITS,
        tolerance_unit=FOOT_LENGTH,
        label="plan moved, largest distance of a footstep",
        reason=_WHY,
        nature="extreme",
    ),
    Metric(
        "plan_moved_time",
        "s",
        "largest difference of a planned landing from that of the first plan",
        "walk",
        partial(_footsteps, which=0),
        {"default": 1.0},
        label="plan moved, largest time of a landing",
        reason=_WHY,
        nature="extreme",
    ),
    Metric(
        "plan_change_rate",
        "1/s",
        "plans after the first one, over the time of the walk",
        "walk",
        _rate,
        {"default": 25.0},
        label="plan moved, times a second",
        reason="A plan that is new at every tick could follow the measurement a tick late. A planner that "
        "plans every 50 ms makes 20 plans a second.",
        nature="count",
    ),
    Metric(
        "plan_moved_zmp_rms",
        "m",
        "root mean square distance of the planned ZMP from that of the first plan",
        "walk",
        _rms,
        label="plan moved, RMS distance of its ZMP",
    ),
    Metric(
        "plan_changes",
        "1",
        "plans that were followed after the first one",
        "walk",
        _changes,
        label="plan moved, times",
        nature="count",
    ),
)
