"""ZMP planners of others on the footsteps, times and feet of a gait: IPM, preview control, DCM.

All of them are the cart-table, ``u'' = (g/H) (u - p)``: the ground force passes through the COM, and the
angular momentum about it is constant. They differ in the ZMP ``p``. In single support it goes from heel to
toe of the stance foot as far as in the AMPM's plan (``l_s / a_s`` to either side of the reference point, as
feet that roll need), here linearly in time, and rests in the frontal plane. In double support it goes to the
other foot.

- *IPM* (Kudoh & Komura, IROS 2003, section 1.2): at rest under the foot, then under the COM.
- *Preview* (Kajita et al., "Biped walking pattern generation by using preview control of zero-moment point",
  ICRA 2003): linear in time in double support, too; the least jerk follows it.
- *DCM* (Englsberger, Ott & Albu-Schaeffer, "Three-dimensional bipedal walking control based on divergent
  component of motion", IEEE T-RO 31(2), 2015): closed form in single support, a cubic in double support.

Walks are periodic, as the AMPM's: the state that returns mirrored after a step is solved for.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from ampm.description import SoleGeometry
from ampm.parameters import FootParameters, GaitParameters
from ampm.planner.centroidal import CentroidalPhase
from ampm.planner.pendulum import LawState
from ampm.planner.sampled import SampledLaw, plan_constants
from ampm.planner.support import StepPlan, plan_steps

Array = NDArray[np.float64]

SAMPLE_TIME = 0.005
"""Sampling time of preview control [s], of Kajita et al.; adapted to a whole number of samples in a step."""
PREVIEW_TIME = 3.2
"""Time for which preview control sees the ZMP in advance [s]; with half of it, as in that paper, the ZMP
stays 2.5 mm behind at 0.9 m/s."""
JERK_WEIGHT = 1e-6
"""Weight R of the squared change of jerk over that of the squared ZMP error [s^6], of that paper."""


@dataclass(frozen=True)
class ZmpLaw:
    """One axis of one phase of the cart-table, with a ZMP that is a polynomial of time.

    Equation: ``u'' = w^2 (u - p)``, so that ``u = p + p''/w^2 + p''''/w^4 + ... + A exp(w t) + B exp(-w t)``.

    Attributes:
        frequency: w = sqrt(g/H) [1/s].
        zmp: coefficients of p, lowest order first, at most four [m, m/s, ...].
        growing: A [m].
        decaying: B [m].
    """

    frequency: float
    zmp: Array
    growing: float
    decaying: float

    def evaluate(self, time: Any) -> LawState:
        """State at times since the start of the phase [s]; every field has the shape of the times."""
        t, w = np.asarray(time, dtype=np.float64), self.frequency
        middle = polynomial.polyadd(self.zmp, polynomial.polyder(self.zmp, 2) / w**2)
        up, down = self.growing * np.exp(w * t), self.decaying * np.exp(-w * t)
        position = polynomial.polyval(t, middle) + up + down
        zmp: Any = polynomial.polyval(t, self.zmp)
        return LawState(
            position=position,
            velocity=polynomial.polyval(t, polynomial.polyder(middle)) + w * (up - down),
            acceleration=w**2 * (position - zmp),
            zmp=zmp,
            moment_arm=np.zeros_like(t),
            moment_arm_integral=np.zeros_like(t),
        )


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


def _with_phases(steps: StepPlan, phases: list[CentroidalPhase]) -> StepPlan:
    """The same steps with another motion of the COM."""
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
    own = plan_steps(gait, mass, foot, sole)
    if gait.model == "ipm":
        return own
    single, double = own.constants.single_support_duration, own.constants.double_support_duration
    k = math.sqrt(own.gravity / own.com_height)
    travel = math.tanh(0.5 * k * single) / k
    share = travel / (travel + 0.5 * double)
    speed = 0.5 * gait.step_length / (travel + 0.5 * double)
    changed = {"switching_velocity": speed, "single_support_ratio": share}
    plain = {"model": "ipm", "a_s": math.inf, "c_s": 1.0, "c_y": 1.0}
    return plan_steps(GaitParameters(**(gait.model_dump() | plain | changed)), mass, foot, sole)


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
    phases, laws = [], [_dcm_laws(steps, axis) for axis in step_axes(steps)]
    for number, phase in enumerate(steps.contacts.phases):
        step, kind = divmod(number, 2)
        x, y = laws[0][kind], laws[1][kind]
        if step % 2:
            y = ZmpLaw(y.frequency, -y.zmp, -y.growing, -y.decaying)
        origin = step * steps.contacts.step_length, 0.0
        phases.append(CentroidalPhase(phase.start, phase.duration, origin, x, y, (0.0, 0.0)))
    return _with_phases(steps, phases)


def _dcm_laws(steps: StepPlan, axis: _Axis) -> tuple[ZmpLaw, ZmpLaw]:
    """Single and double support of one axis."""
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
    # The COM is continuous and returns: two equations for the decaying parts.
    before, after = ZmpLaw(w, moving, 0.5 * divergence, 0.0), ZmpLaw(w, zmp, 0.0, 0.0)
    gaps = [
        after.evaluate(0.0).position - before.evaluate(single).position,
        axis.sign * before.evaluate(0.0).position + axis.shift - after.evaluate(double).position,
    ]
    fade = [[math.exp(-w * single), -1.0], [-axis.sign, math.exp(-w * double)]]
    decaying = np.linalg.solve(fade, np.array(gaps))
    return (
        replace(before, decaying=float(decaying[0])),
        replace(after, decaying=float(decaying[1])),
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
    number = np.arange(count * steps.contacts.steps + 1)
    times = np.asarray(number * period, dtype=np.float64)
    laws: list[SampledLaw] = []
    for axis in step_axes(steps):
        position, *rates = _preview_step(steps, axis, gains, count, period)
        step, index = np.divmod(number, count)
        velocity, acceleration = (axis.sign**step * rate[index] for rate in rates)
        place: Array = axis.returned(position[index], step)
        zmp: Array = place - steps.com_height / steps.gravity * acceleration
        laws.append(SampledLaw(times, place, velocity, acceleration, zmp, np.zeros(len(number))))
    phase = CentroidalPhase(0.0, steps.duration, (0.0, 0.0), laws[0], laws[1], (0.0, 0.0))
    return _with_phases(steps, [phase])


def reference_zmp(steps: StepPlan, axis: _Axis, times: Array) -> Array:
    """The ZMP that preview control follows, linear in time in either phase, shape (N,) [m]."""
    step = np.floor(times / steps.constants.step_duration + 1e-9)
    knots = [0.0, steps.constants.single_support_duration, steps.constants.step_duration]
    local = np.interp(times - step * steps.constants.step_duration, knots, [axis.begin, axis.end, axis.next])
    return axis.returned(local, step)


def _preview_step(
    steps: StepPlan, axis: _Axis, gains: PreviewGains, count: int, period: float
) -> tuple[Array, Array, Array]:
    """COM, velocity and acceleration at the samples of the periodic step, shape (count,) each."""
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
    return error[:-1] + reference[:count] - gains.C[2] * acceleration, velocity, acceleration


StepPlanner = Callable[[GaitParameters, float, FootParameters, SoleGeometry], StepPlan]
"""Makes periodic steps of a gait, mass, feet and sole; errors are those of plan_steps."""
STEP_PLANNERS: Mapping[str, StepPlanner] = {
    "ampm": plan_steps, "ipm": ipm_steps, "preview": preview_steps, "dcm": dcm_steps,
}  # fmt: skip
"""Planners of periodic steps by name."""
