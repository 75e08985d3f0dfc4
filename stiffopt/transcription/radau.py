"""Legendre-Gauss-Radau collocation (flipped: the points include each interval's end).

States are polynomials of the given degree through the interval's start and its points; controls
are defined at the points only. There is none at t = 0: bounds on the initial control hold for the
polynomial through the first interval's points, which is also the exported acceleration there.
Second-order states integrate that polynomial exactly. Integrals use the Radau weights, path rows
hold at the points.
"""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np

from stiffopt.errors import ProblemError
from stiffopt.transcription import grid
from stiffopt.transcription.nlp import Places
from stiffopt.transcription.ocp import Rows
from stiffopt.transcription.scheme import Defect, Scheme, StagePoints, Symbols


class Radau(Scheme):
    """Radau points of a degree from 1 to 9; the value at the ends has order 2 degree - 1.

    With bounded control rates the controls are also held continuous between intervals; the rate
    is bounded at both ends of each interval, which covers the inside up to degree 3.
    """

    name = "radau"
    rate_nodes = np.array([0.0, 1.0])

    def __init__(self, degree: int = 3) -> None:
        if not 1 <= degree <= 9:
            raise ProblemError(f"radau degree {degree} is not possible; allowed: 1 to 9.")
        self.degree = degree
        self.control_nodes = grid.radau_nodes(degree)
        self.state_nodes = np.append(0.0, self.control_nodes)

    def defects(self, s: Symbols) -> Iterator[Defect]:
        """Slopes of the state polynomials at the points, and double integrals."""
        d, count = self.degree, len(s.intervals)
        x = [s.states[:, j : j + d * (count - 1) + 1 : d] for j in range(d + 1)]
        u = [s.controls[:, j::d] for j in range(d)]
        slopes = grid.differentiation_matrix(self.state_nodes)[1:]
        twice = grid.integration_matrix(self.control_nodes, self.control_nodes, times=2)
        q, v, a = s.second_order
        first = s.first_order
        rates = s.rates(s.states[:, 1:], s.controls) if first else ca.MX(0, d * count)
        for i, local in enumerate(self.control_nodes):
            places = s.intervals.places(np.array([local]))
            if q:
                h = s.step(len(q))
                slope = _weighted_sum(slopes[i], x, v)
                yield "velocity step", v, slope - h * u[i][a, :], places
                moved = float(local) * h * x[0][v, :] + h * h * _weighted_sum(twice[i], u, a)
                yield "position step", q, x[i + 1][q, :] - x[0][q, :] - moved, places
            if first:
                slope = _weighted_sum(slopes[i], x, first)
                yield "dynamics", first, slope - s.step(len(first)) * rates[:, i::d], places

    def stage_points(self, s: Symbols, midpoints: bool) -> StagePoints:
        """Return the Radau points, whatever the rows ask for."""
        count = len(s.intervals)
        weights = np.kron(np.eye(count), grid.quadrature_weights(self.control_nodes)[:, None])
        return StagePoints(
            states=s.states[:, 1:],
            controls=s.controls,
            weights=weights,
            places=self.control_places(s.intervals),
            main=np.ones(self.degree * count, dtype=bool),
        )

    def extra_rows(self, s: Symbols) -> Iterator[tuple[Rows, ca.MX, Places]]:
        """Velocity rows, and bounds of the initial control on its polynomial at t = 0."""
        yield from super().extra_rows(s)
        lower, upper = s.ocp.initial_control_lower, s.ocp.initial_control_upper
        if lower is None or upper is None:
            return
        start = grid.interpolation_matrix(self.control_nodes, np.array([0.0]))[0]
        value = ca.mtimes(s.controls[:, : self.degree], ca.DM(start))
        rows = Rows.make(
            "control at the start", s.ocp.controls, lower, upper, s.ocp.scales_of_controls
        )
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
