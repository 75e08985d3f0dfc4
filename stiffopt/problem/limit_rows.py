"""Limits that are not plain bounds, as path rows of the optimal-control problem."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import casadi as ca
import numpy as np

from stiffopt.problem.coordinates import Coordinates
from stiffopt.problem.stage_model import StageModel
from stiffopt.problem.trajectory import Limits, TrajectoryProblem
from stiffopt.symbolic import Quantity
from stiffopt.transcription.ocp import Rows

Block = tuple[Rows, Quantity]

# Share of the torque at which the exact stiffness jumps.
_BESIDE_JUMP = 2e-3
# Factor on the smoothing widths at which a reducer's step is as good as a jump.
_SHARP = 1e-6


def limit_rows(
    problem: TrajectoryProblem,
    model: StageModel,
    coordinates: Coordinates,
    margins: Mapping[str, float],
) -> list[Block]:
    """Blocks of rows with their expressions; each row is relative to its limit.

    A margin m tightens the limit of that name by the share m.
    """
    limits = problem.active_limits
    blocks: list[Block] = []
    blocks += _torques(problem, model, margins)
    if not coordinates.bounds_joints:
        for name in ("velocity", "acceleration"):
            values, bound = getattr(model, name), getattr(limits, name)
            blocks += _magnitudes(name, values, bound, margins, midpoints=True)
    if limits.velocity_map is not None:
        blocks.append(_velocity_map(model, limits, margins.get("velocity_by_position", 0.0)))
    if np.isfinite(limits.tool_speed):
        blocks.append(_length("tool_speed", model.tool_velocity, limits.tool_speed, margins))
    for name in ("dynamic_deflection", "total_deflection"):
        cap = getattr(limits, name)
        if np.isfinite(cap):
            vector = getattr(model.deflection, name.removesuffix("_deflection"))
            blocks.append(_length(name, vector, cap, margins))
    if limits.joint_stiffness:
        blocks.append(_stiffness_floor(problem, model, margins.get("joint_stiffness", 0.0)))
    return blocks


def _torques(
    problem: TrajectoryProblem, model: StageModel, margins: Mapping[str, float]
) -> list[Block]:
    """|drive torque| <= limit; with dry friction, each side by its own envelope."""
    bound = problem.active_limits.torque
    if not np.any(problem.robot.coulomb):
        return _magnitudes("torque", model.drive_torque, bound, margins, midpoints=True)
    blocks = []
    for side in (1.0, -1.0):
        torque = side * model.torque_envelope(side)
        for rows, ratio in _magnitudes("torque", torque, bound, margins, midpoints=True):
            one_sided = replace(rows, lower=np.full(len(rows), -np.inf))
            blocks.append((one_sided, ratio))
    return blocks


def _magnitudes(
    name: str,
    values: Quantity,
    bound: np.ndarray,
    margins: Mapping[str, float],
    midpoints: bool = False,
) -> list[Block]:
    """|value| <= bound for every joint with a finite bound."""
    joints = np.flatnonzero(np.isfinite(bound))
    if joints.size == 0:
        return []
    allowed = 1.0 - margins.get(name, 0.0)
    labels = [f"joint {j + 1}" for j in joints]
    rows = Rows.make(name, labels, -allowed, allowed, midpoints=midpoints)
    return [(rows, ca.vertcat(*(values[int(j)] / bound[j] for j in joints)))]


def _length(name: str, vector: Quantity, bound: float, margins: Mapping[str, float]) -> Block:
    """|vector| <= bound, squared so that it is smooth at zero."""
    relative = vector / bound
    allowed = (1.0 - margins.get(name, 0.0)) ** 2
    rows = Rows.make(name, ["tool"], -np.inf, allowed, midpoints=True)
    return rows, ca.dot(relative, relative)


def _velocity_map(model: StageModel, limits: Limits, margin: float) -> Block:
    """|velocity| below a piecewise-linear function of the joint's own position."""
    assert limits.velocity_map is not None
    positions, speeds = limits.velocity_map
    expressions, labels = [], []
    for j in range(positions.shape[1]):
        allowed = _piecewise_linear(model.position[j], positions[:, j], speeds[:, j])
        scale = float(np.max(speeds[:, j]))
        for sign, side in ((1.0, "forward"), (-1.0, "backward")):
            slack = sign * model.velocity[j] - (1.0 - margin) * allowed
            expressions.append(slack / scale)
            labels.append(f"joint {j + 1} {side}")
    rows = Rows.make("velocity_by_position", labels, -np.inf, 0.0, midpoints=True)
    return rows, ca.vertcat(*expressions)


def _piecewise_linear(x: Quantity, knots: np.ndarray, values: np.ndarray) -> Quantity:
    """Linear interpolation, constant outside the knots, as a sum of hinges."""
    slopes = np.concatenate(([0.0], np.diff(values) / np.diff(knots), [0.0]))
    result: Quantity = float(values[0])
    for knot, change in zip(knots, np.diff(slopes), strict=True):
        if change != 0.0:
            result = result + float(change) * ca.fmax(x - float(knot), 0.0)
    return result


def _stiffness_floor(problem: TrajectoryProblem, model: StageModel, margin: float) -> Block:
    """Tangent stiffness above a floor, as torque where a torque separates stiff from soft.

    The stiffness of a reducer jumps at two torques. A bound on the torque is smooth where one on
    the smoothed stiffness is flat, then steep, and still meets the jump only nearly.
    """
    labels, expressions = [], []
    for j, floor in sorted(problem.active_limits.joint_stiffness.items()):
        labels.append(f"joint {j}")
        needed = _torque_of_stiffness(model, j, floor)
        if needed and model.sides[j - 1]:
            # A little beyond the jump, so that rounding does not fall off it.
            share = model.sides[j - 1] * model.torques.spring[j - 1] / needed
            expressions.append(1.0 + _BESIDE_JUMP + margin - share)
        else:
            # In compliance, which is bounded where stiffness is steep.
            expressions.append(floor * model.compliance(j) - (1.0 - margin))
    rows = Rows.make("joint_stiffness", labels, -np.inf, 0.0, midpoints=True)
    return rows, ca.vertcat(*expressions)


def _torque_of_stiffness(model: StageModel, joint: int, floor: float) -> float | None:
    """Torque [N m] from which on a joint is at least as stiff as `floor` [N m/rad].

    None where no such torque separates the stiff from the soft: the stiffness falls again within
    one and a half times the joint's largest torque, or the joint is rigid.
    """
    chain = model.robot.chains[joint - 1]
    if chain is None:
        return None

    def stiff(torque: Quantity) -> Quantity:
        return chain.tangent_stiffness(torque, smoothing=_SHARP) >= floor

    largest = 1.5 * float(model.robot.torque_max[joint - 1])
    torques = np.array([0.0, *np.geomspace(1e-4 * largest, largest, 1000)])
    enough = stiff(torques)
    first = int(np.argmax(enough))
    if not np.all(enough[first:]):
        return None
    if first == 0:
        return 0.0
    low, high = torques[first - 1], torques[first]
    while high - low > 1e-9 * largest:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if stiff(middle) else (middle, high)
    return float(high)
