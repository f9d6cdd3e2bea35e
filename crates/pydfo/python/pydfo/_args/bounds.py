"""Bounds in the forms of SciPy and NumPy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from . import values as _values
from .text import show

FloatArray = npt.NDArray[np.float64]


def pairs_of_bounds(bounds: Any, n: int | None) -> tuple[FloatArray, FloatArray]:
    """Returns lower and upper bounds from SciPy's forms: a sequence of pairs (None: no bound), or an object with
    ``lb`` and ``ub``.

    Without a start point, the number of bounds is the number of parameters."""
    if bounds is None:
        if n is None:
            raise ValueError("x0 (the start point) is missing; methods that sample a box require at least bounds")
        return np.full(n, -np.inf), np.full(n, np.inf)
    if hasattr(bounds, "lb") and hasattr(bounds, "ub"):
        if n is None:
            n = np.broadcast(np.asarray(bounds.lb), np.asarray(bounds.ub)).size
        # SciPy converts scalars, which apply to all parameters, to arrays of length one.
        lower, upper = (side[0] if np.shape(side) == (1,) else side for side in (bounds.lb, bounds.ub))
        return bound("bounds.lb", lower, n, -np.inf), bound("bounds.ub", upper, n, np.inf)
    if isinstance(bounds, str):
        raise TypeError(f"bounds must be pairs of numbers or None, not {bounds!r}; did you mean method={bounds!r}?")
    try:
        pairs = [tuple(pair) for pair in bounds]
    except TypeError:
        raise TypeError(f"bounds must be pairs of numbers or None, or an object with lb and ub, not {show(bounds)}") from None
    for index, pair in enumerate(pairs):
        if len(pair) != 2:
            raise ValueError(f"bounds[{index}] = {pair!r} has {len(pair)} values; expected 2")
    if n is not None and len(pairs) != n:
        raise ValueError(f"bounds: expected {n} pairs, one per parameter; got {len(pairs)}")
    return (
        bound("lower bounds", [pair[0] for pair in pairs], len(pairs), -np.inf),
        bound("upper bounds", [pair[1] for pair in pairs], len(pairs), np.inf),
    )


def bounds_of_least_squares(bounds: Any, x0: FloatArray) -> Any:
    """Converts bounds in the forms of SciPy's ``least_squares`` for `pairs_of_bounds`.

    These forms include lower and upper bounds as two arrays, or as two numbers that apply to all parameters. For two
    parameters, a tuple of two pairs is ambiguous. The interpretation that contains x0 is used. Raises ValueError if
    both contain x0 and differ."""
    if hasattr(bounds, "lb") or isinstance(bounds, str):
        return bounds
    try:
        first, second = bounds
        sides = [np.broadcast_to(np.asarray(side, dtype=np.float64), x0.shape) for side in (first, second)]
    except (TypeError, ValueError):
        # Not two items, a None among them, or not the length of x0.
        return bounds
    as_sides = [[lower, upper] for lower, upper in zip(*(side.tolist() for side in sides))]
    if np.shape(first) == np.shape(second) == (2,) and len(x0) == 2:
        if not isinstance(bounds, tuple):
            return bounds
        as_pairs = [list(first), list(second)]
        fits = [all(low <= x <= high for (low, high), x in zip(pairs, x0)) for pairs in (as_pairs, as_sides)]
        if as_pairs == as_sides or not fits[1]:
            return bounds
        if fits[0]:
            raise ValueError(
                f"bounds = {show(bounds)} may mean (lower, upper) for each of two parameters, or all lower and all upper bounds. "
                "Use a list of pairs, [(lower, upper), ...], or scipy.optimize.Bounds(lb, ub)"
            )
    return as_sides


def bound(name: str, value: npt.ArrayLike | Sequence[float | None] | None, n: int, default: float) -> FloatArray:
    """Returns a bound per parameter. `default` replaces None, for all or for one of them. A number applies to all."""
    if value is None:
        return np.full(n, default)
    given: Any = [default if v is None else v for v in value] if isinstance(value, (list, tuple)) else value
    array = _values.vector(name, given)
    if np.ndim(given) == 0:
        return np.full(n, array[0])
    if len(array) != n:
        raise ValueError(f"{name}: expected {n} values, one per parameter; got {len(array)}")
    return array.copy()
