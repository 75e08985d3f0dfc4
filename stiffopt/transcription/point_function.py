"""A function of single points at many of them: compiled where it can be."""

from __future__ import annotations

import casadi as ca
import numpy as np

from stiffopt.symbolic import array_of
from stiffopt.transcription import compiled
from stiffopt.transcription.node_derivatives import numbered


class PointFunction:
    """Values, without derivatives, of a function at any number of points.

    Parameters
    ----------
    function : casadi.Function
        (x, u, z, p) -> (m,), of SX.
    """

    def __init__(self, function: ca.Function) -> None:
        own = numbered(function)
        inputs = own.function.sx_in()
        # By itself: a stage would be compiled with its derivatives.
        self._values = ca.Function(compiled.VALUES, inputs, own.function.call(inputs)[1:])
        self._numbers = own.numbers
        # Made while the first points are looked at without it.
        self._library = compiled.library(self._values)

    def __call__(self, variables: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """Values (m, k).

        Parameters
        ----------
        variables : array (n, k)
            x above u above z at every point.
        parameters : array (np,)
            The same at all points.
        """
        if self._library is None:
            self._library = compiled.library(self._values)
        library, count = self._library, variables.shape[1]
        one = self._values if library is None else ca.external(compiled.VALUES, str(library))
        lanes = int(one.size2_in(0))
        calls = -(-count // lanes)
        filled = np.pad(variables, ((0, 0), (0, calls * lanes - count)), mode="edge")
        same = (ca.repmat(ca.DM(each), 1, calls) for each in (parameters, self._numbers))
        return array_of(one.map(calls)(filled, *same))[:, :count]
