"""Inverse dynamics along a motion, compiled (bodies.c), where the library is there already."""

from __future__ import annotations

import ctypes
from pathlib import Path

import numpy as np

from stiffopt import compiler
from stiffopt.c_code import ARRAY, WHOLE, Struct, source
from stiffopt.robot.body_tree import BodyTree

_C_SOURCE = Path(__file__).with_name("bodies.c")
# Size of the arrays of the C code [joints].
_MAX_JOINTS = 32
# Instants from which compiled code is faster, and instants per contiguous copy.
_MIN_INSTANTS, _BLOCK_INSTANTS = 16, 2**14


class _Bodies(Struct):
    _fields_ = (
        ("n", WHOLE),
        *((name, ARRAY) for name in ("parent", "slides", "axis", "rotation", "translation")),
        *((name, ARRAY) for name in ("inertial", "gravity")),
    )


class NativeBodies:
    """An arm's bodies as the compiled loop takes them.

    Parameters
    ----------
    tree : BodyTree
    inertial : array (n, 10), optional
        Replace those of the bodies, in the order of `Body.inertial_parameters`; need not be
        physical.
    """

    def __init__(self, tree: BodyTree, inertial: np.ndarray | None = None) -> None:
        self._tree, self._n = tree, tree.n
        if inertial is None:
            inertial = np.array([body.inertial_parameters for body in tree.bodies])
        self._own = _Bodies()
        self._own.set(
            n=self._n,
            parent=[body.parent for body in tree.bodies],
            slides=[body.prismatic for body in tree.bodies],
            inertial=np.asarray(inertial, dtype=float),
            gravity=np.asarray(tree.gravity, dtype=float),
            **{
                name: np.array([getattr(body, name) for body in tree.bodies], dtype=float)
                for name in ("axis", "rotation", "translation")
            },
        )

    def with_parameters(self, inertial: np.ndarray) -> NativeBodies:
        """The same joints with other inertial parameters (n, 10)."""
        return NativeBodies(self._tree, inertial)

    def torque(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray | None:
        """Torques (K, n) along a motion (K, n) each; None where the library was not prepared."""
        if (
            len(q) < _MIN_INSTANTS
            or self._n > _MAX_JOINTS
            or (made := _BODIES_LIBRARY.loaded()) is None
        ):
            return None
        torque = np.empty(q.shape)
        for begin in range(0, len(q), _BLOCK_INSTANTS):
            part = torque[begin : begin + _BLOCK_INSTANTS]
            motion = [
                np.ascontiguousarray(x[begin : begin + _BLOCK_INSTANTS], dtype=float)
                for x in (q, v, a)
            ]
            made.inverse(
                ctypes.byref(self._own),
                WHOLE(len(part)),
                *(ARRAY(x.ctypes.data) for x in (*motion, part)),
            )
        return torque


class _Library:
    """The library, looked for once it was asked for and until it is there."""

    def __init__(self) -> None:
        self.wanted = False
        self._loaded: ctypes.CDLL | None = None

    def loaded(self) -> ctypes.CDLL | None:
        """It, if it is there."""
        if self.wanted and self._loaded is None:
            path = compiler.library("bodies", source(_C_SOURCE))
            if path is not None:
                self._loaded = ctypes.CDLL(str(path))
                self._loaded.inverse.restype = None
        return self._loaded


_BODIES_LIBRARY = _Library()


def prepare() -> None:
    """Have the library made beside other work, if there is none yet; torques use it from then on.

    For many long motions: one by one pinocchio is as good.
    """
    _BODIES_LIBRARY.wanted = True
    _BODIES_LIBRARY.loaded()
