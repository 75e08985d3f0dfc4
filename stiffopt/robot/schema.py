"""Schema of robot files: the arm, its joints, and the elements of each drivetrain."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from stiffopt.files import Section
from stiffopt.units import (
    Angle,
    Area,
    Force,
    JointAcceleration,
    JointInertia,
    JointJerk,
    JointPosition,
    JointStiffness,
    JointTorque,
    JointVelocity,
    JointViscous,
    Length,
    Pressure,
    Ratio,
    Stiffness,
    Torque,
)

Provenance = Literal["catalogue", "paper", "estimated"]
Vector = tuple[Length, Length, Length]


class Cited(Section):
    """A section that says where its numbers come from.

    `estimated` names single keys that are estimates although the rest of the section is not.
    """

    provenance: Provenance = "estimated"
    source: str = ""
    estimated: tuple[str, ...] = ()


class ElementSection(Cited):
    """What every element of a drivetrain has."""

    name: str
    ratio: Ratio = 1.0
    efficiency: Ratio = 1.0
    parallel: str | None = None


class KeySection(ElementSection):
    """Parallel key; flank heights default to those of DIN 6885 for its width and height."""

    type: Literal["key"]
    shaft_diameter: Length
    width: Length
    height: Length
    length: Length
    shaft_flank_height: Length | None = None
    hub_flank_height: Length | None = None
    flanks: Literal["series", "parallel"] = "series"
    surface: str
    prepressure: Pressure = 0.1e6
    hub_material: str = "steel"


class BoltSection(Section):
    """Bolts of a flange; materials are of the parts under the head and with the thread."""

    size: str
    grade: str = "12.9"
    count: int = Field(gt=0)
    circle_diameter: Length
    clamp_length: Length | None = None
    engagement: Length | None = None
    head_material: str = "steel"
    thread_material: str = "steel"


class FlangeSection(ElementSection):
    """Flange held by bolts; `pattern` takes what is left out from the catalogue."""

    type: Literal["bolted_flange"]
    pattern: str | None = None
    inner_radius: Length | None = None
    outer_radius: Length | None = None
    bolt: BoltSection | None = None
    preload: Force | None = None
    surface: str
    friction: Ratio | None = None


class SetScrewSection(Section):
    """Set screw that presses a tip."""

    size: str
    length: Length | None = None
    shaft_material: str = "hardened_steel"


class PinsSection(ElementSection):
    """Pins or set screws that clamp a shaft."""

    type: Literal["clamping_pins"]
    count: int = Field(gt=0)
    shaft_diameter: Length
    tip_diameter: Length
    preload: Force
    surface: str
    friction: Ratio | None = None
    both_sides: bool = True
    half_space: bool = True
    screw: SetScrewSection | None = None


class BeltSection(ElementSection):
    """Synchronous belt between two pulleys; the first is on the motor's side.

    `profile` names a belt of the catalogue; single values of it may be given instead.
    """

    type: Literal["timing_belt"]
    profile: str
    teeth: int = Field(gt=0)
    teeth_driven: int | None = Field(default=None, gt=0)
    width: Length
    span_length: Length
    wrap: Angle | None = None
    wrap_driven: Angle | None = None
    tooth_height: Length | None = None
    tooth_root_width: Length | None = None
    flank_angle: Angle | None = None
    tooth_modulus: Pressure | None = None
    span_stiffness: Force | None = None
    preload: Force | None = None


class GearSection(ElementSection):
    """Pair of spur gears; the first is on the motor's side."""

    type: Literal["gear_pair"]
    module: Length
    teeth: int = Field(gt=0)
    teeth_driven: int = Field(gt=0)
    face_width: Length
    pressure_angle: Angle = 0.3490658503988659
    contact_ratio: Ratio = 1.5
    surface: str


class ReducerSection(ElementSection):
    """Reducer of the catalogue, or its three slopes and two torques."""

    type: Literal["reducer"]
    catalogue: str | None = None
    K1: Stiffness | None = None
    K2: Stiffness | None = None
    K3: Stiffness | None = None
    T1: Torque | None = None
    T2: Torque | None = None


class ShaftSection(ElementSection):
    """Round shaft."""

    type: Literal["shaft"]
    diameter: Length
    length: Length
    bore: Length = 0.0
    shear_modulus: Pressure = 80e9


class ConstantSection(ElementSection):
    """Spring of constant stiffness."""

    type: Literal["constant"]
    stiffness: JointStiffness


Element = Annotated[
    KeySection
    | FlangeSection
    | PinsSection
    | BeltSection
    | GearSection
    | ReducerSection
    | ShaftSection
    | ConstantSection,
    Field(discriminator="type"),
]


class JointSection(Cited):
    """One joint of the URDF; what is left out comes from there or is without limit."""

    name: str
    torque_max: JointTorque | None = None
    velocity_max: JointVelocity | None = None
    acceleration_max: JointAcceleration | None = None
    jerk_max: JointJerk | None = None
    position_lower: JointPosition | None = None
    position_upper: JointPosition | None = None
    rotor_inertia: JointInertia = 0.0
    coulomb: JointTorque | None = None
    viscous: JointViscous | None = None
    element: tuple[Element, ...] = ()


class MaterialSection(Section):
    """A material given by its numbers."""

    modulus: Pressure
    poisson: Ratio
    hardness: Pressure


class SurfaceSection(Cited):
    """A pair of surfaces that the catalogue does not have; materials by name or by numbers."""

    first: str | MaterialSection
    second: str | MaterialSection
    fractal_dimension: Ratio
    fractal_roughness: Length
    friction: Ratio = 0.15
    reference_area: Area = 1e-4


class AssemblySection(Cited):
    """How the elements make a joint."""

    reflect: bool = True
    contact_law: Literal["log_cubic", "power_law"] = "log_cubic"
    shear: Literal["mindlin", "load"] = "mindlin"


class PlaceSection(Section):
    """A frame fixed to a link."""

    link: str
    offset: Vector = (0.0, 0.0, 0.0)
    rpy: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)


class RobotFile(Section):
    """A whole robot file."""

    schema_: int = Field(alias="schema")
    kind: Literal["robot"]
    name: str
    title: str = ""
    urdf: str | None = None
    tool: PlaceSection | None = None
    flange: PlaceSection | None = None
    assembly: AssemblySection = AssemblySection()
    surface: dict[str, SurfaceSection] = Field(default_factory=dict)
    joint: tuple[JointSection, ...] = ()
