"""The uncertainty of a fit (standard errors, correlation, parameters not determined by the data), and the check
before a fit."""

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
    """Autocorrelation at lag one; NaN for fewer than three residuals."""
    n_outliers: int
    """Number of residuals beyond six robust standard deviations from the median; 0 for fewer than 20 residuals."""
    n_outlier_groups: int
    """Number of groups of neighbouring outliers."""


class Uncertainty:
    """The uncertainty of a fit (``fit.uncertainty``, `Calibration.uncertainty`); ``print(uncertainty)`` shows it.

    Attributes
    ----------
    estimator : {"sandwich", "pooled"}
        Estimator of the covariance: "sandwich" uses one residual variance per output of the model, "pooled" one for
        all outputs.
    names : list of str
        Names of the parameters.
    x : ndarray, shape (n,)
        Values of the parameters.
    covariance, correlation : ndarray, shape (n, n)
        Covariance in the units of the parameters, and correlation. Autocorrelated residuals of an output are modelled
        as a first-order autoregression. A robust loss uses the covariance of an M-estimator. The noise of measured
        initial states is included. The covariance is zero for `held` parameters, and infinite on the diagonal for
        `undetermined` ones. The correlation is NaN for both.
    stderr : ndarray, shape (n,)
        Standard errors: the square roots of the diagonal.
    uncorrected_stderr : ndarray, shape (n,), or None
        Standard errors that assume independent residuals; None if no output has autocorrelated residuals, because
        they are then equal.
    autocorrelations : ndarray, shape (k,)
        Autocorrelation at lag one assumed by the covariance for each of `residual_checks`; zero if it is not
        significant.
    degrees_of_freedom : float
        Number of measurements minus the number of parameters that they determine. Without priors, these are the
        parameters that are not held. A parameter with a prior as accurate as the measurements counts one half.
        Measurements with weight zero, and those from which a simulation starts, do not count. Infinite if the noise of
        all outputs is known (`sigma`), because no variance is then estimated.
    effective_degrees_of_freedom : ndarray, shape (n,)
        Degrees of freedom of the confidence interval of each parameter (Satterthwaite). They are lower if its
        variance comes mostly from an output with few measurements, or if residuals are autocorrelated. They are
        higher if it comes mostly from a prior.
    residual_checks : list of ResidualCheck
        Properties of the residuals of each output.
    held : list of str
        Parameters that are fixed, held or at a bound, and therefore assumed known.
    active_constraints : list of str
        Constraints that hold with equality at the point. The covariance excludes moves across them.
    undetermined, without_effect : list of str
        Parameters that the data do not determine, and the undetermined parameters that do not change any output.
    confounded : list of (str, str, float)
        Pairs with nearly the same effect on the outputs, with their correlation: 0.9 or more.
    weakest : list of str
        Parameters of the combination that the data determine worst, if it has three or more and is relevant.
    identifiable : list of str
        Parameters that the data determine if the others are fixed: their standard errors are below half of their
        values, and no correlation is 0.9 or more.
    findings : list of Finding
        Remarks on the uncertainty with their severity.
    verdict : list of str
        The remarks in sentences; empty if there are none.
    cost, accurate_cost : float
        The cost, and the cost with a tenth of the relative tolerance, or with half the step of a fixed-step solver
        (None: that simulation failed).
    jacobian : ndarray, shape (m, n)
        Derivatives of the residuals with respect to the parameters; zero for fixed parameters.
    n_simulations : int
        Number of points simulated.
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
    active_constraints: list[str]
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
        self.active_constraints = fields.get("active_constraints", [])
        for matrix in ("covariance", "correlation", "jacobian"):
            setattr(self, matrix, np.reshape(fields[matrix], (-1, len(names))))
        for list_of_names in ("held", "undetermined", "without_effect", "weakest", "identifiable"):
            setattr(self, list_of_names, [names[i] for i in fields[list_of_names]])
        self.confounded = [(names[i], names[j], correlation) for i, j, correlation in fields["confounded"]]
        self.residual_checks = [ResidualCheck(*map(check.get, ResidualCheck._fields)) for check in fields["residual_checks"]]
        self.findings = [Finding(**finding) for finding in fields["findings"]]

    @explained
    def confidence_intervals(self, level: SupportsFloat = 0.95, *, corrected: bool = True) -> FloatArray:
        """Returns confidence intervals from Student's t: ``x -+ t s``, or ``x * exp(-+ t s / x)`` on a log scale.

        Parameters
        ----------
        level : float
            Level between 0 and 1.
        corrected : bool
            If True, correct for autocorrelated residuals. If False, use `uncorrected_stderr`.

        Returns
        -------
        ndarray, shape (n, 2)
            Lower and upper ends. The ends coincide for fixed parameters and are infinite for undetermined parameters.
        """
        return self._native.intervals(_values.number("level", level), _values.flag("corrected", corrected))

    @property
    def message(self) -> str:
        """Remark on undetermined parameters and on those assumed known; empty if there are none."""
        return self._native.message()

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (self._native.state(),)

    def __repr__(self) -> str:
        return self._native.text().rstrip("\n")


def _restored(state: bytes) -> Uncertainty:
    return Uncertainty(_core.Uncertainty.restore(state))


class ParameterCheck(NamedTuple):
    """The effect of moving one parameter before a fit."""

    name: str
    start: float
    moved_to: float | None
    """Value to which the parameter was moved; None if it is fixed."""
    sensitivity: float | None
    """RMS change of the residuals for a step of the parameter's size, divided by the RMS range of the measurements.

    None if the parameter was not moved or the simulation failed."""
    has_effect: bool
    """True if the parameter changes an output by more than the error of the simulations."""
    failure: str | None
    """Reason of a failed simulation."""


class Preflight:
    """The check before a fit (`Calibration.preflight`, ``fit.preflight``); ``print(preflight)`` shows a table.

    Attributes
    ----------
    parameters : list of ParameterCheck
        Effects of moving each parameter by a hundredth of its size.
    confounded : list of (str, str, float)
        Pairs with nearly the same effect on the outputs at the start, with the correlation that their estimates would
        have.
    cost, accurate_cost : float
        The cost at the start, and the cost with a tenth of the relative tolerance, or with half the step of a
        fixed-step solver (None: that simulation failed).
    noise : float
        Difference between both costs relative to the cost.
    seconds_per_evaluation, expected_seconds : float
        Time in s of one evaluation, and of a fit by least squares with sequential evaluations.
    expected_evaluations : int
        Rule of thumb for least squares: 12 for each free parameter, plus one.
    workers : int
        Number of evaluations that may run at once.
    findings : list of Finding
        Remarks, causes first; empty if there are none.
    n_simulations : int
        Number of points simulated.
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
    """Returns the check of a point before a fit."""
    return Preflight(calibration._native.preflight(x, _options.worker_count("workers", workers, None)))


def at(
    calibration: Calibration, x: list[float], covariance: str, parameters: Sequence[str] | None, workers: SupportsIndex | None
) -> Uncertainty:
    """Returns the uncertainty of a point."""
    held: list[int] = []
    if parameters is not None:
        free = _values.names("parameters", [parameters] if isinstance(parameters, str) else parameters)
        if unknown := [name for name in free if name not in calibration.names]:
            raise BadCalibrationError(f"unknown parameter '{unknown[0]}'; expected one of: {', '.join(calibration.names)}")
        held = [i for i, name in enumerate(calibration.names) if name not in free]
    count = _options.worker_count("workers", workers, None)
    return Uncertainty(calibration._native.uncertainty(x, covariance, held, count))
