"""Predicted separation of two explanations on a motion [sigma]: the part no refit absorbs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.discovery.comparison.channel_rows import ChannelNoise
from stiffopt.discovery.comparison.comparison import Comparison, Fit
from stiffopt.discovery.comparison.design_matrix import DesignMatrix
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.comparison.prepared_run import PreparedRun
from stiffopt.discovery.names import ValueName


@dataclass(frozen=True, eq=False)
class _Explanation:
    """One explanation, fitted to the training runs."""

    names: list[ValueName]
    effects: tuple[LocatedEffect, ...]
    fit: Fit


class Separation:
    """Predicted separation of two explanations of the same training runs.

    `comparison`: of the training runs. `others`: effects common to both explanations.

    Both predict the channels of a motion with values fitted to the training runs. Amplitudes of one
    and nominal values are then refitted to the prediction of the other, with the posterior of the
    training runs as prior; the remaining difference is the separation, the lesser of both
    directions. This is the criterion of Box and Hill (1967) for a linear Gaussian model.
    """

    def __init__(
        self,
        comparison: Comparison,
        first: LocatedEffect,
        second: LocatedEffect,
        others: Sequence[LocatedEffect] = (),
    ) -> None:
        self.comparison = comparison
        names, _ = comparison.priors
        self.first, self.second = (
            _Explanation(names, effects, comparison.fit(effects))
            for effects in ((first, *others), (second, *others))
        )

    def of(self, run: PreparedRun, *, step: float | None = None) -> float:
        """Return the separation on a motion [sigma].

        `step`: sampling time of the recording [s]; default: that of the run.
        """
        here = self._compare_along(run, step)
        parts = [self._parameter_columns(here, each) for each in (self.first, self.second)]
        means = [each.fit.posterior.mean for each in (self.first, self.second)]
        difference = parts[0] @ means[0] - parts[1] @ means[1]
        left = [
            _unabsorbed_square(difference, columns, each.fit.posterior.covariance)
            for columns, each in zip(parts, (self.first, self.second), strict=True)
        ]
        return float(np.sqrt(max(min(left), 0.0)))

    def _compare_along(self, run: PreparedRun, step: float | None) -> Comparison:
        base = self.comparison
        # More samples of the same motion lower the noise that passes the filter.
        finer = 1.0 if step is None else float(np.sqrt(step / run.signals.dt))
        noise = ChannelNoise(base.noise.torque * finer, base.noise.deflection * finer)
        along = replace(run, signals=replace(run.signals, constants=base.constants))
        columns = DesignMatrix(base.robot, (along,), noise, base.tolerance)
        return Comparison(columns, inflation=base.inflation)

    def _parameter_columns(self, here: Comparison, each: _Explanation) -> np.ndarray:
        names, _ = here.priors
        own = dict(zip(names, here.stack_columns().T, strict=True))
        nothing = np.zeros(here.rows.size)
        # A stationary joint has no column of friction.
        nuisance = [own.get(name, nothing) for name in each.names]
        effects = [here.effect_columns(located) for located in each.effects]
        return np.column_stack([*nuisance, *effects])


def _unabsorbed_square(difference: np.ndarray, columns: np.ndarray, spread: np.ndarray) -> float:
    """Return the chi-square of a difference after a refit with this prior covariance."""
    root = np.linalg.cholesky(spread + 1e-14 * np.diag(np.diag(spread)))
    reach = columns @ root
    inner = np.eye(len(spread)) + reach.T @ reach
    along = reach.T @ difference
    return float(difference @ difference - along @ np.linalg.solve(inner, along))
