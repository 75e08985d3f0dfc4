"""Predict channels of a run from its motion, and compare held-out runs with predictions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.discovery.comparison.channel_rows import KnownNoise
from stiffopt.discovery.comparison.extended_run import extend_run
from stiffopt.discovery.comparison.located_effect import Extension
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.prepared_run import PreparedRun, prepare_run
from stiffopt.discovery.settings import MIN_MOVING_SPEED, PREDICTION_CUTOFF, Settings
from stiffopt.discovery.signals import RobotConstants
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

    `run`: only its motor positions, temperature and times are used. `constants`: of the training
    runs. `prepared`: the run as prepared for a fit; with elastic joints, predictions use the same
    motion. `vibrating`: see `prepare`.

    `nominal`: the run with signals of the nominal model.
    """

    def __init__(
        self,
        robot: RobotModel,
        run: RecordedRun,
        constants: RobotConstants,
        settings: Settings,
        prepared: PreparedRun | None = None,
        *,
        vibrating: bool = True,
    ) -> None:
        self.robot, self.run = robot, run
        self._constants, self._swinging = constants, vibrating
        self._position = _interpolate_columns(run.time, run.position, run.stamps)
        # Joints by their band, where that differs from the usual one.
        self._others: dict[float, list[int]] = {}
        self._settings = settings
        if prepared is not None and prepared.vibration is not None:
            self.nominal = prepared
            return
        widest = PREDICTION_CUTOFF
        usual = max(settings.fit_band, widest) if settings.predict is None else widest
        self.nominal = self._prepare_band(usual)
        bands = settings.predict or (usual,) * robot.n
        self._others = {
            band: [j for j, own in enumerate(bands) if own == band]
            for band in sorted(set(bands) - {usual})
        }

    def _prepare_band(self, cutoff: float) -> PreparedRun:
        """Prepare the run in another band, without the channels to be predicted."""
        run = self.run
        blind = replace(run, torque=np.full_like(run.torque, np.nan), link_position=None)
        settings = replace(self._settings, cutoff=cutoff)
        return prepare_run(
            self.robot, blind, 0, self._constants, settings, vibrating=self._swinging
        )

    @property
    def velocity(self) -> np.ndarray:
        """Joint velocities (K, n), recorded or else derived from positions [rad/s]."""
        derived = _interpolate_columns(
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
        stamps = self.run.stamps
        channels = [self._predict_channels(extensions) for extensions in several]
        for band, joints in self._others.items():
            self._replace_band(band, joints, [drive for drive, _ in channels], several)
        time = self.nominal.time
        while channels:
            drive, deflection = channels.pop(0)
            yield Prediction(
                stamps=stamps,
                torque=_interpolate_columns(time, drive, stamps),
                link_position=self._position - _interpolate_columns(time, deflection, stamps),
            )

    def _predict_channels(self, extensions: Sequence[Extension]) -> tuple[np.ndarray, np.ndarray]:
        """Return drive torque and motor minus link angle (K, n) in the usual band."""
        prepared = extend_run(self.nominal, self.robot, *extensions)
        return (
            prepared.signals.drive_torque.copy(),
            prepared.signals.windup + prepared.added_deflection,
        )

    def _replace_band(
        self,
        band: float,
        joints: list[int],
        drives: Sequence[np.ndarray],
        several: Sequence[Sequence[Extension]],
    ) -> None:
        """Replace torques of joints with another band."""
        other = self._prepare_band(band)
        for drive, extensions in zip(drives, several, strict=True):
            along = extend_run(other, self.robot, *extensions).signals.drive_torque
            drive[:, joints] = along[:, joints]


def _interpolate_columns(time: np.ndarray, values: np.ndarray, stamps: np.ndarray) -> np.ndarray:
    """Interpolate columns (K, n) to other times (R, n), across missing samples."""
    columns = []
    for column in values.T:
        known = np.isfinite(column)
        columns.append(np.interp(stamps, time[known], column[known]))
    return np.column_stack(columns)


@dataclass(frozen=True, kw_only=True)
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
    # Indices of the used samples among all stamps.
    places = np.searchsorted(run.stamps, run.time)
    scales = {"torque": noise.channels.torque, "link_position": noise.channels.deflection}
    channels = []
    for kind, joint, used in used_samples(run, velocity):
        if used is None or not np.isfinite(scales[kind][joint]):
            continue
        measured = getattr(run, kind)[used, joint]
        left = [measured - getattr(p, kind)[places[used], joint] for p in (before, after)]
        channels.append(
            ChannelError(
                kind=kind,
                joint=joint,
                samples=int(used.sum()),
                before=float(left[0] @ left[0]),
                after=float(left[1] @ left[1]),
                noise=float(scales[kind][joint]),
            )
        )
    return RunProof(run=run, before=before, after=after, channels=tuple(channels))


def used_samples(
    run: RecordedRun, velocity: np.ndarray
) -> Iterator[tuple[str, int, np.ndarray | None]]:
    """Yield kind, joint and mask (K,) of the samples to compare: torques, then link positions.

    `velocity` (K, n): of the joints [rad/s].
    """
    moving = np.abs(velocity) >= MIN_MOVING_SPEED
    for kind in ("torque", "link_position"):
        measured = getattr(run, kind)
        for joint in range(run.n):
            if measured is None:
                yield kind, joint, None
                continue
            used = np.isfinite(measured[:, joint])
            if kind == "torque" and not run.at_rest:
                used &= moving[:, joint]
            yield kind, joint, used if used.any() else None
