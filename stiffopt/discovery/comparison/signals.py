"""What the terms of effects see: motion and nominal torques of a joint or of the whole robot."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from stiffopt.connection.reducer import Reducer
from stiffopt.discovery.settings import SIGN_SPEED
from stiffopt.drivetrain.chain import Chain, Stage
from stiffopt.exact.connection import Corners, Slopes, reducer_compliance, reducer_windup
from stiffopt.symbolic import Quantity


def smooth_sign(velocity: Quantity) -> Quantity:
    """Direction of motion: -1 to 1, even where the joint reverses [rad/s] -> [-]."""
    return np.tanh(velocity / SIGN_SPEED)


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
    joint_damping : float
        Between motor and link [N m s/rad]; 0 where unknown.
    chain : Chain or None
        Nominal drivetrain; None where rigid or unknown.
    pole_pairs : float or None
    stroke : (lowest, highest)
        Motor angle met in the recordings [rad].
    fastest : float
        Largest motor speed met [rad/s].
    largest_torque : float
        Largest nominal spring torque met [N m].
    measured_torque : float
        Largest measured drive torque of the training runs, filtered; 0 where none is [N m].
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
    joint_damping: float = 0.0
    chain: Chain | None = None
    pole_pairs: float | None = None
    stroke: tuple[float, float] = (-np.pi, np.pi)
    fastest: float = 1.0
    largest_torque: float = 1.0
    measured_torque: float = 0.0
    prismatic: bool = False
    belt: bool | None = None

    @property
    def elastic(self) -> bool:
        """Whether the nominal joint winds up at all."""
        return self.chain is not None and bool(self.chain.stages)

    @cached_property
    def _reducer(self) -> Stage | None:
        """The first reducer that is in series with all the rest."""
        groups = [] if self.chain is None else self.chain.groups()
        alone = (group[0] for group in groups if len(group) == 1)
        return next((stage for stage in alone if isinstance(stage.element, Reducer)), None)

    @cached_property
    def _contacts(self) -> Chain:
        """The drivetrain without that reducer."""
        if self.chain is None:
            return Chain(())
        stages = tuple(stage for stage in self.chain.stages if stage is not self._reducer)
        return replace(self.chain, stages=stages)

    @cached_property
    def _curve(self) -> tuple[Slopes, Corners] | None:
        if self._reducer is None:
            return None
        own, down, counts = (
            self._reducer.element,
            self._reducer.reduction,
            self._reducer.windup_factor,
        )
        assert isinstance(own, Reducer)
        slopes = (own.K1, own.K2, own.K3)
        k1, k2, k3 = (stiffness * down / counts for stiffness in slopes)
        return (k1, k2, k3), (own.T1 * down, own.T2 * down)

    @property
    def slopes(self) -> Slopes | None:
        """K1, K2, K3 of the reducer, seen from the joint [N m/rad]; None without one."""
        return None if self._curve is None else self._curve[0]

    @property
    def corners(self) -> Corners | None:
        """T1, T2, where the reducer's slope changes, seen from the joint [N m]."""
        return None if self._curve is None else self._curve[1]

    @cached_property
    def contact_stiffness(self) -> float:
        """Of all but the reducer, secant at the rated torque [N m/rad]; inf where rigid."""
        if not self._contacts.stages:
            return np.inf
        return float(self._contacts.secant_stiffness(self.torque_rated))

    def windup(self, torque: Quantity) -> Quantity:
        """Nominal wind-up [rad] under a spring torque [N m]; takes symbols.

        The three slopes of the reducer are the catalogue's own, unsmoothed.
        """
        angle = self._contacts.windup(torque)
        return angle if self._curve is None else angle + reducer_windup(torque, *self._curve)

    def compliance(self, torque: Quantity) -> Quantity:
        """Slope of the nominal wind-up [rad/(N m)]; takes symbols."""
        slope = self._contacts.tangent_compliance(torque)
        return slope if self._curve is None else slope + reducer_compliance(torque, *self._curve)


@dataclass(frozen=True, kw_only=True)
class MotionSignals:
    """Signals of one joint, arrays (K,), or of the robot, (K, n); or CasADi symbols.

    Parameters
    ----------
    time, session_time
        Since the run's begin, since switching on [s]; (K,) always.
    run : str
        Name of the run.
    dt : float
        Of the clock, which is uniform [s].
    temperature_rise
        Of the housing above that at which friction was identified [K]; 0 where unknown.
    motor_position, motor_velocity, motor_acceleration
        Through the ratio [rad], [rad/s], [rad/s^2].
    motor_direction
        Smooth sign of that velocity, where links swing its mean over each sample's time [-].
    link_position, link_velocity, link_acceleration
        By the nominal wind-up.
    transmitted_torque
        Nominal, of the rigid bodies: what motor and link give each other [N m].
    spring_torque
        The same without the damping of the joint, where it is known [N m].
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
    motor_direction: Quantity
    link_position: Quantity
    link_velocity: Quantity
    link_acceleration: Quantity
    transmitted_torque: Quantity
    spring_torque: Quantity
    windup: Quantity
    drive_torque: Quantity
    drive_torque_rate: Quantity
    run: str = ""


@dataclass(frozen=True, kw_only=True)
class JointSignals(MotionSignals):
    """Signals of one joint.

    Parameters
    ----------
    previous_position, previous_velocity, previous_acceleration
        Motor of the joint before; 0 for the first [rad], [rad/s], [rad/s^2].
    constants : JointConstants
    """

    previous_position: Quantity
    previous_velocity: Quantity
    previous_acceleration: Quantity
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


class ArmSignals(Protocol):
    """Signals of the arm as a whole, beside those of its joints."""

    @property
    def tool_position(self) -> Quantity:
        """Of the tool in the base frame (K, 3) [m]."""

    @property
    def tool_velocity(self) -> Quantity:
        """Of the tool in the base frame (K, 3) [m/s]."""

    @property
    def tool_jacobian(self) -> Quantity:
        """Of its position (K, 3, n)."""

    @property
    def body_regressor(self) -> Any:
        """Joint torques for the inertial parameters of every body (K, n, 10 n) [N m per unit].

        (m, m c, I) of the moving bodies, one after another; where it is worked out on demand,
        entries [..., k].
        """

    @property
    def tilt(self) -> Quantity:
        """Change of the spring torques for a turn of the base about x and y (K, n, 2) [N m/rad]."""

    def until(self, count: int) -> ArmSignals:
        """The first samples."""

    def thinned(self, every: int) -> ArmSignals:
        """Every so many samples."""

    def with_bodies(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> ArmSignals:
        """The same with the bodies' torques along another motion (K, n)."""


@dataclass(frozen=True, kw_only=True)
class RobotSignals(MotionSignals):
    """Signals of the whole robot.

    Parameters
    ----------
    arm : ArmSignals
        Whose signals are this one's, too.
    last_link, link : int
        Index of the last link, and of the one that an effect is about.
    constants : RobotConstants
    """

    arm: ArmSignals
    last_link: int
    link: int
    constants: RobotConstants

    @property
    def tool_position(self) -> Quantity:
        """As of the arm."""
        return self.arm.tool_position

    @property
    def tool_velocity(self) -> Quantity:
        """As of the arm."""
        return self.arm.tool_velocity

    @property
    def tool_jacobian(self) -> Quantity:
        """As of the arm."""
        return self.arm.tool_jacobian

    @property
    def body_regressor(self) -> Any:
        """As of the arm."""
        return self.arm.body_regressor

    @property
    def tilt(self) -> Quantity:
        """As of the arm."""
        return self.arm.tilt

    def until(self, count: int) -> RobotSignals:
        """The first samples."""
        return self._of_samples(slice(count), self.arm.until(count))

    def thinned(self, every: int) -> RobotSignals:
        """Every so many samples; the clock stays."""
        return self._of_samples(slice(None, None, every), self.arm.thinned(every))

    def _of_samples(self, samples: slice, arm: ArmSignals) -> RobotSignals:
        fields = {name: value for name, value in vars(self).items() if np.ndim(value) > 0}
        kept: dict[str, Any] = {name: value[samples] for name, value in fields.items()}
        return replace(self, arm=arm, **kept)

    def of_joint(self, index: int) -> JointSignals:
        """Signals of one joint (0-based)."""

        def of(name: str, joint: int) -> Quantity:
            column = getattr(self, name)[:, joint]
            return np.ascontiguousarray(column) if isinstance(column, np.ndarray) else column

        def before(name: str) -> Quantity:
            return of(name, index - 1) if index else 0.0 * self.time

        def own(name: str) -> Quantity:
            return of(name, index)

        return JointSignals(
            time=self.time,
            run=self.run,
            dt=self.dt,
            session_time=self.session_time,
            previous_position=before("motor_position"),
            previous_velocity=before("motor_velocity"),
            previous_acceleration=before("motor_acceleration"),
            constants=self.constants.joints[index],
            **{name: own(name) for name in OF_EACH_JOINT},
        )


# Signals that every joint has of its own.
OF_EACH_JOINT = (
    "temperature_rise",
    "motor_position",
    "motor_velocity",
    "motor_acceleration",
    "motor_direction",
    "link_position",
    "link_velocity",
    "link_acceleration",
    "transmitted_torque",
    "spring_torque",
    "windup",
    "drive_torque",
    "drive_torque_rate",
)
