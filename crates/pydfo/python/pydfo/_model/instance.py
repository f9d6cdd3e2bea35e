"""An instance of an FMU controlled call by call: the individual functions of FMI, and steps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import TracebackType
from typing import Any, Literal, NoReturn, SupportsFloat

import numpy as np
import numpy.typing as npt

from .. import _core
from .._args import options as _options
from .._args import text as _text
from .._args import values as _values
from .._args.keywords import explained
from .description import Description
from .files import OpenOptions, PathLike
from .model import FMUModel, _log_request, names_and_values

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class EventInfo:
    """The result of an event iteration.

    Attributes
    ----------
    states_changed, nominals_changed : bool
        True if states, or their nominal values, have changed.
    terminate : bool
        True if the model requests the end of the simulation.
    next_time : float or None
        Time of the next time event in s; None if there is none.
    """

    states_changed: bool
    nominals_changed: bool
    terminate: bool
    next_time: float | None


@dataclass(frozen=True)
class StepInfo:
    """The result of a step.

    Attributes
    ----------
    time : float
        Current time of the instance in s.
    complete : bool
        True if the instance reached the end of the step.
    terminate : bool
        True if the model requests the end of the simulation.
    event : bool
        Co-simulation with an event mode (FMI 3.0): True if the model requests `Instance.handle_events`, or a clock is
        due. An unhandled event is handled at the start of the next step.
    early : bool
        Co-simulation (FMI 3.0): True if the model has returned early.
    """

    time: float
    complete: bool
    terminate: bool = False
    event: bool = False
    early: bool = False


@dataclass(frozen=True)
class LinearSystem:
    """The linear system ``dx/dt = A x + B u``, ``y = C x + D u`` of deviations from a point.

    Attributes
    ----------
    A, B, C, D : ndarray
        Shapes (states, states), (states, inputs), (outputs, states), (outputs, inputs); in the units of the model.
    states, inputs, outputs : list of str
        Names; each element of an array has its own name. Inputs and outputs are the continuous ones of type Real.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    states: list[str]
    inputs: list[str]
    outputs: list[str]


class Instance:
    """An instance of an FMU controlled call by call.

    It is always in one `phase`. FMI allows the following calls in each phase:

    =================  =======================================================  ===============================================
    phase              calls                                                    continues with
    =================  =======================================================  ===============================================
    "instantiated"     `set` (parameters, start values)                         `enter_initialization`, `initialize`
    "initialization"   `get`, `set` (inputs)                                    `exit_initialization`
    "event" (ME)       `get`, `set` (inputs), `update_discrete_states`          `enter_continuous_time`, `terminate`
    "continuous" (ME)  `get`, `set` (continuous inputs), `time`, `states`,      `enter_event_mode`, `do_step`, `terminate`
                       `derivatives`, `event_indicators`, `linearize`
    "step" (CS)        `get`, `set` (inputs), `do_step`, `handle_events`        `terminate`
    "terminated"       `get`                                                    `reset`
    =================  =======================================================  ===============================================

    A call in another phase raises a ValueError with the name of the required phase. If a call that changes the phase fails,
    the instance is freed. Each instance has a separate worker process, with the working folder and the environment
    variables at the time of its creation. A crash of the FMU, or Ctrl-C during a call, ends that process. The call
    raises, and each later call raises a ValueError. Instances do not wait for each other, and the behaviour of the
    FMU is not checked. For reproducible simulations, use `FMUModel`. As a context manager, the instance is closed at
    the end.

    Steps handle events as a simulation does. Clocks with an interval tick when they are due. Set triggered clocks
    yourself (True). If setting an input between two steps moves an event indicator across zero, the event occurs at
    the start of the next step. In a co-simulation with an event mode (FMI 3.0), all inputs except continuous ones
    take effect in that mode: at `handle_events`, or at the start of the next step. Before the initialization, arrays
    may be set with the size that structural parameters will determine.

    Parameters
    ----------
    path : path or FMUModel
        An ``.fmu`` file, an unpacked folder, or a model. The values set in a model are also set in the instance.
    kind : {"auto", "ME", "CS"}
        Model exchange or co-simulation. "auto" selects model exchange if it is available; for an `FMUModel`, it
        selects the kind of the model.
    name : str, optional
        Name of the instance in the FMU's log; default: the name of the model, with `_2`, `_3` and so on in further
        worker processes.
    logging : bool, str or list of str
        If True, the FMU is asked to log. A list restricts logging to these categories.
    visible : bool
        If True, the FMU may show windows.
    isolation : {"none", "process"}, optional
        "process": the FMU runs in a worker process (the default if one can be started). "none": it runs in this
        process, with bit-for-bit identical results. With "none", a call takes less time, and a crash of the FMU ends
        Python.

    Raises
    ------
    OSError, FmuError
        The FMU cannot be read, loaded or instantiated.

    Examples
    --------
    >>> import pydfo
    >>> with pydfo.fmi.instantiate(pydfo.example_fmu("dahlquist")) as instance:
    ...     instance.set("k", 2.0)
    ...     instance.initialize()
    ...     step = instance.do_step(1.0, relative_tolerance=1e-9)
    ...     (step.time, round(instance.get("x"), 6))
    (1.0, 0.135335)
    """

    @explained
    def __init__(
        self,
        path: PathLike | FMUModel,
        kind: str = "auto",
        *,
        name: str | None = None,
        logging: bool | str | Sequence[str] = False,
        visible: bool = False,
        isolation: Literal["none", "process"] | None = None,
    ) -> None:
        has_logging, categories = _log_request(logging)
        values: dict[str, Any] = {}
        if isinstance(path, FMUModel):
            values = dict(path._model.values_set())
            fmu, kind = path._fmu, path.kind if kind == "auto" else kind
        else:
            fmu = _core.Fmu(_values.path("path", path), OpenOptions())
        self._fmu = fmu
        place = None if isolation is None else _values.choice("isolation", isolation)
        self._native = _core.Instance(fmu, kind, name, has_logging, list(categories), _values.flag("visible", visible), place)
        self._time: float | None = None
        if values:
            self.set(values)

    def __reduce__(self) -> NoReturn:
        raise TypeError("an Instance cannot be pickled, because its state is inside the FMU; create one in each process")

    @cached_property
    def description(self) -> Description:
        """Description of the model."""
        return Description(self._fmu)

    @property
    def kind(self) -> str:
        """Interface used to run the model: "ME" or "CS"."""
        return self._native.kind

    @property
    def phase(self) -> str:
        """Current phase; "closed" after the instance was freed."""
        return self._native.phase

    @property
    def next_event(self) -> float | None:
        """Time in s of the next announced time event or of the next tick of a clock; None if there is none."""
        return self._native.next_event

    # --- values -------------------------------------------------------------------------------------------------------

    def get(self, name: str | Iterable[str]) -> Any:
        """Returns values of variables, as `FMUModel.get`, in all phases except "instantiated".

        Raises
        ------
        KeyError
            There is no such variable.
        ValueError
            The phase does not allow the call.
        SimulationError
            The FMU rejects the call.
        """
        if isinstance(name, str):
            return self._native.get([name])[0]
        return self._native.get(_values.names("name", name))

    def set(self, name: str | Iterable[str] | Mapping[str, object], *value: object) -> None:
        """Sets variables that FMI allows to be set in this phase, with the arguments of `FMUModel.set`.

        Raises
        ------
        KeyError, TypeError, ValueError
            There is no such variable, the value does not match it, or it cannot be set in this phase (the message
            states the reason).
        SimulationError
            The FMU rejects the call.
        """
        self._native.set(*names_and_values(name, *value))

    # --- initialization -----------------------------------------------------------------------------------------------

    def enter_initialization(
        self, start_time: SupportsFloat | None = None, stop_time: SupportsFloat | None = None, tolerance: SupportsFloat | None = None
    ) -> None:
        """Sets up the experiment (times in s, relative tolerance) and enters initialization mode.

        The start time defaults to the start time of the default experiment, or 0. A stop time and a tolerance are
        passed to the FMU only if they are given.
        """
        default = self.description.default_experiment.start_time
        start = _values.optional_number("start_time", start_time)
        start = start if start is not None else default if default is not None else 0.0
        stop, rtol = _values.optional_number("stop_time", stop_time), _values.optional_number("tolerance", tolerance)
        self._native.enter_initialization(start, stop, rtol)
        self._time = start

    def exit_initialization(self) -> None:
        """Ends the initialization. Model exchange is then in event mode, co-simulation in step mode."""
        self._native.exit_initialization()

    def initialize(
        self, start_time: SupportsFloat | None = None, stop_time: SupportsFloat | None = None, tolerance: SupportsFloat | None = None
    ) -> EventInfo | None:
        """Initializes the instance: enters and exits initialization mode.

        Initialization mode may already have been entered to set inputs. In model exchange, the initial events are
        handled, and the instance enters continuous time.

        Returns
        -------
        EventInfo or None
            The result of the initial events (model exchange). If the model requests the end of the simulation, the
            instance stays in event mode.
        """
        if self.phase != "initialization":
            self.enter_initialization(start_time, stop_time, tolerance)
        self.exit_initialization()
        return self._settle() if self.kind == "ME" else None

    # --- model exchange -----------------------------------------------------------------------------------------------

    def _settle(self) -> EventInfo:
        info = self.update_discrete_states()
        if not info.terminate:
            self.enter_continuous_time()
        return info

    def update_discrete_states(self) -> EventInfo:
        """Updates the discrete states in event mode until they no longer change, in at most 100 rounds."""
        return EventInfo(**self._native.update_discrete_states())

    def enter_event_mode(self) -> None:
        """Enters event mode, in which discrete inputs can be set."""
        self._native.enter_event_mode()

    def enter_continuous_time(self) -> None:
        """Enters continuous-time mode."""
        self._native.enter_continuous_time()

    @property
    def time(self) -> float | None:
        """Current time of the instance in s; can be set in continuous-time mode. None before the initialization."""
        return self._time

    @time.setter
    def time(self, time: SupportsFloat) -> None:
        number = _values.number("time", time)
        self._native.set_time(number)
        self._time = number

    @property
    def states(self) -> FloatArray:
        """Continuous states; can be set in continuous-time mode."""
        return self._native.states()

    @states.setter
    def states(self, states: npt.ArrayLike) -> None:
        self._native.set_states(_values.vector("states", states).tolist())

    @property
    def state_names(self) -> list[str | None]:
        """Names of the continuous states in their order; None for states that are not variables."""
        return self._native.state_names()

    @property
    def nominals(self) -> FloatArray:
        """Nominal values of the states, as returned by the FMU."""
        return self._native.nominals()

    @property
    def derivatives(self) -> FloatArray:
        """Derivatives of the states with respect to time, per s."""
        return self._native.derivatives()

    @property
    def event_indicators(self) -> FloatArray:
        """Event indicators; a change of sign is a state event."""
        return self._native.event_indicators()

    def completed_integrator_step(self) -> tuple[bool, bool]:
        """Notifies the model that a step is complete.

        Returns two flags: the model requests event mode, and the model requests the end of the simulation."""
        return self._native.completed_integrator_step()

    def directional_derivative(
        self, unknowns: str | Iterable[str], knowns: str | Iterable[str], seed: npt.ArrayLike | None = None
    ) -> FloatArray:
        """Returns the derivative of the variables `unknowns` in the direction `seed` of the variables `knowns`
        (default: ones).

        An array has as many elements in `seed` as it has values.

        Raises
        ------
        FmuError
            The FMU does not provide directional derivatives. `linearize` then uses differences.
        """
        return self._along(unknowns, knowns, seed, False)

    def adjoint_derivative(
        self, unknowns: str | Iterable[str], knowns: str | Iterable[str], seed: npt.ArrayLike | None = None
    ) -> FloatArray:
        """Returns the derivative of the sum of `unknowns`, weighted with `seed` (default: ones), with respect to each
        of `knowns` (FMI 3.0)."""
        return self._along(unknowns, knowns, seed, True)

    def _along(self, unknowns: str | Iterable[str], knowns: str | Iterable[str], seed: npt.ArrayLike | None, adjoint: bool) -> FloatArray:
        of, by = (
            [names] if isinstance(names, str) else _values.names(what, names)
            for what, names in (("unknowns", unknowns), ("knowns", knowns))
        )
        variables = self.description.variables
        size = sum(int(np.prod(variables[name].shape)) for name in (of if adjoint else by))
        along = np.ones(size) if seed is None else _values.vector("seed", np.atleast_1d(np.asarray(seed)))
        return self._native.directional_derivative(of, by, along.tolist(), adjoint)

    def linearize(self, *, differences: bool = False) -> LinearSystem:
        """Returns the linear system at the current point of the instance (continuous-time mode).

        The derivatives are directional derivatives if the model provides them, otherwise central differences. For a
        smooth model, central differences are accurate to about 10 digits.

        Parameters
        ----------
        differences : bool
            If True, always use differences.

        Raises
        ------
        ValueError
            The phase does not allow the call (co-simulation cannot be linearised), or a derivative is not finite.
        """
        found = self._native.linearize(_values.flag("differences", differences))
        n, m, p = (len(found[vector]) for vector in ("states", "inputs", "outputs"))
        shapes = {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)}
        return LinearSystem(**{name: value.reshape(shapes[name]) if name in shapes else value for name, value in found.items()})

    # --- steps --------------------------------------------------------------------------------------------------------

    def do_step(
        self,
        step: SupportsFloat,
        *,
        solver: str = "auto",
        relative_tolerance: SupportsFloat = 1e-6,
        step_size: SupportsFloat | None = None,
    ) -> StepInfo:
        """Advances the instance by `step` s with the current inputs.

        In co-simulation, the model performs the step. If a clock ticks within the step, its events are handled at the
        tick. In model exchange, the step is integrated with a method of `FMUModel.simulate`, and events are
        handled when they occur. From event mode, in which discrete inputs are set, the instance first enters continuous
        time. Each step restarts its method, so many small steps take longer than one simulation.

        Parameters
        ----------
        step : float
            Length of the step in s, positive.
        solver, relative_tolerance, step_size : optional
            As in `FMUModel.simulate` (model exchange only).

        Raises
        ------
        ValueError
            The phase does not allow the call.
        SimulationError
            The integration fails, or the FMU rejects the call.
        """
        length = _values.number("step", step)
        if not (0.0 < length < float("inf")):
            raise ValueError(f"step must be positive, not {length!r}")
        start = self._time if self._time is not None else 0.0
        if self.kind == "CS":
            done = self._native.do_step(start, length)
            reached = done.pop("reached")
            self._time = start + length if done["complete"] and not done["early"] else start if reached is None else reached
            return StepInfo(time=self._time, **done)
        if self.phase == "event" and self._settle().terminate:
            return StepInfo(time=start, complete=False, terminate=True)
        self._time, is_over = self._native.integrate(
            start,
            start + length,
            _options.solver(solver),
            _values.number("relative_tolerance", relative_tolerance),
            _values.optional_number("step_size", step_size),
        )
        return StepInfo(time=self._time, complete=not is_over, terminate=is_over)

    def handle_events(self) -> EventInfo:
        """Handles the events that are due at the end of the last step, and sets the inputs that wait for event mode
        (co-simulation, FMI 3.0)."""
        return EventInfo(**self._native.handle_events(self._time if self._time is not None else 0.0))

    def set_input_derivatives(self, names: str | Iterable[str], values: npt.ArrayLike) -> None:
        """Sets the derivatives of continuous inputs with respect to time, per s, for the next step (co-simulation, FMI 1.0 and 2.0)."""
        inputs = [names] if isinstance(names, str) else _values.names("names", names)
        self._native.set_input_derivatives(inputs, _values.vector("values", np.atleast_1d(np.asarray(values))).tolist())

    # --- states, log, end ---------------------------------------------------------------------------------------------

    def save_state(self) -> SavedState:
        """Returns a copy of the complete state of the instance for `restore_state`.

        It includes the state of the FMU, the time, pending events and ticks, and assigned values that are not yet
        in effect.

        Raises
        ------
        FmuError
            The FMU does not support it (``description.capabilities.can_get_and_set_state``).
        """
        return SavedState(self._native.save_state(), self._time)

    def restore_state(self, state: SavedState) -> None:
        """Restores a state that this instance saved in its current phase."""
        if not isinstance(state, SavedState):
            raise TypeError(f"state must be a result of save_state(), not {_text.show(state)}")
        self._native.restore_state(state._native)
        self._time = state.time

    def set_logging(self, logging: bool | str | Sequence[str] = True) -> None:
        """Switches the FMU's log on (True), off (False), or on for the given categories."""
        has_logging, categories = _log_request(logging)
        self._native.set_logging(has_logging, list(categories))

    @property
    def log(self) -> list[str]:
        """The last lines logged by the FMU, oldest first."""
        return self._native.log()[0]

    def terminate(self) -> None:
        """Ends the simulation. Values can still be read."""
        self._native.terminate()

    def reset(self) -> None:
        """Returns the instance to the phase "instantiated", in which all variables have their start values."""
        self._native.reset()
        self._time = None

    def close(self) -> None:
        """Frees the instance."""
        self._native.close()

    def __enter__(self) -> Instance:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self.close()

    def __repr__(self) -> str:
        at = "" if self._time is None else f" at {self._time:g} s"
        return _text.line(f"<Instance: {self.description.model_name}, FMI {self.description.fmi_version} {self.kind}, {self.phase}{at}>")


@dataclass(frozen=True)
class SavedState:
    """A state of an `Instance`.

    Attributes
    ----------
    time : float or None
        Time in s at which the state was saved.
    """

    _native: _core.SavedState
    time: float | None


def instantiate(
    path: PathLike | FMUModel,
    kind: str = "auto",
    *,
    name: str | None = None,
    logging: bool | str | Sequence[str] = False,
    visible: bool = False,
    isolation: Literal["none", "process"] | None = None,
) -> Instance:
    """Creates an `Instance` of an FMU. **This loads its library and runs its code.** The arguments are the same
    as for `Instance`."""
    return Instance(path, kind, name=name, logging=logging, visible=visible, isolation=isolation)
