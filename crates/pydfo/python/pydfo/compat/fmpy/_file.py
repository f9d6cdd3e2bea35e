"""Parts of a description that `pydfo.read_description` does not return: model structure, attributes of schedulers and
clocks.

The file is read after `pydfo.read_description`, which rejects untrustworthy files."""

from __future__ import annotations

import codecs
import re
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Any
from xml.parsers import expat

#: Lists of unknowns, by the elements that contain them (FMI 2.0), or by their own names (FMI 3.0).
_LISTS = {
    "Outputs": "outputs",
    "Derivatives": "derivatives",
    "InitialUnknowns": "initialUnknowns",
    "Output": "outputs",
    "ContinuousStateDerivative": "derivatives",
    "ClockedState": "clockedStates",
    "InitialUnknown": "initialUnknowns",
    "EventIndicator": "eventIndicators",
}


def numbers(text: str) -> list[int]:
    """Returns the numbers in a string separated by blanks."""
    return [int(word) for word in text.split() if word.isdecimal()]


def _flag(text: str) -> bool:
    return text in ("true", "1")


#: Readers of the attributes.
_READ: dict[str, Callable[[str], Any]] = {
    "canBeDeactivated": _flag,
    "intermediateUpdate": _flag,
    "intervalCounter": int,
    "intervalDecimal": float,
    "previous": int,
    "priority": int,
    "providesEvaluateDiscreteStates": _flag,
    "providesPerElementDependencies": _flag,
    "recommendedIntermediateInputSmoothness": int,
    "resolution": int,
    "shiftCounter": int,
    "shiftDecimal": float,
    "supportsFraction": _flag,
}


def attribute_values(attributes: dict[str, str], names: Collection[str]) -> dict[str, Any]:
    """Returns the attributes that are present and readable, for a class with fields of these names."""
    found = {}
    for name in _READ.keys() & names & attributes.keys():
        try:
            found[name] = _READ[name](attributes[name])
        except ValueError:
            continue
    return found


@dataclass
class DescriptionFile:
    """Attributes of elements of a file.

    Attributes
    ----------
    unknowns : dict
        Unknowns of each list of the model structure: their lines and attributes.
    variables : dict
        Attributes of variables by value reference (FMI 3.0).
    interfaces : dict
        Attributes of "ModelExchange" and "CoSimulation".
    """

    unknowns: dict[str, list[tuple[int, dict[str, str]]]] = field(default_factory=lambda: {name: [] for name in _LISTS.values()})
    variables: dict[int, dict[str, str]] = field(default_factory=dict)
    interfaces: dict[str, dict[str, str]] = field(default_factory=dict)


def _bytes_of_one(file: bytes) -> bytes:
    """Converts a file to one byte for each relevant character, without characters that XML does not allow."""
    for start, encoding in ((codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"), (b"<\0", "utf-16-le"), (b"\0<", "utf-16-be")):
        if file.startswith(start):
            file = file.decode(encoding, "replace").encode("latin-1", "replace")
    return re.sub(rb"&#\w+;|[\0-\x08\x0b\x0c\x0e-\x1f]", b" ", file.removeprefix(codecs.BOM_UTF8))


def read_file(file: bytes) -> DescriptionFile:
    """Returns the attributes in the bytes of a ``modelDescription.xml`` of FMI 2.0 or 3.0."""
    found, path = DescriptionFile(), list[str]()
    # The attributes read here are ASCII in any encoding. Names and strings are not used.
    parser = expat.ParserCreate("iso-8859-1")

    def start(name: str, attributes: dict[str, str]) -> None:
        match path[1:]:
            case []:
                if path and name in ("ModelExchange", "CoSimulation"):
                    found.interfaces[name] = attributes
            case ["ModelVariables"]:
                for reference in numbers(attributes.get("valueReference", "")):
                    found.variables[reference] = attributes
            case ["ModelStructure"] if name in _LISTS and "valueReference" in attributes:
                found.unknowns[_LISTS[name]].append((parser.CurrentLineNumber, attributes))
            case ["ModelStructure", around] if around in _LISTS and name == "Unknown" and "index" in attributes:
                found.unknowns[_LISTS[around]].append((parser.CurrentLineNumber, attributes))
        path.append(name)

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: path.pop()
    parser.Parse(_bytes_of_one(file), True)
    return found
