"""Models for scripts: open, set, simulate and get."""

from __future__ import annotations

import logging as _logging
import operator
import warnings
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, NoReturn, SupportsFloat, SupportsIndex

import numpy as np
import numpy.typing as npt

from .. import _core
from .._args import options as _options
from .._args import text as _text
from .._args import values as _values
from .._args.keywords import also_called, explained
from . import inputs as _inputs
from .description import Description
from .files import OpenOptions, PathLike, size_limit
from .trajectory import SimulationResult

_log = _logging.getLogger("pydfo")

FloatArray = npt.NDArray[np.float64]

#: Marks a missing value, because None is a valid value.
_NOT_GIVEN: object = object()


class Request(NamedTuple):
    """The options of a simulation in the order in which the native code reads them; None means the default of
    the model."""

    start_time: float | None
    final_time: float | None
    times: FloatArray | None
    output_interval: float | None
    ncp: int | None
    start_values: list[tuple[str, Any]]
    clock_intervals: list[tuple[str, float | tuple[int, int]]]
    outputs: list[str] | None
    tables: list[_inputs.Table]
    functions: list[_inputs.Function]
    settings: dict[str, Any]
    max_time: float | None
    record_events: bool
    between_steps: str
    isolation: str | None
    parameter_set: str | None
    #: The FMU with units that its description does not declare.
    described: _core.Fmu | None
    sandbox: bool
    #: Names of the start values that are initial states.
    initial_states: list[str]


LOG_LEVELS = ("nothing", "fatal", "error", "warning", "info", "verbose", "debug", "all")
"""PyFMI's log levels, indexed by their numbers."""


def _log_level(level: int | str | None) -> int:
    """Returns the number of a log level."""
    if level is None:
        return len(LOG_LEVELS) - 1
    names = ", ".join(f"{number} ({name})" for number, name in enumerate(LOG_LEVELS))
    if isinstance(level, str):
        if level.lower() in LOG_LEVELS:
            return LOG_LEVELS.index(level.lower())
        raise ValueError(f"log_level must be one of {names}, not {level!r}")
    if isinstance(level, bool) or not hasattr(level, "__index__"):
        raise TypeError(f"log_level must be a number or a name, one of {names}, not {level!r}")
    number = operator.index(level)
    if not 0 <= number < len(LOG_LEVELS):
        raise ValueError(f"log_level must be one of {names}, not {level!r}")
    return number


def _log_request(logging: bool | str | Sequence[str]) -> tuple[bool, tuple[str, ...]]:
    """Returns True if the FMU should log, and the categories requested by name."""
    names = (logging,) if isinstance(logging, str) else tuple(logging) if isinstance(logging, (list, tuple)) else ()
    if names and all(isinstance(name, str) for name in names):
        return True, names
    try:
        return _values.flag("logging", logging), ()
    except TypeError:
        what = "True, False or a list of log categories (['logEvents'])"
        raise TypeError(f"logging must be {what}, not {_text.show(logging)}") from None


class FMUModel:
    """A model in an FMU (FMI 1.0, 2.0 or 3.0, model exchange or co-simulation).

    Opening reads the file. Opening an unchanged file again costs almost nothing. The FMU's code is loaded, or built
    from its sources, when it is first needed. As a context manager, the model is closed at the end.

    Values of `set` apply to all following simulations until `reset`. Each simulation starts from a fresh model with
    these values, so equal values give bit-for-bit identical results.

    The FMU runs in a separate process, which is reused from one call to the next. If the process ends, the next call
    starts another process with the same values set. A warning is logged the first time. The process
    repeats its first simulation after later ones. If the results differ, each simulation gets a new instance, and if
    that is not enough, a new process. ``description.quirks`` reports it (see `reuse`).

    Parameters
    ----------
    path : path
        An ``.fmu`` file or an unpacked folder.
    kind : {"auto", "ME", "CS"}
        Interface used to run the model. "ME" (model exchange) integrates its equations with a selectable method. "CS"
        (co-simulation) lets the model integrate itself from one communication point to the next. "auto" selects model
        exchange if it is available. Case is ignored.
    log_level : int or str, optional
        Lines of the FMU's log to keep and show. After each simulation, they are sent to the logger "pydfo" of
        Python's `logging` with the level INFO. The levels are PyFMI's: 0 "nothing", 1 "fatal", 2 "error" (both pass
        errors of any kind), 3 "warning", 4 "info", 5 "verbose", 6 "debug" and 7 "all". The last four keep all lines.
        By default, all lines are kept and none are shown. Every error message includes the last lines.
    logging : bool, str or list of str
        If True, the FMU is asked to log. FMUs also log important lines without being asked. A list restricts logging
        to these categories. ``description.log_categories`` contains their names. FMI 1.0 declares no categories, so
        any name is accepted.
    deepbind : bool
        If True, symbols of the FMU's library take precedence over symbols of the process (RTLD_DEEPBIND, Linux). Use
        it for libraries that would otherwise call a function of the host program with the name of their own function.
    lazy : bool
        If True, functions of the library are resolved at their first call (RTLD_LAZY). Use it for libraries that lack
        functions which are never called.
    max_description_bytes : int, optional
        Maximum size of ``modelDescription.xml``; default 64 MiB. Reading it requires at most eight times as much
        memory.
    max_elements : int, optional
        Maximum total number of elements of the array variables; default 2 million.

    Raises
    ------
    OSError
        The file cannot be read (FileNotFoundError if it does not exist).
    FmuError
        The archive or its ``modelDescription.xml`` is damaged or not safe to unpack. Also if the kind or version of
        the FMU cannot be simulated; `read_description` still describes it.
    ValueError
        `kind` or `log_level` is not one of the values above.

    Examples
    --------
    >>> from pydfo import FMUModel, example_fmu
    >>> model = FMUModel(example_fmu("dahlquist"))
    >>> model.set("k", 2.0)
    >>> res = model.simulate(final_time=1.0)
    >>> round(res.final("x"), 5)
    0.13534
    """

    @explained
    def __init__(
        self,
        path: PathLike,
        kind: str = "auto",
        log_level: int | str | None = None,
        *,
        logging: bool | str | Sequence[str] = False,
        deepbind: bool = False,
        lazy: bool = False,
        max_description_bytes: int | None = None,
        max_elements: int | None = None,
    ) -> None:
        if not isinstance(kind, str):
            raise TypeError(f"kind must be a string, not {kind!r}")
        has_logging, categories = _log_request(logging)
        self._opened = OpenOptions(
            log_level=_log_level(log_level),
            logging=has_logging,
            log_categories=categories,
            show_log=log_level is not None,
            deepbind=_values.flag("deepbind", deepbind),
            lazy=_values.flag("lazy", lazy),
            max_description_bytes=size_limit("max_description_bytes", max_description_bytes),
            max_elements=size_limit("max_elements", max_elements),
        )
        self._fmu = _core.Fmu(_values.path("path", path), self._opened)
        self._kind = self._fmu.check_runnable(kind)
        self._model = _core.Model(self._fmu, self._kind)

    def __setattr__(self, name: str, value: object) -> None:
        # An attribute with the name of a variable would have no effect on the model.
        if not name.startswith("_") and name in self.description.variables:
            raise AttributeError(f"variables of the model are not attributes; use set('{name}', {_text.show(value)})")
        super().__setattr__(name, value)

    def __reduce__(self) -> NoReturn:
        raise TypeError("an FMUModel cannot be pickled, because it contains a loaded library; open the FMU in each process")

    @property
    def path(self) -> Path:
        """Path of the file as given."""
        return self._fmu.path

    @property
    def kind(self) -> str:
        """Interface used to run the model: "ME" or "CS"."""
        return self._kind

    @property
    def reuse(self) -> str:
        """Method by which a worker process resets the model between two simulations.

        "reset" calls the function of the FMU, "reinstantiate" creates a new instance and "process" starts a new
        process. It starts with "reset". If a simulation differs from the equal simulation in a fresh process, it
        switches to the next method."""
        return self._fmu.reuse()

    @cached_property
    def description(self) -> Description:
        """Description of the model."""
        return Description(self._fmu)

    def get(self, name: str | Iterable[str]) -> Any:
        """Returns values of variables: final values after a simulation, and before it the values set or otherwise the
        initial values.

        A simulation interrupted or ended by an error does not count.

        Parameters
        ----------
        name : str or iterable of str
            Names of variables, or of elements of arrays (``name[2,1]``, counted from 1).

        Returns
        -------
        float, int, bool, str, bytes or ndarray, or a list of them
            One value for a name, a list for a list. Enumerations are int. Arrays keep their shape.

        Raises
        ------
        KeyError
            There is no such variable. The message suggests the nearest names.
        SimulationError
            Initial values were needed, and the model cannot be initialized.
        """
        if isinstance(name, str):
            return self._model.get([name])[0]
        return self._model.get(_values.names("name", name))

    def set(self, name: str | Iterable[str] | Mapping[str, object], value: object = _NOT_GIVEN) -> None:
        """Sets parameters, start values or constant values of inputs for all following simulations.

        Parameters
        ----------
        name : str, iterable of str, or dict
            Names of variables, or of elements of arrays (``name[2,1]``, counted from 1). Alternatively, a dict of
            names and values (``model.set(fit.parameters)``) without `value`.
        value : float, int, bool, str, bytes or array_like, or a sequence of them
            One value for a name, or one value per name for a list. Either all values are set or none. NumPy scalars
            and arrays of one element are also single values. Arrays may have their shape or be flat, with the last
            index varying fastest. Items of enumerations are int or their names.

        Raises
        ------
        KeyError
            There is no such variable. The message suggests the nearest names.
        TypeError
            The type of the value does not match the variable.
        ValueError
            The variable cannot be set (the message states the reason), the value is not finite, or the numbers of
            values and names differ.
        """
        self._model.set(*names_and_values(name, value))

    def reset(self) -> None:
        """Discards all values set and the last simulation."""
        self._model.reset()

    @also_called(stop_time="final_time", input="inputs", output="outputs", timeout="max_time")
    def simulate(
        self,
        start_time: SupportsFloat | None = None,
        final_time: SupportsFloat | None = None,
        *,
        inputs: object = None,
        outputs: str | Iterable[str] | None = None,
        times: npt.ArrayLike | None = None,
        output_interval: SupportsFloat | None = None,
        ncp: SupportsFloat | None = None,
        start_values: Mapping[str, object] | PathLike | None = None,
        initial_states: Mapping[str, SupportsFloat] | None = None,
        clock_intervals: Mapping[str, SupportsFloat | tuple[int, int]] | None = None,
        relative_tolerance: SupportsFloat | None = None,
        solver: str = "auto",
        step_size: SupportsFloat | None = None,
        max_step: SupportsFloat | None = None,
        interior_samples: SupportsIndex | None = None,
        max_time: SupportsFloat | None = None,
        record_events: bool = False,
        chattering: Literal["error", "warn", "slide"] = "error",
        input_derivatives: bool = True,
        between_steps: Literal["interpolate", "error"] = "interpolate",
        isolation: Literal["none", "process"] | None = None,
        sandbox: bool = False,
        units: Mapping[str, str] | None = None,
    ) -> SimulationResult:
        """Simulates a freshly reset model with all values of `set`.

        Times are in the time unit of the model (``description.time_unit``), usually s. The FMU runs in a separate process, which is kept for the next call. The interpreter lock is
        released during the simulation. Ctrl-C ends the simulation, and also its process if the FMU does not return
        within 0.1 s.

        In co-simulation (``kind="CS"``), rows are read at the end of a communication step, before the inputs of the
        next step are set. If inputs jump at this time, the row contains the values before the jump, including
        variables that follow the inputs directly. A recorded input is the input of the step that has ended. The first
        row is read after the initialization with the inputs at the start time. Inputs can jump at a row only if the
        model has an event mode (FMI 3.0). The row then contains the values after the jump, and a time listed twice
        gives both rows.

        Parameters
        ----------
        start_time : float, optional
            Start time; default: the start time of the model's default experiment, or 0.
        final_time : float, optional
            End time; default: the stop time of the default experiment, or the last of `times`. Also called
            `stop_time`.
        inputs : optional
            Sources of the inputs (also called `input`):

            - a dict of arrays with "time", a DataFrame with a column or an index "time", or a structured array; a
              number in a dict is a constant;
            - ``(names, matrix)`` with the times in the first column;
            - the path of a recording (CSV, ``.mat``, ``.parquet``, ``.xlsx``), read like the recording of an
              `Experiment`. Columns drive the inputs with their names, converted to the units of the model. Case is
              ignored if only one input matches. Rows with an unknown value are omitted;
            - a function of time, for a model with one input; a dict of functions; ``(names, function)``.

            Elements of an array are separate inputs: ``{"time": t, "u[1]": a, "u[2]": b}``.

            Tables are linear between rows for continuous inputs of type Real (or Float32), and held constant for all
            others. A time listed twice is a jump. Jumps are events. A step ends at every row with a change of slope, so
            no pulse is too short to be detected. A co-simulation therefore also communicates at each such row, even if
            this is more often than `step_size`; the log reports it once. If the model does not receive derivatives of
            its inputs, it communicates at every row with a change of an input. A model with a fixed communication step
            receives the inputs at its steps only.

            Tunable parameters are driven like inputs. They are held constant between rows. They change at events in
            model exchange and at communication points in co-simulation. Functions can drive continuous inputs of
            these types and should be smooth. For a triggered clock (FMI 3.0), rows with True are its ticks. A clock
            with an interval that can be deactivated omits its ticks while the value is False.
        outputs : str or iterable of str, optional
            Variables to record: names, elements of arrays (``name[2,1]``, counted from 1), patterns (``*`` matches
            any characters, ``?`` matches one), or "all". Also called `output`. Default: the outputs and the states.
            If a model declares neither (FMI 1.0), all variables that change.
        times : array_like, optional
            Times of the rows, ascending. A time listed twice gives the limit from the left and then the value after
            the events of that time.
        output_interval : float, optional
            Spacing of the rows. The last row is at the final time.
        ncp : int, optional
            Number of intervals between the rows; default 500. Pass at most one of `times`, `output_interval` and
            `ncp`.
        start_values : dict of str to value, or path, optional
            Values for this simulation only, which take precedence over the values of `set`; or the path of an SSP
            parameter file (``.ssv``). The start value of a state with ``initial="approx"`` is a guess. A warning is
            logged if the state starts with another value.
        initial_states : dict of str to float, optional
            Values of continuous states at the start of this simulation, including states with ``initial="approx"`` or
            ``"calculated"``. In model exchange, a state that the initialization changes is set after it
            (``setContinuousStates``), followed by an event iteration. Values computed from the state during the
            initialization, such as parameters, do not change. A co-simulation cannot set states after the
            initialization. It fails if a state starts with another value.
        clock_intervals : dict of str to float or tuple of int, optional
            Intervals in s between the ticks of input clocks with fixed or tunable intervals (FMI 3.0). A tuple is a
            fraction of counter and resolution.
        relative_tolerance : float, optional
            Relative tolerance; default: the tolerance of the default experiment, or 1e-6.
        solver : {"auto", "tsit5", "dop853", "radau5", "adams", "bdf", "rk4", "euler"}
            Integration method of model exchange. "rk4" and "euler" have a fixed step. "CVode" and SciPy's "RK45",
            "Radau" and "LSODA" map to "auto", "tsit5", "radau5" and "auto".
        step_size : float, optional
            In model exchange, the step of the fixed-step methods; default: a 500th of the span. In co-simulation, the
            communication step. It defaults to the larger of the step of the default experiment and the row spacing.
            If the model requires a fixed communication step, the default is the step of the default experiment,
            unless this gives more than 1e6 steps. A model that can step to any time also communicates at the rows of
            the result and of the inputs.
        max_step : float, optional
            Largest step of the adaptive methods.
        interior_samples : int, optional
            Number of points within each step at which event indicators are evaluated (model exchange). They detect an
            indicator that crosses zero and returns within a step. Default: one ("dop853", "radau5": three), and more
            if the values curve.
        max_time : float, optional
            Limit on the wall-clock time in s. It is checked between calls into the FMU. Also called `timeout`.
        record_events : bool
            If True, add rows for both sides of every event.
        chattering : {"error", "warn", "slide"}
            Action if time hardly advances during more than a hundred consecutive state events. "error": the
            simulation fails. "warn": it continues and a warning is logged. "slide": it continues in small steps along
            the event surface, which is the solution if the model pushes against the surface from both sides.
        input_derivatives : bool
            If True, co-simulations of FMI 1.0 and 2.0 that extrapolate continuous inputs (``canInterpolateInputs``)
            receive derivatives before each step. They are the slopes of the lines to the inputs at its end. If False,
            inputs are held constant over each step, as in most other tools.
        between_steps : {"interpolate", "error"}
            Rows between the steps of a co-simulation that cannot stop there. Such a model has a fixed communication
            step (``canHandleVariableCommunicationStepSize`` is not set) or advances in multiples of an internal step
            (``fixedInternalStepSize``, FMI 3.0). "interpolate": linear interpolation between the neighbouring steps,
            which the log reports once. Variables that are not continuous keep the value of the previous step.
            "error": such rows are an error. Fits interpolate.
        isolation : {"none", "process"}, optional
            "process" (the default): the FMU runs in a separate process. "none": it runs in this process. The results
            are bit-for-bit identical. In a separate process, a crash, a call of `exit`, or a call that does not
            return within `max_time` ends the process of the FMU and raises SimulationError. The next call starts
            another process. "none" is for programs that embed the module, and for benchmarks. With "none", a crash of
            the FMU ends Python, and Ctrl-C acts only between two calls into the FMU.
        sandbox : bool
            If True, confine the process of the FMU, as in `Calibration`. Raises an error if the system does not
            support it.
        units : dict of str to str, optional
            Units of variables for which the model declares no unit: ``{"room.T": "K"}``, as in `Calibration`. Columns
            of a recording of the inputs and values of an SSP parameter file are converted if they state a unit. The
            result reports these units.

        Returns
        -------
        SimulationResult
            The columns contain the values returned by the model, including NaN and infinities. Derivatives and states
            that are NaN or infinite raise an error.

        Warns
        -----
        UserWarning
            A setting has no effect: `step_size` with an adaptive solver, `max_step` with a fixed-step solver,
            `solver` and `max_step` in co-simulation. Also if recorded inputs end before the simulation or begin after
            its start, by more than one row spacing. They keep their first and last values.
        CalibrationWarning
            An input has no column in the recording given as `inputs` and no start value, or units are not converted.

        Raises
        ------
        KeyError
            Unknown name.
        ValueError, TypeError
            Invalid arguments or combinations of arguments.
        FmuError
            The FMU cannot be loaded or built.
        SimulationError
            The simulation failed or took longer than `max_time`. The error has ``status``, ``time`` and ``log``.
        Interrupted
            Ctrl-C was pressed; a KeyboardInterrupt.
        Exception
            Exceptions of an input function propagate unchanged.
        """
        values, parameter_set = _values.values_or_file("start_values", start_values)
        states: list[tuple[str, object]] = [
            (name, _values.number(f"initial_states[{name!r}]", value))  # type: ignore[arg-type]
            for name, value in _values.pairs("initial_states", initial_states)
        ]
        described = self._fmu.with_units(_values.units(units)) if units is not None else None
        tables: list[_inputs.Table] = []
        functions: list[_inputs.Function] = []
        if inputs is not None:
            given = [name for name, _ in values] + self._names_set()
            tables, functions = _inputs.normalize(inputs, described or self._fmu, given, parameter_set)
        request = Request(
            start_time=_values.optional_number("start_time", start_time),
            final_time=_values.optional_number("final_time", final_time),
            times=None if times is None else _values.vector("times", times),
            output_interval=_values.optional_number("output_interval", output_interval),
            ncp=_values.limit("ncp", ncp, 1),
            start_values=values + states,
            clock_intervals=_intervals(clock_intervals),
            outputs=self._outputs(outputs),
            tables=tables,
            functions=functions,
            settings=_options.run_settings(
                relative_tolerance=relative_tolerance,
                solver=solver,
                step_size=step_size,
                max_step=max_step,
                interior_samples=interior_samples,
                chattering=chattering,
                input_derivatives=input_derivatives,
            ),
            max_time=_values.optional_number("max_time", max_time),
            record_events=_values.flag("record_events", record_events),
            between_steps=_values.choice("between_steps", between_steps),
            isolation=None if isolation is None else _values.choice("isolation", isolation),
            parameter_set=parameter_set,
            described=described,
            sandbox=_values.flag("sandbox", sandbox),
            initial_states=[name for name, _ in states],
        )
        result = SimulationResult(**self._model.simulate(request))
        if len(result.time) and (message := _inputs.held_beyond(tables, float(result.time[0]), float(result.time[-1]))):
            warnings.warn(message, UserWarning, stacklevel=2)
        if chattering == "warn" and result.stats.chattering:
            _log.warning("simulate: time hardly advanced during %d sequences of 100 events", result.stats.chattering)
        return result

    if not TYPE_CHECKING:

        def __getattr__(self, name):
            # Names of PyFMI's models in scripts written for PyFMI.
            if not name.startswith("_"):
                from ..compat.pyfmi import FMUModelME2

                if hasattr(FMUModelME2, name):
                    raise AttributeError(f"'FMUModel' has no '{name}'; for PyFMI's methods, use pydfo.compat.pyfmi.load_fmu")
            raise AttributeError(f"'FMUModel' object has no attribute '{name}'", name=name, obj=self)

    def _outputs(self, outputs: str | Iterable[str] | None) -> list[str] | None:
        if outputs is None:
            return None
        return [outputs] if isinstance(outputs, str) else _values.names("outputs", outputs)

    def _names_set(self) -> list[str]:
        """Returns the names of the variables set; empty during a simulation and after closing."""
        try:
            return self._model.names_set()
        except (RuntimeError, ValueError):
            return []

    def close(self) -> None:
        """Frees the instance of the model. Afterwards, only `description` and `path` are available."""
        self._model.close()

    def __enter__(self) -> FMUModel:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        d = self.description
        closed = ", closed" if self._model.closed else ""
        return _text.line(f"<FMUModel: {d.model_name}, FMI {d.fmi_version} {self.kind}, {d.n_states} states, {str(self.path)!r}{closed}>")


def names_and_values(name: str | Iterable[str] | Mapping[str, object], value: object = _NOT_GIVEN) -> tuple[list[str], list[Any]]:
    """Returns the names and values passed to `set`."""
    if isinstance(name, Mapping):
        if value is not _NOT_GIVEN:
            raise TypeError("set() requires either a dict of names and values, or names and values as two arguments")
        return _values.names("name", list(name)), list(name.values())
    if value is _NOT_GIVEN:
        raise TypeError(f"set() requires a value for {_text.show(name)}, or a dict of names and values")
    if isinstance(name, str):
        return [name], [value]
    names = _values.names("name", name)
    if isinstance(value, np.ndarray):
        values = list(np.atleast_1d(value))
    elif isinstance(value, Iterable) and not isinstance(value, (str, bytes)):
        values = list(value)
    else:
        values = [value]
    if len(values) != len(names):
        raise ValueError(f"set(): expected {len(names)} values, one per name; got {len(values)}")
    return names, values


load_fmu = FMUModel
"""PyFMI's name for opening an FMU."""


def _intervals(
    intervals: Mapping[str, SupportsFloat | tuple[int, int]] | None,
) -> list[tuple[str, float | tuple[int, int]]]:
    if intervals is None:
        return []
    if not isinstance(intervals, Mapping):
        raise TypeError(f"clock_intervals must be a dict of names and intervals, not {_text.show(intervals)}")
    _values.names("clock_intervals", list(intervals))
    return [(name, _interval(name, interval)) for name, interval in intervals.items()]


def _interval(name: str, interval: SupportsFloat | tuple[int, int]) -> float | tuple[int, int]:
    if not isinstance(interval, tuple):
        return _values.number(f"the interval of {name}", interval)
    if len(interval) != 2 or not all(isinstance(part, int) and 0 <= part < 2**64 for part in interval):
        raise TypeError(f"the interval of {name} must be a number or (counter, resolution), not {_text.show(interval)}")
    return interval
