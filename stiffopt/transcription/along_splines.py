"""A stage of splines' own coefficients, so that its derivatives are by what the programme varies.

States and controls at a point are sums of the few splines that are not zero there. The chain rule
through them, point by point, is part of the stage's derivatives: by products of sparse matrices of
all the programme it took longer than the stages.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca


@dataclass(frozen=True)
class AlongSplines:
    """How a stage's variables w follow from local ones: coefficients, static variables, duration.

    Parameters
    ----------
    chains : tuple of (position index, velocity index, .., control index)
        Places in w.
    degree : int
        Of the positions: degree + 1 splines are not zero at a point.
    statics : int
        Static variables, the last of w.
    free : bool
        Whether the duration of a point's phase is a variable, the last of all.

    Notes
    -----
    Local variables are the coefficients (chains run fastest), the static variables, the duration.
    The basis (degree + 1, derivatives) holds the values of a point's splines, column by column, by
    shares of the phase's duration; where that is given, they are by time.
    """

    chains: tuple[tuple[int, ...], ...]
    degree: int
    statics: int
    free: bool

    @property
    def orders(self) -> int:
        """Number of derivatives, from the position to the control."""
        return len(self.chains[0])

    @property
    def size(self) -> int:
        """Number of local variables."""
        return len(self.chains) * (self.degree + 1) + self.statics + self.free

    def variables(self, local: ca.SX, basis: ca.SX) -> ca.SX:
        """The stage's variables w (n,) of local ones and the basis."""
        n, splines = len(self.chains), self.degree + 1
        moved = ca.mtimes(
            ca.reshape(local[: n * splines], n, splines),
            ca.reshape(basis, splines, self.orders),
        )
        lasting = local[self.size - 1] if self.free else ca.SX(1)
        found = [ca.SX(0)] * (n * self.orders)
        for j, chain in enumerate(self.chains):
            for order, place in enumerate(chain):
                found[place] = moved[j, order] / lasting**order
        return ca.vertcat(*found, local[n * splines : n * splines + self.statics])

    def of_stage(self, functions: Sequence[ca.Function]) -> tuple[ca.Function, ...]:
        """A stage and its derivatives by local variables.

        Parameters
        ----------
        functions : sequence of casadi.Function
            (w, p, numbers) -> values; -> Jacobian by w; (.., weights) -> Hessian by w.

        Returns
        -------
        tuple of casadi.Function
            (local, p, numbers, basis) -> values; -> Jacobian; (.., weights) -> upper half of the
            Hessian.
        """
        values, jacobian, hessian = functions
        local, basis = (
            ca.SX.sym("local", self.size),
            ca.SX.sym("basis", self.orders * (self.degree + 1)),
        )
        _, *same, weights = hessian.sx_in()
        w = self.variables(local, basis)
        slope, by_w = ca.jacobian(w, local), jacobian(w, *same)
        pull = ca.SX.sym("pull", w.numel())
        curved = ca.hessian(ca.dot(pull, w), local)[0]
        (bent,) = ca.substitute([curved], [pull], [ca.densify(ca.mtimes(by_w.T, weights))])
        bent += ca.mtimes([slope.T, hessian(w, *same, weights), slope])
        given = [local, *same, basis]
        return (
            ca.Function(values.name(), given, [values(w, *same)]),
            ca.Function(jacobian.name(), given, [ca.mtimes(by_w, slope)]),
            ca.Function(hessian.name(), [*given, weights], [ca.triu(bent)]),
        )
