"""Rivals of the tool: what a good engineer would fit to the torque that the nominal model leaves.

Each takes motions with their residual torque and gives predictions of the residual; each joint has
a model of its own, fitted to moving samples of the training runs.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from benchmarks.blind.nominal import SIGN_SPEED, Motion
from stiffopt.recording.nominal import Nominal

SPARSE_WORKER = Path(__file__).with_name("sparse_worker.py")
# Library of the sparse rival, in the order of its columns.
LIBRARY = (
    "1", "sg(w)", "w", "|w| w", "sg(w) exp(-(w/0.1)^2)", "a", "rigid", "|rigid| sg(w)",
    "d rigid/dt", "tanh(rigid/rated)", "q", "q^3", "q sg(w)", "q^2 sg(w)", "sin q", "cos q",
    "sin N q", "cos N q", "sin 2 N q", "cos 2 N q", "sin p N q", "cos p N q", "sin 6 p N q",
    "cos 6 p N q", "t_s w", "t_s sg(w)", "t_s", "w of the joint before", "w of the joint after",
    "a of the joint before", "a of the joint after", "rigid of the joint before",
    "rigid of the joint after",
)  # fmt: skip


class Rival(Protocol):
    """A model of the residual torque of every joint."""

    def fit(self, runs: Sequence[Motion]) -> None: ...

    def predict(self, run: Motion) -> np.ndarray: ...


def _stacked(runs: Sequence[Motion], joint: int, columns: list[np.ndarray], every: int) -> tuple:
    """Columns and residuals of moving samples, every so many."""
    x, y = [], []
    for run, own in zip(runs, columns, strict=True):
        left = run.measured[:, joint] - run.torque[:, joint]
        used = np.flatnonzero(run.moving[:, joint] & np.isfinite(left))[::every]
        x.append(own[used])
        y.append(left[used])
    return np.vstack(x), np.concatenate(y)


class Friction:
    """Coulomb and viscous friction and an offset by least squares."""

    def __init__(self) -> None:
        self._weights: list[np.ndarray] = []

    def fit(self, runs: Sequence[Motion]) -> None:
        self._weights = []
        for j in range(runs[0].torque.shape[1]):
            x, y = _stacked(runs, j, [self._columns(run, j) for run in runs], 1)
            self._weights.append(np.linalg.lstsq(x, y, rcond=None)[0])

    def predict(self, run: Motion) -> np.ndarray:
        return np.column_stack([self._columns(run, j) @ w for j, w in enumerate(self._weights)])

    @staticmethod
    def _columns(run: Motion, j: int) -> np.ndarray:
        w = run.velocity[:, j]
        return np.column_stack([np.tanh(w / SIGN_SPEED), w, np.ones_like(w)])


class Sparse:
    """Sequentially thresholded least squares on `LIBRARY`.

    Parameters
    ----------
    nominal : Nominal
    threshold : float
        Terms that give less than this share of the residual's rms are dropped.
    ridge : float
        On columns of unit rms.
    python : Path, optional
        Interpreter that has pysindy; without it the same algorithm by NumPy.
    """

    def __init__(
        self, nominal: Nominal, *, threshold: float, ridge: float, python: Path | None = None
    ) -> None:
        self._nominal, self._threshold, self._ridge = nominal, threshold, ridge
        self._python = python
        self._weights: list[np.ndarray] = []

    def fit(self, runs: Sequence[Motion]) -> None:
        problems, scales = [], []
        for j in range(runs[0].torque.shape[1]):
            x, y = _stacked(runs, j, [self._columns(run, j) for run in runs], 2)
            scale, size = np.sqrt(np.mean(x**2, axis=0)) + 1e-12, float(np.std(y))
            problems.append((x / scale, y / size))
            scales.append(size / scale)
        solve = self._numpy if self._python is None else self._pysindy
        self._weights = [w * s for w, s in zip(solve(problems), scales, strict=True)]

    def predict(self, run: Motion) -> np.ndarray:
        return np.column_stack([self._columns(run, j) @ w for j, w in enumerate(self._weights)])

    @property
    def terms(self) -> int:
        """Terms kept, of all joints."""
        return int(sum(np.count_nonzero(w) for w in self._weights))

    def _numpy(self, problems: list[tuple[np.ndarray, np.ndarray]]) -> list[np.ndarray]:
        return [stlsq(x, y, self._threshold, self._ridge) for x, y in problems]

    def _pysindy(self, problems: list[tuple[np.ndarray, np.ndarray]]) -> list[np.ndarray]:
        with tempfile.TemporaryDirectory() as folder:
            for j, (x, y) in enumerate(problems):
                np.savez(Path(folder) / f"problem_{j}.npz", x=x, y=y)
            settings = {"threshold": self._threshold, "ridge": self._ridge * len(problems[0][0])}
            subprocess.run(
                [str(self._python), str(SPARSE_WORKER), folder, json.dumps(settings)], check=True
            )
            return [np.load(Path(folder) / f"weights_{j}.npy") for j in range(len(problems))]

    def _columns(self, run: Motion, j: int) -> np.ndarray:
        n = run.torque.shape[1]
        q, w, a, s = (
            values[:, j] for values in (run.position, run.velocity, run.acceleration, run.rigid)
        )
        side, one = np.tanh(w / SIGN_SPEED), np.ones_like(w)
        ratio = 1.0 if self._nominal.gear_ratio is None else float(self._nominal.gear_ratio[j])
        rated = self._nominal.torque_rated
        level = float(np.abs(s).max()) + 1e-9 if rated is None else float(rated[j])
        poles = self._nominal.pole_pairs or 1.0
        hours = (run.session_time + run.time - run.time[0]) / 3600.0
        columns = [
            one, side, w, np.abs(w) * w, side * np.exp(-((w / 0.1) ** 2)), a, s, np.abs(s) * side,
            np.gradient(s, run.time), np.tanh(s / level), q, q**3, q * side, q**2 * side,
            np.sin(q), np.cos(q),
        ]  # fmt: skip
        for order in (ratio, 2.0 * ratio, poles * ratio, 6.0 * poles * ratio):
            columns += [np.sin(order * q), np.cos(order * q)]
        columns += [hours * w, hours * side, hours]
        for values in (run.velocity, run.acceleration, run.rigid):
            columns.append(values[:, j - 1] if j > 0 else 0.0 * one)
            columns.append(values[:, j + 1] if j + 1 < n else 0.0 * one)
        return np.column_stack(columns)


def stlsq(x: np.ndarray, y: np.ndarray, threshold: float, ridge: float) -> np.ndarray:
    """Sequentially thresholded ridge regression (Brunton, Proctor, Kutz, PNAS 113, 2016).

    Parameters
    ----------
    x : array (m, p)
        Columns of unit rms.
    y : array (m,)
    threshold : float
    ridge : float
        Times the number of rows.
    """
    gram, moment = x.T @ x, x.T @ y
    kept = np.ones(x.shape[1], dtype=bool)
    weights = np.zeros(x.shape[1])
    for _ in range(20):
        if not kept.any():
            return np.zeros_like(weights)
        weights[:] = 0.0
        own = gram[np.ix_(kept, kept)] + ridge * len(x) * np.eye(int(kept.sum()))
        weights[kept] = np.linalg.solve(own, moment[kept])
        large = np.abs(weights) >= threshold
        if np.array_equal(large, kept):
            break
        kept = large
        weights[~kept] = 0.0
    return weights


class BlackBox:
    """Ridge regression on random Fourier features of the whole motion: a Gaussian process's mean.

    Parameters
    ----------
    length : float
        Of the radial kernel, over the spread of each input.
    ridge : float
        Times the number of rows.
    features : int
    """

    def __init__(self, *, length: float, ridge: float, features: int = 300) -> None:
        self._length, self._ridge, self._features = length, ridge, features
        self._weights = np.zeros((0, 0))

    def fit(self, runs: Sequence[Motion]) -> None:
        inputs = [self._inputs(run) for run in runs]
        every = np.vstack(inputs)
        self._centre, self._spread = every.mean(axis=0), every.std(axis=0) + 1e-9
        rng = np.random.default_rng(0)
        self._waves = rng.standard_normal((every.shape[1], self._features)) / self._length
        self._phases = rng.uniform(0.0, 2.0 * np.pi, self._features)
        columns = [self._columns(own) for own in inputs]
        weights = []
        for j in range(runs[0].torque.shape[1]):
            x, y = _stacked(runs, j, columns, 4)
            gram = x.T @ x + self._ridge * len(x) * np.eye(x.shape[1])
            weights.append(np.linalg.solve(gram, x.T @ y))
        self._weights = np.column_stack(weights)

    def predict(self, run: Motion) -> np.ndarray:
        return np.asarray(self._columns(self._inputs(run)) @ self._weights)

    @staticmethod
    def _inputs(run: Motion) -> np.ndarray:
        side = np.tanh(run.velocity / SIGN_SPEED)
        return np.hstack([run.position, run.velocity, run.acceleration, side])

    def _columns(self, inputs: np.ndarray) -> np.ndarray:
        scaled = (inputs - self._centre) / self._spread
        waves = np.cos(scaled @ self._waves + self._phases) * np.sqrt(2.0 / self._features)
        return np.hstack([waves, scaled, np.ones((len(scaled), 1))])
