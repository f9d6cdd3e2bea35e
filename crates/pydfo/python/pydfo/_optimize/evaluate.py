"""Evaluation of the objective: by an executor point by point, by a map, or with all points at once.

The functions for a map and for all points at once have three arguments. These are the points of a batch, shape (S, n),
their cutoffs, shape (S,), and a function that returns True if the run should end. For each point they return a cost,
`Above`, the raised exception, or Ellipsis for an omitted point. They may also return a pair of the run time in seconds
and one of these.
"""

from __future__ import annotations

import bisect
import concurrent.futures
import inspect
import logging
import math
import os
import pickle
import queue
import time
from collections.abc import Callable, Iterable
from typing import Any, SupportsFloat

import numpy as np
import numpy.typing as npt

from .._args import options as _options
from .._args import text as _text
from .._args import values as _values

FloatArray = npt.NDArray[np.float64]
Batches = Callable[[FloatArray, FloatArray, Callable[[], bool]], list[Any]]

_log = logging.getLogger("pydfo")

#: Seconds without an answer after which a warning is logged.
SILENCE = 30.0


class WithArguments:
    """The objective with its further arguments; picklable if they are."""

    def __init__(self, fun: Callable[..., Any], args: tuple[Any, ...]) -> None:
        self.fun = fun
        self.args = args

    def __call__(self, x: FloatArray, **cutoff: float) -> Any:
        return self.fun(x, *self.args, **cutoff)


def takes_cutoff(fun: Callable[..., Any]) -> bool:
    """Returns True if a function has a keyword-only parameter named cutoff.

    It receives the cost above which its value makes no difference."""
    try:
        parameter = inspect.signature(fun).parameters.get("cutoff")
    except (TypeError, ValueError):
        # Compiled functions may have no signature.
        return False
    return parameter is not None and parameter.kind is inspect.Parameter.KEYWORD_ONLY


class WithCutoff:
    """Wraps an objective with a cutoff for callers that pass one object per point; picklable if the objective is."""

    def __init__(self, fun: Callable[..., Any]) -> None:
        self.fun = fun

    def __call__(self, point: tuple[FloatArray, float]) -> Any:
        return self.fun(point[0], cutoff=point[1])


def _in_pieces(fun: Callable[..., Any], cutoffs: bool) -> tuple[Returning, Callable[[FloatArray, FloatArray], list[Any]]]:
    """Returns the function to call for each piece of a batch, and a function that splits a batch into pieces."""
    if cutoffs:
        return Returning(WithCutoff(fun)), lambda points, limits: list(zip(points, limits.tolist()))
    return Returning(fun), lambda points, _: list(points)


class Returning:
    """Calls the objective and returns its exception instead of raising it, so that one point does not affect its
    batch.

    Picklable if the objective is. A pool would wait forever for an exception that cannot be unpickled. Such an
    exception is replaced by one with the same message."""

    def __init__(self, fun: Callable[[Any], Any]) -> None:
        self.fun = fun
        self.home = os.getpid()

    def __call__(self, x: Any) -> Any:
        try:
            return self.fun(x)
        except KeyboardInterrupt:
            if os.getpid() == self.home:
                raise
            # A pool worker that dies from Ctrl-C would leave its map waiting forever.
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
    """Returns the result of a function together with its run time in s."""

    def __init__(self, fun: Callable[[Any], Any]) -> None:
        self.fun = fun

    def __call__(self, x: Any) -> tuple[float, Any]:
        start = time.perf_counter()
        value = self.fun(x)
        return time.perf_counter() - start, value


def residual_vector(value: Any) -> FloatArray:
    """Converts returned residuals to a one-dimensional array of numbers, with NaN for masked entries.

    Raises TypeError for other values."""
    needed = "the function must return the residuals as a one-dimensional array of numbers"
    if value is None:
        raise TypeError(f"{needed}, not None. Check for a missing return statement")
    try:
        array = np.ma.asanyarray(value)
        if array.dtype.kind in "cUSMm":
            raise TypeError
        array = np.ma.asarray(array, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise TypeError(f"{needed}, not {_text.show(value)}") from None
    if array.ndim == 0:
        raise TypeError(f"{needed}, not one number ({_text.show(value)}): use minimize for a cost, or return a single residual r as [r]")
    if array.ndim != 1:
        raise TypeError(f"{needed}, not one of shape {array.shape}")
    return np.ascontiguousarray(np.ma.filled(array, np.nan))


def vectorized(fun: Callable[[FloatArray], Any], of_residuals: bool = False) -> Batches:
    """Wraps an objective that takes points in columns, shape (n, S), and returns costs (S,), or residuals (m, S)."""

    def evaluate(points: FloatArray, cutoffs: FloatArray, stopped: Callable[[], bool]) -> list[Any]:
        try:
            # A masked entry is not a cost, whatever its value.
            costs = np.ma.asanyarray(fun(np.ascontiguousarray(points.T)))
        except Exception as e:
            if len(points) == 1:
                return [e]
            # A failure of one point must not fail the other points.
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
    """Wraps ``apply(function, points)``, which evaluates a batch like the built-in ``map``."""
    returning, pieces = _in_pieces(fun, takes_cutoff)

    def evaluate(points: FloatArray, cutoffs: FloatArray, stopped: Callable[[], bool]) -> list[Any]:
        results = apply(returning, pieces(points, cutoffs))
        if not isinstance(results, Iterable):
            raise TypeError(f"workers must return an iterable of the results of a batch, as map does, not {_text.show(results)}")
        return list(results)

    return evaluate


#: Number of answers after which a task may be overdue. The median of fewer answers may not be typical.
MIN_ANSWERS = 5


class Futures:
    """Sends points to an executor one by one and receives the results in any order."""

    def __init__(self, fun: Callable[..., Any], executor: Any, takes_cutoff: bool = False, width: int | None = None) -> None:
        returning, self._pieces = _in_pieces(fun, takes_cutoff)
        self._call = Timed(returning)
        self._resubmit: Resubmit | None = executor if isinstance(executor, Resubmit) else None
        self._executor = executor if self._resubmit is None else self._resubmit.executor
        #: Running tasks of each point: one, or two if the first was overdue.
        self._futures: dict[int, list[concurrent.futures.Future[Any]]] = {}
        self._given_up: set[int] = set()
        self._ended: queue.SimpleQueue[tuple[int, concurrent.futures.Future[Any]]] = queue.SimpleQueue()
        #: Time of the last answer or of the first submission; None before it and after a warning.
        self._silent_since: float | None = None
        self._has_answered = False
        #: Function that submits each point again, and the time of its submission. Kept if a task may be overdue.
        self._submissions: dict[int, tuple[float, Callable[[], concurrent.futures.Future[Any]]]] = {}
        #: Times from submission to answer in s, ascending.
        self._durations: list[float] = []
        self._n_overdue = 0
        self.width = width or plan_width(self._executor)

    def submit(self, number: int, x: FloatArray, cutoff: float) -> None:
        """Starts the evaluation of a point."""
        (piece,) = self._pieces(x[np.newaxis], np.array([cutoff]))
        self._begin_task(number, self._call, piece)

    def _begin_task(self, number: int, function: Callable[..., Any], *arguments: Any) -> None:
        def again() -> concurrent.futures.Future[Any]:
            future: concurrent.futures.Future[Any] = self._executor.submit(function, *arguments)
            return future

        if not self._futures:
            self._silent_since = time.monotonic()
        self._began(number, again())
        if self._resubmit is not None:
            self._submissions[number] = time.monotonic(), again

    def _began(self, number: int, future: concurrent.futures.Future[Any]) -> None:
        self._futures.setdefault(number, []).append(future)
        future.add_done_callback(lambda _: self._ended.put((number, future)))

    def poll(self, seconds: float) -> tuple[int, float, Any, str] | None:
        """Returns a finished point: its number, its run time in s, its result and the state of the executor.

        The result is Ellipsis if the point was cancelled. The state is empty, "lost" (this point) or "broken".
        Returns None if no point finishes within `seconds`."""
        try:
            number, future = self._ended.get(timeout=max(seconds, 0.0))
        except queue.Empty:
            self._submit_overdue()
            self._warn_of_silence()
            return None
        futures = self._futures.get(number, [])
        if not any(future is running for running in futures):
            # A released Dask task or an overdue task, which may end later.
            return None
        self._silent_since = time.monotonic()
        answer = self._answer_of(number, future)
        if answer[3] == "lost" and len(futures) > 1:
            self._futures[number] = [running for running in futures if running is not future]
            return None
        del self._futures[number]
        for other in futures:
            if other is not future:
                self._drop(other)
        if (submission := self._submissions.pop(number, None)) is not None and not answer[3]:
            bisect.insort(self._durations, time.monotonic() - submission[0])
        return answer

    def _answer_of(self, number: int, future: concurrent.futures.Future[Any]) -> tuple[int, float, Any, str]:
        """Returns the answer of a finished task, as `poll` does."""
        if number in self._given_up and (future.cancelled() or isinstance(self._executor, DaskExecutor)):
            return number, 0.0, ..., ""
        if future.cancelled():
            return number, 0.0, RuntimeError("the task was cancelled"), "lost"
        self._has_answered = True
        try:
            ended = future.result()
        except (concurrent.futures.BrokenExecutor, pickle.PicklingError, TypeError, AttributeError, ImportError) as e:
            # Every other point would fail in the same way.
            return number, 0.0, e, "broken"
        except Exception as e:
            return number, 0.0, e, "lost"
        if len(ended) == 2 and isinstance(ended[0], float):
            return number, ended[0], ended[1], ""
        return number, 0.0, ended, ""

    def take_n_overdue(self) -> int:
        """Returns the number of overdue tasks submitted again since the last call."""
        n, self._n_overdue = self._n_overdue, 0
        return n

    def _submit_overdue(self) -> None:
        """Submits the overdue tasks again."""
        if self._resubmit is None:
            return
        latest = time.monotonic() - self._resubmit.limit(self._durations)
        for number, (begun, again) in list(self._submissions.items()):
            if begun < latest and number not in self._given_up:
                del self._submissions[number]
                self._n_overdue += 1
                self._began(number, again())

    def _warn_of_silence(self) -> None:
        """Logs a warning, once, if no worker answers and this is probably not due to long evaluations."""
        if self._silent_since is None or time.monotonic() - self._silent_since < SILENCE:
            return
        self._silent_since = None
        if (n_workers := worker_count(self._executor)) == 0:
            _log.warning("no worker has answered for %g s, because the cluster has no workers. Its logs contain the reason", SILENCE)
        elif not self._has_answered:
            count = "" if n_workers is None else f" of {n_workers}"
            _log.warning(
                "no worker%s has answered in the first %g s. If an evaluation takes less, check the logs of the workers", count, SILENCE
            )

    def cancel(self, number: int) -> None:
        """Abandons a point; a running evaluation continues."""
        for future in self._futures.get(number, []):
            self._given_up.add(number)
            self._drop(future)
            if isinstance(self._executor, DaskExecutor):
                self._ended.put((number, future))

    def _drop(self, future: concurrent.futures.Future[Any]) -> None:
        """Cancels a task that has not started."""
        if isinstance(self._executor, DaskExecutor):
            # Dask's cancel waits for the scheduler. The scheduler drops a released task that has not started.
            task: Any = future
            task.release()
        else:
            future.cancel()


class DaskExecutor:
    """An executor on a Dask client.

    The executor of Dask prints tracebacks if a task ends while it is cancelled. It also needs `pure=False` to run a
    task again."""

    def __init__(self, client: Any, options: dict[str, Any]) -> None:
        self._client = client
        self._options = options | {"pure": False}

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Any:
        """Submits a task and returns its Dask future."""
        return self._client.submit(function, *arguments, **self._options)


class Resubmit:
    """Executor that submits a task again if it is overdue, and uses the first answer.

    Pass it as `workers` in place of the executor. A task is overdue if it has taken `overdue` times as long as the
    median of the answered tasks, from submission to answer. Until five tasks are answered, the slowest of them takes
    the place of the median. Before the first answer, a task is overdue after `first_limit`. Each task is submitted again
    at most once. This decides only which process computes a point, so the result of a run is the same. ``n_lost``
    counts the tasks submitted again.

    Parameters
    ----------
    executor : executor
        An object that `workers` accepts, with a method ``submit`` or a Dask client.
    overdue : float
        Multiple of the median time, above 1.
    first_limit : float, optional
        Time in s after which a task is overdue while no task has been answered. It should include the start of the
        workers. Default: no limit, so that a run waits for its first answer.

    Raises
    ------
    TypeError
        If `executor` is not an executor.
    ValueError
        If `overdue` is not a finite number above 1, or `first_limit` is not positive.
    """

    def __init__(self, executor: Any, overdue: SupportsFloat, first_limit: SupportsFloat | None = None) -> None:
        if (found := executor_of(executor)) is None or isinstance(executor, Resubmit):
            raise TypeError(f"executor must have a method submit, or be a Dask client, not {_text.show(executor)}")
        self.executor = found
        self.overdue = _values.number("overdue", overdue)
        if not 1.0 < self.overdue < math.inf:
            raise ValueError(f"overdue must be a finite number above 1, not {_text.show(overdue)}")
        self.first_limit = None if first_limit is None else _values.number("first_limit", first_limit)
        if self.first_limit is not None and not self.first_limit > 0.0:
            raise ValueError(f"first_limit must be a positive time in s, not {_text.show(first_limit)}")

    def limit(self, durations: list[float]) -> float:
        """Returns the time in s after which a task is overdue, from the ascending times of the answered tasks."""
        if not durations:
            return math.inf if self.first_limit is None else self.first_limit
        typical = durations[-1] if len(durations) < MIN_ANSWERS else durations[len(durations) // 2]
        return self.overdue * typical


def executor_of(workers: Any) -> Any:
    """Returns the executor for `workers`: itself, or one on a Dask client. Returns None if it is not an executor.

    Raises TypeError for objects of joblib that are not executors, and suggests the object to pass instead."""
    if isinstance(workers, Resubmit):
        return workers
    if callable(getattr(workers, "get_executor", None)):
        return DaskExecutor(workers, {})
    if type(workers).__module__ == "distributed.cfexecutor":
        return DaskExecutor(workers._client, workers._kwargs)
    if callable(getattr(workers, "submit", None)):
        if isinstance(workers, type):
            raise TypeError(f"workers must be an executor, not the class {workers.__name__}; use {workers.__name__}(...)")
        return workers
    if type(workers).__module__.partition(".")[0] == "joblib":
        raise TypeError(
            f"workers must be an executor, not a joblib {type(workers).__name__}; use workers=joblib.externals.loky.get_reusable_executor()"
        )
    return None


def foreign(fun: Callable[..., Any], workers: Any, takes_cutoff: bool = False) -> Batches | Futures | None:
    """Returns the evaluator for `workers`; None if it is a number or cannot evaluate points."""
    if (executor := executor_of(workers)) is not None:
        return Futures(fun, executor, takes_cutoff)
    if callable(workers):
        return mapped(fun, workers, takes_cutoff)
    if callable(getattr(workers, "map", None)):
        return mapped(fun, workers.map, takes_cutoff)
    return None


def worker_count(workers: Any) -> int | None:
    """Returns the number of workers of an executor, or None if it is unknown."""
    if isinstance(workers, Resubmit):
        return worker_count(workers.executor)
    if isinstance(workers, DaskExecutor):
        return int(sum(workers._client.nthreads().values()))
    # Attributes of Python's executors, loky and MPI.
    count = getattr(workers, "_max_workers", None) or getattr(workers, "num_workers", None)
    return count if isinstance(count, int) and count > 0 else None


def plan_width(workers: Any) -> int:
    """Returns the number of points to plan for: the number of workers of an executor if known, otherwise all cores."""
    return worker_count(workers) or _options.all_cores()


def shared_out(
    fun: Callable[..., Any], name: str, workers: Any, default: int | None, takes_cutoff: bool = False
) -> tuple[Batches | Futures | None, int | None]:
    """Returns the evaluator of batches, None for threads, and the number of simultaneous points for which a method
    may plan.

    `name` is the name of the argument `workers`. `default` is the number that replaces None."""
    batches = None if workers is None else foreign(fun, workers, takes_cutoff)
    if batches is not None:
        return batches, batches.width if isinstance(batches, Futures) else plan_width(workers)
    return None, _options.worker_count(name, workers, default)
