"""What the terms of effects see: motion and nominal torques of a joint or of the whole robot."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stiffopt.exact.reducer import reducer_compliance, reducer_windup
from stiffopt.symbolic import Quantity


@dataclass(frozen=True, kw_only=True)
class JointConstants:
    """Numbers of one joint that terms and bounds need.

    Parameters
    ----------
    joint : int
        1-based, in the order of the recording set.
    ratio : float
        Turns of the motor for one of the joint.
    coulomb, viscous : float
        Nominal friction [N m], [N m s/rad].
    torque_rated, torque_max : float
        [N m]
    rotor_inertia : float
        At the output side [kg m^2].
    contact_stiffness : float
        Of the healthy connections in series [N m/rad]; inf where rigid or unknown.
    pole_pairs : float or None
    slopes : (K1, K2, K3) or None
        Of the reducer [N m/rad]; None where rigid or unknown.
    torques : (T1, T2) or None
        Where its slope changes [N m].
    stroke : (lowest, highest)
        Motor angle met in the recordings [rad].
    fastest : float
        Largest motor speed met [rad/s].
    largest_torque : float
        Largest nominal spring torque met [N m].
    prismatic : bool
    belt : bool or None
        Whether a belt is among the connections; None where they are unknown.
    """

    joint: int
    ratio: float
    coulomb: float
    viscous: float
    torque_rated: float
    torque_max: float
    rotor_inertia: float
    contact_stiffness: float = np.inf
    pole_pairs: float | None = None
    slopes: tuple[float, float, float] | None = None
    torques: tuple[float, float] | None = None
    stroke: tuple[float, float] = (-np.pi, np.pi)
    fastest: float = 1.0
    largest_torque: float = 1.0
    prismatic: bool = False
    belt: bool | None = None

    @property
    def elastic(self) -> bool:
        """Whether the nominal joint winds up at all."""
        return self.slopes is not None or np.isfinite(self.contact_stiffness)

    def windup(self, torque: Quantity) -> Quantity:
        """Nominal wind-up [rad] under a spring torque [N m]; takes symbols."""
        angle = torque / self.contact_stiffness
        if self.slopes is None or self.torques is None:
            return angle
        return angle + reducer_windup(torque, self.slopes, self.torques)

    def compliance(self, torque: Quantity) -> Quantity:
        """Slope of the nominal wind-up [rad/(N m)]; takes symbols."""
        slope = 1.0 / self.contact_stiffness + 0.0 * torque
        if self.slopes is None or self.torques is None:
            return slope
        return slope + reducer_compliance(torque, self.slopes, self.torques)


@dataclass(frozen=True, kw_only=True)
class MotionSignals:
    """Signals of one joint, arrays (K,), or of the robot, (K, n); or CasADi symbols.

    Parameters
    ----------
    time, session_time
        Since the run's begin, since switching on [s]; (K,) always.
    dt : float
        Of the clock, which is uniform [s].
    temperature_rise
        Of the housing above that at which friction was identified [K]; 0 where unknown.
    motor_position, motor_velocity, motor_acceleration
        Through the ratio [rad], [rad/s], [rad/s^2].
    link_position, link_velocity, link_acceleration
        By the nominal wind-up.
    spring_torque
        Nominal, of the rigid bodies [N m].
    windup
        Nominal, under the spring torque [rad].
    drive_torque, drive_torque_rate
        Nominal prediction [N m], [N m/s].
    """

    time: Quantity
    dt: float
    session_time: Quantity
    temperature_rise: Quantity
    motor_position: Quantity
    motor_velocity: Quantity
    motor_acceleration: Quantity
    link_position: Quantity
    link_velocity: Quantity
    link_acceleration: Quantity
    spring_torque: Quantity
    windup: Quantity
    drive_torque: Quantity
    drive_torque_rate: Quantity


@dataclass(frozen=True, kw_only=True)
class JointSignals(MotionSignals):
    """Signals of one joint.

    Parameters
    ----------
    previous_position
        Motor angle of the joint before; 0 for the first [rad].
    constants : JointConstants
    """

    previous_position: Quantity
    constants: JointConstants


@dataclass(frozen=True, kw_only=True)
class RobotConstants:
    """Numbers of the robot as a whole.

    Parameters
    ----------
    joints : tuple of JointConstants
    links : tuple of str
        Moving link behind each joint of the model.
    masses : array (n,)
        Nominal [kg].
    centres : array (n, 3)
        Nominal centres of mass in the joints' frames [m].
    tool_range : array (2, 3)
        Lowest and highest tool position met, base frame [m].
    """

    joints: tuple[JointConstants, ...]
    links: tuple[str, ...]
    masses: np.ndarray
    centres: np.ndarray
    tool_range: np.ndarray


@dataclass(frozen=True, kw_only=True)
class RobotSignals(MotionSignals):
    """Signals of the whole robot.

    Parameters
    ----------
    tool_position, tool_velocity : (K, 3)
        Base frame [m], [m/s].
    tool_jacobian : (K, 3, n)
    body_regressor : (K, n, 10 n)
        Joint torques for the inertial parameters (m, m c, I) of every moving body, after one
        another [N m per unit].
    tilt : (K, n, 2)
        Change of the spring torques for a turn of the base about x and y [N m/rad].
    last_link, link : int
        Index of the last link, and of the one that an effect is about.
    constants : RobotConstants
    """

    tool_position: Quantity
    tool_velocity: Quantity
    tool_jacobian: Quantity
    body_regressor: Quantity
    tilt: Quantity
    last_link: int
    link: int
    constants: RobotConstants

    def thinned(self, every: int) -> RobotSignals:
        """Every so many samples; the clock stays."""
        fields = {name: value for name, value in vars(self).items() if np.ndim(value) > 0}
        kept: dict[str, Any] = {name: value[::every] for name, value in fields.items()}
        return replace(self, **kept)

    def of_joint(self, index: int) -> JointSignals:
        """Signals of one joint (0-based)."""
        before = self.motor_position[:, index - 1] if index else 0.0 * self.time

        def own(name: str) -> Quantity:
            return getattr(self, name)[:, index]

        return JointSignals(
            time=self.time,
            dt=self.dt,
            session_time=self.session_time,
            previous_position=before,
            constants=self.constants.joints[index],
            **{name: own(name) for name in _BY_JOINT},
        )


_BY_JOINT = (
    "temperature_rise",
    "motor_position",
    "motor_velocity",
    "motor_acceleration",
    "link_position",
    "link_velocity",
    "link_acceleration",
    "spring_torque",
    "windup",
    "drive_torque",
    "drive_torque_rate",
)
