"""pysindy: sparse regression of each joint's torque beside the nominal model.

Libraries: a constant; of every joint sine and cosine of the angle, speed and its sign, acceleration
and nominal torque; in the larger one the products of the joint's own six too. STLSQ; library,
threshold and ridge are chosen by stretches of the training samples left out, and fitted anew to
all. What hardly varies in training is left out.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import pysindy as ps
from given import Given, Samples, answer

SIGN, MOST, STILL, STRETCHES = 0.01, 4000, 0.02, 4
THRESHOLDS, RIDGES = (0.003, 0.01, 0.03, 0.1), (1e-3, 1.0, 100.0)


def features(samples: Samples, band: int) -> np.ndarray:
    """Six of each joint (K, 6 n)."""
    q, v, a = samples.q[band], samples.v[band], samples.a[band]
    return np.column_stack((np.sin(q), np.cos(q), v, np.tanh(v / SIGN), a, samples.nominal))


def joint_torque(given: Given, j: int) -> tuple[np.ndarray, int]:
    """Torque of one joint in the test samples beyond the nominal one, and its number of terms."""
    used = np.flatnonzero(given.moving(j))
    if len(used) < 10:
        return np.zeros(len(given.test.nominal)), 0
    used = used[np.linspace(0, len(used) - 1, min(MOST, len(used))).astype(int)]
    x, wanted = (features(s, given.band_of[j]) for s in (given.train, given.test))
    x = x[used]
    middle, spread = x.mean(axis=0), x.std(axis=0)
    kept = np.flatnonzero(spread > STILL * np.abs(x).max(axis=0))
    own = [k for k, column in enumerate(kept) if column % len(given.joints) == j]
    others = np.delete(np.arange(len(kept)), own)
    left = (given.train.torque - given.train.nominal)[used, j]
    size = max(float(left.std()), 1e-9)
    y, stretch = left / size, np.arange(len(used)) * STRETCHES // len(used)
    best: tuple[float, int, np.ndarray] | None = None
    for degree in (1, 2):
        library = ps.PolynomialLibrary(degree=degree)
        columns = []
        for values in (x, wanted):
            scaled = ((values - middle) / np.where(spread > 0, spread, 1.0))[:, kept]
            products = np.asarray(library.fit_transform(scaled[:, own]))
            columns.append(np.column_stack([products, scaled[:, others]]))
        for threshold, ridge in product(THRESHOLDS, RIDGES):
            error = 0.0
            for k in range(STRETCHES):
                out = stretch == k
                law = coefficients(columns[0][~out], y[~out], threshold, ridge)
                error += float(np.sum((columns[0][out] @ law - y[out]) ** 2))
            if best is None or error < best[0]:
                law = coefficients(columns[0], y, threshold, ridge)
                best = error, int(np.count_nonzero(law)), columns[1] @ law
    assert best is not None
    return size * best[2], best[1]


def coefficients(x: np.ndarray, y: np.ndarray, threshold: float, ridge: float) -> np.ndarray:
    """STLSQ's."""
    try:
        law = ps.STLSQ(threshold=threshold, alpha=ridge).fit(x, y[:, None])
    except ValueError:
        # It refuses to end with no term at all.
        return np.zeros(x.shape[1])
    return np.ravel(law.coef_)


def predict(given: Given) -> tuple[np.ndarray, str]:
    """All joints."""
    found = [joint_torque(given, j) for j in range(len(given.joints))]
    torque = given.test.nominal + np.column_stack([each[0] for each in found])
    return torque, f"{sum(each[1] for each in found)} terms"


if __name__ == "__main__":
    answer(predict)
