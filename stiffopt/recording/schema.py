"""Schema of recordings.toml and static.toml."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from stiffopt.files import Section

Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
Numbers = tuple[float, ...]
PositiveNumbers = tuple[Positive, ...]
NotNegativeNumbers = tuple[NotNegative, ...]
Names = tuple[str, ...]


class SignalsSection(Section):
    """Columns of the run files."""

    time: str = ""
    position: Names
    velocity: Names | None = None
    link_position: Names | None = None
    torque: Names
    torque_side: Literal["motor", "link"] | None = None


class ReducerCurvesSection(Section):
    """Catalogue curve of each reducer; infinite is rigid."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=True)

    K1: PositiveNumbers
    K2: PositiveNumbers
    K3: PositiveNumbers
    T1: PositiveNumbers
    T2: PositiveNumbers


class SpringSection(Section):
    """Spring that balances a joint."""

    type: Literal["spring"]
    joint: int | str
    stiffness: float
    offset: float = 0.0


class TableSection(Section):
    """Torque that balances a joint, by its angle."""

    type: Literal["table"]
    joint: int | str
    angle: Numbers
    torque: Numbers


CounterbalanceSection = Annotated[SpringSection | TableSection, Field(discriminator="type")]


class NominalSection(Section):
    """What today's simulation knows."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=True)

    gear_ratio: Numbers | None = None
    rotor_inertia: NotNegativeNumbers | None = None
    coulomb: NotNegativeNumbers | None = None
    viscous: NotNegativeNumbers | None = None
    friction_temperature: float | None = None
    torque_max: PositiveNumbers | None = None
    torque_rated: PositiveNumbers | None = None
    pole_pairs: Positive | None = None
    joint_damping: NotNegativeNumbers | None = None
    contact_stiffness: PositiveNumbers | None = None
    connections: Names | None = None
    reducer: ReducerCurvesSection | None = None
    counterbalance: CounterbalanceSection | tuple[CounterbalanceSection, ...] = ()


class ToleranceSection(Section):
    """One standard deviation of the nominal values."""

    mass: NotNegative | None = None
    com: NotNegative | None = None
    rotor_inertia: NotNegative | None = None
    coulomb: NotNegative | None = None
    viscous: NotNegative | None = None
    stiffness: NotNegative | None = None
    torque_constant: NotNegative | None = None
    encoder_zero: NotNegative | None = None


class NoiseSection(Section):
    """One standard deviation of the sensors' noise; one number holds for all joints."""

    torque: NotNegative | NotNegativeNumbers | None = None
    velocity: NotNegative | NotNegativeNumbers | None = None
    link_position: NotNegative | NotNegativeNumbers | None = None
    position_resolution: NotNegative | NotNegativeNumbers | None = None
    link_position_resolution: NotNegative | NotNegativeNumbers | None = None


class RunSection(Section):
    """One run file."""

    file: str = Field(min_length=1)
    role: Literal["train", "test", "extrapolate"]
    session_time: float | None = None
    housing_temperature: float | Numbers | None = None


class RecordingsFile(Section):
    """A whole recordings.toml."""

    schema_: int = Field(alias="schema")
    name: str = Field(min_length=1)
    title: str = ""
    citation: str = ""
    licence: str = ""
    robot: str = Field(min_length=1)
    joints: Names = Field(min_length=1)
    tool_frame: str | None = None
    gravity: tuple[float, float, float] | None = None
    signals: SignalsSection
    nominal: NominalSection = NominalSection()
    tolerance: ToleranceSection = ToleranceSection()
    noise: NoiseSection = NoiseSection()
    runs: tuple[RunSection, ...] = Field(min_length=1)


class StaticNominalSection(Section):
    """What is known of the joints' stiffness."""

    stiffness: PositiveNumbers | None = None


class StaticFile(Section):
    """A whole static.toml."""

    schema_: int = Field(alias="schema")
    kind: Literal["static"]
    name: str = Field(min_length=1)
    title: str = ""
    citation: str = ""
    licence: str = ""
    robot: str = Field(min_length=1)
    joints: Names = Field(min_length=1)
    tool_frame: str
    poses: str = Field(min_length=1)
    position: Names
    force: tuple[str, str, str]
    displacement: tuple[str, str, str]
    difference: bool
    gravity: tuple[float, float, float] | None = None
    nominal: StaticNominalSection = StaticNominalSection()
