"""A recording and how the model is to reproduce it: `Experiment`."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, SupportsFloat

import numpy as np

from .. import _core
from .._args import text as _text
from .._args import values as _values
from .._args.keywords import explained
from .._errors import BadCalibrationError
from . import data as _data
from .parameter import Parameter

Names = Mapping[str, str] | Sequence[str] | str
#: What drives an input: a column, a number, a function of time.
Source = str | float | Callable[[float], float]
Inputs = Mapping[str, Source] | Sequence[str] | str
#: What residuals are multiplied with: a number, a column, numbers per row (their bytes, as floats), the name of a scale.
Weight = float | str | bytes | tuple[str]
Weights = Mapping[str, Any] | Sequence[Any] | str


@dataclass(frozen=True, init=False, repr=False)
class Experiment:
    """A recording of the machine, and how the model is to reproduce it: for a `Calibration` with several of them.

    Parameters
    ----------
    data : path, dict of arrays, DataFrame, Series, xarray or structured array
        The recording, as `Calibration` takes it.
    outputs : dict of str to str, or list of str
        Which output of the model was measured by which column.
    inputs : dict, or list of str, optional
        What drives each input and tunable parameter of the model: a column, a number (constant), or a function of time. A function is smooth, always
        gives the same, and can be imported where the calibration is to be pickled.
    window : (float, float), optional
        Only measurements at times in this interval count, in s: one of `windows`.
    weights : dict, or sequence, optional
        Per output, what its residuals are multiplied with: a number, or one number per measurement: a column, or an array as long as
        the recording (of Booleans: a mask). Measurements with the weight 0 do not count. Weights are in the unit of the column and are
        converted with it; a weight of 1, and weights of only 0 and 1, state no noise and stay. "range", "mean" or "sd" weighs each output by
        the inverse of the range, mean or standard deviation of what was measured in the whole recording.
    start_values : dict or path, optional
        Values of other parameters and start values of variables in this experiment, by name; of a local parameter, where
        its search starts here. Or the path of an SSP parameter file (``.ssv``), of which those that are fitted or driven do not count.
    start_time : float, optional
        Where the simulation starts, in s.
    time : str, optional
        Name of the column of times, where it is not ``time``.
    mask : array of bool or str, optional
        Rows whose measurements count, one entry per row, or the column that says so (neither 0 nor missing). Inputs count in all rows.
    resample : float, optional
        Interval in s over which the times and all columns are replaced by their means (of what the mask leaves). Weights other than 1 are
        those of the rows: a measured column becomes the mean with their squares as weights, and the mean counts with the root of the
        sum of these squares. Columns of Boolean and integer inputs are not averaged; they keep the times where they change.
    initial_states : dict, optional
        What states of the model are at the start: a number, "measured" (the recording of the column that is compared with the
        state, at the start of the simulation, without offset and delay; an error where there is none), or a `Parameter` of this experiment alone with start and bounds, whose name plays no part: it
        is called ``x[run1]``. In model exchange a state that the initialization computes (``initial="approx"``, ``"calculated"``) is
        set after it. In a co-simulation such a state is an error if it is fitted or measured, and a warning if it is a number.
    windows : sequence of (float, float), optional
        Only measurements at times in one of these intervals count, in s.
    warm_up : float, optional
        For so many seconds from its start the simulation is not compared, so that it forgets its initial states. With windows and
        without `start_time` it starts so much before the first measurement in them; else where it does without warm-up, and measurements
        before the end of the warm-up do not count.
    delays : dict of str to float, optional
        By how many seconds an output that is compared, or an input, is late: ``y(t - delay)`` is compared with what was measured at t (before
        the start: the value at the start), and the model is driven by ``u(t - delay)``. A delay that is fitted is a
        ``Parameter("tau", 0.05, 0, 1, delay_of="y")``.
    hold_inputs : bool
        Hold the first and last values of inputs where the simulation goes beyond their recording by more than one of its
        sampling intervals; else that is an error.
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
    table: _core.Table | None
    time: str | None
    outputs: list[tuple[str, str, Weight]]
    inputs: list[tuple[str, Source]]
    start_values: list[tuple[str, Any]]
    parameter_set: str | None
    initial_states: list[tuple[str, float | str | Parameter]]
    windows: list[tuple[float, float]]
    warm_up: float | None
    start_time: float | None
    mask: list[bool] | None
    mask_column: str | None
    resample: float | None
    delays: list[tuple[str, float]]
    hold_inputs: bool

    @explained
    def __init__(
        self,
        data: Any,
        outputs: Names,
        inputs: Inputs | None = None,
        *,
        window: tuple[float, float] | None = None,
        weights: Weights | None = None,
        start_values: Mapping[str, Any] | str | os.PathLike[str] | None = None,
        start_time: SupportsFloat | None = None,
        time: str | None = None,
        name: str | None = None,
        initial_states: Mapping[str, SupportsFloat | str | Parameter] | None = None,
        windows: Sequence[tuple[float, float]] | None = None,
        warm_up: SupportsFloat | None = None,
        delays: Mapping[str, SupportsFloat] | None = None,
        hold_inputs: bool = False,
        mask: Any = None,
        resample: SupportsFloat | None = None,
    ) -> None:
        put = object.__setattr__
        put(self, "name", None if name is None else _values.choice("name", name))
        with _errors_name(self.name):
            pairs = pairs_of_columns("outputs", outputs)
            driven = sources(inputs)
            named = None if time is None else _values.choice("time", time)
            weighed = weighted(pairs, weights)
            columns = [column for _, column in pairs]
            columns += [source for _, source in driven if isinstance(source, str)]
            columns += [weight for _, _, weight in weighed if isinstance(weight, str)]
            rows, by = _data.mask(mask)
            try:
                table = _data.read_recording(data, columns + ([] if by is None else [by]), named)
            except BadCalibrationError as e:
                turned = [pair for pair in pairs if f"no column '{pair[1]}'" in str(e) and f"'{pair[0]}'" in str(e).partition("there are")[2]]
                if not turned:
                    raise
                variable, column = turned[0]
                raise BadCalibrationError(
                    f"{e}. Are outputs the wrong way round? They map variables of the model to columns: {{{column!r}: {variable!r}}}"
                ) from None
            put(self, "mask", rows)
            put(self, "mask_column", by)
            put(self, "resample", _values.optional_number("resample", resample))
            put(self, "path", table.path)
            put(self, "table", table.table)
            put(self, "time", table.time)
            put(self, "outputs", weighed)
            put(self, "inputs", driven)
            values, file = _values.values_or_file("start_values", start_values)
            put(self, "start_values", values)
            put(self, "parameter_set", file)
            put(self, "initial_states", states(initial_states))
            put(self, "windows", intervals(window, windows))
            put(self, "warm_up", _values.optional_number("warm_up", warm_up))
            put(self, "start_time", _values.optional_number("start_time", start_time))
            given = _values.pairs("delays", delays)
            put(self, "delays", [(variable, _values.number("delays", delay)) for variable, delay in given])  # type: ignore[arg-type]
            put(self, "hold_inputs", _values.flag("hold_inputs", hold_inputs))

    def __repr__(self) -> str:
        source = self.path if self.table is None else f"{len(self.table)} rows"
        outputs = ", ".join(variable for variable, _, _ in self.outputs)
        return _text.line(f"<Experiment{'' if self.name is None else ' ' + self.name}: {outputs} from {source}>")


@contextmanager
def _errors_name(experiment: str | None) -> Iterator[None]:
    """Errors begin with the name of the experiment, if it has one."""
    try:
        yield
    except (TypeError, ValueError) as e:
        if experiment is not None:
            e.args = (f"{_text.line(experiment)}: {e}",)
        raise


def collected(data: Any, outputs: Any, parameters: Any, inputs: Any, **own: Any) -> tuple[list[Experiment], Any]:
    """The experiments and the parameters of a calibration, from its arguments: one recording with what belongs to it, or
    experiments, which the parameters follow."""
    experiments = listed(data)
    if experiments is not None:
        if parameters is None:
            outputs, parameters = None, outputs
        given = {"outputs": outputs, "inputs": inputs, **own}
        if misplaced := [name for name, value in given.items() if value is not None]:
            raise TypeError(f"{', '.join(misplaced)}: with experiments this is an argument of Experiment, given for each")
    elif outputs is None:
        raise TypeError("Calibration() needs the argument 'outputs'")
    else:
        experiments = [Experiment(data, outputs, inputs, **{name: value for name, value in own.items() if value is not None})]
    if parameters is None:
        raise TypeError("Calibration() needs the argument 'parameters'")
    return experiments, parameters


def listed(data: Any) -> list[Experiment] | None:
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
        return [(_values.choice(name, variable), _values.choice(name, column)) for variable, column in value.items()]
    if isinstance(value, Iterable) and not isinstance(value, (set, frozenset)):
        return [(_values.choice(name, variable), variable) for variable in value]
    raise TypeError(f"{name} must be a dict of variable and column, or a list of variables, not {_text.show(value)}")


def sources(given: Inputs | None) -> list[tuple[str, Source]]:
    """Inputs with what drives them: a column, a number, a function of time."""
    if not isinstance(given, Mapping):
        return list(pairs_of_columns("inputs", given))
    driven: list[tuple[str, Source]] = []
    for variable, value in _values.pairs("inputs", given):
        source: Any = value
        if not isinstance(source, str) and not callable(source):
            if np.ndim(source) > 0:
                raise TypeError(
                    f"inputs: '{_text.line(variable)}' must be driven by a column, a number or a function of time, not by an array: put it among the "
                    "columns of the data"
                )
            source = _values.number("inputs", source)
        driven.append((variable, source))
    return driven


def states(given: Mapping[str, SupportsFloat | str | Parameter] | None) -> list[tuple[str, float | str | Parameter]]:
    """Initial states with their numbers, words or parameters."""

    def of(state: object) -> float | str | Parameter:
        return state if isinstance(state, (str, Parameter)) else _values.number("initial_states", state)  # type: ignore[arg-type]

    return [(name, of(state)) for name, state in _values.pairs("initial_states", given)]


def intervals(
    window: tuple[float, float] | None, windows: Sequence[tuple[float, float]] | None
) -> list[tuple[float, float]]:
    """The windows, one or several."""
    if window is not None and windows is not None:
        raise ValueError("window and windows are given: put the one among the others")
    if windows is not None and (isinstance(windows, (str, Mapping)) or not isinstance(windows, Iterable)):
        raise TypeError(f"windows must be a list of pairs of times, not {_text.show(windows)}")
    listed = [window] if window is not None else list(windows or [])
    if windows is not None and not listed:
        raise ValueError("windows is empty: leave it out, if all measurements count")
    for pair in listed:
        if isinstance(pair, str) or np.shape(pair) != (2,):
            name = "window" if windows is None else "each of windows"
            raise ValueError(f"{name} must be two times, not {_text.show(pair)}")
    return [(_values.number("window", start), _values.number("window", end)) for start, end in listed]


def weighted(outputs: list[tuple[str, str]], weights: Weights | None) -> list[tuple[str, str, Weight]]:
    """Pairs of output and column with their weights: 1 where there is none."""
    if weights is None:
        return [(variable, column, 1.0) for variable, column in outputs]
    if isinstance(weights, Mapping):
        known = [variable for variable, _ in outputs]
        for name in weights:
            if name not in known:
                raise BadCalibrationError(f"weights: there is no output '{name}'; there are: {', '.join(known)}")
        return [(v, c, _weight(v, weights.get(v, 1.0))) for v, c in outputs]
    if isinstance(weights, str):
        return [(variable, column, (weights,)) for variable, column in outputs]
    if not isinstance(weights, Iterable):
        raise TypeError(f"weights must be a dict of outputs and numbers, or a number per output, not {_text.show(weights)}")
    listed = list(weights)
    if len(listed) != len(outputs):
        per_row = "; for one weight per measurement give a dict: weights={output: array}"
        raise BadCalibrationError(f"{len(listed)} weights for {len(outputs)} outputs{per_row}")
    return [(variable, column, _weight(variable, weight)) for (variable, column), weight in zip(outputs, listed)]


def _weight(variable: str, weight: Any) -> Weight:
    """A number, the name of a column, or numbers for all rows."""
    if isinstance(weight, str):
        return weight
    if np.ndim(weight) == 0:
        return _values.number("weights", weight)
    if np.ndim(weight) != 1:
        raise BadCalibrationError(f"weights of '{variable}' must be one-dimensional, not of shape {np.shape(weight)}")
    return np.asarray(weight, dtype=np.float64).tobytes()


def path_of(model: Any) -> str:
    """The path of a model that is given as such, or opened."""
    if isinstance(model, (str, os.PathLike)):
        return os.fspath(model)
    path = getattr(model, "path", None)
    if isinstance(path, (str, os.PathLike)):
        return os.fspath(path)
    raise TypeError(f"model must be the path of an FMU or an FMUModel, not {_text.show(model)}")
