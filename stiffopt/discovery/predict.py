"""Channels of a run predicted on its own time stamps, from its motion alone."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stiffopt.discovery.extension import Extension, extended
from stiffopt.discovery.prepare import PreparedRun, prepare
from stiffopt.discovery.robot import RobotModel
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.signals import RobotConstants
from stiffopt.discovery.vibration import vibration
from stiffopt.recording.run import Run

# Of the motion that predictions follow [Hz]: wider than a fit's, since what is predicted is not
# filtered, and below the resonances of the joints.
PREDICTION_CUTOFF = 20.0


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
    run : Run
        Only its motor positions, temperature and times are used; that it has link encoders, not
        what they read.
    constants : RobotConstants
        Of the training runs.
    settings : Settings
    """

    def __init__(
        self, robot: RobotModel, run: Run, constants: RobotConstants, settings: Settings
    ) -> None:
        self.robot, self.run = robot, run
        wide = replace(settings, cutoff=max(settings.cutoff, PREDICTION_CUTOFF))
        # What is predicted must not be seen.
        blind = replace(run, torque=np.full_like(run.torque, np.nan), link_position=None)
        self._nominal = prepare(robot, blind, 0, constants, wide)
        self._position = _at_stamps(run.time, run.position, run.stamps)
        even = _at_stamps(run.time, run.position, self._nominal.time)
        seen = None if run.link_position is None else self._nominal.signals
        self._fast = None if seen is None else vibration(robot, seen, even)

    @property
    def velocity(self) -> np.ndarray:
        """Joint speeds as recorded, from the positions where none is (K, n) [rad/s]."""
        derived = _at_stamps(
            self._nominal.time, self._nominal.signals.motor_velocity, self.run.time
        )
        if self.run.velocity is None:
            return derived
        return np.where(np.isfinite(self.run.velocity), self.run.velocity, derived)

    def predict(self, *extensions: Extension) -> Prediction:
        """Prediction of the nominal model with extensions, each on top of those before it."""
        prepared: PreparedRun = self._nominal
        for extension in extensions:
            prepared = extended(prepared, self.robot, extension)
        drive, windup = prepared.signals.drive_torque, prepared.signals.windup
        if self._fast is not None:
            drive = drive + prepared.low_pass(self._fast.torque)
            windup = windup + self._fast.deflection
        stamps = self.run.stamps
        return Prediction(
            stamps=stamps,
            torque=_at_stamps(prepared.time, drive, stamps),
            link_position=self._position - _at_stamps(prepared.time, windup, stamps),
        )


def _at_stamps(time: np.ndarray, values: np.ndarray, stamps: np.ndarray) -> np.ndarray:
    """Columns (K, n) at other times (R, n); what is missing is bridged."""
    columns = []
    for column in values.T:
        known = np.isfinite(column)
        columns.append(np.interp(stamps, time[known], column[known]))
    return np.column_stack(columns)
