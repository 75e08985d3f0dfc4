"""Refutation of findings by held-out runs, against models that are fitted without them.

Findings are chosen and fitted by the training runs alone. Held-out runs support none: they may
refute one. Values that training runs hardly determine may be far off in a faster motion, without a
doubt about the finding: refuted is a finding that predicts worse with any of its likely values.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import optimize, special

from stiffopt.discovery.comparison.channel_rows import part_numbers
from stiffopt.discovery.comparison.comparison import Comparison, Fit
from stiffopt.discovery.comparison.design_matrix import STRETCH_DURATION
from stiffopt.discovery.comparison.located_effect import Extension, LocatedEffect
from stiffopt.discovery.names import Channel
from stiffopt.discovery.prediction import Predictor, residuals

# Key of a located effect.
_Key = tuple[object, ...]
# Probability that the values of a finding are outside the region that is tried.
_OUTSIDE_PROBABILITY = 0.05


@dataclass(frozen=True)
class HeldOutEvidence:
    """Evidence of held-out runs on a finding."""

    # Root mean square residual of its channel with it over that of a model fitted without it.
    ratio: float
    # Likelihood of its gain over that of no gain, with the best of its likely values; 1 where it
    # gains. By the spread of the gain between stretches (Student's t): errors of a law are
    # correlated within a stretch, so that the number of samples says nothing.
    likelihood: float


@dataclass(frozen=True, eq=False)
class _StretchSums:
    """Sums over a stretch of a finding's channel."""

    without: float  # squared residuals without the finding
    # Products of the residual with it and of the changes by its values: the first row and column
    # are those of the residual.
    products: np.ndarray

    def residual(self, moved: np.ndarray) -> float:
        """Return the squared residuals with values moved (p,) over their deviations."""
        weights = np.append(1.0, -moved)
        return float(weights @ self.products @ weights)


@dataclass(eq=False)
class _Tested:
    """A finding under test: its channel, the models with and without it, and the sums so far."""

    channel: Channel
    without: Extension
    # Models with its values moved along the axes of their likely region, by one deviation each.
    moved: Sequence[Extension]
    sums: list[_StretchSums] = field(default_factory=list)

    def evidence(self) -> HeldOutEvidence | None:
        """Return the evidence; None where fewer than two stretches tell."""
        if len(self.sums) < 2:
            return None
        still = np.zeros(len(self.moved))
        best = _best_within(np.sum([each.products for each in self.sums], axis=0))
        without = np.array([each.without for each in self.sums])
        stated, likely = (
            np.array([each.residual(moved) for each in self.sums]) for moved in (still, best)
        )
        ratio = float(np.sqrt(stated.sum() / without.sum()))
        return HeldOutEvidence(ratio, _likelihood_of_gain(without - likely))


class Refutation:
    """Predictions of held-out runs by models that are fitted without one finding each.

    `comparison`: of the training runs, with the noise estimated beside `effects`, which are all
    that were fitted. `channels`: by the key of each effect to be tested, the channel that it
    changes most.
    """

    def __init__(
        self,
        comparison: Comparison,
        effects: Sequence[LocatedEffect],
        channels: Mapping[_Key, Channel],
    ) -> None:
        self._tested: dict[_Key, _Tested] = {}
        if not channels:
            return
        fit = comparison.fit(effects)
        self._whole = comparison.extension_of(fit)
        for key, channel in channels.items():
            others = [each for each in effects if each.key != key]
            self._tested[key] = _Tested(
                channel,
                comparison.extension_of(comparison.fit(others)),
                [comparison.extension_of(each) for each in _moved_fits(fit, key)],
            )

    def add(self, predictor: Predictor, start: Sequence[Extension]) -> None:
        """Add a run; `start`: extensions that the diagnosis started from."""
        if not self._tested:
            return
        run = predictor.run
        duration = float(run.time[-1] - run.time[0])
        part = part_numbers(run.time, max(1, round(duration / STRETCH_DURATION)))
        models = [self._whole]
        for own in self._tested.values():
            models += [own.without, *own.moved]
        predictions = predictor.predict_each([(*start, each) for each in models])
        whole = next(predictions)
        found: dict[_Key, list[_StretchSums]] = {}
        for key, own in self._tested.items():
            others = itertools.islice(predictions, 1 + len(own.moved))
            each = residuals(run, predictor.velocity, whole, *others)
            found[key] = list(own.sums)
            for kind, joint, used, (beside, without, *moved) in each:
                if (kind, joint + 1) == own.channel:
                    columns = np.column_stack([beside, *(beside - other for other in moved)])
                    found[key] += _sums_by_stretch(part[used], without, columns)
        # Assigned last: after Ctrl-C a run is added as a whole or not at all.
        for key, sums in found.items():
            self._tested[key].sums = sums

    def evidence(self) -> dict[_Key, HeldOutEvidence]:
        """Return the evidence by key; without those of which fewer than two stretches tell."""
        found = {key: own.evidence() for key, own in self._tested.items()}
        return {key: own for key, own in found.items() if own is not None}


def _moved_fits(fit: Fit, key: _Key) -> list[Fit]:
    """Return fits with the values of an effect moved by a deviation along each of their axes.

    All others are moved with them as the fit relates them.
    """
    first = fit.nuisance
    for located in fit.effects:
        rows = slice(first, first + len(located.effect.amplitudes))
        if located.key == key:
            break
        first = rows.stop
    mean, covariance = fit.posterior.mean, fit.posterior.covariance
    variances, axes = np.linalg.eigh(covariance[rows, rows])
    steps = covariance[:, rows] @ axes / np.sqrt(np.maximum(variances, np.finfo(float).tiny))
    return [replace(fit, posterior=replace(fit.posterior, mean=mean + step)) for step in steps.T]


def _sums_by_stretch(
    part: np.ndarray, without: np.ndarray, columns: np.ndarray
) -> list[_StretchSums]:
    found = []
    for number in np.unique(part):
        own = part == number
        sums = _StretchSums(float(without[own] @ without[own]), columns[own].T @ columns[own])
        if sums.without and sums.products[0, 0]:
            found.append(sums)
    return found


def _best_within(products: np.ndarray) -> np.ndarray:
    """Return the values (p,) over their deviations of the least residual in their likely region."""
    count = len(products) - 1
    curvature, axes = np.linalg.eigh(products[1:, 1:])
    slope = axes.T @ products[1:, 0]
    radius = float(np.sqrt(special.chdtri(count, _OUTSIDE_PROBABILITY)))
    curvature = np.maximum(curvature, np.finfo(float).eps * max(curvature[-1], 0.0))
    if not slope.any():
        return np.zeros(count)

    def moved(damping: float) -> np.ndarray:
        return np.asarray(slope / np.maximum(curvature + damping, np.finfo(float).tiny))

    def beyond(damping: float) -> float:
        return float(np.linalg.norm(moved(damping))) - radius

    most = float(np.linalg.norm(slope)) / radius
    damping = optimize.brentq(beyond, 0.0, most) if beyond(0.0) > 0.0 else 0.0
    return np.asarray(axes @ moved(damping))


def _likelihood_of_gain(gains: np.ndarray) -> float:
    """Return the likelihood ratio of a mean gain (b,) of zero or more to the mean that is seen."""
    count, mean, spread = len(gains), float(gains.mean()), float(gains.std(ddof=1))
    if mean >= 0.0:
        return 1.0
    deviation = mean / max(spread, 1e-300) * np.sqrt(count)
    return float((1.0 + deviation**2 / (count - 1)) ** (-0.5 * count))
