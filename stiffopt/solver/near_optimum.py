"""Optima near a known one, by Newton's method on the bounds and rows that bind there.

An interior-point method begins inside and has to find its way back to the bounds. Here the optimum
of the programme before tells which of them bind. Each step is a quadratic programme, solved by
letting go what has a multiplier of the wrong sign and taking in what is exceeded. With the
coefficients of splines in place of states and controls no equations are left, and everything is
banded in time.

What is found is accepted only as a local minimum, where the curvature is positive with a penalty on
leaving what binds, and to the tolerance of the solver that it stands in for. Otherwise nothing is
said.

Source: Hintermueller, Ito, Kunisch (2002), "The primal-dual active set strategy as a semismooth
Newton method".
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded
from scipy.sparse import csr_matrix, diags, vstack
from scipy.sparse.linalg import splu

from stiffopt.solver.ipopt import IpoptSolver, Multipliers, RawSolution
from stiffopt.solver.monitor import Progress
from stiffopt.symbolic import BufferedFunction
from stiffopt.transcription.nlp import Nlp
from stiffopt.transcription.transcription import Transcription

# Steps, and exchanges in each, after which an optimum is not near.
_STEPS, _EXCHANGES = 8, 40
# Share of its distance from which on a multiplier says that a constraint binds, and excess from
# which on it is taken in.
_BINDS, _ENTERS = 1e-4, 1e-10
# By which what binds may be missed, where what binds depends on each other.
_KEPT = 1e-6
# Of what binds: how much steeper than the objective its penalty is; rounds that leave none of it.
_PENALTY, _ROUNDS = 1e4, 3


class NearOptimum:
    """Finds optima of programmes that differ in numbers, each from one near it.

    Parameters
    ----------
    solver : IpoptSolver
        Whose derivatives are used and whose tolerance is kept.
    """

    def __init__(self, solver: IpoptSolver) -> None:
        self._tolerance = solver.options.tol
        self._gradient, self._jacobian, self._hessian = map(BufferedFunction, solver.derivatives)
        self._motions: _Motions | None = None

    def solve(
        self,
        transcription: Transcription,
        x0: np.ndarray,
        parameters: np.ndarray,
        near: Multipliers,
        report: Callable[[Progress], object] | None = None,
    ) -> RawSolution | None:
        """The optimum; None where it is not found, which says nothing of the programme.

        Parameters
        ----------
        transcription : Transcription
            Of the solver's programme, with its own bounds and numbers.
        x0 : array
            Scaled variables of the near optimum.
        parameters : array (np,)
        near : Multipliers
            Of the near optimum.
        report : callable, optional
        """
        begin = time.perf_counter()
        motions = self._motions_of(transcription)
        if motions is None or not np.isfinite(x0).all():
            return None
        basis = motions.basis
        nlp = transcription.nlp
        p = nlp.parameters(parameters)
        constraints = _Constraints(nlp, basis)
        coefficients = motions.nearest(x0)
        history: list[Progress] = []
        forces, side = np.zeros(0), np.zeros(0)
        for step in range(_STEPS):
            x = basis @ coefficients
            objective, gradient = (values.copy() for values in self._gradient(x, p))
            g = self._jacobian(x, p)[0].copy()
            jacobian = self._jacobian.sparse(1).tocsr()
            slope, value = basis.T @ gradient, constraints.values(x, g)
            if not step:
                forces, side = constraints.binding(near, value)
            matrix = constraints.matrix(jacobian)
            excess = np.maximum(constraints.lower - value, value - constraints.upper)
            violation = max(float(excess.max(initial=0.0)), 0.0)
            stationary = float(np.abs(slope + matrix.T @ forces).max())
            if not np.isfinite(stationary + violation):
                return None
            history.append(_progress(nlp, step, objective[0], g, time.perf_counter() - begin))
            if report is not None:
                report(history[-1])
            if step and max(stationary, violation) <= self._tolerance:
                lam_x, lam_g = constraints.split(forces)
                lam_g = motions.with_equations(nlp, gradient + lam_x, jacobian, lam_g)
                seconds = time.perf_counter() - begin
                return _solution(nlp, x, g, lam_x, lam_g, history, seconds)
            curvature = self._curvature(x, p, constraints.split(forces)[1], motions)
            to_bounds = constraints.lower - value, constraints.upper - value
            taken = _quadratic(curvature, slope, matrix, to_bounds, forces, side)
            if taken is None:
                return None
            moved, forces, side = taken
            coefficients = coefficients + moved
        return None

    def _motions_of(self, transcription: Transcription) -> _Motions | None:
        """All motions; kept while the duration is the same."""
        duration = transcription.ocp.duration[0]
        if self._motions is None or self._motions.duration != duration:
            basis = transcription.motion_basis()
            self._motions = None if basis is None else _Motions(duration, basis)
        return self._motions

    def _curvature(
        self, x: np.ndarray, p: np.ndarray, multipliers: np.ndarray, motions: _Motions
    ) -> csr_matrix:
        """Of the Lagrangian by the coefficients (k, k)."""
        self._hessian(x, p, 1.0, multipliers)
        lower = self._hessian.sparse(0).T
        lower.data[_rows(lower) == lower.indices] /= 2.0
        half = motions.transposed @ (lower @ motions.basis)
        return half + half.T.tocsr()


class _Motions:
    """All motions that last as long: a basis with columns of unit length."""

    def __init__(self, duration: float, basis: csr_matrix) -> None:
        lengths = np.sqrt(np.asarray(basis.multiply(basis).sum(axis=0))).ravel()
        self.duration = duration
        self.basis = (basis @ diags(1.0 / lengths)).tocsr()
        # Kept by rows as well: products of what is kept alike need no conversion.
        self.transposed = self.basis.T.tocsr()
        self._normal = splu((self.transposed @ self.basis).tocsc())
        self._equations: tuple[csr_matrix, Any] | None = None

    def nearest(self, x: np.ndarray) -> np.ndarray:
        """Coefficients of the motion nearest to variables."""
        found: np.ndarray = self._normal.solve(self.transposed @ x)
        return found

    def with_equations(
        self, nlp: Nlp, slope: np.ndarray, jacobian: csr_matrix, multipliers: np.ndarray
    ) -> np.ndarray:
        """Multipliers of all rows, with those of the equations that splines stand in for."""
        own = nlp.structural
        if not own.any():
            return multipliers
        if self._equations is None:
            # Linear, or there were no splines: the same in every problem that lasts as long.
            equations = jacobian[own]
            self._equations = equations, splu((equations @ equations.T).tocsc())
        equations, factor = self._equations
        missing = equations @ (slope + jacobian.T @ multipliers)
        whole = multipliers.copy()
        whole[own] = -factor.solve(missing)
        return whole


class _Constraints:
    """Bounds of variables above rows, without equations that motions of splines obey anyway.

    A force on a constraint, its multiplier, is positive at the upper bound and negative at the
    lower; a side is 1, -1, 0 where it does not bind and 2 where both are one.
    """

    def __init__(self, nlp: Nlp, basis: csr_matrix) -> None:
        self.nlp, self._basis = nlp, basis
        self.bounds = np.flatnonzero(np.isfinite(nlp.lower_x) | np.isfinite(nlp.upper_x))
        self.rows = np.flatnonzero(~nlp.structural)
        self._of_bounds = basis[self.bounds]
        self.lower = np.append(nlp.lower_x[self.bounds], nlp.lower_g[self.rows])
        self.upper = np.append(nlp.upper_x[self.bounds], nlp.upper_g[self.rows])

    def values(self, x: np.ndarray, g: np.ndarray) -> np.ndarray:
        """Of all constraints (c,)."""
        return np.append(x[self.bounds], g[self.rows])

    def matrix(self, jacobian: csr_matrix) -> csr_matrix:
        """Their slopes by the coefficients (c, k)."""
        return vstack([self._of_bounds, jacobian[self.rows] @ self._basis], format="csr")

    def split(self, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Multipliers of all variables and all rows."""
        of_x, of_g = np.zeros(len(self.nlp.lower_x)), np.zeros(len(self.nlp.lower_g))
        of_x[self.bounds], of_g[self.rows] = np.split(forces, [len(self.bounds)])
        return of_x, of_g

    def binding(self, near: Multipliers, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forces (c,) of a near optimum and sides (c,), for values (c,) that it has here."""
        forces = np.append(near.multipliers_x[self.bounds], near.multipliers_g[self.rows])
        side = np.where(forces > _BINDS * np.maximum(self.upper - value, 0.0), 1, 0)
        side[forces < -_BINDS * np.maximum(value - self.lower, 0.0)] = -1
        side[self.lower == self.upper] = 2
        return np.where(side != 0, forces, 0.0), side


def _quadratic(
    curvature: csr_matrix,
    slope: np.ndarray,
    matrix: csr_matrix,
    to_bounds: tuple[np.ndarray, np.ndarray],
    forces: np.ndarray,
    side: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Step, forces and sides of min slope s + s curvature s / 2 with lower <= matrix s <= upper."""
    lower, upper = to_bounds
    lengths = np.bincount(_rows(matrix), matrix.data**2, len(side))
    steep = np.abs(curvature.data).max(initial=0.0)
    stiffness = _PENALTY * steep / np.maximum(lengths, 1e-300)
    width = _width(curvature, matrix)
    bands, held = _bands(curvature, width), np.zeros(len(side), dtype=bool)
    seen = {side.tobytes()}
    for _ in range(_EXCHANGES):
        bound = side != 0
        for sign, changed in ((1.0, bound & ~held), (-1.0, held & ~bound)):
            if changed.any():
                rows = matrix[changed]
                pulled = rows.T.tocsr()
                pulled.data *= stiffness[changed][pulled.indices]
                bands += sign * _bands(pulled @ rows, width)
        held = bound
        try:
            factor = cholesky_banded(bands, lower=True, check_finite=False), True
        except LinAlgError:
            return None
        rows, pull = matrix[bound], stiffness[bound]
        columns = rows.T
        missing = np.where(side > 0, upper, lower)[bound]
        step, own = np.zeros(len(slope)), forces[bound]
        # What is missed falls to a ten-thousandth each time.
        for _ in range(_ROUNDS):
            push = pull * missing
            unbalanced = slope + curvature @ step + columns @ (own - push)
            moved = cho_solve_banded(factor, -unbalanced, check_finite=False)
            step = step + moved
            along = rows @ moved
            own = own + pull * along - push
            missing = missing - along
        forces = np.zeros(len(side))
        forces[bound] = own
        value = matrix @ step
        now = side.copy()
        now[((side == 1) & (forces < 0.0)) | ((side == -1) & (forces > 0.0))] = 0
        now[~bound & (value > upper + _ENTERS)] = 1
        now[~bound & (value < lower - _ENTERS)] = -1
        changed = np.flatnonzero(now != side)
        if not changed.size:
            missed = np.abs(missing).max(initial=0.0)
            return (step, forces, side) if missed <= _KEPT else None
        if now.tobytes() in seen:
            # All together go round in circles: the one that is worst, alone.
            excess = np.maximum(value - upper, lower - value)
            wrong = np.where(bound, np.abs(forces) / stiffness, excess)
            worst = changed[np.argmax(wrong[changed])]
            now = np.where(np.arange(len(side)) == worst, now, side)
        seen.add(now.tobytes())
        side = now
    return None


def _rows(matrix: csr_matrix) -> np.ndarray:
    """Row of each entry."""
    return np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))


def _width(curvature: csr_matrix, matrix: csr_matrix) -> int:
    """Half the band of the curvature with a penalty on any rows."""
    filled = np.diff(matrix.indptr) > 0
    first, last = matrix.indptr[:-1][filled], matrix.indptr[1:][filled] - 1
    spans = matrix.indices[last] - matrix.indices[first]
    beside = np.abs(_rows(curvature) - curvature.indices).max(initial=0)
    return int(max(beside, spans.max(initial=0)))


def _bands(matrix: csr_matrix, width: int) -> np.ndarray:
    """Lower half of a symmetric matrix, diagonal by diagonal (width + 1, k)."""
    below = _rows(matrix) - matrix.indices
    lower = below >= 0
    bands = np.zeros((width + 1, matrix.shape[0]))
    bands[below[lower], matrix.indices[lower]] = matrix.data[lower]
    return bands


def _progress(nlp: Nlp, step: int, objective: float, g: np.ndarray, elapsed: float) -> Progress:
    return Progress(step, float(objective) * nlp.objective_scale, *nlp.worst_excess(g), elapsed)


def _solution(
    nlp: Nlp,
    x: np.ndarray,
    g: np.ndarray,
    lam_x: np.ndarray,
    lam_g: np.ndarray,
    history: list[Progress],
    seconds: float,
) -> RawSolution:
    last = history[-1]
    return RawSolution(
        status="optimal",
        reason="Newton steps on what binds at a near optimum",
        x=np.clip(x, nlp.lower_x, nlp.upper_x),
        g=g,
        objective=last.objective,
        violation=last.violation,
        worst_rows=[],
        conflicts=[],
        iteration=last.iteration,
        iterations=last.iteration,
        multipliers_x=lam_x,
        multipliers_g=lam_g,
        history=history,
        build_s=0.0,
        solve_s=seconds,
    )
