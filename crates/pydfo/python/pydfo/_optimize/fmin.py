"""`fmin`: minimises a Python function, with the signature of the tool of the paper."""

from __future__ import annotations

import inspect
import logging
import operator
import os
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, SupportsFloat, SupportsIndex

import numpy as np
import numpy.typing as npt

from .. import _core
from .._args import bounds as _bounds
from .._args import options as _options
from .._args import values as _values
from .._args.keywords import explained, given_once
from .._errors import Interrupted
from . import evaluate as _evaluate
from .progress import Printer, Progress
from .result import OptimizeResult

if TYPE_CHECKING:
    from .._plot import SimplexWalk

_log = logging.getLogger("pydfo")

Objective = Callable[[npt.NDArray[np.float64]], Any]
Callback = Callable[[Progress], Any]


def _algorithm(alg: int | str | None) -> str:
    """The name of a method from its number or name; None stands for Nelder-Mead."""
    if alg is None:
        return "nelder-mead"
    if isinstance(alg, str):
        return _options.method_name(alg)
    try:
        return _core.method_of_number(operator.index(alg))
    except (ValueError, TypeError, OverflowError):
        raise ValueError(f"alg = {alg!r} is none of the numbers 1 to 4, nor a name as in minimize") from None


def check_callback(callback: Any) -> None:
    """Refuses what cannot be called."""
    if callback is not None and not callable(callback):
        raise TypeError(f"callback must be callable, not {callback!r}")
    if inspect.iscoroutinefunction(callback):
        raise TypeError("callback is a coroutine function (async def), whose body would never run: give a plain function")


def listen(callback: Callback) -> Callback:
    """A callback that is given its argument by name if it asks for it by the name ``intermediate_result``."""
    try:
        parameters = inspect.signature(callback).parameters
    except (TypeError, ValueError):
        return callback
    named = parameters.get("intermediate_result")
    if named is not None and named.kind is inspect.Parameter.KEYWORD_ONLY:
        return lambda progress: callback(intermediate_result=progress)  # type: ignore[call-arg]
    return callback


def log_evaluations(progress: Progress) -> None:
    """Writes the evaluations of an iteration to the log."""
    for x, outcome, used in progress._recent:
        _log.debug("x = %s: %s%s", x.tolist(), outcome, "" if used else " (not used)")


@explained
def fmin(
    func: Objective,
    xstart: npt.ArrayLike | None = None,
    lb: npt.ArrayLike | Sequence[float | None] | None = None,
    ub: npt.ArrayLike | Sequence[float | None] | None = None,
    alg: int | str | None = None,
    plot: bool = False,
    plot_conv: bool = False,
    x_tol: float = 1e-6,
    f_tol: float = 1e-6,
    max_iters: SupportsFloat | None = 1000,
    max_fevals: SupportsFloat | None = 10000,
    disp: bool = True,
    nbr_cores: SupportsIndex | Any = None,
    debug: bool = False,
    *,
    workers: SupportsIndex | Any = None,
    callback: Callback | None = None,
    rng: int | np.random.Generator | None = None,
    stop: Literal["any", "all"] = "any",
    batch: str | SupportsIndex = "auto",
    initial_simplex: npt.ArrayLike | None = None,
    target: SupportsFloat | None = None,
    max_time: SupportsFloat | None = None,
    on_error: Literal["raise", "fail"] = "raise",
    options: Mapping[str, Any] | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    resume: Literal["auto", "never", "require"] = "auto",
) -> OptimizeResult:
    """Minimise a function of several variables without derivatives.

    The signature is that of the tool that the paper describes; what is new is keyword-only.

    Parameters
    ----------
    func : callable
        ``func(x) -> float`` with `x` an array of shape (n,), which the function may keep. Functions, methods, partials
        and objects with ``__call__`` will do. It may return a float, a NumPy scalar or an array of one element. NaN and
        infinities mean that there is no cost at this point.
    xstart : array_like, shape (n,)
        Where to start. May lie on a bound (not with 2, the barrier method). Methods 3 and 4 can do without.
    lb, ub : array_like, shape (n,), or number, optional
        Bounds; None (also as an element) where there is none. Equal bounds fix a parameter. No point outside of the
        bounds is ever evaluated.
    alg : optional
        1 or None: Nelder-Mead; 2: Nelder-Mead with a sequential barrier; 3: differential evolution as in the paper
        (rand/1/bin); 4: genetic algorithm; or a name as in `minimize` ("de" is L-SHADE). 2 needs a bound, 3 and 4 need
        both bounds for every parameter.
    plot : bool
        Draw the cost as contours over two parameters, with the simplex (or the population) walking. Needs matplotlib.
    plot_conv : bool
        Draw how the best point and its cost change with the evaluations. Needs matplotlib.
    x_tol : float
        Absolute tolerance of the x test: the largest distance, along an axis, of a vertex from the best one.
    f_tol : float
        Absolute tolerance of the f test: the difference between the worst and the best vertex.
    max_iters, max_fevals : int, optional
        Exact limits of iterations and of evaluations, those that a run with one worker makes (``nfev``; calls ahead of need
        are ``n_speculative``); None for no limit.
    disp : bool
        Print a line per iteration, and how the run ended.
    nbr_cores : int, map-like or executor, optional
        How many calls of `func` may run at once, each in a thread of its own; -1 for all cores. None stands for 1: a
        Python function is called from several threads only if you ask for it. Only what releases the interpreter lock
        (simulations do) gains from more. Or a ``concurrent.futures`` executor, which is given points one by one, or a function
        like the built-in ``map`` (``multiprocessing.Pool().map``), which is given whole batches, both from the calling thread:
        with processes, as the tool of the paper has it, `func` must be one that can be pickled. The simplices and the result are the same for any.
    debug : bool
        Log every evaluation (logger "pydfo", level DEBUG).
    workers : optional
        Another name for `nbr_cores`, that of `minimize`.
    callback : callable, optional
        Called after the starting points and after each iteration with a `Progress`, on the calling thread. Raising
        StopIteration, or returning True, ends the run with the best point so far.
    rng : int or numpy.random.Generator, optional
        The seed of what is random, or a generator to draw it from; None draws one. It stands in the result (``seed``).
    stop : {"any", "all"}
        Whether one of the two tests ends the run (as in the paper), or both must hold. A simplex that has not moved yet
        never passes.
    batch : {"auto", "serial", "ahead"} or int
        Methods 1 and 2: how many trial points are evaluated at once, ahead of need; "auto" takes at most `nbr_cores`, as many as
        pay; "ahead" always as many. The simplices are the same; what is evaluated in vain counts in ``n_speculative`` only.
    initial_simplex : array_like, optional
        Vertices, shape (n + 1, n), or steps from `xstart` along each axis, shape (n,). By default each parameter has a
        step of its own: a tenth of the width of its box (up to 100 abs(xstart)), else 0.3 abs(xstart); where that is 0, one that is found by steps
        of powers of ten.
    target : float, optional
        End the run with the first evaluation whose cost is at or below this, for any number of workers. What was evaluated
        at once with it and comes after it counts as speculative.
    max_time : float, optional
        Limit of wall-clock time in s: no call starts after it.
    on_error : {"raise", "fail"}
        What an exception in `func` means: it is raised, or it counts as a failed evaluation. A return value that is no
        number is always raised.
    options : dict, optional
        What else the method can be told, see `minimize`. Two defaults are others than there: ``tolerances`` are
        "absolute", and methods 1 and 2 take the ``coefficients`` "standard", those of Table 1 of the paper, for any
        number of parameters (`minimize` takes "auto": adaptive ones from five on, which solve more problems there).
    checkpoint, resume : optional
        A file for the state of the run, and whether to continue from it; see `minimize`.

    Returns
    -------
    OptimizeResult
        With fields ``x``, ``fun``, ``nit``, ``nfev``, ``nfail``, ``success``, ``message``, ``trace`` and others; unpacks
        like the five-tuple ``(x_opt, f_opt, nbr_iters, nbr_fevals, solve_time)``. However a run ends, ``x`` is the best
        point that was seen.

    Raises
    ------
    ValueError, TypeError
        Arguments that cannot be used; a return value that is no number (TypeError).
    AllStartsFailed
        There was no cost at any of the starting points; the reasons are counted in its ``failures``.
    Interrupted
        Ctrl-C: a KeyboardInterrupt with the result so far in ``result``. A call of `func` that is running is awaited;
        a second Ctrl-C does not wait.
    Exception
        Whatever `func` or `callback` raises comes out as it is, with the result so far in ``partial_result`` (None
        if no point had a cost yet).

    Examples
    --------
    >>> from pydfo import fmin
    >>> res = fmin(lambda x: (x[0] - 1) ** 2 + (x[1] + 2) ** 2, [0, 0], lb=[-5, -5], ub=[5, 5], disp=False, stop="all")
    >>> res.x.round(3)
    array([ 1., -2.])
    >>> x_opt, f_opt, nbr_iters, nbr_fevals, solve_time = res
    """
    if not callable(func):
        hint = "; give the function itself, not the name of its file" if isinstance(func, str) else ""
        raise TypeError(f"func must be callable, not {func!r}{hint}")
    for name, value in (("plot", plot), ("plot_conv", plot_conv), ("disp", disp), ("debug", debug)):
        _values.flag(name, value)
    method = _algorithm(alg)
    if on_error not in ("raise", "fail"):
        raise ValueError(f"on_error = {on_error!r} is none of 'raise', 'fail'")
    check_callback(callback)
    if xstart is None and method not in _options.SAMPLERS:
        raise ValueError(f"xstart is needed: the point where {method} starts")
    start = None if xstart is None else _values.vector("xstart", xstart)
    n = _size(start, lb, ub)
    lower = _bounds.bound("lb", lb, n, -np.inf)
    upper = _bounds.bound("ub", ub, n, np.inf)
    own = given_once(
        _options.dictionary(options), fmin, x_tol=x_tol, f_tol=f_tol, stop=stop, initial_simplex=initial_simplex, batch=batch
    )
    if method in ("nelder-mead", "barrier"):
        own.setdefault("coefficients", "standard")
    # As the paper has them.
    own.setdefault("tolerances", "absolute")
    if nbr_cores is not None and workers is not None:
        raise ValueError("nbr_cores and workers are two names for one argument: give one of them")
    name, given = ("nbr_cores", nbr_cores) if workers is None else ("workers", workers)
    batches, count = _evaluate.shared_out(func, name, given, 1)
    asked = _options.record(
        fmin,
        method,
        own,
        n,
        rng=rng,
        checkpoint=checkpoint,
        function=func,
        workers=count,
        max_fevals=max_fevals,
        max_iters=max_iters,
        max_time=max_time,
        target=target,
        # Who asks for no limit has none, not even the method's own.
        unlimited=True,
        resume=resume,
    )
    listeners: list[Callback] = []
    if debug:
        listeners.append(log_evaluations)
    printer = Printer()
    if disp:
        listeners.append(printer)
    walk: SimplexWalk | None = None
    if plot or plot_conv:
        from .. import _plot

        _plot.pyplot()
        if plot:
            walk = _plot.SimplexWalk(lower != upper)
            listeners.append(walk)
    if callback is not None:
        listeners.append(listen(callback))
    try:
        result: OptimizeResult = _core.minimize(
            batches or func,
            None if start is None else start.tolist(),
            lower.tolist(),
            upper.tolist(),
            asked,
            tolerant=on_error == "fail",
            observer=combine(listeners),
            batches=batches is not None,
            detail=debug,
        )
    except Interrupted as e:
        if disp and isinstance(e.result, OptimizeResult):
            _print_end(printer, e.result)
        raise
    _log.info("fmin: %s; f = %r after %d evaluations", result.message, result.fun, result.nfev)
    if disp:
        _print_end(printer, result)
    if walk is not None:
        result.figures += (walk.finish(result),)
    if plot_conv:
        from .. import _plot

        result.figures += (_plot.convergence(result),)
    return result


def _size(start: npt.NDArray[np.float64] | None, *bounds: Any) -> int:
    """How many parameters there are: the length of the start point, else of the longest of the bounds."""
    if start is not None:
        return len(start)
    return max(1, *(1 if b is None else np.size(b) for b in bounds))


def combine(listeners: list[Callback]) -> Callback | None:
    """One listener that calls all of them; True from any of them ends the run."""
    if not listeners:
        return None

    def tell(progress: Progress) -> bool:
        enough = False
        for listener in listeners:
            enough |= listener(progress) is True
        return enough

    return tell


def _print_end(printer: Printer, result: OptimizeResult) -> None:
    printer.end(result.message, result.x, result.fun, result.nit, result.nfev, result.solve_time)
