"""How the native code starts processes in which FMUs run: this interpreter, with the native module alone."""

from __future__ import annotations

import os
import sys

from . import _core

#: Neither numpy nor anything else of the package is imported.
_PROGRAM = """
import importlib.machinery as m, importlib.util as u, sys
s = u.spec_from_loader("_core", m.ExtensionFileLoader("_core", sys.argv[1]))
c = u.module_from_spec(s)
s.loader.exec_module(c)
c.serve_worker()
"""


def know_interpreter() -> None:
    """Has worker processes started by this interpreter; a program that only embeds one cannot be started so."""
    program = sys.executable
    name = os.path.basename(program or "").lower()
    if name.startswith(("python", "pypy")):
        _core.set_launcher(program, ["-I", "-S", "-c", _PROGRAM, os.fspath(_core.__file__)])
