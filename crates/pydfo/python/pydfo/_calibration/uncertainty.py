"""The uncertainty of a fit (standard errors, correlation, what the data cannot tell), and what is found before it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, SupportsFloat, SupportsIndex

import numpy as np
import numpy.typing as npt

from .. import _core
from .._args import options as _options
from .._args import values as _values
from .._args.keywords import explained
from .._errors import BadCalibrationError
from .check import Finding

if TYPE_CHECKING:
    from .calibration import Calibration

FloatArray = npt.NDArray[np.float64]


class ResidualCheck(NamedTuple):
    """The residuals of one output of one experiment."""

    experiment: str
    variable: str
    n: int
    mean: float
    deviation: float
    """Standard deviation around the mean."""
    autocorrelation: float
    """At lag one; NaN for fewer than three."""
    n_outliers: int
    """Number of residuals beyond six robust standard deviations from the median; 0 for fewer than 20 residuals."""
    n_outlier_groups: int
    """How many groups of neighbours the outliers form."""


class Uncertainty:
    """The uncertainty of a fit (``fit.uncertainty``, `Calibration.uncertainty`); ``print(uncertainty)`` shows it.

    Attributes
    ----------
    estimator : {"sandwich", "pooled"}
        How the covariance was estimated: with one residual variance per output of the model, or with one for all.
    names : list of str
        Names of the parameters.
    x : ndarray, shape (n,)
        The point.
    covariance, correlation : ndarray, shape (n, n)
        In the units of the parameters. Where the residuals of an output are autocorrelated they are taken for a first-order
        autoregression; with a robust loss the covariance is that of an M-estimator. The noise of measured initial states enters it. It
        is zero for those that are `held`, infinite on the diagonal for those that are `undetermined`; the correlation is NaN there.
    stderr : ndarray, shape (n,)
        Standard errors: the roots of the diagonal.
    uncorrected_stderr : ndarray, shape (n,), or None
        Standard errors that suppose independent residuals; None where no output has autocorrelated ones, and they are the same.
    autocorrelations : ndarray, shape (k,)
        The autocorrelation at lag one that the covariance supposes for each of `residual_checks`: zero where it is no more than chance.
    degrees_of_freedom : float
        Number of measurements less the number of parameters that they determine: without priors the number of those that are not held; a
        prior as good as the measurements counts one half. Measurements of weight zero do not count, nor those from which a simulation starts.
    effective_degrees_of_freedom : ndarray, shape (n,)
        Degrees of freedom of each parameter's confidence interval (Satterthwaite): fewer where its variance is mostly that of an output
        with few measurements, or where residuals are autocorrelated; more where it is mostly that of a prior.
    residual_checks : list of ResidualCheck
        What the residuals of each output look like.
    held : list of str
        Parameters that are fixed, held or at a bound: taken as known.
    undetermined, without_effect : list of str
        Parameters that the data do not determine, and those of them that move no output.
    confounded : list of (str, str, float)
        Pairs that move the outputs the same way, with their correlation: 0.9 or more.
    weakest : list of str
        The parameters of the combination that the data determine worst, where there are three or more in it and it matters.
    identifiable : list of str
        Parameters that this data can tell, the others held: with standard errors below half of their values, and no correlation of
        0.9 or more.
    findings : list of Finding
        What is to be said of all this, with a severity.
    verdict : list of str
        The same in sentences; empty if nothing is to be said.
    cost, accurate_cost : float
        The cost, and the same with a tenth of the relative tolerance, or with half the step of a fixed-step solver (None: that simulation failed).
    jacobian : ndarray, shape (m, n)
        Derivatives of the residuals by the parameters; zero for those that are held.
    n_simulations : int
        Points that were simulated to find out.
    """

    estimator: str
    names: list[str]
    x: FloatArray
    covariance: FloatArray
    correlation: FloatArray
    stderr: FloatArray
    uncorrected_stderr: FloatArray | None
    autocorrelations: FloatArray
    effective_degrees_of_freedom: FloatArray
    degrees_of_freedom: float
    held: list[str]
    undetermined: list[str]
    without_effect: list[str]
    confounded: list[tuple[str, str, float]]
    weakest: list[str]
    identifiable: list[str]
    verdict: list[str]
    cost: float
    accurate_cost: float | None
    jacobian: FloatArray
    n_simulations: int

    def __init__(self, native: _core.Uncertainty) -> None:
        self._native = native
        fields = native.fields()
        names: list[str] = fields["names"]
        vars(self).update({name: fields[name] for name in Uncertainty.__annotations__ if name in fields})
        self.stderr = fields["standard_errors"]
        for matrix in ("covariance", "correlation", "jacobian"):
            setattr(self, matrix, np.reshape(fields[matrix], (-1, len(names))))
        for list_of_names in ("held", "undetermined", "without_effect", "weakest", "identifiable"):
            setattr(self, list_of_names, [names[i] for i in fields[list_of_names]])
        self.confounded = [(names[i], names[j], correlation) for i, j, correlation in fields["confounded"]]
        self.residual_checks = [ResidualCheck(*map(check.get, ResidualCheck._fields)) for check in fields["residual_checks"]]
        self.findings = [Finding(**finding) for finding in fields["findings"]]

    @explained
    def confidence_intervals(self, level: SupportsFloat = 0.95, *, corrected: bool = True) -> FloatArray:
        """Confidence intervals by Student's t: ``x -+ t s``, for a parameter on a log scale ``x * exp(-+ t s / x)``.

        Parameters
        ----------
        level : float
            Between 0 and 1.
        corrected : bool
            Whether autocorrelated residuals are taken account of; False: with `uncorrected_stderr`.

        Returns
        -------
        ndarray, shape (n, 2)
            Lower and upper ends. Points for parameters that are held, without ends for those that are not determined.
        """
        return self._native.intervals(_values.number("level", level), _values.flag("corrected", corrected))

    @property
    def message(self) -> str:
        """Who is not determined, who is taken as known; empty if there is nothing to be said."""
        return self._native.message()

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (self._native.state(),)

    def __repr__(self) -> str:
        return self._native.text().rstrip("\n")


def _restored(state: bytes) -> Uncertainty:
    return Uncertainty(_core.Uncertainty.restore(state))


class ParameterCheck(NamedTuple):
    """What moving one parameter did before a fit."""

    name: str
    start: float
    moved_to: float | None
    """None: the parameter is fixed."""
    sensitivity: float | None
    """RMS change of the residuals for a step of the parameter's size, over the RMS range of the measurements; None where nothing
    was moved or the simulation failed."""
    has_effect: bool
    """Whether it moves an output by more than the error of the simulations."""
    failure: str | None
    """Why the simulation failed."""


class Preflight:
    """What was found before a fit (`Calibration.preflight`, ``fit.preflight``); ``print(preflight)`` shows a table.

    Attributes
    ----------
    parameters : list of ParameterCheck
        What moving each parameter by a hundredth of its size did.
    confounded : list of (str, str, float)
        Pairs that move the outputs the same way at the start, with the correlation that their estimates would have.
    cost, accurate_cost : float
        The cost at the start, and with a tenth of the relative tolerance, or with half the step of a fixed-step solver (None: that simulation failed).
    noise : float
        The difference of both relative to the cost.
    seconds_per_evaluation, expected_seconds : float
        Time of one evaluation, and of a fit by least squares, one evaluation after the other.
    expected_evaluations : int
        A rule of thumb for least squares: 12 for each free parameter and one more.
    workers : int
        Evaluations that may run at once.
    findings : list of Finding
        What is to be said, causes first; empty if nothing is.
    n_simulations : int
        Points that were simulated.
    """

    cost: float
    accurate_cost: float | None
    noise: float
    seconds_per_evaluation: float
    expected_evaluations: int
    expected_seconds: float
    workers: int
    n_simulations: int

    def __init__(self, fields: dict[str, Any]) -> None:
        vars(self).update({name: fields[name] for name in Preflight.__annotations__})
        self.findings = [Finding(**finding) for finding in fields["findings"]]
        self.parameters = [ParameterCheck(**check) for check in fields["parameters"]]
        names = [check.name for check in self.parameters]
        self.confounded = [(names[i], names[j], correlation) for i, j, correlation in fields["confounded"]]
        self._text: str = fields["text"]

    def __repr__(self) -> str:
        return self._text.rstrip("\n")


def before(calibration: Calibration, x: list[float], workers: SupportsIndex | None) -> Preflight:
    """What is found at a point before a fit."""
    return Preflight(calibration._native.preflight(x, _options.worker_count("workers", workers, None)))


def at(
    calibration: Calibration, x: list[float], covariance: str, parameters: Sequence[str] | None, workers: SupportsIndex | None
) -> Uncertainty:
    """Uncertainty of a point."""
    held: list[int] = []
    if parameters is not None:
        free = _values.names("parameters", [parameters] if isinstance(parameters, str) else parameters)
        if unknown := [name for name in free if name not in calibration.names]:
            raise BadCalibrationError(f"there is no parameter '{unknown[0]}'; there are: {', '.join(calibration.names)}")
        held = [i for i, name in enumerate(calibration.names) if name not in free]
    count = _options.worker_count("workers", workers, None)
    return Uncertainty(calibration._native.uncertainty(x, covariance, held, count))
