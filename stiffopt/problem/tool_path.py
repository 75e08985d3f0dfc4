"""Tool paths of lines, arcs and splines with blended corners and stops, and the joints' paths.

The joints follow a spline through poses of the tool, with knots where the path bends, close enough
that the tool stays within a tolerance. Where the tool stops, the joints' path may have a corner.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy

from stiffopt.errors import ProblemError
from stiffopt.problem.path_freedom import FreedomChoice
from stiffopt.problem.path_posture import follow_path
from stiffopt.problem.pose_following import fit_joint_path
from stiffopt.problem.tool_curves import Arc, Curve, Line, ToolCurve, blend_curve
from stiffopt.result.joint_path import JointPath
from stiffopt.robot.robot import Robot

# Shorter segments have no direction [m].
_MIN_LENGTH = 1e-6
# Samples of each piece of a path, by which the turn of its feed is known.
_TURN_SAMPLES = 16


@dataclass(frozen=True, kw_only=True, eq=False)
class ToolSegment:
    """A segment of a tool path."""

    end: np.ndarray  # (3,) end point, base frame [m]
    # (3, 3) orientation of the tool at the end; None keeps the previous one.
    rotation: np.ndarray | None = None
    through: np.ndarray | None = None  # (3,) a point on the arc; None for a straight line [m]
    # Distance from its end at which the rounding into the next segment begins [m].
    blend: float = 0.0
    curve: ToolCurve | None = None  # the segment itself, where it is neither a line nor an arc
    # Rotations (K, 3, 3) at shares (K,) of the segment, where they do not turn evenly to its end.
    turns: Callable[[np.ndarray], np.ndarray] | None = None
    speed: float = np.inf  # largest tool speed on it [m/s]
    stop: bool = False  # the tool rests at its end
    dwell: float = 0.0  # rest at its end [s]
    where: str = ""  # how messages name it


class ToolPath:
    """A path of the tool, smooth but for the places where it stops.

    Parameters
    ----------
    start : array (3,)
        [m]
    rotation : array (3, 3)
        Orientation of the tool at the start.

    Attributes
    ----------
    length : float [m]
    breaks : array (m,)
        Distances at which pieces meet, 0 and the length among them [m].
    speeds : array (m - 1,)
        Largest tool speed on each piece [m/s].
    stops : array (k,)
        Distances of inner stops [m].
    dwells : array (k,)
        Rests there [s].
    corners : array (c, 3)
        Ends of segments that are blended or stopped at [m].
    """

    def __init__(
        self, start: np.ndarray, rotation: np.ndarray, segments: Sequence[ToolSegment]
    ) -> None:
        curves, at = [], np.asarray(start, dtype=float)
        names = [
            segment.where or f"path.segment[{number}]" for number, segment in enumerate(segments, 1)
        ]
        for segment, name in zip(segments, names, strict=True):
            curves.append(_segment_curve(at, segment, name))
            at = np.asarray(segment.end, dtype=float)
        pieces, owners, corners = _blend_corners(curves, segments, names)
        self._pieces = pieces
        self.breaks = np.concatenate([[0.0], np.cumsum([piece.length for piece in pieces])])
        self.length = float(self.breaks[-1])
        self.speeds = np.array([min(segments[k].speed for k in own) for own in owners])
        inner = [
            (corner, segment)
            for corner, segment in zip(corners, segments, strict=False)
            if segment.stop
        ]
        self.stops = np.array([self.breaks[corner] for corner, _ in inner])
        self.dwells = np.array([segment.dwell for _, segment in inner])
        met = [segment.blend > 0.0 or segment.stop for segment in segments[:-1]]
        places = np.array([segment.end for segment in segments[:-1]], dtype=float).reshape(-1, 3)
        self.corners = places[np.array(met, dtype=bool)]
        self.smallest_blend = min(
            (segment.blend for segment in segments[:-1] if segment.blend > 0.0), default=np.inf
        )
        # Places where a fit begins: in between, a spline may bend at every point.
        self.marks = np.unique(
            np.concatenate(
                [self.breaks[k] + piece.marks() for k, piece in enumerate(pieces)]
                + [self.breaks[-1:]]
            )
        )
        # Distances at which segments begin and end, those within a blend at its start [m].
        self.segment_ends = np.array([0.0, *(self.breaks[k] for k in corners), self.length])
        self._turns = _Orientation(rotation, segments, curves, pieces, owners, self.breaks)
        self._choice: FreedomChoice | None = None

    def chosen(self, choice: FreedomChoice) -> ToolPath:
        """Return the path with its freedom as chosen."""
        found = copy(self)
        found._choice = choice
        found.corners = choice.place(self.corners)
        return found

    def poses(self, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions (K, 3) [m] and rotations (K, 3, 3) at distances along the path (K,) [m]."""
        places, rotations = self.stated_poses(along)
        if self._choice is None:
            return places, rotations
        return self._choice.place(places), self._choice.turn(along, rotations)

    def surface_poses(self, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Poses as of `poses`, with the tool's axes as they were stated to the placed work."""
        places, rotations = self.stated_poses(along)
        if self._choice is None:
            return places, rotations
        return self._choice.place(places), self._choice.work_rotation.as_matrix() @ rotations

    def stated_poses(self, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Poses as of `poses`, without regard of what was chosen."""
        inside = np.clip(along, 0.0, self.length)
        number = np.clip(
            np.searchsorted(self.breaks, inside, side="right") - 1, 0, len(self._pieces) - 1
        )
        places = np.empty((len(inside), 3))
        for k in np.unique(number):
            own = number == k
            places[own] = self._pieces[k].at(inside[own] - self.breaks[k])
        return places, self._turns(inside)

    def turn_of_feed(self) -> tuple[np.ndarray, np.ndarray]:
        """Distances (K,) [m], and how far the direction of the feed has turned there (K,) [rad]."""
        # Blends, however short, are sampled like whole segments.
        shares = np.arange(_TURN_SAMPLES) / _TURN_SAMPLES
        inside = self.breaks[:-1, None] + shares * np.diff(self.breaks)[:, None]
        along = np.append(inside.ravel(), self.length)
        steps = np.diff(self.stated_poses(along)[0], axis=0)
        ways = steps / np.maximum(np.linalg.norm(steps, axis=1), 1e-300)[:, None]
        turn = np.arccos(np.clip(np.sum(ways[1:] * ways[:-1], axis=1), -1.0, 1.0))
        # A corner turns half before its place and half after it.
        shared = 0.5 * (np.append(turn, 0.0) + np.append(0.0, turn))
        return along, np.concatenate([[0.0], np.cumsum(shared)])

    def parts(self) -> list[tuple[float, float]]:
        """Ranges between stops [m]."""
        return list(pairwise([0.0, *self.stops.tolist(), self.length]))


class _Orientation:
    """Orientation of the tool along a path, with continuous rate but at stops."""

    def __init__(
        self,
        rotation: np.ndarray,
        segments: Sequence[ToolSegment],
        curves: Sequence[ToolCurve],
        pieces: Sequence[ToolCurve],
        owners: Sequence[tuple[int, ...]],
        breaks: np.ndarray,
    ) -> None:
        # A blend is shared by its two segments: the orientation changes over between in its middle.
        middles = 0.5 * (breaks[1:] + breaks[:-1])
        keys = [0.0]
        for number in range(len(segments) - 1):
            shared = [k for k, own in enumerate(owners) if own == (number, number + 1)]
            own = [k for k, own in enumerate(owners) if own == (number,)]
            keys.append(float(middles[shared[0]] if shared else breaks[own[-1] + 1]))
        keys.append(float(breaks[-1]))
        self._keys = np.array(keys)
        self._parts: list[Callable[[np.ndarray], np.ndarray]] = []
        last = np.asarray(rotation, dtype=float)
        for segment in segments:
            end = last if segment.rotation is None else segment.rotation
            self._parts.append(segment.turns or _EasedTurn(last, end))
            last = end

    def __call__(self, along: np.ndarray) -> np.ndarray:
        """Rotations (K, 3, 3) at distances (K,)."""
        number = np.clip(
            np.searchsorted(self._keys, along, side="right") - 1, 0, len(self._parts) - 1
        )
        found = np.empty((len(along), 3, 3))
        for k in np.unique(number):
            own = number == k
            span = self._keys[k + 1] - self._keys[k]
            found[own] = self._parts[k](np.clip((along[own] - self._keys[k]) / span, 0.0, 1.0))
        return found


class _EasedTurn:
    """Turn about one axis that begins and ends without rate and acceleration."""

    def __init__(self, first: np.ndarray, last: np.ndarray) -> None:
        self._first = scipy.spatial.transform.Rotation.from_matrix(first)
        self._vector = (
            self._first.inv() * scipy.spatial.transform.Rotation.from_matrix(last)
        ).as_rotvec()

    def __call__(self, share: np.ndarray) -> np.ndarray:
        eased = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        turn = scipy.spatial.transform.Rotation.from_rotvec(eased[:, None] * self._vector)
        return np.asarray((self._first * turn).as_matrix())


class _QuaternionSpline:
    """Orientations through given ones, by a spline of their quaternions."""

    def __init__(self, rotations: np.ndarray, along: np.ndarray) -> None:
        turns = scipy.spatial.transform.Rotation.from_matrix(rotations).as_quat()
        flips = np.sign(np.sum(turns[1:] * turns[:-1], axis=1))
        turns[1:] *= np.cumprod(np.where(flips < 0.0, -1.0, 1.0))[:, None]
        self._spline = scipy.interpolate.CubicSpline(along, turns)

    def between(self, begin: float, end: float) -> Callable[[np.ndarray], np.ndarray]:
        """Return the rotations between two distances [m], by the share of the way."""
        return lambda share: np.asarray(
            scipy.spatial.transform.Rotation.from_quat(
                self._spline(begin + share * (end - begin))
            ).as_matrix()
        )


def spline_segments(
    points: np.ndarray,
    rotations: np.ndarray | None,
    speeds: np.ndarray,
    stops: np.ndarray,
    names: Sequence[str],
) -> list[ToolSegment]:
    """Return segments of splines through points (m, 3) [m], the first the start, from stop to stop.

    At each point: orientation (m, 3, 3) or None for one that stays, largest tool speed on the way
    to it (m,) [m/s], whether the tool rests there, and its name in messages ("points.csv, row 3").
    Raises `ProblemError` for a point that repeats the one before.
    """
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    for k in np.flatnonzero(~(steps > _MIN_LENGTH)):
        raise ProblemError(
            f"{names[int(k) + 1]} repeats the point before, {_coordinates(points[k])}. Delete it."
        )
    found = []
    ends = [0, *np.flatnonzero(stops[1:-1]) + 1, len(points) - 1]
    for first, last in pairwise(ends):
        own = slice(first, last + 1)
        curve = Curve.through(points[own])
        along = curve.point_distances
        turns = None if rotations is None else _QuaternionSpline(rotations[own], along)
        inner = speeds[own]
        changes = np.flatnonzero(inner[2:] != inner[1:-1]) + 1
        for a, b in pairwise([0, *changes.tolist(), last - first]):
            found.append(
                ToolSegment(
                    end=points[first + b],
                    rotation=None if rotations is None else rotations[first + b],
                    curve=curve.cut(along[a], curve.length - along[b]),
                    turns=None if turns is None else turns.between(along[a], along[b]),
                    speed=float(inner[b]),
                    stop=bool(first + b == last and last < len(points) - 1),
                    where=names[first + b],
                )
            )
    return found


@dataclass(frozen=True, eq=False)
class FittedPath:
    """Joint path of a tool path."""

    joints: JointPath  # knots where pieces meet; the tool stops at its `stops`
    error: float  # largest distance of the tool from the tool path [m]
    remark: str  # on the posture, "" where it is the usual one


def fit_tool_path(
    robot: Robot,
    path: ToolPath,
    near: np.ndarray | Callable[[float], np.ndarray] | None,
    tolerance: float,
) -> FittedPath:
    """Fit a joint spline that follows a tool path.

    `near` (n,) or callable: selects the inverse-kinematics solution at the start, or at each
    distance [m]; with None, any posture that follows the whole path. `tolerance`: largest error of
    the tool's position [m]. Raises `ProblemError`: the path is out of reach, passes a singular
    pose, or needs too many knots.
    """
    follower, remark = follow_path(robot, path.poses, path.breaks, near)
    # Deviation of the joints' path over the size of the smallest blend: it must not vanish.
    allowed = min(tolerance, 0.05 * path.smallest_blend)
    # Orientation error that weighs as much as the tolerance of the position [rad].
    weight = allowed / 2e-3
    knots, coefficients, worst = [np.zeros(1)], [], 0.0
    for begin, end in path.parts():
        span = end - begin
        inner = path.marks[(path.marks > begin) & (path.marks < end)]
        breaks = np.concatenate([[0.0], (inner - begin) / span, [1.0]])

        def curve(s: np.ndarray, begin: float = begin, span: float = span) -> np.ndarray:
            return follower(begin + span * s)

        def error(
            q: np.ndarray, s: np.ndarray, begin: float = begin, span: float = span
        ) -> np.ndarray:
            distance, angle = follower.errors(q, begin + span * s)
            return np.asarray(np.maximum(distance, weight * angle))

        part, off = fit_joint_path(curve, breaks, error, allowed)
        worst = max(worst, off)
        share = span / path.length
        knots.append((begin + span * part.knots[1:]) / path.length)
        coefficients.append(part.coefficients / share ** np.arange(4)[None, :, None])
    whole = np.concatenate(knots)
    whole[-1] = 1.0
    middles = 0.5 * (whole[1:] + whole[:-1]) * path.length
    piece = np.clip(np.searchsorted(path.breaks, middles) - 1, 0, len(path.speeds) - 1)
    joints = JointPath(
        whole,
        np.concatenate(coefficients),
        speeds=path.speeds[piece],
        stops=np.searchsorted(whole, path.stops / path.length - 1e-12),
        dwells=path.dwells,
        corners=path.corners,
    )
    return FittedPath(joints, worst, remark)


def _coordinates(point: np.ndarray) -> str:
    return f"[{', '.join(f'{x:.6g}' for x in point)}] m"


def _segment_curve(start: np.ndarray, segment: ToolSegment, where: str) -> ToolCurve:
    """Return the curve of a segment from its start."""
    if segment.curve is not None:
        return segment.curve
    if not np.linalg.norm(segment.end - start) > _MIN_LENGTH:
        raise ProblemError(
            f"{where} ends where it begins, at {_coordinates(start)}. Give another end, or delete "
            "it."
        )
    if segment.through is None:
        return Line(start, np.asarray(segment.end, dtype=float))
    return Arc.through(start, segment.through, segment.end, where)


def _blend_corners(
    curves: Sequence[ToolCurve], segments: Sequence[ToolSegment], names: Sequence[str]
) -> tuple[list[ToolCurve], list[tuple[int, ...]], list[int]]:
    """Return pieces with blended corners, the segments (from 0) of each, and where segments meet.

    The last are numbers of breaks; those within a blend are its first.
    """
    cuts = []
    for number, (one, other) in enumerate(pairwise(curves)):
        (ahead, bend), (behind, other_bend) = one.end_derivatives(-1), other.end_derivatives(0)
        turn = np.arccos(np.clip(ahead @ behind, -1.0, 1.0))
        # Smaller changes of curvature need no blend [1/m].
        bends = np.linalg.norm(other_bend - bend) > 1e-6
        segment = segments[number]
        # Smaller changes of direction are no corner [rad].
        corner = turn > 0.01 and not segment.stop
        if corner and not segment.blend > 0.0:
            raise ProblemError(
                f"{names[number]}: the tool turns by {np.degrees(turn):.3g} deg at its end, "
                "where it would have to stop. Give the segment a `blend`, or `stop = true`."
            )
        blended = corner or (bends and not segment.stop)
        cuts.append(segment.blend if blended else 0.0)
    before, after = [0.0, *cuts], [*cuts, 0.0]
    for number, curve in enumerate(curves):
        asked = before[number] + after[number]
        if asked > 0.999 * curve.length:
            raise ProblemError(
                f"{names[number]} is {1e3 * curve.length:.4g} mm long, its blends take "
                f"{1e3 * asked:.4g} mm. Give smaller ones."
            )
    pieces: list[ToolCurve] = []
    owners: list[tuple[int, ...]] = []
    corners: list[int] = []
    short = [
        curve.cut(before[number], after[number]) if before[number] + after[number] > 0.0 else curve
        for number, curve in enumerate(curves)
    ]
    for number, curve in enumerate(short):
        pieces.append(curve)
        owners.append((number,))
        if number == len(curves) - 1:
            break
        corners.append(len(pieces))
        if cuts[number] > 0.0:
            pieces.append(blend_curve(curve, short[number + 1], cuts[number]))
            owners.append((number, number + 1))
    return pieces, owners, corners
