"""simulation.html: the arm as it swings, and how far its tool is from where it would hang."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.report.common.page import PageFigures, write_page
from stiffopt.report.common.text import si
from stiffopt.report.scene.embedded import embedded_scene
from stiffopt.report.scene.poses import Poses, joint_shares, tool_jacobian
from stiffopt.report.solve.compensation import (
    COMPENSATED,
    compensation_figure,
    compensation_section,
)
from stiffopt.report.solve.swing import simulation_notes, simulation_table, swing_figure

if TYPE_CHECKING:
    from stiffopt.elastic.arm import ElasticArm
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.compensation import Compensation
    from stiffopt.result.simulation import SimulatedMotion, Simulation

PAGE_FILE = "simulation.html"
# Time behind the arrival that the scene shows [s], and its frames.
_AFTER, _FRAMES = 0.4, 241


def write_simulation_report(
    problem: TrajectoryProblem,
    arm: ElasticArm,
    simulation: Simulation,
    directory: str | Path,
    compensation: Compensation | None = None,
) -> Path:
    """Write simulation.html and its figures; return its path.

    Parameters
    ----------
    problem : TrajectoryProblem
    arm : ElasticArm
        That was simulated.
    simulation : Simulation
    directory : path
    compensation : Compensation, optional
        Of the command that is written, on uncertain arms.
    """
    own = simulation.optimised.simulated
    shown = [motion for motion in simulation.motions if motion.name != "optimised"][:1]
    motions = {"optimised": swinging_poses(arm, own)}
    motions |= {each.name: swinging_poses(arm, each.simulated) for each in shown}
    figures = PageFigures("simulation", png=False)
    figures.draw("swing", swing_figure(simulation), "Deviation of the tool over time")
    if compensation is not None:
        drawn = compensation_figure(compensation)
        figures.draw("compensation", drawn, COMPENSATED)
    scene = embedded_scene(problem.robot, motions, "swing", problem.cell)
    figures.draw("arm", scene.still, "The arm with the paths of its tool")
    after = "" if own.peak_after is None else f", {si(own.peak_after, 'm', 3)} after arrival"
    context = {
        "title": f"{problem.title or problem.robot.name}, simulated",
        "headline": f"The tool swings by up to {si(own.peak, 'm', 3)} in flight{after}",
        "simulated": simulation_table(simulation),
        "notes": simulation_notes(simulation),
        "lead": compensation_section(compensation),
        "space": scene.embedded,
        "still": scene.caption,
    }
    path = Path(directory) / PAGE_FILE
    return write_page("solve/simulation.html.j2", path, context, figures)


def swinging_poses(arm: ElasticArm, motion: SimulatedMotion, frames: int = _FRAMES) -> Poses:
    """Where the arm would hang at rest at each instant, and how far its links are from there."""
    end = min(float(motion.time[-1]), motion.duration + _AFTER)
    at = np.unique(np.searchsorted(motion.time, np.linspace(0.0, end, frames)))
    at = np.unique([*at[at < len(motion.time)], int(np.argmax(motion.distance))])
    hanging = arm.static_equilibrium((motion.position + motion.windup)[at])
    bend = hanging - motion.position[at]
    jacobian = tool_jacobian(arm.robot.tree, arm.robot.tool, hanging)
    return Poses(
        time=motion.time[at],
        position=hanging,
        bend={"swing": bend},
        share={"swing": joint_shares(jacobian, bend)},
        deflection={"swing": motion.distance[at]},
    )
