"""Evaluation of single points of a `Calibration`: names, cost, residuals, simulations."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import _core
from .._args import values as _values
from .._args.keywords import explained
from .._errors import BadCalibrationError
from .._model.trajectory import SimulationResult
from .parameter import Parameter

FloatArray = npt.NDArray[np.float64]


class Evaluation:
    """The part of a `Calibration` that evaluates single points."""

    _native: _core.Calibration
    _parameters: tuple[Parameter, ...]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters as given."""
        return self._parameters

    @property
    def names(self) -> list[str]:
        """Names of the entries of ``x``: the parameters in their order. A local parameter has one entry per
        experiment (``T0[run1]``)."""
        return self._native.names()

    @property
    def experiments(self) -> list[str]:
        """Names of the experiments."""
        return self._native.experiments()

    @property
    def start(self) -> FloatArray:
        """Start values of the parameters, shape (n,)."""
        return np.array(self._native.start())

    @property
    def n_residuals(self) -> int:
        """Length of the residual vector: the number of measurements that count, plus one for each prior."""
        return self._native.n_residuals

    @property
    def n_measurements(self) -> int:
        """Number of measurements that count."""
        return self._native.n_measurements

    def model_values(self, x: npt.ArrayLike | Mapping[str, float] | None = None, experiment: str | None = None) -> dict[str, float]:
        """Returns the values set in the model.

        Parameters
        ----------
        x : array_like or dict, optional
            As in `cost`.
        experiment : str, optional
            Name of the experiment; default: the first one.

        Returns
        -------
        dict of str to float
            The values of variables by name, in the units of the model, including derived parameters and parameters that
            set several variables.
        """
        names = self.experiments
        if experiment is not None and experiment not in names:
            raise BadCalibrationError(f"unknown experiment '{experiment}'; expected one of: {', '.join(names)}")
        return dict(self._native.model_values(0 if experiment is None else names.index(experiment), self._checked(x)))

    @property
    def constraints(self) -> list[str]:
        """Constraints between the parameters, as written."""
        return self._native.constraints()

    def _checked(self, x: npt.ArrayLike | Mapping[str, float] | None) -> list[float]:
        values = self._values(x)
        if len(values) != len(self.names):
            raise BadCalibrationError(f"expected {len(self.names)} values, one per parameter; got {len(values)} ({', '.join(self.names)})")
        return values

    @property
    def solver(self) -> str:
        """Name of the integration method of all simulations, inside and outside fits."""
        return self._native.solver()

    def _values(self, x: npt.ArrayLike | Mapping[str, float] | None, argument: str = "x") -> list[float]:
        if x is None or isinstance(x, Mapping):
            values = dict(zip(self.names, self._native.start()))
            given = dict(x or {})
            derived = {name: given.pop(name) for name, _ in self._native.derived(self._native.start()) if name in given}
            for name, value in given.items():
                if name not in values:
                    raise BadCalibrationError(f"unknown parameter '{name}'; expected one of: {', '.join(values)}")
                values[name] = _values.number(name, value)
            for name, expected in self._native.derived(list(values.values())):
                if name in derived and not np.isclose(_values.number(name, derived[name]), expected, rtol=1e-9, atol=0.0):
                    raise BadCalibrationError(f"{name} = {derived[name]!r}: the parameter follows from other parameters, which determine the value {expected!r}")
            return list(values.values())
        return [float(value) for value in _values.vector(argument, x)]

    def cost(self, x: npt.ArrayLike | Mapping[str, float] | None = None) -> float:
        """Returns the sum of the squared weighted residuals.

        The interpreter lock is released during the simulation. Ctrl-C ends the simulation, and also its process if
        the FMU does not return within 0.1 s.

        Parameters
        ----------
        x : array_like, shape (n,), or dict, optional
            Values of the parameters, in their order or by name. Omitted parameters have their start values. Default:
            all start values.

        Raises
        ------
        SimulationError
            The simulation failed. The message states the time and the reason.
        ValueError
            The number of values is wrong, or a value is not finite.
        """
        return self._native.cost(self._values(x))

    def residuals(self, x: npt.ArrayLike | Mapping[str, float] | None = None) -> FloatArray:
        """Returns the residuals: simulated minus measured, times weight.

        Parameters
        ----------
        x : array_like or dict, optional
            As in `cost`.

        Returns
        -------
        ndarray, shape (n_residuals,)
            The residuals ordered by experiment, by output as given, and by time, without missing values. Length and
            order never change.

        Raises
        ------
        SimulationError, ValueError
            See `cost`.
        """
        return self._native.residuals(self._values(x))

    @explained
    def simulate(
        self,
        x: npt.ArrayLike | Mapping[str, float] | None = None,
        times: npt.ArrayLike | None = None,
        outputs: str | Iterable[str] | None = None,
    ) -> Any:
        """Simulates once.

        Parameters
        ----------
        x : array_like or dict, optional
            As in `cost`.
        times : array_like, optional
            Times of the rows, ascending; default: the measured times that count.

        outputs : str or iterable of str, optional
            Variables of the model to record directly, without the delays or offsets of outputs. Pass names, elements
            of arrays, patterns with ``*`` and ``?``, or "all".

        Returns
        -------
        dict of str to ndarray
            ``"time"`` and the compared outputs by their names in the model. With `outputs`: a `SimulationResult` with
            units. With several experiments: a dict of these results by experiment name.

        Raises
        ------
        SimulationError, ValueError
            See `cost`.
        """
        rows = None if times is None else _values.vector("times", times).tolist()
        if outputs is not None:
            names = [outputs] if isinstance(outputs, str) else _values.names("outputs", outputs)
            found = self._native.simulate_variables(self._values(x), rows, names)
            return self._by_experiment([SimulationResult(**fields) for fields in found])
        return self._by_experiment(self._native.simulate(self._values(x), rows))

    def measurements(self) -> dict[str, Any]:
        """Returns the measurements as read: times and values by output, without missing values.

        With several experiments, returns a dict of these results by experiment name."""
        found: dict[str, Any] = self._by_experiment(
            [{v: (time[~np.isnan(y)], y[~np.isnan(y)]) for v, y in columns} for time, columns in self._native.measurements()]
        )
        return found

    def _by_experiment(self, found: Sequence[Any]) -> Any:
        return found[0] if len(found) == 1 else dict(zip(self.experiments, found))
