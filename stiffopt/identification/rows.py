"""Deflection of an arm at rest as rows that are linear in the compliances of its joints.

The torque that winds a joint up is that of the weight less that of the force on the tool,
s = g(q) - J^T f, and the tool moves by -J phi(s). With phi = c s, one column a joint.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stiffopt.errors import InputFileError
from stiffopt.recording.static_set import StaticSet

Windup = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, kw_only=True, eq=False)
class StaticRows:
    """Loads of every pose and what they move.

    Parameters
    ----------
    jacobian : array (m, 3, n)
        Of the tool's position, base frame [m/rad].
    pull : array (m, n)
        Torque of the force on the tool, J^T f [N m].
    weight : array (m, n) or None
        Torque that holds the weight of the links, g(q) [N m]; None without masses.
    displacement : array (m, 3)
        Measured [m].
    difference : bool
        Displacements are differences of two load states, with and without the force.
    """

    jacobian: np.ndarray
    pull: np.ndarray
    weight: np.ndarray | None
    displacement: np.ndarray
    difference: bool

    @property
    def load(self) -> np.ndarray:
        """Torque that a constant compliance turns into the measured displacement, (m, n) [N m].

        Positive in the direction of the deflection.
        """
        if self.difference or self.weight is None:
            return self.pull
        return np.asarray(self.pull - self.weight)

    def compliance_columns(self) -> np.ndarray:
        """Displacement of the tool for a compliance of one, per joint: (m, 3, n)."""
        return np.asarray(self.jacobian * self.load[:, None, :])

    def windup_columns(self, windup: Windup, *, on_weight: bool) -> np.ndarray:
        """Displacement of the tool for a wind-up law, per joint.

        Parameters
        ----------
        windup : function (m, n) -> (m, n)
            Odd in the torque [N m].
        on_weight : bool
            The difference is taken about the weight that the joint already carries; else about
            an unloaded joint.

        Returns
        -------
        array (m, 3, n)
        """
        if self.difference and on_weight and self.weight is not None:
            moved = windup(self.weight) - windup(self.weight - self.pull)
        else:
            moved = windup(self.load)
        return np.asarray(self.jacobian * moved[:, None, :])


def static_rows(recorded: StaticSet) -> StaticRows:
    """Rows of a static set.

    Raises
    ------
    InputFileError
        Too few poses, or displacements that include the weight of links without mass.
    """
    m, n = recorded.position.shape
    if m < 3 or 3 * m <= n:
        least = max(3, n // 3 + 1)
        raise InputFileError(
            recorded.path, "poses", f"{m} poses cannot tell {n} joints and their errors apart. "
            f"Measure at least {least}, better {2 * n}."
        )  # fmt: skip
    massive = any(body.mass > 0.0 for body in recorded.robot.tree.bodies)
    if not recorded.difference and not massive:
        raise InputFileError(
            recorded.path, "difference", "is false, so the weight of the links is in the "
            "displacements, but no link of the robot has a mass. Give the masses, or differences "
            "of two load states with difference = true."
        )  # fmt: skip
    robot, order = recorded.robot, recorded.order
    bodies = robot.rigid_bodies()
    jacobian, weight = np.empty((m, 3, n)), np.empty((m, n))
    for k, position in enumerate(recorded.position):
        q = np.empty(n)
        q[order] = position
        jacobian[k] = bodies.jacobian(robot.tool, q)[:3, order]
        weight[k] = bodies.gravity_torque(q)[order]
    return StaticRows(
        jacobian=jacobian,
        pull=np.einsum("kij,ki->kj", jacobian, recorded.force),
        weight=weight if massive else None,
        displacement=recorded.displacement,
        difference=recorded.difference,
    )
