"""First principles in symbols, with which every formula of the paper is compared.

The force F acts on the body at the ZMP p and turns it about its COM c with M = (p - c) x F; the COM keeps its
height H. Nothing here is taken from the paper.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import sympy as sp

t = sp.Symbol("t", real=True)
g, H, m = sp.symbols("g H m", positive=True)


def moment(zmp: Sequence[Any], com: Sequence[Any], force: Sequence[Any]) -> Any:
    """``(p - c) x F``, a column of three."""
    return (sp.Matrix(zmp) - sp.Matrix(com)).cross(sp.Matrix(force))


def moment_y(zmp: Any, x: Any, acceleration: Any) -> Any:
    """Moment about +y of a body whose COM is at x and moves with an acceleration along x."""
    return moment((zmp, 0, 0), (x, 0, H), (m * acceleration, 0, m * g))[1]


def moment_x(zmp: Any, y: Any, acceleration: Any) -> Any:
    """Moment about +x of a body whose COM is at y and moves with an acceleration along y."""
    return moment((0, zmp, 0), (0, y, H), (0, m * acceleration, m * g))[0]


def acceleration_towards(zmp: Any, meets: Any) -> Any:
    """Acceleration by a force whose line starts at the ZMP and is at ``meets`` at the COM's height.

    Horizontal over vertical force is horizontal over vertical distance, and the vertical force is the weight.
    """
    return g * (meets - zmp) / H


def of_law(x: Any, rate: Any, shift: Any = 0) -> Any:
    """Residual of ``x'' = rate x + shift``."""
    return sp.diff(x, t, 2) - rate * x - shift
