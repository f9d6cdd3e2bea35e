"""The names of other tools: `pydfo.compat.fmpy` and `pydfo.compat.pyfmi`, for scripts that change only their
imports."""
