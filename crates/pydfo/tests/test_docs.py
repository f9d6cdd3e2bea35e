"""The documentation: examples are correct, and every public name is documented."""

from __future__ import annotations

import doctest
import importlib
import inspect
import pkgutil
import subprocess
import sys

import pytest

import pydfo

MODULES = [f"pydfo.{module.name}" for module in pkgutil.walk_packages(pydfo.__path__) if not module.ispkg]


@pytest.mark.parametrize("name", [m for m in MODULES if m != "pydfo._core"])
def test_docstring_examples_are_correct(name):
    module = importlib.import_module(name)
    failed, _ = doctest.testmod(module, optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    assert failed == 0 and module.__doc__


def test_import_defers_unused_modules():
    """The import loads neither numpy nor most of the package, and an unknown name is rejected."""
    program = """
import sys, pydfo
assert not {"numpy", "pydfo._calibration.calibration", "pydfo._model.model"} & set(sys.modules)
assert set(pydfo.__all__) <= set(dir(pydfo)) and not hasattr(pydfo, "Calibrations")
from pydfo import Calibration, dfo
assert pydfo.Calibration is Calibration is sys.modules["pydfo._calibration.calibration"].Calibration
assert pydfo.dfo is dfo is sys.modules["pydfo.dfo"]
"""
    subprocess.run([sys.executable, "-c", program], check=True)


@pytest.mark.parametrize("name", sorted(set(pydfo.__all__) - {"__version__"}))
def test_public_names_are_documented(name):
    thing = getattr(pydfo, name)
    assert inspect.getdoc(thing)
    for member, value in vars(thing).items() if inspect.isclass(thing) else ():
        if not member.startswith("_") and (inspect.isfunction(value) or isinstance(value, property)):
            assert inspect.getdoc(value), f"{name}.{member}"
