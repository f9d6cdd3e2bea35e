"""`least_squares`: minimises the sum of squared residuals without derivatives."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from typing import Any, Literal, SupportsFloat, SupportsIndex

import numpy as np
import numpy.typing as npt

from .._args import bounds as _bounds
from .._args import options as _options
from .._args import values as _values
from .._args.keywords import explained, given_once
from .fmin import Callback
from .minimize import run
from .result import LeastSquaresResult


@explained
def least_squares(
    fun: Callable[..., Any],
    x0: npt.ArrayLike,
    bounds: Any = None,
    *,
    loss: Literal["linear", "soft_l1", "huber", "cauchy"] = "linear",
    f_scale: SupportsFloat = 1.0,
    x_tol: SupportsFloat | None = None,
    f_tol: SupportsFloat | None = None,
    max_evaluations: SupportsFloat | None = None,
    max_iterations: SupportsFloat | None = None,
    max_time: SupportsFloat | None = None,
    target: SupportsFloat | None = None,
    args: Any = (),
    workers: SupportsIndex | Any = 1,
    batch: str | SupportsIndex = "auto",
    callback: Callback | None = None,
    rng: int | np.random.Generator | None = None,
    options: Mapping[str, Any] | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    resume: Literal["auto", "never", "require"] = "auto",
    on_error: Literal["raise", "fail"] = "raise",
    vectorized: bool = False,
    search: Literal["local", "global"] = "local",
    absolute_sigma: bool = False,
    constraints: Any = None,
) -> LeastSquaresResult:
    """Minimise the sum of the squares of residuals without derivatives.

    The result's ``cost`` is this sum, ``sum(fun**2)``, without the factor 1/2 of SciPy. If a cost consists of
    residuals, `least_squares` requires a fraction of the evaluations of `minimize`. It shares the properties of
    `minimize`: the same path for any number and kind of workers and after a resume, and exact limits. Failures are
    counted and are never used to build a model.

    Parameters
    ----------
    fun : callable
        ``fun(x, *args) -> array_like, shape (m,)`` returns the residuals at `x`, an array of shape (n,). Their number
        and order must not change; another number raises ValueError. If a residual is NaN or infinite, the evaluation
        has failed.
    x0 : array_like, shape (n,)
        Starting point, which may be on a bound.
    bounds : sequence of pairs, or scipy.optimize.Bounds, optional
        ``(low, high)`` per parameter; None or infinite if there is no bound. Equal bounds fix a parameter. No point
        outside the bounds is ever evaluated. SciPy's tuple ``(lower, upper)`` of numbers or arrays is also accepted.
        For two parameters, a tuple of two pairs is ambiguous. The interpretation that contains `x0` is used; if both
        contain `x0`, a ValueError is raised. A list always contains pairs.
    loss : {"linear", "soft_l1", "huber", "cauchy"}
        Loss of a residual r: ``f_scale**2 * rho(z)`` with ``z = (r / f_scale)**2`` and rho as in SciPy: z;
        ``2 * (sqrt(1 + z) - 1)``; z up to 1, then ``2 * sqrt(z) - 1``; ``log(1 + z)``. All but the first limit the
        influence of outliers.
    f_scale : float
        Scale of the loss. Residuals much smaller than `f_scale` contribute their squares with every loss.
    x_tol : float, optional
        Tolerance of the x test (1e-6): radius of the trust region, in units of the sizes of the parameters.
    f_tol : float, optional
        Tolerance of the f test (1e-6): predicted decrease as a fraction of the cost.
    max_evaluations, max_iterations, max_time, target
        As in `minimize`; `target` is a cost. If none of the first three is set, the limit is 1000 (n + 1)
        evaluations.
    args : tuple
        Further arguments of `fun`.
    workers : int, map-like or executor
        As in `minimize`.
    batch : "auto", "serial", "rounds", "workers" or int
        Number of points requested at once after the first n + 1. "serial": one point, with the fewest evaluations.
        An integer: n neighbours of a point for its Jacobian, and the others at several radii, which needs fewer
        rounds and more evaluations. "rounds": n + 4 points. "workers": the number of workers. "auto": the number of
        workers, at most n + 4, if there are at least n + 1 workers; otherwise "serial". The result contains the plan
        (`batch_plan`). For one plan, the path does not depend on the number of workers.
    callback, rng, checkpoint, resume, on_error : optional
        As in `minimize`; ``fun`` of a `Progress` is the cost.
    options : dict, optional
        The common options of all methods, see `minimize`, including ``nominal`` (typical sizes of the parameters) and
        ``scale`` ("linear" or "log"), and the option ``radius`` of "least-squares" (first trust-region radius, 0.1 of
        the sizes).
    vectorized : bool
        If True, ``fun(x, *args)`` receives points as columns, shape (n, S), and returns residuals of shape (m, S).
        `workers` must then be a number.
    search : {"local", "global"}
        "local": the minimum next to the start. "global": the best minimum in the box, by searches from several starts
        ("multistart" of `minimize`, with its options), which requires two finite bounds for every parameter.
    absolute_sigma : bool
        If True, the residuals are in units of their known standard deviation, so ``cov`` is ``inv(J.T @ J)``, as in
        SciPy's ``curve_fit``. If False, ``cov`` is scaled by the variance of the residuals. True requires the loss
        "linear". Without more residuals than parameters, or if all residuals are zero, ``cov`` is not rescaled.
    constraints : optional
        Relations between parameters, as in `minimize`.

    Returns
    -------
    LeastSquaresResult
        ``x``, ``fun`` (the residuals at ``x``), ``cost``, ``jac``, ``cov`` and the fields of `minimize`. ``x`` is the
        best point found, regardless of how the run ended.

    Raises
    ------
    ValueError, TypeError
        Invalid arguments; a return value that is not a vector of numbers (TypeError).
    CheckpointError, OSError, AllStartsFailed, Interrupted, Exception
        As in `minimize`.

    Examples
    --------
    >>> import numpy as np, pydfo
    >>> t = np.linspace(0, 4, 9)
    >>> y = 2 * np.exp(-0.7 * t) + 0.01 * np.sin(9 * t)
    >>> res = pydfo.least_squares(lambda x: x[0] * np.exp(-x[1] * t) - y, [1, 1], bounds=[(0, 5), (0, None)])
    >>> res.x.round(2), res.success, res.fun.shape
    (array([2. , 0.7]), True, (9,))
    """
    if x0 is None:
        raise ValueError("x0 (the start point) is missing")
    if absolute_sigma and loss != "linear":
        raise ValueError(f"absolute_sigma=True requires loss='linear', not {loss!r}")
    start = _values.vector("x0", x0)
    result = run(
        least_squares,
        fun,
        "least-squares" if search == "local" else "auto",
        start,
        _bounds.bounds_of_least_squares(bounds, start),
        given_once(_options.dictionary(options), least_squares, x_tol=x_tol, f_tol=f_tol, batch=batch),
        args=args,
        workers=workers,
        callback=callback,
        on_error=on_error,
        vectorized=vectorized,
        of_residuals=True,
        rng=rng,
        checkpoint=checkpoint,
        max_evaluations=max_evaluations,
        max_iterations=max_iterations,
        max_time=max_time,
        target=target,
        resume=resume,
        search=search,
        loss=loss,
        f_scale=f_scale,
        constraints=constraints,
    )
    assert isinstance(result, LeastSquaresResult)
    if absolute_sigma and result.cov is not None and result.active_mask is not None:
        variance = result.sum_of_squares / max(result.fun.size - np.count_nonzero(result.active_mask == 0), 1)
        result.cov = result.cov / variance if variance > 0 else result.cov
    return result
