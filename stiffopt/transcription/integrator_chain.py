"""Chains of more than two integrators behind a piecewise-linear control, integrated exactly.

Nodes are those of `PiecewiseLinear`; variables are the coefficients of splines (`ChainSplines`), so
that no equation ties the nodes of a phase. Such motions bend so little between nodes that bounds of
states need no rows within the intervals.
"""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np

from stiffopt.transcription.chain_splines import ChainSplines
from stiffopt.transcription.mesh import Mesh
from stiffopt.transcription.nlp import Places
from stiffopt.transcription.ocp import OptimalControlProblem, Rows
from stiffopt.transcription.piecewise_linear import PiecewiseLinear
from stiffopt.transcription.scheme import Defect, Symbols


class IntegratorChain(PiecewiseLinear):
    """Control linear in each interval and continuous; every state belongs to a chain."""

    def splines(self, ocp: OptimalControlProblem, mesh: Mesh) -> ChainSplines:
        """The splines whose coefficients are the variables."""
        return ChainSplines(mesh, ocp.chains)

    def defects(self, s: Symbols) -> Iterator[Defect]:
        """None: splines obey the dynamics."""
        return iter(())

    def middle(self, s: Symbols) -> tuple[ca.MX, ca.MX]:
        """States and controls in the middles of the intervals."""
        assert s.moves is not None
        values = s.moves(s.intervals.places(np.array([0.5])))
        states = len(s.ocp.states)
        return values[:states, :], values[states:, :]

    def extra_rows(self, s: Symbols) -> Iterator[tuple[Rows, ca.MX, Places]]:
        """None."""
        return iter(())
