"""When and in which direction a walk is pushed."""

from typing import Literal, get_args

import numpy as np

from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.planner.contacts import Contacts

DURATION = 0.1
"""Duration of the push [s]."""
Direction = Literal["forward", "backward", "wider", "narrower"]
DIRECTIONS: tuple[Direction, ...] = get_args(Direction)
"""Directions of the push, along and across the walk. *narrower* is over the foot of the single support in
which, or before which, the push ends, so that the next step must narrow or cross; *wider* is away from it."""
PushPhase = Literal["early", "mid", "late", "double"]
PUSH_PHASES: tuple[PushPhase, ...] = get_args(PushPhase)
"""When a push begins: at 12, 50, 85 % of a single support, or in mid double support after it."""
_SHARES = {"early": 0.12, "mid": 0.5, "late": 0.85, "double": 0.5}


def push_instant(
    contacts: Contacts, direction: Direction, phase: PushPhase, step: int, shift: float = 0.0
) -> tuple[float, Array]:
    """The instant of a push in a walk.

    Args:
        contacts: of the walk.
        direction: see :data:`DIRECTIONS`.
        phase: see :data:`PUSH_PHASES`.
        step: number of the single support, from 1.
        shift: share of the phase by which it begins later [1].

    Returns:
        Time at which it begins [s], and its unit vector in world, shape (2,).

    Raises:
        InputError: no single support follows this one.
    """
    singles = np.flatnonzero(contacts.kind_codes == 0)
    if step >= len(singles):
        raise InputError(f"a push in step {step} needs a later one; walk {step + 1} steps at least.")
    index = int(singles[step - 1]) + (phase == "double")
    during = contacts.phases[index]
    time = float(during.start + (_SHARES[phase] + shift) * during.duration)
    ends = np.append(contacts.starts[1:], contacts.duration)
    after = singles[ends[singles] > time + DURATION][0]
    side = 1.0 if contacts.phases[after].stance == "left" else -1.0
    heading = contacts.headings[index]
    along = np.array([np.cos(heading), np.sin(heading)])
    over_foot = side * np.array([-along[1], along[0]])
    vectors = {"forward": along, "backward": -along, "narrower": over_foot, "wider": -over_foot}
    return time, vectors[direction]
