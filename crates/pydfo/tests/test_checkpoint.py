"""Checkpoints from Python: an interrupted and resumed run equals the uninterrupted run."""

from __future__ import annotations

import concurrent.futures
import functools
import multiprocessing
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time

import pytest
from conftest import Recorder, press_ctrl_c
from methods import METHODS, RUN, rosenbrock, timeless

import pydfo
from pydfo import minimize


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("how", ["budget", "exception", "base exception", "stop", "ctrl-c"])
def test_resumed_run_equals_uninterrupted_run(method, how, tmp_path):
    chance = random.Random(f"{method} {how}")
    # L-SHADE plans with its budget, so the budget is fixed although the limit changes.
    options_of_method = {"budget": 260} if method == "de" else {}
    run = {**RUN, "method": method, "options": options_of_method}
    whole = timeless(minimize(rosenbrock, **run, max_evaluations=260))
    path = tmp_path / "run"
    calls, limit, n_repeated = 0, 260, 0

    class Exit(BaseException):
        pass

    for _ in range(200):
        left = chance.randrange(1, 60)

        def func(x, left=left):
            nonlocal calls
            func.count += 1
            if how == "ctrl-c" and func.count == left:
                signal.raise_signal(signal.SIGINT)
            if func.count > left and "exception" in how:
                raise (RuntimeError if how == "exception" else Exit)
            calls += 1
            return rosenbrock(x)

        func.count = 0
        limits = {"max_evaluations": min(limit, calls + left) if how == "budget" else limit}
        options = {**run["options"], "checkpoint_interval": 0.0}
        workers = chance.choice([1, map, 2]) if how in ("budget", "stop") else 1
        # Threads may be evaluating when the run stops. These points are evaluated again.
        n_repeated += workers if workers == 2 and how == "stop" else 0
        if method in ("nelder-mead", "barrier", "pattern-search"):
            options["batch"] = "serial"

        def stop(progress, left=left):
            if how == "stop" and func.count >= left:
                raise StopIteration

        try:
            arguments = {**run, "options": options, **limits}
            # Every function object here has a different name.
            resume = "require" if path.exists() else "auto"
            res = minimize(func, **arguments, checkpoint=path, resume=resume, workers=workers, callback=stop)
        except (RuntimeError, pydfo.Interrupted, Exit):
            assert path.exists()
            continue
        if res.termination == "stopped-by-observer" or (how == "budget" and calls < limit and not res.success):
            continue
        break
    assert timeless(res) == whole
    assert res.nfev <= calls <= res.nfev + n_repeated


def test_finished_run_returns_its_stored_result(tmp_path):
    path = tmp_path / "run"
    first = minimize(rosenbrock, [-1.2, 1.0], checkpoint=path)
    func = Recorder(rosenbrock)
    again = minimize(func, [-1.2, 1.0], checkpoint=path, resume="require")
    assert timeless(first) == timeless(again) and func.values == []
    assert minimize(func, [-1.2, 1.0], checkpoint=path, resume="never").nfev == len(func.values) > 0


def test_mismatched_checkpoint_is_rejected_and_unchanged(tmp_path):
    path = tmp_path / "run"
    with pytest.raises(FileNotFoundError):
        minimize(rosenbrock, [-1.2, 1.0], checkpoint=path, resume="require")
    minimize(rosenbrock, [-1.2, 1.0], bounds=[(-2, 2)] * 2, checkpoint=path)
    before = path.read_bytes()
    for changes, expected in [
        ({"x0": [-1.0, 1.0]}, "start: .* in the file, .* in this run"),
        ({"bounds": [(-3, 2), (-2, 2)]}, r"lower bounds: \[-2.0, -2.0\] in the file, \[-3.0, -2.0\] in this run"),
        ({"method": "barrier"}, "method: quadratic-model in the file, barrier in this run"),
        ({"options": {"restarts": 0}}, "option restarts: 3 in the file, 0 in this run"),
        ({"options": {"x_tol": 1e-3}}, "x_tol: .* in the file, 0.001 in this run"),
    ]:
        arguments = {"x0": [-1.2, 1.0], "bounds": [(-2, 2)] * 2, **changes}
        with pytest.raises(pydfo.CheckpointError, match=expected):
            minimize(rosenbrock, **arguments, checkpoint=path)
    assert path.read_bytes() == before
    path.write_bytes(before[:-1] + b"x")
    with pytest.raises(pydfo.CheckpointError, match="damaged"):
        minimize(rosenbrock, [-1.2, 1.0], bounds=[(-2, 2)] * 2, checkpoint=path)
    with pytest.raises(OSError):
        minimize(rosenbrock, [-1.2, 1.0], checkpoint=tmp_path / "nowhere" / "run")
    other = {"bounds": [(-2, 2)] * 2, "method": "de", "max_evaluations": 50, "checkpoint": tmp_path / "seeded"}
    minimize(rosenbrock, **other, rng=1)
    with pytest.raises(pydfo.CheckpointError, match="seed: 1 in the file, 2 in this run"):
        minimize(rosenbrock, **other, rng=2)
    assert minimize(rosenbrock, **other).seed == 1


def killed_at(path, method, count):
    """Runs in a separate process, which exits without cleanup at an evaluation."""
    calls = 0

    def func(x):
        nonlocal calls
        calls += 1
        if calls == count:
            os._exit(1)
        time.sleep(0.003)
        return rosenbrock(x)

    options = {"checkpoint_interval": 0.0}
    minimize(func, **RUN, method=method, max_evaluations=300, checkpoint=path, options=options)


@pytest.mark.parametrize("method", METHODS)
def test_killed_process_resumes_from_last_checkpoint(method, tmp_path):
    path = tmp_path / "run"
    # Quadratic models reach the minimum sooner.
    count = 60 if method == "quadratic-model" else 170
    process = multiprocessing.get_context("spawn").Process(target=killed_at, args=(path, method, count))
    process.start()
    process.join(60.0)
    assert process.exitcode == 1
    func = Recorder(rosenbrock)
    resumed = minimize(func, **RUN, method=method, max_evaluations=300, checkpoint=path, resume="require")
    assert timeless(resumed) == timeless(minimize(rosenbrock, **RUN, method=method, max_evaluations=300))
    assert len(func.values) < 300


def test_ctrl_c_cancels_pending_executor_tasks(tmp_path):
    started = []

    def func(x):
        started.append(1)
        if len(started) == 30:
            press_ctrl_c()
            time.sleep(0.3)
        return rosenbrock(x)

    run = {**RUN, "method": "de", "options": {"budget": 300}, "max_evaluations": 300}
    whole = timeless(minimize(rosenbrock, **run))
    with concurrent.futures.ThreadPoolExecutor(1) as threads:
        with pytest.raises(pydfo.Interrupted) as info:
            minimize(func, **run, workers=threads, checkpoint=tmp_path / "run")
    assert info.value.result.nfev == len(started) == 30
    assert timeless(minimize(func, **run, checkpoint=tmp_path / "run")) == whole
    assert len(started) == 300


def test_result_is_kept_when_checkpoint_becomes_unwritable(tmp_path):
    place = tmp_path / "place"
    place.mkdir()
    calls = []

    def func(x):
        calls.append(1)
        if len(calls) == 100:
            shutil.rmtree(place)
        return rosenbrock(x)

    run = {**RUN, "method": "de", "max_evaluations": 5000, "options": {"checkpoint_interval": 0.0}}
    res = minimize(func, **run, checkpoint=place / "run")
    assert (res.status, res.termination, res.success) == (7, "not-saved", False) and res.nfev >= 100
    assert res.fun == rosenbrock(res.x) == res.trace.fun.min() and "could not be saved" in res.message
    with pytest.raises(FileNotFoundError):
        minimize(func, **run, checkpoint=place / "run")
    assert len(calls) == res.nfev


def shifted(x):
    return float((x[0] - 2.0) ** 2)


def test_checkpoint_is_bound_to_function_name(tmp_path):
    path = tmp_path / "run.ckpt"

    def run(fun, **more):
        return minimize(fun, [1.0], checkpoint=path, **more)

    first = run(shifted)
    again = run(functools.partial(shifted))
    assert timeless(again) == timeless(first)
    assert f"continued from {path}, which contains the first {first.nfev} evaluations" in again.message
    assert "continued" not in first.message
    before = path.read_bytes()
    with pytest.raises(pydfo.CheckpointError, match=r'another function, \S*test_checkpoint.shifted instead of .*<lambda>\. Set resume="require"'):
        run(lambda x: float((x[0] - 4.0) ** 2))
    assert path.read_bytes() == before
    assert "continued from" in run(lambda x: float((x[0] - 4.0) ** 2), resume="require").message
    assert run(lambda x: float((x[0] - 4.0) ** 2), resume="never").x == pytest.approx([4.0], abs=1e-3)
    run(shifted, options={"problem": "a word of the user's"}, resume="never")
    run(lambda x: 0.0, options={"problem": "a word of the user's"})


def test_checkpoint_is_locked_within_a_process(tmp_path):
    path = tmp_path / "run.ckpt"
    started, go_on = threading.Event(), threading.Event()

    def waits(x):
        started.set()
        go_on.wait(60.0)
        return float(x @ x)

    with concurrent.futures.ThreadPoolExecutor(1) as pool:
        first = pool.submit(minimize, waits, [1.0], checkpoint=path, max_evaluations=5)
        started.wait(60.0)
        with pytest.raises(pydfo.CheckpointError, match="another run in this process is writing to it; wait until it has ended"):
            minimize(lambda x: float(x @ x), [1.0], checkpoint=path)
        go_on.set()
        assert first.result().nfev == 5


FULL = """
import logging, pydfo, resource, sys, time
messages, calls = [], [0]
class Keep(logging.Handler):
    def emit(self, record):
        messages.append((calls[0], record.getMessage()))
logging.getLogger("pydfo").addHandler(Keep())
def cost(x):
    calls[0] += 1
    time.sleep(0.002)
    return float(x @ x)
resource.setrlimit(resource.RLIMIT_FSIZE, (200, 200))
result = pydfo.minimize(cost, [1.0, 2.0], workers=int(sys.argv[2]), checkpoint=sys.argv[1], max_evaluations=40, options={"checkpoint_interval": 0})
print(len(messages), messages[0][0] < 20, messages[0][1], "|", result.status, result.message)
"""


@pytest.mark.skipif(os.name != "posix", reason="limits of file sizes")
@pytest.mark.parametrize("workers", [1, 2])
def test_unwritable_checkpoint_is_reported_before_the_run(tmp_path, workers):
    run = subprocess.run([sys.executable, "-c", FULL, tmp_path / "run.ckpt", str(workers)], capture_output=True, text=True, check=True)
    warned, _, ended = run.stdout.partition(" | ")
    assert warned.startswith("1 True the checkpoint was not written; the run continues"), run.stdout + run.stderr
    assert "could not be saved" in ended


FULL_AT_THE_END = """
import resource, sys
import numpy as np, pydfo
t = np.linspace(0, 4, 60)
x = np.exp(-1.5 * t) + 0.01 * np.random.default_rng(1).standard_normal(t.size)
calibration = pydfo.Calibration(pydfo.example_fmu("dahlquist"), {"time": t, "x": x}, ["x"], [pydfo.Parameter("k", 1.0, 0.1, 5.0)])
plain = calibration.fit()
soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
fit = calibration.fit(checkpoint=sys.argv[1], callback=lambda _: resource.setrlimit(resource.RLIMIT_FSIZE, (0, hard)))
resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
print(fit.termination, "could not be saved" in fit.message, fit.message.startswith("converged"))
print(fit.stderr.tolist() == plain.stderr.tolist(), fit.usable, [f.sentence for f in fit.findings] == [f.sentence for f in plain.findings])
"""


@pytest.mark.skipif(os.name != "posix", reason="limits of file sizes")
def test_fit_has_standard_errors_and_findings_when_its_last_checkpoint_cannot_be_written(tmp_path):
    run = subprocess.run([sys.executable, "-c", FULL_AT_THE_END, tmp_path / "fit.ckpt"], capture_output=True, text=True, check=True)
    assert run.stdout.splitlines() == ["not-saved True True", "True True True"], run.stdout + run.stderr


ORPHANS = """
import concurrent.futures, os, sys, time
import pydfo

def cost(x):
    return float((x[0] - 1) ** 2 + 3 * (x[1] + 0.5) ** 2)

def end(progress):
    if progress.nfev >= 40:
        os.kill(os.getpid(), 9)

with concurrent.futures.ProcessPoolExecutor(2) as executor:
    first = executor.submit(os.getpid).result()
    print(first, flush=True)
    pydfo.minimize(cost, [0.2, 0.3], bounds=[(-2, 2)] * 2, method="de", workers=executor, rng=1, checkpoint=sys.argv[1], callback=end)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="forked workers")
def test_children_of_killed_program_release_its_checkpoint(tmp_path):
    def cost(x):
        return float((x[0] - 1) ** 2 + 3 * (x[1] + 0.5) ** 2)

    path = tmp_path / "run.ckpt"
    killed = subprocess.Popen([sys.executable, "-c", ORPHANS, path], stdout=subprocess.PIPE, text=True, start_new_session=True)
    orphan = int(killed.stdout.readline())
    try:
        assert killed.wait(timeout=60) == -9
        os.kill(orphan, 0)
        arguments = {"bounds": [(-2, 2)] * 2, "method": "de", "rng": 1}
        resumed = pydfo.minimize(cost, [0.2, 0.3], checkpoint=path, options={"problem": "x"}, resume="never", **arguments)
        assert resumed.success
    finally:
        os.killpg(killed.pid, 9)
        killed.stdout.close()
