"""Posture of a tool path: the branch of its first pose that follows it to its end."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from stiffopt.errors import ProblemError
from stiffopt.problem.branches import describe_posture, middle_of_ranges, solutions_of_pose
from stiffopt.problem.pose_following import PathEndsError, PoseFollower, Poses
from stiffopt.robot.robot import Robot

# Largest joint difference of equal postures [rad].
_EQUAL_JOINTS = 1e-5


def follow_path(
    robot: Robot,
    poses: Poses,
    breaks: np.ndarray,
    near: np.ndarray | Callable[[float], np.ndarray] | None,
) -> tuple[PoseFollower, str]:
    """Return inverse kinematics along a path, and a remark on the posture where it is not usual.

    `poses`, `breaks` and `near` as of `PoseFollower`. Without `near` all solutions at the start are
    tried, from the middle of the joint ranges outwards, until one follows the whole path. Raises
    `ProblemError` where none does, with the posture that comes farthest.
    """
    if near is not None:
        return PoseFollower(robot, poses, breaks, near), ""
    middle = middle_of_ranges(robot)
    try:
        return PoseFollower(robot, poses, breaks, middle), ""
    except PathEndsError as end:
        ends = [end]
    (position,), (rotation,) = poses(np.zeros(1))
    for q in solutions_of_pose(robot, position, rotation, middle, lambda _: True):
        if any(_ends_alike(q, end) for end in ends):
            continue
        try:
            follower = PoseFollower(robot, poses, breaks, q)
        except PathEndsError as end:
            ends.append(end)
            continue
        return follower, (
            "The posture nearest the middle of the joint ranges ends "
            f"{ends[0].place:.3f} m along the path: {ends[0].cause} Taken is the nearest one that "
            f"follows the whole path, {describe_posture(robot, q)} at the start; path.near states "
            "another."
        )
    far = max(ends, key=lambda end: end.place)
    raise ProblemError(
        f"path: no posture follows it to its end at {breaks[-1]:.3f} m; of {len(ends)} tried from "
        f"its start, {describe_posture(robot, far.start)} comes farthest. It ends after "
        f"{far.place:.3f} m: {far.cause} Move or turn the path, leave freedom to it by "
        "[path.freedom], or state another posture by path.near. A posture is kept at stops too: "
        "parts that need different ones are problems of their own, with a move between."
    ) from far


def _ends_alike(q: np.ndarray, end: PathEndsError) -> bool:
    """Return True where full turns do not keep a posture (n,) from the end of another one."""
    apart = q - end.start
    turned = np.angle(np.exp(1j * apart))
    # A joint at its limit may pass a full turn away from it.
    return bool(
        np.abs(turned).max() < _EQUAL_JOINTS
        and np.abs(apart[end.limited]).max(initial=0.0) < _EQUAL_JOINTS
    )
