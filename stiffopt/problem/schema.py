"""Schema of trajectory problem files: keys, units, defaults; optional unless marked."""

from __future__ import annotations

import functools
from typing import Annotated, Any, Literal

from pydantic import Field, create_model, model_validator

from stiffopt.declaration import (
    Angle,
    Force,
    Inertia,
    JointPosition,
    JointVelocity,
    Length,
    Mass,
    Time,
)
from stiffopt.files import Section
from stiffopt.problem.limit import LIMITS, LimitKey
from stiffopt.problem.objective import OBJECTIVES

Vector3 = tuple[Length, Length, Length]
Positive = Annotated[float, Field(gt=0, le=1e15)]


class PayloadSection(Section):
    """[payload]: fixed at the flange; com in the flange frame, principal inertia about the com."""

    mass: Annotated[Mass, Field(ge=0, le=1e5)]
    com: Vector3 = (0.0, 0.0, 0.0)
    inertia: tuple[Inertia, Inertia, Inertia] = (0.0, 0.0, 0.0)


class ToolSection(Section):
    """[tool]: the point whose deflection counts, and the force that acts on it."""

    link: str | None = None
    offset: Vector3 | None = None
    process_force: tuple[Force, Force, Force] = (0.0, 0.0, 0.0)


class TargetSection(Section):
    """A place: joints, or position with or without rpy."""

    joints: list[JointPosition] | None = None
    position: Vector3 | None = None
    rpy: tuple[Angle, Angle, Angle] | None = None
    near: list[JointPosition] | None = None
    tolerance: Length | Angle | None = None
    angle_tolerance: Annotated[Angle, Field(gt=0)] = 0.01

    @model_validator(mode="after")
    def _one_kind(self) -> TargetSection:
        if (self.joints is None) == (self.position is None):
            raise ValueError(
                "give either `joints` or `position` (with `rpy` for a pose), not both, not neither"
            )
        if self.rpy is not None and self.position is None:
            raise ValueError("`rpy` needs a `position` beside it")
        if self.tolerance is not None and not self.tolerance > 0:
            raise ValueError("`tolerance` must be greater than zero")
        return self


class DurationSection(Section):
    """duration = { lower, upper }: optimised between the two; no upper bound if left out."""

    lower: Annotated[Time, Field(gt=0)] = 0.01
    upper: Annotated[Time, Field(gt=0)] | None = None


class BoundaryVelocity(Section):
    """boundary_velocity = { start, end }."""

    start: list[JointVelocity]
    end: list[JointVelocity]


class MotionSection(Section):
    """[motion] (required): start and end with vias between, or a fixed joint path."""

    start: TargetSection | None = None
    via: tuple[TargetSection, ...] = ()
    end: TargetSection | None = None
    path: list[list[JointPosition]] | None = None
    duration: Annotated[Time, Field(gt=0)] | DurationSection
    boundary_velocity: Literal["zero"] | BoundaryVelocity = "zero"
    boundary_acceleration: Literal["zero", "free"] = "zero"

    @model_validator(mode="after")
    def _ends(self) -> MotionSection:
        if self.path is None and (self.start is None or self.end is None):
            raise ValueError("give `start` and `end`, or a fixed joint `path`")
        if self.path is not None and (self.start or self.end or self.via):
            raise ValueError("`path` fixes start, end and vias; remove those or the path")
        return self


class MinimiseSection(Section):
    """[[minimise]] (required): one term of the objective."""

    objective: str
    measure: Literal["peak", "rms"] = "peak"
    weight: Positive = 1.0
    joints: tuple[Annotated[int, Field(ge=1)], ...] = ()
    joint_weights: dict[int, Positive] = Field(default_factory=dict)
    accept_bound: bool = False


class LimitsSection(Section):
    """[limits]: the robot's own where a key is left out; "none" removes a limit."""


class MethodSection(Section):
    """[method]: how to solve."""

    transcription: Literal["piecewise_linear_acceleration", "hermite_simpson", "radau"] = (
        "piecewise_linear_acceleration"
    )
    intervals: Annotated[int, Field(ge=4, le=2000)] = 60
    time_limit: Annotated[Time, Field(gt=0)] = 300.0
    max_iterations: Annotated[int, Field(ge=1)] = 500
    starts: Annotated[int, Field(ge=1, le=1000)] = 1
    tolerance: Annotated[float, Field(gt=0, le=1e-2)] = 1e-8
    seed: int = 1


class ExpectedSection(Section):
    """[expected]: what `stiffopt verify` compares, and where the value comes from."""

    objective: float
    unit: str
    rtol: Annotated[float, Field(gt=0, le=0.1)] = 1e-4
    source: str


class ProblemFile(Section):
    """A whole trajectory problem file."""

    schema_: Annotated[int, Field(alias="schema")]
    kind: Literal["trajectory"]
    title: str = ""
    robot: str
    payload: PayloadSection | None = None
    tool: ToolSection = ToolSection()
    motion: MotionSection
    minimise: Annotated[list[MinimiseSection], Field(min_length=1)]
    limits: LimitsSection = LimitsSection()
    method: MethodSection = MethodSection()
    expected: ExpectedSection | None = None


def problem_file() -> type[ProblemFile]:
    """`ProblemFile` with the objectives and the limits that are registered now."""
    keys = tuple(key for kind in LIMITS.values() for key in kind.keys)
    return _problem_file(tuple(OBJECTIVES), keys)


@functools.cache
def _problem_file(objectives: tuple[str, ...], keys: tuple[LimitKey, ...]) -> type[ProblemFile]:
    names: Any = Literal[objectives]
    kinds = (f"{name}: {OBJECTIVES[name].description}" for name in objectives)
    objective = Field(description="What is minimised. " + " ".join(kinds))
    minimise: Any = create_model(
        "MinimiseSection",
        __base__=MinimiseSection,
        __doc__=MinimiseSection.__doc__,
        objective=(names, objective),
    )
    factors: dict[str, Any] = {
        key.key: (Positive, Field(1.0, description=f"Factor on {key.key} [-]."))
        for key in keys
        if key.scaled
    }
    scale = create_model(
        "ScaleSection",
        __base__=Section,
        __doc__="limits.scale: factors on the robot's own limits.",
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
    terms: Any = Annotated[list[minimise], Field(min_length=1)]
    return create_model(
        "ProblemFile",
        __base__=ProblemFile,
        __doc__=ProblemFile.__doc__,
        minimise=(terms, ...),
        limits=(limits, limits()),
    )
