"""Global sensitivity analysis: closed forms, options, failures, interrupts and calibrations."""

from __future__ import annotations

import concurrent.futures
import signal
import threading

import numpy as np
import pytest

import pydfo
from pydfo import Calibration, Parameter, Sensitivity, example_fmu, sensitivity

ISHIGAMI = [(-np.pi, np.pi)] * 3


def ishigami(x):
    return np.sin(x[0]) + 7.0 * np.sin(x[1]) ** 2 + 0.1 * x[2] ** 4 * np.sin(x[0])


def two_values(x):
    return [x[0] + 2.0 * x[1], x[0] * x[1]]


def decay(**settings):
    times = np.linspace(0, 3, 30)
    parameters = [Parameter("k", 1.0, 0.1, 5.0), Parameter("x", 1.0, 0.5, 2.0)]
    return Calibration(example_fmu("dahlquist"), {"time": times, "x": np.exp(-1.5 * times)}, ["x"], parameters, **settings)


def test_sobol_indices_of_ishigami_are_within_their_intervals():
    found = sensitivity(ishigami, ISHIGAMI, method="sobol", n=512, second_order=True, names=["a", "b", "c"], outputs=["y"], rng=1)
    # Closed forms with 9 digits (Ishigami and Homma 1990; a = 7, b = 0.1).
    assert np.all(np.abs(found.S1[0] - [0.313905191, 0.442411145, 0.0]) < found.S1_conf[0])
    assert np.all(np.abs(found.ST[0] - [0.557588855, 0.442411145, 0.243683664]) < found.ST_conf[0])
    assert abs(found.S2[0, 0, 2] - 0.243683664) < found.S2_conf[0, 0, 2] and found.S2[0, 2, 0] == found.S2[0, 0, 2]
    assert np.isnan(found.S2[0, 1, 1]) and found.mu is None and found.reasons == [""]
    assert found.n_evaluations == 512 * 8 == len(found.x) == len(found.values) and found.seed == 1
    np.testing.assert_array_equal(found.values[:, 0], [ishigami(x) for x in found.x])
    text = repr(found)
    assert text.startswith("sensitivity (sobol): 4096 evaluations, 95 % intervals") and "a, c" in text


def test_result_is_identical_for_threads_executor_and_vectorized_function():
    def vectorized(x):
        return np.array([x[0] + 2.0 * x[1], x[0] * x[1]])

    bounds = [(0, 1), (0, 1)]
    expected = sensitivity(two_values, bounds, method="sobol", n=32, rng=3)
    with concurrent.futures.ThreadPoolExecutor(3) as executor:
        for fun, settings in ((two_values, {"workers": 4}), (two_values, {"workers": executor}), (vectorized, {"vectorized": True})):
            found = sensitivity(fun, bounds, method="sobol", n=32, rng=3, **settings)
            assert repr(found) == repr(expected)
            for name in ("S1", "S1_conf", "ST", "ST_conf", "x", "values"):
                np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_morris_effects_of_linear_function_are_slopes_over_the_range():
    found = sensitivity(lambda x: 2.0 * x[0] - 3.0 * x[1], [(0, 1), (0, 10), (5, 5)], n=8, rng=1)
    assert found.names == ["x[0]", "x[1]"] and found.outputs == ["y[0]"] and found.n_evaluations == 8 * 3
    np.testing.assert_allclose(found.mu, [[2.0, -30.0]], rtol=1e-14)
    np.testing.assert_allclose(found.mu_star, [[2.0, 30.0]], rtol=1e-14)
    np.testing.assert_allclose(found.sigma, 0.0, atol=1e-13)
    assert found.S1 is None and np.all(found.x[:, 2] == 5.0)


def test_logarithmic_and_integer_parameters_have_their_scale():
    found = sensitivity(lambda x: np.log10(x[0]) + 3 * x[1], [(1e-3, 1e3), (1, 3)], scale=["log", "linear"], kinds=["continuous", "integer"], rng=1)
    np.testing.assert_allclose(found.mu, [[6.0, 6.0]], rtol=1e-13)
    assert set(found.x[:, 1]) == {1.0, 2.0, 3.0}


def test_missing_values_are_left_out_and_counted():
    def fun(x):
        if x[0] > 0.9:
            raise ArithmeticError("diverged")
        return [x[0], np.nan if x[1] > 0.8 else x[1], 4.0]

    found = sensitivity(fun, [(0, 1), (0, 1)], method="sobol", n=64, rng=1, on_error="fail")
    assert 0 < found.n_used[1] < found.n_used[0] < 64 and found.n_failed == sum(found.failures.values())
    assert set(found.failures) == {"ArithmeticError: diverged", "value 1 is NaN"}
    assert np.isnan(found.values).any() and found.n_missing == 0
    assert "no variance" in found.reasons[2] and np.isnan(found.S1[2]).all() and "left out" in repr(found)
    with pytest.raises(pydfo.CalibrationError, match="0 complete trajectories.*diverged"):
        sensitivity(lambda x: fun([1.0, 0.0]), [(0, 1)], on_error="fail")


def test_exception_carries_partial_result():
    calls = []

    def fun(x):
        calls.append(x)
        if len(calls) == 20:
            raise ArithmeticError("diverged")
        return x[0]

    with pytest.raises(ArithmeticError, match="diverged") as caught:
        sensitivity(fun, [(0, 1), (0, 1)], method="sobol", n=10, rng=1)
    partial = caught.value.partial_result
    assert isinstance(partial, Sensitivity) and partial.n_used == [4] and partial.n_missing == 21


def test_interrupted_analysis_has_partial_result_and_continues(tmp_path):
    calls = []

    def fun(x):
        calls.append(x)
        if len(calls) == 20:
            signal.raise_signal(signal.SIGINT)
        return x[0]

    def analyse():
        return sensitivity(fun, [(0, 1), (0, 1)], checkpoint=tmp_path / "run.sens", options={"problem": "x"})

    with pytest.raises(pydfo.Interrupted) as caught:
        analyse()
    partial = caught.value.result
    assert isinstance(partial, Sensitivity) and partial.n_missing > 0 and partial.n_used[0] >= 6
    found = analyse()
    assert found.n_missing == 0 and found.seed == 0 and len(calls) <= 31
    np.testing.assert_allclose(found.mu, [[1.0, 0.0]], atol=1e-14)


def test_invalid_arguments_are_rejected():
    for settings, message in (
        ({"method": "fast"}, "expected one of: 'morris', 'sobol'"),
        ({"n": 1}, "n = 1 must be at least 2"),
        ({"levels": 3}, "levels = 3 must be an even number"),
        ({"method": "sobol", "levels": 4}, "levels applies"),
        ({"second_order": True}, "second_order applies"),
        ({"level": 1.0}, "level = 1 must be between 0 and 1"),
        ({"names": ["a"]}, "names of the parameters: expected 2"),
        ({"outputs": ["a", "b"]}, "number of values of a point = 1"),
    ):
        with pytest.raises(ValueError, match=message):
            sensitivity(lambda x: x[0], [(0, 1), (0, 1)], **settings)
    with pytest.raises(ValueError, match="finite bounds"):
        sensitivity(lambda x: x[0], [(0, 1), (0, None)])


def test_table_and_figure():
    found = sensitivity(two_values, [(0, 1), (0, 1)], names=["a", "b"], outputs=["sum", "product"], rng=1)
    table = found.table()
    assert [(row["output"], row["parameter"]) for row in table] == [("sum", "a"), ("sum", "b"), ("product", "a"), ("product", "b")]
    assert table[1]["mu_star"] == found.mu_star[0, 1]
    pytest.importorskip("matplotlib").use("Agg")
    assert len([axes for axes in found.plot().axes if axes.get_visible()]) == 2
    assert found.plot("product").axes[0].get_title(loc="left") == "product"
    with pytest.raises(ValueError, match="unknown output 'x'"):
        found.plot("x")
    frame = pytest.importorskip("pandas") and found.to_dataframe()
    assert list(frame.columns[:3]) == ["output", "parameter", "mu"] and len(frame) == 4


def test_calibration_analyses_cost_and_errors_of_outputs():
    calibration = decay()
    found = calibration.sensitivity("sobol", 64, rng=1)
    assert found.outputs == ["cost", "rms(x)"] and found.names == ["k", "x"] and found.n_evaluations == 64 * 4
    for x, values in list(zip(found.x, found.values))[:5]:
        assert values[0] == calibration.cost(x)
        np.testing.assert_allclose(values[1], np.sqrt(values[0] / 30), rtol=1e-12)
    assert np.all(found.ST[:, 0] > found.ST_conf[:, 0])
    one = calibration.sensitivity("sobol", 64, 1, rng=1)
    assert repr(one) == repr(found)
    np.testing.assert_array_equal(one.values, found.values)


def test_calibration_continues_from_checkpoint_and_rejects_another(tmp_path):
    file = tmp_path / "run.sens"
    first = decay().sensitivity(checkpoint=file)
    again = decay().sensitivity(checkpoint=file)
    assert repr(first) == repr(again) and first.seed == 0 and first.n_evaluations == 10 * 3
    with pytest.raises(pydfo.CheckpointError):
        decay().sensitivity("sobol", 16, checkpoint=file)


def test_calibration_returns_complete_rows_after_time_limit():
    found = decay().sensitivity("sobol", 2**14, max_time=1.0)
    assert found.n_missing > 0 and 2 <= found.n_used[0] < 2**14 and "were not evaluated" in repr(found)


def test_calibration_requires_finite_bounds():
    calibration = Calibration(
        example_fmu("dahlquist"), {"time": [0.0, 1.0], "x": [1.0, 0.5]}, ["x"], [Parameter("k", 1.0, 0.1, 5.0), Parameter("x", 1.0)]
    )
    with pytest.raises(ValueError, match="finite bounds.*'x'"):
        calibration.sensitivity()


def test_calibration_interrupt_has_partial_result():
    calibration = decay()
    timer = threading.Timer(0.5, signal.raise_signal, [signal.SIGINT])
    timer.start()
    with pytest.raises(pydfo.Interrupted) as caught:
        calibration.sensitivity("sobol", 2**17)
    timer.join()
    assert caught.value.result is None or caught.value.result.n_missing > 0
