"""Elements of a drivetrain: their sections in robot files, and the chains built of them.

The keys of an element are the declared fields of its connection and of its stage (`ratio` and so
on), so that a robot file can contain every connection. For some kinds, keys that the file omits
are looked up in the catalogue by the classes of this module.
"""

from __future__ import annotations

import contextlib
import inspect
import typing
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import create_model

from stiffopt.connection import Bolt, Connection
from stiffopt.connection.bolted_flange import BoltCount, CircleDiameter
from stiffopt.contact.surface import SurfacePair
from stiffopt.declaration import DETAIL, Declared, Doc, Length, Named, declared, unit
from stiffopt.drivetrain import catalogue
from stiffopt.drivetrain.chain import Chain, Stage
from stiffopt.errors import InputError, InputFileError, nearest
from stiffopt.units import JointNumber, fit_joint
from stiffopt.validation import Section

if TYPE_CHECKING:
    from stiffopt.robot.schema import AssemblySection, JointSection, SurfaceSection


class Cited(Section):
    """Section with the provenance of its numbers."""

    provenance: Annotated[
        Literal["catalogue", "paper", "estimated"], Doc("Where the numbers come from.")
    ] = "estimated"
    source: Annotated[str, Doc("Which catalogue or paper, or how it was estimated.")] = ""
    estimated: Annotated[
        tuple[str, ...], Doc("Keys that are estimates although the rest of the section is not.")
    ] = ()


class ElementSection(Cited):
    """Element of a drivetrain; `build_element_section` creates the section of a kind."""

    # Class of the connection, set by `build_element_section`.
    connection: ClassVar[type[Connection]]
    # Fields of the connection that `look_up` may supply, those with other keys in the file, and the
    # remedy when one is missing.
    looked_up: ClassVar[tuple[str, ...]] = ()
    elsewhere: ClassVar[tuple[str, ...]] = ()
    advice: ClassVar[str] = ""

    name: Annotated[str, Doc("Name of the element, once a joint.")]
    ratio: float
    efficiency: float
    parallel: str | None

    def look_up(self) -> dict[str, Any]:
        """Look up fields of the connection that follow from others or from the catalogue."""
        return {}

    def connection_fields(self) -> dict[str, Any]:
        """Collect the fields of the connection: of the file, else looked up."""
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
    """Key whose flank heights default to those of DIN 6885 for its width and height."""

    looked_up = ("shaft_flank_height", "hub_flank_height")
    width: Annotated[Length, DETAIL, Doc("Width of the key.")]
    height: Annotated[Length, DETAIL, Doc("Height of the key.")]

    def connection_fields(self) -> dict[str, Any]:
        """Collect the fields; raise `InputError` for flanks higher than the key."""
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
        """Look up flank heights where one is omitted."""
        if all(getattr(self, name) is not None for name in self.looked_up):
            return {}
        return vars(catalogue.key(self.width, self.height))


@dataclass(frozen=True, kw_only=True)
class BoltsSection(Bolt):
    """The bolts of a flange."""

    count: BoltCount
    circle_diameter: CircleDiameter


class FlangeLookUp(ElementSection):
    """Flange whose omitted values are those of a bolt pattern of the catalogue."""

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
        """Collect the fields; a catalogue pattern is fixed, and its preload is net."""
        values = super().connection_fields()
        if self.pattern is not None:
            values["fixed_pattern"] = True
            if values["preload"] == catalogue.flange(self.pattern).preload:
                values["preload_is"] = "net"
        return values

    def look_up(self) -> dict[str, Any]:
        """Look up ring, preload and bolts of the pattern; bolts of the file take precedence."""
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
    """Belt of a profile; single values of it may be overridden."""

    looked_up = (
        *("teeth_driven", "pitch", "tooth_height", "tooth_root_width", "span_stiffness"),
        *("flank_angle", "tooth_modulus", "tooth_poisson", "teeth_in_mesh_max"),
    )
    profile: Annotated[str, Named("belt"), Doc("Belt profile of the catalogue.")]
    teeth: int
    width: float

    def look_up(self) -> dict[str, Any]:
        """Look up the profile; the second pulley has as many teeth as the first by default."""
        data = catalogue.belt(self.profile)
        return vars(data) | {
            "teeth_driven": self.teeth,
            "span_stiffness": data.span_stiffness_at(self.width),
        }


class ReducerLookUp(ElementSection):
    """Reducer whose omitted values are those of the catalogue."""

    looked_up = ("K1", "K2", "K3", "T1", "T2")
    advice = "Give K1, K2, K3, T1 and T2, or the name of a reducer in `catalogue`."
    catalogue: Annotated[str | None, Named("reducer"), Doc("Reducer of the catalogue.")] = None

    def look_up(self) -> dict[str, Any]:
        """Look up slopes and torques, and the rated life where its torque is known."""
        if self.catalogue is None:
            return {}
        data = catalogue.reducer(self.catalogue)
        return vars(data) | {"rated_torque": data.rated_torque}


_LOOK_UP_SECTIONS: dict[str, type[ElementSection]] = {
    "key": KeyLookUp,
    "bolted_flange": FlangeLookUp,
    "timing_belt": BeltLookUp,
    "reducer": ReducerLookUp,
}


def build_section_key(
    field: Declared, *, optional: bool = False, required: bool = False
) -> tuple[Any, Any]:
    """Annotation and default of a declared field, as `create_model` takes them.

    A pair of surfaces is given by name in files.
    """
    annotation = field.annotation
    if typing.get_args(annotation)[0] is SurfacePair:
        annotation = Annotated[str, *annotation.__metadata__]
    if optional:
        return Annotated[typing.get_args(annotation)[0] | None, *annotation.__metadata__], None
    if required or field.required:
        return annotation, ...
    return annotation, field.default


def build_element_section(connection: type[Connection]) -> type[ElementSection]:
    """Create the section of a connection: its declared fields, those of the stage, its look-up."""
    base = _LOOK_UP_SECTIONS.get(connection.kind, ElementSection)
    stage = declared(Stage)
    keys: dict[str, Any] = {
        "type": (Annotated[Literal[connection.kind], Doc("Kind of element.")], ...),
        "ratio": build_section_key(stage["ratio"]),
        "efficiency": build_section_key(stage["efficiency"]),
        "parallel": build_section_key(stage["group"]),
    }
    for name, field in declared(connection).items():
        if name in base.elsewhere or (name == "preload" and not connection.takes_preload):
            continue
        found = name in base.looked_up
        needed = name == "preload" and connection.needs_preload
        keys[name] = build_section_key(field, optional=found, required=needed and not found)
    documented = [connection, *([] if base is ElementSection else [base])]
    section = create_model(
        f"{connection.__name__}Section",
        __base__=base,
        __doc__=" ".join((inspect.getdoc(cls) or "").partition("\n\n")[0] for cls in documented),
        **keys,
    )
    section.connection = connection
    return section


class ElementBuilder:
    """Builder of the chains of a robot file.

    `surfaces`: surfaces of the file, which take precedence over the catalogue.
    """

    def __init__(
        self, path: object, assembly: AssemblySection, surfaces: Mapping[str, SurfaceSection]
    ) -> None:
        self.path, self.assembly = path, assembly
        self.surfaces: dict[str, SurfacePair] = {}
        for name, section in surfaces.items():
            with locate_errors(path, f"surface.{name}"):
                self.surfaces[name] = _find_surface(name, section)

    def chain(self, joint: JointSection, torque_max: float, prismatic: bool) -> Chain | None:
        """Chain of a joint with the largest torque `torque_max` [N m]; None without elements."""
        if not joint.element:
            return None
        stages = []
        for section in joint.element:
            with locate_errors(self.path, f"joint[{joint.name}].element[{section.name}]"):
                stages.append(self._build_stage(section, torque_max, prismatic))
        with locate_errors(self.path, f"joint[{joint.name}]"):
            _check_inputs(joint.element)
            return Chain(tuple(stages), reflect=self.assembly.reflect)

    def _build_stage(self, section: ElementSection, torque_max: float, prismatic: bool) -> Stage:
        kind = section.connection
        values = section.connection_fields()
        for name, value in values.items():
            if isinstance(value, JointNumber):
                values[name] = fit_joint(value, prismatic, unit(kind, name).dimension, name)
        if "surface" in values:
            values["surface"] = replace(
                self._find_surface(values["surface"]), loading=self.assembly.loading
            )
        # Settings of the whole robot.
        common = {"contact_law": self.assembly.contact_law, "shear": self.assembly.shear}
        values |= {name: law for name, law in common.items() if name in kind.__dataclass_fields__}
        element = kind(
            name=section.name,
            torque_max=torque_max / (section.ratio * section.efficiency),
            **values,
        )
        return Stage(element, section.ratio, section.efficiency, section.parallel)

    def _find_surface(self, name: str) -> SurfacePair:
        if name in self.surfaces:
            return self.surfaces[name]
        known = [*self.surfaces, *catalogue.surface_names()]
        if name not in known:
            raise InputError(f"surface: no surface {name!r}. {nearest(name, known)}")
        return catalogue.surface(name)


def _check_inputs(sections: Sequence[ElementSection]) -> None:
    """Raise `InputError` for an element whose ratio contradicts the input of the next reducer.

    Checked for catalogue reducers, whose ratio is known. A deviation by one turn is accepted: it
    is that of a strain-wave gear with the other part held.
    """
    for reducer, before in zip(sections[1:], sections, strict=False):
        name = getattr(reducer, "catalogue", None)
        if name is None or before.parallel is not None:
            continue
        turns = catalogue.reducer(name).ratio
        # Teeth between the element's own shaft and the reducer.
        teeth = float(getattr(before, "teeth", 1.0))
        geared = float(getattr(before, "teeth_driven", None) or teeth) / teeth
        wanted = reducer.ratio * turns * geared
        if abs(before.ratio - wanted) > 1.001 * reducer.ratio * geared:
            raise InputError(
                f"element[{before.name}].ratio = {before.ratio:g}, but the input of"
                f" {reducer.name!r} ({name}) after it turns {turns} times for one turn of its"
                f" output: give ratio = {wanted:g}, list the belt or gears between the two, or give"
                " K1, K2, K3, T1 and T2 in place of `catalogue`."
            )


def _find_surface(name: str, section: SurfaceSection) -> SurfacePair:
    values: dict[str, Any] = {key: getattr(section, key) for key in declared(SurfacePair)}
    for key, body in values.items():
        if isinstance(body, str):
            values[key] = catalogue.material(body)
    return SurfacePair(name=name, **values)


@contextlib.contextmanager
def locate_errors(path: object, where: str) -> Iterator[None]:
    """Convert `InputError` raised inside to `InputFileError` with file and key."""
    try:
        yield
    except InputFileError:
        raise
    except InputError as error:
        raise InputFileError(path, where, str(error)) from error
