"""Optimizer: controlled by the user, in any order, with checkpoints."""

from __future__ import annotations

import random

import numpy as np
import pytest
from methods import METHODS, RUN, rosenbrock, timeless

import pydfo
from pydfo import Optimizer, minimize


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("k", [1, 3, None])
def test_any_order_and_grouping_gives_the_run_of_minimize(method, k):
    chance = random.Random(k)
    run = {**RUN, "max_evaluations": 300}
    driven = timeless(minimize(rosenbrock, **run, method=method))
    opt = Optimizer(method, **run)
    waiting = []
    while not opt.done:
        ids, points, cutoffs = opt.ask(k)
        assert points.shape == (len(ids), 2) and cutoffs.shape == ids.shape
        waiting += zip(ids, points)
        assert opt.n_pending == len(waiting)
        chance.shuffle(waiting)
        for _ in range(chance.randrange(1, len(waiting) + 1)):
            number, point = waiting.pop()
            if chance.random() < 0.1:
                opt.tell(number, ...)
            else:
                opt.tell(number, rosenbrock(point))
    assert timeless(opt.report()) == driven
    x, fun = opt.best
    assert (x.tobytes(), fun) == driven[:2] and opt.ask().ids.size == 0


@pytest.mark.parametrize("method", METHODS)
def test_optimizer_resumes_from_checkpoint_at_any_point(method, tmp_path):
    chance = random.Random(method)
    run = {**RUN, "max_evaluations": 200, "checkpoint": tmp_path / "run", "options": {"trace_limit": 150}}
    n_told = 0
    while True:
        opt = Optimizer(method, **run)
        left = chance.randrange(1, 40)
        while not opt.done and left > 0:
            ids, points, _ = opt.ask(min(left, 7))
            opt.tell(ids[::-1], [rosenbrock(x) for x in points[::-1]])
            left, n_told = left - len(ids), n_told + len(ids)
        if opt.done:
            break
        opt.save()
    run["checkpoint"] = None
    assert timeless(opt.report()) == timeless(minimize(rosenbrock, **run, method=method))
    assert n_told == opt.report().nfev and len(opt.report().trace) == min(n_told, 150)


def test_none_nan_and_exceptions_mean_failed():
    opt = Optimizer("nelder-mead", [1.0, 1.0], max_evaluations=20)
    ids, points, _ = opt.ask()
    opt.tell(ids, [1.0, None, np.nan])
    ids, _, _ = opt.ask()
    opt.tell(ids[0], ZeroDivisionError("by zero"))
    while not opt.done:
        ids, points, _ = opt.ask()
        opt.tell(ids, np.array([rosenbrock(x) for x in points]))
    failures = opt.report().failures
    assert failures == {"no value": 1, "cost is NaN": 1, "ZeroDivisionError: by zero": 1}


def test_misuse_is_rejected_and_early_ends_are_handled():
    opt = Optimizer("de", **RUN)
    assert opt.best is None and "no cost yet" in repr(opt) and not opt.done
    with pytest.raises(pydfo.NoResult):
        opt.report()
    with pytest.raises(KeyError, match="point 0 is not waiting"):
        opt.tell(0, 1.0)
    ids, _, _ = opt.ask(5)
    with pytest.raises(ValueError, match="got 2 values for 5 points"):
        opt.tell(ids, [1.0, 2.0])
    with pytest.raises(TypeError, match="must return one number"):
        opt.tell(ids[0], "one")
    with pytest.raises(ValueError):
        opt.ask(-1)
    opt.tell(ids[3:], [4.0, 3.0])
    with pytest.raises(KeyError):
        opt.tell(ids[3], 4.0)
    opt.stop()
    opt.stop()
    assert opt.done and opt.report().termination == "interrupted" and opt.report().fun == 3.0
    assert opt.report().nfev == 2
    with pytest.raises(ValueError, match="did you mean 'de'"):
        Optimizer("dee", **RUN)
    wide = Optimizer("nelder-mead", [1.0, 1.0], workers=4)
    wide.tell(wide.ask().ids, [3.0, 2.0, 1.0])
    assert len(wide.ask().ids) == 4


@pytest.mark.parametrize("method", METHODS)
def test_stopping_above_cutoff_does_not_change_decisions(method):
    run = {**RUN, "max_evaluations": 300}
    opt = Optimizer(method, **run)
    given_up = 0
    while not opt.done:
        ids, points, cutoffs = opt.ask()
        costs = [rosenbrock(x) for x in points]
        outcomes = [pydfo.Above(c) if f > c else f for f, c in zip(costs, cutoffs)]
        given_up += sum(isinstance(t, pydfo.Above) for t in outcomes)
        opt.tell(ids, outcomes)
    driven, report = minimize(rosenbrock, **run, method=method), opt.report()
    assert report.trace.x.tobytes() == driven.trace.x.tobytes()
    assert (report.x.tobytes(), report.fun, report.nit) == (driven.x.tobytes(), driven.fun, driven.nit)
    assert report.nfail == 0 and given_up == np.isnan(report.trace.fun).sum()
    assert given_up > 0 or method in ("ga", "cma-es", "quadratic-model")


def test_cutoff_below_the_requested_one_is_a_failure():
    opt = Optimizer("nelder-mead", [1.0, 2.0])
    ids, _, cutoffs = opt.ask()
    assert np.isinf(cutoffs).all()
    opt.tell(ids, [3.0, pydfo.Above(1.0), 2.0])
    assert opt.report().failures == {"the objective returned Above(1), although the cutoff is inf": 1}
    with pytest.raises(TypeError, match="the cutoff of Above must be a number"):
        opt.tell(opt.ask().ids[0], pydfo.Above("a"))


def test_unknown_ids_are_rejected():
    opt = Optimizer("nelder-mead", [1.0, 2.0])
    opt.ask(2**70)
    for number in (-1, 3, 2**70):
        with pytest.raises(KeyError, match="not waiting"):
            opt.tell(number, 1.0)
        with pytest.raises(KeyError, match="not waiting"):
            opt.tell(np.array([number], dtype=object), [1.0])
    for number in (0.5, "a", None):
        with pytest.raises(TypeError):
            opt.tell(number, 1.0)
