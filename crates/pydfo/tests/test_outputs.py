"""Outputs of every type, compared with FMPy, an independent importer: strings, bytes, 64-bit integers, arrays as further
axes."""

from __future__ import annotations

import fmus
import numpy as np
import pytest

from pydfo import Calibration, FMUModel, Parameter, SimulationError


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return fmus.compiled("arrays", tmp_path_factory.mktemp("arrays") / "arrays.fmu")


NAMES = ["label", "sum", "count", "text", "matrix", "blob", "u64", "x", "i8", "choice", "flags", "f32"]


@pytest.fixture(scope="module", params=["ME", "CS"])
def result(path, request):
    return FMUModel(path, kind=request.param).simulate(0, 1, ncp=10, output=NAMES, relative_tolerance=1e-10)


def test_columns_have_types_of_variables(result):
    assert list(result) == ["time", *NAMES]
    rows = range(11)
    assert list(result["label"]) == ["early" if row < 5 else "late" for row in rows]
    assert list(result["blob"]) == [b"\x00\x01\xff"[: row % 4] for row in rows]
    assert result["label"].dtype == result["blob"].dtype == object
    # float64 cannot distinguish these integers.
    assert result["count"].dtype == np.int64 and list(result["count"]) == [2**53 + 1 + row for row in rows]
    assert result["u64"].dtype == np.uint64 and set(result["u64"].tolist()) == {18000000000000000064}
    assert result["i8"].dtype == np.float64 and set(result["i8"]) == {-8.0}


def test_arrays_have_axes_and_elements(result):
    assert result["x"].shape == (11, 3) and result["matrix"].shape == (11, 2, 3) and result["text"].shape == (11, 2)
    assert np.array_equal(result["matrix"][4], [[0, 1, 2], [3, 4, 5]])
    assert np.array_equal(result["matrix[2,1]"], result["matrix"][:, 1, 0])
    np.testing.assert_allclose(result["x[3]"], 3 * np.exp(-result.time), rtol=1e-8)
    assert list(result["text[2]"]) == ["two"] * 11
    assert "x[3]" in result and "x" in result and "x[4]" not in result and 3 not in result
    for missing in ("x[4]", "matrix[1]", "[1]", "y"):
        with pytest.raises(KeyError, match="was not recorded"):
            result[missing]


def test_final_values_have_types_of_variables(result):
    assert result.final("label") == "late" and result.final("blob") == b"\x00\x01" and result.final("u64") == 18000000000000000064
    assert type(result.final("count")) is int and type(result.final("sum")) is float
    assert np.array_equal(result.final("matrix"), [[0, 1, 2], [3, 4, 5]])
    assert result.final(["text[1]", "i8"]) == ["one", -8.0]


def test_result_converts_to_structured_array(result):
    array = result.to_structured()
    assert array.dtype.names == ("time", *NAMES)
    assert array.dtype["matrix"] == np.dtype((np.int32, (2, 3))) and array.dtype["flags"] == np.dtype((np.bool_, (2,)))
    kinds = {"count": np.int64, "u64": np.uint64, "i8": np.int8, "f32": np.float32, "label": object, "choice": np.int64}
    assert {name: array.dtype[name] for name in kinds} == {name: np.dtype(kind) for name, kind in kinds.items()}
    assert array["count"][-1] == 2**53 + 11 and array["label"][0] == "early" and np.array_equal(array["x"], result["x"])


def test_result_converts_to_dataframe(result):
    pytest.importorskip("pandas")
    frame = result.to_dataframe()
    assert list(frame.columns)[:6] == ["time", "label", "sum", "count", "text[1]", "text[2]"]
    assert "matrix[2,3]" in frame and frame["u64"].dtype == np.uint64 and frame["flags[1]"].dtype == bool
    assert frame["count"].iloc[3] == 2**53 + 4 and frame["blob"].iloc[3] == b"\x00\x01\xff"


def test_result_is_plotted(result):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    from matplotlib import pyplot

    drawn = [line.get_label() for axes in result.plot().axes for line in axes.lines]
    assert "x[2]" in drawn and "count" in drawn and not {"label", "blob", "text[1]"} & set(drawn)
    assert [line.get_label() for line in result.plot("x[2]").axes[0].lines] == ["x[2]"]
    with pytest.raises(ValueError, match="label is of type String"):
        result.plot("label")
    pyplot.close("all")


def test_outputs_default_and_all_are_recorded(path):
    model = FMUModel(path)
    assert list(model.simulate(0, 1, ncp=2)) == ["time", "x", "sum", "label"]
    everything = model.simulate(0, 1, ncp=2, output="all")
    assert set(NAMES) < set(everything) and everything["k"].shape == (3, 3)


def test_strings_cannot_be_fitted(tmp_path):
    gain = '<ScalarVariable name="gain" valueReference="9" causality="parameter" variability="fixed"><Real start="1"/></ScalarVariable>'
    path = fmus.write(tmp_path / "m.fmu", fmus.xml(fmus.KINDS + gain))
    data = {"time": [0.0, 0.5], "y": [1.0, 2.0]}
    with pytest.raises(ValueError, match="text cannot be an output: it is a string or binary variable"):
        Calibration(path, data, {"text": "y"}, [Parameter("gain", 1.0, 0.1, 10.0)])


@pytest.mark.parametrize("kind", ["ME", "CS"])
def test_outputs_agree_with_fmpy(path, kind):
    fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(path)) == []
    # FMPy does not record strings, and records arrays of the model as a whole.
    names = ["sum", "count", "x", "matrix", "u64", "i8", "u8", "i16", "flags", "f32"]
    theirs = fmpy.simulate_fmu(
        str(path),
        fmi_type={"ME": "ModelExchange", "CS": "CoSimulation"}[kind],
        stop_time=1.0,
        output_interval=0.125,
        step_size=0.125,
        relative_tolerance=1e-10,
        output=names,
        record_events=False,
    )
    ours = FMUModel(path, kind=kind).simulate(
        0, 1, times=theirs["time"], output=names, relative_tolerance=1e-10, step_size=0.125 if kind == "CS" else None
    )
    structured = ours.to_structured()
    for name in names:
        assert structured[name].shape == theirs[name].shape and structured.dtype[name] == theirs.dtype[name], name
        np.testing.assert_allclose(structured[name].astype(float), theirs[name].astype(float), rtol=1e-7, err_msg=name)
    for name in ("count", "u64"):
        assert np.array_equal(structured[name], theirs[name])


def test_arrays_strings_and_bytes_are_set(path):
    model = FMUModel(path)
    model.set("matrix", np.array([[6, 5, 4], [3, 2, 1]]))
    model.set("text", ("left", "right"))
    model.set("bytes", b"\x00\xff")
    model.set("i64", 2**62 + 1)
    res = model.simulate(0, 1, ncp=1, output=["matrix", "text", "bytes", "i64"], start_values={"k": [[0.5], 1.0, np.float64(2.0)]})
    assert np.array_equal(res.final("matrix"), [[6, 5, 4], [3, 2, 1]])
    assert list(res.final("text")) == ["left", "right"] and res.final("bytes") == b"\x00\xff" and res.final("i64") == 2**62 + 1
    assert model.get("matrix").tolist() == [[6, 5, 4], [3, 2, 1]] and model.get("k").tolist() == [0.5, 1.0, 2.0]
    for wrong in ([1, 2], 3, [[1, 2, 3], [4, 5, "x"]]):
        with pytest.raises((TypeError, ValueError), match="matrix"):
            model.simulate(0, 1, start_values={"matrix": wrong})
    smaller = model.simulate(0, 1, ncp=4, output=["x"], start_values={"n": 2, "x": [1.0, 3.0], "k": [1.0, 1.0]})
    assert smaller["x"].shape == (5, 2) and smaller.final("x[2]") == pytest.approx(3 * np.exp(-1), rel=1e-5)


def test_description_contains_extents_and_clocks(path, tmp_path):
    variables = FMUModel(path).description.variables
    assert (variables["matrix"].shape, variables["x"].shape, variables["i8"].shape) == ((2, 3), (3,), ())
    clocks = FMUModel(fmus.compiled("clocks", tmp_path / "clocks.fmu")).description.variables
    assert clocks["later"].interval_variability == "countdown" and clocks["x"].interval_variability is None


@pytest.mark.parametrize("kind", ["ME", "CS"])
def test_strings_and_bytes_are_inputs(path, kind):
    model = FMUModel(path, kind=kind)
    table = {"time": [0.0, 0.25, 0.5], "word": ["first", "second", "first"], "packet": [b"", b"\x00\xff", b""], "u[1]": [1.0, 1.0, 1.0]}
    res = model.simulate(0, 1, output_interval=0.25, output=["word", "packet", "u"], input=table)
    # A row of a co-simulation is read before the inputs of the next step are set.
    late = kind == "CS"
    assert list(res["word"]) == ["first"] * late + ["first", "second", "first", "first", "first"][: 5 - late]
    assert list(res["packet"]) == [b""] * late + [b"", b"\x00\xff", b"", b"", b""][: 5 - late]
    assert res["u"][-1, 0] == 1.0
    res = model.simulate(0, 1, ncp=1, output=["word"], input={"word": "always"})
    assert list(res["word"]) == ["always", "always"]
    with pytest.raises((TypeError, ValueError), match="word"):
        model.simulate(0, 1, input={"time": [0.0, 1.0], "word": ["a", 1]})


def test_64_bit_integer_inputs_are_exact(tmp_path):
    roles = [
        (
            f'name="{name}" valueReference="{reference}" causality="parameter" variability="fixed"',
            f'name="{name}" valueReference="{reference}" causality="input" variability="discrete"',
        )
        for name, reference in (("i64", 17), ("u64", 18))
    ]
    model = FMUModel(fmus.compiled("arrays", tmp_path / "i.fmu", replacements=roles))
    times = [0.0, 0.3, 0.6, 0.9]
    big = 2**53 + 1
    tables = [
        {"time": times, "i64": np.array([big, -big, 3, 2**63 - 1]), "u64": np.array([2**64 - 1, 1, big, 2**64 - 1], dtype=np.uint64)},
        {"time": times, "i64": [big, -big, 3, 2**63 - 1], "u64": [2**64 - 1, 1, big, 2**64 - 1]},
        {"time": times, "i64": np.array([big, -big, 3, 2**63 - 1], dtype=object), "u64": [np.uint64(2**64 - 1), 1, big, 2**64 - 1]},
    ]
    for table in tables:
        res = model.simulate(input=table, times=times, output=["i64", "u64"])
        assert res["i64"].dtype == np.int64 and res["i64"].tolist() == [big, -big, 3, 2**63 - 1]
        assert res["u64"].dtype == np.uint64 and res["u64"].tolist() == [2**64 - 1, 1, big, 2**64 - 1]
    res = model.simulate(input={"i64": -big}, times=times, output="i64")
    assert set(res["i64"].tolist()) == {-big}
    with pytest.raises((ValueError, TypeError), match="u64"):
        model.simulate(input={"u64": -big}, times=times)


def test_nan_outputs_are_recorded_but_fail_a_fit(tmp_path):
    """A result contains the values of the model. A fit counts them as failures at the times of measurements."""
    path = fmus.compiled("arrays", tmp_path / "nan.fmu", "NAN_ABOVE=2")
    model = FMUModel(path)
    model.set("k[1]", 3.0)
    res = model.simulate(0, 1, ncp=4, output=["sum", "x"])
    assert np.isnan(res["sum"]).all() and np.isfinite(res["x"]).all()

    t = np.linspace(0, 1, 11)
    measured = np.exp(-1.5 * t) + 5 * np.exp(-t)
    calibration = Calibration(path, {"time": t, "y": measured}, {"sum": "y"}, [Parameter("k[1]", 1.0, 0.5, 10.0)])
    expected = "the residual of 'sum' is not finite"
    with pytest.raises(SimulationError, match=expected):
        calibration.cost([3.0])
    fit = calibration.fit(method="de", max_evaluations=500, rng=1)
    assert fit.nfail > 50 and fit.failures == {expected: fit.nfail}
    assert abs(fit.x[0] - 1.5) < 1e-4 and np.isnan(fit.trace.fun).sum() >= fit.nfail
