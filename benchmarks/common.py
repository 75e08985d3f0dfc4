"""What all benchmarks share: the UR10 problem of the problem data, rows of results, tables."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from stiffopt.problem.limit import Limits
from stiffopt.problem.objective import Objective
from stiffopt.problem.trajectory import Method, Target, TrajectoryProblem
from stiffopt.robot.files import load_robot
from stiffopt.robot.robot import Robot

HERE = Path(__file__).parent
DATA = Path(os.environ.get("STIFFOPT_BENCHMARKS", HERE.parent.parent / "shared" / "benchmarks"))


@dataclass(frozen=True)
class Row:
    """One measured number beside its reference.

    `wanted` says what is asked of it, "" where it is only recorded; `holds` whether it is so.
    """

    what: str
    measured: str
    reference: str = ""
    wanted: str = ""
    holds: bool | None = None


@dataclass
class Stopwatch:
    """Seconds spent in named blocks."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        begin = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin


def numbers() -> dict[str, Any]:
    """Problem data of the UR10 benchmarks."""
    return json.loads((DATA / "ur10.json").read_text())


def require_data() -> None:
    """End the script with a message where the problem data are absent."""
    if not (DATA / "ur10.json").is_file():
        print(f"skipped: no ur10.json in {DATA}; set STIFFOPT_BENCHMARKS to its directory.")
        sys.exit(0)


def urdf_model() -> Any:
    """Arm of the problem data, payload merged."""
    return pin.buildModelFromUrdf(str(DATA / numbers()["urdf"]))


def loaded_ur10() -> Robot:
    """The shipped UR10 with its drivetrain, the payload of the problem data and its tool point."""
    # The body by which the last link of ur10_5kg.urdf exceeds the bare arm's.
    return load_robot("ur10").with_payload(5.0, [0.0, 0.0, 0.0], [0.01, 0.01, 0.01])


def torque_squared_problem(robot: Robot, method: Method | None = None) -> TrajectoryProblem:
    """Minimum squared torque: boundary acceleration free, no acceleration or jerk limit."""
    return ur10_problem(
        robot,
        Objective(name="torque_squared"),
        acceleration=None,
        boundary_acceleration="free",
        method=method or Method(),
    )


def deflection_problem(robot: Robot, method: Method | None = None) -> TrajectoryProblem:
    """Minimum peak dynamic deflection from rest to rest, acceleration limited, no jerk limit."""
    return ur10_problem(
        robot,
        Objective(name="dynamic_deflection"),
        acceleration=np.array(numbers()["dynamic_deflection"]["acceleration_max"]),
        method=method or Method(),
    )


def ur10_problem(
    robot: Robot, objective: Objective, acceleration: np.ndarray | None, **rest: Any
) -> TrajectoryProblem:
    """Motion and limits of the problem data."""
    data = numbers()
    unlimited = np.full(robot.n, np.inf)
    limits = replace(
        Limits.of(robot),
        velocity=np.array(data["velocity_max"]),
        torque=np.array(data["torque_max"]),
        acceleration=unlimited if acceleration is None else acceleration,
        jerk=unlimited,
    )
    rest.setdefault("duration", (data["duration"], data["duration"]))
    return TrajectoryProblem(
        robot=robot,
        start=Target(joints=np.array(data["start"])),
        end=Target(joints=np.array(data["end"])),
        objectives=(objective,),
        limits=limits,
        **rest,
    )


def table(title: str, rows: list[Row]) -> str:
    """Markdown table of results."""
    lines = [f"## {title}", "", "| what | measured | reference | wanted | holds |"]
    lines.append("|---|---|---|---|---|")
    marks = {True: "yes", False: "**no**", None: ""}
    for row in rows:
        cells = (row.what, row.measured, row.reference, row.wanted, marks[row.holds])
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main(title: str, run: Callable[[], list[Row]]) -> None:
    """Run one benchmark as a script."""
    require_data()
    print(table(title, run()))
