"""The free choices of a gait, found by an optimiser on plan and inverse kinematics alone.

The paper fixes a gait by step, speed, c_s and c_y and leaves the rest to be "set manually": how much of the
step is single support, how far the ZMP rolls under the foot, how high the COM is, when and how far the feet
turn, how the trunk leans. Here these are unknowns of a nonlinear least-squares problem. Every limit of body
and floor has a normalised margin: 0 where the limit is met exactly, 1 where it is comfortably far. What is
missing to 1 is a residual, and so is, weakly, the distance to a closed-form guess, which makes the answer
unique where nothing binds. Plan, feet, the periodic step of the inverse kinematics on a coarse grid, and the
joint torques of that step under the planned ground force are all that is looked at: no simulation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from scipy.optimize import brentq, least_squares

from ampm.exceptions import BodilyRefusal, MathematicalRefusal, RefusedGait
from ampm.feasibility import (
    COM_OVER_HIP,
    FLOOR_TOLERANCE,
    LEG_ALLOWANCE,
    ROLL_TOLERANCE,
    check_body,
)
from ampm.feet import HEEL
from ampm.gait import LEAST_MID_STANCE_SHARE, GaitPlan, plan_gait
from ampm.geometry import polygon_margin
from ampm.inverse_kinematics import KNEE_MINIMUM, Unreachable
from ampm.orbit import RoughOrbit, RoughOrbits, solve_motion
from ampm.parameters import GRAVITY, GaitParameters, RunParameters

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from ampm.body import BodyDescription
    from ampm.feet import FootSample
    from ampm.motion import WholeBodyMotion
    from ampm.robot import Robot

    Array = NDArray[np.float64]

_STATURE = 1.70  # of the body on which the closed-form guess was made [m]
_NODES = (32, 14)  # intervals of the grid in single and double support
_DIFFERENCE = 0.015  # step of finite differences, as a share of a choice's range
_FAILED = 6.0  # residual of a choice for which there is no periodic step
_PULL = 0.06  # weight of the distance to the guess
_SWEEPS = 12  # points at which one search may ask for a Jacobian
_DROPS = (
    0.0,
    0.012,
    0.025,
    0.04,
    0.06,
)  # by which the guess lowers the COM until there is an orbit [statures]
_RISE_TOLERANCE = 0.6 * ROLL_TOLERANCE  # how far behind the ball the ZMP may be when the heel rises [m]
_BUDGET = 5000  # integrated steps after which no new way is begun
_TIGHT = 0.3  # margin below which a limit is named as what ended a way
_ENOUGH = 0.9  # share of the wanted margins at which a search ends
_HOPELESS = -0.5  # margin at which a path is given up
_LANDING_TURN = 1.7  # heel strike rate over its mean: the foot comes down turning, and slows down


@dataclass(frozen=True)
class Limit:
    """One limit of body, floor or formula.

    Attributes:
        what: what is measured.
        unit: of all three figures.
        bound: what may not be passed.
        comfort: where nothing more is asked for; beyond ``bound`` on the allowed side.
        reason: short name for tables.
    """

    what: str
    unit: str
    bound: float
    comfort: float
    reason: str

    def margin(self, value: float) -> float:
        """Normalised margin: 0 at the bound, 1 at comfort, negative beyond the bound [1]."""
        return (value - self.bound) / (self.comfort - self.bound)


_TORQUES = {
    f"{name}_torque": Limit(f"largest share of {of} torque limit", "1", 1.0, 0.8, "torque_limits")
    for name, of in (
        ("hip", "a hip joint's"),
        ("knee", "a knee's"),
        ("ankle", "an ankle joint's"),
        ("toe", "a toe joint's"),
        ("trunk", "a waist or chest joint's"),
        ("arms", "an arm joint's"),
    )
}
_JOINTS = {
    name: Limit(f"least distance of {of} joint from its limits", "rad", bound, comfort, "joint_limits")
    for name, of, bound, comfort in (
        ("hip", "a hip", 0.0, 0.06),
        ("ankle", "an ankle", 0.0, 0.045),
        ("toe", "a toe", 0.0, 0.06),
        ("trunk", "a waist or chest", 0.0, 0.12),
        ("arms", "an arm", -1e-3, 0.05),  # the inverse kinematics may hold an arm at its limit
    )
}
_SUPPORT = "least distance of the ZMP into the support in"
LIMITS: Mapping[str, Limit] = MappingProxyType(
    {
        "mid_stance": Limit(
            "square of the mid-stance speed over v0",
            "1",
            LEAST_MID_STANCE_SHARE**2,
            0.2,
            "mid_stance_too_slow",
        ),
        "zmp_single": Limit(
            f"{_SUPPORT} single support on the whole sole", "m", 0.0, 0.006, "zmp_leaves_support"
        ),
        "zmp_double": Limit(
            f"{_SUPPORT} double support or on the ball",
            "m",
            -ROLL_TOLERANCE,
            -_RISE_TOLERANCE,
            "zmp_leaves_support",
        ),
        "reach": Limit(
            "distance of hip and ankle over the straight leg",
            "1",
            1.0 + LEG_ALLOWANCE,
            0.995,
            "leg_too_short",
        ),
        "floor": Limit("least height of a sole point", "m", -FLOOR_TOLERANCE, 0.0, "sole_under_floor"),
        "clearance": Limit("height of the sole in mid swing", "m", 0.0, 0.006, "sole_under_floor"),
        "turn": Limit("fastest turn of a foot at the floor", "rad/s", 25.0, 10.0, "foot_turns_too_fast"),
        "friction": Limit("horizontal over vertical ground force", "1", 0.6, 0.45, "friction"),
        "knee": Limit("least knee flexion", "rad", KNEE_MINIMUM, 0.35, "knee_too_straight"),
        **_JOINTS,
        **_TORQUES,
    }
)
"""What a choice is judged by."""


@dataclass(frozen=True)
class Certificate:
    """Why nothing was found: the limit that stayed broken, and the best that was reached.

    Attributes:
        limit: name in :data:`LIMITS`, or ``no_periodic_motion``.
        what: what was measured.
        value: best value over all choices that were tried while the other limits were broken least.
        bound: what it should have met.
        unit: of both.
        tried: how many choices had been tried.
        choice: free choices of that best value, by namespaced key.
        where: clause about an easier gait at which the search ended, if it did not reach the one asked for.
    """

    limit: str
    what: str
    value: float
    bound: float
    unit: str
    tried: int
    choice: Mapping[str, float]
    where: str = ""

    def __str__(self) -> str:
        """One clause."""
        if self.limit not in LIMITS:
            return self.what + self.where
        limit = LIMITS[self.limit]
        most = limit.comfort < limit.bound
        unit = "" if self.unit == "1" else f" {self.unit}"
        return (
            f"{self.what} is {self.value:.4g}{unit} at best, {self.tried} choices tried, and must be "
            f"{'at most' if most else 'at least'} {self.bound:.4g}{unit}{self.where}"
        )


@dataclass(frozen=True)
class Tuned:
    """A run whose free choices are made.

    Attributes:
        run: complete.
        plan: with feet and the motion's constant of L_y.
        motion: the periodic step, on the fine grid.
        found: the free choices, by namespaced key.
        margins: limit to value on the search's grid, in the unit of :data:`LIMITS`.
        tried: how many choices were tried.
    """

    run: RunParameters
    plan: GaitPlan
    motion: WholeBodyMotion
    found: Mapping[str, float]
    margins: Mapping[str, float]
    tried: int


def named_keys(run: RunParameters) -> frozenset[str]:
    """Namespaced keys that a preset, a file or a setting named; the others were left at their defaults."""
    return frozenset(
        f"{section}.{key}"
        for section in run.model_fields_set
        for key in getattr(run, section).model_fields_set
    )


# ------------------------------------------------------------------ free choices


@dataclass(frozen=True)
class _Choice:
    """One unknown: its range, and by how much it may leave the guess before that costs one residual."""

    name: str
    lower: float
    upper: float
    slack: float
    keys: tuple[str, ...]


_CHOICES = (
    _Choice("ratio", 0.45, 0.93, 0.08, ("gait.single_support_ratio",)),
    _Choice("roll", 0.0, 1.09, 0.25, ("gait.a_s",)),  # ZMP travel either way, over the ball's distance
    _Choice("height", 0.43, 0.535, 0.02, ("gait.com_height",)),  # in statures
    _Choice("width", 0.062, 0.13, 0.012, ("gait.step_width",)),  # in statures
    _Choice("lean", -0.15, 0.3, 0.1, ("body.lean",)),
    _Choice("toe_off", 0.0, 0.95, 0.15, ("foot.toe_off_angle",)),
    _Choice("toe_turn", 1.2, 2.3, 0.3, ("foot.toe_off_rate",)),  # rate at toe off over the mean rate
    _Choice("toe_back", 0.35, 1.0, 0.15, ("foot.toe_return",)),
    _Choice("strike", 0.0, 0.4, 0.1, ("foot.heel_strike_angle",)),
    _Choice("down", 0.12, 0.95, 0.15, ("foot.full_contact",)),
    _Choice("lift", 0.0, 0.09, 0.02, ("foot.swing_height",)),  # in statures
    _Choice("lag", -0.1, 0.25, 0.06, ("foot.swing_lag",)),
)
DERIVED = ("foot.schedule", "foot.heel_rise_lead", "foot.heel_strike_rate")
"""Keys that follow from the others: the heel rises when the ZMP reaches the ball."""
FREE_KEYS = tuple(key for choice in _CHOICES for key in choice.keys) + DERIVED
"""All keys that tuning may set."""


class _Space:
    """From unknowns to parameters: which choices are free, and what the others are.

    Args:
        run: what was asked for.
        fixed: keys that may not be changed.
        description: the body.
    """

    def __init__(self, run: RunParameters, fixed: Collection[str], description: BodyDescription) -> None:
        self.run, self.fixed, self.description = run, frozenset(fixed), description
        self.sole = description.sole
        self.flat = "foot.schedule" in self.fixed and run.foot.schedule == "flat"
        useless = {"toe_off", "toe_turn", "toe_back", "strike", "down"} if self.flat else set()
        self.free = [
            c for c in _CHOICES if c.name not in useless and not all(key in self.fixed for key in c.keys)
        ]
        self.names = [c.name for c in self.free]
        self.lower = np.array([c.lower for c in self.free])
        self.upper = np.array([c.upper for c in self.free])
        self.slack = np.array([c.slack for c in self.free])

    def easy(self) -> tuple[GaitParameters, ...]:
        """Easy neighbours: without momentum, and then with a step of middle length in an unhurried time."""
        gait, h = self.run.gait, self.description.height
        step = float(np.clip(gait.step_length, 0.12 * h, 0.33 * h))
        speed = step / float(np.clip(step / gait.switching_velocity, 0.45, 0.75))
        plain = gait.model_copy(update={"c_s": 1.0, "c_y": 1.0})
        return plain, plain.model_copy(update={"step_length": step, "switching_velocity": speed})

    def between(self, easy: GaitParameters, share: float) -> _Space:
        """The same space for a gait that is only a share of the way from an easy one [1]."""
        names, gait = ("step_length", "switching_velocity", "c_s", "c_y"), self.run.gait
        there = {
            f"gait.{name}": (1.0 - share) * getattr(easy, name) + share * getattr(gait, name)
            for name in names
        }
        return _Space(self.run.replace(there), self.fixed, self.description)

    def passing(self, x: Array) -> Array:
        """``x`` with share of single support and roll as the guess has them, with which the COM passes.

        Raises:
            MathematicalRefusal: there are none.
        """
        guess, x = self.guess(), x.copy()
        for name in ("ratio", "roll"):
            if name in self.names:
                x[self.names.index(name)] = guess[name]
        return x

    def values(self, x: Array, base: Mapping[str, float]) -> dict[str, float]:
        """All choices by name: the free ones from ``x``, the others from ``base``."""
        return {**base, **dict(zip(self.names, x.tolist(), strict=True))}

    def parameters(self, choice: Mapping[str, float]) -> RunParameters:
        """The run with these choices.

        Raises:
            RefusedGait: the formula has no solution for them.
        """
        run, h, ball = self.run, self.description.height, self.sole.ball_x
        l_s = 0.5 * run.gait.step_length * choice["ratio"]
        travel = choice["roll"] * ball
        table: dict[str, float | str] = {
            "gait.single_support_ratio": choice["ratio"],
            "gait.com_height": choice["height"] * h,
            "gait.step_width": choice["width"] * h,
            "gait.a_s": l_s / travel if travel > 1e-9 else math.inf,
            "body.lean": choice["lean"],
            "foot.swing_height": choice["lift"] * h,
            "foot.swing_lag": choice["lag"],
        }
        run = run.replace({key: value for key, value in table.items() if key not in self.fixed})
        if self.flat:
            return run
        plan = plan_gait(run.gait, mass=run.body.mass)
        double = plan.constants.double_support_duration
        down = self._kept("foot.full_contact", choice["down"])
        strike = self._kept("foot.heel_strike_angle", choice["strike"])
        toe_off = self._kept("foot.toe_off_angle", choice["toe_off"])
        lead = self._kept("foot.heel_rise_lead", _heel_rise_lead(plan, ball))
        run = self._rolling(run, choice, toe_off, strike, down, double, lead)
        if "foot.heel_rise_lead" in self.fixed:
            return run
        late = _later_rise(plan_gait(run.gait, mass=run.body.mass, foot=run.foot, sole=self.sole))
        late = min(late, 0.7 * (double + lead))
        return self._rolling(run, choice, toe_off, strike, down, double, lead - late) if late > 0.0 else run

    def _rolling(
        self,
        run: RunParameters,
        choice: Mapping[str, float],
        toe_off: float,
        strike: float,
        down: float,
        double: float,
        lead: float,
    ) -> RunParameters:
        """Key-frames of the feet for a heel that rises ``lead`` before the double support."""
        table = {
            "foot.schedule": "roll",
            "foot.heel_rise_lead": lead,
            "foot.heel_strike_angle": strike,
            "foot.heel_strike_rate": min(20.0, _LANDING_TURN * strike / (down * double)),
            "foot.full_contact": down,
            "foot.toe_off_angle": toe_off,
            "foot.toe_return": choice["toe_back"],
            "foot.toe_off_rate": min(30.0, choice["toe_turn"] * toe_off / (double + lead)),
        }
        return run.replace({key: value for key, value in table.items() if key not in self.fixed})

    def _kept(self, key: str, value: float) -> float:
        """The value of a key that was named, or else the one that was chosen."""
        section, _, name = key.partition(".")
        return float(getattr(getattr(self.run, section), name)) if key in self.fixed else value

    # ------------------------------------------------------------------- guess

    def guess(self) -> dict[str, float]:
        """Choices by closed-form rules, scaled with stature and step.

        Raises:
            MathematicalRefusal: no share of single support and no roll lets the COM pass over the foot.
        """
        gait, h, sole = self.run.gait, self.description.height, self.sole
        stride = float(np.clip((gait.step_length / h - 0.06) / (0.353 - 0.06), 0.0, 1.2))
        choice = {
            "ratio": 0.79,
            "roll": 1.0,
            "height": 0.505,
            "width": 0.18 / _STATURE,
            "lean": 0.0,
            "toe_off": 0.45 * stride,
            "toe_turn": 1.8,
            "toe_back": 0.8,
            "strike": 0.2 * stride,
            "down": 0.9,
            "lift": 0.05 / _STATURE,
            "lag": 0.08,
        }
        for name, key, scale in (
            ("ratio", "gait.single_support_ratio", 1.0),
            ("height", "gait.com_height", h),
            ("width", "gait.step_width", h),
            ("lean", "body.lean", 1.0),
            ("toe_off", "foot.toe_off_angle", 1.0),
            ("strike", "foot.heel_strike_angle", 1.0),
            ("toe_back", "foot.toe_return", 1.0),
            ("down", "foot.full_contact", 1.0),
            ("lift", "foot.swing_height", h),
            ("lag", "foot.swing_lag", 1.0),
        ):
            choice[name] = self._kept(key, choice[name] * scale) / scale
        l_s = 0.5 * gait.step_length * choice["ratio"]
        # c_s - 1/a_s must stay well above 0: short steps and small c_s let the ZMP roll less.
        choice["roll"] = min(1.0, 0.55 * gait.c_s * l_s / sole.ball_x)
        self._make_pass(choice)
        if "height" in self.names:
            choice["height"] = self._height(choice)
        if not self.flat:
            self._set_down(choice)
        return choice

    def _set_down(self, choice: dict[str, float]) -> None:
        """Bring the front foot down before the ZMP needs more of it than its heel, and not too fast."""
        best = -math.inf
        for down in (choice["down"], 0.7, 0.5, 0.35, 0.2) if "down" in self.names else (choice["down"],):
            trial = {**choice, "down": down}
            try:
                run = self.parameters(trial)
                plan = plan_gait(run.gait, mass=run.body.mass, foot=run.foot, sole=self.sole)
            except RefusedGait:
                return
            if "strike" in self.names:
                fastest = 8.0 * down * plan.constants.double_support_duration / _LANDING_TURN
                trial["strike"] = min(choice["strike"], fastest)
            times, double = _instants(plan)
            margin = float(plan.zmp_margin(times[double]).min())
            if margin > best:
                best, found = margin, trial
            if margin >= LIMITS["zmp_double"].comfort:
                break
        choice.update(found)

    def passes(self, choice: Mapping[str, float]) -> float:
        """Square of the mid-stance speed over v0; the formula needs at least 0.04 [1]."""
        return _mid_stance(self._gait(choice))

    def _gait(self, choice: Mapping[str, float]) -> GaitParameters:
        gait, h = self.run.gait, self.description.height
        l_s = 0.5 * gait.step_length * choice["ratio"]
        travel = choice["roll"] * self.sole.ball_x
        a_s = l_s / travel if travel > 1e-9 else math.inf
        chosen = {"single_support_ratio": choice["ratio"], "com_height": choice["height"] * h, "a_s": a_s}
        kept = {name for name in chosen if f"gait.{name}" in self.fixed}
        return gait.model_copy(update={k: v for k, v in chosen.items() if k not in kept})

    def _make_pass(self, choice: dict[str, float]) -> None:
        """Roll the ZMP farther, then shorten the single support, until the COM passes over the foot.

        Raises:
            MathematicalRefusal: it does not, whatever is chosen.
        """
        wanted, limit = LIMITS["mid_stance"].comfort, LIMITS["mid_stance"].bound
        roll, ratio = (next(c for c in _CHOICES if c.name == name) for name in ("roll", "ratio"))
        gait = self.run.gait
        best, at = -math.inf, dict(choice)
        ratios = np.linspace(choice["ratio"], ratio.lower, 25) if "ratio" in self.names else [choice["ratio"]]
        for share in ratios:
            l_s = 0.5 * gait.step_length * float(share)
            # Beyond c_s l_s the force line would not drive the COM off the foot.
            most = min(roll.upper - 0.05, 0.9 * gait.c_s * l_s / self.sole.ball_x)
            rolls = (
                np.linspace(choice["roll"], most, 7)
                if "roll" in self.names and most > choice["roll"]
                else [choice["roll"]]
            )
            for travel in rolls:
                trial = {**choice, "ratio": float(share), "roll": min(float(travel), max(most, 0.0))}
                value = self.passes(trial)
                if value > best:
                    best, at = value, trial
                if value >= wanted:
                    choice.update(trial)
                    return
        if best < limit:
            gait = self._gait(at)
            least = gait.switching_velocity * math.sqrt((1.0 - best) / (1.0 - limit))
            raise MathematicalRefusal(
                f"gait.switching_velocity = {gait.switching_velocity:.4g} m/s is too slow to pass over the "
                f"foot, whatever is chosen: with {at['ratio']:.0%} of single support and a roll of "
                f"{at['roll'] * self.sole.ball_x:.3g} m it takes {least:.4g} m/s",
                reason="switching_velocity_too_low",
                value=gait.switching_velocity,
                limit=least,
                unit="m/s",
                way_out="raise gait.switching_velocity, shorten gait.step_length or lower gait.c_s",
            )
        choice.update(at)

    def _height(self, choice: Mapping[str, float]) -> float:
        """Highest COM at which the hip and ankle centres stay as near as with a knee bent by 0.6 rad."""
        row = next(c for c in self.free if c.name == "height")
        wanted = math.sqrt(0.5 + 0.5 * math.cos(0.6))  # both segments are about half the leg

        def spare(height: float) -> float:
            run = self.parameters({**choice, "height": height})
            plan = plan_gait(run.gait, mass=run.body.mass, foot=run.foot, sole=self.sole)
            return wanted - _leg_extension(plan, self.description, _instants(plan)[0])

        try:
            top = 0.51
            if spare(top) >= 0.0:
                return top
            if spare(row.lower) <= 0.0:
                return row.lower
            return float(brentq(spare, row.lower, top, xtol=1e-4))
        except RefusedGait:
            return choice["height"]


def _mid_stance(gait: GaitParameters) -> float:
    """Square of the speed over the foot as a share of v0's; negative if the COM does not pass [1]."""
    bracket = gait.c_s - 1.0 / gait.a_s
    l_s = 0.5 * gait.step_length * gait.single_support_ratio
    if bracket <= 0.0:
        return -1.0
    return 1.0 - l_s**2 * bracket * GRAVITY / (gait.com_height * gait.switching_velocity**2)


def _heel_rise_lead(plan: GaitPlan, ball: float) -> float:
    """Time from the ZMP's reaching the standing foot's ball to the double support; negative: after it [s]."""
    times, double = _instants(plan)
    start = float(times[double][0])
    zmp = np.maximum.accumulate(plan.sample(times).zmp[:, 0])
    reached = float(np.interp(ball + 1e-4, zmp, times))  # a little more, for the interpolation's sake
    if reached > start:  # in double support the ZMP is fast: a few millimetres are forgiven
        reached = max(start, float(np.interp(ball - _RISE_TOLERANCE, zmp, times)))
    return start - reached


def _later_rise(plan: GaitPlan) -> float:
    """By how much later the heel must rise to leave the ZMP before the line from ball to front foot [s]."""
    if plan.feet is None:
        raise TypeError("a heel rises from planned feet")
    times, double = _instants(plan)
    times = times[double]
    rear, front = plan.feet.sample(times)
    contact = np.concatenate([rear.contact.repeat(2, axis=1), front.contact.repeat(2, axis=1)], axis=1)
    points = np.concatenate([rear.sole_points[:, :, :2], front.sole_points[:, :, :2]], axis=1)
    zmp = plan.sample(times).zmp
    risen = ~contact[:, 0]
    standing = contact.copy()
    standing[:, :2] = True
    level = points.copy()
    level[:, :2, 0] = points[:, 2:4, 0] + plan.feet.sole.heel_x - plan.feet.sole.ball_x
    without, with_heel = polygon_margin(points, contact, zmp), polygon_margin(level, standing, zmp)
    missed = risen & (without < -_RISE_TOLERANCE) & (with_heel > without + 1e-6)
    return float(times[missed].max() - times[risen].min()) if missed.any() else 0.0


# ------------------------------------------------------------------ margins


def _instants(plan: GaitPlan) -> tuple[Array, NDArray[np.bool_]]:
    """Times of the first step, and which lie in double support."""
    single, double = plan.phases[0], plan.phases[1]
    end = double.start + double.duration * (1.0 - 1e-9)
    times = [np.linspace(0.0, single.duration, 120, endpoint=False), np.linspace(double.start, end, 80)]
    if plan.feet is not None:  # a margin is least just before or after a contact changes
        changes = np.concatenate([plan.feet.left.start, plan.feet.right.start])
        changes = changes[(changes > 1e-6) & (changes < end - 1e-6)]
        times += [changes - 1e-8, changes + 1e-8]
    together = np.sort(np.concatenate(times))
    return together, together >= double.start - 1e-12


def _leg_extension(plan: GaitPlan, description: BodyDescription, times: Array) -> float:
    """Largest distance of hip and ankle centres over the straight leg's; the pelvis upright under the COM."""
    if plan.feet is None:
        raise TypeError("a leg is measured against planned feet")
    sole, com = description.sole, plan.sample(times).com
    longest = 0.0
    for foot, side in zip(plan.feet.sample(times), (1.0, -1.0), strict=True):
        c, s = np.cos(foot.pitch), np.sin(foot.pitch)
        lever = np.stack(
            [
                sole.ankle_x * c + sole.ankle_height * s,
                np.zeros_like(c),
                sole.ankle_height * c - sole.ankle_x * s,
            ],
            axis=1,
        )
        hip = com + np.array([0.0, side * description.hip_half_width, -COM_OVER_HIP * description.height])
        longest = max(longest, float(np.linalg.norm(hip - foot.position - lever, axis=1).max()))
    return longest / description.leg_length


def plan_margins(plan: GaitPlan, run: RunParameters, description: BodyDescription) -> dict[str, float]:
    """What plan and feet alone say, by name in :data:`LIMITS`, in its unit."""
    if plan.feet is None:
        raise TypeError("margins need planned feet")
    times, double = _instants(plan)
    margin = plan.zmp_margin(times)
    sample = plan.sample(times)
    level = ~double & plan.feet.sample(times)[0].contact[:, HEEL]  # a rising heel leaves the ZMP on the edge
    swing = plan.feet.sample(times[~double])[1].sole_points[:, :, 2].min(axis=1)
    points = np.stack([f.sole_points[:, :, 2].min(axis=1) for f in plan.feet.sample(times)])
    share = times[~double] / plan.phases[0].duration
    middle = (share > 0.2) & (share < 0.8)
    force = sample.force
    roll = run.foot.schedule == "roll"
    return {
        "mid_stance": _mid_stance(run.gait),
        "zmp_single": float(margin[level].min()),
        "zmp_double": float(margin[~level].min()),
        "reach": _leg_extension(plan, description, times),
        "floor": float(points.min()),
        "clearance": float(swing[middle].min()),
        "turn": max(run.foot.toe_off_rate, run.foot.heel_strike_rate) if roll else 0.0,
        "friction": float((np.hypot(force[:, 0], force[:, 1]) / force[:, 2]).max()),
    }


def orbit_margins(orbit: RoughOrbit, plan: GaitPlan, robot: Robot) -> dict[str, float]:
    """What the periodic step says, by name in :data:`LIMITS`, in its unit."""
    angles = orbit.trajectory.q[:, 7:]
    margin = np.minimum(angles - robot.lower, robot.upper - angles).min(axis=0)
    share = (np.abs(step_torques(orbit, plan, robot)) / robot.torque_limit).max(axis=0)
    groups = joint_groups(robot)
    values = {name: float(margin[joints].min()) for name, joints in groups.items() if name != "knee"}
    values["knee"] = float(angles[:, groups["knee"]].min())
    return values | {f"{name}_torque": float(share[joints].max()) for name, joints in groups.items()}


def joint_groups(robot: Robot) -> dict[str, NDArray[np.intp]]:
    """Indices of the hinges by what they are: hip, knee, ankle, toe, trunk, arms."""
    legs = robot.description.legs
    names = {
        "hip": [joint for leg in legs for joint in leg.hip],
        "knee": [leg.knee for leg in legs],
        "ankle": [joint for leg in legs for joint in leg.ankle],
        "toe": [leg.toe for leg in legs],
        "trunk": robot.description.trunk,
        "arms": robot.description.arms,
    }
    return {name: robot.velocity_indices(tuple(joints)) - 6 for name, joints in names.items()}


def step_torques(orbit: RoughOrbit, plan: GaitPlan, robot: Robot) -> Array:
    """Joint torques of a periodic step under the ground force that it needs.

    In single support the force is known from the motion; in double support it is shared by the lateral place
    of the ZMP, the rear foot carrying at its ball where its contact allows.

    Args:
        orbit: the step.
        plan: with feet; its first step.
        robot: the body.

    Returns:
        Shape (n+1, nu) [N m].
    """
    if plan.feet is None:
        raise TypeError("torques need planned feet")
    trajectory, time = orbit.trajectory, np.minimum(orbit.reference.time, plan.duration)
    time = time.copy()
    time[-1] = np.nextafter(time[-1], 0.0) - 1e-9  # the step's end, not the next one's start
    sample, feet = plan.sample(time), plan.feet.sample(time)
    torque = np.empty((len(time), robot.nu))
    for k in range(len(time)):
        q, v = trajectory.q[k], trajectory.v[k]
        jacobian = robot.jacobian(q, v).jacobian
        soles = [jacobian[6:12].copy(), jacobian[12:18].copy()]
        total = pin.rnea(robot.model, robot.data, q, v, trajectory.acceleration[k])
        wrench = np.linalg.solve(soles[0][:, :6].T, total[:6])  # force and moment about the left sole
        reference = [feet[0].position[k], feet[1].position[k]]
        share = _right_share(
            sample.phase[k], sample.zmp[k], sample.left_placement[k], sample.right_placement[k]
        )
        centre = _centre(reference[0], wrench)
        places = _places(feet, k, centre[0], share, robot.description.sole.ball_x)
        yaw = (
            wrench[5] - (centre[0] - reference[0][0]) * wrench[1] + (centre[1] - reference[0][1]) * wrench[0]
        )
        rest = total[6:].copy()
        for foot, part in ((0, 1.0 - share), (1, share)):
            if part <= 0.0:
                continue
            force = part * wrench[:3]
            y = centre[1] if share in (0.0, 1.0) else reference[foot][1]
            at = np.array([places[foot], y, 0.0])
            moment = np.cross(at - reference[foot], force)
            moment[2] += part * yaw
            rest -= soles[foot][:3, 6:].T @ force + soles[foot][3:, 6:].T @ moment
            toe = robot.toe_joints[foot] - 6
            axis = reference[foot][0] + robot.description.sole.ball_x * math.cos(feet[foot].pitch[k])
            rest[toe] += max(0.0, places[foot] - axis) * force[2]
        torque[k] = rest
    return torque


def _right_share(phase: int, zmp: Array, left: Array, right: Array) -> float:
    """Share of the ground force under the right foot; the left one stands first."""
    if phase == 0:
        return 0.0
    return float(np.clip((left[1] - zmp[1]) / (left[1] - right[1]), 0.0, 1.0))


def _centre(point: Array, wrench: Array) -> tuple[float, float]:
    """Where on the floor a wrench about ``point`` has no horizontal moment [m]."""
    fx, fy, fz, mx, my = wrench[:5].tolist()
    # Moment about a floor point c: m - (c - p) x f.
    height = point[2]
    return point[0] - (my + height * fx) / fz, point[1] + (mx - height * fy) / fz


def _places(
    feet: tuple[FootSample, FootSample], k: int, centre: float, share: float, ball: float
) -> tuple[float, float]:
    """X at which left (rear) and right (front) foot carry, so that together they carry at ``centre`` [m]."""
    if share in (0.0, 1.0):
        return centre, centre
    (rear_low, rear_high), (front_low, front_high) = (_carrying(f, k) for f in feet)
    rear = float(np.clip(feet[0].position[k, 0] + ball * math.cos(feet[0].pitch[k]), rear_low, rear_high))
    front = float(np.clip((centre - (1.0 - share) * rear) / share, front_low, front_high))
    rear = float(np.clip((centre - share * front) / (1.0 - share), rear_low, rear_high))
    return rear, front


def _carrying(foot: FootSample, k: int) -> tuple[float, float]:
    """First and last x of a foot's points in contact."""
    points = foot.sole_points[k, :, 0]
    touching = points[np.repeat(foot.contact[k], 2)]
    return (float(touching.min()), float(touching.max())) if touching.size else (float(points[0]),) * 2


# ------------------------------------------------------------------ search


@dataclass
class _Trial:
    """One choice that was looked at.

    Attributes:
        x: free unknowns.
        run: complete, None where the formula has no solution.
        values: limit to value; those of the orbit are missing where there is none.
        orbit: the periodic step, if there is one.
        why: why there is none.
    """

    x: Array
    run: RunParameters | None = None
    plan: GaitPlan | None = None
    values: dict[str, float] = field(default_factory=dict)
    orbit: RoughOrbit | None = None
    why: Unreachable | None = None

    @property
    def whole(self) -> bool:
        """Whether all limits have a value."""
        return self.orbit is not None

    def margins(self) -> dict[str, float]:
        """Normalised margins of the limits that have a value."""
        return {name: LIMITS[name].margin(value) for name, value in self.values.items()}

    def worst(self) -> float:
        """Least normalised margin; minus infinity where there is no periodic step."""
        return min(self.margins().values()) if self.whole else -math.inf


class _Search:
    """Least squares over one space.

    Args:
        space: the free choices.
        base: the guess, for what is not free, and to stay near to.
        orbits: solver of periodic steps.
        robot: the body.
        say: called with a line of text now and then.
    """

    def __init__(
        self,
        space: _Space,
        base: Mapping[str, float],
        orbits: RoughOrbits,
        robot: Robot,
        say: Callable[[str], None],
    ) -> None:
        self.space, self.base, self.orbits, self.robot, self.say = space, base, orbits, robot, say
        self.guess = np.clip([base[name] for name in space.names], space.lower, space.upper)
        self.trials: list[_Trial] = []
        self.near: RoughOrbit | None = None
        self._kept: dict[bytes, _Trial] = {}
        self.wanted, self.pull = 1.0, _PULL

    def look(self, x: Array, near: RoughOrbit | None, *, again: bool = False) -> _Trial:
        """Judge one choice, from the orbit of another; ``again`` if that may lead where others did not."""
        key = x.tobytes()
        if key in self._kept and not (again and not self._kept[key].whole):
            return self._kept[key]
        trial = _Trial(np.array(x))
        self._judge(trial, near)
        self._kept[key] = trial
        self.trials.append(trial)
        return trial

    def _judge(self, trial: _Trial, near: RoughOrbit | None) -> None:
        space, description = self.space, self.space.description
        try:
            run = space.parameters(space.values(trial.x, self.base))
            plan = plan_gait(
                run.gait.model_copy(update={"steps": 2}), mass=run.body.mass, foot=run.foot, sole=space.sole
            )
        except RefusedGait:
            return
        trial.run, trial.plan = run, plan
        trial.values = plan_margins(plan, run, description)
        try:
            trial.orbit = self.orbits.solve(plan, run.body.lean, near)
        except Unreachable as error:
            trial.why = error
            return
        trial.values |= orbit_margins(trial.orbit, plan, self.robot)

    def residuals(self, trial: _Trial) -> Array:
        """What is missing to comfort, limit by limit, and the distance to the guess."""
        margins = trial.margins()
        missing = np.array(
            [_missing(margins[name], self.wanted) if name in margins else _FAILED for name in LIMITS]
        )
        if not trial.whole:
            missing = np.maximum(missing, 0.5 * _FAILED)
        return np.concatenate([missing, self.pull * (trial.x - self.guess) / self.space.slack])

    def _value(self, x: Array) -> Array:
        trial = self.look(x, self.near)
        return self.residuals(trial)

    def _jacobian(self, x: Array) -> Array:
        here = self.look(x, self.near)
        if here.orbit is not None:
            self.near = here.orbit
        if here.worst() >= _ENOUGH * self.wanted:
            raise _Comfortable(here)
        base = self.residuals(here)
        jacobian = np.zeros((len(base), len(x)))
        for j in range(len(x)):
            step = _DIFFERENCE * (self.space.upper[j] - self.space.lower[j])
            for sign in (1.0, -1.0) if x[j] + step <= self.space.upper[j] else (-1.0,):
                moved = x.copy()
                moved[j] += sign * step
                if not self.space.lower[j] <= moved[j] <= self.space.upper[j]:
                    continue
                trial = self.look(moved, self.near)
                if trial.whole == here.whole:
                    jacobian[:, j] = (self.residuals(trial) - base) / (sign * step)
                    break
        self.say(f"worst margin {here.worst():.2f} after {len(self.trials)} choices")
        return jacobian

    def minimise(
        self, start: Array, *, wanted: float = 1.0, pull: float = _PULL, sweeps: int = _SWEEPS
    ) -> _Trial:
        """Least squares from a start that has an orbit; the trial with the least residuals."""
        self.wanted, self.pull = wanted, pull
        try:
            found = least_squares(
                self._value,
                np.clip(start, self.space.lower + 1e-9, self.space.upper - 1e-9),
                jac=self._jacobian,
                bounds=(self.space.lower, self.space.upper),
                x_scale=self.space.slack,
                method="trf",
                ftol=5e-3,
                xtol=1e-3,
                gtol=1e-6,
                max_nfev=sweeps,
            )
        except _Comfortable as end:
            return end.trial
        return self.look(found.x, self.near)


class _Comfortable(Exception):
    """The search may end: every margin is wide enough."""

    def __init__(self, trial: _Trial) -> None:
        super().__init__()
        self.trial = trial


def _missing(margin: float, wanted: float) -> float:
    """Shortfall of a margin; far ones grow slowly, so that one hopeless limit does not drown the others."""
    short = max(0.0, wanted - margin)
    return 0.5 * short * (1.0 + short) if short < 2.0 else 3.0 + math.log(short - 1.0)


def tune(
    run: RunParameters,
    robot: Robot,
    *,
    fixed: Collection[str] | None = None,
    progress: Callable[[str], None] | None = None,
    cache: Path | None = None,
) -> Tuned:
    """Make the free choices of a gait.

    Args:
        run: step, speed, c_s, c_y, body, and whatever else is fixed.
        robot: the body.
        fixed: namespaced keys that stay as they are; by default those that were named (:func:`named_keys`).
        progress: called with a line of text now and then.
        cache: folder of solved motions.

    Returns:
        The complete run, its plan and its motion.

    Raises:
        MathematicalRefusal: no choice gives the formula a solution.
        BodilyRefusal: every choice breaks a limit; ``certificate`` says which, and the best that was found.
    """
    say = progress or (lambda text: None)
    space = _Space(run, named_keys(run) if fixed is None else fixed, robot.description)
    guess = space.guess()
    orbits = RoughOrbits(robot, run, _NODES)
    search = _Search(space, guess, orbits, robot, say)
    start = _standing_start(search)
    best = _settle(search, start) if start is not None else None
    farthest: _Farthest | None = None
    for easy in space.easy() if best is None or best.worst() < 0.0 else ():
        way = _follow(easy, search, say)
        if way is not None and (farthest is None or way.share > farthest.share):
            farthest = way
        if farthest is not None and farthest.share == 1.0:
            break
    whole = [trial for trial in search.trials if trial.whole]
    if whole and (best is None or best.worst() < 0.0):
        best = max(whole, key=_Trial.worst)
    if best is None or best.worst() < 0.0:
        raise _refusal(search, best, farthest)
    return _confirmed(search, best, robot, space, cache)


@dataclass
class _Farthest:
    """How far a path from an easy neighbour led.

    Attributes:
        share: of the way [1].
        search: at that place.
        trial: the choice there.
        why: what ended the way.
    """

    share: float
    search: _Search
    trial: _Trial
    why: Unreachable | None = None


def _follow(
    easy: GaitParameters,
    search: _Search,
    say: Callable[[str], None],
) -> _Farthest | None:
    """Come from an easy neighbour: tune it, move a little towards the gait, tune again, and so on.

    Args:
        easy: where to begin.
        search: of the gait that is asked for.
        say: called with a line of text now and then.

    Returns:
        The farthest choice that has a periodic step; None if not even the easy neighbour has.
    """
    space, orbits, robot = search.space, search.orbits, search.robot
    first = space.between(easy, 0.0)
    try:
        here = _Search(first, first.guess(), orbits, robot, say)
    except RefusedGait:
        return None
    start = _standing_start(here)
    if start is None:
        return None
    farthest, stride = _Farthest(0.0, here, here.minimise(start.x, sweeps=5)), 0.5
    while farthest.share < 1.0 and stride > 0.02 and orbits.evaluations < _BUDGET:
        there = min(1.0, farthest.share + stride)
        follow = search
        if there < 1.0:
            place = space.between(easy, there)
            try:
                base = place.guess()
            except RefusedGait:
                base = dict(search.base)
            follow = _Search(place, base, orbits, robot, say)
        trial = _stepped(follow, farthest.trial)
        say(f"{there:.0%} of the way: {'a periodic step' if trial.whole else trial.why or 'no plan'}")
        if not trial.whole:
            farthest.why = trial.why or farthest.why
            stride *= 0.5
            continue
        follow.near = trial.orbit
        best = _settle(follow, trial) if there == 1.0 else follow.minimise(trial.x, sweeps=4)
        if there < 1.0 and best.worst() < 0.0:
            best = _settle(follow, trial)
        farthest = _Farthest(there, follow, best)
        if best.worst() < _HOPELESS:
            break
        stride *= 1.5
    return farthest


def _stepped(follow: _Search, last: _Trial) -> _Trial:
    """The last choice on the way, at the next place; its COM lowered if the legs do not reach otherwise."""
    x = last.x
    trial = follow.look(x, last.orbit, again=True)
    if trial.run is None:
        try:
            x = follow.space.passing(x)
        except RefusedGait:
            return trial
        trial = follow.look(x, last.orbit, again=True)
    if "height" in follow.space.names:
        j = follow.space.names.index("height")
        for drop in _DROPS[1:3]:
            if trial.whole:
                break
            lower = x.copy()
            lower[j] = max(follow.space.lower[j], x[j] - drop)
            trial = follow.look(lower, last.orbit, again=True)
    return trial


def _standing_start(search: _Search) -> _Trial | None:
    """The guess, its COM lowered until there is a periodic step."""
    drops = _DROPS if "height" in search.space.names else _DROPS[:1]
    for drop in drops:
        x = search.guess.copy()
        if drop:
            j = search.space.names.index("height")
            x[j] = max(search.space.lower[j], x[j] - drop)
        trial = search.look(x, None)
        if trial.whole:
            search.near = trial.orbit
            return trial
    return None


def _settle(search: _Search, start: _Trial) -> _Trial:
    """Comfort first; where a limit stays broken, only what the limits need."""
    best = search.minimise(start.x)
    if best.worst() < 0.0:
        search.near = best.orbit or search.near
        harder = search.minimise(best.x if best.whole else start.x, wanted=0.15, pull=0.02)
        if harder.worst() > best.worst():
            best = harder
    whole = [trial for trial in search.trials if trial.whole]
    if best.worst() < 0.0 and whole:
        best = max(whole, key=_Trial.worst)
    return best


def _confirmed(search: _Search, best: _Trial, robot: Robot, space: _Space, cache: Path | None) -> Tuned:
    """The choice with its plan over all steps and its motion on the fine grid."""
    if best.run is None:
        raise TypeError("a choice without a plan cannot be confirmed")
    run = best.run
    plan = plan_gait(run.gait, mass=run.body.mass, foot=run.foot, sole=space.sole)
    check_body(plan, space.description)
    motion = solve_motion(plan, run, robot, cache=cache)
    plan = plan.with_angular_momentum_offset(motion.report.angular_momentum_y_offset)
    return Tuned(
        run=run,
        plan=plan,
        motion=motion,
        found=MappingProxyType(_found(run, space)),
        margins=MappingProxyType(dict(best.values)),
        tried=len(search.trials),
    )


def _found(run: RunParameters, space: _Space) -> dict[str, float]:
    """Free keys and their values."""
    values = {}
    for key in FREE_KEYS:
        if key not in space.fixed:
            section, _, name = key.partition(".")
            values[key] = getattr(getattr(run, section), name)
    return values


class Untunable(BodilyRefusal):
    """No choice was found.

    Attributes:
        certificate: which limit, and the best that was reached.
    """

    def __init__(self, message: str, certificate: Certificate, *, reason: str, way_out: str) -> None:
        super().__init__(
            message,
            reason=reason,
            value=certificate.value,
            limit=certificate.bound,
            unit=certificate.unit,
            way_out=way_out,
        )
        self.certificate = certificate


_WAYS_OUT = {
    **dict.fromkeys(
        (name for name in LIMITS if name.endswith("_torque")),
        "lower gait.switching_velocity, or bring gait.c_s and gait.c_y nearer to 1",
    ),
    "trunk": "bring gait.c_s and gait.c_y nearer to 1",
    "arms": "bring gait.c_s and gait.c_y nearer to 1",
    "friction": "bring gait.c_s nearer to 1 or shorten gait.step_length",
    "mid_stance": "raise gait.switching_velocity, shorten gait.step_length or lower gait.c_s",
}


def _refusal(search: _Search, best: _Trial | None, farthest: _Farthest | None) -> Untunable:
    """The limit that stayed broken in the best of all choices, or where the way to the gait ended."""
    tried = len(search.trials)
    where = ""
    if best is None and farthest is not None:
        best, gait = farthest.trial, farthest.search.space.run.gait
        tried += len(farthest.search.trials)
        where = (
            f" at step {gait.step_length:.3g} m, v0 {gait.switching_velocity:.3g} m/s, c_s {gait.c_s:.3g}, "
            f"c_y {gait.c_y:.3g}, {farthest.share:.0%} of the way from an easy gait; beyond, "
            f"{farthest.why or 'there is no plan'}"
        )
    name = "no_periodic_motion"
    if best is not None and best.whole:
        margins = best.margins()
        tightest = min(margins, key=lambda key: margins[key])
        limit = LIMITS[tightest]
        what, value, bound, unit = limit.what, best.values[tightest], limit.bound, limit.unit
        if not where or margins[tightest] < _TIGHT:
            name = tightest
        elif farthest is not None:
            what, value, bound, unit = "a periodic step is found only", farthest.share, 1.0, "1"
        reason = name if name not in LIMITS else limit.reason
    else:
        best = next((trial for trial in reversed(search.trials) if trial.why is not None), search.trials[-1])
        what, value, bound, unit, reason = "the formula has no solution", 0.0, 0.0, "1", name
        if best.why is not None:
            what, value, bound, unit = str(best.why), best.why.value, best.why.limit, best.why.unit
    found = _found(best.run, search.space) if best.run is not None else {}
    choice = {key: float(value) for key, value in found.items() if isinstance(value, float)}
    certificate = Certificate(
        name, what, float(value), float(bound), unit, tried, MappingProxyType(choice), where
    )
    return Untunable(
        f"no choice of timing, heights and angles lets this body walk the gait: {certificate}",
        certificate,
        reason=reason,
        way_out=_WAYS_OUT.get(name, "shorten gait.step_length, or bring gait.c_s and gait.c_y nearer to 1"),
    )
