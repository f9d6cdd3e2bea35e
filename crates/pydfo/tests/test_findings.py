"""Findings of a fit: order by cause, usability, units not declared by the model, and start values from SSP parameter
files."""

import datetime
import json
import warnings
from pathlib import Path

import numpy as np
import pytest

import pydfo

TIMES = np.linspace(0, 3, 61)
K = pydfo.Parameter("k", 1.5, 0.1, 10)


def decay(**columns: object) -> dict[str, object]:
    return {"time": TIMES, **columns}


def fitted(columns: dict[str, object], parameter: pydfo.Parameter = K, **options: object) -> pydfo.Fit:
    return pydfo.Calibration(pydfo.example_fmu("dahlquist"), columns, ["x"], [parameter], **options).fit()


def test_causes_come_first_and_fit_worse_than_constant_is_unusable() -> None:
    good, off = (fitted(decay(x=np.exp(-2 * TIMES) + shift)) for shift in (0, 273.15))
    assert good.usable and good.success
    assert off.success and not off.usable
    grave = [finding for finding in off.findings if finding.severity != "note"]
    order = ["problem", "search", "residuals"]
    assert [finding.origin for finding in grave] == sorted((finding.origin for finding in grave), key=order.index)
    assert grave[0].origin == "problem" and (grave[0].id, grave[0].name) == ("F047", "unit-mismatch")
    assert [finding.subject for finding in grave if finding.severity == "error"] == ["output 'x' (column 'x')"]
    assert str(off).splitlines()[1].startswith("The fit converged, but its result should not be used: RMS")


def test_undeclared_units_can_be_given() -> None:
    columns = decay(**{"x [mm]": 1e3 * np.exp(-2 * TIMES)})
    with pytest.warns(pydfo.CalibrationWarning, match=r"\[F046 unconverted-unit\]. State the unit of 'x' with the setting units"):
        assert fitted(columns).parameters["k"] < 1
    fit = fitted(columns, units={"x": "m"})
    assert fit.parameters["k"] == pytest.approx(2, rel=1e-5) and fit.outputs[0].unit == "m"
    for units, error, expected in [
        ({"x": "K"}, ValueError, "mm"),
        ({"x": "mx"}, ValueError, "units: 'x'"),
        ({"z": "m"}, KeyError, "z"),
        ({"x": 1}, TypeError, "units"),
    ]:
        with pytest.raises(error, match=expected):
            fitted(columns, units=units)


def test_simulation_uses_given_units(tmp_path: Path) -> None:
    model = pydfo.FMUModel(pydfo.example_fmu("dahlquist"))
    path = tmp_path / "set.ssv"
    path.write_text(
        '<ParameterSet><Parameters><Parameter name="x"><Real value="2" unit="ell"/></Parameter></Parameters>'
        '<Units><Unit name="ell"><BaseUnit m="1" factor="1.143"/></Unit></Units></ParameterSet>'
    )
    result = model.simulate(final_time=1, ncp=2, start_values=path, units={"x": "cm"})
    assert result["x"][0] == pytest.approx(228.6, rel=1e-14) and result.units["x"] == "cm"
    with pytest.raises(ValueError, match="the model declares no unit for 'x'"):
        model.simulate(final_time=1, start_values=path)
    for units, error in [({"z": "m"}, KeyError), ({"x": 1}, TypeError), ("cm", TypeError)]:
        with pytest.raises(error):
            model.simulate(final_time=1, units=units)  # type: ignore[arg-type]


def test_few_noisy_rows_give_no_findings() -> None:
    rows = np.linspace(0, 2, 5)
    off = pydfo.Calibration(
        pydfo.example_fmu("dahlquist"), {"time": rows, "x": np.array([2.3, 3.3, 2.1, 3.0, 2.3])}, ["x"], [pydfo.Parameter("k", 1, 0.5, 5)]
    ).fit()
    [finding] = [finding for finding in off.findings if finding.id == "F011"]
    assert finding.severity == "warning" and "In 5 rows this may be chance" in finding.sentence and off.usable


def test_start_values_are_read_from_parameter_set(tmp_path: Path) -> None:
    path = tmp_path / "set.ssv"
    fit = fitted(decay(x=np.exp(-2 * TIMES)))
    fit.export_ssv(path)
    model = pydfo.FMUModel(pydfo.example_fmu("dahlquist"))
    by_file = model.simulate(final_time=1, ncp=4, start_values=path)
    by_name = model.simulate(final_time=1, ncp=4, start_values={"k": fit.parameters["k"]})
    assert np.array_equal(by_file["x"], by_name["x"]) and by_file["x"][-1] == pytest.approx(np.exp(-2), rel=1e-4)
    # A fitted k overrides the file. If x(0) is fitted, k is the value of the file.
    assert fitted(decay(x=np.exp(-2 * TIMES)), start_values=path).x.tobytes() == fit.x.tobytes()
    start = fitted(decay(x=3 * np.exp(-2 * TIMES)), pydfo.Parameter("x", 1, 0, 10), start_values=str(path))
    assert start.parameters["x"] == pytest.approx(3, rel=1e-4)
    path.write_text("k = 2")
    with pytest.raises(ValueError, match="set.ssv"):
        model.simulate(final_time=1, start_values=path)
    with pytest.raises(FileNotFoundError):
        model.simulate(final_time=1, start_values=tmp_path / "none.ssv")


def test_dates_get_no_unit_advice() -> None:
    # A recording of 10 000 s for a model that suggests 10 s, with a simulation that does not follow it.
    seconds = np.arange(0, 10000.0, 100)
    measured = np.cos(seconds / 500)
    check = {
        name: pydfo.Calibration(pydfo.example_fmu("dahlquist"), {"time": times, "x": measured}, ["x"], [K]).check()
        for name, times in {
            "numbers": seconds,
            "dates": [datetime.datetime(2025, 1, 14) + datetime.timedelta(seconds=s) for s in seconds],
            "texts": [str(np.datetime64("2025-01-14T06:00:00") + np.timedelta64(int(s), "s")) for s in seconds],
        }.items()
    }
    remedies = {name: [finding.remedy for finding in found if "time [" in finding.remedy] for name, found in check.items()}
    assert remedies["numbers"] and not remedies["dates"] and not remedies["texts"], check


def test_delay_of_several_outputs_is_rejected() -> None:
    with pytest.raises((TypeError, ValueError), match="delay_of must be one output or input.*delays"):
        pydfo.Parameter("tau", 0.1, 0, 1, delay_of=["x", "y"])  # type: ignore[arg-type]


def test_zero_residuals_give_no_findings() -> None:
    """Without a residual variance, no value can be compared with its error."""
    parameters = [pydfo.Parameter("k", 1.0, 0.1, 5.0), pydfo.Parameter("x", 1.0, 0.5, 2.0)]

    def calibration(x: object) -> pydfo.Calibration:
        return pydfo.Calibration(pydfo.example_fmu("dahlquist"), decay(x=x), ["x"], parameters, solver="rk4", step_size=0.01)

    fit = calibration(calibration(np.zeros(61)).simulate([1.0, 1.0])["x"]).fit()
    assert fit.cost == 0.0
    assert not [finding for finding in fit.findings if finding.id == "F007"]


def test_findings_have_stable_identifiers() -> None:
    fit = fitted(decay(x=np.exp(-2 * TIMES)), pydfo.Parameter("k", 1.5, 0.1, 1.8))
    [bound] = [finding for finding in fit.findings if finding.id == "F001"]
    assert bound.name == "at-bound" and f"{bound.sentence} [F001 at-bound]" in str(fit)
    assert {"id": "F001", "severity": "warning"}.items() <= json.loads(fit.to_json())["findings"][0].items()
    with pytest.raises(ValueError, match="F099"):
        _ = bound._replace(id="F099").name


def test_warnings_are_silenced_by_identifier() -> None:
    columns = decay(**{"x [mm]": np.exp(-2 * TIMES)})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*F046")
        fitted(columns)
