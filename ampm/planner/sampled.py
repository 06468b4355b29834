"""A plan from a table of COM and ZMP: of a preview controller, an MPC, another program, or a measurement."""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ampm.exceptions import InputError
from ampm.parameters import GRAVITY
from ampm.planner.centroidal import TIME_TOLERANCE, CentroidalPhase, CentroidalPlan, PlanConstants
from ampm.planner.contacts import Contacts, Footstep, Phase, Side
from ampm.planner.pendulum import LawState

Array = NDArray[np.float64]

NO_CONSTANTS = PlanConstants(**dict.fromkeys((item.name for item in fields(PlanConstants)), 0.0))
"""Of a plan whose constants are still to be read from its motion, see :func:`plan_constants`."""


@dataclass(frozen=True)
class SampledLaw:
    """One axis of a centroidal motion as samples: position and velocity cubic in between, the rest linear.

    Attributes:
        time: ascending, shape (N,) [s].
        position: of the COM, shape (N,) [m].
        velocity: shape (N,) [m/s].
        acceleration: shape (N,) [m/s^2].
        zmp: shape (N,) [m].
        moment_arm: distance by which the force line misses the COM, shape (N,) [m].
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    zmp: Array
    moment_arm: Array

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


def sampled_plan(
    time: ArrayLike,
    com: ArrayLike,
    zmp: ArrayLike,
    contacts: Contacts,
    *,
    mass: float,
    com_height: float,
    acceleration: ArrayLike | None = None,
    angular_momentum: tuple[float, float] = (0.0, 0.0),
) -> CentroidalPlan:
    """Make a plan of a table of COM and ZMP.

    Args:
        time: ascending from 0 to the end of the contacts, shape (N,) [s].
        com: (x, y) of the COM in world, shape (N, 2) [m].
        zmp: shape (N, 2) [m].
        contacts: which foot stands where, and when.
        mass: of the body [kg].
        com_height: constant height of the COM, H [m].
        acceleration: of the COM, shape (N, 2) [m/s^2]. Without it the ground force passes through the COM, so
            that it is ``(g/H) (com - zmp)``; with it COM, ZMP and acceleration give the moment about the COM.
        angular_momentum: (L_x, L_y) about the COM at time 0 [N m s].

    Raises:
        InputError: shapes that do not fit, times that do not ascend or end too early, entries that are not
            finite.
    """
    given = (time, com, zmp, com if acceleration is None else acceleration)
    t, c, p, a = (np.array(values, dtype=np.float64) for values in given)
    if t.ndim != 1 or len(t) < 3 or any(values.shape != (len(t), 2) for values in (c, p, a)):
        raise InputError(
            f"time has the shape {t.shape}, COM {c.shape}, ZMP {p.shape} and acceleration {a.shape}; give "
            "(N,) and (N, 2), three samples or more."
        )
    if not all(np.isfinite(values).all() for values in (t, c, p, a)):
        raise InputError("the table has entries that are no numbers; give finite ones.")
    ends = abs(t[0]) <= TIME_TOLERANCE and t[-1] >= contacts.duration - TIME_TOLERANCE
    if not (ends and (np.diff(t) > 0.0).all()):
        raise InputError(
            f"the times {t[0]:g} ... {t[-1]:g} s must ascend from 0 to the end of the contacts, "
            f"{contacts.duration:g} s; add samples or drop footsteps."
        )
    rate = GRAVITY / com_height
    if acceleration is None:
        a = rate * (c - p)
    v = np.gradient(c, t, axis=0, edge_order=2)
    arm = np.zeros_like(c) if acceleration is None else a / rate - c + p
    x, y = (SampledLaw(t, c[:, k], v[:, k], a[:, k], p[:, k], arm[:, k]) for k in (0, 1))
    phase = CentroidalPhase(0.0, contacts.duration, (0.0, 0.0), x, y, angular_momentum)
    plan = CentroidalPlan(mass, GRAVITY, com_height, 1.0, contacts, (phase,), NO_CONSTANTS)
    constants = plan_constants(plan)
    return replace(plan, switching_velocity=constants.mean_velocity, constants=constants)


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
            angular_momentum_y_offset=0.0,
        )


def sampled_contacts(
    time: ArrayLike, stance: ArrayLike, left: ArrayLike, right: ArrayLike, start: ArrayLike | None = None
) -> Contacts:
    """Contacts of a table such as ``ampm plan --samples`` writes.

    The foot that swings first starts as far behind the standing foot as it lands ahead of it.

    Args:
        time: ascending, shape (N,) [s].
        stance: ``left``, ``right`` or ``both``, shape (N,).
        left: (x, y) of the left foot's footstep, of the next one while it swings, shape (N, 2) [m].
        right: the same of the right foot, shape (N, 2) [m].
        start: when the phase of every sample began, shape (N,) [s]; at its first sample by default.
    """
    t, names = np.asarray(time, dtype=np.float64), np.asarray(stance)
    places: dict[Side, Array] = {"left": np.asarray(left, float), "right": np.asarray(right, float)}
    starts = np.flatnonzero(np.r_[True, names[1:] != names[:-1]])
    phases, footsteps = [], []
    begun = (t if start is None else np.asarray(start, dtype=np.float64))[starts]
    for first, begin, end in zip(starts, begun, [*begun[1:], t[-1]], strict=True):
        standing: dict[Side, Footstep | None] = {}
        for foot, place in places.items():
            step = Footstep(foot, (float(place[first, 0]), float(place[first, 1]), 0.0))
            stands = names[first] in (foot, "both")
            standing[foot] = step if stands else None
            if stands and step not in footsteps:
                footsteps.append(step)
        phases.append(Phase(float(begin), float(end - begin), standing["left"], standing["right"]))
    here, ahead = footsteps[:2]
    behind = (2.0 * here.position[0] - ahead.position[0], ahead.position[1], 0.0)
    return Contacts((Footstep(ahead.foot, behind), *footsteps), tuple(phases))
