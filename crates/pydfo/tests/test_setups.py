"""Misleading setups: time columns, recordings that start late, inputs that end early, parameters without effect."""

from __future__ import annotations

import datetime
import logging
import pickle
import warnings
import zipfile

import numpy as np
import pytest
from fmus import changed

import pydfo
from pydfo import Calibration, CalibrationWarning, FMUModel, Parameter, example_fmu

TIME = np.linspace(0.0, 2.0, 21)
DECAY = np.exp(-2.0 * TIME)
K = Parameter("k", 1.0, 0.1, 10.0)


def decay(data, **more):
    return Calibration(example_fmu("dahlquist"), data, ["x"], more.pop("parameters", [K]), **more)


# --- Time columns
# -----------------------------------------------------------------------------------------------------


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
def test_times_are_converted_from_their_unit(name, scale, shape, tmp_path):
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


@pytest.mark.parametrize("shape", ["numpy", "objects", "frame", "index"])
def test_durations_are_converted_to_seconds(shape):
    durations = np.round(TIME * 1e6).astype("timedelta64[us]")
    if shape == "numpy":
        data = {"time": durations, "x": DECAY}
    elif shape == "objects":
        data = {"time": [datetime.timedelta(seconds=t) for t in TIME.tolist()], "x": DECAY}
    else:
        pd = pytest.importorskip("pandas")
        data = pd.DataFrame({"time": pd.to_timedelta(TIME, unit="s"), "x": DECAY})
        data = data.set_index("time") if shape == "index" else data
    calibration = decay(data)
    assert calibration.measurements()["x"][0] == pytest.approx(TIME, abs=1e-15)
    assert calibration.cost([2.0]) < 1e-9


def test_inputs_may_be_given_over_durations():
    model = FMUModel(example_fmu("quad_tank"))
    drive = {"u1": [4.0, 4.5], "u2": [4.0, 4.0]}
    plain = model.simulate(final_time=2.0, input={"time": [0.0, 2.0], **drive})
    timed = model.simulate(final_time=2.0, input={"time": np.array([0, 2000], dtype="timedelta64[ms]"), **drive})
    assert (plain["qt.x1"] == timed["qt.x1"]).all()


def test_time_units_are_case_sensitive(tmp_path):
    for name in ("time [MS]", "time (S)", "time [H]"):
        with pytest.raises(ValueError, match="expected s, ms, us, ns, min, h or d. Units are case-sensitive"):
            decay({name: TIME, "x": DECAY})


def test_mixed_decimal_signs_are_rejected(tmp_path):
    path = tmp_path / "data.csv"
    path.write_text("time;x\n0;1,234\n1;2.345\n")
    with pytest.raises(ValueError, match="'1,234' in column 'x', line 2, has a comma, but '2.345' in column 'x', line 3, has a point"):
        decay(path)
    path.write_text("time;x;\n0;1,5;\n1;0,5;\n")
    assert decay(path).measurements()["x"][1].tolist() == [1.5, 0.5]
    path.write_text("time;x\n0;1,5;\n1;0,5;\n")
    assert decay(path).measurements()["x"][1].tolist() == [1.5, 0.5]


def test_column_that_differs_from_input_in_case_is_reported():
    data = {"time": [0.0, 1.0], "x1": [1.0, 1.0], "U1": [4.0, 4.0]}
    with pytest.warns(CalibrationWarning, match="column 'U1' is not used, but nothing drives the input 'u1'"):
        Calibration(example_fmu("quad_tank"), data, {"qt.x1": "x1"}, [Parameter("qt.a1", 3e-6, 2e-6, 4e-6)])


def test_unnamed_index_is_not_the_time(tmp_path):
    """The default CSV of pandas, in which an unnamed index comes first."""
    path = tmp_path / "data.csv"
    path.write_text(",t,x\n" + "".join(f"{k},{t},{x}\n" for k, (t, x) in enumerate(zip(TIME, DECAY))))
    with pytest.raises(pydfo.BadCalibrationError, match="the first column has no name, as the index of a pandas table, and the others are 't', 'x'"):
        decay(path)
    assert decay(path, time="t").cost([2.0]) < 1e-9
    with pytest.raises(pydfo.BadCalibrationError, match="column 'T' not found; available: '', 't', 'x'"):
        decay(path, time="T")
    assert decay({"t [ms]": 1e3 * TIME, "time": TIME + 7, "x": DECAY}, time="t").cost([2.0]) < 1e-9


def test_message_lists_some_of_many_columns():
    with pytest.raises(ValueError, match=r"'c19' and 130 more\.") as info:
        decay({f"c{k}": DECAY for k in range(150)})
    assert len(str(info.value)) < 400


def test_simulation_inputs_follow_rules_of_recordings():
    model = FMUModel(example_fmu("quad_tank"))
    volts = {"u1": [5.0, 6.0], "u2": [5.0, 5.0]}
    expected = model.simulate(final_time=10, input={"time": [0.0, 10.0], **volts})["qt.x1"]
    for name, times in [("Time [s]", [0.0, 10.0]), ("time (ms)", [0.0, 1e4])]:
        assert np.array_equal(model.simulate(final_time=10, input={name: times, **volts})["qt.x1"], expected)
    with pytest.raises(ValueError, match="the dict of inputs has no times, only u1, u2. Add them"):
        model.simulate(final_time=10, input=volts)


# --- Probable mistakes
# ------------------------------------------------------------------------------------------------


def test_late_recording_requires_start_time():
    late = {"time": TIME + 100.0, "x": DECAY}
    with pytest.raises(pydfo.BadCalibrationError, match=r"begins at 100 s, but the simulation begins at 0 s\. Set start_time = 100 "):
        decay(late)
    assert decay(late, start_time=100).cost([2.0]) < 1e-9
    assert decay(late, start_time=0).cost([2.0]) > 1.0
    # a gap of ten sampling intervals is allowed
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
def test_unused_column_with_name_of_input_is_a_warning(tank, on_disk, tmp_path, caplog):
    data = tank
    if on_disk:
        data = tmp_path / "tank.csv"
        names = list(tank)
        rows = zip(*(tank[name].tolist() for name in names))
        data.write_text(",".join(names) + "\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows))
    with caplog.at_level(logging.INFO, "pydfo"), pytest.warns(CalibrationWarning) as warned:
        tank_calibration(data, ["u1"])
    assert len(warned) == 1 and warned[0].filename == __file__
    assert "column 'u2' is not used, but nothing drives the input 'u2'" in str(warned[0].message)
    assert not [record for record in caplog.records if "u2" in record.getMessage()]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tank_calibration(data, ["u1", "u2"])
        tank_calibration(data, ["u1"], start_values={"u2": 5.0})


def test_inputs_are_held_beyond_recording_only_on_request(tank):
    for rows in (slice(0, 20), slice(5, 31)):
        ended = dict(tank, u1=np.full(31, np.nan))
        ended["u1"][rows] = tank["u1"][rows]
        with pytest.raises(ValueError, match="input 'u1' is recorded from .* needs it from 0 s to 30 s. Set hold_inputs"):
            tank_calibration(ended, ["u1", "u2"])
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert tank_calibration(ended, ["u1", "u2"], hold_inputs=True).cost() > 0.0
    # a gap of one sampling interval is allowed
    first = dict(tank, u1=np.where(np.arange(31) == 0, np.nan, tank["u1"]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tank_calibration(first, ["u1", "u2"])


def test_ignored_values_of_a_model_are_a_warning():
    model = FMUModel(example_fmu("dahlquist"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Calibration(model, {"time": TIME, "x": DECAY}, ["x"], [K])
    model.set("x", 2.0)
    model.set("k", 3.0)  # is fitted, so no warning is necessary
    with pytest.warns(CalibrationWarning, match="values set in an FMUModel are ignored in a calibration: 'x'. To use them, pass them"):
        Calibration(model, {"time": TIME, "x": DECAY}, ["x"], [K])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Calibration(model, {"time": TIME, "x": DECAY}, ["x"], [K], start_values={"x": 2.0})


# --- Undetermined parameters
# ------------------------------------------------------------------------------------------


def falling(parameters):
    """Returns a calibration of a falling ball that has not bounced yet."""
    time = np.arange(0.0, 0.41, 0.02)
    height = 1.0 - 0.5 * 9.0 * time**2
    return Calibration(example_fmu("bouncing_ball"), {"time": time, "h": height}, ["h"], parameters)


E = Parameter("e", 0.6, 0.1, 0.9)


def gravity():
    """Returns the parameter g, with start and bounds of the sign used by the model."""
    start = FMUModel(example_fmu("bouncing_ball")).get("g")
    return Parameter("g", start, *sorted((0.5 * start, 1.5 * start)))


@pytest.mark.parametrize("method", ["nelder-mead", "de", "ga"])
def test_parameter_without_effect_is_named(method):
    fit = falling([gravity(), E]).fit(method=method, rng=1, max_iterations=60, workers=1)
    assert fit.without_effect == ["e"] and fit.at_bound == {}
    assert any("determine e" in f.sentence or "e did not change the cost" in f.sentence for f in fit.findings), fit
    # The effect of e in the first simplex is tested; after other methods, the standard errors show it.
    assert fit.n_checks == (1 if method == "nelder-mead" else 0) and len(fit.trace) == fit.nfev
    assert abs(fit.parameters["g"]) == pytest.approx(9.0, rel=1e-2)


def test_budget_applies_to_the_search():
    fit = falling([gravity(), E]).fit("nelder-mead", max_evaluations=12)
    # The first simplex has already shown the effect.
    assert (fit.nfev, fit.n_checks, fit.without_effect) == (12, 0, ["e"])
    for method in ("de", "ga", "de-classic"):
        fit = falling([gravity(), E]).fit(method=method, rng=1, max_evaluations=40)
        assert (fit.nfev, fit.without_effect, fit.n_checks) == (40, ["e"], 0) and len(fit.trace) == 40
        near = decay({"time": TIME, "x": DECAY}, parameters=[Parameter("k", 1.0, 0.1, 1.5)])
        assert near.fit(method=method, rng=1, max_evaluations=400).at_bound == {"k": "upper"}
    fit = falling([gravity(), E]).fit(method="de", rng=1, max_evaluations=400, callback=lambda progress: progress.nit >= 3)
    assert fit.termination == "stopped-by-observer" and fit.without_effect == ["e"]


@pytest.mark.parametrize("scale", ["linear", "log"])
@pytest.mark.parametrize(("lower", "upper", "side"), [(0.1, 1.5, "upper"), (2.5, 10.0, "lower"), (0.1, 10.0, None)])
def test_parameter_at_its_bound_is_reported(scale, lower, upper, side):
    parameter = Parameter("k", 0.5 * (lower + upper), lower, upper, scale=scale)
    fit = decay({"time": TIME, "x": DECAY}, parameters=[parameter]).fit()
    assert fit.at_bound == ({} if side is None else {"k": side}) and fit.without_effect == []
    bound = lower if side == "lower" else upper
    assert any(f"k is at its {side} bound {bound:g}" in f.sentence for f in fit.findings) == (side is not None)
    # A wide box with a best value within the tolerance of its end is not reported.
    wide = decay({"time": TIME, "x": DECAY}, parameters=[Parameter("k", 1.0, 0.0, 1e5)]).fit()
    assert wide.at_bound == {} and wide.x[0] < 10.0
    held = Parameter("k", 1.0, fixed=True)
    assert decay({"time": TIME, "x": DECAY}, parameters=[held]).fit().at_bound == {}


def test_checks_do_not_change_the_fit():
    """Checks are not evaluations of the run."""
    calibration = falling([gravity(), E])
    fit = calibration.fit()
    assert fit.n_checks == 1 and len(fit.trace) == fit.nfev
    assert fit.cost == calibration.cost(fit.x)


# --- Names of other tools ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["ME", "me", "ModelExchange", "model_exchange", "Model Exchange", "model-exchange"])
def test_full_names_of_kinds_are_accepted(kind):
    assert FMUModel(example_fmu("dahlquist"), kind=kind).kind == "ME"


def test_full_name_of_co_simulation_is_accepted():
    assert FMUModel(example_fmu("dahlquist", kind="CS"), kind="CoSimulation").kind == "CS"
    with pytest.raises(ValueError, match="expected one of: 'auto', 'ME' .ModelExchange., 'CS' .CoSimulation."):
        FMUModel(example_fmu("dahlquist"), kind="exchange")


def test_solver_names_of_other_tools_are_mapped(caplog):
    model = FMUModel(example_fmu("dahlquist"))
    with caplog.at_level(logging.INFO, "pydfo"):
        ours = model.simulate(final_time=1, solver="tsit5")["x"]
        assert np.array_equal(model.simulate(final_time=1, solver="RK45")["x"], ours)
    assert any("RK45" in record.getMessage() for record in caplog.records)


def test_messages_show_file_names_as_given(tmp_path):
    for path, error in [(tmp_path / "nope.csv", FileNotFoundError), (tmp_path, IsADirectoryError)]:
        with pytest.raises(error) as info:
            decay(path)
        assert "PosixPath" not in str(info.value) and repr(str(path)) in str(info.value)
    with pytest.raises(ValueError, match="zip archive"):
        decay(example_fmu("dahlquist"))


# --- Names of other tools, and settings without effect
# ----------------------------------------------------------------


def bowl(x):
    return float(np.sum((np.asarray(x) - 1.0) ** 2))


@pytest.mark.parametrize(
    ("call", "expected"),
    [
        (lambda: pydfo.minimize(bowl, [0.0], maxiter=3), r"^minimize\(\) has no argument 'maxiter'; use the argument max_iterations"),
        (lambda: pydfo.minimize(bowl, [0.0], xatol=3), r"'xatol'; use the option x_tol: options={'x_tol': \.\.\.}"),
        (lambda: pydfo.minimize(bowl, [0.0], x_tol=3), r"'x_tol'; use the option x_tol: options={'x_tol': \.\.\.}"),
        (lambda: pydfo.minimize(bowl, [0.0], tol=3), r"use the options x_tol and f_tol"),
        (lambda: pydfo.minimize(bowl, [0.0], lb=0, ub=1), "use the argument bounds"),
        (lambda: pydfo.minimize(bowl, [0.0], seed=1), "use the argument rng"),
        (lambda: pydfo.minimize(bowl, [0.0], max_evals=1), "did you mean max_evaluations"),
        (lambda: pydfo.fmin(bowl, [0.0], maxfev=3), r"^fmin\(\) has no argument 'maxfev'; use the argument max_fevals"),
        (lambda: pydfo.fmin(bowl, [0.0], max_iterations=3), "use the argument max_iters"),
        (lambda: pydfo.fmin(bowl, x0=[0.0]), "use the argument xstart"),
        (lambda: pydfo.fmin(bowl, [0.0], bounds=[(0, 1)]), "use the arguments lb and ub"),
        (lambda: decay({"time": TIME, "x": DECAY}).fit(fatol=1e-3), r"^Calibration\.fit\(\) has no .*; use the argument f_tol"),
        (lambda: decay({"time": TIME, "x": DECAY}, rtol=1e-3), r"^Calibration\(\) has no .*; use the argument relative_tolerance"),
        (lambda: decay({"time": TIME, "x": DECAY}, weight=[1]), "did you mean weights"),
        (lambda: Parameter("k", 1.0, max=2.0), "use the argument upper"),
        (lambda: FMUModel(example_fmu("dahlquist")).simulate(tend=1), "use the argument final_time"),
        (lambda: FMUModel(example_fmu("dahlquist")).simulate(output_="x"), "did you mean outputs"),
        (lambda: pydfo.ode.solve(bowl, (0, 1), [1.0], y0=[1.0]), "use the argument x0"),
        (lambda: pydfo.Optimizer("de", bounds=[(0, 1)], popsize=3), "use the option population"),
        (lambda: Parameter("k", 1.0, fixed="no"), "fixed must be True or False, not 'no'"),
        (lambda: FMUModel(example_fmu("dahlquist")).simulate(record_events="no"), "record_events must be True or False"),
        (lambda: decay({"time": TIME, "x": DECAY}).fit(options="x_tol"), "options must be a dict, not 'x_tol'"),
        (lambda: decay({"time": TIME, "x": DECAY}, weights=2.0), "weights must be a dict of outputs and numbers, or a number per"),
        (lambda: decay({"time": TIME, "x": DECAY}, inputs={"u"}), "inputs must be a dict of variables and columns, or a list"),
        (lambda: decay({"time": TIME, "x": DECAY}).cost("2"), "x must be numbers, not '2'"),
        (lambda: decay({"time": TIME, "x": DECAY}).fit(start=["1"]), r"start must be numbers, not \['1'\]"),
        (lambda: pydfo.fmin(bowl, [0.0], plot="no"), "plot must be True or False, not 'no'"),
    ],
)
def test_foreign_keywords_are_explained(call, expected):
    with pytest.raises(TypeError, match=expected):
        call()


@pytest.mark.parametrize(
    ("call", "expected"),
    [
        (lambda c: c().fit(options={"maxiter": 3}), "unknown option 'maxiter'; use the argument max_iterations"),
        (lambda c: pydfo.fmin(bowl, [0.0], options={"maxiter": 3}), "unknown option 'maxiter'; use the argument max_iters"),
        (lambda c: c().fit(x_tol=1e-2, options={"x_tol": 1e-3}), "x_tol is specified twice"),
        (lambda c: c().fit(resume="require"), "resume='require' requires a checkpoint"),
        (lambda c: c().fit(options={"checkpoint_interval": 1.0}), "checkpoint_interval = 1.0 requires a checkpoint"),
        (lambda c: c().fit(max_time=0), "max_time = 0 must be a positive number"),
        (lambda c: c(timeout=0), "timeout = 0 must be a positive number"),
        (lambda c: Parameter("k", 1.0, nominal=-3), "parameter 'k': nominal -3 must be positive"),
        (lambda c: c(weights="x"), "weights = 'x' is unknown; expected 'range', 'mean', 'sd', or numbers"),
        (lambda c: c(outputs=["k"]), "output 'k' is compared with column 'k', but it is a parameter that is fitted, not a result"),
        (lambda c: c(outputs=["time"]), "output 'time' is compared with column 'time', but it is the time"),
        (lambda c: c(data={"time": TIME, "Time [ms]": TIME, "x": DECAY}), "several columns may contain the times: 'time', 'Time"),
    ],
)
def test_contradictory_arguments_are_rejected(call, expected):
    def made(data=None, outputs=("x",), **more):
        data = {"time": TIME, "x": DECAY, "k": DECAY} if data is None else data
        return Calibration(example_fmu("dahlquist"), data, list(outputs), [K], **more)

    with pytest.raises(ValueError, match=expected):
        call(made)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("time x\n0 1\n1 2\n", "only one column; separate columns with commas, semicolons or tabs"),
        ("time,x\n0,0,1,5\n0,5,1,2\n", "line 2 has 4 cells, but the header has 2. Separate columns with semicolons"),
        ("time,x\nkg,m\n0,1\n1,2\n", "time 'kg' in line 2 is not a number, but the times in other lines are"),
        ("time,x\n0,1\n1,?\n", r"'\?' in column 'x', line 3, is not a number. Write missing values as empty cells, NaN"),
    ],
)
def test_files_of_other_tools_are_read_or_rejected(text, expected, tmp_path):
    path = tmp_path / "data.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=expected):
        decay(path)


def test_input_is_not_an_output_and_has_one_value():
    data = {"time": TIME, "u1": TIME, "u2": TIME, "x": TIME}
    a1 = Parameter("qt.a1", 3e-6, 2e-6, 4e-6)
    with pytest.raises(ValueError, match="output 'u1' is compared with column 'u1', but it is an input"):
        Calibration(example_fmu("quad_tank"), data, ["u1"], [a1], inputs=["u1", "u2"])
    with pytest.raises(ValueError, match="input 'u1' is driven by column 'u1', but start_values sets it to 3"):
        Calibration(example_fmu("quad_tank"), data, {"qt.x1": "x"}, [a1], inputs=["u1", "u2"], start_values={"u1": 3.0})


def test_settings_without_effect_cause_a_warning():
    data, line = {"time": TIME, "x": DECAY}, lambda t, y: [1.0]
    step, largest = "step_size = 0.1 has no effect with the solver 'tsit5'", "max_step = 0.1 has no effect with the solver 'rk4'"
    with pytest.warns(CalibrationWarning, match=step):
        decay(data, solver="tsit5", step_size=0.1)
    with pytest.warns(CalibrationWarning, match=largest):
        decay(data, solver="rk4", max_step=0.1)
    with pytest.warns(CalibrationWarning, match="nominal of parameter 'k' has no effect on a log scale"):
        decay(data, parameters=[Parameter("k", 1.0, 0.1, 10.0, scale="log", nominal=3.0)])
    with pytest.warns(UserWarning, match=step) as caught:
        FMUModel(example_fmu("dahlquist")).simulate(0, 1, solver="tsit5", step_size=0.1)
    assert caught[0].filename == __file__
    for more, expected in (
        ({"method": "rk4", "max_step": 0.1}, "max_step has no effect, because method 'rk4'"),
        ({"method": "euler", "first_step": 0.1}, "first_step has no effect, because method 'euler'"),
        ({"method": "tsit5", "step": 0.1}, "step has no effect, because method 'tsit5' selects its own steps"),
        ({"method": "dop853", "jac": [[0.0]]}, "jac has no effect, because method 'dop853' is explicit"),
        ({"method": "tsit5", "jac_sparsity": [[1]]}, "jac_sparsity has no effect"),
        ({"on_event": lambda t, y, which: None}, "on_event has no effect without events"),
    ):
        with pytest.warns(UserWarning, match=expected) as caught:
            pydfo.ode.solve(line, (0, 1), [1.0], **more)
        assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        decay(data, solver="rk4", step_size=0.1)
        pydfo.ode.solve(line, (0, 1), [1.0], "bdf", jac=[[0.0]], max_step=0.5, first_step=0.1)


def test_checkpoint_in_missing_folder_is_rejected(tmp_path):
    path = tmp_path / "nowhere" / "run.ck"
    with pytest.raises(FileNotFoundError, match=r"run\.ck: folder '.*nowhere' does not exist$"):
        pydfo.minimize(bowl, [0.0], checkpoint=path)


# --- Rejected arguments without effect
# --------------------------------------------------------------------------------


def test_repeated_output_is_rejected():
    with pytest.raises(ValueError, match="output 'x' is compared with column 'x' twice"):
        Calibration(example_fmu("dahlquist"), {"time": TIME, "x": DECAY}, ["x", "x"], [K])


def test_clock_times_start_at_the_first_row(tmp_path):
    path = tmp_path / "data.csv"
    path.write_text("time,x\n10:00:00,1\n10:00:01,0.1\n")
    assert decay(path).cost([1.0]) == decay({"time": [0.0, 1.0], "x": [1.0, 0.1]}).cost([1.0])
    path.write_text("time,x\n10:00:00 PM,1\n10:00:01 PM,0.1\n")
    with pytest.raises(ValueError, match="line 2: '10:00:00 PM' is neither a number nor a date .write hours from 0 to 23"):
        decay(path)


def test_attributes_without_effect_are_rejected():
    model = FMUModel(example_fmu("dahlquist"))
    with pytest.raises(AttributeError, match=r"not attributes; use set\('k', 5.0\)"):
        model.k = 5.0
    model.note = "ours"
    with pytest.raises(AttributeError, match=r"create another Calibration\(window=...\)"):
        decay({"time": TIME, "x": DECAY}).window = (0.0, 1.0)


def test_loaded_model_cannot_be_pickled():
    with pytest.raises(TypeError, match="open the FMU in each process"):
        pickle.dumps(FMUModel(example_fmu("dahlquist")))


def test_advice_can_be_followed():
    """Earlier advice in these cases was missing or was itself rejected."""
    model = example_fmu("quad_tank")
    with pytest.raises(ValueError, match=r"has no times, only u1. Add them, inputs=\{'time'"):
        FMUModel(model).simulate(final_time=1, inputs={"u1": [0, 1]})
    with pytest.warns(UserWarning, match="inputs u1 cover 0 s to 2 s, but the simulation runs from 0 s to 5 s"):
        FMUModel(model).simulate(final_time=5, inputs={"time": [0, 1, 2], "u1": [5, 5, 5]})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        FMUModel(model).simulate(final_time=2, inputs={"time": [0, 1, 2], "u1": [5, 5, 5]})
    with pytest.raises(TypeError, match="did you mean options|use the argument options"):
        pydfo.minimize(lambda x: x[0] ** 2, [1.0], opts={})
    with pytest.warns(pydfo.CalibrationWarning, match="CVode is not available; using solver='auto' instead"):
        calibration = Calibration(example_fmu("dahlquist"), {"time": TIME, "x": DECAY}, ["x"], Parameter("k", 1, 0.1, 10), solver="CVode")
    with pytest.raises(ValueError, match="a report is an HTML page"):
        calibration.fit().report("fit.pdf")
    with pytest.raises(ValueError, match="outputs must map variables of the model to columns"):
        Calibration(example_fmu("dahlquist"), {"time": TIME, "decay": DECAY}, {"decay": "x"}, Parameter("k", 1, 0.1, 10))


def test_non_executors_are_rejected_with_an_alternative():
    Parallel = type("Parallel", (), {"__module__": "joblib.parallel", "__call__": lambda self, tasks: list(tasks)})
    with pytest.raises(TypeError, match="loky.get_reusable_executor"):
        pydfo.minimize(lambda x: x[0] ** 2, [1.0], workers=Parallel())


def test_converted_columns_with_units_are_reported():
    ball = {"time": TIME[:5], "h (in)": (1 - 0.5 * 9.81 * TIME[:5] ** 2) / 0.0254}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        calibration = Calibration(example_fmu("bouncing_ball"), ball, {"h": "h (in)"}, Parameter("g", -9, -12, -8))
    expected = "columns were converted from the units that they state: 'h (in)' from in to m"
    fit = calibration.fit()
    assert expected in str(calibration.check()) and expected in str(fit) and fit.x[0] == pytest.approx(-9.81, rel=1e-3)
    assert [f.severity for f in fit.findings if expected in f.sentence] == ["note"]


# --- Arguments of a wrong type or name --------------------------------------------------------------------------------


def test_errors_name_the_argument():
    calibration = decay({"time": TIME, "x": DECAY})
    fit = calibration.fit()
    for call, expected in [
        (lambda: calibration.fit(checkpoint=3), "checkpoint must be a path, not 3"),
        (lambda: fit.profile(checkpoint=3), "checkpoint must be a path, not 3"),
        (lambda: fit.save(3), "path must be a path, not 3"),
        (lambda: fit.report(None), "path must be a path, not None"),
        (lambda: pydfo.load_fit(3), "path must be a path, not 3"),
        (lambda: pydfo.Stage(["k"], optoins={}), "did you mean options"),
        (lambda: fit.profile(points=3), "did you mean max_points"),
        (lambda: calibration.fit(start="x"), "start must be numbers, not 'x'"),
        (lambda: calibration.fit("ga", options={"resolution": []}), "'resolution' of ga must be one number per parameter"),
        (lambda: pydfo.Calibration(example_fmu("dahlquist"), {"time": TIME, "x": DECAY}, ["x"], 5), "must be a list of pydfo.Parameter"),
        (lambda: decay({"time": TIME, "x": DECAY}, window=(0, 10**400)), "window must be a number up to 1.8e+308, not 1000"),
        (lambda: fit.to_csv("fit.csv", what=5), "what must be a string, not 5"),
        (lambda: fit.to_dataframe(what=5), "what must be a string, not 5"),
        (lambda: pydfo.build_fmu(None, "out.fmu"), "folder must be a path, not None"),
        (lambda: pydfo.build_fmu("folder", 3), "out must be a path, not 3"),
        (lambda: calibration.fit(checkpoint=""), "checkpoint must be a path, not an empty string"),
        (lambda: pydfo.minimize(lambda x: x[0] ** 2, [1.0], checkpoint=""), "checkpoint must be a path, not an empty string"),
        (lambda: pydfo.minimize(lambda x: x[0] ** 2, [1.0], workers=lambda f, points: None), "workers must return an iterable of the results"),
        (lambda: pydfo.least_squares(lambda x: [x[0], 10**400], [1.0]), "residuals as a one-dimensional array of numbers, not"),
        (lambda: pydfo.minimize(lambda x: 10**400, [1.0]), "the objective must return one number"),
        (lambda: calibration.fit("de", options={"mutation": 0.5}), "'de-classic' has the option weight"),
    ]:
        with pytest.raises((TypeError, ValueError)) as info:
            call()
        assert expected in str(info.value)


def test_words_ignore_case_and_fit_reports_options():
    data = {"time": TIME, "x": DECAY}
    fit = decay(data, chattering="Error", isolation="None", weights="SD").fit("Nelder-Mead", f_tol=1e-3)
    assert fit.options["f_tol"] == "0.001" and fit.options["bounds_handling"] == "sine"
    assert fit.to_dict()["options"] == fit.options
    # The result also contains the requested values.
    found = fit.to_dict()
    assert found["fit_options"]["method"] == "nelder-mead" and found["fit_options"]["f_tol"] == 1e-3
    assert found["problem"]["settings"]["isolation"] == "none" and found["relative_tolerance"] is not None
    assert found["problem"]["experiments"][0]["data"]["n_rows"] == len(TIME)
    assert "e0" not in fit.message


def test_supported_batch_plan_keeps_the_method():
    plain, serial = (decay({"time": TIME, "x": DECAY}).fit(rng=1, workers=1, **more) for more in ({}, {"batch": "serial"}))
    assert serial.method == plain.method == "least-squares" and (serial.x == plain.x).all() and serial.nfev == plain.nfev


HOURS = 0.2 * np.arange(41)


def in_hours(data, **own):
    return Calibration(example_fmu("dahlquist"), data, ["x"], [Parameter("k", 1.0, 0.1, 10.0)], **own)


def test_models_in_hours_read_times_in_any_unit(tmp_path):
    x = np.exp(-0.5 * HOURS)
    plain = in_hours({"time": HOURS, "x": x}, time_unit="h")
    same = in_hours({"time [h]": HOURS, "x": x}, time_unit="h")
    assert same.residuals([0.7]).tobytes() == plain.residuals([0.7]).tobytes()
    minutes = in_hours({"time [min]": 60 * HOURS, "x": x}, time_unit="h", window=(0, 6))
    fit = minutes.fit()
    assert fit.parameters["k"] == pytest.approx(0.5, abs=1e-5) and minutes.n_measurements == 31
    np.testing.assert_allclose(fit.simulate()["time"], HOURS[:31], atol=1e-12)
    assert fit.validate(windows=[(6.1, 8)]).time_unit == "h"
    # Bit for bit after pickling, too.
    hours = pickle.loads(pickle.dumps(pydfo.Experiment({"time [h]": HOURS, "x": x}, ["x"])))
    again = Calibration(example_fmu("dahlquist"), [hours], [Parameter("k", 1.0, 0.1, 10.0)], time_unit="h")
    assert again.residuals([0.7]).tobytes() == plain.residuals([0.7]).tobytes()
    dates = np.datetime64("2024-05-31T10:00:00") + (3600 * HOURS).astype("timedelta64[s]")
    assert in_hours({"time": dates, "x": x}, time_unit="h").fit().parameters["k"] == pytest.approx(0.5, abs=1e-5)
    with pytest.raises(ValueError, match="time_unit: 'kg' is not a unit of time; expected s, ms"):
        in_hours({"time": HOURS, "x": x}, time_unit="kg")
    report = tmp_path / "fit.html"
    fit.report(report)
    assert "time in h" in report.read_text(encoding="utf-8")


def test_time_unit_of_the_model_is_used(tmp_path):
    """The unit of the independent variable of FMI 2.0 and 3.0."""
    hours = [('name="s"', 'name="h"'), ('<BaseUnit s="1"/>', '<BaseUnit s="1" factor="3600"/>'), ('unit="s"', 'unit="h"')]
    fmi2 = changed("dahlquist", tmp_path / "h2.fmu", *hours)
    fmi3 = changed("dahlquist", tmp_path / "h3.fmu", *hours, version="3.0")
    for path in (fmi2, fmi3):
        model = pydfo.FMUModel(path)
        assert model.description.time_unit == "h"
        result = model.simulate(final_time=2.0, inputs=None)
        assert result.units["time"] == "h" and result.time[-1] == 2.0
        calibration = Calibration(path, {"time [min]": 60 * HOURS, "x": np.exp(-0.5 * HOURS)}, ["x"], [Parameter("k", 1.0, 0.1, 10.0)])
        assert calibration.fit().parameters["k"] == pytest.approx(0.5, abs=1e-5)
        assert not any(finding.id == "F041" for finding in calibration.check())


def test_check_suggests_the_time_unit_of_the_model():
    hours = 0.2 * np.arange(51)
    data = {"time [h]": hours, "x": np.exp(-0.5 * hours)}
    found = [finding for finding in in_hours(data).check() if finding.id == "F041"]
    assert len(found) == 1 and found[0].remedy == 'Set time_unit = "h"' and "probably counts its time in h" in found[0].sentence
    assert not any(finding.id == "F041" for finding in in_hours(data, time_unit="h").check())


def test_steady_start_brings_the_model_to_rest(tmp_path):
    t = 0.1 * np.arange(41)
    y = np.where(t < 1, 2.0, 4 - 2 * np.exp(-(t - 1) / 0.8))
    data = {"time": t, "y": y, "u": np.where(t < 0.95, 1.0, 2.0)}
    own = {"inputs": {"u": pydfo.Hold("u")}}
    parameters = [Parameter("T", 0.3, 0.05, 5)]
    steady = Calibration(example_fmu("switched_input"), data, ["y"], parameters, initial_states="steady", **own)
    fit = steady.fit()
    assert fit.parameters["T"] == pytest.approx(0.8, abs=1e-4) and fit.simulate()["y"][0] == pytest.approx(2.0, rel=1e-5)
    fit.save(tmp_path / "a.fit")
    assert pydfo.load_fit(tmp_path / "a.fit").simulate()["y"].tobytes() == fit.simulate()["y"].tobytes()
    held = Calibration(example_fmu("switched_input"), data, ["y"], parameters, initial_states={"x": 0.5, "*": "steady"}, **own)
    assert held.simulate([0.8])["y"][0] == 0.5
    short = Calibration(example_fmu("switched_input"), data, ["y"], parameters, initial_states="steady", steady_limit=1e-3, **own)
    with pytest.raises(pydfo.FmuError, match="it still moves after 0.001 units of time, where the derivative of 'x' is"):
        short.cost([0.8])
    with pytest.raises(ValueError, match="steady_limit requires initial_states"):
        decay({"time": TIME, "x": DECAY}, steady_limit=3)
    with pytest.raises(ValueError, match="must be a dict of states, or 'steady', not 'rest'"):
        decay({"time": TIME, "x": DECAY}, initial_states="rest")
    stepping = example_fmu("dahlquist", kind="CS")
    with pytest.raises(pydfo.FmuError, match="requires model exchange"):
        Calibration(stepping, {"time": TIME, "x": DECAY}, ["x"], [K], initial_states="steady", kind="CS")


@pytest.fixture(scope="module")
def turning(tmp_path_factory):
    """A model whose parameter k is an angle: x' = cos(t + k), x(0) = 1."""
    path = tmp_path_factory.mktemp("angle") / "angle.fmu"
    with zipfile.ZipFile(example_fmu("dahlquist")) as source, zipfile.ZipFile(path, "w") as out:
        for entry in source.infolist():
            content = source.read(entry)
            if entry.filename == "sources/model.c":
                assert b"-memory->k * memory->x;" in content
                content = content.replace(b"-memory->k * memory->x;", b"cos(time + memory->k);")
                content = content.replace(b'#include "model.h"', b'#include "model.h"\n#include <math.h>')
            elif entry.filename == "modelDescription.xml":
                content = content.replace(b'providesDirectionalDerivative="true"', b'providesDirectionalDerivative="false"')
            elif entry.filename.startswith("binaries/"):
                continue
            out.writestr(entry, content)
    return path


def angle(model, truth, start=3.0, noise=0.0, method="auto", **own):
    t = np.linspace(0, 6, 61)
    x = 1 + np.sin(t + truth) - np.sin(truth) + noise * np.random.default_rng(3).standard_normal(61)
    parameter = Parameter("k", start, -np.pi, np.pi, periodic=True, **own)
    return Calibration(model, {"time": t, "x": x}, ["x"], [parameter])


@pytest.mark.parametrize("method", ["auto", "nelder-mead", "de", "cma-es", "quadratic-model", "pattern-search"])
def test_search_of_an_angle_crosses_its_bounds(turning, method):
    """The start 3 is 0.28 from the truth -3 across the bound, and 6 from it within the bounds."""
    fit = angle(turning, -3.0).fit(method=method, rng=1, max_evaluations=400)
    assert fit.parameters["k"] == pytest.approx(-3.0, abs=1e-3) and -np.pi <= fit.x[0] < np.pi
    assert not fit.at_bound and fit.cost < 1e-4


def test_errors_and_profiles_of_an_angle_pass_the_bound(turning, tmp_path):
    at_seam, inside = (angle(turning, truth, start, 0.3).fit() for truth, start in ((np.pi - 1e-4, 3.0), (0.4, 0.1)))
    assert not at_seam.at_bound and not any(f.id in ("F001", "F002") for f in at_seam.findings if "bound" in f.sentence)
    low, high = at_seam.profile("k").intervals["k"]
    center = at_seam.x[0]
    assert low < center < high and (low < -np.pi or high > np.pi)
    assert (high - low) / (4 * at_seam.stderr[0]) == pytest.approx(1.0, rel=0.1)
    assert at_seam.stderr[0] > 0 and inside.stderr[0] > 0
    found = at_seam.bootstrap(40, rng=2)
    assert found.stderr[0] == pytest.approx(at_seam.stderr[0], rel=0.5)
    at_seam.save(tmp_path / "a.fit")
    again = pydfo.load_fit(tmp_path / "a.fit")
    assert again.profile("k").intervals == at_seam.profile("k").intervals and again.parameters == at_seam.parameters
    first = angle(turning, -3.0).fit(method="nelder-mead", max_evaluations=9, checkpoint=tmp_path / "a.ckpt", rng=1)
    more = angle(turning, -3.0).fit(method="nelder-mead", checkpoint=tmp_path / "a.ckpt", rng=1)
    whole = angle(turning, -3.0).fit(method="nelder-mead", rng=1)
    assert first.nfev == 9 and more.x.tobytes() == whole.x.tobytes()


@pytest.mark.parametrize(
    ("own", "said"),
    [
        ({"upper": None}, "its period is the difference of its bounds, but they are 0 and inf"),
        ({"scale": "log", "lower": 0.1}, "cannot be combined with a log scale"),
        ({"kind": "integer"}, "cannot be combined with integer values"),
        ({"prior": pydfo.Normal(1, 1)}, "cannot be combined with a prior"),
        ({"delay_of": "x"}, "cannot be combined with delay_of"),
    ],
)
def test_invalid_periodic_parameters_are_rejected(own, said):
    with pytest.raises(ValueError, match=said):
        Parameter(**{"name": "k", "start": 1, "lower": 0, "upper": 6, "periodic": True, **own})
