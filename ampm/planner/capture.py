"""Largest push that a point mass on legs can survive, by direction and phase of a gait.

The linear inverted pendulum with the divergent component of motion ``xi = c + v / omega`` obeys
``xi' = omega (xi - r)``, r the ZMP. Its motion stays bounded just if

    xi(0) = integral of omega exp(-omega s) r(s) over s = 0 ... infinity.

A push of the velocity change ``dv``, constant over the time ``d``, adds ``dv / omega (1 - exp(-omega d)) /
(omega d)`` on the left. The right side is largest where r is always at the edge of the foremost sole in the
push's direction, and the soles go there as early and as far as legs can: that is the bound. It is exact for
the point mass at constant height with steps that take no time to load. A body that turns its trunk and arms
can exceed it. Koolen et al., Int. J. Robotics Research 31 (9), 2012, have the same sums.
"""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple, Self, get_args

import numpy as np

from ampm.description import BodyDescription
from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.planner.centroidal import phase_of
from ampm.planner.contacts import Contacts
from ampm.planner.support import StepPlan

Direction = Literal["forward", "backward", "wider", "narrower"]
DIRECTIONS: tuple[Direction, ...] = get_args(Direction)
"""Of a push, along and across the walk. *narrower* is over the foot of the single support in which, or before
which, the push ends, so that the next step must narrow or cross; *wider* is away from it."""
PushPhase = Literal["early", "mid", "late", "double"]
PUSH_PHASES: tuple[PushPhase, ...] = get_args(PushPhase)
"""When a push begins: at 12, 50, 85 % of a single support, or in mid double support after it."""
_SHARES = {"early": 0.12, "mid": 0.5, "late": 0.85, "double": 0.5}


class PushInstant(NamedTuple):
    """When and where a push acts.

    Attributes:
        time: at which it begins [s].
        direction: unit vector in world, shape (2,).
    """

    time: float
    direction: Array


def push_instant(
    contacts: Contacts,
    direction: Direction,
    phase: PushPhase,
    step: int,
    duration: float = 0.1,
    shift: float = 0.0,
) -> PushInstant:
    """The instant of a push in a walk.

    Args:
        contacts: of the walk.
        direction: see :data:`DIRECTIONS`.
        phase: see :data:`PUSH_PHASES`.
        step: number of the single support, from 1.
        duration: of the push [s].
        shift: share of the phase by which it begins later [1].

    Raises:
        InputError: the walk has no such step, or none in or after the push.
    """
    singles = np.flatnonzero(contacts.kind_codes == 0)
    if not 1 <= step <= len(singles):
        raise InputError(f"step {step} is none of the walk's {len(singles)}; take one of them.", value=step)
    index = int(singles[step - 1]) + (phase == "double")
    ends = np.append(contacts.starts[1:], contacts.duration)
    if index >= len(ends):
        raise InputError(f"no double support follows step {step}; take an earlier one.", value=step)
    during = contacts.phases[index]
    time = during.start + (_SHARES[phase] + shift) * during.duration
    after = singles[ends[singles] > time + duration]
    if not after.size:
        raise InputError(f"no single support follows a push in step {step}; take an earlier one.", value=step)
    along = _along(contacts, index)
    side = 1.0 if contacts.phases[after[0]].stance == "left" else -1.0
    over_foot = side * np.array([-along[1], along[0]])
    vector = {"forward": along, "backward": -along, "narrower": over_foot, "wider": -over_foot}[direction]
    return PushInstant(float(time), vector)


def _along(contacts: Contacts, index: int) -> Array:
    """Unit vector along the walk in a phase, shape (2,)."""
    heading = contacts.headings[index]
    return np.array([np.cos(heading), np.sin(heading)])


@dataclass(frozen=True)
class Reach:
    """What feet and legs can do.

    Attributes:
        front, back: edges of the sole from its reference point, along the foot; back is negative [m].
        half_width: of the sole [m].
        along: largest distance of successive footsteps along the walk [m].
        wide: largest lateral distance of the feet [m].
        narrow: least lateral distance of the feet: legs do not cross or touch [m].
        swing: shortest time from lift-off to landing [s].
        speed: of the swinging foot [m/s].
    """

    front: float
    back: float
    half_width: float
    along: float
    wide: float
    narrow: float
    swing: float
    speed: float

    @classmethod
    def of(cls, body: BodyDescription, com_height: float) -> Self:
        """That of a body whose COM stays at a height [m].

        Both legs are straight, the rear foot stands on its ball; feet side by side keep 10 mm apart. The
        shortest swing, 0.3 s, and the speed of the foot, 5 m/s, are assumed for 1.70 m, and scaled with the
        square root of the size.
        """
        sole = body.sole
        high = com_height - body.com_over_hip - sole.ankle_height
        spread = 2.0 * math.sqrt(max(body.leg_length**2 - high**2, 0.0))
        pace = math.sqrt(body.scale)
        return cls(
            front=sole.tip_x,
            back=sole.heel_x,
            half_width=sole.half_width,
            along=spread + sole.ball_x - sole.ankle_x,
            wide=spread + 2.0 * body.hip_half_width,
            narrow=2.0 * sole.half_width + 0.01,
            swing=0.3 * pace,
            speed=5.0 * pace,
        )


def largest_dcm_along(omega: float, edge: float, foot: float, least: float, reach: Reach) -> float:
    """Largest DCM ahead of the stance foot from which steps ahead can go on for ever.

    Args:
        omega: of the pendulum [1/s].
        edge: of the sole, in that direction, from its reference point [m].
        foot: place of the swinging foot ahead of the stance foot [m].
        least: time until it can land [s].
        reach: of the legs.

    Returns:
        From the stance foot's reference point [m].
    """
    step = min(reach.along, 0.5 * reach.speed * reach.swing)
    further = step / math.expm1(omega * reach.swing)  # steps after the first landing
    return edge + max(0.0, _at_best(omega, least, foot + further, reach.along + further, reach.speed))


def _at_best(omega: float, least: float, start: float, limit: float, speed: float) -> float:
    """Largest value of ``exp(-omega t) min(limit, start + speed t)`` at times from ``least`` on."""
    times = (least, (limit - start) / speed, 1.0 / omega - start / speed)  # where the slope jumps or vanishes
    return max(math.exp(-omega * t) * min(limit, start + speed * t) for t in (max(t, least) for t in times))


def largest_dcm_across(omega: float, foot: float, least: float, reach: Reach) -> tuple[float, float]:
    """Largest DCM towards the swinging foot, and over the stance foot away from it.

    Args:
        omega: of the pendulum [1/s].
        foot: lateral distance of the swinging foot from the stance foot [m].
        least: time until it can land [s].
        reach: of the legs.

    Returns:
        Both from the stance foot's reference point, the second positive away from the swinging foot [m].
    """
    q = math.exp(-omega * reach.swing)
    cycle = 1.0 / (1.0 - q * q)
    # Steps after a wide one, and after a narrow one, from its landing.
    inward = max(0.0, (reach.wide * q - reach.narrow) * q * cycle)
    wider = _at_best(omega, least, foot + inward, reach.wide + inward, reach.speed)
    after = (reach.wide - reach.narrow * q) * q * cycle
    narrower = _at_best(omega, least, after - foot, after - reach.narrow, reach.speed)
    return reach.half_width + max(0.0, wider), reach.half_width + max(0.0, narrower)


def largest_velocity_change(
    plan: StepPlan, push: PushInstant, reach: Reach, duration: float = 0.1, lever: float = 0.0
) -> float:
    """Bound of the velocity change of a push that the gait can survive.

    In double support the rear foot lifts next. A push above the COM brings angular momentum, which the ZMP
    takes out while it comes. A trunk that stores some of it can do better.

    Args:
        plan: of the walk; at the push both its feet and its COM are where it says.
        push: when, and in which direction: along or across the walk.
        reach: of the legs.
        duration: of the push [s].
        lever: height of the push over the COM [m].

    Returns:
        Velocity change of the COM, not below 0 [m/s].

    Raises:
        InputError: the time is outside the plan.
    """
    contacts, time = plan.contacts, push.time
    state = plan.sample([time])
    omega = math.sqrt(plan.gravity / float(state.com[0, 2]))
    index = int(phase_of(contacts.starts, np.array(time)))
    double = contacts.phases[index].stance == "both"
    if index + double >= len(contacts.phases):
        raise InputError(f"no step follows a push at {time:g} s; push earlier.", value=time)
    feet = [path.position[0, :2] for path in plan.feet.sample([time])]
    standing, swing = feet if contacts.phases[index + double].stance == "left" else feet[::-1]
    least = reach.swing if double else max(reach.swing - (time - contacts.phases[index].start), 0.0)
    # The swinging foot and the DCM in the direction of the push.
    ahead = float((swing - standing) @ push.direction)
    dcm = float((state.com[0, :2] + state.com_velocity[0, :2] / omega - standing) @ push.direction)
    forward = float(push.direction @ _along(contacts, index))
    if abs(forward) > math.sqrt(0.5):
        edge = reach.front if forward > 0.0 else -reach.back
        largest = largest_dcm_along(omega, edge, ahead, least, reach)
    else:
        edge = reach.half_width
        towards_swing, over_stance = largest_dcm_across(omega, abs(ahead), least, reach)
        largest = towards_swing if ahead > 0.0 else over_stance
    if double:  # both feet may also stay where they are
        largest = max(largest, ahead + edge)
    impulse = -math.expm1(-omega * duration) / (omega * duration)
    per_velocity = impulse * (1.0 / omega + lever * omega / plan.gravity)
    return max(0.0, (largest - dcm) / per_velocity)
