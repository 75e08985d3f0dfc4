"""Elastic simulation of a solution and its rivals, with its sensitivity to assumed damping."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.baseline.rivals import FairRival, fair_rivals
from stiffopt.certificate.assess import assess
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.simulate import check_reach, simulate, typical_hysteresis
from stiffopt.errors import NotSimulatedError, format_relative
from stiffopt.problem.limit import LIMITS
from stiffopt.problem.trajectory import ResolvedMotion
from stiffopt.result.simulation import (
    SETTLING_BAND,
    ElasticMotion,
    PeakRms,
    SimulatedMotion,
    SimulatedPart,
    Simulation,
)

if TYPE_CHECKING:
    from stiffopt.elastic.servo import Servo
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.assessment import Assessment
    from stiffopt.result.trajectory import JointMotion, Trajectory

# Factors on the assumed damping of 2 % of critical: 1 and 3 %.
_DAMPING_FACTORS = (0.5, 1.5)
# Rounding of a duration.
_DURATION_SLACK = 1.0 + 1e-9
# Links slower than this are at rest [rad/s].
_STANDSTILL_SPEED = 1e-6


def elastic_arm(problem: TrajectoryProblem, start: np.ndarray) -> ElasticArm:
    """Return the problem's robot as an elastic arm, checked in its start pose (n,) [rad].

    Raises `RobotError` for unphysical damping or hysteresis, `NotSimulatedError` for an arm that
    cannot be simulated.
    """
    arm = ElasticArm(problem.robot, start, problem.process_force)
    parts = {objective.kind.deflection_part for objective in problem.objectives}
    # The other parts of the deflection include the wind-up of all joints under weight and force.
    if not problem.process_force.any() and parts <= {"", "dynamic"}:
        arm = arm.with_fast_joints_following(start)
    check_reach(arm, start)
    return arm


@dataclass(frozen=True, kw_only=True)
class PlannedMotion:
    """Motion to be simulated."""

    name: str
    time: np.ndarray  # (K,) from 0 [s]
    # (K, n) [rad], [rad/s].
    position: np.ndarray
    velocity: np.ndarray
    parts: dict[str, PeakRms]  # parts of its planned deflection by name, "dynamic" among them [m]
    counted: bool  # True where it keeps all limits and the problem's duration
    motors: Trajectory | None = None  # where the motors lead the planned path, as planned
    # Planned motion of the links of a stored motion whose motors lead it.
    path: JointMotion | None = None
    exceeded: tuple[str, ...] = ()  # names of limits that it exceeds
    at: Callable[[float], Trajectory] | None = None  # motion of the links at a duration [s]

    @cached_property
    def followed(self) -> MotorMotion:
        """Motion of motors that follow the plan."""
        return MotorMotion(self.time, self.position, self.velocity)

    @cached_property
    def planned_path(self) -> MotorMotion:
        """Planned motion of the links, from which the tool error is measured."""
        return self.followed if self.link is None else MotorMotion.of(self.link)

    @property
    def link(self) -> JointMotion | None:
        """Planned motion of the links, None where the motors follow the plan."""
        return self.path if self.motors is None else self.motors.link

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return float(self.time[-1])

    @property
    def vibrates_after_arrival(self) -> bool:
        """True where the plan has residual vibration of the links after the motors' arrival."""
        if self.link is None:
            return False
        end = self.link(np.array([self.link.duration]), 1)
        return bool(np.any(np.abs(end) > _STANDSTILL_SPEED))

    @classmethod
    def of_rival(cls, rival: FairRival, assessment: Assessment, counted: bool) -> PlannedMotion:
        """Make the motion of a rival, which can be slowed."""
        return replace(cls.of(rival.name, assessment, counted), at=rival.at)

    def slowed_to(self, problem: TrajectoryProblem, duration: float) -> PlannedMotion:
        """Return the motion at a longer duration [s]."""
        assert self.at is not None
        assessment = assess(problem, self.at(duration))
        counted = assessment.duration <= problem.duration[1] * _DURATION_SLACK
        return replace(PlannedMotion.of(self.name, assessment, counted), at=self.at)

    @classmethod
    def of_solution(
        cls, assessment: Assessment, trajectory: Trajectory | None, counted: bool = True
    ) -> PlannedMotion:
        """Make the motion of a solve, whose motors lead the links where it plans these."""
        own = cls.of("optimised", assessment, counted)
        if trajectory is None:
            return own
        if trajectory.link is None:
            return replace(own, at=trajectory.scaled_to)
        return replace(own, motors=trajectory, at=trajectory.link.scaled_to)

    @classmethod
    def of(cls, name: str, assessment: Assessment, counted: bool) -> PlannedMotion:
        """Make the motion from its certificate."""
        return cls(
            name=name,
            time=assessment.time,
            position=assessment.position,
            velocity=assessment.velocity,
            parts=assessment.deflection_summary() | {"forced": _forced_deflection(assessment)},
            counted=counted,
            exceeded=tuple(
                v.limit for v in assessment.violations if v.value > CERTIFICATE_TOLERANCE
            ),
        )


def _planned_part(arm: ElasticArm, motion: PlannedMotion) -> PeakRms:
    """Return the planned deflection that a simulation on the arm is compared with [m]."""
    name = "dynamic" if arm.path_force is None else "forced"
    return motion.parts.get(name, motion.parts["dynamic"])


def _forced_deflection(motion: Assessment) -> PeakRms:
    """Return the deflection by motion and force, which a command compensates together [m]."""
    square = np.sum((motion.deflection["dynamic"] + motion.deflection["process"]) ** 2, axis=1)
    mean = np.trapezoid(square, motion.time) / motion.duration
    return PeakRms(float(np.sqrt(square.max())), float(np.sqrt(mean)))


def rival_motions(
    problem: TrajectoryProblem, motion: ResolvedMotion, duration: float
) -> list[PlannedMotion]:
    """Return the rivals that keep every limit, of the optimised duration [s] or slowed.

    Where the duration is minimised they are as fast as their limits allow.
    """
    if problem.path_force is not None:
        # Their forces would be those of other places of the path.
        return []
    shortest, longest = problem.duration
    # A fixed duration is that of the other comparisons, to the last digit.
    stated = shortest == longest or any(each.name == "duration" for each in problem.objectives)
    return [
        PlannedMotion.of_rival(rival, assessment, assessment.duration <= longest * _DURATION_SLACK)
        for rival, assessment in fair_rivals(problem, motion, shortest if stated else duration)
    ]


def simulate_motions(
    problem: TrajectoryProblem,
    arm: ElasticArm,
    motions: Sequence[PlannedMotion],
    *,
    servo: Servo | None = None,
    band: float = SETTLING_BAND,
) -> Simulation:
    """Simulate motions of a problem, the optimised one first, with a settling band [m].

    `servo` defaults to the problem's, whose known dead time all motions are sent ahead. Raises
    `NotSimulatedError`.
    """
    terms = problem.objectives
    part = terms[0].kind.deflection_part if len(terms) == 1 else ""
    found, servo, ahead = [], servo or problem.servo, problem.led_servo.dead_time
    for each in motions:
        command, plan = each.followed, each.planned_path
        simulated = simulate(arm, command, servo=servo, ahead=ahead, band=band, plan=plan)
        minimised = None
        if part:
            same = simulated if servo.follows_exactly else simulate(arm, command)
            minimised = _part_of(arm, part, each, same)
        found.append(
            ElasticMotion(
                name=each.name,
                planned=_planned_part(arm, each),
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


def _part_of(
    arm: ElasticArm, name: str, motion: PlannedMotion, simulated: SimulatedMotion
) -> SimulatedPart:
    """Return a part of the tool's deflection against the motors in flight, as objectives have it.

    `simulated` is of motors that follow exactly. The dynamic part is less the sag, that of the
    process less the motion without it.
    """
    command = motion.followed
    flight = simulated.time <= command.duration
    time = simulated.time[flight]
    unloaded = command.position(time)
    if name == "dynamic":
        unloaded = arm.static_equilibrium(unloaded)
    elif name == "process":
        unloaded = simulate(arm.without_force(), command).position[flight]
    size = np.linalg.norm(arm.tool(simulated.position[flight]) - arm.tool(unloaded), axis=1)
    rms = float(np.sqrt(np.trapezoid(size**2, time) / time[-1]))
    found = PeakRms(float(size.max()), rms)
    return SimulatedPart(name=name, planned=motion.parts[name], simulated=found)


def check_simulation(problem: TrajectoryProblem, motion: ResolvedMotion) -> None:
    """Raise `RobotError` before a long solve where damping or hysteresis is not physical."""
    stated = (problem.robot.damping, problem.robot.hysteresis)
    # Defaults need no check.
    if problem.robot.yields and any(
        np.any(np.nan_to_num(each)) for each in stated if each is not None
    ):
        with suppress(NotSimulatedError):
            elastic_arm(problem, motion.start)


def damping_sensitive_limits(problem: TrajectoryProblem, motion: Assessment) -> dict[str, float]:
    """Return the limits after arrival that arms of other damping exceed, with the overshoot.

    Empty where the problem has none, or every joint states its damping. No motion is slowed for
    that (decision 0027): a note reports it. Raises `NotSimulatedError`.
    """
    if motion.simulated is None or motion.simulated.peak_after is None:
        return {}
    limits = problem.active_limits
    kinds = [each for each in limits.kinds if LIMITS[each.name].of_arrival]
    arm = ElasticArm(problem.robot, motion.position[0], problem.process_force)
    if not (kinds and arm.assumed_damping):
        return {}
    command = MotorMotion(motion.time, motion.position, motion.velocity)
    found: dict[str, float] = {}
    for factor in _DAMPING_FACTORS:
        swing = simulate(arm.scale_assumed_damping(factor), command, band=limits.settling_band)
        for kind in kinds:
            over = LIMITS[kind.name].overshoot(limits, swing)
            if over > max(found.get(kind.name, 0.0), 0.0):
                found[kind.name] = over
    return found


def damping_sensitivity_note(problem: TrajectoryProblem, motion: Assessment) -> str:
    """Return a note on limits that hold only with the assumed damping; "" where all hold."""
    found = damping_sensitive_limits(problem, motion)
    if not found:
        return ""
    listed = " and ".join(f"{name} by {format_relative(over)}" for name, over in found.items())
    return (
        "Limits after arrival hold with the assumed damping. With 0.5 or 1.5 times of it the "
        f"residual vibration exceeds {listed}: state the joints' measured damping in the robot "
        "file, or a lower limit."
    )
