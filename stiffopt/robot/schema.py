"""Schema of robot files: the arm, its joints, and the elements of each drivetrain.

An element's keys are the declared fields of its connection and of its stage (`ratio` and so on),
so that every connection can stand in a robot file. Some kinds have a shorthand besides, a look-up
in the catalogue that gives what the file leaves out; it is written here.
"""

from __future__ import annotations

import functools
import inspect
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, Union

from pydantic import Field, create_model

from stiffopt.connection import Bolt, Connection
from stiffopt.connection.bolted_flange import BoltCount, CircleDiameter
from stiffopt.contact.shear import ShearLaw
from stiffopt.contact.surface import Material, SurfacePair
from stiffopt.contact.surrogate import LawName
from stiffopt.declaration import (
    NOT_NEGATIVE,
    POSITIVE,
    Angle,
    Declared,
    Doc,
    JointAcceleration,
    JointInertia,
    JointJerk,
    JointPosition,
    JointTorque,
    JointVelocity,
    JointViscous,
    Length,
    Named,
    declared,
)
from stiffopt.drivetrain import catalogue
from stiffopt.drivetrain.stage import Stage
from stiffopt.errors import InputError
from stiffopt.files import Model, Section

Vector = tuple[Length, Length, Length]


class Cited(Section):
    """A section that says where its numbers come from."""

    provenance: Annotated[
        Literal["catalogue", "paper", "estimated"], Doc("Where the numbers come from.")
    ] = "estimated"
    source: Annotated[str, Doc("Which catalogue or paper, or how it was estimated.")] = ""
    estimated: Annotated[
        tuple[str, ...], Doc("Keys that are estimates although the rest of the section is not.")
    ] = ()


class ElementSection(Cited):
    """One element of a drivetrain; `element_section` makes the section of a kind."""

    # What the section is made of, set by `element_section`.
    connection: ClassVar[type[Connection]]
    # Fields of the connection that `look_up` may give, those that the file has elsewhere, and
    # what to do when one is missing.
    looked_up: ClassVar[tuple[str, ...]] = ()
    elsewhere: ClassVar[tuple[str, ...]] = ()
    advice: ClassVar[str] = ""

    name: Annotated[str, Doc("Name of the element, once a joint.")]
    ratio: float
    efficiency: float
    parallel: str | None

    def look_up(self) -> dict[str, Any]:
        """Fields of the connection that follow from others or stand in the catalogue."""
        return {}

    def connection_fields(self) -> dict[str, Any]:
        """Declared fields of the connection: those of the file, then those looked up."""
        own = {
            name: getattr(self, name)
            for name in declared(self.connection)
            if name in type(self).model_fields and name not in self.elsewhere
        }
        values = self.look_up() | {name: value for name, value in own.items() if value is not None}
        missing = [name for name in self.looked_up if values.get(name) is None]
        if missing:
            raise InputError(f"{', '.join(missing)} missing. {self.advice}")
        return {name: values[name] for name in declared(self.connection) if name in values}


class KeyLookUp(ElementSection):
    """Flank heights default to those of DIN 6885 for the width and height of the key."""

    looked_up = ("shaft_flank_height", "hub_flank_height")
    width: Annotated[Length, POSITIVE, Doc("Width of the key.")]
    height: Annotated[Length, POSITIVE, Doc("Height of the key.")]

    def look_up(self) -> dict[str, Any]:
        """Flank heights, of the catalogue where one is left out."""
        if all(getattr(self, name) is not None for name in self.looked_up):
            return {}
        return vars(catalogue.key(self.width, self.height))


@dataclass(frozen=True, kw_only=True)
class BoltsSection(Bolt):
    """The bolts of a flange."""

    count: BoltCount
    circle_diameter: CircleDiameter


class FlangeLookUp(ElementSection):
    """A pattern of the catalogue gives what is left out."""

    looked_up = (
        *("inner_radius", "outer_radius", "preload"),
        *("circle_diameter", "bolt_count", "bolt"),
    )
    elsewhere = ("circle_diameter", "bolt_count", "bolt")
    advice = "Give inner_radius, outer_radius, bolt and preload, or a pattern of the catalogue."
    pattern: Annotated[
        str | None, Named("flange pattern"), Doc("Bolt pattern of the catalogue.")
    ] = None
    bolt: Annotated[BoltsSection | None, Doc("The bolts; default those of the pattern.")] = None

    def look_up(self) -> dict[str, Any]:
        """Ring, preload and bolts of the pattern, then the bolts of the file."""
        values: dict[str, Any] = {}
        if self.pattern is not None:
            data = catalogue.flange(self.pattern)
            values = vars(data) | {"bolt_count": data.count, "bolt": Bolt(size=data.bolt)}
        if self.bolt is not None:
            bolt = {name: getattr(self.bolt, name) for name in declared(Bolt)}
            values |= {
                "bolt": Bolt(**bolt),
                "bolt_count": self.bolt.count,
                "circle_diameter": self.bolt.circle_diameter,
            }
        return values


class BeltLookUp(ElementSection):
    """The profile gives the belt; single values of it may be given instead."""

    looked_up = (
        *("teeth_driven", "pitch", "tooth_height", "tooth_root_width", "span_stiffness"),
        *("flank_angle", "tooth_modulus", "tooth_poisson", "teeth_in_mesh_max"),
    )
    profile: Annotated[str, Named("belt"), Doc("Belt profile of the catalogue.")]
    teeth: int
    width: float

    def look_up(self) -> dict[str, Any]:
        """Values of the profile, and as many teeth on the second pulley as on the first."""
        data = catalogue.belt(self.profile)
        return vars(data) | {
            "teeth_driven": self.teeth,
            "span_stiffness": data.span_stiffness_at(self.width),
        }


class ReducerLookUp(ElementSection):
    """A reducer of the catalogue gives what is left out."""

    looked_up = ("K1", "K2", "K3", "T1", "T2")
    advice = "Give K1, K2, K3, T1 and T2, or the name of a reducer in `catalogue`."
    catalogue: Annotated[str | None, Named("reducer"), Doc("Reducer of the catalogue.")] = None

    def look_up(self) -> dict[str, Any]:
        """Slopes and torques of the catalogue."""
        return {} if self.catalogue is None else vars(catalogue.reducer(self.catalogue))


_LOOK_UPS: dict[str, type[ElementSection]] = {
    "key": KeyLookUp,
    "bolted_flange": FlangeLookUp,
    "timing_belt": BeltLookUp,
    "reducer": ReducerLookUp,
}


def _key(field: Declared, *, optional: bool = False, required: bool = False) -> tuple[Any, Any]:
    """Annotation and default of a declared field, as `create_model` takes them."""
    annotation = field.annotation
    if typing.get_args(annotation)[0] is SurfacePair:
        annotation = Annotated[str, *annotation.__metadata__]
    if optional:
        return Annotated[typing.get_args(annotation)[0] | None, *annotation.__metadata__], None
    if required or field.required:
        return annotation, ...
    return annotation, field.default


def element_section(connection: type[Connection]) -> type[ElementSection]:
    """Section of a kind of connection: its declared fields, those of the stage, its look-up."""
    base = _LOOK_UPS.get(connection.kind, ElementSection)
    stage = declared(Stage)
    keys: dict[str, Any] = {
        "type": (Annotated[Literal[connection.kind], Doc("Kind of element.")], ...),
        "ratio": _key(stage["ratio"]),
        "efficiency": _key(stage["efficiency"]),
        "parallel": _key(stage["group"]),
    }
    for name, field in declared(connection).items():
        if name in base.elsewhere or (name == "preload" and not connection.takes_preload):
            continue
        found = name in base.looked_up
        needed = name == "preload" and connection.needs_preload
        keys[name] = _key(field, optional=found, required=needed and not found)
    documented = [connection, *([] if base is ElementSection else [base])]
    section = create_model(
        f"{connection.__name__}Section",
        __base__=base,
        __doc__=" ".join(_summary(cls) for cls in documented),
        **keys,
    )
    section.connection = connection
    return section


def _summary(cls: type) -> str:
    return (inspect.getdoc(cls) or "").partition("\n\n")[0]


def _kinds(base: type[Connection] = Connection) -> Iterator[type[Connection]]:
    """Every connection that has a kind of its own."""
    for cls in base.__subclasses__():
        if "kind" in vars(cls) and not inspect.isabstract(cls):
            yield cls
        yield from _kinds(cls)


class JointSection(Cited):
    """One joint of the URDF; what is left out comes from there or is without limit."""

    name: Annotated[str, Doc("Name of the joint in the URDF.")]
    torque_max: Annotated[
        JointTorque | None,
        POSITIVE,
        Doc("Largest torque of the drive at the output; 100 % of the torque ratio."),
    ] = None
    velocity_max: Annotated[JointVelocity | None, POSITIVE, Doc("Largest velocity.")] = None
    acceleration_max: Annotated[
        JointAcceleration | None, POSITIVE, Doc("Largest acceleration; default no limit.")
    ] = None
    jerk_max: Annotated[JointJerk | None, POSITIVE, Doc("Largest jerk; default no limit.")] = None
    position_lower: Annotated[JointPosition | None, Doc("Lower limit of the position.")] = None
    position_upper: Annotated[JointPosition | None, Doc("Upper limit of the position.")] = None
    rotor_inertia: Annotated[
        JointInertia, NOT_NEGATIVE, Doc("Inertia of the motor's rotor, at the joint's output.")
    ] = 0.0
    coulomb: Annotated[
        JointTorque | None, NOT_NEGATIVE, Doc("Coulomb friction at the joint's output.")
    ] = None
    viscous: Annotated[
        JointViscous | None, NOT_NEGATIVE, Doc("Viscous friction at the joint's output.")
    ] = None
    element: Annotated[
        tuple[ElementSection, ...],
        Doc(
            "Elements of the drivetrain from motor to link, in series unless `parallel` names a "
            "group; without any the joint is rigid."
        ),
    ] = ()


class SurfaceSection(Cited):
    """A pair of surfaces that the catalogue does not have."""


class AssemblySection(Cited):
    """How the elements make a joint."""

    reflect: Annotated[
        bool,
        Doc(
            "True (physics): the wind-up of an element counts 1/ratio at the joint, its stiffness "
            "ratio^2. False: stiffness is added as it is."
        ),
    ] = True
    contact_law: LawName = "log_cubic"
    shear: ShearLaw = "mindlin"


class PlaceSection(Section):
    """A frame fixed to a link."""

    link: Annotated[str, Doc("Link of the URDF that it is fixed to.")]
    offset: Annotated[Vector, Doc("Origin in the frame of the link.")] = (0.0, 0.0, 0.0)
    rpy: Annotated[
        tuple[Angle, Angle, Angle], Doc("Roll, pitch, yaw about the axes of the link.")
    ] = (0.0, 0.0, 0.0)


class RobotFile(Section):
    """A robot: its URDF, tool, and the drivetrain of each joint."""

    schema_: Annotated[int, Doc("Version of the format: 1.")] = Field(alias="schema")
    kind: Annotated[Literal["robot"], Doc("Kind of file.")]
    name: Annotated[str, Doc("Name of the robot.")]
    title: Annotated[str, Doc("Title in reports; default the name.")] = ""
    urdf: Annotated[
        str | None, Doc("Path of the URDF, relative to this file; needed unless it is given.")
    ] = None
    tool: Annotated[PlaceSection | None, Doc("Tool point; default the frame of the last link.")] = (
        None
    )
    flange: Annotated[
        PlaceSection | None, Doc("Where payloads are fixed; default the flange of the URDF.")
    ] = None
    assembly: Annotated[AssemblySection, Doc("How the elements make a joint.")] = AssemblySection()
    surface: Annotated[
        dict[str, SurfaceSection], Doc("Pairs of surfaces by name, besides the catalogue's.")
    ] = Field(default_factory=dict)
    joint: Annotated[
        tuple[JointSection, ...], Doc("Joints of the URDF, in any order; all may be left out.")
    ] = ()


def robot_file() -> type[RobotFile]:
    """Schema of robot files with every connection that is defined now."""
    return _robot_file(tuple(sorted(set(_kinds()), key=lambda cls: cls.kind)))


@functools.cache
def _robot_file(kinds: tuple[type[Connection], ...]) -> type[RobotFile]:
    """`RobotFile` whose elements are of these kinds."""
    elements: Any = Union[tuple(element_section(kind) for kind in kinds)]  # noqa: UP007
    element: Any = Annotated[elements, Field(discriminator="type")]
    joint: Any = _extended(JointSection, element=tuple[element, ...])
    surface: Any = _surface_section()
    return _extended(RobotFile, joint=tuple[joint, ...], surface=dict[str, surface])


def _surface_section() -> type[SurfaceSection]:
    """`SurfaceSection` with the declared fields of a pair of surfaces; materials also by name."""
    keys: dict[str, Any] = {name: _key(field) for name, field in declared(SurfacePair).items()}
    for name in ("first", "second"):
        by_name: Any = Annotated[str, Named("material")]
        docs = keys[name][0].__metadata__
        keys[name] = (Annotated[by_name | Material, *docs], ...)
    return create_model(
        "SurfaceSection", __base__=SurfaceSection, __doc__=SurfaceSection.__doc__, **keys
    )


def _extended(section: type[Model], **keys: Any) -> type[Model]:
    """`section` with other types of some of its keys; their sentences and defaults stay."""
    hints = typing.get_type_hints(section, include_extras=True)
    changed: dict[str, Any] = {
        name: (Annotated[kind, *hints[name].__metadata__], section.model_fields[name])
        for name, kind in keys.items()
    }
    return create_model(section.__name__, __base__=section, __doc__=section.__doc__, **changed)
