"""The parts of PyFMI's models based on the model description: variables and general information."""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..._model.description import Capabilities, TypeDefinition, Variable
from ..._model.model import FMUModel
from . import constants
from .exceptions import FMUException


@dataclass(frozen=True)
class ScalarVariable:
    """A variable; type, causality, variability and initial are PyFMI's numbers."""

    name: str
    value_reference: int
    type: int
    description: str
    variability: int
    causality: int
    alias: int
    initial: int


class DescribedModel:
    """The variables and facts of a model."""

    def __init__(self, model: FMUModel) -> None:
        self._model = model
        self._description = model.description
        self._version = int(self._description.fmi_version[0])

    # --- variables ----------------------------------------------------------------------------------------------------

    def _variable(self, name: str) -> Variable:
        return self._description.variables[name]

    @cached_property
    def _first_names(self) -> dict[tuple[str, int], str]:
        """Returns the first name of each pair of type and value reference."""
        first: dict[tuple[str, int], str] = {}
        for name, v in self._description.variables.items():
            first.setdefault((v.type, v.value_reference), name)
        return first

    def _scalar(self, name: str) -> ScalarVariable:
        v, version = self._variable(name), self._version
        return ScalarVariable(
            name,
            v.value_reference,
            constants.type_number(version, v.type),
            v.description or "",
            constants.variability_number(version, v.variability),
            constants.causality_number(version, v.causality),
            int(self._first_names[v.type, v.value_reference] != name),
            constants.initial_number(version, v.initial),
        )

    def get_model_variables(
        self,
        type: int | None = None,
        include_alias: bool = True,
        causality: int | None = None,
        variability: int | None = None,
        only_start: bool = False,
        only_fixed: bool = False,
        filter: str | Sequence[str] | None = None,
    ) -> dict[str, ScalarVariable]:
        """Returns the variables by name.

        They can be filtered by type, causality or variability (PyFMI's numbers), by a start value, or by a pattern of
        the name."""
        patterns = None if filter is None else [filter] if isinstance(filter, str) else list(filter)
        seen: set[tuple[str, int]] = set()
        found = {}
        for name, v in self._description.variables.items():
            scalar = self._scalar(name)
            is_alias = (v.type, v.value_reference) in seen
            seen.add((v.type, v.value_reference))
            filters = ((type, scalar.type), (causality, scalar.causality), (variability, scalar.variability))
            if any(wanted is not None and wanted != has for wanted, has in filters) or (is_alias and not include_alias):
                continue
            if (only_start and v.start is None) or (only_fixed and v.initial != "exact"):
                continue
            if patterns is None or any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns):
                found[name] = scalar
        return found

    def get_scalar_variable(self, variable_name: str) -> ScalarVariable:
        """Returns a variable."""
        return self._scalar(variable_name)

    def get_variable_valueref(self, variable_name: str) -> int:
        """Returns the value reference of a variable."""
        return self._variable(variable_name).value_reference

    def get_variable_data_type(self, variable_name: str) -> int:
        """Returns PyFMI's code for the type of a variable."""
        return self._scalar(variable_name).type

    def get_variable_causality(self, variable_name: str) -> int:
        """Returns PyFMI's code for the causality of a variable."""
        return self._scalar(variable_name).causality

    def get_variable_variability(self, variable_name: str) -> int:
        """Returns PyFMI's code for the variability of a variable."""
        return self._scalar(variable_name).variability

    def get_variable_initial(self, variable_name: str) -> int:
        """Returns PyFMI's code for the initial attribute of a variable."""
        return self._scalar(variable_name).initial

    def get_variable_description(self, variable_name: str) -> str:
        """Returns the description of a variable."""
        return self._variable(variable_name).description or ""

    def _stated(self, name: str, what: str) -> Any:
        value = getattr(self._variable(name), what)
        if value is None:
            raise FMUException(f"the model declares no {what} for {name}")
        return value

    def get_variable_unit(self, variable_name: str) -> str:
        """Returns the unit of a variable; raises an error if none is declared."""
        return str(self._stated(variable_name, "unit"))

    def get_variable_display_unit(self, variable_name: str) -> str:
        """Returns the display unit of a variable; raises an error if none is declared."""
        return str(self._stated(variable_name, "display_unit"))

    def get_variable_start(self, variable_name: str) -> Any:
        """Returns the start value of a variable; raises an error if there is none."""
        return self._stated(variable_name, "start")

    def get_variable_min(self, variable_name: str) -> float:
        """Returns the minimum of a variable; by default the minimum of a double."""
        least = self._variable(variable_name).min
        return -np.finfo(np.float64).max if least is None else least

    def get_variable_max(self, variable_name: str) -> float:
        """Returns the maximum of a variable; by default the maximum of a double."""
        most = self._variable(variable_name).max
        return np.finfo(np.float64).max if most is None else most

    def get_variable_nominal(self, variable_name: str | None = None, valueref: int | None = None) -> float:
        """Returns the nominal value of a variable; 1 by default."""
        name = variable_name if variable_name is not None else self._names(("Real",), valueref)[0]
        nominal = self._variable(name).nominal
        return 1.0 if nominal is None else nominal

    def get_variable_unbounded(self, variable_name: str) -> bool:
        """Returns True if a variable is unbounded."""
        return self._variable(variable_name).unbounded

    def get_variable_relative_quantity(self, variable_name: str) -> bool:
        """Returns True if a variable is a relative quantity, such as a difference."""
        return self._variable(variable_name).relative_quantity

    def get_variable_declared_type(self, variable_name: str) -> TypeDefinition:
        """Returns the type definition of a variable; raises an error if there is none."""
        return self._description.type_definitions[self._stated(variable_name, "declared_type")]

    def get_variable_by_valueref(self, valueref: int, type: int = 0) -> str:
        """Returns the name of the first variable with a value reference and a type (PyFMI's number)."""
        for name, v in self._description.variables.items():
            if v.value_reference == valueref and constants.type_number(self._version, v.type) == type:
                return name
        raise FMUException(f"the model has no variable of type {type} with the value reference {valueref}")

    def get_variable_alias(self, variable_name: str) -> dict[str, int]:
        """Returns all aliases of a variable with 0 for the first name and 1 for the others."""
        found = self._variable(variable_name)
        names = [n for n, v in self._description.variables.items() if (v.type, v.value_reference) == (found.type, found.value_reference)]
        return {name: int(k > 0) for k, name in enumerate(names)}

    def get_variable_alias_base(self, variable_name: str) -> str:
        """Returns the first alias of a variable."""
        return next(iter(self.get_variable_alias(variable_name)))

    def _listed(self, names: Iterable[str | None]) -> dict[str, ScalarVariable]:
        return {name: self._scalar(name) for name in names if name is not None}

    def get_states_list(self) -> dict[str, ScalarVariable]:
        """Returns the states."""
        return self._listed(self._description.states)

    def get_derivatives_list(self) -> dict[str, ScalarVariable]:
        """Returns the derivatives of the states."""
        of_state = {v.derivative: name for name, v in self._description.variables.items() if v.derivative is not None}
        return self._listed(of_state[state] for state in self._description.states if state in of_state)

    def get_input_list(self) -> dict[str, ScalarVariable]:
        """Returns the continuous inputs of type Real."""
        variables = self._description.variables
        return self._listed(n for n in self._description.inputs if variables[n].type == "Real" and variables[n].variability == "continuous")

    def get_output_list(self) -> dict[str, ScalarVariable]:
        """Returns the outputs."""
        return self._listed(self._description.outputs)

    # --- facts --------------------------------------------------------------------------------------------------------

    def get_version(self) -> str:
        """Returns the version of FMI."""
        return self._description.fmi_version

    def get_name(self) -> str:
        """Returns the name of the model."""
        return self._description.model_name

    def get_identifier(self) -> str:
        """Returns the name of the library."""
        interface = self._description.co_simulation if self._model.kind == "CS" else self._description.model_exchange
        return interface.model_identifier if interface else ""

    def get_guid(self) -> str:
        """Returns the guid, or the instantiation token in FMI 3.0."""
        return self._description.guid

    def get_author(self) -> str:
        """Returns the author."""
        return self._description.author or ""

    def get_description(self) -> str:
        """Returns the description of the model."""
        return self._description.description or ""

    def get_copyright(self) -> str:
        """Returns the copyright."""
        return self._description.copyright or ""

    def get_license(self) -> str:
        """Returns the licence."""
        return self._description.license or ""

    def get_model_version(self) -> str:
        """Returns the version of the model."""
        return self._description.version or ""

    def get_generation_tool(self) -> str:
        """Returns the tool that generated the FMU."""
        return self._description.generation_tool or ""

    def get_generation_date_and_time(self) -> str:
        """Returns the date and time of generation of the FMU."""
        return self._description.generation_date_and_time or ""

    def get_variable_naming_convention(self) -> str:
        """Returns the naming convention of the variables."""
        return self._description.variable_naming_convention or "flat"

    def get_model_types_platform(self) -> str:
        """Returns the platform name of FMI: "standard32" for FMI 1.0, otherwise "default"."""
        return "standard32" if self._version == 1 else "default"

    def get_ode_sizes(self) -> tuple[int, int]:
        """Returns the numbers of states and of event indicators."""
        return self._description.n_states, self._description.n_event_indicators

    def get_categories(self) -> list[str]:
        """Returns the names of the categories of log messages."""
        return [category.name for category in self._description.log_categories]

    def get_log_categories(self) -> dict[str, str]:
        """Returns the names of the categories of log messages with their descriptions."""
        return {category.name: category.description or "" for category in self._description.log_categories}

    def get_capability_flags(self) -> dict[str, Any]:
        """Returns the capabilities of the FMU by the names of FMI."""
        interface = self._description.co_simulation if self._model.kind == "CS" else self._description.model_exchange
        can = interface.capabilities if interface else self._description.capabilities
        return {_camel(name): getattr(can, name) for name in Capabilities.__dataclass_fields__}

    def get_default_experiment_start_time(self) -> float:
        """Returns the suggested start time in s; 0 by default."""
        return self._description.default_experiment.start_time or 0.0

    def get_default_experiment_stop_time(self) -> float:
        """Returns the suggested stop time in s; 1 by default."""
        stop = self._description.default_experiment.stop_time
        return 1.0 if stop is None else stop

    def get_default_experiment_tolerance(self) -> float:
        """Returns the suggested relative tolerance; 1e-4 by default."""
        return self._description.default_experiment.tolerance or 1e-4

    def get_default_experiment_step(self) -> float:
        """Returns the suggested step size in s; 1e-2 by default."""
        return self._description.default_experiment.step_size or 1e-2

    def _names(self, kinds: Sequence[str], references: Any) -> list[str]:
        wanted = np.atleast_1d(np.asarray(references)).ravel().tolist()
        name_of: dict[int, str] = {}
        for name, v in self._description.variables.items():
            if v.type in kinds:
                name_of.setdefault(v.value_reference, name)
        for reference in wanted:
            if reference not in name_of:
                raise FMUException(f"the model has no variable of type {' or '.join(kinds)} with the value reference {reference}")
        return [name_of[reference] for reference in wanted]


def _camel(name: str) -> str:
    if name in ("can_get_and_set_state", "can_serialize_state"):
        name = name.replace("state", "FMUstate")
    first, *rest = name.split("_")
    return first + "".join(word[0].upper() + word[1:] for word in rest)
