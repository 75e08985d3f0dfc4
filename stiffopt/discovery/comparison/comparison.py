"""The comparison of training runs with the nominal model: rows, nuisance, residual."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear

from stiffopt.discovery.comparison.bodies import (
    body_units,
    exist,
    nearest_bodies,
    nominal_bodies,
)
from stiffopt.discovery.comparison.evidence import BlockSums, Posterior, Sums, posterior
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.nuisance import NuisanceColumn, nuisance_columns
from stiffopt.discovery.comparison.prepare import PreparedRun, with_link_torque
from stiffopt.discovery.comparison.rows import ChannelNoise, ChannelRows
from stiffopt.recording.nominal import Tolerance

# Blocks a run is cut into where there are too few runs to leave one out.
FEW_RUNS = 3
_BLOCK_SECONDS = 2.0
_MOST_BLOCKS = 8
# Columns that are kept for the next time they are asked for.
_KEPT = 64


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

    def losses(self) -> np.ndarray:
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


class Comparison:
    """Training runs against the nominal model.

    Parameters
    ----------
    robot : RobotModel
    runs : sequence of PreparedRun
    noise : ChannelNoise
    tolerance : Tolerance
    link_torque : sequence of array (K, n), optional
        Of effects already found, one a run; laws that bend are taken about it.
    inflation : array (2 n,), optional
        Factor on the noise of every channel, for what the model leaves unexplained there.
    box : float
        Nominal values stay within so many standard deviations.
    bodies : array (n, 10), optional
        Standard deviations of all inertial parameters, where they are free: in place of the
        tolerances of masses and centres.
    """

    def __init__(
        self,
        robot: RobotModel,
        runs: Sequence[PreparedRun],
        noise: ChannelNoise,
        tolerance: Tolerance,
        *,
        link_torque: Sequence[np.ndarray] | None = None,
        inflation: np.ndarray | None = None,
        box: float = 4.0,
        bodies: np.ndarray | None = None,
    ) -> None:
        self.robot, self.noise, self.tolerance, self.box = robot, noise, tolerance, box
        self.bodies = bodies
        self.nominal_runs = tuple(runs)
        self.link_torque = link_torque
        if link_torque is not None:
            runs = [
                with_link_torque(run, robot, added)
                for run, added in zip(runs, link_torque, strict=True)
            ]
        self.runs = tuple(runs)
        self.constants = self.runs[0].signals.constants
        self.whole_runs = len(self.runs) >= FEW_RUNS
        self.rows = ChannelRows(self.runs, noise, self._blocks())
        self.blocks = int(self.rows.block.max()) + 1
        self._kept: dict[tuple[object, ...], np.ndarray] = {}
        self.inflation = np.ones(2 * robot.n) if inflation is None else inflation

    def _blocks(self) -> int:
        if self.whole_runs:
            return 1
        seconds = min(float(run.time[-1] - run.time[0]) for run in self.runs)
        return int(np.clip(seconds / _BLOCK_SECONDS, 2, _MOST_BLOCKS))

    @cached_property
    def _weight(self) -> np.ndarray:
        """Weight of every row beside the stated noise."""
        return np.asarray(1.0 / self.inflation[self.rows.channel])

    # ---- columns, weighted

    @cached_property
    def nuisance(self) -> tuple[list[str], np.ndarray, np.ndarray]:
        """Names, priors and columns (m, p) of the nominal values."""
        per_run: list[list[NuisanceColumn]] = [
            list(nuisance_columns(run, self.robot, self.tolerance, self.bodies))
            for run in self.runs
        ]
        columns = []
        for each in zip(*per_run, strict=True):
            columns.append(self._column([c.torque for c in each], [c.deflection for c in each]))
        first = per_run[0]
        matrix = np.column_stack(columns) if columns else np.zeros((self.rows.size, 0))
        return [c.name for c in first], np.array([c.sd for c in first]), matrix

    @cached_property
    def target(self) -> np.ndarray:
        """What the nominal model leaves of the measured channels (m,), weighted."""
        torque, deflection = [], []
        for index, run in enumerate(self.runs):
            signals = run.signals
            drive, windup = signals.drive_torque, signals.windup
            if self.link_torque is not None:
                # Amplitudes stay whole: what their own share of the link torque does comes back.
                added = self.link_torque[index]
                drive = drive - added
                windup = windup - self.robot.compliance(signals.spring_torque) * added
            torque.append(bridged(run.torque) - drive)
            deflection.append(bridged(run.deflection) - windup)
        return self._column(torque, deflection)

    def effect_columns(self, located: LocatedEffect) -> np.ndarray:
        """Columns (m, k) of an effect's amplitudes over their sizes."""
        key = located.key
        if key not in self._kept:
            self._kept[key] = self._effect_columns(located)
            if len(self._kept) > _KEPT:
                self._kept.pop(next(iter(self._kept)))
        return self._kept[key]

    def _effect_columns(self, located: LocatedEffect) -> np.ndarray:
        per_run = [list(located.columns(run, self.robot)) for run in self.runs]
        sizes = located.sizes(self.constants)
        columns = [
            size * self._column([c[0] for c in each], [c[1] for c in each])
            for size, each in zip(sizes, zip(*per_run, strict=True), strict=True)
        ]
        return np.column_stack(columns)

    def _column(
        self, torque: Sequence[np.ndarray | None], deflection: Sequence[np.ndarray | None]
    ) -> np.ndarray:
        return np.asarray(self.rows.flatten(torque, deflection) * self._weight)

    # ---- fits

    def fit(self, effects: Sequence[LocatedEffect] = (), *, boxed: bool = True) -> Fit:
        """Fit nuisance values, in their box unless told otherwise, and effects together."""
        _, sd, nuisance = self.nuisance
        parts = [nuisance, *(self.effect_columns(e) for e in effects)]
        columns = np.column_stack(parts)
        prior = np.concatenate([sd, np.ones(columns.shape[1] - len(sd))])
        sums = BlockSums(columns, self.target, self.rows.block, self.blocks).own
        found = posterior(sums, prior, cross_validate=False)
        limits = np.full(len(prior), np.inf)
        limits[: len(sd)] = self.box
        free = 0 if self.bodies is None else self.bodies.size
        limits[:free] = np.inf
        if boxed and np.any(np.abs(found.mean / prior) > limits):
            found = replace(found, mean=_within(sums, prior, limits))
        if boxed and free:
            found = replace(found, mean=self._of_matter(found.mean, sums, prior, limits))
        residual = (self.target - columns @ found.mean) / self._weight
        return Fit(tuple(effects), found, residual, len(sd))

    def _of_matter(
        self, mean: np.ndarray, sums: Sums, prior: np.ndarray, limits: np.ndarray
    ) -> np.ndarray:
        """Likeliest values (p,) whose bodies can exist; as they are where they can."""
        nominal, units = nominal_bodies(self.robot), body_units(self.robot)
        place = slice(0, nominal.size)
        if exist(nominal + mean[place].reshape(nominal.shape), units):
            return mean
        gram = sums.gram.sum(axis=0) + np.diag(prior**-2.0)
        moment = sums.moment.sum(axis=0)
        return nearest_bodies(gram, moment, place, nominal, units, limits * prior)

    def channel_ratio(self, residual: np.ndarray) -> np.ndarray:
        """Root mean square of whitened residuals in every channel (2 n,); nan without rows."""
        square = np.bincount(self.rows.channel, residual**2, minlength=2 * self.robot.n)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.sqrt(square / self.rows.counts))


def _within(sums: Sums, prior: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Likeliest values (p,) within so many standard deviations of their priors."""
    scaled = sums.gram.sum(axis=0) * np.outer(prior, prior) + np.eye(len(prior))
    root = np.linalg.cholesky(scaled)
    goal = solve_triangular(root, prior * sums.moment.sum(axis=0), lower=True)
    return np.asarray(prior * lsq_linear(root.T, goal, (-limits, limits)).x)


def bridged(samples: np.ndarray) -> np.ndarray:
    """Single missing samples bridged for the filter; whole missing channels are zero."""
    out = np.where(np.isfinite(samples), samples, 0.0)
    for j in range(samples.shape[1]):
        missing = ~np.isfinite(samples[:, j])
        if missing.any() and not missing.all():
            places = np.arange(len(samples))
            out[missing, j] = np.interp(places[missing], places[~missing], samples[~missing, j])
    return out
