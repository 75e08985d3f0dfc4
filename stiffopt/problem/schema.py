"""Schema of trajectory problem files: keys, units, defaults; optional unless marked."""

from __future__ import annotations

import functools
import typing
from dataclasses import MISSING
from typing import Annotated, Any, Literal

from pydantic import Field, create_model, model_validator

from stiffopt.declaration import (
    NOT_NEGATIVE,
    POSITIVE,
    Angle,
    Bounds,
    Doc,
    Energy,
    Force,
    ForcePerSpeed,
    Inertia,
    JointPosition,
    JointTorque,
    JointVelocity,
    Length,
    Mass,
    Ratio,
    Speed,
    Time,
    declared,
)
from stiffopt.elastic.servo import Servo
from stiffopt.elastic.uncertainty import AssumedUncertainty, Uncertainty
from stiffopt.problem.limit import LIMITS, LimitKey
from stiffopt.problem.objective import OBJECTIVES, Objective
from stiffopt.problem.path_freedom import ErrorDirection, PathFreedom
from stiffopt.problem.trajectory import Method
from stiffopt.robot.cell import Cell
from stiffopt.robot.tolerances import Tolerances
from stiffopt.validation import Section

Vector3 = tuple[Length, Length, Length]
Force3 = tuple[Force, Force, Force]
RollPitchYaw = tuple[Angle, Angle, Angle]


class PayloadSection(Section):
    """Body that is fixed at the flange."""

    mass: Annotated[Mass, Bounds(least=0.0, most=1e5), Doc("Mass.")]
    com: Annotated[Vector3, Doc("Centre of mass in the flange frame.")] = (0.0, 0.0, 0.0)
    inertia: Annotated[
        tuple[Inertia, Inertia, Inertia] | None,
        Doc(
            "Principal inertias about the centre of mass, along the axes of the flange; without it "
            "the payload is a point, which results say."
        ),
    ] = None


class ToolPointSection(Section):
    """Tool point."""

    link: Annotated[str | None, Doc("Link that carries the tool; default the robot's.")] = None
    offset: Annotated[Vector3 | None, Doc("Tool point in the frame of the link.")] = None
    rpy: Annotated[
        RollPitchYaw | None,
        Doc("Fixed-axis roll, pitch, yaw of the tool's axes in the frame of the link."),
    ] = None


class ToolSection(ToolPointSection):
    """Tool point whose deflection is evaluated, and the process force on it."""

    process_force: Annotated[Force3, Doc("Force ON the tool, base frame.")] = (0.0, 0.0, 0.0)


class TargetSection(Section):
    """Joint angles, or a tool position with or without an orientation."""

    joints: Annotated[list[JointPosition] | None, Doc("Joint positions, one a joint.")] = None
    position: Annotated[Vector3 | None, Doc("Position of the tool, base frame.")] = None
    rpy: Annotated[
        RollPitchYaw | None,
        Doc("Fixed-axis roll, pitch, yaw of the tool; without it the orientation is free."),
    ] = None
    near: Annotated[
        list[JointPosition] | None,
        Doc("Joint positions that select the solution of the inverse kinematics."),
    ] = None
    tolerance: Annotated[
        Length | Angle | None,
        POSITIVE,
        Doc("Tolerance of a via point, [m] of a position, [rad] of joints; default 1e-4."),
    ] = None
    angle_tolerance: Annotated[
        Angle, POSITIVE, Doc("Tolerance of the orientation of a via pose.")
    ] = 0.01


# A pose, or the name of one of [[pose]].
NamedTarget = TargetSection | str


class PoseSection(TargetSection):
    """Pose that moves refer to by its name; it is taken in the same joint angles at every visit."""

    name: Annotated[str, Doc("Name of the pose.")]


class MoveSection(Section):
    """Move of a working cycle, from the pose before to its own."""

    to: Annotated[NamedTarget, Doc("End of the move: a pose, or the name of one of [[pose]].")]
    name: Annotated[str, Doc("Name in results; default the pose's name, else the number.")] = ""
    via: Annotated[tuple[NamedTarget, ...], Doc("Via points, passed in order at free times.")] = ()
    stop: Annotated[
        bool | None,
        Doc(
            "False: the arm passes the end within its tolerance, without a stop. Default true, as "
            "dwells, events and changes of speed or force need."
        ),
    ] = None
    dwell: Annotated[
        Annotated[Time, NOT_NEGATIVE] | Literal["settled"],
        Doc(
            "Rest after arrival and event; settled: until the tool stays within "
            "limits.settling_band on the elastic arm."
        ),
    ] = 0.0
    event: Annotated[
        Literal["grip", "release", "tool_change"] | None,
        Doc(
            "Event at arrival: the gripper takes the part `payload`, lets it go, or `payload` and "
            "`tool` replace those of the file."
        ),
    ] = None
    payload: Annotated[
        PayloadSection | None, Doc("Part that is gripped, or body of the new tool.")
    ] = None
    tool: Annotated[ToolPointSection | None, Doc("Tool point after a tool change.")] = None
    speed: Annotated[
        Ratio,
        Bounds(above=0.0, most=1.0),
        Doc("Speed override: factor on the limits of joint velocity and tool speed."),
    ] = 1.0
    process_force: Annotated[
        Force3 | None, Doc("Force ON the tool during the move, base frame; default that of [tool].")
    ] = None


class DurationSection(Section):
    """Duration that is optimised between two bounds."""

    lower: Annotated[Time, POSITIVE, Doc("Least duration.")] = 0.01
    upper: Annotated[Time | None, POSITIVE, Doc("Largest duration; default no bound.")] = None


class BoundaryVelocity(Section):
    """Velocities at both ends."""

    start: Annotated[list[JointVelocity], Doc("At the start, one a joint.")]
    end: Annotated[list[JointVelocity], Doc("At the end, one a joint.")]


class MotionSection(Section):
    """Start and end with via points, a fixed joint path, or the start of a cycle of moves."""

    start: Annotated[NamedTarget | None, Doc("Start of the motion.")] = None
    via: Annotated[tuple[NamedTarget, ...], Doc("Via points, passed in order at free times.")] = ()
    end: Annotated[
        NamedTarget | None, Doc("End of the motion; that of a cycle is its last [[move]].")
    ] = None
    path: Annotated[
        list[list[JointPosition]] | None,
        Doc(
            "Waypoints of a fixed joint path (not-a-knot cubic spline), in place of start, via and "
            "end; only the timing is then free."
        ),
    ] = None
    duration: Annotated[
        Annotated[Time, POSITIVE] | DurationSection,
        Doc("Fixed, or optimised between two bounds; of a cycle with its dwells. Default free."),
    ] = DurationSection()
    error_limit: Annotated[
        Length | None,
        POSITIVE,
        Doc(
            "Of a cycle: largest value of the minimised deflection in any leg; the cycle is then "
            "as short as that allows."
        ),
    ] = None
    boundary_velocity: Annotated[
        Literal["zero"] | BoundaryVelocity, Doc("Velocity at both ends.")
    ] = "zero"
    boundary_acceleration: Annotated[Literal["zero", "free"], Doc("Acceleration at both ends.")] = (
        "zero"
    )

    @model_validator(mode="after")
    def _check_ends(self) -> MotionSection:
        # Without any of them the tool path, [path], defines the motion; a cycle has no end here.
        if self.path is None and (self.end or self.via) and (not self.start or not self.end):
            raise ValueError("give `start` and `end`, or a fixed joint `path`")
        if self.path is not None and (self.start or self.end or self.via):
            raise ValueError("`path` fixes start, end and vias; remove those or the path")
        if self.path is not None and len(self.path) < 2:
            raise ValueError("`path` needs two waypoints or more")
        return self


class PathEndSection(Section):
    """Pose of the tool on its path."""

    position: Annotated[Vector3, Doc("Position of the tool, base frame.")]
    rpy: Annotated[
        RollPitchYaw | None,
        Doc("Fixed-axis roll, pitch, yaw of the tool; default that of the pose before."),
    ] = None


class PathStartSection(PathEndSection):
    """Start of the tool path."""

    rpy: Annotated[RollPitchYaw, Doc("Fixed-axis roll, pitch, yaw of the tool.")]
    near: Annotated[
        list[JointPosition] | None,
        Doc("Joint positions that select the solution of the inverse kinematics."),
    ] = None


class SegmentSection(Section):
    """Segment of the tool path."""

    type: Annotated[
        Literal["lin", "circ", "spline"], Doc("A straight line, an arc, or a spline through `via`.")
    ]
    to: Annotated[PathEndSection, Doc("End pose.")]
    through: Annotated[Vector3 | None, Doc("A point on the arc; `circ` needs it.")] = None
    via: Annotated[tuple[Vector3, ...], Doc("Points of a spline between start and end.")] = ()
    blend: Annotated[
        Length, NOT_NEGATIVE, Doc("Distance from its end at which the rounding begins.")
    ] = 0.0
    speed: Annotated[Speed | None, POSITIVE, Doc("Largest tool speed; default path.speed.")] = None
    stop: Annotated[bool, Doc("Whether the tool rests at its end, which may be a corner.")] = False
    dwell: Annotated[Time, NOT_NEGATIVE, Doc("Rest at a stop.")] = 0.0
    label: Annotated[str, Doc("Name of the segment in messages.")] = ""
    force: Annotated[
        Force3 | None, Doc("Force ON the tool on this segment; default path.force.value.")
    ] = None

    @model_validator(mode="after")
    def _check_arc(self) -> SegmentSection:
        if (self.type == "circ") != (self.through is not None):
            raise ValueError("`through` belongs to a segment of type circ, which needs it")
        if (self.type == "spline") != bool(self.via):
            raise ValueError("`via` belongs to a segment of type spline, which needs it")
        if self.stop and self.blend:
            raise ValueError("a `stop` needs no `blend`: remove one of them")
        if self.dwell and not self.stop:
            raise ValueError("`dwell` belongs to a stop: add stop = true")
        return self


PathSpeedUnit = Literal["m/s", "mm/s", "mm/min", "cm/min"]


class PathTableSection(Section):
    """Poses of a tool path in a CSV file, in place of start and segments.

    Columns x, y, z; optionally rx, ry, rz (or roll, pitch, yaw) or qw, qx, qy, qz; speed on the way
    to the pose; stop (1: the tool rests there); label, which messages name. Others are not read.
    Cells are separated by commas, or by semicolons or tabs with commas in decimals.
    """

    file: Annotated[str, Doc("CSV file beside this file.")]
    length: Annotated[Literal["m", "mm"], Doc("Unit of x, y and z.")] = "m"
    angle: Annotated[Literal["rad", "deg"], Doc("Unit of rx, ry and rz.")] = "rad"
    speed: Annotated[PathSpeedUnit | None, Doc("Unit of speed; default: length per second.")] = None
    rpy: Annotated[
        RollPitchYaw | None, Doc("Orientation of the tool, where the file has none.")
    ] = None
    interpolation: Annotated[
        Literal["spline", "linear"],
        Doc("A spline through the poses, or lines whose corners are blended."),
    ] = "spline"
    blend: Annotated[Length, NOT_NEGATIVE, Doc("Blend of the corners between lines.")] = 0.0


class WorkFrameSection(Section):
    """Frame of the path's poses, on the base or on a positioner."""

    link: Annotated[
        str | None,
        Doc(
            "Link of a positioner that carries the work; poses, speed and force are relative to it "
            "and in its axes. Its joints are a branch of the URDF, each named by a [[joint]]."
        ),
    ] = None
    position: Annotated[Vector3, Doc("Origin, base frame or that of `link`.")] = (0.0, 0.0, 0.0)
    rpy: Annotated[RollPitchYaw, Doc("Fixed-axis roll, pitch, yaw.")] = (0.0, 0.0, 0.0)


class PathForceSection(Section):
    """Process force ON the tool along its path; a table's columns fx, fy, fz [N] replace `value`.

    It is not part of the calibrated pose, as tool.process_force is: the command compensates it.
    """

    value: Annotated[Force3, Doc("Constant part.")] = (0.0, 0.0, 0.0)
    per_feed: Annotated[
        tuple[ForcePerSpeed, ForcePerSpeed, ForcePerSpeed],
        Doc("Part proportional to the tool speed."),
    ] = (0.0, 0.0, 0.0)
    frame: Annotated[
        Literal["base", "tool", "path"],
        Doc("Axes: base, tool, or path (x the feed, z the tool's axis, y the side)."),
    ] = "base"
    ramp: Annotated[
        Length, POSITIVE, Doc("Length over which the force of a segment passes into the next.")
    ] = 2e-3
    deflection_limit: Annotated[
        Length | None,
        POSITIVE,
        Doc("Largest deflection of the nominal arm under the force: kept by the speed."),
    ] = None
    deflection_direction: Annotated[
        ErrorDirection,
        Doc("Direction that is limited: any, along the stated tool axis, or to the side."),
    ] = "any"


class PathSection(Section):
    """A fixed path of the tool, in place of [motion] start, via, end and path."""

    start: Annotated[PathStartSection | None, Doc("Start pose.")] = None
    segment: Annotated[
        tuple[SegmentSection, ...], Doc("Lines, arcs and splines, one after another.")
    ] = ()
    table: Annotated[PathTableSection | None, Doc("Poses from a CSV file instead.")] = None
    frame: Annotated[WorkFrameSection, Doc("Work frame.")] = WorkFrameSection()
    near: Annotated[
        list[JointPosition] | None,
        Doc("Joint positions near those at the start; default any posture for the whole path."),
    ] = None
    force: Annotated[PathForceSection | None, Doc("Process force along the path.")] = None
    freedom: Annotated[PathFreedom | None, Doc("Freedom that the process leaves.")] = None
    speed: Annotated[
        Speed | None,
        POSITIVE,
        Doc("Tool speed: held where limits and the ends allow it, never exceeded."),
    ] = None
    tolerance: Annotated[
        Length,
        POSITIVE,
        Doc("Largest distance of the tool from the path, as the joints follow a spline."),
    ] = 5e-5

    @model_validator(mode="after")
    def _check_source(self) -> PathSection:
        if self.table is None and (self.start is None or not self.segment):
            raise ValueError("give `start` and one segment or more, or a `table` of poses")
        if self.table is not None and (self.start is not None or self.segment):
            raise ValueError("`table` has the whole path; remove `start` and the segments")
        return self


class MinimiseSection(Section):
    """One term of the objective; terms are summed with their weights."""

    objective: str


class LimitsSection(Section):
    """Limits; the robot's own where a key is left out, "none" removes a limit."""

    scale: Section = Section()


class DutySection(Section):
    """Limits of the duty of a cycle, which its moves and the split of its time keep.

    With an error limit or a deflection to minimise, a cycle beyond one is refused instead. The
    fastest motion on a path, repeated without a pause, is slowed as a whole until they hold.
    """

    rms_torque: Annotated[
        list[JointTorque] | None, Doc("Largest rms torque over the cycle, one a joint.")
    ] = None
    mean_torque: Annotated[
        list[JointTorque] | None,
        Doc("Largest mean torque of the reducers by the turns made under it, one a joint."),
    ] = None
    reducer_life: Annotated[
        Time | None, POSITIVE, Doc("Least life L10 of every reducer whose rating is known.")
    ] = None
    energy: Annotated[
        Energy | None, POSITIVE, Doc("Largest work of all drives in a cycle, nothing regenerated.")
    ] = None


class ExpectedSection(Section):
    """Expected value for `stiffopt verify`, with its source."""

    objective: Annotated[float, Doc("Value of the objective, in `unit`.")]
    unit: Annotated[str, Doc("Unit of the value.")]
    rtol: Annotated[Ratio, Bounds(above=0.0, most=0.1), Doc("Allowed relative difference.")] = 1e-4
    source: Annotated[str, Doc("Independent source of the value: never the same run alone.")]


class ProblemFile(Section):
    """Trajectory problem: robot, motion, objective and limits."""

    schema_: Annotated[int, Field(alias="schema"), Doc("Version of the format: 1.")]
    kind: Annotated[Literal["trajectory"], Doc("Kind of file.")]
    title: Annotated[str, Doc("Title of the report; default the name of the file.")] = ""
    robot: Annotated[
        str, Doc("A shipped robot, or the path of a robot file, URDF or MJCF beside this file.")
    ]
    payload: PayloadSection | None = None
    tool: ToolSection = ToolSection()
    motion: MotionSection = MotionSection()
    pose: Annotated[tuple[PoseSection, ...], Doc("Poses that have names.")] = ()
    move: Annotated[
        tuple[MoveSection, ...], Doc("Moves of a working cycle, from motion.start on.")
    ] = ()
    path: PathSection | None = None
    minimise: Annotated[
        list[MinimiseSection] | None,
        Field(min_length=1),
        Doc(
            "Terms of the objective, one or more; default tool_error, the peak of tool_deviation "
            "without a command, or of dynamic_deflection where links cannot be planned."
        ),
    ] = None
    limits: LimitsSection = LimitsSection()
    duty: DutySection = DutySection()
    cell: Annotated[Cell | None, Doc("Obstacles around the arm.")] = None
    method: Method = Method()
    uncertainty: Uncertainty = AssumedUncertainty()
    servo: Servo = Servo(kind="industrial")
    tolerances: Tolerances = Tolerances()
    expected: ExpectedSection | None = None


def problem_file() -> type[ProblemFile]:
    """`ProblemFile` with the objectives and the limits that are registered now."""
    keys = tuple(key for kind in LIMITS.values() for key in kind.keys)
    return _problem_file(tuple(OBJECTIVES), keys)


@functools.cache
def _problem_file(objectives: tuple[str, ...], keys: tuple[LimitKey, ...]) -> type[ProblemFile]:
    names: Any = Literal[objectives]
    kinds = (f"{name}: {OBJECTIVES[name].description}" for name in objectives)
    objective = Field(description="Quantity to minimise. " + " ".join(kinds))
    term: dict[str, Any] = {
        name: (
            field.annotation,
            Field(default_factory=dict) if field.default is MISSING else field.default,
        )
        for name, field in declared(Objective).items()
    }
    minimise: Any = create_model(
        "MinimiseSection",
        __base__=MinimiseSection,
        __doc__=MinimiseSection.__doc__,
        objective=(names, objective),
        **term,
    )
    factors: dict[str, Any] = {
        key.key: (Annotated[Ratio, POSITIVE, Doc(f"Factor on {key.key}.")], 1.0)
        for key in keys
        if key.scaled
    }
    scale = create_model(
        "ScaleSection",
        __base__=Section,
        __doc__="Factors on the robot's own limits.",
        **factors,
    )
    fields: dict[str, Any] = {
        key.key: (key.form, Field(None, description=key.description)) for key in keys
    }
    limits = create_model(
        "LimitsSection",
        __base__=LimitsSection,
        __doc__=LimitsSection.__doc__,
        scale=(scale, scale()),
        **fields,
    )
    docs = typing.get_type_hints(ProblemFile, include_extras=True)["minimise"].__metadata__
    terms: Any = Annotated[list[minimise] | None, *docs]
    return create_model(
        "ProblemFile",
        __base__=ProblemFile,
        __doc__=ProblemFile.__doc__,
        minimise=(terms, None),
        limits=(limits, limits()),
    )
