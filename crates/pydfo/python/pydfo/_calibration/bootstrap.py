"""Bootstrap: fits to synthetic measurements."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, NamedTuple, SupportsFloat, SupportsIndex

import numpy as np
import numpy.typing as npt

from .._args import options as _options
from .._args import values as _values
from . import export as _export

if TYPE_CHECKING:
    from .fit import Fit

FloatArray = npt.NDArray[np.float64]


class Bootstrap(NamedTuple):
    """Fits to synthetic measurements. ``print`` shows a table."""

    names: list[str]
    """Names of the parameters."""
    x: FloatArray
    """Values of the original fit."""
    samples: FloatArray
    """Fitted values, one row per fit, without failed fits."""
    n_failed: int
    """Number of fits that failed."""
    kind: str
    """Source of the synthetic errors."""
    seed: int
    """Seed of the random numbers."""
    text: str
    """The table."""

    @property
    def stderr(self) -> FloatArray:
        """Standard deviation of each parameter; NaN for a single fit."""
        if len(self.samples) < 2:
            return np.full(len(self.x), np.nan)
        found: FloatArray = np.std(self.samples, axis=0, ddof=1)
        return found

    def intervals(self, level: SupportsFloat = 0.95) -> dict[str, tuple[float, float]]:
        """Returns the percentile interval of each parameter by name.

        Raises
        ------
        ValueError
            The level is not between 0 and 1.
        """
        low, high = np.quantile(self.samples, _values.quantiles(level), axis=0).tolist()
        return dict(zip(self.names, zip(low, high)))

    def __str__(self) -> str:
        return self.text


def of_fit(
    fit: Fit,
    n: SupportsFloat,
    kind: str,
    rng: int | np.random.Generator | None,
    workers: SupportsIndex | None,
    checkpoint: str | os.PathLike[str] | None,
) -> Bootstrap:
    """Returns the fits to synthetic measurements of a fit."""
    number = _values.count("n", n)
    found, text = _export.native_of(fit).bootstrap(
        number,
        _values.choice("kind", kind),
        _options.seed(rng),
        _options.worker_count("workers", workers, None),
        None if checkpoint is None else _values.path("checkpoint", checkpoint),
    )
    samples = np.array(found["samples"])
    return Bootstrap(found["names"], np.array(found["x"]), samples, found["n_failed"], kind, found["seed"], text)
