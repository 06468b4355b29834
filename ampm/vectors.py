"""Vectors and rotations, compiled: vectors are three plain numbers, matrices arrays of shape (3, 3)."""

import math

from ampm.compiled import compiled
from ampm.geometry import Array

Vector = tuple[float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)


@compiled
def vector(a: Array) -> Vector:
    """Three numbers of an array of shape (3,)."""
    return a[0], a[1], a[2]


@compiled
def put(out: Array, a: Vector) -> None:
    """Write a vector into an array of shape (3,)."""
    out[0], out[1], out[2] = a


@compiled
def plus(a: Vector, b: Vector) -> Vector:
    """``a + b``."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@compiled
def minus(a: Vector, b: Vector) -> Vector:
    """``a - b``."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@compiled
def times(s: float, a: Vector) -> Vector:
    """``s a``."""
    return s * a[0], s * a[1], s * a[2]


@compiled
def dot(a: Vector, b: Vector) -> float:
    """``a . b``."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def cross(a: Vector, b: Vector) -> Vector:
    """``a x b``."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def clip(value: float, low: float, high: float) -> float:
    """The nearest number between two others."""
    return min(max(value, low), high)


@compiled
def along_across(x: float, y: float, cos: float, sin: float) -> tuple[float, float]:
    """Components of (x, y) along a heading with this cosine and sine, and to its left."""
    return cos * x + sin * y, cos * y - sin * x


@compiled
def turned(matrix: Array, a: Vector) -> Vector:
    """``matrix a``."""
    return (
        matrix[0, 0] * a[0] + matrix[0, 1] * a[1] + matrix[0, 2] * a[2],
        matrix[1, 0] * a[0] + matrix[1, 1] * a[1] + matrix[1, 2] * a[2],
        matrix[2, 0] * a[0] + matrix[2, 1] * a[1] + matrix[2, 2] * a[2],
    )


@compiled
def column(matrix: Array, k: int) -> Vector:
    """Column k of a matrix."""
    return matrix[0, k], matrix[1, k], matrix[2, k]


@compiled
def multiply(a: Array, b: Array, out: Array) -> None:
    """``out = a b``."""
    for k in range(3):
        out[0, k], out[1, k], out[2, k] = turned(a, column(b, k))


@compiled
def turn_about(matrix: Array, axis: Vector, angle: float, out: Array) -> None:
    """``out = matrix E``, with E the turn about a unit axis by an angle [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    for i in range(3):  # a row times E, by Rodrigues' formula
        row = matrix[i, 0], matrix[i, 1], matrix[i, 2]
        along = times((1.0 - c) * dot(row, axis), axis)
        put(out[i], plus(plus(times(c, row), times(s, cross(row, axis))), along))


@compiled
def from_quaternion(x: float, y: float, z: float, w: float, out: Array) -> None:
    """The rotation of a unit quaternion."""
    put(out[0], (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)))
    put(out[1], (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)))
    put(out[2], (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)))


@compiled
def rotation_vector(to: Array, start: Array) -> Vector:
    """Rotation vector in world axes that takes ``start`` to ``to``, both rotations to world [rad]."""
    sine, trace = (0.0, 0.0, 0.0), 0.0
    for k in range(3):  # of the columns: half the sum of their cross products is the axis times the sine
        before, after = column(start, k), column(to, k)
        sine = plus(sine, times(0.5, cross(before, after)))
        trace += dot(before, after)
    size = math.sqrt(dot(sine, sine))
    if size < 1e-8:  # the sine is the angle, to the last bit
        return sine
    return times(math.atan2(size, 0.5 * (trace - 1.0)) / size, sine)
