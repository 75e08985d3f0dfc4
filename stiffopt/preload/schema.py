"""Schema of preload study files: keys, units, defaults; optional unless marked."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from stiffopt.declaration import (
    POSITIVE,
    Bounds,
    Doc,
    Force,
    JointPosition,
    JointStiffness,
    JointTorque,
    Ratio,
    Torque,
)
from stiffopt.fastening.tightening import Tightening
from stiffopt.preload.problem import Choice, Requirements
from stiffopt.problem.schema import Force3, PayloadSection, RollPitchYaw, ToolSection, Vector3
from stiffopt.validation import Section

# Keys of a load case of which exactly one gives the origin of its torques.
_LOAD_SOURCES = ("torque", "trajectory", "joints", "position")
# Optional components of a joint's load beside a given torque.
_LOADS_BESIDE_TORQUE = ("axial_force", "shear_force", "tilting_moment")


class LoadCaseSection(Section):
    """[[load_case]] (required): joint torques, a solved trajectory, or a pose at rest."""

    name: Annotated[str, Field(min_length=1), Doc("Name in results.")]
    torque: Annotated[list[JointTorque] | None, Doc("Magnitudes, one a joint.")] = None
    axial_force: Annotated[
        list[Force] | None, Doc("Beside `torque`: along each joint's axis, magnitudes.")
    ] = None
    shear_force: Annotated[
        list[Force] | None, Doc("Beside `torque`: across each joint's axis, magnitudes.")
    ] = None
    tilting_moment: Annotated[
        list[Torque] | None,
        Doc("Beside `torque`: about axes across each joint's, at its origin, magnitudes."),
    ] = None
    reversing: Annotated[bool, Doc("Beside `torque`: it acts in alternating directions.")] = False
    trajectory: Annotated[
        str | None, Doc("trajectory.csv of a solve, relative to the study file.")
    ] = None
    joints: Annotated[list[JointPosition] | None, Doc("Pose at rest, one a joint.")] = None
    position: Annotated[Vector3 | None, Doc("Place of the tool in a pose at rest.")] = None
    rpy: Annotated[RollPitchYaw | None, Doc("Roll, pitch and yaw of the tool at `position`.")] = (
        None
    )
    near: Annotated[
        list[JointPosition] | None,
        Doc("Chooses between the solutions of the inverse kinematics for `position`."),
    ] = None
    force: Annotated[Force3 | None, Doc("Acts ON the tool, base axes; default that of [tool].")] = (
        None
    )

    @model_validator(mode="after")
    def _one_kind(self) -> LoadCaseSection:
        given = [key for key in _LOAD_SOURCES if getattr(self, key) is not None]
        if len(given) != 1:
            raise ValueError(
                "give one of `torque`, `trajectory`, `joints` or `position`, not "
                + (" and ".join(f"`{key}`" for key in given) or "none")
            )
        for key in (*_LOADS_BESIDE_TORQUE, "reversing"):
            if getattr(self, key) and self.torque is None:
                raise ValueError(
                    f"`{key}` needs a `torque` beside it: a pose or a trajectory determines it"
                )
        for key in ("rpy", "near"):
            if getattr(self, key) is not None and self.position is None:
                raise ValueError(f"`{key}` needs a `position` beside it")
        if self.force is not None and self.torque is not None:
            raise ValueError(
                "`force` needs a pose or a `trajectory`: `torque` includes the force already"
            )
        return self


class StudyObjectiveSection(Section):
    """[[minimise]] (required, one): objective of the preloads."""

    objective: Annotated[
        Literal["total_preload", "bolt_utilisation", "joint_stiffness", "tool_deflection"],
        Doc("joint_stiffness is maximised: the least over the joints of stiffness over weight."),
    ]
    joint_weights: Annotated[
        dict[int, JointStiffness],
        POSITIVE,
        Doc("For joint_stiffness, by joint number; default the stiffness at the largest preloads."),
    ] = Field(default_factory=dict)


class ParetoSection(Section):
    """[pareto]: front between total preload and stiffness."""

    points: Annotated[
        int, Bounds(least=0, most=200), Doc("Points of the front; 0 leaves it out.")
    ] = 15


class StudyMotionSection(Section):
    """[motion]: a trajectory problem, optimised together with the preloads."""

    problem: Annotated[str, Doc("Trajectory problem file, relative to the study file.")]
    rounds: Annotated[int, Bounds(least=1, most=50), Doc("Largest number of alternations.")] = 4
    intervals: Annotated[
        int | None,
        Bounds(least=4),
        Doc("Mesh intervals in place of the problem's, since every round solves it."),
    ] = None


class ExpectedValueSection(Section):
    """[expected.values.NAME]: expected result of `stiffopt verify`, with its origin."""

    value: Annotated[float, Doc("Expected value, in `unit`.")]
    unit: Annotated[str, Doc("Unit of the value; default none.")] = ""
    rtol: Annotated[Ratio, Bounds(above=0.0, most=0.1), Doc("Relative tolerance.")] = 1e-4
    source: Annotated[str, Field(min_length=1), Doc("Origin of the value.")]


class StudyExpectedSection(Section):
    """[expected]."""

    values: Annotated[
        dict[str, ExpectedValueSection], Doc("Expected results, by the names of study.json.")
    ] = Field(default_factory=dict)


class PreloadFile(Section):
    """A whole preload study file."""

    schema_: Annotated[int, Field(alias="schema"), Doc("Version of the file format, 1.")]
    kind: Annotated[Literal["preload"], Doc("Kind of file.")]
    title: Annotated[str, Doc("Heading of the report; default the file's name.")] = ""
    robot: Annotated[str, Doc("A robot's name, or a robot file relative to the study file.")]
    joints: Annotated[
        list[int] | None, Bounds(least=1), Doc("Joint numbers; default all with a drivetrain.")
    ] = None
    free: Annotated[
        tuple[str, ...],
        Doc("Elements with free preload; default all bolts and pins of the joints."),
    ] = ()
    individual: Annotated[
        bool, Doc("One preload per bolt or pin instead of one per connection.")
    ] = False
    deflection: Annotated[
        Literal["total", "dynamic", "process"],
        Doc(
            "Wind-up that counts as tool deflection: total, dynamic (less the sag at rest) or "
            "process (by the process force only)."
        ),
    ] = "total"
    payload: Annotated[PayloadSection | None, Doc("Load at the flange.")] = None
    tool: Annotated[ToolSection, Doc("Tool point and process force.")] = ToolSection()
    load_case: Annotated[list[LoadCaseSection], Field(min_length=1), Doc("Loads of the design.")]
    tightening: Annotated[Tightening, Doc("Tightening of bolts and pins.")] = Tightening()
    minimise: Annotated[
        list[StudyObjectiveSection], Field(min_length=1), Doc("The objective, exactly one.")
    ]
    require: Annotated[Requirements, Doc("Requirements on every design.")] = Requirements()
    choose: Annotated[Choice | None, Doc("Catalogue of bolts.")] = None
    pareto: Annotated[ParetoSection, Doc("Pareto front.")] = ParetoSection()
    motion: Annotated[
        StudyMotionSection | None, Doc("Motion optimised together with the preloads.")
    ] = None
    expected: Annotated[StudyExpectedSection, Doc("Expected results of a verification.")] = (
        StudyExpectedSection()
    )

    @model_validator(mode="after")
    def _one_objective(self) -> PreloadFile:
        if len(self.minimise) > 1:
            raise ValueError(
                "a preload study has one [[minimise]]; keep one and put the others under "
                "[require]. The Pareto front of the report shows the trade between them"
            )
        return self
