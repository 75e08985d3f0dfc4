"""Objectives as pieces of an optimal-control problem: integrands, epigraph rows, static variables.

A peak is minimised through an upper bound z on it (epigraph); a root mean square through a bound
on the integral, so that the Hessian stays sparse; the minimum stiffness through a lower bound.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from stiffopt.problem.objectives import DEFLECTIONS, Objective
from stiffopt.problem.stage_model import StageModel
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.symbolic import Quantity
from stiffopt.transcription.ocp import Rows

if TYPE_CHECKING:
    from stiffopt.problem.formulation import Scales

# Relative loss of stiffness that outweighs a torque of torque_max on the other side.
_RELIEF_PRICE = 10.0

# (integrals, duration) -> scalar
Piece = Callable[[Quantity, Quantity], Quantity]


@dataclass
class Terms:
    """The objective in pieces, collected over all weighted terms."""

    statics: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    names: tuple[str, ...] = ()
    lower: np.ndarray = field(default_factory=lambda: np.zeros(0))
    upper: np.ndarray = field(default_factory=lambda: np.zeros(0))
    scale: np.ndarray = field(default_factory=lambda: np.zeros(0))
    integrands: list[Quantity] = field(default_factory=list)
    path_rows: list[tuple[Rows, Quantity]] = field(default_factory=list)
    integral_rows: tuple[Rows, ...] = ()
    pieces: list[tuple[float, Piece]] = field(default_factory=list)
    integral_pieces: list[Piece] = field(default_factory=list)

    def static(self, name: str, scale: float) -> ca.SX:
        """A new non-negative static variable."""
        symbol = ca.SX.sym(name)
        self.statics = ca.vertcat(self.statics, symbol)
        self.names += (name,)
        self.lower = np.append(self.lower, 0.0)
        self.upper = np.append(self.upper, np.inf)
        self.scale = np.append(self.scale, scale)
        return symbol

    def integral(self, integrand: Quantity) -> int:
        """A new integrand; its index among the integrals."""
        self.integrands.append(integrand)
        return len(self.integrands) - 1

    def value(self, integral: Quantity, duration: Quantity) -> Quantity:
        """The weighted sum."""
        total: Quantity = 0.0
        for weight, piece in self.pieces:
            total = total + weight * piece(integral, duration)
        return total

    def integral_expressions(self, integral: Quantity, duration: Quantity) -> Quantity:
        """The integral rows, stacked."""
        return ca.vertcat(*(piece(integral, duration) for piece in self.integral_pieces))


def objective_terms(problem: TrajectoryProblem, model: StageModel, scales: Scales) -> Terms:
    """All terms of the problem's objective, scaled so that the first is about one."""
    terms = Terms()
    first = problem.objectives[0]
    unit = 1.0 / (first.weight * scales.of(first.name))
    for objective in problem.objectives:
        piece = _piece(terms, problem, model, objective, scales.of(objective.name))
        sign = -1.0 if objective.maximised else 1.0
        terms.pieces.append((sign * objective.weight * unit, piece))
    return terms


def _piece(
    terms: Terms,
    problem: TrajectoryProblem,
    model: StageModel,
    objective: Objective,
    scale: float,
) -> Piece:
    """One objective in its SI unit as a function of integrals and duration."""
    if objective.name in DEFLECTIONS:
        return _deflection(terms, model, objective, scale)
    if objective.name == "joint_stiffness":
        return _stiffness(terms, problem, model, objective, scale)
    if objective.name == "duration":
        return lambda integral, duration: duration
    joints = objective.joints or tuple(range(1, problem.joints + 1))
    if objective.name == "mean_compliance":
        index = terms.integral(sum(model.compliance(j) for j in joints))
        return lambda integral, duration: integral[index] / duration
    if objective.name == "torque_squared":
        ratio = [model.drive_torque[j - 1] / problem.robot.torque_max[j - 1] for j in joints]
        index = terms.integral(sum(r * r for r in ratio))
        return lambda integral, duration: integral[index]
    index = terms.integral(sum(model.acceleration[j - 1] ** 2 for j in joints))
    return lambda integral, duration: integral[index]


def _deflection(terms: Terms, model: StageModel, objective: Objective, scale: float) -> Piece:
    part = objective.name.removesuffix("_deflection")
    bound = terms.static(f"{objective.measure} {part} deflection", scale)
    relative = getattr(model.deflection, part) / scale
    square = ca.dot(relative, relative)
    if objective.measure == "peak":
        row = Rows.make(f"{part} deflection peak", ["tool"], -np.inf, 0.0, midpoints=True)
        terms.path_rows.append((row, square - (bound / scale) ** 2))
    else:
        index = terms.integral(square)
        row = Rows.make(f"{part} deflection rms", ["tool"], -np.inf, 0.0)
        terms.integral_rows += (row,)
        terms.integral_pieces.append(
            lambda integral, duration: integral[index] / duration - (bound / scale) ** 2
        )
    return lambda integral, duration: bound


def _stiffness(
    terms: Terms,
    problem: TrajectoryProblem,
    model: StageModel,
    objective: Objective,
    scale: float,
) -> Piece:
    joints = objective.joints or tuple(range(1, problem.joints + 1))
    bound = terms.static("minimum joint stiffness", scale)
    # In compliance, not stiffness: 1/k is smooth and bounded where k is steep.
    expressions = [bound * objective.weight_of(j) * model.compliance(j) - 1.0 for j in joints]
    labels = [f"joint {j}" for j in joints]
    row = Rows.make("minimum joint stiffness", labels, -np.inf, 0.0, midpoints=True)
    terms.path_rows.append((row, ca.vertcat(*expressions)))
    if not np.any(model.sides[np.array(joints) - 1]):
        return lambda integral, duration: bound
    relief = terms.static("torque on the other side", 1.0)
    terms.path_rows.append(model.one_sided(joints, relief))
    return lambda integral, duration: bound - _RELIEF_PRICE * scale * relief
