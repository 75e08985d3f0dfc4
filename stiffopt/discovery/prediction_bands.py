"""Bands of the motion that torques are predicted from, selected with the fitted model.

A wide band follows reversals and pulses; a narrow one keeps the noise of twice differentiated
encoders out of the torque. How much noise passes depends on the inertia of the model: a fit with a
free inertia for every band would shrink it until the noise costs nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stiffopt.discovery.comparison.bands import candidate_bands
from stiffopt.discovery.comparison.located_effect import Extension
from stiffopt.discovery.prediction import Predictor, compare_predictions
from stiffopt.discovery.settings import PREDICTION_CUTOFF
from stiffopt.discovery.training import Training

# Share of the least mean square that a wider band may cost: encoder noise is visible in the
# training runs, the needs of a faster motion are not.
_MAX_WIDER_BAND_COST = 0.1


def choose_prediction_bands(
    training: Training, extensions: Sequence[Extension]
) -> tuple[float, ...]:
    """Return the band [Hz] for each joint in which the model predicts the training runs best.

    `extensions`: of the nominal model, each added to those before.
    """
    tried = candidate_bands(training.recorded, PREDICTION_CUTOFF)
    errors = np.array([_torque_errors(training, extensions, band) for band in tried])
    # The link motion of an elastic joint is computable only below its resonance.
    slower = int(np.searchsorted(tried, PREDICTION_CUTOFF, side="right"))
    counts = [slower if joint.elastic else len(tried) for joint in training.constants.joints]
    return tuple(
        _select_widest_adequate(tried[:count], column[:count])
        for count, column in zip(counts, errors.T, strict=True)
    )


def _torque_errors(training: Training, extensions: Sequence[Extension], band: float) -> np.ndarray:
    """Return the mean square error of every joint's unfiltered torque (n,); nan without any."""
    n = training.robot.n
    settings = replace(training.settings, predict=(band,) * n)
    square, count = np.zeros(n), np.zeros(n)
    for run in training.recorded:
        predictor = Predictor(training.robot, run, training.constants, settings)
        after = predictor.predict(*extensions)
        proof = compare_predictions(run, predictor.velocity, after, after, training.noise)
        for channel in proof.channels:
            if channel.kind == "torque":
                square[channel.joint] += channel.after
                count[channel.joint] += channel.samples
    mean = np.divide(square, count, out=np.full(n, np.nan), where=count > 0)
    return np.asarray(mean)


def _select_widest_adequate(tried: Sequence[float], errors: np.ndarray) -> float:
    if not np.isfinite(errors).all():
        return PREDICTION_CUTOFF
    most = (1.0 + _MAX_WIDER_BAND_COST) * errors.min()
    return max(band for band, error in zip(tried, errors, strict=True) if error <= most)
