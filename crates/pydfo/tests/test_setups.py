"""Setups that mislead: columns of times, recordings that begin late, inputs that end early, parameters without effect."""

from __future__ import annotations

import logging
import warnings

import numpy as np
import pytest

import pydfo
from pydfo import Calibration, CalibrationWarning, FMUModel, Parameter, example_fmu

TIME = np.linspace(0.0, 2.0, 21)
DECAY = np.exp(-2.0 * TIME)
K = Parameter("k", 1.0, 0.1, 10.0)


def decay(data, **more):
    return Calibration(example_fmu("dahlquist"), data, ["x"], more.pop("parameters", [K]), **more)


# --- Columns of times -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "scale"),
    [
        ("time", 1.0),
        ("Time", 1.0),
        ("TIME [s]", 1.0),
        ("time [ms]", 1e3),
        ("time (us)", 1e6),
        ("Time(min)", 1 / 60),
        ("time [h]", 1 / 3600),
        ("time [d]", 1 / 86400),
    ],
)
@pytest.mark.parametrize("shape", ["dict", "csv", "frame", "index", "structured"])
def test_times_are_read_with_their_unit(name, scale, shape, tmp_path):
    times = TIME * scale
    if shape == "dict":
        data = {"x": DECAY, name: times}
    elif shape == "csv":
        data = tmp_path / "data.csv"
        rows = "".join(f"{x!r};{t!r}\n" for x, t in zip(DECAY.tolist(), times.tolist()))
        data.write_text(f"x;{name}\n" + rows.replace(".", ","))
    elif shape == "structured":
        data = np.zeros(21, dtype=[("x", float), (name, float)])
        data["x"], data[name] = DECAY, times
    else:
        pd = pytest.importorskip("pandas")
        data = pd.DataFrame({"x": DECAY, name: times})
        data = data.set_index(name) if shape == "index" else data
    calibration = decay(data)
    assert calibration.measurements()["x"][0] == pytest.approx(TIME, rel=1e-15, abs=1e-15)
    assert calibration.cost([2.0]) < 1e-9


def test_an_index_without_a_name_is_no_time(tmp_path):
    """What pandas writes by default: an unnamed index comes first."""
    path = tmp_path / "data.csv"
    path.write_text(",t,x\n" + "".join(f"{k},{t},{x}\n" for k, (t, x) in enumerate(zip(TIME, DECAY))))
    with pytest.raises(pydfo.BadCalibrationError, match=r"no column 'time'; there are: '', 't', 'x'\."):
        decay(path)
    assert decay(path, time="t").cost([2.0]) < 1e-9
    with pytest.raises(pydfo.BadCalibrationError, match="no column 'T'; there are: '', 't', 'x'"):
        decay(path, time="T")
    assert decay({"t [ms]": 1e3 * TIME, "time": TIME + 7, "x": DECAY}, time="t").cost([2.0]) < 1e-9


def test_of_many_columns_some_are_listed():
    with pytest.raises(ValueError, match=r"'c19' and 130 more\.") as info:
        decay({f"c{k}": DECAY for k in range(150)})
    assert len(str(info.value)) < 400


def test_inputs_of_a_simulation_follow_the_same_rule():
    model = FMUModel(example_fmu("quad_tank"))
    volts = {"u1": [5.0, 6.0], "u2": [5.0, 5.0]}
    expected = model.simulate(final_time=10, input={"time": [0.0, 10.0], **volts})["qt.x1"]
    for name, times in [("Time [s]", [0.0, 10.0]), ("time (ms)", [0.0, 1e4])]:
        assert np.array_equal(model.simulate(final_time=10, input={name: times, **volts})["qt.x1"], expected)
    with pytest.raises(ValueError, match="the dict of inputs: there is no column 'time'; there are: 'u1', 'u2'"):
        model.simulate(final_time=10, input=volts)


# --- What may not be meant --------------------------------------------------------------------------------------------


def test_a_recording_that_begins_late_needs_a_start_time():
    late = {"time": TIME + 100.0, "x": DECAY}
    with pytest.raises(pydfo.BadCalibrationError, match=r"begins at 100 s, the simulation at 0 s\. Give start_time = 100 "):
        decay(late)
    assert decay(late, start_time=100).cost([2.0]) < 1e-9
    assert decay(late, start_time=0).cost([2.0]) > 1.0
    # ten sampling intervals may be missing
    for missing, is_late in [(10, False), (11, True)]:
        data = {"time": TIME + 0.1 * missing, "x": DECAY}
        if is_late:
            with pytest.raises(ValueError, match="start_time"):
                decay(data)
        else:
            decay(data)


@pytest.fixture
def tank():
    time = np.arange(0.0, 31.0)
    data = {"time": time, "u1": 5 + time % 2, "u2": np.full(31, 5.0)}
    res = FMUModel(example_fmu("quad_tank")).simulate(final_time=30, times=time, input=data)
    return data | {"qt.x1": res["qt.x1"]}


def tank_calibration(data, inputs, **more):
    parameters = [Parameter("qt.a1", 3e-6, 2e-6, 4e-6)]
    return Calibration(example_fmu("quad_tank"), data, ["qt.x1"], parameters, inputs=inputs, **more)


@pytest.mark.parametrize("on_disk", [False, True])
def test_an_unused_column_with_the_name_of_an_input_is_a_warning(tank, on_disk, tmp_path, caplog):
    data = tank
    if on_disk:
        data = tmp_path / "tank.csv"
        names = list(tank)
        rows = zip(*(tank[name].tolist() for name in names))
        data.write_text(",".join(names) + "\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows))
    with caplog.at_level(logging.INFO, "pydfo"), pytest.warns(CalibrationWarning) as warned:
        tank_calibration(data, ["u1"])
    assert len(warned) == 1 and warned[0].filename == __file__
    assert "column 'u2' is not used, but the model has an input 'u2'" in str(warned[0].message)
    assert not [record for record in caplog.records if "u2" in record.getMessage()]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tank_calibration(data, ["u1", "u2"])
        tank_calibration(data, ["u1"], start_values={"u2": 5.0})


def test_inputs_that_do_not_cover_the_run_are_a_warning(tank):
    for rows in (slice(0, 20), slice(5, 31)):
        ended = dict(tank, u1=np.full(31, np.nan))
        ended["u1"][rows] = tank["u1"][rows]
        with pytest.warns(CalibrationWarning, match="input 'u1' is recorded from .* the simulation runs from 0 s to 30 s") as w:
            tank_calibration(ended, ["u1", "u2"])
        assert len(w) == 1
    # a gap of one sampling interval is none
    first = dict(tank, u1=np.where(np.arange(31) == 0, np.nan, tank["u1"]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tank_calibration(first, ["u1", "u2"])


def test_values_of_a_model_that_do_not_count_are_a_warning():
    model = FMUModel(example_fmu("dahlquist"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Calibration(model, {"time": TIME, "x": DECAY}, ["x"], [K])
    model.set("x", 2.0)
    model.set("k", 3.0)  # is fitted: nobody expects that to count
    with pytest.warns(CalibrationWarning, match="values set in an FMUModel do not count in a calibration: 'x'; give them"):
        Calibration(model, {"time": TIME, "x": DECAY}, ["x"], [K])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Calibration(model, {"time": TIME, "x": DECAY}, ["x"], [K], start_values={"x": 2.0})


# --- What a fit leaves open -------------------------------------------------------------------------------------------


def falling(parameters):
    """A ball that falls and has not bounced yet."""
    time = np.arange(0.0, 0.41, 0.02)
    height = 1.0 - 0.5 * 9.0 * time**2
    return Calibration(example_fmu("bouncing_ball"), {"time": time, "h": height}, ["h"], parameters)


E = Parameter("e", 0.6, 0.1, 0.9)


def gravity():
    """Whichever sign the model gives to g."""
    start = FMUModel(example_fmu("bouncing_ball")).get("g")
    return Parameter("g", start, *sorted((0.5 * start, 1.5 * start)))


@pytest.mark.parametrize("method", ["nelder-mead", "de", "ga"])
def test_a_parameter_that_moves_nothing_is_named(method):
    fit = falling([gravity(), E]).fit(method=method, rng=1, max_iterations=60, workers=1)
    assert fit.without_effect == ["e"] and fit.at_bound == {}
    assert "e did not change the cost" in fit.message
    # The first simplex shows that g has an effect; what it shows of e, and for other methods both, is tested.
    assert fit.n_checks == (1 if method == "nelder-mead" else 2) and len(fit.trace) == fit.nfev
    assert abs(fit.parameters["g"]) == pytest.approx(9.0, rel=1e-2)


def test_a_budget_leaves_nothing_for_checks():
    fit = falling([gravity(), E]).fit(max_evaluations=12)
    # The first simplex has shown it already.
    assert (fit.nfev, fit.n_checks, fit.without_effect) == (12, 0, ["e"])
    fit = falling([gravity(), E]).fit(method="de", rng=1, max_evaluations=40)
    assert (fit.nfev, fit.n_checks, fit.without_effect) == (40, 0, [])


@pytest.mark.parametrize("scale", ["linear", "log"])
@pytest.mark.parametrize(("lower", "upper", "side"), [(0.1, 1.5, "upper"), (2.5, 10.0, "lower"), (0.1, 10.0, None)])
def test_a_parameter_at_its_bound_is_named(scale, lower, upper, side):
    parameter = Parameter("k", 0.5 * (lower + upper), lower, upper, scale=scale)
    fit = decay({"time": TIME, "x": DECAY}, parameters=[parameter]).fit()
    assert fit.at_bound == ({} if side is None else {"k": side}) and fit.without_effect == []
    bound = lower if side == "lower" else upper
    assert (f"k is at its {side} bound {bound:g}" in fit.message) == (side is not None)
    # A wide box, and a best value that is no farther from its end than the tolerance of the fit, is another matter.
    wide = decay({"time": TIME, "x": DECAY}, parameters=[Parameter("k", 1.0, 0.0, 1e5)]).fit()
    assert wide.at_bound == {} and wide.x[0] < 10.0
    held = Parameter("k", 1.0, fixed=True)
    assert decay({"time": TIME, "x": DECAY}, parameters=[held]).fit().at_bound == {}


def test_the_rest_of_a_fit_is_as_it_was_without_checks():
    """Checks are none of the run's evaluations."""
    calibration = falling([gravity(), E])
    fit = calibration.fit()
    assert fit.n_checks == 1 and len(fit.trace) == fit.nfev
    assert fit.cost == calibration.cost(fit.x)


# --- Names of other tools ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["ME", "me", "ModelExchange", "model_exchange", "Model Exchange", "model-exchange"])
def test_kinds_go_by_their_full_names(kind):
    assert FMUModel(example_fmu("dahlquist"), kind=kind).kind == "ME"


def test_co_simulation_goes_by_its_full_name():
    assert FMUModel(example_fmu("dahlquist", kind="CS"), kind="CoSimulation").kind == "CS"
    with pytest.raises(ValueError, match="none of 'auto', 'ME' .ModelExchange., 'CS' .CoSimulation."):
        FMUModel(example_fmu("dahlquist"), kind="exchange")


def test_solvers_go_by_the_names_of_other_tools(caplog):
    model = FMUModel(example_fmu("dahlquist"))
    with caplog.at_level(logging.INFO, "pydfo"):
        ours = model.simulate(final_time=1, solver="tsit5")["x"]
        assert np.array_equal(model.simulate(final_time=1, solver="RK45")["x"], ours)
    assert any("RK45" in record.getMessage() for record in caplog.records)


def test_files_are_named_as_they_were_given(tmp_path):
    for path, error in [(tmp_path / "nope.csv", FileNotFoundError), (tmp_path, IsADirectoryError)]:
        with pytest.raises(error) as info:
            decay(path)
        assert "PosixPath" not in str(info.value) and str(path) in str(info.value)
    with pytest.raises(ValueError, match="zip archive"):
        decay(example_fmu("dahlquist"))
