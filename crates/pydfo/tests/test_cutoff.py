"""Objectives that receive the cutoff and stop above it."""

from __future__ import annotations

import concurrent.futures
import functools
import math

import numpy as np
import pytest
from methods import METHODS, RUN, rosenbrock, timeless

import pydfo
from pydfo import Above, minimize


def gives_up(x, *, cutoff):
    cost = rosenbrock(x)
    return Above(cutoff) if cost > cutoff else cost


def shifted_gives_up(x, by, *, cutoff=math.inf):
    return gives_up(x - by, cutoff=cutoff)


@pytest.mark.parametrize("method", METHODS)
def test_stopping_at_cutoff_does_not_change_decisions(method):
    run = {**RUN, "method": method, "max_evaluations": 300}
    plain, less = minimize(rosenbrock, **run), minimize(gives_up, **run)
    assert plain.trace.x.tobytes() == less.trace.x.tobytes()
    assert (plain.x.tobytes(), plain.fun, plain.nit, plain.message) == (
        less.x.tobytes(), less.fun, less.nit, less.message,
    )  # fmt: skip
    given_up = ~np.isnan(less.trace.above)
    assert less.nfail == 0 and np.isnan(less.trace.fun[given_up]).all()
    # Abandoned evaluations were above the cutoff, and all others have equal costs.
    assert (plain.trace.fun[given_up] > less.trace.above[given_up]).all()
    assert plain.trace.fun[~given_up].tobytes() == less.trace.fun[~given_up].tobytes()
    # The genetic algorithm with fitness selection requires every cost, and so do models of the cost.
    assert given_up.any() == (method not in ("ga", "cma-es", "quadratic-model"))


def test_trace_is_identical_for_all_evaluators():
    run = {**RUN, "method": "de", "max_evaluations": 200}
    expected = timeless(minimize(gives_up, **run))
    assert timeless(minimize(gives_up, **run, workers=3)) == expected
    assert timeless(minimize(gives_up, **run, workers=map)) == expected
    with concurrent.futures.ProcessPoolExecutor(2) as pool:
        assert timeless(minimize(gives_up, **run, workers=pool)) == expected
    shifted = minimize(shifted_gives_up, **run, args=(np.zeros(2),))
    assert timeless(shifted) == expected
    assert timeless(minimize(functools.partial(shifted_gives_up, by=np.zeros(2)), **run)) == expected


def test_cutoff_is_passed_only_to_keyword_only_parameter():
    def positional(x, cutoff=3.0):
        assert cutoff == 3.0
        return rosenbrock(x)

    def anything(x, **others):
        assert not others
        return rosenbrock(x)

    for fun in (positional, anything):
        assert minimize(fun, **RUN, max_evaluations=20).nfev == 20
    with pytest.raises(TypeError, match=r"must return one number .* not Above\(cutoff=1"):
        minimize(lambda x: Above(1.0), **RUN)
    with pytest.raises(ValueError, match="vectorized=True evaluates many points at once"):
        minimize(gives_up, **RUN, vectorized=True)


def test_stopping_below_cutoff_is_a_failure():
    def early(x, *, cutoff):
        return Above(1.0) if x[0] > 0.0 else rosenbrock(x)

    res = minimize(early, **RUN, max_evaluations=100)
    assert res.nfail > 0 and any("the objective returned Above(1), although" in reason for reason in res.failures)
    with pytest.raises(TypeError, match="the cutoff of Above must return one number|cutoff of Above"):
        minimize(lambda x, *, cutoff: pydfo.Above("high"), **RUN)
