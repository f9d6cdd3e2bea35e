"""Recorded simulations."""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Iterator, KeysView, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, overload

import numpy as np
import numpy.typing as npt

from ._errors import UnknownVariableError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class SimulationStats:
    """What a simulation cost.

    Attributes
    ----------
    accepted_steps, rejected_steps : int
    right_hand_sides, event_indicators : int
        Evaluations; the right-hand sides for differences of a Jacobian count.
    jacobians, directional_derivatives : int
        Jacobians made, and directional derivatives that the model was asked for.
    decompositions : int
        Decompositions of matrices; Radau5 makes two at a time, a real and a complex one.
    newton_iterations : int
    samples : int
        Rows.
    events : int
        Visits of event mode after the start; the four counts that follow tell their causes, of which one visit may have
        several.
    state_events, time_events, step_events, input_events : int
    restarts : int
        Restarts of the method after events that changed something.
    chattering : int
        How often state events were found to follow each other while time hardly advanced, and the run went on.
    """

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


class SimulationResult(Mapping[str, FloatArray]):
    """The result of a simulation: columns of numbers by name, ``res["time"]`` among them.

    A mapping of names to arrays of shape (rows,); Integers and Booleans are numbers, too (`to_structured` and
    `to_dataframe` give them their types). An array has a column for each element, ``res["a[2,1]"]`` (counted from 1), and
    ``res["a"]`` is all of it, of shape (rows, ...). At the time of an event a row holds the values after it. A time that was asked
    for twice, and with ``record_events=True`` every event, has two rows: the limit from the left, then the values after
    the event.

    Attributes
    ----------
    time : ndarray, shape (rows,)
        Times in s.
    left_limit : ndarray of bool, shape (rows,)
        Whether a row holds the limit from the left.
    events : recarray
        The events after the start, with fields ``time`` and ``kind``: "state", "time", "step", "input", or several of
        them with a plus between.
    stats : SimulationStats
        What it cost.
    termination : {"finished", "stopped-by-model"}
        Whether the final time was reached, or the model asked for the end.
    end_time : float
        When it ended.
    """

    def __init__(
        self,
        *,
        time: FloatArray,
        names: list[str],
        columns: list[FloatArray],
        types: list[str],
        dtypes: list[str],
        units: list[str | None],
        arrays: list[tuple[str, int, list[int]]],
        left: npt.NDArray[np.bool_],
        event_times: FloatArray,
        event_kinds: list[str],
        stats: dict[str, int],
        termination: str,
        end_time: float,
    ) -> None:
        self.time = time
        self.left_limit = left
        events = np.empty(len(event_times), dtype=[("time", np.float64), ("kind", "U21")])
        events["time"] = event_times
        events["kind"] = event_kinds
        self.events = events.view(np.recarray)
        self.stats = SimulationStats(**stats)
        self.termination = termination
        self.end_time = end_time
        self._columns = {"time": time} | dict(zip(names, columns))
        self._types = {"time": "Real"} | dict(zip(names, types))
        self._dtypes = {"time": "float64"} | dict(zip(names, dtypes))
        self._arrays = {array: (names[first : first + int(np.prod(shape))], shape) for array, first, shape in arrays}
        self._units: dict[str, str | None] = {"time": "s", **dict(zip(names, units))}

    def __getitem__(self, name: str) -> FloatArray:
        try:
            return self._columns[name]
        except KeyError:
            if name not in self._arrays:
                raise UnknownVariableError(self._missing(name)) from None
        elements, shape = self._arrays[name]
        values = np.array([self._columns[element] for element in elements]).reshape(len(elements), len(self.time))
        return np.ascontiguousarray(values.T).reshape(len(self.time), *shape)

    def _missing(self, name: object) -> str:
        nearest = difflib.get_close_matches(str(name), self._columns, n=3)
        hint = f"; did you mean {', '.join(nearest)}?" if nearest else "."
        names = list(self._columns)
        shown = ", ".join(names[:20]) + (", ..." if len(names) > 20 else "")
        return f'"{name}" was not recorded{hint} Recorded are {shown}; simulate(output=[...]) chooses'

    def keys(self) -> KeysView[str]:
        """The names of the columns, "time" first."""
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
    def final(self, name: str) -> float: ...  # type: ignore[overload-overlap]
    @overload
    def final(self, name: Sequence[str]) -> list[float]: ...
    def final(self, name: str | Sequence[str]) -> float | list[float]:
        """The value in the last row; a list of values for a list of names."""
        if not isinstance(name, str):
            return [self.final(one) for one in name]
        column = self[name]
        return float(column[-1]) if len(column) else float("nan")

    def to_structured(self) -> npt.NDArray[np.void]:
        """A structured array of shape (rows,) with a field per column, ``time`` first; Integers and Booleans have
        their types."""
        array = np.empty(len(self.time), dtype=[(name, self._dtypes[name]) for name in self])
        for name, column in self.items():
            array[name] = column
        return array

    def to_dataframe(self) -> Any:
        """A pandas.DataFrame with a column per variable, ``time`` first; Integers and Booleans have their types.
        Needs pandas."""
        try:
            pd: Any = importlib.import_module("pandas")
        except ImportError as e:
            raise ImportError("to_dataframe() needs pandas: pip install pandas") from e
        return pd.DataFrame({name: column.astype(self._dtypes[name]) for name, column in self.items()})

    def plot(self, names: str | Sequence[str] | None = None) -> Figure:
        """Draws columns over time, those of one unit in one plot. Needs matplotlib.

        Parameters
        ----------
        names : str or sequence of str, optional
            The columns; default: all.

        Returns
        -------
        matplotlib.figure.Figure
        """
        from ._plot import pyplot

        plt = pyplot()
        chosen = [name for name in self if name != "time"] if names is None else names
        chosen = [chosen] if isinstance(chosen, str) else list(chosen)
        groups: dict[str | None, list[str]] = {}
        for name in chosen:
            self[name]
            groups.setdefault(self._units[name], []).append(name)
        figure: Figure
        figure, plots = plt.subplots(max(len(groups), 1), 1, sharex=True, squeeze=False, layout="constrained")
        for axes, (unit, members) in zip(plots[:, 0], groups.items()):
            for name in members:
                held = self._types[name] not in ("Real", "Float32")
                axes.plot(self.time, self[name], label=name, drawstyle="steps-post" if held else "default")
            axes.set_ylabel(unit or "")
            axes.grid(alpha=0.3)
            axes.legend(loc="best", fontsize="small")
        plots[-1, 0].set_xlabel("time [s]")
        return figure
