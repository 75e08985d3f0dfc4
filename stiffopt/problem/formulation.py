"""Optimal-control problem of a trajectory problem.

States are joint positions and velocities, controls are accelerations (or path position, speed and
acceleration on a fixed path); torque enters by inverse dynamics. The parameters are factors on the
widths over which laws are smooth (`problem.stage_terms`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from stiffopt.dynamics.kinematics import frame_pose
from stiffopt.problem.arrival_modes import ArrivalModes
from stiffopt.problem.coordinates import Coordinates, coordinates_of
from stiffopt.problem.motor_model import LAW_SMOOTHING_FACTOR, ApproximateMotorModel, MotorModel
from stiffopt.problem.objective import Scales, TermInputs
from stiffopt.problem.rest_poses import torque_sides
from stiffopt.problem.stage_model import StageModel
from stiffopt.problem.stage_terms import (
    WINDUP_SMOOTHING,
    IntegralRow,
    ObjectiveTerms,
    PathRows,
    Smoothing,
    StaticVariable,
)
from stiffopt.problem.trajectory import ResolvedMotion, Target, TrajectoryProblem
from stiffopt.robot.frames import rotation_from_rpy
from stiffopt.symbolic import Quantity
from stiffopt.transcription.ocp import OptimalControlProblem, Rows, Waypoint

if TYPE_CHECKING:
    from stiffopt.elastic.modes import Mode


def formulate(
    problem: TrajectoryProblem,
    motion: ResolvedMotion,
    scales: Scales,
    margins: Mapping[str, float] | None = None,
    modes: Sequence[Mode] = (),
) -> OptimalControlProblem:
    """Formulate the optimal-control problem of a trajectory problem.

    `motion`: resolved poses of the problem. `margins`: constraint back-off as a share of each limit
    that a certificate found exceeded between nodes. `modes`: elastic modes of the end pose where
    residual vibration is allowed; empty: links end at rest.
    """
    margins = margins or {}
    coordinates = coordinates_of(problem)
    size, order = coordinates.size, coordinates.order
    x, u = ca.SX.sym("x", order * size), ca.SX.sym("u", size)
    p = ca.SX.sym("smoothing", len(fields(Smoothing)))
    sides = torque_sides(problem, motion)
    smoothing = Smoothing(*ca.vertsplit(p))
    ends = (motion.start, motion.end)
    model = stage_model(problem, coordinates, x, u, smoothing, sides, ends)
    goal = _WeightedSum(problem, model, scales)
    blocks = [*_limit_rows(problem, model, coordinates, margins), *goal.path_rows]
    path = _stack_entries([row for block in blocks for row in block.expressions])
    stage = ca.Function("stage", [x, u, goal.statics, p], [_stack_entries(goal.integrands), path])
    through = ca.Function("torques", [x, u, goal.statics, p], [model.computed_torques])
    return OptimalControlProblem(
        name=problem.title or "trajectory",
        states=coordinates.state_names,
        controls=coordinates.control_names,
        stage=stage,
        intermediate=through,
        objective=goal.function(order * size, p, smoothing.robust),
        duration=problem.duration,
        statics=tuple(variable.name for variable in goal.variables),
        path_rows=tuple(
            Rows.make(block.name, block.labels, block.lower, block.upper) for block in blocks
        ),
        integral_function=goal.integral_function(p),
        integral_rows=tuple(
            Rows.make(row.name, [row.label], -np.inf, 0.0) for _, row in goal.integral_rows
        ),
        start=None
        if motion.start_fixed
        else _boundary_waypoint(problem, problem.start, "start", p),
        end=_end_waypoint(problem, motion, modes, p),
        vias=tuple(
            _via_waypoint(problem, via, k, p) for k, via in enumerate(problem.vias, start=1)
        ),
        static_lower=np.array(goal.static_lower),
        static_upper=np.full(len(goal.variables), np.inf),
        static_scale=np.array(goal.static_scales),
        chains=tuple((*(k * size + i for k in range(order)), i) for i in range(size)),
        parameters=Smoothing(1.0).parameters,
        **_state_and_control_bounds(
            problem, motion, coordinates, margins, vibrates_after=bool(modes)
        ),
    )


def exact_path_rows(
    problem: TrajectoryProblem, motion: ResolvedMotion, scales: Scales
) -> ca.Function:
    """Path rows (x, u, z, p) -> (m,) in the order of `formulate`, without approximation.

    `formulate` approximates them where the links are planned (`ApproximateMotorModel`).
    """
    coordinates = coordinates_of(problem)
    x, u = ca.SX.sym("x", coordinates.order * coordinates.size), ca.SX.sym("u", coordinates.size)
    p, sides = ca.SX.sym("smoothing", len(fields(Smoothing))), torque_sides(problem, motion)
    smoothing, ends = Smoothing(*ca.vertsplit(p)), (motion.start, motion.end)
    if problem.plans_links:
        derivatives = [*ca.vertsplit(x, coordinates.size), u]
        model: StageModel = _make_motor_model(
            MotorModel, problem, derivatives, smoothing, sides, ends
        )
    else:
        model = stage_model(problem, coordinates, x, u, smoothing, sides)
    goal = _WeightedSum(problem, model, scales)
    blocks = [*_limit_rows(problem, model, coordinates, {}), *goal.path_rows]
    rows = _stack_entries([row for block in blocks for row in block.expressions])
    return ca.Function("exact_path_rows", [x, u, goal.statics, p], [rows])


def stage_model(
    problem: TrajectoryProblem,
    coordinates: Coordinates,
    x: Quantity,
    u: Quantity,
    smoothing: Smoothing,
    sides: np.ndarray,
    rest_poses: Sequence[np.ndarray] = (),
) -> StageModel:
    """Stage model of a problem at a state and control of its coordinates."""
    if problem.plans_links:
        derivatives = [*ca.vertsplit(x, coordinates.size), u]
        return _make_motor_model(
            ApproximateMotorModel, problem, derivatives, smoothing, sides, rest_poses
        )
    return StageModel(
        problem.robot,
        *coordinates.joint_motion(x, u),
        problem.process_force,
        smoothing=smoothing.stiffness,
        sides=sides,
        friction=(smoothing.kinks, smoothing.creeping, smoothing.convexity),
    )


def _make_motor_model(
    kind: type[MotorModel],
    problem: TrajectoryProblem,
    derivatives: list[Quantity],
    smoothing: Smoothing,
    sides: np.ndarray,
    rest_poses: Sequence[np.ndarray] = (),
) -> MotorModel:
    return kind(
        problem.robot,
        derivatives,
        smoothing.stiffness,
        sides,
        problem.process_force,
        LAW_SMOOTHING_FACTOR * smoothing.lead,
        smoothing.robust if problem.chosen_for_robustness else 0.0,
        rest_poses,
    )


def static_variables(
    problem: TrajectoryProblem, motion: ResolvedMotion
) -> tuple[StaticVariable, ...]:
    """Static variables of all objectives, in the order of the optimal-control problem."""
    sides = torque_sides(problem, motion)
    return tuple(
        variable
        for objective in problem.objectives
        for variable in objective.kind.static_variables(objective, problem, sides)
    )


def smoothing_stages(problem: TrajectoryProblem) -> tuple[float, ...]:
    """Factors on the smoothing widths, wide to narrow: the longest list of all active kinds."""
    asked = [objective.kind.smoothing for objective in problem.objectives]
    asked += [kind.smoothing for kind in problem.active_limits.kinds]
    asked += [WINDUP_SMOOTHING] if problem.plans_links else []
    return max(asked, key=len)


def law_smoothing(problem: TrajectoryProblem) -> float:
    """Factor on the smoothing widths of the feedforward-lead law of a problem."""
    return WINDUP_SMOOTHING[-1] * (LAW_SMOOTHING_FACTOR if problem.plans_links else 1.0)


def _limit_rows(
    problem: TrajectoryProblem,
    model: StageModel,
    coordinates: Coordinates,
    margins: Mapping[str, float],
) -> list[PathRows]:
    """Rows of all limits other than bounds of states and controls, joint limits first."""
    blocks = [
        rows
        for kind in problem.active_limits.kinds
        if kind.order is None or not coordinates.bounds_joints
        for rows in kind.rows(problem, model, margins.get(kind.name, 0.0))
    ]
    # Row order decides the linear solver's pivots, and so which of two close optima is found.
    return sorted(blocks, key=lambda rows: rows.labels[0] == "tool")


def _stack_entries(entries: Sequence[Quantity]) -> Quantity:
    return ca.vertcat(ca.SX(0, 1), *entries)


class _WeightedSum:
    """Weighted objectives of a problem, scaled so that the first is about one."""

    def __init__(self, problem: TrajectoryProblem, model: StageModel, scales: Scales) -> None:
        self.variables: list[StaticVariable] = []
        self.static_scales: list[float] = []
        self.static_lower: list[float] = []
        self.integrands: list[Quantity] = []
        self.path_rows: list[PathRows] = []
        # Each with the index of the first integral of its objective.
        self.integral_rows: list[tuple[int, IntegralRow]] = []
        self._values: list[tuple[float, int, ObjectiveTerms]] = []
        symbols: list[Quantity] = []
        first = problem.objectives[0]
        unit = 1.0 / (first.weight * scales.of(first.name))
        for objective in problem.objectives:
            scale = scales.of(objective.name)
            variables = objective.kind.static_variables(objective, problem, model.sides)
            statics = tuple(ca.SX.sym(variable.name) for variable in variables)
            terms = objective.kind.terms(TermInputs(objective, problem, model, statics, scales))
            start = len(self.integrands)
            sign = -1.0 if objective.maximised else 1.0
            self._values.append((sign * objective.weight * unit, start, terms))
            self.variables += variables
            self.static_scales += [scale if v.scale is None else v.scale for v in variables]
            self.static_lower += [objective.kind.target_value(scale)] * len(variables)
            self.integrands += terms.integrands
            self.path_rows += terms.path_rows
            self.integral_rows += [(start, row) for row in terms.integral_rows]
            symbols += statics
        self.statics = _stack_entries(symbols)

    def function(self, states: int, p: ca.SX, robust: Quantity) -> ca.Function:
        """Weighted sum of integrals, duration, statics, first and last state.

        `robust` blends from the objectives' values (0) to their robust values (1).
        """
        integral, duration = ca.SX.sym("integral", len(self.integrands)), ca.SX.sym("duration")
        x0, xf = ca.SX.sym("x0", states), ca.SX.sym("xf", states)
        value: Quantity = 0.0
        for weight, start, terms in self._values:
            own = terms.value(integral[start:], duration)
            if terms.robust_value is not None:
                own += robust * (terms.robust_value(integral[start:], duration) - own)
            value = value + weight * own
        return ca.Function("objective", [integral, duration, self.statics, x0, xf, p], [value])

    def integral_function(self, p: ca.SX) -> ca.Function | None:
        """Stacked integral rows; None without any."""
        if not self.integral_rows:
            return None
        integral, duration = ca.SX.sym("integral", len(self.integrands)), ca.SX.sym("duration")
        rows = [row.expression(integral[start:], duration) for start, row in self.integral_rows]
        return ca.Function(
            "integral_rows", [integral, duration, self.statics, p], [_stack_entries(rows)]
        )


def _state_and_control_bounds(
    problem: TrajectoryProblem,
    motion: ResolvedMotion,
    coordinates: Coordinates,
    margins: Mapping[str, float],
    vibrates_after: bool,
) -> dict[str, Any]:
    """Bounds and scales of states and controls."""
    lower, upper = coordinates.state_bounds(margins)
    control = coordinates.control_bounds(margins)
    rate = coordinates.rate_bounds(margins)
    limited = bool(np.any(np.isfinite(rate)))
    start, end = coordinates.boundary_states(motion)
    # Bounds that are backed off still hold a given boundary state that is within the limits.
    lowest, highest = coordinates.state_bounds({})
    for value, fixed in ((start, motion.start_fixed), (end, motion.end_fixed)):
        if fixed:
            lower = np.minimum(lower, np.maximum(value, lowest))
            upper = np.maximum(upper, np.minimum(value, highest))
    free = (slice(0, coordinates.size),)
    bounds: dict[str, Any] = {
        "state_lower": lower,
        "state_upper": upper,
        "control_lower": control[0],
        "control_upper": control[1],
        "control_rate_lower": rate[0] if limited else None,
        "control_rate_upper": rate[1] if limited else None,
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
        if problem.plans_links and problem.boundary_acceleration == "free":
            # With links at rest, the motors' acceleration is a function of the links' snap.
            snap = slice(4 * coordinates.size, None)
            low[snap], high[snap] = lower[snap], upper[snap]
        if side == "final" and vibrates_after:
            low, high = lower.copy(), upper.copy()
        bounds[f"{side}_lower"], bounds[f"{side}_upper"] = low, high
        held = coordinates.order == 2 and problem.boundary_acceleration == "zero"
        rest = np.zeros(coordinates.size) if held else None
        bounds[f"{side}_control_lower"] = bounds[f"{side}_control_upper"] = rest
    return bounds


def _end_waypoint(
    problem: TrajectoryProblem, motion: ResolvedMotion, modes: Sequence[Mode], p: ca.SX
) -> Waypoint | None:
    """Rows on the last state: tool position, motors at rest, residual vibration."""
    place = None if motion.end_fixed else _boundary_waypoint(problem, problem.end, "end", p)
    if not modes:
        return place
    x = ca.SX.sym("x", coordinates_of(problem).order * problem.joints)
    model = _motor_model_at(problem, x, Smoothing(*ca.vertsplit(p)))
    limits, joints = problem.active_limits, [f"joint {j + 1}" for j in range(problem.joints)]
    rows, expressions = [], []
    speed, acceleration = (
        np.where(np.isfinite(each), each, 1.0) for each in (limits.velocity, limits.acceleration)
    )
    parts = [("end velocity", model.velocity / speed)]
    if problem.boundary_acceleration == "zero":
        parts.append(("end acceleration", model.acceleration / acceleration))
    if motion.end_fixed:
        parts.insert(0, ("end", model.position - motion.end))
    for name, value in parts:
        rows.append(Rows.make(name, joints, 0.0, 0.0))
        expressions.append(value)
    arrival = ArrivalModes.of(modes, model)
    for kind in limits.kinds:
        for block in kind.arrival_rows(limits, arrival) if kind.of_arrival else ():
            rows.append(Rows.make(block.name, block.labels, block.lower, block.upper))
            expressions += block.expressions
    if place is not None:
        rows += place.rows
        expressions.append(place.function(x, p))
    function = ca.Function("end", [x, p], [ca.vertcat(*expressions)])
    return Waypoint(function=function, rows=tuple(rows))


def _boundary_waypoint(problem: TrajectoryProblem, target: Target, side: str, p: ca.SX) -> Waypoint:
    """Tool position at the start or end of a motion whose end pose is otherwise free."""
    x, _, position, _ = _tool_pose(problem, p)
    rows = Rows.make(f"{side} position", ["x", "y", "z"], 0.0, 0.0, unit="m")
    return Waypoint(function=ca.Function(side, [x, p], [position - target.position]), rows=(rows,))


def _via_waypoint(problem: TrajectoryProblem, target: Target, number: int, p: ca.SX) -> Waypoint:
    """Rows of a via point: joints, tool position or tool pose within their tolerances."""
    x, joints, position, rotation = _tool_pose(problem, p)
    name = f"via {number}"
    if target.joints is not None:
        labels = [f"joint {j + 1}" for j in range(problem.joints)]
        miss = (joints - target.joints) / target.tolerance
        rows = Rows.make(name, labels, -1.0, 1.0)
        return Waypoint(function=ca.Function("via", [x, p], [miss]), rows=(rows,))
    offset = (position - target.position) / target.tolerance
    blocks = [Rows.make(name, ["tool position"], -np.inf, 1.0)]
    expressions = [ca.dot(offset, offset)]
    if target.rpy is not None:
        wanted = rotation_from_rpy(target.rpy)
        # sin(angle) times the axis is smooth at zero, where the trace has zero gradient.
        difference = ca.mtimes(ca.DM(wanted.T), rotation)
        sine = ca.vertcat(
            difference[2, 1] - difference[1, 2],
            difference[0, 2] - difference[2, 0],
            difference[1, 0] - difference[0, 1],
        ) / (2.0 * np.sin(target.angle_tolerance))
        blocks.append(Rows.make(name, ["tool orientation"], -np.inf, 1.0))
        expressions.append(ca.dot(sine, sine))
        # The sine vanishes at a half turn as well: exclude it.
        blocks.append(Rows.make(name, ["tool half turn"], 0.0, np.inf))
        expressions.append(ca.trace(difference) - 1.0)
    function = ca.Function("via", [x, p], [ca.vertcat(*expressions)])
    return Waypoint(function=function, rows=tuple(blocks))


def _tool_pose(problem: TrajectoryProblem, p: ca.SX) -> tuple[ca.SX, Quantity, Quantity, Quantity]:
    """State symbol with the planned joints, tool position and tool rotation."""
    n = problem.joints
    x = ca.SX.sym("x", coordinates_of(problem).order * n)
    joints = x[:n]
    if problem.plans_links:
        last = Smoothing(smoothing_stages(problem)[-1], Smoothing(*ca.vertsplit(p)).lead)
        joints = _motor_model_at(problem, x, last).position
    position, rotation = frame_pose(problem.robot.tree, problem.robot.tool, joints)
    return x, joints, position, rotation


def _motor_model_at(problem: TrajectoryProblem, x: Quantity, smoothing: Smoothing) -> MotorModel:
    """Motor model at a state of the links."""
    n = problem.joints
    return _make_motor_model(MotorModel, problem, ca.vertsplit(x, n), smoothing, np.zeros(n))
