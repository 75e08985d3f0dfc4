"""Process force along a tool path, and the speeds at which the tool's deflection by it is limited.

The force is constant, by segment, proportional to the feed, or from a table, in base axes, those of
the tool, or of the path: x along the feed, z the tool's z axis turned perpendicular to it, y the
right-handed third.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy

from stiffopt.errors import ProblemError
from stiffopt.exact.chain import exact_windup
from stiffopt.problem.path_freedom import ErrorDirection
from stiffopt.problem.tool_path import ToolPath
from stiffopt.result.joint_path import JointPath
from stiffopt.robot.batched_kinematics import tool_jacobians
from stiffopt.robot.robot import Robot
from stiffopt.units import joint_unit

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
    # Force [N] below which an entry is taken for one in another unit: a thousandth of 500 N, by N
    # for kN. As a force it would deflect an arm of 0.1 N/µm by 5 µm.
    if size.max() < 0.5 and size.max() > 0.0:
        raise ProblemError(
            f"path.force: the largest force on the path is {size.max():.3g} N, which moves no "
            "tool measurably. Bare numbers are in N: was kN meant? Then write texts such as "
            "'0.1 kN'."
        )
    _, jacobians = tool_jacobians(robot.tree, robot.tool, joints(force.place))
    torque = np.abs(np.einsum("kij,ki->kj", jacobians, forces)) / robot.torque_max
    k, j = np.unravel_index(int(np.argmax(torque)), torque.shape)
    # Torque of a force over a joint's limit from which the force is wrong by its unit or frame.
    if torque[k, j] > 1.0:
        along = float(force.place[k]) * length
        unit = joint_unit("N m", bool(robot.prismatic[j]))
        estimated = {(each.joint, each.key) for each in robot.estimated()}
        guessed = (
            ", which the robot file marks as estimated: state the arm's own torque_max there"
            if (robot.joint_names[j], "torque_max") in estimated
            else ""
        )
        raise ProblemError(
            f"path.force: {size[k]:.4g} N in {name(along)}, {1e3 * along:.4g} mm from the start of "
            f"the path, alone take {torque[k, j]:.3g} times the torque limit of "
            f"{robot.joint_names[j]}, {robot.torque_max[j]:.4g} {unit}{guessed}. Check the force's "
            "unit (bare numbers are in N) and its frame (base, tool or path)."
        )


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
