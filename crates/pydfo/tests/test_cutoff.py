"""Objectives that are told the cutoff, and give up above it."""

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
def test_giving_up_changes_no_decision(method):
    run = {**RUN, "method": method, "max_evaluations": 300}
    plain, less = minimize(rosenbrock, **run), minimize(gives_up, **run)
    assert plain.trace.x.tobytes() == less.trace.x.tobytes()
    assert (plain.x.tobytes(), plain.fun, plain.nit, plain.message) == (
        less.x.tobytes(), less.fun, less.nit, less.message,
    )  # fmt: skip
    given_up = ~np.isnan(less.trace.above)
    assert less.nfail == 0 and np.isnan(less.trace.fun[given_up]).all()
    # What was given up was above, and what was not given up has the same cost.
    assert (plain.trace.fun[given_up] > less.trace.above[given_up]).all()
    assert plain.trace.fun[~given_up].tobytes() == less.trace.fun[~given_up].tobytes()
    # The genetic algorithm with its selection by fitness needs every cost, and so do models of the cost.
    assert given_up.any() == (method not in ("ga", "cma-es", "quadratic-model"))


def test_every_way_of_calling_gives_the_same_trace():
    run = {**RUN, "method": "de", "max_evaluations": 200}
    expected = timeless(minimize(gives_up, **run))
    assert timeless(minimize(gives_up, **run, workers=3)) == expected
    assert timeless(minimize(gives_up, **run, workers=map)) == expected
    with concurrent.futures.ProcessPoolExecutor(2) as pool:
        assert timeless(minimize(gives_up, **run, workers=pool)) == expected
    shifted = minimize(shifted_gives_up, **run, args=(np.zeros(2),))
    assert timeless(shifted) == expected
    assert timeless(minimize(functools.partial(shifted_gives_up, by=np.zeros(2)), **run)) == expected


def test_only_a_keyword_of_its_own_asks_for_the_cutoff():
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


def test_giving_up_too_early_is_a_failure_and_a_cutoff_is_a_number():
    def early(x, *, cutoff):
        return Above(1.0) if x[0] > 0.0 else rosenbrock(x)

    res = minimize(early, **RUN, max_evaluations=100)
    assert res.nfail > 0 and any("given up above 1, although" in reason for reason in res.failures)
    with pytest.raises(TypeError, match="the cutoff of Above must return one number|cutoff of Above"):
        minimize(lambda x, *, cutoff: pydfo.Above("high"), **RUN)
