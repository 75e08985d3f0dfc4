"""Predict runs left out of a problem by peers: PROBLEM METHOD... -> squares that each leaves.

The answer is JSON.
"""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Callable

import numpy as np
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, WhiteKernel

warnings.filterwarnings("ignore")
# Rows, drawn at random, that the lengths of the Gaussian process are fitted to, and those that it
# predicts from: it takes their cube in time.
_MAX_LENGTH_ROWS, _MAX_PROCESS_ROWS = 600, 2000

Fit = Callable[[np.ndarray, np.ndarray], Callable[[np.ndarray], np.ndarray]]


def sparse(x: np.ndarray, y: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Sparse regression on products of two signals, thresholds chosen by the last third."""
    import pysindy

    library = pysindy.PolynomialLibrary(degree=2, include_bias=True)
    whole = np.asarray(library.fit_transform(x))
    size = whole.std(axis=0) + 1e-12
    cut = 2 * len(y) // 3
    best: tuple[float, float] | None = None
    for threshold in (0.03, 0.1, 0.3, 1.0, 3.0):
        weights = _weights(whole[:cut] / size, y[:cut], threshold)
        left = float(np.sum((y[cut:] - whole[cut:] / size @ weights) ** 2))
        best = min(best or (left, threshold), (left, threshold))
    weights = _weights(whole / size, y, best[1])
    return lambda new: np.asarray(library.transform(new)) / size @ weights


def _weights(columns: np.ndarray, y: np.ndarray, threshold: float) -> np.ndarray:
    import pysindy

    try:
        solver = pysindy.STLSQ(threshold=threshold, alpha=1e-3, max_iter=20)
        return np.ravel(solver.fit(columns, y[:, None]).coef_)
    except ValueError:  # no term is left
        return np.zeros(columns.shape[1])


def symbolic(x: np.ndarray, y: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Symbolic regression with the functions of the tool's grammar that it has."""
    from gplearn.genetic import SymbolicRegressor

    model = SymbolicRegressor(
        population_size=500,
        generations=15,
        function_set=("add", "sub", "mul", "div", "sin", "cos", "abs", "max", "min"),
        parsimony_coefficient=0.01,
        random_state=0,
    )
    return model.fit(x, y).predict


def process(x: np.ndarray, y: np.ndarray) -> Fit:
    """Gaussian process with one length for each signal, fitted once to all runs: as a bound."""
    some = np.random.default_rng(0).permutation(len(y))
    few = some[:_MAX_LENGTH_ROWS]
    start = float(y.var()) * RBF(np.full(x.shape[1], 3.0), (0.3, 1e3)) + WhiteKernel(1.0)
    kernel = GaussianProcessRegressor(start).fit(x[few], y[few]).kernel_

    def fit(x: np.ndarray, y: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        some = np.random.default_rng(0).permutation(len(y))[:_MAX_PROCESS_ROWS]
        return GaussianProcessRegressor(kernel, optimizer=None).fit(x[some], y[some]).predict

    return fit


# By title, given all rows.
METHODS: dict[str, Callable[[np.ndarray, np.ndarray], Fit]] = {
    "pysindy": lambda x, y: sparse,
    "gplearn": lambda x, y: symbolic,
    "gaussian process": process,
}


def main() -> None:
    """Write the squares that every method leaves in runs left out."""
    with np.load(sys.argv[1]) as problem:
        x, y, run, names = (problem[key] for key in ("x", "y", "run", "names"))
    # Directions of motion are steps: they are given to every method as the tool has them.
    x = (x - x.mean(axis=0)) / (x.std(axis=0) + 1e-12)
    assert x.shape[1] == len(names)
    left = {}
    for title in sys.argv[2:]:
        fit, left[title] = METHODS[title](x, y), 0.0
        for own in np.unique(run):
            predict = fit(x[run != own], y[run != own])
            left[title] += float(np.sum((y[run == own] - predict(x[run == own])) ** 2))
    print(json.dumps(left))


if __name__ == "__main__":
    main()
