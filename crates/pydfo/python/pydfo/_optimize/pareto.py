"""`pareto`: minimises several criteria at once."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, SupportsFloat, SupportsIndex

import numpy as np
import numpy.typing as npt

from .._args import options as _options
from .._args.keywords import explained, given_once
from .fmin import Callback, check_callback, listen
from .minimize import run
from .pareto_front import ParetoFront, check_names
from .progress import Progress


@explained
def pareto(
    fun: Callable[..., Any],
    bounds: Any,
    *,
    names: Sequence[str] | None = None,
    x0: npt.ArrayLike | None = None,
    population: SupportsIndex | None = None,
    max_evaluations: SupportsFloat | None = None,
    max_iterations: SupportsFloat | None = None,
    max_time: SupportsFloat | None = None,
    args: Any = (),
    workers: SupportsIndex | Any = 1,
    callback: Callback | None = None,
    rng: int | np.random.Generator | None = None,
    options: Mapping[str, Any] | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    resume: Literal["auto", "never", "require"] = "auto",
    on_error: Literal["raise", "fail"] = "raise",
    vectorized: bool = False,
    constraints: Any = None,
) -> ParetoFront:
    """Minimise several criteria at once, and return their Pareto front.

    The method is NSGA-II (Deb, Pratap, Agarwal and Meyarivan, IEEE Trans. Evol. Comput. 6, 2002). It has no test of
    convergence, so the run uses its whole budget. As in `minimize`, the path is the same for any number and kind of
    workers and after a resume, and limits are exact. Failures are counted, and failed points are never in the front.

    Parameters
    ----------
    fun : callable
        ``fun(x, *args) -> array_like, shape (m,)`` returns the criteria at `x`, an array of shape (n,). All are
        minimised; negate a criterion to maximise it. Their number and order must not change; another number raises
        ValueError. If a criterion is NaN or infinite, the evaluation has failed.
    bounds : sequence of pairs, or scipy.optimize.Bounds
        ``(low, high)`` per parameter, both finite. Equal bounds fix a parameter.
    names : sequence of str, optional
        Names of the criteria for tables and figures.
    x0 : array_like, shape (n,), optional
        A member of the first population.
    population : int
        Number of members (100), which limits the number of points of the front.
    max_evaluations, max_iterations, max_time : optional
        Exact limits, as in `minimize`; an iteration is a generation. If all are None, the limit is 25 000 evaluations,
        as in the experiments of the paper.
    args, workers, callback, rng, checkpoint, resume, on_error, vectorized : optional
        As in `minimize`. A checkpoint continues with a larger limit. A vectorized function returns criteria of shape
        (m, S). A `Progress` contains the ``front``; its ``x`` is the compromise (see `ParetoFront`), and its ``fun``
        the scaled distance of the compromise from the ideal point.
    options : dict, optional
        The common options of all methods, see `minimize`, including ``kinds`` ("continuous", "integer" or
        "categorical", for all or each), ``scale`` ("linear" or "log") and ``constraint_tol``; tolerances are unused.
        Options of NSGA-II: ``crossover_rate`` (0.9) and ``crossover_index`` (15) of the simulated binary crossover,
        ``mutation_rate`` (1 / n) and ``mutation_index`` (20) of the polynomial mutation, ``sampling`` ("uniform",
        "latin-hypercube" or "sobol") of the first population, ``include_start``.
    constraints : optional
        Relations between parameters, as in `minimize`. Feasible points rank before infeasible ones.

    Returns
    -------
    ParetoFront
        ``x`` and ``criteria`` of the points, sorted by the first criterion, and the fields of `minimize`. The front
        consists of the non-dominated members of the final population.

    Raises
    ------
    ValueError, TypeError
        Invalid arguments; a return value that is not a vector of numbers (TypeError).
    CheckpointError, OSError, AllStartsFailed, Interrupted, Exception
        As in `minimize`.

    Examples
    --------
    >>> import pydfo
    >>> def criteria(x):
    ...     return (x[0] - 1) ** 2 + x[1] ** 2, (x[0] + 1) ** 2 + x[1] ** 2
    >>> front = pydfo.pareto(criteria, [(-3, 3), (-3, 3)], rng=1, max_evaluations=3000)
    >>> front.criteria.shape, front.success
    ((100, 2), True)
    >>> bool(abs(front.criteria**0.5 @ [1, 1] - 2).max() < 0.05)
    True
    """
    check_callback(callback)
    labels = None if names is None else tuple(names)
    result = run(
        pareto,
        fun,
        "nsga2",
        x0,
        bounds,
        given_once(_options.dictionary(options), pareto, population=population),
        args=args,
        workers=workers,
        callback=callback if labels is None else _checking(labels, callback),
        on_error=on_error,
        vectorized=vectorized,
        of_residuals=True,
        front=True,
        rng=rng,
        checkpoint=checkpoint,
        resume=resume,
        loss="linear",
        constraints=constraints,
        max_evaluations=max_evaluations,
        max_iterations=max_iterations,
        max_time=max_time,
    )
    assert isinstance(result, ParetoFront)
    if labels is not None:
        check_names(labels, result.criteria)
        result.names = labels
    return result


def _checking(names: Sequence[str], callback: Callback | None) -> Callback:
    """Returns a callback that ends the run after the first population if the number of names is wrong."""
    notify = None if callback is None else listen(callback)

    def check(progress: Progress) -> Any:
        if progress.front is not None:
            check_names(names, progress.front[1])
        return None if notify is None else notify(progress)

    return check
