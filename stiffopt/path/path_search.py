"""Search of a collision-free path to start a solve from: one intermediate pose, else two trees.

Edges are free along their whole length: no distance changes faster than the joints can move the
farthest point of the arm, which bounds it between two poses.

Source: Kuffner, LaValle (2000), "RRT-connect: an efficient approach to single-query path planning".
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.result.joint_path import JointPath

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import TrajectoryProblem

# Largest number of poses of one search, most of which are in edges of the trees: some 10 s.
_MAX_TRIED_POSES = 100_000
# Trial poses of a path by one intermediate pose, and their spreads about the straight line, as
# shares of the joints' ranges.
_INTERMEDIATE_POSES = 1500
_INTERMEDIATE_SPREADS = (0.05, 0.1, 0.2, 0.4)
# Step of the trees, as a share of the joints' ranges; resolution of edges [rad].
_TREE_STEP = 0.15
_MIN_EDGE_STEP = 0.01
_SHORTCUT_ATTEMPTS = 60
# Spline through a path: samples that are checked, and refinements towards the polyline.
_SPLINE_SAMPLES = 60
_MAX_REFINEMENTS = 4


class FreeSpace:
    """Collision-free poses of a problem's arm, and paths through them.

    `seconds`: time that is left; the number of poses bounds the search on every machine alike.
    """

    def __init__(self, problem: TrajectoryProblem, seed: int, seconds: float) -> None:
        self._model = problem.clearance_model
        self._clearance = problem.stated_cell.clearance
        self._random = np.random.default_rng(seed)
        self._until = time.perf_counter() + seconds
        limits = problem.active_limits
        low, high = limits.position_lower, limits.position_upper
        self._low = np.where(np.isfinite(low), low, -np.pi)
        self._high = np.where(np.isfinite(high), high, np.pi)
        speed = limits.velocity
        self._speed = np.where(np.isfinite(speed), speed, 1.0)
        # Number of poses evaluated.
        self.tried = 0

    @property
    def timed_out(self) -> bool:
        """True where the time is over."""
        return time.perf_counter() > self._until

    @property
    def _is_exhausted(self) -> bool:
        return self.tried >= _MAX_TRIED_POSES or self.timed_out

    def path(self, points: np.ndarray) -> np.ndarray | None:
        """Return poses (k, n) of a free spline through all `points` (m, n), None if none is found.

        None without a search where one of `points` is `blocked`.
        """
        if self.blocked(points):
            return None
        found = [points[0]]
        for start, end in pairwise(points):
            leg = self._connect_poses(start, end)
            if leg is None:
                return None
            found += leg[1:]
        return self._refine_spline(found)

    def blocked(self, points: np.ndarray) -> list[int]:
        """Return indices of `points` (m, n) that overlap by more than the finest step resolves."""
        deepest = self._model.fastest(np.full(np.shape(points), _MIN_EDGE_STEP), np.asarray(points))
        return [k for k, pose in enumerate(points) if self.gap(pose) <= -deepest[k]]

    def gap(self, pose: np.ndarray) -> float:
        """Return the least distance beyond the clearance [m]."""
        self.tried += 1
        return float(self._model.couple_distances(pose).min()) - self._clearance

    def poses(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Return random poses (count, n) in the joints' ranges."""
        return random.uniform(self._low, self._high, (count, len(self._low)))

    def _connect_poses(self, start: np.ndarray, end: np.ndarray) -> list[np.ndarray] | None:
        if self._edge_is_free(start, end):
            return [start, end]
        between = self._connect_by_one_pose(start, end)
        if between is not None:
            return [start, between, end]
        tree = self._connect_by_trees(start, end)
        return None if tree is None else self._replace_detours(tree)

    def _connect_by_one_pose(self, start: np.ndarray, end: np.ndarray) -> np.ndarray | None:
        """Return the intermediate pose of the shortest free path of two straight edges."""
        count = _INTERMEDIATE_POSES
        width = self._high - self._low
        spread = np.repeat(_INTERMEDIATE_SPREADS, count // len(_INTERMEDIATE_SPREADS))[:, None]
        along = self._random.uniform(0.2, 0.8, (len(spread), 1))
        poses = start + along * (end - start)
        poses = poses + spread * width * self._random.normal(size=poses.shape)
        poses = np.clip(poses, self._low, self._high)
        length = self._travel_times(poses - start) + self._travel_times(end - poses)
        for pose in poses[np.argsort(length)]:
            if self._is_exhausted:
                return None
            if (
                self.gap(pose) > 0.0
                and self._edge_is_free(start, pose)
                and self._edge_is_free(pose, end)
            ):
                return np.asarray(pose)
        return None

    def _connect_by_trees(self, start: np.ndarray, end: np.ndarray) -> list[np.ndarray] | None:
        """Connect two poses by two trees that grow towards each other."""
        trees: list[_Tree] = [_Tree(start), _Tree(end)]
        while not self._is_exhausted:
            [aim] = self.poses(1, self._random)
            reached = self._grow_towards(trees[0], aim, once=True)
            if reached is not None:
                other = self._grow_towards(trees[1], trees[0].poses[reached], once=False)
                if other is not None and np.allclose(
                    trees[1].poses[other], trees[0].poses[reached]
                ):
                    one, two = trees[0].to_root(reached), trees[1].to_root(other)
                    whole = [*one[::-1], *two[1:]]
                    return whole if np.array_equal(whole[0], start) else whole[::-1]
            trees.reverse()
        return None

    def _grow_towards(self, tree: _Tree, aim: np.ndarray, *, once: bool) -> int | None:
        """Grow a tree towards an aim; return the index of its last pose, None where blocked."""
        width = self._high - self._low
        nearest = tree.nearest(aim, width)
        found = None
        while not self._is_exhausted:
            away = aim - tree.poses[nearest]
            share = _TREE_STEP / max(float(np.linalg.norm(away / width)), 1e-12)
            pose = aim if share >= 1.0 else tree.poses[nearest] + share * away
            if not self._edge_is_free(tree.poses[nearest], pose):
                return found
            nearest = found = tree.add(pose, nearest)
            if once or share >= 1.0:
                return found
        return None

    def _replace_detours(self, path: list[np.ndarray]) -> list[np.ndarray]:
        """Return the path with detours replaced by free straight edges."""
        for _ in range(_SHORTCUT_ATTEMPTS):
            if len(path) < 3 or self._is_exhausted:
                break
            i, j = sorted(self._random.choice(len(path), 2, replace=False))
            if j - i > 1 and self._edge_is_free(path[i], path[j]):
                path = [*path[: i + 1], *path[j:]]
        return path

    def _refine_spline(self, path: list[np.ndarray]) -> np.ndarray:
        """Insert midpoints until the spline through the path is free."""
        poses = np.array(path)
        for _ in range(_MAX_REFINEMENTS):
            spline = JointPath.through(poses, "chord")
            if self._polyline_is_free(spline(np.linspace(0.0, 1.0, _SPLINE_SAMPLES + 1))):
                break
            middle = 0.5 * (poses[:-1] + poses[1:])
            sharper = np.empty((len(poses) + len(middle), poses.shape[1]))
            sharper[::2], sharper[1::2] = poses, middle
            poses = sharper
        return poses

    def _polyline_is_free(self, poses: np.ndarray) -> bool:
        return all(self._edge_is_free(one, other) for one, other in pairwise(poses))

    def _edge_is_free(self, start: np.ndarray, end: np.ndarray) -> bool:
        """Return True where a straight edge keeps the clearance between its ends."""
        stack: list[Sequence[float]] = [(0.0, 1.0)]
        travel = self._distance_change_bound(start, end)
        size = float(np.max(np.abs(end - start), initial=0.0))
        gaps: dict[float, float] = {}

        def gap(share: float) -> float:
            if share not in gaps:
                gaps[share] = self.gap(start + share * (end - start))
            return gaps[share]

        while stack:
            first, second = stack.pop()
            if (
                gap(first) + gap(second) > travel * (second - first)
                or size * (second - first) < _MIN_EDGE_STEP
            ):
                continue
            middle = 0.5 * (first + second)
            if gap(middle) <= 0.0 or self._is_exhausted:
                return False
            stack += [(first, middle), (middle, second)]
        return True

    def _distance_change_bound(self, start: np.ndarray, end: np.ndarray) -> float:
        """Return an upper bound of the change of any distance along a straight edge [m]."""
        poses = np.stack([start, end])
        moved = np.abs(end - start)
        return float(self._model.fastest(np.stack([moved, moved]), poses).max())

    def _travel_times(self, step: np.ndarray) -> np.ndarray:
        """Return the times (k,) of steps (k, n) at full speed."""
        return np.asarray(np.max(np.abs(step) / self._speed, axis=-1))


class _Tree:
    """Tree of poses with the index of each one's parent."""

    def __init__(self, root: np.ndarray) -> None:
        self.poses = [root]
        self._from = [-1]

    def add(self, pose: np.ndarray, before: int) -> int:
        self.poses.append(pose)
        self._from.append(before)
        return len(self.poses) - 1

    def nearest(self, aim: np.ndarray, width: np.ndarray) -> int:
        away = (np.array(self.poses) - aim) / width
        return int(np.argmin(np.sum(away**2, axis=1)))

    def to_root(self, last: int) -> list[np.ndarray]:
        path = []
        while last >= 0:
            path.append(self.poses[last])
            last = self._from[last]
        return path
