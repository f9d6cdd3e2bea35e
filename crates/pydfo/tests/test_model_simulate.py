"""Simulations: rows, arguments, events, limits, threads, Ctrl-C."""

from __future__ import annotations

import logging
import signal
import sys
import threading
import time

from conftest import press_ctrl_c
import fmus
import numpy as np
import pytest

import pydfo
from pydfo import Calibration, FmuError, FMUModel, Parameter, SimulationError, example_fmu

#: A simulation that takes hours.
LONG = {"final_time": 1e6, "ncp": 1, "solver": "euler", "step_size": 1e-5}


def model(name):
    return FMUModel(example_fmu(name))


# --- rows -------------------------------------------------------------------------------------------------------------


def test_simulation_has_500_intervals_by_default():
    res = model("furuta").simulate(final_time=40)
    assert np.array_equal(res["time"], np.append(0.08 * np.arange(500), 40.0))
    assert res.time is res["time"]
    assert all(column.shape == (501,) and column.dtype == float for column in res.values())


def test_start_and_final_time_may_be_positional():
    m = model("dahlquist")
    a, b, c = m.simulate(0, 2), m.simulate(final_time=2), m.simulate(stop_time=2)
    assert fmus.same_bits(a, b) and fmus.same_bits(a, c)
    late = m.simulate(1.5, 3.5, ncp=4)
    assert list(late.time) == [1.5, 2.0, 2.5, 3.0, 3.5]
    assert late.final("x") == pytest.approx(np.exp(-2), rel=1e-5)


def test_default_experiment_sets_final_time():
    m = model("furuta")
    assert m.description.default_experiment.stop_time == 40.0
    assert m.simulate().time[-1] == 40.0


def test_rows_are_at_given_times():
    times = np.array([0.0, 0.1, 0.1 + 0.2, 1.0, 7.123456789])
    for given in (times, list(times), tuple(times), times[:, None][:, 0]):
        res = model("dahlquist").simulate(times=given, final_time=8, relative_tolerance=1e-10)
        assert np.array_equal(res.time, times)
        assert res["x"] == pytest.approx(np.exp(-times), rel=1e-8)


def test_interval_and_ncp_determine_rows():
    m = model("dahlquist")
    assert np.array_equal(m.simulate(0, 1, output_interval=0.4).time, [0.0, 0.4, 0.8, 1.0])
    assert np.array_equal(m.simulate(0, 1, ncp=2).time, [0.0, 0.5, 1.0])
    assert np.array_equal(m.simulate(0, 1, ncp=2.0).time, [0.0, 0.5, 1.0])
    assert np.array_equal(m.simulate(0, 0).time, [0.0])


@pytest.mark.parametrize(
    "arguments",
    [
        {"times": [0.5], "ncp": 3},
        {"times": [0.5], "output_interval": 0.1},
        {"ncp": 3, "output_interval": 0.1},
        {"times": [0.5], "ncp": 3, "output_interval": 0.1},
        {"final_time": 1, "stop_time": 1},
        {"times": [0.5, 0.2]},
        {"times": [0.2, 0.2, 0.2]},
        {"times": [np.nan]},
        {"times": [-1.0]},
        {"times": [2.0]},
        {"times": np.zeros((2, 2))},
        {"ncp": 0},
        {"ncp": 2.5},
        {"ncp": -1},
        {"output_interval": 0},
        {"output_interval": -0.1},
        {"output_interval": np.nan},
        {"output_interval": 1e-300},
        {"start_time": 2},
        {"start_time": np.nan},
        {"final_time": np.inf},
        {"relative_tolerance": 0},
        {"relative_tolerance": -1},
        {"relative_tolerance": 2},
        {"relative_tolerance": np.nan},
        {"step_size": 0, "solver": "rk4"},
        {"max_step": 0},
        {"max_step": np.nan},
        {"timeout": -1},
        {"timeout": np.nan},
        {"solver": "ode45"},
        {"solver": ""},
    ],
    ids=str,
)
def test_invalid_arguments_are_rejected(arguments):
    if "stop_time" not in arguments:
        arguments = {"final_time": 1} | arguments
    with pytest.raises(ValueError):
        model("dahlquist").simulate(**arguments)


@pytest.mark.parametrize(
    "arguments",
    [
        {"final_time": "1"},
        {"final_time": [1, 2]},
        {"times": ["a"]},
        {"times": 1j},
        {"ncp": "3"},
        {"output_interval": {}},
        {"relative_tolerance": "small"},
        {"solver": 3},
        {"solver": None},
        {"output": 3},
        {"output": [3]},
        {"output": b"x"},
        {"start_values": ["k"]},
        {"start_values": {3: 1.0}},
        {"timeout": "1 s"},
        {"unknown": 1},
    ],
    ids=str,
)
def test_arguments_of_wrong_type_are_rejected(arguments):
    with pytest.raises(TypeError):
        model("dahlquist").simulate(**arguments)


# --- outputs ----------------------------------------------------------------------------------------------------------


def test_outputs_and_states_are_recorded_by_default():
    assert list(model("furuta").simulate(final_time=0.1)) == [
        "time",
        "armJoint.phi",
        "pendulumJoint.phi",
        "armJoint.w",
        "pendulumJoint.w",
    ]
    assert list(model("switched_input").simulate(final_time=0.1)) == ["time", "y", "target", "limit", "x"]
    assert list(model("stair").simulate(final_time=0.1)) == ["time", "counter"]


def test_chosen_outputs_are_recorded():
    m = model("furuta")
    assert list(m.simulate(0, 1, output="armJoint.mode")) == ["time", "armJoint.mode"]
    chosen = ["pendulumJoint.w", "armJoint.mode", "time", "g"]
    res = m.simulate(0, 1, output=chosen)
    assert list(res) == ["time", "pendulumJoint.w", "armJoint.mode", "g"]
    assert np.all(res["g"] == 9.81) and set(res["armJoint.mode"]) <= {-1.0, 0.0, 1.0}
    assert list(m.simulate(0, 1, output=[])) == ["time"]
    everything = m.simulate(0, 1, output="all")
    assert set(everything) == set(m.description.variables)
    assert np.array_equal(everything["armJoint.phi"], m.simulate(0, 1)["armJoint.phi"])


# --- methods ----------------------------------------------------------------------------------------------------------


def test_methods_agree_on_the_result():
    m = model("dahlquist")
    exact = np.exp(-1.0)
    errors = {
        solver: abs(m.simulate(0, 1, solver=solver, step_size=step).final("x") - exact)
        for solver, step in (("auto", None), ("tsit5", None), ("TSIT5", None), ("rk4", 0.01), ("euler", 0.01))
    }
    assert errors["auto"] == errors["tsit5"] == errors["TSIT5"] < 1e-6
    assert errors["rk4"] < 1e-10 and 1e-4 < errors["euler"] < 1e-2
    steps = m.simulate(0, 1, max_step=0.01).stats.accepted_steps
    assert steps >= 100 > m.simulate(0, 1).stats.accepted_steps


def test_cvode_selects_auto_with_a_note(caplog):
    m = model("dahlquist")
    with caplog.at_level(logging.INFO, logger="pydfo"):
        res = m.simulate(0, 1, solver="CVode")
    assert fmus.same_bits(res, m.simulate(0, 1))
    assert any("CVode" in record.getMessage() and record.name == "pydfo" for record in caplog.records)


@pytest.mark.parametrize("solver", ["tsit5", "dop853", "radau5", "bdf", "rk4", "auto"])
def test_methods_solve_the_test_equation(solver):
    step = 0.01 if solver in ("rk4", "euler") else None
    res = model("dahlquist").simulate(0, 5, solver=solver, relative_tolerance=1e-8, step_size=step)
    assert np.max(np.abs(res["x"] - np.exp(-res["time"]))) < 1e-5


def test_relative_tolerance_controls_the_error():
    m = model("van_der_pol")
    loose, tight = m.simulate(0, 20, relative_tolerance=1e-3), m.simulate(0, 20, relative_tolerance=1e-11)
    assert loose.stats.accepted_steps < tight.stats.accepted_steps
    assert tight.final(["x0", "x1"]) == pytest.approx([2.008149762174948592, -0.04250887527320214699], abs=1e-9)


# --- events -----------------------------------------------------------------------------------------------------------


def test_state_event_times_match_closed_form():
    res = model("bouncing_ball").simulate(final_time=3, relative_tolerance=1e-10)
    exact = fmus.bounces(11)
    assert np.abs(res.events["time"] - exact).max() < 1e-10
    assert set(res.events["kind"]) == {"state"}
    assert res.stats.events == res.stats.state_events == 11
    assert [t for t, kind in res.events if kind == "state"] == [event.time for event in res.events]


def test_both_sides_of_events_are_recorded():
    m = model("bouncing_ball")
    plain = m.simulate(final_time=3, ncp=30)
    res = m.simulate(final_time=3, ncp=30, record_events=True)
    assert len(res.time) == 31 + 2 * 11 and len(plain.time) == 31
    left = np.flatnonzero(res.left_limit)
    assert np.array_equal(res.time[left], res.events["time"])
    assert np.array_equal(res.time[left + 1], res.events["time"])
    assert np.all(res["v"][left] < 0) and np.all(res["v"][left + 1] >= 0)
    assert res["v"][left + 1][:-1] == pytest.approx(-0.7 * res["v"][left][:-1])
    assert not plain.left_limit.any()


def test_time_listed_twice_gives_both_limits():
    m = model("stair")
    res = m.simulate(final_time=5, times=[0, 0.5, 1, 1, 2, 3, 3])
    assert list(res["counter"]) == [1, 1, 1, 2, 3, 3, 4]
    assert list(res.left_limit) == [False, False, True, False, False, True, False]
    assert list(m.simulate(final_time=5, times=[0, 1, 2, 3])["counter"]) == [1, 2, 3, 4]


def test_model_has_time_events_and_ends_the_simulation():
    m = model("stair")
    res = m.simulate(final_time=20, times=np.arange(21.0))
    assert np.array_equal(res.events["time"], np.arange(1.0, 10.0)) and set(res.events["kind"]) == {"time"}
    assert (res.termination, res.end_time) == ("stopped-by-model", 9.0)
    assert list(res["counter"]) == list(range(1, 11)) and list(res.time) == list(range(10))
    assert m.get("counter") == 10 and m.get("time") == 9.0
    assert "stopped by the model" in repr(res)


# --- failures ---------------------------------------------------------------------------------------------------------


def test_time_limit_ends_the_simulation():
    m = model("van_der_pol")
    start = time.monotonic()
    with pytest.raises(pydfo.SimulationError, match=r"0\.1 s") as info:
        m.simulate(**LONG, max_time=0.1)
    assert time.monotonic() - start < 5
    assert info.value.status is None and 0 < info.value.time < 1e6 and info.value.log == []
    # The model can be used again; None and inf mean no limit.
    assert fmus.same_bits(m.simulate(0, 1, timeout=None), m.simulate(0, 1, timeout=np.inf))


def test_chattering_is_an_error():
    m = model("bouncing_ball")
    m.set("v_min", 0.0)
    with pytest.raises(pydfo.SimulationError, match="chattering") as info:
        m.simulate(final_time=3)
    assert info.value.time == pytest.approx(fmus.bounces(1)[0] * 1.7 / 0.3, abs=1e-3)


def test_rejected_call_reports_reason_of_model():
    m = model("bouncing_ball")
    m.set("e", 2.0)
    with pytest.raises(pydfo.SimulationError) as info:
        m.simulate(final_time=3)
    assert info.value.status == "error" and info.value.log and "fmi2" in str(info.value)
    m.set("e", 0.5)
    assert m.simulate(final_time=3).termination == "finished"


def test_warnings_go_to_the_logger(tmp_path, caplog):
    names = ('modelIdentifier="dahlquist"', 'modelIdentifier="other"')
    odd = FMUModel(fmus.changed("dahlquist", tmp_path / "m.fmu", names))
    with caplog.at_level(logging.WARNING, logger="pydfo"):
        res = odd.simulate(0, 1)
    assert any("dahlquist" in r.getMessage() and r.name == "pydfo" for r in caplog.records)
    assert fmus.same_bits(res, model("dahlquist").simulate(0, 1))


# --- threads and Ctrl-C -----------------------------------------------------------------------------------------------


def test_interpreter_lock_is_released():
    ticks, stop = [], threading.Event()

    def tick():
        while not stop.wait(0.001):
            ticks.append(1)

    m = model("van_der_pol")
    thread = threading.Thread(target=tick)
    thread.start()
    with pytest.raises(pydfo.SimulationError):
        m.simulate(**LONG, timeout=0.5)
    stop.set()
    thread.join()
    assert len(ticks) > 50


def test_threads_simulate_concurrently():
    path = example_fmu("furuta")
    expected = FMUModel(path).simulate(final_time=40)
    results = {}

    def run(k):
        separate = FMUModel(path)
        for _ in range(5):
            results[k, _] = separate.simulate(final_time=40)

    threads = [threading.Thread(target=run, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(results) == 20 and all(fmus.same_bits(expected, result) for result in results.values())


def test_concurrent_simulation_of_one_model_is_rejected():
    m = model("van_der_pol")
    errors = []

    def intrude():
        time.sleep(0.1)
        for call in (lambda: m.get("x0"), lambda: m.set("mu", 2.0), m.reset, lambda: m.simulate(0, 1)):
            try:
                call()
            except RuntimeError as e:
                errors.append(e)

    thread = threading.Thread(target=intrude)
    thread.start()
    with pytest.raises(pydfo.SimulationError):
        m.simulate(**LONG, timeout=0.5)
    thread.join()
    assert len(errors) == 4 and all("simulated" in str(e) for e in errors)
    assert m.get("mu") == 1.0


def test_model_may_be_closed_during_simulation():
    m = model("van_der_pol")
    threading.Timer(0.1, m.close).start()
    with pytest.raises(pydfo.SimulationError):
        m.simulate(**LONG, max_time=0.4)
    with pytest.raises(ValueError, match="closed"):
        m.get("x0")


@pytest.fixture
def ctrl_c():
    """Presses Ctrl-C after a delay, and appends the time to the list."""
    before = signal.getsignal(signal.SIGINT)
    pressed = []

    def press():
        pressed.append(time.monotonic())
        press_ctrl_c()

    threading.Timer(0.2, press).start()
    yield pressed
    assert signal.getsignal(signal.SIGINT) is before


def test_ctrl_c_ends_the_simulation(ctrl_c):
    m = model("van_der_pol")
    with pytest.raises(KeyboardInterrupt) as info:
        m.simulate(**LONG)
    assert time.monotonic() - ctrl_c[0] < 0.2
    assert isinstance(info.value, pydfo.Interrupted) and "interrupted at t = " in str(info.value)
    assert m.simulate(0, 1).termination == "finished"


def test_ctrl_c_within_objective_ends_the_run(ctrl_c):
    m = model("van_der_pol")

    def cost(x):
        try:
            m.simulate(**LONG)
        except pydfo.SimulationError:
            pytest.fail("an interrupt must not look like a failed simulation")

    with pytest.raises(pydfo.Interrupted):
        pydfo.fmin(cost, [1.0], disp=False)
    assert time.monotonic() - ctrl_c[0] < 0.2


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signal")
def test_exception_of_signal_handler_propagates():
    class Enough(Exception):
        pass

    def handler(number, frame):
        raise Enough

    before = signal.signal(signal.SIGALRM, handler)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.2)
        with pytest.raises(Enough):
            model("van_der_pol").simulate(**LONG)
    finally:
        signal.signal(signal.SIGALRM, before)


# --- results ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def result():
    inputs = {"time": [0, 1, 2, 3], "u": [0, 3, 3, 0], "gear": [1, 1, 2, 2]}
    return model("switched_input").simulate(0, 3, ncp=6, input=inputs, output=["x", "limit", "gear", "u"])


def test_result_columns_are_accessible_by_name(result):
    assert "x" in result and "y" not in result and len(result) == 5
    assert list(result.keys()) == ["time", "x", "limit", "gear", "u"]
    assert result.final("gear") == 2.0 and isinstance(result.final("gear"), float)
    assert result.final(["time", "u"]) == [3.0, 0.0]
    assert list(result["gear"]) == [1, 1, 1, 1, 2, 2, 2]
    for access in (lambda: result["gaer"], lambda: result.final("gaer"), lambda: result.plot("gaer")):
        with pytest.raises(KeyError) as info:
            access()
        assert str(info.value).startswith('"gaer" was not recorded; did you mean gear? Recorded variables: time, x,')
    assert result.get("gaer") is None
    assert dict(result).keys() == result.keys()
    assert "7 rows" in repr(result)


def test_result_converts_to_dataframe(result):
    pandas = pytest.importorskip("pandas")
    frame = result.to_dataframe()
    assert list(frame.columns) == ["time", "x", "limit", "gear", "u"] and len(frame) == 7
    assert list(frame.dtypes) == [np.float64, np.float64, np.bool_, np.int32, np.float64]
    assert np.array_equal(frame["x"], result["x"])
    pandas.testing.assert_frame_equal(frame, pandas.DataFrame(result.to_structured()))


def test_result_converts_to_structured_array(result):
    array = result.to_structured()
    assert array.dtype.names == ("time", "x", "limit", "gear", "u") and array.shape == (7,)
    assert [array.dtype[name] for name in array.dtype.names] == [float, float, bool, np.int32, float]
    assert np.array_equal(array["x"], result["x"])


def test_result_is_plotted(result):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure = result.plot()
    assert sum(len(axes.lines) for axes in figure.axes) == 4
    assert len(result.plot(["x", "u"]).axes[0].lines) == 2
    assert len(model("furuta").simulate(0, 1).plot().axes) == 2
    pyplot.close("all")


def test_result_without_events_has_empty_events():
    res = model("dahlquist").simulate(0, 1)
    assert len(res.events) == 0 and res.events.time.shape == (0,) and list(res.events["kind"]) == []
    assert res.stats.events == 0 and res.stats.samples == 501 and res.stats.right_hand_sides > 0


def test_events_without_time_advance_are_an_error_or_slide():
    """Without a speed at which it comes to rest, the ball bounces infinitely often before t = 2.5586 s."""
    model = FMUModel(example_fmu("bouncing_ball"))
    model.set("v_min", 0.0)
    for policy in ("error", "warn"):
        # Continuing to locate events does not help here, because time stops advancing.
        with pytest.raises(SimulationError, match="chattering at t = 2.5586339"):
            model.simulate(0, 3, chattering=policy)
    res = model.simulate(0, 3, chattering="slide")
    assert res.stats.chattering == 1 and res["time"][-1] == 3
    assert abs(res["h"][-1]) < 1e-6
    with pytest.raises(ValueError, match="unknown chattering policy 'stop'"):
        model.simulate(0, 3, chattering="stop")


def test_fit_supports_sliding():
    instants = np.linspace(0, 3, 31)
    settings = {
        "data": {"time": instants, "h": np.zeros(31)},
        "outputs": ["h"],
        "parameters": [Parameter("e", 0.7, 0.1, 0.9)],
        "start_values": {"v_min": 0.0},
    }
    with pytest.raises(SimulationError, match="chattering"):
        Calibration(example_fmu("bouncing_ball"), **settings).cost()
    assert Calibration(example_fmu("bouncing_ball"), chattering="slide", **settings).cost() > 0


def test_names_of_other_tools_are_accepted():
    model = FMUModel(example_fmu("quad_tank"))
    drive = {"time": [0.0, 10.0], "u1": [5.0, 6.0], "u2": 5.0}
    ours = model.simulate(0, final_time=10, inputs=drive, outputs=["qt.x1"], max_time=60)
    theirs = model.simulate(0, stop_time=10, input=drive, output=["qt.x1"], timeout=60)
    assert fmus.same_bits(ours, theirs)
    for twice in ({"inputs": drive, "input": drive}, {"outputs": "qt.x1", "output": "qt.x1"}, {"max_time": 1, "timeout": 1}):
        first, second = twice
        with pytest.raises(ValueError, match=f"{first} and {second} are the same argument; specify only one of them"):
            model.simulate(0, 10, **twice)
    with pytest.raises(ValueError, match="final_time and stop_time are the same argument"):
        model.simulate(0, 10, stop_time=10)


def test_rows_between_fixed_steps_are_interpolated_or_rejected(caplog, tmp_path):
    step = ('mightReturnEarlyFromDoStep="true"', 'fixedInternalStepSize="0.1"')
    path = fmus.compiled("early", tmp_path / "early.fmu", "INTERNAL_STEPS", replacements=[step])
    model = FMUModel(path)
    times = [0.0, 0.2, 0.25, 1.0]
    # x' = 1 in steps of 0.1; between the steps, the model keeps the value of the last one.
    for size in (None, 0.1):
        assert model.simulate(0, 1, times=times, step_size=size)["x"] == pytest.approx(times, abs=1e-14)
    messages = [record.getMessage() for record in caplog.records if "interpolated" in record.getMessage()]
    assert len(messages) == 1 and "t = 0.25" in messages[0] and "0.2 and 0.3" in messages[0]
    with pytest.raises(ValueError, match="t = 0.25 is between two communication points"):
        model.simulate(0, 1, times=times, between_steps="error")
    with pytest.raises(ValueError, match="between_steps = 'no' is invalid; expected one of: 'interpolate', 'error'"):
        model.simulate(0, 1, times=times, between_steps="no")


def test_default_time_span_of_the_model_is_reported(tmp_path):
    model = FMUModel(fmus.changed("dahlquist", tmp_path / "m.fmu", ('startTime="0"', 'startTime="20"')))
    with pytest.raises(ValueError, match="from 20 to 1: .*20 is the start time of the model, which start_time overrides"):
        model.simulate(final_time=1)


def test_missing_binary_is_reported_before_missing_final_time(tmp_path):
    variable = '<ScalarVariable name="x" valueReference="1"><Real/></ScalarVariable>'
    path = fmus.write(tmp_path / "m.fmu", fmus.xml(variable), {"binaries/plan9/m.so": b"MZ"})
    with pytest.raises(FmuError, match="no binary for this platform"):
        FMUModel(path).simulate()
    # A model that runs and suggests no stop time.
    path = fmus.changed("dahlquist", tmp_path / "d.fmu", ("stopTime", "suggested"))
    with pytest.raises(ValueError, match="Specify final_time"):
        FMUModel(path).simulate()
