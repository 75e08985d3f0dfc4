"""Choice of the freedom of a tool path: the best optimum that a joint spline can follow."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from stiffopt.errors import ProblemError
from stiffopt.problem.branches import describe_posture, middle_of_ranges, within_limits
from stiffopt.problem.freedom_programme import FreedomOptimum, optimise_freedom
from stiffopt.problem.freedom_task import FreedomTask
from stiffopt.problem.tool_path import FittedPath, ToolPath, fit_tool_path
from stiffopt.result.provenance import inputs_hash
from stiffopt.robot.cell import Cell
from stiffopt.robot.clearance import ClearanceModel

# Relative difference of estimated times below which optima are the same one.
_SAME_TIME = 1e-4


@dataclass(frozen=True, eq=False)
class ChosenFreedom:
    """Path with its chosen freedom."""

    path: ToolPath
    fitted: FittedPath
    remark: str  # what was chosen, and its value
    # The choice as results keep it, with a hash of all that it depends on.
    document: dict[str, Any]


def choose_freedom(
    task: FreedomTask,
    near: np.ndarray | None,
    tolerance: float,
    cell: Cell,
    kept: object = None,
    timing: Callable[[ChosenFreedom], float] | None = None,
) -> ChosenFreedom:
    """Return the path with the best freedom that a joint spline can follow.

    `near` (n,) is that of the file. `kept` is the document of an earlier choice, which is taken
    where it was made from the same task. With `timing`, the duration [s] of a choice, the fastest
    of all optima and the path as stated is taken where the time is minimised.
    """
    start = middle_of_ranges(task.robot) if near is None else near
    inputs = _hash_of_inputs(task, start, tolerance, cell)

    def chosen(found: FreedomOptimum) -> ChosenFreedom:
        path = task.path.chosen(found.choice)
        fitted = fit_tool_path(task.robot, path, found.choice.joints, tolerance)
        document = {
            "inputs_hash": inputs,
            "value": found.value,
            "placement": found.choice.placement.tolist(),
            "turns": found.choice.turns.tolist(),
            "joints": found.joints.tolist(),
        }
        return ChosenFreedom(path, fitted, _describe_choice(task, found), document)

    def stated() -> ChosenFreedom:
        asked = near if task.freedom.posture == "any" else start
        robot = within_limits(task.robot, task.limits)
        fitted = fit_tool_path(robot, task.path, asked, tolerance)
        posture = describe_posture(task.robot, fitted.joints.points[0])
        remark = f"Of path.freedom nothing is used: the path as stated is the fastest; {posture}."
        document = {"inputs_hash": inputs, "as_stated": True}
        return ChosenFreedom(task.path, fitted, remark, document)

    if isinstance(kept, dict) and kept.get("inputs_hash") == inputs and kept.get("as_stated"):
        return stated()
    if (known := _read_kept(task, kept, inputs)) is not None:
        return chosen(known)
    optima = _optima_without_collisions_first(task, start, cell)
    failures: list[ProblemError] = []

    def followed(makers: Iterator[Callable[[], ChosenFreedom]]) -> Iterator[ChosenFreedom]:
        """Choices that a joint spline can follow."""
        for make in makers:
            try:
                yield make()
            except ProblemError as error:
                failures.append(error)

    if timing is None or task.minimises_error:
        first = next(followed(partial(chosen, each) for each in optima), None)
    else:
        # Estimates are within 4 % of timings, so that their order is not that of the timings.
        makers = [partial(chosen, each) for each in _different(optima)]
        first = min(followed(iter([*makers, stated])), key=timing, default=None)
    if first is None:
        raise failures[0]
    return first


def _different(optima: list[FreedomOptimum]) -> list[FreedomOptimum]:
    """Return the first of each optima with the same estimated time."""
    kept: list[FreedomOptimum] = []
    for found in optima:
        if all(abs(found.value - each.value) > _SAME_TIME * each.value for each in kept):
            kept.append(found)
    return kept


def _optima_without_collisions_first(
    task: FreedomTask, near: np.ndarray, cell: Cell
) -> list[FreedomOptimum]:
    clearance = ClearanceModel(task.robot, cell)

    def collides(found: FreedomOptimum) -> bool:
        nearest = min(clearance.distances(q).min(initial=np.inf) for q in found.joints)
        return bool(nearest < cell.clearance)

    return sorted(optimise_freedom(task, near), key=collides)


def _hash_of_inputs(task: FreedomTask, near: np.ndarray, tolerance: float, cell: Cell) -> str:
    """Hash of all that a choice depends on."""
    path = task.path
    stated = [*path.stated_poses(task.along), path.breaks, path.speeds, path.stops]
    placed = (task.node_data(task.along), task.origin, task.force_axes)
    whole = (task.robot, task.freedom, task.limits, stated, placed, near, tolerance, cell)
    return inputs_hash(whole)


def _read_kept(task: FreedomTask, kept: object, inputs: str) -> FreedomOptimum | None:
    """Return the optimum of an earlier choice from the same inputs; None where it has none."""
    if not isinstance(kept, dict) or kept.get("inputs_hash") != inputs:
        return None
    shapes = {
        "placement": (6,),
        "turns": (task.basis.size, 3),
        "joints": (len(task.along), task.robot.n),
    }
    try:
        found = {name: np.array(kept[name], dtype=float) for name in shapes}
        value = float(kept["value"])
    except (KeyError, TypeError, ValueError):
        return None
    if any(
        found[name].shape != shape or not np.isfinite(found[name]).all()
        for name, shape in shapes.items()
    ):
        return None
    return FreedomOptimum.at(task, **found, cost=value, value=value)


def _describe_choice(task: FreedomTask, found: FreedomOptimum) -> str:
    """Return a remark on the choice and its value."""
    freedom, choice = task.freedom, found.choice
    spin, *tilt = np.degrees(choice.angles(task.along)).T
    parts = []
    parts.append(f"{describe_posture(task.robot, found.joints[0])} at the start")
    if freedom.tool_axis_rotation > 0.0:
        parts.append(f"rotation about the tool's axis {spin.min():.4g} to {spin.max():.4g} deg")
    if freedom.tilt > 0.0:
        parts.append(f"tilt up to {np.hypot(*tilt).max():.3g} deg")
    if np.any(freedom.placement):
        shift = ", ".join(f"{1e3 * x:.4g}" for x in choice.placement[:3])
        turn = ", ".join(f"{np.degrees(x):.3g}" for x in choice.placement[3:])
        parts.append(f"work frame shifted by [{shift}] mm and turned by [{turn}] deg")
    gain = (
        f"peak deflection under the process force, {1e6 * found.value:.4g} µm"
        if task.minimises_error
        else f"estimated time, {found.value:.4g} s"
    )
    return f"Chosen by path.freedom for the least {gain}: {'; '.join(parts)}."
