"""Uncertainty of findings: joint posterior of nominal values, amplitudes and shapes, jackknives."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import special
from scipy.linalg import block_diag

from stiffopt.discovery.comparison.channel_rows import part_numbers
from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.design_matrix import MIN_RUNS_AS_BLOCKS, STRETCH_DURATION
from stiffopt.discovery.comparison.located_effect import (
    EstimatedEffect,
    LocatedEffect,
    with_amplitudes,
)
from stiffopt.discovery.comparison.prepared_run import PreparedRun
from stiffopt.discovery.names import ValueName

if TYPE_CHECKING:
    from stiffopt.discovery.effect import Constants

# Relative step of numerical derivatives.
_DIFFERENCE_STEP = 1e-4
# Prior standard deviation of a shape over its size: wide, so that only the data count.
_SHAPE_PRIOR = 10.0
# Fewer stretches give no jackknife estimate.
_MIN_STRETCHES = 5
# Upper end of a two-sided 95 % interval.
_UPPER_QUANTILE = 0.975


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate:
    """Joint posterior of nominal values and effects."""

    nuisance: tuple[ValueName, ...]  # names of the nominal values
    values: np.ndarray  # (p,) nominal values, then amplitudes over their sizes
    effects: tuple[EstimatedEffect, ...]
    # (r, r) nominal values, amplitudes over sizes, shapes over sizes; by the linear model.
    covariance: np.ndarray
    # (r, r) part of it that the priors make: what estimates from parts of the rows have in common.
    common: np.ndarray
    # spread, between (r, r): covariance by a jackknife over stretches, and over whole runs where
    # there are three or more: only those show differences between runs.
    spread: np.ndarray
    between: np.ndarray
    added: np.ndarray  # (r, r) covariance beyond the likelihood, of all of these
    squares: np.ndarray  # (r, r) of the columns of these, over the noise
    sizes: tuple[np.ndarray, ...]
    shape_sizes: tuple[np.ndarray, ...]
    parts: tuple[int, int]  # number of stretches and of runs

    def calibration(self) -> dict[ValueName, float]:
        """Return the changes of the nominal values by name."""
        values = self.values[: len(self.nuisance)]
        return {name: float(v) for name, v in zip(self.nuisance, values, strict=True)}

    def parameters(self, index: int, constants: Constants) -> dict[str, tuple[float, float]]:
        """Return reported values of one effect with standard deviations.

        The largest of the covariance estimates counts, propagated linearly to the reported values.
        A jackknife shows the scatter by the rows, from few parts and not the error of the priors:
        that is added, and 1.96 deviations hold Student's 95 % interval.
        """
        found = self.effects[index]
        effect, k = found.located.effect, len(self.sizes[index])
        rows, _ = self._parameter_rows(index)
        values, slopes = self._reported_values(index, constants)
        # Few parts show what lies beyond a limit: without them a jackknife knows nothing of it.
        parts = () if effect.takes_recorded else self._jackknives(index)
        scatter = [_small_sample_factor(n) ** 2 * each + self.common for each, n in parts]
        covariances = [
            (each + self.added)[np.ix_(rows, rows)] for each in (self.covariance, *scatter)
        ]
        if effect.takes_recorded:  # the amplitude is known
            slopes, shapes_first = slopes[:, k:], np.roll(np.arange(len(rows)), -k)
            covariances = [
                _conditional_covariance(each[np.ix_(shapes_first, shapes_first)], len(rows) - k)
                for each in covariances
            ]
        variances = [np.einsum("ij,jk,ik->i", slopes, each, slopes) for each in covariances]
        variance = np.max(variances, axis=0)
        if effect.drawn is not None:
            few = effect.drawn(found.amplitudes, found.located.shapes, constants)
            variance = variance + np.array([few[name] for name in values]) ** 2
        return {
            name: (value, float(sd))
            for (name, value), sd in zip(values.items(), np.sqrt(variance), strict=True)
        }

    def prior_deviations(self, index: int, constants: Constants) -> dict[str, float]:
        """Return the standard deviations of the reported values before any recording.

        Amplitudes are of their typical size, shapes within the range of their initial values;
        infinite where a shape has a single one.
        """
        located = self.effects[index].located
        values, slopes = self._reported_values(index, constants)
        ranges = [
            np.ptp(shape.grid(constants)) / size if len(shape.grid(constants)) > 1 else np.inf
            for shape, size in zip(located.effect.shapes, self.shape_sizes[index], strict=True)
        ]
        prior = np.array([*np.ones(len(self.sizes[index])), *ranges])
        own = [np.linalg.norm(row[row != 0.0] * prior[row != 0.0]) for row in slopes]
        return {name: float(sd) for name, sd in zip(values, own, strict=True)}

    def _reported_values(
        self, index: int, constants: Constants
    ) -> tuple[dict[str, float], np.ndarray]:
        """Return the reported values, and their slopes by amplitudes and shapes over sizes."""
        found = self.effects[index]
        effect = found.located.effect
        _, steps = self._parameter_rows(index)
        inputs = np.array([*found.amplitudes, *found.located.shapes])
        count = len(found.amplitudes)

        def report(at: np.ndarray) -> dict[str, float]:
            return effect.parameters(tuple(at[:count]), tuple(at[count:]), constants)

        def difference(step: np.ndarray) -> np.ndarray:
            ends = [list(report(inputs + sign * step).values()) for sign in (1.0, -1.0)]
            return np.asarray(np.subtract(*np.array(ends)) / (2.0 * _DIFFERENCE_STEP))

        slopes = np.column_stack([difference(_DIFFERENCE_STEP * step) for step in np.diag(steps)])
        return {name: float(value) for name, value in report(inputs).items()}, slopes

    def deviations(self, index: int) -> float:
        """Return the size of what an effect adds over its standard deviation, all else free.

        Root mean squares over all rows. Values that make up for one another may be uncertain, each
        by itself, where the function that they describe is not.
        """
        return min(size for size, _ in self._function_deviations(index))

    def p_value(self, index: int) -> float:
        """Return the p-value of one effect: probability of a function as large without it.

        The largest of all covariance estimates; of a jackknife by Student's distribution.
        """
        return max(
            2.0 * float(special.ndtr(-size) if parts is None else special.stdtr(parts - 1, -size))
            for size, parts in self._function_deviations(index)
        )

    def _function_deviations(self, index: int) -> list[tuple[float, int | None]]:
        """Return an effect's deviations from zero by covariance, with the parts of jackknives."""
        rows, _ = self._parameter_rows(index)
        k = len(self.sizes[index])
        values, squares = self.values[rows[:k]], self.squares[np.ix_(rows, rows)]
        square = float(values @ squares[:k, :k] @ values)
        found = []
        for covariance, parts in ((self.covariance, None), *self._jackknives(index)):
            own = (covariance + self.added)[np.ix_(rows, rows)]
            variance = max(float(np.sum(squares * own)), np.finfo(float).tiny)
            found.append((math.sqrt(square / variance), parts))
        return found

    def added_size(self, comparison: Comparison, index: int, channel: int) -> tuple[float, float]:
        """Return the root mean square of what an effect adds, with its deviation [N m or rad].

        `comparison`: of the training runs that were fitted. `channel`: torques of the joints, then
        motor less link angles.
        """
        rows = comparison.rows
        own = rows.channel == channel
        columns = comparison.columns.effect_columns(self.effects[index].located)[own]
        gains = np.array([run.low_pass.noise_gain for run in comparison.runs])[rows.run[own]]
        added = gains * (columns @ self.values[self._amplitude_rows(index)])
        size = float(np.sqrt(np.mean(added**2)) * rows.noise.stacked[channel])
        return size, size / max(self.deviations(index), np.finfo(float).tiny)

    def _jackknives(self, index: int) -> list[tuple[np.ndarray, int]]:
        """Return jackknife covariances and their numbers of parts; one run has none between runs.

        Too few parts give the covariance of the linear model in place of a jackknife.
        """
        each = [(self.spread, self.parts[0])]
        if not self.effects[index].located.is_run_specific:
            each.append((self.between, self.parts[1]))
        return [(m, count) for m, count in each if not np.array_equal(m, self.covariance)]

    def shrunk(self, shares: np.ndarray) -> Estimate:
        """Return the estimate with shares (e,), 0 to 1, of the amplitudes, the others refitted.

        As by a prior about zero that alone would leave that share of an effect. Deviations stay.
        """
        chosen = np.flatnonzero(shares < 1.0)
        rows = [self._amplitude_rows(index) for index in range(len(self.effects))]
        gone = np.concatenate([np.zeros(0, dtype=int), *(rows[index] for index in chosen)])
        across = self.covariance[:, gone]
        within = [self.covariance[np.ix_(rows[k], rows[k])] for k in chosen]
        loose = [s / (1.0 - s) * own for s, own in zip(shares[chosen], within, strict=True)]
        pulled = np.linalg.pinv(across[gone] + block_diag(*loose)) if len(gone) else across[gone]
        change = -across[: len(self.values)] @ pulled @ self.values[gone]
        effects = tuple(
            replace(each, amplitudes=tuple((each.amplitudes + size * change[own]).tolist()))
            for each, own, size in zip(self.effects, rows, self.sizes, strict=True)
        )
        return replace(self, values=self.values + change, effects=effects)

    def _amplitude_rows(self, index: int) -> np.ndarray:
        return self._parameter_rows(index)[0][: len(self.sizes[index])]

    def doubted(self, away: np.ndarray) -> Estimate:
        """Add differences to another fit's amplitudes (k,), over their sizes, as deviations."""
        change = np.zeros(len(self.covariance))
        first = len(self.nuisance)
        change[first : first + len(away)] = away
        return self._widened(np.diag(change**2))

    def scaled(self, scales: Sequence[float]) -> Estimate:
        """Add a common relative standard deviation (e,) of each effect's amplitudes."""
        more = np.zeros_like(self.covariance)
        for index, scale in enumerate(scales):
            own = self._amplitude_rows(index)
            more[np.ix_(own, own)] = scale**2 * np.outer(self.values[own], self.values[own])
        return self._widened(more)

    def _widened(self, more: np.ndarray) -> Estimate:
        """Return the estimate with a covariance (r, r) added to each of its own."""
        return replace(self, added=self.added + more)

    def _parameter_rows(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        """Return rows of an effect's amplitudes and shapes, and the sizes that they are over."""
        lengths = [len(s) for s in self.sizes]
        first = len(self.nuisance) + sum(lengths[:index])
        own = np.arange(first, first + lengths[index])
        shapes = [len(s) for s in self.shape_sizes]
        after = len(self.values) + sum(shapes[:index])
        rows = np.concatenate([own, np.arange(after, after + shapes[index])])
        return rows, np.concatenate([self.sizes[index], self.shape_sizes[index]])


def estimate_parameters(comparison: Comparison, effects: Sequence[LocatedEffect]) -> Estimate:
    """Fit nominal values and effects together and estimate their covariance.

    `comparison`: with the noise estimated beside the effects. `effects`: with fitted shapes.

    Shapes are linearised numerically about their fitted values.
    """
    fit = comparison.fit(effects)
    names, prior_sd = comparison.priors
    sizes = tuple(e.sizes(comparison.constants) for e in effects)
    scaled = fit.amplitudes()
    shape_sizes = tuple(np.array([abs(v) if v else 1.0 for v in e.shapes]) for e in effects)
    slopes, begin = [], 0
    for located, steps in zip(effects, shape_sizes, strict=True):
        amplitudes = scaled[begin : begin + len(located.effect.amplitudes)]
        begin += len(amplitudes)
        for i, step in enumerate(steps):
            slopes.append(_shape_slope(comparison, located, amplitudes, i, step))
    matrix = comparison.stack_columns(effects)
    if slopes:  # without any, no copy of all columns
        matrix = np.column_stack([matrix, *slopes])
    prior = np.concatenate([prior_sd, np.ones(len(scaled)), np.full(len(slopes), _SHAPE_PRIOR)])
    del slopes
    blocks = number_stretches(comparison)
    covariance, spread, squares = _jackknife_covariance(comparison, matrix, prior, blocks)
    between = covariance
    if len(comparison.runs) >= MIN_RUNS_AS_BLOCKS:
        _, between, _ = _jackknife_covariance(
            comparison, matrix, prior, comparison.rows.block, MIN_RUNS_AS_BLOCKS
        )
    return Estimate(
        nuisance=tuple(names),
        values=fit.posterior.mean,
        effects=with_amplitudes(effects, scaled, sizes),
        covariance=covariance,
        # C P^-2 C: with C^-1 = W'W + P^-2 the error C (W'e - P^-2 b) of rows e and priors b.
        common=(covariance / prior**2) @ covariance,
        spread=spread,
        between=between,
        added=np.zeros_like(covariance),
        squares=squares,
        sizes=sizes,
        shape_sizes=shape_sizes,
        parts=(int(blocks.max()) + 1, int(comparison.rows.block.max()) + 1),
    )


def _conditional_covariance(covariance: np.ndarray, k: int) -> np.ndarray:
    """Return the covariance of the first k values with the others held."""
    across = covariance[:k, k:]
    return np.asarray(covariance[:k, :k] - across @ np.linalg.pinv(covariance[k:, k:]) @ across.T)


def _small_sample_factor(parts: int) -> float:
    """Return Student's 97.5 % quantile of a jackknife of so many parts over the normal one."""
    return float(special.stdtrit(parts - 1, _UPPER_QUANTILE) / special.ndtri(_UPPER_QUANTILE))


def null_probability(chance: float, odds: float = 1.0) -> float:
    """Return the least posterior probability of the null hypothesis at some prior odds for it.

    Sellke, Bayarri & Berger (2001): no likelihood ratio to the null exceeds 1/(-e p ln p).
    """
    bound = 1.0 if chance >= 1.0 / math.e else -math.e * float(special.xlogy(chance, chance))
    return odds * bound / (1.0 + odds * bound)


def _shape_slope(
    comparison: Comparison, located: LocatedEffect, amplitudes: np.ndarray, i: int, size: float
) -> np.ndarray:
    """Return the derivative of an effect's contribution by one shape over its size."""
    shape = located.effect.shapes[i]
    now = located.shapes[i]
    low = max(now - _DIFFERENCE_STEP * size, shape.lower)
    high = min(now + _DIFFERENCE_STEP * size, shape.upper)
    ends = []
    for value in (low, high):
        moved = (*located.shapes[:i], value, *located.shapes[i + 1 :])
        ends.append(comparison.effect_columns(replace(located, shapes=moved)) @ amplitudes)
    return np.asarray((ends[1] - ends[0]) * size / (high - low))


def _jackknife_covariance(
    comparison: Comparison,
    matrix: np.ndarray,
    prior: np.ndarray,
    block: np.ndarray,
    fewest: int = _MIN_STRETCHES,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the covariances by the linear model and by a jackknife over blocks of rows.

    With the squares of the columns.
    """
    units = np.outer(prior, prior)
    grams = np.empty((int(block.max()) + 1, *units.shape))
    moments = np.empty(grams.shape[:2])
    for b in range(len(grams)):
        # One block at a time: the columns of a long run are too large to copy.
        part = matrix[block == b]
        grams[b] = units * (part.T @ part)
        moments[b] = prior * (part.T @ comparison.target[block == b])
    squares, moment = grams.sum(axis=0), moments.sum(axis=0)
    gram = squares + np.eye(len(prior))
    covariance, squares = np.linalg.inv(gram) * units, squares / units
    if len(grams) < fewest:
        return covariance, covariance, squares
    left_out = np.array(
        [np.linalg.solve(gram - g, moment - m) for g, m in zip(grams, moments, strict=True)]
    )
    away = left_out - left_out.mean(axis=0)
    return covariance, (len(grams) - 1) / len(grams) * away.T @ away * units, squares


def number_stretches(comparison: Comparison, begin: float = 0.0) -> np.ndarray:
    """Return the number of the stretch that every row (m,) belongs to; `begin` as of parts."""
    rows = comparison.rows

    def count(run: PreparedRun) -> int:
        duration = (1.0 - begin) * float(run.time[-1] - run.time[0])
        return max(1, round(duration / STRETCH_DURATION))

    first = np.concatenate([[0], np.cumsum([count(run) for run in comparison.runs])])
    part = rows.sample_signal(lambda run: part_numbers(run.time, count(run), begin))
    return np.unique(first[rows.run] + part, return_inverse=True)[1]
