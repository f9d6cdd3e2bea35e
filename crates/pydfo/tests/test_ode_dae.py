"""Systems ``F(t, y, y') = 0``, second-order systems, and integration backward in time."""

from __future__ import annotations

import math
import threading

from conftest import press_ctrl_c
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.sparse import csr_matrix

import pydfo
from pydfo import ode

G = 9.81


def robertson(t, y, dy):
    a, b, c = 0.04 * y[0], 1e4 * y[1] * y[2], 3e7 * y[1] ** 2
    return [dy[0] + a - b, dy[1] - a + b + c, y.sum() - 1]


def robertson_jacobians(t, y, dy):
    b, c = 1e4, 6e7 * y[1]
    by_states = [[0.04, -b * y[2], -b * y[1]], [-0.04, b * y[2] + c, b * y[1]], [1.0, 1.0, 1.0]]
    return by_states, np.diag([1.0, 1.0, 0.0])


def pendulum(index):
    def residual(t, y, dy):
        x, h, vx, vy, force = y
        rod = {1: vx**2 + vy**2 - force * (x**2 + h**2) - G * h, 2: x * vx + h * vy, 3: x**2 + h**2 - 1}
        return [dy[0] - vx, dy[1] - vy, dy[2] + x * force, dy[3] + h * force + G, rod[index]]

    return residual


@pytest.mark.parametrize("jac", [None, robertson_jacobians])
def test_robertson_is_solved_from_a_guess(jac):
    exact = [7.158270687194050905e-1, 9.185534764557763904e-6, 2.841637457458303518e-1]
    res = ode.solve_dae(robertson, (0, 40), [1.0, 0.0, 5.0], rtol=1e-8, atol=1e-12, jac=jac, t_eval=[0.0, 40.0])
    assert res.success and np.abs(res.y[:, 0] - [1, 0, 0]).max() < 1e-12
    assert np.abs(res.y[:, 1] / exact - 1).max() < 1e-6
    assert res.nfev < 700


def test_constant_jacobians_and_args_are_used():
    def residual(t, y, dy, k):
        return [dy[0] + k * y[1], y[1] - y[0]]

    pair = ([[0, 2.0], [-1, 1]], csr_matrix([[1.0, 0], [0, 0]]))
    res = ode.solve_dae(residual, (0, 1), [1.0, 0.0], args=(2.0,), jac=pair, rtol=1e-8)
    assert abs(res.y[0, -1] - math.exp(-2)) < 1e-6 and res.nfev < 300
    with pytest.raises(ValueError, match="two matrices, dF/dy and dF/dy', not 1"):
        ode.solve_dae(residual, (0, 1), [1.0, 0.0], args=(2.0,), jac=[pair[0]])
    with pytest.raises(TypeError, match="jac must return two matrices"):
        ode.solve_dae(residual, (0, 1), [1.0, 0.0], args=(2.0,), jac=lambda t, y, dy, k: 1.0)


def test_residual_form_agrees_with_mass_matrix_and_scipy():
    t = np.linspace(0.0, 2.0, 9)
    reference = solve_ivp(lambda t, y: -(y**3) + np.sin(t), (0, 2), [1.5], "DOP853", t, rtol=1e-12, atol=1e-12).y[0]
    res = ode.solve_dae(lambda t, y, dy: [dy[0] + y[1] - np.sin(t), y[1] - y[0] ** 3], (0, 2), [1.5, 0.0], t_eval=t, rtol=1e-8, dense_output=True)
    mass = ode.solve(lambda t, y: [np.sin(t) - y[1], y[1] - y[0] ** 3], (0, 2), [1.5, 0.0], "bdf", t, rtol=1e-8, mass=[[1, 0], [0, 0]])
    for found in (res.y, res.sol(t), mass.y):
        assert np.abs(found[0] - reference).max() < 5e-7 and np.abs(found[1] - reference**3).max() < 5e-6


def test_pendulum_of_index_1_is_solved_and_higher_index_named():
    res = ode.solve_dae(pendulum(1), (0, 3), [1.0, 0, 0, 0, 0], rtol=1e-9, atol=1e-11, t_eval=[0, 3])
    plane = solve_ivp(lambda t, a: [a[1], -G * math.cos(a[0])], (0, 3), [0.0, 0.0], "DOP853", rtol=1e-12, atol=1e-12)
    angle = plane.y[0, -1]
    assert np.abs(res.y[:2, 1] - [math.cos(angle), math.sin(angle)]).max() < 1e-6
    for index in 2, 3:
        res = ode.solve_dae(pendulum(index), (0, 3), [1.0, 0, 0, 0, 0])
        assert not res.success and res.end_time == 0
        assert "index 2 or higher" in res.message and "states [4]" in res.message and "equation 4" in res.message


def test_states_are_consistent_after_events():
    def low(t, y):
        return y[1] - 0.25

    low.direction, low.terminal = -1, 3
    res = ode.solve_dae(
        lambda t, y, dy: [dy[0] + y[0], y[1] - y[0] ** 2], (0, 9), [1.0, 1.0], rtol=1e-9, events=low, on_event=lambda t, y, which: [1.0, y[1]]
    )
    assert res.status == 1 and np.abs(res.t_events[0] - math.log(2) * np.arange(1, 4)).max() < 1e-7
    # The equation holds at the ends of all steps; nothing is made consistent after the last event.
    assert np.abs(res.y[1] - res.y[0] ** 2)[:-1].max() < 1e-7


@pytest.mark.parametrize(
    ("wrong", "error", "words"),
    [
        ({"dx0": [0.0]}, ValueError, "dx0 must be 3 finite values"),
        ({"dx0": [math.nan] * 3}, ValueError, "dx0 must be 3 finite values"),
        ({"residual": 3}, TypeError, "residual must be callable"),
        ({"residual": lambda t, y, dy: [1.0]}, ValueError, r"residual must return an array of shape \(3,\)"),
        ({"residual": lambda t, y, dy: None}, ValueError, "residual must return .*Check for a missing return statement"),
        ({"atol": [1e-6]}, ValueError, "atol: expected 3 values, one per state; got 1"),
        ({"x0": [math.inf, 0, 0]}, ValueError, "x0 must be finite"),
        ({"t_eval": [0.5, 0.2]}, ValueError, "in the order of the integration"),
        ({"mass": np.eye(3)}, TypeError, "mass"),
        ({"events": 3}, TypeError, "events must be a function or a list of functions, not 3"),
        ({"t_span": (0, math.inf)}, ValueError, "from 0 to inf: both times must be finite$"),
    ],
)
def test_bad_arguments_are_rejected(wrong, error, words):
    given = {"residual": robertson, "t_span": (0, 1), "x0": [1.0, 0.0, 0.0], **wrong}
    with pytest.raises(error, match=words):
        ode.solve_dae(**given)


def test_guess_that_hides_a_derivative_is_rejected():
    res = ode.solve_dae(lambda t, y, dy: [y[1] * dy[0] + y[0], y[1] - 2], (0, 1), [1.0, 0.0], rtol=1e-8)
    assert res.y[:, 0].tolist() == [1, 2] and abs(res.y[0, -1] - math.exp(-0.5)) < 1e-6
    jac = [[-1.0]], [[0.0]]
    for given in {}, {"jac": lambda t, y, dy: (jac[0], [[2 * dy[0]]])}:
        res = ode.solve_dae(lambda t, y, dy: [dy[0] ** 2 - y[0]], (0, 1), [1.0], **given)
        assert not res.success and res.y[0, 0] == 1
        assert "equation 0 has residual -1. Specify derivatives (dx0)" in res.message


def test_incomplete_pattern_is_reported():
    n = 100

    def residual(t, y, dy):
        return np.concatenate([dy[:n] - y[n:], y[n:] + y[:n]])

    def swapped(t, y, dy):
        return np.concatenate([y[:n] + y[n:], dy[:n] - y[n:]])

    for equations in residual, swapped:
        res = ode.solve_dae(equations, (0, 1), np.r_[np.ones(n), -np.ones(n)], jac_sparsity=np.eye(2 * n))
        assert not res.success and "entries missing from jac_sparsity" in res.message


def test_sparse_index_2_with_wrong_start_fails():
    n = 40
    eye, zero = np.eye(n), np.zeros((n, n))
    pattern = np.block([[eye, eye, zero], [eye, eye, eye], [zero, eye, zero]])

    def residual(t, y, dy):
        x, u, force = y.reshape(3, n)
        return np.concatenate([dy[:n] - u, dy[n : 2 * n] - force + x, u - np.cos(t)])

    for force in 0.0, 5.0:
        start = np.repeat([0.0, 1.0, force], n)
        res = ode.solve_dae(residual, (0, 1), start, jac_sparsity=pattern, exclude_algebraic=True)
        assert not res.success and "index 2 or higher" in res.message and "equation 80" in res.message


def test_failures_report_their_reason():
    res = ode.solve_dae(lambda t, y, dy: [dy[0] + math.nan], (0, 1), [1.0])
    assert not res.success and "residual returned NaN for component 0 at t = 0" in res.message
    res = ode.solve_dae(lambda t, y, dy: [dy[0] + y[0], y[1] ** 2 + 1], (0, 1), [1.0, 1.0])
    assert not res.success and "are inconsistent" in res.message and "equation 1" in res.message

    def raises(t, y, dy):
        if t > 0.5:
            raise ZeroDivisionError("at half")
        return dy + y

    with pytest.raises(ZeroDivisionError, match="at half") as caught:
        ode.solve_dae(raises, (0, 1), [1.0])
    assert 0 < caught.value.partial_result.end_time <= 0.5
    limited = ode.solve_dae(robertson, (0, 40), [1.0, 0, 0], max_steps=20)
    assert not limited.success and "20 steps" in limited.message


def test_ctrl_c_ends_the_run():
    def slow(t, y, dy):
        threading.Event().wait(0.001)
        return dy - np.cos(50 * t)

    timer = threading.Timer(0.3, press_ctrl_c)
    timer.start()
    with pytest.raises(pydfo.Interrupted) as caught:
        ode.solve_dae(slow, (0, 1e4), [0.0], rtol=1e-8)
    timer.join()
    assert caught.value.result.end_time > 0


def test_algebraic_variables_may_be_excluded_from_error_test():
    given = (robertson, (0, 40), [1.0, 0.0, 0.0])
    plain, without = (ode.solve_dae(*given, rtol=1e-6, exclude_algebraic=flag) for flag in (False, True))
    assert np.abs(plain.y[:, -1] - without.y[:, -1]).max() < 1e-4 and plain.nfev != without.nfev


@pytest.mark.parametrize("method", ["auto", "tsit5", "dop853", "radau5", "bdf"])
def test_backward_integration_agrees_with_scipy(method):
    def lotka(t, y):
        return [1.2 * y[0] - y[0] * y[1], 0.8 * y[0] * y[1] - y[1]]

    def peak(t, y):
        return y[0] - 1.0

    peak.direction = -1
    t = np.linspace(5.0, -1.0, 13)
    theirs = solve_ivp(lotka, (5, -1), [1.5, 1.0], "DOP853", t, events=peak, rtol=1e-11, atol=1e-12)
    ours = ode.solve(lotka, (5, -1), [1.5, 1.0], method, t, events=peak, rtol=1e-9, dense_output=True)
    assert np.array_equal(ours.t, t) and np.abs(ours.y - theirs.y).max() < 1e-5
    assert np.abs(ours.t_events[0] - theirs.t_events[0]).max() < 1e-5 and len(ours.t_events[0]) > 0
    assert np.abs(ours.sol(t) - theirs.y).max() < 1e-5 and (ours.sol.t_min, ours.sol.t_max) == (-1.0, 5.0)
    steps = ode.solve(lotka, (5, -1), [1.5, 1.0], method, rtol=1e-9)
    assert (steps.t[0], steps.t[-1]) == (5.0, -1.0) and (np.diff(steps.t) < 0).all()


def test_dae_is_integrated_backward():
    res = ode.solve_dae(lambda t, y, dy: [dy[0] + y[1], y[1] - y[0]], (1, 0), [math.exp(-1), 0.0], rtol=1e-9)
    assert np.abs(res.y[:, -1] - 1).max() < 1e-6 and res.end_time == 0.0


def test_second_order_system_matches_closed_form():
    t = np.linspace(0.0, 3.0, 7)
    res = ode.solve_second_order(lambda t, x, v, k: -k * x, (0, 3), [1.0, 0.0], [0.0, 2.0], "dop853", t, rtol=1e-10, args=(4.0,))
    expected = [np.cos(2 * t), np.sin(2 * t), -2 * np.sin(2 * t), 2 * np.cos(2 * t)]
    assert np.abs(res.y - expected).max() < 1e-8
    with pytest.raises(ValueError, match="v0: expected 2 values, as in x0; got 1"):
        ode.solve_second_order(lambda t, x, v: -x, (0, 3), [1.0, 0.0], [0.0])
    with pytest.raises(ValueError, match="acceleration must return an array of shape"):
        ode.solve_second_order(lambda t, x, v: [0.0], (0, 3), [1.0, 0.0], [0.0, 1.0])
