"""What may be chosen about a run, checked on the way to the native code."""

from __future__ import annotations

import logging
import operator
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, SupportsFloat, SupportsIndex

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

_log = logging.getLogger("pydfo")


@dataclass(frozen=True)
class Options:
    """The options of a run, as the native code reads them; None is no limit."""

    x_tol: float
    f_tol: float
    stop: str
    batch: str
    max_evaluations: int | None
    max_iterations: int | None
    max_time: float | None
    target: float | None
    workers: int | None
    vertices: list[list[float]] | None = None
    steps: list[float] | None = None


def number(name: str, value: SupportsFloat | SupportsIndex) -> float:
    """The argument `name` as a float."""
    try:
        return float(value)
    except (TypeError, ValueError):
        raise TypeError(f"{name} must be a number, not {value!r}") from None


def optional_number(name: str, value: SupportsFloat | SupportsIndex | None) -> float | None:
    """The argument `name` as a float, or None."""
    return None if value is None else number(name, value)


def choice(name: str, value: str) -> str:
    """The argument `name`, which must be a string."""
    if not isinstance(value, str):
        raise TypeError(f"{name} must be a string, not {value!r}")
    return value


def limit(name: str, value: SupportsFloat | None, least: int) -> int | None:
    """A count; None and infinity are no limit. Floats like 1e4 are counts, too."""
    if value is None:
        return None
    count = number(name, value)
    if count == np.inf:
        return None
    if not (count >= least and count == int(count)):
        raise ValueError(f"{name} = {value} must be a whole number, at least {least}")
    return int(count)


def worker_count(name: str, value: SupportsIndex | None, default: int | None) -> int | None:
    """A number of workers: None stands for `default`, -1 for all cores that this process may use."""
    if value is None:
        return default
    try:
        count = operator.index(value)
    except TypeError:
        raise TypeError(f"{name} must be a whole number, not {value!r}") from None
    if count == -1:
        return all_cores()
    if count < 1:
        raise ValueError(f"{name} = {count} must be at least 1, or -1 for all cores")
    return count


def all_cores() -> int:
    """The number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def vector(name: str, value: npt.ArrayLike) -> FloatArray:
    """The argument `name` as a one-dimensional array; a number becomes an array of one."""
    try:
        array = np.asarray(value)
        if array.dtype.kind == "c":
            raise TypeError
        array = array.astype(np.float64)
    except (TypeError, ValueError):
        raise TypeError(f"{name} must be numbers, not {value!r}") from None
    if array.ndim > 1:
        raise ValueError(f"{name} must be one-dimensional, not of shape {array.shape}")
    return np.atleast_1d(array)


def bound(name: str, value: npt.ArrayLike | Sequence[float | None] | None, n: int, default: float) -> FloatArray:
    """A bound per parameter; None, for all or for one of them, stands for `default`; a number holds for all."""
    if value is None:
        return np.full(n, default)
    given: Any = [default if v is None else v for v in value] if isinstance(value, (list, tuple)) else value
    array = vector(name, given)
    if np.ndim(given) == 0:
        return np.full(n, array[0])
    if len(array) != n:
        raise ValueError(f"{name} has {len(array)} values for {n} parameters")
    return array


def simplex(value: npt.ArrayLike | None, n: int) -> tuple[list[list[float]] | None, list[float] | None]:
    """Vertices or steps of an initial simplex from the argument ``initial_simplex``."""
    if value is None:
        return None, None
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise TypeError(f"initial_simplex must be numbers, not {value!r}") from None
    if array.ndim == 2 and array.shape[1] == n:
        return array.tolist(), None
    if array.shape == (n,):
        return None, array.tolist()
    raise ValueError(
        f"initial_simplex of shape {array.shape}: either vertices, shape ({n + 1}, {n}), or one step per parameter, "
        f"shape ({n},), is needed"
    )


def solver(name: str) -> str:
    """The name of an integration method; ``CVode``, which other tools have, stands for "auto"."""
    if choice("solver", name).lower() == "cvode":
        _log.info("there is no CVode here: solver='auto' is used instead")
        return "auto"
    return name
