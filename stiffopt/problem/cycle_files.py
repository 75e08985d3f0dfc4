"""Files of working cycles: from [[pose]] and [[move]] to the legs of a `Cycle`."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from stiffopt.dynamics.inverse_kinematics import solve_pose
from stiffopt.errors import InputFileError, ProblemError
from stiffopt.files import load_toml, read_document
from stiffopt.problem import branches, schema
from stiffopt.problem.cycle import (
    MIN_LEG_TIME,
    CarriedLoad,
    Cycle,
    CycleEvent,
    Leg,
    Posture,
    Stop,
    follow_loads,
)
from stiffopt.problem.files import (
    PoseReader,
    check_expected_unit,
    common_fields,
    payload_remarks,
    read_duration,
    read_duty,
    read_robot,
)
from stiffopt.problem.joint_lists import JointLists
from stiffopt.problem.limit import Limits
from stiffopt.problem.resolve import check_range
from stiffopt.problem.trajectory import Target, TrajectoryProblem
from stiffopt.robot.clearance import ClearanceModel
from stiffopt.robot.elements import locate_errors
from stiffopt.robot.files import load_robot
from stiffopt.robot.frames import rotation_from_rpy
from stiffopt.robot.robot import Robot


@dataclass(frozen=True)
class LoadedCycle:
    """Cycle of a file, with the expected value of its solution."""

    cycle: Cycle
    expected: schema.ExpectedSection | None
    path: Path


@dataclass(frozen=True)
class _Step:
    """Visit of a pose: at a move's end, or at one of its vias."""

    move: int
    where: str
    target: Target
    pose: int | None
    passed: bool


def is_cycle(path: str | os.PathLike[str]) -> bool:
    """Return True for the file of a cycle."""
    return "move" in load_toml(path)


def load_cycle(
    path: str | os.PathLike[str],
    changes: Sequence[str] = (),
    *,
    robots: Callable[[str | Path], Robot] = load_robot,
) -> LoadedCycle:
    """Read the file of a cycle; parameters as of `load_problem`.

    Raises `InputFileError`: the file is invalid: file, key, allowed values and remedy.
    """
    path = Path(path)
    document = read_document(path, schema.problem_file(), "trajectory", changes)
    with locate_errors(path, ""):
        cycle = _CycleReader(document, path, robots).read()
    check_expected_unit(document.expected, cycle.first.objectives, path)
    return LoadedCycle(cycle, document.expected, path)


class _CycleReader:
    """Reader of one file."""

    def __init__(
        self, document: schema.ProblemFile, path: Path, robots: Callable[[str | Path], Robot]
    ) -> None:
        self._document, self._path = document, path
        self._moves = document.move
        self._robots: dict[CarriedLoad, Robot] = {}
        self._load_robot = robots
        motion = document.motion
        if motion.start is None or motion.end is not None or motion.via or motion.path is not None:
            self._fail(
                "motion",
                "a cycle has `start` and `duration` here; its vias and ends belong to [[move]].",
            )
        if document.path is not None:
            self._fail("path", "a path of the tool and [[move]] exclude each other. Remove one.")
        if motion.boundary_velocity != "zero":
            self._fail("motion.boundary_velocity", "a cycle starts and ends at rest. Leave it out.")
        self._loads = follow_loads(document, path)
        self._joints = JointLists(self._robot(self._loads[0]), path)
        self._poses = PoseReader(self._joints, document.pose)
        self._common = common_fields(document, self._joints)

    def _fail(self, where: str, reason: str) -> NoReturn:
        raise InputFileError(self._path, where, reason)

    def _robot(self, load: CarriedLoad) -> Robot:
        if load not in self._robots:
            robot = read_robot(
                self._document.robot, load.body, load.tool, self._path, self._load_robot
            )
            if load.part is not None:
                with locate_errors(self._path, load.place):
                    robot = robot.with_payload(load.part.mass, load.part.com, load.part.inertia)
            self._robots[load] = robot
        return self._robots[load]

    def read(self) -> Cycle:
        """Cycle of the file."""
        steps = self._steps()
        chosen, postures = self._choose_branches(steps)
        legs = self._legs(steps, chosen)
        lower, upper = duration = read_duration(self._document)
        first = legs[0].problem
        timed = any(each.name == "duration" for each in first.objectives)
        limit = self._document.motion.error_limit
        peak = len(first.objectives) == 1 and first.objectives[0].shown_measure == "peak"
        if limit is not None and (not peak or first.objectives[0].unit != "m" or lower == upper):
            self._fail(
                "motion.error_limit",
                "bounds the peak of one minimised deflection, such as tool_deviation, in a cycle "
                "of free duration: give motion.duration = { upper = ... } and that objective.",
            )
        if lower == upper and timed:
            self._fail(
                "motion.duration",
                "the duration is minimised, so it must be free: give { upper = ... }, or minimise"
                " another objective.",
            )
        if lower < upper and not timed and limit is None:
            self._fail(
                "motion.duration",
                "a free duration of a cycle needs the objective duration under limits, or "
                "motion.error_limit; give one number to minimise another objective.",
            )
        return Cycle(
            title=str(self._common["title"]),
            legs=tuple(self._share_time(legs, lower, upper, chosen, steps)),
            duration=duration,
            postures=postures,
            after_last=self._robot(self._loads[-1]),
            duty_limits=read_duty(self._document.duty, self._joints),
            error_limit=limit,
        )

    @cached_property
    def _stops(self) -> list[bool]:
        """True for each move at whose end the arm stops."""
        found = []
        for k, move in enumerate(self._moves):
            after = self._moves[k + 1] if k + 1 < len(self._moves) else None
            reasons = [
                (move.event is not None, f"its event {move.event}"),
                (move.dwell != 0.0, "its dwell"),
                (after is None, "it is the last move"),
                (after is not None and after.speed != move.speed, "the next move's speed differs"),
                (
                    after is not None and after.process_force != move.process_force,
                    "the next move's process_force differs",
                ),
            ]
            why = next((text for needed, text in reasons if needed), "")
            if move.stop is False and why:
                self._fail(
                    f"move[{k + 1}].stop",
                    f"the arm has to stop there: {why}. Leave stop out.",
                )
            found.append(move.stop is not False)
        return found

    def _steps(self) -> list[_Step]:
        """Visits in order, the start first (of move 0)."""
        keys: dict[Any, int] = {}

        def visit(move: int, section: schema.NamedTarget, where: str, passed: bool) -> _Step:
            target = self._poses(section, where)
            load = self._loads[max(move - 1, 0)]
            # A position is a stop of an arm that has no orientation to choose.
            fixed = target.fixes_pose or self._robot(load).position_fixes_joints
            # By its text, as lists of joints cannot be keys.
            pose = keys.setdefault((repr(section), load.tool), len(keys)) if fixed else None
            if pose is None and not passed:
                self._fail(
                    where,
                    "the arm stops here, so the pose must be given: add `rpy`, or give `joints`.",
                )
            return _Step(move, where, target, pose, passed)

        assert self._document.motion.start is not None
        found = [visit(0, self._document.motion.start, "motion.start", False)]
        for number, move in enumerate(self._moves, start=1):
            where = f"move[{number}]"
            for k, via in enumerate(move.via, start=1):
                found.append(visit(number, via, f"{where}.via[{k}]", True))
            found.append(visit(number, move.to, f"{where}.to", not self._stops[number - 1]))
            before = found[-2]
            if found[-1].pose is not None and found[-1].pose == before.pose:
                self._fail(
                    f"{where}.to",
                    "the move ends in the pose where it begins. Remove it, or give a dwell to the"
                    " move before.",
                )
        return found

    def _choose_branches(
        self, steps: Sequence[_Step]
    ) -> tuple[list[np.ndarray], tuple[Posture, ...]]:
        """Joint angles of each pose, and the postures."""
        limits: Limits = self._common["limits"]
        cell = self._common["cell"]
        visits: dict[int, list[_Step]] = {}
        for step in steps:
            if step.pose is not None:
                visits.setdefault(step.pose, []).append(step)
        base = self._robot(self._loads[0])
        clearance = None
        if self._document.method.collisions == "avoid":
            from stiffopt.robot.cell import Cell

            model = ClearanceModel(base, Cell() if cell is None else cell)
            clearance = model if model.pairs else None
        reference = self._reference(steps)
        candidates = [
            self._candidates(visits[pose], limits, clearance, reference)
            for pose in range(len(visits))
        ]
        route = [step for step in steps if step.pose is not None]
        tables = []
        for before, after in itertools.pairwise(route):
            assert before.pose is not None
            assert after.pose is not None
            if before.pose == after.pose:
                continue
            speed = self._moves[after.move - 1].speed
            cost = branches.quintic_durations(
                np.stack(candidates[before.pose]),
                np.stack(candidates[after.pose]),
                (speed * limits.velocity, limits.acceleration, limits.jerk),
            )
            tables.append(branches.CostTable((before.pose, after.pose), cost))
        best = branches.best_combination(tables, len(candidates))
        chosen = [candidates[pose][k] for pose, k in enumerate(best)]
        postures = tuple(
            Posture(
                name=self._pose_name(visits[pose][0]),
                joints=chosen[pose],
                prismatic=base.prismatic,
                branch=branches.branch_name(base, chosen[pose]),
                chosen=visits[pose][0].target.joints is None
                and visits[pose][0].target.near is None,
                candidates=len(candidates[pose]),
            )
            for pose in range(len(candidates))
        )
        return chosen, postures

    def _reference(self, steps: Sequence[_Step]) -> np.ndarray:
        """Joint angles (n,) near which solutions are sought: the first ones that are given."""
        for step in steps:
            given = step.target.joints if step.target.joints is not None else step.target.near
            if given is not None:
                return given
        return branches.middle_of_ranges(self._robot(self._loads[0]))

    def _candidates(
        self,
        visits: Sequence[_Step],
        limits: Limits,
        clearance: ClearanceModel | None,
        reference: np.ndarray,
    ) -> list[np.ndarray]:
        """Admissible joint angles of one pose."""
        step = visits[0]
        target = step.target
        with locate_errors(self._path, step.where):
            loads = {self._loads[k] for each in visits for k in (max(each.move - 1, 0), each.move)}
            robot = branches.within_limits(self._robot(self._loads[max(step.move - 1, 0)]), limits)
            if target.joints is not None:
                check_range(robot, limits, "joints", target.joints)
                return [target.joints]
            assert target.position is not None
            rotation = None if target.rpy is None else rotation_from_rpy(target.rpy)
            if target.near is not None:
                return [solve_pose(robot, target.position, rotation, target.near)]

            bodies = {load: self._robot(load).rigid_bodies() for load in loads}
            least = self._document.cell.clearance if self._document.cell else 0.0
            # Of postures without collisions that the drives cannot hold: largest share of a torque
            # limit at rest, and its load.
            too_heavy: list[tuple[float, CarriedLoad]] = []

            def admissible(q: np.ndarray) -> bool:
                if clearance is not None and float(clearance.distances(q).min()) < least:
                    return False
                shares = {
                    load: float((np.abs(own.gravity_torque(q)) / limits.torque).max())
                    for load, own in bodies.items()
                }
                heaviest = max(shares, key=lambda load: shares[load])
                if shares[heaviest] > 1.0:
                    too_heavy.append((shares[heaviest], heaviest))
                return shares[heaviest] <= 1.0

            found = branches.solutions_of_pose(
                robot, target.position, rotation, reference, admissible
            )
            if not found and not too_heavy:
                # States the cause where the pose is out of reach.
                solve_pose(robot, target.position, rotation, reference)
                raise ProblemError(
                    "in every posture that reaches this pose the arm collides. Move the pose."
                )
        if not found:
            share, load = min(too_heavy, key=lambda each: each[0])
            self._fail(
                load.place,
                f"the drives cannot hold {load.mass:g} kg at rest in the pose of {step.where}: a "
                f"joint needs {share:.3g} times its torque limit. Lighten the load (its mass is in "
                "kg unless it has a unit), or move the pose.",
            )
        return found

    def _pose_name(self, step: _Step) -> str:
        if step.move == 0:
            entry: schema.NamedTarget | None = self._document.motion.start
        else:
            move = self._moves[step.move - 1]
            entry = move.to if step.where.endswith(".to") else None
            if entry is not None and not isinstance(entry, str) and move.name:
                return move.name
        return entry if isinstance(entry, str) else step.where.removesuffix(".to")

    def _move_name(self, number: int) -> str:
        move = self._moves[number - 1]
        return move.name or (move.to if isinstance(move.to, str) else f"move {number}")

    def _legs(self, steps: Sequence[_Step], chosen: Sequence[np.ndarray]) -> list[Leg]:
        legs: list[Leg] = []
        numbers: list[int] = []
        passed: list[_Step] = []
        here = steps[0]
        for step in steps[1:]:
            if not numbers or numbers[-1] != step.move:
                numbers.append(step.move)
            if step.passed:
                passed.append(step)
                continue
            legs.append(self._leg(tuple(numbers), here, passed, step, chosen))
            here, passed, numbers = step, [], []
        return legs

    def _leg(
        self,
        numbers: tuple[int, ...],
        here: _Step,
        passed: Sequence[_Step],
        last: _Step,
        chosen: Sequence[np.ndarray],
    ) -> Leg:
        move: schema.MoveSection = self._moves[numbers[-1] - 1]
        load, after = self._loads[numbers[-1] - 1], self._loads[numbers[-1]]
        limits: Limits = self._common["limits"]
        if move.speed != 1.0:
            scaled = {
                "velocity": move.speed * limits.velocity,
                "tool_speed": move.speed * limits.tool_speed,
            }
            limits = Limits({**limits.values, **scaled})
        force = self._common["process_force"]
        names = [self._move_name(number) for number in numbers]
        assert here.pose is not None
        assert last.pose is not None
        bodies = (load.body, load.part)
        remarks = [remark for body in bodies for remark in payload_remarks(body)]
        if numbers[-1] == len(self._moves) and after.part is not None:
            remarks.append(
                f"{after.place}: the part is still in the gripper after the last move. Put it down "
                "by a move with event = 'release', unless the cycle is to end with it."
            )
        with locate_errors(self._path, f"move[{numbers[0]}]"):
            problem = TrajectoryProblem(
                **self._common
                | {
                    "robot": self._robot(load),
                    "start": Target(joints=chosen[here.pose]),
                    "end": Target(joints=chosen[last.pose]),
                    "vias": tuple(
                        via.target
                        if via.pose is None or via.target.joints is not None
                        else replace(via.target, near=chosen[via.pose])
                        for via in passed
                    ),
                    "duration": (MIN_LEG_TIME, np.inf),
                    "limits": limits,
                    "process_force": force
                    if move.process_force is None
                    else np.array(move.process_force),
                    "boundary_acceleration": self._document.motion.boundary_acceleration,
                    "remarks": tuple(dict.fromkeys(remarks)),
                    "title": f"{self._common['title']}: {', '.join(names)}",
                }
            )
        settled = move.dwell == "settled"
        event = (
            None
            if move.event is None
            else CycleEvent(kind=move.event, mass_before=load.mass, mass_after=after.mass)
        )
        return Leg(
            problem=problem,
            moves=numbers,
            name=", ".join(names),
            stop=Stop(
                dwell=0.0 if settled else float(move.dwell), until_settled=settled, event=event
            ),
        )

    def _share_time(
        self,
        legs: Sequence[Leg],
        lower: float,
        upper: float,
        chosen: Sequence[np.ndarray],
        steps: Sequence[_Step],
    ) -> list[Leg]:
        """Give each leg its first share of a fixed time, by the durations of the quintic rivals."""
        if lower != upper:
            return list(legs)
        left = lower - sum(leg.stop.dwell for leg in legs)
        if left < MIN_LEG_TIME * len(legs):
            self._fail(
                "motion.duration",
                f"the cycle of {lower:.4g} s leaves {left:.4g} s for its {len(legs)} motions "
                "beside the dwells. Give more time, or shorter dwells.",
            )
        needed = np.zeros(len(legs))
        number = {move: k for k, leg in enumerate(legs) for move in leg.moves}
        route = [step for step in steps if step.pose is not None]
        for before, after in itertools.pairwise(route):
            assert before.pose is not None
            assert after.pose is not None
            leg = number[after.move]
            limits = legs[leg].problem.active_limits
            ends = (chosen[before.pose][None], chosen[after.pose][None])
            needed[leg] += branches.quintic_durations(
                *ends, (limits.velocity, limits.acceleration, limits.jerk)
            )[0, 0]
        share = np.maximum(left * needed / needed.sum(), MIN_LEG_TIME)
        return [
            leg.lasting(float(each))
            for leg, each in zip(legs, share * left / share.sum(), strict=True)
        ]
