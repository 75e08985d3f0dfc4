"""Chains of integrators behind a piecewise-linear control, as splines.

With five integrators (position, velocity, acceleration, jerk and snap behind a crackle) positions
are splines of degree 6 with five continuous derivatives. With their coefficients as variables no
equation couples the states of neighbouring nodes: a fifth of the variables, a third of the time of
an iteration, and fewer iterations.

Source: de Boor (1978), "A practical guide to splines".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
import scipy

from stiffopt.transcription.mesh import Mesh
from stiffopt.transcription.nlp import Places


@dataclass(frozen=True, eq=False)
class ChainSplines:
    """Splines of a problem's chains, phase by phase, in shares of the phase's duration.

    Coefficients are one vector, in order of time, in which chains run fastest.
    """

    mesh: Mesh
    # Indices (position, velocity, .., control); all states and controls belong to one chain.
    chains: tuple[tuple[int, ...], ...]
    control_degree: int = 1  # degree of the controls, which are continuous

    @property
    def orders(self) -> int:
        """Number of derivatives in a chain, from the position to the control."""
        return len(self.chains[0])

    @property
    def degree(self) -> int:
        """Degree of the positions."""
        return self.orders - 1 + self.control_degree

    @property
    def values(self) -> int:
        """Number of states and controls at a point."""
        return self.orders * len(self.chains)

    @property
    def places(self) -> tuple[tuple[int, ...], ...]:
        """Indices of position to control of each chain in the vector (states, controls)."""
        return tuple(tuple(self._chain_indices(j)) for j in range(len(self.chains)))

    @cached_property
    def counts(self) -> np.ndarray:
        """Number of coefficients of a chain in each phase."""
        inner = [self.control_degree * (len(part) - 1) for part in self.mesh]
        return np.array(inner) + self.degree + 1

    @property
    def size(self) -> int:
        """Number of all coefficients."""
        return int(self.counts.sum()) * len(self.chains)

    def at(
        self, places: Places, coefficients: ca.MX, durations: ca.MX, orders: tuple[int, ...] = ()
    ) -> ca.MX:
        """States and controls (nx + nu, P) at places, as expressions of the coefficients.

        `durations` (K,) are those of each interval's phase. With `orders`, derivatives of these
        orders (len(orders) n, P) of all chains instead.
        """
        matrix, powers, _ = self._coefficient_map(places, orders)
        height = len(orders) * len(self.chains) or self.values
        moved = ca.mtimes(ca.DM(matrix.tocsc()), coefficients)
        stretched = self._durations_at(places, durations, height) ** ca.DM(-powers)
        return ca.reshape(moved * stretched, height, len(places))

    def positions(self, places: Places, states: Sequence[int], columns: int) -> ca.DM:
        """Matrix from variables, the coefficients first, to positions, place by place."""
        chains = [chain[0] for chain in self.chains]
        matrix = self._coefficient_map(places, (0,))[0].tocsr()
        rows = np.arange(len(places))[:, None] * len(chains) + [chains.index(i) for i in states]
        own = matrix[rows.ravel()]
        own.resize((own.shape[0], columns))
        return ca.DM(own.tocsc())

    def nonzero_basis(self, places: Places) -> tuple[np.ndarray, np.ndarray]:
        """Nonzero basis functions at places.

        `coefficients` (P, degree + 1) of int: rows of the coefficients (size / n, n). `basis` (P,
        orders, degree + 1): derivatives by shares of the phase's duration.
        """
        begins = np.cumsum(self.counts) - self.counts
        splines = np.arange(self.degree + 1)
        rows = np.zeros((len(places), len(splines)), dtype=int)
        basis = np.zeros((len(places), self.orders, len(splines)))
        for phase in np.unique(places.phase):
            own, fractions = places.phase == phase, places.fraction[places.phase == phase]
            interval = self._interval_index(int(phase), fractions)
            first = (self.control_degree * interval)[:, None] + splines
            rows[own] = begins[phase] + first
            for order in range(self.orders):
                values = self._basis_values(int(phase), fractions, order)
                basis[own, order] = np.take_along_axis(values, first, axis=1)
        return rows, basis

    def evaluate(
        self, places: Places, coefficients: np.ndarray, durations: np.ndarray
    ) -> np.ndarray:
        """States and controls (P, nx + nu) of numeric coefficients."""
        matrix, powers, phases = self._coefficient_map(places)
        found = matrix.tocsr() @ coefficients / durations[phases] ** powers
        return np.asarray(found.reshape(len(places), self.values))

    def matrix(self, places: Places, durations: np.ndarray) -> scipy.sparse.csr_matrix:
        """Matrix ((nx + nu) P, size) from coefficients to states and controls, place by place."""
        matrix, powers, phases = self._coefficient_map(places)
        return (scipy.sparse.diags(durations[phases] ** -powers) @ matrix).tocsr()

    def fit(
        self, places: Places, values: np.ndarray, scales: np.ndarray, durations: np.ndarray
    ) -> np.ndarray:
        """Fit coefficients to states and controls (P, nx + nu) at places by least squares.

        `values` (P, nx + nu). `scales` (nx + nu,). `durations` (phases,).
        """
        n, start = len(self.chains), 0
        found = np.zeros((int(self.counts.sum()), n))
        for phase, count in enumerate(self.counts):
            # The node at a border belongs to both phases.
            own = places.phase == phase
            fractions, given = places.fraction[own], values[own]
            if phase:
                last = np.flatnonzero(places.phase == phase - 1)[-1]
                fractions = np.append(0.0, fractions)
                given = np.vstack([values[last], given])
            orders = [self._basis_values(phase, fractions, k) for k in range(self.orders)]
            for j in range(n):
                indices = self._chain_indices(j)
                rows = [
                    basis / durations[phase] ** k / scales[indices[k]]
                    for k, basis in enumerate(orders)
                ]
                wanted = [given[:, i] / scales[i] for i in indices]
                solved = np.linalg.lstsq(np.vstack(rows), np.concatenate(wanted), rcond=None)
                found[start : start + count, j] = solved[0]
            start += count
        return found.ravel()

    def _durations_at(self, places: Places, durations: ca.MX, height: int) -> ca.MX:
        """Phase durations of the intervals of places, each repeated `height` times."""
        counts = np.array([len(part) for part in self.mesh])
        firsts = np.cumsum(counts) - counts
        index = np.zeros(len(places), dtype=int)
        for phase in np.unique(places.phase):
            own = places.phase == phase
            index[own] = firsts[phase] + self._interval_index(int(phase), places.fraction[own])
        return durations[np.repeat(index, height).tolist()]

    def _interval_index(self, phase: int, fractions: np.ndarray) -> np.ndarray:
        """Index of the interval within a phase at each fraction of its duration."""
        borders = np.cumsum(self.mesh[phase])[:-1]
        return np.searchsorted(borders, fractions, side="right")

    def _chain_indices(self, chain: int) -> list[int]:
        *states, control = self.chains[chain]
        return [*states, (self.orders - 1) * len(self.chains) + control]

    def _basis_values(self, phase: int, fractions: np.ndarray, order: int) -> np.ndarray:
        """Derivatives of all splines (P, count) of a phase by its scaled time."""
        breaks = np.append(0.0, np.cumsum(self.mesh[phase]))
        breaks[-1] = 1.0
        first, *inner, last = breaks
        ends = np.ones(self.degree + 1)
        knots = np.concatenate([first * ends, np.repeat(inner, self.control_degree), last * ends])
        spline = scipy.interpolate.BSpline(knots, np.eye(self.counts[phase]), self.degree)
        return np.asarray((spline.derivative(order) if order else spline)(fractions))

    def _coefficient_map(
        self, places: Places, orders: tuple[int, ...] = ()
    ) -> tuple[scipy.sparse.coo_matrix, np.ndarray, np.ndarray]:
        """Matrix from the coefficients, powers of the phase duration in the divisor, and phases.

        Rows are the states above the controls, point by point; or derivatives of these orders, of
        all chains.
        """
        n, count = len(self.chains), len(places)
        height = len(orders) * n if orders else self.values
        rows, columns, data = [], [], []
        powers = np.zeros((count, height))
        begins = np.cumsum(self.counts) - self.counts
        for phase in np.unique(places.phase):
            own = np.flatnonzero(places.phase == phase)
            for place, order in enumerate(orders or range(self.orders)):
                basis = self._basis_values(int(phase), places.fraction[own], order)
                point, coefficient = np.nonzero(np.abs(basis) > 1e-14 * np.abs(basis).max())
                for j in range(n):
                    index = place * n + j if orders else self._chain_indices(j)[order]
                    rows.append(own[point] * height + index)
                    columns.append((begins[phase] + coefficient) * n + j)
                    data.append(basis[point, coefficient])
                    powers[own, index] = order
        matrix = scipy.sparse.coo_matrix(
            (np.concatenate(data), (np.concatenate(rows), np.concatenate(columns))),
            (count * height, self.size),
        )
        return matrix, powers.ravel(), np.repeat(places.phase, height)
