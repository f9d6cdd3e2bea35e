"""Handing a fit on: files, pickles, tables, other programs."""

import copy
import pickle
import shutil

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
    """x' = -k x with k = 2; one recording from x = 1, one from x = 3."""
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
    """All numbers of both."""
    assert one.parameters == two.parameters
    assert (one.cost, one.rms, one.start_cost, one.start_rms) == (two.cost, two.rms, two.start_cost, two.start_rms)
    assert (one.message, one.nfev, one.method, one.solver, one.race) == (two.message, two.nfev, two.method, two.solver, two.race)
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


def test_a_file_holds_all_of_a_fit(fit, tmp_path):
    assert fit.parameters == pytest.approx({"k": 2, "x[cold]": 1, "x[hot]": 3}, abs=5e-3)
    path = tmp_path / "decay.fit"
    fit.save(path)
    loaded = load_fit(path)
    assert_same(loaded, fit)
    assert_simulates(loaded, fit)
    assert loaded._calibration.parameters == fit._calibration.parameters
    # It can be fitted again, and saved again.
    assert loaded._calibration.fit().parameters == pytest.approx(fit.parameters)
    loaded.save(tmp_path / "again.fit")
    assert (tmp_path / "again.fit").read_bytes() == path.read_bytes()


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda fit: pickle.loads(pickle.dumps(fit))])
def test_copies_are_the_same(fit, copied):
    assert_same(copied(fit), fit)
    assert_simulates(copied(fit), fit)
    calibration = copied(fit._calibration)
    assert calibration.cost(fit.x) == fit.cost


def test_copies_after_a_plot(fit):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed").use("Agg")
    fit.plot()
    assert_same(pickle.loads(pickle.dumps(fit)), fit)


def test_without_its_model_a_fit_shows_its_numbers(fit, place, tmp_path):
    path, moved, content = tmp_path / "decay.fit", place.with_name("moved.fmu"), FMUModel(place).description
    fit.save(path)
    dump = pickle.dumps(fit)
    place.rename(moved)
    try:
        for loaded in (load_fit(path), pickle.loads(dump)):
            assert_same(loaded, fit)
            with pytest.raises(FileNotFoundError, match=r"decay\.fmu.*SHA-256 [0-9a-f]{64}.*not there any more"):
                loaded.simulate()
            with pytest.raises(FileNotFoundError, match="decay.fmu"):
                loaded.residuals()
            with pytest.raises((FileNotFoundError, pydfo.FmuError), match="decay.fmu"):
                loaded._calibration.fit()
        shutil.copy(example_fmu("van_der_pol"), place)
        with pytest.raises(FileNotFoundError, match="what is there now has the content"):
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


def test_files_that_are_no_fits(fit, tmp_path):
    path = tmp_path / "a.fit"
    fit.save(path)
    whole = path.read_bytes()
    for content, message in [(b"", "no saved fit"), (b"k,2", "no saved fit"), (whole[:500], "cut off"), (whole[:-40], "cut off")]:
        path.write_bytes(content)
        with pytest.raises(pydfo.BadCalibrationError, match=message) as raised:
            load_fit(path)
        assert str(path) in str(raised.value)
    with pytest.raises(pydfo.BadCalibrationError, match="holds no fit.json"):
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
