"""Packaged bolts, set screws and strength of the clamped parts, each with its provenance."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from stiffopt.drivetrain.tables import (
    Entry,
    find,
    own_entries,
    read_table,
    rows,
    source_text,
)
from stiffopt.errors import InputError, nearest


@dataclass(frozen=True, kw_only=True)
class BoltData(Entry):
    """Socket head bolt with coarse thread."""

    # d and P [m].
    diameter: float
    pitch: float
    # d2 and d3 of the thread [m].
    pitch_diameter: float
    minor_diameter: float
    stress_area: float  # A_S [m^2]
    head_diameter: float  # d_k, room that the head takes [m]
    bearing_diameter: float  # d_w, of the flat under the head [m]
    hole: float  # d_h, of the clearance hole [m]
    # d_T of the part beside the thread [m]; `shanked` makes such a bolt.
    shank_diameter: float | None = None
    shank_length: float = 0.0  # l of that part within the clamp length [m]; infinite: all of it

    @property
    def stress_diameter(self) -> float:
        """d_S = (d2 + d3)/2 of the thread, or that of a thinner shank [m]."""
        return self._smaller_diameter((self.pitch_diameter + self.minor_diameter) / 2)

    @property
    def core_diameter(self) -> float:
        """d_3 of the thread, or d_T of a thinner shank: section under shear [m]."""
        return self._smaller_diameter(self.minor_diameter)

    def _smaller_diameter(self, diameter: float) -> float:
        """Smaller one of a diameter and that of the shank [m]."""
        return diameter if self.shank_diameter is None else min(diameter, self.shank_diameter)

    def sections(self, length: float) -> tuple[tuple[float, float], ...]:
        """Length and diameter of the cylinders within a clamp length: shank, thread at d_3 [m]."""
        if self.shank_diameter is None:
            return ((length, self.minor_diameter),)
        shank = min(self.shank_length, length)
        return ((shank, self.shank_diameter), (length - shank, self.minor_diameter))

    @property
    def core_area(self) -> float:
        """Area of the core [m^2]."""
        return math.pi / 4 * self.core_diameter**2

    @property
    def minor_area(self) -> float:
        """A_3 = pi/4 d3^2, core of the thread [m^2]."""
        return math.pi / 4 * self.minor_diameter**2

    @property
    def nominal_area(self) -> float:
        """A_N = pi/4 d^2 [m^2]."""
        return math.pi / 4 * self.diameter**2

    @property
    def head_area(self) -> float:
        """Bearing annulus between head and clearance hole, pi/4 (d_w^2 - d_h^2) [m^2]."""
        return math.pi / 4 * (self.bearing_diameter**2 - self.hole**2)

    @property
    def friction_diameter(self) -> float:
        """D_Km = (d_w + d_h)/2, lever of the friction under the head [m]."""
        return (self.bearing_diameter + self.hole) / 2


def shanked(bolt: BoltData, diameter: float, length: float = math.inf) -> BoltData:
    """The same bolt with a shank beside its thread [m]; a thinner one is the weakest section."""
    area = min(bolt.stress_area, math.pi / 4 * diameter**2)
    return replace(bolt, shank_diameter=diameter, shank_length=length, stress_area=area)


@dataclass(frozen=True, kw_only=True)
class BoltGrade(Entry):
    """Property class of bolts."""

    # R_p0.2 and R_m, least [Pa].
    proof_stress: float
    tensile_strength: float
    modulus: float  # Young's modulus [Pa]
    expansion: float  # thermal, for 1 K
    heat_treated: bool  # quenched and tempered; stainless bolts are work-hardened instead


@dataclass(frozen=True, kw_only=True)
class HexagonData(Entry):
    """Hexagon head or nut: d_w of its face and width across corners [m]."""

    bearing_diameter: float
    corners: float


@dataclass(frozen=True, kw_only=True)
class SetScrewData(Entry):
    """Set screw of class 45H: thread [m], tightening torque [N m], nut factor F = M/(factor d)."""

    diameter: float
    minor_diameter: float
    tightening_torque: float
    nut_factor: float

    @property
    def minor_area(self) -> float:
        """Core of the thread [m^2]."""
        return math.pi / 4 * self.minor_diameter**2


@dataclass(frozen=True, kw_only=True)
class ClampedMaterial(Entry):
    """Permissible pressures and strengths of a material around fasteners."""

    modulus: float  # Young's modulus [Pa]
    head_pressure: float  # permissible under a bolt head [Pa]
    # By grade: length of thread needed, in bolt diameters; see `engagement_for`.
    engagement: Mapping[str, float]
    engagement_assumed: float  # length of thread where none is given, in bolt diameters
    # strength and yield_stress: R_m and R_p0.2 [Pa].
    strength: float
    shear_ratio: float  # shear over tensile strength
    yield_stress: float
    expansion: float  # thermal, for 1 K
    # "steady" and "reversing": permissible on key flanks in a hub of it [Pa]; empty for materials
    # not used for hubs.
    key_pressure: Mapping[str, float] = field(default_factory=dict)

    def engagement_for(self, grade: str) -> float:
        """Return the thread engagement needed [diameters], of the next stronger listed grade."""
        strength = tensile_strength(grade)
        tried = [name for name in self.engagement if tensile_strength(name) >= strength]
        return self.engagement[min(tried, key=tensile_strength)]


@dataclass(frozen=True, kw_only=True)
class WasherData(Entry):
    """Hardened washer: outer diameter and thickness [m], permissible pressure [Pa]."""

    diameter: float
    thickness: float
    pressure: float


@dataclass(frozen=True, kw_only=True)
class CoatingData(Entry):
    """Coating of bolts: least and largest friction in the thread and under the head [-]."""

    least: float
    largest: float


def bolt_sizes() -> list[str]:
    """Names of the packaged bolts, small to large."""
    return list(rows("bolts", "bolt", "size"))


def bolt(size: str) -> BoltData:
    """Look up a bolt by size, for example "M5"."""
    row = dict(find("bolt", size, rows("bolts", "bolt", "size")))
    return BoltData(name=row.pop("size"), **row)


def bolt_grades() -> list[str]:
    """Names of the packaged bolt grades, weak to strong."""
    return list(read_table("bolts")["grade"])


def bolt_grade(name: str) -> BoltGrade:
    """Look up a property class, for example "12.9" or "A2-70"."""
    table = read_table("bolts")
    row = dict(find("bolt grade", name, table["grade"]))
    made_of = dict(table["material"][row.pop("material")])
    source = f"{source_text(table, row.pop('source'))}; {made_of.pop('source')}"
    return BoltGrade(name=name, provenance="catalogue", source=source, **row, **made_of)


def proof_stress(grade: str) -> float:
    """Yield strength R_p0.2 of a bolt grade such as "12.9" [Pa]."""
    return bolt_grade(grade).proof_stress


def set_screw_modulus() -> float:
    """Young's modulus of set screws [Pa]."""
    return float(read_table("bolts")["material"]["steel"]["modulus"])


def hexagon(size: str) -> HexagonData:
    """Look up the hexagon head or nut for the thread diameter of a bolt."""
    table = read_table("bolts")["hexagons"]
    diameter = bolt(size).diameter
    for name, row in table.items():
        if isinstance(row, dict) and bolt(name).diameter == diameter:
            return HexagonData(
                name=size, provenance=table["provenance"], source=table["source"], **row
            )
    raise InputError(
        f"bolt {size}: no hexagon head or nut is packaged for {1e3 * diameter:g} mm. Take a "
        'packaged size, or `head = "socket"` in a tapped hole (`nut = false`).'
    )


def set_screw_sizes() -> list[str]:
    """Names of the packaged set screws, small to large."""
    return list(rows("set_screws", "set_screw", "size"))


def set_screw(size: str) -> SetScrewData:
    """Look up a set screw by size, for example "M4"."""
    row = dict(find("set screw", size, rows("set_screws", "set_screw", "size")))
    factor = float(read_table("set_screws")["torque"]["nut_factor"])
    return SetScrewData(name=row.pop("size"), nut_factor=factor, **row)


def tensile_strength(grade: str) -> float:
    """Least tensile strength R_m of a bolt grade such as "12.9" [Pa]."""
    return bolt_grade(grade).tensile_strength


def washer(size: str) -> WasherData:
    """Look up the hardened washer of a bolt: a user entry, else by size, else by diameter.

    Raises `InputError`: there is none, or the head is wider than the washer.
    """
    own = own_entries("washer")
    table = read_table("bolts")["washers"]
    known = {name: row for name, row in table.items() if isinstance(row, dict)}
    for_bolt = bolt(size)
    if size in own:
        row = {key: own[size][key] for key in ("diameter", "thickness", "provenance", "source")}
        pressure = own[size]["pressure"]
        row["pressure"] = float(table["pressure"]) if pressure is None else pressure
    else:
        same = (name for name in known if bolt(name).diameter == for_bolt.diameter)
        row = dict(known.get(size) or known.get(next(same, "")) or {})
        row |= {key: table[key] for key in ("pressure", "provenance", "source")}
    if "diameter" not in row or row["diameter"] < for_bolt.bearing_diameter:
        found = (
            "no packaged washer is for it"
            if "diameter" not in row
            else (
                f"its head bears on {1e3 * for_bolt.bearing_diameter:g} mm, and the washer is"
                f" {1e3 * row['diameter']:g} mm wide"
            )
        )
        raise InputError(
            f'bolt {size}: {found}. Add a [[washer]] with size = "{size}", diameter and thickness'
            " to your catalogue file, or leave the washer out."
        )
    return WasherData(name=size, **row)


def coating_names() -> list[str]:
    """Names of the packaged coatings."""
    table = read_table("bolts")["coatings"]
    return [name for name, row in table.items() if isinstance(row, list)]


def coating(name: str) -> CoatingData:
    """Look up the friction of a coating, for example "zinc_flake"."""
    table = read_table("bolts")["coatings"]
    if name not in coating_names():
        raise InputError(f"no coating {name!r} in the catalogue. {nearest(name, coating_names())}")
    least, largest = table[name]
    return CoatingData(
        name=name,
        provenance=table["provenance"],
        source=table["source"],
        least=least,
        largest=largest,
    )


def clamped_material(name: str) -> ClampedMaterial:
    """Look up a clamped or tapped material."""
    table = read_table("fastening")
    row = dict(find("material", name, table["material"]))
    modulus = float(read_table("surfaces")["materials"][row.pop("of", name)]["young"])
    row["yield_stress"] = row.pop("yield")
    row["source"] = source_text(table, row["source"])
    return ClampedMaterial(name=name, modulus=modulus, **row)


def shaft_proof_stress(material: str) -> float:
    """Yield strength of a shaft under pin tips: hardened_steel or steel_45 [Pa]."""
    return float(find("shaft material", material, read_table("fastening")["shaft"])["proof_stress"])
