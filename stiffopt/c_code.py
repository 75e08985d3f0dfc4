"""What the package's own C code begins with, and how Python hands over structs to it."""

from __future__ import annotations

import ctypes
import functools
from pathlib import Path

import numpy as np

WHOLE, REAL, ARRAY = ctypes.c_longlong, ctypes.c_double, ctypes.c_void_p

HEAD = """#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Numbers taken at once, as many as a register holds: vectors of several registers GCC lowers to
   what takes it twenty times as long to compile. */
#if defined __AVX512F__
#define LANES 8
#elif defined __AVX__
#define LANES 4
#else
#define LANES 2
#endif
/* Neither aligned as a whole nor of a type of its own: they lie in arrays of double. */
typedef double wide __attribute__((vector_size(8 * LANES), aligned(8), may_alias));
/* What is left in wide registers slows all code that knows narrow ones only, such as MUMPS. */
#ifdef __AVX__
#define LEAVE __builtin_ia32_vzeroupper()
#else
#define LEAVE
#endif
"""


@functools.cache
def source(*files: Path) -> str:
    """Code of files as one, behind `HEAD`."""
    return "\n".join((HEAD, *(file.read_text(encoding="ascii") for file in files)))


class Struct(ctypes.Structure):
    """A struct of the C code, which keeps the arrays that it points to."""

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
