"""Coarse scan of the freedom of a tool path: postures, constant rotations and tilts, placements.

All candidates are followed along the path at once, from a pose that each posture was found at. From
pose to pose the joints turn as little as possible; where the last joint of a positioner turns the
work, also so that the tool's place about its axis, or the feed's direction, is at rest in the cell.
No small step leads from the ones to the others: they differ by whole turns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import scipy

from stiffopt.dynamics.inverse_kinematics import UnreachablePoseError, solve_pose
from stiffopt.problem.branches import solutions_of_pose
from stiffopt.problem.freedom_task import EXCESS_WEIGHT, SCAN_STRIDE, FreedomTask

# Directions of tilt, and shares of half-widths at which tilt and placement are tried.
_TILT_DIRECTIONS, _TRIED_SHARE = 6, 2.0 / 3.0
# Difference of two turning motions of the work below which they are one [rad].
_SAME_ANGLE = 0.5


@dataclass(frozen=True, eq=False)
class PathCandidate:
    """A motion of the arm along the path at all nodes, with constant freedom."""

    placement: np.ndarray  # (6,)
    turns: np.ndarray  # (3,)
    joints: np.ndarray  # (K, n)
    # Largest deflection [m], more where joints are too slow for the speed; or the time [s].
    cost: float
    excess: float  # largest of torques at rest, relative

    @property
    def rank(self) -> float:
        """Cost with the price of the excess."""
        return self.cost * (1.0 + EXCESS_WEIGHT * self.excess)


def scan_candidates(task: FreedomTask, near: np.ndarray, count: int) -> list[PathCandidate]:
    """Return the best candidates that follow the whole path, of different postures and rotations.

    `near` (n,): reference of the postures [rad]. `count`: of candidates at most.
    """
    anywhere = task.freedom.posture == "any"
    nodes = task.along[::SCAN_STRIDE]
    begin = len(nodes) // 2 if anywhere else 0
    data = task.node_data(nodes)
    seeds = _postures(task, nodes[begin], near)
    if not len(seeds):
        return []
    # Of more candidates, a random choice is taken.
    settings = _settings(task, 4000 // len(seeds))
    placement, turns = np.split(np.tile(settings, (len(seeds), 1)).T, [6])
    q, found = task.solve_poses(
        np.repeat(seeds, len(settings), axis=0),
        placement,
        turns,
        np.repeat(data[:, [begin]], placement.shape[1], axis=1),
    )
    kept = np.flatnonzero(found)
    kept = kept[_first_of_equal(np.hstack([_unwound(q), placement.T, turns.T])[kept])]
    placement, turns = placement[:, kept], turns[:, kept]
    angles = [None, *_turning_angles(task, nodes)]
    groups = []
    for angle in angles:
        own = np.full((len(kept), len(nodes), task.robot.n), np.nan)
        own[:, begin] = q[kept]
        for order in (range(begin + 1, len(nodes)), range(begin - 1, -1, -1)):
            _follow(task, own, order, placement, turns, data, angle)
        groups.append(own)
    joints = np.concatenate(groups)
    placement, turns = (np.tile(each, len(angles)) for each in (placement, turns))
    whole = np.flatnonzero(np.isfinite(joints).all(axis=(1, 2)))
    if not len(whole):
        return []
    moved, turned = (np.repeat(each[:, whole], len(nodes), axis=1) for each in (placement, turns))
    costs = np.stack(task.costs(joints[whole], nodes, moved, turned, data), axis=1)
    found_whole = [
        PathCandidate(placement[:, k], turns[:, k], joints[k], *own.tolist())
        for k, own in zip(whole, costs, strict=True)
    ]
    chosen: list[PathCandidate] = []
    for candidate in sorted(found_whole, key=lambda each: each.rank):
        if len(chosen) < count and all(_differ(task, candidate, each) for each in chosen):
            chosen.append(candidate)
    return chosen


def refine_candidate(task: FreedomTask, candidate: PathCandidate) -> PathCandidate | None:
    """Return a candidate at all nodes of the task, None where it does not follow them."""
    nodes = task.along[::SCAN_STRIDE]
    guess = np.stack(
        [np.interp(task.along, nodes, column) for column in candidate.joints.T], axis=1
    )
    placement, turns = (
        np.repeat(each[:, None], len(guess), axis=1)
        for each in (candidate.placement, candidate.turns)
    )
    data = task.node_data(task.along)
    q, found = task.solve_poses(guess, placement, turns, data)
    if not found.all():
        return None
    (cost,), (excess,) = task.costs(q[None], task.along, placement, turns, data)
    return replace(candidate, joints=q, cost=float(cost), excess=float(excess))


def _settings(task: FreedomTask, most: int) -> np.ndarray:
    """Return the constant placements, rotations and tilts (S, 9) that are tried, `most` at most."""
    freedom = task.freedom
    half = freedom.placement
    free = np.flatnonzero(half)
    shares = (0.0, -_TRIED_SHARE, _TRIED_SHARE)
    shifts = []
    for each in product(shares, repeat=len(free)):
        shift = np.zeros(6)
        shift[free] = each * half[free]
        shifts.append(shift)
    tilts = [np.zeros(2)]
    if freedom.tilt > 0.0:
        angles = 2.0 * np.pi * np.arange(_TILT_DIRECTIONS) / _TILT_DIRECTIONS
        tilts += [_TRIED_SHARE * freedom.tilt * np.array([np.cos(a), np.sin(a)]) for a in angles]
    # Rotations of a tool that turns freely, alone and beside other freedom.
    count = 24 if len(shifts) * len(tilts) == 1 else 8
    if freedom.rotates_freely:
        spins = 2.0 * np.pi * np.arange(count) / count - np.pi
    elif freedom.tool_axis_rotation > 0.0:
        spins = np.linspace(-1.0, 1.0, count | 1) * freedom.tool_axis_rotation
    else:
        spins = np.zeros(1)
    rows = [
        # The tilt is about axes of the tool before its rotation.
        np.concatenate([shift, [spin], tilt])
        for shift, tilt, spin in product(shifts, tilts, spins)
    ]
    if len(rows) > most:
        # Those without shift and tilt come first.
        others = np.random.default_rng(1).permutation(np.arange(len(spins), len(rows)))
        rows = [rows[k] for k in [*range(len(spins)), *sorted(others[: most - len(spins)])]]
    return np.array(rows)


def _postures(task: FreedomTask, along: float, near: np.ndarray) -> np.ndarray:
    """Return joint positions (P, n) of the stated pose at a distance [m], turned evenly."""
    freedom = task.freedom
    (place,), (rotation,) = task.path.poses(np.array([along]))
    bound = np.pi if freedom.rotates_freely else freedom.tool_axis_rotation
    # Rotations at which postures are searched.
    count = 4 if bound > 0.0 else 1
    spins = bound * (np.arange(count) / max(count - 1, 1) * 2.0 - 1.0) if count > 1 else [0.0]
    found: list[np.ndarray] = []
    for spin in spins:
        turned = (
            rotation @ scipy.spatial.transform.Rotation.from_rotvec([0.0, 0.0, spin]).as_matrix()
        )
        if freedom.posture == "any":
            found += solutions_of_pose(task.robot, place, turned, near, lambda q: True)
            continue
        try:
            found.append(solve_pose(task.robot, place, turned, near))
        except UnreachablePoseError:
            continue
    if not found:
        return np.zeros((0, task.robot.n))
    poses = np.stack(found)
    return np.asarray(poses[_first_of_equal(_unwound(poses))])


def _first_of_equal(rows: np.ndarray) -> np.ndarray:
    """Return the numbers of rows (R, m) that equal none before them."""
    # Largest joint difference of equal postures [rad].
    _, first = np.unique(np.round(rows / 1e-3), axis=0, return_index=True)
    return np.sort(first)


def _follow(
    task: FreedomTask,
    joints: np.ndarray,
    order: range,
    placement: np.ndarray,
    turns: np.ndarray,
    data: np.ndarray,
    angle: np.ndarray | None,
) -> None:
    """Fill in the joint positions (C, K, n) at nodes in order, NaN from where they end.

    `angle` (K,) is that by which the joint of the work turns [rad]; None: as little as possible.
    """
    back = -1 if order.step > 0 else 1
    held, work = None, _work_joint(task)
    if angle is not None:
        held = np.arange(task.robot.n) == work
    for k in order:
        own = np.flatnonzero(np.isfinite(joints[:, k + back]).all(axis=1))
        if not len(own):
            return
        before = joints[own, k + back]
        guess = before.copy()
        if angle is not None:
            guess[:, work] += angle[k] - angle[k + back]
        at = np.repeat(data[:, [k]], len(own), axis=1)
        q, found = task.solve_poses(guess, placement[:, own], turns[:, own], at, held)
        # Larger joint steps between neighbouring nodes of the scan are a change of posture [rad].
        found &= np.abs(q - before).max(axis=1) < 1.2
        joints[own[found], k] = q[found]


def _work_joint(task: FreedomTask) -> int:
    """Return the joint (from 0) whose link carries the work, -1 where the base does."""
    work = task.robot.tool.seen_from
    return -1 if work is None else work.joint - 1


def _turning_angles(task: FreedomTask, nodes: np.ndarray) -> list[np.ndarray]:
    """Return angles (K,) [rad] of the joint of the work at nodes with which it turns.

    One for the tool's place about its axis at rest in the cell, one for the direction of the feed.
    """
    joint, work = _work_joint(task), task.robot.tool.seen_from
    if work is None or task.robot.prismatic[joint]:
        return []
    axis = work.rotation.T @ task.robot.tree.bodies[joint].axis
    place, _ = task.path.stated_poses(nodes)
    place = place + work.rotation.T @ work.offset
    across = np.linalg.svd(axis[None])[2][1:]
    across[1] = np.cross(axis, across[0])
    found: list[np.ndarray] = []
    for arrow in (place, np.gradient(place, nodes, axis=0)):
        x, y = across @ arrow.T
        angle = -np.unwrap(np.arctan2(y, x))
        # Less than half a turn is found from the motion that turns the joints least.
        if np.ptp(angle) > np.pi and all(np.ptp(angle - each) > _SAME_ANGLE for each in found):
            found.append(angle)
    return found


def _unwound(q: np.ndarray) -> np.ndarray:
    """Return cosine and sine of joint positions (K, n), equal for full turns."""
    return np.hstack([np.cos(q), np.sin(q)])


def _differ(task: FreedomTask, one: PathCandidate, other: PathCandidate) -> bool:
    """Return True where candidates differ in posture or rotation, or by a step of the scan."""
    joints = np.abs(np.angle(np.exp(1j * (one.joints - other.joints)))).max()
    shift = np.abs(one.placement - other.placement) >= 0.5 * task.freedom.placement
    tilt = np.abs(one.turns[1:] - other.turns[1:]) >= 0.5 * task.freedom.tilt
    # Least difference of a joint between chosen candidates [rad].
    return bool(
        joints > 0.6
        or np.any(shift & (task.freedom.placement > 0.0))
        or np.any(tilt & (task.freedom.tilt > 0.0))
    )
