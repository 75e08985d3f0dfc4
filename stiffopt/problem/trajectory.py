"""Trajectory problems: robot, poses, objectives, limits and solution method."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np

from stiffopt.declaration import POSITIVE, Bounds, Doc, Ratio, Time, check_fields
from stiffopt.elastic.servo import Servo
from stiffopt.elastic.uncertainty import AssumedUncertainty, Uncertainty
from stiffopt.errors import ProblemError
from stiffopt.problem.limit import Limits
from stiffopt.problem.objective import Objective
from stiffopt.result.joint_path import JointPath
from stiffopt.robot.cell import Cell
from stiffopt.robot.tolerances import Tolerances

if TYPE_CHECKING:
    from stiffopt.problem.limit import LimitKind
    from stiffopt.problem.path_force import PathForce
    from stiffopt.result.duty import DutyLimits
    from stiffopt.robot.clearance import ClearanceModel
    from stiffopt.robot.robot import Robot

# Largest distance from the base [m] and range of durations [s]: values beyond are input errors and
# overflow in the solve.
_MAX_POSITION = 1e3
_DURATION_RANGE = (1e-3, 600.0)
# The first that a problem allows is minimised where none is stated.
_DEFAULT_OBJECTIVES = ("tool_error", "tool_deviation", "dynamic_deflection")
_DROPPED_JERK_REMARK = (
    "The robot's own jerk limit is dropped: along a fixed path the acceleration jumps. Give poses "
    "instead of motion.path to keep it."
)


@dataclass(frozen=True, kw_only=True)
class Target:
    """Joint angles, a tool pose, or a tool position.

    Parameters
    ----------
    joints : array (n,) or None [rad]
    position : array (3,) or None [m]
        Tool position, base frame.
    rpy : array (3,) or None [rad]
        Fixed-axis roll, pitch, yaw of the tool; None leaves the orientation free.
    near : array (n,) or None [rad]
        Joint angles that select the solution of the inverse kinematics.
    tolerance : float [m] (a tool position) or [rad] (joints)
        Tolerance of a via point.
    angle_tolerance : float [rad]
        Tolerance of the orientation of a via pose.
    """

    joints: np.ndarray | None = None
    position: np.ndarray | None = None
    rpy: np.ndarray | None = None
    near: np.ndarray | None = None
    tolerance: float = 1e-4
    angle_tolerance: float = 0.01

    @property
    def fixes_pose(self) -> bool:
        """True for joint angles or a tool pose, which leave the joints no freedom."""
        return self.joints is not None or self.rpy is not None

    def __post_init__(self) -> None:
        for name in ("joints", "position", "rpy", "near"):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, np.asarray(value, dtype=float))
        if (self.joints is None) == (self.position is None):
            raise ProblemError(
                "A target needs either `joints` or `position`, not both and not neither; "
                "`rpy` beside `position` makes it a pose."
            )
        if self.rpy is not None and self.position is None:
            raise ProblemError("`rpy` needs a `position` beside it; `joints` fix both.")
        if self.position is not None:
            _check_vector("position", self.position)
            if (
                np.linalg.norm(np.clip(self.position, -_MAX_POSITION, _MAX_POSITION))
                >= _MAX_POSITION
            ):
                raise ProblemError(
                    f"position {np.asarray(self.position).tolist()} m is out of reach of any arm; "
                    f"allowed: less than {_MAX_POSITION:g} m from the base."
                )
        if self.rpy is not None:
            _check_vector("rpy", self.rpy)
        for name in ("tolerance", "angle_tolerance"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ProblemError(f"{name} = {value:g} must be finite and greater than zero.")


@dataclass(frozen=True)
class ResolvedMotion:
    """Joint angles of a problem's poses."""

    # (n,) [rad].
    start: np.ndarray
    end: np.ndarray
    # (n,) [rad] one inverse-kinematics solution each; the optimiser may pass a via in another.
    vias: tuple[np.ndarray, ...]
    # False where only the tool's position is given: the angles are then an initial guess.
    start_fixed: bool
    end_fixed: bool

    @property
    def points(self) -> np.ndarray:
        """Start, vias and end, (k, n)."""
        return np.stack([self.start, *self.vias, self.end])


def _check_vector(name: str, value: np.ndarray) -> None:
    if np.shape(value) != (3,) or not np.all(np.isfinite(value)):
        raise ProblemError(f"{name} must hold 3 finite numbers, got {np.asarray(value).tolist()}.")


def _check_duration(duration: tuple[float, float]) -> None:
    """Raise `ProblemError` unless the range (lower, upper) [s] holds a motion of an arm."""
    lower, upper = duration
    shortest, longest = _DURATION_RANGE
    if not shortest <= lower <= min(upper, longest) or longest < upper < np.inf:
        raise ProblemError(
            f"motion.duration: from lower = {lower:g} s to upper = {upper:g} s cannot be used; "
            f"allowed: {shortest:g} <= lower <= upper <= {longest:g} s, or no upper bound."
        )


@dataclass(frozen=True, kw_only=True)
class Method:
    """Solution method; the defaults suit most problems."""

    transcription: Annotated[
        Literal["piecewise_linear_acceleration", "hermite_simpson", "radau"],
        Doc("Transcription of the motion to a nonlinear programme."),
    ] = "piecewise_linear_acceleration"
    intervals: Annotated[
        int,
        Bounds(least=4, most=2000),
        Doc("Intervals of the whole motion; at least 6 from via to via."),
    ] = 60
    time_limit: Annotated[
        Time,
        POSITIVE,
        Doc(
            "Time after which the best motion so far is returned; its message names the steps left"
            " out."
        ),
    ] = 300.0
    max_iterations: Annotated[
        int,
        Bounds(least=1, most=1_000_000),
        Doc("Largest number of IPOPT iterations of each stage; from 10 phases on, per 10 phases."),
    ] = 500
    starts: Annotated[
        int,
        Bounds(least=1, most=1000),
        Doc("Number of initial guesses; the best certified result wins."),
    ] = 1
    tolerance: Annotated[
        Ratio, Bounds(above=0.0, most=1e-2), Doc("Relative tolerance of IPOPT.")
    ] = 1e-8
    seed: Annotated[int, Bounds(least=0), Doc("Random seed of the further initial guesses.")] = 1
    collisions: Annotated[
        Literal["avoid", "check"],
        Doc("Avoid collisions, or report them only. On a fixed path they are only reported."),
    ] = "avoid"

    def __post_init__(self) -> None:
        check_fields(self, "method", ProblemError)


@dataclass(frozen=True, kw_only=True)
class TrajectoryProblem:
    """A motion to be optimised.

    Parameters
    ----------
    robot : Robot
        Payload and tool already attached.
    vias : tuple of Target
        Passed in order; the time of passing is free.
    path : JointPath, array (k, n) or None [rad]
        Fixed joint path, or its waypoints (not-a-knot cubic spline); only the timing is then free.
    duration : (lower, upper) [s]
        Equal values fix it.
    objectives : tuple of Objective
        Default: the tool error of the commanded arm; without a command the peak tool deviation, and
        where the links cannot be planned the dynamic deflection. `chosen` states which.
    limits : Limits or None
        Default: the robot's own.
    boundary_velocity : (start (n,), end (n,)) [rad/s]
    boundary_acceleration : "zero" or "free"
    path_force : PathForce or None
        Force on the tool along the path, which the command compensates.
    process_force : array (3,) [N]
        Constant force on the tool, base frame, under which poses are calibrated.
    path_choice : dict or None
        Choice of the freedom of a tool path, kept with results.
    duty : DutyLimits or None
        Limits of the duty under repetition of the motion, kept by the timing of a path.
    remarks : tuple of str
        Assumptions for incomplete input, repeated in results.
    uncertainty : Uncertainty
        Ranges of stiffness, damping and payload for which the command is judged. Where stated, it
        also selects among plans of about equal value (`chosen_for_robustness`).
    servo : Servo
        Servo of the motors, whose known lag the command leads.
    tolerances : Tolerances
        Of the geometry, for the error budget; no motion depends on them.
    cell : Cell or None
        Obstacles; None: collisions of the arm with itself, by the shapes of its URDF.
    """

    robot: Robot
    start: Target
    end: Target
    duration: tuple[float, float]
    objectives: tuple[Objective, ...] = ()
    vias: tuple[Target, ...] = ()
    path: JointPath | None = None
    limits: Limits | None = None
    boundary_velocity: tuple[np.ndarray, np.ndarray] | None = None
    boundary_acceleration: str = "zero"
    path_force: PathForce | None = None
    process_force: np.ndarray = field(default_factory=lambda: np.zeros(3))
    method: Method = field(default_factory=Method)
    title: str = ""
    remarks: tuple[str, ...] = ()
    uncertainty: Uncertainty = field(default_factory=AssumedUncertainty)
    servo: Servo = field(default_factory=lambda: Servo(kind="industrial"))
    # Not compared: no motion depends on them.
    tolerances: Tolerances = field(default_factory=Tolerances, compare=False)
    cell: Cell | None = None
    duty: DutyLimits | None = None
    # Not compared: the path follows from it.
    path_choice: dict[str, Any] | None = field(default=None, compare=False, repr=False)
    # Reason for default objectives. No field: it does not change the problem.
    chosen: ClassVar[str] = ""

    def __post_init__(self) -> None:
        _check_duration(self.duration)
        if self.path is not None:
            if not isinstance(self.path, JointPath):
                object.__setattr__(self, "path", self._path_through(self.path))
            if not self.is_timed_on_path:
                self._drop_robot_jerk_limit()
        object.__setattr__(self, "process_force", np.asarray(self.process_force, dtype=float))
        _check_vector("process_force", self.process_force)
        if self.boundary_acceleration not in ("zero", "free"):
            raise ProblemError(
                f"boundary_acceleration = {self.boundary_acceleration!r} is unknown; allowed: "
                "'zero' or 'free'."
            )
        self.uncertainty.shares(self.joints)
        # Refuses an unstable loop.
        self.uncertainty.worst_servo(self.servo)
        if not self.objectives:
            self._choose_objective()
        for number, objective in enumerate(self.objectives, start=1):
            self._check_objective(objective, f"minimise[{number}]")
        if self.duty is not None and not self.is_timed_on_path:
            raise ProblemError(
                "duty: its limits are kept by a cycle of [[move]], or by the timing of a path "
                "whose only objective is the duration. Leave them out, or give such a path."
            )
        for kind in self._arrival_limits:
            name = f"limits.{kind.name}"
            check_link_planning(self, name, f"leave {name} out")
            check_arrival(self, name)

    @property
    def led_servo(self) -> Servo:
        """Servo whose lag commands lead, and whose dead time they are sent ahead."""
        return self.uncertainty.led_servo(self.servo)

    def _path_through(self, waypoints: np.ndarray) -> JointPath:
        """Return the path through waypoints; raise `ProblemError` where they are none."""
        points = np.asarray(waypoints, dtype=float)
        if points.ndim != 2 or points.shape[0] < 4 or points.shape[1] != self.joints:
            raise ProblemError(
                f"motion.path needs at least 4 waypoints of {self.joints} joint angles each, got "
                f"an array of shape {points.shape}."
            )
        return JointPath.through(points)

    @property
    def is_timed_on_path(self) -> bool:
        """True where nothing but the timing of a path is sought, and that the fastest."""
        names = [objective.name for objective in self.objectives]
        return self.path is not None and names == ["duration"]

    @property
    def leads_on_path(self) -> bool:
        """True where motors are to lead the links along a path that is timed."""
        asked = self.path_force is not None or self.uncertainty != AssumedUncertainty()
        eased = self.boundary_acceleration == "zero"
        return self.is_timed_on_path and asked and eased and self.robot.yields

    def _drop_robot_jerk_limit(self) -> None:
        """Drop the robot's own jerk limit on a fixed path, where no other was given."""
        own = Limits.of(self.robot)
        stated = own if self.limits is None else self.limits
        if np.any(np.isfinite(stated.jerk)) and np.array_equal(stated.jerk, own.jerk):
            free = np.full(self.joints, np.inf)
            limits = Limits({**stated.values, "jerk": free})
            object.__setattr__(self, "limits", limits)
            object.__setattr__(self, "remarks", (*self.remarks, _DROPPED_JERK_REMARK))

    def _choose_objective(self) -> None:
        """Choose the default objective."""
        if all(chain is None for chain in self.robot.chains):
            raise ProblemError(
                f"The problem has no objective, and {self.robot.name} has no drivetrain whose "
                "deflection could be the default; add at least one [[minimise]]."
            )
        why = "by default"
        for name in _DEFAULT_OBJECTIVES:
            best = Objective(name=name)
            try:
                best.kind.check(best, self)
            except ProblemError as error:
                why = f"by default: {str(error).rstrip('.')}"
            else:
                break
        object.__setattr__(self, "objectives", (best,))
        object.__setattr__(self, "chosen", f"{best.name} is minimised, {why}.")

    def _check_objective(self, objective: Objective, where: str) -> None:
        for key in ("joints", "joint_weights"):
            for joint in getattr(objective, key):
                if not 1 <= joint <= self.joints:
                    raise ProblemError(
                        f"{where}.{key}: there is no joint {joint}; allowed: 1 to {self.joints}."
                    )
        objective.kind.check(objective, self)

    @property
    def charges_dry_friction(self) -> bool:
        """True where the objective depends on joints' dry friction."""
        depends = any(objective.kind.of_drives for objective in self.objectives)
        return depends and bool(np.any(np.asarray(self.robot.coulomb) > 0.0))

    @property
    def plans_links(self) -> bool:
        """True where the links' motion is planned and the motors lead it by the wind-up."""
        return self.arrives_at_rest or bool(self._arrival_limits)

    @property
    def arrives_at_rest(self) -> bool:
        """True where no residual vibration is allowed; else limits bound it."""
        asked = any(objective.kind.plans_links for objective in self.objectives)
        return asked or self.leads_when_fastest

    @property
    def leads_when_fastest(self) -> bool:
        """True where motors are to lead on a fastest motion, which jumps from limit to limit.

        A stated uncertainty asks for their command.
        """
        fastest = any(objective.name == "duration" for objective in self.objectives)
        asked = fastest and self.uncertainty != AssumedUncertainty()
        if not (asked and self.rests_at_both_ends and self.robot.yields):
            return False
        with suppress(ProblemError):
            check_link_planning(self, "", "")
            return True
        return False

    @property
    def rests_at_both_ends(self) -> bool:
        """True where the velocity is zero at both ends."""
        return self.boundary_velocity is None or not np.any(self.boundary_velocity)

    @property
    def judges_arrival(self) -> bool:
        """True where an objective or a limit refers to residual vibration."""
        asked = any(objective.kind.of_arrival for objective in self.objectives)
        return asked or bool(self._arrival_limits)

    @property
    def judges_uncertain_arms(self) -> bool:
        """True where an objective refers to the tool error of uncertain arms."""
        return any(objective.kind.of_uncertain_arms for objective in self.objectives)

    @property
    def _arrival_limits(self) -> list[LimitKind]:
        return [kind for kind in self.active_limits.kinds if kind.of_arrival]

    @property
    def chosen_for_robustness(self) -> bool:
        """True where uncertain arms decide among plans of about equal value."""
        alone = len(self.objectives) == 1 and self.objectives[0].kind.chosen_for_robustness
        if not (self.uncertainty.stated and alone):
            return False
        # Only a motion from rest to rest of fixed duration has a command whose lead can vary.
        return self.rests_at_both_ends and self.duration[0] == self.duration[1]

    @property
    def is_shaped(self) -> bool:
        """True where the motion is averaged over a period of the lowest elastic mode."""
        return any(objective.kind.shaped for objective in self.objectives)

    @cached_property
    def active_limits(self) -> Limits:
        """Limits of the problem, by default the robot's own."""
        return Limits.of(self.robot) if self.limits is None else self.limits

    @property
    def stated_cell(self) -> Cell:
        """The cell; empty by default."""
        return Cell() if self.cell is None else self.cell

    @property
    def avoids_collisions(self) -> bool:
        """True where collision avoidance is part of the solve."""
        free = self.path is None and self.method.collisions == "avoid"
        return free and bool(self.clearance_model.pairs)

    @cached_property
    def clearance_model(self) -> ClearanceModel:
        """Distances between links and to the cell; cached, as hulls of meshes take time."""
        from stiffopt.robot.clearance import ClearanceModel

        return ClearanceModel(self.robot, self.stated_cell)

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.robot.joint_names)


def check_link_planning(problem: TrajectoryProblem, subject: str, instead: str) -> None:
    """Raise `ProblemError` unless the links' motion can be planned.

    `subject`: objective or limit that plans the links, as users write it: "tool_deviation".
    `instead`: alternative: "minimise 'dynamic_deflection'".
    """
    if problem.path is not None:
        raise ProblemError(
            f"{subject} cannot be combined with motion.path, whose spline has a jump in its third "
            f"derivative: give start, via and end, or {instead}."
        )
    if problem.method.transcription != "piecewise_linear_acceleration":
        raise ProblemError(
            f"{subject} needs the transcription 'piecewise_linear_acceleration', the "
            f"default; leave method.transcription out, or {instead}."
        )


def check_arrival(problem: TrajectoryProblem, subject: str) -> None:
    """Raise `ProblemError` unless the motion ends at rest and the arm is elastic."""
    if problem.boundary_velocity is not None and np.any(problem.boundary_velocity[1]):
        raise ProblemError(
            f"{subject} refers to the arm after arrival, and the motion ends with a velocity: "
            f"leave boundary_velocity.end out, or leave {subject} out."
        )
    if not problem.robot.yields:
        raise ProblemError(
            f"{subject} needs an elastic joint, and {problem.robot.name} has no drivetrain: "
            f"describe the joints' elements in the robot file, or leave {subject} out."
        )
