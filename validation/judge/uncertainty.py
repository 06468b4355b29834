"""Numerical uncertainty of a gait's metrics, as ``ampm convergence`` stores it; what rounding changes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import NonNegativeFloat, create_model

from ampm.exceptions import InputError
from ampm.geometry import Array
from validation.store.environment import parameter_values
from validation.store.json import json_ready, read_json
from validation.trial.plan import Request

CONVERGENCE_FILE = "convergence.json"
RELATIVE_FLOOR = 1e-6
"""Share of a metric's value below which a difference is rounding [1].

Perturbing the body's mass by 1e-15 to 1e-12 of itself moves every metric of `normal` and `momentum` that is
not rounding itself by less than 1e-9 of its value; this is a thousand times that.
"""
ABSOLUTE_FLOOR: Mapping[str, float] = {
    "m": 1e-11,
    "m/s^2": 1e-10,
    "N": 1e-8,
    "N m": 1e-8,
    "N m s": 1e-10,
    "1": 1e-12,
}
"""The same in a metric's SI unit, for values near zero: ten times the largest observed effect of rounding."""


def rounding(size: Array | float, unit: str) -> Any:
    """Difference between two values of a size in an SI unit that may be rounding."""
    return np.fmax(RELATIVE_FLOOR * np.abs(size), ABSOLUTE_FLOOR.get(unit, 0.0))


@dataclass(frozen=True)
class Uncertainty:
    """Numerical uncertainty of a gait's metrics."""

    gait: str  # name
    steps: int  # walked at every level
    values: Mapping[str, NonNegativeFloat]  # by metric in its SI unit; infinite where there is no bound
    # by metric its largest change by another contact law or engine, in its SI unit; infinite where a walk
    # with one did not complete
    spreads: Mapping[str, NonNegativeFloat] = field(default_factory=dict)
    parameters: Mapping[str, Any] = field(default_factory=dict)  # of the run, by key

    def difference(self, request: Request) -> str:
        """First key in which a run differs from the studied one, with both values; empty if none does."""
        own, studied = json_ready(parameter_values(request.run)), json_ready(self.parameters)
        for key in {**studied, **own}:
            was, now = studied.get(key), own.get(key)
            if key != "gait.steps" and was != now:  # the gait is periodic
                return "other footsteps" if key == "footsteps" else f"{key} = {was}, and here {now}"
        return ""


def load_uncertainty(path: str | Path) -> Uncertainty:
    """Read the ``convergence.json`` of ``ampm convergence``, or of a folder; InputError if it cannot."""
    file = Path(path, CONVERGENCE_FILE) if Path(path).is_dir() else Path(path)
    kind = create_model("File", uncertainty=Uncertainty)
    way_out = f"give --uncertainty the {CONVERGENCE_FILE} that 'ampm convergence --out' writes"
    found: Uncertainty = read_json(file, kind, way_out)[1].uncertainty
    if not found.values:
        raise InputError(f"--uncertainty {file} holds no metrics: its walk did not complete; study again.")
    return found


def matching(known: Sequence[Uncertainty], request: Request) -> Uncertainty:
    """The study of this gait; raises InputError if none of them is."""
    differences = [item.difference(request) for item in known]
    if "" in differences:
        return known[differences.index("")]
    listed = "; ".join(f"{item.gait} ({text})" for item, text in zip(known, differences, strict=True))
    raise InputError(
        f"--uncertainty has no study of {request.name}, only of {listed}; run 'ampm convergence' with "
        f"the gait and the --set of this run, and give its {CONVERGENCE_FILE}."
    )
