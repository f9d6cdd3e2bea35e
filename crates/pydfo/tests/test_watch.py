"""The page of a running fit."""

import copy
import http.client
import pickle
import re
import threading
import urllib.parse

import numpy as np
import pytest

from pydfo import Calibration, Interrupted, Parameter, example_fmu

TIME = np.linspace(0.0, 3.0, 31)


def decay(**settings):
    return Calibration(example_fmu("dahlquist"), {"time": TIME, "x": np.exp(-2.0 * TIME)}, ["x"], Parameter("k", 1.0, 0.1, 10.0), **settings)


def requested(url, method="GET", path=""):
    parts = urllib.parse.urlsplit(url)
    connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=30)
    try:
        connection.request(method, parts.path + path)
        response = connection.getresponse()
        return response.status, response.read().decode()
    finally:
        connection.close()


def address(capsys):
    [url] = re.findall(r"^watch the fit at (http://127\.0\.0\.1:\d+/[0-9a-f]{32}/)$", capsys.readouterr().err, re.M)
    return url


def test_report_is_served_as_long_as_the_fit_exists(capsys):
    plain = decay().fit(workers=1, rng=1)
    fit = decay().fit(workers=1, rng=1, watch=True)
    assert (fit.x == plain.x).all() and fit.cost == plain.cost and fit.nfev == plain.nfev
    url = address(capsys)
    status, report = requested(url)
    assert status == 200 and "The fit converged" in report and "</svg>" in report
    assert requested(url, path="state")[0] == 205
    assert requested(url.replace(url[-33:-1], "0" * 32))[0] == 404
    # Copies of the fit have no page.
    for other in (copy.deepcopy(fit), pickle.loads(pickle.dumps(fit))):
        assert (other.x == fit.x).all() and other._page is None
    del fit
    with pytest.raises(ConnectionError):
        requested(url)


def test_button_ends_the_fit(capsys):
    seen = []

    def press(progress):
        # On the calling thread, so another thread requests the page.
        if not seen:
            seen.append(address(capsys))
            threading.Thread(target=lambda: seen.append(requested(seen[0], "POST", "stop"))).start()

    fit = decay(solver="rk4", step_size=1e-5).fit("de", x_tol=0, f_tol=0, max_evaluations=10**9, workers=2, callback=press, watch=True)
    assert seen[1][0] == 303
    assert not fit.success and fit.termination == "interrupted" and fit.cost <= fit.start_cost
    status, report = requested(seen[0])
    # The search has already computed the responses, so the report needs no simulation.
    assert status == 200 and "interrupted" in report and "</svg>" in report
    status, text = requested(seen[0], "POST", "close")
    assert status == 200 and "closed" in text


@pytest.mark.parametrize("settings", [{}, {"solver": "rk4", "step_size": 1e-4}])
def test_stop_before_any_result_is_an_interrupt(monkeypatch, settings):
    """Ends the fit while the solver is chosen, and at the first evaluation."""
    monkeypatch.setattr("builtins.print", lambda text, **_: requested(text.split()[-1], "POST", "stop"))
    with pytest.raises(Interrupted) as info:
        decay(**settings).fit(rng=1, watch=True)
    assert info.value.result is None


@pytest.mark.parametrize("wrong", [{"loss": "soft"}, {"method": "simplex"}, {"options": {"batchh": 1}}, {"stages": [["nobody"]]}, {"workers": 0}])
def test_address_is_shown_only_for_valid_arguments(capsys, wrong):
    with pytest.raises((ValueError, KeyError)):
        decay().fit(watch=True, **wrong)
    assert capsys.readouterr().err == ""


def test_fit_is_not_watched_by_default(capsys):
    assert decay().fit()._page is None and capsys.readouterr().err == ""
    with pytest.raises((TypeError, ValueError), match="watch"):
        decay().fit(watch="yes")
