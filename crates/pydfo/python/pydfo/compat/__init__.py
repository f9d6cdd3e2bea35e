"""The names of other tools: `pydfo.compat.fmpy` and `pydfo.compat.pyfmi`, for scripts whose import lines alone change."""
