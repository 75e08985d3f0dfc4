"""The nominal model of a recording set along a motion: torques, wind-up, friction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from stiffopt.discovery.comparison.signals import (
    JointConstants,
    RobotConstants,
    RobotSignals,
    smooth_sign,
)
from stiffopt.discovery.settings import fill_missing
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun
from stiffopt.robot import native_bodies
from stiffopt.robot.along_motion import body_torques, tool_along
from stiffopt.robot.frames import first_link_of


class RobotModel:
    """Nominal dynamics in the order of the set's joints.

    Parameters
    ----------
    recordings : RecordingSet

    Attributes
    ----------
    n : int
        Joints.
    rotor_inertia, coulomb, viscous : array (n,)
        Zero where the set is silent.
    kept_torques : dict
        Torques of single bodies along motions, those asked for last.
    """

    def __init__(self, recordings: RecordingSet) -> None:
        self.recordings = recordings
        self.arm = recordings.robot
        self._bodies = self.arm.bodies_in_motion()
        native_bodies.prepare()
        self.order = np.asarray(recordings.order)
        self.n = len(recordings.joints)
        self.rotor_inertia = self.arm.rotor_inertia[self.order]
        self.coulomb = self.arm.coulomb[self.order]
        self.viscous = self.arm.viscous[self.order]
        self._balance = recordings.nominal.counterbalance
        self.kept_torques: dict[tuple[object, int], np.ndarray] = {}

    # ---- constants

    @cached_property
    def constants(self) -> RobotConstants:
        """Constants without any range met."""
        nominal, connections = self.recordings.nominal, self.recordings.nominal.connections
        torque_max = self.arm.torque_max[self.order]
        torque_max = np.where((torque_max > 0.0) & np.isfinite(torque_max), torque_max, np.nan)
        rated = fill_missing(nominal.torque_rated, torque_max / 3.0)
        ratio = fill_missing(nominal.gear_ratio, np.ones(self.n))
        damping = fill_missing(nominal.joint_damping, np.zeros(self.n))
        joints = tuple(
            JointConstants(
                joint=j + 1,
                ratio=float(ratio[j]),
                coulomb=float(self.coulomb[j]),
                viscous=float(self.viscous[j]),
                torque_rated=float(rated[j]),
                torque_max=float(torque_max[j]),
                rotor_inertia=float(self.rotor_inertia[j]),
                joint_damping=float(damping[j]),
                chain=self.arm.chains[self.order[j]],
                pole_pairs=nominal.pole_pairs,
                prismatic=bool(self.recordings.prismatic[j]),
                belt=None if connections is None else "belt" in connections[j],
            )
            for j in range(self.n)
        )
        bodies = [self.arm.tree.bodies[j] for j in self.order]
        return RobotConstants(
            joints=joints,
            links=tuple(first_link_of(self.arm.model, int(j) + 1) for j in self.order),
            masses=np.array([body.mass for body in bodies]),
            centres=np.array([body.centre for body in bodies]),
            tool_range=np.array([[-1.0] * 3, [1.0] * 3]),
        )

    def ranged(
        self, signals: Sequence[RobotSignals], measured: np.ndarray | None = None
    ) -> RobotConstants:
        """Constants with the ranges that some runs meet; unknown torques from what they carry.

        Parameters
        ----------
        signals : sequence of RobotSignals
        measured : array (n,), optional
            Largest torque that they show [N m].
        """
        base = self.constants

        def stack(name: str) -> np.ndarray:
            return np.vstack([getattr(s, name) for s in signals])

        motor, speed = stack("motor_position"), np.abs(stack("motor_velocity"))
        spring, drive = np.abs(stack("spring_torque")), np.abs(stack("drive_torque"))
        tool = stack("tool_position")
        joints = []
        for j, own in enumerate(base.joints):
            largest = float(drive[:, j].max())
            known = np.isfinite(own.torque_max)
            joints.append(
                replace(
                    own,
                    torque_max=own.torque_max if known else max(largest, 1e-6),
                    torque_rated=own.torque_rated if known else max(largest / 2.0, 1e-6),
                    stroke=(float(motor[:, j].min()), float(motor[:, j].max())),
                    fastest=max(float(speed[:, j].max()), 1e-6),
                    measured_torque=0.0 if measured is None else float(measured[j]),
                    largest_torque=max(float(spring[:, j].max()), 1e-9),
                )
            )
        span = np.array([tool.min(axis=0), tool.max(axis=0)])
        return replace(base, joints=tuple(joints), tool_range=span)

    # ---- along a motion, (K, n) each, in the set's order

    @property
    def elastic(self) -> bool:
        """Whether any nominal joint winds up."""
        return any(joint.elastic for joint in self.constants.joints)

    @property
    def swings(self) -> bool:
        """Whether every joint's spring and damping is known."""
        return self.recordings.swings

    def windup(self, torque: np.ndarray) -> np.ndarray:
        """Nominal wind-up under spring torques [rad]."""
        joints = enumerate(self.constants.joints)
        return np.array([joint.windup(torque[:, j]) for j, joint in joints]).T

    def compliance(self, torque: np.ndarray) -> np.ndarray:
        """Slope of the nominal wind-up [rad/(N m)]."""
        return np.column_stack(
            [joint.compliance(torque[:, j]) for j, joint in enumerate(self.constants.joints)]
        )

    def friction(self, velocity: np.ndarray, direction: np.ndarray | None = None) -> np.ndarray:
        """Nominal friction torque [N m], with a smooth sign where no direction is given."""
        side = smooth_sign(velocity) if direction is None else direction
        return np.asarray(self.coulomb * side + self.viscous * velocity)

    def spring_torque(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Torque in the springs, of rigid bodies and counterbalances [N m]."""
        torque = self._bodies.torque(*(self._of_robot(x) for x in (q, v, a)))[:, self.order]
        for balance in self._balance:
            j = balance.joint
            torque[:, j] -= balance.at(q[:, j])
        return torque

    def gravity_torque(self, q: np.ndarray, gravity: np.ndarray) -> np.ndarray:
        """Torque (K, n) that holds the weight under another gravity (3,) [m/s^2]."""
        bodies = self._bodies.with_gravity(gravity)
        return bodies.gravity_torque(self._of_robot(q))[:, self.order]

    def torque_slopes(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Slopes of the bodies' torques along position, velocity, acceleration (K, n, n) each."""
        slopes = self._bodies.torque_slopes(*(self._of_robot(x) for x in (q, v, a)))
        position, velocity, acceleration = (x[:, self.order][..., self.order] for x in slopes)
        return position, velocity, acceleration

    def body_torques(self, body: int, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Spring torques for the inertial parameters of one body (K, n, 10)."""
        motion = (self._of_robot(x) for x in (q, v, a))
        torques = body_torques(self.arm.tree, int(self.order[body]), *motion)
        # No copy where the set has the robot's order: that is the largest array of a long run.
        return torques if np.all(self.order == np.arange(self.n)) else torques[:, self.order]

    def body_regressor(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Spring torques for the inertial parameters of every body (K, n, 10 n)."""
        return np.concatenate([self.body_torques(b, q, v, a) for b in range(self.n)], axis=2)

    def changed_torque(
        self, change: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray
    ) -> np.ndarray:
        """Spring torques (K, n) of changed inertial parameters (n, 10)."""
        by_body = np.empty_like(change)
        by_body[self.order] = change
        motion = (self._of_robot(x) for x in (q, v, a))
        return self._bodies.changed_torque(by_body, *motion)[:, self.order]

    def tilt(self, q: np.ndarray) -> np.ndarray:
        """Change of the gravity torques for a turn of the base about x and y (K, n, 2)."""
        # Gravity turns the other way in the base's axes.
        turned = [-np.cross(axis, self.recordings.gravity) for axis in np.eye(3)[:2]]
        return np.stack([self.gravity_torque(q, gravity) for gravity in turned], axis=2)

    def tool(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tool position (K, 3) and its Jacobian (K, 3, n)."""
        position, jacobian = tool_along(self.arm.tree, self.arm.tool, self._of_robot(q))
        return position, jacobian[..., self.order]

    def temperature_rise(self, run: RecordedRun, count: int) -> np.ndarray:
        """Housing temperature above that at which friction was identified (K, n) [K]."""
        reference = self.recordings.nominal.friction_temperature
        if run.temperature is None or reference is None:
            return np.zeros((self.n, count)).T
        return np.tile(np.asarray(run.temperature, dtype=float) - reference, (count, 1))

    def _of_robot(self, values: np.ndarray) -> np.ndarray:
        """Columns (K, n) in the robot's own order."""
        full = np.empty_like(values)
        full[:, self.order] = values
        return full
