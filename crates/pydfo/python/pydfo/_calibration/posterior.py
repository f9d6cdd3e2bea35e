"""Samples of the posterior distribution of the parameters of a fit."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import closing, nullcontext
from typing import TYPE_CHECKING, Any, SupportsFloat, SupportsIndex

import numpy as np
import numpy.typing as npt

from .. import _core
from .._args import options as _options
from .._args import values as _values
from .._errors import Interrupted
from .._model.trajectory import SimulationStats
from .._optimize.live_line import DELAY, StepLine, is_watched
from . import export as _export

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .fit import Fit

FloatArray = npt.NDArray[np.float64]


class Posterior:
    """Sample of the posterior distribution of the parameters of a fit (``fit.sample()``); printed as a table.

    Attributes
    ----------
    names : list of str
        Names of the sampled parameters.
    chain : ndarray, shape (steps, walkers, n)
        Draws after the warm-up, in the user's units.
    log_density : ndarray, shape (steps, walkers)
        Logarithm of the density of each draw, up to a constant.
    mean, sd : dict of str to float
        Means and standard deviations of the draws by parameter.
    r_hat : dict of str to float
        Split R-hat by parameter; close to 1 if the walkers agree.
    effective_draws : dict of str to float
        Number of effective draws by parameter: the number of draws divided by their autocorrelation time.
    converged : bool
        True if every R-hat is at most 1.05, and every number of effective draws is at least 400.
    acceptance : float
        Fraction of accepted moves.
    seed : int
        Seed of the random numbers.
    n_warmup : int
        Number of steps before the sample, which are not a part of it.
    n_simulations : int
        Number of simulated points, including the points of a continued file.
    n_failed : int
        Number of failed simulations; their points have the density zero.
    interrupted : bool
        True if Ctrl-C ended the sample before the last step.
    stats : SimulationStats
        Computational cost of the simulations, without the simulations of a continued file.
    """

    names: list[str]
    chain: FloatArray
    acceptance: float
    seed: int
    n_warmup: int
    n_simulations: int
    n_failed: int
    converged: bool
    interrupted: bool

    def __init__(self, fields: dict[str, Any], units: dict[str, str]) -> None:
        vars(self).update({name: fields[name] for name in Posterior.__annotations__ if name in fields})
        self.log_density: FloatArray = fields["log_density"].reshape(self.chain.shape[:2])
        of = {name: dict(zip(self.names, fields[name].tolist())) for name in ("mean", "sd", "r_hat", "effective_draws")}
        self.mean: dict[str, float] = of["mean"]
        self.sd: dict[str, float] = of["sd"]
        self.r_hat: dict[str, float] = of["r_hat"]
        self.effective_draws: dict[str, float] = of["effective_draws"]
        self.stats = SimulationStats(**fields["stats"])
        self._text: str = fields["text"]
        #: Units of the parameters that have one.
        self._units = units

    @property
    def draws(self) -> dict[str, FloatArray]:
        """All draws by parameter, step by step, walker by walker."""
        return {name: self.chain[:, :, k].ravel() for k, name in enumerate(self.names)}

    def intervals(self, level: SupportsFloat = 0.95) -> dict[str, tuple[float, float]]:
        """Returns the intervals between the quantiles ``(1 - level) / 2`` and ``(1 + level) / 2`` of the draws.

        Raises
        ------
        ValueError
            The level is not between 0 and 1.
        """
        ends = _values.quantiles(level)
        return {name: (float(low), float(high)) for name, (low, high) in ((n, np.quantile(d, ends)) for n, d in self.draws.items())}

    def __repr__(self) -> str:
        return self._text

    def plot(self) -> Figure:
        """Draws a histogram of each parameter and the joint distribution of each pair (corner plot).

        Returns
        -------
        matplotlib.figure.Figure
            The figure is not shown or saved. Save it with ``posterior.plot().savefig("posterior.png")``.

        Raises
        ------
        ImportError
            matplotlib is not installed.
        """
        from .. import _plot

        return _plot.corner(self)


def of_fit(
    fit: Fit,
    steps: SupportsFloat,
    warmup: SupportsFloat | None,
    walkers: SupportsFloat | None,
    start: str,
    rng: int | np.random.Generator | None,
    workers: SupportsIndex | None,
    checkpoint: str | os.PathLike[str] | None,
    disp: bool | None,
) -> Posterior:
    """Returns a sample of the posterior distribution of a fit."""
    word = _values.choice("start", start)
    if word not in ("fit", "box"):
        raise ValueError(f"start is {start!r}; expected 'fit' or 'box'")
    n_steps = _values.count("steps", steps)
    units = {one["name"]: one["unit"] for one in fit.to_dict()["parameters"] if one.get("unit")}
    line = None
    if (disp is None or _values.flag("disp", disp)) and is_watched():
        line = StepLine("sampling: step", n_steps, DELAY if disp is None else 0.0)
    observer: Callable[[int], None] | None = line
    try:
        with closing(line) if line else nullcontext():
            fields = _core.sample(
                _export.native_of(fit),
                (n_steps, _values.limit("warmup", warmup, 0), _values.limit("walkers", walkers, 1)),
                word == "box",
                _options.seed(rng),
                _options.worker_count("workers", workers, None),
                None if checkpoint is None else _values.path("checkpoint", checkpoint),
                observer,
            )
    except Interrupted as e:
        # Convert the partial result to a Posterior.
        found: Any = e.result
        if isinstance(found, dict):
            e.result = Posterior(found, units)
        raise
    return Posterior(fields, units)
