"""The result of a fit."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, SupportsFloat

import numpy as np
import numpy.typing as npt

from . import _worth
from ._result import OptimizeResult
from ._trajectory import SimulationStats

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ._calibration import Calibration

FloatArray = npt.NDArray[np.float64]


class Fit(OptimizeResult):
    """The result of a fit: all that an `OptimizeResult` has, with names and in terms of the measurements.

    Attributes
    ----------
    x : ndarray, shape (n,)
        The fitted values, in the order of the parameters; fixed ones included.
    parameters : dict of str to float
        The same by name.
    cost : float
        Sum of the squared weighted residuals there (the same as ``fun``); with a loss, of what they count.
    rms : float
        Root of the mean squared weighted residual there.
    start : ndarray, shape (n,)
        Where the fit started.
    solver : str or None
        The integration method of all simulations; see `Calibration.solver`. (None: interrupted before it was chosen.)
    race : list of Raced or None
        The methods that were compared, if there was a race.
    start_cost, start_rms : float or None
        The same as `cost` and `rms` at the start; None if the simulation failed there.
    at_bound : dict of str to {"lower", "upper"}
        Parameters that ended at one of their bounds: the best values may lie beyond.
    without_effect : list of str
        Parameters that did not change the cost, by more than the relative tolerance of the simulations: their values say
        nothing.
    n_checks : int
        Simulations made after the run to find out about both: at the bound, for each parameter that ended as near to it as
        `x_tol`; with the parameter moved, for each that no evaluation has shown to change the cost (those of a first simplex
        show it, because they differ in one parameter alone). They do not count in ``nfev`` nor
        in its limit, are not made after an interrupt or when the time is up, and are part of `stats`.
    n_beginnings : int
        How often the fit was begun: more than once where its simulations were found to depend on earlier ones, by a state that
        the model keeps and no variable shows; ``model.description.quirks`` says so, too. ``nfev`` counts from the last beginning.
    scaled_rms : float or None
        The RMS over that at the start, on the same measurements.
    stages : list of Fit
        The fit of each stage; empty if there were none. Standard errors of a stage are conditional: they take
        what the stage holds as known. ``success`` of the whole fit is that of all its stages.
    worth : Worth or None
        Standard errors, correlation, and what the data cannot tell, in words (``print(fit.worth)``). None: not asked for, the fit
        was ended by an interrupt, an error or its time, or simulations around the result fail.
    preflight : Preflight or None
        What was found at the start, where ``preflight=True`` was given.
    cov, cov_message
        The covariance of `worth` and what is to be said of it.
    stats : SimulationStats or None
        What all simulations of the fit took together, those that failed or were given up included, those of a resumed fit
        from before not. (None: interrupted twice, and the simulations under way were left behind.)
    """

    def __init__(self, calibration: Calibration, result: OptimizeResult, start: FloatArray, solver: str | None) -> None:
        vars(self).update(vars(result))
        rms = calibration._native.rms(self.fun)
        self._rms_and_start: tuple[float, float | None] = vars(self).pop("_rms", (rms, None))
        counts = vars(self).pop("stats", None)
        self.stats = None if counts is None else SimulationStats(**counts)
        if "at_bound" not in vars(self):
            # Interrupted twice.
            self.start_cost: float | None = None
            self.at_bound: dict[str, str] = {}
            self.without_effect: list[str] = []
            self.n_checks = 0
            self.n_beginnings = 1
        self.stages = [Fit(calibration, stage, np.array(stage._native.start), solver) for stage in vars(self).get("stages", [])]
        self._calibration = calibration
        self.worth = _worth.of_fit(vars(self).get("_native"))
        self.preflight = _worth.before_fit(vars(self).get("_native"))
        self.cov = None if self.worth is None else self.worth.covariance
        self.cov_message = "" if self.worth is None else self.worth.message
        self.start = start
        self.solver = solver
        self.race = calibration.race

    @property
    def stderr(self) -> FloatArray | None:
        """Standard errors of the parameters, shape (n,): zero for those that are fixed or at a bound, infinite for those that the
        data do not determine; None where there is no `worth`."""
        return None if self.worth is None else self.worth.stderr

    @property
    def covariance(self) -> FloatArray | None:
        """Covariance of the parameters, shape (n, n); the same as ``cov``."""
        return self.cov

    @property
    def correlation(self) -> FloatArray | None:
        """Correlation of the parameters, shape (n, n); NaN where a standard error is zero or infinite."""
        return None if self.worth is None else self.worth.correlation

    def confidence_intervals(self, level: SupportsFloat = 0.95) -> FloatArray:
        """Lower and upper ends of the confidence intervals, shape (n, 2); see `Worth.confidence_intervals`.

        Raises
        ------
        ValueError
            A level that does not lie between 0 and 1; the fit has no `worth`.
        """
        if self.worth is None:
            raise ValueError("what the fit is worth was not found out: it was interrupted, or covariance=None was given")
        return self.worth.confidence_intervals(level)

    @property
    def parameters(self) -> dict[str, float]:
        """The fitted values by name."""
        return dict(zip(self._calibration.names, np.asarray(self.x).tolist()))

    @property
    def cost(self) -> float:
        """Sum of the squared weighted residuals at the fitted values."""
        cost: float = self.fun
        return cost

    @property
    def rms(self) -> float:
        """Root of the mean squared weighted residual at the fitted values."""
        return self._rms_and_start[0]

    @property
    def start_rms(self) -> float | None:
        """Root of the mean squared weighted residual at the start."""
        return self._rms_and_start[1]

    @property
    def scaled_rms(self) -> float | None:
        """RMS over that at the start, on the same measurements; None if the simulation failed at the start."""
        return None if self.start_rms is None else self.rms / self.start_rms

    def simulate(self, x: npt.ArrayLike | None = None, times: npt.ArrayLike | None = None) -> dict[str, Any]:
        """Simulates at the fitted values; see `Calibration.simulate`.

        Parameters
        ----------
        x : array_like, shape (n,), optional
            Other values of the parameters.
        times : array_like, optional
            Times of the rows in s; default: the measured times.

        Returns
        -------
        dict of str to ndarray
            ``"time"`` and the compared outputs by their names in the model. With several experiments: a dict of such
            by their names.
        """
        return self._calibration.simulate(self.x if x is None else x, times)

    def residuals(self) -> FloatArray:
        """The residuals at the fitted values, simulated minus measured times weight; see `Calibration.residuals`."""
        return self._calibration.residuals(self.x)

    def plot(self) -> Figure:
        """Draws measurements, the response at the start and the fitted one, and below the residuals.

        Returns
        -------
        matplotlib.figure.Figure
            One column per output of each experiment. Nothing is shown or saved: ``fit.plot().savefig("fit.png")``.

        Raises
        ------
        ImportError
            matplotlib is not installed.
        """
        from . import _plot

        return _plot.fit(self, self._calibration)

    def __getitem__(self, key: Any) -> Any:
        if key in ("parameters", "cost", "rms", "stderr", "covariance", "correlation", "start_rms", "scaled_rms"):
            return getattr(self, key)
        return super().__getitem__(key)

    def __repr__(self) -> str:
        width = max(10, *(len(name) for name in self._calibration.names))
        lines = [f"{name:>{width}}: {value:.8g}" for name, value in self.parameters.items()]
        lines.append(f"{'cost':>{width}}: {self.cost:.8g}" + self._was(self.start_cost))
        lines.append(f"{'rms':>{width}}: {self.rms:.8g}" + self._was(self.start_rms))
        for line in super().__repr__().splitlines():
            name, _, text = line.partition(": ")
            if name.strip() not in ("fun", "x"):
                lines.append(f"{name.strip():>{width}}: {text}")
        if self.stats is not None:
            seconds, in_model = self.stats.seconds, self.stats.seconds_in_model
            work = f"{self.stats.right_hand_sides} right-hand sides, {seconds:.3g} s, {in_model:.3g} s of them inside the model"
            lines.append(f"{'simulated':>{width}}: {work}")
        return "\n".join(lines)

    @staticmethod
    def _was(value: float | None) -> str:
        return "" if value is None else f" ({value:.8g} at the start)"
