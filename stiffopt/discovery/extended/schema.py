"""Schema of extended.toml."""

from __future__ import annotations

from pydantic import Field

from stiffopt.files import Section
from stiffopt.recording.schema import Names, NominalSection, PositiveNumbers


class ParameterSection(Section):
    """Reported value of an effect."""

    value: float
    sd: float | None = None
    unit: str = ""


class EffectSection(Section):
    """An effect at a place."""

    name: str
    joint: int | None = None
    link: str | None = None
    run: str | None = None
    probability: float | None = None
    term: dict[str, float]
    parameters: dict[str, ParameterSection] = Field(default_factory=dict)


class ScalesSection(Section):
    """What the terms of effects are measured against."""

    torque_rated: PositiveNumbers
    torque_max: PositiveNumbers
    fastest: PositiveNumbers


class ExtendedFile(Section):
    """A whole extended.toml."""

    schema_: int = Field(alias="schema")
    kind: str
    name: str
    joints: Names = Field(min_length=1)
    links: Names = Field(min_length=1)
    nominal: NominalSection = NominalSection()
    scales: ScalesSection
    calibration: dict[str, float] = Field(default_factory=dict)
    effect: tuple[EffectSection, ...] = ()
