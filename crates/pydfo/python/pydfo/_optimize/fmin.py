"""`fmin`: minimises a Python function, with the signature of the paper's tool."""

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
from . import constraints as _constraints
from . import evaluate as _evaluate
from .progress import Printer, Progress
from .result import OptimizeResult

if TYPE_CHECKING:
    from .._plot import SimplexWalk

_log = logging.getLogger("pydfo")

Objective = Callable[[npt.NDArray[np.float64]], Any]
Callback = Callable[[Progress], Any]


def _algorithm(alg: int | str | None) -> str:
    """Returns the name of a method from its number or name; None selects Nelder-Mead."""
    if alg is None:
        return "nelder-mead"
    if isinstance(alg, str):
        return _options.method_name(alg)
    try:
        return _core.method_of_number(operator.index(alg))
    except (ValueError, TypeError, OverflowError):
        raise ValueError(f"alg = {alg!r} must be a number from 1 to 4, or a method name as in minimize") from None


def check_callback(callback: Any) -> None:
    """Raises TypeError if `callback` cannot be called."""
    if callback is not None and not callable(callback):
        raise TypeError(f"callback must be callable, not {callback!r}")
    if inspect.iscoroutinefunction(callback):
        raise TypeError("callback is a coroutine function (async def), which would never run; use a regular function")


def listen(callback: Callback) -> Callback:
    """Wraps a callback with a keyword-only parameter ``intermediate_result`` so that it receives its argument by
    name."""
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
    constraints: Any = None,
) -> OptimizeResult:
    """Minimise a function of several variables without derivatives.

    The signature is the same as in the tool described in the paper. Additional arguments are keyword-only.

    Parameters
    ----------
    func : callable
        ``func(x) -> float``. `x` is an array of shape (n,), which the function may keep. Functions, methods, partials
        and objects with ``__call__`` are accepted. The function may return a float, a NumPy scalar or an array of one
        element. NaN and infinities mean that there is no cost at this point.
    xstart : array_like, shape (n,)
        Starting point, which may be on a bound (not with 2, the barrier method). It is optional for methods 3 and 4.
    lb, ub : array_like, shape (n,), or number, optional
        Bounds; None, also as an element, if there is no bound. Equal bounds fix a parameter. No point outside the
        bounds is ever evaluated.
    alg : optional
        1 or None: Nelder-Mead; 2: Nelder-Mead with a sequential barrier; 3: differential evolution as in the paper
        (rand/1/bin); 4: genetic algorithm; or a name as in `minimize` ("de" is L-SHADE). Method 2 requires a bound.
        Methods 3 and 4 require both bounds for every parameter.
    plot : bool
        If True, draw the contours of the cost over two parameters, with the path of the simplex or the population.
        Needs matplotlib.
    plot_conv : bool
        If True, draw the best point and its cost against the evaluations. Needs matplotlib.
    x_tol : float
        Absolute tolerance of the x test: the largest distance, along an axis, of a vertex from the best one.
    f_tol : float
        Absolute tolerance of the f test: the difference between the worst and the best vertex.
    max_iters, max_fevals : int, optional
        Exact limits on iterations and evaluations; default: no limit. They apply to ``nfev``, the
        evaluations of a run with one worker. Speculative calls are counted in ``n_speculative``.
    disp : bool
        If True, print a line per iteration and how the run ended.
    nbr_cores : int, map-like or executor, optional
        Number of simultaneous calls of `func`, each in a separate thread; -1 means all cores, None means 1. A Python
        function is called from several threads only on request. Only functions that release the interpreter lock, such as
        simulations, run faster in several threads. Alternatively, a ``concurrent.futures`` executor, which receives
        single points, or a function like the built-in ``map`` (``multiprocessing.Pool().map``), which receives whole
        batches. Both are called from the calling thread. With processes, as in the paper's tool, `func` must be
        picklable. The simplices and the result do not depend on the choice.
    debug : bool
        If True, log every evaluation (logger "pydfo", level DEBUG).
    workers : optional
        Another name for `nbr_cores`, as in `minimize`.
    callback : callable, optional
        Called after the starting points and after each iteration with a `Progress`, on the calling thread. Raising
        StopIteration or returning True ends the run with the best point so far.
    rng : int or numpy.random.Generator, optional
        Seed of the random numbers, or a generator from which to draw the seed; None draws one. The result stores the
        seed in ``seed``.
    stop : {"any", "all"}
        "any": one of the two tests ends the run, as in the paper. "all": both tests must pass. A simplex that has not
        moved yet never passes.
    batch : {"auto", "serial", "ahead"} or int
        Number of trial points that methods 1 and 2 evaluate at once, speculatively. "auto" uses the most efficient
        number up to `nbr_cores`; "ahead" always uses the maximum. The simplices do not depend on it. Unneeded
        evaluations count only in ``n_speculative``.
    initial_simplex : array_like, optional
        Vertices, shape (n + 1, n), or steps from `xstart` along each axis, shape (n,). By default, each parameter has
        a separate step: a tenth of the width of its box (up to 100 abs(xstart)), otherwise 0.3 abs(xstart). If this
        is 0, steps of powers of ten determine it.
    target : float, optional
        The run ends with the first evaluation whose cost is at or below this value, for any number of workers.
        Simultaneous evaluations that come later in the order count as speculative.
    max_time : float, optional
        Limit on the wall-clock time in s. No call starts after it.
    on_error : {"raise", "fail"}
        Action after an exception in `func`: raise it, or count a failed evaluation. A return value that is not a
        number always raises an error.
    options : dict, optional
        Further options of the method, see `minimize`. Two defaults differ from `minimize`: ``tolerances`` is
        "absolute", and methods 1 and 2 use the ``coefficients`` "standard" (Table 1 of the paper) for any number of
        parameters. `minimize` uses "auto", which is adaptive from five parameters on and solves more problems there.
    checkpoint, resume : optional
        File for the state of the run, and the rule for continuing from it; see `minimize`.
    constraints : optional
        Relations between parameters, see `minimize`.

    Returns
    -------
    OptimizeResult
        Fields ``x``, ``fun``, ``nit``, ``nfev``, ``nfail``, ``success``, ``message``, ``trace`` and others. The
        result unpacks like the five-tuple ``(x_opt, f_opt, nbr_iters, nbr_fevals, solve_time)``. ``x`` is the best
        point found, regardless of how the run ended.

    Raises
    ------
    ValueError, TypeError
        Invalid arguments; a return value that is not a number (TypeError).
    AllStartsFailed
        There was no cost at any of the starting points. ``failures`` counts the reasons.
    Interrupted
        Ctrl-C was pressed. This KeyboardInterrupt contains the result so far in ``result``. It is raised after a
        running call of `func` returns; a second Ctrl-C raises it at once.
    Exception
        Exceptions of `func` or `callback` propagate unchanged, with the result so far in ``partial_result`` (None if
        no point had a cost yet).

    Examples
    --------
    >>> from pydfo import fmin
    >>> res = fmin(lambda x: (x[0] - 1) ** 2 + (x[1] + 2) ** 2, [0, 0], lb=[-5, -5], ub=[5, 5], disp=False, stop="all")
    >>> res.x.round(3)
    array([ 1., -2.])
    >>> x_opt, f_opt, nbr_iters, nbr_fevals, solve_time = res
    """
    if not callable(func):
        hint = "; pass the function itself, not the name of its file" if isinstance(func, str) else ""
        raise TypeError(f"func must be callable, not {func!r}{hint}")
    for name, value in (("plot", plot), ("plot_conv", plot_conv), ("disp", disp), ("debug", debug)):
        _values.flag(name, value)
    method = _algorithm(alg)
    if on_error not in ("raise", "fail"):
        raise ValueError(f"on_error = {on_error!r} is invalid; expected one of: 'raise', 'fail'")
    check_callback(callback)
    if xstart is None and method not in _options.SAMPLERS:
        raise ValueError(f"xstart, the start point of {method}, is missing")
    start = None if xstart is None else _values.vector("xstart", xstart)
    n = _size(start, lb, ub)
    lower = _bounds.bound("lb", lb, n, -np.inf)
    upper = _bounds.bound("ub", ub, n, np.inf)
    method_options = given_once(
        _options.dictionary(options), fmin, x_tol=x_tol, f_tol=f_tol, stop=stop, initial_simplex=initial_simplex, batch=batch
    )
    if method in ("nelder-mead", "barrier"):
        method_options.setdefault("coefficients", "standard")
    # Default of the paper.
    method_options.setdefault("tolerances", "absolute")
    if nbr_cores is not None and workers is not None:
        raise ValueError("nbr_cores and workers are the same argument; specify only one of them")
    name, given = ("nbr_cores", nbr_cores) if workers is None else ("workers", workers)
    native, function = _constraints.read(constraints, start, lower, upper)
    called = func if native is None or function is None else _constraints.Constrained(func, function, native[1], method_options)
    batches, count = _evaluate.shared_out(called, name, given, 1)
    requested = _options.record(
        fmin,
        method,
        method_options,
        n,
        rng=rng,
        checkpoint=checkpoint,
        function=func,
        workers=count,
        max_fevals=max_fevals,
        max_iters=max_iters,
        max_time=max_time,
        target=target,
        # A limit of None means no limit, so the default of the method does not apply.
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
            batches or called,
            None if start is None else start.tolist(),
            lower.tolist(),
            upper.tolist(),
            requested,
            constraints=native,
            failures_allowed=on_error == "fail",
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
    """Returns the number of parameters: the length of the start point, otherwise of the longest bound."""
    if start is not None:
        return len(start)
    return max(1, *(1 if b is None else np.size(b) for b in bounds))


def combine(listeners: list[Callback]) -> Callback | None:
    """Returns one listener that calls all listeners. True from any of them ends the run."""
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
