"""Integrate systems written in Python with the stepper that simulates the models: ``pydfo.ode.solve``.

Arguments and results follow SciPy's ``solve_ivp``. Additional features are events that change the state, mass
matrices, and methods for stiff systems that do not slow down in non-stiff phases. `solve_dae` integrates
``F(t, y, y') = 0``, and `solve_second_order` integrates ``x'' = f(t, x, x')``.
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
    """The solution between the steps as a function of time, as accurate as the steps.

    Attributes
    ----------
    ts : ndarray, shape (steps + 1,)
        Ends of the steps in the order of the integration.
    t_min, t_max : float
        First and last time; there is no extrapolation.
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
        """Returns the states at the times `t`: shape (n,) for a number, (n, len(t)) for an array.

        At the time of an event, returns the values after the event.
        """
        times = np.asarray(t, dtype=np.float64)
        if times.ndim > 1:
            raise ValueError(f"t must be a number or one-dimensional, not of shape {times.shape}")
        flat = np.atleast_1d(times)
        slack = 1e-14 * max(abs(self.t_min), abs(self.t_max))
        outside = ~((flat >= self.t_min - slack) & (flat <= self.t_max + slack))
        if outside.any():
            raise ValueError(f"t = {flat[outside][0]} is outside [{self.t_min}, {self.t_max}]")
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
        The requested times, or the ends of the steps. If an event changed the state, the end of the step is listed
        twice: before and after the event.
    y : ndarray, shape (n, m)
        States at these times.
    sol : DenseOutput or None
        The solution as a function of time, if ``dense_output=True``.
    t_events, y_events : list of ndarray, shapes (k,) and (k, n), or None
        Per event function, the times of the events and the states before `on_event` changed them. None without
        events.
    nfev, njev, nlu : int
        Number of right-hand sides (including those for difference quotients of a Jacobian), Jacobians and matrix
        decompositions.
    status : int
        0: the final time was reached; 1: a terminal event occurred; -1: the integration failed.
    message : str
        How the integration ended, with numbers.
    success : bool
        True if `status` is not negative.
    end_time : float
        Last time reached.
    stats : SimulationStats
        Computational cost in more detail.
    seconds, seconds_in_model : float
        Wall-clock time of the integration in s, and the part of it spent in the given functions (an estimate, see
        `SimulationStats`).
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
                # Without a step, store the start as a step of length zero.
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
        ``rhs(t, y) -> array_like, shape (n,)``. The function may keep its arrays. If it returns NaN or infinity, for
        example the logarithm of a negative number, a smaller step is tried. A pulse in `rhs` that is shorter than the
        steps can be missed. To avoid this, pass `max_step` or two event functions, one that crosses zero at the start
        of the pulse and one at its end. A single function for both is missed like the pulse.
    t_span : (float, float)
        Start and end. If the end is before the start, the integration runs backward.
    x0 : array_like, shape (n,)
        States at the start.
    method : str
        "auto" (Tsit5, below rtol 1e-7 DOP853 unless events are close to each other; switches to Radau5 if an
        implicit method advances more per right-hand side, or to BDF for nonlinear systems with at least 16
        states or if the Newton iterations of Radau5 fail), "tsit5", "dop853" (for tight tolerances), "radau5"
        (stiff), "adams" (not stiff, expensive right-hand side, few events), "bdf" (stiff, expensive right-hand
        side, few events); with a fixed `step`, "rk4" and "euler". SciPy's names "RK45", "Radau" and "LSODA" map
        to "tsit5", "radau5" and "auto". "radau5" and "bdf" use dense matrices of n x n entries without
        `jac_sparsity`. If they are too large, a MemoryError is raised before they are allocated.
    t_eval : array_like, shape (m,), optional
        Times at which to store the solution, in the order of the integration and within the span. At a time at which
        `on_event` changes the state, the value after the change is stored. A time listed twice gives the values
        before and after. By default, the ends of the steps are stored.
    dense_output : bool
        If True, also keep the solution as a function of time (`OdeResult.sol`).
    events : callable, or list of callables, optional
        ``event(t, y) -> float``: an event occurs when the value becomes positive or stops being positive. The
        attributes are the same as in SciPy. ``terminal`` is True, or the number of occurrences after which the run ends.
        ``direction`` selects upward (positive) or downward (negative) crossings in the direction of the integration,
        even if it runs backward. Other crossings do not end a step. If a change of the states in `on_event` leaves a
        function at zero, its return to its previous sign is not an event. A bouncing ball therefore needs no
        ``direction``.
    on_event : callable, optional
        ``on_event(t, y, which) -> array_like, shape (n,), or None`` is called at each event. `which` lists the
        indices of the functions that have crossed zero. The integration continues with the returned states. If it
        returns None, it continues with `y`, which may be changed in place. SciPy has no such function; Julia's
        callbacks work like this.
    args : tuple
        Further arguments of all of these functions.
    rtol : float
        Relative tolerance.
    atol : float or array_like, shape (n,), optional
        Absolute tolerance in the units of the states; default: ``0.01 * rtol``. Either tolerance may be zero. If a
        state without absolute tolerance becomes zero, the integration ends with a message.
    jac : callable or array_like, shape (n, n), optional
        ``jac(t, y)``, or the constant Jacobian: ``jac[i, k]`` is the derivative of ``rhs[i]`` with respect to
        ``y[k]``. By default, difference quotients are used. A constant sparse matrix stays sparse. Sparse matrices
        returned by a function stay sparse if `jac_sparsity` is given, otherwise they are converted to dense ones.
        Entries outside `jac_sparsity` are an error.
    jac_sparsity : array_like or sparse matrix, shape (n, n), optional
        Nonzero entries mark possible nonzero entries of the Jacobian. Columns that share no row are computed from one
        difference.
    mass : array_like, shape (n, n), optional
        Constant matrix on the left-hand side. It may be singular (a differential-algebraic system of index 1).
        Equations without a derivative must then hold at the start and after each event. If they do not hold within
        the tolerances, Newton's method corrects the states that they determine and keeps ``mass @ y``. Pass exact
        values of the other states, and guesses of these states. If Newton's method fails, the integration fails and
        the message contains the equation. For "radau5", "bdf" and "auto".
    first_step, max_step : float, optional
        First and largest step. By default, the first step is estimated, and the largest step is the span.
    step : float, optional
        Step of "rk4" and "euler"; default: a 500th of the span.
    interior_samples : int, optional
        Number of points inside each step at which the events are evaluated in addition to its end. Each value is
        compared with the previous one, so that a crossing and its return within one step are detected. The default is
        one ("dop853", "radau5": three). Up to 32 points are added if the curvature of three neighbouring values
        exceeds their distance from zero. An event function near zero after an event that `on_event` has turned back
        or stopped is always followed. Its next crossing is found, or the run fails with a message. Two sign changes
        within one step are missed if they do not show at these points. Examples are a narrow pulse and a function
        with values such as -1 and 1. To detect them, use two functions, `max_step`, or more points. SciPy, MATLAB and
        SUNDIALS evaluate events at the ends of steps only; Julia's OrdinaryDiffEq uses ten points in each step.
    chattering : {"error", "warn", "slide"}
        Action if events follow each other while time hardly advances: a hundred within 1e-6 of the span, or within
        1e-3 if the span is longer than 1000. "error": the integration fails. "warn": it continues and logs a warning,
        but fails if time does not advance at all. "slide": it continues in steps of 1e-5 of the span with the events
        at their ends. The solution then slides along a boundary that it cannot leave. Bodies with decaying bounces
        are held where their event function is zero, on the side from which they came. They are held through the
        states changed by `on_event`, with the change made as strong as necessary; other states are never moved. With
        "slide", a hundred bounces within 1e-4 of the span are the limit.
    max_steps, max_events : int, optional
        Maximum number of steps and events.
    max_time : float, optional
        Limit on the wall-clock time in s, checked between calls of the functions. Also called `timeout`.

    Returns
    -------
    OdeResult
        Fields ``t``, ``y``, ``t_events``, ``y_events``, ``sol``, ``status``, ``message``, ``success``, ``nfev``,
        ``njev``, ``nlu`` and ``stats``. If the integration fails (steps too small, a limit), ``success`` is False,
        ``message`` states the reason, and the result contains the computed part.

    Warns
    -----
    UserWarning
        An argument has no effect with this method (`step` with an adaptive method, `jac` with an explicit method).

    Raises
    ------
    ValueError, TypeError
        Invalid arguments, or a function that returns a wrong shape or type.
    Interrupted
        Ctrl-C was pressed. This KeyboardInterrupt contains the computed part in ``result``.
    Exception
        Exceptions of a function propagate unchanged, with the part that was computed in ``partial_result``.

    Examples
    --------
    A ball that loses a fifth of its speed at each bounce, until the third bounce:

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

    For equations ``mass @ y' = rhs(t, y)`` with a constant matrix, use `solve` with its argument `mass`.

    Parameters
    ----------
    residual : callable
        ``residual(t, y, dy) -> array_like, shape (n,)``, which the solution makes zero. If it returns NaN or
        infinity, a smaller step is tried.
    t_span : (float, float)
        Start and end. If the end is before the start, the integration runs backward.
    x0, dx0 : array_like, shape (n,)
        States and their derivatives at the start; `dx0` is zero by default. The part of `x0` with derivatives in the
        equations (the part on which ``dF/dy'`` acts) is kept. The remaining part, the algebraic variables, and `dx0`
        are guesses. Newton's method changes them until the equations hold. The algebraic variables need not be
        marked. A guess at which ``dF/dy'`` is singular, but not in its neighbourhood (``dy**3 - y`` with
        ``dx0 = 0``), raises an error with an explanation.
    t_eval, dense_output, events, on_event, args, rtol, atol, first_step, max_step, interior_samples, chattering
        As in `solve`. Events are functions of time and states. After a change of the states, the algebraic variables
        are made consistent again.
    jac : callable, or a pair of array_like, optional
        ``jac(t, y, dy) -> (dF/dy, dF/dy')``, both of shape (n, n), or the two matrices if they are constant. By
        default, difference quotients are used. The two matrices are stored separately, so a change of the step needs
        no residual. ``dF/dy'`` is evaluated again only if one residual shows that it has changed.
    jac_sparsity : array_like or sparse matrix, shape (n, n), optional
        Nonzero entries mark possible nonzero entries of the Jacobians. Columns that share no row are computed from
        one difference. The matrices are sparse for at least 100 states with at most 5 % nonzero entries. If they are
        sparse and there are more than 500 states, the message does not report the index. Values at the start are then
        corrected only if each variable clearly has or lacks a derivative in the equations. Equations without a
        derivative that do not hold are an error.
    exclude_algebraic : bool
        If True, exclude variables without a derivative in the equations from the error test. By default they are
        included. With index 1, their errors are as large as the other errors, and nothing else limits them.
    max_steps, max_events, max_time
        Limits, as in `solve`.

    Returns
    -------
    OdeResult
        As in `solve`; ``nfev`` counts residuals, including those for difference quotients. For a system of index 2 or
        higher, ``success`` is False, and the message lists the variables that its equations do not determine. For
        more than 500 states with sparse matrices, see `jac_sparsity`.

    Examples
    --------
    Robertson's reaction with conservation of mass, from a wrong guess of the last concentration:

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
        raise ValueError(f"dx0 must be {len(states)} finite values, one per value of x0, not {slopes}")
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
        Further arguments of `solve`, from `method` on. Their states are ``y = [x, v]``, of shape (2 n,).

    Returns
    -------
    OdeResult
        As in `solve`; ``y[:n]`` are the positions, ``y[n:]`` the velocities.

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
        raise ValueError(f"v0: expected {n} values, as in x0; got {len(v)}")
    if not callable(acceleration):
        raise TypeError(f"acceleration must be callable, not {acceleration!r}")

    def rhs(t: float, y: FloatArray, *more: Any) -> FloatArray:
        a = _values.vector("the result of acceleration", acceleration(t, y[:n], y[n:], *more))
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
    **arguments: Any,
) -> OdeResult:
    """Checks the arguments, named as in `solve`, and integrates.

    `equations` is the name and the function of the equations. With slopes at the start, the function returns the residual.
    """
    on_event, jac, sparsity = arguments["on_event"], arguments["jac"], arguments["jac_sparsity"]
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
        "method": arguments["method"],
        "times": None if arguments["t_eval"] is None else _values.vector("t_eval", arguments["t_eval"]).tolist(),
        "dense_output": _values.flag("dense_output", arguments["dense_output"]),
        "events": [(bind(function), *_marks(i, function)) for i, function in enumerate(_listed(arguments["events"]))],
        "on_event": None if on_event is None else bind(on_event),
        "jacobian": bind(jac) if callable(jac) else jac,
        "sparsity": None if sparsity is None else _pattern(sparsity, n),
        "mass": arguments.get("mass"),
        "rtol": _values.number("rtol", rtol),
        "atol": _tolerances(arguments["atol"], float(rtol), n),
        "interior_samples": _count("interior_samples", arguments["interior_samples"]),
        "chattering": _values.choice("chattering", chattering),
        "slopes": arguments.get("slopes"),
        "exclude_algebraic": arguments.get("exclude_algebraic", False),
    }
    for name in ("first_step", "max_step", "step", "max_time"):
        problem[name] = _values.optional_number(name, arguments.get(name))
    if problem["max_step"] == np.inf:
        problem["max_step"] = None
    for name in ("max_steps", "max_events"):
        problem[name] = _values.limit(name, arguments[name], 0)
    result = _core.solve(problem)
    if result.stats.chattering and chattering == "warn":
        _log.warning("solve: time hardly advanced during %d sequences of 100 events", result.stats.chattering)
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
        raise TypeError(f"events must be a function or a list of functions, not {events!r}") from None
    for i, function in enumerate(functions):
        if not callable(function):
            raise TypeError(f"event {i} must be callable, not {function!r}")
    return functions


def _marks(i: int, function: Callable[..., Any]) -> tuple[float, int]:
    """Returns direction and terminal count (0: never) of an event function."""
    direction = _values.number(f"direction of event {i}", getattr(function, "direction", None) or 0.0)
    if np.isnan(direction):
        raise ValueError(f"direction of event {i} is NaN")
    terminal = getattr(function, "terminal", None)
    # Values accepted by SciPy: True, NumPy's True, a count as int or float.
    return float(np.sign(direction)), _values.limit(f"terminal of event {i}", terminal, 0) or 0


def _count(name: str, value: SupportsIndex | None) -> int | None:
    if value is None:
        return None
    try:
        count = operator.index(value)
    except TypeError:
        raise TypeError(f"{name} must be an integer, not {value!r}") from None
    if not 0 <= count < 2**32:
        raise ValueError(f"{name} = {count} must be at least 0 and below 2**32")
    return count


def _tolerances(atol: npt.ArrayLike | None, rtol: float, n: int) -> list[float]:
    """Returns one absolute tolerance, or one per state."""
    if atol is None:
        if rtol == 0.0:
            raise ValueError("rtol = 0 requires a positive atol")
        return [0.01 * rtol]
    tolerances = _values.vector("atol", atol)
    if np.ndim(atol) > 0 and len(tolerances) != n:
        raise ValueError(f"atol: expected {n} values, one per state; got {len(tolerances)}")
    return [float(v) for v in tolerances]


def _pattern(sparsity: Any, n: int) -> list[tuple[int, int]]:
    """Returns the indices of the nonzero entries of a matrix."""
    # A sparse matrix also has `shape` and `nonzero`, and stays sparse.
    matrix = sparsity if hasattr(sparsity, "tocoo") else np.asarray(sparsity)
    if matrix.shape != (n, n):
        raise ValueError(f"jac_sparsity must have the shape ({n}, {n}), not {matrix.shape}")
    rows, columns = matrix.nonzero()
    return list(zip(rows.tolist(), columns.tolist()))
