"""Systems written in Python: agreement with SciPy and closed forms, events that change the state, and
terminations."""

from __future__ import annotations

import math
import signal
import time

from conftest import press_ctrl_c
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.sparse import csr_matrix, diags

import pydfo
from pydfo import ode

ADAPTIVE = ["auto", "tsit5", "dop853", "radau5", "bdf"]
STIFF = ["auto", "radau5", "bdf"]


def circle(t, y):
    return [y[1], -y[0]]


def robertson(t, y):
    a, b, c = 0.04 * y[0], 1e4 * y[1] * y[2], 3e7 * y[1] ** 2
    return [b - a, a - b - c, c]


def robertson_jacobian(t, y):
    return [[-0.04, 1e4 * y[2], 1e4 * y[1]], [0.04, -1e4 * y[2] - 6e7 * y[1], -1e4 * y[1]], [0, 6e7 * y[1], 0]]


def lotka(t, y, a, b):
    return np.array([a * y[0] - y[0] * y[1], b * y[0] * y[1] - y[1]])


@pytest.mark.parametrize("method", ADAPTIVE)
def test_solution_matches_closed_form_at_requested_times(method):
    t = np.linspace(0.0, 10.0, 37)
    res = ode.solve(circle, (0, 10), [0.0, 1.0], method, t, rtol=1e-9, atol=1e-9)
    assert np.array_equal(res.t, t) and res.y.shape == (2, 37)
    assert np.abs(res.y - [np.sin(t), np.cos(t)]).max() < 2e-7
    assert res.success and res.status == 0 and res.end_time == 10.0 and res.sol is None and res.t_events is None


@pytest.mark.parametrize("method", ADAPTIVE)
def test_solution_agrees_with_scipy(method):
    t = np.linspace(0.0, 15.0, 31)
    reference = solve_ivp(lotka, (0, 15), [1.5, 1.0], "DOP853", t, rtol=1e-12, atol=1e-12, args=(1.2, 0.8))
    res = ode.solve(lotka, (0, 15), [1.5, 1.0], method, t, rtol=1e-8, atol=1e-10, args=(1.2, 0.8))
    assert np.abs(res.y / reference.y - 1).max() < (2e-5 if method == "bdf" else 1e-6)


@pytest.mark.parametrize("method", STIFF)
@pytest.mark.parametrize("jac", [None, robertson_jacobian, lambda t, y: csr_matrix(robertson_jacobian(t, y))])
def test_stiff_solution_agrees_with_scipy(method, jac):
    t = [1e-2, 1.0, 1e2, 1e4]
    reference = solve_ivp(robertson, (0, 1e4), [1, 0, 0], "Radau", t, rtol=1e-11, atol=1e-16, jac=robertson_jacobian)
    res = ode.solve(robertson, (0, 1e4), [1, 0, 0], method, t, rtol=1e-7, atol=1e-13, jac=jac)
    assert np.abs(res.y / reference.y - 1).max() < 1e-4
    assert res.njev > 0 and res.nlu > 0 and res.stats.newton_iterations > 0
    assert res.nfev < 4000


def test_ends_of_steps_are_stored_by_default():
    for method in [*ADAPTIVE, "rk4"]:
        res = ode.solve(circle, (0, 5), [0.0, 1.0], method, dense_output=True, rtol=1e-9, atol=1e-9, max_step=None if method == "rk4" else 0.5)
        assert len(res.t) == res.stats.accepted_steps + 1
        assert res.t[0] == 0.0 and res.t[-1] == 5.0 and np.diff(res.t).max() <= 0.5
        assert np.array_equal(res.sol.ts, res.t)
        assert np.abs(res.sol(res.t) - res.y).max() < 1e-14
        t = np.linspace(0, 5, 1001)
        bar = 1e-6 if method == "bdf" else 1e-7
        assert np.abs(res.sol(t) - [np.sin(t), np.cos(t)]).max() < bar, method
        assert res.sol(1.0).shape == (2,)
    with pytest.raises(ValueError, match=r"6\.0 is outside \[0\.0, 5\.0\]"):
        res.sol(6.0)


@pytest.mark.parametrize(("method", "end"), [("bdf", 0.3), ("radau5", 0.03)])
def test_constant_jacobian_and_pattern_reduce_evaluations(method, end):
    n = 30
    heat = (n + 1) ** 2 * diags([1.0, -2.0, 1.0], [-1, 0, 1], (n, n)).toarray()
    x0 = np.sin(np.pi * np.arange(1, n + 1) / (n + 1))
    decay = 2 * (n + 1) ** 2 * (np.cos(np.pi / (n + 1)) - 1)
    plain = ode.solve(lambda t, y: heat @ y, (0, end), x0, method)
    coloured = ode.solve(lambda t, y: heat @ y, (0, end), x0, method, jac_sparsity=csr_matrix(heat))
    given = ode.solve(lambda t, y: heat @ y, (0, end), x0, method, jac=heat)
    for res in plain, coloured, given:
        assert np.abs(res.y[:, -1] - x0 * math.exp(end * decay)).max() < 1e-5
        # Equal steps with one Jacobian: only the evaluations for the Jacobian differ.
        assert (len(res.t), res.njev) == (len(given.t), 1)
    assert (plain.nfev - given.nfev, coloured.nfev - given.nfev) == (n, 3)


@pytest.mark.parametrize("method", ADAPTIVE)
def test_events_agree_with_scipy(method):
    def up(t, y):
        return y[0] - 0.5

    def both(t, y):
        return y[1]

    up.direction = 1
    ours = ode.solve(circle, (0, 12), [0.0, 1.0], method, events=[up, both], rtol=1e-9, atol=1e-9)
    theirs = solve_ivp(circle, (0, 12), [0.0, 1.0], "DOP853", events=[up, both], rtol=1e-11, atol=1e-12)
    for a, b in zip(ours.t_events, theirs.t_events):
        assert len(a) == len(b) and np.abs(a - b).max() < 1e-6
    for a, b in zip(ours.y_events, theirs.y_events):
        assert a.shape == b.shape and np.abs(a - b).max() < 1e-6
    assert [len(t) for t in ours.t_events] == [2, 4]
    assert ours.status == theirs.status == 0


@pytest.mark.parametrize("method", ADAPTIVE)
def test_crossings_in_other_direction_are_ignored(method):
    def up(t, y):
        return y[0] - 0.5

    up.direction = 1
    called = []
    res = ode.solve(circle, (2, 5), [1.0, 0.0], method, events=up, on_event=lambda t, y, which: called.append(which))
    # Down through 0.5 at 2 + pi / 3: this crossing does not end a step and is not counted.
    plain = ode.solve(circle, (2, 5), [1.0, 0.0], method)
    assert called == [] and res.stats.events == 0 and res.t_events[0].tolist() == []
    assert np.array_equal(res.t, plain.t) and np.array_equal(res.y, plain.y)
    up.direction = -1
    res = ode.solve(circle, (2, 5), [1.0, 0.0], method, events=up, on_event=lambda t, y, which: called.append(which))
    assert called == [[0]] and res.stats.events == 1 and abs(res.t_events[0][0] - 2 - math.pi / 3) < 1e-4


def test_terminal_events_end_the_run():
    def ground(t, y):
        return y[0]

    ground.terminal, ground.direction = True, -1
    res = ode.solve(lambda t, y: [y[1], -9.81], (0, 100), [0.0, 10.0], events=ground)
    assert res.status == 1 and res.success and abs(res.end_time - 20 / 9.81) < 1e-12 and res.t[-1] == res.end_time
    res = ode.solve(lambda t, y: [y[1], -9.81], (0, 100), [0.0, 10.0], t_eval=[1.0, 50.0], events=ground)
    assert res.t.tolist() == [1.0]


@pytest.mark.parametrize("method", ADAPTIVE)
def test_events_change_the_state(method):
    def height(t, y, loss):
        return y[0]

    def bounce(t, y, which, loss):
        assert which == [0]
        return [0.0, -loss * y[1]]

    height.direction, height.terminal = -1, 11
    res = ode.solve(
        lambda t, y, loss: [y[1], -9.81],
        (0, 4),
        [1.0, 0.0],
        method,
        events=height,
        on_event=bounce,
        args=(0.7,),
        rtol=1e-9,
        dense_output=True,
    )
    # The ball of the FMI reference models: closed form.
    expected = {0: 0.45152364098573090445, 1: 1.0836567383657541707, 9: 2.4736044636412544968, 10: 2.4991133142246206853}
    for k, t in expected.items():
        assert abs(res.t_events[0][k] - t) < (1e-12 if method not in ("radau5", "bdf") else 1e-7)
    assert res.y_events[0].shape == (11, 2) and (res.y_events[0][:, 1] < 0).all()
    # The result contains both sides of each event; the dense output uses the right side.
    first = res.t_events[0][0]
    at = np.flatnonzero(res.t == first)
    assert len(at) == 2 and res.y[1, at[0]] < -4 and res.y[1, at[1]] > 3
    assert np.allclose(res.sol(first), res.y[:, at[1]], atol=1e-12)
    # The upward crossing at zero is not an event.
    assert res.stats.state_events == 11 and res.stats.restarts == 10


@pytest.mark.parametrize("method", ["auto", "tsit5", "dop853", "radau5"])
def test_bouncing_ball_stays_above_the_floor(method):
    def height(t, y):
        return y[0]

    height.direction = -1
    res = ode.solve(lambda t, y: [y[1], -9.81], (0, 4), [1.0, 0.0], method, events=height, on_event=lambda t, y, which: [0.0, -0.7 * y[1]])
    assert not res.success and res.message.startswith("chattering at t = 2.5586")
    assert abs(res.end_time - 2.5586339655858085) < 1e-6 and res.y[0].min() > -1e-9


def test_handler_may_change_states_in_place():
    def bounce(t, y, which):
        y[1] = -0.8 * y[1]

    def returned(t, y, which):
        return [y[0], -0.8 * y[1]]

    def nothing(t, y, which):
        return None

    def broken(t, y, which):
        y[1] = math.nan

    def run(handler):
        return ode.solve(lambda t, y: [y[1], -9.81], (0, 1.5), [1.0, 0.0], events=lambda t, y: y[0], on_event=handler)

    assert np.array_equal(run(bounce).y, run(returned).y) and len(run(bounce).t_events[0]) == 2
    assert len(run(nothing).t_events[0]) == 1 and run(nothing).y[0, -1] < -1
    with pytest.raises(ValueError, match="on_event returned NaN for state 1 at t = 0.45"):
        run(broken)


@pytest.mark.parametrize("method", ADAPTIVE)
@pytest.mark.parametrize("sign", [1, -1])
def test_resting_body_stays_on_its_side_for_both_signs(method, sign):
    # Bounces accumulate at t = 1.35.
    for floor, declared, handler in (
        (0.0, False, lambda t, y, which: [0.0, abs(0.5 * y[1])]),
        (100.0, False, lambda t, y, which: [y[0], -0.5 * y[1]] if y[1] < 0 else None),
        (-3.0, True, lambda t, y, which: [-3.0, -0.5 * y[1]]),
    ):

        def event(t, y):
            return sign * (y[0] - floor)

        if declared:
            event.direction = -sign
        res = ode.solve(
            lambda t, y: [y[1], -9.81],
            (0, 1.4),
            [floor + 1.0, 0.0],
            method,
            events=event,
            on_event=handler,
            chattering="slide",
        )
        assert res.success and res.y[0].min() > floor - 1e-6 and abs(res.y[0, -1] - floor) < 1e-6


def test_time_requested_twice_gives_both_sides_of_event():
    def clock(t, y):
        return t - 0.5

    def double(t, y, which):
        return 2.0 * y

    res = ode.solve(lambda t, y: 0 * y, (0, 1), [1.0], t_eval=[0.25, 0.5, 0.5, 1.0], events=clock, on_event=double)
    assert res.t.tolist() == [0.25, 0.5, 0.5, 1.0] and res.y[0].tolist() == [1.0, 1.0, 2.0, 2.0]


def test_differential_algebraic_system_is_solved():
    # Robertson's problem with the conservation of mass instead of the third equation.
    def rhs(t, y):
        return [*robertson(t, y)[:2], y.sum() - 1.0]

    mass = np.diag([1.0, 1.0, 0.0])
    reference = solve_ivp(robertson, (0, 1e3), [1, 0, 0], "Radau", [1e3], rtol=1e-11, atol=1e-16, jac=robertson_jacobian)
    for method, bar in ("radau5", 1e-6), ("auto", 1e-6), ("bdf", 1e-5):
        res = ode.solve(rhs, (0, 1e3), [1, 0, 0], method, [1e3], mass=mass, rtol=1e-8, atol=1e-13)
        assert np.abs(res.y / reference.y - 1).max() < bar
        assert abs(res.y.sum() - 1) < 1e-8
    with pytest.raises(ValueError, match="mass matrix can be integrated only by radau5, bdf or auto"):
        ode.solve(rhs, (0, 1), [1, 0, 0], "dop853", mass=mass)
    with pytest.raises(ValueError, match=r"mass must have the shape \(3, 3\), not \(2, 2\)"):
        ode.solve(rhs, (0, 1), [1, 0, 0], mass=np.eye(2))


def test_algebraic_states_are_guesses():
    def rhs(t, y):
        return [-y[0], y[1] ** 2 - 4.0 * y[0]]

    mass = np.diag([1.0, 0.0])
    for method in "radau5", "auto":
        exact = ode.solve(rhs, (0, 2), [1.0, 2.0], method, mass=mass, rtol=1e-8, dense_output=True)
        guess = ode.solve(rhs, (0, 2), [1.0, 30.0], method, mass=mass, rtol=1e-8, dense_output=True)
        assert exact.y[:, 0].tolist() == [1.0, 2.0] and exact.t[0] == guess.t[0] == 0.0 < guess.t[1]
        assert np.abs(guess.y[:, 0] - [1.0, 2.0]).max() < 1e-9 and np.abs(guess.sol(0.0) - [1.0, 2.0]).max() < 1e-9
        assert np.abs(guess.y[:, -1] / [math.exp(-2), 2 * math.exp(-1)] - 1).max() < 1e-7
        # The second root.
        other = ode.solve(rhs, (0, 2), [1.0, -0.1], method, mass=mass, rtol=1e-8, t_eval=[0.0, 2.0])
        assert np.abs(other.y[1] / [-2.0, -2 * math.exp(-1)] - 1).max() < 1e-7
        failed = ode.solve(rhs, (0, 2), [-1.0, 2.0], method, mass=mass)
        assert not failed.success and "equation 1, which contains no derivative, has residual 8" in failed.message


def test_algebraic_states_follow_events():
    state = {"opening": 1.0}

    def open_valve(t, y, which):
        state["opening"] = 3.0

    res = ode.solve(
        lambda t, y: [-y[1], y[1] - state["opening"] * y[0]],
        (0, 2),
        [1.0, 1.0],
        mass=np.diag([1.0, 0.0]),
        rtol=1e-9,
        events=lambda t, y: t - 1.0,
        on_event=open_valve,
    )
    both = res.y[:, res.t == res.t_events[0][0]]
    assert np.abs(both * math.e - [[1, 1], [1, 3]]).max() < 1e-7
    assert np.abs(res.y[:, -1] - [math.exp(-4), 3 * math.exp(-4)]).max() < 1e-8


def test_tolerances_and_steps_are_applied():
    scales = np.array([1.0, 1e-6])
    loose = ode.solve(lambda t, y: -y, (0, 1), scales, "tsit5", atol=[1e-9, 1e-3], rtol=1e-9)
    tight = ode.solve(lambda t, y: -y, (0, 1), scales, "tsit5", atol=1e-15, rtol=1e-9)
    assert np.abs(tight.y[:, -1] / scales - math.exp(-1)).max() < 1e-9 and loose.nfev <= tight.nfev
    res = ode.solve(circle, (0, 1), [0.0, 1.0], "tsit5", first_step=1e-3)
    assert res.t[1] == 1e-3
    res = ode.solve(circle, (0, 1), [0.0, 1.0], "euler", step=0.25)
    assert res.t.tolist() == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert res.y[0, -1] == pytest.approx(((1 + 0.25j) ** 4).imag, abs=1e-15)


def test_scipy_method_names_are_mapped():
    for theirs, ours in {"RK45": "tsit5", "Radau": "radau5", "BDF": "bdf", "DOP853": "dop853", "LSODA": "auto"}.items():
        a, b = (ode.solve(circle, (0, 3), [0.0, 1.0], name) for name in (theirs, ours))
        assert np.array_equal(a.y, b.y) and a.nfev == b.nfev


def test_empty_span_or_state_is_handled():
    res = ode.solve(circle, (1.0, 1.0), [0.0, 1.0], t_eval=[1.0])
    assert res.success and res.y.T.tolist() == [[0.0, 1.0]]
    res = ode.solve(lambda t, y: [], (0, 1), [], t_eval=[0.0, 1.0])
    assert res.success and res.y.shape == (0, 2)


def test_dense_output_without_steps_is_the_start():
    res = ode.solve(circle, (1.0, 1.0), [0.0, 1.0], dense_output=True)
    assert res.sol(1.0).tolist() == [0.0, 1.0] and res.sol([1.0, 1.0]).shape == (2, 2)
    with pytest.raises(ValueError, match="is outside"):
        res.sol(1.5)
    res = ode.solve(lambda t, y: [math.nan], (0, 1), [3.0], dense_output=True)
    assert not res.success and res.message == "rhs returned NaN for component 0 at t = 0"
    assert res.nfev == 1 and res.sol(0.0).tolist() == [3.0]


def test_terminal_accepts_values_of_scipy():
    def event(t, y):
        return y[1]

    for terminal, ends in [(np.True_, 0.5), (2.0, 1.5), (np.int64(2), 1.5), (False, 3), (np.False_, 3), (None, 3)]:
        event.terminal = terminal
        res = ode.solve(circle, (0, 3 * math.pi), [0.0, 1.0], events=event, rtol=1e-9)
        assert abs(res.end_time - ends * math.pi) < 1e-7, terminal
    for terminal in [-1, 0.5, math.nan]:
        event.terminal = terminal
        with pytest.raises(ValueError, match="terminal of event 0 = .* must be an integer of at least 0"):
            ode.solve(circle, (0, 1), [0.0, 1.0], events=event)


def test_failures_are_results_with_reasons():
    res = ode.solve(lambda t, y: y**2, (0, 2), [1.0])
    assert not res.success and res.status == -1 and abs(res.end_time - 1) < 1e-4 and "steps" in res.message
    assert res.t[-1] == res.end_time and res.y[0, -1] > 1e4
    res = ode.solve(lambda t, y: [math.log(y[0])] if y[0] > 0.5 else [math.nan], (0, 9), [0.6])
    assert not res.success and "cannot be evaluated beyond" in res.message
    assert "rhs returned NaN for component 0 at t = " in res.message
    res = ode.solve(circle, (0, 100), [0.0, 1.0], max_steps=5)
    assert "limit of 5 steps" in res.message and len(res.t) <= 6


def test_sliding_follows_the_surface():
    state = {}

    def relay(t, y):
        return [-state["sign"], 2.0 - state["sign"]]

    def switch(t, y, which):
        state["sign"] = 1.0 if y[0] > 0 else -1.0

    def run(**options):
        state["sign"] = 1.0
        return ode.solve(relay, (0, 2), [1.0, 0.0], events=lambda t, y: y[0], on_event=switch, **options)

    res = run()
    assert not res.success and "chattering at t = " in res.message and abs(res.end_time - 1) < 1e-5
    res = run(chattering="slide", t_eval=[2.0])
    # Along x = 0 both fields have equal shares: y' = 2.
    assert res.success and np.abs(res.y[:, 0] - [0.0, 3.0]).max() < 1e-4 and res.stats.chattering == 1


def test_chattering_can_be_a_warning(caplog):
    def hysteresis(t, y):
        return y[0] + 1e-9 * y[1]

    res = ode.solve(
        lambda t, y: [-y[1], 0.0],
        (0, 1),
        [1e-9, 1.0],
        "tsit5",
        events=hysteresis,
        max_events=250,
        on_event=lambda t, y, which: [y[0], -y[1]],
        chattering="warn",
    )
    assert "limit of 250 events" in res.message and res.stats.chattering == 2
    assert "time hardly advanced during 2 sequences of 100 events" in caplog.text


def test_time_limit_ends_the_integration():
    def slow(t, y):
        time.sleep(2e-3)
        return circle(t, y)

    res = ode.solve(slow, (0, 1e6), [0.0, 1.0], max_time=0.1)
    assert not res.success and "time limit of 0.1 s" in res.message and res.t[-1] > 0
    assert res.seconds >= res.seconds_in_model >= 0.09


class Odd(Exception):
    pass


@pytest.mark.parametrize("method", ADAPTIVE)
def test_exceptions_keep_their_identity(method):
    error = Odd("here")

    def rhs(t, y):
        if t > 3:
            raise error
        return circle(t, y)

    with pytest.raises(Odd) as info:
        ode.solve(rhs, (0, 10), [0.0, 1.0], method, rtol=1e-9)
    assert info.value is error
    partial = error.partial_result
    assert isinstance(partial, ode.OdeResult) and not partial.success and 2 < partial.t[-1] <= 3
    assert np.abs(partial.y[0] - np.sin(partial.t)).max() < 1e-5

    def event(t, y):
        return y[0] - 0.5

    def on_event(t, y, which):
        raise error

    with pytest.raises(Odd) as info:
        ode.solve(circle, (0, 10), [0.0, 1.0], method, events=event, on_event=on_event)
    assert info.value is error and abs(error.partial_result.t_events[0][0] - math.pi / 6) < 1e-5


@pytest.mark.parametrize(
    ("wrong", "kind", "message"),
    [
        ({"rhs": lambda t, y: [1.0]}, ValueError, r"rhs must return an array of shape \(2,\), not one of shape \(1,\)"),
        ({"rhs": lambda t, y: None}, ValueError, "rhs must return .* not None. Check for a missing return statement"),
        ({"rhs": lambda t, y: ["a", "b"]}, TypeError, "rhs must return numbers"),
        ({"rhs": lambda t, y: [1j, 0]}, TypeError, "rhs must return numbers"),
        ({"rhs": 3}, TypeError, "rhs must be callable, not 3"),
        ({"t_span": (1, -math.inf)}, ValueError, "from 1 to -inf: both times must be finite"),
        ({"t_span": (0, math.inf)}, ValueError, "from 0 to inf"),
        ({"t_span": 3}, ValueError, "t_span must be two numbers"),
        ({"x0": [1j, 0]}, TypeError, "x0 must be numbers"),
        ({"x0": [math.nan, 0]}, ValueError, "x0 must be finite"),
        ({"t_eval": [0.5, 0.2]}, ValueError, "requested time 0.2 at position 1"),
        ({"t_eval": [7.0]}, ValueError, "requested time 7 at position 0"),
        ({"method": "rk23"}, ValueError, "unknown solver 'rk23'; expected one of"),
        ({"rtol": 0.0}, ValueError, "^rtol = 0 requires a positive atol"),
        ({"rtol": 0.0, "atol": 0.0}, ValueError, "^atol = 0"),
        ({"rtol": 1e-15}, ValueError, "^rtol = 1e-15"),
        ({"atol": [1e-6]}, ValueError, "atol: expected 2 values, one per state; got 1"),
        ({"atol": -1.0}, ValueError, "^atol = -1"),
        ({"events": [3]}, TypeError, "event 0 must be callable, not 3"),
        ({"events": lambda t, y: "a"}, TypeError, "event 0 must return one number"),
        ({"jac": [[1.0]], "method": "bdf"}, ValueError, r"jac must have the shape \(2, 2\), not \(1, 1\)"),
        ({"jac": lambda t, y: [1.0], "method": "bdf"}, ValueError, r"jac must have the shape \(2, 2\), not \(1,\)"),
        ({"jac_sparsity": [[1.0]]}, ValueError, r"jac_sparsity must have the shape \(2, 2\)"),
        ({"chattering": "stop"}, ValueError, "unknown chattering policy 'stop'"),
        ({"timeout": -1}, ValueError, "max_time = -1 must be a positive number of seconds"),
        ({"max_step": 0.0}, ValueError, "max_step = 0"),
        ({"max_step": 1e-300}, ValueError, "step size 1e-300 is too small"),
        ({"first_step": 0.0}, ValueError, "^first_step = 0"),
        ({"step": 0.0, "method": "rk4"}, ValueError, "^step = 0"),
        ({"step": 1e-30, "method": "rk4"}, ValueError, "step size 1e-30 is too small"),
        ({"args": 2}, TypeError, r"args must be a tuple of further arguments, such as \(2.0,\), not 2"),
        ({"jac": [[0, 1], [math.nan, 0]], "method": "bdf"}, ValueError, r"jac\[1, 0\] = NaN must be finite"),
        ({"mass": [[1, math.inf], [0, 1]]}, ValueError, r"mass\[0, 1\] = inf must be finite"),
        ({"interior_samples": 2**32}, ValueError, "interior_samples = 4294967296 must"),
        ({"interior_samples": -1}, ValueError, "interior_samples = -1 must be at least 0"),
    ],
)
def test_bad_arguments_are_rejected(wrong, kind, message):
    given = {"rhs": circle, "t_span": (0, 1), "x0": [0.0, 1.0], **wrong}
    with pytest.raises(kind, match=message):
        ode.solve(**given)


def test_ctrl_c_ends_with_partial_result():
    calls = []

    def rhs(t, y):
        calls.append(t)
        if len(calls) == 200:
            press_ctrl_c()
        return circle(t, y)

    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(pydfo.Interrupted) as info:
        ode.solve(rhs, (0, 1e9), [0.0, 1.0], "tsit5")
    assert signal.getsignal(signal.SIGINT) is before
    assert isinstance(info.value.result, ode.OdeResult) and info.value.result.t[-1] > 1
    assert len(calls) <= 210


def test_objective_may_run_simulations():
    """Fits the rate of a decay from its values."""
    t = np.linspace(0, 2, 9)
    measured = np.exp(-1.3 * t)
    cost = lambda p: float(((ode.solve(lambda t, y: -p[0] * y, (0, 2), [1.0], t_eval=t).y - measured) ** 2).sum())  # noqa: E731
    res = pydfo.fmin(cost, [0.5], lb=[0], ub=[5], x_tol=1e-7, f_tol=1e-14, stop="all", disp=False)
    assert abs(res.x[0] - 1.3) < 1e-5


def test_many_states_need_no_matrix_with_explicit_method() -> None:
    n = 100_000
    solution = ode.solve(lambda t, y: -y, (0, 1), np.ones(n), t_eval=[1.0])
    assert solution.success and solution.njev == 0
    assert np.allclose(solution.y[..., -1] if solution.y.shape[0] == n else solution.y[-1], np.exp(-1.0), rtol=1e-4)
    for method in ("radau5", "bdf"):
        with pytest.raises(MemoryError, match=r"100000 x 100000 entries \(80.0 GB\).*sparsity pattern"):
            ode.solve(lambda t, y: -y, (0, 1), np.ones(n), method, t_eval=[1.0])


def test_samples_without_memory_are_rejected() -> None:
    with pytest.raises(MemoryError, match=r"t_eval: 10000000 times of 100000 states require 8000.0 GB"):
        ode.solve(lambda t, y: -y, (0, 1), np.ones(100_000), t_eval=np.linspace(0, 1, 10_000_000))


@pytest.mark.parametrize("method", ["auto", "tsit5", "dop853", "radau5", "bdf"])
@pytest.mark.parametrize("direction", [-1, None])
def test_balls_stay_above_the_floor_or_raise_an_error(method, direction):
    """Balls after their Zeno limit with typical handlers: an error with the event, at any tolerance."""
    for floor, height, gravity in [(0.0, 1.0, 9.81), (0.1, 0.01, 1.62), (1000.0, 1.0, 9.81)]:
        for factor in [0.0, 0.4, 0.5, 0.7, 0.8, 0.95]:
            for rtol in [1e-3, 1e-6, 1e-9]:
                for keeps in [False, True]:

                    def event(t, y, floor=floor):
                        return y[0] - floor

                    if direction is not None:
                        event.direction = direction

                    def bounce(t, y, which, floor=floor, factor=factor, keeps=keeps):
                        return [y[0] if keeps else floor, -factor * y[1]]

                    limit = np.sqrt(2 * height / gravity) * (1 + factor) / (1 - factor)
                    res = ode.solve(
                        lambda t, y, gravity=gravity: [y[1], -gravity],
                        (0, 1.5 * limit + 0.1),
                        [floor + height, 0.0],
                        method,
                        events=event,
                        on_event=bounce,
                        rtol=rtol,
                    )
                    case = (floor, factor, rtol, keeps, res.message)
                    assert res.y[0].min() > floor - 100 * rtol * (height + floor), case
                    assert not res.success and "event indicator 0" in res.message, case


@pytest.mark.parametrize("method", ["radau5", "bdf"])
def test_sparse_jacobians_stay_sparse(method):
    """As dense matrices, they would require 20 GB."""
    sparse = pytest.importorskip("scipy.sparse")
    n = 50_000
    rates = np.linspace(1.0, 1e4, n)
    jacobian = sparse.diags([-rates, 0.1 * np.ones(n - 1)], [0, 1]).tocsr()
    jacobian_times = []

    def jac(t, y):
        jacobian_times.append(t)
        return jacobian

    given = [{"jac_sparsity": abs(jacobian)}, {"jac": jacobian}, {"jac": jac, "jac_sparsity": jacobian}]
    ends = []
    for more in given:
        res = ode.solve(lambda t, y: jacobian @ y, (0, 1e-3), np.ones(n), method, t_eval=[1e-3], rtol=1e-4, **more)
        assert res.success, res.message
        ends.append(res.y[:, -1])
    assert jacobian_times
    for end in ends:
        assert end == pytest.approx(ends[1], rel=1e-3)
    assert ends[1][-1] == pytest.approx(math.exp(-10.0), rel=0.1)


def test_sparse_jacobians_may_change_pattern_without_jac_sparsity():
    sparse = pytest.importorskip("scipy.sparse")
    with pytest.raises(MemoryError, match="Specify the sparsity pattern of the Jacobian"):
        n = 100_000
        ode.solve(lambda t, y: -y, (0, 1), np.ones(n), "bdf", jac=lambda t, y: -sparse.eye(n))


def test_sparse_jacobians_are_checked():
    sparse = pytest.importorskip("scipy.sparse")

    def growing(t, y):
        return sparse.csr_matrix([[-1.0, 1.0 if t > 0.2 else 0.0], [0.0, -100.0]])

    def solve(jac, **more):
        return ode.solve(lambda t, y: [-y[0] + y[1], -100 * y[1]], (0, 5), [1.0, 1.0], "bdf", jac=jac, **more)

    with pytest.raises(ValueError, match=r"jac has an entry at \[0, 1\] at t = .*, where jac_sparsity"):
        solve(growing, jac_sparsity=sparse.eye(2))
    with pytest.raises(ValueError, match=r"jac has an entry at \[0, 1\]"):
        solve(sparse.csr_matrix([[-1.0, 1.0], [0.0, -100.0]]), jac_sparsity=sparse.eye(2))
    with pytest.raises(ValueError, match=r"jac must have the shape \(2, 2\), not \(3, 3\)"):
        solve(sparse.eye(3))
    with pytest.raises(ValueError, match=r"jac\[0, 0\] = NaN must be finite"):
        solve(sparse.csr_matrix([[math.nan, 0.0], [0.0, 1.0]]))
    dense, both = (solve(jac) for jac in ([[-1.0, 1.0], [0.0, -100.0]], sparse.csr_matrix([[-1.0, 1.0], [0.0, -100.0]])))
    assert both.y.tolist() == dense.y.tolist()


@pytest.mark.parametrize("method,rtol", [("dop853", 1e-3), ("dop853", 1e-6), ("auto", 1e-9)])
def test_pulse_between_two_events_is_integrated(method, rtol):
    # DOP853 has right-hand sides inside its steps for interpolation only.
    for a in np.linspace(0.05, 0.95, 19):
        w = 0.003
        sol = pydfo.ode.solve(
            lambda t, y: [1 / w if a <= t < a + w else 0.0], (0, 1), [0.0], method, rtol=rtol, events=[lambda t, y: t - a, lambda t, y: t - a - w]
        )
        assert sol.success and abs(sol.y[0, -1] - 1.0) < 100 * rtol, a


def test_either_tolerance_may_be_zero():
    exact = 3.0 * np.exp(-2.0)
    for tolerances in ({"rtol": 0.0, "atol": 1e-8}, {"rtol": 1e-8, "atol": 0.0}, {"rtol": 0.0, "atol": [1e-8]}):
        for method in ("auto", "tsit5", "dop853", "radau5", "bdf"):
            res = ode.solve(lambda t, y: -y, (0, 2), [3.0], method=method, **tolerances)
            assert res.success and res.y[0, -1] == pytest.approx(exact, rel=1e-5)
    with pytest.raises(ValueError, match="state 0 and its absolute tolerance are both 0 at t = 0"):
        ode.solve(lambda t, y: np.ones(1), (0, 1), [0.0], atol=0.0)
