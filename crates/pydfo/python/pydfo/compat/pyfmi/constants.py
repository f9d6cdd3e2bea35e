"""PyFMI's numbers of types, causalities and variabilities."""

from __future__ import annotations

from enum import IntEnum

FMI_REAL, FMI_INTEGER, FMI_BOOLEAN, FMI_STRING, FMI_ENUMERATION = range(5)
FMI_CONSTANT, FMI_PARAMETER, FMI_DISCRETE, FMI_CONTINUOUS = range(4)
FMI_INPUT, FMI_OUTPUT, FMI_INTERNAL, FMI_NONE = range(4)
FMI_OK, FMI_WARNING, FMI_DISCARD, FMI_ERROR, FMI_FATAL, FMI_PENDING = range(6)
FMI_TRUE, FMI_FALSE = b"\x01", b"\x00"

FMI2_REAL, FMI2_INTEGER, FMI2_BOOLEAN, FMI2_STRING, FMI2_ENUMERATION = range(5)
FMI2_CONSTANT, FMI2_FIXED, FMI2_TUNABLE, FMI2_DISCRETE, FMI2_CONTINUOUS, FMI2_UNKNOWN = range(6)
FMI2_PARAMETER, FMI2_CALCULATED_PARAMETER, FMI2_INPUT, FMI2_OUTPUT, FMI2_LOCAL, FMI2_INDEPENDENT = range(6)
FMI2_INITIAL_EXACT, FMI2_INITIAL_APPROX, FMI2_INITIAL_CALCULATED, FMI2_INITIAL_UNKNOWN = range(4)
FMI2_TRUE, FMI2_FALSE = True, False

FMI3_Type = IntEnum("FMI3_Type", "FLOAT64 FLOAT32 INT64 INT32 INT16 INT8 UINT64 UINT32 UINT16 UINT8 BOOL BINARY CLOCK STRING ENUM")
FMI3_Initial = IntEnum("FMI3_Initial", "EXACT APPROX CALCULATED UNKNOWN", start=0)
FMI3_Variability = IntEnum("FMI3_Variability", "CONSTANT FIXED TUNABLE DISCRETE CONTINUOUS UNKNOWN", start=0)
FMI3_Causality = IntEnum(
    "FMI3_Causality", "STRUCTURAL_PARAMETER PARAMETER CALCULATED_PARAMETER INPUT OUTPUT LOCAL INDEPENDENT UNKNOWN", start=0
)

_VARIABILITIES = ("constant", "fixed", "tunable", "discrete", "continuous")
_CAUSALITIES = ("parameter", "calculatedParameter", "input", "output", "local", "independent")
_KINDS = ("Real", "Integer", "Boolean", "String", "Enumeration")
_TYPES_3 = "Real Float32 Int64 Integer Int16 Int8 UInt64 UInt32 UInt16 UInt8 Boolean Binary Clock String Enumeration".split()
_INITIALS = ("exact", "approx", "calculated")


def type_number(version: int, kind: str) -> int:
    """Returns PyFMI's number of a type."""
    return FMI3_Type(_TYPES_3.index(kind) + 1) if version == 3 else _KINDS.index(kind)


def causality_number(version: int, causality: str) -> int:
    """Returns PyFMI's number of a causality."""
    if version == 1:
        return {"input": FMI_INPUT, "output": FMI_OUTPUT, "independent": FMI_NONE}.get(causality, FMI_INTERNAL)
    return FMI3_Causality(("structuralParameter", *_CAUSALITIES).index(causality)) if version == 3 else _CAUSALITIES.index(causality)


def variability_number(version: int, variability: str) -> int:
    """Returns PyFMI's number of a variability."""
    if version == 1:
        numbers = {"constant": FMI_CONSTANT, "discrete": FMI_DISCRETE, "continuous": FMI_CONTINUOUS}
        return numbers.get(variability, FMI_PARAMETER)
    number = _VARIABILITIES.index(variability)
    return FMI3_Variability(number) if version == 3 else number


def initial_number(version: int, initial: str | None) -> int:
    """Returns PyFMI's code for an initial attribute."""
    number = _INITIALS.index(initial) if initial in _INITIALS else FMI2_INITIAL_UNKNOWN
    return FMI3_Initial(number) if version == 3 else number
