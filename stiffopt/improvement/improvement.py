"""Improvement of a given motion: the same path, motors that lead the links, limits kept.

The motion is judged as it is: limits, tool error of the servo and the elastic arm, residual
vibration. Where it exceeds a limit it is slowed there and only there; with `retime` it is as fast
as its limits allow. The command leads by the wind-up; where it exceeds a limit of the motors, the
plan is backed off there by as much.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.certificate.assess import assess, drive_history
from stiffopt.certificate.collisions import with_collisions
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.command.command_search import CommandOnArms
from stiffopt.command.compensation import commands_on_arms, compensate
from stiffopt.command.simulation import PlannedMotion, elastic_arm
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.simulate import simulate
from stiffopt.errors import NotSimulatedError
from stiffopt.improvement.given_motion import GivenMotion, MotionPiece, moving_pieces
from stiffopt.path.averaged_law import averaged_law
from stiffopt.path.limit_shares import LimitShares
from stiffopt.path.path_timing import PathDemands, fastest_timing
from stiffopt.problem.objective import Objective
from stiffopt.problem.trajectory import Target, TrajectoryProblem
from stiffopt.result.assessment import Assessment, Violation
from stiffopt.result.compensation import Compensation
from stiffopt.result.path_figures import distances_to_path
from stiffopt.result.simulation import SimulatedMotion
from stiffopt.result.trajectory import JointMotion, Trajectory, join_motions
from stiffopt.robot.batched_kinematics import frame_positions

if TYPE_CHECKING:
    from stiffopt.robot.robot import Robot

# Quantities of joints that are compared with their limits, with the SI unit for revolute joints.
JOINT_LIMITS = {"velocity": "rad/s", "acceleration": "rad/s^2", "jerk": "rad/s^3", "torque": "N m"}
# Rounds of backing off until the command keeps the limits of the motors: each takes a part of the
# excess.
_MAX_BACK_OFFS = 14
# Window over which a new timing is averaged, so that motors can lead [s].
_AVERAGING_WINDOW = 0.02

Progress = Callable[[str], object]


@dataclass(frozen=True, kw_only=True)
class LimitUse:
    """Largest value of a joint quantity over a motion, with its limit and instant."""

    joint: int
    quantity: str
    value: float
    limit: float
    time: float

    @property
    def share(self) -> float:
        """Value over the limit."""
        return self.value / self.limit


@dataclass(frozen=True, kw_only=True)
class AssessedMotion:
    """A motion with what limits and the elastic arm say of it."""

    assessment: Assessment
    uses: tuple[LimitUse, ...]  # of every joint and quantity with a limit, the largest share first
    # Motors that follow exactly on the elastic arm, servo alone, and both; None if not simulated.
    elastic: SimulatedMotion | None
    servo: np.ndarray | None
    both: SimulatedMotion | None
    unsimulated: str = ""  # why it was not simulated

    @property
    def exceeded(self) -> tuple[Violation, ...]:
        """Limits that it exceeds, the worst first."""
        return _violations(self.assessment)


@dataclass(frozen=True, kw_only=True)
class Improvement:
    """A given motion and the improved one."""

    # Robot, limits, servo and uncertainty, with the improved motion's ends and duration.
    problem: TrajectoryProblem
    given: AssessedMotion
    improved: AssessedMotion
    plan: Trajectory  # improved motion of the links
    # Command of the motors on nominal and uncertain arms; None for rigid arms.
    compensation: Compensation | None
    path_deviation: float  # largest distance of the improved path from the given one [m]
    retimed: bool  # True where the timing differs from the given one
    margins: dict[str, float]  # largest shares of limits left to the lead of the motors
    notes: tuple[str, ...]
    is_timed_anew: bool = False  # True where the given timing was not asked to be kept

    @property
    def kept(self) -> bool:
        """True where plan and command keep every limit."""
        refused = self.compensation is not None and bool(self.compensation.refusal)
        return not self.improved.exceeded and not refused


def problem_of_motion(
    robot: Robot, motion: JointMotion, settings: TrajectoryProblem | None = None
) -> TrajectoryProblem:
    """Return the statement of a given motion: its ends and duration, and the settings' limits."""
    ends = motion(np.array([0.0, motion.duration]))
    start, end = Target(joints=ends[0]), Target(joints=ends[1])
    duration = (motion.duration, motion.duration)
    objectives = (Objective(name="torque_squared"),)
    if settings is None:
        return TrajectoryProblem(
            robot=robot, start=start, end=end, duration=duration, objectives=objectives
        )
    return replace(
        settings,
        start=start,
        end=end,
        duration=duration,
        objectives=objectives,
        path=None,
        path_force=None,
        vias=(),
        boundary_velocity=None,
        boundary_acceleration="zero",
    )


def improve(
    robot: Robot,
    given: GivenMotion,
    *,
    retime: bool = False,
    settings: TrajectoryProblem | None = None,
    progress: Progress | None = None,
) -> Improvement:
    """Improve a given motion; parameters as of the command.

    Raises `ProblemError`: the path exceeds a limit at rest, or a range of the joints.
    """
    tell = progress or (lambda _: None)
    given, notes = _moving(given)
    problem = problem_of_motion(robot, given, settings)
    tell("given motion")
    before = _assess_motion(problem, given.without_noise)
    pieces, shares = moving_pieces(given), LimitShares(_AVERAGING_WINDOW)
    laws: list[tuple[float, Trajectory]] = []
    plan = given.plan
    if retime or _violations(assess(problem, plan)):
        plan, laws = _retimed(problem, pieces, shares, retime)
    for number in range(_MAX_BACK_OFFS + 1):
        problem = problem_of_motion(robot, plan, problem)
        tell("command of the motors")
        planned = assess(problem, plan)
        led = _command(problem, planned)
        excess = (_violations(planned) if laws else ()) + (() if led is None else led.excess)
        if not excess or number == _MAX_BACK_OFFS:
            break
        if laws:
            motors = [] if led is None else [drive_history(problem, led.motors)[0]]
            shares.back_off(laws, problem.active_limits, [planned, *motors], excess)
        plan, laws = _retimed(problem, pieces, shares, retime)
    improved = _assess_motion(problem, plan, simulated=False)
    return Improvement(
        problem=problem,
        given=before,
        improved=improved,
        plan=plan,
        compensation=None if led is None else _compensation(problem, led),
        path_deviation=_path_deviation(problem, given, plan),
        retimed=bool(laws),
        margins=shares.margins,
        notes=(*problem.remarks, *notes, *_why_not_simulated(before)),
        is_timed_anew=retime,
    )


def _moving(given: GivenMotion) -> tuple[GivenMotion, tuple[str, ...]]:
    """Return the motion without rest before and after it, with a note where there is some."""
    cut, before, after = given.without_rest()
    if not before + after:
        return given, ()
    return cut, (
        f"Rest of {before:.3g} s before and {after:.3g} s after it, in which no joint moves beyond "
        "its noise: left out.",
    )


def _why_not_simulated(given: AssessedMotion) -> tuple[str, ...]:
    why = given.unsimulated
    return (f"Neither tool error nor lead of the motors: {why}",) if why else ()


def _violations(motion: Assessment) -> tuple[Violation, ...]:
    return tuple(v for v in motion.violations if v.value > CERTIFICATE_TOLERANCE)


def _retimed(
    problem: TrajectoryProblem, pieces: list[MotionPiece], shares: LimitShares, retime: bool
) -> tuple[Trajectory, list[tuple[float, Trajectory]]]:
    """Return the motion along the same path, as fast as its limits allow, or as it was.

    And the time law of each piece with the time at which it begins [s].
    """
    force, begin = problem.process_force, 0.0
    parts, laws = [], []
    for number, piece in enumerate(pieces):
        demands = PathDemands(
            path_speed=None if retime else piece.speed,
            process_force=lambda s: np.broadcast_to(force, (len(s), 3)),
            shares=shares.of_piece(number),
        )
        law = fastest_timing(problem.robot, problem.active_limits, piece.path, demands)
        law = averaged_law(law, _AVERAGING_WINDOW)
        parts.append((piece.path.follow(law), piece.dwell))
        laws.append((begin, law))
        begin += law.duration + piece.dwell
    return join_motions(parts), laws


def _assess_motion(
    problem: TrajectoryProblem, motion: JointMotion, *, simulated: bool = True
) -> AssessedMotion:
    found = with_collisions(problem, assess(problem, motion))
    uses = _limit_uses(problem, found)
    rigid = AssessedMotion(assessment=found, uses=uses, elastic=None, servo=None, both=None)
    if not simulated:
        return rigid
    if not problem.robot.yields:
        return replace(rigid, unsimulated=_no_spring(problem.robot))
    try:
        arm = elastic_arm(problem, found.position[0])
        command = MotorMotion.of(motion)
        servo = problem.servo
        both = simulate(arm, command, servo=servo, ahead=servo.dead_time)
        elastic = simulate(arm, command)
        follows = servo.follow(command, float(both.time[-1]), servo.dead_time)
        late = arm.tool(follows.position(both.time)) - arm.tool(command.position(both.time))
    except NotSimulatedError as error:
        return replace(rigid, unsimulated=str(error))
    return AssessedMotion(
        assessment=found,
        uses=uses,
        elastic=elastic,
        servo=np.linalg.norm(late, axis=1),
        both=both,
    )


def _no_spring(robot: Robot) -> str:
    urdf = "its URDF" if robot.urdf is None else robot.urdf.name
    return (
        f"no joint of {robot.name} has a drivetrain. Take a robot file: `stiffopt init robot"
        f" {urdf}` writes one with estimated drivetrains."
    )


def _limit_uses(problem: TrajectoryProblem, motion: Assessment) -> tuple[LimitUse, ...]:
    """Return the largest use of every limit of the joints."""
    found = []
    for quantity in JOINT_LIMITS:
        limits = getattr(problem.active_limits, quantity)
        values = np.abs(getattr(motion, quantity))
        for j in np.flatnonzero(np.isfinite(limits)):
            k = int(np.argmax(values[:, j]))
            found.append(
                LimitUse(
                    joint=int(j) + 1,
                    quantity=quantity,
                    value=float(values[k, j]),
                    limit=float(limits[j]),
                    time=float(motion.time[k]),
                )
            )
    return tuple(sorted(found, key=lambda use: -use.share))


def _command(problem: TrajectoryProblem, planned: Assessment) -> CommandOnArms | None:
    """Return the command of a plan; None for an arm that is rigid or cannot be simulated."""
    if not problem.robot.yields:
        return None
    motion = PlannedMotion.of("optimised", planned, planned.feasible(CERTIFICATE_TOLERANCE))
    try:
        arm = elastic_arm(problem, planned.position[0])
        return commands_on_arms(problem, arm, [motion])[0]
    except NotSimulatedError:
        return None


def _compensation(problem: TrajectoryProblem, led: CommandOnArms) -> Compensation:
    arm = elastic_arm(problem, led.motion.position[0])
    return compensate(problem, arm, [led.motion], known=led)


def _path_deviation(problem: TrajectoryProblem, given: GivenMotion, plan: Trajectory) -> float:
    """Return the largest distance of the tool's given places from the improved path [m]."""
    robot = problem.robot
    time = np.linspace(0.0, plan.duration, max(4001, int(plan.duration / 1e-3)))
    places = frame_positions(robot.tree, robot.tool, plan(time))
    asked = frame_positions(robot.tree, robot.tool, given(np.linspace(0.0, given.duration, 2001)))
    return float(distances_to_path(asked, places).max())
