"""Changes of the process environment do not reach FMUs."""

from __future__ import annotations

import ctypes
import locale
import math
import shutil
import subprocess

import fmus
import pytest
from fmus import same_bits

from pydfo import FMUModel


@pytest.fixture
def comma(tmp_path, monkeypatch):
    """Sets a locale with a decimal comma, and restores the locale of the process."""
    made = tmp_path / "locales" / "xx_XX"
    made.parent.mkdir()
    tool = shutil.which("localedef")
    # Its warnings, and its exit status, are irrelevant here.
    if tool is not None:
        subprocess.run([tool, "-c", "-i", "de_DE", "-f", "UTF-8", made], capture_output=True, check=False)
    if not made.is_dir():
        pytest.skip("needs localedef and the sources of locales (Debian: the package locales)")
    monkeypatch.setenv("LOCPATH", str(made.parent))
    before = locale.setlocale(locale.LC_ALL)
    yield "xx_XX"
    locale.setlocale(locale.LC_ALL, before)


def test_decimal_comma_does_not_affect_the_model(tmp_path, comma):
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
