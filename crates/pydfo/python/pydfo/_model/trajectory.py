"""Results of simulations."""

from __future__ import annotations

import csv
import os
from collections.abc import Iterable, Iterator, KeysView, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, overload

import numpy as np
import numpy.typing as npt

from .. import _core
from .._args import optional_libraries as _optional_libraries
from .._args import text as _text
from .._errors import UnknownVariableError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FloatArray = npt.NDArray[np.float64]

Column = npt.NDArray[Any]

_DTYPES: dict[str, np.dtype[Any]] = {kind: np.dtype(name) for kind, name in _core.dtypes().items()}
"""NumPy's type of the values of each kind of variable."""


@dataclass(frozen=True)
class SimulationStats:
    """Computational cost of a simulation, or of all simulations of a fit. Two objects are equal if their counts are
    equal.

    Attributes
    ----------
    runs : int
        Number of simulations counted here.
    accepted_steps, rejected_steps : int
    right_hand_sides, event_indicators : int
        Number of evaluations, including the right-hand sides for difference quotients of a Jacobian.
    jacobians, directional_derivatives : int
        Number of Jacobians, and of directional derivatives requested from the model.
    decompositions : int
        Number of matrix decompositions. Radau5 computes two at a time, a real and a complex one.
    newton_iterations : int
    samples : int
        Number of rows.
    events : int
        Number of times event mode was entered after the start. The following four counts list the causes; one entry
        may have several causes.
    state_events, time_events, step_events, input_events : int
    restarts : int
        Number of restarts of the method after events that changed a value.
    chattering : int
        Number of times state events followed each other while time hardly advanced and the run continued.
    check_runs, check_steps, check_right_hand_sides : int
        Additional simulations with their steps and right-hand sides. Short ones check how the model can be reset.
        After a fit, one repeats the best point in a fresh worker. They are included only in `seconds`.
    seconds : float
        Wall-clock time in s, from resetting the model. Loading the model and waiting for its other simulations are
        not included. For a fit, the sum over all simulations. With several workers, it exceeds the duration of the
        fit.
    seconds_in_model : float
        Part of `seconds` spent inside the model: in the calls of the FMU, or of the functions given to
        `pydfo.ode.solve`. It is at most the run time minus the time of input functions. It is an estimate: if calls
        take less than 1 us, one of 61 is timed and represents all.
    phases : dict
        Cost of each phase of a fit, as ``{"simulations": .., "right_hand_sides": .., "seconds": ..}`` (wall-clock
        time). The phases are ``model_test``, ``preflight``, ``search``, ``checks`` (of the result), ``fresh_process``
        and ``uncertainty`` (standard errors: two simulations for each parameter). The simulations of `check_runs` are
        not included, but their time is.
    """

    runs: int
    accepted_steps: int
    rejected_steps: int
    right_hand_sides: int
    jacobians: int
    directional_derivatives: int
    decompositions: int
    newton_iterations: int
    event_indicators: int
    samples: int
    events: int
    state_events: int
    time_events: int
    step_events: int
    input_events: int
    restarts: int
    chattering: int
    check_runs: int = field(compare=False)
    check_steps: int = field(compare=False)
    check_right_hand_sides: int = field(compare=False)
    seconds: float = field(compare=False)
    seconds_in_model: float = field(compare=False)
    phases: dict[str, dict[str, float]] = field(default_factory=dict, compare=False)


class SimulationResult(Mapping[str, Column]):
    """The result of a simulation: columns by name, including ``res["time"]``.

    A mapping of the names of variables to arrays of shape (rows,). Numbers are float64, also for Integers and
    Booleans. `to_structured` and `to_dataframe` return them with their types. 64-bit integers, which may not be
    representable as floats, are int64 or uint64. Strings are arrays of str, and binary variables arrays of bytes
    (dtype object). The extents of an array of the model are further axes. For a 2 x 3 matrix, ``res["A"]`` has the
    shape (rows, 2, 3), and its element ``res["A[1,2]"]`` (counted from 1) has the shape (rows,). At the time of an
    event, a row contains the values after the event. A time requested twice, and with ``record_events=True`` every
    event, has two rows: the limit from the left, then the values after the event.

    Attributes
    ----------
    time : ndarray, shape (rows,)
        Times in the time unit of the model (``units["time"]``), usually s.
    left_limit : ndarray of bool, shape (rows,)
        True if a row contains the limit from the left.
    termination : {"finished", "stopped-by-model"}
        "finished" if the final time was reached, "stopped-by-model" if the model requested the end.
    end_time : float
        End time.
    """

    def __init__(
        self,
        *,
        time: FloatArray,
        names: list[str],
        columns: list[list[Column]],
        extents: list[list[int]],
        types: list[str],
        units: list[str | None],
        time_unit: str,
        left: npt.NDArray[np.bool_],
        event_times: FloatArray,
        event_kinds: list[str],
        tick_times: list[float],
        tick_clocks: list[str],
        stats: dict[str, Any],
        termination: str,
        end_time: float,
    ) -> None:
        self.time = time
        self.left_limit = left
        self.termination = termination
        self.end_time = end_time
        # Converted on first access, because the conversion takes as long as a short simulation.
        self._event_times, self._event_kinds, self._stats = event_times, event_kinds, stats
        self._tick_times, self._tick_clocks = tick_times, tick_clocks
        self._names, self._type_names, self._unit_names, self._time_unit = names, types, units, time_unit
        self._columns: dict[str, Column] = {"time": time}
        # Names of the elements of each array, with their columns.
        self._elements: dict[str, dict[str, Column]] = {}
        for name, parts, shape in zip(names, columns, extents):
            if not shape:
                self._columns[name] = parts[0]
                continue
            whole = np.stack(parts, axis=-1) if parts else np.empty((len(time), 0), dtype=np.float64)
            self._columns[name] = whole.reshape(len(time), *shape)
            indices = (",".join(str(i + 1) for i in index) for index in np.ndindex(*shape))
            self._elements[name] = {f"{name}[{index}]": part for index, part in zip(indices, parts)}

    @cached_property
    def _types(self) -> dict[str, str]:
        return {"time": "Real", **dict(zip(self._names, self._type_names))}

    @cached_property
    def units(self) -> dict[str, str | None]:
        """Units of the variables by name; None if the model does not declare one."""
        return {"time": self._time_unit, **dict(zip(self._names, self._unit_names))}

    @cached_property
    def ticks(self) -> dict[str, FloatArray]:
        """Times in s of the ticks of each clock of the model (FMI 3.0) that ticked."""
        ticks: dict[str, list[float]] = {}
        for clock, tick in zip(self._tick_clocks, self._tick_times):
            ticks.setdefault(clock, []).append(tick)
        return {clock: np.array(times) for clock, times in ticks.items()}

    @cached_property
    def events(self) -> np.recarray[Any, Any]:
        """The events after the start, with fields ``time`` and ``kind``.

        The kind is "state", "time", "step", "input", or several of them joined by a plus sign."""
        events = np.empty(len(self._event_times), dtype=[("time", np.float64), ("kind", "U21")])
        events["time"] = self._event_times
        events["kind"] = self._event_kinds
        return events.view(np.recarray)

    @cached_property
    def stats(self) -> SimulationStats:
        """Computational cost of the simulation."""
        return SimulationStats(**self._stats)

    def __getitem__(self, name: str) -> Column:
        try:
            return self._columns[name] if name in self._columns else self._elements[_array_of(name)][name]
        except KeyError:
            raise UnknownVariableError(self._missing(name)) from None

    def __contains__(self, name: object) -> bool:
        return name in self._columns or (isinstance(name, str) and name in self._elements.get(_array_of(name), ()))

    def _flat(self, names: Iterable[str]) -> Iterator[tuple[str, str, Column]]:
        """Yields name, variable and values of the columns of `names`, with arrays split into elements."""
        for name in names:
            variable = name if name in self._columns else _array_of(name)
            if name in self._elements:
                for element, column in self._elements[name].items():
                    yield element, name, column
            else:
                yield name, variable, self[name]

    def _missing(self, name: object) -> str:
        import difflib

        nearest = difflib.get_close_matches(str(name), self._columns, n=3)
        hint = f"; did you mean {_text.names(nearest)}?" if nearest else "."
        names = list(self._columns)
        shown = _text.names(names[:20]) + (", ..." if len(names) > 20 else "")
        return f'"{_text.line(str(name))}" was not recorded{hint} Recorded variables: {shown}; select others with simulate(outputs=[...])'

    def keys(self) -> KeysView[str]:
        """Returns the names of the variables, "time" first. Arrays are listed without their elements."""
        return self._columns.keys()

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    def __repr__(self) -> str:
        ended = "" if self.termination == "finished" else ", stopped by the model"
        return (
            f"<SimulationResult: {len(self.time)} rows of {len(self) - 1} variables up to {self.end_time:g} s{ended}, "
            f"{len(self.events)} events>"
        )

    @overload
    def final(self, name: str) -> Any: ...
    @overload
    def final(self, name: Sequence[str]) -> list[Any]: ...
    def final(self, name: str | Sequence[str]) -> Any:
        """Returns the value in the last row, NaN if there is none; a list of values for a list of names.

        The value is a float, int for 64-bit integers, str for strings, bytes for binary variables, or an array for
        arrays."""
        if not isinstance(name, str):
            return [self.final(one) for one in name]
        column = self[name]
        if not len(column):
            return float("nan")
        last = column[-1]
        return last.item() if isinstance(last, np.generic) else last

    def to_structured(self) -> npt.NDArray[np.void]:
        """Returns a structured array of shape (rows,) with a field per variable, ``time`` first.

        Integers and Booleans have their types. Strings and bytes are objects. Fields of arrays have their extents."""
        fields = [(name, _DTYPES[self._types[name]], column.shape[1:]) for name, column in self.items()]
        array = np.empty(len(self.time), dtype=fields)
        for name, column in self.items():
            array[name] = column
        return array

    def to_dataframe(self) -> Any:
        """Returns a pandas.DataFrame with a column per variable, or per element of an array, ``time`` first.

        Integers and Booleans have their types. Needs pandas."""
        columns = self._flat(self)
        return _optional_libraries.pandas().DataFrame({name: column.astype(_DTYPES[self._types[variable]]) for name, variable, column in columns})

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Writes the columns to a CSV file, with arrays split into elements and all digits of numbers.

        An existing file is replaced.

        Raises
        ------
        OSError
            The file cannot be written.
        """
        columns = [(name, column.astype(_DTYPES[self._types[variable]]).tolist()) for name, variable, column in self._flat(self)]
        with open(path, "w", newline="", encoding="utf-8") as file:
            rows = csv.writer(file, lineterminator="\n")
            rows.writerow([name for name, _ in columns])
            rows.writerows(zip(*(column for _, column in columns)))

    def to_polars(self) -> Any:
        """Returns a polars.DataFrame with a column per variable, or per element of an array, ``time`` first. Needs
        polars."""
        columns = self._flat(self)
        frame = _optional_libraries.library("polars", "to_polars()").DataFrame
        return frame({name: column.astype(_DTYPES[self._types[variable]]) for name, variable, column in columns})

    def to_xarray(self) -> Any:
        """Returns an xarray.Dataset over ``time`` with the units as attributes. Arrays of the model have separate
        dimensions.

        Needs xarray."""
        data = {
            name: (("time", *(f"{name}_{axis}" for axis in range(1, column.ndim))), column, {"units": self.units[name] or ""})
            for name, column in self.items()
            if name != "time"
        }
        return _optional_libraries.library("xarray", "to_xarray()").Dataset(data, coords={"time": ("time", self.time, {"units": self._time_unit})})

    def plot(self, names: str | Sequence[str] | None = None) -> Figure:
        """Draws columns over time, with one plot per unit. Needs matplotlib.

        Parameters
        ----------
        names : str or sequence of str, optional
            The columns; default: all except strings and binary variables. All elements of an array are drawn.

        Returns
        -------
        matplotlib.figure.Figure

        Raises
        ------
        KeyError
            A name was not recorded.
        ValueError
            A string or a binary variable was requested.
        """
        from .._plot import pyplot

        plt = pyplot()
        drawable = [name for name in self if name != "time" and _DTYPES[self._types[name]] != np.object_]
        chosen = drawable if names is None else [names] if isinstance(names, str) else list(names)
        groups: dict[str | None, list[tuple[str, str, Column]]] = {}
        for name, variable, column in self._flat(chosen):
            if column.dtype == np.object_:
                raise ValueError(f"{_text.line(name)} is of type {self._types[variable]} and cannot be plotted")
            groups.setdefault(self.units[variable], []).append((name, variable, column))
        figure: Figure
        figure, plots = plt.subplots(max(len(groups), 1), 1, sharex=True, squeeze=False, layout="constrained")
        for axes, (unit, members) in zip(plots[:, 0], groups.items()):
            for name, variable, column in members:
                held = self._types[variable] not in ("Real", "Float32")
                axes.plot(self.time, column, label=_text.line(name), drawstyle="steps-post" if held else "default")
            axes.set_ylabel(_text.line(unit or ""))
            axes.grid(alpha=0.3)
            axes.legend(loc="best", fontsize="small")
        plots[-1, 0].set_xlabel(f"time [{self._time_unit}]")
        return figure


def _array_of(element: str) -> str:
    """Returns the name of the array of an element."""
    return element.rpartition("[")[0]
