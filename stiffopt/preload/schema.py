"""Schema of preload study files: keys, units, defaults; optional unless marked."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from stiffopt.declaration import (
    Angle,
    Force,
    JointPosition,
    JointStiffness,
    JointTorque,
    Length,
    Ratio,
    Torque,
)
from stiffopt.files import Section
from stiffopt.problem.schema import PayloadSection, ToolSection, Vector3

JointNumber = Annotated[int, Field(ge=1)]
StiffnessByJoint = dict[int, Annotated[JointStiffness, Field(gt=0)]]

# Keys of a load case of which exactly one says where its torques come from.
_KINDS = ("torque", "trajectory", "joints", "position")


class LoadCaseSection(Section):
    """[[load_case]] (required): joint torques, a solved trajectory, or a pose at rest.

    `torque`: magnitudes, one a joint. `trajectory`: trajectory.csv of a solve, relative to the
    study file. `joints`, or `position` with or without `rpy`: a pose; `near` chooses between the
    solutions of the inverse kinematics. `force` acts ON the tool, base axes; default that of
    [tool].
    """

    name: Annotated[str, Field(min_length=1)]
    torque: list[JointTorque] | None = None
    trajectory: str | None = None
    joints: list[JointPosition] | None = None
    position: Vector3 | None = None
    rpy: tuple[Angle, Angle, Angle] | None = None
    near: list[JointPosition] | None = None
    force: tuple[Force, Force, Force] | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> LoadCaseSection:
        given = [key for key in _KINDS if getattr(self, key) is not None]
        if len(given) != 1:
            raise ValueError(
                "give one of `torque`, `trajectory`, `joints` or `position`, not "
                + (" and ".join(f"`{key}`" for key in given) or "none")
            )
        for key in ("rpy", "near"):
            if getattr(self, key) is not None and self.position is None:
                raise ValueError(f"`{key}` needs a `position` beside it")
        if self.force is not None and self.torque is not None:
            raise ValueError(
                "`force` needs a pose or a `trajectory`: `torque` has the force in it already"
            )
        return self


class TighteningSection(Section):
    """[tightening]: how bolts and pins are tightened; `scatter` is alpha_A = F_max / F_min."""

    method: Literal["torque_wrench", "angle", "yield"] = "torque_wrench"
    scatter: Ratio | None = None
    thread_friction: Ratio = 0.12
    head_friction: Ratio = 0.12
    embedding: Length = 3e-6


class StudyObjectiveSection(Section):
    """[[minimise]] (required, one): joint_stiffness is maximised, min over joints of k / weight."""

    objective: Literal["total_preload", "bolt_utilisation", "joint_stiffness", "tool_deflection"]
    joint_weights: StiffnessByJoint = Field(default_factory=dict)


class RequireSection(Section):
    """[require]: what every design keeps."""

    joint_stiffness: StiffnessByJoint = Field(default_factory=dict)
    tool_deflection: Length | None = None
    slip_safety: Ratio = 1.2
    bolt_utilisation: Ratio = 1.0
    least_preload: Ratio = 0.3


class ChooseSection(Section):
    """[choose]: catalogue to choose from; `torques` of the workshop, default preferred numbers."""

    sizes: list[str] = Field(default_factory=list)
    grades: list[str] = Field(default_factory=list)
    counts: list[int] = Field(default_factory=list)
    torques: list[Torque] = Field(default_factory=list)


class ParetoSection(Section):
    """[pareto]: points of the front between total preload and stiffness; 0 leaves it out."""

    points: Annotated[int, Field(ge=0, le=200)] = 15


class StudyMotionSection(Section):
    """[motion]: a trajectory problem beside the study, optimised together with the preloads.

    `intervals`: in place of the problem's own, since each round solves it anew.
    """

    problem: str
    rounds: Annotated[int, Field(ge=1, le=50)] = 4
    intervals: Annotated[int, Field(ge=4)] | None = None


class ExpectedValueSection(Section):
    """[expected.values.NAME]: a result that `stiffopt verify` compares, and its origin."""

    value: float
    unit: str = ""
    rtol: Annotated[float, Field(gt=0, le=0.1)] = 1e-4
    source: Annotated[str, Field(min_length=1)]


class StudyExpectedSection(Section):
    """[expected]."""

    values: dict[str, ExpectedValueSection] = Field(default_factory=dict)


class PreloadFile(Section):
    """A whole preload study file."""

    schema_: Annotated[int, Field(alias="schema")]
    kind: Literal["preload"]
    title: str = ""
    robot: str
    joints: list[JointNumber] | None = None
    free: list[str] = Field(default_factory=list)
    individual: bool = False
    deflection: Literal["total", "dynamic", "process"] = "total"
    payload: PayloadSection | None = None
    tool: ToolSection = ToolSection()
    load_case: Annotated[list[LoadCaseSection], Field(min_length=1)]
    tightening: TighteningSection = TighteningSection()
    minimise: Annotated[list[StudyObjectiveSection], Field(min_length=1)]
    require: RequireSection = RequireSection()
    choose: ChooseSection | None = None
    pareto: ParetoSection = ParetoSection()
    motion: StudyMotionSection | None = None
    expected: StudyExpectedSection = StudyExpectedSection()

    @model_validator(mode="after")
    def _one_objective(self) -> PreloadFile:
        if len(self.minimise) > 1:
            raise ValueError(
                "a preload study has one [[minimise]]; keep one and put the others under "
                "[require]. The Pareto front of the report shows the trade between them"
            )
        return self
