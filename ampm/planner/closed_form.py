"""The closed form of a periodic gait: its constants, its laws, and the rules that refuse a gait."""

import math

import numpy as np

from ampm.exceptions import MathematicalRefusal
from ampm.parameters import GRAVITY, GaitParameters
from ampm.planner.centroidal import PlanConstants
from ampm.planner.pendulum import AffineLaw, double_support_root

LEAST_MID_STANCE_SHARE = 0.2
"""Least speed over the foot, as a share of v0: below it the pendulum nearly stops and every error grows."""

LIPM = "lipm"
"""Value of ``gait.planner`` for the closed form of the plain inverted pendulum."""
_PLAIN_SLOPES = {"a_s": math.inf, "c_s": 1.0, "c_y": 1.0}  # ZMP at rest, force through the COM


@np.errstate(all="ignore")  # what overflows is refused for the plan's jumps
def step_laws(gait: GaitParameters) -> tuple[PlanConstants, tuple[AffineLaw, ...], tuple[AffineLaw, ...]]:
    """Constants of a gait, and the laws of its first step, on the left foot (paper, sections 2.1 and 2.2).

    In the sagittal plane continuity of ZMP and force at the switches fixes the double support:
    ``c_s l_s + c_d l_d = l_s + l_d`` (Eq. 4, corrected) and ``l_s/a_s + l_d/a_d = l_s + l_d``. In the frontal
    plane both durations are known, beta is not.

    The plain inverted pendulum (section 1.2; Kajita et al., IROS 2001) has a double support at the velocity
    of the switch: the ground force is vertical and the ZMP under the COM, so both jump at a switch. Its beta
    is what the COM drifts in half a double support, ``beta = v T_DS / 2``.

    The laws of single and double support are those along the walk, then those across it. They count from the
    reference point of the stance foot, and in double support from the middle of both feet's.

    Raises :class:`MathematicalRefusal` if the COM is not driven, or does not pass over the foot fast enough.
    """
    plain = gait.planner == LIPM
    values = gait.model_dump() | (_PLAIN_SLOPES if plain else {})
    # NumPy's numbers: those of too different size give infinities or NaN.
    height, v0, c_s, c_y = (
        np.float64(values[name]) for name in ("com_height", "switching_velocity", "c_s", "c_y")
    )
    inverse_a_s = 1.0 / np.float64(values["a_s"])
    half = 0.5 * np.float64(gait.step_length)
    l_s = half * gait.single_support_ratio
    l_d = half * (1.0 - gait.single_support_ratio)
    bracket = c_s - inverse_a_s
    _refuse_undriven(bracket, c_s, inverse_a_s, c_y)
    _refuse_slow(v0, l_s / np.sqrt(height / (bracket * GRAVITY)))

    # Sagittal plane. By both continuity conditions the brackets of both supports have opposite signs.
    ratio = l_s / l_d
    rate_s = GRAVITY / height * bracket
    rate_d = -rate_s * ratio
    k_s, k_d = np.sqrt(rate_s), np.sqrt(-rate_d)
    reach_s, reach_d = v0 / k_s, v0 / k_d  # v0 T_s, v0 T_d
    odd_s = np.sqrt((reach_s - l_s) * (reach_s + l_s))
    t_ss = 2.0 / k_s * np.arcsinh(l_s / odd_s)
    t_ds = 2.0 * l_d / v0 if plain else 2.0 / k_d * np.arctan2(l_d, reach_d)
    # Written from 1, so that c_s = 1 leaves c_d exactly 1 and the moment exactly zero.
    c_d = 1.0 - (c_s - 1.0) * ratio
    inverse_a_d = 1.0 if plain else 1.0 + (1.0 - inverse_a_s) * ratio
    odd_d = v0 if plain else np.hypot(l_d, reach_d)
    single_x = AffineLaw(rate_s, inverse_a_s, c_s, t_ss, 0.0, odd_s)
    double_x = AffineLaw(0.0 if plain else rate_d, inverse_a_d, c_d, t_ds, 0.0, odd_d)

    # Frontal plane.
    k = np.sqrt(c_y * GRAVITY / height)  # 1 / T_l
    tau = np.tanh(0.5 * k * t_ss)
    rho = np.float64(double_support_root(tau, 0.5 * k * t_ds))  # sqrt(beta / s)
    slope = 1.0 / (rho * rho)
    share = 0.5 * k * t_ds * tau if plain else rho * rho  # beta / s
    s = 0.5 * gait.step_width / (1.0 + share)
    velocity = s * k * tau
    even = -s / np.cosh(0.5 * k * t_ss)
    single_y = AffineLaw(GRAVITY / height if plain else k * k, 0.0, c_y, t_ss, even, 0.0)
    if plain:
        double_y = AffineLaw(0.0, 1.0, 1.0, t_ds, 0.0, -velocity)
    else:
        lateral = -s * rho * np.hypot(rho, tau)
        double_y = AffineLaw(-k * k * slope, 1.0 + slope, 1.0 + (1.0 - c_y) * slope, t_ds, 0.0, lateral)
    constants = {
        "l_s": l_s,
        "l_d": l_d,
        "inverse_a_s": inverse_a_s,
        "a_d": 1.0 / np.float64(inverse_a_d),
        "c_d": c_d,
        "single_support_duration": t_ss,
        "double_support_duration": t_ds,
        "s": s,
        "beta": s * share,
        "lateral_switching_velocity": velocity,
        "mean_velocity": gait.step_length / (t_ss + t_ds),
    }
    floats = {name: float(value) for name, value in constants.items()}
    return PlanConstants(**floats), (single_x, double_x), (single_y, double_y)


def _refuse_undriven(bracket: float, c_s: float, inverse_a_s: float, c_y: float) -> None:
    """Refuse a COM that is not driven off the stance foot, or not back to the midline."""
    if not bracket > 0.0:
        larger_a_s = f" or gait.a_s above {1.0 / c_s:.6g}" if c_s > 0.0 else ""
        raise MathematicalRefusal(
            f"gait.c_s - 1/gait.a_s = {bracket:.6g} must be greater than 0: the COM would not be driven off "
            "the stance foot",
            reason="single_support_not_driven",
            value=float(bracket),
            limit=0.0,
            unit="1",
            way_out=f"raise gait.c_s above {inverse_a_s:.6g}{larger_a_s}",
        )
    if not c_y > 0.0:
        raise MathematicalRefusal(
            f"gait.c_y = {c_y:.6g} must be greater than 0: the COM would not be driven back from the stance "
            "foot to the midline",
            reason="c_y_not_positive",
            value=float(c_y),
            limit=0.0,
            unit="1",
            way_out="choose gait.c_y greater than 0, for example 0.4",
        )


def _refuse_slow(v0: float, least: float) -> None:
    """Refuse a COM that passes over the foot too slowly, or only above the least switching velocity [m/s]."""
    enough = rounded_up(float(least) / math.sqrt(1.0 - LEAST_MID_STANCE_SHARE**2))
    faster = f"raise gait.switching_velocity to {enough} m/s or shorten gait.step_length"
    if not v0 > least:
        raise MathematicalRefusal(
            f"gait.switching_velocity = {v0:.6g} m/s is too slow to pass over the foot: the least is l_s/T_s "
            f"= {least:.6g} m/s",
            reason="switching_velocity_too_low",
            value=float(v0),
            limit=float(least),
            unit="m/s",
            way_out=faster,
        )
    middle, limit = np.sqrt((v0 - least) * (v0 + least)), LEAST_MID_STANCE_SHARE * v0
    if not middle >= limit:
        raise MathematicalRefusal(
            f"the COM would pass over the foot at {middle:.6g} m/s, less than {limit:.6g} m/s, "
            f"{100 * LEAST_MID_STANCE_SHARE:.0f} % of gait.switching_velocity = {v0:.6g} m/s (it passes at "
            f"all from {least:.6g} m/s)",
            reason="mid_stance_too_slow",
            value=float(middle),
            limit=float(limit),
            unit="m/s",
            way_out=faster,
        )


def rounded_up(value: float) -> str:
    """``value`` with four digits, rounded up."""
    if value < 1e-300 or not math.isfinite(value):
        return f"{value:g}"
    unit = 10.0 ** (math.floor(math.log10(value)) - 3)
    return f"{math.ceil(value / unit * (1.0 + 1e-12)) * unit:.4g}"
