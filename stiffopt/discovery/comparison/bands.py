"""Bandwidth of a fit, selected by cross-validation for every set.

A wide band follows reversals and pulses; a narrow one keeps the noise of twice differentiated
encoders out of the torque. Which is better depends on the recordings: for every band a small linear
model (bodies, rotor, dry and viscous friction, offset) is fitted to some stretches of the measured
torque and predicts the others, unfiltered.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.discovery.comparison.filtering import (
    ROWS_PER_CYCLE,
    ZeroPhaseFilter,
    bridge_gaps,
    derivative,
    near_gaps,
    resample_uniform,
)
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.prepared_run import quasi_static_links
from stiffopt.discovery.signals import smooth_sign
from stiffopt.recording.run import RecordedRun

# Candidate bands [Hz], as far as the sampling rate admits.
BANDS = (4.0, 6.0, 8.0, 12.0, 20.0, 35.0, 60.0, 100.0, 150.0)
# Range of the fit's band [Hz]: wider ones have too many rows, narrower ones too few.
_MIN_FIT_BAND, _MAX_FIT_BAND = 8.0, 100.0
# Highest band over the sampling rate.
_MAX_BAND_OVER_RATE = 0.2
# Samples of all runs per band; stretches of all runs, and folds that these form.
_MAX_SAMPLES, _STRETCH_COUNT, _FOLD_COUNT = 2000, 40, 5
# Range of the length of a stretch [s].
_MIN_STRETCH, _MAX_STRETCH = 0.2, 2.0
# Ridge penalty of columns scaled to unit mean square, over the number of samples.
_RELATIVE_RIDGE = 1e-3
# Smallest gain in the mean log mean square for which the default band of the fit is left.
_MIN_LOG_GAIN = 0.02
# Largest number of rows of a fit.
_MAX_FIT_ROWS = 60_000
# Joints with fewer moving samples keep the default band.
_MIN_MOVING_SAMPLES = 100


def candidate_bands(runs: Sequence[RecordedRun], usual: float) -> list[float]:
    """Return the bands that the sampling rate of runs admits, and the usual one [Hz]."""
    highest = _MAX_BAND_OVER_RATE / max(run.step for run in runs)
    return sorted({*(b for b in BANDS if b <= highest), min(usual, highest)})


def choose_fit_band(
    robot: RobotModel, runs: Sequence[RecordedRun], *, slow: float, fit: float, predict: float
) -> float:
    """Return the band of a fit that best predicts stretches left out [Hz].

    `runs`: training runs. `slow`: joints slower than this are at rest [rad/s]. `fit`, `predict`:
    usual bands of fit and prediction; the first is kept where too little moves to select [Hz].
    """
    tried = candidate_bands(runs, predict)
    errors = np.array([_cross_validation_errors(robot, runs, band, slow) for band in tried])
    usable = np.isfinite(errors).all(axis=0)
    if not usable.any():
        return fit
    most = _MAX_FIT_ROWS / (sum(run.duration for run in runs) * robot.n * ROWS_PER_CYCLE)
    fits = [
        k for k, b in enumerate(tried) if _MIN_FIT_BAND <= b <= max(min(_MAX_FIT_BAND, most), fit)
    ]
    if robot.elastic:
        fits = [k for k in fits if tried[k] <= fit]
    together = np.log(errors[:, usable]).mean(axis=1)
    best = min(fits, key=lambda k: float(together[k]), default=0)
    near = [k for k in fits if together[k] < together[best] + _MIN_LOG_GAIN]
    return min((tried[k] for k in near), key=lambda band: abs(band - fit), default=fit)


def _cross_validation_errors(
    robot: RobotModel, runs: Sequence[RecordedRun], band: float, slow: float
) -> np.ndarray:
    """Return the mean square error of unfiltered torque in stretches left out (n,), or nan."""
    length = float(
        np.clip(sum(run.duration for run in runs) / _STRETCH_COUNT, _MIN_STRETCH, _MAX_STRETCH)
    )
    parts = [_sample_run(robot, run, band, len(runs), length) for run in runs]
    found = np.full(robot.n, np.nan)
    for j in range(robot.n):
        columns, target, stretch = [], [], []
        first = 0
        for part in parts:
            used = (np.abs(part.velocity[:, j]) >= slow) & np.isfinite(part.residual[:, j])
            columns.append(part.columns(j)[used])
            target.append(part.residual[used, j])
            stretch.append(first + part.stretch[used])
            first += int(part.stretch.max()) + 1
        fold = np.concatenate(stretch) % _FOLD_COUNT
        if len(fold) >= _MIN_MOVING_SAMPLES and len(np.unique(fold)) == _FOLD_COUNT:
            found[j] = _cross_validation_error(np.vstack(columns), np.concatenate(target), fold)
    return found


@dataclass(frozen=True, eq=False)
class _RunSamples:
    """Samples of a run with filtered motion and unfiltered torque."""

    velocity: np.ndarray
    acceleration: np.ndarray
    bodies: np.ndarray | None
    residual: np.ndarray
    stretch: np.ndarray

    def columns(self, j: int) -> np.ndarray:
        """Return the regressors of the torque of a joint (m, k).

        Elastic joints have no free bodies: too wide a band makes spurious link accelerations, which
        free bodies would cancel; nominal ones expose them.
        """
        speed = self.velocity[:, j]
        own = (np.ones_like(speed), smooth_sign(speed), speed, self.acceleration[:, j])
        return np.column_stack(own if self.bodies is None else [*own, self.bodies[:, j]])


def _sample_run(
    robot: RobotModel, run: RecordedRun, band: float, runs: int, length: float
) -> _RunSamples:
    time, position, _, torque = resample_uniform(run)
    dt = float(time[1] - time[0])
    low_pass = ZeroPhaseFilter(1.0 / dt, band)
    motor = low_pass.filter_motion(bridge_gaps(position))
    velocity = derivative(motor, dt)
    acceleration = derivative(velocity, dt)
    # Same samples for every band, clear of the ends of the narrowest.
    margin = min(ZeroPhaseFilter(1.0 / dt, BANDS[0]).settling, len(time) // 4)
    every = max(1, (len(time) - 2 * margin) * runs // _MAX_SAMPLES)
    kept = np.arange(margin, len(time) - margin, every)
    clear = ~near_gaps(run.time, run.step, time, margin)[kept]
    kept = kept[clear] if clear.any() else kept
    links = quasi_static_links(robot, motor, dt, low_pass)
    q, v, a = links.position[kept], links.velocity[kept], links.acceleration[kept]
    speed, rate = velocity[kept], acceleration[kept]
    nominal = links.torque[kept] + robot.rotor_inertia * rate + robot.friction(speed)
    return _RunSamples(
        velocity=speed,
        acceleration=rate,
        bodies=None if robot.elastic else robot.body_regressor(q, v, a),
        residual=torque[kept] - nominal,
        stretch=((time[kept] - time[0]) / length).astype(int),
    )


def _cross_validation_error(columns: np.ndarray, target: np.ndarray, fold: np.ndarray) -> float:
    size = np.sqrt(np.mean(columns**2, axis=0))
    scaled = columns[:, size > 0.0] / size[size > 0.0]
    ridge = _RELATIVE_RIDGE * len(target) * np.eye(scaled.shape[1])
    gram, moment = scaled.T @ scaled + ridge, scaled.T @ target
    total = 0.0
    for k in range(_FOLD_COUNT):
        own = fold == k
        part, left = scaled[own], target[own]
        fitted = np.linalg.solve(gram - part.T @ part, moment - part.T @ left)
        total += float(np.sum((left - part @ fitted) ** 2))
    return total / len(target)
