"""Stages of a fit."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, SupportsFloat

from .._args import options as _options
from .._args import text as _text
from .._args import values as _values
from .._args.keywords import explained

#: One window or several, each (from, to).
Windows = tuple[SupportsFloat, SupportsFloat] | Sequence[tuple[SupportsFloat, SupportsFloat]]


class Stage:
    """One stage of a fit. It frees some of the parameters and holds the others at the values of the previous stage.

    Parameters
    ----------
    parameters : sequence of str
        Names of the parameters to free: all values of a local parameter (``"T0"``), or one of them (``"T0[run1]"``).
    windows : (float, float) or list of such, optional
        Intervals of time. Only measurements in these intervals count in this stage; default: the measurements
        that count in the calibration.
    method, x_tol, f_tol, options : optional
        As in `Calibration.fit`; default: the arguments of `Calibration.fit`.
    max_evaluations, max_iterations, max_time, target : optional
        Limits of this stage, after which the next stage starts. The limits of the fit apply to all stages together.
    """

    @explained
    def __init__(
        self,
        parameters: Sequence[str],
        windows: Windows | None = None,
        method: str | None = None,
        max_evaluations: SupportsFloat | None = None,
        max_iterations: SupportsFloat | None = None,
        max_time: SupportsFloat | None = None,
        *,
        target: SupportsFloat | None = None,
        x_tol: float | None = None,
        f_tol: float | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> None:
        self.parameters = names(parameters, "a stage")
        self.windows = intervals("windows", windows)
        self.method = None if method is None else _options.method_name(method)
        self.limits = {
            "max_evaluations": max_evaluations,
            "max_iterations": max_iterations,
            "max_time": max_time,
            "target": target,
        }
        given = {name: value for name, value in (("x_tol", x_tol), ("f_tol", f_tol)) if value is not None}
        self.options = {**_options.dictionary(options), **given}

    def __repr__(self) -> str:
        return f"Stage({_text.names(self.parameters)})"


def names(value: Any, what: str) -> list[str]:
    """Returns a list of names of parameters."""
    if isinstance(value, (str, bytes)) or not isinstance(value, Iterable):
        raise TypeError(f"{what} requires a list of parameter names, such as [['C2', 'G2'], ['C1', 'G1']], not {_text.show(value)}")
    found = []
    for name in value:
        if not isinstance(name, str):
            raise TypeError(f"{what} requires parameter names, not {_text.show(name)}")
        found.append(name)
    return found


def intervals(name: str, value: Any) -> list[tuple[float, float]]:
    """Returns one window, or several, as a list."""
    if value is None:
        return []
    wrong = f"{name} must be a pair (from, to), or a list of pairs, not {_text.show(value)}"
    if isinstance(value, (str, bytes, Mapping)) or not isinstance(value, Iterable):
        raise TypeError(wrong)
    pairs = list(value)
    if not any(isinstance(pair, Iterable) for pair in pairs):
        pairs = [pairs]
    found = []
    for pair in pairs:
        if isinstance(pair, (str, bytes)) or not isinstance(pair, Iterable):
            raise TypeError(wrong)
        limits = [_values.number(name, limit) for limit in pair]
        if len(limits) != 2:
            raise ValueError(wrong)
        found.append((limits[0], limits[1]))
    if not found:
        raise ValueError(wrong)
    return found


def collected(stages: Any) -> list[Stage]:
    """Converts the argument ``stages``: stages, or lists of names."""
    if isinstance(stages, (str, bytes, Stage, Mapping)) or not isinstance(stages, Iterable):
        raise TypeError(f"stages must be a list of stages, such as [['C2', 'G2'], ['C1', 'G1']], not {_text.show(stages)}")
    return [stage if isinstance(stage, Stage) else Stage(names(stage, f"stage {k}")) for k, stage in enumerate(stages, 1)]


def records(
    stages: Sequence[Stage], method: str, fit_options: Mapping[str, Any], record: Callable[..., _options.Record]
) -> list[_options.Record]:
    """Returns the stages with their common settings. `method` and the options `own` apply to stages without a
    method."""
    found = []
    for stage in stages:
        inherited = fit_options if stage.method is None else {name: fit_options[name] for name in ("x_tol", "f_tol", "stop") if name in fit_options}
        requested = record(stage.method or method, {**inherited, **stage.options}, **stage.limits)
        found.append({**requested, "parameters": stage.parameters, "windows": stage.windows})
    return found
