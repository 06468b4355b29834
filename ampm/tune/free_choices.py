"""What the paper leaves to be "set manually": the free choices of a gait, their ranges, and a first guess."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import brentq

from ampm.exceptions import MathematicalRefusal, RefusedGait
from ampm.geometry import polygon_margin
from ampm.parameters import GaitParameters, RunParameters
from ampm.planner.centroidal import CentroidalPlan
from ampm.planner.periodic import plan_gait
from ampm.planner.support import StepPlan, plan_steps
from ampm.tune.gait_limits import LIMITS, RISE_TOLERANCE, leg_extension, mid_stance_share, step_instants

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.description import BodyDescription

    Array = NDArray[np.float64]

_STATURE = 1.70  # of the body on which the guess was made [m]
_LANDING_TURN = 1.7  # heel strike rate over its mean: the foot comes down turning, and slows down


def named_keys(run: RunParameters) -> frozenset[str]:
    """Namespaced keys that a preset, a file or a setting named; the others were left at their defaults."""
    return frozenset(
        f"{section}.{key}"
        for section in run.model_fields_set
        for key in getattr(run, section).model_fields_set
    )


@dataclass(frozen=True)
class Choice:
    """One unknown: its range, and by how much it may leave the guess before that costs one residual."""

    name: str
    lower: float
    upper: float
    slack: float
    keys: tuple[str, ...]


CHOICES = (
    Choice("ratio", 0.45, 0.93, 0.08, ("gait.single_support_ratio",)),
    Choice("roll", 0.0, 1.09, 0.25, ("gait.a_s",)),  # ZMP travel either way, over the ball's distance
    Choice("height", 0.43, 0.535, 0.02, ("gait.com_height",)),  # in statures
    Choice("width", 0.062, 0.13, 0.012, ("gait.step_width",)),  # in statures
    Choice("lean", -0.15, 0.3, 0.1, ("body.lean",)),
    Choice("toe_off", 0.0, 0.95, 0.15, ("foot.toe_off_angle",)),
    Choice("toe_turn", 1.2, 2.3, 0.3, ("foot.toe_off_rate",)),  # rate at toe off over the mean rate
    Choice("toe_back", 0.35, 1.0, 0.15, ("foot.toe_return",)),
    Choice("strike", 0.0, 0.4, 0.1, ("foot.heel_strike_angle",)),
    Choice("down", 0.12, 0.95, 0.15, ("foot.full_contact",)),
    Choice("lift", 0.0, 0.09, 0.02, ("foot.swing_height",)),  # in statures
    Choice("lag", -0.1, 0.25, 0.06, ("foot.swing_lag",)),
)
DERIVED = ("foot.schedule", "foot.heel_rise_lead", "foot.heel_strike_rate", "body.angular_momentum_z")
"""Keys that follow: the heel rises when the ZMP reaches the ball, and L_z is held at zero where
the feet could not hold its swing."""
FREE_KEYS = tuple(key for choice in CHOICES for key in choice.keys) + DERIVED
"""All keys that tuning may set."""


class FreeChoices:
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
            c for c in CHOICES if c.name not in useless and not all(key in self.fixed for key in c.keys)
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

    def between(self, easy: GaitParameters, share: float) -> FreeChoices:
        """The same space for a gait that is only a share of the way from an easy one [1]."""
        names, gait = ("step_length", "switching_velocity", "c_s", "c_y"), self.run.gait
        there = {
            f"gait.{name}": (1.0 - share) * getattr(easy, name) + share * getattr(gait, name)
            for name in names
        }
        return FreeChoices(self.run.replace(there), self.fixed, self.description)

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
        plan = plan_gait(run.gait, run.body.mass)
        double = plan.constants.double_support_duration
        down = self._kept("foot.full_contact", choice["down"])
        strike = self._kept("foot.heel_strike_angle", choice["strike"])
        toe_off = self._kept("foot.toe_off_angle", choice["toe_off"])
        lead = self._kept("foot.heel_rise_lead", _heel_rise_lead(plan, ball))
        run = self._rolling(run, choice, toe_off, strike, down, double, lead)
        if "foot.heel_rise_lead" in self.fixed:
            return run
        late = _later_rise(plan_steps(run.gait, run.body.mass, run.foot, self.sole))
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
                plan = plan_steps(run.gait, run.body.mass, run.foot, self.sole)
            except RefusedGait:
                return
            if "strike" in self.names:
                fastest = 8.0 * down * plan.constants.double_support_duration / _LANDING_TURN
                trial["strike"] = min(choice["strike"], fastest)
            times, double = step_instants(plan)
            margin = float(plan.zmp_margin(times[double]).min())
            if margin > best:
                best, found = margin, trial
            if margin >= LIMITS["zmp_double"].comfort:
                break
        choice.update(found)

    def passes(self, choice: Mapping[str, float]) -> float:
        """Square of the mid-stance speed over v0; the formula needs at least 0.04 [1]."""
        return mid_stance_share(self._gait(choice))

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
        roll, ratio = (next(c for c in CHOICES if c.name == name) for name in ("roll", "ratio"))
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
                f"{at['roll'] * self.sole.ball_x:.3g} m it takes {least:.5g} m/s",
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
            plan = plan_steps(run.gait, run.body.mass, run.foot, self.sole)
            return wanted - leg_extension(plan, self.description, step_instants(plan)[0])

        try:
            top = 0.51
            if spare(top) >= 0.0:
                return top
            if spare(row.lower) <= 0.0:
                return row.lower
            return float(brentq(spare, row.lower, top, xtol=1e-4))
        except RefusedGait:
            return choice["height"]


def _heel_rise_lead(plan: CentroidalPlan, ball: float) -> float:
    """Time from the ZMP's reaching the standing foot's ball to the double support; negative: after it [s]."""
    times, double = step_instants(plan)
    start = float(times[double][0])
    zmp = np.maximum.accumulate(plan.sample(times).zmp[:, 0])
    reached = float(np.interp(ball + 1e-4, zmp, times))  # a little more, for the interpolation's sake
    if reached > start:  # in double support the ZMP is fast: a few millimetres are forgiven
        reached = max(start, float(np.interp(ball - RISE_TOLERANCE, zmp, times)))
    return start - reached


def _later_rise(plan: StepPlan) -> float:
    """By how much later the heel must rise to leave the ZMP before the line from ball to front foot [s]."""
    times, double = step_instants(plan)
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
    missed = risen & (without < -RISE_TOLERANCE) & (with_heel > without + 1e-6)
    return float(times[missed].max() - times[risen].min()) if missed.any() else 0.0
