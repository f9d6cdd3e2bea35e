"""Ctrl-C: the first one ends the run in order, the second one returns control at once."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time

import pytest
from conftest import press_ctrl_c, rosenbrock

import pydfo
from pydfo import fmin

QUIET = {"disp": False}
ENDLESS = {"x_tol": 0.0, "f_tol": 0.0, "max_iters": None, "max_fevals": None, **QUIET}


def press(*after):
    """Presses Ctrl-C on the main thread after each of these times in seconds."""

    def run():
        start = time.monotonic()
        for seconds in after:
            time.sleep(max(0.0, start + seconds - time.monotonic()))
            press_ctrl_c()

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    return thread


def slow(x):
    time.sleep(0.01)
    return rosenbrock(x)


@pytest.fixture(autouse=True)
def handler_is_put_back():
    before = signal.getsignal(signal.SIGINT)
    yield
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize("workers", [1, 4])
def test_first_ctrl_c_ends_run_with_best_point(workers):
    press(0.3)
    start = time.monotonic()
    with pytest.raises(pydfo.Interrupted) as info:
        fmin(slow, [-1.2, 1.0], nbr_cores=workers, **ENDLESS)
    assert time.monotonic() - start < 1.3
    result = info.value.result
    assert isinstance(info.value, KeyboardInterrupt)
    assert result.status == 5 and result.termination == "interrupted" and result.nfev >= 3
    assert result.fun == result.trace.fun[result.trace.best()] < rosenbrock([-1.2, 1.0])


@pytest.mark.parametrize("workers", [1, 2])
def test_first_ctrl_c_waits_for_running_function(workers):
    ended = []

    def func(x):
        time.sleep(0.5)
        ended.append(1)
        return rosenbrock(x)

    press(0.2)
    with pytest.raises(pydfo.Interrupted) as info:
        fmin(func, [-1.2, 1.0], nbr_cores=workers, **ENDLESS)
    assert len(ended) == workers == info.value.result.nfev


# On Windows, Python does not interrupt a function that waits on the main thread.
@pytest.mark.parametrize("workers", [2] if sys.platform == "win32" else [1, 2])
def test_second_ctrl_c_does_not_wait(workers):
    release = threading.Event()
    calls = []

    def func(x):
        calls.append(1)
        if len(calls) > 8:
            release.wait(8.0)
        return rosenbrock(x)

    press(0.3, 0.6)
    start = time.monotonic()
    with pytest.raises(pydfo.Interrupted) as info:
        fmin(func, [-1.2, 1.0], nbr_cores=workers, **ENDLESS)
    assert time.monotonic() - start < 2.0
    release.set()
    assert info.value.result.fun <= rosenbrock([-1.2, 1.0])


def test_ctrl_c_before_any_cost_has_no_result():
    press(0.2)
    with pytest.raises(pydfo.Interrupted) as info:
        fmin(lambda x: time.sleep(0.4) or float("nan"), [-1.2, 1.0], **ENDLESS)
    assert info.value.result is None


def test_interrupted_run_prints_its_summary(capsys):
    press(0.2)
    with pytest.raises(pydfo.Interrupted):
        fmin(slow, [-1.2, 1.0], x_tol=0.0, f_tol=0.0)
    assert "interrupted" in capsys.readouterr().out


@pytest.mark.parametrize("workers", [1, 2])
def test_nested_run_stops_with_outer_run(workers):
    inner = []

    def func(x):
        try:
            return fmin(slow, [-1.2, 1.0], **ENDLESS).fun
        except pydfo.Interrupted as e:
            inner.append(e.result)
            raise

    press(0.3)
    start = time.monotonic()
    with pytest.raises(pydfo.Interrupted) as info:
        fmin(func, [0.0], nbr_cores=workers, **ENDLESS)
    assert time.monotonic() - start < 1.3
    assert inner and inner[0].nfev > 3
    assert info.value.result is None


def test_signal_handler_of_the_user_is_kept():
    class Alarm(Exception):
        pass

    def handler(signum, frame):
        raise Alarm

    before = signal.signal(signal.SIGINT, handler)
    try:
        for workers in (1, 2):
            press(0.2)
            with pytest.raises(Alarm) as info:
                fmin(slow, [-1.2, 1.0], nbr_cores=workers, **ENDLESS)
            assert info.value.partial_result.fun <= rosenbrock([-1.2, 1.0])
            assert signal.getsignal(signal.SIGINT) is handler
    finally:
        signal.signal(signal.SIGINT, before)


def test_other_threads_can_minimise_without_signals():
    results = []
    thread = threading.Thread(target=lambda: results.append(fmin(rosenbrock, [-1.2, 1.0], **QUIET)))
    thread.start()
    thread.join(30.0)
    assert results[0].success


def test_no_evaluation_starts_0_2_s_after_ctrl_c():
    starts = []

    def func(x):
        starts.append(time.monotonic())
        time.sleep(0.02)
        return rosenbrock(x)

    pressed = []
    thread = threading.Timer(0.3, lambda: (pressed.append(time.monotonic()), press_ctrl_c()))
    thread.start()
    with pytest.raises(pydfo.Interrupted):
        fmin(func, [-1.2, 1.0], nbr_cores=2, **ENDLESS)
    assert max(starts) < pressed[0] + 0.2


@pytest.mark.skipif(os.name != "posix", reason="sends a signal to a separate process")
def test_ctrl_c_ends_a_script_with_the_usual_status():
    script = textwrap.dedent(
        """
        import sys, time, pydfo
        def cost(x):
            time.sleep(0.01)
            return float(x @ x)
        print("ready", flush=True)
        try:
            pydfo.fmin(cost, [1.0, 2.0], nbr_cores=2, disp=False, x_tol=0, f_tol=0, max_iters=None, max_fevals=None)
        except pydfo.Interrupted as e:
            print("best", e.result.fun, flush=True)
            raise
        """
    )
    process = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "ready\n"
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=10.0)
    assert out.startswith("best ") and "Interrupted" in err
    assert process.returncode != 0


@pytest.mark.parametrize("what", ["simulate", "cost", "solve"])
def test_loop_of_short_calls_can_be_interrupted(what):
    model = pydfo.FMUModel(pydfo.example_fmu("dahlquist"))
    data = {"time": [0.0, 0.5, 1.0], "x": [1.0, 0.6, 0.4]}
    calibration = pydfo.Calibration(pydfo.example_fmu("dahlquist"), data, ["x"], [pydfo.Parameter("k", 1.0, 0.1, 5.0)])
    work = {
        "simulate": lambda: model.simulate(final_time=1.0),
        "cost": lambda: calibration.cost([1.0]),
        "solve": lambda: pydfo.ode.solve(lambda t, x: -x, (0.0, 1.0), [1.0]),
    }[what]
    work()
    for _ in range(10):
        with pytest.raises(KeyboardInterrupt):
            # pressed inside the loop, because starting the thread may take longer than the delay
            press(0.02)
            deadline = time.monotonic() + 2.0
            while time.monotonic() < deadline:
                work()


def test_long_simulation_on_calling_thread_can_be_interrupted():
    model = pydfo.FMUModel(pydfo.example_fmu("van_der_pol"))
    for _ in range(3):
        model.simulate(final_time=1.0)
    before = threading.active_count()
    press(0.3)
    start = time.monotonic()
    with pytest.raises(pydfo.Interrupted, match="interrupted at t = ") as info:
        model.simulate(final_time=1e9, output=["x0"], ncp=10)
    assert time.monotonic() - start < 1.3 and before <= threading.active_count()
    assert float(str(info.value).rpartition(" ")[2]) > 0.0
    # and the model is unchanged
    assert model.simulate(final_time=1.0).termination == "finished"


def test_long_cost_on_calling_thread_can_be_interrupted():
    # k = 1e-3 is simulated quickly; for k = 1e9 stability limits Tsit5, with 1e9 steps
    data = {"time": [0.0, 1.0], "x": [1.0, 0.4]}
    parameters = [pydfo.Parameter("k", 1.0, 1e-3, 1e12)]
    calibration = pydfo.Calibration(pydfo.example_fmu("dahlquist"), data, ["x"], parameters, solver="tsit5")
    for _ in range(3):
        calibration.cost([1e-3])
    press(0.3)
    start = time.monotonic()
    with pytest.raises(pydfo.Interrupted):
        calibration.cost([1e10])
    assert time.monotonic() - start < 1.3
    assert calibration.cost([1.0]) < 1.0


@pytest.mark.parametrize("raises", [False, True])
def test_input_functions_of_short_runs_end_the_run(raises):
    """Input functions are called with the interpreter lock, on the simulating thread."""
    model = pydfo.FMUModel(pydfo.example_fmu("quad_tank"))
    voltages = ("u1", "u2"), lambda t: (5.0, 5.0)
    for _ in range(3):
        model.simulate(final_time=1.0, input=voltages)
    seen = []

    def slow_voltages(t):
        seen.append(threading.get_ident())
        if raises and len(seen) > 3:
            raise ArithmeticError("no voltage")
        time.sleep(0.01)
        return 5.0 + 0.1 * (t % 1.0), 5.0

    if not raises:
        press(0.3)
    start = time.monotonic()
    with pytest.raises(ArithmeticError if raises else pydfo.Interrupted):
        model.simulate(final_time=1e6, input=(("u1", "u2"), slow_voltages))
    assert time.monotonic() - start < 1.3
    assert set(seen) == {threading.get_ident()}
