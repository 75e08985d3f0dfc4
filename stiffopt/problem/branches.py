"""Inverse-kinematic branches of the poses of a cycle: candidates, names, and the best combination.

A pose keeps one solution however often it is visited. The combination is the one of least sum of
durations of the quintic rivals between consecutive poses, found exactly by eliminating one pose
after another.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from stiffopt.dynamics.inverse_kinematics import UnreachablePoseError, solve_pose
from stiffopt.problem.limit import Limits
from stiffopt.robot.frames import LinkFrame
from stiffopt.robot.robot import Robot

# Peak velocity, acceleration and jerk of the quintic time law over the powers of its duration.
_QUINTIC_PEAKS = (15.0 / 8.0, 10.0 / np.sqrt(3.0), 60.0)
# Joints further than this from the reference also take the neighbouring turn [rad].
_OTHER_TURN_FROM = 0.5 * np.pi


def solutions_of_pose(
    robot: Robot,
    position: np.ndarray,
    rotation: np.ndarray | None,
    reference: np.ndarray,
    admissible: Callable[[np.ndarray], bool],
) -> list[np.ndarray]:
    """Solutions of the inverse kinematics (n,) within the limits, nearest to `reference` first.

    Full turns count as solutions of their own where a joint lies far from the reference, so that
    continuous joints can go the short way round.
    """
    random = np.random.default_rng(1)
    bounds = (
        np.where(np.isfinite(robot.position_lower), robot.position_lower, -np.pi),
        np.where(np.isfinite(robot.position_upper), robot.position_upper, np.pi),
    )
    found: list[np.ndarray] = []
    # Random starts of the search for solutions of one pose: each ends in one of at most 16
    # branches.
    for start in [reference, *random.uniform(*bounds, size=(48, robot.n))]:
        try:
            q = solve_pose(robot, position, rotation, start, restarts=0)
        except UnreachablePoseError:
            continue
        for turned in _turns(robot, q, reference):
            # Largest joint difference of equal solutions [rad].
            same = any(np.max(np.abs(turned - other)) < 1e-5 for other in found)
            if not same and admissible(turned):
                found.append(turned)
    found.sort(key=lambda q: float(np.linalg.norm(q - reference)))
    return found[:96]


def middle_of_ranges(robot: Robot) -> np.ndarray:
    """Joint positions (n,) in the middle of their ranges, 0 where a joint has none."""
    limits = np.stack([robot.position_lower, robot.position_upper])
    bounded = np.isfinite(limits).all(axis=0)
    return np.where(bounded, np.where(bounded, limits, 0.0).mean(axis=0), 0.0)


def _turns(robot: Robot, q: np.ndarray, reference: np.ndarray) -> list[np.ndarray]:
    """Solutions that differ from q (n,) by full turns, within the limits."""
    whole = 2.0 * np.pi
    choices = []
    for j, angle in enumerate(q):
        if robot.prismatic[j]:
            choices.append([angle])
            continue
        low, high = robot.position_lower[j], robot.position_upper[j]
        nearest = angle + whole * np.round((reference[j] - angle) / whole)
        other = nearest - whole * np.sign(nearest - reference[j])
        far = abs(nearest - reference[j]) > _OTHER_TURN_FROM
        inside = [each for each in ([nearest, other] if far else [nearest]) if low <= each <= high]
        choices.append(inside or [angle])
    return [np.array(each) for each in product(*choices)]


def quintic_durations(
    first: np.ndarray, second: np.ndarray, limits: Sequence[np.ndarray]
) -> np.ndarray:
    """Durations (A, B) [s] of quintic moves between joint angles (A, n) and (B, n).

    `limits` are velocity, acceleration and jerk (n,), infinite for none.
    """
    travel = np.abs(second[None] - first[:, None])
    times = [
        np.max((peak * travel / limit) ** (1.0 / order), axis=-1)
        for order, (peak, limit) in enumerate(zip(_QUINTIC_PEAKS, limits, strict=True), start=1)
    ]
    return np.asarray(np.max(times, axis=0))


@dataclass(frozen=True)
class CostTable:
    """Cost over the candidates of some poses: one axis a pose, by number in `poses`."""

    poses: tuple[int, ...]
    cost: np.ndarray

    def aligned(self, poses: Sequence[int]) -> np.ndarray:
        """Cost with one axis for each of `poses`, of length one where it does not depend on it."""
        order = [self.poses.index(each) for each in poses if each in self.poses]
        moved = np.transpose(self.cost, order)
        sizes = iter(moved.shape)
        return moved.reshape([next(sizes) if each in self.poses else 1 for each in poses])


def best_combination(tables: Sequence[CostTable], poses: int) -> list[int]:
    """Candidate of each pose with the least sum of all tables.

    Poses are eliminated one by one, those with the fewest neighbours first: exact, and quick for
    cycles whose poses recur in order.
    """
    left = list(tables)
    steps: list[tuple[int, tuple[int, ...], np.ndarray]] = []
    remaining = set(range(poses))
    while remaining:
        around_each = {
            pose: {p for table in left if pose in table.poses for p in table.poses} - {pose}
            for pose in sorted(remaining)
        }
        pose = min(around_each, key=lambda each: len(around_each[each]))
        around = tuple(sorted(around_each[pose]))
        own = [table for table in left if pose in table.poses]
        remaining.remove(pose)
        if not own:
            steps.append((pose, (), np.zeros(())))
            continue
        total = np.sum(
            np.broadcast_arrays(*(table.aligned((*around, pose)) for table in own)), axis=0
        )
        steps.append((pose, around, np.argmin(total, axis=-1)))
        left = [table for table in left if pose not in table.poses]
        left.append(CostTable(around, np.min(total, axis=-1)))
    chosen: dict[int, int] = {}
    for pose, around, best in reversed(steps):
        chosen[pose] = int(best[tuple(chosen[each] for each in around)])
    return [chosen[pose] for pose in range(poses)]


def branch_name(robot: Robot, q: np.ndarray) -> str:
    """Names of shoulder, elbow and wrist of a six-axis arm at joint angles (n,); else "".

    Front is the side of axis 1 on which the wrist lies with all joints at zero; the elbow is up
    where it lies above the line from shoulder to wrist; the wrist is "flip" where axis 6 lies on
    the negative side of the plane of axes 4 and 5.
    """
    if robot.n != 6 or np.any(robot.prismatic):
        return ""
    forward, raised, turned = _branch_sides(robot, q)
    front = np.sign(_branch_sides(robot, np.zeros(6))[0]) or 1.0
    words = (
        ("shoulder", "front" if forward * front > 0.0 else "back"),
        ("elbow", "up" if raised > 0.0 else "down"),
        ("wrist", "no flip" if turned > 0.0 else "flip"),
    )
    return ", ".join(f"{part} {side}" for part, side in words)


def describe_posture(robot: Robot, q: np.ndarray) -> str:
    """Branch and joint positions (n,) in words."""
    angles = ", ".join(
        f"{1e3 * each:.4g} mm" if slides else f"{each:.4g}"
        for each, slides in zip(np.round(q, 6) + 0.0, robot.prismatic, strict=True)
    )
    return f"{f'posture {branch_name(robot, q)}'.rstrip()} [{angles}] rad"


def _branch_sides(robot: Robot, q: np.ndarray) -> tuple[float, float, float]:
    """Signed sides: wrist across the plane of axes 1 and 2, elbow over its line, axis 6."""
    bodies = robot.rigid_bodies()
    frames = [bodies.pose(LinkFrame(joint, np.zeros(3), np.eye(3)), q) for joint in range(1, 7)]
    at = [place for place, _ in frames]
    axes = [turn @ robot.tree.bodies[j].axis for j, (_, turn) in enumerate(frames)]
    up = axes[0] if axes[0] @ np.array([0.0, 0.0, 1.0]) >= 0.0 else -axes[0]
    shoulder, elbow, wrist = at[1], at[2], at[4]
    line = wrist - shoulder
    # The line from shoulder to wrist may vanish.
    share = float((elbow - shoulder) @ line) / max(float(line @ line), 1e-9)
    return (
        float(np.cross(axes[1], up) @ (wrist - at[0])),
        float((elbow - shoulder - share * line) @ up),
        float(np.cross(axes[3], axes[4]) @ axes[5]),
    )


def within_limits(robot: Robot, limits: Limits) -> Robot:
    """Robot with the position limits of a problem, for inverse kinematics."""
    lower, upper = limits.position_lower, limits.position_upper
    return replace(robot, position_lower=lower, position_upper=upper)
