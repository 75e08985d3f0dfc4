"""Plan motions with the findings of a diagnosis: an extended robot, compared with the nominal one.

Every effect defines its change of a robot (`Effect.change_robot`); effects without influence on
planning (ripple, offsets, delays) are listed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.certificate.assess import assess
from stiffopt.certificate.objective_value import objective_value
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.discovery.comparison.inertial_parameters import body_parameter_names
from stiffopt.discovery.comparison.located_effect import EstimatedEffect, LocatedEffect
from stiffopt.discovery.extended.model import ExtendedModel, load_extended, require_same_robot
from stiffopt.discovery.laws.law import law_of
from stiffopt.discovery.laws.robot_change import law_change
from stiffopt.discovery.names import ValueName
from stiffopt.discovery.signals import JointConstants
from stiffopt.discovery.user_effects import load_effects
from stiffopt.drivetrain.chain import Chain
from stiffopt.elastic.uncertainty import bounds_from_deviations
from stiffopt.errors import InputFileError, format_increase
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.assessment import Assessment
from stiffopt.result.solution import Solution
from stiffopt.robot.robot import Robot
from stiffopt.solver.solve import solve

# Values with relative calibrations.
_SCALED_VALUES = ("coulomb", "viscous", "rotor_inertia")
# Parameters of effects that multiply a joint's stiffness.
_STIFFNESS_FACTORS = ("factor", "k1_factor")


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannerModel:
    """A robot with the findings of an extended model."""

    robot: Robot
    changes: tuple[str, ...]  # changes, a sentence each
    left_out: tuple[str, ...]  # findings without influence on planning, with their place
    # Findings that are no value of the robot: the same, and laws, which are torques beside it.
    not_in_robot: tuple[EstimatedEffect, ...]
    # (n,) relative standard deviation of each joint's stiffness; NaN if not stated.
    stiffness_deviation: np.ndarray
    # Standard deviation of the identified payload over the payload of the robot; NaN if not stated
    # or without payload.
    payload_deviation: float


def planner_model(robot: Robot, model: ExtendedModel) -> PlannerModel:
    """Return a robot with the findings of an extended model.

    `robot`: with its payload. `model`: from recordings of the same arm.

    Raises `InputFileError`: the model was made for another robot.

    Values of findings are added to the robot's; calibrations of friction and rotor inertia scale
    them, and changes of re-identified bodies are added. Calibrations of masses, centres and
    stiffness within the tolerances of the nominal model are ignored.
    """
    planner = _RobotUpdate(robot, model)
    planner.calibrate()
    for estimated in model.extension.effects:
        planner.add(estimated)
    return PlannerModel(
        robot=planner.robot,
        changes=tuple(planner.changes),
        left_out=tuple(planner.left_out),
        not_in_robot=tuple(planner.not_in_robot),
        stiffness_deviation=planner.stiffness_deviation(),
        payload_deviation=planner.payload_deviation(),
    )


class _RobotUpdate:
    """Robot to which findings are added one after another."""

    def __init__(self, robot: Robot, model: ExtendedModel) -> None:
        self.robot, self.model = robot, model
        self.own_chains = robot.chains
        self.place = _match_joints(robot, model)
        require_same_robot(model.robot, model.source, model.joints, robot, self.place)
        self.changes: list[str] = []
        self.left_out: list[str] = []
        self.not_in_robot: list[EstimatedEffect] = []

    def calibrate(self) -> None:
        """Scale calibrated values of the robot."""
        for name in _SCALED_VALUES:
            values = np.array(getattr(self.robot, name), dtype=float)
            moved = False
            for j, place in enumerate(self.place):
                relative = self.model.extension.calibration.get(ValueName(name, j), 0.0)
                values[place] *= max(1.0 + relative, 0.0)
                moved |= relative != 0.0
            if moved:
                changed: dict[str, Any] = {name: values}
                self.robot = replace(self.robot, **changed)
        self._update_bodies()

    def _update_bodies(self) -> None:
        """Change re-identified bodies."""
        calibration = self.model.extension.calibration
        moved = []
        for j, place in enumerate(self.place):
            change = np.array([calibration.get(name, 0.0) for name in body_parameter_names(j)])
            if not change.any():
                continue
            values = self.robot.tree.bodies[place].inertial_parameters + change
            if values[0] <= 0.0:
                self.left_out.append(f"re-identified body {j + 1} (it would have no mass)")
                continue
            self.robot = self.robot.with_inertial_parameters(place + 1, values)
            moved.append(f"{j + 1}: {change[0]:+.3g} kg")
        if moved:
            self.changes.append(f"Rigid model re-identified, mass of link {', '.join(moved)}.")

    def add(self, estimated: EstimatedEffect) -> None:
        """Add one finding to the robot, or to the list of those left out."""
        located = estimated.located
        own = next((j for j in (located.joint, located.link) if j is not None), len(self.place) - 1)
        change, law = located.effect.change_robot, law_of(located.effect)
        changed = None
        if law is not None:
            law = law.with_shapes(located.shapes)
            changed = law_change(self.robot, law, estimated.amplitudes, self.place, located.label)
        elif change is not None:
            constants = joint_constants(self.model, own, self.own_chains[self.place[own]])
            changed = change(self.robot, estimated, self.place[own], constants)
        if changed is None:
            self.left_out.append(located.label)
        elif changed.robot is None:
            self.left_out.append(f"{located.label} ({changed.sentence})")
        robot = None if changed is None else changed.robot
        if robot is None or len(robot.added_torques) > len(self.robot.added_torques):
            self.not_in_robot.append(estimated)
        if changed is not None and robot is not None:
            self.robot = robot
            self.changes.append(changed.sentence)

    def stiffness_deviation(self) -> np.ndarray:
        """Return relative standard deviations (n,) of identified stiffness, else NaN."""
        found = np.full(self.robot.n, np.nan)
        for located, values, deviations in self._stated_findings():
            if located.effect.family != "elastic" or located.joint is None:
                continue
            shares = [
                deviation / abs(values[name])
                for name, deviation in deviations.items()
                if name in _STIFFNESS_FACTORS and values.get(name)
            ]
            if shares:
                place = self.place[located.joint]
                found[place] = np.fmax(found[place], max(shares))
        return found

    def payload_deviation(self) -> float:
        """Return the standard deviation of an identified payload over the robot's payload."""
        carried = 0.0 if self.robot.payload is None else float(self.robot.payload[0])
        for located, _, deviations in self._stated_findings():
            of_tool = located.effect.scope == "robot" and "mass" in located.effect.tolerances
            if of_tool and "dm" in deviations and carried > 0.0:
                return float(deviations["dm"] / carried)
        return float("nan")

    def _stated_findings(
        self,
    ) -> Iterator[tuple[LocatedEffect, Mapping[str, float], Mapping[str, float]]]:
        """Yield findings with their parameters and standard deviations."""
        stated = zip(
            self.model.extension.effects, self.model.parameters, self.model.deviations, strict=False
        )
        for estimated, values, deviations in stated:
            yield estimated.located, values, deviations


def _match_joints(robot: Robot, model: ExtendedModel) -> tuple[int, ...]:
    """Return the robot's index of every joint of the model: by name, else in order."""
    names: Sequence[str] = robot.joint_names
    if set(model.joints) <= set(names):
        return tuple(names.index(name) for name in model.joints)
    if len(model.joints) != len(names):
        raise InputFileError(
            model.source,
            "joints",
            f"this model is of {', '.join(model.joints)}, the robot of the problem has"
            f" {', '.join(names)}. Give the model of the same robot.",
        )
    return tuple(range(len(names)))


def joint_constants(model: ExtendedModel, joint: int, own: Chain | None) -> JointConstants:
    """Return the constants of a joint that the terms of an extended model were fitted with.

    `joint`: from 0. `own`: drivetrain of the robot's file, used if the model states none.
    """
    nominal = model.nominal

    def stated(values: Sequence[float] | None, default: float) -> float:
        return default if values is None else values[joint]

    return JointConstants(
        joint=joint + 1,
        ratio=stated(nominal.gear_ratio, 1.0),
        coulomb=stated(nominal.coulomb, 0.0),
        viscous=stated(nominal.viscous, 0.0),
        rotor_inertia=stated(nominal.rotor_inertia, 0.0),
        joint_damping=stated(nominal.joint_damping, 0.0),
        chain=own if model.chains is None else model.chains[joint],
        pole_pairs=nominal.pole_pairs,
        **model.scales_of(joint),
    )


Progress = Callable[[Any], object]


@dataclass(frozen=True, kw_only=True, eq=False)
class ClosedLoop:
    """Motions planned with the nominal and the extended robot, and their assessment."""

    problem: TrajectoryProblem  # problem with the extended robot
    planner: PlannerModel
    nominal: Solution  # planned with the nominal robot
    carried_over: Assessment | None  # the nominal motion on the extended robot
    solution: Solution  # planned with the extended robot; its notes describe the change


def read_model(model: Path, effects: Path | None = None) -> ExtendedModel:
    """Read an extended model, with the effects of a user's Python file."""
    return load_extended(model, () if effects is None else load_effects(effects))


def solve_extended(
    problem: TrajectoryProblem, model: ExtendedModel, *, progress: Progress | None = None
) -> ClosedLoop:
    """Solve a problem with the nominal robot, then with the extended one.

    `problem`: problem with the nominal robot. `progress`: called with a `SolveProgress` in every
    iteration of both solves.

    Raises `ProblemError`: the problem is infeasible for the nominal or the extended robot;
    `InputFileError`: the model is of another robot.
    """
    planner = planner_model(problem.robot, model)
    changed = extended_problem(problem, planner)
    nominal = solve(problem, progress=progress, throw=False)
    carried = None
    if nominal.trajectory is not None:
        carried = assess(changed, nominal.trajectory)
    solution = solve(changed, progress=progress, throw=False)
    loop = ClosedLoop(
        problem=changed, planner=planner, nominal=nominal, carried_over=carried, solution=solution
    )
    notes = (*solution.notes, *_describe_changes(planner, model), *_compare_motions(loop))
    return replace(loop, solution=replace(solution, notes=notes))


def _describe_changes(planner: PlannerModel, model: ExtendedModel) -> tuple[str, ...]:
    notes = [f"Planned with {model.source}. {text}" for text in planner.changes]
    if not planner.changes:
        notes.append(f"{model.source} contains no finding that influences planning.")
    if planner.left_out:
        notes.append(f"Left out, without influence on planning: {', '.join(planner.left_out)}.")
    return tuple(notes)


def _compare_motions(loop: ClosedLoop) -> tuple[str, ...]:
    """Compare the motions planned with the nominal and the extended robot."""
    old, new, carried = loop.nominal.assessment, loop.solution.assessment, loop.carried_over
    if old is None or carried is None:
        return ("There is no motion of the nominal robot to compare with.",)
    notes = []
    if new is not None:
        for part in ("dynamic", "total"):
            promised, true, best = (
                each.deflection_summary()[part].peak for each in (old, carried, new)
            )
            notes.append(
                f"Peak {part} deflection of the motion planned with the nominal robot:"
                f" {1e3 * promised:.4g} mm by the nominal model, {1e3 * true:.4g} mm by the"
                f" extended one; of the motion planned with the extended robot:"
                f" {1e3 * best:.4g} mm{_format_change(best, true)}."
            )
        notes.append(_compare_objectives(loop, carried))
    worst = carried.worst_violation
    if worst.value > CERTIFICATE_TOLERANCE:
        notes.append(f"The motion planned with the nominal robot exceeds {worst.describe()}.")
    return tuple(note for note in notes if note)


def _compare_objectives(loop: ClosedLoop, carried: Assessment) -> str:
    own = loop.solution.objective
    if own is None:
        return ""
    before = objective_value(loop.problem, carried)
    return (
        f"Objective of the motion planned with the nominal robot, by the extended model:"
        f" {before.value:.4g} {before.unit}; planned with the extended robot: {own.value:.4g}"
        f" {own.unit}{_format_change(own.value, before.value)}."
    )


def _format_change(after: float, before: float) -> str:
    return f" ({format_increase(after, before, 2)})" if before > 0.0 else ""


def extended_problem(problem: TrajectoryProblem, planner: PlannerModel) -> TrajectoryProblem:
    """Return the problem with the extended robot, as uncertain as its findings."""
    uncertainty = bounds_from_deviations(
        problem.uncertainty, planner.stiffness_deviation, planner.payload_deviation
    )
    return replace(problem, robot=planner.robot, uncertainty=uncertainty)
