"""`minimize`: a function of several variables, without derivatives, by any of the methods."""

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
) -> OptimizeResult:
    """Minimise a function of several variables without derivatives.

    The same arguments and the same seed give the same path, bit for bit, for any number and kind of workers, and also if
    the run is interrupted and continued from a checkpoint. Points that workers evaluate ahead of need are counted apart
    (``n_speculative``); what they end with, an exception as well, means nothing unless the path comes to them.

    Parameters
    ----------
    fun : callable
        ``fun(x, *args) -> float`` with `x` an array of shape (n,), which the function may keep. NaN and infinities mean
        that there is no cost at this point. A function with a keyword-only parameter `cutoff` is told above which cost
        its value makes no difference (infinite: there is no such cost), and may return ``pydfo.Above(cutoff)`` as soon as
        it knows that it is strictly above: the search decides the same, with less work.
    x0 : array_like, shape (n,), optional
        Where to start; may lie on a bound. Methods that sample a box ("de", "de-classic", "ga") can do without;
        so can "cma-es" and "pattern-search", which then begin in its middle.
    bounds : sequence of pairs, or scipy.optimize.Bounds, optional
        ``(low, high)`` per parameter, None or infinite where there is no bound. Equal bounds fix a parameter. No point
        outside is ever evaluated. Bounds more than 100 times as wide as the nominal size, else abs(x0), tell nothing of the
        parameter's size: methods that start from `x0` then take it from there, and those that sample the box search all of it.
    method : str
        "nelder-mead"; "barrier" (Nelder-Mead with a sequential barrier: needs at least one finite bound, starts strictly inside);
        "de" or "differential-evolution" (L-SHADE) and "de-classic" (rand/1/bin); "ga" or "genetic" (genetic algorithm on bit
        strings); names in any case, with "-", "_" or a space between words; "quadratic-model" (trust
        region on quadratic interpolation models, for smooth costs, with options `radius`, `points`, `restarts`, `hand_over`); "cma-es" (covariance matrix
        adaptation); "pattern-search" (mesh adaptive direct search, for kinks and steps, not for smooth costs); "multistart" (differential
        evolution, then local searches from several starts in a box; the minima they end at are the result's ``optima``).
        "auto" is "quadratic-model" that hands over to Nelder-Mead where noise or kinks of the cost show (``hand_over``: from its best
        point; the message says so) or nothing tells the size of a parameter, "multistart" where ``search="global"``, with integer parameters "de", with categorical ones "ga";
        the result has the reason (``method_reason``).
    args : tuple
        Further arguments of `fun`.
    workers : int, map-like or executor
        How many calls of `fun` may run at once, each in a thread of its own; -1 for all cores. Or a
        ``concurrent.futures`` executor (also those of Dask, MPI, joblib and Ray), which is given points one by one, or a
        function like the built-in ``map`` (``multiprocessing.Pool().map``), which is given whole batches, both from the
        calling thread. With processes, `fun` must be one that can be pickled. A point that an executor loses (its process was
        killed) has failed; one that is broken ends the run. A map does not say how many workers it has: Nelder-Mead then
        plans for all cores; pin ``options={"batch": ...}`` to be independent of the machine.
    callback : callable, optional
        ``callback(intermediate_result)`` after the starting points and after each iteration, on the calling thread, with
        a `Progress`. Raising StopIteration, or returning True, ends the run with the best point so far.
    rng : int or numpy.random.Generator, optional
        The seed of what is random, or a generator to draw it from; None draws one. It stands in the result (``seed``).
    max_evaluations, max_iterations : int, optional
        Exact limits of evaluations, those that a run with one worker makes (``nfev``; calls ahead of need are
        ``n_speculative``), and of iterations. Without any of the first three limits the method's defaults
        hold (for Nelder-Mead 5000 (n + 1) evaluations or 1000 (n + 1) iterations).
    max_time : float, optional
        Limit of wall-clock time in s: no call starts after it.
    target : float, optional
        End the run with the first evaluation whose cost is at or below this, for any number of workers. What was evaluated
        at once with it and comes after it counts as speculative.
    options : dict, optional
        For every method: ``x_tol`` (1e-6), ``f_tol`` (1e-6), ``stop`` ("all" or "any" of both tests), ``tolerances``
        ("relative": x_tol in units of the parameters' sizes, f_tol as a fraction of the best cost; or "absolute"),
        ``nominal`` (typical sizes of the parameters, None where there is none to give; a parameter that starts at 0 without
        one and without a box is first moved by powers of ten to find its size), ``scale`` ("linear" or "log", for all or each), ``kinds``
        ("continuous", "integer" or "categorical", for all or each), ``cache`` (evaluations remembered, so that exact
        repeats cost nothing), ``trace_limit`` (evaluations kept in the trace), ``max_failed`` (the run ends where more than this
        share of its evaluations has failed, of at least 20), ``warm_start`` (an earlier result or trace,
        or points and costs: where to start), ``problem`` (a word or hash for what `fun` computes, which you vouch for: the
        costs of a warm start are reused only where it is the same in both runs), ``checkpoint_interval`` (seconds between
        writes, 0.2).
        Nelder-Mead: ``batch`` ("auto", "serial", "ahead" or a number of points), ``coefficients``
        ("standard": reflection 1, expansion 2, contraction 1/2, shrink 1/2; "adaptive": those of Gao and Han, which depend on n; four
        numbers; "auto", the default: "standard" below five free parameters, "adaptive" from there on),
        ``bounds_handling`` ("sine", the default: the search runs over angles, so that bounds are smooth; "mirror";
        "clamp"), ``initial_simplex`` (vertices or steps), ``restarts`` (20: how often at most a simplex that has become flat, all
        vertices nearly in a plane, or lies on a kink is built anew around its best vertex, as long as that lowers the
        cost; a sound one is not, so this finds no other minima). Barrier: ``batch``, ``coefficients``, ``mu``, ``factor``. DE: ``population``, ``sampling``
        ("uniform", "latin-hypercube", "sobol"), ``repair`` ("midpoint", "mirror", "clamp", "resample"), ``include_start``,
        ``lag`` (number of trials made ahead of selection; 0: a whole generation at a time, best for one worker);
        L-SHADE also ``budget``, ``p_best``, ``memory``, ``archive``, ``final_population``; classic also ``strategy``
        ("rand1", "best1", "current-to-best1", "rand2"), ``crossover`` ("binomial", "exponential"), ``weight`` (a number,
        or a pair to draw from), ``probability``. GA: ``population``, ``selection`` ("fitness", or the size of a
        tournament), ``crossover_rate``, ``mutation_rate``, ``elite``, ``gray``, ``resolution``, ``sampling``,
        ``include_start``, ``stall`` (generations without gain that end the run; None: never). Multistart: ``sample`` (points
        of a sample), ``sampling``, ``polish`` ("auto", "nelder-mead", "cma-es", "least-squares"), ``side_by_side`` (local searches
        at once), ``max_starts``, ``exploration`` (share of the budget for differential evolution). CMA-ES: ``population``
        (4 + floor(3 ln n)), ``sigma`` (0.3: the first standard deviation, in units of the parameters' sizes), ``restarts``
        ("none": the run ends when its tests pass; "ipop" and "bipop": the search begins anew with other populations until a
        limit ends the run), ``bounds_handling`` ("smooth", "mirror"), ``lag`` (0: number of individuals drawn ahead of
        selection; four times the workers keeps them busy, with at least 3/4 of it as population where none is given).
        Pattern search: ``batch`` ("auto", "serial", "ahead" or a number of points), ``frame`` (0.3: the first distance of the
        points of a poll, in units of the parameters' sizes),
        ``restarts`` (1: so many searches in a row with new directions must gain nothing).
    checkpoint : path, optional
        A file for the state of the run, written after batches and at the end.
    resume : {"auto", "never", "require"}
        Whether to continue from that file: if it is there, never, or as a must. A finished run gives its stored result; a
        file of another run is refused and left as it is. The module and the name of `fun` are part of what identifies a run. Whether
        it still computes the same, you decide: "never" restarts after a change. If the name has changed, "require" continues all the
        same. The option ``problem`` replaces the name. The message of a run that was continued says so.
    on_error : {"raise", "fail"}
        What an exception in `fun` means: it is raised, or it counts as a failed evaluation. A return value that is no
        number is always raised.
    vectorized : bool
        ``fun(x, *args)`` takes points as columns, shape (n, S), and returns costs of shape (S,). `workers` must then be a
        number; it says how many points Nelder-Mead and pattern search plan for.
    search : {"local", "global"}
        With method "auto": whether the minimum next to the start is looked for, or the best in the box. A global search needs two
        finite bounds for every parameter and uses its whole budget (default 1000 (n + 1) evaluations) unless the minima found are
        probably all there are; see "multistart". No start is needed.

    Returns
    -------
    OptimizeResult
        Fields as in SciPy. However a run ends, ``x`` is the best point that was seen.

    Raises
    ------
    ValueError, TypeError
        Arguments that cannot be used; a return value that is no number (TypeError).
    CheckpointError, OSError
        A checkpoint that belongs to another run or is damaged; one that cannot be read or written
        (FileNotFoundError: required, but not there).
    AllStartsFailed
        There was no cost at any of the starting points; the reasons are counted in its ``failures``.
    Interrupted
        Ctrl-C: a KeyboardInterrupt with the result so far in ``result``.
    Exception
        Whatever `fun` or `callback` raises comes out as it is, with the result so far in ``partial_result``.

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
    **arguments: Any,
) -> OptimizeResult:
    """Minimises the cost or the residuals that `fun` returns; `of` is the function that the user called."""
    if not callable(fun):
        raise TypeError(f"fun must be callable, not {fun!r}")
    if on_error not in ("raise", "fail"):
        raise ValueError(f"on_error = {on_error!r} is none of 'raise', 'fail'")
    check_callback(callback)
    extra = args if isinstance(args, tuple) else (args,)
    called = _evaluate.WithArguments(fun, extra) if extra else fun
    cutoffs = not of_residuals and _evaluate.takes_cutoff(fun)
    batches, count = _evaluate.shared_out(called, "workers", workers, 1, cutoffs)
    if _values.flag("vectorized", vectorized):
        if cutoffs:
            raise ValueError("fun has a parameter cutoff, but vectorized=True evaluates many points at once")
        if batches is not None:
            raise ValueError("vectorized=True evaluates whole batches itself; workers must be a number then")
        batches = _evaluate.vectorized(called, of_residuals)
    own = _options.with_plan(options, count) if of_residuals else options
    start, lower, upper, asked = describe(of, method, x0, bounds, own, function=fun, workers=count, **arguments)
    result = _core.minimize(
        batches or called,
        start,
        lower,
        upper,
        asked,
        tolerant=on_error == "fail",
        observer=None if callback is None else listen(callback),
        batches=batches is not None,
        cutoffs=cutoffs,
    )
    _log.info("%s: %s; cost = %r after %d evaluations", of.__name__, result.message, result[1], result.nfev)
    return result


def describe(
    of: Callable[..., Any],
    method: str,
    x0: npt.ArrayLike | None,
    bounds: Any,
    options: Mapping[str, Any] | None,
    **arguments: Any,
) -> tuple[list[float] | None, list[float], list[float], _options.Record]:
    """Start, bounds and options of a run, as the native code takes them; `of` is the function that the user called."""
    start = None if x0 is None else _values.vector("x0", x0).tolist()
    lower, upper = _bounds.pairs_of_bounds(bounds, None if start is None else len(start))
    return start, lower.tolist(), upper.tolist(), _options.record(of, method, options, len(lower), **arguments)
