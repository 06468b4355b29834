"""The runs of a sweep, by number: columns of values that are computed when they are asked for.

Nothing here grows with the number of runs but the points of sampled blocks: a case of a grid is found from
its number. The same definition gives the same values on every machine with the same SciPy.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from validation.study.sweep.blocks import SAMPLED, Block, Range
from validation.study.sweep.definition import SweepDefinition
from validation.study.sweep.keys import KeyInfo, Value, key_info

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Column = NDArray[Any]

_DIGITS = 12  # significant digits to which a grid's inner values are rounded


@dataclass(frozen=True)
class Axis:
    """The values of one key over all cases: ``values[(case // stride) % len(values)]``.

    Attributes:
        key: namespaced name.
        values: float64, int64, or texts as objects; read-only.
        stride: cases after which the value changes.
    """

    key: str
    values: Column
    stride: int

    def index(self, cases: NDArray[np.int64]) -> NDArray[np.int64]:
        """Places of some cases in ``values``, same shape."""
        return (cases // self.stride) % len(self.values)

    def at(self, cases: NDArray[np.int64]) -> Column:
        """Values of some cases, same shape."""
        return self.values[self.index(cases)]


@dataclass(frozen=True)
class Cases:
    """All runs of a sweep, numbered from 0; several blocks are crossed, the last changing fastest.

    Attributes:
        definition: what they are the runs of.
        axes: one per varied key.
    """

    definition: SweepDefinition
    axes: tuple[Axis, ...]

    def __len__(self) -> int:
        return len(self.definition)

    @property
    def keys(self) -> tuple[str, ...]:
        """Varied keys, in the order of the blocks."""
        return tuple(axis.key for axis in self.axes)

    def columns(self, start: int = 0, stop: int | None = None) -> dict[str, Column]:
        """Varied keys of the cases ``start`` ... ``stop - 1``: arrays of float64, int64 or texts."""
        numbers = np.arange(start, len(self) if stop is None else min(stop, len(self)), dtype=np.int64)
        return {axis.key: axis.at(numbers) for axis in self.axes}

    def column(self, key: str, numbers: NDArray[np.int64]) -> Column:
        """Values of any key of the run, varied or not, in some cases, shape (n,)."""
        for axis in self.axes:
            if axis.key == key:
                return axis.at(numbers)
        section, _, name = key.partition(".")
        value = getattr(getattr(self.definition.run, section), name)
        return np.full(len(numbers), value, dtype=object if isinstance(value, str) else None)

    @cached_property
    def values(self) -> Mapping[str, Column]:
        """Varied keys of all cases; for large sweeps :meth:`columns` gives a part."""
        return self.columns()

    def row(self, case: int) -> dict[str, Value]:
        """Varied keys of one case.

        Raises:
            IndexError: there is no such case.
        """
        if not 0 <= case < len(self):
            raise IndexError(f"there is no case {case}: the sweep has {len(self)}")
        number = np.array(case, dtype=np.int64)
        return {axis.key: _plain(axis.at(number)) for axis in self.axes}

    def run(self, case: int) -> RunParameters:
        """Everything that describes one run.

        Raises:
            InputError: a value is beyond the bounds of its key.
            IndexError: there is no such case.
        """
        return self.definition.run.replace(self.row(case))

    def settings(self, case: int) -> list[str]:
        """One case as ``key=value`` settings on top of the gait, as ``ampm validate --set`` takes them."""
        given = {**self.definition.set, "gait.steps": self.definition.steps, **self.row(case)}
        return [f"{key}={value!r}" for key, value in given.items()]

    def name(self, case: int) -> str:
        """Number of a case as text, with zeros in front so that names sort as numbers do."""
        return f"{case:0{len(str(len(self) - 1))}d}"


def cases(definition: SweepDefinition) -> Cases:
    """The runs of a definition.

    Raises:
        InputError: ranges of a grid leave equal values.
    """
    axes: list[Axis] = []
    stride = len(definition)
    for number, block in enumerate(definition.vary):
        stride //= block.size
        if block.method in SAMPLED:
            columns = _sampled(block, np.random.default_rng([definition.seed, number]))
            axes += [Axis(key, _read_only(values), stride) for key, values in columns.items()]
            continue
        columns = {key: _listed(key_info(key), value) for key, value in block.keys.items()}
        inner = stride if block.method == "list" else stride * block.size
        for key, values in columns.items():
            if block.method == "grid":  # the last key changes fastest
                inner //= len(values)
            axes.append(Axis(key, _read_only(values), inner))
    return Cases(definition, tuple(axes))


def _read_only(values: Column) -> Column:
    values.setflags(write=False)
    return values


def _plain(value: Any) -> Value:
    return value.item() if hasattr(value, "item") else value


def _listed(info: KeyInfo, value: Range | tuple[Value, ...]) -> Column:
    """Values of one key of a grid or list."""
    if not isinstance(value, Range):
        kind: Any = {"text": object, "int": np.int64, "float": np.float64}[info.kind]
        return np.array(value, dtype=kind)
    count = value.count or 0
    space = np.geomspace if value.scale == "log" else np.linspace
    values = space(value.start, value.stop, count)
    if info.kind == "int":
        values = np.rint(values)
    else:
        # 1.0 rather than 1.0000000000000002: some gaits are exact only there.
        largest = max(abs(value.start), abs(value.stop))
        values = np.round(values, min(_DIGITS - math.ceil(math.log10(largest)), 300))
        values[0], values[-1] = value.start, value.stop
    if not (np.diff(values) > 0.0).all():
        raise InputError(
            f"{info.key}: {count} values from {value.start:g} to {value.stop:g} are not all different; lower "
            "its count."
        )
    return values.astype(np.int64) if info.kind == "int" else values


def _sampled(block: Block, generator: np.random.Generator) -> dict[str, Column]:
    """Points of a sampled block."""
    from scipy.stats import qmc  # takes most of a second to import

    count = block.size
    if block.method == "latin_hypercube":
        unit = qmc.LatinHypercube(d=len(block.keys), rng=generator).random(count)
    else:
        engine = qmc.Sobol(d=len(block.keys), scramble=True, rng=generator)
        # Only whole powers of two are balanced; of another number these are the first points.
        unit = engine.random_base2((count - 1).bit_length())[:count]
    return {
        key: _scaled(key_info(key), value, unit[:, i])
        for i, (key, value) in enumerate(block.keys.items())
        if isinstance(value, Range)
    }


def _scaled(info: KeyInfo, value: Range, unit: NDArray[np.float64]) -> Column:
    """Points of 0 ... 1 as values of a range; every whole number of an integer key gets an equal share."""
    whole = info.kind == "int"
    start, stop = (value.start - 0.5, value.stop + 0.5) if whole else (value.start, value.stop)
    if value.scale == "log":
        low, high = math.log(start), math.log(stop)
        values = np.exp(low + unit * (high - low))
    else:
        values = start + unit * (stop - start)
    if whole:
        return np.clip(np.rint(values), value.start, value.stop).astype(np.int64)
    return np.clip(values, value.start, value.stop)
