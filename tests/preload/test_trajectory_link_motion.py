"""Studies along motions whose links have a motion of their own, as shaped ones have."""

import csv

import numpy as np
import pytest

from stiffopt import load_robot
from stiffopt.errors import InputFileError
from stiffopt.preload.load_sources import trajectory_history
from stiffopt.robot.joint_load import joint_wrenches

ROBOT = load_robot("er3a_c60").with_payload(3.0, (0.0, 0.0, 0.1))
TIME = np.arange(0.0, 0.5, 0.002)
RATES = np.array([2.0, 3.0, 4.0, 5.0, 3.0, 2.0])
SWING = 40.0


def motion(amplitude):
    """Positions, velocities and accelerations (K, 6) of sines, with a swing on top."""
    own = [np.sin(np.outer(TIME, RATES)), np.cos(np.outer(TIME, RATES)) * RATES]
    own.append(-np.sin(np.outer(TIME, RATES)) * RATES**2)
    swing = [np.sin(SWING * TIME), SWING * np.cos(SWING * TIME)]
    swing.append(-(SWING**2) * np.sin(SWING * TIME))
    return [0.3 * a + amplitude * b[:, None] for a, b in zip(own, swing, strict=True)]


def written(path, links):
    """trajectory.csv of a plan whose links swing: the springs carry what the links do."""
    plan, real = motion(0.0), motion(1e-3)
    spring = joint_wrenches(ROBOT, *real, np.zeros(3))[..., 5]
    columns = {"t": TIME}
    for name, values in (("q", plan[0]), ("qd", plan[1]), ("qdd", plan[2]), ("tau_spring", spring)):
        columns |= {f"{name}{j + 1}": values[:, j] for j in range(6)}
    if links:
        columns |= {f"link{j + 1}": real[0][:, j] for j in range(6)}
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        writer.writerows(np.column_stack(list(columns.values())).tolist())
    return path


def test_flange_loads_follow_link_motion(tmp_path):
    path = written(tmp_path / "trajectory.csv", links=True)
    found = trajectory_history(ROBOT, "swinging", path, np.zeros(3), whole=True)
    true = joint_wrenches(ROBOT, *motion(1e-3), np.zeros(3))
    # All six components, not the torque alone; those of the plan are far from it.
    assert np.abs(found.wrench - true).max() < 2e-3 * np.abs(true).max()
    plan = joint_wrenches(ROBOT, *motion(0.0), np.zeros(3))
    assert np.abs(found.wrench - plan).max() > 0.05 * np.abs(true).max()


def test_link_torques_without_link_motion_are_refused(tmp_path):
    path = written(tmp_path / "trajectory.csv", links=False)
    with pytest.raises(InputFileError, match="differs by up to"):
        trajectory_history(ROBOT, "swinging", path, np.zeros(3), whole=True)
