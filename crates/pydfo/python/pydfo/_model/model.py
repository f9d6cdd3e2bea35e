"""Models as scripts use them: open, set, simulate, get."""

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

#: Stands where no value is given: None is one that can be.
_NOT_GIVEN: object = object()


class Request(NamedTuple):
    """The options of a simulation, as the native code reads them, in this order; None: the default of the model."""

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
    #: The FMU with units that its description does not state.
    described: _core.Fmu | None
    sandbox: bool
    #: Those of the start values that are initial states.
    initial_states: list[str]


LOG_LEVELS = ("nothing", "fatal", "error", "warning", "info", "verbose", "debug", "all")
"""PyFMI's levels of logging, by their numbers."""


def _log_level(level: int | str | None) -> int:
    """The number of a level."""
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
    """Whether the FMU is asked to log, and the categories that are asked for by name."""
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

    Opening reads the file (the second time, as long as it does not change, next to nothing is done); the FMU's code is
    loaded, or built from its sources, when it is first needed. As a context manager the model is closed at the end.

    Values are `set` for all simulations that follow, until `reset`; each simulation starts from a fresh model with these
    values, so that the same values give the same bits.

    The FMU runs in a process of its own, which is kept from one call to the next. If the process ends, the next call starts another one
    with the same values set, and the first time a warning is logged. The second simulation is also made in a new process: where that gives other bits, the FMU keeps a state
    that no variable shows. Then it is named in ``description.quirks``, and each simulation has a new process.

    Parameters
    ----------
    path : path
        An ``.fmu`` file or an unpacked folder.
    kind : {"auto", "ME", "CS"}
        How to run it: "ME" integrates its equations with a method of choice (model exchange), "CS" lets it integrate
        itself from one communication point to the next (co-simulation), "auto" takes model exchange where it is
        offered. The case of the letters does not matter.
    log_level : int or str, optional
        Which lines of the FMU's log are kept, and shown: after each simulation they go to the logger "pydfo" of Python's
        `logging` at the level INFO. The levels are PyFMI's: 0 "nothing", 1 "fatal", 2 "error" (both let errors of any kind
        pass), 3 "warning", 4 "info", 5 "verbose", 6 "debug", 7 "all" (all lines, with all four). Default: all lines are
        kept, the last of them are part of the message of every error, and none are shown.
    logging : bool, str or list of str
        The FMU is asked to log; FMUs log what they think important without being asked, too. Names: of these categories
        only (``description.log_categories`` has their names; FMI 1.0 has none in advance, and any will do).
    deepbind : bool
        Symbols of the FMU's library come before those of the process (RTLD_DEEPBIND, Linux): for libraries that would get a
        function of the same name of the host program instead of their own.
    lazy : bool
        Functions of the library are looked up when they are first called (RTLD_LAZY): for libraries that lack some which
        are never called.
    max_description_bytes : int, optional
        How large ``modelDescription.xml`` may be; default 64 MiB. Reading it takes at most eight times as much memory.
    max_elements : int, optional
        How many elements its array variables may have together; default 2 million.

    Raises
    ------
    OSError
        The file cannot be read (FileNotFoundError if there is none).
    FmuError
        The archive or its ``modelDescription.xml`` is damaged or not safe to unpack; the FMU is of a kind or version
        that cannot be simulated (`read_description` still describes it).
    ValueError
        `kind` or `log_level` is none of those above.

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
        is_asked, categories = _log_request(logging)
        self._opened = OpenOptions(
            log_level=_log_level(log_level),
            logging=is_asked,
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
        # An attribute of that name would have no effect on the model.
        if not name.startswith("_") and name in self.description.variables:
            raise AttributeError(f"variables of the model are no attributes: set('{name}', {_text.show(value)}) sets this one")
        super().__setattr__(name, value)

    def __reduce__(self) -> NoReturn:
        raise TypeError("an FMUModel cannot be pickled, because it holds a loaded library: open the FMU in each process")

    @property
    def path(self) -> Path:
        """The file, as it was given."""
        return self._fmu.path

    @property
    def kind(self) -> str:
        """How it is run: "ME" or "CS"."""
        return self._kind

    @property
    def reuse(self) -> str:
        """How a worker process returns the model to its start between two simulations: "reset" (the FMU's function), "reinstantiate"
        (a new instance) or "process" (a new process). It begins with "reset", and takes the next one if a simulation differs from the
        same one in a fresh process."""
        return self._fmu.reuse()

    @cached_property
    def description(self) -> Description:
        """The model description."""
        return Description(self._fmu)

    def get(self, name: str | Iterable[str]) -> Any:
        """Values of variables: after a simulation the final ones, before it those set, else the initial ones. A simulation that was
        interrupted or ended by an error does not count.

        Parameters
        ----------
        name : str or iterable of str
            Names of variables, or of elements of arrays (``name[2,1]``, counted from 1).

        Returns
        -------
        float, int, bool, str, bytes or ndarray, or a list of them
            One value for a name, a list for a list. Enumerations are int; arrays have their shape.

        Raises
        ------
        KeyError
            There is no such variable; the message offers the nearest names.
        SimulationError
            Initial values were needed, and the model cannot be initialized.
        """
        if isinstance(name, str):
            return self._model.get([name])[0]
        return self._model.get(_values.names("name", name))

    def set(self, name: str | Iterable[str] | Mapping[str, object], value: object = _NOT_GIVEN) -> None:
        """Sets parameters, start values, or constant values of inputs, for all simulations from now on.

        Parameters
        ----------
        name : str, iterable of str, or dict
            Names of variables, or of elements of arrays (``name[2,1]``, counted from 1); or a dict of names and values
            (``model.set(fit.parameters)``), then without `value`.
        value : float, int, bool, str, bytes or array_like, or a sequence of them
            One value for a name, as many as names for a list: all are set, or none. NumPy scalars and arrays of one element
            are single values, too. Arrays are given in their shape or flat, the last index varying fastest. Items of
            enumerations are given as int or by their names.

        Raises
        ------
        KeyError
            There is no such variable; the message offers the nearest names.
        TypeError
            The value is not of the type of the variable.
        ValueError
            The variable cannot be set (the message says why), the value is not finite, or there are not as many values as
            names.
        """
        self._model.set(*names_and_values(name, value))

    def reset(self) -> None:
        """Forgets all values set and the last simulation."""
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
        """Simulates from a freshly reset model with all values that were `set`.

        Times are in s. The FMU runs in a process of its own, which is kept for the next call; the interpreter lock is released
        meanwhile. Ctrl-C ends the simulation, and its process if the FMU does not return within 0.1 s.

        Rows of co-simulations (``kind="CS"``) are read when a communication step has ended, before the inputs of the next
        one are set: at a time when inputs jump they are the values before the jump, also of what follows the inputs
        directly, and an input that is recorded is the one of the step that has ended. The row at the start is read after
        the initialization with the inputs of that time. Only a model with an event mode (FMI 3.0) lets inputs jump there:
        then the row is the one after the jump, and a time listed twice gives both.

        Parameters
        ----------
        start_time : float, optional
            Default: that of the model's default experiment, else 0.
        final_time : float, optional
            Default: that of the default experiment, else the last of `times`. Also called `stop_time`.
        inputs : optional
            What drives the inputs (also called `input`):

            - a dict of arrays with "time", or a DataFrame with a column or an index "time", or a structured array (in a
              dict, a number is a constant);
            - ``(names, matrix)`` with the times in the first column;
            - the path of a recording (CSV, ``.mat``, ``.parquet``, ``.xlsx``), read as that of an `Experiment`: its columns that
              have the names of inputs (in another case, too, where that can be one input only) drive them, converted to the units of the
              model; rows where one is not known are left out;
            - a function of time, for a model with one input; a dict of functions; ``(names, function)``.

            Elements of an array are inputs of their own: ``{"time": t, "u[1]": a, "u[2]": b}``.

            Tables are linear between rows for continuous inputs of type Real (or Float32), and held for all others; a time
            listed twice is a jump. Jumps are events, and a step ends at every row where the slope changes: no pulse is too
            short to be seen. So a co-simulation communicates at each such row, too, also where that is more often than
            `step_size` says (the log says so once). If the model is not told derivatives of its inputs, it communicates at every
            row at which an input changes. One that takes steps of one length only takes the inputs over at its
            steps. Tunable parameters are driven like inputs. They are held from row to row, and change at events in model
            exchange and at communication points in co-simulation. Functions can drive continuous inputs of these types and should be smooth. Of a triggered clock (FMI 3.0) the rows that hold
            True are its ticks; a clock with an interval that can be deactivated leaves its ticks out where it holds False.
        outputs : str or iterable of str, optional
            Variables to record: names, elements of arrays (``name[2,1]``, counted from 1), patterns (``*`` stands for any
            characters, ``?`` for one), or "all". Also called `output`. Default: the outputs and the states; where a model declares neither
            (FMI 1.0), all variables that change.
        times : array_like, optional
            The times of the rows, ascending. A time listed twice gives the limit from the left, then the value after the
            events of that time.
        output_interval : float, optional
            Distance of the rows; the last one is at the final time.
        ncp : int, optional
            Number of intervals between the rows; default 500. At most one of `times`, `output_interval` and `ncp` may be
            given.
        start_values : dict of str to value, or path, optional
            Values for this simulation only, on top of those set; or the path of an SSP parameter file (``.ssv``). The start
            value of a state with ``initial="approx"`` is a guess; a warning is logged if the state starts with another value.
        initial_states : dict of str to float, optional
            Values of continuous states at the start of this simulation, also of those with ``initial="approx"`` or
            ``"calculated"``. In model exchange a state that the initialization has given another value is set after the
            initialization (``setContinuousStates``), and an event iteration follows. What the model computed from the state
            during the initialization, such as parameters, stays as it is. A co-simulation cannot set states after the
            initialization: it fails if a state starts with another value.
        clock_intervals : dict of str to float or tuple of int, optional
            Intervals in s between the ticks of input clocks whose intervals are fixed or tunable (FMI 3.0); a tuple is a
            fraction, counter and resolution.
        relative_tolerance : float, optional
            Default: that of the default experiment, else 1e-6.
        solver : {"auto", "tsit5", "dop853", "radau5", "bdf", "rk4", "euler"}
            The method (model exchange); the last two have a fixed step. "CVode" and SciPy's "RK45", "Radau" and "LSODA" are
            taken as "auto", "tsit5", "radau5" and "auto".
        step_size : float, optional
            Model exchange: step of the methods with a fixed step; default: a 500th of the span. Co-simulation: the
            communication step; default: the larger of the step of the default experiment and the distance of the rows; for
            a model that takes steps of one length only, the step of the default experiment, unless that makes more than
            1e6 steps. Where the model can step to any time, it communicates at the rows of the result and of the inputs, too.
        max_step : float, optional
            Largest step of the other methods.
        interior_samples : int, optional
            Points within each step at which event indicators are looked at, for one that crosses zero and back within a step
            (model exchange). Default: one ("dop853", "radau5": three), and more where the values bend.
        max_time : float, optional
            Limit of wall-clock time in s; it acts between calls into the FMU. Also called `timeout`.
        record_events : bool
            Add rows for both sides of every event.
        chattering : {"error", "warn", "slide"}
            What happens when more than a hundred state events in a row let time hardly advance: the simulation fails; or it
            goes on, and a warning is logged; or it goes on in small steps along the surface where the events are, which
            is the solution where the model pushes against it from both sides.
        input_derivatives : bool
            Co-simulations of FMI 1.0 and 2.0 that extrapolate continuous inputs (``canInterpolateInputs``) are told their
            derivatives before each step: those of the line to the inputs at its end. With False inputs are held over each
            step, as by most other tools.
        between_steps : {"interpolate", "error"}
            Rows between the steps of a co-simulation that cannot stop there, because it takes steps of one length only
            (``canHandleVariableCommunicationStepSize`` is not set) or moves from one multiple of a step of its own to the
            next (``fixedInternalStepSize``, FMI 3.0): they are interpolated linearly between the steps on both sides (what is
            not continuous has the value of the step before), which the log says once, or they are an error. Fits
            interpolate.
        isolation : {"none", "process"}, optional
            Where the FMU runs: in a process of its own (the default), or in this one, with the same bits. A crash, `exit`, or a call
            that does not return within `max_time` ends the process of the FMU and is a SimulationError; the next call starts another
            process. "none" is for programs that embed the module, and for benchmarks: there, a crash of the FMU ends Python, and Ctrl-C
            acts between two calls into it only.
        sandbox : bool
            Confine the process of the FMU, as in a `Calibration`; an error where the system cannot do that.
        units : dict of str to str, optional
            Units of variables of which the model states none: ``{"room.T": "K"}``, as in a `Calibration`. Columns of a recording that
            drives inputs and values of an SSP parameter file which state a unit are converted to it, and the result has it.

        Returns
        -------
        SimulationResult
            Its columns hold what the model says, NaN and infinities too; derivatives and states that are none end in an error.

        Warns
        -----
        UserWarning
            A setting has no effect: `step_size` with a solver that chooses its steps itself, `max_step` with one that does
            not, `solver` and `max_step` in co-simulation. Recorded inputs end before the simulation, or begin after it, by more than a
            row: they keep their first and last values.
        CalibrationWarning
            An input has no column in the recording that `inputs` names, and no start value is given; units that are not converted.

        Raises
        ------
        KeyError
            A name that is not known.
        ValueError, TypeError
            Arguments that make no sense, alone or together.
        FmuError
            The FMU cannot be loaded or built.
        SimulationError
            The simulation failed or took longer than `max_time`; with ``status``, ``time`` and ``log``.
        Interrupted
            Ctrl-C (a KeyboardInterrupt).
        Exception
            Whatever an input function raises comes out as it is.
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
        if len(result.time) and (said := _inputs.held_beyond(tables, float(result.time[0]), float(result.time[-1]))):
            warnings.warn(said, UserWarning, stacklevel=2)
        if chattering == "warn" and result.stats.chattering:
            _log.warning("simulate: %d times a hundred events hardly advanced time", result.stats.chattering)
        return result

    if not TYPE_CHECKING:

        def __getattr__(self, name):
            # Names of PyFMI's models, in scripts that were written for it.
            if not name.startswith("_"):
                from ..compat.pyfmi import FMUModelME2

                if hasattr(FMUModelME2, name):
                    raise AttributeError(f"'FMUModel' has no '{name}', PyFMI's models have: from pydfo.compat.pyfmi import load_fmu")
            raise AttributeError(f"'FMUModel' object has no attribute '{name}'", name=name, obj=self)

    def _outputs(self, outputs: str | Iterable[str] | None) -> list[str] | None:
        if outputs is None:
            return None
        return [outputs] if isinstance(outputs, str) else _values.names("outputs", outputs)

    def _names_set(self) -> list[str]:
        """Names of the variables that were set; none while it simulates and after it was closed."""
        try:
            return self._model.names_set()
        except (RuntimeError, ValueError):
            return []

    def close(self) -> None:
        """Frees the instance of the model; only `description` and `path` can be used afterwards."""
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
    """The names and values that are given to `set`."""
    if isinstance(name, Mapping):
        if value is not _NOT_GIVEN:
            raise TypeError("set() takes a dict of names and values, or names and values, not both")
        return _values.names("name", list(name)), list(name.values())
    if value is _NOT_GIVEN:
        raise TypeError(f"set() needs a value for {_text.show(name)}, or a dict of names and values")
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
        raise ValueError(f"{len(values)} values are given for {len(names)} names")
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
