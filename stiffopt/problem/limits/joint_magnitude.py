"""Limits on the magnitude of a joint quantity: velocity, acceleration, jerk and torque."""

from __future__ import annotations

from dataclasses import replace
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from stiffopt.declaration import JointAcceleration, JointJerk, JointTorque, JointVelocity
from stiffopt.errors import InputFileError, ProblemError
from stiffopt.problem.limit import LIMITS, DriveLimit, LimitKey, Limits
from stiffopt.problem.stage_terms import PathRows
from stiffopt.result.assessment import DriveHistory, Violation

if TYPE_CHECKING:
    from stiffopt.problem.joint_lists import JointLists
    from stiffopt.problem.stage_model import StageModel
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.symbolic import Quantity
    from stiffopt.validation import Section


# Largest limit accepted [SI]: larger values are input errors and spoil the scaling of the NLP.
_MAX_LIMIT = 1e9


class JointMagnitude(DriveLimit):
    """|quantity| <= limit for every joint; the robot's own where the file gives none.

    `name`: key, attribute of `Assessment`, and NAME_max of the robot. `form`: type of one entry in
    a file, in `units`. `dimension`: dimension for a revolute joint.
    """

    quantity = ""  # in sentences; "" for the name

    def __init__(
        self, name: str, form: Any, dimension: str, units: str, order: int | None = None
    ) -> None:
        self.name, self.dimension, self.order = name, dimension, order
        self.keys = (
            LimitKey(
                key=name,
                form=list[form] | Literal["none"] | None,
                description=f"Largest {self.quantity or name} of each joint [{units}]; the robot's "
                'own if left out, "none" for none.',
                value=lambda robot: getattr(robot, f"{name}_max"),
                of_robot=True,
                scaled=True,
            ),
        )

    def active(self, limits: Limits) -> bool:
        """Return True if any joint has a finite limit."""
        return bool(np.any(np.isfinite(getattr(limits, self.name))))

    def read(self, section: Section, joints: JointLists) -> dict[str, Any]:
        """Read a list, "none" or the robot's own, times the factor of limits.scale."""
        given = getattr(section, self.name)
        if given is None:
            array = self.keys[0].value(joints.robot)
        elif given == "none":
            array = np.full(len(joints.names), np.inf)
        else:
            array = joints(given, self.dimension, f"limits.{self.name}")
            if np.any(array <= 0) or np.any(array > _MAX_LIMIT):
                raise InputFileError(
                    joints.path,
                    f"limits.{self.name}",
                    f"every limit must be greater than zero and at most {_MAX_LIMIT:g}; "
                    f'got {array.tolist()}. Write "none" where there is no limit.',
                )
        return {self.name: array * attrgetter(f"scale.{self.name}")(section)}

    def bounds(self, limits: Limits, margin: float) -> tuple[np.ndarray, np.ndarray]:
        """Symmetric bounds."""
        bound = getattr(limits, self.name) * (1.0 - margin)
        return -bound, bound

    def rows(self, problem: TrajectoryProblem, model: StageModel, margin: float) -> list[PathRows]:
        """One row for each joint with a finite limit."""
        bound = getattr(problem.active_limits, self.name)
        return [magnitude_rows(self.name, getattr(model, self.name), bound, margin)]

    def violations(self, limits: Limits, motion: DriveHistory) -> list[Violation]:
        """Violation of the worst joint and instant."""
        return [self._worst_violation(limits, motion, np.abs(getattr(motion, self.name)))]

    def _worst_violation(
        self, limits: Limits, motion: DriveHistory, magnitude: np.ndarray
    ) -> Violation:
        return worst_joint(self.name, magnitude / getattr(limits, self.name) - 1.0, motion)


def magnitude_rows(name: str, values: Quantity, bound: np.ndarray, margin: float) -> PathRows:
    """Rows |value| <= bound (n,) of joints with a finite bound, relative to it."""
    joints = np.flatnonzero(np.isfinite(bound))
    return PathRows(
        name=name,
        labels=tuple(f"joint {j + 1}" for j in joints),
        expressions=tuple(values[int(j)] / bound[j] for j in joints),
        lower=margin - 1.0,
        upper=1.0 - margin,
    )


def worst_joint(name: str, excess: np.ndarray, motion: DriveHistory) -> Violation:
    """Violation at the largest entry of a relative excess (K, n)."""
    k, j = np.unravel_index(int(np.argmax(excess)), excess.shape)
    return Violation(float(excess[k, j]), name, int(j) + 1, float(motion.time[k]))


LIMITS.add(JointMagnitude("velocity", JointVelocity, "angular velocity", "rad/s, m/s", order=1))


LIMITS.add(
    JointMagnitude(
        "acceleration", JointAcceleration, "angular acceleration", "rad/s^2, m/s^2", order=2
    )
)


class Jerk(JointMagnitude):
    """Jerk limit, a bound of the controls' rate; jumps of the acceleration exceed any limit."""

    def rows(self, problem: TrajectoryProblem, model: StageModel, margin: float) -> list[PathRows]:
        """One row per joint with planned links; refused on a fixed path."""
        if problem.plans_links:
            return super().rows(problem, model, margin)
        raise ProblemError(
            "Jerk limits cannot be kept on a fixed path: the path coordinate has a limited "
            'acceleration only. Write limits.jerk = "none" (inf in Python), or give poses instead '
            "of motion.path."
        )

    def violations(self, limits: Limits, motion: DriveHistory) -> list[Violation]:
        """Violation of the worst joint; acceleration jumps count by their slope on the grid."""
        slope = np.abs(np.diff(motion.acceleration, axis=0)) / np.diff(motion.time)[:, None]
        jerk = np.abs(motion.jerk)
        jerk[:-1] = np.maximum(jerk[:-1], slope)
        return [self._worst_violation(limits, motion, jerk)]


LIMITS.add(Jerk("jerk", JointJerk, "angular jerk", "rad/s^3, m/s^3", order=3))


class Torque(JointMagnitude):
    """Limit on the drive torque, rotor inertia and friction included."""

    quantity = "drive torque"

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


LIMITS.add(Torque("torque", JointTorque, "torque", "N m, N"))
