"""Choice of the freedom of a tool path: the best optimum that a joint spline can follow."""

from __future__ import annotations

import numpy as np

from stiffopt.errors import ProblemError
from stiffopt.problem.branches import branch_name
from stiffopt.problem.freedom_programme import FreedomOptimum, optimise_freedom
from stiffopt.problem.freedom_task import FreedomTask
from stiffopt.problem.tool_path import FittedPath, ToolPath, fit_tool_path
from stiffopt.robot.cell import Cell
from stiffopt.robot.clearance import ClearanceModel


def choose_freedom(
    task: FreedomTask, near: np.ndarray, tolerance: float, cell: Cell
) -> tuple[ToolPath, FittedPath, str]:
    """Return the path with the best freedom that a joint spline can follow, and a remark.

    Optima without collisions at the nodes come first.
    """
    failure: ProblemError | None = None
    clearance = ClearanceModel(task.robot, cell)

    def collides(found: FreedomOptimum) -> bool:
        nearest = min(clearance.distances(q).min(initial=np.inf) for q in found.joints)
        return bool(nearest < cell.clearance)

    for found in sorted(optimise_freedom(task, near), key=collides):
        path = task.path.chosen(found.choice)
        try:
            fitted = fit_tool_path(task.robot, path, found.choice.joints, tolerance)
            return path, fitted, _describe_choice(task, found)
        except ProblemError as error:
            failure = failure or error
    assert failure is not None
    raise failure


def _describe_choice(task: FreedomTask, found: FreedomOptimum) -> str:
    """Return a remark on the choice and its value."""
    freedom, choice = task.freedom, found.choice
    spin, *tilt = np.degrees(choice.angles(task.along)).T
    parts = []
    branch = f"posture {branch_name(task.robot, found.joints[0])}".rstrip()
    start = zip(found.joints[0], task.robot.prismatic, strict=True)
    angles = ", ".join(f"{1e3 * q:.4g} mm" if slides else f"{q:.4g}" for q, slides in start)
    parts.append(f"{branch} [{angles}] rad at the start")
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
