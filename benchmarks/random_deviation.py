"""Twenty random motions planned for the links, judged by an independent simulation.

Ten of the UR10 in 1.0 s, ten of the ER3A-C60 in 0.5 s, between poses within 0.5 rad of a middle
one. Each is solved for the least peak tool deviation; it, toppra's stretched motion and the quintic
one are then simulated by `elastic_simulation`. Baselines may exceed limits, the plan may not.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from common import Row, main
from elastic_simulation import Sampled, Simulated, simulate

from stiffopt.problem.trajectory import Method, Target, TrajectoryProblem
from stiffopt.robot.files import load_robot
from stiffopt.solver.solve import solve

TITLE = "Random motions with the least tool deviation, ten UR10 and ten ER3A-C60"
COUNT, SEED = 20, 11
MIDDLE = {
    "ur10": ([0.0, -1.2, 1.4, -1.7, -1.5, 0.0], 1.0),
    "er3a_c60": ([0.0, 0.3, -0.3, 0.0, -0.9, 0.0], 0.5),
}
# Prediction against simulation: share, or [m] where that is more. Gain over toppra after arrival.
SHARE, LEAST = 0.1, 5e-6
GAIN = 20.0


@dataclass(frozen=True)
class Judged:
    """One problem solved and simulated; values in m."""

    name: str
    status: str
    worst: float
    planned: float
    own: Simulated
    toppra: Simulated | None
    quintic: Simulated | None

    @property
    def predicted(self) -> bool:
        """Whether the simulation does what was planned: the deviation in flight, rest after it."""
        flight = abs(self.own.peak - self.planned) <= max(SHARE * self.own.peak, LEAST)
        return flight and self.own.residual <= max(SHARE * self.own.peak, LEAST)


def problems() -> Iterator[TrajectoryProblem]:
    """The twenty problems, the two robots in turn."""
    random = np.random.default_rng(SEED)
    for number in range(COUNT):
        name = tuple(MIDDLE)[number % 2]
        middle, duration = MIDDLE[name]
        robot = load_robot(name)
        low, high = robot.position_lower + 0.05, robot.position_upper - 0.05
        ends = [np.clip(middle + random.uniform(-0.5, 0.5, 6), low, high) for _ in range(2)]
        yield TrajectoryProblem(
            robot=robot,
            start=Target(joints=ends[0]),
            end=Target(joints=ends[1]),
            duration=(duration, duration),
            # A busy computer must not decide how they end.
            method=Method(time_limit=3600.0),
            title=f"{name} {number // 2 + 1}",
        )


def judged(problem: TrajectoryProblem) -> Judged:
    """Solve a problem and simulate its motion and the baselines."""
    found = solve(problem, throw=False)
    assert found.trajectory is not None
    assert found.objective is not None
    assert found.assessment is not None
    beside = {
        name: None if each.assessment is None else simulate(problem.robot, Sampled(each.assessment))
        for name, each in found.baselines.items()
    }
    return Judged(
        name=problem.title,
        status=found.status.name.lower(),
        worst=found.assessment.worst_violation.value,
        planned=found.objective.value,
        own=simulate(problem.robot, found.trajectory),
        toppra=beside["toppra"],
        quintic=beside["quintic"],
    )


def run() -> list[Row]:
    """One row a problem, and what holds for all."""
    rows, all_of_them = [], []
    for problem in problems():
        one = judged(problem)
        all_of_them.append(one)
        rows.append(_row(one))
        print(rows[-1], flush=True)
    usable = sum(one.status in ("optimal", "acceptable") for one in all_of_them)
    rows.append(Row("optimal or acceptable", f"{usable} of {COUNT}", "", "all", usable == COUNT))
    return rows


def _row(one: Judged) -> Row:
    calmer = all(
        rival is None or one.own.residual * gain <= rival.residual
        for rival, gain in ((one.toppra, GAIN), (one.quintic, 1.0))
    )
    return Row(
        f"{one.name}: {one.status}, worst limit {one.worst:.2%}; planned / in flight / after, um",
        f"{1e6 * one.planned:.1f} / {_told(one.own)}",
        f"toppra {_told(one.toppra)}; quintic {_told(one.quintic)}",
        f"within {SHARE:.0%} or 5 um; after arrival {GAIN:g} times below toppra, below the quintic",
        bool(one.predicted and calmer),
    )


def _told(found: Simulated | None) -> str:
    return "–" if found is None else f"{1e6 * found.peak:.1f} / {1e6 * found.residual:.1f}"


if __name__ == "__main__":
    main(TITLE, run)
