"""Steps of links that swing, compiled (response.c), where the library is there already."""

from __future__ import annotations

import ctypes
from copy import copy

import numpy as np

from stiffopt.elastic import native
from stiffopt.elastic.steps import Swung

# Joints that the C code has room for.
_MOST = 16
# Numbers of a column of a step are filled up to a multiple of so many.
_REGISTER = 4


class _Response(native.Struct):
    _fields_ = (
        *((name, native.WHOLE) for name in ("steps", "n", "rows")),
        *((name, native.REAL) for name in ("dt", "unit")),
        *((name, native.ARRAY) for name in ("mobility", "rate", "stiffness")),
        *((name, native.ARRAY) for name in ("step", "soft", "lag")),
    )


def steps(
    mobility: np.ndarray, rate: np.ndarray, stiffness: np.ndarray, dt: float, unit: float
) -> NativeSteps | None:
    """Steps as of `ArraySteps`; None without the library, or for too many joints."""
    joints = mobility.shape[1]
    made = native.library(joints)
    if made is None or joints > _MOST:
        return None
    return NativeSteps(made, mobility, rate, stiffness, dt, unit)


class NativeSteps:
    """Steps by the compiled loops.

    Parameters
    ----------
    made : CDLL
    mobility, rate, stiffness, dt, unit
        As of `ArraySteps`.
    """

    def __init__(
        self,
        made: ctypes.CDLL,
        mobility: np.ndarray,
        rate: np.ndarray,
        stiffness: np.ndarray,
        dt: float,
        unit: float,
    ) -> None:
        self._made, self._n, count = made, mobility.shape[1], len(mobility) - 1
        self._given = {"mobility": mobility, "rate": rate, "dt": dt, "unit": unit}
        rows = -(-2 * self._n // _REGISTER) * _REGISTER
        self._taken = {
            "step": np.zeros((count, 2 * self._n, rows)),
            "soft": np.empty((count, self._n, self._n)),
            "lag": np.empty((count, self._n, self._n)),
        }
        self._point_to(stiffness)
        self.take(0, count)

    def _point_to(self, stiffness: np.ndarray) -> None:
        count, _, rows = self._taken["step"].shape
        self._own = _Response()
        self._own.set(
            steps=count, n=self._n, rows=rows, stiffness=stiffness, **self._given, **self._taken
        )

    def take(self, first: int, last: int) -> None:
        """See `Steps`."""
        self._made.take(ctypes.byref(self._own), native.WHOLE(first), native.WHOLE(last))

    def copy(self, stiffness: np.ndarray) -> NativeSteps:
        """See `Steps`."""
        new = copy(self)
        new._taken = {name: array.copy() for name, array in self._taken.items()}
        new._point_to(stiffness)
        return new

    def march(
        self, links: np.ndarray, torque: np.ndarray, begin: np.ndarray | None, *, accelerated: bool
    ) -> Swung:
        """See `Steps`."""
        many, count = torque.shape[:2]
        z, velocity = np.empty((2, many, count, self._n))
        acceleration = np.empty(z.shape) if accelerated else None
        if begin is None:
            begin = np.zeros((many, 2 * self._n))
        arrays = (
            np.ascontiguousarray(links, dtype=np.int64),
            *(np.ascontiguousarray(each, dtype=float) for each in (torque, begin)),
            *(z, velocity, acceleration),
        )
        self._made.march(
            ctypes.byref(self._own),
            native.WHOLE(many),
            native.WHOLE(links.shape[1]),
            *(native.ARRAY(None if each is None else each.ctypes.data) for each in arrays),
        )
        return z, velocity, acceleration
