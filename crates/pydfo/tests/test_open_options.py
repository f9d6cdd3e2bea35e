"""Options for opening FMUs: display of logs, loading of libraries, and detected quirks."""

from __future__ import annotations

import logging
import pickle
import sys

import fmus
import pytest

import pydfo
from pydfo import FMUModel, FmuError, example_fmu, load_fmu


def shown(caplog, *arguments, simulations=1, **options):
    """Returns the log records of simulations with two bounces each."""
    caplog.clear()
    model = load_fmu(example_fmu("bouncing_ball"), *arguments, **options)
    with caplog.at_level(logging.DEBUG, logger="pydfo"):
        for _ in range(simulations):
            model.simulate(final_time=1.5)
    return [record for record in caplog.records if record.name == "pydfo"]


def test_fmu_log_is_shown_on_request(caplog):
    assert shown(caplog) == []
    assert shown(caplog, logging=True) == []
    lines = shown(caplog, "auto", "all", logging=True)
    assert lines and all(line.levelno == logging.INFO for line in lines)
    assert all(line.getMessage().startswith("BouncingBall: [ok] ") for line in lines), lines
    # Each run logs its own lines, once.
    assert len(shown(caplog, log_level=7, logging=True, simulations=3)) == 3 * len(lines)
    for level in ("nothing", "fatal", "Error", 3):
        assert shown(caplog, log_level=level, logging=True) == []


def test_log_levels_match_pyfmi():
    path = example_fmu("dahlquist")
    for level in (*range(8), "nothing", "warning", "all"):
        FMUModel(path, log_level=level)
    for level in (-1, 8, "loud"):
        with pytest.raises(ValueError, match="log_level must be one of 0 .nothing., 1 .fatal.*7 .all."):
            load_fmu(path, log_level=level)
    for level in (True, 2.5, []):
        with pytest.raises(TypeError, match="log_level"):
            FMUModel(path, log_level=level)


def test_log_categories_are_selected_by_name(caplog):
    messages = [line.getMessage() for line in shown(caplog, log_level=7, logging=["logEvents"])]
    assert messages and messages == [line.getMessage() for line in shown(caplog, log_level=7, logging=True)]
    assert shown(caplog, log_level=7, logging=("logStatusError",)) == []
    with pytest.raises(ValueError, match='unknown log category "logAll"; expected one of: logEvents, logStatusDiscard, logStatusError'):
        load_fmu(example_fmu("dahlquist"), logging=["logAll"]).simulate(final_time=1)
    assert messages == [line.getMessage() for line in shown(caplog, log_level=7, logging="logEvents")]
    for bad in ([], [1], 2):
        with pytest.raises(TypeError, match="logging must be True, False or a list of log categories"):
            load_fmu(example_fmu("dahlquist"), logging=bad)


@pytest.mark.parametrize(("version", "kind"), [("1.0", "ME"), ("1.0", "CS"), ("2.0", "ME"), ("2.0", "CS"), ("3.0", "ME"), ("3.0", "CS")])
def test_bundled_models_log_events_in_all_versions_and_kinds(version, kind, caplog):
    model = FMUModel(example_fmu("bouncing_ball", version, kind), kind, log_level=7, logging=["logEvents"])
    with caplog.at_level(logging.INFO, logger="pydfo"):
        model.simulate(final_time=1.6)
    bounces = [record.getMessage() for record in caplog.records if "states changed" in record.getMessage()]
    assert len(bounces) == 3, caplog.messages


def test_model_that_needs_its_tool_runs_with_a_note(tmp_path, caplog):
    kind = ("modelIdentifier=", 'needsExecutionTool="true" modelIdentifier=')
    path = fmus.changed("dahlquist", tmp_path / "tool.fmu", kind)
    times = [0.0, 0.5, 1.0]
    with caplog.at_level(logging.WARNING, logger="pydfo"):
        model = FMUModel(path)
        data = {"time": times, "x": model.simulate(times=times, start_values={"k": 0.5})["x"]}
        model.simulate(times=times, isolation="process")
        calibration = pydfo.Calibration(path, data, outputs=["x"], parameters=[pydfo.Parameter("k", 1.0, 0.1, 2.0)])
        assert calibration.fit().x[0] == pytest.approx(0.5, rel=1e-4)
    notes = [record.getMessage() for record in caplog.records if "needsExecutionTool" in record.getMessage()]
    assert len(notes) == 1, caplog.messages


def test_failure_without_required_tool_is_explained(tmp_path):
    tool = ("modelIdentifier=", 'needsExecutionTool="true" modelIdentifier=')
    path = fmus.evil(tmp_path / "tool.fmu", "NOT_INSTANTIABLE", replacements=[tool])
    for isolation in ("none", "process"):
        with pytest.raises(pydfo.SimulationError, match=r"no licence for evil; .*at run time \(needsExecutionTool\), which may be missing"):
            FMUModel(path).simulate(final_time=1.0, isolation=isolation)
    crashes = fmus.evil(tmp_path / "crash.fmu", "AT_INITIALIZE=abort()", replacements=[tool])
    with pytest.raises(pydfo.SimulationError, match=r"abort in fmi2ExitInitializationMode.*which may be missing"):
        FMUModel(crashes).simulate(final_time=1.0, isolation="process")


@pytest.mark.skipif(sys.platform != "linux", reason="options of the loader of Linux")
@pytest.mark.parametrize("options", [{"deepbind": True}, {"lazy": True}])
def test_libraries_load_with_other_options(options):
    res = load_fmu(example_fmu("dahlquist"), **options).simulate(final_time=1.0)
    plain = load_fmu(example_fmu("dahlquist")).simulate(final_time=1.0)
    assert fmus.same_bits(res, plain)


@pytest.mark.parametrize(("fault", "reuse"), [(None, "reset"), ("RESET_TO_ZERO", "reinstantiate"), ("REMEMBERS=1.01", "process")])
def test_reuse_reports_the_first_method_that_agrees_with_a_fresh_process(tmp_path, caplog, fault, reuse):
    path = fmus.evil(tmp_path / "own.fmu", *([fault] if fault else []))
    model = FMUModel(path, "ME")
    first = {}
    for k in [1.0, 2.0, 1.0, 2.0, 1.0]:
        model.set("k", k)
        res = model.simulate(final_time=1.0)
        assert fmus.same_bits(res, first.setdefault(k, FMUModel(path, "ME").simulate(final_time=1.0, start_values={"k": k})))
    assert model.reuse == reuse
    assert len(model.description.quirks) == {"reset": 0, "reinstantiate": 1, "process": 2}[reuse]


def test_false_capability_is_a_quirk(tmp_path, caplog):
    model = FMUModel(fmus.compiled("early_return", tmp_path / "i.fmu", "NO_EVENT_MODE"))
    assert model.description.quirks == []
    with caplog.at_level(logging.WARNING, logger="pydfo"):
        model.simulate()
    assert [quirk.kind for quirk in model.description.quirks] == ["promise"]
    assert "event mode" in caplog.text


def test_description_limits_can_be_set(tmp_path):
    path = fmus.changed("dahlquist", tmp_path / "small.fmu")
    for open_it in (FMUModel, pydfo.read_description):
        with pytest.raises(FmuError, match="limit of 100"):
            open_it(path, max_description_bytes=100)
        assert open_it(path, max_description_bytes=100_000, max_elements=10)
        for value in (0, -1, 2**64):
            with pytest.raises(ValueError, match="max_elements must be a positive number"):
                open_it(path, max_elements=value)
        with pytest.raises(TypeError, match="max_description_bytes must be an integer"):
            open_it(path, max_description_bytes=1.5)
    data = {"time": [0.0, 0.5, 1.0], "x": [1.0, 0.6, 0.4]}
    calibrated = {"outputs": ["x"], "parameters": [pydfo.Parameter("k", 1.0, 0.1, 2.0)]}
    with pytest.raises(FmuError, match="limit of 100; increase the limit with max_description_bytes"):
        pydfo.Calibration(path, data, **calibrated, max_description_bytes=100)
    calibration = pydfo.Calibration(path, data, **calibrated, max_description_bytes=100_000)
    assert pickle.loads(pickle.dumps(calibration)).cost([1.0]) == calibration.cost([1.0])
    with pytest.raises(FmuError, match="elements"):
        FMUModel(fmus.compiled("arrays", tmp_path / "arrays.fmu"), max_elements=3)
