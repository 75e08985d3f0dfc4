"""A function of single points at many of them."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

from stiffopt.symbolic import BufferedFunction
from stiffopt.transcription.evaluated import point_function
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
        found = ca.Function("values", [variables, *same], [ca.densify(values)])
        self._function, self._numbers = point_function(found), own.numbers

    def __call__(self, variables: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """Values (m, k).

        Parameters
        ----------
        variables : array (n, k)
            x above u above z at every point.
        parameters : array (np,)
            The same at all points.
        """
        function, count = self._function, variables.shape[1]
        lanes = int(function.size2_in(0))
        calls = -(-count // lanes)
        # Columns of matrices are rows of arrays.
        filled = np.pad(variables.T, ((0, calls * lanes - count), (0, 0)), mode="edge")
        same = (np.tile(each, calls) for each in (parameters, self._numbers))
        (values,) = BufferedFunction(function.map(calls))(filled.ravel(), *same)
        return np.asarray(values.reshape(len(filled), -1)[:count].T)
