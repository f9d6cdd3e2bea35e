"""Calibration and Fit: from data to parameters."""

from __future__ import annotations

import os
import signal
import threading
import time

from conftest import press_ctrl_c
import numpy as np
import pytest
import recordings

import pydfo
from pydfo import Calibration, Fit, Parameter, example_fmu

K = Parameter("k", 1.0, 0.1, 10.0)
TIME = np.array([0.0, 0.3, 0.5, 1.0, 1.5])
TRUE = np.exp(-2.0 * TIME)


@pytest.fixture(scope="module")
def dahlquist():
    """x' = -k x, x(0) = 1."""
    return example_fmu("dahlquist")


def decay(model, data=None, **changes):
    arguments = {"outputs": ["x"], "parameters": [K], "relative_tolerance": 1e-10, **changes}
    return Calibration(model, {"time": TIME, "x": TRUE} if data is None else data, **arguments)


def test_cost_is_the_sum_of_squares(dahlquist):
    calibration = decay(dahlquist)
    residuals = calibration.residuals([1.0])
    np.testing.assert_allclose(residuals, np.exp(-TIME) - TRUE, atol=1e-8)
    assert calibration.cost([1.0]) == pytest.approx(np.sum(residuals**2), rel=1e-14)
    assert calibration.cost() == calibration.cost({"k": 1.0}) == calibration.cost(np.array([1.0]))
    assert calibration.cost([2.0]) < 1e-15
    assert calibration.n_residuals == 5 and calibration.names == ["k"] and calibration.parameters == (K,)
    assert "5 measurements" in repr(calibration)


def test_cost_is_identical_for_all_forms_of_data(dahlquist, tmp_path):
    pd = pytest.importorskip("pandas")
    path = tmp_path / "data.csv"
    rows = [f"{t!r},{x!r},text" for t, x in zip(TIME.tolist(), TRUE.tolist())]
    path.write_text("time,x,note\n" + "\n".join(rows) + "\n")
    structured = np.zeros(5, dtype=[("time", float), ("x", float)])
    structured["time"], structured["x"] = TIME, TRUE
    frame = pd.DataFrame({"time": TIME, "x": TRUE, "note": ["text"] * 5})
    reference = decay(dahlquist).cost()
    for data in (
        path,
        str(path),
        {"Time": TIME.tolist(), "x": TRUE.tolist()},
        {"time": TIME, "x": TRUE, "other": ["not", "used"]},
        structured,
        frame,
        frame.set_index("time"),
        frame.convert_dtypes(),
    ):
        assert decay(dahlquist, data).cost() == reference


def test_missing_values_are_masked(dahlquist):
    pd = pytest.importorskip("pandas")
    gaps = TRUE.copy()
    gaps[[1, 3]] = np.nan
    expected = decay(dahlquist).residuals()[[0, 2, 4]]
    masked = np.ma.masked_array(TRUE, [0, 1, 0, 1, 0])
    with_none = [None if np.isnan(v) else v for v in gaps]
    with_na = pd.array(with_none, dtype="Float64")
    for column in (gaps, masked, with_none, pd.Series(with_na)):
        np.testing.assert_allclose(decay(dahlquist, {"time": TIME, "x": column}).residuals(), expected, atol=1e-9)


def test_residuals_are_weighted_and_ordered_by_output_and_time():
    model = example_fmu("van_der_pol")
    data = {"time": TIME, "b": np.zeros(5), "a": np.array([1.0, np.nan, 1.0, 1.0, np.nan])}
    options = {"parameters": [Parameter("mu", 1.0)], "relative_tolerance": 1e-10}
    plain = Calibration(model, data, {"x1": "b", "x0": "a"}, **options)
    simulated = plain.simulate()
    np.testing.assert_array_equal(simulated["time"], TIME)
    expected = np.concatenate((simulated["x1"], simulated["x0"][[0, 2, 3]] - 1.0))
    np.testing.assert_allclose(plain.residuals(), expected, atol=1e-8)
    factors = np.array([2.0] * 5 + [0.5] * 3)
    for weights in ({"x1": 2.0, "x0": 0.5}, [2.0, 0.5]):
        weighted = Calibration(model, data, {"x1": "b", "x0": "a"}, weights=weights, **options)
        np.testing.assert_array_equal(weighted.residuals(), plain.residuals() * factors)
    measured = plain.measurements()
    assert list(measured) == ["x1", "x0"] and measured["x0"][0].tolist() == [0.0, 0.5, 1.0]


def test_window_start_time_and_start_values_are_applied(dahlquist):
    whole = decay(dahlquist)
    part = decay(dahlquist, window=(0.3, 1.0))
    np.testing.assert_allclose(part.residuals([1.7]), whole.residuals([1.7])[1:4], atol=1e-8)
    doubled = decay(dahlquist, {"time": TIME, "x": 2.0 * TRUE}, start_values={"x": 2.0})
    assert doubled.cost([2.0]) < 1e-15
    later = decay(dahlquist, {"time": TIME + 5.0, "x": TRUE}, start_time=5.0)
    assert later.cost([2.0]) < 1e-15


def test_inputs_drive_the_model():
    model = example_fmu("switched_input")
    time = np.linspace(0.0, 4.0, 41)
    data = {"time": time, "push": np.sin(time)}
    settings = {"parameters": [Parameter("K", 1.0, 0.1, 10.0)], "inputs": {"u": "push"}, "relative_tolerance": 1e-9}
    settings["start_values"] = {"enabled": True, "gear": 1}
    first = Calibration(model, {**data, "lag": np.zeros(41)}, {"y": "lag"}, **settings)
    measured = first.simulate([2.5])["y"]
    assert np.ptp(measured) > 0.1
    fit = Calibration(model, {**data, "lag": measured}, {"y": "lag"}, **settings).fit(x_tol=1e-7, f_tol=1e-7)
    assert fit.parameters["K"] == pytest.approx(2.5, abs=1e-4)


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_fit_finds_the_parameter(dahlquist, scale):
    fit = decay(dahlquist, parameters=[Parameter("k", 1.0, 0.1, 10.0, scale=scale)]).fit()
    assert isinstance(fit, Fit) and fit.success and fit.status == 0
    assert fit.parameters == {"k": fit.x[0]} and fit.x[0] == pytest.approx(2.0, abs=1e-4)
    assert fit.cost == fit.fun == fit["cost"] and fit.rms == np.sqrt(fit.cost / 5) == fit["rms"]
    assert fit.nfail == 0 and fit.nfev + fit.n_speculative == len(fit.trace) and fit.nit >= 3
    assert "converged" in fit.message and "  k  1  -> " in repr(fit)
    assert fit.start_cost == pytest.approx(np.sum((np.exp(-TIME) - TRUE) ** 2), rel=1e-6)
    assert fit.start_rms == np.sqrt(fit.start_cost / 5)
    x_opt, f_opt, nbr_iters, nbr_fevals, _ = fit
    assert (x_opt is fit.x, f_opt, nbr_iters, nbr_fevals) == (True, fit.cost, fit.nit, fit.nfev)
    np.testing.assert_allclose(fit.simulate()["x"], TRUE, atol=1e-4)
    np.testing.assert_allclose(fit.simulate([1.0], [0.0, 2.0])["x"], np.exp([0.0, -2.0]), atol=1e-6)
    assert np.sum(fit.residuals() ** 2) == pytest.approx(fit.cost, rel=1e-9)


def test_fixed_parameters_are_kept_and_reported(dahlquist):
    parameters = [Parameter("x", 1.0, fixed=True), K]
    fit = decay(dahlquist, parameters=parameters).fit()
    assert fit.x[0] == 1.0 and fit.parameters["k"] == pytest.approx(2.0, abs=1e-4)


def test_fit_is_identical_for_all_worker_counts_and_plans(dahlquist):
    noisy = TRUE + 0.01 * np.random.default_rng(1).normal(size=5)
    calibration = decay(dahlquist, {"time": TIME, "x": noisy})
    reference = calibration.fit("nelder-mead", workers=1)
    for workers in (1, 2, 4, None, -1):
        for batch in ("auto", "serial", 2, 4):
            fit = calibration.fit("nelder-mead", workers=workers, batch=batch)
            assert fit.x.tobytes() == reference.x.tobytes()
            assert (fit.cost, fit.nit) == (reference.cost, reference.nit)
            assert fit.final_simplex[0].tobytes() == reference.final_simplex[0].tobytes()


def test_limits_target_and_start_are_exact(dahlquist):
    calibration = decay(dahlquist)
    for n in (1, 2, 3, 4, 7):
        assert calibration.fit("nelder-mead", max_evaluations=n).nfev == n
    assert calibration.fit(max_iterations=3).nit == 3
    fit = calibration.fit(target=1e-3)
    assert fit.status == 10 and fit.cost <= 1e-3
    fit = calibration.fit(start={"k": 5.0}, max_iterations=0, initial_simplex=[0.5])
    assert fit.trace.x.ravel().tolist() == [5.0, 5.5] and fit.start.tolist() == [5.0]
    assert calibration.fit(x_tol=1e-1, f_tol=0.0, stop="any").x_size <= 0.1


def test_fit_reports_progress_to_callbacks(dahlquist, capsys):
    seen = []
    fit = decay(dahlquist).fit(callback=seen.append, disp=True)
    assert [p.nit for p in seen] == list(range(fit.nit + 1))
    out = capsys.readouterr().out
    assert f"k = {fit.x[0]:.7g}"[:9] in out and fit.message in out and len(out.splitlines()) == fit.nit + 5
    assert decay(dahlquist).fit(callback=lambda p: p.nit >= 3).status == 4
    assert capsys.readouterr().out == ""
    error = RuntimeError("enough")

    def callback(intermediate_result):
        raise error

    with pytest.raises(RuntimeError) as info:
        decay(dahlquist).fit(callback=callback)
    partial = error.partial_result
    assert info.value is error and isinstance(partial, Fit) and "k" in partial.parameters
    assert (partial.status, partial.termination) == (6, "aborted")


def test_failed_simulations_are_counted(dahlquist):
    calibration = decay(dahlquist, timeout=1e-9)
    with pytest.raises(pydfo.SimulationError, match=r"the simulation at k = 3 failed: .*time limit") as info:
        calibration.cost([3.0])
    assert info.value.time == 0.0 and info.value.log == []
    with pytest.raises(pydfo.AllStartsFailed, match="time limit") as info:
        calibration.fit("nelder-mead")
    assert sum(info.value.failures.values()) == 2 == info.value.nfev


@pytest.mark.parametrize(
    ("changes", "error", "expected"),
    [
        ({"parameters": []}, ValueError, "parameters is empty"),
        ({"parameters": [K, K]}, ValueError, "'k': is given twice"),
        ({"parameters": ["k"]}, TypeError, "parameters must be a list of pydfo.Parameter"),
        ({"parameters": [Parameter("kk", 1.0)]}, KeyError, '"kk"; did you mean k'),
        ({"parameters": [Parameter("der(x)", 1.0)]}, ValueError, r"der\(x\) cannot be set"),
        ({"outputs": {}}, ValueError, "no output"),
        ({"outputs": ["y"]}, ValueError, "column 'y' not found; available: 'time', 'x'"),
        ({"outputs": {"xx": "x"}}, KeyError, '"xx"'),
        ({"outputs": {"x": 1}}, TypeError, "outputs must be a string"),
        ({"outputs": 5}, TypeError, "outputs must be a dict"),
        ({"data": {"x": TRUE}}, ValueError, "column 'time' not found; available: 'x'"),
        ({"data": {"time": TIME[::-1], "x": TRUE}}, ValueError, "times must ascend"),
        ({"data": {"time": TIME, "x": TRUE[:3]}}, ValueError, "column 'x' has 3 values, but 'time' has 5"),
        ({"data": {"time": TIME, "x": ["a"] * 5}}, ValueError, "'a' in column 'x', row 0, is not a number"),
        ({"data": {"time": TIME, "x": [np.nan] * 5}}, ValueError, "all 5 values of column 'x' from time 0 to 1.5 are missing"),
        ({"data": {"time": TIME, "x": [np.inf] * 5}}, ValueError, "column 'x' is infinite or above 1.8e308 at time 0"),
        ({"data": {"time": TIME, "x": TRUE[:, None]}}, ValueError, "column 'x' must be one-dimensional"),
        ({"data": {"time": np.flip(TIME).astype("datetime64[s]"), "x": TRUE}}, ValueError, "times must ascend"),
        ({"data": {"time [ms]": (TIME * 1e3).astype("timedelta64[ms]"), "x": TRUE}}, ValueError, "contains durations"),
        ({"data": {"time": TIME, "x": TRUE.astype("timedelta64[s]")}}, ValueError, "column 'x' contains dates"),
        ({"data": {"time": [], "x": []}}, ValueError, "no rows"),
        ({"data": 3.0}, TypeError, "data must be the path"),
        ({"data": "missing.csv"}, FileNotFoundError, "missing.csv"),
        ({"model": "missing.fmu"}, FileNotFoundError, "missing.fmu"),
        ({"model": 3}, TypeError, "model must be the path"),
        ({"window": (5.0, 6.0)}, ValueError, "window from 5 to 6"),
        ({"window": (1.0, 0.0)}, ValueError, "window from 1 to 0"),
        ({"window": (1.0,)}, ValueError, "window must be two times"),
        ({"start_time": 0.2}, ValueError, "before the simulation starts at 0.2"),
        ({"weights": {"y": 1.0}}, ValueError, "unknown output 'y'"),
        ({"weights": [1.0, 2.0]}, ValueError, "weights: expected 1 values, one per output; got 2"),
        ({"weights": [-1.0]}, ValueError, "weight -1"),
        ({"weights": ["heavy"]}, ValueError, "column 'heavy' not found"),
        ({"start_values": {"z": 1.0}}, KeyError, '"z"'),
        ({"start_values": {"x": "a"}}, TypeError, "x: expected a value of type Real, got"),
        ({"start_values": {"x": None}}, TypeError, "x: expected a value of type Real, got None"),
        ({"start_values": {"k": 1.0}}, ValueError, "'k': it is fitted, but start_values sets it to 1"),
        ({"time": "t"}, ValueError, "column 't' not found; available: 'time', 'x'"),
        ({"data": {"t": TIME, "x": TRUE}}, ValueError, "column 'time' not found; available: 't', 'x'"),
        ({"data": {"time [y]": TIME, "x": TRUE}}, ValueError, "unit 'y' is not a unit of time; expected s, ms"),
        ({"data": {"time": TIME + 100.0, "x": TRUE}}, ValueError, "Set start_time = 100 .* start_time = 0"),
        ({"timeout": -1.0}, ValueError, "timeout = -1"),
        ({"relative_tolerance": -1.0}, ValueError, "toleran"),
        ({"interior_samples": -1}, ValueError, "interior_samples must be an integer of at least 0, not -1"),
        ({"solver": "magic"}, ValueError, "magic"),
        ({"solver": None}, TypeError, "solver must be a string"),
        ({"inputs": {"u": "x"}}, KeyError, '"u"'),
    ],
    ids=lambda v: ",".join(f"{k}" for k in v) if isinstance(v, dict) else "",
)
def test_mismatched_arguments_are_named(dahlquist, tmp_path, monkeypatch, changes, error, expected):
    monkeypatch.chdir(tmp_path)
    arguments = {"model": dahlquist, "data": {"time": TIME, "x": TRUE}, "outputs": ["x"], "parameters": [K], **changes}
    with pytest.raises(error, match=expected):
        Calibration(**arguments)
    assert list(tmp_path.iterdir()) == []


def test_settings_reach_the_solver_and_the_problem_identity(dahlquist, tmp_path):
    ball = pydfo.FMUModel(example_fmu("bouncing_ball"))
    usual, close = (ball.simulate(final_time=1.0, **settings).stats for settings in ({}, {"interior_samples": 20}))
    assert close.event_indicators > 2 * usual.event_indicators
    with pytest.raises(ValueError, match="interior_samples must be an integer of at least 0, not -1"):
        ball.simulate(final_time=1.0, interior_samples=-1)
    file = tmp_path / "fit"
    decay(dahlquist).fit(checkpoint=file)
    with pytest.raises(pydfo.CheckpointError, match="interior_samples of the simulations: none in the file, 9 in this run"):
        decay(dahlquist, interior_samples=9).fit(checkpoint=file)


def test_bad_csv_files_are_rejected_with_position(dahlquist, tmp_path):
    path = tmp_path / "data.csv"
    for text, expected in [
        ("time,x\n0,1\n2,1\n1,1\n", "line 4"),
        ("time,x\n0,one\n", "'one' in column 'x', line 2"),
        ("time,y\n0,1\n", "column 'x' not found; available: 'y'"),
        ("", "no rows"),
    ]:
        path.write_text(text)
        with pytest.raises(pydfo.BadCalibrationError, match=expected) as info:
            decay(dahlquist, path)
        assert isinstance(info.value, ValueError) and isinstance(info.value, pydfo.CalibrationError)


@pytest.mark.parametrize(
    ("arguments", "error", "expected"),
    [
        ((("k", np.nan), {}), ValueError, "'k': start NaN"),
        ((("k", 0.5, 2.0, 1.0), {}), ValueError, "lower bound 2 is above upper bound 1"),
        ((("k", 3.0, 0.0, 1.0), {}), ValueError, "start 3 is outside"),
        ((("k", 0.5, np.nan), {}), ValueError, "NaN"),
        ((("k", 0.5, 0.0, 1.0), {"scale": "log"}), ValueError, "above 0, but the start is 0.5 and the lower bound 0"),
        ((("k", 1.0), {"scale": "square"}), ValueError, "scale = 'square'"),
        ((("k", 1.0), {"kind": "int"}), ValueError, "did you mean 'integer'"),
        ((("k", 1.0), {"nominal": 0.0}), ValueError, "nominal 0"),
        ((("k", "one"), {}), TypeError, "start must be a number"),
        (((3, 1.0), {}), TypeError, "name must be a string"),
    ],
)
def test_bad_parameters_are_rejected(arguments, error, expected):
    with pytest.raises(error, match=expected):
        Parameter(*arguments[0], **arguments[1])


def test_parameters_have_a_repr():
    assert repr(Parameter("a", 1, 0, 2)) == "Parameter('a', 1.0, 0.0, 2.0)"
    assert repr(Parameter("a", 1, upper=2, scale="log", nominal=3, fixed=True)) == (
        "Parameter('a', 1.0, None, 2.0, scale='log', nominal=3.0, fixed=True)"
    )
    assert Parameter("a", 1) == Parameter("a", 1.0) and len({Parameter("a", 1), Parameter("a", 1.0)}) == 1
    with pytest.raises(AttributeError):
        Parameter("a", 1).start = 2.0


@pytest.mark.parametrize(
    ("changes", "error", "expected"),
    [
        ({"options": {"scale": "log"}}, ValueError, "set scale in each Parameter"),
        ({"options": {"pop": 3}}, ValueError, "least-squares has no option 'pop'"),
        ({"method": "magic"}, ValueError, "unknown method 'magic'; expected one of: nelder-mead"),
        ({"workers": 0}, ValueError, "workers = 0"),
        ({"x_tol": -1.0}, ValueError, "x_tol"),
        ({"max_evaluations": 0}, ValueError, "max_evaluations = 0"),
        ({"start": [1.0, 2.0]}, ValueError, "2"),
        ({"start": [20.0]}, ValueError, "20"),
        ({"start": {"z": 1.0}}, ValueError, "unknown parameter 'z'"),
        ({"callback": 3}, TypeError, "callback"),
    ],
)
def test_bad_options_of_a_fit_are_named(dahlquist, changes, error, expected):
    with pytest.raises(error, match=expected):
        decay(dahlquist).fit(**changes)


def test_cost_requires_one_finite_value_per_parameter(dahlquist):
    calibration = decay(dahlquist)
    with pytest.raises(ValueError, match=r"2 values given for 1 parameters \(k\)"):
        calibration.cost([1.0, 2.0])
    with pytest.raises(ValueError, match="k"):
        calibration.cost([np.nan])
    with pytest.raises(ValueError, match="unknown parameter 'z'"):
        calibration.residuals({"z": 1.0})


def test_costs_are_identical_in_several_threads(dahlquist):
    calibration = decay(dahlquist)
    xs = np.linspace(0.5, 3.0, 40)
    expected = [calibration.cost([x]) for x in xs]
    results = {}

    def run(i):
        results[i] = [calibration.cost([x]) for x in xs]

    threads = [threading.Thread(target=run, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30.0)
    assert all(results[i] == expected for i in range(4))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_fit_works_in_forked_child(dahlquist):
    calibration = decay(dahlquist)
    fit = calibration.fit(workers=2)
    calibration.cost()
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        status = 1
        try:
            again = calibration.fit(workers=2)
            same = again.x.tobytes() == fit.x.tobytes() and calibration.cost() == decay(dahlquist).cost()
            os.write(writer, b"same" if same else b"different")
            status = 0
        finally:
            os._exit(status)
    os.close(writer)
    with os.fdopen(reader, "rb") as pipe:
        assert pipe.read() == b"same"
    assert os.waitpid(child, 0)[1] == 0
    assert calibration.fit(workers=2).x.tobytes() == fit.x.tobytes()


def furuta(**changes):
    """Returns a model whose simulations take tens of milliseconds."""
    time = np.arange(0.0, 40.0, 0.05)
    data = {"time": time, "phi": np.zeros_like(time), "theta": np.full_like(time, np.pi)}
    parameters = [Parameter("armFriction", 0.012, 0.0, 0.022), Parameter("pendulumFriction", 0.002, 0.0, 0.012)]
    return Calibration(
        example_fmu("furuta"),
        data,
        {"armJoint.phi": "phi", "pendulumJoint.phi": "theta"},
        parameters,
        solver="rk4",
        step_size=5e-4,
        **changes,
    )


def test_other_threads_run_during_a_fit():
    calibration = furuta()
    ticks, done = [], threading.Event()

    def tick():
        while not done.is_set():
            ticks.append(time.monotonic())
            time.sleep(0.001)

    thread = threading.Thread(target=tick)
    thread.start()
    try:
        time.sleep(0.05)
        start = time.monotonic()
        calibration.fit(x_tol=0.0, f_tol=0.0, max_time=0.5)
        end = time.monotonic()
    finally:
        done.set()
        thread.join()
    inside = [t for t in ticks if start < t < end]
    assert len(inside) > 50 and np.max(np.diff(inside)) < 0.2


@pytest.mark.parametrize("presses", [1, 2])
def test_ctrl_c_ends_fit_with_best_point(presses):
    calibration = furuta()
    begun = threading.Event()
    pressed = []

    def press():
        begun.wait(20.0)
        for _ in range(presses):
            pressed.append(time.monotonic())
            press_ctrl_c()
            time.sleep(0.005)

    before = signal.getsignal(signal.SIGINT)
    thread = threading.Thread(target=press)
    thread.start()
    with pytest.raises(pydfo.Interrupted) as info:
        calibration.fit(x_tol=0.0, f_tol=0.0, max_evaluations=10**6, callback=lambda p: begun.set() if p.nit == 2 else None)
    assert time.monotonic() - pressed[0] < 1.0
    thread.join()
    fit = info.value.result
    assert isinstance(fit, Fit) and fit.status == 5 and fit.nit >= 2 and fit.cost <= calibration.cost()
    assert set(fit.parameters) == {"armFriction", "pendulumFriction"} and "armFriction" in repr(fit)
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize("call", ["cost", "residuals", "simulate"])
def test_ctrl_c_ends_long_simulation(call):
    calibration = furuta()
    calibration.cost()
    # simulations of several seconds
    calibration = Calibration(
        example_fmu("furuta"),
        {"time": [0.0, 40.0], "phi": [0.0, 0.0]},
        {"armJoint.phi": "phi"},
        Parameter("armFriction", 0.012),
        solver="euler",
        step_size=2e-6,
        timeout=4.0,
    )
    timer = threading.Timer(0.2, press_ctrl_c)
    start = time.monotonic()
    timer.start()
    with pytest.raises(pydfo.Interrupted):
        getattr(calibration, call)()
    assert time.monotonic() - start < 1.2


def test_fit_is_plotted(dahlquist, tmp_path):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    gaps = TRUE.copy()
    gaps[1] = np.nan
    fit = decay(dahlquist, {"time": TIME, "x": gaps}).fit()
    figure = fit.plot()
    path = tmp_path / "fit.png"
    figure.savefig(path)
    assert path.stat().st_size > 10_000 and len(figure.axes) == 2
    labels = [line.get_label() for line in figure.axes[0].lines]
    assert labels == ["measured", "start", "fitted"]
    residual = figure.axes[1].lines[1]
    np.testing.assert_array_equal(residual.get_xdata(), TIME[[0, 2, 3, 4]])
    np.testing.assert_allclose(residual.get_ydata(), fit.residuals(), atol=1e-9)
    matplotlib.pyplot.close("all")


# --- The Furuta pendulum ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=recordings.at_hand("FurutaData.mat"))
def measured(request):
    return recordings.furuta(request.param) | {"name": request.param}


def furuta_calibration(measured):
    parameters = [Parameter("armFriction", 0.012, 0.0, 0.022), Parameter("pendulumFriction", 0.002, 0.0, 0.012)]
    outputs = {"armJoint.phi": "phi", "pendulumJoint.phi": "theta"}
    data = {name: measured[name] for name in ("time", "phi", "theta")}
    return Calibration(example_fmu("furuta"), data, outputs, parameters, relative_tolerance=1e-8)


def test_furuta_costs_match_reference(measured):
    calibration = furuta_calibration(measured)
    if measured["name"] == "published":
        assert calibration.cost([0.012, 0.002]) == pytest.approx(207.0783, abs=0.01)
        assert calibration.cost([0.010, 0.001]) == pytest.approx(1.09246, abs=1e-3)
    else:
        # The noise of the 801 rows has standard deviations of 0.0305 and 0.0207 rad.
        assert calibration.cost([0.010, 0.001]) == pytest.approx(801 * (0.0305**2 + 0.0207**2), rel=0.15)
        assert calibration.cost([0.012, 0.002]) > 100 * calibration.cost([0.010, 0.001])


def test_furuta_fit_is_identical_for_all_worker_counts(measured):
    calibration = furuta_calibration(measured)
    fits = [calibration.fit(batch="serial", workers=workers) for workers in (1, 2, 4)]
    assert fits[0].parameters["armFriction"] == pytest.approx(0.010, abs=1e-4)
    assert fits[0].parameters["pendulumFriction"] == pytest.approx(0.001, abs=1e-5)
    assert fits[0].cost <= calibration.cost([0.010, 0.001])
    for fit in fits[1:]:
        assert fit.x.tobytes() == fits[0].x.tobytes() and (fit.cost, fit.nit) == (fits[0].cost, fits[0].nit)


def test_groups_of_settings_equal_single_arguments(dahlquist):
    single = decay(dahlquist, solver="bdf", timeout=5.0, isolation="none")
    settings = {"solver": "bdf", "timeout": 5.0, "relative_tolerance": 1e-10}
    for simulation in (settings, pydfo.Simulation(**settings)):
        grouped = decay(dahlquist, relative_tolerance=None, simulation=None)
        assert grouped.cost([1.3]) != single.cost([1.3])
        data = {"time": TIME, "x": TRUE}
        grouped = Calibration(dahlquist, data, ["x"], [K], simulation=simulation, process=pydfo.Process(isolation="none"))
        assert grouped.cost([1.3]) == single.cost([1.3])
        assert grouped.fit(limits=pydfo.Limits(max_evaluations=3)).nfev == single.fit(max_evaluations=3).nfev == 3


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"simulation": {"solver": "bdf"}, "solver": "bdf"}, "simulation and solver are both specified; put solver into simulation"),
        ({"simulation": {"sandbox": True}}, "simulation: unknown setting 'sandbox'; expected one of: kind, solver"),
        ({"process": 3}, "process must be a Process or a dict, not 3"),
        ({"max_stp": 1.0}, "no argument 'max_stp'; did you mean max_step?"),
    ],
)
def test_wrong_groups_of_settings_are_rejected(dahlquist, given, message):
    with pytest.raises(TypeError, match=message):
        Calibration(dahlquist, {"time": TIME, "x": TRUE}, ["x"], [K], **given)
