"""How the objective is called: by an executor point by point, by a map, or with all points at once.

The functions for a map and for all points at once take the points of a batch, shape (S, n), their cutoffs, shape (S,), and
a function that says whether the run is to end; they return for each point a cost, `Above`, the exception that was raised,
or Ellipsis for a point that was left out; or a pair of the seconds that it took and one of these.
"""

from __future__ import annotations

import concurrent.futures
import inspect
import os
import pickle
import queue
import time
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

from .._args import options as _options
from .._args import text as _text

FloatArray = npt.NDArray[np.float64]
Batches = Callable[[FloatArray, FloatArray, Callable[[], bool]], list[Any]]

class WithArguments:
    """The objective with its further arguments; can be pickled if they can."""

    def __init__(self, fun: Callable[..., Any], args: tuple[Any, ...]) -> None:
        self.fun = fun
        self.args = args

    def __call__(self, x: FloatArray, **cutoff: float) -> Any:
        return self.fun(x, *self.args, **cutoff)


def takes_cutoff(fun: Callable[..., Any]) -> bool:
    """Whether a function wants to know above which cost its value makes no difference: it has a keyword-only parameter
    named cutoff."""
    try:
        parameter = inspect.signature(fun).parameters.get("cutoff")
    except (TypeError, ValueError):
        # Compiled functions may have no signature.
        return False
    return parameter is not None and parameter.kind is inspect.Parameter.KEYWORD_ONLY


class WithCutoff:
    """An objective that takes a cutoff, for those who hand on one thing per point. Can be pickled if it can."""

    def __init__(self, fun: Callable[..., Any]) -> None:
        self.fun = fun

    def __call__(self, point: tuple[FloatArray, float]) -> Any:
        return self.fun(point[0], cutoff=point[1])


def _in_pieces(fun: Callable[..., Any], cutoffs: bool) -> tuple[Returning, Callable[[FloatArray, FloatArray], list[Any]]]:
    """What is called for each piece of a batch, and how a batch falls into pieces."""
    if cutoffs:
        return Returning(WithCutoff(fun)), lambda points, limits: list(zip(points, limits.tolist()))
    return Returning(fun), lambda points, _: list(points)


class Returning:
    """Calls the objective and returns its exception instead of raising it, so that one point does not cost the others
    of its batch. Can be pickled if the objective can. An exception that cannot come back from another process (a pool
    would wait for it for ever) is replaced by one with the same text."""

    def __init__(self, fun: Callable[[Any], Any]) -> None:
        self.fun = fun
        self.home = os.getpid()

    def __call__(self, x: Any) -> Any:
        try:
            return self.fun(x)
        except KeyboardInterrupt:
            if os.getpid() == self.home:
                raise
            # A worker of a pool that dies of Ctrl-C leaves its map waiting for ever.
            return KeyboardInterrupt()
        except BaseException as e:
            if os.getpid() == self.home:
                return e
            try:
                pickle.loads(pickle.dumps(e))
            except Exception:
                return RuntimeError(f"{type(e).__name__}: {e}")
            return e


class Timed:
    """Adds to what a function returns how long it took, in s."""

    def __init__(self, fun: Callable[[Any], Any]) -> None:
        self.fun = fun

    def __call__(self, x: Any) -> tuple[float, Any]:
        start = time.perf_counter()
        value = self.fun(x)
        return time.perf_counter() - start, value


def residual_vector(value: Any) -> FloatArray:
    """The residuals that a function returned: whatever NumPy makes a one-dimensional array of numbers of, NaN where it is
    masked. TypeError for anything else."""
    needed = "the function must return the residuals as a one-dimensional array of numbers"
    if value is None:
        raise TypeError(f"{needed}, not None; is a return statement missing?")
    try:
        array = np.ma.asanyarray(value)
        if array.dtype.kind in "cUSMm":
            raise TypeError
        array = np.ma.asarray(array, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise TypeError(f"{needed}, not {_text.show(value)}") from None
    if array.ndim == 0:
        raise TypeError(f"{needed}, not one number ({_text.show(value)}): a cost is for minimize, a single residual r is [r]")
    if array.ndim != 1:
        raise TypeError(f"{needed}, not one of shape {array.shape}")
    return np.ascontiguousarray(np.ma.filled(array, np.nan))


def vectorized(fun: Callable[[FloatArray], Any], of_residuals: bool = False) -> Batches:
    """The objective takes points in columns, shape (n, S), and returns costs of shape (S,), or residuals of shape (m, S)."""

    def evaluate(points: FloatArray, cutoffs: FloatArray, stopped: Callable[[], bool]) -> list[Any]:
        try:
            # What is masked is no cost, whatever lies under the mask.
            costs = np.ma.asanyarray(fun(np.ascontiguousarray(points.T)))
        except Exception as e:
            if len(points) == 1:
                return [e]
            # One point is no reason for the others to fail.
            return [one for k in range(len(points)) for one in evaluate(points[k : k + 1], cutoffs[k : k + 1], stopped)]
        if costs.shape[-1:] != (len(points),) or costs.ndim != 1 + of_residuals:
            wrong = TypeError(
                f"a vectorized objective must return an array of shape ({'m, ' if of_residuals else ''}{len(points)}"
                f"{'' if of_residuals else ','}) for points of shape {points.T.shape}, not of shape {costs.shape}"
            )
            raise wrong
        return list(costs.T)

    return evaluate


def mapped(fun: Callable[..., Any], apply: Callable[..., Iterable[Any]], takes_cutoff: bool = False) -> Batches:
    """``apply(function, points)`` evaluates a batch, like the built-in ``map``."""
    returning, pieces = _in_pieces(fun, takes_cutoff)

    def evaluate(points: FloatArray, cutoffs: FloatArray, stopped: Callable[[], bool]) -> list[Any]:
        results = apply(returning, pieces(points, cutoffs))
        if not isinstance(results, Iterable):
            raise TypeError(f"workers must return the results of a batch as map does, not {_text.show(results)}")
        return list(results)

    return evaluate


class Futures:
    """Hands points to an executor one by one and takes what comes back, in any order."""

    def __init__(
        self, fun: Callable[..., Any], executor: concurrent.futures.Executor, takes_cutoff: bool = False, width: int | None = None
    ) -> None:
        returning, self._pieces = _in_pieces(fun, takes_cutoff)
        self._call = Timed(returning)
        self._executor = executor
        self._futures: dict[int, concurrent.futures.Future[Any]] = {}
        self._given_up: set[int] = set()
        self._ended: queue.SimpleQueue[int] = queue.SimpleQueue()
        self.width = width or plan_width(executor)

    def submit(self, number: int, x: FloatArray, cutoff: float) -> None:
        """Begins a point."""
        (piece,) = self._pieces(x[np.newaxis], np.array([cutoff]))
        self._began(number, self._executor.submit(self._call, piece))

    def _began(self, number: int, future: concurrent.futures.Future[Any]) -> None:
        self._futures[number] = future
        future.add_done_callback(lambda _: self._ended.put(number))

    def poll(self, seconds: float) -> tuple[int, float, Any, str] | None:
        """A point that has ended: its number, the seconds that it took, what became of it (Ellipsis: it was cancelled), and
        what is wrong with the executor: nothing, "lost" (this point), "broken". None: after so many seconds there is none."""
        try:
            number = self._ended.get(timeout=max(seconds, 0.0))
        except queue.Empty:
            return None
        future = self._futures.pop(number)
        try:
            if future.cancelled() and number in self._given_up:
                return number, 0.0, ..., ""
            ended = future.result()
        except concurrent.futures.CancelledError as e:
            return number, 0.0, RuntimeError(f"the task was cancelled {e}".strip()), "lost"
        except (concurrent.futures.BrokenExecutor, pickle.PicklingError, TypeError, AttributeError, ImportError) as e:
            # No point would fare better.
            return number, 0.0, e, "broken"
        except Exception as e:
            return number, 0.0, e, "lost"
        if len(ended) == 2 and isinstance(ended[0], float):
            return number, ended[0], ended[1], ""
        return number, 0.0, ended, ""

    def cancel(self, number: int) -> None:
        """Gives up a point: one that runs goes on."""
        future = self._futures.get(number)
        if future is not None:
            self._given_up.add(number)
            future.cancel()


def executor_of(workers: Any) -> Any:
    """`workers` if it is an executor, else None.

    TypeError for objects of Dask and joblib that are none, with the one to pass instead."""
    if callable(getattr(workers, "get_executor", None)):
        raise TypeError("a Dask Client is no executor: give workers=client.get_executor()")
    if callable(getattr(workers, "submit", None)):
        if isinstance(workers, type):
            raise TypeError(f"workers cannot be the class {workers.__name__}: give an executor, {workers.__name__}(...)")
        return workers
    if type(workers).__module__.partition(".")[0] == "joblib":
        raise TypeError(
            f"workers cannot be a joblib {type(workers).__name__}: give an executor, workers=joblib.externals.loky.get_reusable_executor()"
        )
    return None


def foreign(fun: Callable[..., Any], workers: Any, takes_cutoff: bool = False) -> Batches | Futures | None:
    """How `workers` evaluates points; None if it is a number or nothing that could."""
    if executor_of(workers) is not None:
        return Futures(fun, workers, takes_cutoff)
    if callable(workers):
        return mapped(fun, workers, takes_cutoff)
    if callable(getattr(workers, "map", None)):
        return mapped(fun, workers.map, takes_cutoff)
    return None


def plan_width(workers: Any) -> int:
    """How many points may be under way at once: the workers of an executor, as far as it tells, else all cores."""
    # Python's own, loky, MPI.
    known = getattr(workers, "_max_workers", None) or getattr(workers, "num_workers", None)
    nthreads = getattr(getattr(workers, "_client", None), "nthreads", None)
    if known is None and callable(nthreads):
        known = sum(nthreads().values())
    return known if isinstance(known, int) and known > 0 else _options.all_cores()


def shared_out(
    fun: Callable[..., Any], name: str, workers: Any, default: int | None, takes_cutoff: bool = False
) -> tuple[Batches | Futures | None, int | None]:
    """Who evaluates batches, if not threads of our own, and for how many points at once the method may plan. `name` is that
    of the argument `workers`, `default` the number that None stands for."""
    batches = None if workers is None else foreign(fun, workers, takes_cutoff)
    if batches is not None:
        return batches, batches.width if isinstance(batches, Futures) else plan_width(workers)
    return None, _options.worker_count(name, workers, default)
