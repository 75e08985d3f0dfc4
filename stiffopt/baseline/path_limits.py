"""Limits of an arm along a path, as rows linear in path acceleration u and squared speed x.

With q = q(s): velocity q' sqrt(x), acceleration q' u + q'' x, torque a u + b x + c; dry friction
adds a constant. Viscous friction is a term in sqrt(x), which is not linear: it enters through
conservative linear bounds. Where friction loads the drive, the tangent of sqrt(x) lies above it;
where friction helps, the chord from standstill lies below it. The tangent point comes from the
previous pass, so that repeated passes close the gap on the loaded side.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.certificate.rigid_body import link_torques, rigid_body_history
from stiffopt.errors import format_factor, is_factor
from stiffopt.problem.limits.joint_curve import curve_at
from stiffopt.result.joint_path import JointPath

if TYPE_CHECKING:
    from stiffopt.problem.limit import Limits
    from stiffopt.robot.robot import Robot

# Largest squared path speed: toppra's solver bounds its variables by 1e8.
_SQUARED_SPEED_MAX = 1e7


@dataclass(frozen=True)
class PathLimits:
    """Rows a u + b x + c <= 1 and bounds of x on a grid of the path."""

    grid: np.ndarray  # (N,) path parameters
    # (a, b, c) arrays (N, m) divided by their limits.
    rows: tuple[np.ndarray, np.ndarray, np.ndarray]
    # (N, m) factor of sqrt(x) in each row from viscous friction; negative where friction helps.
    loss: np.ndarray
    labels: tuple[str, ...]  # (m,) quantity and joint that each row limits
    squared_speed_max: np.ndarray  # (N,) bound of x from joint velocity and tool speed

    def linearised(self, about: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows (a, b, c) with viscous friction bounded about the squared speeds `about` (N,)."""
        a, b, c = self.rows
        if not np.any(self.loss):
            return a, b, c
        # At standstill the tangent is vertical: a small positive speed replaces it.
        point = np.sqrt(np.maximum(about, 1e-4 * self.squared_speed_max))[:, None]
        chord = np.sqrt(self.squared_speed_max)[:, None]
        loading = self.loss > 0
        slope = np.where(loading, self.loss / (2.0 * point), self.loss / chord)
        return a, b + slope, c + np.where(loading, self.loss * point / 2.0, 0.0)

    def violation_at_rest(self) -> str:
        """Return a sentence on the limit exceeded most at rest on the path, or ""."""
        c = self.rows[2]
        worst = np.unravel_index(int(np.argmax(c)), c.shape)
        if c[worst] <= 1.0:
            return ""
        size = format_factor(c[worst]) if is_factor(c[worst]) else f"{100 * c[worst]:.0f} % of"
        return (
            f"At rest at {100 * self.grid[worst[0]]:.0f} % of the path the {self.labels[worst[1]]} "
            f"would be {size} its limit."
        )


def path_limits(
    robot: Robot, limits: Limits, path: JointPath, grid: np.ndarray, process_force: np.ndarray
) -> PathLimits:
    """Evaluate all limits on `grid`.

    `limits`: velocity (with its map over position), acceleration, torque and tool speed are taken;
    jerk, deflection and stiffness limits have no form linear in u and x. `grid` (N,).
    `process_force` (3,): acts on the tool, base axes [N].
    """
    q, dq, ddq = path(grid), path(grid, 1), path(grid, 2)
    a, b, c, speed = torque_rows(robot, q, dq, ddq, process_force)
    dry, loss = robot.coulomb * np.sign(dq), robot.viscous * dq
    zero = np.zeros_like(dq)
    blocks = (
        ("torque", limits.torque, (a, b, c, dry, loss)),
        ("acceleration", limits.acceleration, (dq, ddq, zero, zero, zero)),
    )
    columns: list[list[np.ndarray]] = [[], [], [], [], []]
    labels: list[str] = []
    for name, limit, block in blocks:
        for j in np.flatnonzero(np.isfinite(limit)):
            for sign in (1.0, -1.0):
                labels.append(f"{name} of joint {j + 1}")
                for column, values in zip(columns, block, strict=True):
                    column.append(sign * values[:, j] / limit[j])
    a, b, c, dry, loss = (_stack_rows(column, len(grid)) for column in columns)
    # At rest, friction resists either direction: its help must not be counted on.
    dry[[0, -1]] = np.maximum(dry[[0, -1]], 0.0)
    ceiling = _squared_speed_max(limits, q, dq, speed)
    return PathLimits(grid, (a, b, c + dry), loss, tuple(labels), ceiling)


def _stack_rows(columns: list[np.ndarray], count: int) -> np.ndarray:
    return np.column_stack(columns) if columns else np.zeros((count, 1))


def torque_rows(
    robot: Robot, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray, process_force: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return torque coefficients a, b, c (N, n) without friction, and |d tool/ds| (N,).

    The process force, (3,) or (N, 3) [N], is in base axes.
    """
    body = rigid_body_history(robot, q, dq, ddq)
    hold = body.gravity_torque
    a = link_torques(robot, q, np.zeros_like(q), dq) - hold
    b = body.link_torque - hold
    force = np.broadcast_to(process_force, (len(q), 3))
    c = hold - np.einsum("kij,ki->kj", body.jacobian, force)
    speed = np.linalg.norm(np.einsum("kij,kj->ki", body.jacobian, dq), axis=1)
    return a + robot.rotor_inertia * dq, b + robot.rotor_inertia * ddq, c, speed


def _squared_speed_max(
    limits: Limits, q: np.ndarray, dq: np.ndarray, tool_speed: np.ndarray
) -> np.ndarray:
    velocity = np.broadcast_to(limits.velocity, q.shape)
    if limits.velocity_map is not None:
        velocity = np.minimum(velocity, curve_at(limits.velocity_map, q))
    with np.errstate(divide="ignore"):
        ratios = [velocity / np.abs(dq), (limits.tool_speed / tool_speed)[:, None]]
    fastest = np.min(np.hstack(ratios), axis=1)
    return np.asarray(np.minimum(fastest**2, _SQUARED_SPEED_MAX))
