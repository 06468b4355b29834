"""Which run of one sweep is which run of another."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ampm.exceptions import InputError
from validation.study.sweep.table import SweepTable

Rows = NDArray[np.int64]


@dataclass(frozen=True)
class Matching:
    """Runs of two sweeps, put side by side.

    Attributes:
        a: rows of the first sweep, shape (N,).
        b: rows of the second, shape (N,): ``b[i]`` is the same run as ``a[i]``.
        by: how they were matched, in words.
        changed: parameters that all runs of a sweep share, but not both sweeps: key, first, second value.
        only_a: parameters that only the first table has.
        only_b: parameters that only the second table has.
        missing: rows of the first sweep that the second lacks.
        new: rows of the second sweep that the first lacks.
        ambiguous: rows of the first sweep that could be several of the second, or the other way round.
    """

    a: Rows
    b: Rows
    by: str
    changed: tuple[tuple[str, str, str], ...]
    only_a: tuple[str, ...]
    only_b: tuple[str, ...]
    missing: Rows
    new: Rows
    ambiguous: Rows


def match(a: SweepTable, b: SweepTable) -> Matching:
    """Put the runs of two sweeps side by side.

    Runs with the same key are the same: it hashes every parameter and the profile. Where code has gained a
    parameter or changed a default, or the profile is another, no key is left the same; runs are then the same
    if they agree in every parameter that both tables have, but for those that are constant in either sweep
    and differ between them: these were changed for all runs alike, and are what the comparison is about.

    Raises:
        InputError: no run is in both.
    """
    pairs, rest_a, rest_b, _ = _pair(a.words("key"), b.words("key"), range(len(a)), range(len(b)))
    words = ["the same key"] if pairs else []
    common = [key for key in a.parameters if key in b]
    shared_a, shared_b = _constants(a), _constants(b)
    changed = tuple(
        (key, str(shared_a[key]), str(shared_b[key]))
        for key in common
        if key in shared_a and key in shared_b and shared_a[key] != shared_b[key]
    )
    ambiguous: list[int] = []
    if rest_a and rest_b:
        keys = [key for key in common if key not in {name for name, *_ in changed}]
        more, rest_a, rest_b, ambiguous = _pair(_signatures(a, keys), _signatures(b, keys), rest_a, rest_b)
        if more:
            words.append("the same values of all parameters that are comparable")
            pairs += more
    only_a = tuple(key for key in a.parameters if key not in b)
    only_b = tuple(key for key in b.parameters if key not in a)
    if not pairs:
        raise InputError(
            f"no run of {a.source} is in {b.source} ({_why(a, b, ambiguous)}); give two sweeps of the same "
            "definition."
        )
    pairs.sort()
    left, right = (np.array(side, dtype=np.int64) for side in zip(*pairs, strict=True))
    return Matching(
        a=left,
        b=right,
        by=" or ".join(words),
        changed=changed,
        only_a=only_a,
        only_b=only_b,
        missing=np.array(rest_a, dtype=np.int64),
        new=np.array(rest_b, dtype=np.int64),
        ambiguous=np.array(ambiguous, dtype=np.int64),
    )


def _pair(
    a: Sequence[Hashable], b: Sequence[Hashable], rows_a: Sequence[int], rows_b: Sequence[int]
) -> tuple[list[tuple[int, int]], list[int], list[int], list[int]]:
    """Pairs of equal identities; rows left of either; rows of ``a`` that have several partners.

    Equally many of the same identity on both sides are runs that were repeated: paired in their order.
    """
    places: dict[Hashable, list[int]] = defaultdict(list)
    for row in rows_b:
        places[b[row]].append(row)
    own: dict[Hashable, list[int]] = defaultdict(list)
    for row in rows_a:
        own[a[row]].append(row)
    pairs: list[tuple[int, int]] = []
    ambiguous: list[int] = []
    for identity, rows in own.items():
        partners = places.get(identity, [])
        if len(partners) == len(rows):
            pairs += zip(rows, partners, strict=True)
        elif partners:
            ambiguous += rows
    done_a, done_b = {row for row, _ in pairs}, {row for _, row in pairs}
    left_a = [row for row in rows_a if row not in done_a]
    left_b = [row for row in rows_b if row not in done_b]
    return pairs, left_a, left_b, ambiguous


def _signatures(sweep: SweepTable, keys: Sequence[str]) -> list[Hashable]:
    """Values of these parameters of every run."""
    if not keys:
        return [()] * len(sweep)
    columns = [sweep.table.column(key).to_pylist() for key in keys]
    return list(zip(*columns, strict=True))


def _constants(sweep: SweepTable) -> dict[str, object]:
    """Parameters with one value in all runs."""
    if not len(sweep):
        return {}
    varied = set(sweep.varied)
    return {key: sweep.table.column(key)[0].as_py() for key in sweep.parameters if key not in varied}


def _why(a: SweepTable, b: SweepTable, ambiguous: list[int]) -> str:
    """What keeps two sweeps apart."""
    if not len(a) or not len(b):
        return "one of them has no run"
    if ambiguous:
        return "a parameter that only one of them has varies in it, so that runs have several partners"
    one, two = set(a.varied), set(b.varied)
    if one != two:
        return f"they vary {', '.join(sorted(one)) or 'nothing'} and {', '.join(sorted(two)) or 'nothing'}"
    return f"both vary {', '.join(sorted(one)) or 'nothing'}, but at other values"


def notes(a: SweepTable, b: SweepTable, matching: Matching) -> list[str]:
    """What a reader must know of two sweeps to believe their comparison."""
    found = []
    for key, one, two in matching.changed:
        found.append(f"{key} is {one} in all runs of the first sweep and {two} in all of the second")
    for keys, which in ((matching.only_a, "first"), (matching.only_b, "second")):
        if keys:
            found.append(f"only the {which} sweep has {', '.join(keys)}")
    if a.profile != b.profile:
        found.append(f"the verdicts are of different profiles: {a.profile or '?'} and {b.profile or '?'}")
    elif {n: i.limit for n, i in a.limits.items()} != {n: i.limit for n, i in b.limits.items()}:
        found.append("the limits of the profile are not the same in both sweeps; those of the second count")
    if len(matching.ambiguous):
        found.append(f"{len(matching.ambiguous)} runs have several partners and are left out")
    for entry in ("processor", "platform", "version_mujoco", "version_numpy", "version_pin", "version_osqp"):
        first, second = (sorted(_distinct(sweep, f"environment_{entry}")) for sweep in (a, b))
        if first and second and first != second:
            label = entry.removeprefix("version_")
            found.append(
                f"{label}: {' and '.join(first)}, then {' and '.join(second)}; bits may differ for that alone"
            )
    for sweep, which in ((a, "first"), (b, "second")):
        if len(_distinct(sweep, "environment_revision")) > 1:
            found.append(f"the {which} sweep mixes revisions")
        if sweep.planned > len(sweep):
            found.append(f"the {which} sweep is not finished: {len(sweep):,} of {sweep.planned:,} runs")
    return found


def revision(sweep: SweepTable) -> str:
    """Revisions of a sweep, shortened."""
    found = sorted(_distinct(sweep, "environment_revision"))
    modified = "True" in _distinct(sweep, "environment_modified")
    return ", ".join(word[:10] for word in found) + (" (changed since)" if found and modified else "")


def _distinct(sweep: SweepTable, column: str) -> set[str]:
    return {word for word in sweep.words(column) if word}
