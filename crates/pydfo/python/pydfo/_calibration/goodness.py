"""Goodness of a fit, and the comparison of two fits."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from . import export as _export

if TYPE_CHECKING:
    from .fit import Fit


class Goodness(NamedTuple):
    """Statistics of the residuals of a fit, with the names and definitions of lmfit.

    They use the residuals of the measurements, with the weights of the calibration and without a loss. The criteria
    assume independent normal errors of one variance, up to the weights.
    """

    ndata: int
    """Number of measurements N that count."""
    nvarys: int
    """Number of fitted parameters k, including parameters at a bound."""
    nfree: int
    """Degrees of freedom: ``ndata - nvarys``."""
    chisqr: float
    """Chi-square: the sum of the squared weighted residuals."""
    redchi: float
    """Reduced chi-square: ``chisqr / max(1, nfree)``. About 1 if the model is right and the weights are 1/sigma."""
    aic: float
    """Akaike's information criterion: ``N ln(chisqr / N) + 2 k``."""
    aicc: float
    """``aic + 2 k (k + 1) / (N - k - 1)``, for few measurements (Hurvich and Tsai, Biometrika 76, 1989)."""
    bic: float
    """Bayesian information criterion: ``N ln(chisqr / N) + k ln N``."""
    p_value: float | None
    """Probability of a larger chi-square by chance. None if the noise is not known (`sigma`)."""


class Comparison(NamedTuple):
    """Comparison of two fits to the same measurements. ``print`` shows a table."""

    goodness: tuple[Goodness, Goodness]
    """Statistics of the two fits. If they have different weights, or only one of them minimised the likelihood or has
    known noise, their criteria are those of the likelihood of the measurements, with unknown variances as parameters.
    The table then states this."""
    f: float | None
    """F statistic of the additional parameters of the larger model; None if both have the same number, or if the weights
    differ."""
    p_value: float | None
    """Probability of a larger F if the smaller model is right, for nested models."""
    text: str
    """The table."""

    def __str__(self) -> str:
        return self.text


def of_fit(fit: Fit) -> Goodness:
    """Returns the statistics of a fit."""
    return Goodness(**_export.native_of(fit).goodness())


def compare(fit: Fit, other: Fit) -> Comparison:
    """Compares two fits to the same measurements."""
    found, text = _export.native_of(fit).compare(_export.native_of(other))
    first, second = (Goodness(**fields) for fields in found["fits"])
    return Comparison((first, second), found["f"], found["p_value"], text)
