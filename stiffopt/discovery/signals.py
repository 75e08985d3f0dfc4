"""Signals and constants that effects depend on: motion and nominal torques."""

from __future__ import annotations

from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cached_property
from operator import attrgetter
from typing import Any

import numpy as np

from stiffopt.connection.reducer import Reducer
from stiffopt.discovery.settings import SIGN_SPEED
from stiffopt.drivetrain.chain import Chain, Stage
from stiffopt.exact.connection import Corners, Slopes, reducer_compliance, reducer_windup
from stiffopt.symbolic import Quantity

# Inertial parameters of a body: mass, three first moments, six of the inertia.
PARAMETERS_PER_BODY = 10
# Harmonics of the torques over the angle of a joint: sine and cosine of it and of twice it.
HARMONICS_PER_JOINT = 4
# Share of SIGN_SPEED; the sign is taken as constant over smaller changes of speed [-].
_MIN_SPEED_CHANGE = 1e-3


def smooth_sign(velocity: Quantity) -> Quantity:
    """Return the direction of motion, -1 to 1, smooth where the joint reverses [rad/s] -> [-]."""
    return np.tanh(velocity / SIGN_SPEED)


def mean_sign(velocity: np.ndarray) -> np.ndarray:
    """Return the mean of the smooth sign (K, n) over the time of every sample [-].

    A light joint reverses between two samples: sampled, the sign holds for half a sample period at
    most, and a jump of friction comes up to half a sample early or late. Speeds are linear between
    the samples and the midpoints, which a cubic through four samples gives.

    `velocity` (K, n): at equal time steps [rad/s].
    """
    if len(velocity) < 4:
        return np.asarray(smooth_sign(velocity))
    middle = 0.5 * (velocity[1:] + velocity[:-1])
    middle[1:-1] += (velocity[1:-2] + velocity[2:-1] - velocity[:-3] - velocity[3:]) / 16.0
    before = np.concatenate([velocity[:1], middle])
    after = np.concatenate([middle, velocity[-1:]])
    return np.asarray(
        0.5 * (_mean_sign_between(before, velocity) + _mean_sign_between(velocity, after))
    )


def _mean_sign_between(first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return the mean of the smooth sign while the speed changes linearly between two values."""
    change = last - first
    steady = np.abs(change) < _MIN_SPEED_CHANGE * SIGN_SPEED

    def integral(velocity: np.ndarray) -> np.ndarray:
        size = np.abs(velocity)
        return np.asarray(size + SIGN_SPEED * np.log1p(np.exp(-2.0 * size / SIGN_SPEED)))

    mean = (integral(last) - integral(first)) / np.where(steady, 1.0, change)
    return np.asarray(np.where(steady, smooth_sign(0.5 * (first + last)), mean))


# Constants of a joint that scale terms: an extended model keeps those that it was fitted with.
JOINT_SCALES = ("torque_rated", "torque_max", "fastest", "shown_coulomb", "shown_viscous")


@dataclass(frozen=True, kw_only=True)
class JointConstants:
    """Constants of one joint for terms and bounds."""

    joint: int  # 1-based, in the order of the recording set
    ratio: float  # turns of the motor per turn of the joint
    # coulomb, viscous: nominal friction [N m], [N m s/rad].
    coulomb: float
    viscous: float
    # torque_rated, torque_max [N m]
    torque_rated: float
    torque_max: float
    rotor_inertia: float  # reflected to the joint [kg m^2]
    # Viscous damping between motor and link [N m s/rad]; 0 where unknown.
    joint_damping: float = 0.0
    chain: Chain | None = None  # nominal drivetrain; None where rigid or unknown
    pole_pairs: float | None = None
    # (lowest, highest) range of the motor angle in the recordings [rad].
    stroke: tuple[float, float] = (-np.pi, np.pi)
    fastest: float = 1.0  # largest motor speed in the recordings [rad/s]
    # Scales of effects where nominal friction is not stated, 0 where unknown: friction that the
    # recordings show beside the nominal torque [N m], [N m s/rad].
    shown_coulomb: float = 0.0
    shown_viscous: float = 0.0
    largest_torque: float = 1.0  # largest nominal spring torque in the recordings [N m]
    # Largest filtered drive torque measured in the training runs; 0 without measurement [N m].
    measured_torque: float = 0.0
    prismatic: bool = False
    # True where a belt is among the connections; None where they are unknown.
    belt: bool | None = None
    joints: int = 1  # number of joints of the arm
    # Torque per position error by an actuator's law [N m/rad]; nan of measured torques.
    position_gain: float = np.nan

    @property
    def elastic(self) -> bool:
        """True where the nominal joint winds up."""
        return self.chain is not None and bool(self.chain.stages)

    @cached_property
    def _series_reducer(self) -> Stage | None:
        """First reducer in series with all other connections."""
        groups = [] if self.chain is None else self.chain.groups()
        alone = (group[0] for group in groups if len(group) == 1)
        return next((stage for stage in alone if isinstance(stage.element, Reducer)), None)

    @cached_property
    def _other_connections(self) -> Chain:
        """Drivetrain without that reducer."""
        if self.chain is None:
            return Chain(())
        stages = tuple(stage for stage in self.chain.stages if stage is not self._series_reducer)
        return replace(self.chain, stages=stages)

    @cached_property
    def _reducer_curve(self) -> tuple[Slopes, Corners] | None:
        if self._series_reducer is None:
            return None
        own, down, counts = (
            self._series_reducer.element,
            self._series_reducer.reduction,
            self._series_reducer.windup_factor,
        )
        assert isinstance(own, Reducer)
        slopes = (own.K1, own.K2, own.K3)
        k1, k2, k3 = (stiffness * down / counts for stiffness in slopes)
        return (k1, k2, k3), (own.T1 * down, own.T2 * down)

    @property
    def slopes(self) -> Slopes | None:
        """Stiffnesses K1, K2, K3 of the reducer at the joint [N m/rad]; None without a reducer."""
        return None if self._reducer_curve is None else self._reducer_curve[0]

    @property
    def corners(self) -> Corners | None:
        """Torques T1, T2 of the reducer's slope changes at the joint [N m]."""
        return None if self._reducer_curve is None else self._reducer_curve[1]

    @cached_property
    def contact_stiffness(self) -> float:
        """Secant stiffness without the reducer at the rated torque [N m/rad]; inf if rigid."""
        if not self._other_connections.stages:
            return np.inf
        return float(self._other_connections.secant_stiffness(self.torque_rated))

    def windup(self, torque: Quantity) -> Quantity:
        """Return the nominal wind-up [rad] under a spring torque [N m]; takes symbols.

        The three slopes of the reducer are the catalogue's own, without smoothing.
        """
        angle = self._other_connections.windup(torque)
        return (
            angle
            if self._reducer_curve is None
            else angle + reducer_windup(torque, *self._reducer_curve)
        )

    def compliance(self, torque: Quantity) -> Quantity:
        """Return the tangent compliance of the nominal wind-up [rad/(N m)]; takes symbols."""
        slope = self._other_connections.tangent_compliance(torque)
        return (
            slope
            if self._reducer_curve is None
            else slope + reducer_compliance(torque, *self._reducer_curve)
        )


@dataclass(frozen=True, kw_only=True)
class MotionSignals:
    """Signals of one joint, arrays (K,), or of the robot, (K, n); or CasADi symbols."""

    # time, session_time: since the begin of the run, since power-on [s]; (K,) always.
    time: Quantity
    dt: float  # uniform time step [s]
    session_time: Quantity
    # Housing temperature above that at which friction was identified [K]; 0 where unknown.
    temperature_rise: Quantity
    # motor_position, motor_velocity, motor_acceleration: reflected to the joint by the ratio [rad],
    # [rad/s], [rad/s^2].
    motor_position: Quantity
    motor_velocity: Quantity
    motor_acceleration: Quantity
    # Smooth sign of the motor velocity; its mean over each sample period where links vibrate [-].
    motor_direction: Quantity
    # link_position, link_velocity, link_acceleration: from the motor motion and the nominal
    # wind-up.
    link_position: Quantity
    link_velocity: Quantity
    link_acceleration: Quantity
    transmitted_torque: Quantity  # nominal torque between motor and link, of the rigid bodies [N m]
    # Transmitted torque less that of the joint damping, where this is known [N m].
    spring_torque: Quantity
    windup: Quantity  # nominal wind-up under the spring torque [rad]
    # drive_torque, drive_torque_rate: nominal prediction [N m], [N m/s].
    drive_torque: Quantity
    drive_torque_rate: Quantity
    run: str = ""  # name of the run
    run_number: int = 0  # its place in the set, from 0
    # Torque asked of the drive, as recorded or by an actuator's law without a limit [N m]; None of
    # motions without recording.
    asked_torque: Quantity | None = None
    # Of an actuator's law: the same torque per time that its commands are later than assumed
    # [N m/s], and the position error that it reads [rad]; else None.
    command_rate: Quantity | None = None
    position_error: Quantity | None = None
    # 1 while the arm carries a part (K,), else 0; None where it never does.
    carrying: Quantity | None = None


@dataclass(frozen=True, kw_only=True)
class JointSignals(MotionSignals):
    """Signals of one joint."""

    # previous_position, previous_velocity, previous_acceleration: motor motion of the previous
    # joint; 0 for the first [rad], [rad/s], [rad/s^2].
    previous_position: Quantity
    previous_velocity: Quantity
    previous_acceleration: Quantity
    constants: JointConstants

    @classmethod
    def of_known(cls, constants: JointConstants, rest: Quantity, **known: Quantity) -> JointSignals:
        """Return signals of which some are known; all others are `rest`."""
        before = (f"previous_{name}" for name in ("position", "velocity", "acceleration"))
        names = ("time", "session_time", *before, *JOINT_SIGNAL_NAMES)
        values: dict[str, Any] = dict.fromkeys(names, rest)
        return cls(constants=constants, dt=1.0, **(values | known))

    @property
    def nominal_friction(self) -> Quantity:
        """Friction of the nominal model [N m]."""
        own = self.constants
        return own.coulomb * self.motor_direction + own.viscous * self.motor_velocity


@dataclass(frozen=True, kw_only=True)
class RobotConstants:
    """Constants of the robot as a whole."""

    joints: tuple[JointConstants, ...]
    links: tuple[str, ...]  # name of the moving link of each joint
    masses: np.ndarray  # (n,) nominal masses of the links [kg]
    centres: np.ndarray  # (n, 3) nominal centres of mass in the joints' frames [m]
    # (2, 3) lowest and highest tool position in the recordings, base frame [m].
    tool_range: np.ndarray
    # (3,) stated gravity, base frame [m/s^2].
    gravity: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))


@dataclass(frozen=True, kw_only=True)
class RobotSignals(MotionSignals):
    """Signals of the whole robot."""

    arm: Any  # signals of the arm as a whole, which this class passes on
    # last_link, link: index of the last link, and of the link that an effect is located at.
    last_link: int
    link: int
    constants: RobotConstants

    @property
    def nominal_friction(self) -> Quantity:
        """Friction of the nominal model (K, n) [N m]."""
        coulomb, viscous = np.array([[j.coulomb, j.viscous] for j in self.constants.joints]).T
        return coulomb * self.motor_direction + viscous * self.motor_velocity

    # Of the arm as a whole: tool position in the base frame (K, 3) [m], and its Jacobian (K, 3, n).
    tool_position = property(attrgetter("arm.tool_position"))
    tool_jacobian = property(attrgetter("arm.tool_jacobian"))
    # Work of forces at the tool (K, n, 6) [m], along the axes of the base, then of the tool:
    # columns of J^T, and of J^T R with the rotation R of the last link.
    tool_levers = property(attrgetter("arm.tool_levers"))
    # Joint torques per inertial parameter (m, m c, I) of every moving body, one body after another
    # (K, n, 10 n) [N m per unit]; entries [..., k] where it is evaluated on demand.
    body_regressor = property(attrgetter("arm.body_regressor"))
    # Spring torque per gravity along the axes of the base (K, n, 3) [N m per m/s^2].
    weight = property(attrgetter("arm.weight"))
    # Harmonics of the spring torque over the zero of every joint (K, n, 4 n) [N m]: a zero of joint
    # j moved by x adds columns 4 j to 4 j + 3 times sin x, cos x - 1, sin 2x, cos 2x - 1; entries
    # [..., k] where it is evaluated on demand.
    zero_harmonics = property(attrgetter("arm.zero_harmonics"))

    def head(self, count: int) -> RobotSignals:
        """Return the first samples."""
        return self._select_samples(slice(count), self.arm.head(count))

    def decimate(self, every: int) -> RobotSignals:
        """Return every k-th sample; `dt` is unchanged."""
        return self._select_samples(slice(None, None, every), self.arm.decimate(every))

    def _select_samples(self, samples: slice, arm: Any) -> RobotSignals:
        fields = {name: value for name, value in vars(self).items() if np.ndim(value) > 0}
        kept: dict[str, Any] = {name: value[samples] for name, value in fields.items()}
        return replace(self, arm=arm, **kept)

    def of_joint(self, index: int) -> JointSignals:
        """Return the signals of one joint (0-based)."""

        def of(name: str, joint: int) -> Quantity:
            column = getattr(self, name)[:, joint]
            return np.ascontiguousarray(column) if isinstance(column, np.ndarray) else column

        def before(name: str) -> Quantity:
            return of(name, index - 1) if index else 0.0 * self.time

        return JointSignals(
            time=self.time,
            run=self.run,
            run_number=self.run_number,
            dt=self.dt,
            session_time=self.session_time,
            previous_position=before("motor_position"),
            previous_velocity=before("motor_velocity"),
            previous_acceleration=before("motor_acceleration"),
            constants=self.constants.joints[index],
            **{
                name: None if getattr(self, name) is None else of(name, index)
                for name in (*JOINT_SIGNAL_NAMES, *_ACTUATOR_SIGNAL_NAMES)
            },
        )


# Fields of `MotionSignals` with one column per joint, and those that may be None.
_ACTUATOR_SIGNAL_NAMES = ("asked_torque", "command_rate", "position_error")
JOINT_SIGNAL_NAMES = tuple(
    each.name
    for each in fields(MotionSignals)
    if each.default is MISSING and each.name not in ("time", "dt", "session_time")
)
