"""Elastic arm: links on the springs of their joints, which the motors move at the other end.

Rotor inertia is left out, since motors are position-controlled; rigid joints stay rigid.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import scipy

from stiffopt.elastic.springs import JointSpring, joint_springs
from stiffopt.errors import NotSimulatedError, RobotError
from stiffopt.result.tool_error import ToolError, path_directions
from stiffopt.robot.added_torque import MotionState, sum_added_torques
from stiffopt.robot.batched_kinematics import frame_positions, frame_rotations
from stiffopt.units import joint_unit

if TYPE_CHECKING:
    from stiffopt.elastic.uncertainty import Departure
    from stiffopt.result.trajectory import ForceHistory
    from stiffopt.robot.robot import Robot

# Damping ratio where the robot file gives no damping.
ASSUMED_DAMPING = 0.02
# A joint with a higher single-joint frequency [Hz] is taken to follow its motor: the motions of an
# arm excite up to a tenth of it.
MIN_FOLLOWING_FREQUENCY = 1200.0
# A lower single-joint frequency [Hz] suggests a stiffness in another unit: arms have 3 Hz and more,
# and N m/arcmin taken for N m/rad gives a 59th of it.
_MIN_PLAUSIBLE_FREQUENCY, _USUAL_MIN_FREQUENCY = 1.0, 3.0
# Speed over which the direction of motion changes its sign [rad/s], as laws are fitted with.
_SIGN_SPEED = 0.01
_EQUILIBRIUM_TOLERANCE = 1e-12  # change of a joint in the last step [rad]
_MAX_EQUILIBRIUM_STEPS = 50
_DAMPING_ROUND_OFF = 1e-12  # relative; critical damping itself is allowed
_SAMPLES_AT_ONCE = 8192  # of a tool error


class ElasticArm:
    """Bodies, springs, damping and hysteresis of an arm.

    Parameters
    ----------
    robot : Robot
    at : array (n,)
        Motor position of the pose in which damping is judged and, where none is given, assumed:
        2 % of the critical damping of each single-joint vibration.
    process_force : array_like (3,)
        Constant force on the tool, base axes [N].

    Attributes
    ----------
    damping : array (n,)
        [N m s/rad]; zero for rigid joints.
    assumed_damping : tuple of int
        Joints (from 1) whose damping is assumed.
    hysteresis : array (n,)
        Half width of the loop [rad].
    path_force : ForceHistory or None
        Force on the tool during the motion, base axes [N].
    following : tuple of int
        Joints (from 1) whose springs are left out, see `with_fast_joints_following`.

    Raises
    ------
    RobotError
        A joint's damping is negative or above critical, or its hysteresis negative.
    NotSimulatedError
        The springs do not hold the arm.
    """

    def __init__(
        self, robot: Robot, at: np.ndarray, process_force: object = (0.0, 0.0, 0.0)
    ) -> None:
        self.robot, self.bodies = robot, robot.rigid_bodies()
        self.following: tuple[int, ...] = ()
        self.process_force = np.asarray(process_force, dtype=float)
        self.path_force: ForceHistory | None = None
        self.springs = joint_springs(robot)
        self.elastic = np.array([spring is not None for spring in self.springs])
        self.hysteresis = _values_or_default(robot.hysteresis, robot.n, 0.0) * self.elastic
        if not np.all(self.hysteresis >= 0.0):
            joint = robot.joint_names[int(np.argmin(self.hysteresis))]
            raise RobotError(f"the hysteresis of {joint} must be a half width of 0 or above.")
        stated = _values_or_default(robot.damping, robot.n, np.nan)
        unknown = np.isnan(stated) & self.elastic
        self.assumed_damping = tuple(int(j) + 1 for j in np.flatnonzero(unknown))
        critical = self._critical_damping(np.asarray(at, dtype=float))
        self.damping = np.where(unknown, ASSUMED_DAMPING * critical, np.nan_to_num(stated))
        self.damping = np.where(self.elastic, self.damping, 0.0)
        self._critical = critical
        self._check_damping()

    def with_departure(self, departure: Departure) -> ElasticArm:
        """Return a copy of the arm with a departure of its parameters.

        Raises `RobotError`: a joint's damping would exceed the critical one.
        """
        self._check_departure_damping(departure.damping)
        other = copy.copy(self)
        other.robot = self.robot.with_payload_times(departure.payload)
        other.robot = other.robot.with_bearings_times(departure.bearings)
        other.bodies = other.robot.rigid_bodies()
        other.springs = tuple(
            None if spring is None else spring.times(float(factor))
            for spring, factor in zip(self.springs, departure.stiffness, strict=True)
        )
        other.damping = departure.damping * self.damping
        return other

    def _check_departure_damping(self, factor: float) -> None:
        damped = self.elastic & (self.damping > 0.0)
        above = factor * self.damping[damped] > (1.0 + _DAMPING_ROUND_OFF) * self._critical[damped]
        if not np.any(above):
            return
        ratio = np.where(damped, self._critical / np.where(damped, self.damping, 1.0), np.inf)
        j = int(np.argmin(ratio))
        # Rounded down: the value in the message must be accepted.
        largest = max(0.0, np.floor(1000.0 * (ratio[j] - 1.0)) / 1000.0)
        raise RobotError(
            f"uncertainty.damping lets the damping of {self.robot.joint_names[j]}, nominally "
            f"{self.damping[j]:.4g} N m s/rad, be {factor * self.damping[j]:.4g}, above the "
            f"critical {self._critical[j]:.4g} of the single-joint vibration; allowed here: from 0 "
            f"to {largest:g}. Give a smaller share, such as uncertainty.damping = {largest:g}."
        )

    def _check_damping(self) -> None:
        for j in np.flatnonzero(
            self.elastic & ~(self.damping <= self._critical) | (self.damping < 0.0)
        ):
            raise RobotError(
                f"the damping of {self.robot.joint_names[j]} must lie between 0 and the critical "
                f"{self._critical[j]:.4g} N m s/rad of the single-joint vibration; got "
                f"{self.damping[j]:.4g}."
            )

    def with_fast_joints_following(self, at: np.ndarray) -> ElasticArm:
        """Return a copy whose joints above `MIN_FOLLOWING_FREQUENCY` are rigid.

        Judged by single-joint frequencies with the motors at `at` (n,). Such a joint stays within
        1e-5 degrees of its motor, and would take an integrator minutes.
        """
        stiffness, inertia = self._single_joint_properties(np.asarray(at, dtype=float))
        fast = self.elastic & (stiffness > (2.0 * np.pi * MIN_FOLLOWING_FREQUENCY) ** 2 * inertia)
        if not fast.any() or np.all(fast == self.elastic):
            return self
        found = copy.copy(self)
        found.following = tuple(int(j) + 1 for j in np.flatnonzero(fast))
        found.springs = tuple(None if fast[j] else spring for j, spring in enumerate(self.springs))
        found.elastic = self.elastic & ~fast
        found.damping = np.where(fast, 0.0, self.damping)
        found.hysteresis = np.where(fast, 0.0, self.hysteresis)
        found.assumed_damping = tuple(j for j in self.assumed_damping if j not in found.following)
        return found

    def damped(self, share: float) -> ElasticArm:
        """Return a copy in which all elastic joints have one damping ratio.

        Raises `RobotError`: the share is not from 0 to 1.
        """
        if not 0.0 <= share <= 1.0:
            raise RobotError(
                f"damping is a share of the critical one, from 0 to 1; got {share:g}. 2 % is 0.02."
            )
        found = copy.copy(self)
        found.damping = np.where(self.elastic, share * np.nan_to_num(self._critical), 0.0)
        found.assumed_damping = ()
        return found

    def scale_assumed_damping(self, factor: float) -> ElasticArm:
        """Return a copy with the assumed damping times a factor; stated damping stays."""
        found = copy.copy(self)
        assumed = np.isin(np.arange(self.robot.n) + 1, self.assumed_damping)
        found.damping = np.where(assumed, factor, 1.0) * self.damping
        return found

    def without_force(self) -> ElasticArm:
        """Return a copy without the process forces."""
        found = copy.copy(self)
        found.process_force, found.path_force = np.zeros(3), None
        return found

    def under(self, force: ForceHistory | None) -> ElasticArm:
        """Return a copy under a force along its path, which is not calibrated away."""
        found = copy.copy(self)
        found.path_force = force
        return found

    def at_first_instant(self) -> ElasticArm:
        """Return a copy under the constant force of the first instant, which it rests under."""
        found = self.without_force()
        found.process_force = self.process_force
        if self.path_force is not None:
            found.process_force = self.process_force + self.path_force(np.zeros(1))[0]
        return found

    def windup(self, torque: np.ndarray) -> np.ndarray:
        """Wind-ups (K, n) [rad] of spring torques (K, n) [N m], at the middle of the loop."""
        columns = [
            np.zeros(len(torque)) if spring is None else spring.windup(torque[:, j])
            for j, spring in enumerate(self.springs)
        ]
        return np.stack(columns, axis=1)

    def stiffness(self, torque: np.ndarray) -> np.ndarray:
        """Tangent stiffness (n,) [N m/rad] at spring torques (n,); infinite for rigid joints."""
        return _tangent_stiffness(self.springs, torque)

    def lag(self, motor: np.ndarray) -> np.ndarray:
        """Damping over stiffness (n,) [s]: delay of each wind-up, at a motor position (n,)."""
        stiffness = self.stiffness(self.static_torque(self.static_equilibrium(motor[None])[0]))
        return np.asarray(self.damping / stiffness)

    def static_torque(self, q: np.ndarray) -> np.ndarray:
        """Static spring torque (n,) [N m] of a link position: weight less process force."""
        return np.asarray(self.bodies.gravity_torque(q) - self.force_torque(q))

    def _static_torques(self, q: np.ndarray) -> np.ndarray:
        return np.asarray(self.robot.bodies_in_motion().gravity_torque(q) - self.force_torque(q))

    def added_torque(
        self, motor: np.ndarray, speed: np.ndarray, acceleration: np.ndarray, load: np.ndarray
    ) -> np.ndarray:
        """Torques (..., n) [N m] that the springs carry besides rigid bodies and process force.

        `motor`, `speed` and `acceleration`: motion of the motors [rad], [rad/s], [rad/s^2]. `load`:
        torque in the springs without them [N m].
        """
        motion = (motor, speed, acceleration, np.tanh(speed / _SIGN_SPEED), load)
        state = MotionState(
            **dict(
                zip(
                    ("position", "velocity", "acceleration", "direction", "load"),
                    (list(np.moveaxis(each, -1, 0)) for each in motion),
                    strict=True,
                )
            )
        )
        sums = sum_added_torques(self.robot.added_torques, state, in_spring=True)
        return np.stack(sums, axis=-1)

    def force_torque(self, q: np.ndarray) -> np.ndarray:
        """Joint torques (..., n) [N m] of the process force in poses (..., n)."""
        if not self.process_force.any():
            return np.zeros(np.shape(q))
        poses = np.reshape(q, (-1, self.robot.n))
        jacobians = np.array([self.bodies.jacobian(self.robot.tool, own)[:3] for own in poses])
        return np.reshape(jacobians.swapaxes(1, 2) @ self.process_force, np.shape(q))

    def static_equilibrium(self, motor: np.ndarray) -> np.ndarray:
        """Link positions (K, n) in static equilibrium at motor positions (K, n)."""
        q = np.array(motor, dtype=float)
        moving = np.arange(len(q))
        for _ in range(_MAX_EQUILIBRIUM_STEPS):
            load = self._static_torques(q[moving])
            if self.robot.added_torques:
                still = np.zeros_like(load)
                load = load + self.added_torque(motor[moving], still, still, load)
            new = motor[moving] - self.windup(load)
            change = np.max(np.abs(new - q[moving]), axis=1)
            q[moving] = new
            moving = moving[change > _EQUILIBRIUM_TOLERANCE]
            if not moving.size:
                return q
        advice = questionable_springs(self.robot, motor[0]) or "Check stiffness and masses."
        raise NotSimulatedError(
            "the arm does not hang at rest on its springs: the static equilibrium diverges under "
            f"its weight. {advice}"
        )

    def tool(self, q: np.ndarray) -> np.ndarray:
        """Tool positions (K, 3) [m] of link positions (K, n)."""
        return frame_positions(self.robot.tree, self.robot.tool, q)

    def tool_error(
        self, time: np.ndarray, duration: float, q: np.ndarray, planned: np.ndarray
    ) -> ToolError:
        """Tool error of link positions (K, n) against the path of planned ones (K, n).

        The planned path is where the tool rests with its motors at the planned positions: the sag
        under weight and process force is calibrated away. `time` (K,). `duration`: arrival of the
        planned path [s]. `q` and `planned` (K, n).
        """
        # After arrival the planned pose is constant.
        moving = min(int(np.searchsorted(time, duration)) + 1, len(time))
        tree, tool = self.robot.tree, self.robot.tool
        orientation, places = np.empty((len(time), 3)), np.empty((len(time), 3))
        # Matrices of all samples of minutes would take a gigabyte.
        for first in range(0, len(time), _SAMPLES_AT_ONCE):
            own = slice(first, min(first + _SAMPLES_AT_ONCE, len(time)))
            poses = planned[min(first, moving - 1) : min(own.stop, moving)]
            resting = self.static_equilibrium(poses)
            rest = own.stop - first - len(poses)
            resting = np.concatenate([resting, np.repeat(resting[-1:], rest, axis=0)])
            axes = frame_rotations(tree, tool, resting).swapaxes(1, 2)
            turned = frame_rotations(tree, tool, q[own]) @ axes
            orientation[own] = scipy.spatial.transform.Rotation.from_matrix(turned).as_rotvec()
            places[own] = self.tool(resting)
        return ToolError(
            time=time,
            duration=duration,
            position=self.tool(q) - places,
            orientation=orientation,
            direction=path_directions(places),
        )

    def _critical_damping(self, at: np.ndarray) -> np.ndarray:
        stiffness, inertia = self._single_joint_properties(at)
        # Infinity times zero for rigid joints without inertia behind them.
        with np.errstate(invalid="ignore"):
            return np.asarray(2.0 * np.sqrt(stiffness * inertia))

    def _single_joint_properties(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stiffness and inertia (n,) of each single-joint vibration, motors at `at` (n,)."""
        q = self.static_equilibrium(at[None])[0]
        return self.stiffness(self.static_torque(q)), np.diag(self.bodies.inertia_matrix(q))


def _tangent_stiffness(springs: Sequence[JointSpring | None], torque: np.ndarray) -> np.ndarray:
    return np.array(
        [
            np.inf if spring is None else spring.torque_at(float(spring.windup(own)))[1]
            for spring, own in zip(springs, torque, strict=True)
        ]
    )


def questionable_springs(robot: Robot, at: np.ndarray) -> str:
    """Describe joints so soft that their stiffness is most likely in another unit.

    Judged by single-joint frequencies with the motors at `at` (n,); "" where there is none.
    """
    bodies = robot.rigid_bodies()
    stiffness = _tangent_stiffness(joint_springs(robot), bodies.gravity_torque(at))
    inertia = np.diag(bodies.inertia_matrix(at))
    slow = np.flatnonzero(stiffness < (2.0 * np.pi * _MIN_PLAUSIBLE_FREQUENCY) ** 2 * inertia)
    if not slow.size:
        return ""
    j = slow[np.argmin(stiffness[slow] / inertia[slow])]
    frequency = np.sqrt(stiffness[j] / inertia[j]) / (2.0 * np.pi)
    given = f"{stiffness[j]:.3g} {joint_unit('N m/rad', bool(robot.prismatic[j]))}"
    more = f" ({len(slow)} joints below {_MIN_PLAUSIBLE_FREQUENCY:g} Hz)" if len(slow) > 1 else ""
    return (
        f"{robot.joint_names[j]} alone would vibrate at {frequency:.2g} Hz with {given}{more}; "
        f"joints of arms do at {_USUAL_MIN_FREQUENCY:g} Hz or more. Check the unit of its "
        "stiffness: 1 N m/arcmin is 3438 N m/rad, 1 N/um is 1e6 N/m."
    )


def rigid_arm_error(robot: Robot) -> NotSimulatedError:
    """Return the error for an arm without elastic joints."""
    return NotSimulatedError(f"{robot.name} is rigid: no joint has an elastic drivetrain.")


def _values_or_default(values: np.ndarray | None, joints: int, default: float) -> np.ndarray:
    return np.full(joints, default) if values is None else np.array(values, dtype=float)
