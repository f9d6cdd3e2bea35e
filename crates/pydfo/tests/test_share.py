"""Export of a fit: files, pickles, tables, other programs."""

import copy
import csv
import json
import pickle
import shutil
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import pydfo
from pydfo import Calibration, Experiment, FMUModel, Parameter, example_fmu, load_fit

T = np.arange(12) * 0.1


def recording(x0):
    x = x0 * np.exp(-2 * T) + 1e-3 * np.sin(40 * T)
    x[3] = np.nan
    return {"time": T, "x": x}


def local_calibration(model):
    """Returns a calibration of x' = -k x with k = 2; one recording starts at x = 1, one at x = 3."""
    experiments = [Experiment(recording(1), "x", name="cold"), Experiment(recording(3), "x", name="hot")]
    return Calibration(model, experiments, [Parameter("k", 1, 0.1), Parameter("x", 2, local=True)])


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    place = tmp_path_factory.mktemp("model") / "decay.fmu"
    shutil.copy(example_fmu("dahlquist"), place)
    return place


@pytest.fixture(scope="module")
def fit(place):
    return local_calibration(place).fit()


def assert_same(one, two):
    """Checks that all numbers of both fits are equal."""
    assert one.parameters == two.parameters
    assert (one.cost, one.rms, one.start_cost, one.start_rms) == (two.cost, two.rms, two.start_cost, two.start_rms)
    for name in ("message", "nfev", "method", "solver"):
        assert getattr(one, name) == getattr(two, name), name
    assert (one.stats.seconds, one.stats) == (two.stats.seconds, two.stats)
    for name in ("x", "start", "jac", "cov"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    for name in ("x", "fun", "above", "used", "id", "seconds"):
        np.testing.assert_array_equal(getattr(one.trace, name), getattr(two.trace, name))
    assert set(vars(one)) == set(vars(two))
    assert repr(one) == repr(two)


def assert_simulates(one, two):
    np.testing.assert_array_equal(one.residuals(), two.residuals())
    for name, columns in one.simulate().items():
        np.testing.assert_array_equal(columns["x"], two.simulate()[name]["x"])


def test_saved_fit_is_complete(fit, tmp_path):
    assert fit.parameters == pytest.approx({"k": 2, "x[cold]": 1, "x[hot]": 3}, abs=5e-3)
    path = tmp_path / "decay.fit"
    fit.save(path)
    loaded = load_fit(path)
    assert_same(loaded, fit)
    assert_simulates(loaded, fit)
    assert loaded._calibration.parameters == fit._calibration.parameters
    # The loaded fit can be fitted and saved again.
    assert loaded._calibration.fit().parameters == pytest.approx(fit.parameters)
    loaded.save(tmp_path / "again.fit")
    assert (tmp_path / "again.fit").read_bytes() == path.read_bytes()


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda fit: pickle.loads(pickle.dumps(fit))])
def test_copies_are_identical(fit, copied):
    assert_same(copied(fit), fit)
    assert_simulates(copied(fit), fit)
    calibration = copied(fit._calibration)
    assert calibration.cost(fit.x) == fit.cost


def test_fit_can_be_copied_after_a_plot(fit):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed").use("Agg")
    fit.plot()
    assert_same(pickle.loads(pickle.dumps(fit)), fit)


@pytest.mark.skipif(sys.platform == "win32", reason="under Wine, a removed file exists until it is closed")
def test_fit_without_its_model_shows_its_numbers(fit, place, tmp_path):
    path, moved = tmp_path / "decay.fit", place.with_name("moved.fmu")
    fit.save(path)
    dump = pickle.dumps(fit)
    place.rename(moved)
    try:
        for loaded in (load_fit(path), pickle.loads(dump)):
            assert_same(loaded, fit)
            with pytest.raises(FileNotFoundError, match=r"decay\.fmu.*SHA-256 [0-9a-f]{64}.*no longer exists"):
                loaded.simulate()
            with pytest.raises(FileNotFoundError, match="decay.fmu"):
                loaded.residuals()
            with pytest.raises((FileNotFoundError, pydfo.FmuError), match="decay.fmu"):
                loaded._calibration.fit()
        shutil.copy(example_fmu("van_der_pol"), place)
        with pytest.raises(FileNotFoundError, match="the file has changed and now has the content"):
            load_fit(path).simulate()
        with pytest.raises(pydfo.BadCalibrationError, match="has changed"):
            load_fit(path, model=place)
        for model in (moved, FMUModel(moved)):
            assert_simulates(load_fit(path, model=model), load_fit(path, model=moved))
        place.unlink()
        with pytest.raises(FileNotFoundError):
            load_fit(path, model=place)
    finally:
        moved.rename(place)
    assert_simulates(load_fit(path), fit)


def test_files_that_are_not_fits_are_rejected(fit, tmp_path):
    path = tmp_path / "a.fit"
    fit.save(path)
    whole = path.read_bytes()
    for content, message in [(b"", "not a saved fit"), (b"k,2", "not a saved fit"), (whole[:500], "truncated"), (whole[:-40], "truncated")]:
        path.write_bytes(content)
        with pytest.raises(pydfo.BadCalibrationError, match=message) as raised:
            load_fit(path)
        assert str(path) in str(raised.value)
    with pytest.raises(pydfo.BadCalibrationError, match="is not a saved fit"):
        load_fit(example_fmu("dahlquist"))
    with pytest.raises(FileNotFoundError, match="none.fit"):
        load_fit(tmp_path / "none.fit")
    with pytest.raises(FileNotFoundError, match="none"):
        fit.save(tmp_path / "none" / "a.fit")
    with pytest.raises(OSError, match="."):
        fit.save(tmp_path)
    with pytest.raises(pydfo.BadCalibrationError, match="is the model itself"):
        fit.save(fit._calibration._model)
    with pytest.raises(TypeError):
        fit.save(3)


@pytest.fixture(scope="module")
def furuta():
    """Returns a fit to the angle of the pendulum over 2 s, without noise."""
    model = FMUModel(example_fmu("furuta"))
    model.set({"armFriction": 0.010, "pendulumFriction": 0.001})
    result = model.simulate(final_time=2, output_interval=0.02)
    data = {"time": result["time"], "phi": result["armJoint.phi"], "theta": result["pendulumJoint.phi"]}
    parameters = [Parameter("armFriction", 0.012, 0, 0.022), Parameter("pendulumFriction", 0.002, 0, 0.012)]
    outputs = {"armJoint.phi": "phi", "pendulumJoint.phi": "theta"}
    return Calibration(example_fmu("furuta"), data, outputs, parameters).fit()


def test_optimum_is_simulated_with_all_variables(furuta, fit):
    compared, every = furuta.simulate(), furuta.simulate(outputs="all")
    assert "pendulumJoint.w" in every and every.units["pendulumJoint.w"] == "rad/s"
    np.testing.assert_array_equal(every["armJoint.phi"], compared["armJoint.phi"])
    one = furuta.simulate(times=[0, 0.5, 1], outputs=["pendulumJoint.w"])
    assert set(one) == {"time", "pendulumJoint.w"} and one["time"].tolist() == [0, 0.5, 1]
    with pytest.raises(KeyError, match="pendulumJoint.w"):
        furuta.simulate(outputs=["pendulumJoint.ww"])
    assert set(fit.simulate(outputs="all")) == {"cold", "hot"}


def test_model_accepts_fitted_values(furuta, fit):
    model = FMUModel(example_fmu("furuta"))
    model.set(furuta.parameters)
    result = model.simulate(final_time=2, output_interval=0.02, solver=furuta.solver)
    np.testing.assert_allclose(result["pendulumJoint.phi"], furuta.simulate()["pendulumJoint.phi"], rtol=1e-6)
    assert furuta.parameters_of() == furuta.parameters
    assert fit.parameters_of("hot") == {"k": fit.parameters["k"], "x": fit.parameters["x[hot]"]}
    with pytest.raises(ValueError, match="a separate value of x.*'cold', 'hot'"):
        fit.parameters_of()
    with pytest.raises(ValueError, match="experiment 'warm' not found; available: cold, hot"):
        fit.parameters_of("warm")
    for arguments in [({"armFriction": 1.0}, 2.0), ("armFriction",)]:
        with pytest.raises(TypeError, match="dict of names and values"):
            model.set(*arguments)


def test_fit_exports_json_csv_and_dataframes(furuta, fit, tmp_path):
    text = furuta.to_json()
    found = json.loads(text, parse_constant=lambda name: pytest.fail(name))
    assert found == furuta.to_dict()
    assert [(p["name"], p["value"]) for p in found["parameters"]] == list(furuta.parameters.items())
    assert (found["cost"], found["rms"], found["n_evaluations"]) == (furuta.cost, furuta.rms, furuta.nfev)
    assert found["parameters"][0]["unit"] == "N.m"
    assert fit.to_dict()["parameters"][0]["upper"] is None  # infinite

    path = tmp_path / "fit.csv"
    fit.to_csv(path)
    rows = list(csv.DictReader(path.open(newline="")))
    assert {row["name"]: float(row["value"]) for row in rows} == fit.parameters
    fit.to_csv(path, what="trajectories")
    rows = list(csv.DictReader(path.open(newline="")))
    residuals = fit.residuals()
    assert [float(row["residual"]) for row in rows] == residuals.tolist()
    np.testing.assert_allclose([float(row["simulated"]) - float(row["measured"]) for row in rows], residuals, atol=1e-15)
    fit.to_csv(path, what="trace")
    rows = list(csv.DictReader(path.open(newline="")))
    assert len(rows) == len(fit.trace)
    assert [float(row["x[hot]"]) for row in rows] == fit.trace.x[:, 2].tolist()
    with pytest.raises(ValueError, match="'parameters', 'trajectories', 'trace'"):
        fit.to_csv(path, what="table")
    pandas = pytest.importorskip("pandas", reason="pandas is not installed")
    frame = fit.to_dataframe("trajectories")
    assert isinstance(frame, pandas.DataFrame) and frame["residual"].tolist() == residuals.tolist()


SSV = "{http://ssp-standard.org/SSP1/SystemStructureParameterValues}"
SSC = "{http://ssp-standard.org/SSP1/SystemStructureCommon}"


def values_of(path):
    """Returns the values of a parameter file."""
    root = ElementTree.parse(path).getroot()
    assert root.tag == f"{SSV}ParameterSet" and root.get("version") == "1.0"
    units = {unit.get("name") for unit in root.iter(f"{SSC}Unit")}
    found = {}
    for parameter in root.find(f"{SSV}Parameters"):
        (value,) = parameter
        assert value.tag == f"{SSV}Real" and value.get("unit") in units | {None}
        found[parameter.get("name")] = float(value.get("value"))
    return found


def test_parameter_files_are_written(furuta, fit, tmp_path):
    path = tmp_path / "fitted.ssv"
    assert furuta.export_ssv(path) == path
    assert values_of(path) == furuta.parameters
    base = ElementTree.parse(path).getroot().find(f"{SSV}Units/{SSC}Unit[@name='N.m']/{SSC}BaseUnit")
    assert base.attrib == {"kg": "1", "m": "2", "s": "-2"}
    fit.export_ssv(path, experiment="cold")
    assert values_of(path) == fit.parameters_of("cold")
    with pytest.raises(ValueError, match="a separate value of x"):
        fit.export_ssv(path)
    with pytest.raises(ValueError, match=r"ends in \.ssv, for example .*fitted\.ssv"):
        furuta.export_ssv(tmp_path / "fitted.xml")
    with pytest.raises(ValueError, match="is a folder"):
        furuta.export_ssv(tmp_path)
    with pytest.raises(FileNotFoundError):
        furuta.export_ssv(tmp_path / "none" / "fitted.ssv")


def test_parameter_file_is_valid_ssv(furuta, tmp_path):
    fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
    etree = pytest.importorskip("lxml.etree", reason="lxml is not installed")
    path = tmp_path / "fitted.ssv"
    furuta.export_ssv(path)
    (schema,) = Path(fmpy.__file__).parent.glob("ssp/schema/**/SystemStructureParameterValues.xsd")
    etree.XMLSchema(etree.parse(str(schema))).assertValid(etree.parse(str(path)))


def test_parameter_file_is_written_when_library_ignores_description(furuta, tmp_path):
    path = tmp_path / "fitted.fmu"
    with pytest.warns(pydfo.CalibrationWarning, match=r"differs from the fit \('.*' by .* at t = .*fitted\.fmu is not written"):
        written = furuta.export_fmu(path)
    assert written == path.with_suffix(".ssv") and not path.exists()
    assert values_of(written) == furuta.parameters
    for wrong, message in [(tmp_path / "fitted.zip", r"ends in \.fmu"), (furuta._calibration._model, "is the model itself")]:
        with pytest.raises(ValueError, match=message):
            furuta.export_fmu(wrong)


def test_exported_fmu_has_fitted_start_values(furuta, fit, tmp_path):
    path = tmp_path / "fitted.fmu"
    with pytest.warns(pydfo.CalibrationWarning, match="correct only in tools that set the start values"):
        assert furuta.export_fmu(path, keep=True) == path
    description = FMUModel(path).description
    assert {name: description.variables[name].start for name in furuta.parameters} == furuta.parameters
    with pytest.warns(pydfo.CalibrationWarning):
        fit.export_fmu(path, experiment="hot", keep=True)
    assert FMUModel(path).description.variables["x"].start == fit.parameters["x[hot]"]
    with pytest.raises(ValueError, match="a separate value of x"):
        fit.export_fmu(path)


def test_exported_fmu_is_accepted_when_values_equal_library_values(tmp_path, recwarn):
    held = [Parameter("k", 1, 0.1, fixed=True)]
    fit = Calibration(example_fmu("dahlquist"), recording(1), "x", held).fit()
    path = tmp_path / "fitted.fmu"
    assert fit.export_fmu(path) == path and path.is_file() and not path.with_suffix(".ssv").exists()
    assert not [w for w in recwarn if issubclass(w.category, pydfo.CalibrationWarning)]


@pytest.mark.parametrize("version, kind", [("1.0", "ME"), ("2.0", "ME"), ("2.0", "CS"), ("3.0", "ME")])
def test_fmpy_simulates_exported_fmu(version, kind, tmp_path):
    fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
    model, path = example_fmu("dahlquist", version, kind), tmp_path / "fitted.fmu"
    fit = Calibration(model, recording(1), "x", Parameter("k", 1, 0.1), kind=kind).fit()
    with pytest.warns(pydfo.CalibrationWarning):
        fit.export_fmu(path, keep=True)
    options = {"stop_time": 1.1, "output_interval": 0.1, "relative_tolerance": 1e-9, "record_events": False, "output": ["x"]}
    ours = fit.simulate(times=T)["x"]
    assert abs(ours[-1] - np.exp(-2 * 1.1)) < 1e-2
    interface = "ModelExchange" if kind == "ME" else "CoSimulation"
    # Like a tool that sets the start values of the description.
    variables = fmpy.read_model_description(str(path)).modelVariables
    starts = {v.name: float(v.start) for v in variables if v.causality == "parameter" or v.name == "k"}
    copy = fmpy.simulate_fmu(str(path), fmi_type=interface, start_values=starts, **options)
    values = values_of(path.with_suffix(".ssv"))
    original = fmpy.simulate_fmu(str(model), fmi_type=interface, start_values=values, **options)
    for theirs in (copy, original):
        np.testing.assert_allclose(theirs["x"], ours, atol=1e-5)


def test_parameters_of_all_kinds_are_restored(tmp_path):
    parameters = [
        Parameter("rate", 1, 0.1, 10, variables=["k"], scale="log", prior=pydfo.LogNormal(2, 1), display_name="rate of decay"),
        Parameter("x", 1, fixed=True),
        Parameter("drift", 0, -0.1, 0.1, offset_of="x", prior=pydfo.Normal(0, 0.01)),
    ]
    calibration = Calibration(example_fmu("dahlquist"), recording(1), "x", parameters)
    fit = calibration.fit(max_evaluations=20)
    path = tmp_path / "sorts.fit"
    fit.save(path)
    loaded = load_fit(path)
    assert loaded._calibration.parameters == calibration.parameters
    assert_same(loaded, fit)
    assert loaded._calibration.cost(fit.x) == calibration.cost(fit.x)
    assert fit.parameters_of() == {"k": fit.parameters["rate"], "x": 1.0}


def test_tied_parameters_and_display_names_are_exported(tmp_path):
    t = np.linspace(0.0, 2.0, 21)
    x = np.exp(-2.0 * t) + 1e-3 * np.sin(40.0 * t)
    parameters = [
        Parameter("k", 1.0, 0.1, 10.0, display_name="rate of decay"),
        Parameter("x", tied_to="k", factor=0.5, display_name="start"),
    ]
    calibration = pydfo.Calibration(pydfo.example_fmu("dahlquist"), {"time": t, "x": x}, "x", parameters)
    fit = calibration.fit()
    fitted, tied = fit.to_dict()["parameters"]
    assert {p["name"]: p["value"] for p in (fitted, tied)} == fit.parameters
    assert (tied["tied_to"], tied["standard_error"]) == ("k", 0.5 * fitted["standard_error"])
    fit.to_csv(tmp_path / "fit.csv")
    rows = list(csv.DictReader((tmp_path / "fit.csv").open(newline="")))
    assert [(row["name"], float(row["value"]), row["tied_to"]) for row in rows] == [("k", fit.x[0], ""), ("x", fit.x[0] / 2, "k")]
    fit.save(tmp_path / "a.fit")
    for shown in (fit, pydfo.load_fit(tmp_path / "a.fit")):
        assert "rate of decay" in str(shown)
        assert "rate of decay" in shown._repr_html_()
        pytest.importorskip("matplotlib", reason="matplotlib is not installed")
        labels = [label.get_text() for label in shown.plot_correlation().axes[0].get_yticklabels()]
        assert labels == ["rate of decay"]


@pytest.mark.parametrize("times, message", [([np.nan], "not a finite"), ([-1.0], "before the start"), ([1.0, 0.5], "times must ascend")])
def test_simulation_rows_of_delayed_outputs_are_checked(times, message):
    t = np.linspace(0.0, 2.0, 21)
    experiment = pydfo.Experiment({"time": t, "x": np.exp(-t)}, "x", delays={"x": 0.1})
    calibration = pydfo.Calibration(pydfo.example_fmu("dahlquist"), experiment, parameters=[Parameter("k", 1.0, 0.1, 10.0)])
    with pytest.raises(ValueError, match=message):
        calibration.simulate([1.0], times)


def test_fit_with_functions_is_loaded_with_them(tmp_path):
    model = example_fmu("quad_tank")
    time = np.arange(0.0, 31.0)
    voltage = lambda t: 5.0 + 0.1 * t  # noqa: E731
    inputs = {"u1": voltage, "u2": 5.0}
    res = FMUModel(model).simulate(times=time, inputs={"u1": voltage, "u2": lambda t: 5.0}, start_values={"qt.a1": 2.7e-6})
    data = {"time": time, "level": res["qt.x1"]}
    fit = Calibration(model, data, {"qt.x1": "level"}, Parameter("qt.a1", 3e-6, 2e-6, 4e-6), inputs=inputs).fit()
    path = tmp_path / "tank.fit"
    fit.save(path)
    for given in ({"u1": voltage}, {"run1": {"u1": voltage}}):
        loaded = load_fit(path, inputs=given, fmu=model)
        assert loaded.x.tobytes() == fit.x.tobytes() and loaded.residuals().tobytes() == fit.residuals().tobytes()
    for given, expected in (
        ({}, r"u1: these inputs are driven by functions of time, which files do not contain. Pass the functions again with load_fit\(..., inputs="),
        ({"u1": voltage, "u3": voltage}, "'u3' is not driven by a function of time; inputs driven by functions: u1"),
    ):
        with pytest.raises(pydfo.BadCalibrationError, match=expected):
            load_fit(path, inputs=given)
    with pytest.raises(TypeError, match="must be a function of time, not 5"):
        load_fit(path, inputs={"u1": 5.0})


def test_report_propagates_input_function_exception(tmp_path):
    time = np.arange(0.0, 11.0)
    works = True

    def voltage(t):
        if not works:
            raise LookupError(f"no voltage at {t}")
        return 5.0

    data = {"time": time, "level": np.full(11, 0.1)}
    parameter = Parameter("qt.a1", 3e-6, 2e-6, 4e-6)
    calibration = Calibration(example_fmu("quad_tank"), data, {"qt.x1": "level"}, parameter, inputs={"u1": voltage, "u2": 5.0})
    fit = calibration.fit(max_evaluations=3, covariance=None)
    works = False
    with pytest.raises(LookupError, match="no voltage at"):
        fit.report(tmp_path / "tank.html")
    with pytest.raises(LookupError, match="no voltage at"):
        fit.to_csv(tmp_path / "tank.csv", "trajectories")


def test_pickled_description_is_complete():
    description = FMUModel(example_fmu("quad_tank")).description
    copy = pickle.loads(pickle.dumps(description))
    assert (copy.model_name, copy.guid, copy.path) == (description.model_name, description.guid, description.path)
    assert list(copy.variables) == list(description.variables) and copy.variables["qt.a1"] == description.variables["qt.a1"]
