"""Comparison of training runs with the nominal model: nuisance values, residual, fits."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear

from stiffopt.discovery.comparison.design_matrix import MAX_LINEARISATION_ERROR, DesignMatrix
from stiffopt.discovery.comparison.evidence import (
    AddedSums,
    BlockSums,
    Posterior,
    Sums,
    posterior,
    savage_dickey,
)
from stiffopt.discovery.comparison.extension_change import select_calibration
from stiffopt.discovery.comparison.inertial_parameters import (
    body_units,
    is_consistent,
    likeliest_consistent_bodies,
    nominal_bodies,
)
from stiffopt.discovery.comparison.located_effect import Extension, LocatedEffect, with_amplitudes
from stiffopt.discovery.comparison.nuisance import BODY_VALUES
from stiffopt.discovery.comparison.piece_sums import WeightedSums
from stiffopt.discovery.comparison.prepared_run import PreparedRun
from stiffopt.discovery.names import ValueName
from stiffopt.discovery.settings import MAX_NOMINAL_DEVIATIONS

# Default of a nominal model without an earlier diagnosis.
_NO_SUSPECTS: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True, eq=False)
class Fit:
    """Least-squares fit of nominal values within tolerance and of effects."""

    effects: tuple[LocatedEffect, ...]
    posterior: Posterior  # of the nuisance values, then the amplitudes over their sizes
    residual: np.ndarray  # (m,) over the stated noise
    nuisance: int

    def evidence_losses(self) -> np.ndarray:
        """Return the log evidence lost without each effect, with the others.

        Savage-Dickey ratio: posterior over prior density at amplitude zero.
        """
        lost, begin = [], self.nuisance
        for located in self.effects:
            part = slice(begin, begin + len(located.effect.amplitudes))
            mean, covariance = self.posterior.mean[part], self.posterior.covariance[part, part]
            lost.append(savage_dickey(mean, covariance))
            begin = part.stop
        return np.array(lost)

    def amplitudes(self) -> np.ndarray:
        """Return the amplitudes of all effects over their sizes, concatenated."""
        return self.posterior.mean[self.nuisance :]


@dataclass(frozen=True, eq=False)
class ModelSums:
    """Sums of products of a model's columns."""

    own: Sums  # of the nominal values, then the amplitudes over their sizes
    added_sums: Callable[[LocatedEffect], AddedSums]  # -> sums of an effect's columns with those


class Comparison:
    """Training runs against the nominal model.

    `columns`: design matrix of these runs, linearised about known findings. `inflation` (2 n,):
    factor on the noise of every channel for its unexplained residual. `least` (2 n,): smallest of
    these factors: the residual of the starting model in its own recordings; nan for unseen
    channels. `suspects`: log evidence per row of effects, by label, that the starting model left
    unexplained: so much does not count as evidence of a change.
    """

    def __init__(
        self,
        columns: DesignMatrix,
        *,
        inflation: np.ndarray | None = None,
        least: np.ndarray | None = None,
        suspects: Mapping[str, float] = _NO_SUSPECTS,
    ) -> None:
        self.columns, robot = columns, columns.robot
        self.robot, self.noise, self.tolerance = robot, columns.noise, columns.tolerance
        self.nominal_runs, self.start = columns.nominal_runs, columns.start
        self.runs, self.rows = self.columns.runs, self.columns.rows
        self.constants = self.runs[0].signals.constants
        self.blocks = int(self.rows.block.max()) + 1
        self.after_model = least is not None
        self._least_known, self.suspects = least, suspects
        self.least = np.ones(2 * robot.n) if least is None else np.nan_to_num(least, nan=1.0)
        self.unseen = np.zeros(2 * robot.n, dtype=bool) if least is None else np.isnan(least)
        self.inflation = self.least if inflation is None else inflation

    @cached_property
    def _row_weight(self) -> np.ndarray:
        """Weight of every row over the stated noise."""
        return np.asarray(1.0 / self.inflation[self.rows.channel])

    def linearised_at(self, fit: Fit, near: float = MAX_LINEARISATION_ERROR) -> Comparison:
        """Return the comparison linearised at a fit, with its residual noise in each channel.

        `near`: largest linearisation error of the links, rms over that noise.
        """
        left = np.nan_to_num(self.channel_ratio(fit.residual), nan=1.0)
        return self.with_extension(self.extension_of(fit), np.maximum(self.least, left), near)

    def extension_of(self, fit: Fit) -> Extension:
        """Return nominal values and effects of a fit."""
        names, _ = self.priors
        sizes = [located.sizes(self.constants) for located in fit.effects]
        return Extension(
            calibration=dict(zip(names, fit.posterior.mean[: len(names)].tolist(), strict=True)),
            effects=with_amplitudes(fit.effects, fit.amplitudes(), sizes),
        )

    def with_extension(
        self,
        found: Extension,
        inflation: np.ndarray | None = None,
        near: float = MAX_LINEARISATION_ERROR,
    ) -> Comparison:
        """Return the comparison about an extension, with other noise factors (2 n,)."""
        noise = self.least if inflation is None else inflation
        return self._derive_comparison(inflation, self.columns.linearised_at(found, noise, near))

    def about_bodies(self, fit: Fit) -> Comparison:
        """Return the comparison linearised about the free bodies of a fit."""
        return self.with_extension(select_calibration(self.extension_of(fit), BODY_VALUES))

    def with_runs(self, runs: Sequence[PreparedRun]) -> Comparison:
        """Return the comparison of other runs with the same model."""
        columns = DesignMatrix(self.robot, tuple(runs), self.noise, self.tolerance, self.start)
        return self._derive_comparison(None, columns)

    def _derive_comparison(self, inflation: np.ndarray | None, columns: DesignMatrix) -> Comparison:
        return Comparison(
            columns, inflation=inflation, least=self._least_known, suspects=self.suspects
        )

    @property
    def bodies(self) -> np.ndarray | None:
        """Standard deviations of all inertial parameters (n, 10), where they are free."""
        return self.columns.bodies

    def with_bodies(self, bodies: np.ndarray | None) -> Comparison:
        """Return the comparison with free inertial parameters (n, 10) of all bodies.

        In place of masses and centres of mass.
        """
        return self._derive_comparison(self.inflation, self.columns.with_bodies(bodies))

    def inherited_evidence(self, located: LocatedEffect) -> float:
        """Return the log evidence for an effect that the starting model left unexplained."""
        return self.suspects.get(located.label, 0.0) * self.rows.size

    @property
    def max_inherited_evidence(self) -> float:
        """Largest inherited log evidence of all effects."""
        return max(self.suspects.values(), default=0.0) * self.rows.size

    # ---- weighted columns

    @property
    def priors(self) -> tuple[list[ValueName], np.ndarray]:
        """Names and priors of the nominal values."""
        return self.columns.priors

    def stack_columns(self, effects: Sequence[LocatedEffect] = ()) -> np.ndarray:
        """Return weighted columns (m, p) of nominal values and effects, as large as all signals."""
        counts = [len(e.effect.amplitudes) for e in effects]
        edges = np.cumsum([len(self.priors[0]), *counts]).tolist()
        columns = np.empty((self.rows.size, edges[-1]))
        columns[:, : edges[0]] = self.columns.nuisance
        for located, first, last in zip(effects, edges, edges[1:], strict=False):
            columns[:, first:last] = self.columns.effect_columns(located)
        return self._whiten_rows(columns)

    def model_rows(self, effects: Sequence[LocatedEffect], values: np.ndarray) -> np.ndarray:
        """Return the weighted rows (m,) of nominal values and effects with values (p,)."""
        begin = len(self.priors[0])
        rows = self.columns.nominal_rows(values[:begin])
        for located in effects:
            end = begin + len(located.effect.amplitudes)
            rows += self.columns.effect_rows(located, values[begin:end])
            begin = end
        return self._whiten_rows(rows)

    @cached_property
    def target(self) -> np.ndarray:
        """Weighted residual of the nominal model in the measured channels (m,)."""
        return self._whiten_rows(self.columns.target.copy())

    def effect_columns(self, located: LocatedEffect) -> np.ndarray:
        """Return the weighted columns (m, k) of an effect's amplitudes over their sizes."""
        return self._whiten_rows(self.columns.effect_columns(located))

    def sums(self, effects: Sequence[LocatedEffect] = ()) -> ModelSums:
        """Return the sums of nominal values and effects, and a function for further effects."""
        if self.columns.initial_state_columns.size:
            # Initial vibration couples all rows of a run.
            columns = self.stack_columns(effects)
            rows = BlockSums(columns, self.target, self.rows.block, self.blocks)
            return ModelSums(rows.own, lambda each: rows.added_sums(self.effect_columns(each)))
        pieces = self.columns.pieces
        weight = self.inflation[pieces.channel] ** -2.0
        products = [self.columns.products(e) for e in effects]
        weighted = WeightedSums(self.columns.sums, products, weight)
        return ModelSums(
            weighted.own, lambda each: weighted.added_sums(self.columns.products(each))
        )

    def _whiten_rows(self, columns: np.ndarray) -> np.ndarray:
        """Return rows over the noise, in place; initial vibration counts as noise."""
        np.multiply(columns.T, self._row_weight, out=columns.T)
        along, kept = self._initial_state_directions
        if along.size:
            columns -= along @ (((1.0 - kept) * (along.T @ columns).T).T)
        return columns

    @cached_property
    def _initial_state_directions(self) -> tuple[np.ndarray, np.ndarray]:
        """Directions (m, r) of initial vibration in the rows, and the shares kept."""
        columns = self.columns.initial_state_columns * self._row_weight[:, None]
        along, sizes, _ = np.linalg.svd(columns, full_matrices=False)
        return along, 1.0 / np.sqrt(1.0 + sizes**2)

    # ---- fits

    def fit(self, effects: Sequence[LocatedEffect] = (), *, boxed: bool = True) -> Fit:
        """Fit nuisance values and effects together; `boxed` bounds the nuisance values."""
        _, sd = self.priors
        prior = np.concatenate([sd, np.ones(sum(len(e.effect.amplitudes) for e in effects))])
        sums = self.sums(effects).own
        found = posterior(sums, prior, cross_validate=False)
        if boxed:
            gram, moment = sums.gram.sum(axis=0), sums.moment.sum(axis=0)
            found = replace(found, mean=self.within_bounds(found.mean, gram, moment, prior))
        residual = (self.target - self.model_rows(effects, found.mean)) / self._row_weight
        return Fit(tuple(effects), found, residual, len(sd))

    def limits(self, count: int) -> np.ndarray:
        """Bounds (count,) of nuisance values and amplitudes, in standard deviations of priors.

        Amplitudes and free bodies have none; bodies must be consistent instead.
        """
        found = np.full(count, np.inf)
        first = 0 if self.bodies is None else self.bodies.size
        found[first : len(self.priors[1])] = MAX_NOMINAL_DEVIATIONS
        return found

    def within_bounds(
        self, mean: np.ndarray, gram: np.ndarray, moment: np.ndarray, prior: np.ndarray
    ) -> np.ndarray:
        """Return the likeliest values (p,) within limits and with physically consistent bodies.

        `mean` (p,): likeliest without bounds. `gram` (p, p), `moment` (p,): of the rows. `prior`
        (p,): standard deviations.
        """
        limits = self.limits(len(prior))
        if np.any(np.abs(mean / prior) > limits):
            mean = solve_boxed(gram, moment, prior, limits)
        if self.bodies is None:
            return mean
        nominal, units = nominal_bodies(self.robot), body_units(self.robot)
        place = slice(0, nominal.size)
        if is_consistent(nominal + mean[place].reshape(nominal.shape), units):
            return mean
        whole = gram + np.diag(prior**-2.0)
        return likeliest_consistent_bodies(whole, moment, place, nominal, units, limits * prior)

    def channel_ratio(self, residual: np.ndarray) -> np.ndarray:
        """Return the rms of whitened residuals per channel (2 n,); nan without rows."""
        square = np.bincount(self.rows.channel, residual**2, minlength=2 * self.robot.n)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.sqrt(square / self.rows.counts))


def solve_boxed(
    gram: np.ndarray, moment: np.ndarray, prior: np.ndarray, limits: np.ndarray
) -> np.ndarray:
    """Return the likeliest values (p,) within bounds in standard deviations of the priors."""
    root = np.linalg.cholesky(gram * np.outer(prior, prior) + np.eye(len(prior)))
    goal = solve_triangular(root, prior * moment, lower=True)
    return np.asarray(prior * lsq_linear(root.T, goal, (-limits, limits)).x)
