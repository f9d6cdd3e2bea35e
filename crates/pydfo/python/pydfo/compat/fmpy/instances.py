"""Instances with FMPy's methods: variables by value reference, and calls that change the phase."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..._model.instance import Instance, SavedState
from .._refused import refused


def _vector(target: Any, n: int) -> np.ndarray[Any, Any]:
    """Returns the numbers of a caller's array or ctypes pointer."""
    if isinstance(target, np.ndarray):
        return target[:n]
    return np.ctypeslib.as_array(ctypes.cast(target, ctypes.POINTER(ctypes.c_double)), (n,))


def _accessors(kind: str) -> tuple[Any, Any]:
    def get(self: Any, vr: Sequence[int], nValues: int | None = None) -> list[Any]:
        values: list[Any] = self._get(kind, vr)
        # FMPy returns ctypes strings, which only its class of FMI 3.0 decodes.
        is_bytes = kind == "String" and self._instance.description.fmi_version[0] < "3"
        return [text.encode() for text in values] if is_bytes else values

    def set(self: Any, vr: Sequence[int], value: Sequence[Any] | None = None, values: Sequence[Any] | None = None) -> None:
        given = value if value is not None else values
        self._set(kind, vr, given if given is not None else [])

    get.__doc__ = f"Values of variables of type {kind} by value reference."
    set.__doc__ = f"Sets variables of type {kind} by value reference."
    return get, set


class _Instance:
    """Common part of both kinds of instances."""

    KIND = "ME"

    def __init__(
        self, guid: str | None = None, unzipDirectory: str | os.PathLike[str] = "", modelIdentifier: str | None = None, instanceName: str | None = None, **more: Any
    ) -> None:
        self.guid, self.unzipDirectory, self.modelIdentifier, self.instanceName = guid, unzipDirectory, modelIdentifier, instanceName
        self._made: Instance | None = None
        self._names: dict[tuple[str, int], str] = {}
        self._experiment: tuple[float | None, float | None, float | None] = (0.0, None, None)

    @property
    def _instance(self) -> Instance:
        if self._made is None:
            raise ValueError("no instance exists; call instantiate() first")
        return self._made

    def instantiate(self, visible: bool = False, callbacks: Any = None, loggingOn: bool = False, **more: Any) -> None:
        """Creates the instance; `callbacks` have no effect."""
        self._made = Instance(os.fspath(self.unzipDirectory), self.KIND, name=self.instanceName, logging=bool(loggingOn), visible=bool(visible))
        types = {"Enumeration": "Integer"} if self._made.description.fmi_version[0] < "3" else {"Real": "Float64", "Integer": "Int32", "Enumeration": "Int64"}
        self._names.clear()
        for name, v in self._made.description.variables.items():
            self._names.setdefault((types.get(v.type, v.type), v.value_reference), name)

    def _get(self, kind: str, vr: Sequence[int]) -> list[Any]:
        values = self._instance.get([self._name(kind, reference) for reference in vr])
        return [item for value in values for item in (value.ravel().tolist() if isinstance(value, np.ndarray) else [value])]

    def _set(self, kind: str, vr: Sequence[int], values: Sequence[Any]) -> None:
        rest = list(values)
        names = [self._name(kind, reference) for reference in vr]
        sizes = [int(np.prod(self._instance.description.variables[name].shape)) for name in names]
        if len(rest) != sum(sizes):
            raise ValueError(f"got {len(rest)} values for the {sum(sizes)} elements of the variables {', '.join(names)}")
        for name, n in zip(names, sizes):
            given, rest = rest[:n], rest[n:]
            value = given if self._instance.description.variables[name].shape else given[0]
            self._instance.set(name, bool(value) if kind == "Boolean" and not isinstance(value, list) else value)

    def _name(self, kind: str, reference: int) -> str:
        try:
            return self._names[kind, int(reference)]
        except KeyError:
            raise KeyError(f"the model has no variable of type {kind} with the value reference {reference}") from None

    def setupExperiment(self, tolerance: float | None = None, startTime: float = 0.0, stopTime: float | None = None) -> None:
        """Sets times in s and relative tolerance of the experiment."""
        self._experiment = (startTime, stopTime, tolerance)

    def enterInitializationMode(self, tolerance: float | None = None, startTime: float | None = None, stopTime: float | None = None) -> None:
        """Enters initialization mode."""
        start, stop, rtol = self._experiment
        self._instance.enter_initialization(
            start if startTime is None else startTime, stop if stopTime is None else stopTime, rtol if tolerance is None else tolerance
        )

    def exitInitializationMode(self) -> None:
        """Ends the initialization."""
        self._instance.exit_initialization()

    def terminate(self) -> None:
        """Ends the simulation."""
        self._instance.terminate()

    def reset(self) -> None:
        """Resets the instance to its initial phase."""
        self._instance.reset()

    def freeInstance(self) -> None:
        """Frees the instance."""
        if self._made is not None:
            self._made.close()
            self._made = None

    def getFMUstate(self) -> SavedState:
        """Returns a copy of the state."""
        return self._instance.save_state()

    def setFMUstate(self, state: SavedState) -> None:
        """Restores a state."""
        self._instance.restore_state(state)

    def freeFMUstate(self, state: SavedState) -> None:
        """Does nothing, because a state is freed when it is no longer referenced."""

    getFMUState, setFMUState, freeFMUState = getFMUstate, setFMUstate, freeFMUstate

    def getVersion(self) -> str:
        """Returns the version of FMI."""
        return self._instance.description.fmi_version

    def getTypesPlatform(self) -> str:
        """Returns the platform name of FMI."""
        return "standard32" if self.getVersion() == "1.0" else "default"

    def setDebugLogging(self, loggingOn: bool, categories: Sequence[str] = ()) -> None:
        """Switches the FMU's log on or off."""
        self._instance.set_logging(list(categories) if loggingOn and categories else bool(loggingOn))

    def getDirectionalDerivative(self, vUnknown_ref: Sequence[int], vKnown_ref: Sequence[int], dvKnown: Sequence[float], dvUnknown: Any = None) -> list[float]:
        """Returns derivatives of reals in a direction."""
        kind = "Float64" if self._instance.description.fmi_version[0] == "3" else "Real"
        of, by = ([self._name(kind, reference) for reference in vr] for vr in (vUnknown_ref, vKnown_ref))
        return [float(value) for value in self._instance.directional_derivative(of, by, dvKnown)]

    getReal, setReal = _accessors("Real")
    getInteger, setInteger = _accessors("Integer")
    getBoolean, setBoolean = _accessors("Boolean")
    getString, setString = _accessors("String")
    getFloat32, setFloat32 = _accessors("Float32")
    getFloat64, setFloat64 = _accessors("Float64")
    getInt8, setInt8 = _accessors("Int8")
    getUInt8, setUInt8 = _accessors("UInt8")
    getInt16, setInt16 = _accessors("Int16")
    getUInt16, setUInt16 = _accessors("UInt16")
    getInt32, setInt32 = _accessors("Int32")
    getUInt32, setUInt32 = _accessors("UInt32")
    getInt64, setInt64 = _accessors("Int64")
    getUInt64, setUInt64 = _accessors("UInt64")
    getBinary, setBinary = _accessors("Binary")
    getClock, setClock = _accessors("Clock")
    serializeFMUstate = serializeFMUState = refused("serializeFMUState", "states are valid only in their instance; use getFMUState() and setFMUState()")
    deSerializeFMUstate = deserializeFMUState = refused("deserializeFMUState", "states are valid only in their instance; use getFMUState() and setFMUState()")


class Model(_Instance):
    """An instance for model exchange."""

    def enterEventMode(self) -> None:
        """Enters event mode."""
        if self._instance.phase != "event":
            self._instance.enter_event_mode()

    def enterContinuousTimeMode(self) -> None:
        """Enters continuous-time mode."""
        self._instance.enter_continuous_time()

    def newDiscreteStates(self) -> tuple[bool, bool, bool, bool, bool, float]:
        """Updates the discrete states until they no longer change.

        The first of FMPy's six values, which requests another round, is therefore False."""
        info = self._instance.update_discrete_states()
        return False, info.terminate, info.nominals_changed, info.states_changed, info.next_time is not None, info.next_time or 0.0

    updateDiscreteStates = newDiscreteStates

    def completedIntegratorStep(self, noSetFMUStatePriorToCurrentPoint: bool = True) -> tuple[bool, bool]:
        """Returns two flags: the model requests event mode, and the model requests the end of the simulation."""
        return self._instance.completed_integrator_step()

    def setTime(self, time: float) -> None:
        """Sets the time in s."""
        self._instance.time = time

    def getContinuousStates(self, x: Any, nx: int) -> None:
        """Writes the states to `x`, an array or a pointer."""
        _vector(x, nx)[:] = self._instance.states

    def setContinuousStates(self, x: Any, nx: int) -> None:
        """Sets the states from `x`, an array or a pointer."""
        self._instance.states = _vector(x, nx).copy()

    def getDerivatives(self, dx: Any, nx: int) -> None:
        """Writes the derivatives of the states to `dx`, an array or a pointer."""
        _vector(dx, nx)[:] = self._instance.derivatives

    getContinuousStateDerivatives = getDerivatives

    def getEventIndicators(self, z: Any, nz: int) -> None:
        """Writes the event indicators to `z`, an array or a pointer."""
        _vector(z, nz)[:] = self._instance.event_indicators

    def getNominalsOfContinuousStates(self, x_nominal: Any, nx: int) -> None:
        """Writes the nominal values to `x_nominal`, an array or a pointer."""
        _vector(x_nominal, nx)[:] = self._instance.nominals


class Slave(_Instance):
    """An instance for co-simulation."""

    KIND = "CS"

    def doStep(self, currentCommunicationPoint: float, communicationStepSize: float, noSetFMUStatePriorToCurrentPoint: bool = True) -> Any:
        """Performs a step from a time to a later one, in s.

        For FMI 3.0, returns three flags and the time reached. The flags are event, request of the end, and early
        return."""
        self._instance._time = float(currentCommunicationPoint)
        done = self._instance.do_step(communicationStepSize)
        if self._instance.description.fmi_version[0] == "3":
            return done.event, done.terminate, done.early, done.time
        return None

    def setRealInputDerivatives(self, vr: Sequence[int], order: Sequence[int], value: Sequence[float]) -> None:
        """Sets the first derivatives of inputs."""
        self._instance.set_input_derivatives([self._name("Real", reference) for reference in vr], value)

    getRealOutputDerivatives = getOutputDerivatives = refused("getRealOutputDerivatives", "unsupported; differentiate the result")
    cancelStep = refused("cancelStep", "steps are blocking")
    getStatus = refused("getStatus", "steps are blocking; a rejected call raises SimulationError with .status")
