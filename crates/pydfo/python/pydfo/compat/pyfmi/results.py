"""Results with PyFMI's methods."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..._model.trajectory import SimulationResult


class Result:
    """The result of a simulation: ``res["x"]``, `initial`, `final`, `keys`.

    Attributes
    ----------
    model : FMUModelBase
        The simulated model.
    options : dict
        Options of the simulation.
    native : SimulationResult
        The result in the class of pydfo.
    """

    def __init__(self, model: Any, options: dict[str, Any], native: SimulationResult, result_file: str | None) -> None:
        self.model, self.options, self.native, self._file = model, options, native, result_file

    @property
    def result_file(self) -> str:
        """Path of the written file (``result_handling="csv"``)."""
        if self._file is None:
            raise ValueError('no file was written; set options["result_handling"] = "csv", or use SimulationResult.to_csv')
        return self._file

    @property
    def result_data(self) -> SimulationResult:
        """Columns of the result."""
        return self.native

    def __getitem__(self, name: str) -> np.ndarray[Any, Any]:
        return self.native[name]

    def __contains__(self, name: object) -> bool:
        return name in self.native

    def keys(self) -> list[str]:
        """Returns the names of the columns, "time" first."""
        return list(self.native)

    def initial(self, name: str) -> Any:
        """Returns the value in the first row."""
        return self.native[name][0]

    def final(self, name: str) -> Any:
        """Returns the value in the last row."""
        return self.native[name][-1]

    def is_variable(self, name: str) -> bool:
        """Returns True if the values are not all equal."""
        return bool(np.any(self.native[name] != self.native[name][:1]))
