"""Vectors of three and rotations in plain numbers: for so few elements arrays are slower."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    Vector = Sequence[float]
    Matrix = Sequence[Sequence[float]]


def cross(a: Vector, b: Vector) -> tuple[float, float, float]:
    """``a x b``."""
    ax, ay, az = a
    bx, by, bz = b
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


def rotation_error(wanted: Matrix, actual: Matrix) -> tuple[float, float, float]:
    """Small rotation vector in world axes that takes ``actual`` to ``wanted`` [rad].

    The skew part of ``wanted actual^T``, both rotations to world, shape (3, 3).
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = wanted
    (axx, axy, axz), (ayx, ayy, ayz), (azx, azy, azz) = actual
    return (
        0.5 * (zx * ayx + zy * ayy + zz * ayz - yx * azx - yy * azy - yz * azz),
        0.5 * (xx * azx + xy * azy + xz * azz - zx * axx - zy * axy - zz * axz),
        0.5 * (yx * axx + yy * axy + yz * axz - xx * ayx - xy * ayy - xz * ayz),
    )
