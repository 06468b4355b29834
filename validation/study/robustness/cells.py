"""What is tried: cells of one kind of disturbance, each with rising values."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from ampm.exceptions import InputError
from ampm.geometry import Array, rotations
from ampm.planner.contacts import Contacts
from ampm.run_file import key_info
from ampm.section import unknown
from validation.table import package_rows

DURATION = 0.1
"""Duration of the push [s]."""
_GRID = {"forward": 0.1, "backward": 0.1, "wider": 0.05, "narrower": 0.05}  # [m/s]
DIRECTIONS = tuple(_GRID)
"""Directions of the push, along and across the walk. *narrower* is over the foot of the single support in
which, or before which, the push ends, so that the next step must narrow or cross; *wider* is away from it."""
_SHARES = {"early": 0.12, "mid": 0.5, "late": 0.85, "double": 0.5}
PUSH_PHASES = tuple(_SHARES)
"""When a push begins: after this share of a single support, or in mid double support after it."""
PUSHES = "pushes"
_MOST = 2.0  # velocity change of a push [m/s]


@dataclass(frozen=True)
class Cell:
    """One disturbance with rising values."""

    name: str  # unique
    key: str  # that it sets, `pushes` for a push
    # tried in this order until one is not survived, in the key's unit; of a push its velocity change [m/s]
    values: tuple[float, ...]
    direction: str = "forward"  # of a push
    phase: str = "mid"  # of a push
    height: str = "com"  # of a push

    @property
    def unit(self) -> str:
        """Unit of its values."""
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
    cells, phases = [], PUSH_PHASES[::2] if quick else PUSH_PHASES
    for height, phase, direction in product(("com", "chest"), phases, DIRECTIONS):
        step = _GRID[direction] * (2.0 if quick else 1.0)
        values = tuple(round(step * n, 6) for n in range(1, round(_MOST / step) + 1))
        cells.append(Cell(f"{height} {phase} {direction}", PUSHES, values, direction, phase, height))
    return tuple(cells)


def other_cells(quick: bool = False) -> tuple[Cell, ...]:
    """All other disturbances, and errors of sensors, of ``ladders.csv``; ``quick``: every other value."""
    cells = []
    for row in package_rows("study/robustness/ladders.csv"):
        units = (text.partition("deg") for text in row["values"].split())  # that of the key, or degrees
        values = tuple(math.radians(float(text)) if unit else float(text) for text, unit, _ in units)
        cells.append(Cell(row["name"], row["key"], values[1::2] if quick else values))
    return tuple(cells)


def chosen(cells: Sequence[Cell], only: Sequence[str]) -> tuple[Cell, ...]:
    """The cells of some kinds, all if none is named; raises InputError if there is no such kind."""
    kinds, only = {cell.kind for cell in cells}, [only] if isinstance(only, str) else only
    for name in only:
        if name not in kinds:
            raise unknown(name, sorted(kinds), "disturbance of this planner and engine", value=name)
    return tuple(cell for cell in cells if not only or cell.kind in only)


def push_instant(
    contacts: Contacts, direction: str, phase: str, step: int, shift: float = 0.0
) -> tuple[float, Array]:
    """Time at which a push begins [s], and its unit vector in world, shape (2,).

    The step is the number of the single support, from 1. The shift is the share of the phase by which it
    begins later [1]. Raises :class:`InputError` if no single support follows this one.
    """
    singles = np.flatnonzero(contacts.kind_codes == 0)
    if step >= len(singles):
        rule = f"walk {step + 1} steps at least, or study others with --only"
        raise InputError(f"a push in step {step} needs a later step; {rule}.")
    index = int(singles[step - 1]) + (phase == "double")
    during = contacts.phases[index]
    time = float(during.start + (_SHARES[phase] + shift) * during.duration)
    ends = np.append(contacts.starts[1:], contacts.duration)
    after = singles[ends[singles] > time + DURATION][0]
    along, left = rotations(contacts.headings[index]).T
    over_foot = left if contacts.phases[after].stance == "left" else -left
    vectors = {"forward": along, "backward": -along, "narrower": over_foot, "wider": -over_foot}
    return time, vectors[direction]
