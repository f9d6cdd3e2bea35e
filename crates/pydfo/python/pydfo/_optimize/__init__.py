"""Minimisation of Python functions: the methods, their results and progress."""
