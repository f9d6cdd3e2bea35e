"""`simulate_fmu` with FMPy's arguments, implemented with `pydfo.FMUModel`."""

from __future__ import annotations

import os
import shutil
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import IO, Any, SupportsFloat

import numpy as np

from ... import _core
from ..._model.description import Description, Variable
from ..._model.model import FMUModel
from ..._model.trajectory import SimulationResult as NativeResult
from .._refused import hand_out, refuse
from .instances import Model, Slave
from .model_description import ModelDescription, PathLike, of_description, path_of


class SimulationResult(np.ndarray):
    """A structured array with a row per sample, ``time`` (in s) first; `modelDescription` is the description of its
    model."""

    modelDescription: ModelDescription | None

    def __array_finalize__(self, obj: Any) -> None:
        self.modelDescription = getattr(obj, "modelDescription", None)


#: Types in the order of FMPy's columns, with NumPy's types.
_ORDER = {
    "Float32": np.float32,
    "Real": np.float64,
    "Int8": np.int8,
    "UInt8": np.uint8,
    "Int16": np.int16,
    "UInt16": np.uint16,
    "Integer": np.int32,
    "UInt32": np.uint32,
    "Int64": np.int64,
    "Enumeration": np.int64,
    "UInt64": np.uint64,
    "Boolean": np.bool_,
}


#: Maximum number of rows. More rows indicate a wrong interval.
_MOST_ROWS = 100_000_000


def auto_interval(t: float) -> float:
    """Returns the interval that FMPy uses by default: a round number that divides `t` into 500 to 1000 steps.
    """
    h = 10.0 ** (np.round(np.log10(t)) - 3)
    n = t / h
    for least, factor in ((2500, 5.0), (2000, 4.0), (1000, 2.0)):
        if n >= least:
            return float(h * factor)
    for most, factor in ((200, 5.0), (250, 4.0), (500, 2.0)):
        if n <= most:
            return float(h / factor)
    return float(h)


def _default_outputs(description: Description) -> list[str]:
    states = [name for name in description.states if name is not None]
    # Aliases of outputs (FMI 3.0) are also outputs.
    outputs = [name for name, variable in description.variables.items() if variable.causality == "output"]
    return outputs or states[:5] or list(description.variables)[:5]


def _converted(description: Description, variable: Variable, value: Any) -> Any:
    """Converts a start value: a literal, or a value with its unit."""
    if isinstance(value, tuple) and len(value) == 2 and isinstance(value[1], str):
        number, unit = float(value[0]), value[1]
        if unit == variable.unit:
            return number
        definition = description.units.get(variable.unit or "")
        shown = next((display for display in definition.display_units if display.name == unit), None) if definition else None
        if shown is None:
            raise ValueError(f"{variable.name}: {unit!r} is neither the unit of the variable ({variable.unit}) nor one of its display units")
        return (shown.factor / number if shown.inverse else (number - shown.offset) / shown.factor)
    if not isinstance(value, str) or variable.type in ("String", "Binary"):
        return value
    if variable.shape:
        return [float(item) for item in value.split()]
    if variable.type == "Boolean":
        if value.lower() not in ("true", "false", "1", "0"):
            raise ValueError(f"{variable.name}: expected 'true' or 'false', got {value!r}")
        return value.lower() in ("true", "1")
    return float(value) if variable.type in ("Real", "Float32") else int(value) if value.lstrip("+-").isdigit() else value


def _is_driven(name: str, description: Description) -> bool:
    """Returns True if FMPy sets a variable from a column: an input (or an element of one), or a tunable variable."""
    whole = name if name in description.variables else name.partition("[")[0]
    found = description.variables[whole] if whole in description.variables else None
    return found is not None and (found.causality == "input" or found.variability == "tunable")


def _inputs(signals: np.ndarray[Any, Any] | None, description: Description) -> dict[str, Any] | None:
    """Returns the columns that drive inputs; others are omitted with a warning."""
    if signals is None:
        return None
    if not isinstance(signals, np.ndarray) or signals.dtype.names is None:
        raise TypeError("input must be a structured array whose first field is the time")
    first, *others = signals.dtype.names
    columns: dict[str, Any] = {"time": np.asarray(signals[first], dtype=np.float64)}
    if left_out := [name for name in others if not _is_driven(name, description)]:
        warnings.warn(f"columns of input that are not inputs of the model have no effect: {', '.join(left_out)}", stacklevel=3)
    for name in (name for name in others if name not in left_out):
        column = np.asarray(signals[name])
        for index in np.ndindex(*column.shape[1:]):
            element = f"{name}[{','.join(str(i + 1) for i in index)}]" if index else name
            columns[element] = column[(slice(None),) + index]
    return columns if len(columns) > 1 else None


def _input_jumps(signals: np.ndarray[Any, Any], description: Description) -> list[float]:
    """Returns times at which inputs jump: times listed twice, and changes of inputs that are not continuous."""
    names: tuple[str, ...] = signals.dtype.names or ()
    at = signals[names[0]]
    jumps = set(at[1:][np.diff(at) == 0].tolist())
    for name in names[1:]:
        if name in description.variables and description.variables[name].variability in ("discrete", "tunable"):
            jumps.update(at[1:][signals[name][1:] != signals[name][:-1]].tolist())
    return sorted(jumps)


def _structured(result: NativeResult, description: Description, names: Sequence[str], model: ModelDescription) -> SimulationResult:
    """Returns the columns in FMPy's order: by type, then as in the file."""
    requested = set(names) - {"time"}
    whole = [variable.name for variable in model.modelVariables if variable.name in requested]
    columns: list[tuple[str, Any, tuple[int, ...]]] = []
    for kind, dtype in _ORDER.items():
        if kind == "Enumeration" and model.fmiMajorVersion < 3:
            continue
        kinds = {kind, "Enumeration"} if kind == "Integer" and model.fmiMajorVersion < 3 else {kind}
        columns += [(name, dtype, result[name].shape[1:]) for name in whole if description.variables[name].type in kinds]
    array = np.empty(len(result.time), dtype=[("time", np.float64), *((n, t, s) if s else (n, t) for n, t, s in columns)])
    for name in array.dtype.names or ():
        array[name] = result.time if name == "time" else result[name]
    shown = array.view(SimulationResult)
    shown.modelDescription = model
    return shown


def simulate_fmu(
    filename: PathLike | IO[bytes],
    validate: bool = True,
    start_time: float | str | None = None,
    stop_time: float | str | None = None,
    solver: str | None = "CVode",
    step_size: float | str | None = None,
    relative_tolerance: float | str | None = None,
    output_interval: float | str | None = None,
    record_events: bool = True,
    fmi_type: str | None = None,
    start_values: Mapping[str, Any] = {},
    apply_default_start_values: bool = False,
    input: np.ndarray[Any, Any] | None = None,
    output: Sequence[str] | None = None,
    timeout: float | str | None = None,
    debug_logging: bool = False,
    visible: bool = False,
    logger: Callable[..., Any] | None = None,
    fmi_call_logger: Callable[[str], None] | None = None,
    step_finished: Callable[..., bool] | None = None,
    model_description: ModelDescription | None = None,
    fmu_instance: Any = None,
    set_input_derivatives: bool = False,
    remote_platform: str | None = "auto",
    early_return_allowed: bool = False,
    use_event_mode: bool = False,
    initialize: bool = True,
    terminate: bool = True,
    fmu_state: Any = None,
    set_stop_time: bool = True,
) -> SimulationResult:
    """Simulates an FMU, with FMPy's arguments.

    Co-simulation is used if an FMU supports both interfaces. Model exchange is integrated by ``FMUModel.simulate``.
    "CVode" selects "auto", with a default tolerance of 1e-5. Events are located exactly, and rows are exactly on the
    grid. A timeout raises SimulationError. Event mode and early return are used if an FMU of version 3.0 supports
    them, for any value of `use_event_mode` and `early_return_allowed`. `use_event_mode` adds rows for both sides of
    jumps of inputs. `validate`, `apply_default_start_values`, `model_description` and `remote_platform` have no
    effect.

    Parameters
    ----------
    filename : path or file-like
        An ``.fmu`` file or an unpacked folder.
    start_time, stop_time, output_interval, step_size : float or str, optional
        Times in s; the defaults are FMPy's. With the solver "Euler", `output_interval` must be a multiple of
        `step_size`. "Euler" takes one step from row to row, for any `step_size`.
    solver : {"CVode", "Euler"}
    relative_tolerance : float or str, optional
    record_events : bool
        If True, add rows for both sides of events (model exchange).
    fmi_type : {"ModelExchange", "CoSimulation"}, optional
    start_values : dict
        Values by name: numbers, strings as in an XML file, or pairs of a value and its unit.
    input : structured ndarray, optional
        The first field is the time. Two rows with one time are a jump. Fields that are not inputs are ignored with a
        warning.
    output : list of str, optional
        Names to record; default: the outputs, or otherwise the first five states.
    timeout : float or str, optional
        Limit on the wall-clock time in s.
    debug_logging : bool
        If True, the FMU logs to Python's logger "pydfo".
    set_input_derivatives : bool
        If True, co-simulations receive the derivatives of the inputs. Raises ValueError if the FMU cannot interpolate
        inputs.

    Raises
    ------
    NotProvided
        For `visible`, `logger`, `fmi_call_logger`, `step_finished`, `fmu_instance`, `fmu_state`, ``initialize=False``,
        ``terminate=False`` and ``set_stop_time=False``.
    SimulationError, FmuError, KeyError, ValueError
        As in `pydfo.FMUModel.simulate`.
    """
    by_hand = "drive the instance yourself with pydfo.fmi.instantiate() or instantiate_fmu()"
    reasons = {
        "visible": (visible, by_hand),
        "logger": (logger, 'set debug_logging=True to log messages of the FMU with logging.getLogger("pydfo")'),
        "fmi_call_logger": (fmi_call_logger, "calls are made in Rust; every error contains the last lines of the FMU's log"),
        "step_finished": (step_finished, by_hand),
        "fmu_instance": (fmu_instance, f"omit it, because opening an FMU again is fast and creates a new instance, or {by_hand}"),
        "fmu_state": (fmu_state, "pydfo.fmi.Instance.save_state() and restore_state() save and restore the state of an instance"),
        "initialize=False": (not initialize, by_hand),
        "terminate=False": (not terminate, by_hand),
        "set_stop_time=False": (not set_stop_time, by_hand),
    }
    for name, (given, reason) in reasons.items():
        if given is not None and given is not False:
            refuse(f"simulate_fmu({name})", reason)
    if fmi_type not in (None, "ModelExchange", "CoSimulation"):
        raise ValueError('fmi_type must be one of "ModelExchange" or "CoSimulation"')
    if solver not in (None, "CVode", "Euler"):
        raise ValueError(f"Unknown solver: {solver}. Must be one of 'Euler' or 'CVode'.")
    path, folder = path_of(filename)
    try:
        from ..._model.description import read_description

        description = read_description(path)
        offers_cs = description.co_simulation is not None
        is_cs = offers_cs if fmi_type is None else fmi_type == "CoSimulation"
        if set_input_derivatives and is_cs and offers_cs and not description.co_simulation.capabilities.can_interpolate_inputs:  # type: ignore[union-attr]
            raise ValueError("set_input_derivatives is True but the FMU cannot interpolate inputs (canInterpolateInputs)")
        model = FMUModel(path, "CS" if is_cs else "ME", log_level="all" if debug_logging else None, logging=bool(debug_logging))
        with model:
            experiment = description.default_experiment
            start = _first(start_time, experiment.start_time, 0.0)
            stop = _first(stop_time, experiment.stop_time, start + 1.0)
            if not np.isfinite([start, stop]).all() or stop < start:
                raise ValueError(f"stop_time must be finite and not before start_time, not {stop!r} after {start!r}")
            interval = _interval(
                description, is_cs, start, stop, _positive("output_interval", output_interval), _positive("step_size", step_size)
            )
            if (stop - start) / interval > _MOST_ROWS:
                raise ValueError(f"{stop - start!r} s in intervals of {interval!r} s exceed the limit of {_MOST_ROWS} rows")
            time_tolerance = _core.time_tolerance(start, stop)
            n = int(np.floor((stop - start + time_tolerance) / interval))
            times = start + interval * np.arange(n + 1)
            varies = not is_cs or (offers_cs and description.co_simulation.capabilities.can_handle_variable_communication_step_size)  # type: ignore[union-attr]
            if stop - times[-1] > time_tolerance and varies and (is_cs or record_events):
                times = np.append(times, stop)
            elif abs(stop - times[-1]) <= time_tolerance:
                times[-1] = stop
            if use_event_mode and is_cs and input is not None and description.co_simulation.capabilities.has_event_mode:  # type: ignore[union-attr]
                for jump in (t for t in _input_jumps(input, description) if start < t <= stop):
                    near = times[np.argmin(np.abs(times - jump))]
                    # Add rows for both sides of the jump if the model can stop there.
                    if abs(near - jump) <= time_tolerance:
                        times = np.append(times, near)
                    elif varies:
                        times = np.append(times, [jump, jump])
                times.sort()
            variables = description.variables
            output = [output] if isinstance(output, str) else output
            names = [name for name in (output if output is not None else _default_outputs(description)) if name in variables]
            names = [name for name in names if name != "time" and variables[name].type not in ("String", "Binary", "Clock")]
            tolerance = _number(relative_tolerance)
            more: dict[str, Any] = {"step_size": _step(description, interval)} if is_cs else {"record_events": bool(record_events)}
            if not is_cs and solver == "Euler":
                more |= {"solver": "euler", "step_size": _euler_step(start, stop, interval, _positive("step_size", step_size))}
            result = model.simulate(
                start,
                stop,
                times=times,
                inputs=_inputs(input, description),
                outputs=names or [next(iter(variables))],
                start_values={name: _converted(description, variables[name], value) for name, value in start_values.items()},
                relative_tolerance=tolerance if tolerance is not None else None if is_cs else experiment.tolerance or 1e-5,
                max_time=_number(timeout),
                input_derivatives=bool(set_input_derivatives),
                **more,
            )
        return _structured(result, description, names, model_description or of_description(description, is_strict=False))
    finally:
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)


def _number(value: SupportsFloat | str | None) -> float | None:
    return None if value is None else float(value)


def _positive(name: str, value: SupportsFloat | str | None) -> float | None:
    number = _number(value)
    if number is not None and not 0.0 < number < float("inf"):
        raise ValueError(f"{name} must be positive, not {number!r}")
    return number


def _first(given: float | str | None, suggested: float | None, default: float) -> float:
    return float(given) if given is not None else suggested if suggested is not None else default


def _interval(
    description: Description, is_cs: bool, start: float, stop: float, requested: float | None, step: float | None
) -> float:
    """Returns the row spacing by FMPy's rules."""
    span = stop - start
    if requested is not None:
        return requested
    if span <= 0:
        return 1.0
    if not is_cs:
        found: float | None = step if step is not None else float(10.0 ** (np.round(np.log10(span)) - 3))
    else:
        fixed = description.co_simulation.capabilities.fixed_internal_step_size if description.co_simulation else None
        found = fixed if fixed is not None else description.default_experiment.step_size
    if found is None:
        return auto_interval(span)
    while span / found > 1000:
        found *= 2
    return found


def _step(description: Description, interval: float) -> float:
    """Returns the communication step of a co-simulation.

    If the model has an internal step, rows between its steps are interpolated."""
    internal_step = description.co_simulation.capabilities.fixed_internal_step_size if description.co_simulation else None
    return internal_step if internal_step and not np.isclose(round(interval / internal_step) * internal_step, interval, atol=0.0) else interval


def _euler_step(start: float, stop: float, interval: float, requested: float | None) -> float:
    """Returns the step of FMPy's solver "Euler": the row spacing, if it is a multiple of the requested step."""
    step = requested if requested is not None else 10.0 ** (np.round(np.log10(stop - start)) - 3)
    if not np.isclose(round(interval / step) * step, interval, atol=0.0):
        raise ValueError("output_interval must be a multiple of step_size for fixed step solvers")
    return interval


def instantiate_fmu(
    unzipdir: PathLike,
    model_description: ModelDescription,
    fmi_type: str | None = None,
    visible: bool = False,
    debug_logging: bool = False,
    logger: Any = None,
    fmi_call_logger: Any = None,
    library_path: Any = None,
    early_return_allowed: bool = False,
    event_mode_used: bool = False,
    intermediate_update: Any = None,
    require_functions: bool = True,
    required_intermediate_variables: Any = None,
) -> Any:
    """Creates an instance with FMPy's methods, based on `pydfo.fmi.Instance`; the FMU may be a folder or a file.

    Raises
    ------
    NotProvided
        For `logger`, `fmi_call_logger`, `library_path` and `intermediate_update`.
    """
    given = {"logger": logger, "fmi_call_logger": fmi_call_logger, "library_path": library_path, "intermediate_update": intermediate_update}
    for name, value in given.items():
        if value is not None:
            refuse(f"instantiate_fmu({name})", "the FMU is called from Rust")
    is_cs = model_description.coSimulation is not None if fmi_type is None else fmi_type == "CoSimulation"
    fmu = (Slave if is_cs else Model)(unzipDirectory=os.fspath(unzipdir), guid=model_description.guid)
    fmu.instantiate(visible=visible, loggingOn=debug_logging)
    return fmu


_SETTABLE = "pydfo.fmi.Instance.set raises an error with the reason if a variable cannot be set in a phase"
REFUSED = {
    "has_start_value": _SETTABLE,
    "settable_in_initialization_mode": _SETTABLE,
    "settable_in_instantiated": _SETTABLE,
    "Recorder": "rows are recorded in Rust; use simulate_fmu(output=...)",
    "Input": "inputs are set in Rust; use simulate_fmu(input=...)",
    "ForwardEuler": "use a method of FMUModel.simulate(solver=...)",
    "apply_start_values": "simulate_fmu(start_values=...)",
    "simulateME": 'simulate_fmu(fmi_type="ModelExchange")',
    "simulateCS": 'simulate_fmu(fmi_type="CoSimulation")',
}
__getattr__ = hand_out("pydfo.compat.fmpy.simulation", REFUSED)
