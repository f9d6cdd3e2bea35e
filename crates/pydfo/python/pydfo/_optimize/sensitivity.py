"""Global sensitivity analysis: the effect of each parameter on each value, over the whole box."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Literal, SupportsFloat, SupportsIndex

import numpy as np
import numpy.typing as npt

from .. import _core
from .._args import bounds as _bounds
from .._args import optional_libraries as _optional_libraries
from .._args import options as _options
from .._args import text as _text
from .._args import values as _values
from .._args.keywords import explained
from . import evaluate as _evaluate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FloatArray = npt.NDArray[np.float64]


class Sensitivity:
    """Effects of parameters on values (`sensitivity`, `Calibration.sensitivity`); printed as a table.

    The arrays have one row per value (`outputs`) and one column per parameter (`names`). The arrays of the other
    method are None. SALib has the same names and estimators.

    Attributes
    ----------
    method : str
        "morris" or "sobol".
    names : list of str
        Names of the free parameters.
    outputs : list of str
        Names of the values.
    mu, mu_star, sigma : ndarray or None
        Mean, mean of the sizes and standard deviation of the elementary effects. They are in units of the value, for a
        change of the parameter over its whole range. `mu_star` ranks the parameters. A `sigma` of the size of
        `mu_star` indicates a nonlinear effect or an interaction.
    mu_star_conf : ndarray or None
        Half widths of the confidence intervals of `mu_star`.
    S1, ST : ndarray or None
        First-order and total-order Sobol' indices: the part of the variance of a value that a parameter causes alone,
        and alone or in interactions. NaN for a constant value.
    S1_conf, ST_conf : ndarray or None
        Half widths of the confidence intervals.
    S2, S2_conf : ndarray, shape (outputs, names, names), or None
        Second-order indices of pairs of parameters with their half widths; NaN on the diagonal.
    reasons : list of str
        Reasons why the effects on a value are NaN; empty if they are not.
    level : float
        Level of the confidence intervals.
    seed : int
        Seed of the random numbers.
    n_evaluations : int
        Number of evaluations.
    n_failed : int
        Number of points with missing values: a failure, NaN or infinity. Missing values are never replaced.
    n_missing : int
        Number of points that were not evaluated, because an interrupt or a time limit ended the analysis.
    n_used : list of int
        Number of complete trajectories or rows of each value. The others are left out.
    failures : dict of str to int
        Reasons of missing values with the number of points, most frequent first.
    x : ndarray, shape (points, n)
        All points, with fixed parameters.
    values : ndarray, shape (points, outputs)
        Values at the points; NaN if missing.
    """

    method: str
    names: list[str]
    outputs: list[str]
    reasons: list[str]
    level: float
    seed: int
    n_evaluations: int
    n_failed: int
    n_missing: int
    n_used: list[int]
    failures: dict[str, int]
    x: FloatArray
    values: FloatArray

    def __init__(self, fields: dict[str, Any]) -> None:
        vars(self).update({name: fields[name] for name in Sensitivity.__annotations__})
        effects: dict[str, FloatArray] = fields["effects"]
        self.mu = effects.get("mu")
        self.mu_star = effects.get("mu_star")
        self.sigma = effects.get("sigma")
        self.mu_star_conf = effects.get("mu_star_conf")
        self.S1 = effects.get("S1")
        self.S1_conf = effects.get("S1_conf")
        self.ST = effects.get("ST")
        self.ST_conf = effects.get("ST_conf")
        n = len(self.names)
        pairs = {name: effects[name].reshape(-1, n, n) for name in ("S2", "S2_conf") if name in effects}
        self.S2 = pairs.get("S2")
        self.S2_conf = pairs.get("S2_conf")
        self._text: str = fields["text"]

    def __repr__(self) -> str:
        return self._text

    def _columns(self) -> dict[str, FloatArray]:
        """Returns the arrays of the method, except the second order."""
        names = ("mu", "mu_star", "sigma", "mu_star_conf", "S1", "S1_conf", "ST", "ST_conf")
        return {name: array for name in names if (array := getattr(self, name)) is not None}

    def table(self) -> list[dict[str, Any]]:
        """Returns one row per value and parameter: ``output``, ``parameter`` and the effects with their half widths.

        Second-order indices are only in `S2`."""
        columns = self._columns()
        return [
            {"output": output, "parameter": name, **{column: float(array[k, i]) for column, array in columns.items()}}
            for k, output in enumerate(self.outputs)
            for i, name in enumerate(self.names)
        ]

    def to_dataframe(self) -> Any:
        """Returns `table` as a pandas.DataFrame. Needs pandas."""
        return _optional_libraries.pandas().DataFrame(self.table())

    def plot(self, outputs: str | Sequence[str] | None = None) -> Figure:
        """Draws a bar plot of the effects with their confidence intervals, one panel per value.

        Parameters
        ----------
        outputs : str or sequence of str, optional
            Names of the values; default: all.

        Returns
        -------
        matplotlib.figure.Figure
            The figure is not shown or saved. Save it with ``found.plot().savefig("sensitivity.png")``.

        Raises
        ------
        ImportError
            matplotlib is not installed.
        ValueError
            There is no value with this name.
        """
        from .. import _plot

        chosen = range(len(self.outputs))
        if outputs is not None:
            given = _values.names("outputs", [outputs] if isinstance(outputs, str) else outputs)
            if unknown := [name for name in given if name not in self.outputs]:
                raise ValueError(f"unknown output '{unknown[0]}'; expected one of: {_text.listed(self.outputs)}")
            return _plot.effects(self, [self.outputs.index(name) for name in given])
        return _plot.effects(self, list(chosen))


class AsVector:
    """Returns the value of a function as a vector, also if it is a single number; picklable if the function is."""

    def __init__(self, fun: Callable[..., Any], ndim: int) -> None:
        self.fun = fun
        self.ndim = ndim

    def __call__(self, x: FloatArray) -> Any:
        value = self.fun(x)
        return [value] if np.ndim(value) == self.ndim - 1 and value is not None else value


def analysis(
    method: str, n: SupportsFloat | None, levels: SupportsFloat | None, second_order: bool, level: SupportsFloat, n_resamples: SupportsFloat | None
) -> tuple[str, int | None, int | None, bool, float, int | None]:
    """Returns the checked numbers of an analysis for the native code."""
    if (word := _values.choice("method", method)) not in ("morris", "sobol"):
        raise ValueError(f"method = {method!r} is invalid; expected one of: 'morris', 'sobol'")
    if word == "sobol" and levels is not None:
        raise ValueError("levels applies to method='morris' only")
    if word == "morris" and _values.flag("second_order", second_order):
        raise ValueError("second_order applies to method='sobol' only")
    counts = _values.limit("n", n, 1), _values.limit("levels", levels, 1)
    return word, *counts, _values.flag("second_order", second_order), _values.number("level", level), _values.limit("n_resamples", n_resamples, 1)


@contextmanager
def partial_results() -> Iterator[None]:
    """Converts the partial result of an exception to a Sensitivity."""
    try:
        yield
    except BaseException as e:
        for name in ("result", "partial_result"):
            if isinstance(found := getattr(e, name, None), dict):
                setattr(e, name, Sensitivity(found))
        raise


@explained
def sensitivity(
    fun: Callable[..., Any],
    bounds: Any,
    *,
    method: Literal["morris", "sobol"] = "morris",
    n: SupportsFloat | None = None,
    names: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    levels: SupportsFloat | None = None,
    second_order: bool = False,
    level: SupportsFloat = 0.95,
    n_resamples: SupportsFloat | None = None,
    scale: str | Sequence[str] = "linear",
    kinds: str | Sequence[str] = "continuous",
    args: Any = (),
    workers: SupportsIndex | Any = 1,
    rng: int | np.random.Generator | None = None,
    max_time: SupportsFloat | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    resume: Literal["auto", "never", "require"] = "auto",
    options: Mapping[str, Any] | None = None,
    on_error: Literal["raise", "fail"] = "raise",
    vectorized: bool = False,
) -> Sensitivity:
    """Estimate the effect of each parameter on each value of a function, over the whole box.

    Morris screening ranks the parameters with few evaluations. Sobol' indices are the parts of the variance that the
    parameters cause. Parameters vary independently and uniformly on their scale. All points can be evaluated at the
    same time. The result does not depend on the number of workers.

    Parameters
    ----------
    fun : callable
        ``fun(x, *args)`` returns a number or a vector of values at `x`, an array of shape (n,). The number of values
        must not change. A value that is NaN or infinite is missing: its trajectory or row is left out of the estimates
        of this value.
    bounds : sequence of pairs, or scipy.optimize.Bounds
        ``(low, high)`` per parameter, finite. Equal bounds fix a parameter, which then has no effect.
    method : {"morris", "sobol"}
        "morris": elementary effects along trajectories on a grid (Morris 1991), with ``n * (D + 1)`` evaluations for D
        free parameters. "sobol": first- and total-order indices from Sobol points (Saltelli et al. 2010, Jansen 1999),
        with ``n * (D + 2)`` evaluations, or ``n * (2 * D + 2)`` with `second_order`; at most 20 free parameters.
    n : int, optional
        Number of trajectories (10), or of rows of Sobol points (1024). Powers of two fill the box most evenly.
    names, outputs : sequence of str, optional
        Names of the parameters (``x[0]``, ...) and of the values (``y[0]``, ...).
    levels : int, optional
        Number of levels of the grid of "morris" (4); even.
    second_order : bool
        If True, "sobol" also estimates the effects of pairs of parameters.
    level : float
        Level of the confidence intervals.
    n_resamples : int, optional
        Number of resamples of the bootstrap (1000) for the confidence intervals.
    scale : {"linear", "log"} or sequence of these
        Scale on which a parameter is uniform, for all or for each.
    kinds : {"continuous", "integer", "categorical"} or sequence of these
        Kind of values, for all or for each. "morris" does not support categorical parameters.
    args : tuple
        Further arguments of `fun`.
    workers, max_time, resume, on_error, vectorized : optional
        As in `least_squares`. After `max_time`, the result contains the effects from the complete trajectories or rows.
    rng : int or numpy.random.Generator, optional
        Seed of the random numbers. Default: drawn, and stored in the result; with `checkpoint` 0, so that the points are
        the same when the analysis is continued.
    checkpoint : path, optional
        File for the evaluations, from which an interrupted analysis continues, as in `minimize`.
    options : dict, optional
        The option ``problem`` of `minimize`, which identifies the function in the checkpoint.

    Returns
    -------
    Sensitivity
        The effects with their confidence intervals.

    Raises
    ------
    ValueError, TypeError
        Invalid arguments.
    CalibrationError
        Fewer than two trajectories or rows have all values.
    CheckpointError, OSError
        As in `minimize`.
    Interrupted
        Ctrl-C was pressed. ``result`` contains the effects from the complete trajectories or rows, if there are at
        least two.
    Exception
        Exceptions of `fun` propagate unchanged, with the effects so far in ``partial_result``.

    Examples
    --------
    >>> import pydfo
    >>> found = pydfo.sensitivity(lambda x: 2 * x[0] - x[1], [(0, 1), (0, 1), (0, 1)], names=["a", "b", "c"], rng=1)
    >>> found.mu.round(6), found.n_evaluations
    (array([[ 2., -1.,  0.]]), 40)
    """
    if not callable(fun):
        raise TypeError(f"fun must be callable, not {fun!r}")
    if on_error not in ("raise", "fail"):
        raise ValueError(f"on_error = {on_error!r} is invalid; expected one of: 'raise', 'fail'")
    numbers = analysis(method, n, levels, second_order, level, n_resamples)
    extra = args if isinstance(args, tuple) else (args,)
    is_vectorized = _values.flag("vectorized", vectorized)
    called = AsVector(_evaluate.WithArguments(fun, extra) if extra else fun, 2 if is_vectorized else 1)
    batches, count = _evaluate.shared_out(called, "workers", workers, 1)
    if is_vectorized:
        if batches is not None:
            raise ValueError("workers must be a number if vectorized=True, because fun evaluates whole batches")
        batches = _evaluate.vectorized(called, of_residuals=True)
    lower, upper = _bounds.pairs_of_bounds(bounds, None)
    requested = _options.record(
        sensitivity,
        "auto",
        options,
        len(lower),
        rng=rng,
        checkpoint=checkpoint,
        function=fun,
        workers=count,
        max_time=max_time,
        resume=resume,
        scale=scale,
        kinds=kinds,
    )
    with partial_results():
        return Sensitivity(
            _core.sensitivity(
                batches or called,
                lower.tolist(),
                upper.tolist(),
                requested,
                numbers,
                [f"x[{i}]" for i in range(len(lower))] if names is None else _values.names("names", names),
                None if outputs is None else _values.names("outputs", outputs),
                failures_allowed=on_error == "fail",
                batches=batches is not None,
            )
        )
