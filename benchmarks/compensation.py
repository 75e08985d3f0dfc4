"""Compensated motions on arms that are not as modelled, by an independent simulation.

Motions of the two shipped deflection problems: the shaped and the unshaped optimum and toppra's,
each as planned and with motors that lead the links (`stiffopt.command.compensation`). They are put
on the arm as modelled and on arms whose stiffness is off by 20 %, all joints alike and each joint
such that the errors add up, with a payload that is off by 10 %, by the Runge-Kutta simulation of
`elastic_simulation`, which shares neither springs nor integrator with the package.
Deviations are from where the arm that is simulated would hang at rest: as planned at the motors'
position, compensated at the planned one.

A servo of 20 Hz whose velocity feed-forward is complete follows exactly (x' = c' + k (c - x) from
x = c), so it changes nothing here.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from common import Row, main
from elastic_simulation import Sampled, simulate

from stiffopt.baseline.baselines import baselines
from stiffopt.command.compensation import commands_on_arms
from stiffopt.command.simulation import PlannedMotion, elastic_arm
from stiffopt.elastic.uncertainty import Uncertainty
from stiffopt.problem.files import load_problem
from stiffopt.problem.objective import Objective
from stiffopt.problem.resolve import resolve
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.compensation import CompensatedMotion
from stiffopt.result.solution import Solution
from stiffopt.solver.solve import solve

TITLE = "Compensation on arms that are not as modelled"
FOLDER = Path(__file__).parents[1] / "problems"
PROBLEMS = {"UR10": "ur10_tool_deviation.toml", "ER3A": "er3a_pick_and_place.toml"}
MOTIONS = ("shaped_deviation", "tool_deviation", "dynamic_deflection")
# Of the arms: stiffness and payload alone, as the targets have it.
UNSURE = Uncertainty(damping=0.0)
CORNERS = tuple(product((0.8, 1.2), (0.9, 1.1)))
# Limits that a command without any need not keep.
LIMITS = ("position", "velocity", "velocity_by_position", "acceleration", "jerk", "torque")
# In flight and after arrival; plain of toppra, over the compensated motion.
EXACT, AT_WORST, SAME = 20.0, 8.0, 3.0


class Followed:
    """A trajectory with the arguments of the simulation."""

    def __init__(self, motion: Any) -> None:
        self._motion, self.duration = motion, float(motion.duration)

    def __call__(self, t: np.ndarray, order: int) -> np.ndarray:
        return np.asarray(self._motion(np.minimum(t, self.duration), order))


def peaks(
    problem: TrajectoryProblem, command: Any, plan: Any, found: CompensatedMotion
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Peaks [mm] in flight and after arrival: nominal, joints alike at worst, joints apart."""

    def run(stiffness: Any = 1.0, payload: float = 1.0) -> np.ndarray:
        one = simulate(
            problem.robot, command, reference=plan, stiffness=np.array(stiffness), payload=payload
        )
        return 1e3 * np.array([one.peak, one.residual])

    alike = np.max([run(stiffness, payload) for stiffness, payload in CORNERS], axis=0)
    arms = [found.compensated.flight.worst_arm, found.compensated.after.worst_arm]
    apart = np.max([run(arm["stiffness"], arm["payload"]) for arm in arms], axis=0)
    return run(), alike, np.maximum(alike, apart)


def solved(problem: TrajectoryProblem, objective: str) -> Solution:
    """The problem with another objective."""
    return solve(replace(problem, objectives=(Objective(name=objective),)), throw=False)


def text(values: np.ndarray) -> str:
    return " / ".join(f"{value:.4f}" for value in values) + " mm"


def ratio(above: np.ndarray, below: np.ndarray, wanted: float) -> tuple[str, str, bool]:
    """Ratios in flight and after arrival, what is asked, whether both hold."""
    ratios = above / below
    shown = " / ".join(f"{value:.1f}" for value in ratios)
    return shown, f"at least {wanted:g}", bool(np.all(ratios >= wanted))


def rows_of(name: str, problem: TrajectoryProblem) -> list[Row]:
    """Toppra's motion, as planned and compensated, then the optimised ones over it."""
    baseline = baselines(problem, resolve(problem))["toppra"].assessment
    assert baseline is not None
    arm, plan = elastic_arm(problem, baseline.position[0]), Sampled(baseline)
    one = simulate(problem.robot, plan)
    plain = 1e3 * np.array([one.peak, one.residual])
    rows = [Row(f"{name}, toppra stretched as planned", text(plain))]
    rival = PlannedMotion.of("toppra", baseline, True)
    others = {}
    # A command within the limits that toppra keeps, all but jerk, where a spline gives one; and one
    # that need keep none.
    for how, motion in (
        ("within its limits", rival),
        ("without limits", replace(rival, exceeded=LIMITS)),
    ):
        (made,) = commands_on_arms(problem, arm, [motion])
        found, command = made.for_reports(), made.motors
        others[how] = peaks(problem, Followed(command), plan, found)
        rows += described(f"{name}, toppra compensated {how}", others[how], found)
    for objective in MOTIONS:
        rows += optimised(name, problem, objective, plain, others)
    return rows


def optimised(
    name: str,
    problem: TrajectoryProblem,
    objective: str,
    plain: np.ndarray,
    others: dict[str, tuple[np.ndarray, ...]],
) -> list[Row]:
    """One optimised motion, compensated, and toppra's over it."""
    solution = solved(problem, objective)
    assert solution.assessment is not None
    assert solution.trajectory is not None
    arm = elastic_arm(problem, solution.assessment.position[0])
    own = PlannedMotion.of(objective, solution.assessment, True)
    if solution.trajectory.link is not None:
        own = replace(own, motors=solution.trajectory)
    (made,) = commands_on_arms(problem, arm, [own])
    found, command = made.for_reports(), made.motors
    plan = Followed(solution.trajectory.link or solution.trajectory)
    ours = peaks(problem, Followed(command), plan, found)
    rows = described(f"{name}, {objective} compensated", ours, found)
    pairs = [
        ("toppra as planned over it, exact model", plain, ours[0], EXACT),
        ("toppra as planned over it, joints alike", plain, ours[1], AT_WORST),
        ("toppra as planned over it, joints apart", plain, ours[2], AT_WORST),
    ]
    for how, theirs in others.items():
        over = f"toppra compensated {how} over it"
        pairs.append((f"{over}, joints alike", theirs[1], ours[1], SAME))
        pairs.append((f"{over}, joints apart", theirs[2], ours[2], SAME))
    for label, above, below, wanted in pairs:
        shown, asked, holds = ratio(above, below, wanted)
        rows.append(Row(f"{name}, {objective}: {label}", shown, "", asked, holds))
    return rows


def described(name: str, found: tuple[np.ndarray, ...], motion: CompensatedMotion) -> list[Row]:
    """Deviations in flight / after arrival, and what the package says of the worst arm."""
    excess = motion.excess[0].describe() if motion.excess else "kept"
    inside = 1e3 * np.array([motion.compensated.flight.worst, motion.compensated.after.worst])
    return [
        Row(f"{name}: exact model", text(found[0])),
        Row(f"{name}: worst arm, joints alike", text(found[1])),
        Row(f"{name}: worst arm, joints apart", text(found[2]), text(inside) + " by the package"),
        Row(f"{name}: motor limits", excess),
    ]


def run() -> list[Row]:
    """Both robots, or those named on the command line."""
    chosen = [name for name in PROBLEMS if name in sys.argv[1:]] or list(PROBLEMS)
    rows = []
    for name in chosen:
        problem = load_problem(FOLDER / PROBLEMS[name]).problem
        rows += rows_of(name, replace(problem, uncertainty=UNSURE))
    return rows


if __name__ == "__main__":
    main(TITLE, run)
