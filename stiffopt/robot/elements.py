"""From the sections of a robot file to connections and chains."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from stiffopt.connection import (
    Bolt,
    BoltedFlange,
    ClampingPins,
    Connection,
    Constant,
    GearPair,
    Key,
    Reducer,
    SetScrew,
    Shaft,
    TimingBelt,
)
from stiffopt.contact.surface import Material, SurfacePair
from stiffopt.drivetrain import catalogue
from stiffopt.drivetrain.chain import Chain
from stiffopt.drivetrain.stage import Stage
from stiffopt.errors import InputError, InputFileError, nearest
from stiffopt.robot.schema import (
    AssemblySection,
    BeltSection,
    BoltSection,
    ConstantSection,
    Element,
    FlangeSection,
    GearSection,
    JointSection,
    KeySection,
    MaterialSection,
    PinsSection,
    ReducerSection,
    SetScrewSection,
    ShaftSection,
    SurfaceSection,
)


class ElementBuilder:
    """Builds the chains of a robot file.

    Parameters
    ----------
    path : the file, for messages
    assembly : AssemblySection
    surfaces : mapping of name to SurfaceSection
        Of the file; they come before those of the catalogue.
    """

    def __init__(
        self, path: object, assembly: AssemblySection, surfaces: Mapping[str, SurfaceSection]
    ) -> None:
        self.path, self.assembly = path, assembly
        self._builders: dict[type, Callable[[Any, float], Connection]] = {
            KeySection: self._key,
            FlangeSection: self._flange,
            PinsSection: self._pins,
            BeltSection: self._belt,
            GearSection: self._gear,
            ReducerSection: self._reducer,
            ShaftSection: self._shaft,
            ConstantSection: self._constant,
        }
        self.surfaces: dict[str, SurfacePair] = {}
        for name, section in surfaces.items():
            with located(path, f"surface.{name}"):
                self.surfaces[name] = _surface(name, section)

    def chain(self, joint: JointSection, torque_max: float) -> Chain | None:
        """Chain of a joint with the largest torque `torque_max` [N m]; None without elements."""
        if not joint.element:
            return None
        stages = []
        for section in joint.element:
            with located(self.path, f"joint[{joint.name}].element[{section.name}]"):
                stages.append(self._stage(section, torque_max))
        with located(self.path, f"joint[{joint.name}]"):
            return Chain(tuple(stages), reflect=self.assembly.reflect)

    def _stage(self, section: Element, torque_max: float) -> Stage:
        if not (section.ratio > 0.0 and 0.0 < section.efficiency <= 1.0):
            raise InputError(
                f"ratio = {section.ratio:g} must be above 0 and efficiency = "
                f"{section.efficiency:g} above 0 and at most 1. Correct them."
            )
        build = self._builders[type(section)]
        element = build(section, torque_max / (section.ratio * section.efficiency))
        return Stage(element, section.ratio, section.efficiency, section.parallel)

    def _pair(self, name: str) -> SurfacePair:
        if name in self.surfaces:
            return self.surfaces[name]
        known = [*self.surfaces, *catalogue.surface_names()]
        if name not in known:
            raise InputError(f"surface: no surface {name!r}. {nearest(name, known)}")
        return catalogue.surface(name)

    def _key(self, s: KeySection, torque_max: float) -> Key:
        shaft, hub = s.shaft_flank_height, s.hub_flank_height
        if shaft is None or hub is None:
            data = catalogue.key(s.width, s.height)
            shaft = data.shaft_flank_height if shaft is None else shaft
            hub = data.hub_flank_height if hub is None else hub
        catalogue.clamped_material(s.hub_material)
        return Key(
            name=s.name,
            torque_max=torque_max,
            shaft_diameter=s.shaft_diameter,
            length=s.length,
            shaft_height=shaft,
            hub_height=hub,
            surface=self._pair(s.surface),
            prepressure=s.prepressure,
            flanks=s.flanks,
            contact_law=self.assembly.contact_law,
            hub_material=s.hub_material,
        )

    def _flange(self, s: FlangeSection, torque_max: float) -> BoltedFlange:
        values: dict[str, Any] = {
            "inner_radius": s.inner_radius,
            "outer_radius": s.outer_radius,
            "preload": s.preload,
            "circle_diameter": None if s.bolt is None else s.bolt.circle_diameter,
            "bolt_count": None if s.bolt is None else s.bolt.count,
            "bolt": None if s.bolt is None else _bolt(s.bolt),
        }
        if s.pattern is not None:
            data = catalogue.flange(s.pattern)
            own: dict[str, Any] = {
                "inner_radius": data.inner_radius,
                "outer_radius": data.outer_radius,
                "preload": data.preload,
                "circle_diameter": data.circle_diameter,
                "bolt_count": data.count,
                "bolt": Bolt(size=data.bolt),
            }
            values = {k: own[k] if v is None else v for k, v in values.items()}
        missing = [k for k, v in values.items() if v is None]
        if missing:
            raise InputError(
                f"{', '.join(missing)} missing. Give inner_radius, outer_radius, bolt and preload, "
                "or a pattern of the catalogue."
            )
        return BoltedFlange(
            name=s.name,
            torque_max=torque_max,
            surface=self._pair(s.surface),
            friction=s.friction,
            shear=self.assembly.shear,
            contact_law=self.assembly.contact_law,
            **values,
        )

    def _pins(self, s: PinsSection, torque_max: float) -> ClampingPins:
        return ClampingPins(
            name=s.name,
            torque_max=torque_max,
            pin_count=s.count,
            shaft_radius=s.shaft_diameter / 2,
            tip_diameter=s.tip_diameter,
            preload=s.preload,
            surface=self._pair(s.surface),
            friction=s.friction,
            both_sides=s.both_sides,
            half_space=s.half_space,
            screw=None if s.screw is None else _set_screw(s.screw),
            shear=self.assembly.shear,
            contact_law=self.assembly.contact_law,
        )

    def _belt(self, s: BeltSection, torque_max: float) -> TimingBelt:
        data = catalogue.belt(s.profile)

        def or_own(given: float | None, own: float) -> float:
            return own if given is None else given

        return TimingBelt(
            name=s.name,
            torque_max=torque_max,
            preload=s.preload,
            teeth=s.teeth,
            teeth_driven=s.teeth if s.teeth_driven is None else s.teeth_driven,
            pitch=data.pitch,
            width=s.width,
            tooth_height=or_own(s.tooth_height, data.tooth_height),
            tooth_root_width=or_own(s.tooth_root_width, data.tooth_root_width),
            span_stiffness=or_own(s.span_stiffness, data.span_stiffness_at(s.width)),
            span_length=s.span_length,
            wrap=or_own(s.wrap, math.pi),
            wrap_driven=or_own(s.wrap_driven, math.pi),
            flank_angle=or_own(s.flank_angle, data.flank_angle),
            modulus=or_own(s.tooth_modulus, data.tooth_modulus),
            poisson=data.tooth_poisson,
            teeth_effective_max=data.teeth_in_mesh_max,
        )

    def _gear(self, s: GearSection, torque_max: float) -> GearPair:
        return GearPair(
            name=s.name,
            torque_max=torque_max,
            pitch_radius=s.module * s.teeth / 2,
            pitch_radius_driven=s.module * s.teeth_driven / 2,
            face_width=s.face_width,
            surface=self._pair(s.surface),
            pressure_angle=s.pressure_angle,
            contact_ratio=s.contact_ratio,
            contact_law=self.assembly.contact_law,
        )

    def _reducer(self, s: ReducerSection, torque_max: float) -> Reducer:
        values = {k: getattr(s, k) for k in ("K1", "K2", "K3", "T1", "T2")}
        if s.catalogue is not None:
            data = catalogue.reducer(s.catalogue)
            values = {k: getattr(data, k) if v is None else v for k, v in values.items()}
        missing = [k for k, v in values.items() if v is None]
        if missing:
            raise InputError(
                f"{', '.join(missing)} missing. Give K1, K2, K3, T1 and T2, "
                "or the name of a reducer in `catalogue`."
            )
        _check_reducer(values)
        return Reducer(
            name=s.name,
            torque_max=torque_max,
            stiffness_1=values["K1"],
            stiffness_2=values["K2"],
            stiffness_3=values["K3"],
            torque_1=values["T1"],
            torque_2=values["T2"],
        )

    def _shaft(self, s: ShaftSection, torque_max: float) -> Shaft:
        return Shaft(
            name=s.name,
            torque_max=torque_max,
            diameter=s.diameter,
            length=s.length,
            bore=s.bore,
            shear_modulus=s.shear_modulus,
        )

    def _constant(self, s: ConstantSection, torque_max: float) -> Constant:
        return Constant(name=s.name, torque_max=torque_max, stiffness=float(s.stiffness))


def _bolt(s: BoltSection) -> Bolt:
    """Bolt whose size, grade and materials the catalogue knows."""
    catalogue.bolt(s.size)
    catalogue.proof_stress(s.grade)
    for material in (s.head_material, s.thread_material):
        catalogue.clamped_material(material)
    return Bolt(
        size=s.size,
        grade=s.grade,
        clamp_length=s.clamp_length,
        engagement=s.engagement,
        head_material=s.head_material,
        thread_material=s.thread_material,
    )


def _set_screw(s: SetScrewSection) -> SetScrew:
    """Set screw whose size and shaft material the catalogue knows."""
    catalogue.set_screw(s.size)
    catalogue.shaft_proof_stress(s.shaft_material)
    return SetScrew(size=s.size, length=s.length, shaft_material=s.shaft_material)


def _check_reducer(values: Mapping[str, float]) -> None:
    """Check in the words of the file, ahead of the element's own."""
    for name, value in values.items():
        if value <= 0.0:
            raise InputError(
                f"{name} = {value:g} must be above 0. Correct {name}, or name a reducer in "
                "`catalogue`."
            )
    if values["T2"] <= values["T1"]:
        raise InputError(
            f"T2 = {values['T2']:g} N m must be larger than T1 = {values['T1']:g} N m, where the "
            "first range of stiffness ends. Correct one of the two."
        )


def _surface(name: str, s: SurfaceSection) -> SurfacePair:
    def body(which: str | MaterialSection) -> Material:
        if isinstance(which, str):
            return catalogue.material(which)
        return Material(modulus=which.modulus, poisson=which.poisson, hardness=which.hardness)

    return SurfacePair(
        name=name,
        first=body(s.first),
        second=body(s.second),
        fractal_dimension=s.fractal_dimension,
        fractal_roughness=s.fractal_roughness,
        friction=s.friction,
        reference_area=s.reference_area,
    )


@contextlib.contextmanager
def located(path: object, where: str) -> Iterator[None]:
    """Add file and key to what the objects inside say about their numbers."""
    try:
        yield
    except InputFileError:
        raise
    except InputError as error:
        raise InputFileError(path, where, str(error)) from error
