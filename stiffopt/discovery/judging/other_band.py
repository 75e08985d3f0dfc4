"""How sure values are where the law is not quite right: fitted again in half the band.

A law that holds gives the same values in every band, up to what a narrower band knows less of them.
One that does not, such as an inertia that a flexible joint hides from fast motion, gives others,
and how far they differ no noise tells.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.prepared_run import prepare_run
from stiffopt.discovery.search.uncertainty import Estimate, estimate
from stiffopt.discovery.training import Training

# Of the cutoff.
_NARROWER = 0.5
# Share of its prior variance from which an amplitude is not seen, so that all it can be is likely;
# without bounds, over its typical size.
_UNSEEN, _WIDEST = 0.5, 100.0


def doubted_by_band(training: Training, comparison: Comparison, parameters: Estimate) -> Estimate:
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
    settings = replace(training.settings, cutoff=_NARROWER * training.settings.fit_band)
    runs = [
        prepare_run(training.robot, run, k, training.constants, settings)
        for k, run in enumerate(training.recorded)
    ]
    if not all((run.torque_used.any() or run.deflection_used.any()) for run in runs):
        return parameters
    other = replace(training, runs=tuple(runs)).comparison().with_bodies(comparison.bodies)
    other = other.with_extension(comparison.columns.found, comparison.inflation)
    located = [each.located for each in parameters.effects]
    first, last = len(parameters.nuisance), len(parameters.values)
    if comparison.after_model:
        half = estimate(other, located)
        less = _variances(half)[len(half.nuisance) : len(half.values)]
        away = half.values[len(half.nuisance) :] - parameters.values[first:]
        away = beyond_chance(away, less, _variances(parameters)[first:last])
    else:
        away = other.fit(located).amplitudes() - parameters.values[first:]
    own = np.diag(parameters.covariance)[first:last]
    bounds = np.concatenate([e.located.bounds(training.constants) for e in parameters.effects])
    range_ = np.minimum(bounds[:, 1] - bounds[:, 0], _WIDEST)
    return parameters.doubted(np.where(own > _UNSEEN, range_ / np.sqrt(12.0), away))


def beyond_chance(away: np.ndarray, less: np.ndarray, more: np.ndarray) -> np.ndarray:
    """How far two estimates differ beyond what chance explains (k,), with their variances.

    Parameters
    ----------
    away : array (k,)
    less, more : array (k,)
        Variances of the one that knows less, and of the one that knows all that it knows.
    """
    return np.asarray(np.sqrt(np.maximum(away**2 - np.maximum(less - more, 0.0), 0.0)))


def _variances(estimated: Estimate) -> np.ndarray:
    """Of all values, by noise or by stretches of the recordings, whichever is larger."""
    return np.asarray(np.maximum(np.diag(estimated.covariance), np.diag(estimated.spread)))
