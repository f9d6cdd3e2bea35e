"""Inputs in all forms, for a first-order lag with a Real, an Integer and a Boolean input."""

from __future__ import annotations

import gc
import threading
import warnings
import weakref

import fmus
import numpy as np
import pytest

from pydfo import Calibration, CalibrationWarning, CheckpointError, FMUModel, Parameter, example_fmu

K, T = 2.0, 0.5
TIGHT = {"relative_tolerance": 1e-10}


@pytest.fixture
def switched():
    return FMUModel(example_fmu("switched_input"))


def lag(x0, target, dt):
    return target + (x0 - target) * np.exp(-dt / T)


def ramp(t, rate=1.0, gear=1):
    """Returns the response to u = rate t."""
    return K * gear * rate * (t - T * (1 - np.exp(-t / T)))


def ramp_forms():
    """Returns u = t from 0 to 5 in every form."""
    times = np.linspace(0.0, 5.0, 11)
    matrix = np.column_stack([times, times])
    structured = np.array(list(zip(times, times)), dtype=[("time", float), ("u", float)])
    return {
        "dict of arrays": {"time": times, "u": times},
        "dict of lists": {"u": times.tolist(), "time": times.tolist()},
        "dict of columns": {"time": times[:, None], "u": times[:, None]},
        "dict of integers": {"time": np.arange(6), "u": np.arange(6)},
        "structured": structured,
        "record array": structured.view(np.recarray),
        "name and matrix": ("u", matrix),
        "names and matrix": (["u"], matrix),
        "names and lists": (("u",), matrix.tolist()),
        "array of names and matrix": (np.array(["u"]), matrix),
        "matrix in Fortran order": ("u", np.asfortranarray(matrix)),
        "dict of a function": {"u": lambda t: t},
        "name and function": ("u", lambda t: t),
        "names and function": (["u"], lambda t: [t]),
        "function of arrays": (["u"], lambda t: np.array([t])),
        "function of NumPy scalars": ("u", lambda t: np.float64(t)),
        "function of integers": {"u": lambda t: 0 if t == 0 else t},
    }


@pytest.mark.parametrize("form", ramp_forms())
def test_ramp_input_gives_closed_form(switched, form):
    times = np.linspace(0.0, 5.0, 21)
    res = switched.simulate(0, 5, times=times, input=ramp_forms()[form], output=["x", "u"], **TIGHT)
    assert res["x"] == pytest.approx(ramp(times), abs=1e-8)
    assert res["u"] == pytest.approx(times, abs=1e-14)


def frame(index=False):
    pandas = pytest.importorskip("pandas")
    data = pandas.DataFrame({"time": [0.0, 1.0, 2.0, 5.0], "u": 1.0, "gear": [1, 2, 2, 2], "enabled": [True, True, False, False]})
    return data.set_index("time") if index else data


@pytest.mark.parametrize(
    "form",
    [
        lambda: {"time": [0, 1, 2, 5], "u": np.ones(4), "gear": [1, 2, 2, 2], "enabled": [True, True, False, False]},
        lambda: {"time": [0, 1, 2, 5], "u": 1.0, "gear": [1, 2, 2, 2], "enabled": [1, 1, 0, 0]},
        lambda: {"time": [0, 1, 2, 5], "u": lambda t: 1.0, "gear": [1, 2, 2, 2], "enabled": [1, 1, 0, 0]},
        lambda: (["u", "gear", "enabled"], [[0, 1, 1, 1], [1, 1, 2, 1], [2, 1, 2, 0], [5, 1, 2, 0]]),
        frame,
        lambda: frame(index=True),
        lambda: frame().to_records(index=False),
    ],
    ids=["dict", "constant", "function", "matrix", "DataFrame", "DataFrame with index", "records"],
)
def test_inputs_of_all_kinds_may_jump(switched, form):
    res = switched.simulate(0, 5, times=[0, 1, 2, 3, 5], input=form(), record_events=True, **TIGHT)
    x1 = lag(0, 2, 1)
    x2 = lag(x1, 4, 1)
    x3 = lag(x2, 0, 1)
    exact = {0.0: 0.0, 1.0: x1, 2.0: x2, 3.0: x3, 5.0: lag(x3, 0, 2)}
    for time, value in exact.items():
        assert res["x"][res.time == time] == pytest.approx(value, abs=1e-8)
    assert list(res.events["kind"]) == ["state", "input", "input", "state"]
    assert res.events["time"] == pytest.approx([T * np.log(4), 1, 2, 2 + T * np.log(x2)], abs=1e-9)
    before, after = res["target"][res.time == 1.0]
    assert (before, after) == (2.0, 4.0)


def test_time_listed_twice_is_a_jump(switched):
    inputs = {"time": [0, 1, 1, 2], "u": [0, 0, 3, 3]}
    res = switched.simulate(0, 2, times=[0.5, 1, 1, 2], input=inputs, output=["x", "u"], **TIGHT)
    assert list(res["u"]) == [0, 0, 3, 3]
    assert res["x"] == pytest.approx([0, 0, 0, lag(0, 6, 1)], abs=1e-8)
    assert list(res.events["time"])[:1] == [1.0] and res.events["kind"][0] == "input"


def test_tables_are_constant_outside_their_span(switched):
    res = switched.simulate(0, 4, ncp=4, input={"time": [1, 2], "u": [1, 2]}, output=["u"])
    assert list(res["u"]) == [1, 1, 2, 2, 2]


def test_function_is_called_once_per_time(switched):
    calls = []

    def function(t):
        calls.append(t)
        return (t,)

    res = switched.simulate(0, 5, input=(["u"], function))
    assert res.final("x") == pytest.approx(ramp(5.0), rel=1e-5)
    assert all(a != b for a, b in zip(calls, calls[1:]))


def test_inputs_apply_to_one_simulation(switched):
    plain = switched.simulate(0, 1)
    switched.simulate(0, 1, input={"u": 3.0})
    assert fmus.same_bits(plain, switched.simulate(0, 1))
    switched.set("u", 3.0)
    assert fmus.same_bits(switched.simulate(0, 1), switched.simulate(0, 1, input={"u": 3.0}))


def test_single_function_for_several_inputs_is_rejected(switched):
    with pytest.raises(ValueError, match=r"3 \(u, enabled, gear\)"):
        switched.simulate(0, 1, input=np.sin)
    with pytest.raises(ValueError, match="none"):
        FMUModel(example_fmu("dahlquist")).simulate(0, 1, input=np.sin)


def test_single_function_drives_single_input(tmp_path):
    others = ('causality="input" variability="discrete"', 'causality="parameter" variability="tunable"')
    model = FMUModel(fmus.changed("switched_input", tmp_path / "m.fmu", others))
    assert model.description.inputs == ["u"]
    res = model.simulate(0, 5, input=lambda t: t, **TIGHT)
    assert res["x"] == pytest.approx(ramp(res.time), abs=1e-8)
    assert res["x"] == pytest.approx(model.simulate(0, 5, input=np.positive, **TIGHT)["x"], abs=1e-12)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"u": [1.0, 2.0]}, "'time'"),
        ({"time": [0, 1], "u": [1.0]}, "1 values for 2 times"),
        ({"time": [0, 1], "u": [1.0, np.nan]}, "NaN"),
        ({"time": [0, np.inf], "u": [1.0, 2.0]}, "inf"),
        ({"time": [1, 0], "u": [1.0, 2.0]}, "must not decrease"),
        ({"time": [], "u": []}, "no rows"),
        ({"time": [0, 1], "u": np.zeros((2, 2))}, "one-dimensional"),
        ({"time": [0, 1], "gear": [1, 1.5]}, "not an integer"),
        ({"time": [0, 1], "enabled": [1, 2]}, "0 or 1"),
        ({"time": [0, 1], "T": [1, 2]}, "neither an input nor a tunable parameter.*causality is parameter and its variability is fixed"),
        ({"time": [0, 1], "u": [1, 2], "gear": lambda t: 1}, "only continuous floating-point inputs"),
        (("u", np.zeros((3, 3))), r"\(3, 3\)"),
        (("u", np.zeros(3)), r"\(3,\)"),
        ((["u", "u"], np.zeros((3, 3))), "twice"),
        (np.zeros(2, dtype=[("u", float)]), "'time'"),
    ],
    ids=str,
)
def test_invalid_inputs_are_rejected(switched, given, message):
    with pytest.raises(ValueError, match=message):
        switched.simulate(0, 2, input=given)


@pytest.mark.parametrize(
    "given",
    [3.0, ["u"], np.zeros((2, 2)), {3: [1]}, {"time": [0, 1], "u": ["a", "b"]}, {"u": "on"}, {"u": None}, ("u", "v"), ([3], np.zeros((2, 2)))],
    ids=str,
)
def test_inputs_of_wrong_type_are_rejected(switched, given):
    with pytest.raises(TypeError):
        switched.simulate(0, 2, input=given)


def test_frame_without_times_is_rejected(switched):
    pandas = pytest.importorskip("pandas")
    with pytest.raises(ValueError, match="'time'"):
        switched.simulate(0, 2, input=pandas.DataFrame({"u": [1.0, 2.0]}))


def test_function_exception_propagates_unchanged(switched):
    error = ZeroDivisionError("mine")

    def function(t):
        if t > 1:
            raise error
        return 1.0

    with pytest.raises(ZeroDivisionError) as info:
        switched.simulate(0, 5, input={"u": function})
    assert info.value is error
    assert switched.simulate(0, 1).termination == "finished"


@pytest.mark.parametrize(
    ("value", "kind"),
    [("a", TypeError), (None, TypeError), ([1.0, 2.0], TypeError), (np.nan, ValueError), (np.inf, ValueError), (1j, TypeError)],
    ids=str,
)
def test_invalid_function_values_are_rejected(switched, value, kind):
    with pytest.raises(kind, match="input function"):
        switched.simulate(0, 1, input={"u": lambda t: value})


def test_interpreter_lock_is_held_only_inside_a_function(switched):
    threads = set()
    ticks, stop = [], threading.Event()

    def tick():
        while not stop.wait(0.0005):
            ticks.append(1)

    def function(t):
        threads.add(threading.get_ident())
        return t

    thread = threading.Thread(target=tick)
    thread.start()
    switched.simulate(0, 5, input={"u": function}, max_step=1e-3)
    stop.set()
    thread.join()
    assert ticks and len(threads) == 1


def test_function_must_not_use_the_model(switched):
    with pytest.raises(RuntimeError, match="simulated"):
        switched.simulate(0, 1, input={"u": lambda t: switched.get("x")})


def test_function_is_released_after_the_simulation():
    class Holder:
        pass

    model, holder = FMUModel(example_fmu("switched_input")), Holder()
    model.simulate(0, 1, input={"u": lambda t, holder=holder: t})
    gone = weakref.ref(holder)
    del holder
    gc.collect()
    assert gone() is None


def test_input_derivatives_are_passed_unless_disabled():
    model = FMUModel(example_fmu("switched_input", kind="CS"))
    # y' = (2 u - y) / 0.5 with u = 0.3 t, as a ramp, or held over steps of 0.25 s.
    ramp = 0.6 * (2.0 - 0.5 * (1.0 - np.exp(-4.0)))
    held = 0.0
    for k in range(8):
        target = 0.15 * k
        held = target + (held - target) * np.exp(-0.5)
    for options, expected in (({}, ramp), ({"input_derivatives": True}, ramp), ({"input_derivatives": False}, held)):
        result = model.simulate(final_time=2.0, ncp=8, output="y", input={"u": lambda t: 0.3 * t}, **options)
        assert result.final("y") == pytest.approx(expected, abs=1e-9)


def test_checkpoint_depends_on_input_derivatives(tmp_path):
    t = np.linspace(0.0, 2.0, 9)
    data = {"time": t, "u": 0.3 * t, "y": 0.6 * (t - 0.5 * (1.0 - np.exp(-2.0 * t)))}

    def calibration(input_derivatives):
        return Calibration(
            example_fmu("switched_input", kind="CS"),
            data,
            ["y"],
            Parameter("T", 0.4, 0.1, 1.0),
            inputs=["u"],
            input_derivatives=input_derivatives,
        )

    assert calibration(True).cost([0.5]) < 1e-9 < calibration(False).cost([0.5])
    calibration(True).fit(checkpoint=tmp_path / "fit", max_evaluations=20)
    with pytest.raises(CheckpointError, match="input_derivatives of the simulations: true in the file, false in this run"):
        calibration(False).fit(checkpoint=tmp_path / "fit", resume="require", max_evaluations=20)


@pytest.mark.parametrize("solver", ["auto", "tsit5", "dop853", "radau5", "bdf", "rk4"])
@pytest.mark.parametrize("width", [1e-4, 1e-2])
def test_narrow_pulses_are_not_missed(solver, width):
    """With all methods, every row with a change of slope of a table ends a step."""
    m = FMUModel(example_fmu("quad_tank"))

    def level(times, volts, tolerance):
        data = {"time": times, "u1": volts, "u2": [5.0] * len(times)}
        return m.simulate(0, 100, input=data, output=["qt.x1"], ncp=1, solver=solver, relative_tolerance=tolerance).final("qt.x1")

    triangle = [0, 50, 50 + width, 50 + 2 * width, 100], [5, 5, 5 + 1 / width, 5, 5]
    jumps = [0, 50, 50, 50 + width, 50 + width, 100], [5, 5, 5 + 1 / width, 5 + 1 / width, 5, 5]
    flat = level([0, 100], [5, 5], 1e-9)
    for times, volts in (triangle, jumps):
        expected = level(times, volts, 1e-10)
        assert expected - flat > 1e-5
        assert level(times, volts, 1e-6) - flat == pytest.approx(expected - flat, rel=0.02)


def test_recording_drives_inputs_by_name(switched, tmp_path):
    path = tmp_path / "u.csv"
    path.write_text("time [ms],u,other,gear\n0,0,7,1\n1000,,8,2\n2000,0.6,9,2\n")
    found = switched.simulate(0, 2, inputs=path, outputs=["x", "gear"])
    # An empty cell is unknown, and the line continues across it.
    table = {"time": [0.0, 1.0, 2.0], "u": [0.0, 0.3, 0.6], "gear": [1.0, 2.0, 2.0]}
    expected = switched.simulate(0, 2, inputs=table, outputs=["x", "gear"])
    assert np.allclose(found["x"], expected["x"], rtol=1e-9) and np.array_equal(found["gear"], expected["gear"])
    assert list(found["gear"][[0, -1]]) == [1, 2]
    path.write_text("time,v\n0,0\n1,1\n")
    with pytest.raises(ValueError, match=r"no column has the name of an input.*'?v'?.*'?u'?"):
        switched.simulate(0, 2, inputs=str(path))
    with pytest.raises(FileNotFoundError):
        switched.simulate(0, 2, inputs=tmp_path / "none.csv")


def test_input_without_column_is_named(switched, tmp_path):
    path = tmp_path / "u.csv"
    path.write_text("time,U,other,enabled\n0,0,7,1\n2,0.6,9,1\n")
    table = {"time": [0.0, 2.0], "u": [0.0, 0.6], "enabled": [True, True]}
    expected = switched.simulate(0, 2, inputs=table, outputs=["x"])
    message = r"input 'gear' has no column and keeps its start value \d+ \[F054 .*\]. Assign one of the columns 'U', 'other', 'enabled'"
    with pytest.warns(CalibrationWarning, match=message):
        found = switched.simulate(0, 2, inputs=path, outputs=["x"])
    assert np.array_equal(found["x"], expected["x"])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        switched.simulate(0, 2, inputs=path, outputs=["x"], start_values={"gear": 2})
    path.write_text("time,u [m],gear\ns,mm,-\n0,0,1\n2,0.6,1\n")
    with pytest.raises(ValueError, match=r"u\.csv.*'u \[m\]' has two units, 'm' in its name and 'mm' in line 2"):
        switched.simulate(0, 2, inputs=path)


def test_recording_of_another_format_is_read(switched, tmp_path):
    pytest.importorskip("pyarrow")
    pd = pytest.importorskip("pandas")
    path = tmp_path / "u.parquet"
    pd.DataFrame({"time": [0.0, 2.0], "u": [0.0, 0.6], "note": ["a", "b"]}).to_parquet(path)
    table = {"time": [0.0, 2.0], "u": [0.0, 0.6]}
    assert np.array_equal(switched.simulate(0, 2, inputs=path)["x"], switched.simulate(0, 2, inputs=table)["x"])


def test_matrix_for_an_array_is_rejected_with_element_names(switched):
    with pytest.raises(ValueError, match=r"'u\[1\]', 'u\[2\]'"):
        switched.simulate(0, 1, inputs={"time": [0.0, 1.0], "u": np.zeros((2, 2))})


def test_steps_caused_by_input_rows_are_logged(caplog, tmp_path):
    times = np.linspace(0.0, 2.0, 101)
    path = tmp_path / "m.fmu"
    path.write_bytes(example_fmu("switched_input", kind="CS").read_bytes())
    model = FMUModel(path)
    for derivatives in (True, False):
        res = model.simulate(0, 2, times=[0, 2], step_size=0.5, inputs={"time": times, "u": np.sin(9 * times)}, input_derivatives=derivatives)
        assert res.stats.accepted_steps == 100
    messages = [record.getMessage() for record in caplog.records if "communication points" in record.getMessage()]
    assert len(messages) == 1 and "99 times" in messages[0] and "step 0.5" in messages[0]


GAINS = {"time": [0.0, 1.0], "K": [3.0, -1.0]}


def gains(t):
    """Returns x of the lag with u = 1 and the gains above."""
    return np.where(t <= 1, lag(0.0, 3.0, t), lag(lag(0.0, 3.0, 1.0), -1.0, t - 1))


@pytest.mark.parametrize("kind", ["ME", "CS"])
def test_tunable_parameter_is_driven_like_an_input(kind, tmp_path):
    model = FMUModel(example_fmu("switched_input", kind=kind), kind=kind)
    times = np.linspace(0, 2, 9)
    found = model.simulate(0, 2, times=times, inputs={**GAINS, "u": [1.0, 1.0]}, outputs=["x"], **TIGHT)
    assert np.allclose(found["x"], gains(times), atol=1e-8)
    path = tmp_path / "gains.csv"
    path.write_text("time,u,K,enabled,gear\n0,1,3,1,1\n1,1,-1,1,1\n")
    assert np.array_equal(model.simulate(0, 2, times=times, inputs=path, outputs=["x"], **TIGHT)["x"], found["x"])


def test_fit_supports_tunable_parameter_driven_by_column():
    times = np.linspace(0, 2, 41)
    table = {"time": times, "x": 1.5 * gains(times), "gain": np.where(times < 1, 3.0, -1.0)}
    for kind in ("ME", "CS"):
        fmu = example_fmu("switched_input", kind=kind)
        fit = Calibration(fmu, table, ["x"], [Parameter("u", 1.0, 0.1, 5.0)], inputs={"K": "gain"}, kind=kind).fit()
        assert fit.x[0] == pytest.approx(1.5, abs=1e-4)


def test_simulation_of_more_than_a_million_steps_is_reported(caplog, tmp_path):
    path = tmp_path / "m.fmu"
    path.write_bytes(example_fmu("dahlquist", kind="CS").read_bytes())
    FMUModel(path).simulate(0, 1, ncp=2, step_size=9e-7)
    assert any("requires 1111111 steps" in record.getMessage() for record in caplog.records)


def test_initial_states_are_applied():
    model = FMUModel(example_fmu("dahlquist"))
    found = model.simulate(0, 1, initial_states={"x": 2.5}, **TIGHT)
    assert np.allclose(found["x"], 2.5 * np.exp(-found.time), atol=1e-8)
    assert model.simulate(0, 1)["x"][0] == 1.0
    with pytest.raises(KeyError):
        model.simulate(0, 1, initial_states={"z": 2.5})
    with pytest.raises(TypeError):
        model.simulate(0, 1, initial_states={"x": "high"})
