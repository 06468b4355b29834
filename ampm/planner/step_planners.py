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
  point", ICRA 2003): linear in time in double support, too; the least change of jerk follows it.
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

from ampm.description import SoleGeometry
from ampm.geometry import Array
from ampm.parameters import FootParameters, GaitParameters
from ampm.planner.centroidal import CentroidalPhase
from ampm.planner.closed_form import LIPM
from ampm.planner.sampled import SampledLaw, plan_constants
from ampm.planner.support import StepPlan, plan_steps

SAMPLE_TIME = 0.005
"""Sampling time of preview control [s], of Kajita et al.; adapted to a whole number of samples in a step."""
DCM_SAMPLE_TIME = 0.001
"""Largest time between samples of a DCM plan, between which its ZMP is linear [s]."""
JERK_WEIGHT = 1e-6
"""Weight R of the squared change of jerk over that of the squared ZMP error [s^6], of that paper."""


class _Axis(NamedTuple):
    """ZMP of one axis in one step, and how the step returns: times ``sign``, plus ``shift``."""

    begin: float  # ZMP at the begin of single support [m]
    end: float  # ZMP at its end [m]
    sign: float  # 1 or, where the step returns mirrored, -1
    shift: float  # [m]

    @property
    def next(self) -> float:
        """ZMP at the start of the next single support [m]."""
        return self.sign * self.begin + self.shift


def step_axes(steps: StepPlan) -> tuple[_Axis, _Axis]:
    """Sagittal and frontal plane of a gait's first step, from the reference point of the stance foot."""
    constants, contacts = steps.constants, steps.contacts
    roll, half = constants.l_s * constants.inverse_a_s, 0.5 * contacts.step_width
    return _Axis(-roll, roll, 1.0, contacts.step_length), _Axis(half, half, -1.0, 0.0)


def _repeated(steps: StepPlan, times: Array, motions: Sequence[Array]) -> StepPlan:
    """The same steps with another motion of the COM, mirrored from step to step.

    Motions along x and y are position, velocity and acceleration at n times of the first step, (3, n) each.
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


def ipm_steps(gait: GaitParameters, mass: float, foot: FootParameters, sole: SoleGeometry) -> StepPlan:
    """The plain inverted pendulum; its speed at the switches is that which gives the gait's durations.

    With ``k = sqrt(g/H)``, half the travel in single support is ``l_s = v0 tanh(k T_SS/2) / k``, in double
    support ``v0 T_DS / 2``, and together they are half a step.
    """
    steps = plan_steps(gait, mass, foot, sole)
    single, double = steps.constants.single_support_duration, steps.constants.double_support_duration
    k = math.sqrt(steps.gravity / steps.com_height)
    travel = math.tanh(0.5 * k * single) / k
    timed = {
        "switching_velocity": 0.5 * gait.step_length / (travel + 0.5 * double),
        "single_support_ratio": travel / (travel + 0.5 * double),
    }
    return lipm_steps(gait.model_copy(update=timed), mass, foot, sole)


def lipm_steps(gait: GaitParameters, mass: float, foot: FootParameters, sole: SoleGeometry) -> StepPlan:
    """The plain inverted pendulum in closed form, with the gait's speed at the switches."""
    return plan_steps(gait.model_copy(update={"planner": LIPM}), mass, foot, sole)


def dcm_steps(gait: GaitParameters, mass: float, foot: FootParameters, sole: SoleGeometry) -> StepPlan:
    """DCM planning: ``xi = u + u'/w`` diverges from the ZMP, ``xi' = w (xi - p)``, and the COM follows it.

    In single support ``xi`` is closed form. For the recursion the ZMP changes feet at once in the middle of
    the double support (equal shares of it before and after). Then the double support becomes a cubic of
    ``xi`` that meets value and rate at both ends, so that the ZMP is continuous.
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
    lead = (axis.end - axis.begin) / single / w  # distance of a DCM that does not diverge from the moving ZMP
    # xi = p + lead + C exp(w t) in single support: C from the mirrored return.
    rise, half = math.exp(w * single), math.exp(0.5 * w * double)
    jump = (axis.next - axis.end) * half
    divergence = (jump + (axis.sign - half * half) * lead) / (rise * half * half - axis.sign)
    first = axis.end + lead + divergence * rise
    last = axis.next + axis.sign * (lead + divergence)
    # The cubic of xi in double support: its values, and its rates w (xi - p).
    begins, ends = w * (first - axis.end), w * (last - axis.next)
    gap, bend = last - first - begins * double, (ends - begins) * double
    curvature, third = (3.0 * gap - bend) / double**2, (bend - 2.0 * gap) / (double * double * double)
    dcm = np.array([first, begins, curvature, third])
    zmp = polynomial.polysub(dcm, polynomial.polyder(dcm) / w)
    moving = np.array([axis.begin, (axis.end - axis.begin) / single])

    def motion(time: Any, p: Array, growing: float, decaying: float) -> Array:
        """``u = p + p''/w^2 + A exp(w t) + B exp(-w t)`` solves ``u'' = w^2 (u - p)`` for p at most cubic."""
        middle = polynomial.polyadd(p, polynomial.polyder(p, 2) / w**2)
        up, down = growing * np.exp(w * time), decaying * np.exp(-w * time)
        position = polynomial.polyval(time, middle) + up + down
        velocity = polynomial.polyval(time, polynomial.polyder(middle)) + w * (up - down)
        return np.array([position, velocity, w**2 * (position - polynomial.polyval(time, p))])

    # The COM is continuous and returns: two equations for the decaying parts.
    grows = 0.5 * divergence
    gaps = [
        motion(0.0, zmp, 0.0, 0.0)[0] - motion(single, moving, grows, 0.0)[0],
        axis.sign * motion(0.0, moving, grows, 0.0)[0] + axis.shift - motion(double, zmp, 0.0, 0.0)[0],
    ]
    fade = [[math.exp(-w * single), -1.0], [-axis.sign, math.exp(-w * double)]]
    decaying = np.linalg.solve(fade, np.array(gaps))
    walked = motion(in_single, moving, grows, decaying[0]), motion(in_double, zmp, 0.0, decaying[1])
    return np.hstack(walked)


def preview_steps(gait: GaitParameters, mass: float, foot: FootParameters, sole: SoleGeometry) -> StepPlan:
    """Preview control of the cart-table along a ZMP that is linear in time in either phase."""
    steps = plan_steps(gait, mass, foot, sole)
    count = round(steps.constants.step_duration / SAMPLE_TIME)
    times = np.linspace(0.0, steps.constants.step_duration, count, endpoint=False)
    return _repeated(steps, times, [_preview_step(steps, axis, times) for axis in step_axes(steps)])


def reference_zmp(steps: StepPlan, axis: _Axis, times: Array) -> Array:
    """The ZMP that preview control follows, linear in time in either phase, shape (N,) [m]."""
    step = np.floor(times / steps.constants.step_duration + 1e-9)
    knots = [0.0, steps.constants.single_support_duration, steps.constants.step_duration]
    local = np.interp(times - step * steps.constants.step_duration, knots, [axis.begin, axis.end, axis.next])
    return np.asarray(axis.sign**step * local + step * axis.shift)


def _preview_step(steps: StepPlan, axis: _Axis, times: Array) -> Array:
    """COM, velocity and acceleration at N times of the periodic step, shape (3, N).

    Preview control minimises the sum of ``e(k)^2 + R (j(k+1) - j(k))^2`` of the error of the ZMP and the
    jerk, which is constant between samples. With all of a periodic reference in preview its walk is the
    periodic motion with the least such sum: a linear problem in the first state and the jerks of a step.
    """
    count, period = len(times), times[1]
    A = np.array([[1.0, period, 0.5 * period**2], [0.0, 1.0, period], [0.0, 0.0, 1.0]])
    B = np.array([period**3 / 6.0, 0.5 * period**2, period])
    # (u, u', u'') at every sample and at the step's end, as maps of the first state and all jerks.
    states = np.zeros((count + 1, 3, 3 + count))
    states[0] = np.eye(3, 3 + count)
    for k in range(count):
        states[k + 1] = A @ states[k]
        states[k + 1, :, 3 + k] += B
    shift = states[-1] - axis.sign * states[0]  # is the shift of the position
    jerk = np.eye(count, 3 + count, 3)
    change = np.vstack([jerk[1:], axis.sign * jerk[:1]]) - jerk
    zmp = states[:-1, 0] - steps.com_height / steps.gravity * states[:-1, 2]
    system = np.block([[zmp.T @ zmp + JERK_WEIGHT * change.T @ change, shift.T], [shift, np.zeros((3, 3))]])
    right = np.concatenate([zmp.T @ reference_zmp(steps, axis, times), [axis.shift, 0.0, 0.0]])
    return np.asarray((states[:-1] @ np.linalg.solve(system, right)[:-3]).T)


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
