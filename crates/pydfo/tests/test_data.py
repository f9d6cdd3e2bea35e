"""Recordings in all supported forms: one calibration with equal costs."""

from __future__ import annotations

import datetime
import hashlib
import json
import os
import pickle
import warnings

import numpy as np
import pytest
import recordings

from pydfo import BadCalibrationError, Calibration, CalibrationWarning, Experiment, FMUModel, Normal, Parameter, example_fmu

TIME = np.arange(0.0, 2.05, 0.05)
X = np.exp(-2.0 * TIME)
#: The cost of k = 1 with these measurements.
COST = Calibration(example_fmu("dahlquist"), {"time": TIME, "x": X}, ["x"], [Parameter("k", 1.0, 0.1, 10.0)]).cost([1.0])


def cost(data, column="x", **options):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        calibration = Calibration(example_fmu("dahlquist"), data, {"x": column}, [Parameter("k", 1.0, 0.1, 10.0)], **options)
    return calibration.cost([1.0])


def dates():
    return np.datetime64("2024-05-31T23:59:59") + (TIME * 1e3).round().astype("timedelta64[ms]")


def in_memory():
    pd = pytest.importorskip("pandas")
    structured = np.empty(TIME.size, [("time", float), ("x", np.float32)])
    structured["time"], structured["x"] = TIME, X
    yield "dict of lists", {"time": TIME.tolist(), "x": X.tolist()}, {}
    yield "structured", structured, {}
    yield "masked", {"time": TIME, "x": np.ma.masked_array(X, mask=False)}, {}
    yield "unit in the name", {"Time [ms]": TIME * 1e3, "x (1)": X}, {}
    yield "datetime64", {"time": dates(), "x": X}, {}
    yield "datetime", {"when": dates().astype("datetime64[us]").tolist(), "x": X}, {"time": "when"}
    yield "texts", {"time": [str(t) for t in dates()], "x": X}, {}
    yield "timedelta", {"time": [datetime.timedelta(seconds=float(t)) for t in TIME], "x": X}, {}
    yield "DataFrame", pd.DataFrame({"time": TIME, "x": X}), {}
    yield "DatetimeIndex", pd.DataFrame({"x": X}, index=pd.DatetimeIndex(dates())), {}
    yield "time zone", pd.DataFrame({"x": X}, index=pd.DatetimeIndex(dates()).tz_localize("Europe/Stockholm")), {}
    yield "time zone in a column", pd.DataFrame({"time": pd.Series(dates()).dt.tz_localize("UTC"), "x": X}), {}
    yield "Series", pd.Series(X, index=TIME, name="x"), {}
    yield "two lines of names", pd.DataFrame({("time", "ms"): TIME * 1e3, ("x", "Unnamed: 1"): X}), {}
    yield "objects", pd.DataFrame({"time": TIME, "x": X}, dtype=object), {}


@pytest.mark.parametrize(("shape", "data", "options"), [pytest.param(*one, id=one[0]) for one in in_memory()])
def test_tables_in_memory_are_read(shape, data, options):
    # 32-bit floats and rounded durations cause small differences
    assert cost(data, **options) == pytest.approx(COST, rel=1e-6)


def test_polars_and_xarray_are_read():
    pl = pytest.importorskip("polars")
    assert cost(pl.DataFrame({"time": TIME, "x": X})) == COST
    assert cost(pl.DataFrame({"time": dates(), "x": X})) == pytest.approx(COST, rel=1e-12)
    xr = pytest.importorskip("xarray")
    array = xr.DataArray(X, coords={"time": ("time", TIME * 1e3, {"units": "ms"})}, dims="time", name="x")
    assert cost(array) == pytest.approx(COST, rel=1e-12)
    assert cost(array.to_dataset()) == pytest.approx(COST, rel=1e-12)


def test_missing_values_are_ignored():
    holes = X.copy()
    holes[3] = np.nan
    expected = cost({"time": TIME, "x": holes})
    assert expected < COST
    assert cost({"time": TIME, "x": np.ma.masked_array(X, mask=np.isnan(holes))}) == expected
    assert cost({"time": TIME, "x": [None if np.isnan(x) else x for x in holes]}) == expected


def write_mat(folder):
    io = pytest.importorskip("scipy.io")
    path = folder / "run.MAT"
    values = {"time": TIME, "x": X[:, None], "Y": np.stack((X, 2 * X), axis=1), "note": "run 3", "gain": 3.0, "rig": {"x": X, "id": 7}}
    io.savemat(path, values)
    return path


def write_mat73(folder):
    h5py = pytest.importorskip("h5py")
    path = folder / "run73.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["time"], file["x"], file["Y"] = TIME[None, :], X[None, :], np.stack((X, 2 * X))
        file["rig/x"] = X[None, :]
        file["note"] = np.array([114, 117, 110], dtype=np.uint16)
        file["note"].attrs["MATLAB_class"] = np.bytes_("char")
        file["#refs#/a"] = X
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")
    return path


@pytest.mark.parametrize("write", [write_mat, write_mat73])
def test_matlab_files_are_read(tmp_path, write):
    path = write(tmp_path)
    for column in ("x", "Y[1]", "rig.x"):
        assert cost(path, column) == COST
    with pytest.raises(BadCalibrationError, match=r"column 'y' not found; available: .*rig.*") as error:
        cost(path, "y")
    assert "'Y[2]'" in str(error.value) and "note" not in str(error.value)
    with pytest.raises(BadCalibrationError, match="column 't' not found"):
        cost(path, time="t")


def test_columns_of_different_lengths_are_listed(tmp_path):
    with pytest.raises(
        BadCalibrationError,
        match=r"column 'gain' not found.*Ignored, because their length differs from the times: rig \(a struct: rig.field\), gain \(1 x 1\)",
    ):
        cost(write_mat(tmp_path), "gain")


def write_excel(folder):
    book = pytest.importorskip("openpyxl").Workbook()
    sheet = book.active
    sheet.append(["Time", "x", "note"])
    sheet.append(["ms", "1", None])
    for t, x in zip(TIME, X):
        sheet.append([1e3 * float(t), float(x), "ok"])
    sheet.append([None, None, None])
    book.save(folder / "run.xlsx")
    return folder / "run.xlsx"


def write_excel_with_dates(folder):
    book = pytest.importorskip("openpyxl").Workbook()
    book.active.append(["when", "x [1]"])
    for t, x in zip(dates().astype("datetime64[us]").tolist(), X):
        book.active.append([t, float(x)])
    book.save(folder / "dates.xlsx")
    return folder / "dates.xlsx"


def write_parquet(folder):
    pd = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    pd.DataFrame({"time": dates(), "x": X}).to_parquet(folder / "run.parquet")
    return folder / "run.parquet"


@pytest.mark.parametrize(("write", "time"), [(write_excel, None), (write_excel_with_dates, "when"), (write_parquet, None)])
def test_excel_and_parquet_files_are_read(tmp_path, write, time):
    assert cost(write(tmp_path), time=time) == pytest.approx(COST, rel=1e-9)


def write_csv(folder):
    (folder / "run.csv").write_text("time,x\n" + "".join(f"{t!r},{x!r}\n" for t, x in zip(TIME.tolist(), X.tolist())))
    return folder / "run.csv"


@pytest.mark.parametrize("write", [write_csv, write_excel, write_mat, write_parquet])
def test_fit_records_hash_of_data_file(tmp_path, write):
    path = write(tmp_path)
    fit = Calibration(example_fmu("dahlquist"), path, ["x"], [Parameter("k", 1, 0, 5)]).fit()
    recorded = json.loads(fit.to_json())["problem"]["experiments"][0]["data"]
    assert recorded["file_sha256"] == hashlib.sha256(path.read_bytes()).hexdigest() and recorded["source"] == str(path)


@pytest.mark.parametrize("file", [".mat", ".parquet", ".xlsx"])
def test_files_with_wrong_format_are_rejected(tmp_path, file):
    pytest.importorskip({".mat": "scipy", ".parquet": "pyarrow", ".xlsx": "openpyxl"}[file])
    path = tmp_path / f"run{file}"
    with pytest.raises(FileNotFoundError):
        cost(path)
    path.write_bytes(b"time,x\n0,1\n")
    with pytest.raises(BadCalibrationError, match=r"run\..*the file is not an? .*file|the file is not an Excel workbook"):
        cost(path)


@pytest.mark.parametrize("write", [write_mat, write_mat73])
def test_matlab_file_that_crashes_its_reader_is_rejected(tmp_path, monkeypatch, write):
    path = write(tmp_path)
    monkeypatch.setattr("pydfo._calibration.data_files._RUN", "import os; os._exit(139)")
    with pytest.raises(BadCalibrationError, match=r"run.*or it is damaged: the reader process ended with code 139"):
        cost(path)


def test_damaged_matlab_files_never_end_python(tmp_path):
    path = write_mat(tmp_path)
    whole = path.read_bytes()
    rng = np.random.default_rng(3)
    for _ in range(4):
        damaged = bytearray(whole)
        damaged[rng.integers(128, 400)] = rng.integers(256)
        path.write_bytes(damaged)
        try:
            assert cost(path) >= 0
        except (BadCalibrationError, MemoryError):
            pass


@pytest.mark.parametrize(("file", "module", "package"), [(".mat", "scipy.io", "scipy"), (".xlsx", "openpyxl", "openpyxl")])
def test_missing_library_is_named(tmp_path, monkeypatch, file, module, package):
    path = tmp_path / f"run{file}"
    path.write_bytes(b"?" * 200)
    monkeypatch.setitem(__import__("sys").modules, module, None)
    with pytest.raises(ImportError, match=f"requires {package}; install it with pip install {package}"):
        cost(path)


def book_of_two(folder):
    """Returns a workbook with the sheets cold and warm, and an empty sheet."""
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.title = "cold"
    for name, scale in (("cold", 1.0), ("warm", 3.0)):
        sheet = book["cold"] if name == "cold" else book.create_sheet(name)
        for row in [("time", "x"), *zip(TIME.tolist(), (scale * X).tolist())]:
            sheet.append(row)
    book.create_sheet("empty")
    book.save(folder / "two.xlsx")
    return folder / "two.xlsx"


def test_sheet_selects_a_sheet_of_a_workbook(tmp_path):
    path = book_of_two(tmp_path)
    assert cost(path, sheet="cold") == pytest.approx(COST)
    assert cost(path, sheet="warm") == pytest.approx(cost({"time": TIME, "x": 3 * X}))
    with pytest.warns(CalibrationWarning, match=r"several sheets: 'cold', 'warm'. The first one is read") as caught:
        Calibration(example_fmu("dahlquist"), path, ["x"], [Parameter("k", 1.0, 0.1, 10.0)])
    assert len(caught) == 1
    with pytest.raises(BadCalibrationError, match="sheet 'hot' not found; expected one of: 'cold', 'warm', 'empty'"):
        cost(path, sheet="hot")


def test_of_sheets_returns_one_experiment_per_sheet(tmp_path):
    runs = Experiment.of_sheets(book_of_two(tmp_path), ["x"])
    calibration = Calibration(example_fmu("dahlquist"), runs, [Parameter("k", 1.0, 0.1, 10.0)])
    assert [run.name for run in runs] == ["cold", "warm"]
    assert calibration.cost([1.0]) == pytest.approx(COST + cost({"time": TIME, "x": 3 * X}))


def test_hdf5_tables_are_read_through_pandas(tmp_path):
    pd = pytest.importorskip("pandas")
    pytest.importorskip("tables")
    path = tmp_path / "run.h5"
    pd.DataFrame({"time": TIME, "x": X}).to_hdf(path, key="cold")
    assert cost(path) == COST
    pd.DataFrame({"x": 3 * X}, index=pd.Index(TIME, name="time")).to_hdf(path, key="warm")
    assert cost(path, sheet="warm") == cost({"time": TIME, "x": 3 * X})
    with pytest.raises(BadCalibrationError, match="several tables; specify one with sheet=, expected one of: 'cold', 'warm'"):
        cost(path)
    with pytest.raises(BadCalibrationError, match="table 'hot' not found"):
        cost(path, sheet="hot")


def test_hdf5_without_pytables_states_how_to_install_it(tmp_path, monkeypatch):
    pytest.importorskip("pandas")
    path = tmp_path / "run.hdf"
    path.write_bytes(b"?" * 200)
    monkeypatch.setitem(__import__("sys").modules, "tables", None)
    with pytest.raises(ImportError, match="requires PyTables; install it with pip install tables"):
        cost(path)


@pytest.mark.parametrize("first", [0.0, 90000.0])
def test_csv_with_durations_of_pandas_is_read(tmp_path, first):
    pd = pytest.importorskip("pandas")
    durations = pd.to_timedelta(TIME + first, unit="s").round("ms")
    pd.DataFrame({"x": X}, index=durations).to_csv(tmp_path / "run.csv", index_label="time")
    assert " days " in (tmp_path / "run.csv").read_text()
    assert cost(tmp_path / "run.csv", start_time=first) == pytest.approx(COST, rel=1e-6)


@pytest.mark.parametrize(
    ("cell", "said"),
    [
        ("-0 days 00:00:12", "-1 days \\+23:59:48 is -12 s"),
        ("2016-12-31T23:59:60Z", "line 2.*seconds go from 0 to 59; remove rows with a leap second"),
    ],
)
def test_ambiguous_times_are_rejected(tmp_path, cell, said):
    (tmp_path / "run.csv").write_text(f"time,x\n{cell},1\n")
    with pytest.raises(BadCalibrationError, match=said):
        cost(tmp_path / "run.csv")


def test_csv_with_dates_of_matlab_is_read(tmp_path):
    """`writetable` writes a datetime as 31-May-2024 23:59:59, and with other display formats its milliseconds."""
    texts = [when.astype("datetime64[us]").item().strftime("%d-%b-%Y %H:%M:%S.%f")[:-3] for when in dates()]
    (tmp_path / "run.csv").write_text("time,x\n" + "".join(f"{when},{x!r}\n" for when, x in zip(texts, X.tolist())))
    assert cost(tmp_path / "run.csv") == pytest.approx(COST, rel=1e-6)
    (tmp_path / "run.csv").write_text("time,x\n31-Mai-2024 10:00:00,1\n")
    with pytest.raises(BadCalibrationError, match="expected a date such as 31-May-2024"):
        cost(tmp_path / "run.csv")


def test_pandas_csv_with_unnamed_index_suggests_index_label(tmp_path):
    pd = pytest.importorskip("pandas")
    frame = pd.DataFrame({"x": X}, index=TIME)
    frame.to_csv(tmp_path / "run.csv")
    with pytest.raises(BadCalibrationError, match=r'the first column has no name, .* write index_label="time" in to_csv'):
        cost(tmp_path / "run.csv")
    frame.to_csv(tmp_path / "run.csv", index_label="time")
    assert cost(tmp_path / "run.csv") == pytest.approx(COST)


def test_unnamed_index_of_several_columns_is_named_in_the_error():
    pd = pytest.importorskip("pandas")
    frame = pd.DataFrame({"x": X, "z": X}, index=TIME)
    with pytest.raises(BadCalibrationError, match=r"column 'time' not found; .* name it: frame.rename_axis\('time'\)"):
        cost(frame)
    assert cost(frame.rename_axis("time")) == pytest.approx(COST)
    with pytest.raises(BadCalibrationError, match="column 'time' not found") as caught:
        cost(frame.reset_index(drop=True))
    assert "rename_axis" not in str(caught.value)


def test_weight_may_be_missing_where_the_measurement_is():
    x, w = X.copy(), np.full(41, 2.0)
    x[3], w[3] = np.nan, np.nan
    assert cost({"time": TIME, "x": x}, weights={"x": w}) == cost({"time": TIME, "x": x}, weights={"x": 2.0})
    assert cost({"time": TIME, "x": x, "w": w}, weights={"x": "w"}) == cost({"time": TIME, "x": x}, weights={"x": 2.0})
    with pytest.raises(BadCalibrationError, match="weight NaN of output 'x' at time 0.15"):
        cost({"time": TIME, "x": X}, weights={"x": w})


def test_scale_weights_one_output():
    data = {"time": TIME, "x": X, "der": -2 * X}
    calibration = Calibration(example_fmu("dahlquist"), data, {"x": "x", "der(x)": "der"}, [Parameter("k", 1.0, 0.1, 10.0)], weights={"x": "range"})
    r = calibration.residuals([1.0])
    assert r[:41] == pytest.approx((np.exp(-TIME) - X) / np.ptp(X), abs=1e-5)
    assert r[41:] == pytest.approx(-np.exp(-TIME) + 2 * X, abs=1e-5)


def replicates(seed, n=3, misfit=0.0):
    """Returns n measurements of the decay at each of 10 times, with noise 0.01 and a misfit."""
    t = np.repeat(np.linspace(0.0, 2.0, 10), n)
    noise = 0.01 * np.random.default_rng(seed).standard_normal(t.size)
    return {"time": t, "x": np.exp(-2.0 * t) + misfit * np.sin(5 * t) + noise}


def test_replicates_are_compared_one_by_one_and_tested_for_lack_of_fit():
    data = replicates(1)
    calibration = Calibration(example_fmu("dahlquist"), data, ["x"], [Parameter("k", 1.0, 0.1, 10.0)])
    assert calibration.residuals([2.0]) == pytest.approx(np.exp(-2 * data["time"]) - data["x"], abs=1e-5)
    fit = calibration.fit()
    groups = data["x"].reshape(10, 3)
    pure = ((groups - groups.mean(axis=1, keepdims=True)) ** 2).sum()
    f = (fit.cost - pure) / 9 / (pure / 20)
    assert f"the lack of fit is F(9, 20) = {f:.4g} (p = " in str(fit)
    assert "F067" not in {finding.id for finding in fit.findings if finding.severity == "warning"}
    wrong = Calibration(example_fmu("dahlquist"), replicates(1, misfit=0.03), ["x"], [Parameter("k", 1.0, 0.1, 10.0)]).fit()
    assert "F067" in {finding.id for finding in wrong.findings if finding.severity == "warning"}


def test_standard_errors_of_replicates_cover_the_true_value():
    z = []
    for seed in range(30):
        fit = Calibration(example_fmu("dahlquist"), replicates(seed), ["x"], [Parameter("k", 1.5, 0.1, 10.0)]).fit()
        z.append((fit.x[0] - 2.0) / fit.stderr[0])
    assert 0.6 < np.std(z) < 1.4


def test_duplicate_rows_are_reported():
    data = {"time": [0.0, 1.0, 1.0, 2.0], "x": [1.0, 0.1, 0.1, 0.02]}
    with pytest.warns(CalibrationWarning, match="rows with the time and all measured values of the row before: 1, the first at 1 s"):
        Calibration(example_fmu("dahlquist"), data, ["x"], [Parameter("k", 1.0, 0.1, 10.0)])


def test_factor_scales_an_output_and_an_input():
    data = {"time": TIME, "x": 3 * X + 0.5}
    scale, zero = Parameter("scale", 1.0, 0.1, 10.0, factor_of="x"), Parameter("zero", 0.0, -1.0, 1.0, offset_of="x")
    calibration = Calibration(example_fmu("dahlquist"), data, ["x"], [Parameter("k", 1.0, 0.1, 10.0), scale, zero])
    assert calibration.residuals([2.0, 1.5, 0.25]) == pytest.approx(1.5 * X + 0.25 - data["x"], abs=1e-5)
    assert calibration.fit().x == pytest.approx([2.0, 3.0, 0.5], rel=1e-3)
    t = np.linspace(0.0, 3.0, 31)
    # x' = (2 gain - x) / T
    recorded = {"time": t, "x": 2 * 1.5 * (1 - np.exp(-2 * t)), "u": np.ones(31)}
    gain = Parameter("gain", 1.0, 0.1, 10.0, factor_of="u")
    driven = Calibration(example_fmu("switched_input"), recorded, ["x"], [Parameter("T", 0.4, 0.1, 2.0), gain], inputs=["u"])
    assert driven.fit().x == pytest.approx([0.5, 1.5], rel=1e-3)
    with pytest.raises(ValueError, match="is a factor, which has no unit"):
        Parameter("gain", 1.0, 0.1, 10.0, factor_of="u", unit="V")


@pytest.mark.parametrize(
    ("data", "options", "message"),
    [
        ({"t": TIME, "x": X}, {}, r"column 'time' not found; available: 't', 'x'\. Specify the column of the times"),
        ({"time": TIME, "X": X}, {}, r"column 'x' not found; available: 'time', 'X'. Did you mean 'X'\?"),
        ({"time": TIME, "x": X[:5]}, {}, "column 'x' has 5 values, but 'time' has 41"),
        ({"time": TIME[::-1], "x": X}, {}, "times must ascend"),
        ({"time": np.zeros(41), "x": X}, {}, "all 41 rows have the time 0"),
        ({"time": TIME, "x": np.full(41, np.nan)}, {}, "all 41 values of column 'x'"),
        ({"time": TIME, "x": np.where(TIME < 1, X, np.inf)}, {}, "column 'x' is infinite or above 1.8e308 at time 1"),
        ({"time": TIME, "x": [10**400] * 41}, {}, "a number in column 'x', row 0, exceeds the largest number 1.8e308"),
        ({"time": TIME, "x": ["1,5" * 10**6] * 41}, {}, "^.{1,300}$"),
        ({"time": TIME, "x": ["1,5"] * 41}, {}, "'1,5' in column 'x', row 0, is not a number"),
        ({"time": ["soon"] * 41, "x": X}, {}, "row 0: 'soon' is neither a number nor a date"),
        ({"time": TIME, "x": dates()}, {}, "column 'x' contains dates or durations, not measurements"),
        ({"time [kg]": TIME, "x": X}, {}, "unit 'kg' is not a unit of time; expected s, ms"),
        ({"time [ms]": dates(), "x": X}, {}, "remove the unit from its name"),
        ({"time": TIME, "x [1]": X, "x [%]": X}, {}, r"several columns are named 'x': 'x \[1\]', 'x \[%\]'"),
        ({"time": TIME, "x": np.stack((X, X))}, {}, r"column 'x' must be one-dimensional, not of shape \(2, 41\)"),
        ({"time": TIME, "x": X}, {"window": (5, 6)}, "no time of data is in the window from 5 to 6. The times range from 0 to 2"),
        ("run.ods", {}, r"run\.ods: \.ods files are not supported; expected CSV, \.mat, \.parquet, \.xlsx or \.h5"),
        ({"time": TIME, "x": X}, {"sheet": "a"}, r"sheet = 'a' requires a workbook \(\.xlsx\)"),
    ],
)
def test_errors_state_their_position(data, options, message):
    with pytest.raises(BadCalibrationError, match=message):
        cost(data, **options)


def test_arrays_without_names_are_rejected():
    with pytest.raises(TypeError, match=r"columns have no names; use a dict such as \{'time': t, 'y': y\}"):
        cost(np.stack((TIME, X)))


def test_unconverted_units_are_reported():
    with pytest.warns(CalibrationWarning, match=r"'x \[mm\]' is used in the unit of 'x' without conversion: the model declares no unit"):
        Calibration(example_fmu("dahlquist"), {"time": TIME, "x [mm]": X}, ["x"], [Parameter("k", 1.0, 0.1, 10.0)])


def test_columns_are_converted_to_the_units_of_the_model():
    frictions = [Parameter("armFriction", 0.012, 0, 0.022)]
    outputs = {"armJoint.phi": "phi", "pendulumJoint.phi": "theta"}
    radians = recordings.furuta("own")
    furuta = Calibration(example_fmu("furuta"), radians, outputs, frictions)
    degrees = {"Time (ms)": radians["time"] * 1e3, "phi [deg]": np.degrees(radians["phi"]), "theta": radians["theta"]}
    converted = Calibration(example_fmu("furuta"), degrees, outputs, frictions)
    assert converted.cost([0.011]) == pytest.approx(furuta.cost([0.011]), rel=1e-9)
    with pytest.raises(BadCalibrationError, match=r"'phi \[mm\]' belongs to 'armJoint.phi', but 'mm' \(m\) cannot be converted to 'rad'"):
        Calibration(example_fmu("furuta"), {"time": radians["time"], "phi [mm]": radians["phi"]}, {"armJoint.phi": "phi"}, frictions)


def test_published_recordings_are_read():
    if not (recordings.PUBLISHED / "FurutaData.mat").is_file():
        pytest.skip("the published recordings are not at hand")
    pytest.importorskip("scipy")
    outputs = {"armJoint.phi": "phi", "pendulumJoint.phi": "theta"}
    frictions = [Parameter("armFriction", 0.012, 0, 0.022), Parameter("pendulumFriction", 0.002, 0, 0.012)]
    furuta = Calibration(example_fmu("furuta"), recordings.PUBLISHED / "FurutaData.mat", outputs, frictions)
    assert furuta.cost([0.012, 0.002]) == pytest.approx(207.0783, abs=0.01)
    tank = Experiment(recordings.PUBLISHED / "qt_par_est_data.mat", {"qt.x1": "y1_f"}, {"u1": "u1_d", "u2": "u2_d"}, time="t", window=(60, 120))
    assert len(tank.table) == 12001


def write_csv(folder):
    (folder / "run.csv").write_text("time,x\n" + "".join(f"{t},{x}\n" for t, x in zip(TIME, X)))
    return folder / "run.csv"


def write_far(folder):
    book = pytest.importorskip("openpyxl").Workbook()
    for row in [["time", "x"], *zip(TIME.tolist(), X.tolist())]:
        book.active.append(row)
    book.active["XFD1048576"] = "far away"
    book.save(folder / "far.xlsx")
    return folder / "far.xlsx"


def test_distant_cell_is_ignored(tmp_path):
    assert cost(write_far(tmp_path)) == pytest.approx(COST, rel=1e-12)


@pytest.mark.parametrize("write", [write_mat, write_mat73, write_parquet])
def test_oversized_columns_are_rejected_before_reading(tmp_path, monkeypatch, write):
    path = write(tmp_path)
    monkeypatch.setattr("os.path.getsize", lambda path: 0)
    # Only the required columns count.
    monkeypatch.setattr("pydfo._calibration.data_files.MOST_BYTES", 2 * 8 * TIME.size)
    assert cost(path) == pytest.approx(COST, rel=1e-9)
    monkeypatch.setattr("pydfo._calibration.data_files.MOST_BYTES", 2 * 8 * TIME.size - 1)
    with pytest.raises(MemoryError, match=r"the required columns have 82 values, which require 656 bytes, more than 655"):
        cost(path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes")
@pytest.mark.parametrize("file", [".csv", ".mat", ".parquet", ".xlsx"])
def test_named_pipes_are_rejected(tmp_path, file):
    os.mkfifo(tmp_path / f"run{file}")
    with pytest.raises(OSError, match="not a regular file"):
        cost(tmp_path / f"run{file}")


def test_experiments_are_copied_with_their_recordings(tmp_path):
    for data in ({"time": TIME, "x": X}, write_csv(tmp_path)):
        one = Experiment(data, ["x"])
        other = pickle.loads(pickle.dumps(one))
        assert other == one and repr(other) == repr(one)
        assert Calibration(example_fmu("dahlquist"), [other], [Parameter("k", 1.0, 0.1, 10.0)]).cost([1.0]) == pytest.approx(COST)


def test_clock_changes_are_reported():
    night = np.datetime64("2024-03-31T00:00:00") + 600 * np.arange(30)
    moved = np.where(night >= np.datetime64("2024-03-31T02:00:00"), night + 3600, night)
    x = np.ones(30)
    for times in (moved, moved.astype("datetime64[us]").tolist(), [str(t) for t in moved]):
        with pytest.warns(CalibrationWarning, match="between 2024-03-31T01:50:00 and 2024-03-31T03:00:00 an hour is missing, as if the clock"):
            Calibration(example_fmu("dahlquist"), {"time": times, "x": x}, ["x"], [Parameter("k", 1.0, 0.1, 10.0)])
    back = np.where(night >= np.datetime64("2024-03-31T03:00:00"), night - 3600, night)
    with pytest.raises(BadCalibrationError, match="between 2024-03-31T02:50:00 and 2024-03-31T02:00:00 an hour is doubled"):
        cost({"time": back, "x": x})


def test_mask_selects_rows():
    keep = TIME < 1
    expected = cost({"time": TIME, "x": np.where(keep, X, np.nan)})
    assert cost({"time": TIME, "x": X}, mask=keep) == expected
    assert cost({"time": TIME, "x": X, "valid": keep}, mask="valid") == expected
    assert cost({"time": TIME, "x": X}, mask=keep.tolist()) == expected
    with pytest.raises(BadCalibrationError, match="the mask has 3 entries, but the table has 41 rows"):
        cost({"time": TIME, "x": X}, mask=[True] * 3)
    with pytest.raises(BadCalibrationError, match="the mask excludes all rows"):
        cost({"time": TIME, "x": X}, mask=np.zeros(41, dtype=bool))
    with pytest.raises(TypeError, match="mask must be one True or False per row"):
        cost({"time": TIME, "x": X}, mask=[0, 1])
    with pytest.raises(BadCalibrationError, match="column 'good' not found"):
        cost({"time": TIME, "x": X}, mask="good")


def test_resampling_averages_rows():
    by_hand = {"time": TIME[:40].reshape(-1, 4).mean(axis=1), "x": X[:40].reshape(-1, 4).mean(axis=1)}
    assert cost({"time": TIME[:40], "x": X[:40]}, resample=0.2) == pytest.approx(cost(by_hand), rel=1e-9)
    with pytest.raises(BadCalibrationError, match="resample = 0.01 s is shorter than the row spacing of 0.05"):
        cost({"time": TIME, "x": X}, resample=0.01)
    with pytest.raises(BadCalibrationError, match="output 'x' has 11 weights for 41 rows of data before resampling"):
        cost({"time": TIME, "x": X}, resample=0.2, weights={"x": np.full(11, 2.0)})


def tank(data, **options):
    parameters = [Parameter("qt.a1", 3e-6, 2e-6, 4e-6), Parameter("qt.a2", 3e-6, 2e-6, 4e-6)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CalibrationWarning)
        return Calibration(example_fmu("quad_tank"), data, ["qt.x1", "qt.x2"], parameters, **{"inputs": ["u1", "u2"], **options})


@pytest.mark.parametrize(
    ("change", "options", "expected"),
    [
        (lambda d: d | {"qt.x1": 1e3 * d["qt.x1"]}, {}, r"'qt.x1'.* differ by a factor of about .* in another unit"),
        (lambda d: d | {"time": 1e3 * d["time"]}, {}, "The times are probably in ms"),
        (lambda d: d | {"time": 100 + d["time"]}, {"start_time": 0.0, "hold_inputs": True}, "first row is at 100 s, but the simulation starts"),
        (lambda d: {k: v for k, v in d.items() if k != "u2"}, {"inputs": ["u1"]}, "input 'u2': the input is not driven"),
    ],
)
def test_check_reports_mistakes(change, options, expected):
    check = tank(change(recordings.quad_tank("own")), **options).check()
    assert check and not check.ok
    assert any(__import__("re").search(expected, f"{f.subject}: {f.sentence}") for f in check), str(check)
    assert all(f.severity in ("warning", "note") for f in check) and "warning" in str(check) and check.n_evaluations >= 1


@pytest.mark.parametrize("which", recordings.at_hand("qt_par_est_data.mat"))
def test_check_accepts_sound_recordings(which):
    check = tank(recordings.quad_tank(which)).check()
    # The check is true if it contains findings, as every sequence; notes are not mistakes.
    assert check.ok and bool(check) == (len(check) > 0) and {f.severity for f in check} <= {"note"}, str(check)
    assert {f.id for f in check} <= {"F044", "F065"} and tuple(check) == check[:], str(check)
    outputs = {"armJoint.phi": "phi", "pendulumJoint.phi": "theta"}
    frictions = [Parameter("armFriction", 0.012, 0, 0.022), Parameter("pendulumFriction", 0.002, 0, 0.012)]
    assert Calibration(example_fmu("furuta"), recordings.furuta(which), outputs, frictions).check().ok
    exhaust = Calibration(
        example_fmu("exhaust"),
        recordings.exhaust(which),
        ["T_out"],
        [Parameter("C2", 9000, 1, 50e3), Parameter("G2", 80, 1, 500)],
        recordings.EXHAUST_INPUTS,
    )
    assert (check := exhaust.check()).ok, str(check)


def test_recordings_are_plotted():
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    figure = tank(recordings.quad_tank("own"), window=(10, 50)).plot_data()
    axes = figure.axes
    assert [axis.get_ylabel() for axis in axes] == ["qt.x1 [m]", "qt.x2 [m]", "u1 [V]", "u2 [V]"]
    assert axes[-1].get_xlabel() == "time [s]" and len(axes[0].patches) == 2 and not axes[2].patches
    matplotlib.pyplot.close(figure)


@pytest.mark.parametrize(
    ("zone", "start"), [("Europe/Berlin", "2024-03-31T00:00"), ("Europe/Berlin", "2024-10-27T00:00"), ("America/New_York", "2024-11-03T05:30")]
)
def test_datetimes_with_a_zone_are_converted_to_utc_when_clocks_change(zone, start):
    """Python subtracts datetimes of one zone by the wall clock: an hour would be missing or doubled."""
    zoneinfo = pytest.importorskip("zoneinfo")
    first = datetime.datetime.fromisoformat(start).replace(tzinfo=datetime.timezone.utc)
    utc = [first + datetime.timedelta(minutes=15 * k) for k in range(12)]
    local = [time.astimezone(zoneinfo.ZoneInfo(zone)) for time in utc]
    assert len({time.utcoffset() for time in local}) == 2
    x = np.exp(-1e-5 * 900.0 * np.arange(12))

    def fitted(times):
        return Calibration(example_fmu("dahlquist"), {"time": times, "x": x}, ["x"], [Parameter("k", 1e-5, 1e-8, 1.0)]).fit().x[0]

    for times in (local, np.array(local, dtype=object), utc):
        assert fitted(times) == pytest.approx(1e-5, rel=1e-6)
    with pytest.raises(BadCalibrationError, match=r"the date in row 1, .* has no time zone, but the date in row 0, .*, has one"):
        fitted([local[0], *(time.replace(tzinfo=None) for time in local[1:])])


def averaged(weights, resample, sigma=0.1, **more):
    """Returns the offset of a decay with a prior, which has a closed form for all rows."""
    n = 400
    times = np.linspace(0.0, 2.0, n)
    noise = sigma * np.random.default_rng(3).standard_normal(n)
    data = {"time": times, "x": np.exp(-times) + 0.03 + noise, "w": np.full(n, 1 / sigma), **more}
    offset = Parameter("off", 0.0, -1, 1, offset_of="x", prior=Normal(0.0, 0.01))
    fit = Calibration(example_fmu("dahlquist"), data, ["x"], [offset], start_values={"k": 1.0}, weights={"x": weights}, resample=resample).fit(
        x_tol=1e-9
    )
    of_all = n / sigma**2
    return fit, np.mean(data["x"] - np.exp(-times)) * of_all / (of_all + 1e4), (of_all + 1e4) ** -0.5


@pytest.mark.parametrize("weights", [10.0, "w", np.full(400, 10.0)], ids=["number", "column", "rows"])
@pytest.mark.parametrize("resample", [None, 0.05, 0.2])
def test_resampled_means_have_combined_weights(weights, resample):
    fit, expected, error = averaged(weights, resample)
    # The mean of a decay over an interval differs from its middle value by interval^2 / 24.
    assert fit.x[0] == pytest.approx(expected, abs=(resample or 0.0) ** 2 / 24 + 1e-6)
    # The standard error uses the residual variance, whose square root n means determine with the relative error 1 /
    # sqrt(2 n).
    n = 400 if resample is None else round(2.0 / resample) + 1
    assert fit.uncertainty.stderr[0] == pytest.approx(error, rel=2.0 / np.sqrt(2 * n))


def test_rows_without_weight_are_not_averaged_when_resampled():
    times = np.linspace(0.0, 2.0, 400)
    wrong = np.where(np.arange(400) % 7 == 3, 50.0, 0.0)
    data = {"time": times, "x": np.exp(-times) + wrong, "ok": (wrong == 0.0).astype(float)}
    for options in ({"weights": {"x": "ok"}}, {"weights": {"x": wrong == 0.0}}, {"mask": "ok"}):
        calibration = Calibration(example_fmu("dahlquist"), data, ["x"], [Parameter("k", 1.2, 0.1, 10.0)], resample=0.1, **options)
        fit = calibration.fit()
        assert fit.x[0] == pytest.approx(1.0, abs=2e-3) and calibration.n_measurements == 21


def test_boolean_inputs_keep_their_changes_when_resampled():
    """x' = (enabled ? u : 0) would be driven by 0.5 in the interval of the change."""
    times = np.linspace(0.0, 2.0, 201)
    enabled = (times >= 0.555) & (times < 1.305)
    model = FMUModel(example_fmu("switched_input"))
    inputs = {"time": times, "u": np.ones(201), "enabled": enabled}
    x = model.simulate(0, 2, times=times, inputs=inputs, outputs=["x"])["x"]
    data = {"time": times, "x": x, "u": inputs["u"], "enabled": enabled}

    def calibration(resample):
        parameter = Parameter("x0", 0.1, -1.0, 1.0, offset_of="x")
        return Calibration(example_fmu("switched_input"), data, ["x"], [parameter], inputs=["u", "enabled"], resample=resample, start_time=0.0)

    # A mean over an interval with a change of slope by 1 differs by less than an eighth of the interval.
    fit = calibration(0.1).fit()
    assert abs(fit.x[0]) < 5e-3 and fit.rms < 0.1 / 8


@pytest.mark.parametrize("weights", [1 / 20, "w", np.full(60, 1 / 20)], ids=["number", "column", "rows"])
def test_weights_are_converted_with_the_unit_of_their_column(weights):
    rng = np.random.default_rng(8)
    times = np.linspace(0.0, 3.0, 60)
    x = np.exp(-times)
    in_m = x + 0.02 * rng.standard_normal(60)
    slope = -x + 0.05 + 0.3 * rng.standard_normal(60)

    def fitted(data, weight):
        outputs = {"x": "x", "der(x)": "v"}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            calibration = Calibration(
                example_fmu("dahlquist"),
                {"time": times, "v": slope, "w": np.full(60, 1 / 20), **data},
                outputs,
                [Parameter("k", 0.7, 0.1, 10.0)],
                units={"x": "m"},
                weights={"x": weight, "der(x)": 1 / 0.3},
            )
            return calibration.fit(x_tol=1e-8)

    expected, fit = fitted({"x": in_m}, 1 / 0.02), fitted({"x [mm]": 1000.0 * in_m}, weights)
    assert fit.x[0] == pytest.approx(expected.x[0], rel=1e-6)
    assert fit.uncertainty.stderr[0] == pytest.approx(expected.uncertainty.stderr[0], rel=1e-4)
    assert fit.fun == pytest.approx(expected.fun, rel=1e-6)


def test_window_includes_its_ends_despite_rounding():
    times = 1.7e9 + 0.1 * np.arange(20)
    data = {"time": times, "x": np.ones(20)}
    for window, n in (((times[3] + 2e-7, times[7] - 2e-7), 5), ((1.7e9, 1.7e9 + 0.3), 4)):
        calibration = Calibration(example_fmu("dahlquist"), data, ["x"], [Parameter("k", 1.0, 0.1, 10.0)], start_time=1.7e9, window=window)
        assert calibration.n_measurements == n
