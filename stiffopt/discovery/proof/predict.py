"""Channels of a run predicted on its own time stamps, from its motion alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.discovery.comparison.extension import Extension, added_inertia, extended
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.prepare import PreparedRun, prepare, with_link_torque
from stiffopt.discovery.comparison.signals import RobotConstants
from stiffopt.discovery.proof.vibration import Vibration, posture_step, vibration
from stiffopt.discovery.settings import PREDICTED_CUTOFF, Settings
from stiffopt.recording.run import RecordedRun

# Of the motion of motors that predictions follow where their links swing [Hz]; links' beyond
# theirs is for their vibration.
MOTOR_CUTOFF = 45.0
# Of the slope of a spring's law, over the rated torque.
_SLOPE_STEP = 0.01
# Slope of an extended spring over the nominal one; beyond, a wave or a gap is no spring's.
_STIFFER = (0.1, 3.0)


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
        Only its motor positions, temperature and times are used; that it has link encoders, not
        what they read.
    constants : RobotConstants
        Of the training runs.
    settings : Settings
    """

    def __init__(
        self, robot: RobotModel, run: RecordedRun, constants: RobotConstants, settings: Settings
    ) -> None:
        self.robot, self.run = robot, run
        # Links that were never seen have springs that nothing confirms.
        self.swinging = run.link_position is not None and robot.swings
        widest = MOTOR_CUTOFF if self.swinging else PREDICTED_CUTOFF
        links = PREDICTED_CUTOFF if self.swinging else np.inf
        usual = max(settings.fit_band, widest) if settings.predict is None else widest
        # What is predicted must not be seen.
        blind = replace(run, torque=np.full_like(run.torque, np.nan), link_position=None)

        def along(cutoff: float) -> PreparedRun:
            followed = replace(settings, cutoff=cutoff)
            return prepare(robot, blind, 0, constants, followed, links=links)

        self._nominal = along(usual)
        # Joints whose torque follows another band than the rest.
        bands = settings.predict or (usual,) * robot.n
        self._others = {
            band: (along(band), [j for j, own in enumerate(bands) if own == band])
            for band in sorted(set(bands) - {usual})
        }
        self._position = _at_stamps(run.time, run.position, run.stamps)
        self._even = _at_stamps(run.time, run.position, self._nominal.time)

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
        prepared = self._with(extensions)
        drive, windup = prepared.signals.drive_torque.copy(), prepared.signals.windup
        for other, joints in self._others.values():
            drive[:, joints] = self._with(extensions, run=other).signals.drive_torque[:, joints]
        fast = self._vibration(prepared, extensions)
        if fast is not None:
            drive = drive + prepared.low_pass(fast.torque)
            windup = windup + fast.deflection
        stamps = self.run.stamps
        return Prediction(
            stamps=stamps,
            torque=_at_stamps(prepared.time, drive, stamps),
            link_position=self._position - _at_stamps(prepared.time, windup, stamps),
        )

    def _with(
        self,
        extensions: Sequence[Extension],
        added: np.ndarray | float = 0.0,
        run: PreparedRun | None = None,
    ) -> PreparedRun:
        """The run with extensions, and with a torque (n,) added in the springs."""
        prepared = self._nominal if run is None else run
        if np.any(added):
            load = np.broadcast_to(added, prepared.signals.spring_torque.shape)
            prepared = with_link_torque(prepared, self.robot, load)
        for extension in extensions:
            prepared = extended(prepared, self.robot, extension)
        return prepared

    def _vibration(
        self, prepared: PreparedRun, extensions: Sequence[Extension]
    ) -> Vibration | None:
        if not self.swinging:
            return None
        carried = self._nominal.signals.spring_torque
        step = _SLOPE_STEP * np.array([j.torque_rated for j in prepared.signals.constants.joints])
        wound = self._with(extensions, step).signals.windup - prepared.signals.windup
        nominal = self.robot.windup(carried + step) - self.robot.windup(carried)
        stiffer = np.clip(nominal / wound, *_STIFFER)
        every = posture_step(prepared.signals.dt)
        added = added_inertia(self._nominal, self.robot, extensions, every)
        return vibration(self.robot, prepared, self._even, stiffer, added)


def _at_stamps(time: np.ndarray, values: np.ndarray, stamps: np.ndarray) -> np.ndarray:
    """Columns (K, n) at other times (R, n); what is missing is bridged."""
    columns = []
    for column in values.T:
        known = np.isfinite(column)
        columns.append(np.interp(stamps, time[known], column[known]))
    return np.column_stack(columns)
