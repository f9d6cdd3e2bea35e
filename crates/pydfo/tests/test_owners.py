"""Several owners of one FMU: models, fits, threads."""

from __future__ import annotations

import threading

import fmus
import numpy as np
import pytest

import pydfo
from pydfo import FMUModel, example_fmu, load_fmu

PATIENCE = 60.0
ONCE = ('modelIdentifier="dahlquist"', 'modelIdentifier="dahlquist" canBeInstantiatedOnlyOncePerProcess="true"')


def decay(model):
    t = np.linspace(0.0, 1.5, 4)
    parameters = [pydfo.Parameter("k", 1.0, 0.1, 10.0)]
    return pydfo.Calibration(model, {"time": t, "x": np.exp(-2 * t)}, outputs=["x"], parameters=parameters)


def test_simulated_model_can_be_calibrated_despite_once_flag(tmp_path):
    model = FMUModel(fmus.changed("dahlquist", tmp_path / "once.fmu", ONCE))
    first = model.simulate(final_time=1.0)
    other = FMUModel(model.path)
    other.set("k", 3.0)
    other.simulate(final_time=1.0)
    calibration = decay(model)
    cost = calibration.cost([2.5])
    assert calibration.fit(workers=2).x[0] == pytest.approx(2.0, rel=1e-3)
    assert calibration.cost([2.5]) == cost
    assert model.get("x") == first["x"][-1]
    assert fmus.same_bits(model.simulate(final_time=1.0), first)


def test_models_of_one_fmu_are_independent():
    models = [load_fmu(example_fmu("dahlquist")) for _ in range(3)]
    truth = [None] * 3
    for _ in range(3):
        for i, model in enumerate(models):
            model.set("k", 1.0 + i)
            res = model.simulate(final_time=1.0)
            truth[i] = truth[i] or res
            assert fmus.same_bits(res, truth[i])
        assert [model.get("k") for model in models] == [1.0, 2.0, 3.0]


@pytest.mark.parametrize("how", ["close", "reset", "drop"])
def test_releasing_a_model_does_not_wait_for_its_simulation(tmp_path, how):
    """The simulation needs the interpreter lock for its input, so releasing a model must not wait for it with the
    lock held."""
    once = tuple(text.replace("dahlquist", "switched_input") for text in ONCE)
    path = fmus.changed("switched_input", tmp_path / "once.fmu", once)
    idle = FMUModel(path)
    idle.simulate(final_time=1.0)
    inside, go_on = threading.Event(), threading.Event()

    def u(time):
        inside.set()
        assert go_on.wait(PATIENCE)
        return 0.0

    busy = FMUModel(path)
    outcome = []
    thread = threading.Thread(target=lambda: outcome.append(busy.simulate(final_time=1.0, input=("u", u))))
    thread.start()
    assert inside.wait(PATIENCE)
    done = threading.Event()

    def let_go():
        nonlocal idle
        if how == "close":
            idle.close()
        elif how == "reset":
            idle.reset()
        idle = None
        done.set()

    threading.Thread(target=let_go).start()
    assert done.wait(PATIENCE)
    go_on.set()
    thread.join(PATIENCE)
    assert len(outcome) == 1
