"""Start of processes for FMUs by the native code: this interpreter with only the native module."""

from __future__ import annotations

import os
import sys

from .. import _core

#: Neither numpy nor other parts of the package are imported. The standard library is limited to the modules of
#: Python's start: importing `importlib.util` alone would take half as long again.
_PROGRAM = """
import sys
sys.path.insert(0, sys.argv[1])
import _core
del sys.path[0]
_core.serve_worker()
"""


def interpreter() -> str | None:
    """Returns the running interpreter, even if `sys.executable` is a program that embeds one."""
    name = f"python{sys.version_info.major}.{sys.version_info.minor}"
    of_this_interpreter = [sys.executable, getattr(sys, "_base_executable", None)]
    of_folders = [os.path.join(folder, "bin", name) for folder in (sys.exec_prefix, sys.base_exec_prefix)]
    for program in (*of_this_interpreter, *of_folders):
        is_python = program and os.path.basename(program).lower().startswith(("python", "pypy"))
        if program and is_python and os.access(program, os.X_OK):
            return program
    return None


#: True if worker processes can be started.
has_interpreter = False


def set_interpreter() -> None:
    """Registers this interpreter as the starter of worker processes."""
    global has_interpreter
    if (program := interpreter()) is not None:
        library = os.path.abspath(_core.__file__)
        _core.set_launcher(program, ["-I", "-S", "-c", _PROGRAM, os.path.dirname(library)], library)
        has_interpreter = True
