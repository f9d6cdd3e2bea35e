"""Integrate systems written in Python with the stepper that simulates the models: ``pydfo.ode.solve``.

Arguments and results have the shape of SciPy's ``solve_ivp``; what is new are events that change the state, mass matrices,
and methods for stiff systems that do not slow down where the system is not stiff. `solve_dae` integrates
``F(t, y, y') = 0``, `solve_second_order` ``x'' = f(t, x, x')``.
"""

from __future__ import annotations

import logging
import operator
from collections.abc import Callable, Sequence
from typing import Any, Literal, SupportsFloat, SupportsIndex

import numpy as np
import numpy.typing as npt

from . import _core
from ._args import options as _options
from ._args import values as _values
from ._args.keywords import also_called
from ._model.trajectory import SimulationStats

__all__ = ["DenseOutput", "OdeResult", "solve", "solve_dae", "solve_second_order"]

FloatArray = npt.NDArray[np.float64]

_log = logging.getLogger("pydfo")


class DenseOutput:
    """The solution between the steps: a function of time, as accurate as the steps themselves.

    Attributes
    ----------
    ts : ndarray, shape (steps + 1,)
        The ends of the steps, in the order of the integration.
    t_min, t_max : float
        Where it begins and ends; it is not continued beyond.
    """

    def __init__(self, spans: FloatArray, values: FloatArray) -> None:
        self._spans = spans
        self._values = values
        self.ts = np.append(spans[:, 0], spans[-1:, 1])
        self._sign = 1.0 if self.ts[-1] >= self.ts[0] else -1.0
        self.t_min, self.t_max = float(self.ts.min()), float(self.ts.max())
        m = values.shape[1]
        self._nodes = -np.cos(np.pi * np.arange(m) / (m - 1))
        # Barycentric weights of Chebyshev's extreme points (Berrut and Trefethen, SIAM Review 46 (2004) 501, eq. 5.4).
        self._weights = (-1.0) ** np.arange(m)
        self._weights[[0, -1]] *= 0.5

    def __call__(self, t: npt.ArrayLike) -> FloatArray:
        """The states at the times `t`: shape (n,) for a number, (n, len(t)) for an array.

        At the time of an event these are the values after it.
        """
        times = np.asarray(t, dtype=np.float64)
        if times.ndim > 1:
            raise ValueError(f"t must be a number or one-dimensional, not of shape {times.shape}")
        flat = np.atleast_1d(times)
        slack = 1e-14 * max(abs(self.t_min), abs(self.t_max))
        outside = ~((flat >= self.t_min - slack) & (flat <= self.t_max + slack))
        if outside.any():
            raise ValueError(f"t = {flat[outside][0]} lies outside of [{self.t_min}, {self.t_max}]")
        begins = self._sign * self._spans[:, 0]
        which = np.clip(np.searchsorted(begins, self._sign * flat, side="right") - 1, 0, len(begins) - 1)
        start, end = self._spans[which].T
        length = np.where(end != start, end - start, 1.0)
        s = np.clip((2.0 * flat - start - end) / length, -1.0, 1.0)
        distance = s[:, np.newaxis] - self._nodes
        hit = distance == 0.0
        share = self._weights / np.where(hit, 1.0, distance)
        share = np.where(hit.any(axis=1)[:, np.newaxis], hit, share)
        share /= share.sum(axis=1)[:, np.newaxis]
        y: FloatArray = np.einsum("tk,tkn->nt", share, self._values[which])
        return y[:, 0] if times.ndim == 0 else y


class OdeResult:
    """The result of `solve`.

    Attributes
    ----------
    t : ndarray, shape (m,)
        The times that were asked for, or the ends of the steps. Where an event changed the state, the end of a step is
        listed twice: before and after.
    y : ndarray, shape (n, m)
        The states there.
    sol : DenseOutput or None
        The solution as a function of time, if ``dense_output=True``.
    t_events, y_events : list of ndarray, shapes (k,) and (k, n), or None
        Per event function: when it occurred, and the states before `on_event` changed them. None without events.
    nfev, njev, nlu : int
        Right-hand sides (those for differences of a Jacobian included), Jacobians, decompositions of matrices.
    status : int
        0: the final time was reached, 1: a terminal event occurred, -1: the integration failed.
    message : str
        How it ended, with numbers.
    success : bool
        Whether `status` is not negative.
    end_time : float
        The time that was reached.
    stats : SimulationStats
        What it cost, in more detail.
    seconds, seconds_in_model : float
        Wall-clock time of the integration, and the part of it that was spent in the functions given (an estimate, see
        `SimulationStats`), in s.
    """

    def __init__(
        self,
        *,
        t: FloatArray,
        states: FloatArray,
        t_events: list[FloatArray],
        y_events: list[FloatArray],
        status: int,
        message: str,
        end_time: float,
        stats: dict[str, Any],
        spans: FloatArray | None = None,
        values: FloatArray | None = None,
    ) -> None:
        self.t = t
        self.y = states.T
        self.sol = None
        if spans is not None and values is not None:
            if not len(spans) and len(t):
                # Without a step there is the start: a step of length zero.
                spans, values = np.full((1, 2), t[0]), np.stack([states[:1], states[:1]], axis=1)
            self.sol = DenseOutput(spans, values) if len(spans) else None
        self.t_events = t_events if t_events else None
        self.y_events = y_events if t_events else None
        self.stats = SimulationStats(**stats)
        self.nfev = self.stats.right_hand_sides
        self.njev = self.stats.jacobians
        self.nlu = self.stats.decompositions
        self.status = status
        self.message = message
        self.success = status >= 0
        self.end_time = end_time
        self.seconds = self.stats.seconds
        self.seconds_in_model = self.stats.seconds_in_model

    def __repr__(self) -> str:
        n, m = self.y.shape
        return f"<OdeResult: {self.message} t = {self.end_time}, {n} states at {m} times, nfev = {self.nfev}>"


@also_called(timeout="max_time")
def solve(
    rhs: Callable[..., npt.ArrayLike],
    t_span: Sequence[SupportsFloat],
    x0: npt.ArrayLike,
    method: str = "auto",
    t_eval: npt.ArrayLike | None = None,
    dense_output: bool = False,
    events: Callable[..., SupportsFloat] | Sequence[Callable[..., SupportsFloat]] | None = None,
    *,
    on_event: Callable[..., npt.ArrayLike | None] | None = None,
    args: Sequence[Any] = (),
    rtol: SupportsFloat = 1e-6,
    atol: npt.ArrayLike | None = None,
    jac: Callable[..., npt.ArrayLike] | npt.ArrayLike | None = None,
    jac_sparsity: npt.ArrayLike | None = None,
    mass: npt.ArrayLike | None = None,
    first_step: SupportsFloat | None = None,
    max_step: SupportsFloat | None = None,
    step: SupportsFloat | None = None,
    interior_samples: SupportsIndex | None = None,
    chattering: Literal["error", "warn", "slide"] = "error",
    max_steps: SupportsFloat | None = None,
    max_events: SupportsFloat | None = None,
    max_time: SupportsFloat | None = None,
) -> OdeResult:
    """Integrate ``y' = rhs(t, y)``, or ``mass @ y' = rhs(t, y)``, with events that may change the state.

    Parameters
    ----------
    rhs : callable
        ``rhs(t, y) -> array_like, shape (n,)``. The arrays it is given are its to keep. Where it returns NaN or infinity
        (the logarithm of a negative number, say) a smaller step is tried. A pulse in it that is shorter than the steps can
        be missed: give two event functions, one that crosses zero where it begins and one where it ends (a single one
        that does both is missed like the pulse), or `max_step`.
    t_span : (float, float)
        Start and end. Where the end lies before the start the integration leads backward.
    x0 : array_like, shape (n,)
        States at the start.
    method : str
        "auto" (Tsit5, below rtol 1e-7 DOP853; where an implicit method advances more per right-hand side Radau5, or BDF for
        nonlinear systems of 16 states and more), "tsit5", "dop853" (for tight tolerances), "radau5" (stiff), "bdf" (stiff,
        expensive right-hand side, few events); with a fixed `step`, "rk4" and "euler". SciPy's names "RK45", "Radau" and
        "LSODA" stand for "tsit5", "radau5" and "auto". "radau5" and "bdf" take dense matrices of n x n entries unless
        `jac_sparsity` tells otherwise; a MemoryError says so before they are too large.
    t_eval : array_like, shape (m,), optional
        When to store the solution: in the order of the integration, within the span. A time at which `on_event` changes the state holds the
        value after it; listed twice, the values before and after. By default the ends of the steps are stored.
    dense_output : bool
        Keep the solution as a function of time, too (`OdeResult.sol`).
    events : callable, or list of callables, optional
        ``event(t, y) -> float``: an event occurs where it becomes positive or stops being positive. Its attributes are
        those of SciPy: ``terminal`` (True, or after how many occurrences the run ends) and ``direction`` (positive: only
        upward, negative: only downward crossings are events, as seen along the integration, also where that leads backward;
        the others do not even end a step). A function that
        is left at zero by a change of the states in `on_event`, on its way back to the sign it had, has no event when it
        gets there: a ball bounces without a ``direction``, too.
    on_event : callable, optional
        ``on_event(t, y, which) -> array_like, shape (n,), or None``: called at each event with the list `which` of the
        positions of the functions that have crossed; returns the states to go on with, or None: then those in `y` are taken,
        which may be changed in place (SciPy has no such function; Julia's callbacks work like this).
    args : tuple
        Further arguments for all of these functions.
    rtol : float
        Relative tolerance.
    atol : float or array_like, shape (n,), optional
        Absolute tolerance, in the units of the states; by default ``0.01 * rtol``. Either tolerance may be zero. A state
        that becomes zero where it has no absolute tolerance ends the integration, which says so.
    jac : callable or array_like, shape (n, n), optional
        ``jac(t, y)``, or the constant Jacobian: ``jac[i, k]`` is the derivative of ``rhs[i]`` with respect to ``y[k]``.
        By default differences. A constant sparse matrix stays sparse, and so do those that a function returns where
        `jac_sparsity` is given; without it they are made dense. Entries where `jac_sparsity` has none are an error.
    jac_sparsity : array_like or sparse matrix, shape (n, n), optional
        Not zero where the Jacobian may differ from zero: columns that share no row then come from one difference.
    mass : array_like, shape (n, n), optional
        The constant matrix on the left. It may be singular (a differential-algebraic system of index 1). Then the
        equations in which no derivative stands must hold at the start and after each event. Where they do not, within
        the tolerances, the states that they decide are corrected by Newton's method, with ``mass @ y`` as it was: give
        the others exactly, and for these a guess. If that finds none the integration fails and names the equation. For
        "radau5", "bdf" and "auto".
    first_step, max_step : float, optional
        First and largest step. By default the first step is estimated, and the largest is the span.
    step : float, optional
        Step of "rk4" and "euler"; by default a 500th of the span.
    interior_samples : int, optional
        At how many points inside each step the events are looked at besides its end, each compared with the one before,
        so that a crossing and its return do not hide in one step. By default one ("dop853", "radau5": three), and up to 32
        more where three neighbouring values bend by more than they stay away from zero. An event function
        next to zero after its event that `on_event` has turned back, or stopped, is always followed: its next crossing is
        found, or the run fails and says so. A function that changes its sign twice within one step and shows nothing of it at these points (a
        narrow pulse in it, a function of values like -1 and 1) is not seen: use two functions, `max_step`, or more points
        (SciPy, MATLAB and SUNDIALS look at the ends of steps alone, Julia's OrdinaryDiffEq at ten points in each).
    chattering : {"error", "warn", "slide"}
        What to do where events follow each other while time hardly advances (a hundred within 1e-6 of the span, or within
        1e-3 where the span is longer than 1000): fail; go on and log a warning (an error still where time stands still);
        or go on in steps of 1e-5 of the span at whose ends the events happen, which slides along a border that the
        solution cannot leave. Bodies that bounce less and less are held where their event function is zero then, on the side
        they came from, by what `on_event` has changed, made as strong as it takes: other states are never moved. With "slide"
        a hundred bounces within 1e-4 of the span are too many.
    max_steps, max_events : int, optional
        Limits.
    max_time : float, optional
        Limit of wall-clock time in s, looked at between calls of the functions (also called `timeout`).

    Returns
    -------
    OdeResult
        With fields ``t``, ``y``, ``t_events``, ``y_events``, ``sol``, ``status``, ``message``, ``success``, ``nfev``,
        ``njev``, ``nlu`` and ``stats``. An integration that fails (steps too small, a limit) has ``success=False``, says
        why in ``message``, and holds what was reached.

    Warns
    -----
    UserWarning
        An argument has no effect with this method (`step` where it chooses its steps itself, `jac` where it is explicit).

    Raises
    ------
    ValueError, TypeError
        Arguments that cannot be used; a function that returns something of the wrong shape or type.
    Interrupted
        Ctrl-C: a KeyboardInterrupt with what was reached in ``result``.
    Exception
        Whatever a function raises comes out as it is, with what was reached in ``partial_result``.

    Examples
    --------
    A ball that loses a fifth of its speed at each bounce, until the third:

    >>> from pydfo import ode
    >>> def height(t, y):
    ...     return y[0]
    >>> height.direction, height.terminal = -1, 3
    >>> res = ode.solve(lambda t, y: [y[1], -9.81], (0, 10), [1.0, 0.0], events=height,
    ...                 on_event=lambda t, y, which: [0.0, -0.8 * y[1]])
    >>> res.t_events[0].round(6)
    array([0.451524, 1.173961, 1.751912])
    >>> res.message
    'A terminal event occurred.'
    """
    return _run(
        ("rhs", rhs),
        t_span,
        x0,
        method=_options.solver(method, "method"),
        t_eval=t_eval,
        dense_output=dense_output,
        events=events,
        on_event=on_event,
        args=args,
        rtol=rtol,
        atol=atol,
        jac=jac,
        jac_sparsity=jac_sparsity,
        mass=mass,
        first_step=first_step,
        max_step=max_step,
        step=step,
        interior_samples=interior_samples,
        chattering=chattering,
        max_steps=max_steps,
        max_events=max_events,
        max_time=max_time,
    )


@also_called(timeout="max_time")
def solve_dae(
    residual: Callable[..., npt.ArrayLike],
    t_span: Sequence[SupportsFloat],
    x0: npt.ArrayLike,
    dx0: npt.ArrayLike | None = None,
    t_eval: npt.ArrayLike | None = None,
    dense_output: bool = False,
    events: Callable[..., SupportsFloat] | Sequence[Callable[..., SupportsFloat]] | None = None,
    *,
    on_event: Callable[..., npt.ArrayLike | None] | None = None,
    args: Sequence[Any] = (),
    rtol: SupportsFloat = 1e-6,
    atol: npt.ArrayLike | None = None,
    jac: Callable[..., Sequence[npt.ArrayLike]] | Sequence[npt.ArrayLike] | None = None,
    jac_sparsity: npt.ArrayLike | None = None,
    exclude_algebraic: bool = False,
    first_step: SupportsFloat | None = None,
    max_step: SupportsFloat | None = None,
    interior_samples: SupportsIndex | None = None,
    chattering: Literal["error", "warn", "slide"] = "error",
    max_steps: SupportsFloat | None = None,
    max_events: SupportsFloat | None = None,
    max_time: SupportsFloat | None = None,
) -> OdeResult:
    """Integrate ``residual(t, y, y') = 0``, a differential-algebraic system of index 0 or 1, by BDF of order 1 to 5.

    Where the equations are ``mass @ y' = rhs(t, y)`` with a constant matrix, `solve` with its argument `mass` takes them as
    they are.

    Parameters
    ----------
    residual : callable
        ``residual(t, y, dy) -> array_like, shape (n,)``: what is to be zero. Where it returns NaN or infinity a smaller step is
        tried.
    t_span : (float, float)
        Start and end. Where the end lies before the start the integration leads backward.
    x0, dx0 : array_like, shape (n,)
        States and their derivatives at the start; `dx0` is zero by default. Of `x0` counts what has a derivative in the
        equations (the part that ``dF/dy'`` acts on). The rest, the algebraic variables, and `dx0` are guesses: Newton's
        method changes them until the equations hold, which need no mark of the algebraic variables. A guess at which
        ``dF/dy'`` is singular while it is not near it (``dy**3 - y`` with ``dx0 = 0``) is an error that says so.
    t_eval, dense_output, events, on_event, args, rtol, atol, first_step, max_step, interior_samples, chattering
        As for `solve`. Events are functions of time and states. After a change of the states the algebraic
        variables are made consistent again.
    jac : callable, or a pair of array_like, optional
        ``jac(t, y, dy) -> (dF/dy, dF/dy')``, both of shape (n, n), or these two where they are constant. By default differences:
        the two are kept apart, so that a change of the step takes no residual, and ``dF/dy'`` is only evaluated again where
        one residual shows that it has changed.
    jac_sparsity : array_like or sparse matrix, shape (n, n), optional
        Not zero where one of the Jacobians may differ from zero: columns that share no row then come from one difference.
        Where it makes the matrices sparse (100 states and more, at most 5 % of the places) and there are more than 500
        states, the index is not named, and values at the start are only corrected where each variable either has a
        derivative in the equations or not; equations without a derivative that do not hold are an error.
    exclude_algebraic : bool
        Leave variables without a derivative in the equations out of the error test. By default they are in it: with index 1
        their errors are of the size of the others', and nothing else would limit them.
    max_steps, max_events, max_time
        Limits, as for `solve`.

    Returns
    -------
    OdeResult
        As from `solve`; ``nfev`` counts residuals, those for differences included. A system of index 2 or higher has
        ``success=False`` and a message that names the variables which its equations do not determine (for more than 500
        states with sparse matrices see `jac_sparsity`).

    Examples
    --------
    Robertson's reaction with the conservation of mass, from a wrong guess of the last concentration:

    >>> from pydfo import ode
    >>> def residual(t, y, dy):
    ...     r = 0.04 * y[0] - 1e4 * y[1] * y[2]
    ...     return [dy[0] + r, dy[1] - r + 3e7 * y[1] ** 2, y.sum() - 1]
    >>> res = ode.solve_dae(residual, (0, 40), [1.0, 0.0, 0.7], rtol=1e-8, atol=1e-12)
    >>> res.y[:, 0].round(9), res.y[:, -1].round(6)
    (array([1., 0., 0.]), array([7.15827e-01, 9.00000e-06, 2.84164e-01]))
    """
    states = _values.vector("x0", x0)
    slopes = np.zeros(len(states)) if dx0 is None else _values.vector("dx0", dx0)
    if len(slopes) != len(states) or not np.isfinite(slopes).all():
        raise ValueError(f"dx0 must be {len(states)} finite values, as x0, not {slopes}")
    if jac is not None and not callable(jac):
        pair = tuple(jac)
        if len(pair) != 2:
            raise ValueError(f"jac must be two matrices, dF/dy and dF/dy', not {len(pair)}")
    return _run(
        ("residual", residual),
        t_span,
        x0,
        method="bdf",
        t_eval=t_eval,
        dense_output=dense_output,
        events=events,
        on_event=on_event,
        args=args,
        rtol=rtol,
        atol=atol,
        jac=jac if jac is None or callable(jac) else lambda t, y, dy, *more: pair,
        jac_sparsity=jac_sparsity,
        first_step=first_step,
        max_step=max_step,
        interior_samples=interior_samples,
        chattering=chattering,
        max_steps=max_steps,
        max_events=max_events,
        max_time=max_time,
        slopes=slopes.tolist(),
        exclude_algebraic=_values.flag("exclude_algebraic", exclude_algebraic),
    )


def solve_second_order(
    acceleration: Callable[..., npt.ArrayLike],
    t_span: Sequence[SupportsFloat],
    x0: npt.ArrayLike,
    v0: npt.ArrayLike,
    *args: Any,
    **options: Any,
) -> OdeResult:
    """Integrate ``x'' = acceleration(t, x, x')``.

    Parameters
    ----------
    acceleration : callable
        ``acceleration(t, x, v) -> array_like, shape (n,)``.
    t_span : (float, float)
        Start and end.
    x0, v0 : array_like, shape (n,)
        Positions and velocities at the start.
    *args, **options
        The further arguments of `solve`, from `method` on; for all of them the states are ``y = [x, v]``, of shape (2 n,).

    Returns
    -------
    OdeResult
        As from `solve`: ``y[:n]`` are the positions, ``y[n:]`` the velocities.

    Examples
    --------
    >>> import numpy as np
    >>> from pydfo import ode
    >>> res = ode.solve_second_order(lambda t, x, v: -x, (0, np.pi), [1.0], [0.0], rtol=1e-9)
    >>> res.y[:, -1].round(6) + 0.0
    array([-1.,  0.])
    """
    x, v = _values.vector("x0", x0), _values.vector("v0", v0)
    n = len(x)
    if len(v) != n:
        raise ValueError(f"v0 has {len(v)} values, x0 has {n}")
    if not callable(acceleration):
        raise TypeError(f"acceleration must be callable, not {acceleration!r}")

    def rhs(t: float, y: FloatArray, *more: Any) -> FloatArray:
        a = _values.vector("what acceleration returns", acceleration(t, y[:n], y[n:], *more))
        if len(a) != n:
            raise ValueError(f"acceleration must return an array of shape ({n},), not one of shape {a.shape}")
        return np.concatenate((y[n:], a))

    return solve(rhs, t_span, np.concatenate((x, v)), *args, **options)


def _run(
    equations: tuple[str, Callable[..., npt.ArrayLike]],
    t_span: Sequence[SupportsFloat],
    x0: npt.ArrayLike,
    rtol: SupportsFloat,
    chattering: str,
    args: Sequence[Any],
    **asked: Any,
) -> OdeResult:
    """Checks the arguments, which have the names that they have in `solve`, and integrates; `equations` is the function with its
    name. With slopes at the start it returns the residual."""
    on_event, jac, sparsity = asked["on_event"], asked["jac"], asked["jac_sparsity"]
    for name, function in (equations, ("on_event", on_event)):
        if not callable(function) and (name != "on_event" or function is not None):
            raise TypeError(f"{name} must be callable, not {function!r}")
    start, end = _span(t_span)
    x = _values.vector("x0", x0)
    if not np.isfinite(x).all():
        raise ValueError(f"x0 must be finite, not {x}")
    n = len(x)
    try:
        extra = tuple(args)
    except TypeError:
        raise TypeError(f"args must be a tuple of further arguments, such as (2.0,), not {args!r}") from None

    def bind(function: Callable[..., Any]) -> Callable[..., Any]:
        return (lambda *given: function(*given, *extra)) if extra else function

    problem: _options.Record = {
        "rhs": bind(equations[1]),
        "start": start,
        "end": end,
        "x0": x.tolist(),
        "method": asked["method"],
        "times": None if asked["t_eval"] is None else _values.vector("t_eval", asked["t_eval"]).tolist(),
        "dense_output": _values.flag("dense_output", asked["dense_output"]),
        "events": [(bind(function), *_marks(i, function)) for i, function in enumerate(_listed(asked["events"]))],
        "on_event": None if on_event is None else bind(on_event),
        "jacobian": bind(jac) if callable(jac) else jac,
        "sparsity": None if sparsity is None else _pattern(sparsity, n),
        "mass": asked.get("mass"),
        "rtol": _values.number("rtol", rtol),
        "atol": _tolerances(asked["atol"], float(rtol), n),
        "interior_samples": _count("interior_samples", asked["interior_samples"]),
        "chattering": _values.choice("chattering", chattering),
        "slopes": asked.get("slopes"),
        "exclude_algebraic": asked.get("exclude_algebraic", False),
    }
    for name in ("first_step", "max_step", "step", "max_time"):
        problem[name] = _values.optional_number(name, asked.get(name))
    if problem["max_step"] == np.inf:
        problem["max_step"] = None
    for name in ("max_steps", "max_events"):
        problem[name] = _values.limit(name, asked[name], 0)
    result = _core.solve(problem)
    if result.stats.chattering and chattering == "warn":
        _log.warning("solve: %d times a hundred events hardly advanced time", result.stats.chattering)
    return result


def _span(t_span: Sequence[SupportsFloat]) -> tuple[float, float]:
    try:
        start, end = map(float, t_span)
    except (TypeError, ValueError):
        raise ValueError(f"t_span must be two numbers, start and end, not {t_span!r}") from None
    return start, end


def _listed(events: Any) -> list[Callable[..., Any]]:
    try:
        functions = [] if events is None else [events] if callable(events) else list(events)
    except TypeError:
        raise TypeError(f"events must be a function, or several in a list, not {events!r}") from None
    for i, function in enumerate(functions):
        if not callable(function):
            raise TypeError(f"event {i} must be callable, not {function!r}")
    return functions


def _marks(i: int, function: Callable[..., Any]) -> tuple[float, int]:
    """Direction and terminal count (0: never) of an event function."""
    direction = _values.number(f"direction of event {i}", getattr(function, "direction", None) or 0.0)
    if np.isnan(direction):
        raise ValueError(f"direction of event {i} is NaN")
    terminal = getattr(function, "terminal", None)
    # Whatever SciPy takes: True, NumPy's True, a count as int or float.
    return float(np.sign(direction)), _values.limit(f"terminal of event {i}", terminal, 0) or 0


def _count(name: str, value: SupportsIndex | None) -> int | None:
    if value is None:
        return None
    try:
        count = operator.index(value)
    except TypeError:
        raise TypeError(f"{name} must be a whole number, not {value!r}") from None
    if not 0 <= count < 2**32:
        raise ValueError(f"{name} = {count} must not be negative, and below 2**32")
    return count


def _tolerances(atol: npt.ArrayLike | None, rtol: float, n: int) -> list[float]:
    """One absolute tolerance, or one per state."""
    if atol is None:
        if rtol == 0.0:
            raise ValueError("rtol = 0 needs a positive atol")
        return [0.01 * rtol]
    tolerances = _values.vector("atol", atol)
    if np.ndim(atol) > 0 and len(tolerances) != n:
        raise ValueError(f"atol has {len(tolerances)} values for {n} states")
    return [float(v) for v in tolerances]


def _pattern(sparsity: Any, n: int) -> list[tuple[int, int]]:
    """The places of a matrix that are not zero."""
    # A sparse matrix has these two as well, and is not made dense.
    matrix = sparsity if hasattr(sparsity, "tocoo") else np.asarray(sparsity)
    if matrix.shape != (n, n):
        raise ValueError(f"jac_sparsity must have the shape ({n}, {n}), not {matrix.shape}")
    rows, columns = matrix.nonzero()
    return list(zip(rows.tolist(), columns.tolist()))
