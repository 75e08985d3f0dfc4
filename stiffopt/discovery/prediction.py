"""Predict channels of a run from its motion, and compare held-out runs with predictions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.discovery.comparison.bands import candidate_bands
from stiffopt.discovery.comparison.channel_rows import KnownNoise
from stiffopt.discovery.comparison.extended_run import extend_run
from stiffopt.discovery.comparison.filtering import interpolate_linear
from stiffopt.discovery.comparison.located_effect import Extension
from stiffopt.discovery.comparison.prepared_run import PreparedRun, prepare_run
from stiffopt.discovery.settings import MIN_MOVING_SPEED, PREDICTION_CUTOFF
from stiffopt.discovery.training import Training
from stiffopt.recording.run import RecordedRun


@dataclass(frozen=True, kw_only=True, eq=False)
class Prediction:
    """Predicted channels of one run."""

    stamps: np.ndarray  # (R,) every time stamp of the run [s]
    # torque, link_position (R, n) [N m], [rad]; always finite.
    torque: np.ndarray
    link_position: np.ndarray


class Predictor:
    """Predictions along the motion of one run.

    `run`: only its motor positions, temperature and times are used, and the torque asked for beyond
    the limit of a drive, of which the motion tells nothing. `prepared`: the run as prepared for a
    fit; with elastic joints, predictions use the same motion. `vibrating`: as of
    `prepare_run`. Its `nominal` is the run with signals of the nominal model.
    """

    def __init__(
        self,
        training: Training,
        run: RecordedRun,
        prepared: PreparedRun | None = None,
        *,
        vibrating: bool = True,
    ) -> None:
        self.robot, self.run = training.robot, run
        self._training, self._vibrating = training, vibrating
        self._position = interpolate_linear(run.time, run.position, run.stamps)
        # Joints by their band, where that differs from the usual one.
        self._others: dict[float, list[int]] = {}
        if prepared is not None and prepared.vibration is not None:
            self.nominal = prepared
            return
        settings = training.settings
        usual = PREDICTION_CUTOFF
        if settings.predict is None:
            usual = max(settings.fit_band, usual)
        self.nominal = self._prepare_band(usual)
        bands = settings.predict or (usual,) * self.robot.n
        self._others = {
            band: [j for j, own in enumerate(bands) if own == band]
            for band in sorted(set(bands) - {usual})
        }

    def _prepare_band(self, cutoff: float) -> PreparedRun:
        """Prepare the run in another band."""
        run = replace(self.run, link_position=None)
        settings = replace(self._training.settings, cutoff=cutoff)
        constants = self._training.constants
        return prepare_run(self.robot, run, 0, constants, settings, vibrating=self._vibrating)

    @property
    def velocity(self) -> np.ndarray:
        """Joint velocities (K, n), recorded or else derived from positions [rad/s]."""
        derived = interpolate_linear(
            self.nominal.time, self.nominal.signals.motor_velocity, self.run.time
        )
        if self.run.velocity is None:
            return derived
        return np.where(np.isfinite(self.run.velocity), self.run.velocity, derived)

    def predict(self, *extensions: Extension) -> Prediction:
        """Predict with the nominal model and extensions, each added to those before."""
        return next(self.predict_each([extensions]))

    def predict_each(self, several: Sequence[Sequence[Extension]]) -> Iterator[Prediction]:
        """Yield predictions of several models; further bands are prepared once for all.

        One at a time, since predictions of a long run need much memory.
        """
        stamps, time = self.run.stamps, self.nominal.time
        recorded = self.run.recorded_stamps
        # Drive torque and motor minus link angle (K, n).
        channels: list[tuple[np.ndarray, np.ndarray]] = []
        for extensions in several:
            usual = extend_run(self.nominal, *extensions)
            deflection = usual.signals.windup + usual.added_deflection
            channels.append((usual.signals.drive_torque.copy(), deflection))
        for band, joints in self._others.items():
            other = self._prepare_band(band)
            for (drive, _), extensions in zip(channels, several, strict=True):
                along = extend_run(other, *extensions).signals.drive_torque
                drive[:, joints] = along[:, joints]
        while channels:
            drive, deflection = channels.pop(0)
            yield Prediction(
                stamps=stamps if recorded is None else recorded,
                torque=interpolate_linear(time, drive, stamps),
                link_position=self._position - interpolate_linear(time, deflection, stamps),
            )

    def torque(self, band: float, *extensions: Extension) -> np.ndarray:
        """Predict the drive torques (R, n) from the motion in one band [Hz]."""
        own = self.nominal if band == self.nominal.low_pass.cutoff else self._prepare_band(band)
        drive = extend_run(own, *extensions).signals.drive_torque
        return interpolate_linear(own.time, drive, self.run.stamps)


@dataclass(frozen=True)
class ChannelError:
    """Squares of the residuals of one channel of one run."""

    kind: str  # "torque" or "link_position"
    joint: int  # from 0
    samples: int
    # before, after: sum of squares [(N m)^2] or [rad^2].
    before: float
    after: float
    noise: float  # one standard deviation [N m] or [rad]

    @property
    def name(self) -> str:
        """Such as "torque_3"."""
        return f"{self.kind}_{self.joint + 1}"


@dataclass(frozen=True, kw_only=True, eq=False)
class RunProof:
    """One held-out run with its predictions."""

    run: RecordedRun
    velocity: np.ndarray  # (K, n) of the joints [rad/s]
    # before, after: of the model that the diagnosis started from, and of the extended one.
    before: Prediction
    after: Prediction
    channels: tuple[ChannelError, ...]

    @property
    def nrmse_before(self) -> float:
        """Normalised residual of the starting model, all channels together."""
        return nrmse([self], "before")

    @property
    def nrmse_after(self) -> float:
        """Normalised residual of the extended model, all channels together."""
        return nrmse([self], "after")


def nrmse(proofs: list[RunProof] | tuple[RunProof, ...], when: str) -> float:
    """Return the normalised residual, all channels of all runs; nan without samples.

    `when` {"before", "after"}.
    """
    channels = [c for proof in proofs for c in proof.channels]
    count = sum(c.samples for c in channels)
    total = sum(getattr(c, when) / c.noise**2 for c in channels)
    return float(np.sqrt(total / count)) if count else float("nan")


def compare_predictions(
    run: RecordedRun, velocity: np.ndarray, before: Prediction, after: Prediction, noise: KnownNoise
) -> RunProof:
    """Compare a run with its predictions.

    `velocity` (K, n): of the joints, on the run's own samples [rad/s]. `before`, `after`: on the
    run's stamps.

    Unfiltered samples are compared: torque where the joint is faster than 0.03 rad/s, the link
    position everywhere. Missing channels are skipped.
    """
    scales = {"torque": noise.channels.torque, "link_position": noise.channels.deflection}
    channels = []
    for kind, joint, used, left in residuals(run, velocity, before, after):
        scale = float(scales[kind][joint])
        if np.isfinite(scale):
            first, last = (float(each @ each) for each in left)
            channels.append(ChannelError(kind, joint, int(used.sum()), first, last, scale))
    return RunProof(
        run=run, velocity=velocity, before=before, after=after, channels=tuple(channels)
    )


def residuals(
    run: RecordedRun, velocity: np.ndarray, *predictions: Prediction
) -> Iterator[tuple[str, int, np.ndarray, list[np.ndarray]]]:
    """Yield kind, joint, mask (K,) of the samples to compare, and the residual of each prediction.

    Torques, then link positions; `velocity` (K, n) is of the joints [rad/s].
    """
    # Indices of the samples among all stamps.
    places = np.searchsorted(run.stamps, run.time)
    for kind, joint, used in used_samples(run, velocity):
        measured = getattr(run, kind)[used, joint]
        left = [measured - getattr(each, kind)[places[used], joint] for each in predictions]
        yield kind, joint, used, left


def used_samples(run: RecordedRun, velocity: np.ndarray) -> Iterator[tuple[str, int, np.ndarray]]:
    """Yield kind, joint and mask (K,) of the samples to compare: torques, then link positions."""
    moving = np.abs(velocity) >= MIN_MOVING_SPEED
    for kind in ("torque", "link_position"):
        measured = getattr(run, kind)
        for joint in range(0 if measured is None else run.n):
            used = np.isfinite(measured[:, joint])
            if kind == "torque" and not run.at_rest:
                used &= moving[:, joint]
            if used.any():
                yield kind, joint, used


# Share of the least mean square that a wider band may cost: encoder noise is visible in the
# training runs, the needs of a faster motion are not.
_MAX_WIDER_BAND_COST = 0.05


def choose_prediction_bands(training: Training, found: Extension) -> tuple[float, ...]:
    """Return the band [Hz] for each joint in which the model predicts the training runs best.

    A wide band follows reversals and pulses; a narrow one keeps the noise of twice differentiated
    encoders out of the torque. How much noise passes depends on the inertia of the model: a fit
    with a free inertia for every band would shrink it until the noise costs nothing.
    """
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
