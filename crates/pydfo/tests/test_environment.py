"""What FMUs do to their process is undone, and what the process does does not reach them."""

from __future__ import annotations

import ctypes
import locale
import math
import os
import shutil
import signal
import subprocess

import fmus
import pytest
from fmus import same_bits

import pydfo
from pydfo import FMUModel


@pytest.fixture
def comma(tmp_path, monkeypatch):
    """A locale with a decimal comma; the locale of the process is put back."""
    made = tmp_path / "locales" / "xx_XX"
    made.parent.mkdir()
    tool = shutil.which("localedef")
    # It warns, and says so by its status, of what does not matter here.
    if tool is not None:
        subprocess.run([tool, "-c", "-i", "de_DE", "-f", "UTF-8", made], capture_output=True, check=False)
    if not made.is_dir():
        pytest.skip("needs localedef and the sources of locales (Debian: the package locales)")
    monkeypatch.setenv("LOCPATH", str(made.parent))
    before = locale.setlocale(locale.LC_ALL)
    yield "xx_XX"
    locale.setlocale(locale.LC_ALL, before)


def test_a_decimal_comma_does_not_reach_the_model(tmp_path, comma):
    path = fmus.evil(tmp_path / "m.fmu", "USES_STRTOD")
    truth = FMUModel(path).simulate(ncp=10)
    assert truth.final("y") == pytest.approx(math.exp(-1.5), abs=1e-5)
    locale.setlocale(locale.LC_ALL, comma)
    strtod = ctypes.CDLL(None).strtod
    strtod.restype = ctypes.c_double
    strtod.argtypes = [ctypes.c_char_p, ctypes.c_void_p]
    assert strtod(b"1,5", None) == 1.5
    assert same_bits(FMUModel(path).simulate(ncp=10), truth)
    assert (strtod(b"1,5", None), locale.setlocale(locale.LC_ALL)) == (1.5, comma)


@pytest.mark.parametrize("place", [1, 3, 5])
def test_a_model_that_sets_the_locale_leaves_no_trace(tmp_path, comma, monkeypatch, place):
    monkeypatch.setenv("EVIL_LOCALE", comma)
    path = fmus.evil(tmp_path / "m.fmu", f"LOCALE_IN={place}", "USES_STRTOD")
    before = locale.setlocale(locale.LC_ALL)
    model = FMUModel(path)
    results = [model.simulate(ncp=10), model.simulate(ncp=10)]
    model.close()
    assert locale.setlocale(locale.LC_ALL) == before
    assert results[0].final("y") == pytest.approx(math.exp(-1.5), abs=1e-5)
    assert same_bits(*results)


@pytest.mark.parametrize("place", [1, 3, 4, 5, 6])
def test_ctrl_c_is_handled_as_before(tmp_path, place):
    path = fmus.evil(tmp_path / "m.fmu", f"SIGNALS_IN={place}")
    model = FMUModel(path, kind="CS" if place == 4 else "ME")
    for _ in range(2):
        model.simulate(ncp=10)
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
            for _ in range(1000):
                pass
    model.close()
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)
        for _ in range(1000):
            pass


def test_ctrl_c_during_a_fit_of_a_model_that_ignores_it(tmp_path):
    # It does so at the start of each run, which takes some 8 s.
    path = fmus.evil(tmp_path / "m.fmu", "SIGNALS_IN=6", "SLOW=2000")
    data = {"time": [0.0, 0.5, 1.0], "y": [1.0, 0.6, 0.37]}
    calibration = pydfo.Calibration(path, data, ["y"], pydfo.Parameter("k", 1.3, 0.1, 5.0), solver="rk4", step_size=1e-3)
    # Within the first trial run: it is ended after 2 s, and for some 20 ms at the start of the next the model ignores the signal.
    with subprocess.Popen(["sh", "-c", f"sleep 1; kill -INT {os.getpid()}"]) as killer:
        with pytest.raises(pydfo.Interrupted):
            calibration.fit(workers=1)
        killer.wait()
