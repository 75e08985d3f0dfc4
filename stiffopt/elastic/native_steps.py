"""Steps of links that swing by the compiled core (response.c)."""

from __future__ import annotations

import ctypes
from copy import copy
from dataclasses import replace

import numpy as np

from stiffopt.elastic.native import core
from stiffopt.elastic.steps import Load, Matrices, Swung
from stiffopt.native import ARRAY, REAL, WHOLE, Struct

# Joints that the C code has room for.
MAX_JOINTS = 16
# Numbers of a column of a step are filled up to a multiple of so many.
REGISTER_SIZE = 4


class _Response(Struct):
    _fields_ = (
        *((name, WHOLE) for name in ("steps", "n", "rows")),
        *((name, REAL) for name in ("dt", "unit")),
        *((name, ARRAY) for name in ("mobility", "rate", "stiffness")),
        *((name, ARRAY) for name in ("step", "soft", "lag")),
    )


def steps(matrices: Matrices) -> NativeSteps | None:
    """Steps as of `ArraySteps`; None without the compiled core, or for too many joints."""
    made = core(matrices.joints)
    if made is None or matrices.joints > MAX_JOINTS:
        return None
    return NativeSteps(made, matrices)


class NativeSteps:
    """Steps by the compiled loops.

    Parameters
    ----------
    made : CDLL
    matrices : Matrices
    """

    def __init__(self, made: ctypes.CDLL, matrices: Matrices) -> None:
        self._made, self._n, count = made, matrices.joints, len(matrices.mobility) - 1
        rows = -(-2 * self._n // REGISTER_SIZE) * REGISTER_SIZE
        self._taken = {
            "step": np.zeros((count, 2 * self._n, rows)),
            "soft": np.empty((count, self._n, self._n)),
            "lag": np.empty((count, self._n, self._n)),
        }
        self._point_to(matrices)
        self.take(0, count)

    def _point_to(self, matrices: Matrices) -> None:
        count, _, rows = self._taken["step"].shape
        self._of, self._own = matrices, _Response()
        self._own.set(steps=count, n=self._n, rows=rows, **vars(matrices), **self._taken)

    def take(self, first: int, last: int) -> None:
        """See `Steps`."""
        self._made.take(ctypes.byref(self._own), WHOLE(first), WHOLE(last))

    def copy(self, stiffness: np.ndarray) -> NativeSteps:
        """See `Steps`."""
        new = copy(self)
        new._taken = {name: array.copy() for name, array in self._taken.items()}
        new._point_to(replace(self._of, stiffness=stiffness))
        return new

    def march(self, load: Load, begin: np.ndarray | None, *, accelerated: bool) -> Swung:
        """See `Steps`."""
        many, count = load.torque.shape[:2]
        z, velocity = np.empty((2, many, count, self._n))
        acceleration = np.empty(z.shape) if accelerated else None
        if begin is None:
            begin = np.zeros((many, 2 * self._n))
        arrays = (
            np.ascontiguousarray(load.links, dtype=np.int64),
            np.ascontiguousarray(load.torque, dtype=float),
            None if load.within is None else np.ascontiguousarray(load.within, dtype=float),
            np.ascontiguousarray(begin, dtype=float),
            *(z, velocity, acceleration),
        )
        self._made.march(
            ctypes.byref(self._own),
            WHOLE(many),
            WHOLE(load.links.shape[1]),
            *(ARRAY(None if each is None else each.ctypes.data) for each in arrays),
        )
        return z, velocity, acceleration
