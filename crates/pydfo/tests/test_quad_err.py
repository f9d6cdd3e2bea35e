"""quad_err: linear interpolation, events, weights."""

from __future__ import annotations

import numpy as np
import pytest

from pydfo import dfo

T, Y = [0.0, 1.0, 3.0], [0.0, 2.0, 6.0]


@pytest.mark.parametrize("quad_err", [dfo.quad_err, dfo.quad_err_simple])
def test_rows_are_interpolated_linearly(quad_err):
    assert quad_err([0.5, 2.0, 3.0], [0.0, 4.0, 7.0], T, Y) == 2.0
    both = quad_err([0.5, 2.0], [[0.0, 4.0], [1.0, 5.0]], T, [Y, Y])
    assert both == 1.0 + 0.0 + 0.0 + 1.0
    # outside the simulated span, the end values are used
    assert quad_err([-1.0, 9.0], [1.0, 6.0], T, Y) == 1.0


def test_weights_multiply_the_squared_errors():
    assert dfo.quad_err([0.5], [[0.0], [0.0]], T, [Y, Y], w=[2.0, 3.0]) == 5.0
    assert dfo.quad_err([0.5], [0.0], T, Y, 4.0) == 4.0


def test_event_at_measured_time_uses_the_mean():
    # the paper's tool fails here for one-dimensional data
    assert dfo.quad_err([1.0], [0.0], [0.0, 1.0, 1.0, 2.0], [0.0, 2.0, 4.0, 4.0]) == 9.0
    assert dfo.quad_err([1.0], [[0.0]], [0.0, 1.0, 1.0, 2.0], [[0.0, 2.0, 4.0, 4.0]]) == 9.0
    assert dfo.quad_err([1.5], [0.0], [0.0, 1.0, 1.0, 2.0], [0.0, 2.0, 4.0, 6.0]) == 25.0


def test_agrees_with_numpy_on_long_series():
    rng = np.random.default_rng(5)
    t_sim = np.sort(rng.uniform(0.0, 10.0, 300))
    t_meas = rng.uniform(-0.5, 10.5, 200)
    y_sim, y_meas = rng.normal(size=(3, 300)), rng.normal(size=(3, 200))
    w = np.array([1.0, 0.5, 2.0])
    expected = sum(w[q] * np.sum((np.interp(t_meas, t_sim, y_sim[q]) - y_meas[q]) ** 2) for q in range(3))
    assert dfo.quad_err(t_meas, y_meas, t_sim, y_sim, w) == pytest.approx(expected, rel=1e-12)


def test_any_array_layout_and_type_is_accepted():
    reference = dfo.quad_err([0.0, 1.0], [[1.0, 2.0], [3.0, 4.0]], T, [Y, Y])
    y_meas = np.asfortranarray([[1, 2], [3, 4]], dtype=np.float32)
    y_sim = np.vstack((Y, Y, Y, Y))[::2]
    assert dfo.quad_err(np.array([0, 1]), y_meas, np.array(T)[:], y_sim) == reference
    assert np.isnan(dfo.quad_err([0.0], [np.nan], T, Y))


@pytest.mark.parametrize(
    ("arguments", "error", "expected"),
    [
        (([0.0], [0.0], [0.0], [[0.0], [0.0]]), ValueError, "1 measured quantities, but 2"),
        (([0.0, 1.0], [0.0], T, Y), ValueError, "measured quantity 0 has 1 values, but there are 2 times"),
        (([0.0], [0.0], [1.0, 0.0], [0.0, 0.0]), ValueError, "simulated time 0 at position 1 comes after 1"),
        (([0.0], [0.0], [], []), ValueError, "the simulation has no times"),
        (([0.0], [0.0], T, Y, [1.0, 2.0]), ValueError, "2 weights for 1"),
        (([0.0], [[[0.0]]], T, Y), ValueError, "y_meas must be a matrix with one row per quantity"),
        (([[0.0]], [0.0], T, Y), ValueError, "t_meas must be one-dimensional"),
        (([0.0], ["a"], T, Y), TypeError, "y_meas must be numbers"),
        (([0.0], [0.0], T, [Y, [1.0]]), TypeError, "y_sim must be numbers"),
    ],
)
def test_mismatched_arguments_are_named(arguments, error, expected):
    with pytest.raises(error, match=expected):
        dfo.quad_err(*arguments)
