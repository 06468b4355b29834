"""Planners of periodic steps by name: the AMPM, and ZMP planners of others.

Those of others are the cart-table, ``u'' = (g/H) (u - p)``: the ground force passes through the COM, and the
angular momentum about it is constant. They differ in the ZMP ``p``.

- ``lipm``, the plain inverted pendulum (Kajita et al., "The 3D linear inverted pendulum mode", IROS 2001; the
  IPM of Kudoh & Komura, IROS 2003, section 1.2): at rest under the foot, then under the COM; the gait's speed
  at the switches gives the durations.

The others have footsteps, times and feet of the AMPM's plan. In single support the ZMP goes from heel to toe
of the stance foot as far as there (``l_s / a_s`` to either side of the reference point, as feet that roll
need), here linearly in time, and rests in the frontal plane. In double support it goes to the other foot.

- ``ipm``: the plain inverted pendulum at these times; its ZMP rests under the foot.
- ``preview`` (Kajita et al., "Biped walking pattern generation by using preview control of zero-moment
  point", ICRA 2003): linear in time in double support, too; the least jerk follows it.
- ``dcm`` (Englsberger, Ott & Albu-Schaeffer, "Three-dimensional bipedal walking control based on divergent
  component of motion", IEEE T-RO 31(2), 2015): closed form in single support, a cubic in double support.

Walks are periodic, as the AMPM's: the state that returns mirrored after a step is solved for.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from ampm.description import SoleGeometry
from ampm.parameters import FootParameters, GaitParameters
from ampm.planner.centroidal import CentroidalPhase
from ampm.planner.closed_form import LIPM
from ampm.planner.sampled import SampledLaw, plan_constants
from ampm.planner.support import StepPlan, plan_steps

Array = NDArray[np.float64]

SAMPLE_TIME = 0.005
"""Sampling time of preview control [s], of Kajita et al.; adapted to a whole number of samples in a step."""
DCM_SAMPLE_TIME = 0.001
"""Largest time between samples of a DCM plan, between which its ZMP is linear [s]."""
PREVIEW_TIME = 3.2
"""Time for which preview control sees the ZMP in advance [s]; with half of it, as in that paper, the ZMP
stays 2.5 mm behind at 0.9 m/s."""
JERK_WEIGHT = 1e-6
"""Weight R of the squared change of jerk over that of the squared ZMP error [s^6], of that paper."""


class _Axis(NamedTuple):
    """ZMP of one axis in one step, and how the step returns: times ``sign``, plus ``shift``.

    Attributes:
        begin, end: ZMP at the ends of single support [m].
        sign: 1 or, where the step returns mirrored, -1.
        shift: [m].
    """

    begin: float
    end: float
    sign: float
    shift: float

    @property
    def next(self) -> float:
        """ZMP at the start of the next single support [m]."""
        return self.sign * self.begin + self.shift

    def returned(self, value: Array, step: NDArray[Any]) -> Array:
        """A position of the first step in later ones."""
        moved: Array = self.sign**step * value + step * self.shift
        return moved


def step_axes(steps: StepPlan) -> tuple[_Axis, _Axis]:
    """Sagittal and frontal plane of a gait's first step, from the reference point of the stance foot."""
    constants, contacts = steps.constants, steps.contacts
    roll, half = constants.l_s * constants.inverse_a_s, 0.5 * contacts.step_width
    return _Axis(-roll, roll, 1.0, contacts.step_length), _Axis(half, half, -1.0, 0.0)


def _repeated(steps: StepPlan, times: Array, motions: Sequence[Array]) -> StepPlan:
    """The same steps with another motion of the COM, the mirror image of its first step in every step.

    Args:
        steps: contacts and feet.
        times: of samples of the first step, from its start on, shape (n,) [s].
        motions: COM, velocity and acceleration along x and y at these times, shapes (3, n).
    """
    duration, length = steps.constants.step_duration, steps.contacts.step_length
    laws, ends = [], np.append(times, duration)
    for axis, motion in zip(step_axes(steps), motions, strict=True):
        returned = axis.sign * motion[:, :1] + np.array([[axis.shift], [0.0], [0.0]])
        position, velocity, acceleration = np.hstack([motion, returned])
        zmp = position - steps.com_height / steps.gravity * acceleration
        laws.append(SampledLaw(ends, position, velocity, acceleration, zmp, np.zeros(len(ends))))
    x, y = laws
    mirrored = SampledLaw(ends, -y.position, -y.velocity, -y.acceleration, -y.zmp, y.moment_arm)
    phases = [
        CentroidalPhase(k * duration, duration, (k * length, 0.0), x, mirrored if k % 2 else y, (0.0, 0.0))
        for k in range(steps.contacts.steps)
    ]
    plan = replace(steps, phases=tuple(phases))
    switch = plan.sample(plan.contacts.starts[1])
    return replace(plan, constants=plan_constants(plan), switching_velocity=float(switch.com_velocity[0, 0]))


# -------------------------------------------------------------------------------------------------- IPM


def ipm_steps(gait: GaitParameters, mass: float, foot: FootParameters, sole: SoleGeometry) -> StepPlan:
    """The plain inverted pendulum; its speed at the switches is that which gives the gait's durations.

    With ``k = sqrt(g/H)``, half the travel in single support is ``l_s = v0 tanh(k T_SS/2) / k``, in double
    support ``v0 T_DS / 2``, and together they are half a step.

    Raises:
        InputError, MathematicalRefusal: as :func:`ampm.planner.support.plan_steps`.
    """
    steps = plan_steps(gait, mass, foot, sole)
    single, double = steps.constants.single_support_duration, steps.constants.double_support_duration
    k = math.sqrt(steps.gravity / steps.com_height)
    travel = math.tanh(0.5 * k * single) / k
    timed = {
        "switching_velocity": 0.5 * gait.step_length / (travel + 0.5 * double),
        "single_support_ratio": travel / (travel + 0.5 * double),
    }
    return lipm_steps(GaitParameters(**(gait.model_dump() | timed)), mass, foot, sole)


def lipm_steps(gait: GaitParameters, mass: float, foot: FootParameters, sole: SoleGeometry) -> StepPlan:
    """The plain inverted pendulum in closed form, with the gait's speed at the switches.

    Raises:
        InputError, MathematicalRefusal: as :func:`ampm.planner.support.plan_steps`.
    """
    return plan_steps(gait.model_copy(update={"planner": LIPM}), mass, foot, sole)


# -------------------------------------------------------------------------------------------------- DCM


def dcm_steps(gait: GaitParameters, mass: float, foot: FootParameters, sole: SoleGeometry) -> StepPlan:
    """DCM planning: ``xi = u + u'/w`` diverges from the ZMP, ``xi' = w (xi - p)``, and the COM follows it.

    In single support ``xi`` is closed form. For the recursion the ZMP changes feet at once in the middle of
    the double support (equal shares of it before and after). Then the double support becomes a cubic of
    ``xi`` that meets value and rate at both ends, so that the ZMP is continuous.

    Raises:
        InputError, MathematicalRefusal: as :func:`ampm.planner.support.plan_steps`.
    """
    steps = plan_steps(gait, mass, foot, sole)
    single, double = (
        np.linspace(0.0, duration, math.ceil(duration / DCM_SAMPLE_TIME), endpoint=False)
        for duration in (steps.constants.single_support_duration, steps.constants.double_support_duration)
    )
    motions = [_dcm_step(steps, axis, single, double) for axis in step_axes(steps)]
    return _repeated(steps, np.append(single, steps.constants.single_support_duration + double), motions)


def _dcm_step(steps: StepPlan, axis: _Axis, in_single: Array, in_double: Array) -> Array:
    """COM, velocity and acceleration at times since the start of either support [s], shape (3, n)."""
    single, double = steps.constants.single_support_duration, steps.constants.double_support_duration
    w = math.sqrt(steps.gravity / steps.com_height)
    lead = (axis.end - axis.begin) / single / w  # of the DCM before the moving ZMP, where it does not diverge
    # xi = p + lead + C exp(w t) in single support: C from the mirrored return.
    rise, half = math.exp(w * single), math.exp(0.5 * w * double)
    jump = (axis.next - axis.end) * half
    divergence = (jump + (axis.sign - half * half) * lead) / (rise * half * half - axis.sign)
    first = axis.end + lead + divergence * rise
    last = axis.next + axis.sign * (lead + divergence)
    # The cubic of xi in double support: its values, and its rates w (xi - p).
    ends = np.array([first, last]), w * np.array([first - axis.end, last - axis.next])
    mean = (last - first) / double
    cubic = np.array(
        [
            first,
            ends[1][0],
            (3.0 * mean - 2.0 * ends[1][0] - ends[1][1]) / double,
            (ends[1].sum() - 2.0 * mean) / double**2,
        ]
    )
    zmp = polynomial.polysub(cubic, polynomial.polyder(cubic) / w)
    moving = np.array([axis.begin, (axis.end - axis.begin) / single])

    def motion(time: Any, p: Array, growing: float, decaying: float) -> Array:
        """``u = p + p''/w^2 + A exp(w t) + B exp(-w t)`` solves ``u'' = w^2 (u - p)`` for p at most cubic."""
        middle = polynomial.polyadd(p, polynomial.polyder(p, 2) / w**2)
        up, down = growing * np.exp(w * time), decaying * np.exp(-w * time)
        position = polynomial.polyval(time, middle) + up + down
        velocity = polynomial.polyval(time, polynomial.polyder(middle)) + w * (up - down)
        return np.array([position, velocity, w**2 * (position - polynomial.polyval(time, p))])

    # The COM is continuous and returns: two equations for the decaying parts.
    gaps = [
        motion(0.0, zmp, 0.0, 0.0)[0] - motion(single, moving, 0.5 * divergence, 0.0)[0],
        axis.sign * motion(0.0, moving, 0.5 * divergence, 0.0)[0]
        + axis.shift
        - motion(double, zmp, 0.0, 0.0)[0],
    ]
    fade = [[math.exp(-w * single), -1.0], [-axis.sign, math.exp(-w * double)]]
    decaying = np.linalg.solve(fade, np.array(gaps))
    return np.hstack(
        [
            motion(in_single, moving, 0.5 * divergence, decaying[0]),
            motion(in_double, zmp, 0.0, decaying[1]),
        ]
    )


# ---------------------------------------------------------------------------------------------- preview


class PreviewGains(NamedTuple):
    """Cart-table in discrete time and the gains of its preview control, for the state x = (u, u', u'').

    ``x(k+1) = A x(k) + B j(k)`` with the jerk j, ``p = C x``, and with ``e = p - p_ref``

        j(k+1) - j(k) = -K (e(k+1), x(k+1) - x(k)) - sum over i of F_i (p_ref(k+1+i) - p_ref(k+i))

    Attributes:
        A, B, C: shapes (3, 3), (3,), (3,).
        feedback: K, of the error and of the differences of the state, shape (4,).
        preview: F_1, F_2, ..., shape (n,).
    """

    A: Array
    B: Array
    C: Array
    feedback: Array
    preview: Array

    def in_errors(self) -> tuple[Array, Array]:
        """A, (4, 4), and B, (4,), for the state (e(k), x(k) - x(k-1)) and the difference of the jerk."""
        A = np.block([[np.ones((1, 1)), (self.C @ self.A)[None]], [np.zeros((3, 1)), self.A]])
        return A, np.concatenate([[self.C @ self.B], self.B])


def preview_gains(height: float, gravity: float, period: float) -> PreviewGains:
    """Gains that minimise the sum of ``e^2 + R (j(k+1) - j(k))^2`` by the discrete Riccati equation.

    Args:
        height: of the COM [m].
        gravity: [m/s^2].
        period: sampling time [s].
    """
    from scipy.linalg import solve_discrete_are  # imported here: SciPy is slow to load

    A = np.array([[1.0, period, 0.5 * period**2], [0.0, 1.0, period], [0.0, 0.0, 1.0]])
    B = np.array([period**3 / 6.0, 0.5 * period**2, period])
    C = np.array([1.0, 0.0, -height / gravity])
    gains = PreviewGains(A, B, C, np.zeros(4), np.zeros(0))
    error, (A_error, B_error) = np.array([1.0, 0.0, 0.0, 0.0]), gains.in_errors()
    P = solve_discrete_are(A_error, B_error[:, None], np.outer(error, error), [[JERK_WEIGHT]])
    scale = JERK_WEIGHT + B_error @ P @ B_error
    feedback = B_error @ P @ A_error / scale
    closed = A_error - np.outer(B_error, feedback)
    preview, ahead = [], -P @ error
    for _ in range(round(PREVIEW_TIME / period)):
        preview.append(B_error @ ahead / scale)
        ahead = closed.T @ ahead
    return gains._replace(feedback=feedback, preview=np.array(preview))


def preview_steps(gait: GaitParameters, mass: float, foot: FootParameters, sole: SoleGeometry) -> StepPlan:
    """Preview control of the cart-table along a ZMP that is linear in time in either phase.

    Raises:
        InputError, MathematicalRefusal: as :func:`ampm.planner.support.plan_steps`.
    """
    steps = plan_steps(gait, mass, foot, sole)
    count = round(steps.constants.step_duration / SAMPLE_TIME)
    period = steps.constants.step_duration / count
    gains = preview_gains(steps.com_height, steps.gravity, period)
    motions = [_preview_step(steps, axis, gains, count, period) for axis in step_axes(steps)]
    return _repeated(steps, np.asarray(period * np.arange(count)), motions)


def reference_zmp(steps: StepPlan, axis: _Axis, times: Array) -> Array:
    """The ZMP that preview control follows, linear in time in either phase, shape (N,) [m]."""
    step = np.floor(times / steps.constants.step_duration + 1e-9)
    knots = [0.0, steps.constants.single_support_duration, steps.constants.step_duration]
    local = np.interp(times - step * steps.constants.step_duration, knots, [axis.begin, axis.end, axis.next])
    return axis.returned(local, step)


def _preview_step(steps: StepPlan, axis: _Axis, gains: PreviewGains, count: int, period: float) -> Array:
    """COM, velocity and acceleration at the samples of the periodic step, shape (3, count)."""
    preview, (A, B) = gains.preview, gains.in_errors()
    times = np.asarray(period * np.arange(count + len(preview) + 1), dtype=np.float64)
    reference = reference_zmp(steps, axis, times)
    change = np.diff(reference)
    closed = A - np.outer(B, gains.feedback)
    force = -np.outer([change[k : k + len(preview)] @ preview for k in range(count)], B)
    force[:, 0] -= change[:count]
    # State (e(k), x(k) - x(k-1)): it returns after ``count`` samples, and so does the sum of all forcing.
    state = np.zeros(4)
    for term in force:
        state = closed @ state + term
    state = np.linalg.solve(axis.sign * np.eye(4) - np.linalg.matrix_power(closed, count), state)
    states = [state]
    for term in force:
        states.append(closed @ states[-1] + term)
    # From the differences of x = (u, u', u'') over a sample: jerk, acceleration, velocity at its start.
    error, moved, faster, pushed = np.array(states).T
    jerk = pushed[1:] / period
    acceleration = faster[1:] / period - 0.5 * period * jerk
    velocity = moved[1:] / period - 0.5 * period * acceleration - period**2 / 6.0 * jerk
    position = error[:-1] + reference[:count] - gains.C[2] * acceleration
    return np.array([position, velocity, acceleration])


StepPlanner = Callable[[GaitParameters, float, FootParameters, SoleGeometry], StepPlan]
"""Makes periodic steps of a gait, mass, feet and sole; errors are those of plan_steps."""
STEP_PLANNERS: Mapping[str, StepPlanner] = {
    "ampm": plan_steps,
    LIPM: lipm_steps,
    "ipm": ipm_steps,
    "preview": preview_steps,
    "dcm": dcm_steps,
}
"""Planners of periodic steps, by their names in ``gait.planner``."""
