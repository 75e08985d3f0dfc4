"""Working cycles: several moves, passed or stopped at, with events of the gripper between them.

A leg is a run of moves from one stop to the next, with one payload, process force and speed. The
arm rests at stops in given joint angles, so that legs share nothing but the time of the cycle: the
optimum over all moves is the optimum of every leg at the best split of that time.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from stiffopt.errors import InputFileError
from stiffopt.problem.schema import PayloadSection, ProblemFile, ToolPointSection
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.duty import DutyLimits
from stiffopt.robot.robot import Robot

EventKind = Literal["grip", "release", "tool_change"]
# Smallest time that a leg may be given by the split of the cycle's time [s].
MIN_LEG_TIME = 0.02


@dataclass(frozen=True, kw_only=True)
class CycleEvent:
    """Event at the arrival of a move."""

    kind: EventKind  # "grip", "release" or "tool_change"
    # All that the flange carries [kg].
    mass_before: float
    mass_after: float


@dataclass(frozen=True, kw_only=True)
class Stop:
    """Stop at the end of a leg."""

    # [s]: rest before the next move; the least one where it lasts until the tool has settled.
    dwell: float = 0.0
    until_settled: bool = False
    event: CycleEvent | None = None  # at arrival, before the rest


@dataclass(frozen=True, kw_only=True)
class Leg:
    """Moves from one stop to the next."""

    # From rest to rest; its duration is fixed by the split of the cycle's time, or free.
    problem: TrajectoryProblem
    moves: tuple[int, ...]  # numbers of its moves, from 1
    name: str
    stop: Stop  # at its end

    def lasting(self, duration: float) -> Leg:
        """Leg of a fixed duration [s]."""
        return replace(self, problem=replace(self.problem, duration=(duration, duration)))


@dataclass(frozen=True, kw_only=True)
class Posture:
    """Pose of a cycle with the inverse-kinematic branch in which it is taken."""

    name: str
    joints: np.ndarray  # (n,) [rad], [m] of prismatic joints
    prismatic: np.ndarray  # (n,) True for prismatic joints
    branch: str  # names of shoulder, elbow and wrist
    chosen: bool  # True where the file leaves the branch open
    candidates: int  # number of admissible solutions of the inverse kinematics


@dataclass(frozen=True, kw_only=True)
class Cycle:
    """A working cycle."""

    title: str
    legs: tuple[Leg, ...]
    # (lower, upper) [s] of the whole cycle, rests included; equal values fix it.
    duration: tuple[float, float]
    postures: tuple[Posture, ...] = ()  # distinct poses in the order of their first visit
    after_last: Robot | None = None  # with the payload after the event of the last leg
    duty_limits: DutyLimits = field(default_factory=DutyLimits)
    # Largest value of the minimised deflection [m]: every leg is as short as that allows.
    error_limit: float | None = None

    @cached_property
    def first(self) -> TrajectoryProblem:
        """Problem of the first leg, whose robot, servo and objectives are those of the cycle."""
        return self.legs[0].problem

    @property
    def time_is_minimised(self) -> bool:
        """True where the objective is the time of the cycle."""
        asked = any(each.name == "duration" for each in self.first.objectives)
        return asked or self.error_limit is not None

    @property
    def times_legs(self) -> bool:
        """True where every leg is solved at given durations; else its programme has it free."""
        return self.duration[0] == self.duration[1] or self.error_limit is not None

    @property
    def rest(self) -> float:
        """Sum of the stated rests [s]."""
        return sum(leg.stop.dwell for leg in self.legs)


@dataclass(frozen=True)
class CarriedLoad:
    """Bodies at the flange and the tool point."""

    body: PayloadSection | None
    part: PayloadSection | None
    tool: ToolPointSection
    # Of its last body in the file; not compared: equal loads share one robot.
    place: str = field(default="payload", compare=False)

    @property
    def mass(self) -> float:
        """Sum of the masses [kg]."""
        return sum(each.mass for each in (self.body, self.part) if each is not None)


def follow_loads(document: ProblemFile, path: Path) -> list[CarriedLoad]:
    """Load of each move of a cycle, and that after the last one.

    Raises `InputFileError`: an event is impossible: a part is put down that is not held or taken
    while another one is held, or the tool is changed then.
    """
    tool = document.tool
    loads = [
        CarriedLoad(
            document.payload,
            None,
            ToolPointSection(link=tool.link, offset=tool.offset, rpy=tool.rpy),
        )
    ]
    gripped_at = ""
    for number, move in enumerate(document.move, start=1):
        now, where = loads[-1], f"move[{number}]"
        if move.payload is not None and move.event not in ("grip", "tool_change"):
            raise InputFileError(
                path,
                f"{where}.payload",
                "belongs to a move whose event is grip (the part) or tool_change (the new tool).",
            )
        if move.tool is not None and move.event != "tool_change":
            raise InputFileError(
                path, f"{where}.tool", "belongs to a move whose event is tool_change."
            )
        if move.event == "grip":
            if now.part is not None:
                raise InputFileError(
                    path,
                    f"{where}.event",
                    f"the gripper still holds the part that it took at {gripped_at}. Release "
                    "that one before.",
                )
            if move.payload is None:
                raise InputFileError(
                    path, f"{where}.payload", "a grip needs the part: mass, com and inertia."
                )
            now = replace(now, part=move.payload, place=f"{where}.payload")
            gripped_at = where
        elif move.event == "release":
            if now.part is None:
                raise InputFileError(
                    path,
                    f"{where}.event",
                    "the gripper holds no part here: nothing was gripped before, or it was "
                    "put down already. Add a move with event = 'grip' and its payload before,"
                    " or leave this event out.",
                )
            now = replace(now, part=None, place=loads[0].place)
        elif move.event == "tool_change":
            if now.part is not None:
                raise InputFileError(
                    path,
                    f"{where}.event",
                    "the tool cannot be changed while the gripper holds the part that it took"
                    f" at {gripped_at}. Release it before.",
                )
            new = move.tool or ToolPointSection()
            now = CarriedLoad(move.payload, None, new, f"{where}.payload")
        loads.append(now)
    return loads
