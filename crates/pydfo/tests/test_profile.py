"""Profile likelihoods: comparison with the standard errors of the pendulum, and typical use."""

from __future__ import annotations

import signal
import threading
import time

import numpy as np
import pytest
import recordings

from pydfo import Calibration, Interrupted, Parameter, Profile, example_fmu

FRICTION = [Parameter("armFriction", 0.012, 0, 0.022), Parameter("pendulumFriction", 0.002, 0, 0.012)]
ANGLES = {"armJoint.phi": "phi", "pendulumJoint.phi": "theta"}


def decay(upper=5.0):
    times = np.linspace(0, 3, 30)
    x = np.exp(-1.5 * times) + np.random.default_rng(7).normal(0, 0.05, times.size)
    parameters = [Parameter("k", 1.0, 0.1, upper), Parameter("x", 1.0)]
    return Calibration(example_fmu("dahlquist"), {"time": times, "x": x}, ["x"], parameters)


@pytest.mark.parametrize("which", recordings.at_hand("FurutaData.mat"))
def test_profile_of_pendulum_agrees_with_standard_errors(which):
    fit = Calibration(example_fmu("furuta"), recordings.furuta(which), ANGLES, FRICTION).fit()
    profile = fit.profile(corrected=False)
    assert list(profile.intervals) == fit._calibration.names and profile.message == "" and not profile.interrupted
    widths = np.diff(list(profile.intervals.values()))[:, 0]
    expected = np.diff(fit.confidence_intervals(corrected=False))[:, 0]
    np.testing.assert_allclose(widths, expected, rtol=0.15)
    if which == "published":
        np.testing.assert_allclose(widths / (2 * np.sqrt(profile.threshold)), [1.375e-5, 1.094e-6], rtol=0.15)


def test_profile_has_intervals_values_costs_text_and_figure(tmp_path):
    fit = decay().fit()
    profile = fit.profile(checkpoint=tmp_path / "profile.json", workers=2)
    for name, (low, high) in profile.intervals.items():
        values, costs = profile.values[name], profile.costs[name]
        assert (np.diff(values) > 0).all() and costs.min() == 0 == costs[values == profile.parameters[name]][0]
        assert profile.points[name].shape == (len(values), 2) and low < fit.parameters[name] < high
        np.testing.assert_allclose(np.interp([low, high], values, costs), profile.threshold, rtol=0.05)
    assert profile.degrees_of_freedom == 28 and profile.stats.right_hand_sides > 0
    assert repr(profile).startswith("profile likelihood: 95 % intervals") and "k  " in repr(profile)
    again = fit.profile("x", checkpoint=tmp_path / "profile.json")
    assert again.intervals == {"x": profile.intervals["x"]} and again.stats.right_hand_sides < profile.stats.right_hand_sides
    pytest.importorskip("matplotlib").use("Agg")
    panels = fit.plot_profiles(profile).axes
    assert [axes.get_xlabel() for axes in panels] == ["k [1/s]", "x"]
    (axes,) = again.plot().axes
    assert "open" not in axes.get_title()
    # a smooth curve through the points, including points near the optimum
    (curve,) = [line for line in axes.get_lines() if len(line.get_xdata()) > 50]
    values, costs = again.values["x"], again.costs["x"]
    assert np.sum(costs < 0.1 * again.threshold) >= 3
    np.testing.assert_allclose(np.interp(values, *curve.get_data()), costs, atol=0.02 * again.threshold)
    # straight lines between the points would bend only at the points
    bends = np.diff(curve.get_ydata(), 2)
    assert np.mean(bends > 0) > 0.95 and bends.max() < 3 * np.median(bends)


def test_curve_of_a_parabola_is_a_parabola():
    pytest.importorskip("matplotlib").use("Agg")
    from pydfo._plot.profile import smooth

    values = np.array([-3.0, -1.0, -0.4, 0.0, 0.5, 2.0])
    at, costs = smooth(values, values**2, 0.0)
    np.testing.assert_allclose(costs, at**2, atol=1e-9)
    at, costs = smooth(values, np.array([4.0, 4.0, 1.0, 0.0, 1.0, 1.0]), 0.0)
    assert costs.max() <= 4.0 + 1e-12 and costs.min() >= 0.0


def test_open_side_is_infinite_and_reported():
    fit = decay(upper=1.5).fit()
    profile = fit.profile("k")
    low, high = profile.intervals["k"]
    assert np.isfinite(low) and high == np.inf
    assert profile.messages["k"] == "open towards larger values: reaches its upper bound, 1.5"
    assert profile.message in repr(profile)


def test_interrupt_contains_partial_profile(tmp_path):
    calibration = Calibration(example_fmu("furuta"), recordings.furuta("own"), ANGLES, FRICTION, relative_tolerance=1e-11, solver="tsit5")
    fit, file = calibration.fit(), tmp_path / "profile.json"

    def written():
        try:
            return file.read_text()
        except OSError:
            return ""  # not there yet; on Windows also while it is replaced

    def interrupt():
        # One side is complete, three are not.
        while '"side"' not in written():
            time.sleep(1e-3)
        signal.raise_signal(signal.SIGINT)

    thread = threading.Thread(target=interrupt, daemon=True)
    thread.start()
    with pytest.raises(Interrupted) as caught:
        fit.profile(workers=1, checkpoint=file)
    thread.join()
    found = caught.value.result
    assert isinstance(found, Profile) and found.interrupted and "interrupted" in found.message
    assert np.isfinite(found.intervals["armFriction"][0]) and found.intervals["pendulumFriction"][1] == np.inf


def test_profile_of_the_likelihood_equals_that_of_one_output():
    calibration = decay()
    ours, squares = (calibration.fit(objective=objective) for objective in ("likelihood", "sum-of-squares"))
    assert ours.method == squares.method == "least-squares"
    ours, squares = ours.profile(), squares.profile()
    assert ours.degrees_of_freedom == squares.degrees_of_freedom
    for name, (low, high) in ours.intervals.items():
        np.testing.assert_allclose((low, high), squares.intervals[name], atol=1e-4 * (high - low))


def test_mistakes_are_reported(tmp_path):
    fit = decay().fit()
    for options, expected in (
        ({"parameters": ["q"]}, "unknown parameter 'q'; expected one of: k, x"),
        ({"level": 95}, "between 0 and 1"),
        ({"max_points": 0}, "max_points = 0"),
        ({"workers": 0}, "workers = 0"),
    ):
        with pytest.raises(ValueError, match=expected):
            fit.profile(**options)
    with pytest.raises(OSError):
        fit.profile(checkpoint=tmp_path)
    with pytest.raises(ValueError, match="another cost \\(mae\\)"):
        decay().fit(objective="mae").profile()
