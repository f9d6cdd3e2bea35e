"""Single arguments, checked before they are passed to the native code."""

from __future__ import annotations

import operator
import os
import sys
from collections.abc import Iterable, Mapping
from typing import SupportsFloat, SupportsIndex

import numpy as np
import numpy.typing as npt

from .text import show

FloatArray = npt.NDArray[np.float64]


def number(name: str, value: SupportsFloat | SupportsIndex) -> float:
    """Returns the argument `name` as a float."""
    if isinstance(value, (str, bytes)):
        raise TypeError(f"{name} must be a number, not {show(value)}")
    try:
        return float(value)
    except (TypeError, ValueError):
        raise TypeError(f"{name} must be a number, not {show(value)}") from None
    except OverflowError:
        raise ValueError(f"{name} must be a number up to {sys.float_info.max:.2g}, not {show(value)}") from None


def optional_number(name: str, value: SupportsFloat | SupportsIndex | None) -> float | None:
    """Returns the argument `name` as a float, or None."""
    return None if value is None else number(name, value)


def quantiles(level: SupportsFloat | SupportsIndex) -> tuple[float, float]:
    """Returns the probabilities at the ends of a central interval, after a check of its level."""
    part = number("level", level)
    if not 0.0 < part < 1.0:
        raise ValueError(f"level is {part:g}; it must be between 0 and 1")
    return 0.5 - 0.5 * part, 0.5 + 0.5 * part


def flag(name: str, value: object) -> bool:
    """Returns the argument `name`, which must be True or False (or 1 or 0)."""
    if isinstance(value, bool):
        return value
    if isinstance(value, (np.bool_, int, np.integer)) and value in (0, 1):
        return bool(value)
    raise TypeError(f"{name} must be True or False, not {show(value)}")


def path(name: str, value: str | os.PathLike[str]) -> str:
    """Returns the argument `name`, which must be a path."""
    try:
        found = os.fspath(value)
    except TypeError:
        found = None
    if not isinstance(found, str):
        raise TypeError(f"{name} must be a path, not {show(value)}")
    if not found:
        raise ValueError(f"{name} must be a path, not an empty string")
    return found


def choice(name: str, value: str) -> str:
    """Returns the argument `name`, which must be a string."""
    if not isinstance(value, str):
        raise TypeError(f"{name} must be a string, not {show(value)}")
    return value


def limit(name: str, value: SupportsFloat | None, least: int) -> int | None:
    """Returns a count; None and infinity mean no limit. Floats like 1e4 are also counts."""
    if value is None:
        return None
    count = number(name, value)
    if count == np.inf:
        return None
    if not (count >= least and count == int(count)):
        raise ValueError(f"{name} = {value} must be an integer of at least {least}")
    # A count above the maximum of the machine means no limit.
    return int(count) if count <= sys.maxsize else None


def count(name: str, value: SupportsFloat) -> int:
    """Returns a finite count of at least 1. Raises ValueError or TypeError for other values."""
    if (found := limit(name, value, 1)) is None:
        raise ValueError(f"{name} must be an integer of at least 1, not {show(value)}")
    return found


def index(name: str, value: SupportsIndex) -> int:
    """Returns an integer."""
    try:
        return operator.index(value)
    except TypeError:
        raise TypeError(f"{name} must be integers, not {show(value)}") from None


def vector(name: str, value: npt.ArrayLike) -> FloatArray:
    """Returns the argument `name` as a one-dimensional, contiguous float array, without a copy if possible.

    A number becomes an array of length one."""
    try:
        array = np.asarray(value)
        if array.dtype.kind in "cUSM":
            raise TypeError
        array = np.ascontiguousarray(array, dtype=np.float64)
    except (TypeError, ValueError):
        raise TypeError(f"{name} must be numbers, not {show(value)}") from None
    if array.ndim > 1:
        raise ValueError(f"{name} must be one-dimensional, not of shape {array.shape}")
    return array


def names(argument: str, given: Iterable[str]) -> list[str]:
    """Returns the argument `argument`, which must be names."""
    if not isinstance(given, list) and (isinstance(given, (bytes, Mapping)) or not isinstance(given, Iterable)):
        raise TypeError(f"{argument} must be a name or a list of names, not {show(given)}")
    listed = list(given)
    for name in listed:
        if not isinstance(name, str):
            raise TypeError(f"{argument} must be a name or a list of names; {show(name)} is not a name")
    return listed


def pairs(argument: str, given: Mapping[str, object] | None) -> list[tuple[str, object]]:
    """Returns the argument `argument`, which must be names with values."""
    if given is None:
        return []
    if not isinstance(given, Mapping):
        raise TypeError(f"{argument} must be a dict of names and values, not {show(given)}")
    names(argument, list(given))
    return list(given.items())


def units(given: Mapping[str, str] | None) -> list[tuple[str, str]]:
    """Returns variables with their units."""
    return [(variable, choice("units", unit)) for variable, unit in pairs("units", given)]  # type: ignore[arg-type]


def values_or_file(argument: str, given: Mapping[str, object] | str | os.PathLike[str] | None) -> tuple[list[tuple[str, object]], str | None]:
    """Returns names with values, or the path of an SSP parameter file."""
    if isinstance(given, (str, os.PathLike)):
        return [], os.fspath(given)
    return pairs(argument, given), None
