"""Tables of a solve's report: each a head and rows of ready text."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from stiffopt.report.common.motions import (
    OPTIMISED,
    PARTS,
    JointUnits,
    compared_motions,
    joint_units,
)
from stiffopt.report.common.quantities import engineering, length_scale, significant
from stiffopt.report.solve.wording import limit_text, objective_phrase, violation_text
from stiffopt.result.assessment import Assessment
from stiffopt.result.solution import Solution

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import Target, TrajectoryProblem

DASH = "–"


@dataclass(frozen=True)
class Table:
    """Head and rows; `bad` holds the numbers of rows (from 0) to be marked."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    bad: frozenset[int] = frozenset()


def certificate_table(assessment: Assessment, tolerance: float) -> Table:
    """Every limit with its worst joint and time, worst first.

    Parameters
    ----------
    assessment : Assessment
    tolerance : float
        Relative excess that is still accepted.
    """
    rows, bad = [], set()
    for number, each in enumerate(assessment.violations):
        joint = f"J{each.joint}" if each.joint else DASH
        limit = each.limit.replace("_", " ")
        rows.append((limit, joint, f"{each.time:.3f}", violation_text(each)))
        if each.value > tolerance:
            bad.add(number)
    head = ("limit", "joint", "time [s]", "worst on the fine grid")
    return Table(head, tuple(rows), frozenset(bad))


def deflection_table(solution: Solution) -> Table:
    """Peak and rms of every part of the deflection, for all motions."""
    motions = compared_motions(solution)
    summaries = [motion.assessment.deflection_summary() for motion in motions]
    parts = [p for p in PARTS if any(summary[p].peak > 0 for summary in summaries)]
    largest = max((summary[p].peak for summary in summaries for p in parts), default=0.0)
    factor, unit = length_scale(largest)
    head = ["motion"]
    for part in parts:
        head += [f"{part} peak [{unit}]", f"{part} rms [{unit}]"]
    rows, bad = [], set()
    for number, (motion, summary) in enumerate(zip(motions, summaries, strict=True)):
        row = [motion.label]
        for part in parts:
            row += [
                significant(summary[part].peak * factor),
                significant(summary[part].rms * factor),
            ]
        rows.append(tuple(row))
        if not motion.feasible:
            bad.add(number)
    return Table(tuple(head), tuple(rows), frozenset(bad))


def baseline_table(solution: Solution, tolerance: float) -> Table:
    """Optimised motion and baselines: duration, objective, limits exceeded, verdict."""
    rows, bad = [], set()
    unit = "" if solution.objective is None else solution.objective.unit
    if solution.assessment is not None and solution.objective is not None:
        value = engineering(solution.objective.value, unit)
        verdict = str(solution.status).replace("_", " ")
        rows.append(_motion_row(OPTIMISED, solution.assessment, value, tolerance, verdict))
    for name, baseline in solution.baselines.items():
        if baseline.assessment is None:
            rows.append((name, DASH, DASH, "absent", baseline.reason))
            continue
        if not baseline.feasible:
            bad.add(len(rows))
        value = engineering(baseline.objective, unit)
        verdict = "feasible" if baseline.feasible else "not counted"
        rows.append(_motion_row(name, baseline.assessment, value, tolerance, verdict))
    head = ("motion", "duration", "objective", "verdict", "limits exceeded, else the tightest")
    return Table(head, tuple(rows), frozenset(bad))


def _motion_row(
    name: str, assessment: Assessment, value: str, tolerance: float, verdict: str
) -> tuple[str, ...]:
    exceeded = [each for each in assessment.violations if each.value > tolerance]
    shown = exceeded or [assessment.worst_violation]
    limits = "; ".join(f"{limit_text(each)}: {violation_text(each)}" for each in shown)
    return name, f"{assessment.duration:.4g} s", value, verdict, limits


def solver_table(solution: Solution) -> Table:
    """List what the solver did, as name and value."""
    record = solution.solver
    rows = [
        ("transcription", record.transcription.replace("_", " ")),
        ("intervals", str(record.intervals)),
        ("iterations, all stages", str(record.iterations)),
        ("building the problem", f"{record.build_s:.2f} s"),
        ("solving", f"{record.solve_s:.2f} s"),
    ]
    return Table(("", ""), tuple(rows))


def homotopy_table(stages: Sequence[dict[str, Any]]) -> Table | None:
    """Stages of the homotopy with whatever was recorded of each; None where there were none."""
    if not stages:
        return None
    names = list(dict.fromkeys(name for stage in stages for name in stage))
    rows = tuple(
        (str(number), *(_cell(stage.get(name)) for name in names))
        for number, stage in enumerate(stages, start=1)
    )
    return Table(("stage", *(name.replace("_", " ") for name in names)), rows)


def _cell(value: Any) -> str:
    if value is None:
        return DASH
    if isinstance(value, float | np.floating):
        return significant(float(value))
    return str(value).replace("_", " ")


def limits_table(problem: TrajectoryProblem) -> Table:
    """Limits of every joint in the units of the figures."""
    limits = problem.active_limits
    rows = []
    for j, unit in enumerate(joint_units(problem)):
        factor, name = unit.position
        low, high = limits.position_lower[j] * factor, limits.position_upper[j] * factor
        rows.append(
            (
                unit.label,
                str(problem.robot.joint_names[j]),
                _bound(high, name) if np.isinf(high) else f"{_bound(low)} to {_bound(high, name)}",
                _bound(limits.velocity[j] * factor, f"{name}/s"),
                _bound(limits.acceleration[j], f"{unit.rate}/s²"),
                _bound(limits.jerk[j], f"{unit.rate}/s³"),
                _bound(limits.torque[j], unit.torque),
            )
        )
    head = ("", "joint", "position", "velocity", "acceleration", "jerk", "drive torque")
    return Table(head, tuple(rows))


def _bound(value: float, unit: str = "") -> str:
    return f"{significant(float(value))} {unit}".strip() if np.isfinite(value) else "none"


def inputs_table(problem: TrajectoryProblem) -> Table:
    """List the problem as stated, as name and value."""
    units, limits = joint_units(problem), problem.active_limits
    lower, upper = problem.duration
    rows = [
        ("robot", f"{problem.robot.name}, {len(units)} joints"),
        ("start", _target(problem.start, units)),
        *((f"via {i}", _target(via, units)) for i, via in enumerate(problem.vias, start=1)),
        ("end", _target(problem.end, units)),
        ("duration", f"{lower:g} s" if lower == upper else f"free, {lower:g} to {upper:g} s"),
        ("acceleration at the ends", problem.boundary_acceleration),
    ]
    if problem.path is not None:
        rows.append(("path", f"fixed, through {len(problem.path)} points; only the timing is free"))
    if np.any(problem.process_force):
        rows.append(("process force on the tool", _vector(problem.process_force, "N")))
    for objective in problem.objectives:
        verb = "maximise" if objective.maximised else "minimise"
        text = objective_phrase(objective.name, objective.measure)
        if objective.joints:
            text += ", joints " + ", ".join(map(str, objective.joints))
        if len(problem.objectives) > 1:
            text += f", weight {objective.weight:g}"
        rows.append((verb, text))
    for name, value, unit in (
        ("tool speed at most", limits.tool_speed, "m/s"),
        ("dynamic deflection at most", limits.dynamic_deflection, "m"),
        ("total deflection at most", limits.total_deflection, "m"),
    ):
        if np.isfinite(value):
            rows.append((name, engineering(value, unit)))
    for joint, floor in limits.joint_stiffness.items():
        unit = units[joint - 1].stiffness
        rows.append((f"stiffness of joint {joint} at least", engineering(floor, unit)))
    return Table(("", ""), tuple(rows))


def _target(target: Target, units: Sequence[JointUnits]) -> str:
    if target.joints is not None:
        parts = [
            f"{significant(float(q) * unit.position[0])} {unit.position[1]}"
            for q, unit in zip(target.joints, units, strict=True)
        ]
        return "joints " + ", ".join(parts)
    text = f"tool at {_vector(1e3 * np.asarray(target.position), 'mm')}"
    if target.rpy is not None:
        text += f", roll pitch yaw {_vector(np.rad2deg(target.rpy), 'deg')}"
    return text


def _vector(values: np.ndarray, unit: str) -> str:
    return f"({', '.join(significant(float(v)) for v in values)}) {unit}"


def estimated_table(robot: Any, joints: Container[str] | None = None) -> Table | None:
    """List the inputs of a robot that are estimated; None where there are none.

    Parameters
    ----------
    robot : Robot
    joints : container of str, optional
        Names of the joints whose inputs count, with those of no joint; default: all.
    """
    keys: dict[tuple[str, str, str], list[str]] = {}
    for each in robot.estimated():
        if joints is not None and each.joint and each.joint not in joints:
            continue
        keys.setdefault((each.joint, each.element, each.source), []).append(each.key)
    rows = tuple(
        (joint or DASH, element or DASH, ", ".join(names), source or DASH)
        for (joint, element, source), names in keys.items()
    )
    return Table(("joint", "element", "inputs", "where from"), rows) if rows else None
