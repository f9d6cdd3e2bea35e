"""The sum of squared errors, as computed by the paper's tool."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .. import _core
from .._args.keywords import explained
from .._args.values import vector

FloatArray = npt.NDArray[np.float64]


def _rows(name: str, value: npt.ArrayLike) -> FloatArray:
    try:
        array = np.ascontiguousarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise TypeError(f"{name} must be numbers, with rows of equal length") from None
    if array.ndim == 1:
        array = array[np.newaxis, :]
    if array.ndim != 2:
        raise ValueError(f"{name} must be a matrix with one row per quantity, not of shape {array.shape}")
    return array


@explained
def quad_err(
    t_meas: npt.ArrayLike,
    y_meas: npt.ArrayLike,
    t_sim: npt.ArrayLike,
    y_sim: npt.ArrayLike,
    w: npt.ArrayLike | None = None,
) -> float:
    """Weighted sum of squared errors between measured and simulated series.

    The simulation is interpolated linearly at the measured times. If a simulated time occurs several times (an
    event), the mean of the values is used. Measured times outside the simulated span use the end values.

    Parameters
    ----------
    t_meas : array_like, shape (m,)
        Measured times in s.
    y_meas : array_like, shape (m,) or (q, m)
        Measurements, one row per quantity.
    t_sim : array_like, shape (k,)
        Simulated times in s, ascending; a time may occur twice.
    y_sim : array_like, shape (k,) or (q, k)
        Simulated values, one row per quantity.
    w : array_like, shape (q,), or float, optional
        Weights, one per quantity. They multiply the squared errors, not the errors. Default 1.

    Returns
    -------
    float
        The sum; NaN if a used value is NaN.

    Raises
    ------
    ValueError
        Lengths do not match, or simulated times are not ascending.
    TypeError
        Values are not numbers.

    Examples
    --------
    >>> quad_err([0.5, 1.0], [0.0, 0.0], [0.0, 1.0], [0.0, 2.0])
    5.0
    """
    measured, simulated = _rows("y_meas", y_meas), _rows("y_sim", y_sim)
    weights = None if w is None else vector("w", w)
    return _core.quad_err(
        vector("t_meas", t_meas),
        measured,
        vector("t_sim", t_sim),
        simulated,
        weights,
    )


def quad_err_simple(
    t_meas: npt.ArrayLike,
    y_meas: npt.ArrayLike,
    t_sim: npt.ArrayLike,
    y_sim: npt.ArrayLike,
    w: npt.ArrayLike | None = None,
) -> float:
    """Returns the result of `quad_err`.

    In the paper's tool, this function omits the checks to save time. Here the checks cost almost nothing.
    """
    return quad_err(t_meas, y_meas, t_sim, y_sim, w)
