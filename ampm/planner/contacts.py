"""Which foot stands where, and when: footsteps and the times at which the support changes, without dynamics.

Single and double supports come in turn, the last one a double support; a stand is a long double support.
Conventions: world x forward, y left, z up, floor z = 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ampm.brief import Brief
from ampm.description import SoleGeometry
from ampm.exceptions import InputError
from ampm.geometry import rotations

Side = Literal["left", "right"]

PHASE_NAMES = ("single_support", "double_support")
"""Values of :attr:`Phase.kind`; a sample's ``phase`` is the place of its kind here."""
TIME_TOLERANCE = 1e-9
"""Times this far outside a plan are taken as its ends [s]."""
STANCE_NAMES = ("left", "right", "both")
"""Values of :attr:`Phase.stance`; a sample's ``stance`` is the place of its name here."""


class Footstep(NamedTuple):
    """One placement of one foot.

    Attributes:
        foot: which foot.
        position: reference point of the sole (x, y, z) in world [m].
        heading: direction of the foot, from x, positive to the left [rad].
        time: when the foot is to land [s]; None leaves it to the gait, or to the switches of contacts.
    """

    foot: Side
    position: tuple[float, float, float]
    heading: float = 0.0
    time: float | None = None


class Phase(NamedTuple):
    """A time during which the same feet stand on the same footsteps."""

    start: float  # [s]
    duration: float  # [s]
    left: Footstep | None  # footstep of the left foot, None while it swings
    right: Footstep | None  # likewise of the right foot

    @property
    def kind(self) -> Literal["single_support", "double_support"]:
        """Single or double support."""
        return "double_support" if self.left and self.right else "single_support"

    @property
    def stance(self) -> Literal["left", "right", "both"]:
        """The foot that stands."""
        if self.left is None:
            return "right"
        return "left" if self.right is None else "both"


LEVEL = (0.0, 0.0)
"""Slopes of a level floor along x and y [1]."""


@dataclass(frozen=True, eq=False)
class Contacts(Brief):
    """Footsteps of a walk, and when its support changes. :meth:`in_turn` checks them.

    Attributes:
        footsteps: left and right in turn, S + 2 for S steps; the first swing is from the first one to the
            third one.
        switches: when the support changes, from 0 to the end: 2 S + 1 times, or 2 S + 2 for a walk that
            begins standing, shape (P + 1,) for P phases; read-only [s].
        slope: of the floor, dz/dx and dz/dy; heights of footsteps count from it [1].
    """

    footsteps: tuple[Footstep, ...]
    switches: NDArray[np.float64]
    slope: tuple[float, float] = LEVEL

    def __post_init__(self) -> None:
        object.__setattr__(self, "switches", read_only(self.switches))

    @classmethod
    def in_turn(cls, footsteps: Sequence[Footstep], switches: ArrayLike) -> "Contacts":
        """Contacts of checked footsteps and switches, see the class.

        Raises:
            InputError: feet do not alternate, times do not ascend from 0, or their numbers do not match.
        """
        times, steps = ascending("switches", switches), len(footsteps) - 2
        if times[0] != 0.0 or steps < 1 or len(times) not in (2 * steps + 1, 2 * steps + 2):
            raise InputError(
                f"{len(footsteps)} footsteps do not fit {len(times)} switches from {times[0]:g} s on; for S "
                "steps give S + 2 footsteps and 2 S + 1 switches from 0 s on, or one more to begin standing."
            )
        try:
            finite("footsteps", [(*step.position, step.heading) for step in footsteps])
            sides = [step.foot for step in footsteps]
        except (AttributeError, TypeError):
            raise InputError("footsteps has an entry that is not ampm.Footstep(foot, (x, y, 0.0)).") from None
        if set(sides) != {"left", "right"} or any(one == other for one, other in pairwise(sides)):
            raise InputError(
                f"the footsteps' feet are {', '.join(map(str, sides[:4]))}, ...; give left and right in turn."
            )
        return cls(tuple(footsteps), times)

    @cached_property
    def _numbers(self) -> NDArray[np.intp]:
        """Numbers of the phases, shape (P,); a double support on the first two footsteps is number 0."""
        return 2 * len(self.footsteps) - 2 - len(self.switches) + np.arange(len(self.switches) - 1)

    @cached_property
    def phases(self) -> tuple[Phase, ...]:
        """Which footsteps are stood on, and when. Supports of extreme gaits may have no duration."""
        phases = []
        ends = pairwise(self.switches.tolist())
        for number, (start, end) in zip(self._numbers.tolist(), ends, strict=True):
            feet = {step.foot: step for step in self.footsteps[(number + 1) // 2 : number // 2 + 2]}
            phases.append(Phase(start, end - start, feet.get("left"), feet.get("right")))
        return tuple(phases)

    @property
    def duration(self) -> float:
        """End of the last phase [s]."""
        return float(self.switches[-1])

    @property
    def steps(self) -> int:
        """Number of single supports."""
        return int(np.count_nonzero(self.kind_codes == 0))

    @cached_property
    def step_ends(self) -> NDArray[np.float64]:
        """End of every step: where the next single support begins, or the walk ends, shape (steps,) [s]."""
        return read_only([*self.starts[self.kind_codes == 0][1:], self.duration])

    @property
    def step_length(self) -> float:
        """Distance along x of the first two footsteps that are stood on [m]."""
        return self.footsteps[2].position[0] - self.footsteps[1].position[0]

    @property
    def step_rise(self) -> float:
        """Height by which the floor rises over :attr:`step_length` [m]."""
        return self.slope[0] * self.step_length

    @property
    def step_width(self) -> float:
        """Distance along y of the first two footsteps that are stood on [m]."""
        return abs(self.footsteps[2].position[1] - self.footsteps[1].position[1])

    @cached_property
    def starts(self) -> NDArray[np.float64]:
        """Start of every phase, shape (P,) [s]."""
        return self.switches[:-1]

    @cached_property
    def kind_codes(self) -> NDArray[np.int8]:
        """Place of every phase's kind in :data:`PHASE_NAMES`, shape (P,)."""
        return read_only(self.stance_codes == 2, np.int8)

    @cached_property
    def stance_codes(self) -> NDArray[np.int8]:
        """Place of every phase's stance in :data:`STANCE_NAMES`, shape (P,)."""
        return read_only([STANCE_NAMES.index(phase.stance) for phase in self.phases], np.int8)

    @cached_property
    def placements(self) -> NDArray[np.float64]:
        """Left and right foot's (x, y, z) in every phase, the next one while it swings, (P, 2, 3) [m]."""
        return read_only(self._ahead[:, :, :3])

    @cached_property
    def headings(self) -> NDArray[np.float64]:
        """Mean heading of both feet in every phase, the next one of a foot while it swings, (P,) [rad]."""
        return read_only(mean_heading(*self.foot_headings.T))

    @cached_property
    def foot_headings(self) -> NDArray[np.float64]:
        """Heading of left and right foot in every phase, the next one while it swings, (P, 2) [rad]."""
        return read_only(self._ahead[:, :, 3])

    @cached_property
    def _ahead(self) -> NDArray[np.float64]:
        """x, y, z and heading of left and right foot in every phase, (P, 2, 4) [m, rad]."""
        steps = np.array([(*step.position, step.heading) for step in self.footsteps])
        first = (self._numbers + 1) // 2
        is_left = np.array([step.foot == "left" for step in self.footsteps])[first, None, None]
        here, next_one = steps[first], steps[first + 1]
        return np.where(is_left, np.stack([here, next_one], axis=1), np.stack([next_one, here], axis=1))


def read_only(values: object, dtype: type = np.float64) -> NDArray:
    """A read-only copy; the base array of a frozen view would stay writable."""
    array: NDArray = np.array(values, dtype=dtype)
    array.setflags(write=False)
    return array


def finite(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """A copy of a user's numbers; rejects what is not finite."""
    try:
        if np.iscomplexobj(values):
            raise TypeError
        array = np.ma.array(values, dtype=np.float64, copy=True).filled(np.nan)
    except (TypeError, ValueError):
        raise InputError(f"{name} has entries that are no numbers; give an array of numbers.") from None
    for place in np.argwhere(~np.isfinite(array))[:1]:
        raise InputError(f"{name}{place.tolist()} = {array[tuple(place)]:g}; give finite numbers.")
    return array


def ascending(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """A copy of a user's times, three or more, shape (N,) [s]; refuses those that do not ascend."""
    times = finite(name, values)
    if times.ndim != 1 or len(times) < 3:
        raise InputError(f"{name} have the shape {times.shape}; give one row of three or more times.")
    for row in np.flatnonzero(np.diff(times) <= 0.0)[:1]:
        after = f"{times[row + 1]:g} s comes after {times[row]:g} s"
        raise InputError(f"{name}[{row + 1}] = {after}; give times that ascend.")
    return times


def times_within(times: ArrayLike, duration: float) -> NDArray[np.float64]:
    """Times as an array (N,), those within the tolerance moved onto the ends of a plan of a duration [s].

    Raises :class:`InputError` if a time lies outside the plan or is not a number.
    """
    try:
        time = np.atleast_1d(np.asarray(times, dtype=np.float64))
    except (TypeError, ValueError):
        raise InputError(f"times {times!r} are not numbers; give one number or a sequence.") from None
    if time.ndim != 1:
        raise InputError(f"times have the shape {time.shape}; give one number or a sequence of numbers.")
    outside = ~((time >= -TIME_TOLERANCE) & (time <= duration + TIME_TOLERANCE))
    if outside.any():
        raise InputError(
            f"time {time[outside][0]:g} s is outside the plan's 0 ... {duration:g} s; give times within it "
            "or plan more steps."
        )
    return np.clip(time, 0.0, duration)


def mean_heading(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean of two headings on the side of their smaller angle [rad]."""
    turn = other - one
    return one + 0.5 * (turn - 2.0 * np.pi * np.round(turn / (2.0 * np.pi)))


def footprint(sole: SoleGeometry, step: Footstep) -> NDArray[np.float64]:
    """Closed outline of a sole where a footstep is, shape (7, 2) [m]."""
    x = np.array([sole.heel_x, sole.ball_x, sole.tip_x])
    half = np.array([sole.heel_half_width, sole.ball_half_width, sole.tip_half_width])
    outline = np.column_stack([np.r_[x, x[::-1], x[0]], np.r_[half, -half[::-1], half[0]]])
    return outline @ rotations(step.heading).T + np.asarray(step.position[:2])
