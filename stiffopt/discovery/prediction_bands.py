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
from stiffopt.discovery.prediction import Predictor, used_samples
from stiffopt.discovery.settings import PREDICTION_CUTOFF
from stiffopt.discovery.training import Training

# Share of the least mean square that a wider band may cost: encoder noise is visible in the
# training runs, the needs of a faster motion are not.
_MAX_WIDER_BAND_COST = 0.05


def choose_prediction_bands(training: Training, found: Extension) -> tuple[float, ...]:
    """Return the band [Hz] for each joint in which the model predicts the training runs best."""
    tried = candidate_bands(training.recorded, PREDICTION_CUTOFF)
    errors = _torque_errors(training, found, tried)
    # The link motion of an elastic joint is computable only below its resonance.
    slower = int(np.searchsorted(tried, PREDICTION_CUTOFF, side="right"))
    counts = [slower if joint.elastic else len(tried) for joint in training.constants.joints]
    return tuple(
        _select_widest_adequate(tried[:count], column[:count])
        for count, column in zip(counts, errors.T, strict=True)
    )


def _torque_errors(training: Training, found: Extension, bands: Sequence[float]) -> np.ndarray:
    """Return the mean square errors (b, n) of unfiltered torques, by band; nan without samples."""
    n = training.robot.n
    usual = replace(training.settings, predict=(PREDICTION_CUTOFF,) * n)
    square, count = np.zeros((len(bands), n)), np.zeros((len(bands), n))
    for run in training.recorded:
        predictor = Predictor(replace(training, settings=usual), run)
        places = np.searchsorted(run.stamps, run.time)
        used = [each for each in used_samples(run, predictor.velocity) if each[0] == "torque"]
        for k, band in enumerate(bands):
            torque = predictor.torque(band, *training.before, found)
            for _, joint, samples in used:
                left = run.torque[samples, joint] - torque[places[samples], joint]
                square[k, joint] += float(left @ left)
                count[k, joint] += len(left)
    return np.asarray(np.divide(square, count, out=np.full(square.shape, np.nan), where=count > 0))


def _select_widest_adequate(tried: Sequence[float], errors: np.ndarray) -> float:
    """Return the widest band of an adequate error, to two digits.

    Between the last adequate band and the next the error is interpolated: a little less of the
    recordings moved an answer from one band to the next, and its residual by a tenth.
    """
    if not np.isfinite(errors).all():
        return PREDICTION_CUTOFF
    most = (1.0 + _MAX_WIDER_BAND_COST) * errors.min()
    last = int(np.flatnonzero(errors <= most)[-1])
    if last + 1 == len(tried):
        return tried[last]
    share = (most - errors[last]) / (errors[last + 1] - errors[last])
    return float(f"{tried[last] * (tried[last + 1] / tried[last]) ** share:.2g}")
