"""Functions of numbers and arrays that give the same bits on every processor, alone and in an array.

NumPy's own sines, exponentials and powers differ in the last bit between processors, and so do matrix
products and solutions of equations, which it leaves to a BLAS. Its sums, products and square roots do not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np


def elementwise(function: Callable[..., float]) -> Callable[..., Any]:
    """A function of :mod:`math` on numbers and arrays."""

    def apply(*values: Any) -> Any:
        if type(values[0]) is float:
            return function(*values)
        arrays = np.broadcast_arrays(*values)
        numbers = map(function, *(array.ravel().tolist() for array in arrays))
        return np.fromiter(numbers, np.float64, arrays[0].size).reshape(arrays[0].shape)

    return apply


sin, cos = elementwise(math.sin), elementwise(math.cos)
sinh, cosh, tanh = elementwise(math.sinh), elementwise(math.cosh), elementwise(math.tanh)
asinh, exp, log, power = (
    elementwise(math.asinh),
    elementwise(math.exp),
    elementwise(math.log),
    elementwise(math.pow),
)
hypot = elementwise(math.hypot)
arctan2 = elementwise(math.atan2)
"""Angle of the direction (x, y), given y and x [rad]."""


def sqrt(value: Any) -> Any:
    """Square root of a number or an array; of a negative number ValueError, in an array NaN."""
    return math.sqrt(value) if type(value) is float else np.sqrt(value)


def maximum(a: Any, b: Any) -> Any:
    """The larger of two numbers or arrays; NaN if one is."""
    if type(a) is type(b) is float:
        return b if a < b or b != b else a
    return np.maximum(a, b)


def where(condition: Any, yes: Any, no: Any) -> Any:
    """:func:`numpy.where`; the chosen value itself if the condition is one bool."""
    if isinstance(condition, bool):
        return yes if condition else no
    return np.where(condition, yes, no)


def product(a: Any, b: Any) -> Any:
    """``a @ b`` of a matrix or vector with a vector."""
    return (a * b).sum(axis=-1)
