"""Quantities that the optimiser's model predicts along its own solution."""

from __future__ import annotations

import casadi as ca
import numpy as np

from stiffopt.dynamics.friction import dry_friction_width
from stiffopt.problem.coordinates import coordinates_of
from stiffopt.problem.formulation import stage_model
from stiffopt.problem.stage_terms import Smoothing
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.assessment import PredictedMotion
from stiffopt.result.trajectory import Trajectory
from stiffopt.symbolic import array_of

DEFLECTION_PARTS = ("static", "dynamic", "process", "total")


def predict_motion(
    problem: TrajectoryProblem, motion: Trajectory, smoothing: Smoothing, *, elastic: bool
) -> PredictedMotion:
    """Evaluate the stage model at the nodes and midpoints of a motion.

    `motion`: in the problem's coordinates: all joints, or the parameter of a fixed path.
    `smoothing`: widths of the last stage. `elastic`: add wind-up and deflection; True where
    stiffness enters the problem.
    """
    coordinates = coordinates_of(problem)
    size, order = coordinates.size, coordinates.order
    x, u = ca.SX.sym("x", order * size), ca.SX.sym("u", size)
    model = stage_model(problem, coordinates, x, u, smoothing, np.zeros(problem.joints))
    outputs = {"spring_torque": model.torques.spring}
    if not problem.plans_links:
        # With links planned, the optimiser's motor acceleration is approximate: see `MotorModel`.
        outputs["torque"] = model.drive_torque
    if elastic:
        outputs["windup"] = model.windup(model.torques.spring)
        outputs |= {part: getattr(model.deflection, part) for part in DEFLECTION_PARTS}
    time = np.union1d(motion.times, 0.5 * (motion.times[1:] + motion.times[:-1]))
    states = np.hstack([motion(time, k) for k in range(order)])
    function = ca.Function("believed", [x, u], [ca.densify(value) for value in outputs.values()])
    found = function.map(len(time))(states.T, motion(time, order).T)
    values = {name: array_of(value).T for name, value in zip(outputs, found, strict=True)}
    return PredictedMotion(
        time=time,
        spring_torque=values["spring_torque"],
        torque=values.get("torque"),
        friction_width=np.asarray(dry_friction_width(problem.robot.velocity_max)),
        windup=values.get("windup"),
        deflection={part: values[part] for part in DEFLECTION_PARTS if part in values},
    )
