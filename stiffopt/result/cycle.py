"""Results of a cycle: the solution of each leg, times, events, simulation and duty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stiffopt.files import SCHEMA, pick, to_json_types, write_json
from stiffopt.result.motion_table import write_motion_table
from stiffopt.result.provenance import versions
from stiffopt.result.solution import ObjectiveValue, Solution
from stiffopt.result.status import SolveStatus

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.duty import Duty
    from stiffopt.result.simulation import SimulatedMotion
    from stiffopt.result.trajectory import JointMotion

CYCLE_FILE = "cycle.json"


def leg_folder(number: int) -> str:
    """Name of the folder of a leg (from 1) inside that of its cycle."""
    return f"leg_{number}"


class JoinedMotion:
    """Motions of the same joints one after another, with rests between them.

    A part moves on from where it starts, so that one whose command decays after its arrival
    overlaps the next one without a jump. `parts`: from rest to rest, each from the end of the one
    before. `starts` (L,) [s]. `duration`: of the whole [s].
    """

    def __init__(self, parts: Sequence[JointMotion], starts: np.ndarray, duration: float) -> None:
        self._parts, self._starts, self.duration = tuple(parts), np.asarray(starts), duration
        breaks = [
            start + np.asarray(getattr(part, "times", (0.0, part.duration)))
            for start, part in zip(self._starts, self._parts, strict=True)
        ]
        self.times = np.unique(np.clip(np.concatenate([[0.0, duration], *breaks]), 0.0, duration))

    def __call__(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        """Position (order 0) or a derivative (K, n) at times (K,) [s]."""
        t = np.asarray(t, dtype=float)
        first = self._parts[0](np.zeros(1))
        found = np.repeat(first if order == 0 else np.zeros_like(first), len(t), axis=0)
        for start, part in zip(self._starts, self._parts, strict=True):
            end = float(getattr(part, "times", np.array([part.duration]))[-1])
            local = np.clip(t - start, 0.0, end)
            if order == 0:
                found += part(local) - part(np.zeros(1))
            else:
                inside = (t >= start) & (t <= start + end)
                found[inside] += part(local[inside], order)
        return found


@dataclass(frozen=True, kw_only=True)
class LegResult:
    """Solved leg of a cycle."""

    name: str
    moves: tuple[int, ...]
    problem: TrajectoryProblem  # as it was solved
    solution: Solution
    # In the time of the cycle [s].
    start: float
    arrival: float
    dwell: float  # rest after arrival [s]
    until_settled: bool
    event: str  # kind of the event at arrival, "" for none
    # All that the flange carries, before and after the event [kg].
    mass_before: float
    mass_after: float

    @property
    def departure(self) -> float:
        """End of the rest after the leg [s]."""
        return self.arrival + self.dwell


@dataclass(frozen=True, kw_only=True)
class LegError:
    """Simulated tool error of one leg."""

    flight: float  # peak from start to arrival [m]
    rest: float | None  # peak in the rest after arrival and event [m]; None without a rest
    jump: float  # static displacement of the tool by the event's change of payload [m]
    # From arrival until the tool stays within the band [s]; None where it does not settle within
    # the rest.
    settling_time: float | None


@dataclass(frozen=True, kw_only=True)
class CycleSimulation:
    """Elastic simulation of the whole cycle, payload changes included."""

    simulated: SimulatedMotion
    legs: tuple[LegError, ...]
    notes: tuple[str, ...] = ()

    @property
    def peak(self) -> float:
        """Largest tool error in flight [m]."""
        return max(leg.flight for leg in self.legs)

    @property
    def rest_peak(self) -> float:
        """Largest tool error in the rests [m]."""
        return max((leg.rest for leg in self.legs if leg.rest is not None), default=0.0)


@dataclass(frozen=True, kw_only=True)
class RivalCycle:
    """Cycle of one kind of baseline motion in the same postures, with a stop at each pose."""

    name: str
    duration: float  # with the dwells of the optimised cycle [s]
    objective: float  # value over the cycle [SI]


@dataclass(frozen=True, kw_only=True)
class CycleSolution:
    """Outcome of a cycle."""

    status: SolveStatus  # the worst of the legs
    message: str
    title: str
    legs: tuple[LegResult, ...]  # in order, as far as solved
    objective: ObjectiveValue | None  # over the whole cycle
    rivals: tuple[RivalCycle, ...] = ()  # those that keep every limit
    postures: tuple[Any, ...] = ()  # (name, joints (n,), branch, chosen, candidates)
    simulation: CycleSimulation | None = None
    duty: Duty | None = None
    notes: tuple[str, ...] = ()
    splits: tuple[tuple[float, ...], ...] = field(default=(), repr=False)

    @property
    def duration(self) -> float:
        """Time of the cycle, rests included [s]."""
        return self.legs[-1].departure if self.legs else 0.0

    def joined(self, parts: Sequence[JointMotion]) -> JoinedMotion:
        """Join one motion of each leg at the times of the cycle."""
        starts = np.array([leg.start for leg in self.legs])
        return JoinedMotion(parts, starts, self.duration)


def cycle_document(solution: CycleSolution) -> dict[str, Any]:
    """Content of cycle.json; SI."""
    simulation, duty = solution.simulation, solution.duty
    errors = [None] * len(solution.legs) if simulation is None else simulation.legs
    document = {
        "schema": SCHEMA,
        "status": str(solution.status),
        **pick(solution, "message", "title"),
        "objective": None if solution.objective is None else dict(vars(solution.objective)),
        "duration": solution.duration,
        "legs": [
            {
                "name": leg.name,
                "folder": leg_folder(number),
                "moves": leg.moves,
                "status": str(leg.solution.status),
                **pick(leg, "start", "arrival", "dwell", "until_settled"),
                **pick(leg, "event", "mass_before", "mass_after"),
                "objective": None
                if leg.solution.objective is None
                else leg.solution.objective.value,
                "tool_error": None if error is None else dict(vars(error)),
            }
            for number, (leg, error) in enumerate(zip(solution.legs, errors, strict=True), start=1)
        ],
        "postures": [vars(posture) for posture in solution.postures],
        "rivals": [vars(rival) for rival in solution.rivals],
        "duty": None if duty is None else duty.document(),
        "notes": solution.notes,
        "versions": versions(),
    }
    return {key: to_json_types(value) for key, value in document.items()}


def write_cycle(
    solution: CycleSolution, directory: Path, problem: str, changes: Sequence[str]
) -> Path:
    """Write cycle.json into `directory`; `problem` is the file's path relative to the folder."""
    document = {**cycle_document(solution), "problem": problem, "changes": list(changes)}
    path = directory / CYCLE_FILE
    write_json(path, document)
    return path


def write_cycle_simulation(found: CycleSimulation, directory: Path) -> tuple[str, str]:
    """Write simulation.json and simulation.csv of a cycle; return their names."""
    simulated = found.simulated
    document = {
        "schema": SCHEMA,
        "in_flight": found.peak,
        "in_rests": found.rest_peak,
        "band": simulated.band,
        "legs": [dict(vars(leg)) for leg in found.legs],
        "notes": found.notes,
        "versions": versions(),
    }
    names = ("simulation.json", "simulation.csv")
    write_json(directory / names[0], document)
    error = simulated.error
    arrays = {"t": error.time, "deviation_": error.position, "distance": error.distance}
    write_motion_table(directory / names[1], arrays)
    return names
