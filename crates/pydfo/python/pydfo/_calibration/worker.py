"""How the native code starts processes in which FMUs run: this interpreter, with the native module alone."""

from __future__ import annotations

import os
import sys

from .. import _core

#: Neither numpy nor anything else of the package is imported, and of the standard library only what Python starts with: the import of
#: `importlib.util` alone would take half as long again.
_PROGRAM = """
import sys
sys.path.insert(0, sys.argv[1])
import _core
del sys.path[0]
_core.serve_worker()
"""


def interpreter() -> str | None:
    """The interpreter that runs here, also where `sys.executable` names a program that only embeds one."""
    name = f"python{sys.version_info.major}.{sys.version_info.minor}"
    own = [sys.executable, getattr(sys, "_base_executable", None)]
    of_folders = [os.path.join(folder, "bin", name) for folder in (sys.exec_prefix, sys.base_exec_prefix)]
    for program in (*own, *of_folders):
        is_python = program and os.path.basename(program).lower().startswith(("python", "pypy"))
        if program and is_python and os.access(program, os.X_OK):
            return program
    return None


#: Whether worker processes can be started.
is_known = False


def know_interpreter() -> None:
    """Has worker processes started by this interpreter."""
    global is_known
    if (program := interpreter()) is not None:
        library = os.path.abspath(_core.__file__)
        _core.set_launcher(program, ["-I", "-S", "-c", _PROGRAM, os.path.dirname(library)], library)
        is_known = True
