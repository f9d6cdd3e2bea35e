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
        The model that was simulated.
    options : dict
        Its options.
    native : SimulationResult
        The same result with all that pydfo has for it.
    """

    def __init__(self, model: Any, options: dict[str, Any], native: SimulationResult, result_file: str | None) -> None:
        self.model, self.options, self.native, self._file = model, options, native, result_file

    @property
    def result_file(self) -> str:
        """The file that was written (``result_handling="csv"``)."""
        if self._file is None:
            raise ValueError('no file was written: options["result_handling"] = "csv" writes one, SimulationResult.to_csv too')
        return self._file

    @property
    def result_data(self) -> SimulationResult:
        """The columns."""
        return self.native

    def __getitem__(self, name: str) -> np.ndarray[Any, Any]:
        return self.native[name]

    def __contains__(self, name: object) -> bool:
        return name in self.native

    def keys(self) -> list[str]:
        """The names of the columns, "time" first."""
        return list(self.native)

    def initial(self, name: str) -> Any:
        """The value in the first row."""
        return self.native[name][0]

    def final(self, name: str) -> Any:
        """The value in the last row."""
        return self.native[name][-1]

    def is_variable(self, name: str) -> bool:
        """True where the values are not all the same."""
        return bool(np.any(self.native[name] != self.native[name][:1]))
