"""Inverse dynamics along a motion by the compiled core (bodies.c)."""

from __future__ import annotations

import ctypes

import numpy as np

from stiffopt import native
from stiffopt.native import ARRAY, WHOLE, Struct
from stiffopt.robot.body_tree import BodyTree

# Joints that the C code has room for.
MAX_JOINTS = 32
# Instants from which it is faster than pinocchio, and of which copies are made at once.
MIN_INSTANTS, _MAX_COPIED = 16, 2**14


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
    inertial : array (n, 10), optional
        In place of the bodies' own, in the order of `Body.inertial_parameters`; of bodies that need
        not exist by themselves.
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
        """Torques (K, n) along a motion (K, n) each; None where pinocchio is to compute them."""
        if len(q) < MIN_INSTANTS or self._n > MAX_JOINTS or (core := native.loaded()) is None:
            return None
        torque = np.empty(q.shape)
        for begin in range(0, len(q), _MAX_COPIED):
            part = torque[begin : begin + _MAX_COPIED]
            motion = [
                np.ascontiguousarray(x[begin : begin + _MAX_COPIED], dtype=float) for x in (q, v, a)
            ]
            core.inverse(
                ctypes.byref(self._own),
                WHOLE(len(part)),
                *(ARRAY(x.ctypes.data) for x in (*motion, part)),
            )
        return torque
