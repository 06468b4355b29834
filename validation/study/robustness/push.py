"""When and in which direction a walk is pushed."""

from typing import Literal, NamedTuple, get_args

import numpy as np

from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.planner.contacts import Contacts

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
