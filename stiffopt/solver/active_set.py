"""Active-set warm start: Newton's method from the active set of a nearby optimum.

An interior-point method starts inside the bounds and has to converge back to them. Here the active
set of the nearby programme is the first estimate. Each step is a quadratic programme, solved by
dropping constraints with a multiplier of the wrong sign and adding violated ones. With spline
coefficients in place of states and controls no equations remain, and all matrices are banded.

A result is accepted only as a local minimum, where the curvature with a penalty on the active set
is positive definite, and to the tolerance of the IPOPT solver. Otherwise there is none.

Source: Hintermueller, Ito, Kunisch (2002), "The primal-dual active set strategy as a semismooth
Newton method".
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy

from stiffopt.solver.ipopt import IpoptSolver, Multipliers, RawSolution
from stiffopt.solver.monitor import Progress
from stiffopt.symbolic import BufferedFunction
from stiffopt.transcription.nlp import Nlp
from stiffopt.transcription.transcription import Transcription

# Newton steps, and changes of the active set in each, after which the search is given up.
_MAX_NEWTON_STEPS, _MAX_ACTIVE_SET_CHANGES = 8, 40
# A constraint is active initially where its multiplier exceeds this share of its slack; excess from
# which on an inactive one is added.
_ACTIVE_MULTIPLIER_SHARE, _ENTERING_EXCESS = 1e-4, 1e-10
# Residual allowed in active constraints that are linearly dependent.
_MAX_DEPENDENT_MISS = 1e-6
# Penalty on active constraints relative to the objective's curvature, and rounds of multiplier
# updates: each reduces their residual to 1e-4.
_PENALTY_FACTOR, _MULTIPLIER_ROUNDS = 1e4, 3


class ActiveSetSolver:
    """Solver of programmes that differ in numbers, each from a nearby optimum."""

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
        """Return the optimum, None where it is not found: the programme may have one still.

        `transcription` is of the solver's programme, with its own bounds and numbers; `x0`, scaled,
        and `near` are of the nearby optimum.
        """
        begin = time.perf_counter()
        motions = self._select_motions(transcription)
        if motions is None or not np.isfinite(x0).all():
            return None
        basis = motions.basis
        nlp = transcription.nlp
        p = nlp.parameters(parameters)
        constraints = _Constraints(nlp, basis)
        coefficients = motions.nearest(x0)
        history: list[Progress] = []
        forces, side = np.zeros(0), np.zeros(0)
        for step in range(_MAX_NEWTON_STEPS):
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
            history.append(
                Progress(
                    step, float(objective[0]), *nlp.worst_excess(g), time.perf_counter() - begin
                )
            )
            if report is not None:
                report(history[-1])
            if step and max(stationary, violation) <= self._tolerance:
                lam_x, lam_g = constraints.split(forces)
                lam_g = motions.complete_multipliers(nlp, gradient + lam_x, jacobian, lam_g)
                seconds = time.perf_counter() - begin
                return _raw_solution(nlp, x, g, lam_x, lam_g, history, seconds)
            curvature = self._lagrangian_curvature(x, p, constraints.split(forces)[1], motions)
            to_bounds = constraints.lower - value, constraints.upper - value
            taken = _solve_quadratic_programme(curvature, slope, matrix, to_bounds, forces, side)
            if taken is None:
                return None
            moved, forces, side = taken
            coefficients = coefficients + moved
        return None

    def _select_motions(self, transcription: Transcription) -> _Motions | None:
        """Return the basis of motions, cached while the duration is the same."""
        duration = transcription.ocp.duration[0]
        if self._motions is None or self._motions.duration != duration:
            basis = transcription.motion_basis()
            self._motions = None if basis is None else _Motions(duration, basis)
        return self._motions

    def _lagrangian_curvature(
        self, x: np.ndarray, p: np.ndarray, multipliers: np.ndarray, motions: _Motions
    ) -> scipy.sparse.csr_matrix:
        """Return the Lagrangian's curvature in the coefficients (k, k)."""
        self._hessian(x, p, 1.0, multipliers)
        lower = self._hessian.sparse(0).T
        lower.data[_entry_rows(lower) == lower.indices] /= 2.0
        half = motions.transposed @ (lower @ motions.basis)
        return half + half.T.tocsr()


class _Motions:
    """Basis, with columns of unit length, of all motions of one duration."""

    def __init__(self, duration: float, basis: scipy.sparse.csr_matrix) -> None:
        lengths = np.sqrt(np.asarray(basis.multiply(basis).sum(axis=0))).ravel()
        self.duration = duration
        self.basis = (basis @ scipy.sparse.diags(1.0 / lengths)).tocsr()
        # Stored by rows as well: products of matrices in one format need no conversion.
        self.transposed = self.basis.T.tocsr()
        self._normal_factor = scipy.sparse.linalg.splu((self.transposed @ self.basis).tocsc())
        self._equations: tuple[scipy.sparse.csr_matrix, Any] | None = None

    def nearest(self, x: np.ndarray) -> np.ndarray:
        """Return the coefficients of the motion nearest to variables."""
        found: np.ndarray = self._normal_factor.solve(self.transposed @ x)
        return found

    def complete_multipliers(
        self,
        nlp: Nlp,
        slope: np.ndarray,
        jacobian: scipy.sparse.csr_matrix,
        multipliers: np.ndarray,
    ) -> np.ndarray:
        """Return multipliers of all rows, with those of the equations that splines eliminate."""
        own = nlp.structural
        if not own.any():
            return multipliers
        if self._equations is None:
            # Linear equations: the same in every problem of this duration.
            equations = jacobian[own]
            self._equations = equations, scipy.sparse.linalg.splu((equations @ equations.T).tocsc())
        equations, factor = self._equations
        missing = equations @ (slope + jacobian.T @ multipliers)
        whole = multipliers.copy()
        whole[own] = -factor.solve(missing)
        return whole


class _Constraints:
    """Bounds of variables, then rows, without the equations that spline motions satisfy.

    A force on a constraint, its multiplier, is positive at the upper bound and negative at the
    lower. Sides are 1 (upper active), -1 (lower active), 0 (inactive) and 2 (equality).
    """

    def __init__(self, nlp: Nlp, basis: scipy.sparse.csr_matrix) -> None:
        self.nlp, self._basis = nlp, basis
        self.bounds = np.flatnonzero(np.isfinite(nlp.lower_x) | np.isfinite(nlp.upper_x))
        self.rows = np.flatnonzero(~nlp.structural)
        self._bound_basis = basis[self.bounds]
        self.lower = np.append(nlp.lower_x[self.bounds], nlp.lower_g[self.rows])
        self.upper = np.append(nlp.upper_x[self.bounds], nlp.upper_g[self.rows])

    def values(self, x: np.ndarray, g: np.ndarray) -> np.ndarray:
        """Return the values of all constraints (c,)."""
        return np.append(x[self.bounds], g[self.rows])

    def matrix(self, jacobian: scipy.sparse.csr_matrix) -> scipy.sparse.csr_matrix:
        """Return the constraints' Jacobian in the coefficients (c, k)."""
        return scipy.sparse.vstack(
            [self._bound_basis, jacobian[self.rows] @ self._basis], format="csr"
        )

    def split(self, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the multipliers of all variables and of all rows."""
        of_x, of_g = np.zeros(len(self.nlp.lower_x)), np.zeros(len(self.nlp.lower_g))
        of_x[self.bounds], of_g[self.rows] = np.split(forces, [len(self.bounds)])
        return of_x, of_g

    def binding(self, near: Multipliers, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the initial forces (c,) and sides (c,) from a nearby optimum's multipliers."""
        forces = np.append(near.multipliers_x[self.bounds], near.multipliers_g[self.rows])
        side = np.where(
            forces > _ACTIVE_MULTIPLIER_SHARE * np.maximum(self.upper - value, 0.0), 1, 0
        )
        side[forces < -_ACTIVE_MULTIPLIER_SHARE * np.maximum(value - self.lower, 0.0)] = -1
        side[self.lower == self.upper] = 2
        return np.where(side != 0, forces, 0.0), side


def _solve_quadratic_programme(
    curvature: scipy.sparse.csr_matrix,
    slope: np.ndarray,
    matrix: scipy.sparse.csr_matrix,
    to_bounds: tuple[np.ndarray, np.ndarray],
    forces: np.ndarray,
    side: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Solve min slope s + s curvature s / 2 with lower <= matrix s <= upper.

    Returns step, forces and sides; None where the curvature is not positive definite or the active
    set does not converge.
    """
    lower, upper = to_bounds
    lengths = np.bincount(_entry_rows(matrix), matrix.data**2, len(side))
    steep = np.abs(curvature.data).max(initial=0.0)
    stiffness = _PENALTY_FACTOR * steep / np.maximum(lengths, 1e-300)
    width = _half_bandwidth(curvature, matrix)
    bands, held = _lower_bands(curvature, width), np.zeros(len(side), dtype=bool)
    seen = {side.tobytes()}
    for _ in range(_MAX_ACTIVE_SET_CHANGES):
        bound = side != 0
        for sign, changed in ((1.0, bound & ~held), (-1.0, held & ~bound)):
            if changed.any():
                rows = matrix[changed]
                pulled = rows.T.tocsr()
                pulled.data *= stiffness[changed][pulled.indices]
                bands += sign * _lower_bands(pulled @ rows, width)
        held = bound
        try:
            factor = scipy.linalg.cholesky_banded(bands, lower=True, check_finite=False), True
        except scipy.linalg.LinAlgError:
            return None
        rows, pull = matrix[bound], stiffness[bound]
        columns = rows.T
        missing = np.where(side > 0, upper, lower)[bound]
        step, own = np.zeros(len(slope)), forces[bound]
        # Each round reduces the residual of active constraints to 1e-4.
        for _ in range(_MULTIPLIER_ROUNDS):
            push = pull * missing
            unbalanced = slope + curvature @ step + columns @ (own - push)
            moved = scipy.linalg.cho_solve_banded(factor, -unbalanced, check_finite=False)
            step = step + moved
            along = rows @ moved
            own = own + pull * along - push
            missing = missing - along
        forces = np.zeros(len(side))
        forces[bound] = own
        value = matrix @ step
        now = side.copy()
        now[((side == 1) & (forces < 0.0)) | ((side == -1) & (forces > 0.0))] = 0
        now[~bound & (value > upper + _ENTERING_EXCESS)] = 1
        now[~bound & (value < lower - _ENTERING_EXCESS)] = -1
        changed = np.flatnonzero(now != side)
        if not changed.size:
            missed = np.abs(missing).max(initial=0.0)
            return (step, forces, side) if missed <= _MAX_DEPENDENT_MISS else None
        if now.tobytes() in seen:
            # The active set cycles: change the worst constraint only.
            excess = np.maximum(value - upper, lower - value)
            wrong = np.where(bound, np.abs(forces) / stiffness, excess)
            worst = changed[np.argmax(wrong[changed])]
            now = np.where(np.arange(len(side)) == worst, now, side)
        seen.add(now.tobytes())
        side = now
    return None


def _entry_rows(matrix: scipy.sparse.csr_matrix) -> np.ndarray:
    """Return the row of each entry."""
    return np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))


def _half_bandwidth(curvature: scipy.sparse.csr_matrix, matrix: scipy.sparse.csr_matrix) -> int:
    """Return the half bandwidth of the curvature with a penalty on any rows."""
    filled = np.diff(matrix.indptr) > 0
    first, last = matrix.indptr[:-1][filled], matrix.indptr[1:][filled] - 1
    spans = matrix.indices[last] - matrix.indices[first]
    beside = np.abs(_entry_rows(curvature) - curvature.indices).max(initial=0)
    return int(max(beside, spans.max(initial=0)))


def _lower_bands(matrix: scipy.sparse.csr_matrix, width: int) -> np.ndarray:
    """Return the lower half of a symmetric matrix, diagonal by diagonal (width + 1, k)."""
    below = _entry_rows(matrix) - matrix.indices
    lower = below >= 0
    bands = np.zeros((width + 1, matrix.shape[0]))
    bands[below[lower], matrix.indices[lower]] = matrix.data[lower]
    return bands


def _raw_solution(
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
        reason="active-set Newton steps from a nearby optimum",
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
