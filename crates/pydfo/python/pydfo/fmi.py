"""The individual functions of FMI: an instance of an FMU controlled call by call, its steps and its linearisation."""

from __future__ import annotations

from ._model.instance import EventInfo, Instance, LinearSystem, SavedState, StepInfo, instantiate

__all__ = ["EventInfo", "Instance", "LinearSystem", "SavedState", "StepInfo", "instantiate"]
