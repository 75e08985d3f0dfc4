"""A solution and its baselines on the elastic arm: the third part of the certificate.

A quintic motion that exceeds a limit is simulated a second time, slowed until it keeps them all; it
is counted where the problem allows that duration.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.baseline.baselines import slowed_quintic
from stiffopt.certificate.violations import CERTIFIED
from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.simulate import check_reach, simulate
from stiffopt.errors import NotSimulatedError
from stiffopt.problem.resolve import ResolvedMotion, resolve
from stiffopt.result.simulation import SETTLING_BAND, ElasticMotion, Simulation

if TYPE_CHECKING:
    from stiffopt.elastic.motor import Servo
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.assessment import Assessment
    from stiffopt.result.solution import Baseline, Solution


def is_elastic(problem: TrajectoryProblem) -> bool:
    """Whether any joint of the problem's robot yields."""
    return any(chain is not None and chain.stages for chain in problem.robot.chains)


def elastic_arm(problem: TrajectoryProblem, start: np.ndarray) -> ElasticArm:
    """The problem's robot as an elastic arm, checked in its start pose (n,) [rad].

    Raises
    ------
    RobotError
        Damping or hysteresis is of no joint.
    NotSimulatedError
        The arm cannot be simulated.
    """
    arm = ElasticArm(problem.robot, start, problem.process_force)
    check_reach(arm, start)
    return arm


def simulate_motions(
    problem: TrajectoryProblem,
    arm: ElasticArm,
    optimised: Assessment,
    counted: bool,
    baselines: dict[str, Baseline],
    motion: ResolvedMotion,
    *,
    servo: Servo | None = None,
    band: float = SETTLING_BAND,
) -> Simulation:
    """Simulate an optimised motion and its baselines.

    Parameters
    ----------
    problem : TrajectoryProblem
    arm : ElasticArm
    optimised : Assessment
    counted : bool
        Whether the optimised motion keeps all limits.
    baselines : dict of Baseline
    motion : ResolvedMotion
        Joint angles of the problem's poses.
    servo : Servo, optional
    band : float
        Within which the tool counts as settled [m].

    Raises
    ------
    NotSimulatedError
        The arm cannot be simulated.
    """
    planned = [("optimised", optimised, counted)]
    for name, baseline in baselines.items():
        if baseline.assessment is not None:
            planned.append((name, baseline.assessment, baseline.feasible))
    quintic = baselines.get("quintic")
    if quintic is not None and not quintic.feasible:
        slowed = slowed_quintic(problem, motion)
        if slowed is not None:
            shortest, longest = problem.duration
            allowed = shortest <= slowed.duration <= longest
            planned.append(("slowed quintic", slowed, allowed))
    terms = problem.objectives
    only = terms[0] if len(terms) == 1 else None
    judged = only is not None and only.kind.deflection_part == "dynamic"
    return Simulation(
        motions=tuple(
            ElasticMotion(
                name=name,
                planned=assessment.deflection_summary()["dynamic"],
                simulated=simulate(
                    arm,
                    MotorMotion(assessment.time, assessment.position, assessment.velocity),
                    servo=servo,
                    band=band,
                ),
                counted=each_counted,
            )
            for name, assessment, each_counted in planned
        ),
        measure=only.shown_measure if judged and only is not None else "",
        assumed_damping=arm.assumed_damping,
    )


def check_simulation(problem: TrajectoryProblem, motion: ResolvedMotion) -> None:
    """Raise `RobotError` where damping or hysteresis is of no joint: before a long solve."""
    if is_elastic(problem):
        with suppress(NotSimulatedError):
            elastic_arm(problem, motion.start)


def with_simulation(problem: TrajectoryProblem, solution: Solution) -> Solution:
    """The solution with its simulation; a note instead where the arm cannot be simulated."""
    if solution.assessment is None or not is_elastic(problem):
        return solution
    motion = resolve(problem)
    try:
        arm = elastic_arm(problem, solution.assessment.position[0])
        counted = solution.assessment.feasible(CERTIFIED)
        simulation = simulate_motions(
            problem, arm, solution.assessment, counted, solution.baselines, motion
        )
    except NotSimulatedError as error:
        note = f"Not simulated on the elastic arm: {error}"
        return replace(solution, notes=(*solution.notes, note))
    return replace(solution, simulation=simulation)
