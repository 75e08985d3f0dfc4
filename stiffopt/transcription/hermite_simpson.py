"""Hermite-Simpson collocation in separated form: midpoint states and controls are variables.

Quadratic control in each interval, continuous at the borders. Second-order states integrate it
exactly; other states are Hermite cubics with Simpson's rule (order 4). Integrals use Simpson's
rule, path rows hold at nodes and midpoints.
"""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np

from stiffopt.transcription import grid
from stiffopt.transcription.scheme import Defect, Scheme, StagePoints, Symbols

_INTERVAL_NODES = grid.lobatto_nodes(3)


class HermiteSimpson(Scheme):
    """Nodes and midpoints, in order of time."""

    name = "hermite_simpson"
    state_nodes = _INTERVAL_NODES
    control_nodes = _INTERVAL_NODES
    rate_nodes = np.array([0.0, 1.0])

    def defects(self, s: Symbols) -> Iterator[Defect]:
        """Equations at the midpoint and the end of each interval."""
        x0, xm, x1 = _split_thirds(s.states)
        a0, am, a1 = _split_thirds(s.controls)
        q, v, a = s.second_order
        ends = _INTERVAL_NODES[1:]
        if q:
            h = s.step(len(q))
            once = grid.integration_matrix(_INTERVAL_NODES, ends)
            twice = grid.integration_matrix(_INTERVAL_NODES, ends, times=2)
            nodes = (a0[a, :], am[a, :], a1[a, :])
            for local, target, w1, w2 in zip(ends, (xm, x1), once, twice, strict=True):
                places = s.intervals.places(np.array([local]))
                gain = sum(float(w) * u for w, u in zip(w1, nodes, strict=True))
                yield "velocity step", v, target[v, :] - x0[v, :] - h * gain, places
                gain = sum(float(w) * u for w, u in zip(w2, nodes, strict=True))
                moved = float(local) * h * x0[v, :] + h * h * gain
                yield "position step", q, target[q, :] - x0[q, :] - moved, places
        first = s.first_order
        if first:
            h = s.step(len(first))
            f0, fm, f1 = _split_thirds(s.rates(s.states, s.controls))
            y0, ym, y1 = x0[first, :], xm[first, :], x1[first, :]
            middle = ym - (y0 + y1) / 2.0 - h * (f0 - f1) / 8.0
            yield "dynamics", first, middle, s.intervals.places(np.array([0.5]))
            step = y1 - y0 - h * (f0 + 4.0 * fm + f1) / 6.0
            yield "dynamics", first, step, s.intervals.places(np.array([1.0]))

    def stage_points(self, s: Symbols, midpoints: bool) -> StagePoints:
        """Nodes and midpoints, whatever the rows ask for."""
        count = len(s.intervals)
        weights = np.zeros((2 * count + 1, count))
        for j, w in enumerate(grid.quadrature_weights(_INTERVAL_NODES)):
            weights[2 * np.arange(count) + j, np.arange(count)] += w
        return StagePoints(
            states=s.states,
            controls=s.controls,
            weights=weights,
            places=self.state_places(s.intervals),
            main=np.ones(2 * count + 1, dtype=bool),
        )


def _split_thirds(columns: ca.MX) -> tuple[ca.MX, ca.MX, ca.MX]:
    return columns[:, 0:-2:2], columns[:, 1::2], columns[:, 2::2]
