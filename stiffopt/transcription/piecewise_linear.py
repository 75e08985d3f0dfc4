"""Piecewise-linear control: chains of integrators become splines, integrated exactly.

The equations hold exactly and only the shape of the control is restricted, so that the optimum
converges with order 2.
"""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np

from stiffopt.transcription.chain_splines import ChainSplines
from stiffopt.transcription.mesh import Mesh
from stiffopt.transcription.nlp import Places
from stiffopt.transcription.ocp import OptimalControlProblem, Rows
from stiffopt.transcription.scheme import Defect, Scheme, StagePoints, Symbols


class PiecewiseLinear(Scheme):
    """Control linear in each interval and continuous.

    Path rows hold in the middles of the intervals too. Integrals then use Simpson's rule,
    else the trapezoidal rule on the nodes. Midpoints double the work of an interval; on the torque
    squared of a six-joint arm both rules are equally accurate for equal solve time, so midpoints
    are not added for the integrals' sake.
    """

    name = "piecewise_linear_acceleration"
    state_nodes = np.array([0.0, 1.0])
    control_nodes = np.array([0.0, 1.0])
    rate_nodes = np.array([0.0])

    def defects(self, s: Symbols) -> Iterator[Defect]:
        """Exact double integration."""
        places = s.intervals.places(np.array([0.5]))
        q, v, a = s.second_order
        x0, x1, u0, u1 = _interval_ends(s)
        h = s.step(len(q))
        v0, a0, a1 = x0[v, :], u0[a, :], u1[a, :]
        yield "velocity step", v, x1[v, :] - v0 - h * (a0 + a1) / 2.0, places
        moved = h * v0 + h * h * (2.0 * a0 + a1) / 6.0
        yield "position step", q, x1[q, :] - x0[q, :] - moved, places

    def stage_points(self, s: Symbols) -> StagePoints:
        """Nodes, and the middles of the intervals if there are path rows."""
        count = len(s.intervals)
        left, right = np.eye(count + 1, count), np.eye(count + 1, count, k=-1)
        places = self.state_places(s.intervals)
        if not s.ocp.path_rows:
            return StagePoints(
                states=s.states,
                controls=s.controls,
                weights=(left + right) / 2.0,
                places=places,
            )
        middle = s.intervals.places(np.array([0.5]))
        x_mid, u_mid = self.middle(s)
        return StagePoints(
            states=ca.horzcat(s.states, x_mid),
            controls=ca.horzcat(s.controls, u_mid),
            weights=np.vstack([(left + right) / 6.0, np.eye(count) * 2.0 / 3.0]),
            places=Places(
                np.append(places.phase, middle.phase), np.append(places.fraction, middle.fraction)
            ),
        )

    def middle(self, s: Symbols) -> tuple[ca.MX, ca.MX]:
        """States and controls in the middles of the intervals."""
        q, v, a = s.second_order
        x0, _, u0, u1 = _interval_ends(s)
        h = s.step(len(q))
        v0, a0, a1 = x0[v, :], u0[a, :], u1[a, :]
        states = ca.vertcat(
            x0[q, :] + h * v0 / 2.0 + h * h * (5.0 * a0 + a1) / 48.0,
            v0 + h * (3.0 * a0 + a1) / 8.0,
        )
        return states[np.argsort([*q, *v]).tolist(), :], (u0 + u1) / 2.0


def _interval_ends(s: Symbols) -> tuple[ca.MX, ca.MX, ca.MX, ca.MX]:
    return s.states[:, :-1], s.states[:, 1:], s.controls[:, :-1], s.controls[:, 1:]


class IntegratorChain(PiecewiseLinear):
    """Chains of more than two integrators behind a piecewise-linear, continuous control.

    Variables are the coefficients of splines (`ChainSplines`), so no equation couples the nodes of
    a phase. Such motions deviate so little between nodes that bounds of states need no rows within
    the intervals.
    """

    def splines(self, ocp: OptimalControlProblem, mesh: Mesh) -> ChainSplines:
        """Return the splines whose coefficients are the variables."""
        return ChainSplines(mesh, ocp.chains)

    def defects(self, s: Symbols) -> Iterator[Defect]:
        """Yield nothing: splines obey the equations."""
        return iter(())

    def middle(self, s: Symbols) -> tuple[ca.MX, ca.MX]:
        """States and controls in the middles of the intervals."""
        assert s.spline_values is not None
        values = s.spline_values(s.intervals.places(np.array([0.5])))
        states = len(s.ocp.states)
        return values[:states, :], values[states:, :]

    def extra_rows(self, s: Symbols) -> Iterator[tuple[Rows, ca.MX, Places]]:
        """Yield nothing: see the class."""
        return iter(())
