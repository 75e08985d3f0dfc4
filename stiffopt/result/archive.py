"""Archive of a solution: all that its report shows, so that the page is drawn without a solve.

One file of numpy's npz: the arrays, and the objects around them as JSON. Reading makes dataclasses
and enumerations of `stiffopt.result` only.
"""

from __future__ import annotations

import json
from dataclasses import fields, is_dataclass
from enum import Enum
from importlib import import_module
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from stiffopt.errors import InputFileError, shortened
from stiffopt.result.solution import Solution

ARCHIVE_FILE = "solution.npz"
# Package whose classes an archive may name.
_ARCHIVED_PACKAGE = "stiffopt.result."
# Name of the JSON among the arrays.
_STRUCTURE_NAME = "structure"


def write_archive(solution: Solution, folder: Path) -> None:
    """Write all of a solution into a result folder."""
    arrays: list[np.ndarray] = []
    structure = json.dumps(_encode(solution, arrays))
    named = {f"a{number}": each for number, each in enumerate(arrays)}
    named[_STRUCTURE_NAME] = np.array(structure)
    np.savez(folder / ARCHIVE_FILE, allow_pickle=False, **named)


def read_archive(folder: Path) -> Solution:
    """Return the solution of a result folder.

    Raises `InputFileError`: the archive is damaged or of another version.
    """
    path = folder / ARCHIVE_FILE
    try:
        # numpy leaves a damaged file that it opened itself open.
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
            found = _decode(json.loads(str(arrays[_STRUCTURE_NAME])), arrays)
    except (OSError, BadZipFile, KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputFileError(
            path, "", f"cannot be read: {shortened(error)}. Solve again."
        ) from error
    if not isinstance(found, Solution):
        raise InputFileError(path, "", "holds no solution. Solve again.")
    return found


def _encode(value: Any, arrays: list[np.ndarray]) -> Any:
    """Return a value as JSON, with its arrays appended to `arrays`."""
    if isinstance(value, Enum):
        return {"class": _class_name(value), "value": value.value}
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.ndarray):
        arrays.append(value)
        return {"array": f"a{len(arrays) - 1}"}
    if isinstance(value, list | tuple):
        kind = "list" if isinstance(value, list) else "tuple"
        return {kind: [_encode(each, arrays) for each in value]}
    if isinstance(value, dict):
        return {"dict": [[_encode(each, arrays) for each in pair] for pair in value.items()]}
    if not is_dataclass(value):
        raise TypeError(f"{type(value).__name__} is no part of a solution.")
    own = {
        each.name: _encode(getattr(value, each.name), arrays) for each in fields(value) if each.init
    }
    return {"class": _class_name(value), "fields": own}


def _decode(content: Any, arrays: Any) -> Any:
    """Return the value that `_encode` has made JSON of."""
    if not isinstance(content, dict):
        return content
    if "array" in content:
        return arrays[content["array"]]
    if "dict" in content:
        return {_decode(key, arrays): _decode(each, arrays) for key, each in content["dict"]}
    for name, kind in (("list", list), ("tuple", tuple)):
        if name in content:
            return kind(_decode(each, arrays) for each in content[name])
    module, name = content["class"].split(":")
    if not module.startswith(_ARCHIVED_PACKAGE):
        raise ValueError(f"{module} is no module of results")
    made = getattr(import_module(module), name)
    if "value" in content and issubclass(made, Enum):
        return made(content["value"])
    if not (isinstance(made, type) and is_dataclass(made)):
        raise ValueError(f"{name} is no part of a solution")
    return made(**{key: _decode(each, arrays) for key, each in content["fields"].items()})


def _class_name(value: object) -> str:
    return f"{type(value).__module__}:{type(value).__name__}"
