"""Keywords: messages for unknown ones, names of other tools, formerly positional arguments."""

from __future__ import annotations

import functools
import inspect
import warnings
from collections.abc import Callable, Collection, Mapping
from dataclasses import fields
from typing import Any, Final, ParamSpec, TypeVar

from .. import _core

P = ParamSpec("P")
R = TypeVar("R")

_signature = functools.cache(inspect.signature)

#: Names of SciPy, PyFMI, FMPy and similar tools, and the corresponding arguments or options here, if they exist.
_FOREIGN: Final[Mapping[str, tuple[str, ...]]] = {
    **dict.fromkeys(("maxiter", "maxit", "max_iter", "niter"), ("max_iterations", "max_iters")),
    **dict.fromkeys(("max_iterations", "max_iters"), ("max_iterations", "max_iters")),
    **dict.fromkeys(("maxfev", "maxfun", "maxeval", "max_nfev"), ("max_evaluations", "max_fevals")),
    **dict.fromkeys(("max_evaluations", "max_fevals"), ("max_evaluations", "max_fevals")),
    **dict.fromkeys(("xatol", "xtol", "xrtol", "tol_x"), ("x_tol",)),
    **dict.fromkeys(("fatol", "ftol", "frtol", "tol_fun"), ("f_tol",)),
    "atol": ("atol", "f_tol"),
    "rtol": ("rtol", "relative_tolerance"),
    **dict.fromkeys(("tol", "tolerance"), ("relative_tolerance", "rtol", "x_tol and f_tol")),
    **dict.fromkeys(("seed", "random_state"), ("rng",)),
    **dict.fromkeys(("maxtime", "time_limit", "timeout", "max_time"), ("max_time", "timeout")),
    "adaptive": ('options={"coefficients": "adaptive"}',),
    "popsize": ("population",),
    "init": ('options={"sampling": ...} or options={"initial_population": ...}',),
    "disp": ("disp", "callback"),
    "polish": ("method",),
    "x_scale": ("nominal",),
    "vectorised": ("vectorized",),
    **dict.fromkeys(("nbr_cores", "ncores", "n_jobs", "n_workers"), ("nbr_cores", "workers")),
    **dict.fromkeys(("fun", "func", "cost", "objective"), ("fun", "func")),
    **dict.fromkeys(("x0", "xstart", "y0"), ("x0", "xstart", "start")),
    "bounds": ("bounds", "lb and ub"),
    "cons": ("constraints",),
    **dict.fromkeys(("lb", "ub"), ("bounds",)),
    **dict.fromkeys(("min", "minimum", "low", "lb_"), ("lower",)),
    **dict.fromkeys(("max", "maximum", "high"), ("upper",)),
    **dict.fromkeys(("value", "initial", "guess"), ("start",)),
    **dict.fromkeys(("alg", "method", "solver"), ("method", "alg", "solver")),
    **dict.fromkeys(("stop_time", "t_end", "tend", "tf", "tstop"), ("final_time", "t_span", "window")),
    **dict.fromkeys(("t_start", "tstart"), ("start_time", "t_span")),
    **dict.fromkeys(("dt", "h", "step", "step_size"), ("step", "step_size")),
    **dict.fromkeys(("hmax", "maxh"), ("max_step",)),
    **dict.fromkeys(("t", "t_eval", "teval"), ("times", "t_eval")),
    "f": ("rhs",),
    "fmu": ("model", "path"),
    **dict.fromkeys(("opts", "option", "opt"), ("options",)),
    "filename": ("path", "model"),
    "measurements": ("data",),
}

#: Names without a counterpart here, and the alternative.
_ABSENT: Final[Mapping[str, str]] = {
    **dict.fromkeys(("gtol", "tr_solver", "tr_options"), "unsupported; the tolerances are x_tol and f_tol"),
    "mutation": "method 'de' adapts it; method 'de-classic' has the option weight",
    "recombination": "method 'de' adapts it; method 'de-classic' has the option probability",
    "diff_step": "unsupported; the steps are derived from the noise and the parameter sizes (option nominal)",
    **dict.fromkeys(("jac", "hess", "hessp", "gradient", "grad"), "unsupported; the methods do not use derivatives"),
    **dict.fromkeys(("args", "kwargs", "fargs"), "pass additional arguments through a function: lambda x: f(x, a)"),
}


def _hint(name: str, arguments: Collection[str], among_options: bool = False) -> str:
    """Suggests the intended argument of a function or, if it has that argument, the intended entry of ``options``."""
    options = _core.option_names() if "options" in arguments else set()
    for ours in (name, *_FOREIGN.get(name, ())):
        parts = ours.split(" and ")
        plural = "s" if len(parts) > 1 else ""
        if ours != name and all(part in arguments for part in parts):
            return f"; use the argument{plural} {ours}"
        if all(part in options for part in parts):
            how = "" if among_options else f": options={{{', '.join(f'{part!r}: ...' for part in parts)}}}"
            return f"; use the option{plural} {ours}{how}"
        if ours.startswith("options=") and options:
            return f"; use {ours}"
    if name in _ABSENT:
        return f"; {_ABSENT[name]}"
    import difflib

    near = difflib.get_close_matches(name, {*arguments, *options}, 1)
    if not near:
        return f"; expected one of: {', '.join(arguments)}"
    return f"; did you mean {near[0]}?" if near[0] in arguments else f"; did you mean options={{{near[0]!r}: ...}}?"


def argument_names(function: Callable[..., Any]) -> list[str]:
    """Returns the names of the arguments of a function or method, including the fields of its groups."""
    parameters = _signature(function).parameters
    names = [name for name, parameter in parameters.items() if name != "self" and parameter.kind is not parameter.VAR_KEYWORD]
    return [*names, *getattr(function, "_grouped_names", ())]


def explained(function: Callable[P, R]) -> Callable[P, R]:
    """Wraps a function so that its TypeError for an unknown keyword suggests the intended one."""
    return also_called()(function)


def also_called(*, groups: tuple[type, ...] = (), **others: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Like `explained`, for a function that also accepts other keywords.

    `groups` are dataclasses whose fields are keywords of the function. `others` maps keywords of other tools to
    arguments of the function."""

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        setattr(function, "_grouped_names", tuple(field.name for group in groups for field in fields(group)))
        names = argument_names(function)
        positional = list(_signature(function).parameters)
        accepted = frozenset(("self", *names))

        def translated(n_positional: int, given: dict[str, Any]) -> dict[str, Any]:
            for other in others.keys() & given.keys():
                name, value = others[other], given.pop(other)
                if name not in given and name not in positional[:n_positional]:
                    given[name] = value
                elif value is not None:
                    raise ValueError(f"{name} and {other} are the same argument; specify only one of them")
            if not accepted.issuperset(given):
                name = next(name for name in given if name not in accepted)
                owner = function.__qualname__.removesuffix(".__init__")
                raise TypeError(f"{owner}() has no argument {name!r}{_hint(name, names)}")
            return given

        @functools.wraps(function)
        def call(*args: Any, **kwargs: Any) -> R:
            if not accepted.issuperset(kwargs):
                kwargs = translated(len(args), kwargs)
            return function(*args, **kwargs)

        return call

    return decorate


def positional_until(count: int) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Lets a function accept its keyword-only arguments by position after `count` positional ones, with a warning."""

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        names = list(_signature(function).parameters)

        @functools.wraps(function)
        def call(*args: Any, **kwargs: Any) -> R:
            if count < len(args) <= len(names):
                moved = dict(zip(names[count:], args[count:]))
                what = f"{function.__name__}(): positional arguments after {names[count - 1]}"
                warnings.warn(f"{what} are deprecated; use {', '.join(f'{n}=...' for n in moved)}", DeprecationWarning, stacklevel=2)
                if twice := moved.keys() & kwargs.keys():
                    raise TypeError(f"{function.__name__}() got multiple values for argument '{min(twice)}'")
                args, kwargs = args[:count], {**moved, **kwargs}
            return function(*args, **kwargs)

        return call

    return decorate


def check_options(options: Collection[str], function: Callable[..., Any]) -> None:
    """Rejects options that are arguments of `function`, and options of other tools, and suggests the names used
    here."""
    arguments, accepted = argument_names(function), _core.option_names()
    for name in options:
        # Files use "rng" as the name of a seed.
        if name in accepted and name != "rng":
            continue
        if name in arguments:
            raise ValueError(f"{name} is an argument of {function.__name__}, not an option")
        if name in _FOREIGN or name in _ABSENT:
            raise ValueError(f"unknown option {name!r}{_hint(name, arguments, among_options=True)}")


def given_once(options: Mapping[str, Any], function: Callable[..., Any], **arguments: Any) -> dict[str, Any]:
    """Returns the options together with the arguments of `function` that are options of methods.

    None and "auto" leave the choice to the method. Raises ValueError if a value is given as both."""
    for name, value in arguments.items():
        default = _signature(function).parameters[name].default
        is_default = value is default or (isinstance(value, (int, float, str)) and value == default)
        if name in options and not is_default:
            raise ValueError(f"{name} is specified twice, as an argument and as an option")
    given = {name: value for name, value in arguments.items() if not (value is None or isinstance(value, str) and value == "auto")}
    return {**given, **options}
