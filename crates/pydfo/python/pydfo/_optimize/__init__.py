"""Minimisation of Python functions: methods, results and progress."""
