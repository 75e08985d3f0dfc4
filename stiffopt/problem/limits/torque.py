"""Largest drive torque of every joint."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.declaration import JointTorque
from stiffopt.problem.limit import LIMITS
from stiffopt.problem.limits.joint_magnitude import JointMagnitude, magnitude_rows
from stiffopt.problem.stage_terms import PathRows

if TYPE_CHECKING:
    from stiffopt.problem.stage_model import StageModel
    from stiffopt.problem.trajectory import TrajectoryProblem


class Torque(JointMagnitude):
    """Limit on the drive torque, rotor inertia and friction included."""

    def rows(self, problem: TrajectoryProblem, model: StageModel, margin: float) -> list[PathRows]:
        """One row per joint; with dry friction, one per side by its envelope."""
        bound = problem.active_limits.torque
        if not np.any(problem.robot.coulomb):
            return [magnitude_rows(self.name, model.drive_torque, bound, margin)]
        sides = [
            magnitude_rows(self.name, side * model.torque_envelope(side), bound, margin)
            for side in (1.0, -1.0)
        ]
        return [replace(rows, lower=-np.inf) for rows in sides]


LIMITS.add(
    Torque(
        "torque",
        JointTorque,
        "torque",
        "Largest drive torque of each joint [N m, N]; the robot's own if left out, "
        '"none" for none.',
    )
)
