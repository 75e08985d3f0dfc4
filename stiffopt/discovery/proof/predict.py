"""Channels of a run predicted on its own time stamps, from its motion alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.discovery.comparison.extended_run import extend_run
from stiffopt.discovery.comparison.located_effect import Extension
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.prepared_run import PreparedRun, prepare_run
from stiffopt.discovery.settings import PREDICTED_CUTOFF, Settings
from stiffopt.discovery.signals import RobotConstants
from stiffopt.recording.run import RecordedRun


@dataclass(frozen=True, kw_only=True, eq=False)
class Prediction:
    """Predicted channels of one run.

    Parameters
    ----------
    stamps : array (R,)
        Every time stamp of the run [s].
    torque, link_position : array (R, n)
        [N m], [rad]; finite everywhere.
    """

    stamps: np.ndarray
    torque: np.ndarray
    link_position: np.ndarray


class Predictor:
    """Predictions along the motion of one run.

    Parameters
    ----------
    robot : RobotModel
    run : RecordedRun
        Only its motor positions, temperature and times are used.
    constants : RobotConstants
        Of the training runs.
    settings : Settings
    prepared : PreparedRun, optional
        The run as it was prepared for a fit; where links swing, predictions are of the same motion.
    vibrating : bool
        See `prepare`.

    Attributes
    ----------
    nominal : PreparedRun
        The run as the nominal model has it.
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
        self._position = _at_stamps(run.time, run.position, run.stamps)
        # Joints whose torque follows another band than the rest.
        self._others: dict[float, list[int]] = {}
        self._settings = settings
        if prepared is not None and prepared.vibration is not None:
            self.nominal = prepared
            return
        widest = PREDICTED_CUTOFF
        usual = max(settings.fit_band, widest) if settings.predict is None else widest
        self.nominal = self._along(usual)
        bands = settings.predict or (usual,) * robot.n
        self._others = {
            band: [j for j, own in enumerate(bands) if own == band]
            for band in sorted(set(bands) - {usual})
        }

    def _along(self, cutoff: float) -> PreparedRun:
        """The run in another band; what is predicted must not be seen."""
        run = self.run
        blind = replace(run, torque=np.full_like(run.torque, np.nan), link_position=None)
        settings = replace(self._settings, cutoff=cutoff)
        return prepare_run(
            self.robot, blind, 0, self._constants, settings, vibrating=self._swinging
        )

    @property
    def velocity(self) -> np.ndarray:
        """Joint speeds as recorded, from the positions where none is (K, n) [rad/s]."""
        derived = _at_stamps(self.nominal.time, self.nominal.signals.motor_velocity, self.run.time)
        if self.run.velocity is None:
            return derived
        return np.where(np.isfinite(self.run.velocity), self.run.velocity, derived)

    def predict(self, *extensions: Extension) -> Prediction:
        """Prediction of the nominal model with extensions, each on top of those before it."""
        return next(self.predict_each([extensions]))

    def predict_each(self, several: Sequence[Sequence[Extension]]) -> Iterator[Prediction]:
        """As `predict` of each, one after another: other bands are prepared once for all.

        One of them at a time, since a long run has no room for more.
        """
        stamps = self.run.stamps
        channels = [self._channels(extensions) for extensions in several]
        for band, joints in self._others.items():
            self._take_band(band, joints, [drive for drive, _ in channels], several)
        time = self.nominal.time
        while channels:
            drive, deflection = channels.pop(0)
            yield Prediction(
                stamps=stamps,
                torque=_at_stamps(time, drive, stamps),
                link_position=self._position - _at_stamps(time, deflection, stamps),
            )

    def _channels(self, extensions: Sequence[Extension]) -> tuple[np.ndarray, np.ndarray]:
        """Drive torque and motor minus link angle (K, n) in the usual band."""
        prepared = extend_run(self.nominal, self.robot, *extensions)
        return (
            prepared.signals.drive_torque.copy(),
            prepared.signals.windup + prepared.added_deflection,
        )

    def _take_band(
        self,
        band: float,
        joints: list[int],
        drives: Sequence[np.ndarray],
        several: Sequence[Sequence[Extension]],
    ) -> None:
        """Put the torques of joints that follow another band in their place."""
        other = self._along(band)
        for drive, extensions in zip(drives, several, strict=True):
            along = extend_run(other, self.robot, *extensions).signals.drive_torque
            drive[:, joints] = along[:, joints]


def _at_stamps(time: np.ndarray, values: np.ndarray, stamps: np.ndarray) -> np.ndarray:
    """Columns (K, n) at other times (R, n); what is missing is bridged."""
    columns = []
    for column in values.T:
        known = np.isfinite(column)
        columns.append(np.interp(stamps, time[known], column[known]))
    return np.column_stack(columns)
