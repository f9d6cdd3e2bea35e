"""Models with PyFMI's methods, based on `pydfo.FMUModel` (simulations) and `pydfo.fmi.Instance` (single calls)."""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from ..._model.instance import EventInfo, Instance, LinearSystem, SavedState
from ..._model.model import FMUModel
from .._refused import refuse, refused
from . import constants
from . import options as _options
from .described import DescribedModel
from .exceptions import FMUException
from .results import Result

_BY_FIT = "use pydfo.Calibration.fit() to fit parameters"
_LOG = 'get_log() returns the last lines, and logging.getLogger("pydfo") receives all lines'
_STRUCTURE = "dependencies are not available in Python"


class FMUModelBase(DescribedModel):
    """A model with PyFMI's methods.

    It simulates from a fresh instance with all values of `set`. `initialize` or `setup_experiment` creates an
    instance for single calls. From then on, `get` and `set` refer to this instance until `reset`.
    """

    def __init__(
        self, fmu: str | os.PathLike[str], log_file_name: Any = None, log_level: int = 2, kind: str = "auto", allow_unzipped_fmu: bool = False
    ) -> None:
        if log_file_name not in (None, ""):
            refuse("log_file_name", 'use get_log() or logging.getLogger("pydfo")')
        super().__init__(FMUModel(fmu, kind, log_level=log_level))
        self._instance: Instance | None = None
        self._time: float | None = None
        self._experiment: tuple[float | None, float | None, float | None] = (None, None, None)
        self._info = SimpleNamespace(
            newDiscreteStatesNeeded=False,
            terminateSimulation=False,
            nominalsOfContinuousStatesChanged=False,
            valuesOfContinuousStatesChanged=False,
            nextEventTimeDefined=False,
            nextEventTime=0.0,
        )

    # --- values -------------------------------------------------------------------------------------------------------

    def get(self, variable_name: str | Iterable[str]) -> Any:
        """Returns a value, or a list of values for a list of names. PyFMI's arrays of one element are single values
        here."""
        source = self._instance if self._is_live else self._model
        return source.get(variable_name)  # type: ignore[union-attr]

    def set(self, variable_name: str | Iterable[str], value: Any) -> None:
        """Sets one variable or several."""
        if self._instance is None or self._instance.phase == "instantiated":
            self._model.set(variable_name, value)
        if self._instance is not None:
            self._instance.set(variable_name, value)

    def get_variable_display_value(self, variable_name: str) -> float:
        """Returns the value of a variable in its display unit."""
        shown, v = self.get_variable_display_unit(variable_name), self._variable(variable_name)
        units = self._description.units[v.unit or ""].display_units
        unit = next(unit for unit in units if unit.name == shown)
        value = self.get(variable_name)
        return float(unit.factor / value if unit.inverse else unit.factor * value + (0.0 if v.relative_quantity else unit.offset))

    @property
    def _is_live(self) -> bool:
        return self._instance is not None and self._instance.phase not in ("instantiated", "closed")

    def _live(self) -> Instance:
        if self._instance is None:
            raise FMUException("the model is not initialized; call initialize(), or setup_experiment() and enter_initialization_mode()")
        return self._instance

    def _get_typed(self, kinds: Sequence[str], references: Any, dtype: Any) -> Any:
        values = [self.get(name) for name in self._names(kinds, references)]
        return values if dtype is None else np.array(values, dtype=dtype)

    def get_real(self, valueref: Any) -> Any:
        """Returns values of reals by value reference."""
        return self._get_typed(("Real",), valueref, np.float64)

    def get_integer(self, valueref: Any) -> Any:
        """Returns values of integers and enumerations by value reference."""
        return self._get_typed(("Integer", "Enumeration"), valueref, np.int32)

    def get_boolean(self, valueref: Any) -> Any:
        """Returns values of Booleans by value reference."""
        return self._get_typed(("Boolean",), valueref, np.bool_)

    def get_string(self, valueref: Any) -> Any:
        """Returns strings by value reference."""
        return self._get_typed(("String",), valueref, None)

    def set_real(self, valueref: Any, values: Any) -> None:
        """Sets reals by value reference."""
        self.set(self._names(("Real",), valueref), np.ravel(values).tolist())

    def set_integer(self, valueref: Any, values: Any) -> None:
        """Sets integers and enumerations by value reference."""
        self.set(self._names(("Integer", "Enumeration"), valueref), np.ravel(values).tolist())

    def set_boolean(self, valueref: Any, values: Any) -> None:
        """Sets Booleans by value reference."""
        self.set(self._names(("Boolean",), valueref), [bool(value) for value in np.ravel(values)])

    def set_string(self, valueref: Any, values: Any) -> None:
        """Sets strings by value reference."""
        self.set(self._names(("String",), valueref), [values] if isinstance(values, str) else list(values))

    # --- log ----------------------------------------------------------------------------------------------------------

    def get_log(self, start_lines: int = -1, end_lines: int = -1) -> list[str]:
        """Returns the last lines logged by the FMU for the instance used for single calls."""
        lines = self._instance.log if self._instance is not None and self._instance.phase != "closed" else []
        return lines[max(start_lines, 0) : None if end_lines < 0 else end_lines]

    def print_log(self, start_lines: int = -1, end_lines: int = -1) -> None:
        """Prints the lines of `get_log`."""
        print("\n".join(self.get_log(start_lines, end_lines)))

    def get_number_of_lines_log(self) -> int:
        """Returns the number of lines of `get_log`."""
        return len(self.get_log())

    def set_debug_logging(self, logging_on: bool, categories: Sequence[str] = ()) -> None:
        """Switches the FMU's log on, for these categories or for all, or off."""
        self._made().set_logging(list(categories) if logging_on and categories else bool(logging_on))

    # --- by hand ------------------------------------------------------------------------------------------------------

    def _made(self) -> Instance:
        if self._instance is None:
            self._instance = Instance(self._model)
        return self._instance

    def instantiate(self, name: str = "Model", visible: bool = False) -> None:
        """Creates the instance for single calls."""
        if self._instance is None:
            self._instance = Instance(self._model, name=name, visible=visible)

    def setup_experiment(
        self,
        tolerance_defined: bool = True,
        tolerance: float | str = "Default",
        start_time: float | str = "Default",
        stop_time_defined: bool = False,
        stop_time: float | str = "Default",
    ) -> None:
        """Sets times in s and relative tolerance of the experiment; the defaults are the suggestions of the model."""
        rtol = self.get_default_experiment_tolerance() if tolerance == "Default" else float(tolerance)
        start = self.get_default_experiment_start_time() if start_time == "Default" else float(start_time)
        stop = self.get_default_experiment_stop_time() if stop_time == "Default" else float(stop_time)
        self._experiment = (start, stop if stop_time_defined else None, rtol if tolerance_defined else None)
        self._made()

    def enter_initialization_mode(self) -> None:
        """Enters initialization mode."""
        self._made().enter_initialization(*self._experiment)

    def exit_initialization_mode(self) -> None:
        """Ends the initialization."""
        self._live().exit_initialization()

    def initialize(
        self,
        tolerance_defined: bool = True,
        tolerance: float | str = "Default",
        start_time: float | str = "Default",
        stop_time_defined: bool = False,
        stop_time: float | str = "Default",
    ) -> None:
        """Sets up the experiment, and enters and exits initialization mode. Model exchange is then in event mode."""
        if self._experiment == (None, None, None):
            self.setup_experiment(tolerance_defined, tolerance, start_time, stop_time_defined, stop_time)
        self.enter_initialization_mode()
        self.exit_initialization_mode()

    def terminate(self) -> None:
        """Ends the simulation of the instance."""
        self._live().terminate()

    def free_instance(self) -> None:
        """Frees the instance."""
        if self._instance is not None:
            self._instance.close()
            self._instance = None

    def reset(self) -> None:
        """Discards all values set, and the instance."""
        self.free_instance()
        self._model.reset()
        self._time, self._experiment = None, (None, None, None)

    @property
    def time(self) -> float:
        """Time in s of the instance, otherwise the end of the last simulation, otherwise the start time.

        In model exchange, the time can be set. Before `initialize`, this sets the start time."""
        at = self._instance.time if self._instance is not None and self._is_live else self._time
        return self.get_default_experiment_start_time() if at is None else at

    @time.setter
    def time(self, time: float) -> None:
        if not self._is_live:
            self._time = float(time)
            self.setup_experiment(start_time=time)
            return
        live = self._live()
        if live.kind == "CS":
            live._time = float(time)
        else:
            live.time = time

    def get_fmu_state(self, state: Any = None) -> SavedState:
        """Returns a copy of the state of the instance."""
        return self._live().save_state()

    def set_fmu_state(self, state: SavedState) -> None:
        """Restores a state."""
        self._live().restore_state(state)

    def free_fmu_state(self, state: SavedState) -> None:
        """Does nothing, because a state is freed when it is no longer referenced."""

    def get_directional_derivative(self, var_ref: Any, func_ref: Any, v: Any) -> Any:
        """Returns derivatives of reals (`func_ref`) in the direction `v` of others (`var_ref`), all by value
        reference."""
        of, by = self._names(("Real",), func_ref), self._names(("Real",), var_ref)
        return self._live().directional_derivative(of, by, np.asarray(v, dtype=np.float64))

    def _linear(self) -> LinearSystem:
        live = self._live()
        if live.phase == "event":
            live._settle()
        return live.linearize()

    def get_state_space_representation(
        self, A: bool = True, B: bool = True, C: bool = True, D: bool = True, use_structure_info: bool = True
    ) -> tuple[Any, Any, Any, Any]:
        """Returns the matrices of the linear system at the current point of the instance.

        The instance is in continuous-time mode afterwards. Matrices that are not requested are False. With
        `use_structure_info`, the matrices are sparse matrices of SciPy."""
        linear = self._linear()
        matrices = ((A, linear.A), (B, linear.B), (C, linear.C), (D, linear.D))
        if not use_structure_info:
            return tuple(matrix if is_included else False for is_included, matrix in matrices)  # type: ignore[return-value]
        try:
            csc_matrix = importlib.import_module("scipy.sparse").csc_matrix
        except ImportError as e:
            raise ImportError("sparse matrices require SciPy; install it with pip install scipy, or set use_structure_info=False") from e
        return tuple(csc_matrix(matrix) if is_included else False for is_included, matrix in matrices)  # type: ignore[return-value]

    # --- simulations --------------------------------------------------------------------------------------------------

    def simulate_options(self, algorithm: str = "Default") -> _options.Options:
        """Returns the options of `simulate` with their defaults, to be changed and passed to it."""
        return _options.default_options(self._model.kind)

    def simulate(
        self,
        start_time: float | str = "Default",
        final_time: float | str = "Default",
        input: Any = (),
        algorithm: Any = "Default",
        options: Any = {},
    ) -> Result | None:
        """Simulates from a fresh instance with all values of `set`.

        Parameters
        ----------
        start_time, final_time : float, optional
            Times in s; default: the suggestions of the model, or 0 and 1.
        input : tuple, optional
            ``(names, matrix)`` with the times in the first column, or ``(names, function of time)``.
        options : dict
            The result of `simulate_options`, or some of its entries. ``result_handling`` "file", "binary" and
            "memory" keep the result in memory; "csv" also writes a file.

        Raises
        ------
        NotProvided
            An option is not provided by pydfo.
        """
        requested = self.simulate_options()
        requested.update({} if isinstance(options, str) else options)
        start = self.get_default_experiment_start_time() if start_time == "Default" else float(start_time)
        stop = self.get_default_experiment_stop_time() if final_time == "Default" else float(final_time)
        chosen = _options.arguments(requested, self._model.kind, self._description.default_experiment.tolerance)
        given = None if isinstance(input, tuple) and not input else input
        native = self._model.simulate(start, stop, inputs=given, **chosen)
        self._time = native.end_time
        if not requested["return_result"] or requested["result_handling"] is None:
            return None
        path = None
        if requested["result_handling"] == "csv":
            path = requested["result_file_name"] or f"{self.get_identifier()}_result.csv"
            native.to_csv(path)
        return Result(self, requested, native, path)

    append_log_message = refused("FMUModel.append_log_message", _LOG)
    cancel_step = refused("FMUModel.cancel_step", "steps are blocking")
    deserialize_fmu_state = refused("FMUModel.deserialize_fmu_state", "states are valid only in their instance; use get_fmu_state() and set_fmu_state()")
    estimate = refused("FMUModel.estimate", _BY_FIT)
    estimate_options = refused("FMUModel.estimate_options", _BY_FIT)
    extract_xml_log = refused("FMUModel.extract_xml_log", _LOG)
    get_boolean_status = refused("FMUModel.get_boolean_status", "steps are blocking; a rejected call raises SimulationError with .status")
    get_derivatives_dependencies = refused("FMUModel.get_derivatives_dependencies", _STRUCTURE)
    get_derivatives_dependencies_kind = refused("FMUModel.get_derivatives_dependencies_kind", _STRUCTURE)
    get_fmil_log_level = refused("FMUModel.get_fmil_log_level", _LOG)
    get_integer_status = refused("FMUModel.get_integer_status", "steps are blocking; a rejected call raises SimulationError with .status")
    get_last_result_file = refused("FMUModel.get_last_result_file", "use res.result_file, if a file was written")
    get_log_filename = refused("FMUModel.get_log_filename", _LOG)
    get_log_level = refused("FMUModel.get_log_level", _LOG)
    get_max_log_size = refused("FMUModel.get_max_log_size", _LOG)
    get_model_time_varying_value_references = refused("FMUModel.get_model_time_varying_value_references", "get_model_variables(variability=...)")
    get_output_dependencies = refused("FMUModel.get_output_dependencies", _STRUCTURE)
    get_output_dependencies_kind = refused("FMUModel.get_output_dependencies_kind", _STRUCTURE)
    get_output_derivatives = refused("FMUModel.get_output_derivatives", "unsupported; differentiate the result")
    get_real_status = refused("FMUModel.get_real_status", "steps are blocking; a rejected call raises SimulationError with .status")
    get_status = refused("FMUModel.get_status", "steps are blocking; a rejected call raises SimulationError with .status")
    get_string_status = refused("FMUModel.get_string_status", "steps are blocking; a rejected call raises SimulationError with .status")
    get_unpacked_fmu_path = refused("FMUModel.get_unpacked_fmu_path", "FMUs are unpacked into a private folder")
    get_variable_references = refused("FMUModel.get_variable_references", "get_variable_valueref(name)")
    has_reached_max_log_size = refused("FMUModel.has_reached_max_log_size", _LOG)
    serialize_fmu_state = refused("FMUModel.serialize_fmu_state", "states are valid only in their instance; use get_fmu_state() and set_fmu_state()")
    serialized_fmu_state_size = refused("FMUModel.serialized_fmu_state_size", "states are valid only in their instance; use get_fmu_state() and set_fmu_state()")
    set_additional_logger = refused("FMUModel.set_additional_logger", _LOG)
    set_log_level = refused("FMUModel.set_log_level", "load_fmu(log_level=...)")
    set_max_log_size = refused("FMUModel.set_max_log_size", _LOG)


class _ModelExchange(FMUModelBase):
    """Model exchange."""

    def __init__(self, fmu: str | os.PathLike[str], log_file_name: Any = None, log_level: int = 2, **more: Any) -> None:
        super().__init__(fmu, log_file_name, log_level, "ME", **more)

    def get_event_info(self) -> Any:
        """Returns the result of the last `event_update` with FMI's names; always one object."""
        return self._info

    def event_update(self, intermediateResult: bool = False) -> None:
        """Handles events until the discrete states no longer change, in one call for any `intermediateResult`."""
        live = self._live()
        info: EventInfo = live.update_discrete_states()
        self._info.newDiscreteStatesNeeded, self._info.terminateSimulation = False, info.terminate
        self._info.nominalsOfContinuousStatesChanged = info.nominals_changed
        self._info.valuesOfContinuousStatesChanged = info.states_changed
        self._info.nextEventTimeDefined, self._info.nextEventTime = info.next_time is not None, info.next_time or 0.0

    def enter_event_mode(self) -> None:
        """Enters event mode."""
        if self._live().phase != "event":
            self._live().enter_event_mode()

    def enter_continuous_time_mode(self) -> None:
        """Enters continuous-time mode."""
        if self._live().phase != "continuous":
            self._live().enter_continuous_time()

    @property
    def continuous_states(self) -> Any:
        """Continuous states; can be set in continuous-time mode."""
        return self._live().states

    @continuous_states.setter
    def continuous_states(self, states: Any) -> None:
        self._live().states = np.asarray(states, dtype=np.float64)

    @property
    def nominal_continuous_states(self) -> Any:
        """Nominal values of the states."""
        return self._live().nominals

    def get_derivatives(self) -> Any:
        """Returns the derivatives of the states."""
        return self._live().derivatives

    def get_event_indicators(self) -> Any:
        """Returns the event indicators."""
        return self._live().event_indicators

    def completed_integrator_step(self, no_set_FMU_state_prior_to_current_point: bool = True) -> tuple[bool, bool]:
        """Returns two flags: the model requests event mode, and the model requests the end of the simulation."""
        return self._live().completed_integrator_step()

    def get_relative_tolerance(self) -> float:
        """Returns the relative tolerance of the default experiment."""
        return self.get_default_experiment_tolerance()

    def get_absolute_tolerances(self) -> Any:
        """Returns 0.01 times the relative tolerance times the nominal values of the states."""
        return 0.01 * self.get_relative_tolerance() * np.array([self.get_variable_nominal(name) for name in self.get_states_list()])

    def get_tolerances(self) -> tuple[float, Any]:
        """Returns the relative tolerance and the absolute tolerances."""
        return self.get_relative_tolerance(), self.get_absolute_tolerances()


class _CoSimulation(FMUModelBase):
    """Co-simulation."""

    def __init__(self, fmu: str | os.PathLike[str], log_file_name: Any = None, log_level: int = 2, **more: Any) -> None:
        super().__init__(fmu, log_file_name, log_level, "CS", **more)

    def do_step(self, current_t: float, step_size: float, new_step: bool = True) -> int:
        """Performs a step from a time to a later one, in s. Returns 0 if it is complete, otherwise 2 (discard)."""
        live = self._live()
        live._time = float(current_t)
        return constants.FMI_OK if live.do_step(step_size).complete else constants.FMI_DISCARD

    def set_input_derivatives(self, variables: str | Iterable[str], values: Any, order: int = 1) -> None:
        """Sets the first derivatives of inputs."""
        if order != 1:
            refuse("set_input_derivatives(order > 1)", "inputs are extrapolated linearly")
        self._live().set_input_derivatives(variables, values)


class FMUModelME1(_ModelExchange):
    """Model exchange, FMI 1.0, which has no modes: `initialize` and `event_update` handle all events."""

    def __init__(self, fmu: str | os.PathLike[str], log_file_name: Any = None, log_level: int = 2, **more: Any) -> None:
        super().__init__(fmu, log_file_name, log_level, **more)
        self._info = SimpleNamespace(
            iterationConverged=False,
            stateValueReferencesChanged=False,
            stateValuesChanged=False,
            terminateSimulation=False,
            upcomingTimeEvent=False,
            nextEventTime=0.0,
        )

    def initialize(self, *args: Any, **more: Any) -> None:
        """Initializes the model at the current time."""
        super().initialize(*args, **more)
        self.event_update()

    def event_update(self, intermediateResult: bool = False) -> None:
        """Handles events until they converge, in one call for any `intermediateResult`."""
        self.enter_event_mode()
        info: EventInfo = self._live().update_discrete_states()
        self._info.iterationConverged, self._info.terminateSimulation = True, info.terminate
        self._info.stateValueReferencesChanged, self._info.stateValuesChanged = info.nominals_changed, info.states_changed
        self._info.upcomingTimeEvent, self._info.nextEventTime = info.next_time is not None, info.next_time or 0.0
        if not info.terminate:
            self.enter_continuous_time_mode()

    def completed_integrator_step(self) -> bool:  # type: ignore[override]
        """Returns True if the model requests an event."""
        return super().completed_integrator_step()[0]


class FMUModelCS1(_CoSimulation):
    """Co-simulation, FMI 1.0."""


class FMUModelME2(_ModelExchange):
    """Model exchange, FMI 2.0."""


class FMUModelCS2(_CoSimulation):
    """Co-simulation, FMI 2.0."""


class FMUModelME3(_ModelExchange):
    """Model exchange, FMI 3.0."""


class FMUModelCS3(_CoSimulation):
    """Co-simulation, FMI 3.0, which PyFMI does not support."""


def load_fmu(
    fmu: str | os.PathLike[str], log_file_name: Any = None, kind: str = "auto", log_level: int = 2, allow_unzipped_fmu: bool = False
) -> FMUModelBase:
    """Opens an FMU.

    Parameters
    ----------
    fmu : path
        An ``.fmu`` file or an unpacked folder (for any `allow_unzipped_fmu`).
    kind : {"auto", "ME", "CS"}
    log_level : int
        0 (nothing) to 7 (all).

    Raises
    ------
    NotProvided
        For `log_file_name` and ``kind="SE"``.
    OSError, FmuError
        The FMU cannot be read or run.
    """
    if isinstance(kind, str) and kind.upper() == "SE":
        refuse('load_fmu(kind="SE")', "scheduled execution is not supported")
    opened = FMUModel(Path(fmu), kind)
    version = opened.description.fmi_version[0]
    classes = {(c.__name__[-3:-1], c.__name__[-1]): c for c in (FMUModelME1, FMUModelCS1, FMUModelME2, FMUModelCS2, FMUModelME3, FMUModelCS3)}
    return classes[opened.kind, version](fmu, log_file_name, log_level)
