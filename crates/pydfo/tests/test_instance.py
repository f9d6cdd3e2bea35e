"""Instances controlled call by call: phases, steps, states, linearisation."""

from __future__ import annotations

import gc
import os
import pickle
import threading
import time

from conftest import press_ctrl_c
import fmus
import numpy as np
import pytest

import pydfo
from pydfo import FMUModel, example_fmu, fmi


@pytest.fixture
def ball():
    with fmi.instantiate(example_fmu("bouncing_ball")) as instance:
        yield instance


def test_model_exchange_phases_follow_in_order(ball):
    assert ball.phase == "instantiated" and ball.kind == "ME" and ball.time is None
    ball.set({"e": 0.5, "g": -10.0})
    ball.enter_initialization(0.0, 3.0, 1e-6)
    assert ball.phase == "initialization" and ball.get("e") == 0.5
    ball.exit_initialization()
    info = ball.update_discrete_states()
    assert ball.phase == "event" and not info.terminate and info.next_time is None
    ball.enter_continuous_time()
    assert ball.state_names == ["h", "v"] and ball.nominals.tolist() == [1.0, 1.0]
    # Explicit Euler: v decreases by g dt, h changes by v dt.
    for k in range(1, 4):
        dx = ball.derivatives
        ball.time, ball.states = 0.1 * k, ball.states + 0.1 * dx
        assert ball.completed_integrator_step() == (False, False)
    assert np.allclose(ball.states, [1 - 0.1 * 0.1 * 10 * (0 + 1 + 2), -3.0])
    assert ball.event_indicators[0] == pytest.approx(ball.get("h"))
    ball.terminate()
    assert ball.phase == "terminated" and ball.get("v") == pytest.approx(-3.0)
    ball.reset()
    assert ball.phase == "instantiated"


def test_model_exchange_steps_handle_events(ball):
    ball.initialize()
    first = fmus.bounces(3)
    for _ in range(4):
        step = ball.do_step(0.3, relative_tolerance=1e-10)
    assert step.complete and step.time == ball.time == pytest.approx(1.2)
    after = 1.2 - first[1]
    speed = 0.7**2 * np.sqrt(2 * 9.81)
    assert first[1] < 1.2 < first[2]
    assert ball.get("h") == pytest.approx(speed * after - 9.81 * after**2 / 2, abs=1e-7)
    assert ball.get("bounces") == 2


def test_model_can_end_the_simulation():
    with fmi.instantiate(example_fmu("stair")) as stair:
        assert stair.initialize().next_time == stair.next_event == 1.0
        step = stair.do_step(20)
        assert (step.time, step.complete, step.terminate) == (9.0, False, True)
        assert stair.get("counter") == 10 and stair.phase == "event"


def test_co_simulation_steps_match_reference():
    with fmi.instantiate(example_fmu("dahlquist", kind="CS"), "cs") as instance:
        instance.initialize()
        for k in range(1, 11):
            assert instance.do_step(0.1).time == pytest.approx(0.1 * k)
        assert instance.get("x") == pytest.approx(np.exp(-1), abs=1e-3)
        with pytest.raises(ValueError, match="phase continuous, but the instance is in the phase step"):
            instance.linearize()


def test_discrete_inputs_are_set_in_event_mode():
    with fmi.instantiate(example_fmu("switched_input")) as instance:
        instance.initialize()
        with pytest.raises(ValueError, match="only continuous inputs"):
            instance.set("gear", 2)
        instance.enter_event_mode()
        instance.set({"gear": 2, "enabled": True})
        assert instance.do_step(0.1).complete
        assert instance.get("gear") == 2 and instance.phase == "continuous"


def test_states_are_saved_and_restored(ball):
    ball.initialize()
    ball.do_step(0.2)
    saved, here = ball.save_state(), ball.get(["h", "v"])
    ball.do_step(0.5)
    assert ball.get(["h", "v"]) != here
    ball.restore_state(saved)
    assert ball.get(["h", "v"]) == here and ball.time == saved.time == 0.2


@pytest.mark.parametrize("differences", [False, True])
def test_linearisation_matches_closed_form(differences):
    """Four tanks: for the flow a sqrt(2 g x) out of a tank of area A, da/dx = a sqrt(g / (2 x)) / A."""
    with fmi.instantiate(example_fmu("quad_tank")) as tanks:
        tanks.initialize()
        linear = tanks.linearize(differences=differences)
        before = tanks.states
        a = np.zeros((4, 4))
        for j, h in enumerate(1e-6 * np.maximum(1e-2, before)):
            slopes = []
            for sign in (1, -1):
                tanks.states = before + sign * h * np.eye(4)[j]
                slopes.append(tanks.derivatives)
            a[:, j] = (slopes[0] - slopes[1]) / (2 * h)
    assert linear.A.shape == (4, 4) and linear.B.shape == (4, 2) and linear.C.shape == (4, 4) and linear.D.shape == (4, 2)
    assert np.allclose(linear.A, a, atol=1e-7)
    assert np.array_equal(linear.C, np.eye(4)) or np.allclose(linear.C, np.eye(4), atol=1e-9)
    # The outflow of an upper tank enters the tank below it.
    assert linear.A[0, 2] == pytest.approx(-linear.A[2, 2], abs=1e-9) and linear.A[1, 3] == pytest.approx(-linear.A[3, 3], abs=1e-9)


def test_van_der_pol_is_linearised_exactly():
    with fmi.instantiate(example_fmu("van_der_pol")) as instance:
        instance.initialize()
        assert np.allclose(instance.linearize().A, [[0, 1], [-1, -3]], atol=1e-9)


def test_directional_derivatives_match_reference():
    with fmi.instantiate(example_fmu("quad_tank")) as tanks:
        if not tanks.description.capabilities.provides_directional_derivative:
            pytest.skip("the model has none")
        tanks.initialize()
        derivatives = [n for n, v in tanks.description.variables.items() if v.derivative]
        states = tanks.description.states
        along = tanks.directional_derivative(derivatives, states, [1, 0, 2, 0])
        assert np.allclose(along, tanks.linearize().A @ [1, 0, 2, 0])


def test_instance_receives_values_set_in_model():
    model = FMUModel(example_fmu("dahlquist"))
    model.set("k", 2.0)
    model.simulate(final_time=1)
    with fmi.instantiate(model) as instance:
        instance.initialize()
        assert instance.get(["k", "x"]) == [2.0, 1.0]


def test_calls_in_wrong_phase_are_rejected(ball):
    with pytest.raises(ValueError, match="enter_continuous_time requires the phase event, but the instance is in the phase instantiated"):
        ball.enter_continuous_time()
    with pytest.raises(pydfo.UnknownVariableError, match="no variable"):
        ball.set("hh", 1)
    with pytest.raises(TypeError, match="pickled"):
        pickle.dumps(ball)
    ball.initialize()
    with pytest.raises(ValueError, match="positive"):
        ball.do_step(0)
    with pytest.raises(ValueError, match="one of|solver"):
        ball.do_step(1, solver="none")
    other = fmi.instantiate(example_fmu("bouncing_ball"))
    other.initialize()
    with pytest.raises(pydfo.PydfoError):
        ball.restore_state(other.save_state())
    ball.close()
    with pytest.raises(ValueError, match="closed"):
        ball.get("h")


@pytest.mark.parametrize(
    "wrong", [{"relative_tolerance": 0}, {"relative_tolerance": float("nan")}, {"step_size": -1.0, "solver": "rk4"}, {"solver": "no"}]
)
def test_wrong_step_argument_leaves_instance_unchanged(ball, wrong):
    ball.initialize()
    before = ball.states.tolist()
    with pytest.raises(ValueError):
        ball.do_step(0.1, **wrong)
    assert ball.states.tolist() == before and ball.do_step(0.1).complete
    with pytest.raises(TypeError, match="save_state"):
        ball.restore_state(None)


@pytest.fixture(scope="module")
def sampled(tmp_path_factory):
    """Returns a model that ticks every 0.1 s and is strict about times; x' = n + 10 on + 100 gear, on = (u > 0.5 at
    the last event)."""
    return fmus.compiled("sampled", tmp_path_factory.mktemp("sampled") / "sampled.fmu")


def test_repeated_steps_handle_every_tick(sampled):
    with fmi.instantiate(sampled, "ME") as instance:
        instance.initialize()
        counts = []
        for _ in range(50):
            assert instance.do_step(0.1).complete
            counts.append(instance.get("n"))
        assert counts == list(range(1, 51))
        assert instance.time == pytest.approx(5.0) and instance.next_event == 51 * 0.1


@pytest.mark.parametrize("isolation", ["none", "process"])
@pytest.mark.parametrize("solver", ["auto", "rk4", "radau5"])
def test_tick_at_end_counts_despite_rounding(sampled, solver, isolation):
    model = FMUModel(sampled, kind="ME")
    ends = [round(0.1 * k, 1) for k in range(1, 101)]
    assert sum(0.1 * k > end for k, end in enumerate(ends, 1)) > 20
    for k, end in list(enumerate(ends, 1))[:: 1 if solver == "auto" else 9]:
        res = model.simulate(final_time=end, times=[end], outputs=["n"], solver=solver, isolation=isolation)
        assert res["n"].tolist() == [k] and res["time"].tolist() == [end]


def test_fit_to_data_ending_with_a_tick_works(sampled):
    t = np.array([0.0, 0.1, 0.2, 0.3])
    data = {"time": t, "x": np.array([0.0, 0.0, 0.1, 0.3])}
    fit = pydfo.Calibration(FMUModel(sampled, kind="ME"), data, ["x"], [pydfo.Parameter("period", 0.095, 0.05, 0.105)]).fit()
    assert fit.cost < 1e-6


def test_restored_state_keeps_pending_ticks(sampled):
    with fmi.instantiate(sampled, "ME") as instance:
        instance.initialize()
        instance.do_step(0.25)
        saved = instance.save_state()
        instance.do_step(0.5)
        there = instance.get(["x", "n"]), instance.next_event
        instance.restore_state(saved)
        assert instance.next_event == 0.30000000000000004 and instance.time == 0.25
        instance.do_step(0.5)
        assert (instance.get(["x", "n"]), instance.next_event) == there


def test_reset_discards_values():
    with fmi.instantiate(example_fmu("dahlquist")) as instance:
        instance.set("k", 2.0)
        instance.reset()
        instance.initialize()
        assert instance.get("k") == 1.0


def test_input_across_a_switch_triggers_an_event(sampled):
    with fmi.instantiate(sampled, "ME") as instance:
        instance.set("period", 10.0)
        instance.initialize()
        for k in range(20):
            instance.set("u", 0.05 * (k + 1))
            instance.do_step(0.1)
        # The input is above 0.5 from 1 s on.
        assert instance.get("on") == 1.0 and instance.get("x") == pytest.approx(10.0)


def test_discrete_inputs_of_a_co_simulation_wait_for_event_mode(sampled):
    with fmi.instantiate(sampled, "CS") as instance:
        instance.initialize()
        instance.set({"gear": 1.0, "u": 1.0})
        assert instance.get("gear") == 1.0
        instance.do_step(0.0625)
        assert instance.get(["x", "on", "visits"]) == [110 * 0.0625, 1.0, 2.0]


@pytest.mark.parametrize("kind", ["ME", "CS"])
def test_triggered_clocks_tick_when_set(tmp_path, kind):
    with fmi.instantiate(fmus.compiled("clocks", tmp_path / "clocks.fmu"), kind) as instance:
        instance.initialize()
        for _ in range(4):
            if instance.do_step(0.25).event:
                instance.handle_events()
        assert instance.get(["n_sample", "n_third", "n_growing", "n_optional"]) == [11, 3, 4, 2]
        assert instance.next_event == pytest.approx(1.05)


@pytest.mark.parametrize("names", [("n", "k"), ("k", "n")])
def test_model_values_are_set_in_instance_in_any_order(tmp_path, names):
    model = FMUModel(fmus.compiled("arrays", tmp_path / "arrays.fmu"))
    values = {"n": 2, "k": [3.0, 4.0]}
    model.set({name: values[name] for name in names})
    with fmi.instantiate(model) as instance:
        instance.initialize()
        assert np.asarray(instance.get("k")).tolist() == [3.0, 4.0]


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("*(volatile int *)0 = 1", "segmentation fault in fmi2GetDerivatives"),
        ("exit(3)", r"exit\(3\) in fmi2GetDerivatives"),
        ("close_all()", "fmi2"),
    ],
)
def test_crash_of_fmu_closes_instance_but_not_python(tmp_path, fault, message):
    fmu = fmus.evil(tmp_path / "deadly.fmu", "FAULT_ABOVE=2.2", f"FAULT={fault}")
    sound = fmi.instantiate(fmu)
    sound.initialize()
    with fmi.instantiate(fmu) as instance:
        instance.set("k", 3.0)
        instance.initialize()
        instance.time = 0.5
        with pytest.raises(pydfo.SimulationError, match=message):
            _ = instance.derivatives
        assert instance.phase == "closed" and instance.next_event is None and "closed" in repr(instance)
        for call in (lambda: instance.get("x"), lambda: instance.set("k", 1.0), instance.reset, lambda: instance.do_step(0.1)):
            with pytest.raises(ValueError, match="the instance was lost with its process. Create a new instance"):
                call()
    with pytest.raises(ValueError, match="closed"):
        instance.get("x")
    assert sound.get("x") == 1.0 and sound.derivatives.tolist() == [-1.0]
    with fmi.instantiate(fmu, "CS") as other:
        other.initialize()
        assert other.do_step(0.1).complete


@pytest.mark.parametrize("place", ["AT_INSTANTIATE", "AT_FREE"])
def test_crash_is_an_error_at_the_start_and_logged_at_the_end(tmp_path, caplog, place):
    fmu = fmus.evil(tmp_path / "deadly.fmu", f"{place}=abort()")
    if place == "AT_INSTANTIATE":
        with pytest.raises(pydfo.SimulationError, match="abort in fmi2Instantiate"):
            fmi.instantiate(fmu)
    else:
        with caplog.at_level("INFO", "pydfo"), fmi.instantiate(fmu) as instance:
            instance.initialize()
        assert "abort in fmi2FreeInstance" in caplog.text and instance.phase == "closed"


def test_ctrl_c_ends_hanging_call(tmp_path):
    fmu = fmus.evil(tmp_path / "hangs.fmu", "FAULT_ABOVE=2.2", "FAULT=hang()")
    with fmi.instantiate(fmu) as instance:
        instance.set("k", 3.0)
        instance.initialize()
        instance.time = 0.5
        threading.Timer(0.5, press_ctrl_c).start()
        began = time.monotonic()
        with pytest.raises(pydfo.Interrupted):
            _ = instance.derivatives
        assert time.monotonic() - began < 5
        with pytest.raises(ValueError, match="interrupted. Create a new instance"):
            instance.get("x")


def test_ctrl_c_ends_integration(ball):
    ball.initialize()
    threading.Timer(0.3, press_ctrl_c).start()
    with pytest.raises(pydfo.Interrupted):
        ball.do_step(1.0, solver="euler", step_size=1e-9)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
@pytest.mark.filterwarnings("ignore:This process.*fork:DeprecationWarning")
def test_forked_child_has_no_instance(ball):
    ball.initialize()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            ball.get("h")
        except ValueError as error:
            code = 0 if "parent process of this fork" in str(error) else 2
        ball.close()
        os._exit(code)
    assert os.waitpid(child, 0)[1] == 0
    assert ball.get("h") == 1.0 and ball.do_step(0.1).complete


def by_hand(fmu, kind, isolation):
    """Returns the bits of the results of an instance controlled call by call."""
    with fmi.instantiate(fmu, kind, isolation=isolation) as instance:
        instance.initialize()
        seen = []
        saved = None
        for k in range(20):
            seen.append((instance.do_step(0.1).time, instance.get(["h", "v"]), instance.next_event))
            if kind == "ME":
                seen.append((instance.derivatives.tobytes(), instance.event_indicators.tobytes()))
            if k == 5 and instance.description.capabilities.can_get_and_set_state:
                saved = instance.save_state()
        if saved is not None:
            instance.restore_state(saved)
            seen.append(instance.get(["h", "v"]))
        return pickle.dumps(seen)


@pytest.mark.parametrize("kind", ["ME", "CS"])
def test_instance_results_are_identical_in_worker_and_local_process(kind):
    fmu = example_fmu("bouncing_ball", kind=kind)
    assert by_hand(fmu, kind, "none") == by_hand(fmu, kind, "process") == by_hand(fmu, kind, None)
    with pytest.raises(ValueError, match="isolation"):
        fmi.instantiate(fmu, isolation="thread")


@pytest.mark.parametrize("isolation", ["none", "process"])
def test_saved_states_live_as_long_as_their_objects(isolation):
    with fmi.instantiate(example_fmu("bouncing_ball"), isolation=isolation) as ball:
        ball.initialize()
        kept = ball.save_state()
        for _ in range(50):
            ball.do_step(0.01)
            ball.save_state()
            gc.collect()
        ball.restore_state(kept)
        assert ball.get("h") == 1.0 and ball.time == 0.0


def test_results_convert_to_files_and_other_libraries(tmp_path, monkeypatch):
    result = FMUModel(example_fmu("bouncing_ball")).simulate(final_time=1, ncp=4, outputs=["h", "bounces", "resting"])
    result.to_csv(tmp_path / "out.csv")
    lines = (tmp_path / "out.csv").read_text().splitlines()
    assert lines[0] == "time,h,bounces,resting" and len(lines) == 6
    assert [float(line.split(",")[1]) for line in lines[1:]] == result["h"].tolist()
    assert lines[1].split(",")[2:] == ["0", "False"]
    monkeypatch.setitem(__import__("sys").modules, "polars", None)
    monkeypatch.setitem(__import__("sys").modules, "xarray", None)
    with pytest.raises(ImportError, match=r"to_polars\(\) requires polars; install it with pip install polars"):
        result.to_polars()
    with pytest.raises(ImportError, match=r"to_xarray\(\) requires xarray; install it with pip install xarray"):
        result.to_xarray()
