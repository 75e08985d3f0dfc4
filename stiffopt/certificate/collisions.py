"""Collisions of a motion with the arm itself and its cell: pair, time, depth.

Distances are evaluated at instants of the certificate's grid, dense enough to exclude contact in
between: no distance changes faster than the joints can move the farthest point of the arm.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.result.assessment import Assessment, Violation

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.robot.clearance import ClearanceModel

COLLISION_LIMIT = "collision"
# Scale of a clearance violation where the stated clearance is smaller [m].
_CLEARANCE_SCALE_WITHOUT_CLEARANCE = 1e-3
# Equal steps before adaptive halving.
_INITIAL_SAMPLES = 128
# Missing mesh files that a message names.
_MAX_NAMED_FILES = 2


def with_collisions(problem: TrajectoryProblem, motion: Assessment) -> Assessment:
    """Return the assessment with a violation for every pair below the clearance.

    Without any, for the nearest pair. Each states the pair's distance at the worst instant; the
    limit is the clearance stated in the cell.
    """
    model = problem.clearance_model
    if not model.pairs:
        return motion
    clearance = problem.stated_cell.clearance
    at, distance = _nearest_instants(model, motion, clearance)
    rows: list[Violation] = []
    for k in np.argsort(distance):
        # All pairs below the clearance, else the nearest one.
        if distance[k] >= clearance and rows:
            break
        excess = (clearance - distance[k]) / max(clearance, _CLEARANCE_SCALE_WITHOUT_CLEARANCE)
        rows.append(
            Violation(
                float(excess),
                COLLISION_LIMIT,
                None,
                float(motion.time[at[k]]),
                pair=model.pairs[k],
                distance=float(distance[k]),
            )
        )
    found = sorted((*motion.violations, *rows), key=lambda each: -each.value)
    return replace(motion, violations=tuple(found))


def _nearest_instants(
    model: ClearanceModel, motion: Assessment, clearance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return instant, on the motion's grid, and distance at which each pair is nearest."""
    last = len(motion.time) - 1
    position, velocity = motion.position, motion.velocity
    if motion.link is not None:
        # Where the links' motion is planned, collisions are theirs, not the motors'.
        position, velocity = motion.link, np.gradient(motion.link, motion.time, axis=0)
    speed = model.fastest(velocity, position)
    known: dict[int, np.ndarray] = {}

    def at(k: int) -> np.ndarray:
        if k not in known:
            known[k] = model.distances(position[k])
        return known[k]

    open_ = np.unique(np.linspace(0, last, min(_INITIAL_SAMPLES, last) + 1).astype(int))
    stack = list(zip(open_[:-1].tolist(), open_[1:].tolist(), strict=True))
    while stack:
        first, second = stack.pop()
        begin, end = at(first), at(second)
        # Lower bound of the distance between two instants, from the greatest speed.
        fall = float(speed[first : second + 1].max()) * (motion.time[second] - motion.time[first])
        least = 0.5 * (begin + end - fall)
        both = np.minimum(begin, end)
        if second - first > 1 and np.any((least < clearance) & (both > clearance)):
            middle = (first + second) // 2
            stack += [(first, middle), (middle, second)]
    for pair in range(len(model.pairs)):
        if min(each[pair] for each in known.values()) < clearance:
            _refine_deepest_instant(pair, at, known)
    instants = np.array(sorted(known))
    every = np.stack([known[k] for k in instants])
    where = np.argmin(every, axis=0)
    return instants[where], every[where, np.arange(every.shape[1])]


def _refine_deepest_instant(
    pair: int, at: Callable[[int], np.ndarray], known: Mapping[int, np.ndarray]
) -> None:
    """Halve the steps beside the deepest instant of a pair until they are the grid's own."""
    while True:
        instants = sorted(known)
        k = min(range(len(instants)), key=lambda i: known[instants[i]][pair])
        beside = instants[max(k - 1, 0) : k + 2]
        wide = [(a + b) // 2 for a, b in pairwise(beside) if b - a > 1]
        if not wide:
            return
        for middle in wide:
            at(middle)


def describe_collision_scope(problem: TrajectoryProblem) -> str:
    """Return sentences on the pairs that the collision check covered and those it did not."""
    model, cell = problem.clearance_model, problem.stated_cell
    around = [name for name in cell.names if any(name in pair for pair in model.pairs)]
    links = sum(not any(name in cell.names for name in pair) for pair in model.pairs)
    checked = list(around)
    if links:
        checked.insert(0, f"the arm with itself ({links} pairs of links)")
    left = [] if links else ["the arm with itself"]
    if cell.floor is None:
        left.append("the floor")
    if not set(cell.names) - {"floor"}:
        left.append("the cell")
    text = ""
    if checked:
        text = f"Collisions were checked: {', '.join(checked)}. "
        if model.guessed and around:
            rods = ", ".join(model.guessed)
            text += f"Links without a shape in the URDF are rods of a guessed radius: {rods}. "
    if left:
        unchecked = " and ".join([", ".join(left[:-1]), left[-1]] if len(left) > 1 else left)
        advice = "describe the surroundings in [cell]"
        if left == ["the arm with itself"]:
            advice = "give the URDF collision shapes"
        text += f"Collisions were not checked: {unchecked}; {advice}."
    if model.missing:
        shown, more = model.missing[:_MAX_NAMED_FILES], len(model.missing) - _MAX_NAMED_FILES
        text += f" Not found or no mesh: {', '.join(shown)}"
        text += f" and {more} more shapes of the URDF." if more > 0 else "."
    return text.strip()
