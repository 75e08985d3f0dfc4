"""A solution and its baselines on the elastic arm: the third part of the certificate.

A quintic motion that exceeds a limit is simulated a second time, slowed until it keeps them all; it
is counted where the problem allows that duration.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
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
from stiffopt.result.status import SolveStatus
from stiffopt.solver.compensation import compensate
from stiffopt.solver.stages import ProgressCallback, SolveProgress

if TYPE_CHECKING:
    from stiffopt.elastic.motor import Servo
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.assessment import Assessment, PeakRms
    from stiffopt.result.solution import Baseline, Solution
    from stiffopt.result.trajectory import Trajectory


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


@dataclass(frozen=True, kw_only=True)
class PlannedMotion:
    """A motion to be simulated.

    Parameters
    ----------
    name : str
    time : array (K,)
        From 0 [s].
    position, velocity : array (K, n)
        [rad], [rad/s].
    planned : PeakRms
        Its quasi-static dynamic deflection [m].
    counted : bool
        Whether it keeps all limits and the problem's duration.
    link : Trajectory or None
        What the links are planned to do, where that is planned apart from the motors' motion.
    exceeded : tuple of str
        Names of limits that it does not keep.
    """

    name: str
    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    planned: PeakRms
    counted: bool
    link: Trajectory | None = None
    exceeded: tuple[str, ...] = ()

    @classmethod
    def of(cls, name: str, assessment: Assessment, counted: bool) -> PlannedMotion:
        """From its certificate."""
        return cls(
            name=name,
            time=assessment.time,
            position=assessment.position,
            velocity=assessment.velocity,
            planned=assessment.deflection_summary()["dynamic"],
            counted=counted,
            exceeded=tuple(v.limit for v in assessment.violations if v.value > CERTIFIED),
        )


def rivals(
    problem: TrajectoryProblem,
    motion: ResolvedMotion,
    baselines: dict[str, Baseline],
    strict: Baseline | None = None,
) -> list[PlannedMotion]:
    """The baselines that exist; the quintic one also slowed where it exceeds a limit.

    `strict` is the slowed one where it is known already.
    """
    found = [
        PlannedMotion.of(name, baseline.assessment, baseline.feasible)
        for name, baseline in baselines.items()
        if baseline.assessment is not None
    ]
    quintic = baselines.get("quintic")
    if quintic is not None and not quintic.feasible:
        known = strict is not None and strict.name == "slowed quintic"
        slowed = strict.assessment if strict and known else slowed_quintic(problem, motion)
        if slowed is not None:
            shortest, longest = problem.duration
            allowed = shortest <= slowed.duration <= longest
            found.append(PlannedMotion.of("slowed quintic", slowed, allowed))
    return found


def simulate_motions(
    problem: TrajectoryProblem,
    arm: ElasticArm,
    motions: Sequence[PlannedMotion],
    *,
    servo: Servo | None = None,
    band: float = SETTLING_BAND,
) -> Simulation:
    """Simulate motions of a problem, the optimised one first.

    Parameters
    ----------
    problem : TrajectoryProblem
    arm : ElasticArm
    motions : sequence of PlannedMotion
    servo : Servo, optional
    band : float
        Within which the tool counts as settled [m].

    Raises
    ------
    NotSimulatedError
        The arm cannot be simulated.
    """
    terms = problem.objectives
    judged = len(terms) == 1 and terms[0].kind.deflection_part == "dynamic"
    return Simulation(
        motions=tuple(
            ElasticMotion(
                name=each.name,
                planned=each.planned,
                simulated=simulate(
                    arm,
                    MotorMotion(each.time, each.position, each.velocity),
                    servo=servo,
                    band=band,
                ),
                counted=each.counted,
            )
            for each in motions
        ),
        measure=terms[0].shown_measure if judged else "",
        assumed_damping=arm.assumed_damping,
    )


def check_simulation(problem: TrajectoryProblem, motion: ResolvedMotion) -> None:
    """Raise `RobotError` where damping or hysteresis is of no joint: before a long solve."""
    if is_elastic(problem):
        with suppress(NotSimulatedError):
            elastic_arm(problem, motion.start)


def with_simulation(
    problem: TrajectoryProblem, solution: Solution, progress: ProgressCallback | None = None
) -> Solution:
    """The solution with its simulation and its command; a note instead where there are none."""
    stopped = solution.status is SolveStatus.INTERRUPTED
    if solution.assessment is None or stopped or not is_elastic(problem):
        return solution
    motion = resolve(problem)
    try:
        arm = elastic_arm(problem, solution.assessment.position[0])
        counted = solution.assessment.feasible(CERTIFIED)
        own = PlannedMotion.of("optimised", solution.assessment, counted)
        others = rivals(problem, motion, solution.baselines, solution.strict_baseline)
        if solution.trajectory is not None:
            own = replace(own, link=solution.trajectory.link)
        simulation = simulate_motions(problem, arm, [own, *others])
        solution = replace(solution, simulation=simulation)
        if problem.boundary_velocity is not None and np.any(problem.boundary_velocity):
            return _noted(solution, "No command.csv: the motion does not start and end at rest.")
        compensation = compensate(
            problem, arm, [own, *others], progress=_events(progress, solution)
        )
    except KeyboardInterrupt:
        return _noted(
            solution,
            "The simulation on the elastic arm was interrupted; `stiffopt simulate` does it anew.",
        )
    except NotSimulatedError as error:
        return _noted(solution, f"Not simulated on the elastic arm: {error}")
    return replace(solution, compensation=compensation)


def _noted(solution: Solution, note: str) -> Solution:
    return replace(solution, notes=(*solution.notes, note))


def _events(progress: ProgressCallback | None, solution: Solution) -> Callable[[str], object]:
    """Tells a solve's display which motion is being compensated."""
    begun, value = time.perf_counter(), getattr(solution.objective, "value", np.nan)
    numbers = itertools.count(1)

    def tell(name: str) -> None:
        if progress is not None:
            progress(
                SolveProgress(
                    stage=f"{name} motion on uncertain arms",
                    iteration=next(numbers),
                    objective=value,
                    violation=0.0,
                    row="",
                    elapsed=time.perf_counter() - begun,
                )
            )

    return tell
