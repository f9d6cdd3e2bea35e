"""The command line ``fmufit``, also ``python -m pydfo``; see ``fmufit --help``."""

from __future__ import annotations

import signal
import sys

from . import _core


def main() -> int:
    """Runs the command given by the arguments of this program and returns the exit code."""
    # The command line handles Ctrl-C itself: a fit ends with the best point.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        return _core.command_line(["fmufit", *sys.argv[1:]])
    except NotImplementedError as e:  # a module without it, as `make demo` builds it for speed
        sys.stderr.write(f"error: {e}\n")
        return 2


if __name__ == "__main__":
    sys.exit(main())
