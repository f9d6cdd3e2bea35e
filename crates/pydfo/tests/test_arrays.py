"""Arrays and all types of FMI 3.0, compared with FMPy."""

from __future__ import annotations

import shutil
from pathlib import Path

import fmus
import numpy as np
import pytest

import pydfo
from pydfo import FMUModel

FMI = Path(__file__).parents[2] / "fmi"
BUILD = """<?xml version="1.0" encoding="UTF-8"?>
<fmiBuildDescription fmiVersion="3.0"><BuildConfiguration modelIdentifier="arrays"><SourceFileSet language="C99">
<SourceFile name="arrays.c"/><SourceFile name="rest.c"/></SourceFileSet></BuildConfiguration></fmiBuildDescription>
"""


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arrays")
    (folder / "m" / "sources").mkdir(parents=True)
    shutil.copy(FMI / "tests/arrays/modelDescription.xml", folder / "m")
    shutil.copy(FMI / "tests/arrays/arrays.c", folder / "m/sources")
    shutil.copy(FMI.parent / "example-models/models/frontend/fmi3.h", folder / "m/sources")
    shutil.copy(FMI / "tests/support/rest.c", folder / "m/sources")
    (folder / "m/sources/buildDescription.xml").write_text(BUILD)
    return pydfo.build_fmu(folder / "m", folder / "arrays.fmu")


#: A value of each type that differs from the start value.
VALUES = {
    "f32": 0.25,
    "i8": -128,
    "u8": 255,
    "i16": -32768,
    "u16": 65535,
    "i32": -(2**31),
    "u32": 2**32 - 1,
    "i64": -(2**63),
    "u64": 2**64 - 1,
    "choice": 1,
    "bytes": b"\x00\x01\xff",
}
ARRAYS = {
    "k": np.array([0.5, 1.0, 2.0]),
    "flags": np.array([False, True]),
    "matrix": np.array([[9, 8, 7], [6, 5, 4]], dtype=np.int32),
    "text": np.array(["a", "ä"], dtype=object),
}


@pytest.mark.parametrize("kind", ["ME", "CS"])
def test_values_of_all_types_are_set_and_read(path, kind):
    model = FMUModel(path, kind=kind)
    for name, value in (VALUES | ARRAYS).items():
        model.set(name, value)
    for _ in range(2):
        for name, value in VALUES.items():
            got = model.get(name)
            assert got == value and type(got) is type(value), name
        for name, value in ARRAYS.items():
            got = model.get(name)
            assert got.dtype == value.dtype and np.array_equal(got, value), name
        model.simulate(0, 0.5, ncp=1)
    model.reset()
    assert model.get("bytes") == b"\xca\xfe" and model.get("matrix").tolist() == [[0, 1, 2], [3, 4, 5]]


def test_arrays_are_set_in_all_forms(path):
    model = FMUModel(path)
    for given in ([9, 8, 7, 6, 5, 4], [[9, 8, 7], [6, 5, 4]], ((9, 8, 7), (6, 5, 4)), np.arange(9.0, 3.0, -1.0)):
        model.set("matrix", given)
        assert np.array_equal(model.get("matrix"), ARRAYS["matrix"])
    model.set(["matrix[2,1]", "k"], [60, [1, 2, 3]])
    assert model.get(["matrix[2,1]", "matrix[1,3]"]) == [60, 7] and model.get("k")[2] == 3
    for name, given, message in [
        ("matrix", [[1, 2], [3, 4], [5, 6]], "shape"),
        ("matrix[3,1]", 1, "matrix"),
        ("u8", 256, "0 to 255"),
        ("u64", 2**64, "64 bits"),
    ]:
        with pytest.raises((ValueError, KeyError), match=message):
            model.set(name, given)
    for name, given in [("bytes", "text"), ("k", b"123"), ("text", [1, 2])]:
        with pytest.raises(TypeError):
            model.set(name, given)
    model.set("k", [1.0, 2.0])
    with pytest.raises(TypeError, match="different size"):
        model.simulate(0, 1)


@pytest.mark.parametrize("kind", ["ME", "CS"])
def test_results_have_the_shape_of_arrays(path, kind):
    model = FMUModel(path, kind=kind)
    res = model.simulate(0, 1, output=["x", "matrix", "u8"], output_interval=0.25, relative_tolerance=1e-10)
    assert list(res) == ["time", "x", "matrix", "u8"] and np.array_equal(res["matrix[2,3]"], res["matrix"][:, 1, 2])
    assert res["x"].shape == (5, 3) and res["matrix"].shape == (5, 2, 3)
    assert np.allclose(res["x"], np.exp(-res.time)[:, None] * [1, 2, 3], atol=1e-8)
    assert np.array_equal(res["matrix"][-1], [[0, 1, 2], [3, 4, 5]]) and "x" in res
    structured = res.to_structured().dtype
    assert structured["matrix"].base == np.int32 and structured["matrix"].shape == (2, 3) and structured["u8"] == np.uint8
    # Another structure for one simulation only.
    other = model.simulate(0, 1, start_values={"n": 2, "x": [4.0, 5.0], "k": [1.0, 2.0], "u": [0, 0]})
    assert other["x"].shape[1] == 2 and other.final("x[2]") == pytest.approx(5 * np.exp(-2), rel=1e-5)
    assert model.get("x").shape == (2,)
    assert model.simulate(0, 1)["x"].shape[1] == 3


@pytest.mark.parametrize("kind", ["ME", "CS"])
def test_array_elements_are_driven_and_fitted(path, kind):
    model = FMUModel(path, kind=kind)
    table = {"time": [0.0, 2.0], "u[2]": [3.0, 3.0]}
    res = model.simulate(0, 2, input=table, output_interval=0.25, start_values={"k[2]": 0.5}, relative_tolerance=1e-10)
    truth = 6 + (2 - 6) * np.exp(-0.5 * res.time)
    assert np.allclose(res["x[2]"], truth, atol=1e-8) and np.allclose(res["x[1]"], np.exp(-res.time), atol=1e-8)
    fit = pydfo.Calibration(
        model,
        {"time": res.time, "x2": truth, "u2": np.full(len(truth), 3.0)},
        {"x[2]": "x2"},
        [pydfo.Parameter("k[2]", 1.0, 0.1, 5.0)],
        inputs={"u[2]": "u2"},
        start_values={"matrix": np.ones((2, 3), int), "bytes": b"1"},
    ).fit()
    assert fit.x[0] == pytest.approx(0.5, abs=1e-3)


def test_description_contains_arrays(path):
    d = pydfo.read_description(path)
    x, matrix, n = d.variables["x"], d.variables["matrix"], d.variables["n"]
    assert (x.shape, x.dimensions, x.aliases) == ((3,), ("n",), ("level",)) and d.variables["level"].aliases == ("x",)
    assert (matrix.shape, matrix.dimensions, matrix.start.tolist()) == ((2, 3), (2, 3), [[0, 1, 2], [3, 4, 5]])
    assert (n.type, n.causality, n.shape, n.start) == ("UInt64", "structuralParameter", (), 3)


@pytest.mark.parametrize("kind", ["ME", "CS"])
def test_arrays_agree_with_fmpy(path, kind):
    fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
    options = {"output_interval": 0.25, "step_size": 0.25} if kind == "CS" else {"solver": "CVode", "output_interval": 0.25}
    theirs = fmpy.simulate_fmu(
        str(path),
        fmi_type={"ME": "ModelExchange", "CS": "CoSimulation"}[kind],
        stop_time=2,
        relative_tolerance=1e-10,
        start_values={"k": "0.5 1 2", "u": "1 2 3", "u8": 7},
        output=["x", "sum", "matrix", "u8"],
        record_events=False,
        **options,
    )
    ours = FMUModel(path, kind=kind).simulate(
        0,
        2,
        times=theirs["time"],
        relative_tolerance=1e-11,
        step_size=0.25 if kind == "CS" else None,
        start_values={"k": [0.5, 1, 2], "u": [1, 2, 3], "u8": 7},
        output=["x", "sum", "matrix", "u8"],
    )
    for name in ("x", "sum", "matrix", "u8"):
        found, expected = ours[name].reshape(len(ours.time), -1), theirs[name].reshape(len(ours.time), -1)
        assert np.abs(found - expected).max() <= (0 if kind == "CS" else 1e-6), name


def test_elements_of_resized_array_are_set(path):
    model = FMUModel(path)
    model.set(["n", "k"], [4, [1, 2, 3, 4]])
    model.set("k[4]", 5)
    assert model.get("k").tolist() == [1, 2, 3, 5]
    assert model.get("x").shape == (4,)
    with pytest.raises(KeyError):
        model.set(["k[1]", "k[5]"], [9, 9])
    assert model.get("k[1]") == 1


def test_single_precision_parameter_is_fitted(tmp_path):
    # x' = f32 - x, x(0) = 1.
    path = fmus.compiled("arrays", tmp_path / "arrays.fmu", "SINGLE")
    t = np.linspace(0, 1, 21)
    data = {"time": t, "y": 2.0 - np.exp(-t)}
    fit = pydfo.Calibration(path, data, {"x[1]": "y"}, [pydfo.Parameter("f32", 0.5, 0, 10)], kind="ME").fit()
    assert fit.success and fit.x == pytest.approx([2.0], abs=1e-5)
