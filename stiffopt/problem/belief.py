"""The optimiser's own model along a motion that it found: what it believed, as numbers."""

from __future__ import annotations

import casadi as ca
import numpy as np

from stiffopt.dynamics.friction import smoothing_width
from stiffopt.problem.coordinates import coordinates_of
from stiffopt.problem.stage_model import StageModel
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.believed import Believed
from stiffopt.result.trajectory import Trajectory

PARTS = ("static", "dynamic", "process", "total")


def believed_of(
    problem: TrajectoryProblem, motion: Trajectory, smoothing: float, *, elastic: bool
) -> Believed:
    """Evaluate the stage model at the nodes and midpoints of a motion.

    Parameters
    ----------
    problem : TrajectoryProblem
    motion : Trajectory
        Of the problem's coordinates: all joints, or the one of a fixed path.
    smoothing : float
        Factor on the smoothing widths in the last stage.
    elastic : bool
        Whether stiffness plays a part in the problem.
    """
    size = coordinates_of(problem).size
    x, u = ca.SX.sym("x", 2 * size), ca.SX.sym("u", size)
    model = StageModel(
        problem.robot,
        *coordinates_of(problem).joint_motion(x, u),
        problem.process_force,
        smoothing=smoothing,
        sides=np.zeros(problem.joints),
    )
    outputs = {"spring_torque": model.torques.spring, "torque": model.drive_torque}
    if elastic:
        outputs["windup"] = model.windup(model.torques.spring)
        outputs |= {part: getattr(model.deflection, part) for part in PARTS}
    time = np.union1d(motion.times, 0.5 * (motion.times[1:] + motion.times[:-1]))
    states = np.hstack([motion(time), motion(time, 1)])
    function = ca.Function("believed", [x, u], [ca.densify(value) for value in outputs.values()])
    found = function.map(len(time))(states.T, motion(time, 2).T)
    values = {name: value.full().T for name, value in zip(outputs, found, strict=True)}
    return Believed(
        time=time,
        spring_torque=values["spring_torque"],
        torque=values["torque"],
        friction_width=np.asarray(smoothing_width(problem.robot.velocity_max)),
        windup=values.get("windup"),
        deflection={part: values[part] for part in PARTS if part in values},
    )
