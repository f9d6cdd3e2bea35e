"""A recording and how the model is to reproduce it: `Experiment`."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, SupportsFloat

import numpy as np

from . import _data, _options
from ._errors import BadCalibrationError
from ._keywords import explained

Names = Mapping[str, str] | Sequence[str] | str


@dataclass(frozen=True, init=False, repr=False)
class Experiment:
    """A recording of the machine, and how the model is to reproduce it: for a `Calibration` with several of them.

    Parameters
    ----------
    data : path, dict of arrays, DataFrame, Series, xarray or structured array
        The recording, as `Calibration` takes it.
    outputs : dict of str to str, or list of str
        Which output of the model was measured by which column.
    inputs : dict of str to str, or list of str, optional
        Which input of the model is driven by which column.
    window : (float, float), optional
        Only measurements at times in this interval count, in s.
    weights : dict of str to float, or sequence of float, optional
        Per output, what its residuals are multiplied with.
    start_values : dict, optional
        Values of other parameters and start values of variables in this experiment, by name; of a local parameter, where
        its search starts here.
    start_time : float, optional
        Where the simulation starts, in s.
    time : str, optional
        Name of the column of times, where it is not ``time``.
    mask : array of bool or str, optional
        Rows whose measurements count, one entry per row, or the column that says so (neither 0 nor missing). Inputs count in all rows.
    resample : float, optional
        Interval in s over which the times and all columns are replaced by their means (of what the mask leaves).
    name : str, optional
        Its name, in those of local parameters as well (``T0[cold]``); default: "run1", "run2" and so on. Not empty, without
        brackets and line breaks.

    Raises
    ------
    ValueError, TypeError
        As `Calibration`, which reads a CSV file, and raises what is wrong with it.

    Examples
    --------
    >>> from pydfo import Calibration, Parameter, example_fmu
    >>> runs = [
    ...     Experiment({"time": [0.0, 1.0], "x": [1.0, 0.14]}, ["x"], name="a"),
    ...     Experiment({"time": [0.0, 1.0], "x": [3.0, 0.41]}, ["x"], start_values={"x": 2.0}, name="b"),
    ... ]
    >>> parameters = [Parameter("k", 1.0, 0.1, 10.0), Parameter("x", 1.0, 0.1, 10.0, local=True)]
    >>> calibration = Calibration(example_fmu("dahlquist"), runs, parameters)
    >>> dict(zip(calibration.names, calibration.start.tolist()))
    {'k': 1.0, 'x[a]': 1.0, 'x[b]': 2.0}
    """

    name: str | None
    path: str | None
    columns: _data.Columns
    left_out: list[str]
    time: str | None
    outputs: list[tuple[str, str, float]]
    inputs: list[tuple[str, str]]
    start_values: list[tuple[str, Any]]
    window: tuple[float, float] | None
    start_time: float | None
    mask: list[bool] | None
    mask_column: str | None
    resample: float | None

    @explained
    def __init__(
        self,
        data: Any,
        outputs: Names,
        inputs: Names | None = None,
        *,
        window: tuple[float, float] | None = None,
        weights: Mapping[str, float] | Sequence[float] | None = None,
        start_values: Mapping[str, Any] | None = None,
        start_time: SupportsFloat | None = None,
        time: str | None = None,
        name: str | None = None,
        mask: Any = None,
        resample: SupportsFloat | None = None,
    ) -> None:
        put = object.__setattr__
        put(self, "name", None if name is None else _options.choice("name", name))
        with _errors_name(self.name):
            pairs = pairs_of_columns("outputs", outputs)
            driven = pairs_of_columns("inputs", inputs)
            named = None if time is None else _options.choice("time", time)
            rows, by = _data.mask(mask)
            table = _data.read(data, [column for _, column in pairs + driven] + ([] if by is None else [by]), named)
            put(self, "mask", rows)
            put(self, "mask_column", by)
            put(self, "resample", _options.optional_number("resample", resample))
            span = None
            if window is not None:
                if np.shape(window) != (2,):
                    raise ValueError(f"window must be two times, not {_options.show(window)}")
                span = (_options.number("window", window[0]), _options.number("window", window[1]))
            put(self, "path", table.path)
            put(self, "columns", table.columns)
            put(self, "left_out", table.left_out)
            put(self, "time", table.time)
            put(self, "outputs", weighted(pairs, weights))
            put(self, "inputs", driven)
            put(self, "start_values", _options.pairs("start_values", start_values))
            put(self, "window", span)
            put(self, "start_time", _options.optional_number("start_time", start_time))

    def __repr__(self) -> str:
        source = self.path if self.path is not None else f"{len(self.columns[0][1])} rows"
        outputs = ", ".join(variable for variable, _, _ in self.outputs)
        return f"<Experiment{'' if self.name is None else ' ' + self.name}: {outputs} from {source}>"


@contextmanager
def _errors_name(experiment: str | None) -> Iterator[None]:
    """Errors begin with the name of the experiment, if it has one."""
    try:
        yield
    except (TypeError, ValueError) as e:
        if experiment is not None:
            e.args = (f"{experiment}: {e}",)
        raise


@dataclass(frozen=True)
class Settings:
    """How simulations are made, as the native code reads it."""

    kind: str
    max_time: float | None
    relative_tolerance: float | None
    solver: str
    step_size: float | None
    max_step: float | None
    input_derivatives: bool
    chattering: str
    sharing: str


def collected(data: Any, outputs: Any, parameters: Any, inputs: Any, **own: Any) -> tuple[list[Experiment], Any]:
    """The experiments and the parameters of a calibration, from its arguments: one recording with what belongs to it, or
    experiments, which the parameters follow."""
    experiments = _listed(data)
    if experiments is not None:
        if parameters is None:
            outputs, parameters = None, outputs
        given = {"outputs": outputs, "inputs": inputs, **own}
        if misplaced := [name for name, value in given.items() if value is not None]:
            raise TypeError(f"{', '.join(misplaced)}: with experiments this is an argument of Experiment, given for each")
    elif outputs is None:
        raise TypeError("Calibration() needs the argument 'outputs'")
    else:
        experiments = [Experiment(data, outputs, inputs, **own)]
    if parameters is None:
        raise TypeError("Calibration() needs the argument 'parameters'")
    return experiments, parameters


def _listed(data: Any) -> list[Experiment] | None:
    """The experiments, where `data` is one or several; None: it is a recording."""
    if isinstance(data, Experiment):
        return [data]
    if isinstance(data, Mapping):
        if any(isinstance(value, Experiment) for value in data.values()):
            raise TypeError("experiments must be a list, not a dict; Experiment(..., name=...) names each")
        return None
    if isinstance(data, (str, bytes)) or not isinstance(data, Iterable) or hasattr(data, "dtype") or hasattr(data, "columns"):
        return None
    experiments = list(data)
    if not experiments:
        raise BadCalibrationError("there are no experiments: the list is empty")
    for index, one in enumerate(experiments):
        if not isinstance(one, Experiment):
            raise TypeError(f"entry {index} of the list is a {type(one).__name__}, not an Experiment")
    return experiments


def pairs_of_columns(name: str, value: Mapping[str, str] | Sequence[str] | str | None) -> list[tuple[str, str]]:
    """Pairs of variable and column; of a list, columns that are named like the variables."""
    if value is None:
        return []
    if isinstance(value, str):
        value = [value]
    if isinstance(value, Mapping):
        return [(_options.choice(name, variable), _options.choice(name, column)) for variable, column in value.items()]
    if isinstance(value, Iterable) and not isinstance(value, (set, frozenset)):
        return [(_options.choice(name, variable), variable) for variable in value]
    raise TypeError(f"{name} must be a dict of variable and column, or a list of variables, not {_options.show(value)}")


def weighted(
    outputs: list[tuple[str, str]], weights: Mapping[str, float] | Sequence[float] | None
) -> list[tuple[str, str, float]]:
    """Pairs of output and column with their weights: 1 where there is none."""
    if weights is None:
        return [(variable, column, 1.0) for variable, column in outputs]
    if isinstance(weights, Mapping):
        known = [variable for variable, _ in outputs]
        for name in weights:
            if name not in known:
                raise BadCalibrationError(f"weights: there is no output '{name}'; there are: {', '.join(known)}")
        return [(v, c, _options.number("weights", weights.get(v, 1.0))) for v, c in outputs]
    if isinstance(weights, str) or not isinstance(weights, Iterable):
        raise TypeError(f"weights must be a dict of outputs and numbers, or a number per output, not {_options.show(weights)}")
    numbers = [_options.number("weights", w) for w in weights]
    if len(numbers) != len(outputs):
        raise BadCalibrationError(f"{len(numbers)} weights for {len(outputs)} outputs")
    return [(variable, column, weight) for (variable, column), weight in zip(outputs, numbers)]


def path_of(model: Any) -> str:
    """The path of a model that is given as such, or opened."""
    if isinstance(model, (str, os.PathLike)):
        return os.fspath(model)
    path = getattr(model, "path", None)
    if isinstance(path, (str, os.PathLike)):
        return os.fspath(path)
    raise TypeError(f"model must be the path of an FMU or an FMUModel, not {_options.show(model)}")
