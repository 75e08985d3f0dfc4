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
from stiffopt.elastic import native
from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.simulate import check_reach, simulate, typical_hysteresis
from stiffopt.elastic.uncertainty import AssumedUncertainty
from stiffopt.errors import NotSimulatedError
from stiffopt.interrupts import delivered
from stiffopt.problem.formulation import smoothing_stages
from stiffopt.problem.resolve import resolve
from stiffopt.problem.trajectory import ResolvedMotion
from stiffopt.result.simulation import (
    SETTLING_BAND,
    ElasticMotion,
    PeakRms,
    SimulatedMotion,
    SimulatedPart,
    Simulation,
)
from stiffopt.result.status import SolveStatus
from stiffopt.robot import native_bodies
from stiffopt.solver.compensation import CommandOnArms, compensate
from stiffopt.solver.other_damping import other_damping_note
from stiffopt.solver.solve_run import ProgressCallback, SolveProgress

if TYPE_CHECKING:
    from stiffopt.elastic.motor import Servo
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.assessment import Assessment
    from stiffopt.result.solution import Baseline, Solution
    from stiffopt.result.trajectory import Trajectory

_NOT_ASKED = (
    "No command.csv: no objective or limit is about how the arm yields. State [uncertainty] for a "
    "command that leads the wind-up, judged on uncertain arms."
)


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
    parts = {objective.kind.deflection_part for objective in problem.objectives}
    # What a force or the weight winds a joint up by counts in the other parts.
    if not problem.process_force.any() and parts <= {"", "dynamic"}:
        arm = arm.with_fast_joints_following(start)
    check_reach(arm, start)
    return arm


# Links slower than this are at rest [rad/s].
_STANDSTILL = 1e-6


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
    parts : dict of PeakRms
        Parts of its planned deflection by name, "dynamic" among them [m].
    counted : bool
        Whether it keeps all limits and the problem's duration.
    motors : Trajectory or None
        With what its links are planned to do, where that is planned apart from the motors' motion.
    exceeded : tuple of str
        Names of limits that it does not keep.
    """

    name: str
    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    parts: dict[str, PeakRms]
    counted: bool
    motors: Trajectory | None = None
    exceeded: tuple[str, ...] = ()

    @property
    def link(self) -> Trajectory | None:
        """Motion of the links, where that is planned."""
        return None if self.motors is None else self.motors.link

    @property
    def swings_on(self) -> bool:
        """Whether the links are planned to swing on when the motors stand."""
        link = self.link
        return link is not None and bool(np.any(np.abs(link(link.duration, 1)) > _STANDSTILL))

    @classmethod
    def of(cls, name: str, assessment: Assessment, counted: bool) -> PlannedMotion:
        """From its certificate."""
        return cls(
            name=name,
            time=assessment.time,
            position=assessment.position,
            velocity=assessment.velocity,
            parts=assessment.deflection_summary(),
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
    part = terms[0].kind.deflection_part if len(terms) == 1 else ""
    found = []
    for each in motions:
        command = MotorMotion(each.time, each.position, each.velocity)
        simulated = simulate(arm, command, servo=servo, band=band)
        minimised = None
        if part not in ("", "dynamic"):
            reference = command.position(simulated.time)
            if part == "process":
                reference = simulate(arm.without_force(), command, servo=servo).position
            minimised = _part(arm, part, each.parts[part], simulated, reference)
        found.append(
            ElasticMotion(
                name=each.name,
                planned=each.parts["dynamic"],
                simulated=simulated,
                counted=each.counted,
                minimised=minimised,
            )
        )
    return Simulation(
        motions=tuple(found),
        measure=terms[0].shown_measure if part else "",
        assumed_damping=arm.assumed_damping,
        typical_hysteresis=typical_hysteresis(arm, found[0].simulated.position[-1]),
    )


def _part(
    arm: ElasticArm,
    name: str,
    planned: PeakRms,
    simulated: SimulatedMotion,
    reference: np.ndarray,
) -> SimulatedPart:
    """Way of the tool in flight from where it is with the joints at the reference (K, n)."""
    flight = simulated.time <= simulated.duration
    away = arm.tool(simulated.position[flight]) - arm.tool(reference[flight])
    size, time = np.linalg.norm(away, axis=1), simulated.time[flight]
    rms = float(np.sqrt(np.trapezoid(size**2, time) / time[-1]))
    return SimulatedPart(name=name, planned=planned, simulated=PeakRms(float(size.max()), rms))


def check_simulation(problem: TrajectoryProblem, motion: ResolvedMotion) -> None:
    """Raise `RobotError` where damping or hysteresis is of no joint: before a long solve."""
    stated = (problem.robot.damping, problem.robot.hysteresis)
    if problem.robot.yields:
        native.prepare()
        native_bodies.prepare()
    # What is not stated cannot be wrong.
    if problem.robot.yields and any(
        np.any(np.nan_to_num(each)) for each in stated if each is not None
    ):
        with suppress(NotSimulatedError):
            elastic_arm(problem, motion.start)


def with_simulation(
    problem: TrajectoryProblem,
    solution: Solution,
    progress: ProgressCallback | None = None,
    motion: ResolvedMotion | None = None,
    command: CommandOnArms | None = None,
) -> Solution:
    """The solution with its simulation and its command; a note instead where there are none.

    `motion` are the problem's poses where they are resolved already; `command` is one of the
    solve, which is taken where it is of this solution.
    """
    stopped, assessment = solution.status is SolveStatus.INTERRUPTED, solution.assessment
    if assessment is None or stopped or not problem.robot.yields:
        return solution
    motion = resolve(problem) if motion is None else motion
    if not problem.robot.tool_yields(assessment.position):
        return _noted(solution, "Not simulated: no joint that yields moves the tool.")
    try:
        delivered()
        arm = elastic_arm(problem, assessment.position[0])
        counted = assessment.feasible(CERTIFIED)
        own = PlannedMotion.of("optimised", assessment, counted)
        others = rivals(problem, motion, solution.baselines, solution.strict_baseline)
        if solution.trajectory is not None and solution.trajectory.link is not None:
            own = replace(own, motors=solution.trajectory)
        band = problem.active_limits.settling_band
        simulation = simulate_motions(problem, arm, [own, *others], band=band)
        solution = replace(solution, simulation=simulation)
        unsure = other_damping_note(problem, assessment) if counted else ""
        solution = _noted(solution, unsure) if unsure else solution
        if problem.boundary_velocity is not None and np.any(problem.boundary_velocity):
            return _noted(solution, "No command.csv: the motion does not start and end at rest.")
        if own.swings_on:
            return _noted(
                solution,
                "No command.csv: the links are planned to swing on after arrival, as far as the "
                "limits allow; q of trajectory.csv is the command for that.",
            )
        if not _asks_for_command(problem):
            return _noted(solution, _NOT_ASKED)
        if command is not None and command.motion.motors is not solution.trajectory:
            command = None
        compensation = compensate(
            problem, arm, [own, *others], known=command, progress=_events(progress, solution)
        )
    except KeyboardInterrupt:
        if solution.simulation is not None:
            return _noted(
                solution,
                "The choice of a command was interrupted: no command.csv was made; solve again for "
                "it.",
            )
        return _noted(
            solution,
            "The simulation on the elastic arm was interrupted; `stiffopt simulate` does it anew. "
            "No command.csv was made; solve again for it.",
        )
    except NotSimulatedError as error:
        return _noted(solution, f"Not simulated on the elastic arm: {error}")
    return replace(solution, compensation=compensation)


def _asks_for_command(problem: TrajectoryProblem) -> bool:
    """Whether an objective, a limit or a stated uncertainty is about how the arm yields."""
    return len(smoothing_stages(problem)) > 1 or problem.uncertainty != AssumedUncertainty()


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
