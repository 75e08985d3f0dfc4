"""Schema of robot files: arm, joints, surfaces and assembly of the elements."""

from __future__ import annotations

import functools
import typing
from typing import Annotated, Any, Literal, Union

from pydantic import Field, create_model

from stiffopt.connection import Connection
from stiffopt.connection.connection import connection_kinds
from stiffopt.contact.shear import ShearLaw
from stiffopt.contact.spots import Loading
from stiffopt.contact.surface import Material, SurfacePair
from stiffopt.contact.surrogate import LawName
from stiffopt.declaration import (
    NOT_NEGATIVE,
    POSITIVE,
    Angle,
    Bounds,
    Doc,
    Inertia,
    JointAcceleration,
    JointInertia,
    JointJerk,
    JointPosition,
    JointTorque,
    JointVelocity,
    JointViscous,
    Length,
    Mass,
    Named,
    declared,
)
from stiffopt.drivetrain import catalogue
from stiffopt.drivetrain.bearing import OutputBearing
from stiffopt.robot.elements import (
    Cited,
    ElementSection,
    build_element_section,
    build_section_key,
)
from stiffopt.robot.link_beam import LinkBeam
from stiffopt.validation import Model, Section

Vector = tuple[Length, Length, Length]


class BearingSection(Cited):
    """Output bearing of a joint; omitted values are those of the catalogue, else rigid."""

    catalogue: Annotated[str | None, Named("bearing"), Doc("Output bearing of the catalogue.")] = (
        None
    )

    def bearing(self) -> OutputBearing:
        """Build the bearing: values of the file, else of the catalogue."""
        found = {} if self.catalogue is None else catalogue.bearing(self.catalogue)
        given = {name: getattr(self, name) for name in declared(OutputBearing)}
        stated = {name: value for name, value in given.items() if value is not None}
        return OutputBearing(**{**found, **stated})


class BeamSection(Cited):
    """Bending link behind a joint."""

    def beam(self) -> LinkBeam:
        """Build the beam."""
        return LinkBeam(**{name: getattr(self, name) for name in declared(LinkBeam)})


class JointSection(Cited):
    """One joint of the model; omitted keys are those of the model or without limit."""

    name: Annotated[str, Doc("Name of the joint in the URDF or MJCF.")]
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
        JointInertia | None,
        NOT_NEGATIVE,
        Doc(
            "Inertia of the motor's rotor, at the joint's output; default the armature of an MJCF."
        ),
    ] = None
    coulomb: Annotated[
        JointTorque | None, NOT_NEGATIVE, Doc("Coulomb friction at the joint's output.")
    ] = None
    viscous: Annotated[
        JointViscous | None, NOT_NEGATIVE, Doc("Viscous friction at the joint's output.")
    ] = None
    damping: Annotated[
        JointViscous | None,
        NOT_NEGATIVE,
        Doc(
            "Damping of the joint's spring; default 2 % of the critical damping of this joint "
            "alone, stated in results."
        ),
    ] = None
    hysteresis: Annotated[
        JointPosition | None,
        NOT_NEGATIVE,
        Doc("Half width of the measured loop of wind-up over torque; default none."),
    ] = None
    bearing: Annotated[
        BearingSection | None,
        Doc("Output bearing that tilts and yields across the joint's torsion; default rigid."),
    ] = None
    beam: Annotated[
        BeamSection | None,
        Doc("Bending of the link behind the joint, up to the next joint; default rigid."),
    ] = None
    element: Annotated[
        tuple[ElementSection, ...],
        Doc(
            "Elements of the drivetrain from motor to link, in series unless `parallel` names a "
            "group; without any the joint is rigid."
        ),
    ] = ()


class LinkSection(Cited):
    """Mass and inertia of a link, in place of those of the URDF or MJCF."""

    name: Annotated[str, Doc("Name of the link in the URDF, or of the body in the MJCF.")]
    mass: Annotated[Mass, Bounds(least=0.0, most=1e5), Doc("Mass.")]
    com: Annotated[Vector, Doc("Centre of mass in the frame of the link.")] = (0.0, 0.0, 0.0)
    inertia: Annotated[
        tuple[Inertia, Inertia, Inertia],
        Doc("Principal inertias about the centre of mass, along the axes of the link."),
    ] = (0.0, 0.0, 0.0)


class SurfaceSection(Cited):
    """A pair of surfaces outside the catalogue."""


class AssemblySection(Cited):
    """Assembly of the elements to a joint."""

    reflect: Annotated[
        bool,
        Doc(
            "True (physics): the wind-up of an element counts 1/ratio at the joint, its stiffness "
            "ratio^2. False: stiffness is added as it is."
        ),
    ] = True
    contact_law: LawName = "log_cubic"
    shear: ShearLaw = "mindlin"
    loading: Loading = "first"


class PlaceSection(Section):
    """A frame fixed to a link."""

    link: Annotated[str, Doc("Link of the URDF, or body or site of the MJCF, that it is fixed to.")]
    offset: Annotated[Vector, Doc("Origin in the frame of the link.")] = (0.0, 0.0, 0.0)
    rpy: Annotated[
        tuple[Angle, Angle, Angle], Doc("Roll, pitch, yaw about the axes of the link.")
    ] = (0.0, 0.0, 0.0)


class RobotFile(Section):
    """A robot: its URDF or MJCF, tool, and the drivetrain of each joint."""

    schema_: Annotated[int, Doc("Version of the format: 1.")] = Field(alias="schema")
    kind: Annotated[Literal["robot"], Doc("Kind of file.")]
    name: Annotated[str, Doc("Name of the robot.")]
    title: Annotated[str, Doc("Title in reports; default the name.")] = ""
    urdf: Annotated[
        str | None,
        Doc("Path of the URDF or MJCF, relative to this file; needed unless it is given."),
    ] = None
    catalogue: Annotated[
        str | None,
        Doc("Path of the user's catalogue file, relative to this one; its parts take precedence."),
    ] = None
    lock: Annotated[
        dict[str, JointPosition],
        Doc(
            "Joints that are held, and their positions; a free base is held where it is. Others "
            "that do not lead to the tool are held at zero, and those that follow a held joint "
            "with it, unless a [[joint]] names them."
        ),
    ] = Field(default_factory=dict)
    tool: Annotated[PlaceSection | None, Doc("Tool point; default the frame of the last link.")] = (
        None
    )
    flange: Annotated[
        PlaceSection | None, Doc("Where payloads are fixed; default the flange of the URDF.")
    ] = None
    assembly: Annotated[AssemblySection, Doc("Assembly of the elements to a joint.")] = (
        AssemblySection()
    )
    link: Annotated[
        tuple[LinkSection, ...],
        Doc("Masses of links, in place of the URDF's; all may be left out."),
    ] = ()
    surface: Annotated[
        dict[str, SurfaceSection], Doc("Pairs of surfaces by name, besides the catalogue's.")
    ] = Field(default_factory=dict)
    joint: Annotated[
        tuple[JointSection, ...], Doc("Joints of the URDF, in any order; all may be left out.")
    ] = ()


def robot_file_schema() -> type[RobotFile]:
    """Schema of robot files with every connection defined so far."""
    return _robot_file_of(tuple(connection_kinds().values()))


@functools.cache
def _robot_file_of(kinds: tuple[type[Connection], ...]) -> type[RobotFile]:
    """`RobotFile` whose elements are of these kinds."""
    elements: Any = Union[tuple(build_element_section(kind) for kind in kinds)]  # noqa: UP007
    element: Any = Annotated[elements, Field(discriminator="type")]
    bearing, beam = (
        _declared_section(BearingSection, OutputBearing),
        _declared_section(BeamSection, LinkBeam),
    )
    joint: Any = _replace_key_types(
        JointSection, element=tuple[element, ...], bearing=bearing | None, beam=beam | None
    )
    surface: Any = _surface_section()
    return _replace_key_types(RobotFile, joint=tuple[joint, ...], surface=dict[str, surface])


def _declared_section(section: type[Section], part: type) -> Any:
    """Return a section with the declared fields of a part."""
    keys: dict[str, Any] = {
        name: build_section_key(field) for name, field in declared(part).items()
    }
    return create_model(section.__name__, __base__=section, __doc__=section.__doc__, **keys)


def _surface_section() -> type[SurfaceSection]:
    """`SurfaceSection` with the declared fields of a pair of surfaces; materials also by name."""
    keys: dict[str, Any] = {
        name: build_section_key(field) for name, field in declared(SurfacePair).items()
    }
    for name in ("first", "second"):
        by_name: Any = Annotated[str, Named("material")]
        docs = keys[name][0].__metadata__
        keys[name] = (Annotated[by_name | Material, *docs], ...)
    return create_model(
        "SurfaceSection", __base__=SurfaceSection, __doc__=SurfaceSection.__doc__, **keys
    )


def _replace_key_types(section: type[Model], **keys: Any) -> type[Model]:
    """Section with other types of some keys and the same descriptions and defaults."""
    hints = typing.get_type_hints(section, include_extras=True)
    changed: dict[str, Any] = {
        name: (Annotated[kind, *hints[name].__metadata__], section.model_fields[name])
        for name, kind in keys.items()
    }
    return create_model(section.__name__, __base__=section, __doc__=section.__doc__, **changed)
