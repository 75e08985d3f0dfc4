"""Velocity limit of every joint as a function of that joint's own position."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stiffopt.errors import InputFileError
from stiffopt.files import read_table
from stiffopt.problem.limit import LIMITS, DriveLimit, LimitKey, Limits
from stiffopt.problem.limits.joint_magnitude import worst_joint
from stiffopt.problem.stage_terms import PathRows
from stiffopt.result.assessment import DriveHistory, Violation

if TYPE_CHECKING:
    from stiffopt.problem.joint_lists import JointLists
    from stiffopt.problem.stage_model import StageModel
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.symbolic import Quantity
    from stiffopt.validation import Section


class VelocityByPosition(DriveLimit):
    """Velocity limit as a piecewise-linear function of position, constant beyond its ends.

    The attribute `velocity_map` is (positions (k, n) [rad], velocities (k, n) [rad/s]) or None.
    """

    name = "velocity_by_position"
    keys = (
        LimitKey(
            key="velocity_by_position",
            attribute="velocity_map",
            form=str | None,
            description="CSV file beside this one with the columns q1.., v1.., one each per joint "
            "[rad, m; rad/s, m/s]: largest velocity over that joint's own position.",
            value=lambda robot: None,
        ),
    )

    def active(self, limits: Limits) -> bool:
        """Return True if a table is given."""
        return limits.velocity_map is not None

    def read(self, section: Section, joints: JointLists) -> dict[str, Any]:
        """Read the table of the named file."""
        name = getattr(section, self.name)
        table = None if name is None else _read_map(joints.path.parent / name, len(joints.names))
        return {"velocity_map": table}

    def rows(self, problem: TrajectoryProblem, model: StageModel, margin: float) -> list[PathRows]:
        """Rows on forward and backward velocity of each joint."""
        positions, speeds = problem.active_limits.velocity_map
        expressions, labels = [], []
        for j in range(positions.shape[1]):
            allowed = _interpolate_symbolic(model.position[j], positions[:, j], speeds[:, j])
            scale = float(np.max(speeds[:, j]))
            for sign, side in ((1.0, "forward"), (-1.0, "backward")):
                slack = sign * model.velocity[j] - (1.0 - margin) * allowed
                expressions.append(slack / scale)
                labels.append(f"joint {j + 1} {side}")
        return [PathRows(name=self.name, labels=tuple(labels), expressions=tuple(expressions))]

    def violations(self, limits: Limits, motion: DriveHistory) -> list[Violation]:
        """Violation of the worst joint and instant."""
        allowed = velocity_at(limits.velocity_map, motion.position)
        return [worst_joint(self.name, np.abs(motion.velocity) / allowed - 1.0, motion)]


def velocity_at(table: tuple[np.ndarray, np.ndarray], position: np.ndarray) -> np.ndarray:
    """Velocity limits (K, n) at positions (K, n)."""
    at, allowed = table
    columns = [np.interp(position[:, j], at[:, j], allowed[:, j]) for j in range(at.shape[1])]
    return np.stack(columns, axis=1)


def _interpolate_symbolic(x: Quantity, knots: np.ndarray, values: np.ndarray) -> Quantity:
    """Linear interpolation, constant outside the knots, as a sum of hinges."""
    slopes = np.concatenate(([0.0], np.diff(values) / np.diff(knots), [0.0]))
    result: Quantity = float(values[0])
    for knot, change in zip(knots, np.diff(slopes), strict=True):
        if change != 0.0:
            result = result + float(change) * np.fmax(x - float(knot), 0.0)
    return result


def _read_map(path: Path, joints: int) -> tuple[np.ndarray, np.ndarray]:
    """Read increasing positions and speed limits, (k, joints) each, in SI."""
    columns = [f"{letter}{j + 1}" for letter in "qv" for j in range(joints)]
    read = read_table(path, columns)
    table = np.column_stack([read[column] for column in columns])
    positions, speeds = table[:, :joints], table[:, joints:]
    for row, j in np.argwhere(np.diff(positions, axis=0) <= 0):
        raise InputFileError(
            path,
            f"row {row + 2}, q{j + 1}",
            f"{positions[row + 1, j]:g} follows {positions[row, j]:g}; positions must increase "
            "from row to row.",
        )
    for row, j in np.argwhere(speeds <= 0):
        raise InputFileError(
            path,
            f"row {row + 1}, v{j + 1}",
            f"a speed limit must be greater than zero, got {speeds[row, j]:g}.",
        )
    return positions, speeds


LIMITS.add(VelocityByPosition())
