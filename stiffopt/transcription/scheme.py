"""Base of the transcription schemes: intervals, their nodes and rows."""

from __future__ import annotations

import abc
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from stiffopt.errors import ProblemError
from stiffopt.transcription import grid
from stiffopt.transcription.chain_splines import ChainSplines
from stiffopt.transcription.mesh import Mesh
from stiffopt.transcription.nlp import Places
from stiffopt.transcription.ocp import OptimalControlProblem, Rows


@dataclass(frozen=True)
class Intervals:
    """Intervals of a mesh in order of time."""

    phase: np.ndarray  # (K,) phase of each interval
    # (K,) fractions of the phase's duration.
    start: np.ndarray
    width: np.ndarray

    @classmethod
    def of(cls, mesh: Mesh) -> Intervals:
        """Collect the intervals of a mesh."""
        return cls(
            np.concatenate([np.full(len(part), i) for i, part in enumerate(mesh)]),
            np.concatenate([np.cumsum(part) - part for part in mesh]),
            np.concatenate(mesh),
        )

    def __len__(self) -> int:
        return len(self.phase)

    @property
    def shares(self) -> np.ndarray:
        """Matrix (K, phases) from phase durations to interval durations."""
        own = self.phase[:, None] == np.arange(self.phase[-1] + 1)
        return np.where(own, self.width[:, None], 0.0)

    def copy_durations(self, offset: int, variables: int) -> ca.DM:
        """Matrix (n + K + 1, n) from n variables to these and copies of the phase durations.

        The durations stand at `offset`. Each interval has its own copy of its phase's duration, the
        last entry is their total: second derivatives by copies are as sparse as those of one
        interval, however many phases there are.
        """
        phases, count = int(self.phase[-1]) + 1, len(self)
        columns = [offset + int(i) for i in (*self.phase, *range(phases))]
        rows = [*range(count), *[count] * phases]
        copies = ca.DM.triplet(rows, columns, ca.DM.ones(len(rows)), count + 1, variables)
        return ca.vertcat(ca.DM.eye(variables), copies)

    def places(self, nodes: np.ndarray) -> Places:
        """Places of local nodes (m,) in every interval: (K m,), interval by interval."""
        fraction = self.start[:, None] + self.width[:, None] * nodes
        return Places(np.repeat(self.phase, len(nodes)), fraction.ravel())


@dataclass(frozen=True, kw_only=True)
class StagePoints:
    """Points at which the stage is evaluated."""

    # (nx, P), (nu, P).
    states: ca.MX
    controls: ca.MX
    # (P, K) quadrature weights of the points, as factors of the interval durations.
    weights: np.ndarray
    places: Places  # (P,)


@dataclass(frozen=True, kw_only=True)
class Symbols:
    """Unscaled symbols of one NLP under construction."""

    ocp: OptimalControlProblem
    intervals: Intervals
    # (nx, NX), (nu, NU).
    states: ca.MX
    controls: ca.MX
    durations: ca.MX  # (K,) of each interval's phase [s]
    parameters: ca.MX  # (np, 1)
    # `ChainSplines.at` of the coefficients, where these are variables.
    spline_values: Callable[..., ca.MX] | None = None

    @cached_property
    def chain(self) -> list[list[int]]:
        """Indices of all chains by order of derivative: positions, velocities, .., controls."""
        return [list(order) for order in zip(*self.ocp.chains, strict=True)]

    @cached_property
    def second_order(self) -> tuple[list[int], list[int], list[int]]:
        """Indices of positions, velocities and the controls that are their accelerations."""
        if len(self.chain) != 3:
            raise ProblemError(
                "motions smoother than piecewise-linear acceleration need the transcription "
                "'piecewise_linear_acceleration'."
            )
        q, v, a = self.chain
        return q, v, a

    @cached_property
    def steps(self) -> ca.MX:
        """Interval durations (1, K) [s]."""
        return (ca.DM(self.intervals.width) * self.durations).T

    def step(self, rows: int) -> ca.MX:
        """Interval durations repeated over rows (rows, K)."""
        return ca.repmat(self.steps, rows, 1)


# A block of equations (zero inside): name, state indices, expression (m, k), places (k,).
Defect = tuple[str, list[int], ca.MX, Places]


class Scheme(abc.ABC):
    """Nodes of one interval and the equations on them."""

    name: str
    state_nodes: np.ndarray  # local nodes with 0 (shared with the interval before) and 1
    # Local nodes; where the first is 0 it is shared with the interval before.
    control_nodes: np.ndarray
    rate_nodes: np.ndarray  # local points where the control's time derivative is bounded

    @property
    def continuous_control(self) -> bool:
        """True where intervals share the control at their border."""
        return bool(self.control_nodes[0] == 0.0)

    def state_columns(self, count: int) -> np.ndarray:
        """Columns of the states that belong to each of `count` intervals (count, nodes)."""
        return _interval_columns(count, len(self.state_nodes), shared=True)

    def control_columns(self, count: int) -> np.ndarray:
        """Columns of the controls that belong to each of `count` intervals (count, nodes)."""
        return _interval_columns(count, len(self.control_nodes), shared=self.continuous_control)

    def state_places(self, intervals: Intervals) -> Places:
        """Places of all state columns."""
        return _node_places(intervals, self.state_nodes)

    def control_places(self, intervals: Intervals) -> Places:
        """Places of all control columns."""
        return _node_places(intervals, self.control_nodes)

    def splines(self, ocp: OptimalControlProblem, mesh: Mesh) -> ChainSplines | None:
        """Return the splines whose coefficients are the variables; None where states are."""
        return None

    def motion_splines(self, ocp: OptimalControlProblem, mesh: Mesh) -> ChainSplines | None:
        """Return the splines that represent every motion that obeys the equations.

        None where splines do not represent all, as with control jumps, and where their coefficients
        are the variables already.
        """
        jumps = not np.array_equal(self.state_nodes, self.control_nodes)
        if jumps or self.splines(ocp, mesh) is not None:
            return None
        return ChainSplines(mesh, ocp.chains, len(self.control_nodes) - 1)

    @abc.abstractmethod
    def defects(self, s: Symbols) -> Iterator[Defect]:
        """Equations between the states, all zero where each is the integral of the next."""

    @abc.abstractmethod
    def stage_points(self, s: Symbols) -> StagePoints:
        """Points for path rows and integrals."""

    def extra_rows(self, s: Symbols) -> Iterator[tuple[Rows, ca.MX, Places]]:
        """Velocity and acceleration bounds within the intervals, by Bernstein coefficients.

        A polynomial lies within its Bernstein coefficients, so these linear rows keep the bounds
        of second-order states at every instant, not at nodes only; where the polynomial is constant
        or enters a constant stretch they cost nothing.
        """
        _, v, a = s.second_order
        ocp, nodes, places = s.ocp, self.control_nodes, s.intervals.places
        degree = len(nodes)
        first = self.state_columns(len(s.intervals))[:, 0].tolist()
        bounds = (ocp.state_lower[v], ocp.state_upper[v])
        kept, rows = _bounded_rows("velocity", ocp.states, ocp.state_scale, v, bounds)
        if rows is not None:
            v, own = [v[i] for i in kept], [a[i] for i in kept]
            for j, weights in enumerate(grid.bernstein_of_integral(nodes)[1:-1], start=1):
                change = s.step(len(v)) * self._weighted_controls(s, weights, own)
                yield rows, s.states[v, first] + change, places(np.array([j / degree]))
        bounds = (ocp.control_lower[a], ocp.control_upper[a])
        kept, rows = _bounded_rows("acceleration", ocp.controls, ocp.control_scale, a, bounds)
        if rows is not None:
            own = [a[i] for i in kept]
            for j, weights in enumerate(grid.bernstein_from_values(nodes)):
                local = j / max(degree - 1, 1)
                # At an end that is a node the coefficient is the node's value: bounded already.
                if local not in (0.0, 1.0) or local not in nodes:
                    yield rows, self._weighted_controls(s, weights, own), places(np.array([local]))

    def _weighted_controls(self, s: Symbols, weights: np.ndarray, controls: list[int]) -> ca.MX:
        """Weighted sum of the controls at the nodes of every interval (len(controls), K)."""
        columns = self.control_columns(len(s.intervals))
        total = ca.MX(len(controls), len(columns))
        for i, weight in enumerate(weights):
            total += float(weight) * s.controls[controls, columns[:, i].tolist()]
        return total

    def control_jumps(self, s: Symbols) -> ca.MX:
        """Jumps of the controls between intervals (nu, K - 1)."""
        return ca.MX(s.controls.shape[0], len(s.intervals) - 1)

    def control_rates(self, s: Symbols, local: float) -> ca.MX:
        """Time derivative of the controls at a local point of every interval (nu, K)."""
        nodes = self.control_nodes
        slopes = grid.interpolation_matrix(nodes, np.array([local])) @ grid.differentiation_matrix(
            nodes
        )
        columns = self.control_columns(len(s.intervals))
        total = sum(
            float(w) * s.controls[:, columns[:, j].tolist()] for j, w in enumerate(slopes[0])
        )
        return total / s.step(s.controls.shape[0])


def _bounded_rows(
    name: str,
    labels: tuple[str, ...],
    scales: np.ndarray,
    indices: list[int],
    bounds: tuple[np.ndarray, np.ndarray],
) -> tuple[np.ndarray, Rows | None]:
    """Select those of `indices` with a finite bound, and make their rows."""
    kept = np.flatnonzero(np.isfinite(bounds[0]) | np.isfinite(bounds[1]))
    if not kept.size:
        return kept, None
    own = [indices[i] for i in kept]
    rows = Rows.make(
        f"{name} within interval",
        [labels[i] for i in own],
        bounds[0][kept],
        bounds[1][kept],
        scales[own],
    )
    return kept, rows


def _interval_columns(count: int, nodes: int, shared: bool) -> np.ndarray:
    stride = nodes - 1 if shared else nodes
    return stride * np.arange(count)[:, None] + np.arange(nodes)


def _node_places(intervals: Intervals, nodes: np.ndarray) -> Places:
    if nodes[0] != 0.0:
        return intervals.places(nodes)
    inner = intervals.places(nodes[1:])
    return Places(np.append(0, inner.phase), np.append(0.0, inner.fraction))
