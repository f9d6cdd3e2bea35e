"""The functions of FMI one by one: an instance of an FMU that is driven by hand, its steps and its linearisation."""

from __future__ import annotations

from ._model.instance import EventInfo, Instance, LinearSystem, SavedState, StepInfo, instantiate

__all__ = ["EventInfo", "Instance", "LinearSystem", "SavedState", "StepInfo", "instantiate"]
