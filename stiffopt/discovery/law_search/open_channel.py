"""Residual of one channel, orthogonal to what nominal values and named effects span."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.laws.law import Law
from stiffopt.discovery.laws.shapes import MAX_GRID_ORDER, SignalRange
from stiffopt.discovery.laws.sources import SOURCE_KINDS, LawSource

# Frequencies of a wave: step over the inverse duration, largest one over the rate of the rows,
# peaks of single runs whose surroundings are searched, and steps of such a search either way.
_FREQUENCY_STEP, _MAX_FREQUENCY, _WAVE_PEAKS, _MAX_FINE_STEPS = 0.25, 0.4, 3, 4000
# Share of the rows at which the joint is slow enough to show a ripple, and the highest order that
# is sought [1/rad]: twelve ripples of each of 160 turns of a motor.
_SLOW_SHARE, _MAX_ORDER = 0.05, 2000.0
# Ridge of a fit to rows of unit noise, over the mean square of its columns.
_RELATIVE_RIDGE = 1e-9


@dataclass(frozen=True, eq=False)
class Fitted:
    """Linear fit of columns to the rows."""

    amplitudes: np.ndarray  # (k,)
    covariance: np.ndarray  # (k, k) for rows of unit noise
    removed: float  # squares that the fit removes
    left: np.ndarray  # (b,) squares of every block, predicted by a fit to the other blocks
    by_block: np.ndarray  # (b, k) amplitudes of the fits to all blocks but one


class OpenChannel:
    """Rows of one channel beside a fitted model.

    `effects`: named so far. `channel`: torques of joint 1 to n, then deflections.

    `rows` (m,) of int: rows of the channel. `target` (m,): residual over the stated noise: white
    with unit variance where only noise is left. `block` (m,) of int.
    """

    def __init__(
        self, comparison: Comparison, effects: Sequence[LocatedEffect], channel: int
    ) -> None:
        self.comparison, self.channel = comparison, channel
        n = comparison.robot.n
        self.joint = channel % n
        self.kind = "torque" if channel < n else "deflection"
        _, sd = comparison.priors
        known = comparison.stack_columns(effects)
        prior = np.concatenate([sd, np.ones(known.shape[1] - len(sd))])
        own = comparison.rows.channel == channel
        self.rows, other = np.flatnonzero(own), np.flatnonzero(~own)
        self.block = np.unique(comparison.rows.block[self.rows], return_inverse=True)[1]
        # What other channels say of the known values; this one counts with the stated noise, so
        # that they absorb all of its residual that they can.
        precision = np.diag(prior**-2.0) + known[other].T @ known[other]
        moment = known[other].T @ comparison.target[other]
        scale = float(comparison.inflation[channel] / comparison.least[channel])
        inside = known[self.rows] * scale
        self._project = _Projection(inside, precision)
        beside = np.linalg.solve(precision, moment)
        self.target = self._project(comparison.target[self.rows] * scale - inside @ beside)

    @property
    def square(self) -> float:
        """Sum of squares of the target."""
        return float(self.target @ self.target)

    @property
    def excess(self) -> float:
        """Sum of squares beyond the noise."""
        return max(self.square - len(self.target), 1e-9)

    def beside(self, columns: np.ndarray, fit: Fitted) -> OpenChannel:
        """Return the channel with what a fit of columns (m, k) leaves as its target."""
        rest = copy(self)
        rest.target = self.target - columns @ fit.amplitudes
        return rest

    def share(self, left: float) -> float:
        """Return the share of the excess that is gone where so many squares are left; at most 1."""
        return min((self.square - left) / self.excess, 1.0)

    # ---- columns

    def columns(self, values: Sequence[Sequence[np.ndarray]]) -> np.ndarray:
        """Return projected rows (m, k) of additions to the channel: [run][column] of (K,)."""
        rows = self.comparison.rows
        out = np.zeros((len(self.rows), len(values[0])))
        place = np.cumsum(self.comparison.rows.channel == self.channel) - 1
        for number, of_run in enumerate(values):
            each = [(self.kind, self.joint, k, np.asarray(v, float)) for k, v in enumerate(of_run)]
            for begin, part in rows.channel_columns(number, each, len(each)):
                if len(part):
                    first = place[begin]
                    out[first : first + len(part)] = part
        least = float(self.comparison.least[self.channel])
        return self._project(out / least)

    def law_columns(self, law: Law) -> np.ndarray:
        """Return the projected rows (m, k) per unit of every amplitude."""
        return self.columns([law.columns(run.signals) for run in self.comparison.runs])

    def law_slopes(self, law: Law, amplitudes: np.ndarray) -> np.ndarray:
        """Return the projected derivative (m, s) of a law by its shapes."""
        values = []
        for run in self.comparison.runs:
            slopes = law.slopes(run.signals)
            values.append(
                [
                    sum(a * own[i] for a, own in zip(amplitudes, slopes, strict=True))
                    for i in range(len(law.shapes))
                ]
            )
        return self.columns(values)

    # ---- signals

    @cached_property
    def sources(self) -> tuple[LawSource, ...]:
        """Signals that vary in the recordings."""
        found = []
        for kind, own in SOURCE_KINDS.items():
            joints = range(self.comparison.robot.n) if own.per_joint else (None,)
            every = (self.joint,) if own.of_own_joint else joints
            found += [LawSource(kind, joint) for joint in every]
        ranges = [(source, self.extent(source)) for source in found]
        return tuple(s for s, own in ranges if own.high - own.low > 1e-9 * own.size)

    def extent(self, source: LawSource) -> SignalRange:
        """Return the range of a signal in the runs."""
        runs = self.comparison.runs
        ends = [(float(v.min()), float(v.max())) for v in (source.value(r.signals) for r in runs)]
        return SignalRange(
            low=min(low for low, _ in ends),
            high=max(high for _, high in ends),
            duration=max(float(run.time[-1] - run.time[0]) for run in runs),
            rate=2.0 * runs[0].low_pass.cutoff,
        )

    def frequencies(self, source: LawSource) -> tuple[float, ...]:
        """Return the likeliest frequencies of the residual over a clock [1 per its unit].

        Single runs tell a frequency roughly, whatever their phases; all of them together tell it as
        finely as the whole time between them resolves.
        """
        time = self.comparison.rows.sample_signal(source.value_in)[self.rows]
        parts = [self.block == b for b in range(int(self.block.max()) + 1)]
        short = min(float(np.ptp(time[own])) for own in parts)
        if short <= 0.0:  # a clock that stands, as of poses at rest
            return ()
        step = float(np.median(np.diff(np.unique(time))))
        coarse = np.arange(2.0 / short, _MAX_FREQUENCY / step, _FREQUENCY_STEP / short)
        if not coarse.size:
            return ()
        power = sum(self._wave_power(time, coarse, own) for own in parts)
        peaks = coarse[np.argsort(-power)[:_WAVE_PEAKS]]
        return tuple(self.near_frequencies(source, peak)[0] for peak in peaks)

    def near_frequencies(self, source: LawSource, frequency: float) -> list[float]:
        """Return the frequencies about one that single runs do not tell from it, best first.

        Runs apart tell it only up to multiples of the inverse time between them.
        """
        time = self.comparison.rows.sample_signal(source.value_in)[self.rows]
        short = min(float(np.ptp(time[self.block == b])) for b in np.unique(self.block))
        step = _FREQUENCY_STEP / float(np.ptp(time))
        reach = min(0.5 / short, _MAX_FINE_STEPS * step)
        fine = np.arange(frequency - reach, frequency + reach, step)
        power = self._wave_power(time, fine, np.ones(len(time), dtype=bool))
        inside = power[1:-1]
        tops = 1 + np.flatnonzero((inside >= power[:-2]) & (inside > power[2:]))
        return [float(fine[k]) for k in sorted(tops, key=lambda k: -power[k])] or [frequency]

    def orders(self, source: LawSource) -> tuple[float, ...]:
        """Return the likeliest orders of the residual over an angle, beyond the grid [1/rad].

        Up to those that pass no faster than the rows are, where the joint is slow.
        """
        angle, speed = (
            self.comparison.rows.sample_signal(each.value_in)[self.rows]
            for each in (source, LawSource("speed", source.joint))
        )
        rate = 2.0 * self.comparison.runs[0].low_pass.cutoff
        slow = max(float(np.quantile(np.abs(speed), _SLOW_SHARE)), 1e-6)
        highest = min(2.0 * np.pi * _MAX_FREQUENCY * rate / slow, _MAX_ORDER)
        tried = np.arange(MAX_GRID_ORDER, highest, 1.0 / max(float(np.ptp(angle)), 1e-3))
        power = self._wave_power(angle, tried / (2.0 * np.pi), np.ones(len(angle), dtype=bool))
        return tuple(tried[np.argsort(-power)[:_WAVE_PEAKS]].tolist())

    def _wave_power(self, time: np.ndarray, frequencies: np.ndarray, own: np.ndarray) -> np.ndarray:
        turns = np.outer(frequencies, time[own])
        return np.asarray(np.abs(np.exp(2j * np.pi * turns) @ self.target[own]) ** 2 / own.sum())

    # ---- fits

    def fit(self, columns: np.ndarray) -> Fitted:
        """Fit columns (m, k), and predict every block by a fit to the others."""
        blocks = int(self.block.max()) + 1
        grams = np.empty((blocks, columns.shape[1], columns.shape[1]))
        moments = np.empty((blocks, columns.shape[1]))
        for b in range(blocks):
            part = columns[self.block == b]
            grams[b], moments[b] = part.T @ part, part.T @ self.target[self.block == b]
        gram, moment = grams.sum(axis=0), moments.sum(axis=0)
        ridge = np.diag(_RELATIVE_RIDGE * np.diag(gram) + 1e-300)
        covariance = np.linalg.inv(gram + ridge)
        amplitudes = covariance @ moment
        left, by_block = np.empty(blocks), np.empty_like(moments)
        for b in range(blocks):
            own = self.block == b
            by_block[b] = np.linalg.solve(gram - grams[b] + ridge, moment - moments[b])
            left[b] = float(np.sum((self.target[own] - columns[own] @ by_block[b]) ** 2))
        return Fitted(amplitudes, covariance, float(moment @ amplitudes), left, by_block)


class _Projection:
    """Root of the inverse covariance of rows whose known columns have Gaussian values."""

    def __init__(self, known: np.ndarray, precision: np.ndarray) -> None:
        whole = precision + known.T @ known
        along = solve_triangular(np.linalg.cholesky(whole), known.T, lower=True).T
        # I - Z Z' of the rows; its root along the directions of Z.
        self._directions, sizes, _ = np.linalg.svd(along, full_matrices=False)
        self._kept = 1.0 - np.sqrt(np.maximum(1.0 - sizes**2, 0.0))

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        return np.asarray(
            rows - self._directions @ ((self._kept * (self._directions.T @ rows).T).T)
        )
