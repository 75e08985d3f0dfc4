"""Notes on a simulated motion along a tool path: its figures, and its error under the force."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.result.path_figures import path_figures
from stiffopt.robot.batched_kinematics import frame_positions, frame_rotations

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.simulation import SimulatedMotion
    from stiffopt.result.solution import Solution


def with_path_notes(problem: TrajectoryProblem, solution: Solution) -> Solution:
    """Return the solution with the figures of its tool path and its error under the force."""
    if solution.simulation is None or solution.compensation is None:
        return solution
    led = solution.compensation.optimised.simulated
    followed = solution.simulation.optimised.simulated
    notes = [_describe_force_error(problem, solution)]
    for how, own in (("as planned", followed), ("with the command", led)):
        told = _describe_path(problem, solution, own)
        notes.append(f"Tool path {how}, {told}" if told else "")
    return replace(solution, notes=(*solution.notes, *filter(None, notes)))


def _describe_path(problem: TrajectoryProblem, solution: Solution, own: SimulatedMotion) -> str:
    """Return the figures of a simulated motion along a tool's path as a note; "" without one."""
    path, plan = problem.path, solution.trajectory
    if path is None or plan is None or (problem.path_force is None and not len(path.corners)):
        return ""
    link = plan if plan.link is None else plan.link
    tree, tool = problem.robot.tree, problem.robot.tool
    command = frame_positions(tree, tool, link(np.minimum(own.time, link.duration)))
    found = path_figures(command, command + own.error.position, path.corners, own.settling_time)
    told = [f"path accuracy {1e3 * found.accuracy:.3g} mm"]
    if found.rounding:
        told.append(
            f"corners rounded by up to {1e3 * max(found.rounding):.3g} mm with up to "
            f"{1e3 * max(found.overshoot):.3g} mm of overshoot"
        )
    if found.settling_time is not None:
        told.append(f"settled within {1e3 * own.band:.3g} mm {found.settling_time:.3g} s after")
    return f"as in ISO 9283: {', '.join(told)}."


def _describe_force_error(problem: TrajectoryProblem, solution: Solution) -> str:
    """Return the error under the path's force before and after compensation; "" without one."""
    led = solution.compensation
    if problem.path_force is None or led is None:
        return ""
    before, after = led.optimised.planned.flight, led.optimised.compensated.flight
    across = [
        f"{1e3 * spread.parts['across'].worst:.3g} mm across the path" for spread in (before, after)
    ]
    told = (
        f"Under the process force the worst of the uncertain arms errs by {1e3 * before.worst:.3g} "
        f"mm ({across[0]}) where the motors follow the path, and by {1e3 * after.worst:.3g} mm "
        f"({across[1]}) with the command."
    )
    own = led.optimised.worst
    if own is None or solution.trajectory is None:
        return told
    link = solution.trajectory
    turned = frame_rotations(
        problem.robot.tree, problem.robot.tool, link(np.minimum(own.time, link.duration))
    )
    feed = own.error.direction
    axis = turned[:, :, 2] - np.sum(turned[:, :, 2] * feed, axis=1)[:, None] * feed
    axis /= np.maximum(np.linalg.norm(axis, axis=1), 1e-12)[:, None]
    flight = own.error.flight
    parts = (
        np.sum(own.error.position * axis, axis=1),
        np.sum(own.error.position * np.cross(axis, feed), axis=1),
    )
    normal = [f"{1e3 * np.abs(part[flight]).max():.3g} mm" for part in parts]
    return (
        f"{told} Normal to the machined surface that is {normal[0]} along the tool's axis and "
        f"{normal[1]} to the side of the feed."
    )
