"""Noise ceiling: best fit attainable by a free smooth function of the same signals.

A black box learns the residual of the extended model in the training runs as a smooth function of
positions, velocities, accelerations and loads, and predicts it in held-out runs: physics could
explain at least as much. No finding rests on it. The function uses random Fourier features (Rahimi,
Recht 2007), whose ridge fit approximates a Gaussian process; length and ridge by cross-validation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiffopt.discovery.comparison.channel_rows import part_numbers
from stiffopt.discovery.comparison.located_effect import Extension
from stiffopt.discovery.prediction import Prediction, Predictor, residuals
from stiffopt.discovery.progress import RoundProgress, Say, throttle_progress
from stiffopt.discovery.settings import SIGN_SPEED
from stiffopt.discovery.training import Training

# Number of cosines; kernel lengths over the spread of the signals, and ridges, that are tried.
FEATURE_COUNT = 200
_KERNEL_LENGTHS = (0.5, 1.0, 2.0, 4.0)
_RIDGE_FACTORS = (1e-3, 1e-2, 1e-1, 1.0)


@dataclass(frozen=True, eq=False)
class SmoothFunction:
    """A smooth function of signals."""

    # middle, spread (s,): mean and standard deviation of the signals.
    middle: np.ndarray
    spread: np.ndarray
    waves: np.ndarray  # (s, f)
    # phases, weights (f,)
    phases: np.ndarray
    weights: np.ndarray
    limit: float  # largest training value, which clips the result
    held_out_share: float  # share of the squares that it removes in stretches left out

    def __call__(self, signals: np.ndarray) -> np.ndarray:
        """Return values (m,) at signals (m, s)."""
        scaled = (signals - self.middle) / self.spread
        values = np.cos(scaled @ self.waves + self.phases) @ self.weights
        return np.asarray(np.clip(values, -self.limit, self.limit))


def fit_smooth_function(
    signals: np.ndarray, values: np.ndarray, stretch: np.ndarray
) -> SmoothFunction | None:
    """Fit the function that predicts stretches left out best; None if none predicts anything.

    `signals` (m, s). `values` (m,). `stretch` (m,) of int: number of the stretch of each sample.
    """
    middle, spread = signals.mean(axis=0), signals.std(axis=0)
    spread = np.where(spread > 1e-12, spread, 1.0)
    scaled = (signals - middle) / spread / np.sqrt(signals.shape[1])
    draw = np.random.default_rng(7)
    directions = draw.standard_normal((signals.shape[1], FEATURE_COUNT))
    phases = draw.uniform(0.0, 2.0 * np.pi, FEATURE_COUNT)
    parts = [stretch == k for k in np.unique(stretch)]
    whole = float(values @ values)
    best: tuple[float, float, float] | None = None
    for length in _KERNEL_LENGTHS:
        columns = np.cos(scaled @ (directions / length) + phases)
        grams = [columns[p].T @ columns[p] for p in parts]
        moments = [columns[p].T @ values[p] for p in parts]
        gram, moment = sum(grams), sum(moments)
        for ridge in _RIDGE_FACTORS:
            load = ridge * len(values) * np.eye(FEATURE_COUNT) / FEATURE_COUNT
            left = 0.0
            for own, inner, goal in zip(parts, grams, moments, strict=True):
                weights = np.linalg.solve(gram - inner + load, moment - goal)
                left += float(np.sum((values[own] - columns[own] @ weights) ** 2))
            if best is None or left < best[0]:
                best = left, length, ridge
    if best is None or best[0] >= whole:
        return None
    left, length, ridge = best
    waves = directions / length
    columns = np.cos(scaled @ waves + phases)
    load = ridge * len(values) * np.eye(FEATURE_COUNT) / FEATURE_COUNT
    return SmoothFunction(
        middle=middle,
        spread=spread,
        waves=waves / np.sqrt(signals.shape[1]),
        phases=phases,
        weights=np.linalg.solve(columns.T @ columns + load, columns.T @ values),
        limit=float(np.abs(values).max()),
        held_out_share=1.0 - left / whole,
    )


# Samples of all runs that a black box is fitted to, and stretches per run for cross-validation.
_MAX_FIT_SAMPLES, _STRETCHES_PER_RUN = 2000, 6
# Least share of a channel's squares in held-out runs that a useful black box removes.
_SHOWN_SHARE = 0.1
# Points of a dependence curve, samples that each is averaged over, maximum number of named signals,
# and their least effect over the strongest one's.
_CURVE_POINTS, _CURVE_SAMPLES, _MAX_NAMED_SIGNALS, _MIN_NAMED_SHARE = 25, 200, 2, 0.5
# Quantiles of a signal that limit a curve.
_CURVE_QUANTILES = (0.02, 0.98)


@dataclass(frozen=True, kw_only=True, eq=False)
class Dependence:
    """Mean dependence of a residual on one signal."""

    channel: str
    signal: str  # such as "q_1"
    # at, mean (k,): values of the signal [SI], and mean residual [N m].
    at: np.ndarray
    mean: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class NoiseCeiling:
    """Explained share of the best attainable fit on held-out runs."""

    explained: float  # explained over attainable share, mean over the torques
    # Root mean square residual of each torque with the extended model, and with the black box.
    channels: dict[str, tuple[float, float]]
    # Of the torque that the black box improves most, the strongest signal first; empty if it
    # improves none.
    depends: tuple[Dependence, ...]


class BlackBox:
    """Black boxes of all torques, fitted to what an extension leaves of the training runs."""

    def __init__(self, training: Training, found: Extension, say: Say = lambda _: None) -> None:
        n = training.robot.n
        # No training run shows what drives the other joints: a model of them says nothing.
        self._assessed = np.isin(np.arange(n), training.comparison().rows.channels)
        samples = _ResidualSamples(n)
        tell = throttle_progress(say)
        for number, run in enumerate(training.recorded):
            tell(f"calculate the residual of {run.file}")
            predictor = Predictor(training, run)
            stretch = part_numbers(run.time, _STRETCHES_PER_RUN) + number * _STRETCHES_PER_RUN
            samples.add(predictor, predictor.predict(*training.before, found), stretch)
        self._motion_signals = [samples.signals(j) for j in range(n)]
        self._boxes: list[SmoothFunction | None] = []
        pace = RoundProgress(n)
        for j in range(n):
            tell(f"fit the noise ceiling of the torque of joint {pace.words(j)}")
            self._boxes.append(samples.fitted(j))
        self._squares = np.zeros((n, 4))

    def add(self, predictor: Predictor, before: Prediction, after: Prediction) -> None:
        """Add a held-out run."""
        signals = _motion_signals(predictor)
        compared = residuals(predictor.run, predictor.velocity, before, after)
        for kind, joint, used, (first, left) in compared:
            if kind != "torque" or not self._assessed[joint]:
                continue
            box = self._boxes[joint]
            beside = left if box is None else left - box(_input_columns(signals[used]))
            self._squares[joint] += (first @ first, left @ left, beside @ beside, len(left))

    def found(self) -> NoiseCeiling | None:
        """Return the noise ceiling over the held-out runs; None without any."""
        squares = self._squares
        # Shares need a finite mismatch above zero.
        seen = np.flatnonzero(
            (squares[:, 3] > 0)
            & np.isfinite(squares).all(axis=1)
            & (squares[:, :2] > 0).all(axis=1)
        )
        if not seen.size:
            return None
        before, after, box, count = squares[seen].T
        # If the black box is worse than the model, the model is the best attainable fit.
        possible = 1.0 - np.mean(np.minimum(after, box) / before)
        explained = 1.0 - np.mean(after / before)
        gain = 1.0 - box / after
        best = int(np.argmax(gain))
        depends: tuple[Dependence, ...] = ()
        if gain[best] > _SHOWN_SHARE:
            depends = self._find_dependences(int(seen[best]))
        return NoiseCeiling(
            explained=float(explained / possible) if possible > 0.0 else 0.0,
            channels={
                f"torque_{j + 1}": (float(np.sqrt(a / c)), float(np.sqrt(b / c)))
                for j, a, b, c in zip(seen, after, box, count, strict=True)
            },
            depends=depends,
        )

    def _find_dependences(self, joint: int) -> tuple[Dependence, ...]:
        """Average a black box along each signal, with all others at recorded values."""
        box, signals = self._boxes[joint], self._motion_signals[joint]
        assert box is not None
        chosen = np.unique(np.linspace(0, len(signals) - 1, _CURVE_SAMPLES).astype(int))
        n = len(self._boxes)
        found = []
        for column in range(signals.shape[1]):
            low, high = np.quantile(signals[:, column], _CURVE_QUANTILES)
            at = np.linspace(low, high, _CURVE_POINTS)
            moved = np.repeat(signals[chosen][None], _CURVE_POINTS, axis=0)
            moved[:, :, column] = at[:, None]
            mean = (
                box(_input_columns(moved.reshape(-1, moved.shape[2])))
                .reshape(_CURVE_POINTS, -1)
                .mean(1)
            )
            name = f"{_MOTION_SIGNALS[column // n][0]}_{column % n + 1}"
            found.append(Dependence(channel=f"torque_{joint + 1}", signal=name, at=at, mean=mean))
        found.sort(key=lambda each: -float(each.mean.std()))
        least = _MIN_NAMED_SHARE * float(found[0].mean.std())
        return tuple(each for each in found[:_MAX_NAMED_SIGNALS] if each.mean.std() >= least)


class _ResidualSamples:
    """Residuals of the training runs, subsampled."""

    def __init__(self, n: int) -> None:
        # Signals of a run are shared by all joints: they are subsampled only on use.
        self._parts: list[list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]] = [
            [] for _ in range(n)
        ]

    def add(self, predictor: Predictor, after: Prediction, stretch: np.ndarray) -> None:
        signals = _motion_signals(predictor)
        for kind, joint, used, (left,) in residuals(predictor.run, predictor.velocity, after):
            if kind == "torque":
                self._parts[joint].append((signals, np.flatnonzero(used), left, stretch[used]))

    def signals(self, joint: int) -> np.ndarray:
        """Return signals (m, s) at the samples of a joint."""
        kept, begin, found = self._sample_indices(joint), 0, [np.zeros((0, 1))]
        for signals, own, _, _ in self._parts[joint]:
            here = kept[(kept >= begin) & (kept < begin + len(own))] - begin
            found.append(signals[own[here]])
            begin += len(own)
        return np.vstack(found[1:] or found)

    def fitted(self, joint: int) -> SmoothFunction | None:
        """Return the black box of a joint; None if it predicts nothing."""
        if not self._parts[joint]:
            return None
        kept = self._sample_indices(joint)
        left = np.concatenate([part[2] for part in self._parts[joint]])[kept]
        stretch = np.concatenate([part[3] for part in self._parts[joint]])[kept]
        if len(np.unique(stretch)) < 2:
            return None
        return fit_smooth_function(_input_columns(self.signals(joint)), left, stretch)

    def _sample_indices(self, joint: int) -> np.ndarray:
        count = sum(len(own) for _, own, _, _ in self._parts[joint])
        return np.unique(np.linspace(0, count - 1, _MAX_FIT_SAMPLES).astype(int))


# Signals of every joint: names, and attributes of prepared signals.
_MOTION_SIGNALS = (
    ("q", "motor_position"),
    ("qd", "motor_velocity"),
    ("qdd", "motor_acceleration"),
    ("torque", "spring_torque"),
)


def _motion_signals(predictor: Predictor) -> np.ndarray:
    """Return signals of all joints at the samples of a run (K, 4 n), by kind."""
    nominal, time = predictor.nominal, predictor.run.time
    return np.column_stack(
        [
            np.interp(time, nominal.time, column)
            for _, name in _MOTION_SIGNALS
            for column in getattr(nominal.signals, name).T
        ]
    )


def _input_columns(signals: np.ndarray) -> np.ndarray:
    """Return inputs of a black box from signals (m, 4 n): sines, cosines, smooth signs."""
    q, qd, qdd, torque = np.split(signals, len(_MOTION_SIGNALS), axis=1)
    return np.hstack([np.sin(q), np.cos(q), qd, np.tanh(qd / SIGN_SPEED), qdd, torque])
