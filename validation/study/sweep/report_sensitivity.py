"""What drives what, as the sweep's report shows it: one row per figure, one column per parameter."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from validation.judge.metrics import metric_label
from validation.show.report import number
from validation.study.sweep.map_data import Array
from validation.study.sweep.sensitivity import (
    LEAST_RUNS,
    Influence,
    Sensitivity,
    analyse,
    entangled,
    strength,
)
from validation.study.sweep.table import State, SweepTable

MOST_COLUMNS = 12
"""Parameters in the table; more are unreadable, and most drive nothing."""
IDLE = 0.01
"""Median share of its tolerance below which a figure is rounding, and what drives it of no interest [1]."""


@dataclass(frozen=True)
class SensitivityTable:
    """The section of the report.

    Attributes:
        rows: figures; ``label``, ``runs`` and ``cells``.
        keys: parameters of the columns.
        hidden: parameters left out for room.
        by_strength: all varied parameters, those that decide on passing most first.
        drivers: parameters, each with the figures that it drives above all others.
        undriven: figures that nothing drives beyond chance.
        unsaid: reasons, each with the figures of which nothing is said for it.
        silent: why there is no table.
        entangled: parameters that vary together.
    """

    rows: list[dict[str, Any]] = field(default_factory=list)
    keys: tuple[str, ...] = ()
    hidden: tuple[str, ...] = ()
    by_strength: tuple[str, ...] = ()
    drivers: list[tuple[str, list[str]]] = field(default_factory=list)
    undriven: list[str] = field(default_factory=list)
    unsaid: list[tuple[str, list[str]]] = field(default_factory=list)
    silent: str = ""
    entangled: list[tuple[str, str, float]] = field(default_factory=list)


def targets(sweep: SweepTable) -> dict[str, Array]:
    """What may be driven: refusal, failing once walking, and every figure that is more than rounding."""
    known = np.array([True] * len(sweep))
    known &= ~sweep.is_state(State.CRASHED, State.TIMED_OUT, State.INTERRUPTED)
    refused = sweep.is_state(State.REFUSED)
    walked = known & ~refused
    found = {
        "is refused": np.where(known, refused.astype(float), np.nan),
        "fails, if it walks": np.where(walked, (~sweep.is_state(State.PASS)).astype(float), np.nan),
    }
    found = {name: values for name, values in found.items() if len(np.unique(values[~np.isnan(values)])) > 1}
    for metric in sweep.metrics:
        used = sweep.used(metric)
        if metric in sweep.limits and np.isfinite(used).any() and np.nanmedian(used) >= IDLE:
            found[metric_label(metric)] = np.where(np.isfinite(used), used, np.nan)
    return found


def sensitivity_table(sweep: SweepTable) -> SensitivityTable:
    """Analyse a sweep; see :mod:`validation.study.sweep.sensitivity`."""
    keys = sweep.varied
    if not keys:
        return SensitivityTable(silent="No parameter varies in this sweep.")
    parameters = {
        key: sweep.numbers(key) if sweep.is_number(key) else np.array(sweep.words(key)) for key in keys
    }
    found = [analyse(parameters, name, values) for name, values in targets(sweep).items()]
    ranked = _ranked(keys, found)
    if all(item.silent for item in found):
        completed = int(sweep.measured.sum())
        return SensitivityTable(
            by_strength=ranked,
            silent=f"{completed} completed run{' is' if completed == 1 else 's are'} too few to say what "
            f"drives an error; at {LEAST_RUNS} and more this section has an answer.",
        )
    columns = ranked[:MOST_COLUMNS]  # the strongest first, where no window cuts them off
    return SensitivityTable(
        rows=[_row(item, columns) for item in found if not item.silent],
        unsaid=_unsaid(found),
        keys=columns,
        hidden=ranked[MOST_COLUMNS:],
        by_strength=ranked,
        drivers=_drivers(found),
        undriven=[item.target for item in found if not item.silent and not item.drivers],
        entangled=entangled(parameters)[:6],
    )


def _ranked(keys: tuple[str, ...], found: list[Sensitivity]) -> tuple[str, ...]:
    """Parameters by their strongest influence beyond chance, outcomes before figures."""
    score = dict.fromkeys(keys, 0.0)
    outcomes = dict.fromkeys(keys, 0.0)
    for item in found:
        for influence in item.influences:
            if influence.clear:
                name, value = influence.parameter, strength(influence)
                score[name] = max(score[name], value)
                if item.target in ("is refused", "fails, if it walks"):
                    outcomes[name] = max(outcomes[name], value)
    return tuple(sorted(keys, key=lambda key: (-outcomes[key], -score[key])))


def _row(item: Sensitivity, columns: tuple[str, ...]) -> dict[str, Any]:
    runs = f"{item.runs:,} runs"
    if item.drawn_from > item.runs:
        runs = f"{item.runs:,} of {item.drawn_from:,} runs, drawn at random"
    by_name = {influence.parameter: influence for influence in item.influences}
    ranked = [influence.parameter for influence in item.drivers]
    cells = [_cell(by_name[key], item) for key in columns]
    for cell in cells:
        cell["order"] = ranked.index(cell["key"]) if cell["key"] in ranked else len(ranked)
    return {
        "label": item.target,
        "runs": runs,
        "cells": cells,
        "idle": not any(cell["beyond"] for cell in cells),
    }


def _cell(item: Influence, of: Sensitivity) -> dict[str, Any]:
    if math.isnan(item.share):
        text = "does not vary among these runs"
        return {
            "key": item.parameter,
            "lines": [("–", False)],
            "beyond": False,
            "width": 0,
            "title": f"{item.parameter}: {text}",
        }
    low, high = item.share_interval
    title = (
        f"{of.target} by {item.parameter}: S1 = {100 * item.share:.0f} % [{100 * low:.0f}, "
        f"{100 * high:.0f}], chance reaches {100 * of.noise:.0f} %"
    )
    lines = [(f"{100 * item.share:.0f}\u00a0% [{100 * low:.0f}, {100 * high:.0f}]", item.clear_share)]
    if not math.isnan(item.rho):
        bounds = ", ".join(number(float(f"{value:.2f}"), 2) for value in item.rho_interval)
        lines.append((f"ρ {_signed(item.rho)}", item.clear_rho))
        title += f"; rho = {_signed(item.rho)} [{bounds}]"
    return {
        "key": item.parameter,
        "lines": sorted(lines, key=lambda line: not line[1]),  # first what made the parameter a driver
        "beyond": item.clear,
        "width": f"{100 * item.share:.0f}" if item.clear_share else 0,
        "title": title,
    }


def _signed(value: float) -> str:
    return f"{value:+.2f}".replace("-", "−")


def _unsaid(found: list[Sensitivity]) -> list[tuple[str, list[str]]]:
    """Why nothing is said, and of what."""
    reasons: dict[str, list[str]] = {}
    for item in found:
        if item.silent:
            reasons.setdefault(item.silent, []).append(item.target)
    return list(reasons.items())


def _drivers(found: list[Sensitivity]) -> list[tuple[str, list[str]]]:
    """The strongest driver of every figure, and what it drives."""
    driven: dict[str, list[str]] = {}
    for item in found:
        if item.drivers:
            driven.setdefault(item.drivers[0].parameter, []).append(item.target)
    return list(driven.items())
