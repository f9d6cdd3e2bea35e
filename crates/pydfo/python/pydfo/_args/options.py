"""The options of a run, checked before they are passed to the native code."""

from __future__ import annotations

import functools
import logging
import operator
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any, SupportsIndex

import numpy as np
import numpy.typing as npt

from .. import _core
from . import keywords as _keywords
from . import values as _values
from .text import show

FloatArray = npt.NDArray[np.float64]

_log = logging.getLogger("pydfo")


#: Methods that need no start: they sample a box, or start in its middle.
SAMPLERS = tuple(name for name, needs_start in _core.method_names() if not needs_start)


#: User's settings by name. The native code knows the names, the defaults and the valid values.
Record = dict[str, Any]


def record(
    of: Callable[..., Any],
    method: str,
    options: Mapping[str, Any] | None,
    n: int,
    *,
    rng: int | np.random.Generator | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    function: Callable[..., Any] | None = None,
    **arguments: Any,
) -> Record:
    """Returns the settings of a run over `n` parameters for the function `of`: the options with the other arguments.

    `function` is the Python function to minimise, or None."""
    requested = dictionary(options)
    _keywords.check_options(requested, of)
    if requested.get("warm_start") is not None:
        points, problem = warm_start(requested["warm_start"], n)
        requested["warm_start"] = [{"x": x, "cost": cost, "residuals": [], "problem": problem} for x, cost in points]
    if requested.get("initial_simplex") is not None:
        check_simplex(requested["initial_simplex"], n)
    if requested.get("initial_population") is not None:
        requested["initial_population"] = population(requested["initial_population"], n)
    requested.update(arguments, method=_values.choice("method", method), seed=seed(rng))
    if checkpoint is not None:
        requested["checkpoint"] = _values.path("checkpoint", checkpoint)
        # A problem with a name identifies the objective on the user's responsibility.
        if function is not None and requested.get("problem") is None:
            requested["function"] = function_name(function)
    return requested


def function_name(function: Callable[..., Any]) -> str:
    """Returns the module and the qualified name of a function.

    For a partial, they belong to its function. For another object, they belong to its type."""
    while isinstance(function, functools.partial):
        function = function.func
    named: Any = function if hasattr(function, "__qualname__") else type(function)
    return f"{named.__module__}.{named.__qualname__}"


def tell_of_checkpoint(checkpoint: str | os.PathLike[str] | None, resume: str, options: Mapping[str, Any] | None) -> None:
    """Logs that a run continues from a file that is not bound to an objective, because the user reports the costs."""
    if checkpoint is None or resume != "auto" or (options or {}).get("problem") is not None:
        return
    place = _values.path("checkpoint", checkpoint)
    if not os.path.isfile(place):
        return
    _log.warning(
        "checkpoint %s exists, so the run continues from it or returns its result, even if the function has changed. Use resume='never' to "
        "restart, or resume='require' or options={'problem': ...} to suppress this warning",
        place,
    )


def dictionary(options: Mapping[str, Any] | None) -> dict[str, Any]:
    """Returns the argument ``options`` as a dict, whose names must be strings."""
    if options is not None and not isinstance(options, Mapping):
        raise TypeError(f"options must be a dict, not {show(options)}")
    return {_values.choice("the name of an option", name): value for name, value in (options or {}).items()}


def method_name(method: str) -> str:
    """Returns the canonical name of a method, or "auto"."""
    return _core.method_name(_values.choice("method", method))


def seed(rng: int | np.random.Generator | None) -> int | None:
    """Returns a seed from an integer or a generator; None if the optimiser draws one."""
    if rng is None:
        return None
    if isinstance(rng, np.random.Generator):
        return int(rng.integers(2**63))
    try:
        value = operator.index(rng)
    except TypeError:
        raise TypeError(f"rng must be an integer, a numpy.random.Generator or None, not {show(rng)}") from None
    if not 0 <= value < 2**64:
        raise ValueError(f"rng = {value} must be from 0 to 2**64 - 1")
    return value


def warm_start(value: Any, n: int) -> tuple[list[tuple[list[float], float]], str | None]:
    """Returns points, costs and their problem from a trace, from a result with one, or from points and costs.

    Points and costs may include the problem, so that they can be reused. Only the path of a trace is used, because it
    does not depend on workers."""
    if value is None:
        return [], None
    trace = getattr(value, "trace", value)
    problem = getattr(trace, "problem", None)
    try:
        if hasattr(trace, "fun"):
            points, costs = trace.x[trace.used], trace.fun[trace.used]
        else:
            points, costs, *rest = trace
            if len(rest) > 1:
                raise TypeError
            problem = _values.choice("the problem of a warm start", rest[0]) if rest and rest[0] is not None else None
        points = np.ma.filled(np.ma.asarray(points, dtype=np.float64), np.nan)
        costs = np.ma.filled(np.ma.asarray(costs, dtype=np.float64), np.nan)
    except (TypeError, ValueError):
        raise TypeError(f"warm_start must be a result, a trace, or points (m, n) and costs (m,), not {show(value)}") from None
    if points.ndim != 2 or points.shape[1] != n or costs.shape != points.shape[:1]:
        raise ValueError(f"warm_start: got points of shape {points.shape} and costs of shape {costs.shape}; expected shapes (m, {n}) and (m,)")
    return list(zip(points.tolist(), costs.tolist())), problem


def with_plan(options: Mapping[str, Any] | None, workers: int | None) -> dict[str, Any]:
    """Replaces a batch plan "workers" among the options by the number of workers."""
    planned = dictionary(options)
    plan = planned.get("batch")
    if isinstance(plan, str):
        planned["batch"] = (workers or all_cores()) if plan.lower() == "workers" else plan.lower()
    return planned


def worker_count(name: str, value: SupportsIndex | None, default: int | None) -> int | None:
    """Returns a number of workers. `default` replaces None, and -1 means all cores available to this process."""
    if value is None:
        return default
    try:
        count = operator.index(value)
    except TypeError:
        raise TypeError(f"{name} must be an integer, not {show(value)}") from None
    if count == -1:
        return all_cores()
    if count < 1:
        raise ValueError(f"{name} = {count} must be at least 1, or -1 for all cores")
    if count > sys.maxsize:
        raise ValueError(f"{name} = {count} is too large")
    return count


def all_cores() -> int:
    """Returns the number of cores available to this process."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def check_simplex(value: npt.ArrayLike, n: int) -> None:
    """Raises an error if `value` is neither the vertices nor the steps of a simplex."""
    try:
        if np.iscomplexobj(value):
            raise TypeError
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise TypeError(f"initial_simplex must be numbers, not {show(value)}") from None
    if not np.isfinite(array).all():
        index = np.argwhere(~np.isfinite(array))[0].tolist()
        raise ValueError(f"initial_simplex{index} = {array[tuple(index)]} must be finite")
    if array.shape != (n,) and not (array.ndim == 2 and array.shape[1] == n):
        raise ValueError(
            f"initial_simplex has shape {array.shape}; expected vertices of shape ({n + 1}, {n}), or one step per parameter, "
            f"shape ({n},)"
        )


def population(value: npt.ArrayLike, n: int) -> FloatArray:
    """Returns the members of a first population as an array, and checks its shape and that it is finite."""
    try:
        if np.iscomplexobj(value):
            raise TypeError
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise TypeError(f"initial_population must be points of shape (m, {n}), not {show(value)}") from None
    if array.ndim != 2 or array.shape[1] != n:
        raise ValueError(f"initial_population has shape {array.shape}; expected points of shape (m, {n})")
    if not np.isfinite(array).all():
        index = np.argwhere(~np.isfinite(array))[0].tolist()
        raise ValueError(f"initial_population{index} = {array[tuple(index)]} must be finite")
    return array


def solver(name: str, argument: str = "solver") -> str:
    """Returns the name of an integration method. SciPy's names and ``CVode`` are replaced by a method of pydfo."""
    alias = _core.solver_of_alias(_values.choice(argument, name))
    if alias is None:
        return name
    _log.info("%s is not available; using %s=%r instead", name, argument, alias)
    return alias


#: Defaults of the settings of a model run, except None.
_USUAL = {"solver": "auto", "chattering": "error", "input_derivatives": True}


def run_settings(**given: Any) -> Record:
    """Returns the settings of a model run that differ from the defaults. The native code knows the names and the
    valid values."""
    given["solver"] = solver(given["solver"])
    usual = {name for name, value in given.items() if value is None or (isinstance(value, (str, bool)) and value == _USUAL.get(name))}
    return {name: value for name, value in given.items() if name not in usual}
