"""A stage at all points of a mesh, with its exact derivatives: compiled where it can be."""

from __future__ import annotations

import casadi as ca

from stiffopt.transcription import compiled
from stiffopt.transcription.node_derivatives import NAMES, NumberedStage, with_derivatives


class StageFunction:
    """A problem's stage at `count` points.

    Parameters
    ----------
    stage : NumberedStage
    count : int
    parameters : int
        How many of the programme's parameters are the stage's own; its numbers are the last.

    Notes
    -----
    The variables of all points are one matrix (n, count), so are the values (m, count); as vectors
    their columns follow one another. `parameters` of the methods are all of the programme's.
    """

    def __init__(self, stage: NumberedStage, count: int, parameters: int) -> None:
        library = compiled.library(stage.function)
        functions = (
            with_derivatives(stage.function)
            if library is None
            else tuple(ca.external(name, str(library)) for name in NAMES)
        )
        self._values, self._jacobian, self._hessian = (each.map(count) for each in functions)
        self._own, self._numbers = parameters, len(stage.numbers)
        self._count = count
        self.size = int(functions[0].size1_out(0))
        self._jacobian_pattern = _block_diagonal(functions[1], count)
        self._hessian_pattern = _block_diagonal(functions[2], count)

    def values(self, variables: ca.MX, parameters: ca.MX) -> ca.MX:
        """Integrands and path rows (m, count)."""
        return self._values(variables, *self._same(parameters))

    def jacobian(self, variables: ca.MX, parameters: ca.MX) -> ca.MX:
        """All values by all variables (m count, n count), block-diagonal."""
        found = self._jacobian(variables, *self._same(parameters))
        return ca.sparsity_cast(found, self._jacobian_pattern)

    def hessian(self, variables: ca.MX, parameters: ca.MX, weights: ca.MX) -> ca.MX:
        """Second derivatives of the values' weighted sum (n count, n count), block-diagonal.

        Parameters
        ----------
        variables, parameters : MX (n, count), (np,)
        weights : MX (m, count)
        """
        found = self._hessian(variables, *self._same(parameters), weights)
        return ca.sparsity_cast(found, self._hessian_pattern)

    def _same(self, parameters: ca.MX) -> tuple[ca.MX, ca.MX]:
        own, numbers = parameters[: self._own], parameters[parameters.numel() - self._numbers :]
        return ca.repmat(own, 1, self._count), ca.repmat(numbers, 1, self._count)


def _block_diagonal(function: ca.Function, count: int) -> ca.Sparsity:
    # Its nonzeros are in the order of the blocks side by side.
    return ca.diagcat(*[function.sparsity_out(0)] * count)
