"""Limits of every joint by a curve: velocity over position, torque over speed."""

from __future__ import annotations

from abc import abstractmethod
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


class JointCurve(DriveLimit):
    """Limit of a joint quantity, piecewise linear over another one, constant beyond its ends.

    The attribute of `Limits` is (places (k, n), bounds (k, n)) or None. `name`: key in files.
    `columns` (str, str): letters of the table's columns: of the place and of the bound.
    """

    def __init__(self, name: str, attribute: str, columns: tuple[str, str], doc: str) -> None:
        self.name, self._attribute, self._columns = name, attribute, columns
        self.keys = (
            LimitKey(
                key=name,
                attribute=attribute,
                form=str | None,
                description=doc,
                value=lambda robot: None,
            ),
        )

    def active(self, limits: Limits) -> bool:
        """Return True if a table is given."""
        return getattr(limits, self._attribute) is not None

    def read(self, section: Section, joints: JointLists) -> dict[str, Any]:
        """Read the table of the named file."""
        name = getattr(section, self.name)
        path, count = joints.path.parent, len(joints.names)
        table = None if name is None else _read_curve(path / name, count, self._columns)
        return {self._attribute: table}

    @abstractmethod
    def sides(self, model: StageModel, joint: int) -> tuple[tuple[str, Quantity, Quantity], ...]:
        """Side, limited quantity and place of each row of a joint (from 0)."""

    @abstractmethod
    def history(self, motion: DriveHistory) -> tuple[np.ndarray, np.ndarray]:
        """Places and magnitudes (K, n) over a motion."""

    def rows(self, problem: TrajectoryProblem, model: StageModel, margin: float) -> list[PathRows]:
        """Rows on both signs of each joint's quantity."""
        places, bounds = getattr(problem.active_limits, self._attribute)
        expressions, labels = [], []
        for j in range(places.shape[1]):
            scale = float(np.max(bounds[:, j]))
            for side, value, place in self.sides(model, j):
                allowed = _interpolate_symbolic(place, places[:, j], bounds[:, j])
                expressions.append((value - (1.0 - margin) * allowed) / scale)
                labels.append(f"joint {j + 1} {side}")
        return [PathRows(name=self.name, labels=tuple(labels), expressions=tuple(expressions))]

    def violations(self, limits: Limits, motion: DriveHistory) -> list[Violation]:
        """Violation of the worst joint and instant."""
        places, values = self.history(motion)
        allowed = curve_at(getattr(limits, self._attribute), places)
        return [worst_joint(self.name, values / allowed - 1.0, motion)]


class VelocityByPosition(JointCurve):
    """Velocity over the joint's own position."""

    def sides(self, model: StageModel, joint: int) -> tuple[tuple[str, Quantity, Quantity], ...]:
        """Forward and backward velocity at the position."""
        speed, place = model.velocity[joint], model.position[joint]
        return ("forward", speed, place), ("backward", -speed, place)

    def history(self, motion: DriveHistory) -> tuple[np.ndarray, np.ndarray]:
        """Positions and speeds."""
        return motion.position, np.abs(motion.velocity)


class TorqueBySpeed(JointCurve):
    """Drive torque over the joint's speed, as data sheets of motors state it."""

    def sides(self, model: StageModel, joint: int) -> tuple[tuple[str, Quantity, Quantity], ...]:
        """Torque of either sign, at speeds of either sign: curves fall with the speed."""
        speed = model.velocity[joint]
        torques = [side * model.torque_envelope(side)[joint] for side in (1.0, -1.0)]
        return tuple(
            (f"{name} {way}", torque, place)
            for name, torque in zip(("driving", "braking"), torques, strict=True)
            for way, place in (("forward", speed), ("backward", -speed))
        )

    def history(self, motion: DriveHistory) -> tuple[np.ndarray, np.ndarray]:
        """Speeds and torques."""
        return np.abs(motion.velocity), np.abs(motion.torque)


def curve_at(table: tuple[np.ndarray, np.ndarray], place: np.ndarray) -> np.ndarray:
    """Bounds (K, n) at places (K, n)."""
    at, allowed = table
    columns = [np.interp(place[:, j], at[:, j], allowed[:, j]) for j in range(at.shape[1])]
    return np.stack(columns, axis=1)


def allowed_torque(limits: Limits, velocity: np.ndarray) -> np.ndarray:
    """Largest drive torques (K, n) [N m] at joint velocities (K, n)."""
    allowed = np.broadcast_to(limits.torque, velocity.shape)
    if limits.torque_map is not None:
        allowed = np.minimum(allowed, curve_at(limits.torque_map, np.abs(velocity)))
    return allowed


def _interpolate_symbolic(x: Quantity, knots: np.ndarray, values: np.ndarray) -> Quantity:
    """Linear interpolation, constant outside the knots, as a sum of hinges."""
    slopes = np.concatenate(([0.0], np.diff(values) / np.diff(knots), [0.0]))
    result: Quantity = float(values[0])
    for knot, change in zip(knots, np.diff(slopes), strict=True):
        if change != 0.0:
            result = result + float(change) * np.fmax(x - float(knot), 0.0)
    return result


def _read_curve(path: Path, joints: int, letters: tuple[str, str]) -> tuple[np.ndarray, np.ndarray]:
    """Read increasing places and bounds above zero, (k, joints) each, in SI."""
    columns = [f"{letter}{j + 1}" for letter in letters for j in range(joints)]
    read = read_table(path, columns)
    table = np.column_stack([read[column] for column in columns])
    places, bounds = table[:, :joints], table[:, joints:]
    for row, j in np.argwhere(np.diff(places, axis=0) <= 0):
        raise InputFileError(
            path,
            f"row {row + 2}, {letters[0]}{j + 1}",
            f"{places[row + 1, j]:g} follows {places[row, j]:g}; the column must increase from row "
            "to row.",
        )
    for row, j in np.argwhere(bounds <= 0):
        raise InputFileError(
            path,
            f"row {row + 1}, {letters[1]}{j + 1}",
            f"a limit must be greater than zero, got {bounds[row, j]:g}.",
        )
    return places, bounds


LIMITS.add(
    VelocityByPosition(
        "velocity_by_position",
        "velocity_map",
        ("q", "v"),
        "CSV file beside this one with the columns q1.., v1.., one each per joint "
        "[rad, m; rad/s, m/s]: largest velocity over that joint's own position.",
    )
)
LIMITS.add(
    TorqueBySpeed(
        "torque_by_speed",
        "torque_map",
        ("v", "t"),
        "CSV file beside this one with the columns v1.., t1.., one each per joint "
        "[rad/s, m/s; N m, N]: largest drive torque over that joint's speed, from 0 on.",
    )
)
