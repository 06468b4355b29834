"""What is tried: cells of one kind of disturbance, each with rising values."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.planner.contacts import Contacts
from ampm.run_file import key_info
from ampm.section import unknown

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
HEIGHTS = ("com", "chest")
"""Where pushes act."""
STEPS = 14
"""Walked with a disturbance other than a push."""
PUSH_STEP = 4
"""Single support in which, or after which, the body is pushed; one later in every other replica."""
AFTER = 8
"""Steps walked after that one."""
REPLICAS = 5
NEEDED = 0.8
"""Share of the replicas that has to survive."""
START = 0.01
"""Error of the root's velocity at the start of all replicas but the first, see ``disturbance.start_velocity``
[m/s]."""
SHIFTS = (0.0, 0.03, -0.03, 0.06, -0.06)
"""Shift of a push in the replicas, as share of its phase [1]."""
PUSHES = "pushes"
_MOST = 2.0  # velocity change of a push [m/s]
_GRID = {"forward": 0.1, "backward": 0.1, "wider": 0.05, "narrower": 0.05}


@dataclass(frozen=True)
class Cell:
    """One disturbance with rising values."""

    name: str  # unique
    key: str  # that it sets, `pushes` for a push
    # tried in this order until one is not survived, in the key's unit; of a push its velocity change [m/s]
    values: tuple[float, ...]
    direction: Direction = "forward"  # of a push
    phase: PushPhase = "mid"  # of a push
    height: str = "com"  # of a push

    @property
    def unit(self) -> str:
        """Of its values."""
        return "m/s" if self.is_push else key_info(self.key).unit

    @property
    def is_push(self) -> bool:
        """Whether it is a kind of push."""
        return self.key == PUSHES

    @property
    def kind(self) -> str:
        """``pushes``, or the last part of the key."""
        return self.key.rpartition(".")[2]


def push_cells(quick: bool = False) -> tuple[Cell, ...]:
    """All pushes; ``quick``: early and late, on a grid of twice the size."""
    cells = []
    for height in HEIGHTS:
        for phase in PUSH_PHASES[::2] if quick else PUSH_PHASES:
            for direction in DIRECTIONS:
                step = _GRID[direction] * (2.0 if quick else 1.0)
                values = tuple(round(step * n, 6) for n in range(1, round(_MOST / step) + 1))
                name = f"{height} {phase} {direction}"
                cells.append(Cell(name, PUSHES, values, direction, phase, height))
    return tuple(cells)


def _degrees(*values: float) -> tuple[float, ...]:
    return tuple(math.radians(value) for value in values)


_LADDERS: tuple[tuple[str, str, tuple[float, ...]], ...] = (
    ("floor higher", "disturbance.floor_height", (0.002, 0.005, 0.01, 0.02, 0.03)),
    ("floor lower", "disturbance.floor_height", (-0.002, -0.005, -0.01, -0.02, -0.03)),
    ("one step higher", "disturbance.step_height", (0.002, 0.005, 0.01, 0.02, 0.03, 0.05)),
    ("one step lower", "disturbance.step_height", (-0.002, -0.005, -0.01, -0.02, -0.03, -0.05)),
    ("slope uphill", "disturbance.slope_along", _degrees(0.5, 1, 2, 3, 5)),
    ("slope downhill", "disturbance.slope_along", _degrees(-0.5, -1, -2, -3, -5)),
    ("slope across, up to the left", "disturbance.slope_across", _degrees(0.5, 1, 2, 3, 5)),
    ("slope across, up to the right", "disturbance.slope_across", _degrees(-0.5, -1, -2, -3, -5)),
    ("friction", "disturbance.friction_factor", (0.75, 0.5, 0.375, 0.25)),
    ("soft floor", "disturbance.softness_factor", (2.0, 4.0, 6.0, 8.0)),
    ("delay of sensors", "sensors.delay", (0.002, 0.004, 0.008, 0.012, 0.016)),
    ("delay of torques", "disturbance.actuation_delay", (0.002, 0.004, 0.008, 0.012)),
    ("joint damping", "disturbance.joint_damping", (0.25, 0.5, 1.0, 2.0, 4.0)),
    ("dry friction of joints", "disturbance.joint_friction", (0.25, 0.5, 1.0, 2.0, 4.0)),
    ("noise of joint angles", "sensors.angle_noise", (1e-4, 3e-4, 1e-3, 3e-3, 1e-2)),
    ("noise of joint rates", "sensors.rate_noise", (0.01, 0.025, 0.05, 0.1, 0.2)),
    ("bias of torques", "disturbance.torque_bias", (0.25, 0.5, 1.0, 2.0, 4.0)),
    ("all heavier", "disturbance.mass_change", (0.05, 0.1, 0.2)),
    ("all lighter", "disturbance.mass_change", (-0.05, -0.1, -0.2)),
)


def other_cells(quick: bool = False) -> tuple[Cell, ...]:
    """All other disturbances, and errors of sensors; ``quick``: every other value."""
    return tuple(Cell(name, key, values[1::2] if quick else values) for name, key, values in _LADDERS)


def chosen(cells: Sequence[Cell], only: Sequence[str]) -> tuple[Cell, ...]:
    """The cells of some kinds; all if none is named.

    Raises:
        InputError: there is no such kind.
    """
    kinds = {cell.kind for cell in cells}
    for name in only:
        if name not in kinds:
            raise unknown(name, sorted(kinds), "kind of disturbance", value=name)
    return tuple(cell for cell in cells if not only or cell.kind in only)


def needed(replicas: int) -> int:
    """Replicas that have to survive.

    Raises:
        InputError: there is none.
    """
    if replicas < 1:
        raise InputError(f"--replicas {replicas}: at least one walk is needed.", value=replicas)
    return math.ceil(NEEDED * replicas - 1e-9)


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
