"""Process force along a tool path: constant, by segment, proportional to the feed, from a table.

In base axes, those of the tool, or of the path: x along the feed, z the tool's z axis turned
perpendicular to it, y the right-handed third.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
import scipy

from stiffopt.errors import ProblemError
from stiffopt.robot.batched_kinematics import tool_jacobians

if TYPE_CHECKING:
    from stiffopt.problem.tool_path import ToolPath
    from stiffopt.result.joint_path import JointPath
    from stiffopt.robot.robot import Robot

ForceFrame = Literal["base", "tool", "path"]


@dataclass(frozen=True, eq=False)
class PathForce:
    """Force on the tool along a joint path, base axes."""

    place: np.ndarray  # (K,) path parameters from 0 to 1
    # (K, 3) [N], and [N/(m/s)] times the tool speed.
    constant: np.ndarray
    per_feed: np.ndarray
    axes: np.ndarray  # (K, 3, 3) axes of the path as columns: feed, side, tool axis

    def __call__(self, s: np.ndarray, feed: np.ndarray | float = 0.0) -> np.ndarray:
        """Return the force (K, 3) [N] at path parameters (K,) and tool speeds (K,) [m/s]."""
        parts = [
            np.stack([np.interp(s, self.place, column) for column in values.T], axis=1)
            for values in (self.constant, self.per_feed)
        ]
        return np.asarray(parts[0] + np.asarray(feed)[..., None] * parts[1])

    def axes_at(self, s: np.ndarray) -> np.ndarray:
        """Axes of the path (K, 3, 3) at path parameters (K,)."""
        nearest = np.clip(np.searchsorted(self.place, s), 0, len(self.place) - 1)
        return np.asarray(self.axes[nearest])


def path_force(
    path: ToolPath,
    values: np.ndarray,
    at: np.ndarray,
    per_feed: np.ndarray,
    frame: ForceFrame,
    ramp: float,
) -> PathForce:
    """Return the force of a tool path.

    `values` (m, 3) [N] hold in pieces between distances `at` (m + 1,) [m], or at those (m,);
    `per_feed` (3,) is in N/(m/s), both in axes of `frame`. Over the length `ramp` [m] the force
    changes from one piece to the next.
    """
    along = np.linspace(0.0, path.length, max(2001, int(path.length / 2e-4)))
    if len(at) == len(values) + 1:
        constant = _stepped(along, values, at, ramp)
    else:
        constant = scipy.interpolate.PchipInterpolator(at, values)(along)
    _, rotations = path.poses(along)
    axes = _path_axes(*path.surface_poses(along))
    turned = {"base": None, "tool": rotations, "path": axes}[frame]
    proportional = np.repeat(per_feed[None], len(along), axis=0)
    if turned is not None:
        constant, proportional = (
            np.einsum("kij,kj->ki", turned, each) for each in (constant, proportional)
        )
    return PathForce(along / path.length, constant, proportional, axes)


def _stepped(along: np.ndarray, values: np.ndarray, at: np.ndarray, ramp: float) -> np.ndarray:
    """Return values of pieces, smoothed over the ramp about where they meet."""
    found = np.repeat(values[:1], len(along), axis=0).astype(float)
    for k in range(1, len(values)):
        share = np.clip((along - at[k]) / ramp + 0.5, 0.0, 1.0)
        eased = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        found += eased[:, None] * (values[k] - values[k - 1])
    return found


def _path_axes(places: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    feed = np.gradient(places, axis=0)
    size = np.linalg.norm(feed, axis=1)
    feed /= np.where(size > 0.0, size, 1.0)[:, None]
    tool = rotations[:, :, 2] - np.sum(rotations[:, :, 2] * feed, axis=1)[:, None] * feed
    length = np.linalg.norm(tool, axis=1)
    for k in np.flatnonzero(length < 1e-3):
        raise ProblemError(
            f"path.force: at {1e3 * np.linalg.norm(places[k] - places[0]):.4g} mm from its start "
            "the tool's z axis lies along the feed, so that the path has no side. Give the force "
            "in the frame base or tool, or correct the orientation."
        )
    tool /= length[:, None]
    return np.stack([feed, np.cross(tool, feed), tool], axis=2)


def check_path_force(
    robot: Robot,
    joints: JointPath,
    force: PathForce,
    feed: float,
    length: float,
    name: Callable[[float], str],
) -> None:
    """Raise `ProblemError` for a force of implausible size, which names the place and the joint.

    Wrong by a factor of 1000 (kN for N), or in a frame in which the arm cannot bear it. `name`
    tells the segment or row at a distance along the path [m] of a length [m].
    """
    forces = force(force.place, np.full(len(force.place), feed))
    size = np.linalg.norm(forces, axis=1)
    # Force [N] over which an entry is taken for one in another unit: N for kN gives a thousandth.
    if size.max() < 0.05 and size.max() > 0.0:
        raise ProblemError(
            f"path.force: the largest force on the path is {size.max():.3g} N, which moves no "
            "tool. Bare numbers are in N: was kN meant? Then write texts such as '0.1 kN'."
        )
    _, jacobians = tool_jacobians(robot.tree, robot.tool, joints(force.place))
    torque = np.abs(np.einsum("kij,ki->kj", jacobians, forces)) / robot.torque_max
    k, j = np.unravel_index(int(np.argmax(torque)), torque.shape)
    # Torque of a force over a joint's limit from which the force is wrong by its unit or frame.
    if torque[k, j] > 1.0:
        along = float(force.place[k]) * length
        raise ProblemError(
            f"path.force: {size[k]:.4g} N in {name(along)}, {1e3 * along:.4g} mm from the start of "
            f"the path, alone take {torque[k, j]:.3g} times the torque limit of "
            f"{robot.joint_names[j]}. Check its unit (bare numbers are in N) and its frame (base, "
            "tool or path)."
        )
