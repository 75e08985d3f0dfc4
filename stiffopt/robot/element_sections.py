"""Sections of robot files for the elements of a drivetrain.

An element's keys are the declared fields of its connection and of its stage (`ratio` and so on),
so that every connection can stand in a robot file. Some kinds can besides be looked up in the
catalogue, which gives what the file leaves out; that is written here.
"""

from __future__ import annotations

import inspect
import typing
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

from pydantic import create_model

from stiffopt.connection import Bolt, Connection
from stiffopt.connection.bolted_flange import BoltCount, CircleDiameter
from stiffopt.contact.surface import SurfacePair
from stiffopt.declaration import DETAIL, Declared, Doc, Length, Named, declared
from stiffopt.drivetrain import catalogue
from stiffopt.drivetrain.chain import Stage
from stiffopt.errors import InputError
from stiffopt.validation import Section


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
    width: Annotated[Length, DETAIL, Doc("Width of the key.")]
    height: Annotated[Length, DETAIL, Doc("Height of the key.")]

    def connection_fields(self) -> dict[str, Any]:
        """Refuse flanks that are higher together than the key."""
        values = super().connection_fields()
        together = values["shaft_flank_height"] + values["hub_flank_height"]
        if together > self.height * (1 + 1e-9):
            raise InputError(
                f"shaft_flank_height and hub_flank_height are {1e3 * together:g} mm together, the "
                f"key is {1e3 * self.height:g} mm high. Give the heights that bear, without "
                "chamfers, or leave them out."
            )
        return values

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

    def connection_fields(self) -> dict[str, Any]:
        """Besides: a pattern that is bought is not to be drilled anew, and its preload is net."""
        values = super().connection_fields()
        if self.pattern is not None:
            values["fixed_pattern"] = True
            if values["preload"] == catalogue.flange(self.pattern).preload:
                values["preload_is"] = "net"
        return values

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


def section_key(
    field: Declared, *, optional: bool = False, required: bool = False
) -> tuple[Any, Any]:
    """Annotation and default of a declared field, as `create_model` takes them.

    A pair of surfaces is named in files.
    """
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
        "ratio": section_key(stage["ratio"]),
        "efficiency": section_key(stage["efficiency"]),
        "parallel": section_key(stage["group"]),
    }
    for name, field in declared(connection).items():
        if name in base.elsewhere or (name == "preload" and not connection.takes_preload):
            continue
        found = name in base.looked_up
        needed = name == "preload" and connection.needs_preload
        keys[name] = section_key(field, optional=found, required=needed and not found)
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
