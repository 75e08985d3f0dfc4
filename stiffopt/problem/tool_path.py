"""Tool paths of straight and circular segments with blended corners, as waypoints of the joints.

The joints follow a spline through poses of the tool at equal steps of its path, close enough that
the tool stays within a tolerance of the segments. A step of the spline's parameter is then a step
of the path, and the tool's speed is the parameter's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from stiffopt.dynamics.inverse_kinematics import solve_pose
from stiffopt.errors import ProblemError
from stiffopt.result.joint_path import JointPath

if TYPE_CHECKING:
    from stiffopt.robot.robot import Robot

# Smaller changes of direction are no corner [rad].
_MIN_CORNER_ANGLE = 0.01
# Samples for the arc length of a piece.
_SAMPLES_PER_PIECE = 400
# Relative deviation of the tool's speed from the path parameter's that is accepted.
_MAX_SPEED_DEVIATION = 5e-3
# Waypoints of the first and of the last refinement.
_MIN_WAYPOINTS, _MAX_WAYPOINTS = 17, 257
# Larger joint steps between neighbouring waypoints are a change of posture [rad].
_MAX_JOINT_STEP = 0.6


@dataclass(frozen=True, kw_only=True, eq=False)
class ToolSegment:
    """A segment of a tool path.

    Parameters
    ----------
    end : array (3,)
        End point, base frame [m].
    rotation : array (3, 3) or None
        Orientation of the tool at the end; None keeps the previous one.
    through : array (3,) or None
        A point on the arc; None for a straight line [m].
    blend : float
        Distance from its end at which the rounding into the next segment begins [m].
    """

    end: np.ndarray
    rotation: np.ndarray | None = None
    through: np.ndarray | None = None
    blend: float = 0.0


@dataclass(frozen=True, eq=False)
class _PathPiece:
    """Samples of a smooth piece: arc length (S,) and points (S, 3) [m]."""

    length: np.ndarray
    points: np.ndarray

    @classmethod
    def of(cls, points: np.ndarray) -> _PathPiece:
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        return cls(np.concatenate([[0.0], np.cumsum(steps)]), points)

    @property
    def total(self) -> float:
        return float(self.length[-1])

    def at(self, along: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(along, self.length, column) for column in self.points.T], axis=1)

    def cut(self, before: float, after: float) -> _PathPiece:
        """Shorten the piece at both ends [m]."""
        return _PathPiece.of(self.at(np.linspace(before, self.total - after, _SAMPLES_PER_PIECE)))

    def direction(self, end: int) -> np.ndarray:
        """Unit tangent at the start (0) or end (-1)."""
        step = self.points[1] - self.points[0] if end == 0 else self.points[-1] - self.points[-2]
        return np.asarray(step / np.linalg.norm(step))


class ToolPath:
    """A smooth path of the tool.

    Parameters
    ----------
    start : array (3,)
        [m]
    rotation : array (3, 3)
        Orientation of the tool at the start.
    segments : sequence of ToolSegment

    Attributes
    ----------
    length : float [m]
    """

    def __init__(
        self, start: np.ndarray, rotation: np.ndarray, segments: Sequence[ToolSegment]
    ) -> None:
        pieces, at = [], np.asarray(start, dtype=float)
        for number, segment in enumerate(segments, start=1):
            pieces.append(_sample_segment(at, segment, f"path.segment[{number}]"))
            at = segment.end
        joined, corners = _blend_corners(pieces, [segment.blend for segment in segments])
        self._piece = _PathPiece.of(
            np.vstack([joined[0].points, *(p.points[1:] for p in joined[1:])])
        )
        self.length = self._piece.total
        turns, last = [rotation], rotation
        for segment in segments:
            last = last if segment.rotation is None else segment.rotation
            turns.append(last)
        self._turn = Slerp([0.0, *corners, self.length], Rotation.from_matrix(np.stack(turns)))

    def poses(self, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions (K, 3) [m] and rotations (K, 3, 3) at distances along the path (K,) [m]."""
        inside = np.clip(along, 0.0, self.length)
        return self._piece.at(inside), self._turn(inside).as_matrix()


def joint_waypoints(
    robot: Robot, path: ToolPath, near: np.ndarray, tolerance: float
) -> tuple[np.ndarray, float]:
    """Joint waypoints (k, n) whose spline follows a tool path, and the path error.

    Parameters
    ----------
    robot : Robot
    path : ToolPath
    near : array (n,)
        Selects the inverse-kinematics solution at the start [rad].
    tolerance : float
        Largest error of the tool's position [m].

    Returns
    -------
    (array, float)
        Waypoints [rad], and the largest distance of the tool from the path [m].

    Raises
    ------
    ProblemError
        The path is out of reach, needs a change of posture, or exceeds the tolerance.
    """
    bodies, tool, count = robot.rigid_bodies(), robot.tool, _MIN_WAYPOINTS
    while True:
        along = np.linspace(0.0, path.length, count)
        waypoints = _solve_waypoints(robot, path, along, near)
        spline = JointPath.through(waypoints)
        between = np.linspace(0.0, 1.0, 4 * (count - 1) + 1)
        wanted = path.poses(between * path.length)[0]
        found = np.array([bodies.pose(tool, q)[0] for q in spline(between)])
        error = float(np.linalg.norm(found - wanted, axis=1).max())
        # Equal parameter steps must be equal path steps, so that a tool speed can be held.
        slopes = zip(spline(between), spline(between, 1), strict=True)
        rates = [np.linalg.norm(bodies.jacobian(tool, q)[:3] @ slope) for q, slope in slopes]
        uneven = float(np.abs(np.array(rates) / path.length - 1.0).max())
        if error <= tolerance and uneven <= _MAX_SPEED_DEVIATION:
            return waypoints, error
        if count >= _MAX_WAYPOINTS:
            raise ProblemError(
                f"path: {count} waypoints follow the segments within {1e3 * error:.3g} mm and the "
                f"speed within {uneven:.2%}; asked are {1e3 * tolerance:.3g} mm and "
                f"{_MAX_SPEED_DEVIATION:.2%}. Give a larger tolerance, or larger blends."
            )
        count = 2 * (count - 1) + 1


def _solve_waypoints(
    robot: Robot, path: ToolPath, along: np.ndarray, near: np.ndarray
) -> np.ndarray:
    """Joint angles (k, n) along the path, each close to the previous."""
    positions, rotations = path.poses(along)
    waypoints: list[np.ndarray] = []
    for place, position, rotation in zip(along, positions, rotations, strict=True):
        before = waypoints[-1] if waypoints else near
        # No restarts after the first waypoint: they could change the posture.
        restarts = 0 if waypoints else 60
        try:
            found = solve_pose(robot, position, rotation, before, restarts=restarts)
        except ProblemError as error:
            raise ProblemError(f"path, {place:.3f} m from its start: {error}") from error
        if waypoints and np.max(np.abs(found - before)) > _MAX_JOINT_STEP:
            j = int(np.argmax(np.abs(found - before)))
            raise ProblemError(
                f"path, {place:.3f} m from its start: joint {j + 1} would turn by "
                f"{np.degrees(abs(found[j] - before[j])):.0f} deg in one step, through a "
                "singular pose. Choose another posture by path.start.near, or another path."
            )
        waypoints.append(np.asarray(found))
    return np.stack(waypoints)


def _sample_segment(start: np.ndarray, segment: ToolSegment, where: str) -> _PathPiece:
    """Sample a line or an arc."""
    share = np.linspace(0.0, 1.0, _SAMPLES_PER_PIECE)[:, None]
    chord = segment.end - start
    if not np.linalg.norm(chord) > 1e-6:
        raise ProblemError(f"{where} ends where it begins. Give another end.")
    if segment.through is None:
        return _PathPiece.of(start + share * chord)
    a, b = segment.through - start, chord
    normal = np.cross(a, b)
    if np.linalg.norm(normal) < 1e-6 * np.linalg.norm(a) * np.linalg.norm(b) + 1e-12:
        raise ProblemError(
            f"{where}: start, `through` and end lie on a line. Give a point beside it."
        )
    square = normal @ normal
    middle = start + (np.cross(normal, a) * (b @ b) - np.cross(normal, b) * (a @ a)) / (2 * square)
    first = start - middle
    across = np.cross(normal / np.sqrt(square), first)
    angle = np.arctan2((segment.end - middle) @ across, (segment.end - middle) @ first)
    angle += 2.0 * np.pi if angle <= 0.0 else 0.0
    return _PathPiece.of(middle + np.cos(share * angle) * first + np.sin(share * angle) * across)


def _blend_corners(
    pieces: Sequence[_PathPiece], blends: Sequence[float]
) -> tuple[list[_PathPiece], list[float]]:
    """Pieces with blended corners, and the path length at the middle of each corner [m]."""
    cuts = []
    for number, (one, other) in enumerate(pairwise(pieces), start=1):
        turn = np.arccos(np.clip(one.direction(-1) @ other.direction(0), -1.0, 1.0))
        if turn > _MIN_CORNER_ANGLE and not blends[number - 1] > 0.0:
            raise ProblemError(
                f"path.segment[{number}]: the tool turns by {np.degrees(turn):.3g} deg at its end, "
                "where it would have to stop. Give the segment a `blend`, or end the path there."
            )
        cuts.append(blends[number - 1] if turn > _MIN_CORNER_ANGLE else 0.0)
    before, after = [0.0, *cuts], [*cuts, 0.0]
    for number, piece in enumerate(pieces, start=1):
        asked = before[number - 1] + after[number - 1]
        if asked > 0.999 * piece.total:
            raise ProblemError(
                f"path.segment[{number}] is {1e3 * piece.total:.4g} mm long, its blends take "
                f"{1e3 * asked:.4g} mm. Give smaller ones."
            )
    joined, corners, so_far = [], [], 0.0
    for number, piece in enumerate(pieces):
        own = piece.cut(before[number], after[number])
        joined.append(own)
        so_far += own.total
        if number == len(pieces) - 1:
            break
        if cuts[number] > 0.0:
            following = pieces[number + 1].cut(before[number + 1], after[number + 1])
            bend = _blend_curve(own, following, cuts[number])
            joined.append(bend)
            corners.append(so_far + 0.5 * bend.total)
            so_far += bend.total
        else:
            corners.append(so_far)
    return joined, corners


def _blend_curve(one: _PathPiece, other: _PathPiece, size: float) -> _PathPiece:
    """Cubic blend from the end of one piece to the start of another, tangent to both.

    Between two lines it is the parabola whose tangents meet in the corner.
    """
    reach = 2.0 / 3.0 * size
    first, last = one.points[-1], other.points[0]
    u = np.linspace(0.0, 1.0, _SAMPLES_PER_PIECE)[:, None]
    inner = first + reach * one.direction(-1), last - reach * other.direction(0)
    points = (
        (1 - u) ** 3 * first
        + 3 * (1 - u) ** 2 * u * inner[0]
        + 3 * (1 - u) * u**2 * inner[1]
        + u**3 * last
    )
    return _PathPiece.of(points)
