"""From a trajectory problem to the optimal-control problem that is transcribed.

States are joint positions and velocities, controls are accelerations (or path position, speed and
acceleration on a fixed path); torque enters by inverse dynamics. The one parameter is the factor on
the smoothing widths of the stiffness model.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from stiffopt.problem.bounds import torque_sides
from stiffopt.problem.coordinates import Coordinates, coordinates_of
from stiffopt.problem.limit_rows import limit_rows
from stiffopt.problem.objective_terms import Terms, objective_terms
from stiffopt.problem.resolve import ResolvedMotion
from stiffopt.problem.stage_model import StageModel
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.problem.waypoints import boundary_waypoint, via_waypoint
from stiffopt.transcription.ocp import OptimalControlProblem


@dataclass(frozen=True)
class Scales:
    """Typical sizes that condition the NLP; they do not change its solution.

    Parameters
    ----------
    values : mapping objective name -> float
        A typical value of each objective, in its SI unit.
    """

    values: Mapping[str, float] = field(default_factory=dict)

    def of(self, name: str) -> float:
        """Typical value of an objective; 1 where unknown."""
        value = self.values.get(name, 1.0)
        return value if np.isfinite(value) and value > 0 else 1.0


def formulate(
    problem: TrajectoryProblem,
    motion: ResolvedMotion,
    scales: Scales,
    margins: Mapping[str, float] | None = None,
) -> OptimalControlProblem:
    """The optimal-control problem of a trajectory problem.

    Parameters
    ----------
    problem : TrajectoryProblem
    motion : ResolvedMotion
        Its poses as joint angles.
    scales : Scales
    margins : mapping limit name -> float, optional
        Share by which a limit is tightened, where a certificate found it exceeded between nodes.
    """
    margins = margins or {}
    coordinates = coordinates_of(problem)
    x, u = ca.SX.sym("x", 2 * coordinates.size), ca.SX.sym("u", coordinates.size)
    p = ca.SX.sym("smoothing")
    position, velocity, acceleration = coordinates.joint_motion(x, u)
    model = StageModel(
        problem.robot,
        position,
        velocity,
        acceleration,
        problem.process_force,
        smoothing=p,
        sides=torque_sides(problem, motion),
    )
    terms = objective_terms(problem, model, scales)
    rows = limit_rows(problem, model, coordinates, margins)
    blocks = [*rows, *terms.path_rows]
    path = ca.vertcat(*(expression for _, expression in blocks)) if blocks else ca.SX(0, 1)
    integrands = ca.vertcat(*terms.integrands) if terms.integrands else ca.SX(0, 1)
    stage = ca.Function("stage", [x, u, terms.statics, p], [integrands, path])
    dynamics = ca.Function("dynamics", [x, u, p], [ca.vertcat(x[coordinates.size :], u)])
    return OptimalControlProblem(
        name=problem.title or "trajectory",
        states=coordinates.state_names,
        controls=coordinates.control_names,
        dynamics=dynamics,
        stage=stage,
        objective=_objective(terms, 2 * coordinates.size, p),
        duration=problem.duration,
        statics=terms.names,
        path_rows=tuple(block for block, _ in blocks),
        integral_function=_integral_function(terms, p),
        integral_rows=terms.integral_rows,
        start=None if motion.start_fixed else boundary_waypoint(problem, problem.start, "start"),
        end=None if motion.end_fixed else boundary_waypoint(problem, problem.end, "end"),
        vias=tuple(via_waypoint(problem, via, k) for k, via in enumerate(problem.vias, start=1)),
        static_lower=terms.lower,
        static_upper=terms.upper,
        static_scale=terms.scale,
        second_order=tuple((i, coordinates.size + i, i) for i in range(coordinates.size)),
        parameters=np.ones(1),
        **_bounds(problem, motion, coordinates, margins),
    )


def _bounds(
    problem: TrajectoryProblem,
    motion: ResolvedMotion,
    coordinates: Coordinates,
    margins: Mapping[str, float],
) -> dict[str, Any]:
    """Bounds and scales of states and controls."""
    lower, upper = coordinates.state_bounds(margins)
    control = coordinates.control_bound(margins)
    rate = coordinates.rate_bound(margins)
    start, end = coordinates.boundary_states(motion)
    free = (slice(0, coordinates.size),)
    bounds: dict[str, Any] = {
        "state_lower": lower,
        "state_upper": upper,
        "control_lower": -control,
        "control_upper": control,
        "control_rate_lower": None if np.all(np.isinf(rate)) else -rate,
        "control_rate_upper": None if np.all(np.isinf(rate)) else rate,
        "state_scale": coordinates.state_scale,
        "control_scale": coordinates.control_scale,
    }
    for side, value, fixed in (
        ("initial", start, motion.start_fixed),
        ("final", end, motion.end_fixed),
    ):
        low, high = value.copy(), value.copy()
        if not fixed:
            low[free], high[free] = lower[free], upper[free]
        bounds[f"{side}_lower"], bounds[f"{side}_upper"] = low, high
        rest = np.zeros(coordinates.size) if problem.boundary_acceleration == "zero" else None
        bounds[f"{side}_control_lower"] = bounds[f"{side}_control_upper"] = rest
    return bounds


def _objective(terms: Terms, states: int, p: ca.SX) -> ca.Function:
    integral = ca.SX.sym("integral", len(terms.integrands))
    duration = ca.SX.sym("duration")
    x0, xf = ca.SX.sym("x0", states), ca.SX.sym("xf", states)
    value = terms.value(integral, duration)
    return ca.Function("objective", [integral, duration, terms.statics, x0, xf, p], [value])


def _integral_function(terms: Terms, p: ca.SX) -> ca.Function | None:
    if not terms.integral_rows:
        return None
    integral = ca.SX.sym("integral", len(terms.integrands))
    duration = ca.SX.sym("duration")
    rows = terms.integral_expressions(integral, duration)
    return ca.Function("integral_rows", [integral, duration, terms.statics, p], [rows])
