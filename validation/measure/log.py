"""A log of measured signals, of a robot, another simulator or a person: read from a table, and measured.

A table has one row per instant, in SI units: x in the walking direction, y to the left, z up. It needs
``time`` and a force: of both feet together, of either foot, or at sensors. All that is read is in
:data:`COLUMNS`. An empty cell was not measured.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from itertools import chain
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.signal import detrend
from scipy.spatial.transform import Rotation

from ampm.brief import Brief
from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.section import unknown
from validation.measure.measure import LEAST_SUPPORT, MeasuredGait, SelfChecks, centre_of_pressure
from validation.trial.outcome import Outcome, OutcomeName
from validation.trial.record import FEET, INTEGERS, SHAPES, SimulationRecord, shape_of

_MEASURED = {"force": "xyz", "zmp": "xy", "com": "xyz", "angular_momentum": "xyz"}
_COMMANDED = {f"command_{name}": axes for name, axes in _MEASURED.items()}
_OF_FOOT = {
    "force": "xyz",
    "cop": "xy",
    "sensor_force": "xyz",
    "sensor_torque": "xyz",
    "sensor": "xyz",
    "sensor_quaternion": "wxyz",
    "foot": "xyz",
}
_OF_FEET = {f"{foot}_{name}": axes for foot in FEET for name, axes in _OF_FOOT.items()}
_ENDINGS = {**_MEASURED, **_COMMANDED, "floor": "", "belt_speed": "", **_OF_FEET}
COLUMNS: Mapping[str, list[str]] = MappingProxyType(
    {key: [f"{key}_{axis}" for axis in axes] or [key] for key, axes in _ENDINGS.items()}
)
"""Quantities of a log, and their columns, such as ``force_x``."""
UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "speed": {"m/s": 1.0},
    "momentum": {"N m s": 1.0},
    "torque": {"N m": 1.0, "N mm": 1e-3},
    "force": {"N": 1.0, "kN": 1e3, "kgf": 9.80665},
    "quaternion": {},
    "": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
}
"""Factor to SI by unit, of columns with a word in their name."""
NAMES = ("time", *chain(*COLUMNS.values()))
"""All columns that a log may have."""
_SOURCE = re.compile(r"(?P<sign>-?)(?P<column>.*?)\s*(?:\[(?P<unit>[^\[\]]*)\])?")
PLACES = frozenset(name for name in COLUMNS if name.endswith(("zmp", "com", "cop", "sensor", "foot")))
"""Quantities that are places in the world [m]."""
NEEDED = (
    "time, and force_x, _y, _z of both feet; or left_force_x, _y, _z and the same of right; or "
    "left_sensor_force_x, _y, _z, left_sensor_torque_x, _y, _z, left_sensor_x, _y, _z and, unless in axes of "
    "the world, left_sensor_quaternion_w, _x, _y, _z, and the same of right"
)
LOADED = 0.05
"""Share of the weight from which a foot is on the floor [1]: a sensor is never quite at zero."""
_SLOWEST = 0.05  # most time from row to row [s]
HOLE = 0.03
"""Longest time without rows that is no gap, as signals vary little in it [s]."""
_LONGEST = 3600.0  # longest gap between two rows: a clock that is set later jumps by years [s]
_OVER = 0.5  # time over which the vertical force is averaged to find a fall [s]
_CARRIED = 0.85  # least such mean, as a share of the usual one: less is a fall [1]
_RATIO = 2.0  # most ratio of mean vertical force and weight: more is another unit or body [1]
_FARTHEST = 1000.0  # largest distance of a place from its median: more is another unit [m]
_FASTEST = 15.0  # speed of a belt or place: more is another unit [m/s]
_LEAN = 1.0  # most horizontal distance of COM and ZMP over the COM's height: more slips on any floor [1]
_FILLED = 0.9  # least share of rows with numbers: with less a signal counts as missing [1]
_LOST = 0.2  # most share of a loaded foot's rows without a COP: with more it is the other foot's COP [1]
_LEVEL = np.array([[1.0, 0.0, 0.0, 0.0]])  # quaternion of axes that are the world's
_ASIDE = 2.0  # most distance of a foot's sensor from the force: more is another unit [m]
_CONTRARY = 0.9  # correlation of angular momentum and integrated moment from which both can be compared [1]
_OTHER_UNIT, _OTHER_POINT = 10.0, 100.0  # ratio of both from which unit, or reference point, is another [1]
_BIASED = 0.05  # most mean distance of COM and force line over the COM's height: more is another frame [1]
_CROSSED = -0.5  # correlation of the left foot's load with the ZMP along y: below, the sides are changed [1]
HEIGHTS = 0.05, 5.0
"""Least and largest height of the COM over the floor [m]."""
_FORCES_APART = 0.02  # most difference of forces that are given in two ways, over the weight [1]
_PLACES_APART = 0.05  # the same of places [m]


@dataclass(frozen=True)
class Log(Brief):
    """Signals of a log without its gaps: the rows in which force or ZMP are not known."""

    name: str  # for people
    time: Array  # shape (K,) [s]
    # quantity to array, (K, n), or (K,) of a single column; NaN where not measured; `force` is always there
    signals: Mapping[str, Array]
    time_step: float  # median time from row to row [s]
    lost: Array  # time before each row in which force or ZMP are not known, shape (K,) [s]
    weight: float  # of the body that it is compared with [N]

    @property
    def unsupported(self) -> str:
        """When the floor ceases to carry the body, as a sentence; empty if it never does."""
        vertical, at = self.signals["force"][:, 2], self.time[self.time <= self.time[-1] - _OVER]
        impulse = cumulative_trapezoid(vertical, self.time, initial=0.0)
        means = (np.interp(at + _OVER, self.time, impulse) - impulse[: at.size]) / _OVER
        lost = at[means < _CARRIED * np.quantile(means, 0.9)] if at.size else at
        if not lost.size:
            return ""
        return (
            f"From {lost[0]:.2f} s on the floor carries less than {100.0 * _CARRIED:g} % of the usual force "
            f"over {_OVER:g} s: the body falls, is held, or leaves the plates."
        )

    @property
    def duration(self) -> float:
        """Time that its rows stand for, without gaps [s]."""
        return float(self.time[-1] - self.time[0] - self.lost[1:].sum()) + self.time_step

    @property
    def counts(self) -> Array:
        """Time steps until the next row or gap, shape (K,) [1]: exactly 1 at an even rate."""
        counts = np.append(np.diff(self.time) - self.lost[1:], self.time_step) / self.time_step
        return np.where(np.abs(counts - 1.0) < 0.5, 1.0, counts)

    def rows(self, rows: NDArray[np.bool_]) -> "Log":
        """Some of the rows, (K,)."""
        signals = {name: values[rows] for name, values in self.signals.items()}
        return replace(self, time=self.time[rows], signals=signals, lost=self.lost[rows])

    def moved(self, by: Array) -> "Log":
        """The same with all places moved on the floor, ``by`` (2,) or (K, 2) [m]."""
        known, way = self.signals.items(), np.append(by, np.zeros_like(by[..., :1]), axis=-1)
        moved = {name: at + way[..., : at.shape[1]] for name, at in known if name in PLACES}
        return replace(self, signals={**self.signals, **moved})


def map_columns(table: Mapping[str, Any], mapping: Mapping[str, str]) -> dict[str, Any]:
    """Add columns to a table under other names, in SI units.

    The mapping has ``COLUMN``, ``COLUMN[UNIT]`` or ``-COLUMN[UNIT]``, with a unit of :data:`UNITS`, by the
    name in the log. The table may hold the column with its unit in brackets, too. Raises :class:`InputError`
    for an unknown name or unit, or a column that the table lacks.
    """
    found = dict(table)
    for name, text in mapping.items():
        if name not in NAMES:
            raise unknown(name, NAMES, "column of a log", value=name)
        match = _SOURCE.fullmatch(text)
        parts = match.groupdict() if match else {}
        column, unit = parts.get("column"), parts.get("unit")
        column = next((key for key in (text, text.removeprefix("-"), column) if key in table), None)
        if column is None:
            raise InputError(f"no column {text!r} for {name}; there are {', '.join(map(str, table))}.")
        units = next(units for word, units in UNITS.items() if word in name)
        if unit is not None and unit not in units:
            raise unknown(unit, units, f"unit of {name}", value=unit)
        sign = -1.0 if parts.get("sign") and column != text else 1.0
        found[name] = sign * units.get(str(unit), 1.0) * _real(table[column], f"the column {column!r}")
    return found


def read_log(table: Mapping[str, Any], weight: float | None, name: str = "the log") -> Log:
    """Read a log of columns (K,) by name, and find force and ZMP.

    The weight is that of the body that it is to be compared with [N]; None takes the mean size of the forces,
    which is somewhat more. Raises :class:`InputError` if a column is missing, or has values that cannot be.
    """
    have = ", ".join(map(str, table)) or "none"
    if "time" not in table:
        raise InputError(f"{name} has no column 'time'; it needs {NEEDED}; it has {have}.")
    time, signals = _numbers(table, "time", name), dict[str, Array]()
    step = _step(time, name)
    for key, parts in COLUMNS.items():
        missing = [part for part in parts if part not in table]
        if not missing:
            columns = [_numbers(table, part, name) for part in parts]
            signals[key] = np.column_stack(columns) if len(parts) > 1 else columns[0]
        elif len(missing) < len(parts):
            raise InputError(f"{name} has no column {missing[0]!r}; give all of {', '.join(parts)}.")
    if "belt_speed" in signals:
        if (empty := np.flatnonzero(np.isnan(signals["belt_speed"]))).size:
            raise InputError(f"row {empty[0] + 1} of {name}: belt_speed is empty; fill its gaps.")
        if (most := float(np.abs(signals["belt_speed"]).max())) > _FASTEST:
            raise InputError(f"{name}: belt_speed is up to {most:.4g} m/s; give it in m/s.")
        signals["belt_way"] = cumulative_trapezoid(signals["belt_speed"], time, initial=0.0)
        for key in PLACES & signals.keys():
            signals[key][:, 0] += signals["belt_way"]
    try:
        weight = _mean_force(signals) if weight is None else weight
        _add_force(signals, weight)
    except KeyError as error:
        raise InputError(f"{name} has no {error.args[0]}; it needs {NEEDED}; it has {have}.") from None
    except ValueError as error:
        raise InputError(f"{name}: invalid sensor quaternion ({error}).") from None
    for key in ("com", "angular_momentum"):
        for axis, values in zip("xy", signals[key].T if key in signals else (), strict=False):
            if np.nanmax(values) == np.nanmin(values):
                raise InputError(f"{name}: {key}_{axis} is the same in all rows; leave out its columns.")
    known = np.asarray(np.isfinite(signals["force"]).all(axis=1))
    light = signals["force"][:, 2] < LEAST_SUPPORT * weight
    if "zmp" in signals:
        signals["zmp"] = np.where(light[:, None], np.nan, signals["zmp"])  # that of no force is noise
        known = known & (light | np.isfinite(signals["zmp"]).all(axis=1))
    if np.count_nonzero(known) < 3:
        raise InputError(f"{name} has {np.count_nonzero(known)} rows with force and ZMP; give three or more.")
    _check_units(signals, time, name, weight)
    _check_force_line(signals, name, weight)
    _check_sides(signals, name, weight)
    _check_momentum(signals, time, name)
    filled = {key: float(np.isfinite(v[known & ~light]).mean()) for key, v in signals.items()}
    if rare := [key for key in ("com", "angular_momentum") if filled.get(key, 1.0) < _FILLED]:
        raise InputError(
            f"{name}: {rare[0]} has numbers in {100 * filled[rare[0]]:.1f} % of the rows with force, and "
            f"needs {100 * _FILLED:.0f} %; interpolate it to their times, or leave out its columns."
        )
    signals = {key: v for key, v in signals.items() if filled[key] >= _FILLED}
    step, lost = float(np.median(np.diff(time[known]))), np.zeros(time.size)
    apart, rows = np.diff(time[known], prepend=time[known][0] - step), np.flatnonzero(known)
    # Rows farther apart may be of a slower clock; if empty rows are between, all must be about as far apart.
    least = np.where(np.diff(rows, prepend=rows[0] - 1) > 1, 1.5 * apart.mean(), HOLE)
    lost[known] = np.where(apart > np.maximum(1.5 * step, least), apart - step, 0.0)
    return Log(name, time, signals, step, lost, weight).rows(known)


def _real(values: Any, what: str) -> Any:
    """A masked array of real numbers; refused by the name of ``what`` they are."""
    try:
        if np.iscomplexobj(values):
            raise TypeError("they are complex")
        return np.ma.array(values, dtype=np.float64, copy=True)
    except (TypeError, ValueError) as error:
        raise InputError(f"{what} must be numbers ({error}); leave out rows of names or units.") from None


def _numbers(table: Mapping[str, Any], key: str, name: str) -> Array:
    """A column of numbers; NaN where not measured."""
    numbers = _real(table[key], f"{name}: {key}").filled(np.nan)
    if numbers.shape != np.shape(table["time"]) or numbers.ndim != 1:
        raise InputError(
            f"{name}: {key} has the shape {numbers.shape}; give one number a row, as many as for time."
        )
    if len(numbers) and np.isnan(numbers).all():
        raise InputError(f"{name}: {key} holds no number; give numbers, or leave out all its axes.")
    bad = np.flatnonzero(np.isinf(numbers) | (np.isnan(numbers) & (key == "time")))
    if bad.size:
        raise InputError(f"row {bad[0] + 1} of {name}: {key} = {numbers[bad[0]]:g} must be a number.")
    return numbers


def _step(time: Array, name: str) -> float:
    """Median time from row to row [s]."""
    if len(time) < 3:
        raise InputError(f"{name} has too few rows, {len(time)}; give three or more.")
    steps = np.diff(time)
    if (late := np.flatnonzero(steps <= 0.0)).size:
        raise InputError(
            f"row {late[0] + 2} of {name}: time = {time[late[0] + 1]:.9g} must be later than in the row "
            "before; sort the rows, and leave out repeated ones."
        )
    step = float(np.median(steps))
    if step > _SLOWEST * (1.0 + 1e-9):  # first: of a clock in other units every step is such a jump
        raise InputError(
            f"{name} has a row every {step:.4g} s, and needs one every {_SLOWEST:g} s; give time in seconds."
        )
    if steps.max() > _LONGEST:
        row, jump = int(steps.argmax()) + 2, float(steps.max())
        raise InputError(f"row {row} of {name}: time jumps by {jump:.4g} s; give one log without the jump.")
    return step


def _mean_force(signals: Mapping[str, Array]) -> float:
    """Mean size of the forces on both feet [N]; raises KeyError of a quantity that is missing."""
    feet = next((kind for kind in ("force", "sensor_force") if f"left_{kind}" in signals), "")
    names = ["force"] if "force" in signals or not feet else [f"{foot}_{feet}" for foot in FEET]
    return float(np.nanmean(sum(np.linalg.norm(signals[name], axis=1) for name in names)))


def _add_force(signals: dict[str, Array], weight: float) -> None:
    """Force and ZMP of both feet, from those of either foot or from wrenches at sensors.

    Raises KeyError of a quantity that is missing.
    """
    if not {"left_force", "right_force", "left_sensor_force", "right_sensor_force"} & signals.keys():
        if "force" not in signals:
            raise KeyError("force")
        return
    by_sensor, least = "left_force" not in signals and "right_force" not in signals, LEAST_SUPPORT * weight
    floor = signals.get("floor", 0.0)
    forces, torques = [], []
    for foot in FEET:
        if by_sensor:
            turns = signals.get(f"{foot}_sensor_quaternion", _LEVEL)
            gaps = np.isnan(turns).any(axis=1, keepdims=True)
            axes = Rotation.from_quat(np.where(gaps, _LEVEL, turns), scalar_first=True)
            force = axes.apply(np.where(gaps, np.nan, signals[f"{foot}_sensor_force"]))
            torque, place = axes.apply(signals[f"{foot}_sensor_torque"]), signals[f"{foot}_sensor"]
            aside = np.hypot(*centre_of_pressure(force, torque, LOADED * weight).T)
            # What stays in place is a plate or the origin of the world, and may be far from the force.
            if (aside > _ASIDE).sum() > (aside <= _ASIDE).sum() and np.ptp(place, axis=0).any():
                raise InputError(
                    f"{foot}_sensor_torque puts the force {np.nanmedian(aside):.3g} m aside of the sensor "
                    f"(median), more than {_ASIDE:g} m; give torque in N m and force in N."
                )
            torques.append(np.cross(place, force) + torque)
            forces.append(force)
            signals[f"{foot}_force"] = force
        elif f"{foot}_cop" in signals:
            force = signals[f"{foot}_force"]
            at = np.column_stack([signals[f"{foot}_cop"], np.broadcast_to(floor, len(force))])
            light = force[:, 2:] < least  # the centre of pressure of a foot in the air is noise
            stands = force[:, 2] >= LOADED * weight
            lost = float(np.isnan(at[stands]).any(axis=1).mean()) if stands.any() else 0.0
            if lost > _LOST:
                raise InputError(
                    f"{foot}_cop is empty in {100 * lost:.0f} % of the rows in which the foot carries the "
                    "body; give it, or exchange the columns of the feet."
                )
            forces.append(np.where(light, 0.0, force))
            torques.append(np.where(light, 0.0, np.cross(at, force)))
        elif f"{foot}_sensor_force" in signals:
            raise InputError(f"{foot}_force hides {foot}_sensor_force; leave it out, or give {foot}_cop.")
    found = {"force": signals["left_force"] + signals["right_force"]}
    if len(torques) == len(FEET):
        found["zmp"] = centre_of_pressure(sum(forces), sum(torques), least, floor)
    for key, values in found.items():
        apart = np.abs(signals.setdefault(key, values) - values).max(axis=1)
        most = _FORCES_APART * weight if key == "force" else _PLACES_APART
        if np.isfinite(apart).any() and (middle := float(np.nanmedian(apart))) > most:
            unit = "N" if key == "force" else "m"
            raise InputError(
                f"{key} differs from that of both feet by {middle:.3g} {unit} or more in half of the rows, "
                f"more than {most:.3g} {unit}; correct one, or leave it out."
            )


def _check_units(signals: Mapping[str, Array], time: Array, name: str, weight: float) -> None:
    vertical = signals["force"][:, 2]
    loaded = vertical[vertical >= LOADED * weight]  # after a fall nothing is
    mean = float(np.nanmean(loaded if loaded.size else vertical))
    if not weight / _RATIO < mean < weight * _RATIO:
        raise InputError(
            f"{name}: the mean vertical force is {mean:.4g} N, and the body weighs {weight:.4g} N; give the "
            "force of the floor on the body in newtons, z upwards, or another mass ('ampm fit --mass', 'ampm "
            "judge --set body.mass=...')."
        )
    for key in (key for key in PLACES & signals.keys() if not key.endswith("cop")):  # noise in the air
        places, rows = signals[key], np.searchsorted(time, time[0] + _OVER)
        far = float(np.nanmax(np.abs(places - np.nanmedian(places, axis=0)), initial=0.0))
        speeds = np.abs(places[rows:] - places[:-rows]).max(axis=1) / (time[rows:] - time[:-rows])
        fast = float(np.quantile(speeds[np.isfinite(speeds)], 0.9)) if np.isfinite(speeds).any() else 0.0
        if far > _FARTHEST or fast > _FASTEST:
            raise InputError(
                f"{name}: {key} moves by {far:.4g} m, at {fast:.3g} m/s; give lengths in metres."
            )


def _check_force_line(signals: Mapping[str, Array], name: str, weight: float) -> None:
    """Refuse a COM that is not above the floor, or is too far from the ZMP."""
    if not {"com", "zmp"} <= signals.keys():
        return
    com, zmp = signals["com"], signals["zmp"]
    stands = signals["force"][:, 2] >= LEAST_SUPPORT * weight
    height = com[:, 2] - signals.get("floor", 0.0)
    middle = float(np.nanmedian(height))
    if not HEIGHTS[0] < middle < HEIGHTS[1]:
        raise InputError(
            f"{name}: com_z is {middle:.3g} m above the floor, beyond {HEIGHTS[0]:g} ... {HEIGHTS[1]:g} m; "
            "give it in metres, z upwards."
        )
    lean = float(np.nanmedian((np.hypot(*(com[:, :2] - zmp).T) / np.maximum(height, 1e-9))[stands]))
    if lean > _LEAN:
        raise InputError(
            f"{name}: com and zmp are {lean:.3g} times the COM's height or more apart along the floor in "
            f"half of the rows, more than {_LEAN:g}; give both in metres from one origin."
        )
    force = signals["force"][stands] / np.nanmax(np.abs(signals["force"]), initial=weight)
    # By weight of the load: of a force that chatters, the direction has no mean.
    off = force[:, 2:] * (com[stands, :2] - zmp[stands]) - height[stands, None] * force[:, :2]
    if (aside := float(np.abs(np.nanmean(off, axis=0)).max() / force[:, 2].mean()) / middle) > _BIASED:
        raise InputError(
            f"{name}: the COM is on average {aside:.2g} of its height beside the force through the ZMP, "
            f"more than {_BIASED:g}; give com, zmp and force in one frame, or leave out com."
        )


def _check_momentum(signals: Mapping[str, Array], time: Array, name: str) -> None:
    """Refuse an angular momentum that does not change as the moment of the force says."""
    if not {"com", "zmp", "angular_momentum"} <= signals.keys():
        return
    height = signals["com"][:, 2] - signals.get("floor", 0.0)
    arm = np.column_stack([signals["zmp"] - signals["com"][:, :2], -height])
    moment, momentum = np.cross(arm, signals["force"]), signals["angular_momentum"]
    known = np.isfinite(moment).all(axis=1) & np.isfinite(momentum).all(axis=1)
    if np.count_nonzero(known) < 3:
        return
    change = cumulative_trapezoid(moment[known], time[known], axis=0, initial=0.0)
    for axis in range(2):  # about the vertical, the force may twist
        expected, given = detrend(change[:, axis]), detrend(momentum[known, axis])
        if not (expected.any() and given.any()):
            continue
        alike = float(np.corrcoef(expected, given)[0, 1])
        ratio = float(np.linalg.norm(given) / np.linalg.norm(expected))
        way_out = ""
        if alike > _CONTRARY and not 1.0 / _OTHER_UNIT < ratio < _OTHER_UNIT:
            way_out = "give it in N m s"
        elif alike < -_CONTRARY or ratio > _OTHER_POINT:
            way_out = "give it about the COM in the axes of the forces, x forward, y left, z up"
        if way_out:
            change_of = f"changes by {np.copysign(ratio, alike):.4g} times what the moment of the force"
            raise InputError(
                f"{name}: angular_momentum_{'xy'[axis]} {change_of} about the COM gives; {way_out}."
            )


def _check_sides(signals: Mapping[str, Array], name: str, weight: float) -> None:
    """Refuse a left foot that carries the body while the ZMP is on the right."""
    if not {"left_force", "zmp"} <= signals.keys():
        return
    vertical, y = signals["force"][:, 2], signals["zmp"][:, 1]
    rows = np.isfinite(signals["left_force"][:, 2] + y) & (vertical >= LOADED * weight)
    share, y = signals["left_force"][rows, 2] / vertical[rows], y[rows]
    moves = rows.any() and np.ptp(share) > 0.0 and np.ptp(y) > 0.0
    if moves and np.corrcoef(share, y)[0, 1] < _CROSSED:
        raise InputError(
            f"{name}: the left foot carries the body where the ZMP is on the right; exchange the columns of "
            "the feet, or give y to the left."
        )


def measure_log(log: Log, mass: float, gravity: float) -> MeasuredGait:
    """The measurement of a log on the clock of its plan; NaN is what it does not have.

    The body has this mass [kg], and gravity is in m/s^2.
    """
    rows, nan = log.time.size, float("nan")

    def of(name: str, size: int) -> Array:
        return log.signals.get(name, np.full((rows, size), nan))

    foot_force = np.stack([of(f"{foot}_force", 3) for foot in FEET], axis=1)
    known: dict[str, Any] = {
        "time": log.time,
        "foot_force": foot_force,
        "force": log.signals["force"],
        "zmp": of("zmp", 2),
        "floor": log.signals.get("floor", np.zeros(rows)),
        "com": of("com", 3),
        "angular_momentum": of("angular_momentum", 3),
        "foot_contact": foot_force[..., 2] >= LOADED * mass * gravity,
        "point_contact": np.zeros((rows, 0), dtype=bool),
        "foot_position": np.stack([of(f"{foot}_foot", 3) for foot in FEET], axis=1),
        **dict.fromkeys(("zmp_momentum", "slip", "penetration"), np.full((rows, 2), nan)),
        "polygon_margin": np.full(rows, nan),
        "mass": mass,
        "gravity": gravity,
        "time_step": log.time_step,
        "self_checks": SelfChecks(nan, nan, nan),
    }
    others = {field.name: np.full((rows, 3), nan) for field in fields(MeasuredGait)}
    return MeasuredGait(**{**others, **known})


def log_record(log: Log, measured: MeasuredGait, steps: int) -> SimulationRecord:
    """The record of a log that covers some walking steps; NaN is what it does not have.

    Its body has no joints and no sole points.
    """
    end = float(log.time[-1] + log.time_step)
    rows = log.time.size
    sizes = {"K+1": rows + 1, "R": rows + 1, "K": rows, "R-1": rows, "F": 2, "T": 1, "L": 1}
    sizes |= dict.fromkeys(("nq", "nv", "nu", "P", "S"), 0)
    arrays: dict[str, Any] = {
        name: np.full(shape_of(name, sizes), 0 if name in INTEGERS else np.nan) for name in SHAPES
    }
    commands = {name: values for name, values in log.signals.items() if name.startswith("command_")}
    states = {name: getattr(measured, name) for name in ("com", "angular_momentum", "foot_position")}
    ends = {name: np.concatenate([values, values[-1:]]) for name, values in states.items()}
    times = {"time": np.append(log.time, end), "tick_time": np.zeros(1), "floor": np.zeros(1)}
    times["state_rows"] = np.arange(rows + 1)
    return SimulationRecord(
        **{**arrays, **commands, **ends, **times},
        outcome=Outcome(OutcomeName.COMPLETED, end, "", steps),
        mass=measured.mass,
        gravity=measured.gravity,
        time_step=log.time_step,
        joint_names=(),
    )
