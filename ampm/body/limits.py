"""Limits of body, floor and formula: those that a search keeps, and how a broken one is told."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from ampm.exceptions import BodilyRefusal
from ampm.planner.closed_form import LEAST_MID_STANCE_SHARE

ROLL_TOLERANCE = 0.005
"""Largest distance of the ZMP behind the ball at heel rise [m]: the ZMP covers it in a few milliseconds, in
which the heel rises by less than the millimetre that a soft contact yields."""
RISE_TOLERANCE = 0.6 * ROLL_TOLERANCE
"""The same of a gait that is searched for [m]."""
LEG_ALLOWANCE = 0.02
"""Reach beyond the straight leg that the pelvis can add, as a share of the leg's length [1]. This early check
refuses only what no rotation of the pelvis can correct; the inverse kinematics decides the rest."""
KNEE_MINIMUM = 0.1
"""Least flexion of a knee [rad]: a straighter one can hardly change the hip's height."""
CLEARANCE = 0.010
"""Least distance of arms from legs, trunk and each other, and of leg from leg [m]."""

# By how much a fine grid may find a knee straighter, a joint nearer to its limit and two parts nearer to each
# other than the search's coarse one [rad, rad, m].
_KNEE_GRID, _JOINT_GRID, _GAP_GRID = 0.015, 0.002, 0.0003

AT_MOST, AT_LEAST = -math.inf, math.inf
"""Targets of a limit that is only checked, not searched for."""


@dataclass(frozen=True)
class Limit:
    """One limit of body, floor or formula."""

    what: str  # the measured quantity; in a check, a clause that also names the fault
    unit: str  # of value, bound and target
    bound: float  # hard limit
    target: float  # target of a search; beyond `bound` on the allowed side
    reason: str  # short name for tables
    way_out: str = ""  # what the user can change
    tolerance: float = 0.0  # by how much a check lets a value exceed the bound

    def margin(self, value: float) -> float:
        """Normalised margin: 0 at the bound, 1 at the target, negative beyond the bound [1]."""
        return (value - self.bound) / (self.target - self.bound)

    def broken(self, value: float) -> bool:
        """Whether a value is beyond bound and tolerance, or no number."""
        beyond = value - self.bound if self.target < self.bound else self.bound - value
        return not beyond <= self.tolerance

    def rule(self, digits: int = 3) -> str:
        """The bound in words, with its unit."""
        side = "at most" if self.target < self.bound else "at least"
        return f"{side} {self.quantity(self.bound, digits)}"

    def quantity(self, value: float, digits: int) -> str:
        """A value with its unit; -0 is 0."""
        return f"{value + 0.0:.{digits}g}" + ("" if self.unit == "1" else f" {self.unit}")

    def in_words(self, value: float) -> tuple[str, str]:
        """A broken value and the rule in words, with as many digits as tell them apart."""
        digits = next(d for d in range(4, 18) if d == 17 or f"{value:.{d}g}" != f"{self.bound:.{d}g}")
        return self.quantity(value, digits), self.rule(digits)

    def refusal(self, value: float, also: str = "") -> BodilyRefusal:
        """The error; ``also`` is appended to the way out."""
        reached, rule = self.in_words(value)
        return BodilyRefusal(
            f"{self.what} is {reached} and must be {rule}",
            reason=self.reason,
            value=value,
            limit=self.bound,
            unit=self.unit,
            way_out=self.way_out + also,
        )


def check(limits: Iterable[tuple[Limit, float]]) -> None:
    """Refuse the first value that is beyond its limit, by a BodilyRefusal."""
    for limit, value in limits:
        if limit.broken(value):
            raise limit.refusal(value)


_GROUPS = {
    "hip": ("a hip joint", 0.06),
    "ankle": ("an ankle joint", 0.045),
    "toe": ("a toe joint", 0.06),
    "trunk": ("a waist or chest joint", 0.12),
    "arms": ("an arm or head joint", 0.05),
}
"""Joints in words, and the target of their distance from their limits [rad]."""
_INTO = "least distance of the ZMP into the"
_FLOOR = "height of the sole"
_HANDOVER = "double support over 0.04 s or a longer contact ramp"

LIMITS: Mapping[str, Limit] = {
    "mid_stance": Limit(
        "square of the mid-stance speed over v0", "1", LEAST_MID_STANCE_SHARE**2, 0.2, "mid_stance_too_slow"
    ),
    "zmp_single": Limit(f"{_INTO} support on one sole", "m", 0.0, 0.006, "zmp_leaves_support"),
    "zmp_double": Limit(
        f"{_INTO} double support or on the ball", "m", -ROLL_TOLERANCE, -RISE_TOLERANCE, "zmp_leaves_support"
    ),
    # The front edge of a foot without toes carries the whole body if the ZMP is there when the heel rises.
    "zmp_edge": Limit(f"{_INTO} double support", "m", -ROLL_TOLERANCE, 0.005, "zmp_leaves_support"),
    "reach": Limit(
        "distance of hip and ankle over the straight leg", "1", 1.0 + LEG_ALLOWANCE, 0.995, "leg_too_short"
    ),
    "floor": Limit(
        f"{_FLOOR} at lift and landing, scaled to a fifth of the swing", "m", 0.0, 0.001, "sole_under_floor"
    ),
    "clearance": Limit(f"{_FLOOR} in mid swing", "m", 0.0, 0.006, "sole_under_floor"),
    "turn": Limit("fastest turn of a foot at the floor", "rad/s", 25.0, 10.0, "foot_turns_too_fast"),
    # With less than the whole ramp the foot that lands is late in taking the weight over.
    "handover": Limit(_HANDOVER, "1", 0.85, 1.3, "double_support_too_short"),
    # Without toes the load goes over by edges, which needs longer.
    "edge_handover": Limit(_HANDOVER, "1", 0.85, 2.5, "double_support_too_short"),
    # Chosen on 42 gaits of the G1: of 4 with less, 3 failed with late, noisy readings.
    "edge_least": Limit(_HANDOVER, "1", 1.1, 1.6, "double_support_too_short"),
    # The shortest of which walks are known: 0.177 s.
    "pace": Limit("duration of a step", "s", 0.175, 0.185, "step_too_short_in_time"),
    "friction": Limit("share of the friction that the controller may use", "1", 1.0, 0.75, "friction"),
    # Beyond its bound a foot yaws; well below it the vertical moment is not met, and the ZMP error grows.
    "twist": Limit("share of the twist that the controller gives a foot", "1", 2.0, 1.0, "friction"),
    # A sole that lands rolled turns flat, and its hip goes aside: the ZMP errs by up to 2 mm a milliradian.
    "sole_roll": Limit("largest roll of a sole in double support", "rad", 0.0015, 0.0003, "sole_rolls"),
    "knee": Limit("least knee flexion", "rad", KNEE_MINIMUM + _KNEE_GRID, 0.35, "knee_too_straight"),
    "knee_range": Limit(
        "least distance of a bent knee from its limit", "rad", _JOINT_GRID, 0.06, "joint_limits"
    ),
    **{
        name: Limit(f"least distance of {words} from its limits", "rad", _JOINT_GRID, target, "joint_limits")
        for name, (words, target) in _GROUPS.items()
    },
    # Feedback turns a joint up to 4 % faster than planned, by 1 % in most walks.
    "speed": Limit("largest share of a joint's speed limit", "1", 0.985, 0.885, "speed_limits"),
    "gap": Limit("least distance of two parts", "m", CLEARANCE + _GAP_GRID, 0.0135, "self_collision"),
    # Feedback needs what is left, above all in the hips, which stop and turn the legs of a fast gait.
    "hip_time": Limit(
        "mean use of a hip motor's last fifth of torque over a step", "1", 0.045, 0.02, "torque_limits"
    ),
    **{
        f"{name}_torque": Limit(f"largest share of {words}'s torque limit", "1", 1.0, 0.8, "torque_limits")
        for name, (words, _) in {**_GROUPS, "knee": ("a knee", 0.0)}.items()
    },
}
"""Limits by which a choice of a search is judged."""
