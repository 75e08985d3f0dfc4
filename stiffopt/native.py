"""Compiled core: the extension module that is built at installation, and calls of its functions.

Without it (no C compiler at installation) Python, CasADi and MUMPS give the same results, slower.
"""

from __future__ import annotations

import ctypes
import functools
import importlib.util
import warnings
from pathlib import Path

import numpy as np

WHOLE, REAL, ARRAY = ctypes.c_longlong, ctypes.c_double, ctypes.c_void_p

MISSING = "stiffopt runs without its compiled core, with the same results several times slower."
OUTDATED = "The compiled core is older than its sources and is not used."
_REBUILD_ADVICE = (
    "Install stiffopt again where there is a C compiler (`pip install -e .` in a checkout)."
)


@functools.cache
def library() -> Path | None:
    """Return the path of the extension module; None, with a warning once, where it is missing."""
    spec = importlib.util.find_spec("stiffopt._native")
    path = None if spec is None or spec.origin is None else Path(spec.origin)
    if path is None:
        warnings.warn(f"{MISSING} {_REBUILD_ADVICE}", stacklevel=2)
    elif _is_older_than_sources(path):
        warnings.warn(f"{OUTDATED} {_REBUILD_ADVICE}", stacklevel=2)
        return None
    return path


def loaded() -> ctypes.CDLL | None:
    """Return the functions of the extension module, None where it is missing."""
    path = library()
    return None if path is None else _load_library(path)


@functools.cache
def _load_library(path: Path) -> ctypes.CDLL:
    return ctypes.CDLL(str(path))


def _is_older_than_sources(path: Path) -> bool:
    """Return True where a checkout has changed since: its structs do not fit an older library."""
    package = Path(__file__).parent
    sources = (*package.glob("*.[ch]"), *package.glob("*/*.[ch]"))
    return any(each.stat().st_mtime > path.stat().st_mtime for each in sources)


class Struct(ctypes.Structure):
    """C struct that holds references to the arrays it points to."""

    def set(self, **values: object) -> None:
        """Set fields: numbers, and arrays to point to or, of fixed length, to copy."""
        self.kept = [*getattr(self, "kept", ())]
        kinds: dict[str, type] = {field[0]: field[1] for field in self._fields_}
        for name, value in values.items():
            if kinds[name] is ARRAY:
                array = np.ascontiguousarray(value)
                if array.dtype != float:
                    array = array.astype(np.int64)
                self.kept.append(array)
                value = array.ctypes.data
            elif issubclass(kinds[name], ctypes.Array):
                value = kinds[name](*np.asarray(value).tolist())
            setattr(self, name, value)
