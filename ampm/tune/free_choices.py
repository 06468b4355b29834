"""Free choices of a gait, "set manually" in the paper: their ranges, and a first guess."""

import contextlib
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from ampm.body.feasibility import leg_extension
from ampm.body.limits import LIMITS, RISE_TOLERANCE
from ampm.description import BodyDescription
from ampm.exceptions import MathematicalRefusal, RefusedGait
from ampm.geometry import Array, polygon_margin
from ampm.parameters import OPEN_KEYS, GaitParameters, RunParameters
from ampm.planner.centroidal import CentroidalPlan
from ampm.planner.periodic import plan_gait
from ampm.planner.support import StepPlan, plan_steps
from ampm.tune.gait_limits import mid_stance_share, step_instants

_STATURE = 1.70  # of the body on which the guess was made [m]
_HIP_HALF_WIDTH = 0.05  # of that body, as a share of stature [1]
_BETWEEN_SOLES = 0.015  # of the guess, at least [m]
_NEAR_END = 0.99  # share of the sole before and behind the reference point that the ZMP may use [1]
_SWING_RATE = 8.0  # least rate of the swing foot's feedback times the swing's duration: slower, it lands late
_SOFT_STRIKE = 0.5  # heel strike angle of a foot without toes over that of a human's [1]
_LIFT_RATE = 5.0  # most at which a foot without toes begins to turn at lift-off [rad/s]
_FASTEST_LIFT = 30.0  # of foot.toe_off_rate [rad/s]
_LATEST_RISE = 0.7  # share of the time from the ZMP's reaching the edge to lift-off that it may delay a heel
# In which a point opens: share of the double support, with toes and without [1], and at most [s].
_RAMP, _RAMP_WITHOUT_TOES, _LONGEST_RAMP = 0.35, 0.5, 0.09
_LANDING_TURN = 1.7  # heel strike rate over its mean: the foot comes down turning, and slows down


@dataclass(frozen=True)
class Choice:
    """One unknown."""

    name: str  # of the unknown
    key: str  # parameter that it sets
    lower: float  # end of the range; in statures if `scaled`
    upper: float  # the other end
    slack: float  # deviation from the guess that costs one residual
    guess: float  # where a search begins
    scaled: bool = False  # whether the parameter is the unknown times the stature
    derived: bool = False  # whether the parameter follows from this unknown and others


CHOICES = (
    Choice("ratio", "gait.single_support_ratio", 0.25, 0.93, 0.08, 0.79),
    # ZMP travel either way, over the ball's distance:
    Choice("roll", "gait.a_s", 0.0, 1.09, 0.25, 1.0, derived=True),
    Choice("height", "gait.com_height", 0.43, 0.535, 0.02, 0.505, scaled=True),
    Choice("width", "gait.step_width", 0.062, 0.13, 0.012, 0.18 / _STATURE, scaled=True),
    Choice("lean", "body.lean", -0.15, 0.3, 0.1, 0.0),
    Choice("list", "body.pelvis_list", -0.3, 0.3, 0.1, 0.0),
    Choice("rotation", "body.pelvis_rotation", -0.1, 0.4, 0.1, 0.0),
    Choice("spread", "body.arm_abduction", 0.0, 0.8, 0.1, 0.1),
    Choice("toe_off", "foot.toe_off_angle", 0.0, 1.15, 0.15, 0.45),  # the guess is of a step of middle length
    # Delay of the heel's rise, as a share of what is left of the double support. When the ZMP reaches the
    # front edge of a foot without toes, this edge would carry the whole weight.
    Choice("rise", "foot.heel_rise_lead", 0.0, 0.7, 0.2, 0.4, derived=True),
    # Rate at toe off over the mean rate:
    Choice("toe_turn", "foot.toe_off_rate", 1.0, 2.3, 0.3, 1.8, derived=True),
    Choice("toe_back", "foot.toe_return", 0.35, 1.0, 0.15, 0.8),
    Choice("strike", "foot.heel_strike_angle", 0.0, 0.6, 0.1, 0.2),
    Choice("down", "foot.full_contact", 0.12, 0.95, 0.15, 0.9),
    Choice("lift", "foot.swing_height", 0.0, 0.09, 0.02, 0.05 / _STATURE, scaled=True),
    Choice("lag", "foot.swing_lag", -0.1, 0.25, 0.06, 0.08),
)
"""More open keys follow: a heel with toes rises when the ZMP reaches the ball (``foot.heel_rise_lead``), the
front foot comes down turning (``foot.heel_strike_rate``), the swing foot's feedback is fast beside the swing
(``controller.swing_stiffness``, ``controller.swing_damping``), the load goes from foot to foot in the double
support (``controller.contact_ramp``), and L_z is held at zero where the feet could not hold its swing
(``body.angular_momentum_z``)."""
_ROLLING = {"toe_off", "rise", "toe_turn", "toe_back", "strike", "down"}  # without effect on flat feet
_SPREAD = {
    "ratio": (-0.45, 0.1),
    "height": (-0.5, 0.05),
    "width": (-0.45, 0.05),
    "toe_off": (-0.05, 0.45),
    "rise": (-0.7, 0.1),
    "strike": (-0.05, 0.4),
    "list": (-0.4, 0.4),
    "rotation": (0.0, 0.6),
}
"""Where other starts lie about the guess, as shares of a choice's range: mostly where the legs reach."""
_RANGE = {choice.name: choice for choice in CHOICES}


class FreeChoices:
    """Turns unknowns into parameters: the free choices, and the values of the others.

    Args:
        run: the request.
        fixed: keys that may not be changed.
        description: the body.
        held: open keys that keep the guess.
    """

    def __init__(
        self,
        run: RunParameters,
        fixed: Collection[str],
        description: BodyDescription,
        held: Collection[str] = (),
    ) -> None:
        self.run, self.fixed, self.description = run, frozenset(fixed), description
        self.sole = description.sole
        self.ramp = _RAMP if self.sole.has_toes else _RAMP_WITHOUT_TOES
        self.flat = run.foot.schedule == "flat"
        self.useless = (_ROLLING if self.flat else set()) | (set() if description.spread else {"spread"})
        kept, idle = self.fixed.union(held), self.useless | ({"rise"} if self.sole.has_toes else set())
        free = [choice for choice in CHOICES if choice.key not in kept and choice.name not in idle]
        self.names = [choice.name for choice in free]
        self.lower = np.array([choice.lower for choice in free])
        self.upper = np.array([choice.upper for choice in free])
        self.slack = np.array([choice.slack for choice in free])
        # Between hips as wide as the body's and a human's: a wide step makes a long arm of a landing's force.
        self.wide = math.sqrt(description.hip_half_width / (_HIP_HALF_WIDTH * description.height))
        upright = description.upright
        beside = upright.width if upright else 2.0 * self.sole.half_width + _BETWEEN_SOLES
        self.wide = max(self.wide, beside / (_RANGE["width"].guess * description.height))
        # The sole ends behind and before the reference point.
        self.most_roll = min(
            _RANGE["roll"].upper, _NEAR_END * min(-self.sole.heel_x, self.sole.tip_x) / self.sole.ball_x
        )

    def lowered(self, x: Array, drop: float) -> Array:
        """``x`` with the COM lower by ``drop`` [statures], within its range, if it is free."""
        is_height = [name == "height" for name in self.names]
        return np.where(is_height, np.maximum(self.lower, x - drop), x)

    def spread(self, guess: Array, number: int) -> Array:
        """Choices about a guess, evenly spread (Sobol) and always the same, shape (number, choices)."""
        from scipy.stats import qmc  # takes nearly a second to import

        low, high = np.array([_SPREAD.get(name, (-0.3, 0.3)) for name in self.names]).T
        share = low + (high - low) * qmc.Sobol(len(self.names), rng=0).random(number)
        return np.clip(guess + share * (self.upper - self.lower), self.lower, self.upper)

    def values(self, run: RunParameters) -> dict[str, float | str]:
        """Free keys and their values in a run with choices."""
        idle = {_RANGE[name].key for name in self.useless}
        if self.flat:
            idle.add("foot.heel_strike_rate")
        return {key: run.value(key) for key in OPEN_KEYS if key not in self.fixed | idle}

    def parameters(self, choice: Mapping[str, float]) -> RunParameters:
        """The run with these choices; raises RefusedGait if the formula has no solution for them."""
        h, ball = self.description.height, self.sole.ball_x
        run = self._with_free(
            self.run,
            {
                **self._timing(choice),
                "gait.step_width": choice["width"] * h * self.wide,
                "body.lean": choice["lean"],
                "body.pelvis_list": choice["list"],
                "body.pelvis_rotation": choice["rotation"],
                "body.arm_abduction": choice["spread"],
                "foot.swing_height": choice["lift"] * h,
                "foot.swing_lag": choice["lag"],
            },
        )
        plan = plan_gait(run.gait.model_copy(update={"steps": 2}), run.body.mass)
        gains, swing = self.run.controller, plan.constants.single_support_duration
        double = plan.constants.double_support_duration
        faster = max(1.0, _SWING_RATE / (swing * math.sqrt(max(gains.swing_stiffness, 1.0))))
        run = self._with_free(
            run,
            {
                "controller.swing_stiffness": gains.swing_stiffness * faster**2,
                "controller.swing_damping": gains.swing_damping * faster,
                "controller.contact_ramp": min(self.ramp * double, _LONGEST_RAMP),
            },
        )
        if self.flat:
            return run
        lead = self._set_or("foot.heel_rise_lead", _heel_rise_lead(plan, ball))
        rolling = self._rolling(run, choice, double, lead)
        if "foot.heel_rise_lead" in self.fixed:
            return rolling
        rest = double + lead
        late = min(_later_rise(self.first_steps(rolling)), _LATEST_RISE * rest)
        late += choice["rise"] * (rest - late)
        return self._rolling(rolling, choice, double, lead - late) if late > 0.0 else rolling

    def first_steps(self, run: RunParameters) -> StepPlan:
        """Plan of the first two steps of a run, which are like all others."""
        return plan_steps(run.gait.model_copy(update={"steps": 2}), run.body.mass, run.foot, self.sole)

    def _rolling(
        self, run: RunParameters, choice: Mapping[str, float], double: float, lead: float
    ) -> RunParameters:
        """Key-frames of the feet for a heel that rises ``lead`` before a double support of ``double`` [s]."""
        down, strike, toe_off = choice["down"], choice["strike"], choice["toe_off"]
        return self._with_free(
            run,
            {
                "foot.heel_rise_lead": lead if toe_off else 0.0,
                "foot.heel_strike_angle": strike,
                "foot.heel_strike_rate": min(20.0, _LANDING_TURN * strike / (down * double)),
                "foot.full_contact": down,
                "foot.toe_off_angle": toe_off,
                "foot.toe_return": choice["toe_back"],
                "foot.toe_off_rate": min(_FASTEST_LIFT, choice["toe_turn"] * toe_off / (double + lead)),
            },
        )

    def _with_free(self, run: RunParameters, values: Mapping[str, float | str]) -> RunParameters:
        """The run with other values where they are free, not validated: all ranges are within the bounds."""
        sections: dict[str, dict[str, float | str]] = {}
        for key, value in values.items():
            if key not in self.fixed:
                section, _, name = key.partition(".")
                sections.setdefault(section, {})[name] = value
        changed = {name: getattr(run, name).model_copy(update=new) for name, new in sections.items()}
        return run.model_copy(update=changed)

    def _set_or(self, key: str, value: float) -> float:
        """The value of a key that is set, or else the one that was chosen."""
        return float(self.run.value(key)) if key in self.fixed else value

    def guess(self) -> dict[str, float]:
        """Choices by closed-form rules, scaled with stature and step; those of set values are these.

        Raises MathematicalRefusal if no share of single support and no roll lets the COM pass over the foot.
        """
        gait, h = self.run.gait, self.description.height
        stride = float(np.clip((gait.step_length / h - 0.06) / (0.353 - 0.06), 0.0, 1.2))
        choice = {item.name: item.guess for item in CHOICES}
        if self.sole.has_toes:
            choice["rise"] = 0.0
        choice["toe_off"] *= stride
        choice["strike"] *= stride if self.sole.has_toes else _SOFT_STRIKE * stride
        for item in CHOICES:
            if not item.derived:
                scale = h if item.scaled else 1.0
                scale *= self.wide if item.name == "width" else 1.0
                choice[item.name] = self._set_or(item.key, choice[item.name] * scale) / scale
        l_s = 0.5 * gait.step_length * choice["ratio"]
        # c_s - 1/a_s must stay well above 0: short steps and small c_s let the ZMP roll less.
        choice["roll"] = min(1.0, self.most_roll - 0.05, 0.55 * gait.c_s * l_s / self.sole.ball_x)
        choice = self._passing_choice(choice)
        if self._lift_rate(choice) >= _FASTEST_LIFT:  # the step is shorter than the foot: no heel rises
            choice["toe_off"] = 0.0
        # A foot without toes turns less: its heel rises late, and so in a short time.
        choice["toe_off"] *= min(1.0, _LIFT_RATE / max(self._lift_rate(choice), 1e-9))
        if "height" in self.names:
            choice["height"] = self._height(choice)
        return choice if self.flat else self._set_down(choice)

    def _lift_rate(self, choice: Mapping[str, float]) -> float:
        """Rate at which a foot without toes begins to turn at lift-off [rad/s]; 0 where it is set."""
        if not (self.sole.has_toes or self.flat or "toe_off" not in self.names):
            with contextlib.suppress(RefusedGait):
                return self.parameters(choice).foot.toe_off_rate
        return 0.0

    def _set_down(self, choice: dict[str, float]) -> dict[str, float]:
        """Bring the front foot down before the ZMP needs more of it than its heel, and not too fast."""
        best, best_choice = -math.inf, choice
        for down in (choice["down"], 0.7, 0.5, 0.35, 0.2) if "down" in self.names else (choice["down"],):
            trial = {**choice, "down": down}
            try:
                plan = self.first_steps(self.parameters(trial))
            except RefusedGait:
                return choice
            if "strike" in self.names:
                fastest = 8.0 * down * plan.constants.double_support_duration / _LANDING_TURN
                trial["strike"] = min(choice["strike"], fastest)
            times, double = step_instants(plan)
            margin = float(plan.zmp_margin(times[double]).min())
            if margin > best:
                best, best_choice = margin, trial
            if margin >= LIMITS["zmp_double"].target:
                break
        return best_choice

    def _timing(self, choice: Mapping[str, float]) -> dict[str, float]:
        """Keys that decide whether the COM passes over the foot."""
        l_s = 0.5 * self.run.gait.step_length * choice["ratio"]
        travel = choice["roll"] * self.sole.ball_x
        return {
            "gait.single_support_ratio": choice["ratio"],
            "gait.com_height": choice["height"] * self.description.height,
            "gait.a_s": l_s / travel if travel > 1e-9 else math.inf,
        }

    def longest(self) -> GaitParameters:
        """The gait with the choices that give its step the longest duration."""
        ratio, height = _RANGE["ratio"].upper, _RANGE["height"].lower
        return self._gait({"ratio": ratio, "roll": 0.0, "height": height})

    def _gait(self, choice: Mapping[str, float]) -> GaitParameters:
        return self._with_free(self.run, self._timing(choice)).gait

    def _passing_choice(self, choice: Mapping[str, float]) -> dict[str, float]:
        """Roll the ZMP farther, then shorten the single support, until the COM passes over the foot."""
        wanted, limit = LIMITS["mid_stance"].target, LIMITS["mid_stance"].bound
        gait, ratio, roll = self.run.gait, choice["ratio"], choice["roll"]
        best, best_choice = -math.inf, dict(choice)
        ratios = np.linspace(ratio, _RANGE["ratio"].lower, 25) if "ratio" in self.names else [ratio]
        for share in ratios:
            l_s = 0.5 * gait.step_length * float(share)
            # Beyond c_s l_s the force line would not drive the COM off the foot.
            most = min(self.most_roll - 0.05, 0.9 * gait.c_s * l_s / self.sole.ball_x)
            farther = "roll" in self.names and most > roll
            for longer in np.linspace(roll, most, 7) if farther else [roll]:
                trial = {**choice, "ratio": float(share), "roll": min(float(longer), max(most, 0.0))}
                value = mid_stance_share(self._gait(trial))
                if value > best:
                    best, best_choice = value, trial
                if value >= wanted:
                    return trial
        if best < limit:
            gait = self._gait(best_choice)
            if not gait.c_s > 1.0 / gait.a_s:
                plan_gait(gait, self.run.body.mass)  # refuses a force line that pulls the COM back
            least = gait.switching_velocity * math.sqrt((1.0 - best) / (1.0 - limit))
            raise MathematicalRefusal(
                f"gait.switching_velocity = {gait.switching_velocity:.4g} m/s is too slow to pass over the "
                f"foot, whatever is chosen: with {100 * best_choice['ratio']:.0f} % of single support and a "
                f"roll of {best_choice['roll'] * self.sole.ball_x:.3g} m it takes {least:.5g} m/s",
                reason="switching_velocity_too_low",
                value=gait.switching_velocity,
                limit=least,
                unit="m/s",
                way_out="raise gait.switching_velocity, shorten gait.step_length or lower gait.c_s",
            )
        return best_choice

    def _height(self, choice: Mapping[str, float]) -> float:
        """Highest COM at which the hip and ankle centres stay as near as with a knee bent by 0.6 rad."""
        wanted = math.sqrt(0.5 + 0.5 * math.cos(0.6))  # both segments are about half the leg
        lowest, top = _RANGE["height"].lower, 0.51

        def spare(height: float) -> float:
            plan = self.first_steps(self.parameters({**choice, "height": height}))
            times = step_instants(plan)[0]
            return wanted - leg_extension(plan.sample(times).com, plan.feet.sample(times), self.description)

        try:
            if spare(top) >= 0.0:
                return top
            if spare(lowest) <= 0.0:
                return lowest
            return float(brentq(spare, lowest, top, xtol=1e-4))
        except RefusedGait:
            return choice["height"]


def _heel_rise_lead(plan: CentroidalPlan, ball: float) -> float:
    """Time from the ZMP's reaching the standing foot's ball to the double support; negative: after it [s]."""
    times, double = step_instants(plan)
    start = float(times[double][0])
    zmp = np.maximum.accumulate(plan.sample(times).zmp[:, 0])
    reached = float(np.interp(ball + 1e-4, zmp, times))  # a little more, for the interpolation
    if reached > start:  # in double support the ZMP is fast: tolerance of a few millimetres
        reached = max(start, float(np.interp(ball - RISE_TOLERANCE, zmp, times)))
    return start - reached


def _later_rise(plan: StepPlan) -> float:
    """Delay of the heel's rise that keeps the ZMP before the line from ball to front foot [s]."""
    times, double = step_instants(plan)
    times = times[double]
    points, contact = plan.points_in_contact(times)
    zmp = plan.sample(times).zmp
    risen = ~contact[:, 0]
    without = polygon_margin(points, contact, zmp)
    missed = risen & (without < -RISE_TOLERANCE)
    flat_contact, flat_points = contact.copy(), points.copy()
    flat_contact[:, :2] = True
    flat_points[:, :2, 0] = points[:, 2:4, 0] + plan.feet.sole.heel_x - plan.feet.sole.ball_x
    missed &= polygon_margin(flat_points, flat_contact, zmp) > without + 1e-6
    return float(times[missed].max() - times[risen].min()) if missed.any() else 0.0
