"""The comparison of training runs with the nominal model: rows, nuisance, residual."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear

from stiffopt.discovery.comparison.channel_rows import ChannelNoise
from stiffopt.discovery.comparison.design_matrix import (
    MAX_LINEARISATION_ERROR,
    MIN_RUNS_AS_BLOCKS,
    DesignMatrix,
)
from stiffopt.discovery.comparison.evidence import (
    AddedSums,
    BlockSums,
    Posterior,
    Sums,
    posterior,
)
from stiffopt.discovery.comparison.inertial_parameters import (
    body_units,
    is_consistent,
    likeliest_consistent_bodies,
    nominal_bodies,
)
from stiffopt.discovery.comparison.located_effect import Extension, LocatedEffect, with_amplitudes
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.piece_sums import WeightedSums
from stiffopt.discovery.comparison.prepared_run import PreparedRun
from stiffopt.recording.nominal import Tolerance

# Of a nominal model that nobody has compared yet.
_NO_SUSPECTS: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True, eq=False)
class Fit:
    """Rows fitted by nominal values within tolerance and by effects.

    Parameters
    ----------
    effects : tuple of LocatedEffect
    posterior : Posterior
        Of the nuisance values, then the amplitudes over their sizes.
    residual : array (m,)
        Whitened by the stated noise.
    """

    effects: tuple[LocatedEffect, ...]
    posterior: Posterior
    residual: np.ndarray
    nuisance: int

    def evidence_losses(self) -> np.ndarray:
        """Log evidence that is lost without each effect, the others kept.

        The density that prior and posterior give to the amplitude zero, one over the other.
        """
        lost, begin = [], self.nuisance
        for located in self.effects:
            part = slice(begin, begin + len(located.effect.amplitudes))
            mean, covariance = self.posterior.mean[part], self.posterior.covariance[part, part]
            chi = float(mean @ np.linalg.solve(covariance, mean))
            lost.append(0.5 * (chi + float(np.linalg.slogdet(covariance)[1])))
            begin = part.stop
        return np.array(lost)

    def amplitudes(self) -> np.ndarray:
        """Amplitudes of all effects over their sizes, one after another."""
        return self.posterior.mean[self.nuisance :]


@dataclass(frozen=True, eq=False)
class ModelSums:
    """Sums of squares of a model's columns.

    Parameters
    ----------
    own : Sums
        Of the nominal values, then the amplitudes over their sizes.
    added_sums : callable
        -> sums of an effect's columns beside those.
    """

    own: Sums
    added_sums: Callable[[LocatedEffect], AddedSums]


class Comparison:
    """Training runs against the nominal model.

    Parameters
    ----------
    robot : RobotModel
    runs : sequence of PreparedRun
        With the nominal model.
    noise : ChannelNoise
    tolerance : Tolerance
    start : Extension, optional
        What the model that is compared has beyond the nominal one.
    inflation : array (2 n,), optional
        Factor on the noise of every channel, for what the model leaves unexplained there.
    box : float
        Nominal values stay within so many standard deviations.
    least : array (2 n,), optional
        Least of these factors: what the model that is started from left of its own recordings;
        nan where it has seen none.
    suspects : mapping of str to float
        Effects by their labels that this hints at by itself, with log evidence for a row: of them
        as much is no evidence.
    columns : Columns, optional
        Of these runs, about what was found already.
    """

    def __init__(
        self,
        robot: RobotModel,
        runs: Sequence[PreparedRun],
        noise: ChannelNoise,
        tolerance: Tolerance,
        *,
        start: Extension | None = None,
        inflation: np.ndarray | None = None,
        box: float = 4.0,
        least: np.ndarray | None = None,
        suspects: Mapping[str, float] = _NO_SUSPECTS,
        columns: DesignMatrix | None = None,
    ) -> None:
        self.robot, self.noise, self.tolerance, self.box = robot, noise, tolerance, box
        self.nominal_runs, self.start = tuple(runs), start or Extension()
        self.columns = columns or DesignMatrix(
            robot, self.nominal_runs, noise, tolerance, self.start, Extension()
        )
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
        """Weight of every row beside the stated noise."""
        return np.asarray(1.0 / self.inflation[self.rows.channel])

    def linearised_at(self, fit: Fit, near: float = MAX_LINEARISATION_ERROR) -> Comparison:
        """The comparison about a fit: links that move as found, the noise left in each channel.

        Parameters
        ----------
        fit : Fit
        near : float
            Rms over that noise of what links may do otherwise before they are followed anew.
        """
        left = np.nan_to_num(self.channel_ratio(fit.residual), nan=1.0)
        return self.with_extension(self.extension_of(fit), np.maximum(self.least, left), near)

    def extension_of(self, fit: Fit) -> Extension:
        """Values and effects of a fit."""
        names = self.nuisance[0]
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
        """The comparison about an extension, with another factor on the noise (2 n,)."""
        return Comparison(
            self.robot,
            self.nominal_runs,
            self.noise,
            self.tolerance,
            start=self.start,
            inflation=inflation,
            box=self.box,
            least=self._least_known,
            suspects=self.suspects,
            columns=self.columns.linearised_at(
                found, self.least if inflation is None else inflation, near
            ),
        )

    def with_runs(self, runs: Sequence[PreparedRun]) -> Comparison:
        """The comparison of other runs with the same model."""
        return Comparison(
            self.robot,
            runs,
            self.noise,
            self.tolerance,
            start=self.start,
            box=self.box,
            least=self._least_known,
            suspects=self.suspects,
        )

    @property
    def blocks_are_runs(self) -> bool:
        """Whether blocks are whole runs."""
        return len(self.runs) >= MIN_RUNS_AS_BLOCKS

    @property
    def bodies(self) -> np.ndarray | None:
        """Standard deviations of all inertial parameters (n, 10), where they are free."""
        return self.columns.bodies

    def with_bodies(self, bodies: np.ndarray | None) -> Comparison:
        """The comparison with inertial parameters free (n, 10), in place of masses and centres."""
        return Comparison(
            self.robot,
            self.nominal_runs,
            self.noise,
            self.tolerance,
            start=self.start,
            inflation=self.inflation,
            box=self.box,
            least=self._least_known,
            suspects=self.suspects,
            columns=self.columns.with_bodies(bodies),
        )

    def inherited_evidence(self, located: LocatedEffect) -> float:
        """Log evidence for an effect that the model which was started from left behind."""
        return self.suspects.get(located.label, 0.0) * self.rows.size

    @property
    def max_inherited_evidence(self) -> float:
        """The largest of these."""
        return max(self.suspects.values(), default=0.0) * self.rows.size

    # ---- columns, weighted

    @cached_property
    def nuisance(self) -> tuple[list[str], np.ndarray, np.ndarray]:
        """Names, priors and columns (m, p) of the nominal values."""
        names, sd, columns = self.columns.nuisance
        return names, sd, self._whiten(columns)

    @cached_property
    def target(self) -> np.ndarray:
        """What the nominal model leaves of the measured channels (m,), weighted."""
        return self._whiten(self.columns.target)

    def effect_columns(self, located: LocatedEffect) -> np.ndarray:
        """Columns (m, k) of an effect's amplitudes over their sizes."""
        return self._whiten(self.columns.effect_columns(located))

    def sums(self, effects: Sequence[LocatedEffect] = ()) -> ModelSums:
        """Sums of nominal values and effects together, and of what is put beside them."""
        if self.columns.initial_state_columns.size:
            # What may be the swing of a start mixes the rows of a run.
            _, _, nuisance = self.nuisance
            columns = np.column_stack([nuisance, *(self.effect_columns(e) for e in effects)])
            rows = BlockSums(columns, self.target, self.rows.block, self.blocks)
            return ModelSums(rows.own, lambda each: rows.added_sums(self.effect_columns(each)))
        pieces = self.columns.pieces
        weight = self.inflation[pieces.channel] ** -2.0
        products = [self.columns.products(e) for e in effects]
        weighted = WeightedSums(self.columns.sums, products, weight)
        return ModelSums(
            weighted.own, lambda each: weighted.added_sums(self.columns.products(each))
        )

    def _whiten(self, columns: np.ndarray) -> np.ndarray:
        """Rows over the noise; what may be the swing that a run began with counts as noise."""
        weighted = (columns.T * self._row_weight).T
        along, kept = self._initial_state_directions
        if along.size:
            weighted -= along @ (((1.0 - kept) * (along.T @ weighted).T).T)
        return np.asarray(weighted)

    @cached_property
    def _initial_state_directions(self) -> tuple[np.ndarray, np.ndarray]:
        """Directions (m, r) of the rows that the unknown start of runs has, the share kept."""
        columns = self.columns.initial_state_columns * self._row_weight[:, None]
        along, sizes, _ = np.linalg.svd(columns, full_matrices=False)
        return along, 1.0 / np.sqrt(1.0 + sizes**2)

    # ---- fits

    def fit(self, effects: Sequence[LocatedEffect] = (), *, boxed: bool = True) -> Fit:
        """Fit nuisance values, in their box unless told otherwise, and effects together."""
        _, sd, nuisance = self.nuisance
        parts = [nuisance, *(self.effect_columns(e) for e in effects)]
        columns = np.column_stack(parts)
        prior = np.concatenate([sd, np.ones(columns.shape[1] - len(sd))])
        sums = self.sums(effects).own
        found = posterior(sums, prior, cross_validate=False)
        limits = np.full(len(prior), np.inf)
        limits[: len(sd)] = self.box
        free = 0 if self.bodies is None else self.bodies.size
        limits[:free] = np.inf
        if boxed and np.any(np.abs(found.mean / prior) > limits):
            found = replace(found, mean=_solve_boxed(sums, prior, limits))
        if boxed and free:
            found = replace(found, mean=self._make_consistent(found.mean, sums, prior, limits))
        residual = (self.target - columns @ found.mean) / self._row_weight
        return Fit(tuple(effects), found, residual, len(sd))

    def _make_consistent(
        self, mean: np.ndarray, sums: Sums, prior: np.ndarray, limits: np.ndarray
    ) -> np.ndarray:
        """Likeliest values (p,) whose bodies can exist; as they are where they can."""
        nominal, units = nominal_bodies(self.robot), body_units(self.robot)
        place = slice(0, nominal.size)
        if is_consistent(nominal + mean[place].reshape(nominal.shape), units):
            return mean
        gram = sums.gram.sum(axis=0) + np.diag(prior**-2.0)
        moment = sums.moment.sum(axis=0)
        return likeliest_consistent_bodies(gram, moment, place, nominal, units, limits * prior)

    def channel_ratio(self, residual: np.ndarray) -> np.ndarray:
        """Root mean square of whitened residuals in every channel (2 n,); nan without rows."""
        square = np.bincount(self.rows.channel, residual**2, minlength=2 * self.robot.n)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.sqrt(square / self.rows.counts))


def _solve_boxed(sums: Sums, prior: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Likeliest values (p,) within so many standard deviations of their priors."""
    scaled = sums.gram.sum(axis=0) * np.outer(prior, prior) + np.eye(len(prior))
    root = np.linalg.cholesky(scaled)
    goal = solve_triangular(root, prior * sums.moment.sum(axis=0), lower=True)
    return np.asarray(prior * lsq_linear(root.T, goal, (-limits, limits)).x)
