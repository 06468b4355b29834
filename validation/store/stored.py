"""A record on disk of which only what is asked for is read: a run has more numbers than pictures need."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from validation.store.record_layout import RecordBlock, record_blocks
from validation.trial.record import block_array, header_fields, read_header, read_record_table

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from validation.trial.record import Outcome

    Array = NDArray[np.float64]


class StoredRecord:
    """The fields of a :class:`validation.trial.record.SimulationRecord`, each read when it is first used.

    Args:
        directory: folder of a recorded run.

    Raises:
        InputError: there is no record, or one of another format.
    """

    outcome: Outcome
    mass: float
    gravity: float
    time_step: float
    friction: float
    torque_limit: Array
    joint_range: Array
    joint_names: tuple[str, ...]
    point_foot: NDArray[np.int8]
    point_group: NDArray[np.int8]

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        header = read_header(directory)
        vars(self).update(header_fields(header))
        self.steps = int(header["steps"])
        blocks: dict[str, RecordBlock] = {}
        for block in record_blocks(header):
            blocks.setdefault(block.field, block)
        self._blocks = blocks

    def __getattr__(self, name: str) -> NDArray[Any]:
        """Read a field; it is kept until :meth:`forget`.

        Raises:
            InputError: its file or one of its columns is missing.
        """
        block = vars(self).get("_blocks", {}).get(name)
        if block is None:
            raise AttributeError(f"a record has no field {name!r}")
        table = read_record_table(self.directory / block.file, block.columns)
        array = block_array(block, table, self.directory)
        array.setflags(write=False)
        vars(self)[name] = array
        return array

    def forget(self) -> None:
        """Give the memory of all arrays back; they are read again if they are used again."""
        for name in self._blocks:
            vars(self).pop(name, None)
