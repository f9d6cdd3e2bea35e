"""`Optimizer`: a run that the user drives, asking for points and telling their costs."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from typing import Any, Literal, NamedTuple, SupportsFloat, SupportsIndex

import numpy as np
import numpy.typing as npt

from .. import _core
from .._args import options as _options
from .._args import values as _values
from .._args.keywords import explained
from .minimize import describe
from .result import OptimizeResult

FloatArray = npt.NDArray[np.float64]


class Asked(NamedTuple):
    """Points to evaluate.

    Attributes
    ----------
    ids : ndarray of int, shape (k,)
        Their numbers, to answer by.
    x : ndarray, shape (k, n)
        The points.
    cutoffs : ndarray, shape (k,)
        Above this value the cost of a point makes no difference any more; infinite if there is no such value.
    """

    ids: npt.NDArray[np.uint64]
    x: FloatArray
    cutoffs: FloatArray


class Above(NamedTuple):
    """The value of a point whose evaluation was given up because its cost exceeds the cutoff that came with it.

    It never counts as a cost. A method decides just as it would have with the cost itself.

    Attributes
    ----------
    cutoff : float
        A number that the cost is strictly greater than, at least the cutoff of the point; else the evaluation failed.
    """

    cutoff: float


class Optimizer:
    """A run that you drive: the same trace, bit for bit, as `minimize` makes with the same arguments, whatever the order
    and the pieces in which the answers come.

    Methods work in rounds: `ask` has nothing to give while the last answers of a round are missing.

    Parameters
    ----------
    method : str
        As in `minimize`.
    x0, bounds, rng, max_evaluations, max_iterations, max_time, target, options, checkpoint, resume, search : optional
        As in `minimize`. The checkpoint is written when a round is complete, at the end, and by `save`.
    workers : int
        How many points will be evaluated at once, which a batch plan may follow.

    Examples
    --------
    >>> import pydfo
    >>> opt = pydfo.Optimizer("de", bounds=[(-5, 5), (-5, 5)], rng=1, max_evaluations=600)
    >>> while not opt.done:
    ...     ids, points, _ = opt.ask(4)
    ...     opt.tell(ids, [(x[0] - 1) ** 2 + (x[1] + 2) ** 2 for x in points])
    >>> opt.report().x.round(1)
    array([ 1., -2.])
    """

    @explained
    def __init__(
        self,
        method: str = "auto",
        x0: npt.ArrayLike | None = None,
        bounds: Any = None,
        workers: SupportsIndex = 1,
        rng: int | np.random.Generator | None = None,
        max_evaluations: SupportsFloat | None = None,
        max_iterations: SupportsFloat | None = None,
        max_time: SupportsFloat | None = None,
        target: SupportsFloat | None = None,
        options: Mapping[str, Any] | None = None,
        checkpoint: str | os.PathLike[str] | None = None,
        resume: Literal["auto", "never", "require"] = "auto",
        search: Literal["local", "global"] = "local",
    ) -> None:
        count = _options.worker_count("workers", workers, 1)
        _options.tell_of_checkpoint(checkpoint, resume, options)
        self._native = _core.Optimizer(
            *describe(
                Optimizer,
                method,
                x0,
                bounds,
                options,
                rng=rng,
                checkpoint=checkpoint,
                workers=count,
                max_evaluations=max_evaluations,
                max_iterations=max_iterations,
                max_time=max_time,
                target=target,
                resume=resume,
                search=search,
            )
        )

    def ask(self, k: SupportsIndex | None = None) -> Asked:
        """Points to evaluate, at most `k` (None: all of the round); none while answers are awaited, and after the end."""
        at_most = None if k is None else _values.limit("k", _values.index("k", k), 0)
        return Asked(*self._native.ask(at_most))

    def tell(self, ids: SupportsIndex | Iterable[SupportsIndex], values: Any) -> None:
        """The costs of points, or their residuals ("least-squares"), in any order and in any pieces.

        Parameters
        ----------
        ids : int or sequence of int
            Numbers of points that were asked for.
        values : float or sequence
            Their costs; for "least-squares" their vectors of residuals. None, NaN, infinities and exceptions (the objects) mean that the evaluation failed; `Above` that
            it was given up above the cutoff; Ellipsis gives a point back, to be asked for again.

        Raises
        ------
        KeyError
            A number that is not waiting for an answer; what stands before it is told.
        ValueError, TypeError
            More or fewer values than numbers; a value that is no number, or no vector of residuals where these are wanted.
        Interrupted
            Ctrl-C (a KeyboardInterrupt) while the method chose its next points: the value counts, and the next `ask` goes on with that.
        """
        if type(ids) is np.ndarray and ids.ndim == 1:
            numbers = ids.tolist()
        elif isinstance(ids, Iterable):
            numbers = [_values.index("ids", i) for i in ids]
        else:
            numbers, values = [_values.index("ids", ids)], [values]
        costs = list(values)
        tell = self._native.tell
        if len(numbers) != len(costs):
            raise ValueError(f"{len(costs)} values for {len(numbers)} points")
        for number, cost in zip(numbers, costs):
            if not 0 <= number < 2**64:
                raise KeyError(f"tell called for point {number}, which is not waiting for an answer")
            above = isinstance(cost, Above)
            tell(number, cost.cutoff if above else cost, above)

    @property
    def best(self) -> tuple[FloatArray, float] | None:
        """The best point so far and its cost, of complete rounds; None if there is none."""
        return self._native.best

    @property
    def done(self) -> bool:
        """Whether the run is over."""
        return self._native.termination is not None

    @property
    def n_pending(self) -> int:
        """Points asked for and not told yet."""
        return self._native.n_pending

    def report(self) -> OptimizeResult:
        """The result so far, a `LeastSquaresResult` of "least-squares"; ``termination`` is "interrupted" while the run is not over.

        Raises
        ------
        NoResult
            No point of a complete round had a cost.
        """
        return self._native.report()

    def save(self) -> None:
        """Writes the checkpoint now, with the answers of the round that is under way. Nothing without a checkpoint."""
        self._native.save()

    def stop(self) -> None:
        """Ends the run, if it is not over, with what was told so far."""
        self._native.stop()

    def __repr__(self) -> str:
        state = self._native.termination or "running"
        best = "no cost yet" if self.best is None else f"best {self.best[1]:.6g}"
        return f"<Optimizer: {state}, {best}, {self.n_pending} pending>"
