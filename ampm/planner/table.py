"""A plan as a table, as ``ampm plan --samples`` writes it, and a plan from a table: COM, ZMP, footsteps.

Columns that are read, one row per instant, SI units, world frame (x forward, y left):

==============================  ===========================================================================
``time``                        ascending from 0 [s]
``stance``                      feet on the floor: ``left``, ``right`` or ``both``; single and double support
                                in turn, a double support last
``com_x com_y``                 COM [m]
``zmp_x zmp_y``                 ZMP [m]
``left_placement_x`` ...        (x, y) of either foot's footstep, of the next one while it swings [m]
``left_placement_z`` ...        optional: its height over the floor [m]; 0 by default
``left_placement_heading`` ...  optional: its heading [rad]; 0 by default
``phase_start``                 optional: when the row's phase began [s]; by default at its first row, and
                                equal steps, to a row, at equal times
``com_z``                       optional: height of the COM; by default that of the gait over the floor
``com_acceleration_x ..._y``    optional: by default the force passes through the COM, ``(g/H)(com - zmp)``;
                                refused if the COM moves otherwise, by 0.2 mm of ZMP or more
``angular_momentum_x ..._y``    optional: about the COM; if the steps do not repeat, only the first row counts
==============================  ===========================================================================

Other columns are not read. The feet are placed on the footsteps; how they swing and roll is the gait's.
Only a table that begins with a double support, a walk from standing to standing, may turn and climb.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from ampm.description import SOLE_POINT_GROUPS
from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.planner.centroidal import CentroidalPhase, CentroidalPlan, phase_of
from ampm.planner.contacts import STANCE_NAMES, Contacts, Footstep, Side
from ampm.planner.sampled import SampledLaw
from ampm.planner.stride import quintic
from ampm.planner.support import StepPlan
from ampm.section import misspelt

MOST_SAMPLES = 5_000_000
"""Samples of one table at most: about 2 GB of memory."""
REPEATED = 1e-3
"""Largest distance of the COM from that of the first step, mirrored, for steps that repeat [m]."""
_ORDER = np.array(["left", "both", "right", "both"])
_SAME = 1e-6  # of footsteps and durations that repeat [m, s]
_LARGEST = {"angular_momentum": 1e3, "com_acceleration": 1e3, "com_z": 1e2, "": 1e4}  # by a name's begin
_NOISE, _NOISY = 1e-3, 0.25  # of the ZMP between rows [m], and in which share of them
_FEET = ("left", "right")
_PLACE = ("x", "y", "z", "heading")
_NAMES = (
    *(f"{name}_{axis}" for name in ("com", "com_acceleration", "zmp", "angular_momentum") for axis in "xyz"),
    *(f"{foot}_placement_{axis}" for foot in _FEET for axis in _PLACE),
    "phase_start",
)
_GRID = 64  # instants of a step that are compared with the first one's


def sample_times(duration: float, rate: float) -> Array:
    """Times k / rate [Hz] within the duration of a plan [s].

    Raises :class:`InputError` if the rate is no positive finite number, or gives too many samples.
    """
    if not (math.isfinite(rate) and rate > 0):
        raise InputError(f"--rate {rate:g} Hz must be a positive number; give for example 200.")
    last = duration * rate * (1 + 1e-12)
    if last >= MOST_SAMPLES:
        raise InputError(
            f"--rate {rate:g} Hz gives {last:.4g} samples, over {MOST_SAMPLES}; lower the rate or the steps."
        )
    return np.minimum(np.arange(math.floor(last) + 1) / rate, duration)


def plan_table(plan: CentroidalPlan, times: Array) -> dict[str, NDArray[Any]]:
    """A plan at given times, shape (N,) [s]: column name to array (N,), in SI units and world frame.

    Every plan has the feet's placements (of a swinging foot the next one); one with a body's soles also has
    the motion of their reference points, pitch, toe angle and contacts. Undefined entries are NaN.
    """
    sample = plan.sample(times)
    phase = phase_of(plan.contacts.starts, sample.time)
    columns: dict[str, NDArray[Any]] = {
        "time": sample.time,
        "phase": sample.phase_name.astype(object),
        "stance": sample.stance_name.astype(object),
        "phase_start": plan.contacts.starts[phase],
    }

    def add(name: str, values: NDArray[Any], endings: Sequence[str] = "xyz") -> None:
        columns.update((f"{name}_{ending}", part) for ending, part in zip(endings, values.T, strict=False))

    com = ("com", "com_velocity", "com_acceleration")
    for name in (*com, "dcm", "zmp", "force", "moment", "angular_momentum"):
        add(name, getattr(sample, name))
    for side, foot in enumerate(_FEET):
        add(f"{foot}_placement", plan.contacts.placements[phase, side])
        columns[f"{foot}_placement_heading"] = plan.contacts.foot_headings[phase, side]
    if not isinstance(plan, StepPlan):
        return columns
    for foot, motion in zip(_FEET, plan.feet.sample(times), strict=True):
        add(f"{foot}_foot", motion.position)
        columns |= {f"{foot}_foot_pitch": motion.pitch, f"{foot}_toe": motion.toe}
        add(foot, motion.contact, [f"{group}_contact" for group in SOLE_POINT_GROUPS])
    return columns


def table_motion(table: Mapping[str, Any]) -> dict[str, Any]:
    """Contacts and motion of a table, as :func:`ampm.planners.make_plan` takes them.

    Args:
        table: columns by name, shape (N,) each; see the module.

    Raises:
        InputError: a column is missing, or a row has a value that makes no plan.
    """
    for column, meant in misspelt(table, _NAMES):
        raise InputError(f"the table's column {column!r} is not read; did you mean {meant!r}? Rename one.")
    if "foot" in table and "stance" not in table:
        raise InputError("the table has a column 'foot', as footsteps have; --footsteps walks them.")
    time = _numbers(table, "time")
    later = np.diff(time, prepend=-np.inf) > 0.0
    _check(time, "time", later, "ascend from row to row; give more digits, or remove repeated rows")
    _check(time[:1], "time", time[:1] == 0.0, "begin at 0; subtract the first time")
    com = _vectors(table, "com", "xyz" if "com_z" in table else "xy")
    left, right = (_placements(table, name) for name in ("left_placement", "right_placement"))
    stance = np.ma.filled(_column(table, "stance"), "").astype(str)
    _check(stance, "stance", np.isin(stance, STANCE_NAMES), f"be one of {', '.join(STANCE_NAMES)}")
    if (stance == "both").all():
        raise InputError("the table has no single support, only stance = 'both'; let a foot swing.")
    begins = np.r_[True, stance[1:] != stance[:-1]]
    stands = bool(stance[0] == "both")
    standing = stance[begins][int(stands)]  # foot of the first single support
    turn = 2 * (standing == "right") - stands
    order = _ORDER[(np.cumsum(begins) - 1 + turn) % len(_ORDER)]
    rule = f"come in the order {', '.join(_ORDER)}, and so on; give 20 ms or more to a change of feet"
    _check(stance, "stance", stance == order, rule)
    if stance[-1] != "both":
        raise InputError(f"the table ends with stance = '{stance[-1]}'; end it with double support, 'both'.")
    for foot, place in (("left", left), ("right", right)):
        on_floor = np.isin(stance, (foot, "both"))
        on_floor[1:] &= on_floor[:-1]
        for axis, values in zip(_PLACE, place.T, strict=True):
            rests = ~on_floor | (np.abs(np.diff(values, prepend=values[0])) <= _SAME)
            _check(values, f"{foot}_placement_{axis}", rests, "stay in place while the foot stands")
            if axis in ("z", "heading") and not stands:
                rule = "be 0 as the table begins with a single support; begin with a double support, standing"
                _check(values, f"{foot}_placement_{axis}", np.abs(values) <= _SAME, rule)
    started = time
    if "phase_start" in table:
        started = _numbers(table, "phase_start")
        before = np.r_[0.0, time[:-1]]
        fits = ~begins | ((started >= before - _SAME) & (started <= time + _SAME))
        _check(started, "phase_start", fits, "lie between the phase's first row and the row before")
        started = np.clip(started, before, time)
    switches = np.append(started[begins], time[-1])
    lasts = ~begins
    lasts[begins] = np.diff(switches) > 0.0
    _check(stance, "stance", lasts, "last longer than 0 s; give this support two rows or more")
    contacts = _contacts(switches, stance[begins], left[begins], right[begins])
    if "phase_start" not in table:
        contacts = _evened(contacts, time, com[:, 0])
    motion = {"times": time, "com": com, "zmp": _vectors(table, "zmp"), "contacts": contacts}
    if "com_acceleration_x" in table:
        motion["com_acceleration"] = _vectors(table, "com_acceleration")
    if "angular_momentum_x" in table:
        motion["angular_momentum"] = _vectors(table, "angular_momentum")[0]
    return motion


def _contacts(times: Array, stance: NDArray[np.str_], left: Array, right: Array) -> Contacts:
    """Contacts of P phases with begins and end (P + 1,) [s], from the columns' rows at their begins.

    Places are (x, y, z, heading). Where a single support comes first, the foot that swings starts as far
    behind the standing foot as it lands ahead of it.
    """
    places: dict[str, Array] = {"left": left, "right": right}
    stands = bool(stance[0] == "both")
    sides: tuple[Side, Side] = ("right", "left") if stance[int(stands)] == "right" else ("left", "right")

    def placed(side: Side, phase: int) -> Footstep:
        x, y, z, heading = places[side][phase].tolist()
        return Footstep(side, (x, y, z), heading)

    landings = range(1 + stands, len(stance), 2)
    footsteps = [placed(sides[number % 2], phase) for number, phase in enumerate([0, *landings])]
    here, ahead = footsteps[:2]
    behind = (2.0 * here.position[0] - ahead.position[0], ahead.position[1], 0.0)
    start = placed(sides[1], 0) if stands else ahead._replace(position=behind)
    return Contacts.in_turn([start, *footsteps], times)


def _evened(contacts: Contacts, time: Array, forward: Array) -> Contacts:
    """The contacts at equal times, if each begins within a row of them, else as they are.

    The COM's way gives the time of a step better than the rows at which the support changes.
    """
    number = np.arange(contacts.steps)
    if len(contacts.phases) != 2 * len(number) or len(number) < 2 or (np.diff(forward) <= 0.0).any():
        return contacts
    passed = np.interp(forward[0] + number * contacts.step_length, forward, time)
    step = number @ passed / (number @ number)
    # Each foot touches down between the row that shows it and the row before.
    shown = contacts.starts[1::2] - number * step
    touch = 0.5 * (shown.min() + shown.max() - np.diff(time).max())
    even = np.column_stack([number * step, number * step + touch]).ravel()
    if np.abs(even - contacts.starts).max() > np.diff(time).max():
        return contacts
    return Contacts.in_turn(contacts.footsteps, [*even, contacts.duration])


def _column(table: Mapping[str, Any], name: str) -> Any:
    if name not in table:
        raise InputError(f"the table has no column '{name}'; add it.")
    if np.shape(table[name]) != (shape := np.shape(table.get("time", table[name])))[:1]:
        raise InputError(f"the column '{name}' has the shape {np.shape(table[name])}, and time {shape}.")
    return table[name]


def _numbers(table: Mapping[str, Any], name: str) -> Array:
    """A column of finite numbers."""
    column = np.ma.asarray(_column(table, name))
    values = np.array([_number(cell) for cell in column.tolist()])  # texts become NaN, and are refused
    if len(values) < 3:
        raise InputError(f"the table has {len(values)} rows; give three or more.")
    _check(column, name, np.isfinite(values), "be a finite number; fill empty cells")
    largest = next(most for end, most in _LARGEST.items() if name.startswith(end))
    _check(values, name, np.abs(values) <= largest, f"be at most {largest:g} in magnitude; give SI units")
    return values


def _number(cell: Any) -> float:
    try:
        return float(cell)
    except (TypeError, ValueError):
        return np.nan


def _vectors(table: Mapping[str, Any], name: str, axes: str = "xy") -> Array:
    columns = [_numbers(table, f"{name}_{axis}") for axis in axes]
    if name == "zmp":
        for axis, values in zip(axes, columns, strict=True):
            bend = np.diff(values, 2)
            turns = (bend[1:] * bend[:-1] < 0.0) & (np.minimum(np.abs(bend[1:]), np.abs(bend[:-1])) > _NOISE)
            if turns.mean() > _NOISY:
                raise InputError(
                    f"{name}_{axis} of the table goes to and fro by more than {1e3 * _NOISE:g} mm between "
                    f"rows, in {100 * turns.mean():.0f} % of them; give a smooth plan, with six digits."
                )
    return np.column_stack(columns)


def _placements(table: Mapping[str, Any], name: str) -> Array:
    """x, y, z and heading of a foot's footsteps, shape (N, 4) [m, m, m, rad]."""
    places = _vectors(table, name)
    for column in (f"{name}_z", f"{name}_heading"):
        places = np.c_[places, _numbers(table, column) if column in table else np.zeros(len(places))]
    return places


def _check(values: NDArray[Any], name: str, good: NDArray[np.bool_], rule: str) -> None:
    """Refuse the first row that breaks a rule; rows count from 1."""
    if not good.all():
        row = int(np.argmin(good))
        value = values[row]
        shown = f"{value:.9g}" if isinstance(value, float | np.floating) else repr(str(value))
        raise InputError(f"row {row + 1} of the table: {name} = {shown} must {rule}.")


def repeats(plan: CentroidalPlan) -> bool:
    """Whether every step is the mirror image of the step before, about y = 0.

    Raises InputError if they are about another y.
    """
    contacts, constants = plan.contacts, plan.constants
    single, step, length = constants.single_support_duration, constants.step_duration, contacts.step_length
    number = np.arange(contacts.steps)
    starts = np.column_stack([number * step, number * step + single]).ravel()
    places = np.array([footstep.position[:2] for footstep in contacts.footsteps])
    aside = np.array([0.0, places[:2, 1].mean()])
    places -= aside
    first = mirrored(places[1], np.arange(-1, len(places) - 1), length)
    if len(starts) != len(contacts.starts) or len(places) != len(number) + 2:
        return False
    if np.abs(contacts.starts - starts).max() > _SAME or np.abs(places - first).max() > _SAME:
        return False
    times = step * np.arange(_GRID * len(number) + 1) / _GRID
    times = times[times <= plan.duration]
    com = plan.sample(times).com @ [[1.0, 0.0, -contacts.slope[0]], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    com[:, :2] -= aside
    later, index = np.divmod(np.arange(len(com)), _GRID)
    first = np.column_stack([mirrored(com[index, :2], later, length), com[index, 2]])
    if np.abs(com - first).max() > REPEATED:
        return False
    if abs(aside[1]) > 0.5 * REPEATED:  # closed_step closes a gap of twice as much
        raise InputError(
            f"the steps repeat about y = {aside[1]:g} m, not about 0; subtract it from COM, ZMP and feet."
        )
    return True


def mirrored(places: Array, steps: NDArray[Any], length: float) -> Array:
    """Places (N, 2) or (2,) of the first step, so many steps later, shape (N, 2) [m]."""
    moved: Array = places * np.column_stack([np.ones(len(steps)), (-1.0) ** steps])
    moved[:, 0] += steps * length
    return moved


def closed_step(steps: StepPlan) -> StepPlan:
    """The first step of a table whose steps repeat, with an end that is exactly its mirrored start.

    A quintic closes the gap. L_x is then opposite at both ends, and L_y the same with zero mean over the
    step, as a periodic step has.
    """
    duration, length, phase = steps.constants.step_duration, steps.contacts.step_length, steps.phases[0]
    laws, gained = [], []
    axes = [(phase.x, 1.0, length), (phase.y, -1.0, 0.0)]
    if phase.z is not None:
        axes.append((phase.z, 1.0, 0.0))
    for law, sign, shift in axes:
        time = cast(SampledLaw, law).time
        times = np.append(time[time < duration - _SAME], duration)
        state = law.evaluate(times)
        motion = np.array([state.position, state.velocity, state.acceleration])
        gap = sign * motion[:, 0] - motion[:, -1] + [shift, 0.0, 0.0]
        curve = quintic(np.zeros(3), gap, duration)
        position, velocity, acceleration = (
            values + polynomial.polyval(times, polynomial.polyder(curve, order))
            for order, values in enumerate(motion)
        )
        gained.append(float(state.moment_arm_integral[-1]))
        drift = gained[-1] / duration if sign > 0.0 else 0.0
        laws.append(SampledLaw(times, position, velocity, acceleration, state.zmp, state.moment_arm - drift))
    grid = np.linspace(0.0, duration, 1001)
    mean = float(np.trapezoid(laws[0].evaluate(grid).moment_arm_integral, grid)) / duration
    momentum = -0.5 * steps.weight * gained[1], steps.weight * mean
    high = laws[2] if phase.z is not None else None
    closed = CentroidalPhase(0.0, phase.duration, phase.origin, laws[0], laws[1], momentum, z=high)
    return replace(steps, phases=(closed,))
