"""Plans of samples: one axis of the COM, a whole motion, and the constants that no closed form gives."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ampm.exceptions import InputError
from ampm.geometry import Array, rotations
from ampm.parameters import GRAVITY
from ampm.planner.centroidal import CentroidalPhase, CentroidalPlan, PlanConstants
from ampm.planner.contacts import LEVEL, Contacts, ascending, finite, read_only
from ampm.planner.newton import ALLOWED, WINDOW, check_newton
from ampm.planner.pendulum import LawState


@dataclass(frozen=True)
class SampledLaw:
    """One axis of a centroidal motion as samples: position and velocity cubic in between, the rest linear.

    The arrays are copied, and read-only.
    """

    time: Array  # ascending, shape (N,) [s]
    position: Array  # of the COM, shape (N,) [m]
    velocity: Array  # shape (N,) [m/s]
    acceleration: Array  # shape (N,) [m/s^2]
    zmp: Array  # shape (N,) [m]
    moment_arm: Array  # distance by which the force line misses the COM, shape (N,) [m]

    def __post_init__(self) -> None:
        for name, values in vars(self).copy().items():
            object.__setattr__(self, name, read_only(values))

    def evaluate(self, time: Any) -> LawState:
        """State at times since the first sample [s]; every field has the shape of the times."""
        time = np.asarray(time, dtype=np.float64) + self.time[0]
        i = np.clip(np.searchsorted(self.time, time, side="right") - 1, 0, len(self.time) - 2)
        h = self.time[i + 1] - self.time[i]
        u = (time - self.time[i]) / h

        def linear(values: Array) -> Array:
            return values[i] + u * (values[i + 1] - values[i])

        rise = self.position[i + 1] - self.position[i]
        left, right = h * self.velocity[i] - rise, rise - h * self.velocity[i + 1]
        arm = self.moment_arm
        whole = 0.5 * (arm[1:] + arm[:-1]) * np.diff(self.time)
        before = np.concatenate([[0.0], np.cumsum(whole)])[i]
        mixed = (1.0 - u) * left + u * right
        return LawState(
            position=self.position[i] + u * (rise + (1.0 - u) * mixed),
            velocity=(rise + (1.0 - 2.0 * u) * mixed + u * (1.0 - u) * (right - left)) / h,
            acceleration=linear(self.acceleration),
            zmp=linear(self.zmp),
            moment_arm=linear(arm),
            moment_arm_integral=before + 0.5 * u * h * (arm[i] + linear(arm)),
        )


_LEVEL = 1e-6  # by which a constant height of the COM may vary [m]
_ENOUGH = 100.0  # rows a second with which a right plan is within a quarter of what is allowed


def sampled_plan(plan: CentroidalPlan, times: ArrayLike, **given: Any) -> CentroidalPlan:
    """A plan with the motion of samples.

    Args:
        plan: the one in force with new contacts, or a bare one without phases.
        times: of the samples, shape (N,) [s].
        given: the samples, named as in :func:`ampm.planners.make_plan`; None is the same as left out.

    Raises:
        InputError: they do not fit each other, end before the contacts, or contradict Newton's law.
    """
    times, first = ascending("times", times), not plan.phases
    begin, end = float(times[0]), plan.duration
    if first and begin != 0.0:
        raise InputError(f"times begin at {begin:g} s; begin at 0 s, or give the plan in force as after.")
    if end - times[-1] > times[-1] - times[-2] + 1e-9:
        raise InputError(f"times end at {times[-1]:g} s and contacts at {end:g} s; plan the COM to its end.")
    given = _checked(given, len(times))
    given["com"][:, 2:] -= (given["com"][:, :2] @ plan.contacts.slope)[:, None]  # heights over the floor
    high = _height_law(given, times, plan)
    if high is None and given["com"].shape[1] == 3:
        plan = replace(plan, com_height=float(given["com"][0, 2]))
    given = {name: values[..., :2] for name, values in given.items()}
    com, (acceleration, zmp, arm) = given["com"], _by_newton(given, plan, high)
    velocity = given.get("com_velocity", np.gradient(com, times, axis=0, edge_order=2))
    momentum = given.get("angular_momentum", np.zeros(2) if first else plan.sample(begin).angular_momentum[0])
    around_x, around_y = momentum.tolist()
    around_y -= plan.constants.angular_momentum_y_offset
    columns = com, velocity, acceleration, zmp, arm
    x, y = (SampledLaw(times - begin, *(values[:, axis] for values in columns)) for axis in (0, 1))
    phase = CentroidalPhase(begin, end - begin, (0.0, 0.0), x, y, (around_x, around_y), z=high)
    plan = replace(plan, phases=(phase,))
    if first:
        constants = plan_constants(plan)
        if plan.contacts.phases[0].stance == "both":  # the first step may go aside
            way = np.linalg.norm(np.diff(com, axis=0), axis=1).sum()
            constants = replace(constants, mean_velocity=float(way) / end)
        plan = replace(plan, switching_velocity=constants.mean_velocity, constants=constants)
    rows = float(np.median(1.0 / np.diff(times)))  # a second
    check_newton(plan, "" if rows >= _ENOUGH else f", or give {_ENOUGH:g} rows a second, not {rows:.3g}")
    if "com_velocity" in given:
        _check_velocity(times, com, velocity, math.sqrt(plan.com_height / plan.gravity))
    return plan


def _checked(given: dict[str, Any], count: int) -> dict[str, Array]:
    """What is given of the samples, as finite arrays that fit their number."""
    found = {name: finite(name, values) for name, values in given.items() if values is not None}
    if "com" not in found:
        raise InputError("com is left out; give its place at each of the times.")
    for name, values in found.items():
        shape = (2,) if name == "angular_momentum" else (count, 2)
        if values.shape != shape and not (name.startswith("com") and values.shape == (count, 3)):
            way_out = "give a row for each time, with x and y"
            raise InputError(f"{name} has the shape {values.shape}, not {shape}; {way_out}.")
    return found


def _by_newton(given: dict[str, Array], plan: CentroidalPlan, high: SampledLaw | None) -> tuple[Array, ...]:
    """Acceleration, ZMP of level ground and moment arm, (N, 2) each, from those of them that are given.

    ``h a = g (s (com - zmp) + arm)``: h height over the support, s vertical force over the weight.
    """
    com, height, lift = given["com"], np.full((1, 1), plan.com_height), np.ones((1, 1))
    if high is not None:
        height, lift = (high.position - high.zmp)[:, None], 1.0 + high.acceleration[:, None] / plan.gravity
    rate, arm = plan.gravity / height, np.zeros_like(com)
    if "moment" in given:
        arm = given["moment"][:, ::-1] * [-1.0, 1.0] / plan.weight
    zmp, acceleration = given.get("zmp"), given.get("com_acceleration")
    if zmp is not None and plan.contacts.slope != LEVEL:  # that of level ground has the same moment
        away, slope = com - zmp, np.array(plan.contacts.slope)
        rise, pull = (away @ slope)[:, None], plan.gravity * (away + arm)
        solved = (pull + away * (pull @ slope)[:, None] / height) / (height + rise)
        moves = solved if acceleration is None else acceleration
        zmp = com - (away * (plan.gravity + moves @ slope)[:, None] - rise * moves) / plan.gravity
    if acceleration is not None:
        zmp = com + arm / lift - acceleration / (rate * lift) if zmp is None else zmp
        if "moment" not in given:
            arm = acceleration / rate - com * lift + zmp * lift
    elif zmp is not None:
        acceleration = rate * (com * lift - zmp * lift + arm)
    else:
        raise InputError("zmp and com_acceleration are left out; give one of them or both.")
    return acceleration, zmp, arm


def _check_velocity(times: Array, com: Array, velocity: Array, fall: float) -> None:
    """Refuse velocities that do not move the COM as it moves, in windows; ``fall`` is (h/g)^1/2 [s]."""
    steps = 0.5 * (velocity[1:] + velocity[:-1]) * np.diff(times)[:, None] - np.diff(com, axis=0)
    off = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    ends = np.searchsorted(times, times + WINDOW)
    begins = np.flatnonzero(ends < len(times))
    apart = fall / WINDOW * np.abs(off[ends[begins]] - off[begins]).max(axis=1, initial=0.0)
    if apart.max(initial=0.0) > ALLOWED:
        raise InputError(
            f"com_velocity differs from that of com at {times[begins[apart.argmax()]]:.4g} s by "
            f"{1e3 * apart.max():.3g} mm of ZMP, more than {1e3 * ALLOWED:g} mm; correct it, or leave it out."
        )


def _height_law(given: dict[str, Array], times: Array, plan: CentroidalPlan) -> SampledLaw | None:
    """The law of heights that vary, of the COM or of footsteps; None if none does."""
    slope, climbs = plan.contacts.slope, bool(plan.contacts.placements[..., 2].any())
    if given["com"].shape[1] == 2 and not climbs:
        return None
    height = given["com"][:, 2] if given["com"].shape[1] == 3 else np.full(len(times), plan.com_height)
    if not height.min() > 0.0:
        raise InputError(f"com has the height {height.min():g} m; give heights above 0 m.")
    if np.ptp(height) <= _LEVEL and not climbs:
        return None
    if slope != LEVEL:
        places = np.column_stack([given["com"][:, :2], np.ones_like(times)])
        along, across = (np.linalg.lstsq(places, height)[0][:2] + slope).round(4) + 0.0
        raise InputError(
            f"heights of {'footsteps' if climbs else 'com'} over the floor vary; gait.slope is {slope[0]:g} "
            f"and gait.cross_slope {slope[1]:g}, {along:g} and {across:g} fit best: set these, or give "
            "all the same height over the floor."
        )
    motion = [height]
    for rows in (given.get("com_velocity"), given.get("com_acceleration")):
        differences = np.gradient(motion[-1], times, edge_order=2)
        motion.append(differences if rows is None or rows.shape[1] == 2 else rows[:, 2])
    _, velocity, acceleration = motion
    if not acceleration.min() > -GRAVITY:
        raise InputError(
            f"com accelerates downwards by {-acceleration.min():.3g} m/s^2; keep it below {GRAVITY} m/s^2."
        )
    still = np.zeros_like(times)
    floor = _support_height(given, times, height, acceleration, plan.contacts) if climbs else still
    if not (low := float((height - floor).min())) > 0.0:
        raise InputError(f"com has the height {low:g} m over the floor; give heights above it.")
    return SampledLaw(times - times[0], height, velocity, acceleration, floor, still)


def _support_height(
    given: dict[str, Array], times: Array, height: Array, acceleration: Array, contacts: Contacts
) -> Array:
    """Height of the standing foot, in double support between both by their shares of the load, (N,) [m]."""
    phase = np.clip(np.searchsorted(contacts.starts, times, side="right") - 1, 0, len(contacts.starts) - 1)
    left, right = np.moveaxis(contacts.placements[phase], 1, 0)
    stance, way, heading = contacts.stance_codes[phase], right - left, contacts.headings[phase]
    across = rotations(heading)[:, :, 1]  # shares as PlanSample.right_load has them
    if "zmp" in given:
        zmp, by_height = given["zmp"], np.zeros((len(times), 2))
    else:  # where the force through the COM meets the plane of height 0, and by how much it moves per height
        by_height = given["com_acceleration"][:, :2] / (GRAVITY + acceleration)[:, None]
        zmp = given["com"][:, :2] - height[:, None] * by_height
    off, moves, width = ((across * part[:, :2]).sum(axis=1) for part in (zmp - left[:, :2], by_height, way))
    share = (off + left[:, 2] * moves) / (width - way[:, 2] * moves)
    share = np.where(stance == 2, np.clip(share, 0.0, 1.0), stance)
    return left[:, 2] + share * way[:, 2]


def plan_constants(plan: CentroidalPlan) -> PlanConstants:
    """Constants of the first single support of any plan, and the double support after it."""
    contacts = plan.contacts
    index = next(k for k, phase in enumerate(contacts.phases) if phase.kind == "single_support")
    single, double = contacts.phases[index : index + 2]
    sample = plan.sample([single.start, double.start, double.start + double.duration])
    com, zmp, arm = (
        np.diff(values) for values in (sample.com[:, 0], sample.zmp[:, 0], -sample.moment[:, 1] / plan.weight)
    )
    lateral, speed = sample.com[1, 1], sample.com_velocity[1, 1]
    here, there = contacts.placements[index, :, 1]
    stance = here if single.right is None else there
    with np.errstate(divide="ignore", invalid="ignore"):
        return PlanConstants(
            l_s=float(0.5 * com[0]),
            l_d=float(0.5 * com[1]),
            inverse_a_s=float(zmp[0] / com[0]),
            a_d=float(com[1] / zmp[1]),
            c_d=float(1.0 + arm[1] / com[1]),
            single_support_duration=single.duration,
            double_support_duration=double.duration,
            s=float(abs(lateral - stance)),
            beta=float(abs(lateral - 0.5 * (here + there))),
            lateral_switching_velocity=float(abs(speed)),
            mean_velocity=float(com.sum() / (single.duration + double.duration)),
        )
