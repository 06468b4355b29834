"""What is measured of another library at the same work, and the table of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from typing import Self

import numpy as np

from ampm.geometry import Array
from validation.table import Table, format_duration


@dataclass(frozen=True)
class Peer:
    """One library at one task."""

    name: str  # of the library, with its version
    median: float  # of the times of its calls [s]; NaN where it cannot be measured
    p99: float  # 99th percentile of the same [s]
    error: str  # what its answers are wrong by, or why there are none

    @classmethod
    def of(cls, name: str, seconds: Array, error: str, distribution: str = "") -> Self:
        """Sum up the times of the calls, shape (N,) [s], of a distribution's library, by default of ours."""
        title = f"{name} {metadata.version(distribution)}" if distribution else name
        return cls(title, float(np.median(seconds)), float(np.percentile(seconds, 99)), error)

    @classmethod
    def missing(cls, name: str, reason: object) -> Self:
        """A library that cannot be measured."""
        return cls(name, float("nan"), float("nan"), f"not measured: {reason}")


def peer_table(sections: Mapping[str, Sequence[Peer]]) -> Table:
    """A heading for each task, and a row for each library."""
    columns = ("", ">median", ">99th percentile", "largest error")
    rows: list[tuple[str, ...]] = []
    for task, peers in sections.items():
        rows.append((task, "", "", ""))
        for peer in peers:
            rows.append((peer.name, format_duration(peer.median), format_duration(peer.p99), peer.error))
    return Table("peers", columns, rows)
