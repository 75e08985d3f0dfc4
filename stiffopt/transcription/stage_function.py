"""A stage at all points of a mesh, with its exact derivatives."""

from __future__ import annotations

import casadi as ca

from stiffopt.transcription.evaluated import stage_functions
from stiffopt.transcription.node_derivatives import NumberedStage


class StageFunction:
    """A problem's stage at `count` points.

    Parameters
    ----------
    stage : NumberedStage
    count : int
    parameters : int
        How many of the programme's parameters are the stage's own; its numbers are the last.
    basis : MX (k, count), optional
        Of a stage along splines, at every point.

    Notes
    -----
    The variables of all points are one matrix (n, count), so are the values (m, count); as vectors
    their columns follow one another. `parameters` of the methods are all of the programme's.
    """

    def __init__(
        self, stage: NumberedStage, count: int, parameters: int, basis: ca.MX | None = None
    ) -> None:
        functions = stage_functions(stage)
        # They may take several points at once.
        self._lanes = int(functions[0].size2_in(0))
        self._calls = -(-count // self._lanes)
        self._values, self._jacobian, self._hessian = (each.map(self._calls) for each in functions)
        self._own, self._numbers = parameters, len(stage.numbers)
        self._count = count
        self._basis = () if basis is None else (self._filled(basis),)
        self.size = int(functions[0].size1_out(0))
        self._jacobian_pattern = self._block_diagonal(functions[1])
        self._hessian_pattern = self._block_diagonal(functions[2])

    def values(self, variables: ca.MX, parameters: ca.MX) -> ca.MX:
        """Integrands and path rows (m, count)."""
        return self._values(*self._given(variables, parameters))[:, : self._count]

    def jacobian(self, variables: ca.MX, parameters: ca.MX) -> ca.MX:
        """All values by all variables (m count, n count), block-diagonal."""
        found = self._jacobian(*self._given(variables, parameters))
        return self._along_diagonal(found, variables.size1(), self._jacobian_pattern)

    def hessian(self, variables: ca.MX, parameters: ca.MX, weights: ca.MX) -> ca.MX:
        """Second derivatives of the values' weighted sum (n count, n count), block-diagonal.

        Of a stage along splines their upper half.

        Parameters
        ----------
        variables, parameters : MX (n, count), (np,)
        weights : MX (m, count)
        """
        found = self._hessian(*self._given(variables, parameters), self._filled(weights))
        return self._along_diagonal(found, variables.size1(), self._hessian_pattern)

    def _given(self, variables: ca.MX, parameters: ca.MX) -> tuple[ca.MX, ...]:
        own, numbers = parameters[: self._own], parameters[parameters.numel() - self._numbers :]
        same = (ca.repmat(each, 1, self._calls) for each in (own, numbers))
        return self._filled(variables), *same, *self._basis

    def _filled(self, columns: ca.MX) -> ca.MX:
        """As many columns as are computed; the last one again where there are fewer points."""
        missing = self._calls * self._lanes - self._count
        return ca.horzcat(columns, ca.repmat(columns[:, -1], 1, missing)) if missing else columns

    def _along_diagonal(self, found: ca.MX, width: int, pattern: ca.Sparsity) -> ca.MX:
        """Blocks side by side, each so wide, as one block-diagonal matrix."""
        return ca.sparsity_cast(found[:, : width * self._count], pattern)

    def _block_diagonal(self, function: ca.Function) -> ca.Sparsity:
        # Its nonzeros are in the order of the blocks side by side.
        block = ca.horzsplit(function.sparsity_out(0), function.size2_out(0) // self._lanes)[0]
        return ca.diagcat(*[block] * self._count)
