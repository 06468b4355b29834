"""A walk as force plates and cameras see it, of a person or of a run: its signals, and its mean stride.

Columns of a table, one row per instant, SI units; x in the walking direction, y to the left, z up:

==================================  =======================================================================
``time``                            ascending [s]
``left_force_x ..._z right_...``    force of the floor on either foot [N]; or ``force_x ..._z`` of both
``left_cop_x ..._y right_...``      centre of pressure of either foot [m], or ``cop_x cop_y`` of both;
                                    optional with the forces of either foot
``com_x com_y com_z``               optional: centre of mass by markers [m]
``angular_momentum_x ..._z``        optional: about that [N m s]
``belt_speed``                      optional: speed of a treadmill's belt, which is added to x [m/s]
==================================  =======================================================================

An empty cell is an instant that was not measured; forces have none. Other columns are not read.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.parameters import GRAVITY
from validation.judge.margins import LOADED
from validation.store.saved import SavedRun

PHASES = 200
"""Instants of the mean stride."""
_LIGHT = 10.0  # least weight [N]: of a kilonewton or of a body's weight, the unit is wrong
_FEET = ("left", "right")
_MOST_STRIDE = 30.0  # longer ones are other units [s]
_MOST_WAY, _MOST_BESIDE = 1000.0, 30.0  # of a place forward, and sideways or up: more are other units [m]
_WHOLE = 0.8  # share of the weight from which a foot counts as the one that stands [1]


@dataclass(frozen=True)
class Walking:
    """Signals of a walk.

    Attributes:
        name: for people.
        time: shape (K,) [s].
        signals: name to shape (K,): ``force_x`` ... [N], ``zmp_x`` ..., ``com_x`` ... [m],
            ``angular_momentum_x`` ... [N m s], ``left_force_x`` ... [N]; NaN where not measured.
        share: share of the vertical force that the left foot carries, shape (K,) [1].
        weight: of the body [N]; None: the mean vertical force of whole strides.
    """

    name: str
    time: Array
    signals: Mapping[str, Array]
    share: Array
    weight: float | None = None

    @cached_property
    def strides(self) -> Strides:
        """The whole strides.

        Raises:
            InputError: there is none.
        """
        return Strides.of(self)


@dataclass(frozen=True)
class Strides:
    """Whole strides of a walk, from one instant at which the left foot takes half of the weight to the next.

    ZMP and COM are about their mean of the stride, those along x less the mean way.

    Attributes:
        starts: of the strides, and the end of the last, shape (n + 1,) [s].
        speed: mean speed along x, NaN if no place was recorded [m/s].
        weight: of the body [N].
        both: share of the time in which both feet are loaded, NaN if not known [1].
        curves: name of a signal to its values over each stride, shape (n, PHASES).
    """

    starts: Array
    speed: float
    weight: float
    both: float
    curves: Mapping[str, Array]

    @property
    def count(self) -> int:
        """Number of strides."""
        return len(self.starts) - 1

    @property
    def duration(self) -> float:
        """Mean duration of a stride [s]."""
        return float(self.starts[-1] - self.starts[0]) / self.count

    def mean(self, name: str) -> Array:
        """Mean stride of a signal, shape (PHASES,); NaN where it was never measured."""
        return _over_strides(np.nanmean, self.curves[name])

    def spread(self, name: str) -> float:
        """RMS over the stride of the standard deviation between strides; NaN of one stride."""
        if self.count < 2:
            return float("nan")
        deviation = _over_strides(np.nanstd, self.curves[name]) * np.sqrt(self.count / (self.count - 1))
        return float(np.sqrt(np.nanmean(deviation**2)))

    @classmethod
    def of(cls, walk: Walking) -> Strides:
        """Fold a walk.

        Raises:
            InputError: it has no whole stride.
        """
        time, signals = walk.time, walk.signals
        starts = take_overs(time, walk.share)
        if len(starts) < 2:
            raise InputError(
                f"{walk.name} has no whole stride: the left foot takes the weight {len(starts)} times, and "
                "must twice; give a longer recording."
            )
        mean = float(np.diff(starts).mean())
        if mean > _MOST_STRIDE:
            raise InputError(f"{walk.name} has strides of {mean:.4g} s; give the time in seconds.")
        inside = (time >= starts[0]) & (time <= starts[-1])
        weight = walk.weight or float(signals["force_z"][inside].mean())
        speed = float("nan")
        for name in ("com_x", "zmp_x", "belt_x"):
            ends = np.interp(starts[[0, -1]], time, signals[name]) if name in signals else np.full(2, np.nan)
            if np.isnan(speed):
                speed = float(ends[1] - ends[0]) / float(starts[-1] - starts[0])
        at = starts[:-1, None] + np.diff(starts)[:, None] * np.arange(PHASES) / PHASES
        curves = {name: np.interp(at, time, values) for name, values in signals.items()}
        along = (at - starts[:-1, None]) * speed
        for name in ("zmp_x", "com_x"):
            if name in curves:
                curves[name] = curves[name] - along
        for name in curves:
            if name.startswith(("zmp", "com")):
                curves[name] = curves[name] - _over_strides(np.nanmean, curves[name].T)[:, None]
        both = float("nan")
        if "left_force_z" in signals:
            both = float(np.mean(np.minimum(walk.share[inside], 1.0 - walk.share[inside]) >= LOADED))
        return cls(starts, speed, weight, both, curves)

    def com_by_force(self) -> dict[str, Array]:
        """COM of the mean stride by its force, integrated twice: periodic, about its mean.

        Returns:
            ``com_x``, ``com_y`` and ``com_z``, shape (PHASES,) [m].
        """
        rate = 2.0 * np.pi * np.fft.rfftfreq(PHASES, self.duration / PHASES)
        rate[0] = np.inf  # the mean of an acceleration that repeats is an error of the instrument
        found = {}
        for axis in "xyz":
            acceleration = self.mean(f"force_{axis}") * GRAVITY / self.weight
            found[f"com_{axis}"] = np.fft.irfft(np.fft.rfft(acceleration) / -(rate**2), PHASES)
        return found


def _over_strides(statistic: Any, values: Array) -> Array:
    """A statistic over the first axis; NaN where nothing is known."""
    known = np.isfinite(values).any(axis=0)
    found = np.full(values.shape[1], np.nan)
    if known.any():
        found[known] = statistic(values[:, known], axis=0)
    return found


def take_overs(time: Array, share: Array) -> Array:
    """Instants at which the left foot takes half of the weight [s].

    Args:
        time: shape (K,) [s].
        share: of the weight, on the left foot, shape (K,) [1]; NaN where no foot is loaded.
    """
    known = np.isfinite(share)
    if not known.any():
        return np.zeros(0)
    share = np.interp(time, time[known], share[known])
    decided = np.flatnonzero((share >= _WHOLE) | (share <= 1.0 - _WHOLE))
    left = share[decided] >= _WHOLE
    found = []
    for k in np.flatnonzero(left[1:] & ~left[:-1]):
        rows = np.arange(decided[k], decided[k + 1])
        row = rows[(share[rows] < 0.5) & (share[rows + 1] >= 0.5)][-1]
        found.append(np.interp(0.5, share[[row, row + 1]], time[[row, row + 1]]))
    return np.array(found)


def of_table(table: Mapping[str, Any], name: str) -> Walking:
    """The walk of a table, see the module.

    Args:
        table: columns by name, shape (K,) each.
        name: of the table, for messages.

    Raises:
        InputError: a column is missing, or a row has a value that cannot be.
    """
    time = _numbers(table, "time", name)
    late = np.flatnonzero(~(np.diff(time) > 0.0))
    if late.size:
        raise InputError(
            f"row {late[0] + 2} of {name}: time = {time[late[0] + 1]:.9g} must be later than in the row "
            "before; sort the rows."
        )
    by_foot = "left_force_z" in table or "right_force_z" in table
    signals: dict[str, Array] = {}
    if by_foot:
        forces = np.stack([_vectors(table, f"{foot}_force", "xyz", name) for foot in _FEET])
        for foot, values in zip(_FEET, forces, strict=True):
            signals |= _named(f"{foot}_force", values)
        force = forces.sum(axis=0)
    else:
        force = _vectors(table, "force", "xyz", name)
    mean = float(force[:, 2].mean())
    if not mean > _LIGHT:
        raise InputError(
            f"{name}: the mean of the vertical force is {mean:.4g} N and must be more than {_LIGHT:g} N; "
            "give the force of the floor on the person, z upwards, in newtons."
        )
    signals |= _named("force", force)
    zmp = None
    if by_foot and ("left_cop_x" in table or "right_cop_x" in table):
        places = np.stack([_vectors(table, f"{foot}_cop", "xy", name, gaps=True) for foot in _FEET])
        load = np.where(forces[..., 2:] >= LOADED * mean, forces[..., 2:], 0.0)
        with np.errstate(invalid="ignore", divide="ignore"):
            zmp = np.where(load > 0.0, load * places, 0.0).sum(axis=0) / load.sum(axis=0)
    elif "cop_x" in table or not by_foot:
        zmp = _vectors(table, "cop", "xy", name, gaps=True)
        zmp = np.where(force[:, 2:] >= LOADED * mean, zmp, np.nan)
    if zmp is not None:
        signals |= _named("zmp", zmp)
    with np.errstate(invalid="ignore", divide="ignore"):
        if by_foot:
            share = np.where(force[:, 2] >= LOADED * mean, forces[0, :, 2] / force[:, 2], np.nan)
        else:
            share = _share_by_zmp(signals["zmp_y"])
    for group, axes in (("com", "xyz"), ("angular_momentum", "xyz")):
        if f"{group}_x" in table:
            signals |= _named(group, _vectors(table, group, axes, name, gaps=True))
    if "belt_speed" in table:
        belt = _numbers(table, "belt_speed", name)
        way = np.concatenate([[0.0], np.cumsum(0.5 * (belt[1:] + belt[:-1]) * np.diff(time))])
        for key in ("zmp_x", "com_x"):
            if key in signals:
                signals[key] = signals[key] + way
        signals["belt_x"] = way
    for key in ("zmp_x", "zmp_y", "com_x", "com_y", "com_z"):
        most = _MOST_WAY if key.endswith("x") else _MOST_BESIDE
        if key in signals and np.nanmax(np.abs(signals[key]), initial=0.0) > most:
            raise InputError(
                f"{name}: {key} is up to {np.nanmax(np.abs(signals[key])):.4g} m; give lengths in metres."
            )
    return Walking(name, time, signals, share)


def of_run(saved: SavedRun, *, by_foot: bool = True) -> tuple[Walking, Walking]:
    """Simulated walk and plan of a run without its first step, on one clock and with the same strides.

    Args:
        saved: the run.
        by_foot: whether the load of the feet bounds the strides, not the ZMP.

    Raises:
        InputError: the run is not longer than its first step.
    """
    signals = saved.signals.take(np.arange(saved.signals.first_step(), len(saved.signals)))
    if not len(signals):
        raise InputError(f"{saved.directory} has no more than its first step; walk more.")
    feet = {f"{foot}_force": signals.vector(f"{foot}_force") for foot in _FEET}
    vertical = feet["left_force"][:, 2] + feet["right_force"][:, 2]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(vertical > 0.0, feet["left_force"][:, 2] / vertical, np.nan)
    if not by_foot:
        share = _share_by_zmp(signals["measured_zmp_y"])
    simulated: dict[str, Array] = {}
    planned: dict[str, Array] = {}
    for name, axes in (("force", "xyz"), ("zmp", "xy"), ("com", "xyz"), ("angular_momentum", "xyz")):
        simulated |= _named(name, signals.vector(f"measured_{name}", axes))
        planned |= _named(name, signals.vector(f"plan_{name}", axes))
    planned["angular_momentum_z"] = signals["motion_angular_momentum_z"]
    for name, values in feet.items():
        simulated |= _named(name, values)
    weight = float(saved.summary["scales"]["body_weight"])
    return (
        Walking("simulation", signals.time, simulated, share, weight),
        Walking("plan", signals.time, planned, share, weight),
    )


def _share_by_zmp(sideways: Array) -> Array:
    """Share of the weight on the left foot, shape (K,) [1], by the way of the ZMP from foot to foot [m]."""
    right, left = np.nanquantile(sideways, (0.1, 0.9))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((sideways - right) / (left - right))


def _named(name: str, values: Array) -> dict[str, Array]:
    """Components of a vector (K, n) by name."""
    return {f"{name}_{axis}": column for axis, column in zip("xyz", values.T, strict=False)}


def _vectors(table: Mapping[str, Any], group: str, axes: str, name: str, *, gaps: bool = False) -> Array:
    return np.column_stack([_numbers(table, f"{group}_{axis}", name, gaps=gaps) for axis in axes])


def _numbers(table: Mapping[str, Any], column: str, name: str, *, gaps: bool = False) -> Array:
    """A column of numbers; with ``gaps`` some may be NaN."""
    if column not in table:
        raise InputError(f"{name} has no column {column!r}; it has {', '.join(map(str, table)) or 'none'}.")
    try:
        values = np.asarray(table[column]).astype(np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: {column} must be numbers ({error}).") from None
    bad = np.flatnonzero(np.isinf(values) if gaps else ~np.isfinite(values))
    if bad.size:
        raise InputError(
            f"row {bad[0] + 1} of {name}: {column} = {values[bad[0]]:g} must be a finite number; cut the "
            "recording there, or fill the gap."
        )
    if len(values) < 3 or not np.isfinite(values).any():
        raise InputError(f"{name}: {column} has {np.isfinite(values).sum()} numbers; give three or more.")
    return values
