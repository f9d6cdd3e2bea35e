"""`minimize`: minimises a function of several variables without derivatives, by any of the methods."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Mapping
from typing import Any, Literal, SupportsFloat, SupportsIndex

import numpy as np
import numpy.typing as npt

from .. import _core
from .._args import bounds as _bounds
from .._args import options as _options
from .._args import values as _values
from .._args.keywords import explained, positional_until
from . import constraints as _constraints
from . import evaluate as _evaluate
from .fmin import Callback, check_callback, listen
from .result import OptimizeResult

_log = logging.getLogger("pydfo")


@positional_until(2)
@explained
def minimize(
    fun: Callable[..., Any],
    x0: npt.ArrayLike | None = None,
    *,
    bounds: Any = None,
    method: str = "auto",
    args: Any = (),
    workers: SupportsIndex | Any = 1,
    callback: Callback | None = None,
    rng: int | np.random.Generator | None = None,
    max_evaluations: SupportsFloat | None = None,
    max_iterations: SupportsFloat | None = None,
    max_time: SupportsFloat | None = None,
    target: SupportsFloat | None = None,
    options: Mapping[str, Any] | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    resume: Literal["auto", "never", "require"] = "auto",
    on_error: Literal["raise", "fail"] = "raise",
    vectorized: bool = False,
    search: Literal["local", "global"] = "local",
    constraints: Any = None,
) -> OptimizeResult:
    """Minimise a function of several variables without derivatives.

    Equal arguments and seeds give bit-for-bit the same path. This holds for any number and kind of workers, and for a
    run that is interrupted and resumed from a checkpoint. Points that workers evaluate speculatively are counted
    separately (``n_speculative``). Their results, including exceptions, have no effect unless the path reaches these
    points.

    Parameters
    ----------
    fun : callable
        ``fun(x, *args) -> float``. `x` is an array of shape (n,), which the function may keep. NaN and infinities
        mean that there is no cost at this point. A keyword-only parameter `cutoff` receives the cost above which the
        value makes no difference; infinite if there is none. The function may return ``pydfo.Above(cutoff)`` as soon
        as its cost is known to be strictly above `cutoff`. The search makes the same decisions with less work.
    x0 : array_like, shape (n,), optional
        Starting point, which may be on a bound. It is optional for methods that sample a box ("de", "de-classic",
        "ga"). It is also optional for "cma-es" and "pattern-search", which then start in the middle of the box.
    bounds : sequence of pairs, or scipy.optimize.Bounds, optional
        ``(low, high)`` per parameter; None or infinite if there is no bound. Equal bounds fix a parameter. No point
        outside the bounds is ever evaluated. Bounds more than 100 times as wide as the nominal size, or otherwise
        abs(x0), carry no information on the size of the parameter. Methods that start from `x0` then use the nominal
        size or abs(x0). "quadratic-model" then uses abs(x0) for all parameters without a nominal size. Methods that
        sample the box search all of it.
    method : str
        - "nelder-mead";
        - "barrier": Nelder-Mead with a sequential barrier; requires at least one finite bound and a start strictly
          inside;
        - "de" or "differential-evolution": L-SHADE;
        - "de-classic": rand/1/bin;
        - "ga" or "genetic": genetic algorithm on bit strings;
        - "quadratic-model": trust region on quadratic interpolation models, for smooth costs; options `radius`,
          `points`, `restarts`, `hand_over`;
        - "cma-es": covariance matrix adaptation;
        - "pattern-search": mesh adaptive direct search, for costs with kinks; not for smooth costs, noise or steps;
        - "multistart": differential evolution, then local searches from several starts in a box; ``optima`` of the
          result lists the minima found. With nonlinear constraints, the local searches use quadratic models.

        Case is ignored in names, and "-", "_" or a space may separate the words. "auto" selects "quadratic-model",
        which continues with another method from its best point (``hand_over``) if the cost is not smooth: with
        Nelder-Mead if it detects kinks or weak noise, with CMA-ES if it detects strong noise or steps. The message
        reports the change. "auto" selects "multistart" with ``search="global"``, "cma-es" with restarts if all
        parameters are integers, "de" if some are, and "ga" with categorical ones. ``method_reason`` of the result gives the reason.
    args : tuple
        Further arguments of `fun`.
    workers : int, map-like or executor
        Number of simultaneous calls of `fun`, each in a separate thread; -1 means all cores. Alternatively, a
        ``concurrent.futures`` executor (including executors of Dask, MPI, joblib and Ray), which receives single points,
        or a function like the built-in ``map`` (``multiprocessing.Pool().map``), which receives whole batches. Both
        are called from the calling thread. With processes, `fun` must be picklable. A point lost by an executor,
        because its process was killed, is evaluated again; three losses of a point end the run. A broken executor
        also ends the run. The number of workers of a map is unknown, so Nelder-Mead plans for all cores. Set
        ``options={"batch": ...}`` to be independent of the machine.
    callback : callable, optional
        ``callback(intermediate_result)`` is called after the starting points and after each iteration, on the calling
        thread, with a `Progress`. Raising StopIteration or returning True ends the run with the best point so far.
    rng : int or numpy.random.Generator, optional
        Seed of the random numbers, or a generator from which to draw the seed; None draws one. The result stores the
        seed in ``seed``.
    max_evaluations, max_iterations : int, optional
        Exact limits on the evaluations and iterations. The evaluations are the same as with one worker (``nfev``);
        speculative calls are counted in ``n_speculative``. If `max_evaluations`, `max_iterations` and `max_time`
        are all None, the defaults of the method apply. For Nelder-Mead, they are 5000 (n + 1) evaluations and
        1000 (n + 1) iterations.
    max_time : float, optional
        Limit on the wall-clock time in s. No call starts after it.
    target : float, optional
        The run ends with the first evaluation whose cost is at or below this value, for any number of workers.
        Simultaneous evaluations that come later in the order count as speculative.
    options : dict, optional
        For every method: ``x_tol`` (1e-6), ``f_tol`` (1e-6), ``stop`` ("all" or "any" of both tests), ``tolerances``
        ("relative": x_tol in units of the sizes of the parameters, f_tol as a fraction of the best cost; or
        "absolute"), ``nominal`` (typical sizes of the parameters, None if unknown; a parameter that starts at 0
        without a nominal size and without a box is first moved by powers of ten to find its size), ``scale``
        ("linear" or "log", for all or each), ``kinds`` ("continuous", "integer" or "categorical", for all or each),
        ``constraint_tol`` (1e-6: violation of a nonlinear constraint up to which a point counts as feasible),
        ``cache`` (number of stored evaluations, which make exact repeats free), ``trace_limit`` (evaluations kept in
        the trace), ``max_failed`` (the run ends if more than this fraction of at least 20 evaluations has failed),
        ``warm_start`` (an earlier result or trace, or points and costs, from which to start), ``problem`` (a word or
        hash that identifies the function; you are responsible for it: the costs of a warm start are reused only if
        both runs have the same one), ``checkpoint_interval`` (seconds between writes, 0.2).

        Nelder-Mead: ``batch`` ("auto", "serial", "ahead" or a number of points), ``coefficients`` ("standard":
        reflection 1, expansion 2, contraction 1/2, shrink 1/2; "adaptive": the coefficients of Gao and Han, which
        depend on n; four numbers; "auto", the default: "standard" below five free parameters, otherwise "adaptive"),
        ``bounds_handling`` ("sine", the default: the search runs over angles, so that bounds are smooth; "mirror",
        also at linear constraints; "clamp"), ``initial_simplex`` (vertices or steps), ``restarts`` (20: maximum number of times that a flat
        simplex, with all vertices nearly in a plane, or a simplex at a kink is rebuilt around its best vertex, as
        long as this lowers the cost; a sound simplex is not rebuilt, so restarts do not find other minima).

        Barrier: ``batch``, ``coefficients``, ``mu``, ``factor``.

        DE: ``population``, ``sampling`` ("uniform", "latin-hypercube", "sobol"), ``initial_population`` (members of
        the first population, shape (m, n), instead of sampled ones; their number is then the population size, and
        `x0` is not added), ``repair`` ("midpoint", "mirror", "clamp", "resample"), ``include_start``, ``lag`` (number of trials made ahead of selection; 0: a whole
        generation at a time, best for one worker); L-SHADE also ``budget``, ``p_best``, ``memory``, ``archive``,
        ``final_population``; classic also ``strategy`` ("rand1", "best1", "current-to-best1", "rand2"), ``crossover``
        ("binomial", "exponential"), ``weight`` (a number, or a pair to draw from), ``probability``.

        GA: ``population``, ``selection`` ("fitness", or the size of a tournament), ``crossover_rate``,
        ``mutation_rate``, ``elite``, ``gray``, ``resolution``, ``sampling``, ``include_start``, ``stall`` (number of
        generations without gain that ends the run; None means never).

        Multistart: ``sample`` (points of a sample), ``sampling``, ``polish`` ("auto", "nelder-mead", "cma-es",
        "least-squares"), ``side_by_side`` (number of simultaneous local searches), ``max_starts``, ``exploration``
        (fraction of the budget for differential evolution).

        CMA-ES: ``population`` (4 + floor(3 ln n)), ``sigma`` (0.3: the first standard deviation, in units of the
        sizes of the parameters), ``restarts`` ("none": the run ends when its tests pass; "ipop" and "bipop": the
        search restarts with other populations until a limit ends the run), ``bounds_handling`` ("smooth", "mirror"),
        ``lag`` (0: number of individuals drawn ahead of selection; four times the number of workers keeps them busy;
        the default population is then at least 3/4 of it), ``patience`` (None: no limit; the run ends after this number
        of successive restarts without a better point).

        Pattern search: ``batch`` ("auto", "serial", "ahead" or a number of points), ``frame`` (0.3: the first
        distance of the points of a poll, in units of the sizes of the parameters), ``restarts`` (1: number of
        consecutive searches with new directions that must not improve the cost).
    checkpoint : path, optional
        File for the state of the run, written after batches and at the end.
    resume : {"auto", "never", "require"}
        "auto": continue from the checkpoint if it exists. "never": start again. "require": fail if it does not exist. A
        finished run returns its stored result. A file of another run is rejected and left unchanged. The module and the
        name of `fun` are part of the identity of a run. You decide whether the function is unchanged: "never" restarts
        after a change. "require" continues even if the name has changed. The option ``problem`` replaces the name. The
        message of a resumed run reports that it was resumed.
    on_error : {"raise", "fail"}
        Action after an exception in `fun`: raise it, or count a failed evaluation. A return value that is not a
        number always raises an error.
    vectorized : bool
        If True, ``fun(x, *args)`` receives points as columns, shape (n, S), and returns costs of shape (S,).
        `workers` must then be a number. It determines the number of points for which Nelder-Mead and pattern search
        plan.
    search : {"local", "global"}
        With method "auto", "local" searches for the minimum next to the start, and "global" for the best minimum in
        the box. A global search requires two finite bounds for every parameter; a start is optional. It uses its
        whole budget (default 1000 (n + 1) evaluations) unless the minima found are probably all minima; see
        "multistart".

    constraints : LinearConstraint, NonlinearConstraint, dict or sequence of these
        Relations between parameters, in SciPy's forms (its own classes are accepted, too; derivatives in them are
        unused). Linear ones hold at every evaluated point; equalities among them reduce the dimension of the search. A
        start that violates them is moved to the nearest feasible point. Nonlinear ones may be violated on the way.
        "quadratic-model", "cma-es" and "multistart" support nonlinear equalities. "de" and "ga" rank points by their
        violation first, which practically never satisfies an equality of continuous parameters, so they reject it.

    Returns
    -------
    OptimizeResult
        Fields as in SciPy. ``x`` is the best point found, regardless of how the run ended.

    Raises
    ------
    ValueError, TypeError
        Invalid arguments; a return value that is not a number (TypeError).
    CheckpointError, OSError
        The checkpoint belongs to another run, is damaged, or cannot be read or written. FileNotFoundError if it is
        required but does not exist.
    AllStartsFailed
        There was no cost at any of the starting points. ``failures`` counts the reasons.
    Interrupted
        Ctrl-C was pressed. This KeyboardInterrupt contains the result so far in ``result``.
    Exception
        Exceptions of `fun` or `callback` propagate unchanged, with the result so far in ``partial_result``.

    Examples
    --------
    >>> import pydfo
    >>> res = pydfo.minimize(lambda x: (x[0] - 1) ** 2 + (x[1] + 2) ** 2, [0, 0], bounds=[(-5, 5), (None, 5)])
    >>> res.x.round(3), res.success
    (array([ 1., -2.]), True)
    """
    return run(
        minimize,
        fun,
        method,
        x0,
        bounds,
        options,
        args=args,
        workers=workers,
        callback=callback,
        on_error=on_error,
        vectorized=vectorized,
        rng=rng,
        checkpoint=checkpoint,
        max_evaluations=max_evaluations,
        max_iterations=max_iterations,
        max_time=max_time,
        target=target,
        resume=resume,
        search=search,
        constraints=constraints,
    )


def run(
    of: Callable[..., Any],
    fun: Callable[..., Any],
    method: str,
    x0: npt.ArrayLike | None,
    bounds: Any,
    options: Mapping[str, Any] | None,
    *,
    args: Any,
    workers: SupportsIndex | Any,
    callback: Callback | None,
    on_error: str,
    vectorized: bool,
    of_residuals: bool = False,
    front: bool = False,
    constraints: Any = None,
    **arguments: Any,
) -> OptimizeResult:
    """Minimises the cost, the residuals, or (with `front`) the criteria returned by `fun`.

    `of` is the function called by the user. With `front`, `of_residuals` must be True."""
    if not callable(fun):
        raise TypeError(f"fun must be callable, not {fun!r}")
    if on_error not in ("raise", "fail"):
        raise ValueError(f"on_error = {on_error!r} is invalid; expected one of: 'raise', 'fail'")
    check_callback(callback)
    extra = args if isinstance(args, tuple) else (args,)
    called = _evaluate.WithArguments(fun, extra) if extra else fun
    cutoffs = not of_residuals and _evaluate.takes_cutoff(fun)
    native, function = _constraints.of_call(constraints, x0, bounds)
    constrained = None
    if native is not None and function is not None:
        constrained = _constraints.Constrained(called, function, native[1], _options.dictionary(options))
        called = called if vectorized else constrained
    batches, count = _evaluate.shared_out(called, "workers", workers, 1, cutoffs)
    if _values.flag("vectorized", vectorized):
        if cutoffs:
            raise ValueError("fun has a parameter cutoff, but vectorized=True evaluates many points at once")
        if batches is not None:
            raise ValueError("workers must be a number if vectorized=True, because fun evaluates whole batches")
        batches = _evaluate.vectorized(called, of_residuals)
        if constrained is not None:
            batches = constrained.of_batches(batches)
    planned = _options.with_plan(options, count) if of_residuals else options
    start, lower, upper, requested = describe(of, method, x0, bounds, planned, function=fun, workers=count, **arguments)
    _constraints.complete(requested, function)
    result = _core.minimize(
        batches or called,
        start,
        lower,
        upper,
        requested,
        constraints=native,
        failures_allowed=on_error == "fail",
        observer=None if callback is None else listen(callback),
        batches=batches is not None,
        cutoffs=cutoffs,
        front=front,
    )
    cost = "" if front else f"; cost = {result[1]!r}"
    _log.info("%s: %s%s after %d evaluations", of.__name__, result.message, cost, result.nfev)
    return result


def describe(
    of: Callable[..., Any],
    method: str,
    x0: npt.ArrayLike | None,
    bounds: Any,
    options: Mapping[str, Any] | None,
    **arguments: Any,
) -> tuple[list[float] | None, list[float], list[float], _options.Record]:
    """Returns start, bounds and options of a run for the native code; `of` is the function called by the user."""
    start = None if x0 is None else _values.vector("x0", x0).tolist()
    lower, upper = _bounds.pairs_of_bounds(bounds, None if start is None else len(start))
    return start, lower.tolist(), upper.tolist(), _options.record(of, method, options, len(lower), **arguments)
