"""What a fit is worth: standard errors, correlation, and what the data cannot tell."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple, SupportsFloat, SupportsIndex

import numpy as np
import numpy.typing as npt

from . import _core, _options
from ._errors import BadCalibrationError

if TYPE_CHECKING:
    from ._calibration import Calibration

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
    """How many lie beyond four robust standard deviations from the median."""
    runs: float
    """How many standard deviations the number of runs of one sign is above that of independent residuals."""


class Worth:
    """What a fit is worth (``fit.worth``, `Calibration.worth`); ``print(worth)`` shows it.

    Attributes
    ----------
    estimator : {"sandwich", "pooled"}
        How the covariance was estimated: with one residual variance per output of the model, or with one for all.
    names : list of str
        Names of the parameters.
    x : ndarray, shape (n,)
        The point.
    covariance, correlation : ndarray, shape (n, n)
        In the units of the parameters. The covariance is zero for those that are `held`, infinite on the diagonal for those that
        are `undetermined`; the correlation is NaN there.
    stderr : ndarray, shape (n,)
        Standard errors: the roots of the diagonal.
    corrected_stderr : ndarray, shape (n,), or None
        The same with the residuals of each output taken for a first-order autoregression; None where none are autocorrelated.
    degrees_of_freedom : int
        Residuals less parameters that are not held.
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
    verdict : list of str
        What is to be said of all this, in sentences; empty if nothing is.
    cost, accurate_cost : float
        The cost, and the same with a hundredth of the relative tolerance (None: that simulation failed).
    jacobian : ndarray, shape (m, n)
        Derivatives of the residuals by the parameters; zero for those that are held.
    n_simulations : int
        Points that were simulated to find out.
    """

    def __init__(self, native: _core.Worth) -> None:
        self._native = native
        fields = native.fields()
        self.estimator: str = fields["estimator"]
        self.names: list[str] = fields["names"]
        self.x: FloatArray = fields["x"]
        self.covariance: FloatArray = fields["covariance"]
        self.correlation: FloatArray = fields["correlation"]
        self.stderr: FloatArray = fields["stderr"]
        self.corrected_stderr: FloatArray | None = fields["corrected_stderr"]
        self.degrees_of_freedom: int = fields["degrees_of_freedom"]
        self.residual_checks = [ResidualCheck(**check) for check in fields["residual_checks"]]
        self.held: list[str] = fields["held"]
        self.undetermined: list[str] = fields["undetermined"]
        self.without_effect: list[str] = fields["without_effect"]
        self.confounded: list[tuple[str, str, float]] = fields["confounded"]
        self.weakest: list[str] = fields["weakest"]
        self.identifiable: list[str] = fields["identifiable"]
        self.verdict: list[str] = fields["verdict"]
        self.cost: float = fields["cost"]
        self.accurate_cost: float | None = fields["accurate_cost"]
        self.jacobian: FloatArray = fields["jacobian"]
        self.n_simulations: int = fields["n_simulations"]

    def confidence_intervals(self, level: SupportsFloat = 0.95, *, corrected: bool = False) -> FloatArray:
        """Confidence intervals by Student's t: ``x -+ t s``, for a parameter on a log scale ``x * exp(-+ t s / x)``.

        Parameters
        ----------
        level : float
            Between 0 and 1.
        corrected : bool
            With `corrected_stderr`, where there are such.

        Returns
        -------
        ndarray, shape (n, 2)
            Lower and upper ends. Points for parameters that are held, without ends for those that are not determined.
        """
        return self._native.intervals(_options.number("level", level), _options.flag("corrected", corrected))

    @property
    def message(self) -> str:
        """Who is not determined, who is taken as known; empty if there is nothing to be said."""
        return self._native.message()

    def __repr__(self) -> str:
        return self._native.text().rstrip("\n")


def of_fit(fit: _core.Fit | None) -> Worth | None:
    """What a fit is worth, if that was found out."""
    native = None if fit is None else _core.worth_of_fit(fit)
    return None if native is None else Worth(native)


def at(
    calibration: Calibration, x: list[float], covariance: str, parameters: Sequence[str] | None, workers: SupportsIndex | None
) -> Worth:
    """What a point is worth."""
    held: list[int] = []
    if parameters is not None:
        free = _options.names("parameters", parameters)
        if unknown := [name for name in free if name not in calibration.names]:
            raise BadCalibrationError(f"there is no parameter '{unknown[0]}'; there are: {', '.join(calibration.names)}")
        held = [i for i, name in enumerate(calibration.names) if name not in free]
    count = _options.worker_count("workers", workers, None)
    return Worth(_core.worth_at(calibration._native, x, covariance, held, count))
