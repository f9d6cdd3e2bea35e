"""Options of simulations as PyFMI's nested dictionaries, and their conversion to arguments of `FMUModel.simulate`."""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Mapping
from typing import Any

from .._refused import refuse
from .exceptions import InvalidOptionException, UnrecognizedOptionError

#: PyFMI's solvers and their counterparts in pydfo.
SOLVERS = {
    "CVode": "auto",
    "Radau5ODE": "radau5",
    "Dopri5": "tsit5",
    "RungeKutta34": "tsit5",
    "LSODAR": "auto",
    "ExplicitEuler": "euler",
}
_OTHERS = {"RodasODE": "Radau5ODE", "ImplicitEuler": "Radau5ODE"}


class Options(dict[str, Any]):
    """A dict with a fixed set of names. Values that are dicts are updated, not replaced."""

    def __init__(self, defaults: Mapping[str, Any]) -> None:
        super().__init__(defaults)

    def __setitem__(self, name: str, value: Any) -> None:
        if name not in self:
            nearest = difflib.get_close_matches(str(name), list(self), n=1)
            hint = f"; did you mean {nearest[0]!r}?" if nearest else ""
            raise UnrecognizedOptionError(f"unknown option {name!r}{hint}")
        super().__setitem__(name, value)

    def update(self, *given: Any, **more: Any) -> None:
        """Sets options; values that are dicts are updated."""
        for name, value in dict(*given, **more).items():
            if isinstance(self.get(name), dict) and isinstance(value, Mapping):
                self[name].update(value)
            else:
                self[name] = value


_COMMON = {
    "ncp": 500,
    "initialize": True,
    "write_scaled_result": False,
    "result_file_name": "",
    "result_handling": "binary",
    "result_handler": None,
    "result_max_size": 2e9,
    "result_store_variable_description": True,
    "return_result": True,
    "filter": None,
    "synchronize_simulation": False,
}
_TOLERANCES = {"atol": "Default", "rtol": "Default", "maxh": "Default"}


def default_options(kind: str) -> Options:
    """Returns the options of a kind ("ME", "CS") with their defaults."""
    if kind == "CS":
        return Options({**_COMMON, "stop_time_defined": False, "time_limit": None, "silent_mode": False, "result_downsampling_factor": 1})
    solvers: dict[str, dict[str, Any]] = {f"{name}_options": dict(_TOLERANCES) for name in (*SOLVERS, *_OTHERS)}
    solvers["CVode_options"] |= {"discr": "BDF", "iter": "Newton", "external_event_detection": False}
    solvers["ExplicitEuler_options"], solvers["ImplicitEuler_options"] = {}, {}
    more = {"solver": "CVode", "sensitivities": None, "with_jacobian": "Default", "logging": False, "dynamic_diagnostics": False}
    return Options({**_COMMON, **more, "extra_equations": None, **solvers})


_REASONS = {
    "initialize": (True, "drive the instance with pydfo.fmi.instantiate(), initialize() and do_step()"),
    "result_handler": (None, "the result is in memory; use SimulationResult.to_csv, to_dataframe or to_xarray"),
    "synchronize_simulation": (False, "real-time simulation is not supported"),
    "sensitivities": (None, "use fit.uncertainty() of a pydfo.Calibration to estimate sensitivities"),
    "extra_equations": (None, "use pydfo.ode.solve for systems written in Python"),
    "dynamic_diagnostics": (False, "res.native.stats contains the counts of a simulation, and .events contains its events"),
    "logging": (False, "res.native.stats contains the counts of a simulation, and .events contains its events"),
    "result_downsampling_factor": (1, "use a smaller ncp"),
    "write_scaled_result": (False, "values are not scaled"),
}
_HANDLINGS = ("binary", "memory", "file", "csv", None)


def arguments(options: Mapping[str, Any], kind: str, suggested: float | None) -> dict[str, Any]:
    """Returns the arguments of `FMUModel.simulate`; `suggested` is the tolerance of the default experiment."""
    for name, (allowed, reason) in _REASONS.items():
        if name in options and options[name] != allowed:
            refuse(f"simulate(options={{{name!r}: {options[name]!r}}})", reason)
    if options["result_handling"] not in _HANDLINGS:
        refuse(f"result_handling={options['result_handling']!r}", "the result is in memory; use SimulationResult.to_csv, to_dataframe or to_xarray")
    if not options["ncp"]:
        refuse("ncp=0", "rows have a regular spacing; record_events of FMUModel.simulate adds rows at events")
    made: dict[str, Any] = {"ncp": options["ncp"], "outputs": options["filter"] if options["filter"] is not None else "all"}
    if kind == "CS":
        return {**made, "max_time": options["time_limit"]}
    solver = options["solver"]
    if solver in _OTHERS:
        refuse(f"solver={solver!r}", f"{_OTHERS[solver]} (radau5) also supports stiff systems")
    if solver not in SOLVERS:
        raise InvalidOptionException(f"solver must be one of {', '.join(SOLVERS)}, not {solver!r}")
    given = options[f"{solver}_options"]
    without = [name for name, value in given.items() if name not in ("rtol", "maxh", "h") and value != default_options(kind)[f"{solver}_options"].get(name)]
    if without:
        warnings.warn(f"{', '.join(without)} of {solver}_options have no effect (absolute tolerances are derived from rtol and the nominal values)", stacklevel=4)
    made["solver"] = SOLVERS[solver]
    if solver == "ExplicitEuler":
        return {**made, "step_size": given.get("h")}
    rtol, maxh = given.get("rtol", "Default"), given.get("maxh", "Default")
    made["relative_tolerance"] = (suggested or 1e-4) if rtol == "Default" else rtol
    return made if maxh == "Default" or not maxh else {**made, "max_step": maxh}
