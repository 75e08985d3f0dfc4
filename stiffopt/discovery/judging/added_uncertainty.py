"""Uncertainty beyond the likelihood: torque scale, other filter band; insignificant findings.

Errors of a law show only when values are estimated in several ways: from stretches and runs left
out, from half the band, beside the open residual of a model. Findings that are within this
uncertainty of zero are dropped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.located_effect import Extension
from stiffopt.discovery.comparison.prepared_run import prepare_run
from stiffopt.discovery.names import ValueName
from stiffopt.discovery.search.rivals import Selected
from stiffopt.discovery.search.uncertainty import Estimate, estimate_parameters
from stiffopt.discovery.thresholds import FINDING_DEVIATIONS
from stiffopt.discovery.training import Training

Found = tuple[tuple[Selected, ...], Estimate]


def drop_insignificant(
    selected: Sequence[Selected], estimated: Callable[[Sequence[Selected]], Found]
) -> Found:
    """Estimate findings, and drop insignificant ones one after another.

    `estimated` -> supported findings among the given ones, and their estimate.

    Calibrated values are kept: they exist without doubt.
    """
    while True:
        kept, parameters = estimated(selected)
        excess = [_excess_deviations(each, parameters, k) for k, each in enumerate(kept)]
        if not excess or min(excess) >= 0.0:
            return kept, parameters
        least = excess.index(min(excess))
        selected = [each for k, each in enumerate(kept) if k != least]


def _excess_deviations(selected: Selected, parameters: Estimate, index: int) -> float:
    """Return the significance of a finding less the required one [sigma]."""
    located = selected.located
    if located.calibrated:
        return 0.0
    return parameters.deviations(index) - FINDING_DEVIATIONS


def add_scale_deviation(parameters: Estimate, selected: Sequence[Selected]) -> Estimate:
    """Add the uncertainty of torque constants to the amplitudes.

    `selected`: the same effects; the torque constant is that of the channel that each changes most.

    Recorded torques are currents times torque constants with tolerances. All amplitudes of an
    effect share one scale, so that the uncertainty of their ratios does not change.
    """
    known = np.sqrt(np.diag(parameters.covariance))
    scales = []
    for each in selected:
        name = ValueName("torque_constant", each.channel)
        # Channels above the number of joints are angles.
        there = name in parameters.nuisance
        scales.append(float(known[parameters.nuisance.index(name)]) if there else 0.0)
    return parameters.scaled(scales)


# Factor on the cutoff.
_CUTOFF_FACTOR = 0.5
# Posterior over prior variance from which an amplitude is undetermined, so that its whole range is
# likely; and the largest range over its typical size.
_UNDETERMINED_SHARE, _MAX_AMPLITUDE_RANGE = 0.5, 100.0


def half_band_comparison(
    training: Training, comparison: Comparison, found: Extension
) -> Comparison | None:
    """Return the comparison of the same runs in half the band; None if no sample is left.

    `found`: nominal values and effects to linearise about, whose torques others read.
    """
    settings = replace(training.settings, cutoff=_CUTOFF_FACTOR * training.settings.fit_band)
    runs = [
        prepare_run(training.robot, run, k, training.constants, settings)
        for k, run in enumerate(training.recorded)
    ]
    if not all((run.torque_used.any() or run.deflection_used.any()) for run in runs):
        return None
    other = replace(training, runs=tuple(runs)).comparison().with_bodies(comparison.bodies)
    return other.with_extension(found, comparison.inflation)


def add_band_deviation(
    comparison: Comparison, other: Comparison | None, parameters: Estimate
) -> Estimate:
    """Add the difference to a fit in half the band as one standard deviation.

    A correct law gives the same values in every band; the difference shows errors of the law. With
    an extended model it is reduced by the difference expected by chance, whose variance is the
    difference of the variances (Hausman 1978). Otherwise variances are too small for that.

    `comparison`: with the noise estimated beside the effects. `other`: in half the band.
    """
    if other is None or not parameters.effects:
        return parameters
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
    bounds = np.concatenate([e.located.bounds(comparison.constants) for e in parameters.effects])
    range_ = np.minimum(bounds[:, 1] - bounds[:, 0], _MAX_AMPLITUDE_RANGE)
    return parameters.doubted(np.where(own > _UNDETERMINED_SHARE, range_ / np.sqrt(12.0), away))


def excess_difference(away: np.ndarray, less: np.ndarray, more: np.ndarray) -> np.ndarray:
    """Return the difference of two estimates beyond chance (k,).

    `away` (k,). `less`, `more` (k,): variances of the estimate from fewer data, and of that from
    all data.
    """
    return np.asarray(np.sqrt(np.maximum(away**2 - np.maximum(less - more, 0.0), 0.0)))


def _larger_variances(estimated: Estimate) -> np.ndarray:
    """Return the larger variances of the linear model and the jackknife."""
    return np.asarray(np.maximum(np.diag(estimated.covariance), np.diag(estimated.spread)))
