"""Several criteria at once: `pareto` and its front."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import pydfo

BOX = [(-3.0, 3.0), (-3.0, 3.0)]


def distances(x):
    """Squared distances to (1, 0) and (-1, 0): on the front, the sum of the distances is 2."""
    return [(x[0] - 1) ** 2 + x[1] ** 2, (x[0] + 1) ** 2 + x[1] ** 2]


def test_pareto_finds_the_front_of_two_convex_criteria():
    front = pydfo.pareto(distances, BOX, names=("to the right", "to the left"), rng=1, max_evaluations=4000)
    assert front.x.shape == front.criteria.shape == (100, 2) and front.success and front.status == 1
    assert abs(np.sqrt(front.criteria).sum(axis=1) - 2).max() < 0.05
    assert (np.diff(front.criteria[:, 0]) >= 0).all() and front.nfev == 4000
    assert abs(front.x[front.compromise, 0]) < 0.1
    assert 0.98 < front.hypervolume([4, 4]) / (16 - 8 / 3) < 1
    text = repr(front)
    assert "to the right" in text and "100 points" in text and len(text.splitlines()) == 17
    assert len(front.table().splitlines()) == 101
    with pytest.raises(ValueError, match="reference has 3 values; expected 2"):
        front.hypervolume([4, 4, 4])


def test_workers_vectorization_and_resume_do_not_change_a_front(tmp_path):
    whole = pydfo.pareto(distances, BOX, population=20, rng=3, max_evaluations=500)
    same = [
        pydfo.pareto(distances, BOX, population=20, rng=3, max_evaluations=500, workers=2),
        pydfo.pareto(distances, BOX, population=20, rng=3, max_evaluations=500, vectorized=True),
    ]
    with ThreadPoolExecutor(2) as pool:
        same.append(pydfo.pareto(distances, BOX, population=20, rng=3, max_evaluations=500, workers=pool))
    for budget in (130, 500):
        same.append(pydfo.pareto(distances, BOX, population=20, rng=3, max_evaluations=budget, checkpoint=tmp_path / "run"))
    del same[3]
    for front in same:
        assert (front.x == whole.x).all() and (front.criteria == whole.criteria).all()
    with pytest.raises(pydfo.CheckpointError, match="population"):
        pydfo.pareto(distances, BOX, rng=3, checkpoint=tmp_path / "run")


def test_constraints_hold_on_the_front_and_an_empty_front_is_no_success():
    outside = pydfo.NonlinearConstraint(lambda x: x[0] ** 2 + x[1] ** 2, 0.25, np.inf)
    front = pydfo.pareto(distances, BOX, constraints=outside, rng=1, max_evaluations=3000)
    assert ((front.x**2).sum(axis=1) >= 0.25 - 1e-6).all() and front.success
    never = pydfo.NonlinearConstraint(lambda x: x[0] + x[1], 100, 200)
    empty = pydfo.pareto(distances, BOX, constraints=never, rng=1, max_evaluations=500)
    assert not empty.success and empty.compromise is None and len(empty.x) == 0
    assert empty.constr_violation > 93 and "no evaluated point is feasible" in repr(empty)


def test_callback_receives_the_front_and_exceptions_carry_it():
    seen = []

    def callback(progress):
        seen.append(progress)
        return progress.nit == 3

    front = pydfo.pareto(distances, BOX, rng=1, callback=callback)
    assert front.nit == 3 and front.status == 4 and len(seen) == 4
    x, criteria = seen[-1].front
    assert (x == front.x).all() and (criteria == front.criteria).all()

    def broken(x):
        if x[0] > 2.5:
            raise OSError("no licence")
        return distances(x)

    with pytest.raises(OSError, match="no licence") as caught:
        pydfo.pareto(broken, BOX, rng=1)
    assert isinstance(caught.value.partial_result, pydfo.ParetoFront)
    tolerant = pydfo.pareto(broken, BOX, rng=1, on_error="fail", max_evaluations=1000)
    assert tolerant.nfail > 0 and (tolerant.x[:, 0] <= 2.5).all()


def test_pareto_rejects_unusable_arguments():
    with pytest.raises(ValueError, match="finite bounds"):
        pydfo.pareto(distances, [(-3, 3), (0, None)])
    with pytest.raises(ValueError, match="crossover_rate = 2"):
        pydfo.pareto(distances, BOX, options={"crossover_rate": 2.0})
    with pytest.raises(ValueError, match="nsga2 has no option 'selection'"):
        pydfo.pareto(distances, BOX, options={"selection": 3})
    with pytest.raises(TypeError, match="one-dimensional"):
        pydfo.pareto(lambda x: x[0], BOX)
    with pytest.raises(ValueError, match="2 criteria"):
        pydfo.pareto(distances, BOX, names=("one",), max_evaluations=200)


def test_front_is_drawn_and_exported():
    pytest.importorskip("matplotlib")
    pandas = pytest.importorskip("pandas")
    three = pydfo.pareto(lambda x: [*distances(x), (x[1] - 1) ** 2], BOX, rng=1, max_evaluations=600)
    figure = three.plot()
    assert sum(axes.get_visible() and axes.axison for axes in figure.axes) == 3
    frame = three.to_dataframe()
    assert isinstance(frame, pandas.DataFrame) and list(frame) == ["f[0]", "f[1]", "f[2]", "x[0]", "x[1]"]
