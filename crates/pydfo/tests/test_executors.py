"""Fits and minimisations on executors: the result is the same as with one process, despite lost processes."""

from __future__ import annotations

import concurrent.futures
import logging
import os
import shutil
import subprocess
import sys
import textwrap
import time

import numpy as np
import pydfo
import pytest
from conftest import rosenbrock
from fmus import evil
from pydfo._optimize import evaluate


def slow_cost(x):
    time.sleep(0.002)
    return float((x[0] - 1.0) ** 2 + 10.0 * (x[1] + 0.5) ** 2 + x[0] * x[1])


def point_that_kills(x):
    if 0.4 < x[0] < 0.5:
        os._exit(9)
    return slow_cost(x)


def same(one, other):
    np.testing.assert_array_equal(one.x, other.x)
    np.testing.assert_array_equal(one.fun, other.fun)
    assert (one.nfev, one.nit, one.message) == (other.nfev, other.nit, other.message)


@pytest.mark.parametrize("method", ["nelder-mead", "de", "cma-es", "quadratic-model", "pattern-search"])
@pytest.mark.parametrize("pool", [concurrent.futures.ThreadPoolExecutor, concurrent.futures.ProcessPoolExecutor])
def test_executor_result_equals_serial_result(method, pool):
    def run(workers):
        return pydfo.minimize(slow_cost, [0.2, 0.3], [(-2, 2)] * 2, method, workers=workers, rng=3, max_evaluations=80, options={})

    alone = run(1)
    with pool(3) as executor:
        same(run(executor), alone)


def residuals(x):
    t = np.linspace(0.0, 4.0, 15)
    return x[0] * np.exp(-x[1] * t) - 2.0 * np.exp(-0.7 * t) + 0.05 * np.cos(9.0 * t)


def test_global_least_squares_is_identical_for_all_workers():
    def run(workers, **more):
        return pydfo.least_squares(residuals, [1.0] * 2, [(0, 5)] * 2, search="global", rng=5, max_evaluations=200, workers=workers, **more)

    alone = run(1)
    assert alone.options["polish"] == "least-squares" and alone.jac is not None and alone.cov is not None
    with concurrent.futures.ThreadPoolExecutor(3) as threads, concurrent.futures.ProcessPoolExecutor(2) as processes:
        for other in [run(3), run(map), run(threads), run(processes)]:
            same(other, alone)
            np.testing.assert_array_equal(other.jac, alone.jac)
            np.testing.assert_array_equal(other.cov, alone.cov)
            assert other.options == alone.options and len(other.optima) == len(alone.optima)
    vectorized = pydfo.least_squares(
        lambda x: np.stack([residuals(column) for column in x.T], axis=1),
        *([1.0] * 2, [(0, 5)] * 2),
        search="global",
        rng=5,
        max_evaluations=200,
        vectorized=True,
    )
    same(vectorized, alone)
    np.testing.assert_array_equal(vectorized.cov, alone.cov)


def test_broken_executor_ends_run_with_best_point():
    with concurrent.futures.ProcessPoolExecutor(2) as executor:
        with pytest.raises(concurrent.futures.BrokenExecutor) as caught:
            pydfo.minimize(point_that_kills, [-1.2, 1.0], [(-2, 2)] * 2, "nelder-mead", workers=executor)
    assert caught.value.partial_result.nfev > 3
    assert np.isfinite(caught.value.partial_result.fun)


class Losing(concurrent.futures.ThreadPoolExecutor):
    """Loses every seventh task, like a cluster that loses machines."""

    def __init__(self):
        super().__init__(2)
        self.count = 0

    def submit(self, fn, /, *args, **kwargs):
        self.count += 1
        if self.count % 7 == 0:
            future = concurrent.futures.Future()
            future.set_exception(ConnectionError("the machine is gone"))
            return future
        return super().submit(fn, *args, **kwargs)


@pytest.mark.parametrize("method", ["de", "nelder-mead", "pattern-search"])
def test_lost_points_are_evaluated_again(method):
    arguments = {"bounds": [(-2, 2)] * 2, "method": method, "rng": 1, "max_evaluations": 200}
    with Losing() as executor:
        result = pydfo.minimize(slow_cost, [-1.2, 1.0], workers=executor, **arguments)
    same(result, pydfo.minimize(slow_cost, [-1.2, 1.0], **arguments))
    assert result.n_lost > 10 and result.nfail == 0


class Swallowing(concurrent.futures.ThreadPoolExecutor):
    """Never answers the first submission of every seventh point, like a machine that hangs."""

    def __init__(self):
        super().__init__(2)
        self.seen = set()
        self.n_swallowed = 0

    def submit(self, fn, /, *args, **kwargs):
        key = next(argument.tobytes() for argument in args if isinstance(argument, np.ndarray))
        if key not in self.seen:
            self.seen.add(key)
            if len(self.seen) > 6 and len(self.seen) % 7 == 0:
                self.n_swallowed += 1
                return concurrent.futures.Future()
        return super().submit(fn, *args, **kwargs)


@pytest.mark.parametrize("method", ["de", "nelder-mead", "quadratic-model"])
def test_overdue_points_are_submitted_again(method):
    asked = {"bounds": [(-2, 2)] * 2, "method": method, "rng": 1, "max_evaluations": 60}
    with Swallowing() as executor:
        result = pydfo.minimize(slow_cost, [-1.2, 1.0], workers=pydfo.Resubmit(executor, 3), **asked)
    same(result, pydfo.minimize(slow_cost, [-1.2, 1.0], **asked))
    assert result.n_lost > 0 and executor.n_swallowed > 0 and result.nfail == 0


def test_overdue_simulations_of_fit_are_submitted_again():
    with Swallowing() as executor:
        fit = decay().fit("de", workers=pydfo.Resubmit(executor, 3.0), rng=1, max_evaluations=60)
    alone = decay().fit("de", workers=1, rng=1, max_evaluations=60)
    assert fit.x.tobytes() == alone.x.tobytes() and fit.nfail == 0 and executor.n_swallowed > 3
    assert any("the executor lost" in finding.sentence for finding in fit.findings)


class SwallowingFirst(concurrent.futures.ThreadPoolExecutor):
    """Never answers the first submission of these points, counted from 0."""

    def __init__(self, points):
        super().__init__(2)
        self.points, self.seen = points, []

    def submit(self, fn, /, *args, **kwargs):
        key = next(argument.tobytes() for argument in args if isinstance(argument, np.ndarray))
        if key not in self.seen:
            self.seen.append(key)
            if len(self.seen) - 1 in self.points:
                return concurrent.futures.Future()
        return super().submit(fn, *args, **kwargs)


@pytest.mark.parametrize(("points", "first_limit"), [({1}, None), ({0, 2, 3}, 0.2), (range(9), 0.2)])
@pytest.mark.parametrize("method", ["de", "nelder-mead"])
def test_first_points_are_submitted_again(method, points, first_limit):
    asked = {"bounds": [(-2, 2)] * 2, "method": method, "rng": 1, "max_evaluations": 40}
    with SwallowingFirst(points) as executor:
        result = pydfo.minimize(slow_cost, [-1.2, 1.0], workers=pydfo.Resubmit(executor, 3, first_limit), **asked)
    same(result, pydfo.minimize(slow_cost, [-1.2, 1.0], **asked))
    assert result.n_lost > 0 and result.nfail == 0


def test_limit_of_overdue_tasks():
    with concurrent.futures.ThreadPoolExecutor(1) as pool:
        limit = pydfo.Resubmit(pool, 3.0, 60).limit
        assert pydfo.Resubmit(pool, 3.0).limit([]) == float("inf") and limit([]) == 60
        assert limit([1.0]) == 3.0 and limit([1.0, 2.0, 3.0, 9.0]) == 27.0 and limit([1.0, 2.0, 3.0, 9.0, 9.0]) == 9.0


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ((concurrent.futures.ThreadPoolExecutor(1), 2.0, 0.0), ValueError, "first_limit must be a positive time in s, not 0.0"),
        ((concurrent.futures.ThreadPoolExecutor(1), 2.0, "1"), TypeError, "first_limit"),
        ((3, 2.0), TypeError, "executor must have a method submit, or be a Dask client, not 3"),
        ((Swallowing, 2.0), TypeError, "not the class Swallowing"),
        ((concurrent.futures.ThreadPoolExecutor(1), 1.0), ValueError, "overdue must be a finite number above 1, not 1.0"),
        ((concurrent.futures.ThreadPoolExecutor(1), float("nan")), ValueError, "overdue must be a finite number above 1"),
        ((concurrent.futures.ThreadPoolExecutor(1), "5"), TypeError, "overdue"),
    ],
)
def test_resubmit_rejects_invalid_arguments(arguments, error, message):
    with pytest.raises(error, match=message):
        pydfo.Resubmit(*arguments)


class LosingAll(concurrent.futures.ThreadPoolExecutor):
    """Loses all tasks after the first 30, like a cluster that has lost its scheduler."""

    def __init__(self):
        super().__init__(2)
        self.count = 0

    def submit(self, fn, /, *args, **kwargs):
        self.count += 1
        if self.count > 30:
            future = concurrent.futures.Future()
            future.set_exception(ConnectionError("the scheduler is gone"))
            return future
        return super().submit(fn, *args, **kwargs)


def test_repeatedly_lost_point_ends_run_and_is_evaluated_on_resume(tmp_path):
    arguments = {"bounds": [(-2, 2)] * 2, "method": "de", "rng": 1, "max_evaluations": 90}
    path = tmp_path / "run.ckpt"
    with LosingAll() as executor:
        lost = pydfo.minimize(slow_cost, [0.2, 0.3], workers=executor, checkpoint=path, **arguments)
    assert not lost.success and lost.status == 6 and lost.nfail == 0
    assert "lost the same point 3 times" in lost.message and "the scheduler is gone" in lost.message
    resumed = pydfo.minimize(slow_cost, [0.2, 0.3], checkpoint=path, **arguments)
    whole = pydfo.minimize(slow_cost, [0.2, 0.3], **arguments)
    assert (resumed.x.tobytes(), resumed.fun, resumed.nfev) == (whole.x.tobytes(), whole.fun, whole.nfev)


def test_fit_with_lost_points_is_not_converged():
    with LosingAll() as executor, pytest.raises(pydfo.FmuError, match="lost the same point 3 times .*the scheduler is gone") as caught:
        decay().fit("de", workers=executor, rng=1, max_evaluations=200)
    fit = caught.value.partial_result
    assert not fit.success and fit.nfail == 0 and 1 <= fit.nfev < 40 and np.isfinite(fit.cost)


def test_fit_reports_lost_results():
    with Losing() as executor:
        fit = decay().fit("de", workers=executor, rng=1, max_evaluations=60)
    alone = decay().fit("de", workers=1, rng=1, max_evaluations=60)
    assert fit.x.tobytes() == alone.x.tobytes() and fit.nfail == 0
    assert any("the executor lost" in finding.sentence for finding in fit.findings)


def hang_above(x):
    if x[0] > 2.2:
        time.sleep(8)
    return float((x[0] - 1.7) ** 2)


@pytest.mark.skipif(sys.platform != "linux", reason="faults of an FMU are made for Linux")
@pytest.mark.parametrize("pool", [concurrent.futures.ThreadPoolExecutor, concurrent.futures.ProcessPoolExecutor])
def test_time_limit_ends_fit_of_hanging_model_on_executor(tmp_path, pool):
    fmu = evil(tmp_path / "hangs.fmu", "FAULT_ABOVE=2.2", "FAULT=hang()")
    data = {"time": TIMES, "y": np.exp(-1.7 * TIMES)}
    calibration = pydfo.Calibration(fmu, data, {"y": "y"}, [pydfo.Parameter("k", 1, 0.1, 5)])
    with pool(2) as executor:
        fit = calibration.fit("de", max_time=1.0, rng=1, workers=executor)
        minimum = pydfo.minimize(hang_above, [1.0], bounds=[(0.1, 5)], method="de", max_time=0.5, rng=1, workers=executor)
    for result in (fit, minimum):
        assert result.termination == "max-time" and "were still running elsewhere" in result.message
    assert fit.x[0] < 2.2 and np.isfinite(fit.cost)


def test_too_many_failures_end_a_run():
    def failing(x):
        return np.nan if x[0] > 0.3 else slow_cost(x)

    arguments = {"bounds": [(-1, 1)] * 2, "method": "de", "rng": 1, "options": {"max_failed": 0.25}}
    result = pydfo.minimize(failing, **arguments)
    assert result.status == 17 and result.nfev < 4 * result.nfail and np.isfinite(result.fun)
    assert "more than the allowed share of 0.25" in result.message
    with pytest.raises(ValueError, match="max_failed"):
        pydfo.minimize(failing, **{**arguments, "options": {"max_failed": 2}})


def test_exceptions_end_the_run():
    def wrong(x):
        raise RuntimeError("no")

    with concurrent.futures.ThreadPoolExecutor(2) as executor:
        with pytest.raises(RuntimeError, match="no"):
            pydfo.minimize(wrong, [1.0], [(-2, 2)], "nelder-mead", workers=executor)
        # The executor belongs to the user and continues to work.
        assert executor.submit(lambda: 3).result() == 3


TIMES = np.linspace(0, 1, 21)


def decay(**more):
    """Returns a calibration of x' = -k x with x = exp(-1.7 t), so k = 1.7."""
    data = {"time": TIMES, "x": np.exp(-1.7 * TIMES)}
    return pydfo.Calibration(pydfo.example_fmu("dahlquist"), data, ["x"], [pydfo.Parameter("k", 1, 0.1, 5)], **more)


@pytest.mark.parametrize("method", ["least-squares", "nelder-mead", "de"])
def test_fit_on_executor_equals_local_fit(method):
    plan = {"batch": "serial"} if method == "least-squares" else {}
    alone = decay().fit(method, workers=1, rng=1, max_evaluations=60, **plan)
    with concurrent.futures.ProcessPoolExecutor(2) as executor:
        fit = decay().fit(method, workers=executor, rng=1, max_evaluations=60, **plan)
    assert fit.x.tobytes() == alone.x.tobytes() and fit.stderr.tobytes() == alone.stderr.tobytes()
    assert (fit.cost, fit.nfev, fit.message) == (alone.cost, alone.nfev, alone.message)
    assert fit.stats.right_hand_sides > alone.stats.right_hand_sides / 2


def test_robust_losses_stages_and_noise_work_on_executor():
    times = np.linspace(0, 2, 30)
    data = {"time": times, "x": np.exp(-1.7 * times) + 0.01 * np.sin(37 * times)}
    prior = pydfo.Parameter("k", 1, 0.1, 5, prior=pydfo.Normal(1.5, 0.3))

    def calibration():
        return pydfo.Calibration(pydfo.example_fmu("dahlquist"), data, ["x"], [prior])

    with concurrent.futures.ThreadPoolExecutor(2) as executor:
        for arguments in ({"noise": "estimated"}, {"loss": "huber", "f_scale": 0.01, "noise": "stated"}, {"stages": [["k"], ["k"]]}):
            one, other = (calibration().fit(workers=workers, batch="serial", **arguments) for workers in (1, executor))
            assert (one.x.tobytes(), one.cost, one.nfev) == (other.x.tobytes(), other.cost, other.nfev), arguments


@pytest.mark.skipif(sys.platform == "win32", reason="under Wine, a removed file exists until it is closed")
def test_missing_model_is_sent_to_worker(tmp_path, monkeypatch):
    from pydfo._calibration import simulation_executor as _engine

    calibration = decay()
    path = tmp_path / "elsewhere.fmu"
    path.write_bytes(open(pydfo.example_fmu("dahlquist"), "rb").read())
    data = {"time": TIMES, "x": np.exp(-1.7 * TIMES)}
    moved = pydfo.Calibration(path, data, ["x"], [pydfo.Parameter("k", 1, 0.1, 5)])
    state, content = moved._native.state(), None
    _, content = pydfo._core.Calibration.model_of(state)
    model = path.read_bytes()
    path.unlink()
    monkeypatch.setattr(_engine.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr(_engine, "_problems", {})
    problem = _engine.Problem(state, moved._opened, moved._functions)
    point = (np.array([1.7]), np.inf)
    loss = calibration_loss(moved)
    assert _engine.simulate(pydfo.__version__, "key", None, *point, loss).what == "problem"
    assert _engine.simulate(pydfo.__version__, "key", problem, *point, loss).what == "model"
    _, answer = _engine.simulate(pydfo.__version__, "key", problem._replace(model=model), *point, loss)
    again = _engine.simulate(pydfo.__version__, "key", None, *point, loss)[1]
    # Outcome, residuals and work precede the times and the checks, which only the second simulation makes.
    assert answer[: answer.index(b"checks")] == again[: again.index(b"checks")]
    (kept,) = tmp_path.glob("fmufit-models-*/*.fmu")
    # Another model at the same path is not used instead.
    path.write_bytes(open(pydfo.example_fmu("bouncing_ball"), "rb").read())
    monkeypatch.setattr(_engine, "_problems", {})
    assert _engine.simulate(pydfo.__version__, "key", problem, *point, loss)[1][:20] == answer[:20]
    kept.unlink()
    monkeypatch.setattr(_engine, "_problems", {})
    assert _engine.simulate(pydfo.__version__, "key", problem, *point, loss).what == "model"
    with pytest.raises(RuntimeError, match="has changed since"):
        _engine.simulate(pydfo.__version__, "key", problem._replace(model=path.read_bytes()), *point, loss)
    _engine.simulate(pydfo.__version__, "key", problem._replace(model=model), *point, loss)
    (kept,) = tmp_path.glob("fmufit-models-*/*.fmu")
    assert kept.stem == content and kept.parent.stat().st_mode & 0o777 == 0o700
    assert calibration.cost([1.7]) < 1e-6


class CountingSends(concurrent.futures.ProcessPoolExecutor):
    """An executor that counts the tasks with which the problem is sent."""

    n_sends = 0

    def submit(self, fn, /, *args, **kwargs):
        self.n_sends += args[2] is not None
        return super().submit(fn, *args, **kwargs)


def test_process_receives_each_problem_once(monkeypatch):
    # forked processes inherit the problems of this one
    monkeypatch.setattr("pydfo._calibration.simulation_executor._problems", {})

    def other():
        data = {"time": TIMES, "x": np.exp(-0.9 * TIMES)}
        return pydfo.Calibration(pydfo.example_fmu("dahlquist"), data, ["x"], [pydfo.Parameter("k", 1, 0.1, 5)])

    arguments = {"method": "de", "rng": 1, "max_evaluations": 90}
    with CountingSends(2) as executor:
        # a problem may also reach the process that has it already
        decay().fit(workers=executor, **arguments)
        assert 1 <= executor.n_sends <= 6
        other().fit(workers=executor, **arguments)
        assert executor.n_sends <= 12
        sent = executor.n_sends
        for calibration in (decay(), other(), decay()):
            calibration.fit(workers=executor, **arguments)
        assert executor.n_sends <= sent + 2


def test_other_version_of_the_module_is_rejected():
    from pydfo._calibration import simulation_executor as _engine

    with pytest.raises(ImportError, match=f"has fmufit {pydfo.__version__}, but the fit was started with 0.0.0"):
        _engine.simulate("0.0.0", "key", None, np.array([1.7]), np.inf, b"")


def calibration_loss(calibration):
    """Returns the linear loss in its serialized form."""
    seen = []

    class Watching(concurrent.futures.ThreadPoolExecutor):
        def submit(self, fn, /, *args, **kwargs):
            seen.append(args[-2])
            return super().submit(fn, *args, **kwargs)

    with Watching(1) as executor:
        decay().fit("nelder-mead", workers=executor, max_evaluations=3)
    return seen[0]


class Cancelling(concurrent.futures.ThreadPoolExecutor):
    """An executor that cancels every seventh task."""

    count = 0

    def submit(self, fn, /, *args, **kwargs):
        self.count += 1
        if self.count % 7 == 0:
            future = concurrent.futures.Future()
            future.cancel()
            future.set_running_or_notify_cancel()
            return future
        return super().submit(fn, *args, **kwargs)


def test_externally_cancelled_tasks_are_evaluated_again():
    with Cancelling(2) as executor:
        arguments = {"bounds": [(-2, 2)] * 2, "method": "de", "rng": 1, "max_evaluations": 120}
        result = pydfo.minimize(slow_cost, [-1.2, 1.0], workers=executor, **arguments)
    same(result, pydfo.minimize(slow_cost, [-1.2, 1.0], **arguments))
    assert result.nfail == 0 and result.n_lost > 10
    with pytest.raises(TypeError, match="the class ThreadPoolExecutor"):
        pydfo.minimize(slow_cost, [-1.2, 1.0], workers=concurrent.futures.ThreadPoolExecutor)


def test_costs_above_cutoff_are_identical_for_all_workers():
    def cost(x, *, cutoff):
        return slow_cost(x)

    def path(workers):
        trace = pydfo.minimize(cost, [-1.2, 1.0], method="nelder-mead", workers=workers, max_evaluations=60).trace
        return trace.fun[trace.used].tobytes(), trace.above[trace.used].tobytes()

    with concurrent.futures.ThreadPoolExecutor(3) as executor:
        assert path(1) == path(2) == path(executor) == path(map)


def kills_once(x, marker):
    """Kills its process once, at the first point in a region."""
    if x[0] > 0.4:
        try:
            os.close(os.open(marker, os.O_CREAT | os.O_EXCL))
        except FileExistsError:
            pass
        else:
            os._exit(9)
    return slow_cost(x)


def test_joblib_result_equals_serial_result():
    loky = pytest.importorskip("joblib.externals.loky")
    arguments = {"bounds": [(-2, 2)] * 2, "rng": 3, "max_evaluations": 120}
    executor = loky.get_reusable_executor(2)
    try:
        for method in ("nelder-mead", "de", "multistart"):
            same(
                pydfo.minimize(slow_cost, [0.2, 0.3], method=method, workers=executor, **arguments),
                pydfo.minimize(slow_cost, [0.2, 0.3], method=method, workers=1, **arguments),
            )
        assert (
            decay().fit("nelder-mead", workers=executor, max_evaluations=40).x.tobytes()
            == decay().fit("nelder-mead", workers=1, max_evaluations=40).x.tobytes()
        )
    finally:
        executor.shutdown(kill_workers=True)


def test_dask_repeats_tasks_of_killed_process(tmp_path):
    distributed = pytest.importorskip("distributed")
    marker = str(tmp_path / "killed")
    arguments = {"bounds": [(-2, 2)] * 2, "method": "de", "rng": 3, "max_evaluations": 120, "args": (marker,)}
    cluster = distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None)
    with cluster, distributed.Client(cluster) as client:
        result = pydfo.minimize(kills_once, [0.2, 0.3], workers=client, **arguments)
    assert os.path.exists(marker) and result.nfail == 0
    # The marker exists, so no further process is killed.
    same(result, pydfo.minimize(kills_once, [0.2, 0.3], workers=1, **arguments))


def test_silent_executor_is_logged(monkeypatch, caplog):
    class Silent(concurrent.futures.Executor):
        def submit(self, function, /, *arguments):
            return concurrent.futures.Future()

    monkeypatch.setattr(evaluate, "SILENCE", 0.1)
    with caplog.at_level(logging.WARNING, "pydfo"), pytest.raises(pydfo.PydfoError):
        pydfo.minimize(slow_cost, [0.2, 0.3], workers=Silent(), max_time=0.5)
    assert [record.getMessage().split(".")[0] for record in caplog.records] == ["no worker has answered in the first 0"]


#: Cancels tasks: differential evolution submits a generation, and the target ends the run before its end.
DASK = """
    import logging, time
    import distributed, pydfo
    from pydfo._optimize import evaluate

    def cost(x):
        time.sleep(0.005)
        return float((x[0] - 1.0) ** 2 + 10.0 * (x[1] + 0.5) ** 2 + x[0] * x[1])

    if __name__ == "__main__":
        logging.basicConfig()
        evaluate.SILENCE = 1.0
        cluster = distributed.LocalCluster(n_workers=3, threads_per_worker=1, dashboard_address=None)
        with cluster, distributed.Client(cluster) as client:
            asked = {"bounds": [(-2, 2)] * 2, "method": "de", "rng": 2, "target": -0.4, "max_evaluations": 300}
            alone = pydfo.minimize(cost, [0.2, 0.3], **asked)
            for workers in (client, client.get_executor()):
                result = pydfo.minimize(cost, [0.2, 0.3], workers=workers, **asked)
                assert result.nfev < 300 and (result.x.tobytes(), result.nfev) == (alone.x.tobytes(), alone.nfev)
            cluster.scale(0)
            while client.nthreads():
                time.sleep(0.05)
            try:
                pydfo.minimize(cost, [0.2, 0.3], workers=client, max_time=3.0)
            except pydfo.PydfoError:
                pass
        print("done")
"""


def test_dask_cancels_quietly_and_missing_workers_are_logged(tmp_path):
    pytest.importorskip("distributed")
    program = tmp_path / "program.py"
    program.write_text(textwrap.dedent(DASK))
    ran = subprocess.run([sys.executable, program], capture_output=True, text=True, timeout=600)
    assert ran.stdout == "done\n", ran.stderr
    assert "Traceback" not in ran.stderr and "because the cluster has no workers" in ran.stderr, ran.stderr


def results_are_equal(executor):
    arguments = {"bounds": [(-2, 2)] * 2, "rng": 3, "max_evaluations": 60}
    for method in ("nelder-mead", "de"):
        same(
            pydfo.minimize(rosenbrock, [0.2, 0.3], method=method, workers=executor, **arguments),
            pydfo.minimize(rosenbrock, [0.2, 0.3], method=method, workers=1, **arguments),
        )
    fits = [decay().fit("nelder-mead", workers=workers, max_evaluations=40) for workers in (executor, 1)]
    assert fits[0].x.tobytes() == fits[1].x.tobytes()


def test_ray_result_equals_serial_result():
    ray = pytest.importorskip("ray")
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, runtime_env={"env_vars": {"PYTHONPATH": os.pathsep.join(sys.path)}})
    try:

        @ray.remote
        def run(function, args, kwargs):
            return function(*args, **kwargs)

        class RayExecutor:
            _max_workers = 2

            def submit(self, function, /, *args, **kwargs):
                return run.remote(function, args, kwargs).future()

        results_are_equal(RayExecutor())
    finally:
        ray.shutdown()


def test_ipyparallel_result_equals_serial_result():
    ipyparallel = pytest.importorskip("ipyparallel")
    with ipyparallel.Cluster(n=2, log_level=logging.ERROR) as client:
        client[:].execute(f"import sys; sys.path[:0] = {sys.path!r}", block=True)
        results_are_equal(client.executor())


MPI = """
    import sys
    sys.path[:0] = {path!r}
    from mpi4py.futures import MPIPoolExecutor
    from test_executors import results_are_equal

    if __name__ == "__main__":
        with MPIPoolExecutor(2) as executor:
            results_are_equal(executor)
        print("done")
"""


def test_mpi_result_equals_serial_result(tmp_path):
    pytest.importorskip("mpi4py")
    launcher = shutil.which("mpiexec") or pytest.skip("mpiexec is not installed")
    program = tmp_path / "program.py"
    program.write_text(textwrap.dedent(MPI).format(path=[os.path.dirname(__file__), *sys.path]))
    version = subprocess.run([launcher, "--version"], capture_output=True, text=True).stdout
    options = ["--allow-run-as-root", "--oversubscribe"] if "Open MPI" in version else []
    command = [launcher, *options, "-n", "3", sys.executable, "-m", "mpi4py.futures", program]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert ran.stdout == "done\n", ran.stderr
