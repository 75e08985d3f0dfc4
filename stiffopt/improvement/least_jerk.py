"""Motion through sampled rows: the jerk of least square between them that keeps its limit.

Position, velocity and acceleration at both ends of an interval fix three moments of its jerk. The
jerk of least square with these moments is of degree 2, the motion of degree 5: it overshoots where
the sampled motion's jerk jumps within the interval. The one of least square within a limit is a
polynomial of degree 2 that is cut off at the limit; its coefficients follow from the moments.
"""

from __future__ import annotations

import numpy as np

from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.result.trajectory import Trajectory

# Legendre's polynomials up to degree 2, by powers of the share of the interval that is left.
_LEGENDRE_POLYNOMIALS = np.array([[1.0, 0.0, 0.0], [-1.0, 2.0, 0.0], [1.0, -6.0, 6.0]])
_GAUSS_POINTS, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(3)  # exact to degree 5
# Newton steps and halvings of each, and the error of the moments over the limit at which they end.
_MAX_STEPS, _MAX_HALVINGS, _MOMENT_ERROR = 40, 12, 1e-9
# Condition of a step from which on no polynomial has the moments, and rounding of roots and of the
# shares at which pieces begin.
_MAX_CONDITION, _ROOT_ERROR, _SHARE_DIGITS = 1e12, 1e-8, 8
# Used share of the certificate's tolerance: a jerk that jumps from limit to limit is the only one
# with its moments, and the polynomial infinitely steep.
_USED_TOLERANCE = 0.5 * CERTIFICATE_TOLERANCE


def least_jerk_motion(time: np.ndarray, rows: np.ndarray, limit: np.ndarray) -> Trajectory:
    """Return the motion through rows (K, 3, n) of position, velocity and acceleration.

    `limit` (n,): of the jerk. Where no motion between two rows keeps it, theirs is of degree 5.
    """
    step = np.diff(time)[:, None]
    q, v, a = rows.swapaxes(0, 1)
    mean = np.diff(a, axis=0) / step
    first = (np.diff(v, axis=0) / step - a[:-1]) / step
    second = ((np.diff(q, axis=0) / step - v[:-1]) / step - 0.5 * a[:-1]) / step
    moments = np.stack([mean, 2.0 * first - mean, 12.0 * second - 6.0 * first + mean], axis=1)
    # Coefficients of powers of the share of the interval that is left, (K, 3, n).
    jerk = np.einsum("i,ij,kin->kjn", [1.0, 3.0, 5.0], _LEGENDRE_POLYNOMIALS, moments)
    allowed = (1.0 + _USED_TOLERANCE) * limit
    left = [np.array([1.0]) for _ in step]  # at which pieces begin
    cut = np.zeros((len(step), len(limit)), dtype=bool)
    samples = np.einsum("si,kin->skn", _powers(np.linspace(0.0, 1.0, 9)), jerk)
    for k, j in np.argwhere((np.abs(samples) > allowed).any(axis=0)):
        found = _cut_off(moments[k, :, j] / allowed[j])
        if found is not None:
            powers = _LEGENDRE_POLYNOMIALS.T @ found
            cut[k, j], jerk[k, :, j] = True, powers * allowed[j]
            # Joints that cross at the same instant, but for rounding, share a piece.
            left[k] = np.union1d(left[k], np.round(_crossings(powers), _SHARE_DIGITS))
    own = np.repeat(np.arange(len(step)), [len(each) for each in left])
    begin = np.concatenate([each[::-1] for each in left])
    end = np.where(np.diff(own, append=-1) == 0, np.append(begin[1:], 0.0), 0.0)
    middle = np.einsum("ki,kin->kn", _powers(0.5 * (begin + end)), jerk[own])
    beyond = cut[own] & (np.abs(middle) > allowed)
    c0, c1, c2 = jerk[own].swapaxes(0, 1)
    w, h = begin[:, None], step[own]
    rates = np.stack(
        [
            np.where(beyond, np.clip(middle, -allowed, allowed), c0 + (c1 + c2 * w) * w),
            np.where(beyond, 0.0, -(c1 + 2.0 * c2 * w) / (2.0 * h)),
            np.where(beyond, 0.0, c2 / (3.0 * h**2)),
        ],
        axis=1,
    )
    lasted = h * (w - end[:, None])
    gained = np.einsum("kin,ki->kn", rates, lasted ** np.arange(1, 4))
    before = np.cumsum(gained, axis=0) - gained
    within = before - before[np.searchsorted(own, own)]
    coefficients = np.concatenate([(a[own] + within)[:, None], rates], axis=1)
    starts = time[own] + h[:, 0] * (1.0 - begin)
    return Trajectory(np.append(starts, time[-1]), coefficients, q[0], v[0])


def _powers(share: np.ndarray) -> np.ndarray:
    return share[:, None] ** np.arange(3)


def _crossings(polynomial: np.ndarray) -> np.ndarray:
    """Return the shares in (0, 1) at which a polynomial is 1 or -1."""
    roots = np.concatenate([np.roots((polynomial - [level, 0.0, 0.0])[::-1]) for level in (1, -1)])
    real = roots[np.abs(roots.imag) < _ROOT_ERROR].real
    return np.asarray(real[(real > _ROOT_ERROR) & (real < 1.0 - _ROOT_ERROR)])


def _cut_off(moments: np.ndarray) -> np.ndarray | None:
    """Return Legendre coefficients (3,) of which the polynomial, cut off at 1, has moments (3,).

    Newton's method on the gradient of a convex function; None where no jerk up to 1 has them.
    """
    found = moments * [1.0, 3.0, 5.0]
    missed, slope = _moments(found)
    for _ in range(_MAX_STEPS):
        error = np.abs(missed - moments).max()
        if error <= _MOMENT_ERROR:
            return found
        if np.linalg.cond(slope) > _MAX_CONDITION:
            return None
        move, share = np.linalg.solve(slope, missed - moments), 1.0
        for _ in range(_MAX_HALVINGS):
            tried, tried_slope = _moments(found - share * move)
            if np.abs(tried - moments).max() < error:
                break
            share *= 0.5
        found, missed, slope = found - share * move, tried, tried_slope
    return None


def _moments(coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return moments (3,) of the polynomial that is cut off at 1, and their slopes (3, 3)."""
    own = _LEGENDRE_POLYNOMIALS.T @ coefficients
    edges = np.concatenate([[0.0], np.sort(_crossings(own)), [1.0]])
    width = np.diff(edges)[:, None]
    share = (edges[:-1, None] + 0.5 * width * (1.0 + _GAUSS_POINTS)).ravel()
    weight = (0.5 * width * _GAUSS_WEIGHTS).ravel()
    basis = _powers(share) @ _LEGENDRE_POLYNOMIALS.T
    value = basis @ coefficients
    inside = weight * (np.abs(value) < 1.0)
    return (weight * np.clip(value, -1.0, 1.0)) @ basis, (inside[:, None] * basis).T @ basis
