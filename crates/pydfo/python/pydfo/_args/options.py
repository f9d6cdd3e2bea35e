"""The options of a run, checked on the way to the native code."""

from __future__ import annotations

import importlib
import logging
import operator
import os
import reprlib
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, SupportsFloat, SupportsIndex

import numpy as np
import numpy.typing as npt

from .. import _core
from . import keywords as _keywords

FloatArray = npt.NDArray[np.float64]

_log = logging.getLogger("pydfo")


_shortened = reprlib.Repr()
_shortened.maxstring = _shortened.maxother = 80


def show(value: object) -> str:
    """A value for a message: of long ones the beginning."""
    return " ".join(_shortened.repr(value).split())


def library(name: str, user: str) -> Any:
    """A module that `user` needs and that need not be there."""
    try:
        return importlib.import_module(name)
    except ImportError as e:
        raise ImportError(f"{user} needs {name}: pip install {name}") from e


def pandas() -> Any:
    """The module, where a table of it is asked for."""
    return library("pandas", "to_dataframe()")


def beginning(text: str) -> str:
    """A text for a message: of a long one the beginning."""
    return text if len(text) <= 500 else f"{text[:500]}..."


#: The methods that need no start: they sample a box, or begin in its middle.
SAMPLERS = tuple(name for name, needs_start in _core.method_names() if not needs_start)


#: What a user asks for, by name: the native code knows the names, the defaults and what values may be.
Record = dict[str, Any]


def record(
    of: Callable[..., Any],
    method: str,
    options: Mapping[str, Any] | None,
    n: int,
    *,
    rng: int | np.random.Generator | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    function: Sequence[Any] = (),
    **arguments: Any,
) -> Record:
    """What the user of the function `of` asks for of a run over `n` parameters: the options, with the arguments that name more.
    `function`: what is minimised, and what it is called with; nothing where no Python function is."""
    asked = dictionary(options)
    _keywords.check_options(asked, of)
    if asked.get("warm_start") is not None:
        points, problem = warm_start(asked["warm_start"], n)
        asked["warm_start"] = [{"x": x, "cost": cost, "residuals": [], "problem": problem} for x, cost in points]
    if asked.get("initial_simplex") is not None:
        check_simplex(asked["initial_simplex"], n)
    asked.update(arguments, method=choice("method", method), seed=seed(rng))
    if checkpoint is not None:
        asked["checkpoint"] = path("checkpoint", checkpoint)
        # A problem with a name is the user's word for what is minimised.
        if function and asked.get("problem") is None:
            from . import identity

            text, is_hash = identity.of_code(*function)
            asked["code"] = {"hash" if is_hash else "unknown": text}
    return asked


def tell_of_checkpoint(checkpoint: str | os.PathLike[str] | None, resume: str, options: Mapping[str, Any] | None) -> None:
    """Logs that a run goes on from a file that nothing binds to what is minimised, for the costs are told by hand."""
    if checkpoint is None or resume != "auto" or (options or {}).get("problem") is not None:
        return
    place = path("checkpoint", checkpoint)
    if not os.path.isfile(place):
        return
    _log.warning(
        "checkpoint %s is there: the run goes on from it, or its result is returned, whatever the function computes now; resume='never' "
        "begins anew, resume='require' or options={'problem': ...} say that this is meant",
        place,
    )


def dictionary(options: Mapping[str, Any] | None) -> dict[str, Any]:
    """The argument ``options``, which must have strings for names."""
    if options is not None and not isinstance(options, Mapping):
        raise TypeError(f"options must be a dict, not {show(options)}")
    return {choice("the name of an option", name): value for name, value in (options or {}).items()}


def method_name(method: str) -> str:
    """The name of the method that is called so, or "auto"."""
    return _core.method_name(choice("method", method))


def seed(rng: int | np.random.Generator | None) -> int | None:
    """A seed from an integer, or drawn from a generator; None: the optimiser draws one."""
    if rng is None:
        return None
    if isinstance(rng, np.random.Generator):
        return int(rng.integers(2**63))
    try:
        value = operator.index(rng)
    except TypeError:
        raise TypeError(f"rng must be a whole number, a numpy.random.Generator or None, not {show(rng)}") from None
    if not 0 <= value < 2**64:
        raise ValueError(f"rng = {value} must be from 0 to 2**64 - 1")
    return value


def warm_start(value: Any, n: int) -> tuple[list[tuple[list[float], float]], str | None]:
    """Points and costs, and the problem that they belong to, from a trace, or from a result that has one, or from points,
    costs and, if they are to be reused, the problem. Of a trace only the path counts, which does not depend on workers."""
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
            problem = choice("the problem of a warm start", rest[0]) if rest and rest[0] is not None else None
        points = np.ma.filled(np.ma.asarray(points, dtype=np.float64), np.nan)
        costs = np.ma.filled(np.ma.asarray(costs, dtype=np.float64), np.nan)
    except (TypeError, ValueError):
        raise TypeError(f"warm_start must be a result, a trace, or points (m, n) and costs (m,), not {show(value)}") from None
    if points.ndim != 2 or points.shape[1] != n or costs.shape != points.shape[:1]:
        raise ValueError(f"warm_start: points of shape {points.shape}, costs of shape {costs.shape}; (m, {n}) and (m,) fit")
    return list(zip(points.tolist(), costs.tolist())), problem


def pairs_of_bounds(bounds: Any, n: int | None) -> tuple[FloatArray, FloatArray]:
    """Lower and upper bounds from what SciPy takes: a sequence of pairs (None: no bound), or an object with ``lb`` and
    ``ub``. Without a start point their number is that of the parameters."""
    if bounds is None:
        if n is None:
            raise ValueError("x0 is needed: the point to start from (methods that sample a box need at least bounds)")
        return np.full(n, -np.inf), np.full(n, np.inf)
    if hasattr(bounds, "lb") and hasattr(bounds, "ub"):
        if n is None:
            n = np.broadcast(np.asarray(bounds.lb), np.asarray(bounds.ub)).size
        # SciPy makes arrays of length one of scalars, which hold for all parameters.
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
            raise ValueError(f"bounds[{index}] has {len(pair)} values, not two: {pair!r}")
    if n is not None and len(pairs) != n:
        raise ValueError(f"bounds has {len(pairs)} pairs for {n} parameters")
    return (
        bound("lower bounds", [pair[0] for pair in pairs], len(pairs), -np.inf),
        bound("upper bounds", [pair[1] for pair in pairs], len(pairs), np.inf),
    )


def bounds_of_least_squares(bounds: Any, x0: FloatArray) -> Any:
    """Bounds for `pairs_of_bounds` from what SciPy's ``least_squares`` takes: also two arrays, or numbers that hold for all
    parameters, lower and upper bounds. Where a tuple of two pairs could be either for two parameters, that is meant in which
    x0 lies; ValueError if it lies in both, and they differ."""
    if hasattr(bounds, "lb") or isinstance(bounds, str):
        return bounds
    try:
        first, second = bounds
        sides = [np.broadcast_to(np.asarray(side, dtype=np.float64), x0.shape) for side in (first, second)]
    except (TypeError, ValueError):
        # Not two, or with None among them, or not of the length of x0.
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
                f"bounds = {show(bounds)} may mean (lower, upper) for each of two parameters, or all lower and all upper bounds: "
                "give a list of pairs, [(lower, upper), ...], or scipy.optimize.Bounds(lb, ub)"
            )
    return as_sides


def number(name: str, value: SupportsFloat | SupportsIndex) -> float:
    """The argument `name` as a float."""
    if isinstance(value, (str, bytes)):
        raise TypeError(f"{name} must be a number, not {show(value)}")
    try:
        return float(value)
    except (TypeError, ValueError):
        raise TypeError(f"{name} must be a number, not {show(value)}") from None
    except OverflowError:
        raise ValueError(f"{name} must be a number up to {sys.float_info.max:.2g}, not {show(value)}") from None


def optional_number(name: str, value: SupportsFloat | SupportsIndex | None) -> float | None:
    """The argument `name` as a float, or None."""
    return None if value is None else number(name, value)


def flag(name: str, value: object) -> bool:
    """The argument `name`, which must be True or False (or 1 or 0)."""
    if isinstance(value, bool):
        return value
    if isinstance(value, (np.bool_, int, np.integer)) and value in (0, 1):
        return bool(value)
    raise TypeError(f"{name} must be True or False, not {show(value)}")


def path(name: str, value: str | os.PathLike[str]) -> str:
    """The argument `name`, which must be a path."""
    try:
        found = os.fspath(value)
    except TypeError:
        found = None
    if not isinstance(found, str):
        raise TypeError(f"{name} must be a path, not {show(value)}")
    if not found:
        raise ValueError(f"{name} must be a path, not an empty text")
    return found


def choice(name: str, value: str) -> str:
    """The argument `name`, which must be a string."""
    if not isinstance(value, str):
        raise TypeError(f"{name} must be a string, not {show(value)}")
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
    # More than the machine can count is no limit.
    return int(count) if count <= sys.maxsize else None


def index(name: str, value: SupportsIndex) -> int:
    """A whole number."""
    try:
        return operator.index(value)
    except TypeError:
        raise TypeError(f"{name} must be whole numbers, not {show(value)}") from None


def with_plan(options: Mapping[str, Any] | None, workers: int | None) -> dict[str, Any]:
    """Options in which a batch plan "workers" stands as their number."""
    own = dictionary(options)
    plan = own.get("batch")
    if isinstance(plan, str):
        own["batch"] = (workers or all_cores()) if plan.lower() == "workers" else plan.lower()
    return own


def worker_count(name: str, value: SupportsIndex | None, default: int | None) -> int | None:
    """A number of workers: None stands for `default`, -1 for all cores that this process may use."""
    if value is None:
        return default
    try:
        count = operator.index(value)
    except TypeError:
        raise TypeError(f"{name} must be a whole number, not {show(value)}") from None
    if count == -1:
        return all_cores()
    if count < 1:
        raise ValueError(f"{name} = {count} must be at least 1, or -1 for all cores")
    if count > sys.maxsize:
        raise ValueError(f"{name} = {count} are more than any machine has")
    return count


def all_cores() -> int:
    """The number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def vector(name: str, value: npt.ArrayLike) -> FloatArray:
    """The argument `name` as a one-dimensional, contiguous array of floats, itself if it is one; a number becomes one."""
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
    return array.copy()


def check_simplex(value: npt.ArrayLike, n: int) -> None:
    """Refuses what is neither vertices nor steps of a simplex."""
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise TypeError(f"initial_simplex must be numbers, not {show(value)}") from None
    if not np.isfinite(array).all():
        index = np.argwhere(~np.isfinite(array))[0].tolist()
        raise ValueError(f"initial_simplex{index} = {array[tuple(index)]} must be finite")
    if array.shape != (n,) and not (array.ndim == 2 and array.shape[1] == n):
        raise ValueError(
            f"initial_simplex of shape {array.shape}: either vertices, shape ({n + 1}, {n}), or one step per parameter, "
            f"shape ({n},), is needed"
        )


def names(argument: str, given: Iterable[str]) -> list[str]:
    """The argument `argument`, which must be names."""
    if not isinstance(given, list) and (isinstance(given, (bytes, Mapping)) or not isinstance(given, Iterable)):
        raise TypeError(f"{argument} must be a name or a list of names, not {show(given)}")
    listed = list(given)
    for name in listed:
        if not isinstance(name, str):
            raise TypeError(f"{argument} must be a name or a list of names; {show(name)} is not a name")
    return listed


def pairs(argument: str, given: Mapping[str, object] | None) -> list[tuple[str, object]]:
    """The argument `argument`, which must be names with values."""
    if given is None:
        return []
    if not isinstance(given, Mapping):
        raise TypeError(f"{argument} must be a dict of names and values, not {show(given)}")
    names(argument, list(given))
    return list(given.items())


#: Names beyond these are counted only.
MOST_LISTED = 20


def listed(words: Sequence[str]) -> str:
    """Words in quotes, not too many of them."""
    shown = ", ".join(f"'{word}'" for word in words[:MOST_LISTED])
    more = len(words) - MOST_LISTED
    return f"{shown} and {more} more" if more > 0 else shown


def solver(name: str, argument: str = "solver") -> str:
    """The name of an integration method; those of SciPy and ``CVode``, which other tools have, stand for one of ours."""
    ours = _core.solver_standing_for(choice(argument, name))
    if ours is None:
        return name
    _log.info("there is no %s here: %s=%r is used instead", name, argument, ours)
    return ours


#: The settings of a run of a model that are not None by default.
_USUAL = {"solver": "auto", "chattering": "error", "input_derivatives": True}


def run_settings(**given: Any) -> Record:
    """How a model is run, where that is not the default: the native code knows the names and what values may be."""
    given["solver"] = solver(given["solver"])
    usual = {name for name, value in given.items() if value is None or (isinstance(value, (str, bool)) and value == _USUAL.get(name))}
    return {name: value for name, value in given.items() if name not in usual}
