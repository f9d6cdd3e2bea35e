"""`scipy_method`: the methods as ``method=`` of ``scipy.optimize.minimize``."""

from __future__ import annotations

import importlib
import inspect
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from .._args import options as _options
from .minimize import minimize
from .progress import Progress

#: SciPy's names of options, and the names used here.
_LIMITS = {"maxiter": "max_iterations", "maxfev": "max_evaluations"}
_TOLERANCES = {"xatol": "x_tol", "fatol": "f_tol"}
#: Arguments of `minimize` that are accepted with the method or among SciPy's options.
_ARGUMENTS = frozenset(
    ("workers", "rng", "max_evaluations", "max_iterations", "max_time", "target", "checkpoint", "resume", "on_error")
)


def scipy_method(method: str = "auto", **fixed: Any) -> Callable[..., Any]:
    """Return a method for ``scipy.optimize.minimize(fun, x0, method=...)``.

    Bounds, constraints, ``args``, callback, ``tol`` and options are passed on. ``tol`` and the options ``xatol`` and ``fatol`` are
    absolute, as in SciPy's Nelder-Mead, and both tests must pass. ``maxiter``, ``maxfev``, ``adaptive`` and ``disp``
    are also supported. All other options are options of `minimize`.

    Parameters
    ----------
    method : str
        As in `minimize`.
    **fixed
        ``workers``, ``rng``, ``max_time`` and other arguments of `minimize`, except the function, the start, bounds
        and callback; also options. SciPy's options take precedence over them.

    Returns
    -------
    callable
        A function that returns a ``scipy.optimize.OptimizeResult`` with the fields of `OptimizeResult`.

    Raises
    ------
    ValueError, TypeError
        The method is unknown. At run time: `minimize` rejects the arguments.

    Examples
    --------
    >>> from scipy.optimize import minimize
    >>> import pydfo
    >>> res = minimize(lambda x: (x[0] - 1) ** 2, [0.0], method=pydfo.scipy_method("nelder-mead"), bounds=[(-1, 5)])
    >>> res.success, res.x.round(3)
    (True, array([1.]))
    """
    _options.method_name(method)

    def run(
        fun: Callable[..., Any],
        x0: Any,
        args: Any = (),
        jac: Any = None,
        hess: Any = None,
        hessp: Any = None,
        bounds: Any = None,
        constraints: Any = (),
        callback: Callable[..., Any] | None = None,
        **given: Any,
    ) -> Any:
        if any(derivative not in (None, False) for derivative in (jac, hess, hessp)):
            warnings.warn(f"{method} does not use derivatives (jac, hess, hessp)", RuntimeWarning, stacklevel=3)
        options = {**fixed, **given}
        display = bool(options.pop("disp", False))
        tol = options.pop("tol", None)
        if tol is not None:
            for name in _TOLERANCES:
                options.setdefault(name, tol)
        for theirs, ours in _TOLERANCES.items():
            if theirs in options:
                options[ours] = options.pop(theirs)
                options["tolerances"] = "absolute"
        for theirs, ours in _LIMITS.items():
            if theirs in options:
                options[ours] = options.pop(theirs)
        if options.pop("adaptive", False):
            options["coefficients"] = "adaptive"
        arguments = {name: options.pop(name) for name in _ARGUMENTS & options.keys()}
        result = minimize(
            fun,
            x0,
            bounds=bounds,
            constraints=constraints,
            method=method,
            args=args,
            callback=_as_scipy_calls(callback),
            options=options,
            **arguments,
        )
        if display:
            print(result)
        # SciPy cannot print a result that contains an empty dictionary.
        return _result_class()({name: value for name, value in result.items() if not _is_empty(value)})

    return run


def _is_empty(value: Any) -> bool:
    return isinstance(value, dict) and not value


def _result_class() -> Any:
    return importlib.import_module("scipy.optimize").OptimizeResult


def _as_scipy_calls(callback: Callable[..., Any] | None) -> Callable[[Progress], Any] | None:
    """Adapts a callback to SciPy's convention: it receives only the point, unless its only parameter is
    ``intermediate_result``."""
    if callback is None:
        return None
    try:
        named = set(inspect.signature(callback).parameters) == {"intermediate_result"}
    except (TypeError, ValueError):
        named = False
    if not named:
        return lambda progress: callback(np.copy(progress.x))
    made = _result_class()

    def tell(progress: Progress) -> Any:
        return callback(intermediate_result=made({k: v for k, v in vars(progress).items() if k != "_recent"}))

    return tell
