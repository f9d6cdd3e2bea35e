"""Samples of the posterior distribution: closed forms, bit-for-bit identical results, typical use."""

from __future__ import annotations

import numpy as np
import pytest

from pydfo import Calibration, Normal, Parameter, Posterior, example_fmu

TIMES = np.linspace(0, 3, 30)


def decay(sigma=None, upper=5.0, **rate):
    x = np.exp(-1.5 * TIMES) + np.random.default_rng(7).normal(0, 0.05, TIMES.size)
    parameters = [Parameter("k", 1.0, 0.1, upper, **rate), Parameter("x", 1.0, 0.5, 2.0)]
    return Calibration(example_fmu("dahlquist"), {"time": TIMES, "x": x}, ["x"], parameters, sigma=sigma and {"x": sigma})


def test_posterior_agrees_with_the_covariance_of_a_nearly_linear_model():
    fit = decay(sigma=0.05).fit()
    found = fit.sample(800, rng=1, workers=2)
    assert isinstance(found, Posterior) and found.converged and found.names == ["k", "x"] and not found.interrupted
    assert found.chain.shape == (600, 16, 2) and found.log_density.shape == (600, 16) and found.n_warmup == 200
    # The covariance for the known noise, from the derivatives of exp(-k t) x.
    k, x = fit.x
    jacobian = np.column_stack([-TIMES * x * np.exp(-k * TIMES), np.exp(-k * TIMES)]) / 0.05
    expected = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    np.testing.assert_allclose(list(found.sd.values()), expected, rtol=0.1)
    np.testing.assert_allclose(list(found.mean.values()), fit.x, atol=0.3 * expected.max())
    low, high = found.intervals(0.9)["k"]
    assert low < found.mean["k"] < high and found.draws["k"].shape == (9600,)


def test_posterior_repeats_with_the_seed_for_any_number_of_workers(tmp_path):
    fit = decay().fit()
    first = fit.sample(30, rng=3, workers=1)
    second = fit.sample(30, rng=3, workers=4)
    np.testing.assert_array_equal(first.chain, second.chain)
    # A longer sample continues the file.
    path = tmp_path / "chain"
    fit.sample(20, rng=3, warmup=0, checkpoint=path)
    longer = fit.sample(30, rng=3, warmup=0, checkpoint=path)
    np.testing.assert_array_equal(longer.chain[7:], first.chain)
    with pytest.raises(ValueError, match="another fit or problem, or with other walkers or another seed"):
        fit.sample(30, rng=4, checkpoint=path)


def test_prior_and_bounds_shape_the_posterior():
    mean, sd = 1.2, 0.01
    found = decay(prior=Normal(mean, sd)).fit(noise="estimated").sample(600, rng=1)
    assert mean < found.mean["k"] < mean + sd and 0.8 * sd < found.sd["k"] < 1.05 * sd
    cut = decay(upper=1.4).fit().sample(200, rng=1)
    assert cut.chain[:, :, 0].max() <= 1.4


def test_print_and_figure_show_the_parameters():
    found = decay().fit().sample(40, rng=1)
    text = repr(found)
    assert "posterior distribution: 30 steps of 16 walkers" in text and "R-hat" in text and "not converged" in text
    figure = found.plot()
    assert sum(axes.get_visible() for axes in figure.axes) == 3


def test_bad_options_and_fits_are_rejected():
    fit = decay().fit()
    with pytest.raises(ValueError, match="start is 'prior'; expected 'fit' or 'box'"):
        fit.sample(10, start="prior")
    with pytest.raises(ValueError, match="3 walkers are too few for 2 parameters; the minimum is 6"):
        fit.sample(10, walkers=3)
    with pytest.raises(ValueError, match="level is 2; it must be between 0 and 1"):
        fit.sample(4, rng=1).intervals(2)
    with pytest.raises(ValueError, match="robust loss"):
        decay().fit(loss="huber", f_scale=0.1).sample(10)
