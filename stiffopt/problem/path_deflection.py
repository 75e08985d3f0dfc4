"""Limit of the tool's deflection under the process force along its path, kept by the speed."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.errors import ProblemError
from stiffopt.exact.chain import exact_windup
from stiffopt.robot.batched_kinematics import tool_jacobians

if TYPE_CHECKING:
    from stiffopt.problem.path_force import PathForce
    from stiffopt.problem.path_freedom import ErrorDirection
    from stiffopt.result.joint_path import JointPath
    from stiffopt.robot.robot import Robot

# Places on each piece of the path at which the deflection is evaluated.
_PLACES_PER_PIECE = 9
# Speed from which on a path without a limit of its own is searched [m/s].
_FASTEST_FEED = 10.0
# Axes of the path (feed, side, tool) that count in each direction.
COUNTED_AXES = {"any": (1.0, 1.0, 1.0), "axis": (0.0, 0.0, 1.0), "side": (0.0, 1.0, 0.0)}


class ProcessDeflection:
    """Deflection of the tool at rest by a force, beyond that under gravity alone; exact laws.

    Parameters
    ----------
    joints : array (K, n)
    """

    def __init__(self, robot: Robot, joints: np.ndarray) -> None:
        _, self._jacobian = tool_jacobians(robot.tree, robot.tool, joints)
        gravity = robot.bodies_in_motion().gravity_torque(joints)
        self._springs = [
            (j, chain, gravity[:, j], np.asarray(exact_windup(chain, gravity[:, j])))
            for j, chain in enumerate(robot.chains)
            if chain is not None
        ]

    def __call__(self, force: np.ndarray) -> np.ndarray:
        """Return the deflection (K, 3) [m] under forces (K, 3) [N], base axes."""
        pushed = np.einsum("kij,ki->kj", self._jacobian, force)
        moved = np.zeros(force.shape)
        for j, chain, weight, sag in self._springs:
            turned = np.asarray(exact_windup(chain, weight - pushed[:, j])) - sag
            moved -= self._jacobian[:, :, j] * turned[:, None]
        return moved


def with_limited_deflection(
    robot: Robot, path: JointPath, force: PathForce, limit: float, direction: ErrorDirection
) -> tuple[JointPath, str]:
    """Return the path with speeds at which a deflection keeps its limit [m], and a remark.

    Raises `ProblemError`: the constant part of the force alone exceeds the limit; with the place.
    """
    shares = np.linspace(0.0, 1.0, _PLACES_PER_PIECE)
    s = (path.knots[:-1, None] + np.diff(path.knots)[:, None] * shares).ravel()
    deflection = ProcessDeflection(robot, path(s))
    count = np.array(COUNTED_AXES[direction])
    rows = count[:, None] * force.axes_at(s).swapaxes(1, 2)

    def size(feed: np.ndarray) -> np.ndarray:
        moved = deflection(force(s, feed))
        return np.asarray(np.linalg.norm(np.einsum("kij,kj->ki", rows, moved), axis=1))

    still = size(np.zeros(len(s)))
    worst = int(np.argmax(still))
    if still[worst] > limit:
        raise ProblemError(
            f"path.force.deflection_limit: {100.0 * s[worst]:.3g} % along the path the constant "
            f"force alone deflects the tool by {1e6 * still[worst]:.4g} µm, above the limit of "
            f"{1e6 * limit:.4g} µm, at any speed. Raise the limit, lower the force, or leave "
            "freedom to the path ([path.freedom])."
        )
    stated = np.full(len(path.knots) - 1, np.inf) if path.speeds is None else path.speeds
    high = np.repeat(np.minimum(stated, _FASTEST_FEED), _PLACES_PER_PIECE)
    low = np.where(size(high) <= limit, high, 0.0)
    for _ in range(30):
        middle = 0.5 * (low + high)
        kept = size(middle) <= limit
        low, high = np.where(kept, middle, low), np.where(kept, high, middle)
    allowed = low.reshape(-1, _PLACES_PER_PIECE).min(axis=1)
    slower = allowed < np.minimum(stated, _FASTEST_FEED)
    speeds = np.where(slower, allowed, stated)
    peak = 1e6 * float(
        size(np.repeat(np.where(np.isfinite(speeds), speeds, 0.0), len(shares))).max()
    )
    remark = f"The deflection under the process force is {peak:.4g} µm at most"
    if slower.any():
        remark += f"; the tool's speed is lowered to {1e3 * allowed.min():.4g} mm/s for it"
    return replace(path, speeds=speeds), f"{remark}."
