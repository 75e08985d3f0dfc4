"""A function of single points at many of them: compiled where it can be."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

from stiffopt.symbolic import BufferedFunction
from stiffopt.transcription import compiled
from stiffopt.transcription.node_derivatives import numbered


class PointFunction:
    """Values, without derivatives, of a function at any number of points.

    Parameters
    ----------
    function : casadi.Function
        (x, u, z, p) -> (m,), of SX.
    extended : callable, optional
        What is wanted in place of the values, and of which variables: of the variables and values,
        with numbers of the function as symbols. Numbers of a short function are taken out sooner
        than those of its derivatives.
    """

    def __init__(
        self,
        function: ca.Function,
        extended: Callable[[ca.SX, ca.SX], tuple[ca.SX, ca.SX]] | None = None,
    ) -> None:
        own = numbered(function)
        variables, *same = own.function.sx_in()
        values = own.function.call([variables, *same])[1]
        if extended is not None:
            variables, values = extended(variables, values)
        # By itself: a stage would be compiled with its derivatives.
        self._values = ca.Function(compiled.VALUES, [variables, *same], [ca.densify(values)])
        self._numbers = own.numbers
        # Made while the first points are looked at without it.
        self._text = compiled.text_of(self._values)
        self._library = compiled.library_of(self._text)

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
            self._library = compiled.library_of(self._text)
        library, count = self._library, variables.shape[1]
        one = self._values if library is None else ca.external(compiled.VALUES, str(library))
        lanes = int(one.size2_in(0))
        calls = -(-count // lanes)
        # Columns of matrices are rows of arrays.
        filled = np.pad(variables.T, ((0, calls * lanes - count), (0, 0)), mode="edge")
        same = (np.tile(each, calls) for each in (parameters, self._numbers))
        (values,) = BufferedFunction(one.map(calls))(filled.ravel(), *same)
        return np.asarray(values.reshape(len(filled), -1)[:count].T)
