"""`Scenario`: inputs, start values and the span of a simulation of a design."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any, SupportsFloat

from .. import _core
from .._args import values as _values
from .._args.keywords import explained
from .._calibration import data as _data
from .._calibration.experiment import Experiment, Inputs, errors_name, sources, states
from .._calibration.parameter import Parameter


class Scenario(Experiment):
    """Conditions under which a design is simulated, for a `Design` with one or several scenarios.

    Parameters
    ----------
    final_time : float, optional
        End of the simulation, in the time unit of the model. Default: the last row of `data`, otherwise the stop time
        of the model.
    inputs : dict, or list of str, optional
        Source of each input, as in `Experiment`: a column of `data`, a `Hold`, a number, or a function of time.
    data : path, dict of arrays or DataFrame, optional
        Table with a column of times, as in `Calibration`, for inputs and for references of criteria. A reference is
        interpolated linearly between the rows. References require a CSV file or data in memory.
    start_values : dict or path, optional
        Values of other parameters and start values of variables in this scenario, as in `Experiment`.
    start_time : float, optional
        Start of the simulation. Default: the first row of `data`, otherwise the start time of the model.
    initial_states, steady_limit, hold_inputs, time, sheet : optional
        As in `Experiment`.
    weight : float
        Factor of the objective in this scenario.
    name : str, optional
        Name of the scenario; default: "run1", "run2" and so on.

    Examples
    --------
    >>> Scenario(400, start_values={"r1": 13.0}, name="small step")
    <Scenario small step>
    """

    final_time: float | None
    weight: float | None

    @explained
    def __init__(
        self,
        final_time: SupportsFloat | None = None,
        inputs: Inputs | None = None,
        *,
        data: Any = None,
        start_values: Mapping[str, Any] | str | os.PathLike[str] | None = None,
        start_time: SupportsFloat | None = None,
        initial_states: Mapping[str, SupportsFloat | str | Parameter] | str | None = None,
        steady_limit: SupportsFloat | None = None,
        hold_inputs: bool = False,
        time: str | None = None,
        sheet: str | None = None,
        weight: SupportsFloat = 1.0,
        name: str | None = None,
    ) -> None:
        put = object.__setattr__
        put(self, "name", None if name is None else _values.choice("name", name))
        with errors_name(self.name):
            driven = sources(inputs)
            named = None if time is None else _values.choice("time", time)
            sheet_name = None if sheet is None else _values.choice("sheet", sheet)
            if data is None:
                table = _data.Table(None, None, None)
            else:
                driving = [source if isinstance(source, str) else source[0] for _, source in driven if isinstance(source, (str, tuple))]
                table = _data.read_recording(data, _data.all_columns(data) or driving, named, sheet_name)
            values, file = _values.values_or_file("start_values", start_values)
            given_states, is_steady = states(initial_states)
            fields: dict[str, Any] = {
                "path": table.path,
                "table": table.table,
                "time": table.time,
                "outputs": [],
                "inputs": driven,
                "start_values": values,
                "parameter_set": file,
                "initial_states": given_states,
                "is_steady": is_steady,
                "steady_limit": _values.optional_number("steady_limit", steady_limit),
                "windows": [],
                "warm_up": None,
                "start_time": _values.optional_number("start_time", start_time),
                "final_time": _values.optional_number("final_time", final_time),
                "weight": _values.number("weight", weight),
                "mask": None,
                "mask_column": None,
                "resample": None,
                "delays": [],
                "hold_inputs": _values.flag("hold_inputs", hold_inputs),
            }
            for field, value in fields.items():
                put(self, field, value)

    def __repr__(self) -> str:
        return f"<Scenario{'' if self.name is None else ' ' + self.name}>"
