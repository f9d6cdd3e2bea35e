"""The working folder and the environment variables seen by a model, which match the caller's in all isolation modes."""

import logging
import os
import sys

import numpy as np
import pytest
from fmus import evil

import pydfo
from pydfo import Calibration, FMUModel, Parameter

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="faults of an FMU are made for Linux")

TIMES = np.linspace(0, 1, 21)

#: x' = -k x with k from an environment variable, or from a file in the working folder; otherwise k = 1.
FROM_ENVIRONMENT = 'AT_START={const char *text = getenv("MODEL_K"); if (text != NULL) K(m) = atof(text);}'
FROM_FILE = 'AT_START={FILE *file = fopen("k.txt", "r"); if (file != NULL) { fscanf(file, "%lf", &K(m)); fclose(file); }}'
WRITES = 'AT_INITIALIZE={FILE *file = fopen("written.txt", "w"); if (file != NULL) { fputs("1", file); fclose(file); }}'
NEEDS_TO_WRITE = 'AT_INITIALIZE={FILE *file = fopen("written.txt", "w"); if (file == NULL) return fmi2Error; fclose(file);}'


def started(fmu, k, **more):
    """Returns a calibration with y = exp(-k t) that fits x(0) and does not set k of the model."""
    data = {"time": TIMES, "y": 0.5 * np.exp(-k * TIMES)}
    return Calibration(fmu, data, {"y": "y"}, [Parameter("x", 1, 0.1, 5)], **more)


def final(model, isolation):
    return model.simulate(final_time=1, isolation=isolation).final("y")


def test_simulation_uses_environment_of_the_call(tmp_path, monkeypatch, caplog):
    fmu = evil(tmp_path / "variable.fmu", FROM_ENVIRONMENT)
    monkeypatch.delenv("MODEL_K", raising=False)
    model, calibrations = FMUModel(fmu), [started(fmu, 1.0), started(fmu, 3.0)]
    assert final(model, "process") == pytest.approx(np.exp(-1), rel=1e-5)
    for k in (1.0, 3.0, 1.0):
        monkeypatch.setenv("MODEL_K", repr(k))
        for isolation in ("process", "none"):
            assert final(FMUModel(fmu), isolation) == pytest.approx(np.exp(-k), rel=1e-5), (k, isolation)
        assert final(model, "process") == pytest.approx(np.exp(-k), rel=1e-5), k
        costs = [calibration.cost([0.5]) for calibration in calibrations]
        assert (costs[0] < 1e-9) == (k == 1.0) and (costs[1] < 1e-9) == (k == 3.0), (k, costs)
        fit = started(fmu, k).fit(workers=2)
        assert fit.x[0] == pytest.approx(0.5, rel=1e-6)
    # Different results in different environments do not indicate a state kept by the model.
    assert not [message for message in caplog.messages if "depends on what ran before" in message]


def test_fit_uses_environment_at_its_start(tmp_path, monkeypatch):
    fmu = evil(tmp_path / "variable.fmu", FROM_ENVIRONMENT)
    monkeypatch.setenv("MODEL_K", "3")
    fit = started(fmu, 3.0).fit(method="de", max_evaluations=60, rng=1, workers=2, callback=lambda _: os.environ.update(MODEL_K="1"))
    assert fit.cost < 1e-3 and fit.nfail == 0


def test_model_does_not_see_variables_of_workers(tmp_path):
    refuses = 'AT_INITIALIZE=if (getenv("FMUFIT_WORKER") != NULL || getenv("LD_PRELOAD") != NULL) return fmi2Error'
    assert np.isfinite(final(FMUModel(evil(tmp_path / "clean.fmu", refuses)), "process"))


@pytest.mark.parametrize("more", [{}, {"isolation": "none"}, {"sandbox": True}])
def test_simulation_uses_working_folder_of_the_caller(tmp_path, monkeypatch, more):
    fmu = evil(tmp_path / "reads.fmu", FROM_FILE)
    calibration = started(fmu, 3.0, **more)
    for k in (3, 1, 3):
        folder = tmp_path / f"folder-{k}"
        folder.mkdir(exist_ok=True)
        (folder / "k.txt").write_text(f"{k}\n", encoding="utf-8")
        monkeypatch.chdir(folder)
        assert (calibration.cost([0.5]) < 1e-9) == (k == 3)
        assert final(FMUModel(fmu), "process") == pytest.approx(np.exp(-k), rel=1e-5)


def test_worker_folder_survives_removal_of_the_working_folder(tmp_path, monkeypatch):
    fmu = evil(tmp_path / "reads.fmu", FROM_FILE)
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert started(fmu, 1.0).cost([0.5]) < 1e-9


def test_files_of_a_model_are_written_to_the_working_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    FMUModel(evil(tmp_path / "writes.fmu", WRITES)).simulate(final_time=1, isolation="process")
    assert (tmp_path / "written.txt").read_text(encoding="utf-8") == "1"


def test_file_rejected_by_sandbox_is_named(tmp_path, monkeypatch, caplog):
    monkeypatch.chdir(tmp_path)
    needs = started(evil(tmp_path / "needs.fmu", NEEDS_TO_WRITE), 1.0, sandbox=True)
    with pytest.raises(pydfo.SimulationError, match=r"the sandbox denied the model an operation: with sandbox=True.*\(TMPDIR\)"):
        needs.cost([0.5])
    crashes = started(evil(tmp_path / "crashes.fmu", 'AT_INITIALIZE=fputs("1", fopen("written.txt", "w"))'), 1.0, sandbox=True)
    with pytest.raises(pydfo.SimulationError, match="segmentation fault.*with sandbox=True"):
        crashes.cost([0.5])
    with caplog.at_level(logging.WARNING, logger="pydfo"):
        calibration = started(evil(tmp_path / "writes.fmu", WRITES), 1.0, sandbox=True)
        assert calibration.cost([0.5]) < 1e-9
        assert calibration.cost([0.4]) > 0
    named = [message for message in caplog.messages if "denied the model an operation" in message]
    assert len(named) == 1 and not (tmp_path / "written.txt").exists(), caplog.messages


def test_concurrent_workers_have_distinct_instance_names(tmp_path, monkeypatch):
    # Some models name files by their instance, for example models of EnergyPlus.
    names = '{FILE *file = fopen("names.txt", "a"); fprintf(file, "%s\\n", name); fclose(file);}'
    fmu = evil(tmp_path / "named.fmu", f"AT_INSTANTIATE={names}")
    monkeypatch.chdir(tmp_path)
    started(fmu, 1.0).fit(method="de", max_evaluations=60, rng=1, workers=2)
    found = set((tmp_path / "names.txt").read_text(encoding="utf-8").split())
    assert {"Evil", "Evil_2"} <= found


def test_failure_without_message_is_repeated_with_log(tmp_path, caplog):
    silent = 'AT_INITIALIZE=if (K(m) > 2) { if (m->logs) say(m, fmi2Error, "k is too large"); return fmi2Error; }'
    fmu = evil(tmp_path / "silent.fmu", silent)
    for isolation in ("none", "process"):
        with pytest.raises(pydfo.SimulationError, match="returned error.*; the FMU logged: .*k is too large"):
            FMUModel(fmu).simulate(final_time=1, start_values={"k": 3.0}, isolation=isolation)
    data = {"time": TIMES, "y": np.exp(-1.7 * TIMES)}
    calibration = Calibration(fmu, data, {"y": "y"}, [Parameter("k", 1, 0.1, 5)])
    with pytest.raises(pydfo.SimulationError, match="k is too large"):
        calibration.cost([3.0])
    with caplog.at_level(logging.WARNING, logger="pydfo"):
        fit = calibration.fit(method="de", max_evaluations=60, rng=1, workers=2)
    assert fit.nfail > 1 and fit.x[0] == pytest.approx(1.7, abs=0.1)
    assert len([message for message in caplog.messages if "k is too large" in message]) == 1, caplog.messages
    always = evil(tmp_path / "always.fmu", silent.replace("K(m) > 2", "1"))
    calibration = Calibration(always, data, {"y": "y"}, [Parameter("k", 1, 0.1, 5)])
    with pytest.raises(pydfo.AllStartsFailed, match="returned error .repeated with logging of the model: .*k is too large"):
        calibration.fit()
