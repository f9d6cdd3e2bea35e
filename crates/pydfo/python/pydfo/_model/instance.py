"""One instance of an FMU, driven by hand: the functions of FMI one by one, and steps."""

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
    """What an event iteration has done.

    Attributes
    ----------
    states_changed, nominals_changed : bool
        Whether states, or their nominal values, have changed.
    terminate : bool
        The model wants to end the simulation.
    next_time : float or None
        The next time event in s; None if there is none.
    """

    states_changed: bool
    nominals_changed: bool
    terminate: bool
    next_time: float | None


@dataclass(frozen=True)
class StepInfo:
    """What came of a step.

    Attributes
    ----------
    time : float
        Where the instance stands now, in s.
    complete : bool
        It stands at the end of the step.
    terminate : bool
        The model wants to end the simulation here.
    event : bool
        Co-simulation with an event mode (FMI 3.0): the model asks for `Instance.handle_events`, or a clock is due. What is not
        handled then is handled at the start of the next step.
    early : bool
        Co-simulation (FMI 3.0): the model has returned early.
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
        Of shapes (states, states), (states, inputs), (outputs, states), (outputs, inputs); in the units of the model.
    states, inputs, outputs : list of str
        Names; elements of arrays one by one. Inputs and outputs are those of type Real that are continuous.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    states: list[str]
    inputs: list[str]
    outputs: list[str]


class Instance:
    """An instance of an FMU that is driven by hand.

    It is always in one `phase`, and each phase has the calls that FMI allows in it:

    =================  =======================================================  ===============================================
    phase              calls                                                    leads on with
    =================  =======================================================  ===============================================
    "instantiated"     `set` (parameters, start values)                         `enter_initialization`, `initialize`
    "initialization"   `get`, `set` (inputs)                                    `exit_initialization`
    "event" (ME)       `get`, `set` (inputs), `update_discrete_states`          `enter_continuous_time`, `terminate`
    "continuous" (ME)  `get`, `set` (continuous inputs), `time`, `states`,      `enter_event_mode`, `do_step`, `terminate`
                       `derivatives`, `event_indicators`, `linearize`
    "step" (CS)        `get`, `set` (inputs), `do_step`, `handle_events`        `terminate`
    "terminated"       `get`                                                    `reset`
    =================  =======================================================  ===============================================

    A call in another phase is a ValueError that names the phase it needs. Where a call that leads to another phase fails, the
    instance is freed. Each instance has a worker process of its own, with the working folder and the environment variables of the
    moment when it is made. A crash of the FMU, or a Ctrl-C during a call, ends that process: the call raises, and each later one
    is a ValueError. Instances do not wait for each other, and nothing of the FMU is checked: for simulations that shall be
    the same each time, use `FMUModel`. As a context manager the instance is closed at the end.

    Steps handle events as a simulation does. Clocks with an interval tick when they are due; triggered ones are set by hand
    (True). An event indicator that an input takes across zero, set between two steps, is an event at the start of the next one.
    Between two steps of a co-simulation with an event mode (FMI 3.0) all but continuous inputs wait for that mode: for
    `handle_events`, or the start of the next step. Before the initialization an array may be given the size that structural
    parameters will give it.

    Parameters
    ----------
    path : path or FMUModel
        An ``.fmu`` file, an unpacked folder, or a model: then the values that are set in it are set in the instance.
    kind : {"auto", "ME", "CS"}
        Model exchange or co-simulation; "auto" takes model exchange where it is offered (of an `FMUModel` its kind).
    name : str, optional
        Name of the instance in the FMU's log; default: that of the model, with `_2`, `_3` and so on in further worker processes.
    logging : bool, str or list of str
        The FMU is asked to log; names: of these categories only.
    visible : bool
        The FMU may show windows.
    isolation : {"none", "process"}, optional
        Where the FMU runs: in a worker process (the default where one can be started), or in this process, with the same bits.
        With "none" a call takes less time, and a crash of the FMU ends Python.

    Raises
    ------
    OSError, FmuError
        The FMU cannot be read, loaded, or instantiated.

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
        is_asked, categories = _log_request(logging)
        values: dict[str, Any] = {}
        if isinstance(path, FMUModel):
            values = dict(path._model.values_set())
            fmu, kind = path._fmu, path.kind if kind == "auto" else kind
        else:
            fmu = _core.Fmu(_values.path("path", path), OpenOptions())
        self._fmu = fmu
        place = None if isolation is None else _values.choice("isolation", isolation)
        self._native = _core.Instance(fmu, kind, name, is_asked, list(categories), _values.flag("visible", visible), place)
        self._time: float | None = None
        if values:
            self.set(values)

    def __reduce__(self) -> NoReturn:
        raise TypeError("an Instance cannot be pickled, because its state is inside of the FMU: make one in each process")

    @cached_property
    def description(self) -> Description:
        """The model description."""
        return Description(self._fmu)

    @property
    def kind(self) -> str:
        """How it is run: "ME" or "CS"."""
        return self._native.kind

    @property
    def phase(self) -> str:
        """The phase it is in; "closed" after it was freed."""
        return self._native.phase

    @property
    def next_event(self) -> float | None:
        """The next time event in s that the model has announced, or tick of one of its clocks; None if there is none."""
        return self._native.next_event

    # --- values -------------------------------------------------------------------------------------------------------

    def get(self, name: str | Iterable[str]) -> Any:
        """Values of variables, as `FMUModel.get` returns them; in all phases but "instantiated".

        Raises
        ------
        KeyError
            There is no such variable.
        ValueError
            The phase is another one.
        SimulationError
            The FMU refuses.
        """
        if isinstance(name, str):
            return self._native.get([name])[0]
        return self._native.get(_values.names("name", name))

    def set(self, name: str | Iterable[str] | Mapping[str, object], *value: object) -> None:
        """Sets variables, given as for `FMUModel.set`; those that FMI allows to be set in this phase.

        Raises
        ------
        KeyError, TypeError, ValueError
            There is no such variable, the value does not fit it, or it cannot be set in this phase (the message says why).
        SimulationError
            The FMU refuses.
        """
        self._native.set(*names_and_values(name, *value))

    # --- initialization -----------------------------------------------------------------------------------------------

    def enter_initialization(
        self, start_time: SupportsFloat | None = None, stop_time: SupportsFloat | None = None, tolerance: SupportsFloat | None = None
    ) -> None:
        """Sets the experiment up (times in s, relative tolerance) and enters initialization mode.

        The start time is by default that of the default experiment, else 0; the FMU is told of a stop time and a tolerance only
        if they are given.
        """
        default = self.description.default_experiment.start_time
        start = _values.optional_number("start_time", start_time)
        start = start if start is not None else default if default is not None else 0.0
        stop, rtol = _values.optional_number("stop_time", stop_time), _values.optional_number("tolerance", tolerance)
        self._native.enter_initialization(start, stop, rtol)
        self._time = start

    def exit_initialization(self) -> None:
        """Ends the initialization: model exchange is in event mode then, co-simulation in step mode."""
        self._native.exit_initialization()

    def initialize(
        self, start_time: SupportsFloat | None = None, stop_time: SupportsFloat | None = None, tolerance: SupportsFloat | None = None
    ) -> EventInfo | None:
        """Initializes: enters and exits initialization mode (which may have been entered before, for inputs to be set in), and
        in model exchange lets the initial events happen and goes on in continuous time.

        Returns
        -------
        EventInfo or None
            What the initial events have done (model exchange). If the model wants to end the simulation, it stays in event mode.
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
        """Lets the discrete states settle (event mode): as many rounds as that takes, at most 100."""
        return EventInfo(**self._native.update_discrete_states())

    def enter_event_mode(self) -> None:
        """Enters event mode, where discrete inputs can be set."""
        self._native.enter_event_mode()

    def enter_continuous_time(self) -> None:
        """Enters continuous-time mode."""
        self._native.enter_continuous_time()

    @property
    def time(self) -> float | None:
        """The time in s at which the instance stands; can be set in continuous-time mode. None before the initialization."""
        return self._time

    @time.setter
    def time(self, time: SupportsFloat) -> None:
        number = _values.number("time", time)
        self._native.set_time(number)
        self._time = number

    @property
    def states(self) -> FloatArray:
        """The continuous states; can be set in continuous-time mode."""
        return self._native.states()

    @states.setter
    def states(self, states: npt.ArrayLike) -> None:
        self._native.set_states(_values.vector("states", states).tolist())

    @property
    def state_names(self) -> list[str | None]:
        """Names of the continuous states in their order; None for those that are no variables."""
        return self._native.state_names()

    @property
    def nominals(self) -> FloatArray:
        """Nominal values of the states, as the FMU gives them."""
        return self._native.nominals()

    @property
    def derivatives(self) -> FloatArray:
        """Derivatives of the states with respect to time, per s."""
        return self._native.derivatives()

    @property
    def event_indicators(self) -> FloatArray:
        """The event indicators: a change of sign is a state event."""
        return self._native.event_indicators()

    def completed_integrator_step(self) -> tuple[bool, bool]:
        """Tells the model that a step is completed. Returns whether it wants to enter event mode, and whether it wants to end
        the simulation."""
        return self._native.completed_integrator_step()

    def directional_derivative(
        self, unknowns: str | Iterable[str], knowns: str | Iterable[str], seed: npt.ArrayLike | None = None
    ) -> FloatArray:
        """Derivative of the variables `unknowns` in the direction `seed` of the variables `knowns` (default: ones); an array has
        as many elements in `seed` as it has values.

        Raises
        ------
        FmuError
            The FMU provides none (`linearize` makes differences then).
        """
        return self._along(unknowns, knowns, seed, False)

    def adjoint_derivative(
        self, unknowns: str | Iterable[str], knowns: str | Iterable[str], seed: npt.ArrayLike | None = None
    ) -> FloatArray:
        """Derivative of the sum of `unknowns`, weighted with `seed` (default: ones), with respect to each of `knowns` (FMI 3.0)."""
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
        """The linear system at the point where the instance stands (continuous-time mode), by directional derivatives of the
        model where it provides them, else by central differences: there about 10 digits are right where the model is smooth.

        Parameters
        ----------
        differences : bool
            Make differences in any case.

        Raises
        ------
        ValueError
            The phase is another one (co-simulation has none that can be linearised), or a derivative is not finite here.
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
        """Goes on by `step` s, with the inputs as they are.

        Co-simulation lets the model make the step; where a clock ticks within it, its events happen there. Model exchange integrates it with a method of `FMUModel.simulate` and handles
        the events on the way; from event mode, where discrete inputs are set, it goes on in continuous time first. Each step
        starts its method anew, so many small steps take longer than one simulation.

        Parameters
        ----------
        step : float
            In s, positive.
        solver, relative_tolerance, step_size : optional
            As for `FMUModel.simulate` (model exchange only).

        Raises
        ------
        ValueError
            The instance is in another phase.
        SimulationError
            The integration fails, or the FMU refuses.
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
        """Lets the events happen that are due at the end of the last step, and sets the inputs that wait for them
        (co-simulation, FMI 3.0)."""
        return EventInfo(**self._native.handle_events(self._time if self._time is not None else 0.0))

    def set_input_derivatives(self, names: str | Iterable[str], values: npt.ArrayLike) -> None:
        """Sets the derivatives of continuous inputs with respect to time, per s, for the next step (co-simulation, FMI 1.0 and 2.0)."""
        inputs = [names] if isinstance(names, str) else _values.names("names", names)
        self._native.set_input_derivatives(inputs, _values.vector("values", np.atleast_1d(np.asarray(values))).tolist())

    # --- states, log, end ---------------------------------------------------------------------------------------------

    def save_state(self) -> SavedState:
        """A copy of the complete state of the instance, for `restore_state`: that of the FMU, the time, the events and ticks
        to come, and values that were set and are not in effect yet.

        Raises
        ------
        FmuError
            The FMU cannot (``description.capabilities.can_get_and_set_state``).
        """
        return SavedState(self._native.save_state(), self._time)

    def restore_state(self, state: SavedState) -> None:
        """Brings back a state that this instance saved in the phase that it is in now."""
        if not isinstance(state, SavedState):
            raise TypeError(f"state must be one that save_state() gave, not {_text.show(state)}")
        self._native.restore_state(state._native)
        self._time = state.time

    def set_logging(self, logging: bool | str | Sequence[str] = True) -> None:
        """Switches the FMU's log on (True), off (False), or on for some categories by their names."""
        is_asked, categories = _log_request(logging)
        self._native.set_logging(is_asked, list(categories))

    @property
    def log(self) -> list[str]:
        """The last lines that the FMU logged, oldest first."""
        return self._native.log()[0]

    def terminate(self) -> None:
        """Ends the simulation; values can be read afterwards."""
        self._native.terminate()

    def reset(self) -> None:
        """Brings the instance back to the phase "instantiated", where all variables have their start values."""
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
        The time in s at which it was saved.
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
    """Makes an `Instance` of an FMU; **this loads its library and runs its code**. The arguments are those of `Instance`."""
    return Instance(path, kind, name=name, logging=logging, visible=visible, isolation=isolation)
