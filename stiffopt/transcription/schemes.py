"""Transcription schemes by name: piecewise linear, Hermite-Simpson, Legendre-Gauss-Radau."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np

from stiffopt.transcription import grid
from stiffopt.transcription.chain_splines import ChainSplines
from stiffopt.transcription.mesh import Mesh
from stiffopt.transcription.nlp import Places
from stiffopt.transcription.ocp import OptimalControlProblem, Rows
from stiffopt.transcription.scheme import Defect, Scheme, StagePoints, Symbols


class PiecewiseLinear(Scheme):
    """Control linear in each interval and continuous; chains of integrators become splines.

    The equations hold exactly and only the shape of the control is restricted, so that the optimum
    converges with order 2.

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


# Gauss-Lobatto nodes of an interval: its ends and its middle.
_INTERVAL_NODES = np.array([0.0, 0.5, 1.0])


class HermiteSimpson(Scheme):
    """Nodes and midpoints, in order of time."""

    name = "hermite_simpson"
    state_nodes = _INTERVAL_NODES
    control_nodes = _INTERVAL_NODES
    rate_nodes = np.array([0.0, 1.0])

    def defects(self, s: Symbols) -> Iterator[Defect]:
        """Equations at the midpoint and the end of each interval."""
        x0, *targets = _split_thirds(s.states)
        q, v, a = s.second_order
        h, nodes = s.step(len(q)), [each[a, :] for each in _split_thirds(s.controls)]
        ends = _INTERVAL_NODES[1:]
        once = grid.integration_matrix(_INTERVAL_NODES, ends)
        twice = grid.integration_matrix(_INTERVAL_NODES, ends, times=2)
        for local, target, w1, w2 in zip(ends, targets, once, twice, strict=True):
            places = s.intervals.places(np.array([local]))
            gain = sum(float(w) * u for w, u in zip(w1, nodes, strict=True))
            yield "velocity step", v, target[v, :] - x0[v, :] - h * gain, places
            gain = sum(float(w) * u for w, u in zip(w2, nodes, strict=True))
            moved = float(local) * h * x0[v, :] + h * h * gain
            yield "position step", q, target[q, :] - x0[q, :] - moved, places

    def stage_points(self, s: Symbols) -> StagePoints:
        """Nodes and midpoints."""
        count = len(s.intervals)
        weights = np.zeros((2 * count + 1, count))
        for j, w in enumerate(grid.quadrature_weights(_INTERVAL_NODES)):
            weights[2 * np.arange(count) + j, np.arange(count)] += w
        return StagePoints(
            states=s.states,
            controls=s.controls,
            weights=weights,
            places=self.state_places(s.intervals),
        )


def _split_thirds(columns: ca.MX) -> tuple[ca.MX, ca.MX, ca.MX]:
    return columns[:, 0:-2:2], columns[:, 1::2], columns[:, 2::2]


class Radau(Scheme):
    """Three Radau points; the value at the ends has order 5.

    With bounded control rates the controls are also held continuous between intervals; the rate
    is bounded at both ends of each interval, which covers the inside.
    """

    name = "radau"
    rate_nodes = np.array([0.0, 1.0])
    control_nodes = np.array(ca.collocation_points(3, "radau"))
    state_nodes = np.append(0.0, control_nodes)
    degree = len(control_nodes)

    def defects(self, s: Symbols) -> Iterator[Defect]:
        """Slopes of the state polynomials at the points, and double integrals."""
        d, count = self.degree, len(s.intervals)
        x = [s.states[:, j : j + d * (count - 1) + 1 : d] for j in range(d + 1)]
        u = [s.controls[:, j::d] for j in range(d)]
        slopes = grid.differentiation_matrix(self.state_nodes)[1:]
        twice = grid.integration_matrix(self.control_nodes, self.control_nodes, times=2)
        q, v, a = s.second_order
        h = s.step(len(q))
        for i, local in enumerate(self.control_nodes):
            places = s.intervals.places(np.array([local]))
            slope = _weighted_sum(slopes[i], x, v)
            yield "velocity step", v, slope - h * u[i][a, :], places
            moved = float(local) * h * x[0][v, :] + h * h * _weighted_sum(twice[i], u, a)
            yield "position step", q, x[i + 1][q, :] - x[0][q, :] - moved, places

    def stage_points(self, s: Symbols) -> StagePoints:
        """Return the Radau points."""
        count = len(s.intervals)
        weights = np.kron(np.eye(count), grid.quadrature_weights(self.control_nodes)[:, None])
        return StagePoints(
            states=s.states[:, 1:],
            controls=s.controls,
            weights=weights,
            places=self.control_places(s.intervals),
        )

    def extra_rows(self, s: Symbols) -> Iterator[tuple[Rows, ca.MX, Places]]:
        """Velocity rows, and bounds of the initial control on its polynomial at t = 0."""
        yield from super().extra_rows(s)
        lower, upper = s.ocp.initial_control_lower, s.ocp.initial_control_upper
        if lower is None or upper is None:
            return
        start = grid.interpolation_matrix(self.control_nodes, np.array([0.0]))[0]
        value = ca.mtimes(s.controls[:, : self.degree], ca.DM(start))
        rows = Rows.make("control at the start", s.ocp.controls, lower, upper, s.ocp.control_scale)
        yield rows, value, Places(np.array([0]), np.array([0.0]))

    def control_jumps(self, s: Symbols) -> ca.MX:
        """Control polynomial at each inner interval's start less the one before (nu, K - 1)."""
        d = self.degree
        start = grid.interpolation_matrix(self.control_nodes, np.array([0.0]))[0]
        u = [s.controls[:, j::d] for j in range(d)]
        values = _weighted_sum(start, u, list(range(s.controls.shape[0])))
        return values[:, 1:] - u[-1][:, :-1]


def _weighted_sum(weights: np.ndarray, parts: list[ca.MX], rows: list[int]) -> ca.MX:
    total = ca.MX(len(rows), parts[0].shape[1])
    for weight, part in zip(weights, parts, strict=True):
        total += float(weight) * part[rows, :]
    return total


SCHEMES: dict[str, type[Scheme]] = {
    each.name: each for each in (PiecewiseLinear, HermiteSimpson, Radau)
}


def scheme_of(method: str, integrators: int) -> Scheme:
    """Return the scheme of a name, for so many integrators between a control and its position."""
    if method == PiecewiseLinear.name and integrators > 2:
        return IntegratorChain()
    return SCHEMES[method]()
