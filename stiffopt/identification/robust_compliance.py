"""Non-negative compliances by robust regression of displacements.

A pose is the unit of measurement: its three components share one weight, and cross-validation
leaves out whole poses.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

# Residual from which Huber's weights decrease [standard deviations of one component].
HUBER_THRESHOLD = 2.5
# Root of the median of a chi-squared variable with three degrees of freedom.
_MEDIAN_CHI_3 = 1.5382
# Iterations of reweighted least squares; some ten are usual.
_MAX_REWEIGHTING_STEPS = 60


@dataclass(frozen=True, kw_only=True, eq=False)
class RobustFit:
    """Compliances fitted to displacements."""

    value: np.ndarray  # (p,) one per column, not negative
    weight: np.ndarray  # (m,) huber weight of each pose, 1 at most
    residual: np.ndarray  # (m, 3) measured less fitted [m]
    scale: float  # robust standard deviation of one component [m]


def fit(
    columns: np.ndarray,
    displacement: np.ndarray,
    *,
    robust: bool = True,
    start: RobustFit | None = None,
) -> RobustFit:
    """Non-negative least squares with Huber's weights by pose.

    `columns` (m, 3, p) give the displacement for a value of one [m], `displacement` (m, 3) is [m];
    `start` has initial values. Without `robust` it is plain least squares, all weights one. Huber,
    P. J.: Robust Estimation of a Location Parameter (1964); reweighted least squares.
    """
    size = np.sqrt(np.mean(np.square(columns), axis=(0, 1)))
    size[size == 0.0] = 1.0
    scaled = columns / size
    value = _solve_weighted(scaled, displacement) if start is None else start.value * size
    weight = np.ones(len(displacement))
    residual = displacement - scaled @ value
    scale = _residual_scale(residual, int(np.count_nonzero(value)))
    # Residuals below this are rounding: data without error need no weights.
    exact = 1e-9 * float(np.max(np.abs(displacement), initial=0.0))
    for _ in range(_MAX_REWEIGHTING_STEPS if robust else 0):
        if scale <= exact:
            break
        norm = np.linalg.norm(residual, axis=1)
        weight = np.minimum(1.0, HUBER_THRESHOLD * scale / np.maximum(norm, exact))
        root = np.sqrt(weight)[:, None]
        before, value = value, _solve_weighted(scaled * root[..., None], displacement * root)
        residual = displacement - scaled @ value
        scale = _residual_scale(residual, int(np.count_nonzero(value)))
        # Far below any standard deviation of the values.
        if np.max(np.abs(value - before)) <= 1e-5 * np.max(value, initial=1e-300):
            break
    return RobustFit(value=value / size, weight=weight, residual=residual, scale=scale)


def loss(error: np.ndarray, scale: float) -> np.ndarray:
    """Huber's loss of every pose in units of its scale: (m, 3) -> (m,).

    Half the square up to `HUBER_THRESHOLD` standard deviations, linear beyond.
    """
    u = np.linalg.norm(error, axis=-1) / scale
    return np.asarray(
        np.where(u <= HUBER_THRESHOLD, 0.5 * u**2, HUBER_THRESHOLD * (u - 0.5 * HUBER_THRESHOLD))
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class CrossValidation:
    """Fit of columns (m, 3, p) to displacements (m, 3), and fits that leave out one pose each."""

    columns: np.ndarray
    displacement: np.ndarray
    whole: RobustFit
    folds: tuple[RobustFit, ...]

    @cached_property
    def values(self) -> np.ndarray:
        """Values (m, p) without each pose."""
        return np.array([fold.value for fold in self.folds])

    @cached_property
    def predicted(self) -> np.ndarray:
        """Displacements (m, 3) of the poses left out [m]."""
        return np.asarray(np.einsum("kip,kp->ki", self.columns, self.values))

    @property
    def error(self) -> np.ndarray:
        """Errors (m, 3) of the poses left out [m]."""
        return np.asarray(self.displacement - self.predicted)


def cross_validate(
    columns: np.ndarray, displacement: np.ndarray, *, robust: bool = True
) -> CrossValidation:
    """Fit to all poses, and without each; parameters as of `fit`."""
    whole = fit(columns, displacement, robust=robust)
    start = whole if robust else None
    folds = tuple(
        fit(columns[k], displacement[k], robust=robust, start=start)
        for k in ~np.eye(len(displacement), dtype=bool)
    )
    return CrossValidation(columns=columns, displacement=displacement, whole=whole, folds=folds)


def rms(error: np.ndarray) -> float:
    """Root mean square of all components."""
    return float(np.sqrt(np.mean(np.square(error))))


def model_covariance(columns: np.ndarray, fitted: RobustFit) -> np.ndarray:
    """Covariance of the values if all errors are alike and independent, (p, p).

    All columns count as free, also those at the bound zero, which carries no information.
    """
    p = columns.shape[2]
    weight = fitted.weight[:, None, None]
    information = np.einsum("kia,kib->ab", columns * weight, columns)
    size = np.sqrt(np.diag(information))
    inverse = np.linalg.inv(information / np.outer(size, size)) / np.outer(size, size)
    freedom = max(3.0 * float(np.sum(fitted.weight)) - p, 1.0)
    variance = float(np.sum(fitted.weight * np.sum(fitted.residual**2, axis=1))) / freedom
    return np.asarray(variance * inverse)


def jackknife_deviation(values: np.ndarray) -> np.ndarray:
    """Standard deviation from fits that leave out one pose each: (m, p) -> (p,).

    Valid also for errors that differ between poses or are correlated within one.
    """
    m = len(values)
    return np.asarray(np.sqrt((m - 1) * np.var(values, axis=0)))


def bootstrap(
    columns: np.ndarray, displacement: np.ndarray, fitted: RobustFit, draws: int, seed: int
) -> np.ndarray:
    """Values fitted to poses drawn with replacement, (draws, p)."""
    random = np.random.default_rng(seed)
    m = len(displacement)
    chosen = random.integers(0, m, size=(draws, m))
    return np.array([fit(columns[i], displacement[i], start=fitted).value for i in chosen])


def bootstrap_interval(drawn: np.ndarray, poses: int, confidence: float) -> tuple[float, float]:
    """Confidence interval of the true value from bootstrap values (draws,).

    Hesterberg, T. C.: What Teachers Should Know About the Bootstrap, The American Statistician
    (2015): plain percentiles of few poses are too narrow, like a normal interval with divisor m in
    place of Student's with m - 1; the levels are widened accordingly. Rank r of B draws has the
    level r / (B + 1), so that few draws do not narrow the interval.
    """
    from scipy.stats import norm, t

    reach = t.ppf(0.5 + 0.5 * confidence, poses - 1) * np.sqrt(poses / (poses - 1))
    level = float(norm.cdf(-reach))
    lower, upper = np.quantile(drawn, [level, 1.0 - level], method="weibull")
    return float(lower), float(upper)


def _solve_weighted(columns: np.ndarray, displacement: np.ndarray) -> np.ndarray:
    from scipy.optimize import nnls

    return np.asarray(nnls(columns.reshape(-1, columns.shape[2]), displacement.ravel())[0])


def _residual_scale(residual: np.ndarray, fitted: int) -> float:
    rows = residual.size
    middle = float(np.median(np.linalg.norm(residual, axis=1))) / _MEDIAN_CHI_3
    return middle * float(np.sqrt(rows / max(rows - fitted, 1)))
