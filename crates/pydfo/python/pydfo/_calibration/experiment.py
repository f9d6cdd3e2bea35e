"""`Experiment`: a recording and its settings for the model."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, SupportsFloat

import numpy as np
import numpy.typing as npt

from .. import _core
from .._args import text as _text
from .._args import values as _values
from .._args.keywords import explained
from .._errors import BadCalibrationError
from . import data as _data
from . import data_files as _data_files
from .parameter import Parameter

Names = Mapping[str, str] | Sequence[str] | str


@dataclass(frozen=True)
class Hold:
    """A column that drives an input, with its values held between the rows (zero-order hold).

    Use it for actuators that switch. Without it, the rows of a continuous input are connected by straight lines.

    Parameters
    ----------
    column : str
        Name of the column.

    Examples
    --------
    >>> Hold("power")
    Hold(column='power')
    """

    column: str

    def __post_init__(self) -> None:
        _values.choice("column", self.column)


#: Source of an input: a column (in a tuple if it is held), a number or a function of time.
Source = str | tuple[str] | float | Callable[[float], float]
Inputs = Mapping[str, str | Hold | float | Callable[[float], float]] | Sequence[str] | str
#: Factor of residuals: a number, a column, numbers per row (the bytes of float64 values), the name of a scale, or
#: "sigma" and a standard deviation.
Weight = float | str | bytes | tuple[str] | tuple[str, Any]
Weights = Mapping[str, Any] | Sequence[Any] | str
#: Known standard deviation of the noise, for all outputs or for each.
Sigmas = Mapping[str, Any] | SupportsFloat | str | npt.ArrayLike


@dataclass(frozen=True, init=False, repr=False)
class Experiment:
    """A recording of the machine and its settings for the model, for a `Calibration` with several recordings.

    Parameters
    ----------
    data : path, dict of arrays, DataFrame, Series, xarray or structured array
        The recording, as in `Calibration`.
    outputs : dict of str to str, or list of str
        Maps outputs of the model to the columns that measured them.
    inputs : dict, or list of str, optional
        Source of each input and tunable parameter of the model: a column, a column whose values are held between the
        rows (`Hold`), a number (constant), or a function of time.
        A function must be smooth and deterministic. To pickle the calibration, the function must be importable.
    window : (float, float), optional
        Interval of time, like all times in the time unit of the model (see `Calibration`). Only measurements in this interval count. Equivalent to a single entry of `windows`.
    weights : dict, or sequence, optional
        Factor of the residuals of each output: a number, or one number per measurement, as a column or as an array as
        long as the recording. An array of Booleans is a mask. Measurements with weight 0 do not count. Weights refer
        to the unit of the column and are converted with it. A weight of 1, and weights of only 0 and 1, state no
        noise and are not converted. If a measurement is missing, its weight may be missing (NaN). "range", "mean"
        or "sd", for all outputs or for one, is the inverse of the range, mean or standard deviation of the
        measurements in the whole recording; it takes precedence over a column with this name.
    sigma : number, column or dict, optional
        Known standard deviation of the noise of each output, which replaces its weight: a number, the name of a column
        or one value per measurement. A dict specifies it per output; otherwise it applies to all outputs. The weight is
        1/sigma, and standard errors, intervals, profiles and bands are absolute, as with ``absolute_sigma=True`` of
        SciPy's ``curve_fit``. Sigma is in the unit of the column. An infinite sigma excludes a measurement.
        If a measurement is missing, its sigma may be missing (NaN).
        A text such as ``"0.1 + 0.05*abs(y)"`` is an error model, where y is the simulated output: ``a + b*abs(y)`` or
        ``b*abs(y)``. The fit is repeated with the standard deviations at its simulated values until they settle. Names
        instead of numbers, as in ``"a + b*abs(y)"``, are estimated from the residuals by maximum likelihood, and
        ``fit.noise.coefficients`` contains the values. ``"log"`` compares logarithms, for log-normal noise of unknown
        size: the residual is ``log(simulated) - log(measured)``. Values must be positive.
    start_values : dict or path, optional
        Values of other parameters and start values of variables in this experiment, by name. For a local parameter,
        the start of its search in this experiment. Alternatively, the path of an SSP parameter file (``.ssv``). Its
        values for fitted or driven variables are ignored.
    start_time : float, optional
        Start time of the simulation.
    time : str, optional
        Name of the time column if it is not ``time``.
    sheet : str, optional
        Sheet of a workbook, or table of an HDF5 file. Without it, the first sheet is read, with a warning if there
        are others.
    mask : array of bool or str, optional
        Selects the rows whose measurements count. Pass one entry per row, or the name of a column, which selects a
        row if its value is neither 0 nor missing. Inputs count in all rows.
    resample : float, optional
        Interval of time. Times and columns are replaced by their means over each interval, excluding masked rows.
        Weights other than 1 apply to the rows. The mean of a measured column is then weighted with their squares, and
        the weight of the mean is the square root of the sum of these squares. Columns of Boolean and integer inputs
        are not averaged. They keep the times at which they change.
    initial_states : dict, optional
        Values of states of the model at the start: a number, "measured" or a `Parameter`. "measured" uses the column
        compared with the state, at the start of the simulation, without offset and delay. It is an error if there is
        no such column. "measured:T" uses the column compared with the output ``T``. With it, the name may also be a
        parameter of the model that is the start value of this output, such as ``{"T_start": "measured:T"}``. A
        `Parameter` with start and bounds belongs to this experiment alone. Its name is ignored; it appears as
        ``x[run1]``. In model exchange, a state computed by the initialization (``initial="approx"``, ``"calculated"``)
        is set after it. In a co-simulation, such a state raises an error if it is fitted or measured, and a warning if
        it is a number.

        "steady" brings the model to rest at the first values of its inputs before the recording, for each set of trial
        parameters; ``{"level": Parameter(...), "*": "steady"}`` does so while ``level`` keeps its value. It requires
        model exchange. The time of the model stays at the start time. The states are at rest if none changes by more
        than the relative tolerance times the sum of its magnitude and its nominal value in a window as long as the
        simulation and as long as the approach before it. If they are not at rest within `steady_limit`, the evaluation
        fails, with the state that moves, its derivative and the limit.
    steady_limit : float, optional
        Longest approach to steady state, in units of time; default: 1000 times the simulated time span. An approach
        also ends after 10000 steps.
    windows : sequence of (float, float), optional
        Intervals of time. Only measurements in one of these intervals count.
    warm_up : float, optional
        Duration from the start of the simulation that is not compared, so that the effect of the initial states
        decays. With windows and without `start_time`, the simulation starts this long before the first measurement in
        the windows. Otherwise the start time does not change, and measurements before the end of the warm-up do not
        count.
    delays : dict of str to float, optional
        Delay of a compared output or of an input. ``y(t - delay)`` is compared with the measurement at t, with
        the value at the start for earlier times. The model is driven by ``u(t - delay)``. A fitted delay is a
        ``Parameter("tau", 0.05, 0, 1, delay_of="y")``.
    hold_inputs : bool
        If True, hold the first and last values of inputs if the simulation extends beyond their recording by more
        than one sampling interval. If False, this is an error.
    name : str, optional
        Name of the experiment, also used in the names of local parameters (``T0[cold]``); default: "run1", "run2" and
        so on. It must not be empty or contain brackets or line breaks.

    Raises
    ------
    ValueError, TypeError
        As in `Calibration`. A CSV file is read by `Calibration`, which raises its errors.

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
    is_steady: bool
    steady_limit: float | None
    windows: list[tuple[float, float]]
    warm_up: float | None
    start_time: float | None
    final_time: float | None
    weight: float | None
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
        sigma: Sigmas | None = None,
        start_values: Mapping[str, Any] | str | os.PathLike[str] | None = None,
        start_time: SupportsFloat | None = None,
        time: str | None = None,
        name: str | None = None,
        initial_states: Mapping[str, SupportsFloat | str | Parameter] | str | None = None,
        steady_limit: SupportsFloat | None = None,
        windows: Sequence[tuple[float, float]] | None = None,
        warm_up: SupportsFloat | None = None,
        delays: Mapping[str, SupportsFloat] | None = None,
        hold_inputs: bool = False,
        mask: Any = None,
        resample: SupportsFloat | None = None,
        sheet: str | None = None,
    ) -> None:
        put = object.__setattr__
        put(self, "name", None if name is None else _values.choice("name", name))
        with errors_name(self.name):
            pairs = pairs_of_columns("outputs", outputs)
            driven = sources(inputs)
            named = None if time is None else _values.choice("time", time)
            chosen = None if sheet is None else _values.choice("sheet", sheet)
            weighed = with_sigma(weighted(pairs, weights), sigma)
            columns = [column for _, column in pairs]
            columns += [source if isinstance(source, str) else source[0] for _, source in driven if isinstance(source, (str, tuple))]
            columns += [column for _, _, weight in weighed if (column := _column_of(weight)) is not None]
            rows, by = _data.mask(mask)
            try:
                table = _data.read_recording(data, columns + ([] if by is None else [by]), named, chosen)
            except BadCalibrationError as e:
                turned = [pair for pair in pairs if f"column '{pair[1]}' not" in str(e) and f"'{pair[0]}'" in str(e).partition("available")[2]]
                unknown = [name for _, _, weight in weighed if isinstance(weight, tuple) and (name := _column_of(weight)) is not None]
                if coefficients := [name for name in unknown if name.isidentifier() and f"column '{name}' not" in str(e)]:
                    name = coefficients[0]
                    raise BadCalibrationError(
                        f"{e}. sigma '{name}' is the name of a column; write '{name} + 0*abs(y)' for a standard deviation that the fit estimates"
                    ) from None
                if not turned:
                    raise
                variable, column = turned[0]
                raise BadCalibrationError(
                    f"{e}. outputs must map variables of the model to columns, perhaps {{{column!r}: {variable!r}}}"
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
            given_states, is_steady = states(initial_states)
            limit = _values.optional_number("steady_limit", steady_limit)
            if limit is not None and not is_steady:
                raise BadCalibrationError('steady_limit requires initial_states = "steady"')
            put(self, "initial_states", given_states)
            put(self, "is_steady", is_steady)
            put(self, "steady_limit", limit)
            put(self, "windows", intervals(window, windows))
            put(self, "warm_up", _values.optional_number("warm_up", warm_up))
            put(self, "start_time", _values.optional_number("start_time", start_time))
            put(self, "final_time", None)
            put(self, "weight", None)
            given = _values.pairs("delays", delays)
            put(self, "delays", [(variable, _values.number("delays", delay)) for variable, delay in given])  # type: ignore[arg-type]
            put(self, "hold_inputs", _values.flag("hold_inputs", hold_inputs))

    @classmethod
    def of_sheets(cls, data: str | os.PathLike[str], outputs: Names, inputs: Inputs | None = None, **settings: Any) -> list[Experiment]:
        """Returns one experiment per sheet of a workbook, named after the sheet. Empty sheets are skipped.

        Parameters
        ----------
        data : path
            The workbook (.xlsx).
        outputs, inputs, **settings
            As in `Experiment`, the same for all sheets.
        """
        names = _data_files.sheets(os.fspath(data))
        return [cls(data, outputs, inputs, **{"name": name, **settings, "sheet": name}) for name in names]

    def __repr__(self) -> str:
        source = self.path if self.table is None else f"{len(self.table)} rows"
        outputs = ", ".join(variable for variable, _, _ in self.outputs)
        return _text.line(f"<Experiment{'' if self.name is None else ' ' + self.name}: {outputs} from {source}>")


@contextmanager
def errors_name(experiment: str | None) -> Iterator[None]:
    """Prepends the name of the experiment to errors, if it has a name."""
    try:
        yield
    except (TypeError, ValueError) as e:
        if experiment is not None:
            e.args = (f"{_text.line(experiment)}: {e}",)
        raise


def collected(data: Any, outputs: Any, parameters: Any, inputs: Any, **settings: Any) -> tuple[list[Experiment], Any]:
    """Returns the experiments and the parameters of a calibration from its arguments.

    The arguments are one recording with its settings, or experiments followed by the parameters."""
    experiments = listed(data)
    if experiments is not None:
        if parameters is None:
            outputs, parameters = None, outputs
        given = {"outputs": outputs, "inputs": inputs, **settings}
        if misplaced := [name for name, value in given.items() if value is not None]:
            raise TypeError(f"{', '.join(misplaced)}: with experiments, specify this argument in each Experiment")
    elif outputs is None:
        raise TypeError("Calibration() requires the argument 'outputs'")
    else:
        experiments = [Experiment(data, outputs, inputs, **{name: value for name, value in settings.items() if value is not None})]
    if parameters is None:
        raise TypeError("Calibration() requires the argument 'parameters'")
    return experiments, parameters


def listed(data: Any) -> list[Experiment] | None:
    """Returns the experiments if `data` is one or several; None if it is a recording."""
    if isinstance(data, Experiment):
        return [data]
    if isinstance(data, Mapping):
        if any(isinstance(value, Experiment) for value in data.values()):
            raise TypeError("experiments must be a list, not a dict; set names with Experiment(..., name=...)")
        return None
    if isinstance(data, (str, bytes)) or not isinstance(data, Iterable) or hasattr(data, "dtype") or hasattr(data, "columns"):
        return None
    experiments = list(data)
    if not experiments:
        raise BadCalibrationError("the list of experiments is empty")
    for index, one in enumerate(experiments):
        if not isinstance(one, Experiment):
            raise TypeError(f"entry {index} of the list is a {type(one).__name__}, not an Experiment")
    return experiments


def pairs_of_columns(name: str, value: Mapping[str, str] | Sequence[str] | str | None) -> list[tuple[str, str]]:
    """Returns pairs of variable and column. For a list, both have the same name."""
    if value is None:
        return []
    if isinstance(value, str):
        value = [value]
    if isinstance(value, Mapping):
        return [(_values.choice(name, variable), _values.choice(name, column)) for variable, column in value.items()]
    if isinstance(value, Iterable) and not isinstance(value, (set, frozenset)):
        return [(_values.choice(name, variable), variable) for variable in value]
    raise TypeError(f"{name} must be a dict of variables and columns, or a list of variables, not {_text.show(value)}")


def sources(given: Inputs | None) -> list[tuple[str, Source]]:
    """Returns inputs with their sources: a column (in a tuple if it is held), a number or a function of time."""
    if not isinstance(given, Mapping):
        return list(pairs_of_columns("inputs", given))
    driven: list[tuple[str, Source]] = []
    for variable, value in _values.pairs("inputs", given):
        source: Any = value
        if isinstance(source, Hold):
            source = (source.column,)
        elif not isinstance(source, str) and not callable(source):
            if np.ndim(source) > 0:
                raise TypeError(
                    f"inputs: '{_text.line(variable)}' must be driven by a column, a number or a function of time, not by an array. Add the array to the "
                    "columns of the data"
                )
            source = _values.number("inputs", source)
        driven.append((variable, source))
    return driven


def states(given: Mapping[str, SupportsFloat | str | Parameter] | str | None) -> tuple[list[tuple[str, float | str | Parameter]], bool]:
    """Returns initial states with their numbers, words or parameters, and True if the others start from steady state."""
    if isinstance(given, str):
        if given.lower() != "steady":
            raise BadCalibrationError(f"initial_states must be a dict of states, or 'steady', not {_text.show(given)}")
        return [], True

    def of(state: object) -> float | str | Parameter:
        return state if isinstance(state, (str, Parameter)) else _values.number("initial_states", state)  # type: ignore[arg-type]

    pairs = [(name, of(state)) for name, state in _values.pairs("initial_states", given)]
    others = [pair for pair in pairs if pair[0] != "*" or not isinstance(pair[1], str) or pair[1].lower() != "steady"]
    return others, len(others) < len(pairs)


def intervals(
    window: tuple[float, float] | None, windows: Sequence[tuple[float, float]] | None
) -> list[tuple[float, float]]:
    """Returns the list of windows from either argument."""
    if window is not None and windows is not None:
        raise ValueError("specify either window or windows, not both")
    if windows is not None and (isinstance(windows, (str, Mapping)) or not isinstance(windows, Iterable)):
        raise TypeError(f"windows must be a list of pairs of times, not {_text.show(windows)}")
    listed = [window] if window is not None else list(windows or [])
    if windows is not None and not listed:
        raise ValueError("windows is empty; omit it to use all measurements")
    for pair in listed:
        if isinstance(pair, str) or np.shape(pair) != (2,):
            name = "window" if windows is None else "each of windows"
            raise ValueError(f"{name} must be two times, not {_text.show(pair)}")
    return [(_values.number("window", start), _values.number("window", end)) for start, end in listed]


def weighted(outputs: list[tuple[str, str]], weights: Weights | None) -> list[tuple[str, str, Weight]]:
    """Returns outputs and columns with their weights; the default weight is 1."""
    if weights is None:
        return [(variable, column, 1.0) for variable, column in outputs]
    if isinstance(weights, Mapping):
        available = [variable for variable, _ in outputs]
        for name in weights:
            if name not in available:
                raise BadCalibrationError(f"weights: unknown output '{name}'; expected one of: {', '.join(available)}")
        return [(v, c, _weight(v, weights.get(v, 1.0))) for v, c in outputs]
    if isinstance(weights, str):
        return [(variable, column, (weights,)) for variable, column in outputs]
    if not isinstance(weights, Iterable):
        raise TypeError(f"weights must be a dict of outputs and numbers, or a number per output, not {_text.show(weights)}")
    listed = list(weights)
    if len(listed) != len(outputs):
        per_row = ". For one weight per measurement, use a dict: weights={output: array}"
        raise BadCalibrationError(f"weights: expected {len(outputs)} values, one per output; got {len(listed)}{per_row}")
    return [(variable, column, _weight(variable, weight)) for (variable, column), weight in zip(outputs, listed)]


def with_sigma(
    weighed: list[tuple[str, str, Weight]], sigma: Sigmas | None
) -> list[tuple[str, str, Weight]]:
    """Replaces the weights of outputs whose noise is known."""
    if sigma is None:
        return weighed
    available = [variable for variable, _, _ in weighed]
    given = dict(sigma) if isinstance(sigma, Mapping) else dict.fromkeys(available, sigma)
    for name in given:
        if name not in available:
            raise BadCalibrationError(f"sigma: unknown output '{name}'; expected one of: {', '.join(available)}")
    for variable, _, weight in weighed:
        if variable in given and weight != 1.0:
            raise BadCalibrationError(f"output '{variable}' has a weight and a sigma. Specify one of them")
    return [
        (v, c, ("sigma", _weight(v, given[v], "sigma")) if v in given else weight) for v, c, weight in weighed
    ]


def _column_of(weight: Weight) -> str | None:
    """Returns the column of a weight or of a standard deviation, if any."""
    if isinstance(weight, tuple):
        value = weight[1] if len(weight) == 2 else None
        return value if isinstance(value, str) and not _core.is_sigma_text(value) else None
    return weight if isinstance(weight, str) and not _core.is_output_scale(weight) else None


def _weight(variable: str, weight: Any, name: str = "weights") -> Weight:
    """Returns a number, the name of a column, or numbers for all rows."""
    if isinstance(weight, str):
        return weight
    if np.ndim(weight) == 0:
        return _values.number(name, weight)
    if np.ndim(weight) != 1:
        raise BadCalibrationError(f"{name} of '{variable}' must be one-dimensional, not of shape {np.shape(weight)}")
    return np.asarray(weight, dtype=np.float64).tobytes()


def path_of(model: Any) -> str:
    """Returns the path of a model, given as a path or as an opened model."""
    if isinstance(model, (str, os.PathLike)):
        return os.fspath(model)
    path = getattr(model, "path", None)
    if isinstance(path, (str, os.PathLike)):
        return os.fspath(path)
    raise TypeError(f"model must be the path of an FMU or an FMUModel, not {_text.show(model)}")
