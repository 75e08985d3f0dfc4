"""Constants of a robot with the ranges of recordings, which scale effects and bound shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stiffopt.discovery.comparison.filtering import fill_missing
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.prepared_run import PreparedRun
from stiffopt.discovery.signals import RobotConstants


def constants_over(robot: RobotModel, runs: Sequence[PreparedRun]) -> RobotConstants:
    """Return the constants with the ranges of some runs.

    Ratings and friction that the set does not state are those that the recordings show, where
    these are larger: limits in a URDF are often placeholders, of which a rating is a share.
    """
    base, rated_stated = robot.constants, robot.recordings.nominal.torque_rated is not None
    commanded = robot.recordings.signals.commanded

    def stack(name: str) -> np.ndarray:
        return np.vstack([getattr(run.signals, name) for run in runs])

    motor, speed = stack("motor_position"), np.abs(stack("motor_velocity"))
    spring, drive = np.abs(stack("spring_torque")), np.abs(stack("drive_torque"))
    tool = stack("tool_position")
    joints = []
    for j, own in enumerate(base.joints):
        largest, measured = float(drive[:, j].max()), largest_torque(runs, j)
        if commanded:  # commands may ask a drive for more than it gives and the motion needs
            measured = min(measured, largest)
        coulomb, viscous = _shown_friction(runs, j)
        known = np.isfinite(own.torque_max)
        rated = own.torque_rated if known else max(largest / 2.0, 1e-6)
        joints.append(
            replace(
                own,
                torque_max=own.torque_max if known else max(largest, 1e-6),
                torque_rated=rated if rated_stated else max(rated, measured / 3.0),
                stroke=(float(motor[:, j].min()), float(motor[:, j].max())),
                fastest=max(float(speed[:, j].max()), 1e-6),
                measured_torque=measured,
                largest_torque=max(float(spring[:, j].max()), 1e-9),
                shown_coulomb=coulomb,
                shown_viscous=viscous,
            )
        )
    span = np.array([tool.min(axis=0), tool.max(axis=0)])
    return replace(base, joints=tuple(joints), tool_range=span)


def largest_torque(runs: Sequence[PreparedRun], joint: int) -> float:
    """Return the largest filtered measured torque of a joint; 0 without any [N m]."""
    largest = 0.0
    for run in runs:
        used = run.torque_used[:, joint]
        if used.any():
            torque = fill_missing(run.torque[:, joint : joint + 1])[:, 0]
            largest = max(largest, float(np.abs(run.low_pass(torque)[used]).max()))
    return largest


def _shown_friction(runs: Sequence[PreparedRun], joint: int) -> tuple[float, float]:
    """Return dry and viscous friction beside the nominal torque, a scale and no estimate.

    By least squares, beside an offset and the inertia of a rotor; 0 without a torque.
    """
    found = []
    for run in runs:
        used = run.torque_used[:, joint]
        if used.any():
            s = run.signals
            columns = [
                s.motor_direction[:, joint],
                s.motor_velocity[:, joint],
                s.motor_acceleration[:, joint],
                np.ones(len(used)),
                fill_missing(run.torque[:, joint : joint + 1])[:, 0] - s.drive_torque[:, joint],
            ]
            found.append(run.low_pass(np.column_stack(columns))[used])
    if not found:
        return 0.0, 0.0
    lines = np.vstack(found)
    dry, viscous, *_ = np.linalg.lstsq(lines[:, :-1], lines[:, -1], rcond=None)[0]
    return max(float(dry), 0.0), max(float(viscous), 0.0)
