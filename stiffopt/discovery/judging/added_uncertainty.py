"""Findings whose own deviations say that they may be nothing: no findings.

Likelihood has found them, and what is not quite right with the law is known only once values are
asked in other ways: from stretches and runs left out, from half the band, from what a model left of
its own recordings. Where these leave a value within its own uncertainty, nobody can use it, and a
data sheet or one more recording refutes it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.prepare import prepare
from stiffopt.discovery.search.rivals import Selected
from stiffopt.discovery.search.uncertainty import Estimate, estimate_parameters
from stiffopt.discovery.thresholds import (
    FINDING_DEVIATIONS,
    FINDING_SHARE,
    UNSTATED_DEVIATIONS,
)
from stiffopt.discovery.training import Training

Found = tuple[tuple[Selected, ...], Estimate]


def drop_insignificant(
    selected: Sequence[Selected],
    estimated: Callable[[Sequence[Selected]], Found],
    explained: Callable[[Sequence[Selected]], Sequence[float]] | None = None,
) -> Found:
    """What was found and how sure it is, without what may be nothing: one after another.

    Parameters
    ----------
    selected : sequence of Selected
    estimated : callable
        -> those of some findings that are borne out, and all that is known of their values.
    explained : callable, optional
        -> share of its channel that each takes away in recordings left out; what takes nothing
        that can be told explains nothing.

    Notes
    -----
    What every joint has and the nominal model does not give needs no more than to be larger than
    its deviation: nobody doubts that it is there.
    """
    while True:
        kept, parameters = estimated(selected)
        excess = [_excess_deviations(each, parameters, k) for k, each in enumerate(kept)]
        if explained is not None and kept and min(excess) >= 0.0:
            # Of what every joint has nobody doubts that it is there.
            excess = [
                0.0 if each.located.effect.nominal else share - FINDING_SHARE
                for each, share in zip(kept, explained(kept), strict=True)
            ]
        if not excess or min(excess) >= 0.0:
            return kept, parameters
        least = excess.index(min(excess))
        selected = [each for k, each in enumerate(kept) if k != least]


def _excess_deviations(selected: Selected, parameters: Estimate, index: int) -> float:
    """Deviations from nothing beyond those that a finding has to have."""
    asked = UNSTATED_DEVIATIONS if selected.located.effect.nominal else FINDING_DEVIATIONS
    return parameters.min_deviations(index) - asked


def add_scale_deviation(parameters: Estimate, selected: Sequence[Selected]) -> Estimate:
    """The estimate, where what the fit leaves open of a joint's scale counts as a deviation more.

    Parameters
    ----------
    parameters : Estimate
    selected : sequence of Selected
        The same effects; the scale is that of the channel that each changes most.

    Notes
    -----
    All amplitudes of an effect share one scale, so that their ratios are as sure as before.
    """
    known = np.sqrt(np.diag(parameters.covariance))
    scales = []
    for each in selected:
        name = f"torque_constant {each.channel + 1}"
        # Channels behind the last joint are angles.
        there = name in parameters.nuisance
        scales.append(float(known[parameters.nuisance.index(name)]) if there else 0.0)
    return parameters.scaled(scales)


# Of the cutoff.
_CUTOFF_FACTOR = 0.5
# Share of its prior variance from which an amplitude is not seen, so that all it can be is likely;
# without bounds, over its typical size.
_UNDETERMINED_SHARE, _MAX_AMPLITUDE_RANGE = 0.5, 100.0


def add_band_deviation(
    training: Training, comparison: Comparison, parameters: Estimate
) -> Estimate:
    """The estimate, where what half the band says otherwise counts as one standard deviation.

    Where an extended model was started from, less what it may say otherwise by chance: of two
    estimates of which one has all that the other has, the difference varies as their variances
    differ (Hausman 1978). Elsewhere everything may be missing, and variances are too small.

    Parameters
    ----------
    training : Training
    comparison : Comparison
        With the noise that the effects leave.
    parameters : Estimate
    """
    if not parameters.effects:
        return parameters
    settings = replace(training.settings, cutoff=_CUTOFF_FACTOR * training.settings.fit_band)
    runs = [
        prepare(training.robot, run, k, training.constants, settings)
        for k, run in enumerate(training.recorded)
    ]
    if not all((run.torque_used.any() or run.deflection_used.any()) for run in runs):
        return parameters
    other = replace(training, runs=tuple(runs)).comparison().with_bodies(comparison.bodies)
    other = other.moved(comparison.columns.found, comparison.inflation)
    located = [each.located for each in parameters.effects]
    first, last = len(parameters.nuisance), len(parameters.values)
    if comparison.after_model:
        half = estimate_parameters(other, located)
        less = _larger_variances(half)[len(half.nuisance) : len(half.values)]
        away = half.values[len(half.nuisance) :] - parameters.values[first:]
        away = excess_difference(away, less, _larger_variances(parameters)[first:last])
    else:
        away = other.fit(located).amplitudes() - parameters.values[first:]
    own = np.diag(parameters.covariance)[first:last]
    bounds = np.concatenate([e.located.bounds(training.constants) for e in parameters.effects])
    range_ = np.minimum(bounds[:, 1] - bounds[:, 0], _MAX_AMPLITUDE_RANGE)
    return parameters.doubted(np.where(own > _UNDETERMINED_SHARE, range_ / np.sqrt(12.0), away))


def excess_difference(away: np.ndarray, less: np.ndarray, more: np.ndarray) -> np.ndarray:
    """How far two estimates differ beyond what chance explains (k,), with their variances.

    Parameters
    ----------
    away : array (k,)
    less, more : array (k,)
        Variances of the one that knows less, and of the one that knows all that it knows.
    """
    return np.asarray(np.sqrt(np.maximum(away**2 - np.maximum(less - more, 0.0), 0.0)))


def _larger_variances(estimated: Estimate) -> np.ndarray:
    """Of all values, by noise or by stretches of the recordings, whichever is larger."""
    return np.asarray(np.maximum(np.diag(estimated.covariance), np.diag(estimated.spread)))
