"""The runs of a sweep, by number: columns of values that are computed when they are read.

Nothing here grows with the number of runs but the points of sampled blocks: a case of a grid is found from
its number. The same definition gives the same values on every machine with the same SciPy.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from ampm.run_file import KeyInfo, key_info
from validation.study.sweep.design import Grid, Range, Sampled, SweepDefinition, Value

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

    def column(self, key: str, numbers: NDArray[np.int64]) -> Column:
        """Values of any key of the run, varied or not, in some cases, shape (n,)."""
        for axis in self.axes:
            if axis.key == key:
                return axis.values[axis.index(numbers)]
        section, _, name = key.partition(".")
        value = getattr(getattr(self.definition.run, section), name)
        return np.full(len(numbers), value, dtype=object if isinstance(value, str) else None)

    def row(self, case: int) -> dict[str, Value]:
        """Varied keys of one case.

        Raises:
            IndexError: there is no such case.
        """
        if not 0 <= case < len(self):
            raise IndexError(f"there is no case {case}: the sweep has {len(self)}")
        number = np.array([case])
        return {axis.key: axis.values[axis.index(number)].tolist()[0] for axis in self.axes}

    def run(self, case: int) -> RunParameters:
        """Everything that describes one run.

        Raises:
            InputError: a value is beyond the bounds of its key.
            IndexError: there is no such case.
        """
        return self.definition.run.replace(self.row(case))

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
        outer, stride = stride, stride // block.size
        if isinstance(block, Sampled):
            columns = _sampled(block, np.random.default_rng([definition.seed, number]))
        else:
            columns = {key: _listed(key_info(key), value) for key, value in block.keys.items()}
        for key, values in columns.items():
            if isinstance(block, Grid):  # the last key changes fastest
                outer //= len(values)
            values.setflags(write=False)
            axes.append(Axis(key, values, outer if isinstance(block, Grid) else stride))
    return Cases(definition, tuple(axes))


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


def _sampled(block: Sampled, generator: np.random.Generator) -> dict[str, Column]:
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
        key: _scaled(key_info(key), value, unit[:, i]) for i, (key, value) in enumerate(block.keys.items())
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
