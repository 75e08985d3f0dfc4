"""Packaged reducers, bolts, keys, belts, surfaces and flange patterns, each with its provenance.

Values are SI. `provenance` is "catalogue", "paper" or "estimated"; `estimated` names single values
of an otherwise known entry that are not confirmed.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from stiffopt.contact.surface import Material, SurfacePair
from stiffopt.declaration import Named
from stiffopt.drivetrain.fasteners import BoltData as BoltData
from stiffopt.drivetrain.fasteners import BoltGrade as BoltGrade
from stiffopt.drivetrain.fasteners import ClampedMaterial as ClampedMaterial
from stiffopt.drivetrain.fasteners import HexagonData as HexagonData
from stiffopt.drivetrain.fasteners import SetScrewData as SetScrewData
from stiffopt.drivetrain.fasteners import bolt as bolt
from stiffopt.drivetrain.fasteners import bolt_grade as bolt_grade
from stiffopt.drivetrain.fasteners import bolt_grades as bolt_grades
from stiffopt.drivetrain.fasteners import bolt_sizes as bolt_sizes
from stiffopt.drivetrain.fasteners import clamped_material as clamped_material
from stiffopt.drivetrain.fasteners import coating as coating
from stiffopt.drivetrain.fasteners import coating_names as coating_names
from stiffopt.drivetrain.fasteners import hexagon as hexagon
from stiffopt.drivetrain.fasteners import proof_stress as proof_stress
from stiffopt.drivetrain.fasteners import set_screw as set_screw
from stiffopt.drivetrain.fasteners import set_screw_modulus as set_screw_modulus
from stiffopt.drivetrain.fasteners import set_screw_sizes as set_screw_sizes
from stiffopt.drivetrain.fasteners import shaft_proof_stress as shaft_proof_stress
from stiffopt.drivetrain.fasteners import shanked as shanked
from stiffopt.drivetrain.fasteners import tensile_strength as tensile_strength
from stiffopt.drivetrain.fasteners import washer as washer
from stiffopt.drivetrain.tables import Entry as Entry
from stiffopt.drivetrain.tables import find, own_entries, read_table, rows, source_text
from stiffopt.drivetrain.tables import with_own as with_own
from stiffopt.errors import InputError, nearest


@dataclass(frozen=True, kw_only=True)
class ReducerData(Entry):
    """Strain-wave or cycloidal reducer: three stiffness ranges and, where known, ratings."""

    ratio: int  # turns of the input for one turn of the output
    # Slopes below T1, up to T2, above [N m/rad].
    K1: float
    K2: float
    K3: float
    # [N m].
    T1: float
    T2: float
    # (rated, repeated peak, momentary peak) [N m].
    ratings: tuple[float, float, float] | None = None
    # Output speed [rad/s] and life L10 [s] of the rated torque, and the exponent of the torque.
    rated_speed: float | None = None
    rated_life: float | None = None
    life_exponent: float | None = None

    @property
    def rated_torque(self) -> float | None:
        """Torque of the rated life [N m]."""
        return None if self.ratings is None else self.ratings[0]


@dataclass(frozen=True, kw_only=True)
class KeyData(Entry):
    """Parallel key: section, shafts it belongs to, keyway depths and carrying heights [m]."""

    width: float
    height: float
    shaft_min: float
    shaft_max: float
    shaft_depth: float
    hub_depth: float
    shaft_flank_height: float
    hub_flank_height: float


@dataclass(frozen=True, kw_only=True)
class BeltData(Entry):
    """Synchronous belt profile: lengths [m], moduli [Pa], span stiffness by width [N]."""

    pitch: float
    tooth_height: float
    tooth_root_width: float
    flank_angle: float
    tooth_modulus: float
    tooth_poisson: float
    teeth_in_mesh_max: float
    span_stiffness: Mapping[str, float]

    def span_stiffness_at(self, width: float) -> float:
        """Force for a unit strain of one span [N], interpolated or scaled over the width [m]."""
        table = sorted((float(w), c) for w, c in self.span_stiffness.items())
        if width <= table[0][0]:
            return table[0][1] * width / table[0][0]
        if width >= table[-1][0]:
            return table[-1][1] * width / table[-1][0]
        for (w0, c0), (w1, c1) in itertools.pairwise(table):
            if width <= w1:
                return c0 + (c1 - c0) * (width - w0) / (w1 - w0)
        raise AssertionError("the table covers every width")


@dataclass(frozen=True, kw_only=True)
class FlangeData(Entry):
    """Bolt pattern at a reducer."""

    bolt: str  # size, for example "M5"
    count: int
    circle_diameter: float  # of the bolts [m]
    # Of the contact ring [m].
    inner_radius: float
    outer_radius: float
    preload: float  # nominal, of one bolt [N]
    # Of the maker's table [N m].
    tightening_torque: float
    transmissible_torque: float


_RADIANS_PER_ARCMINUTE = math.pi / 10800.0
# Ratios of the makers' tables; the stiffness class of each is 30, 50 or 80.
# Rated life L10 [s] and speed [rad/s]. Wave generator bearing at 2000 rpm of the input: Harmonic
# Drive, CSF/CSG catalogue, "Life of the wave generator"; CSG gears last 10000 h. Output bearings of
# RV-E gears at 15 rpm: Nabtesco, RV series catalogue, "Service life".
_STRAIN_WAVE_LIFE, _STRAIN_WAVE_INPUT_SPEED = 7000.0 * 3600.0, 2000.0 * math.pi / 30.0
_CYCLOIDAL_LIFE, _CYCLOIDAL_SPEED = 6000.0 * 3600.0, 15.0 * math.pi / 30.0
_LISTED_RATIOS = (30, 50, 80, 100, 120, 160)


def _stiffness_class(ratio: int) -> str:
    return "30" if ratio < 50 else "50" if ratio < 80 else "80"


def reducer_names() -> list[str]:
    """Return the names of the reducers: user entries, harmonic_SIZE_RATIO and rv_SIZE_RATIO."""
    return [*own_entries("reducer"), *_packaged_reducers()]


def reducer(name: str) -> ReducerData:
    """Look up a reducer by name, for example "harmonic_25_100"; user entries come first."""
    own, packaged = own_entries("reducer"), _packaged_reducers()
    if name not in own and name not in packaged:
        raise InputError(f"no reducer {name!r} in the catalogue. {nearest(name, reducer_names())}")
    return ReducerData(**own[name]) if name in own else packaged[name]


@functools.cache
def _packaged_reducers() -> dict[str, ReducerData]:
    return {each.name: each for each in (*_strain_wave(), *_read_cycloidal())}


def _strain_wave() -> Iterator[ReducerData]:
    table = read_table("reducers")
    for row in sorted(table["reducer"], key=lambda row: int(row["size"])):
        for ratio in _LISTED_RATIOS:
            if _stiffness_class(ratio) != row["class"]:
                continue
            name = f"harmonic_{row['size']}_{ratio}"
            ratings = table["ratings"].get(name)
            yield ReducerData(
                name=name,
                provenance=row["provenance"],
                source=source_text(table, row["source"]),
                estimated=tuple(row.get("estimated", ())),
                ratio=ratio,
                K1=row["K"][0],
                K2=row["K"][1],
                K3=row["K"][2],
                T1=row["T1"],
                T2=row["T2"],
                ratings=tuple(ratings["torque"]) if ratings else None,
                rated_speed=_STRAIN_WAVE_INPUT_SPEED / ratio,
                rated_life=_STRAIN_WAVE_LIFE,
                life_exponent=3.0,
            )


def _read_cycloidal() -> Iterator[ReducerData]:
    """Yield the cycloidal reducers: K1 from the lost motion up to 3 % of the rated torque."""
    table = read_table("cycloidal")
    for row in table["reducer"]:
        rated = row["torque"][0]
        corner, slope = 0.03 * rated, row["rigidity"] / _RADIANS_PER_ARCMINUTE
        for ratio in row["ratios"]:
            yield ReducerData(
                name=f"{row['name']}_{ratio}",
                provenance=row["provenance"],
                source=source_text(table, row["source"]),
                ratio=ratio,
                K1=corner / (0.5 * row["lost_motion"] * _RADIANS_PER_ARCMINUTE),
                K2=slope,
                K3=slope,
                T1=corner,
                T2=rated,
                ratings=tuple(row["torque"]),
                rated_speed=_CYCLOIDAL_SPEED,
                rated_life=_CYCLOIDAL_LIFE,
                life_exponent=10.0 / 3.0,
            )


def bearing_names() -> list[str]:
    """Return the names of the output bearings."""
    return list(rows("bearings", "bearing", "name"))


def bearing(name: str) -> dict[str, float]:
    """Look up the stiffnesses of an output bearing by name, for example "csf_2uh_25"."""
    row = find("bearing", name, rows("bearings", "bearing", "name"))
    return {key: float(value) for key, value in row.items() if key.endswith("_stiffness")}


def entry(name: str) -> Entry:
    """Provenance of a reducer or an output bearing."""
    if name not in bearing_names():
        return reducer(name)
    row = find("bearing", name, rows("bearings", "bearing", "name"))
    return Entry(name=name, provenance=row["provenance"], source=row["source"])


def key(width: float, height: float) -> KeyData:
    """Look up a parallel key by its section [m]."""
    name = f"{width * 1e3:g}x{height * 1e3:g}"
    row = dict(find("key", name, rows("keys", "key", "size")))
    return KeyData(name=row.pop("size"), **row)


def belt(name: str) -> BeltData:
    """Look up a belt profile by name, for example "HTD3M"."""
    return BeltData(**find("belt", name, rows("belts", "belt", "name")))


def belt_names() -> list[str]:
    """Names of the packaged belt profiles."""
    return list(rows("belts", "belt", "name"))


def flange_names() -> list[str]:
    """Names of the packaged bolt patterns."""
    return list(rows("flanges", "flange", "name"))


def flange(name: str) -> FlangeData:
    """Look up a bolt pattern by name, for example "flexspline_25"."""
    row = dict(find("flange pattern", name, rows("flanges", "flange", "name")))
    diameter = bolt(row["bolt"]).diameter
    row["inner_radius"] = row["circle_diameter"] / 2 - diameter
    row["outer_radius"] = row["circle_diameter"] / 2 + diameter
    row["preload"] = float(read_table("flanges")["preload"][row["bolt"]])
    row["estimated"] = ("inner_radius", "outer_radius", "preload")
    return FlangeData(**row)


def material(name: str) -> Material:
    """Look up a material by name: steel, aluminium or iron."""
    row = find("material", name, read_table("surfaces")["materials"])
    return Material(
        name=name, modulus=row["young"], poisson=row["poisson"], hardness=row["hardness"]
    )


def surface_names() -> list[str]:
    """Names of the packaged surface pairs."""
    return list(rows("surfaces", "surface", "name"))


def surface_entry(name: str) -> Entry:
    """Provenance of a packaged surface pair."""
    row = find("surface", name, rows("surfaces", "surface", "name"))
    return Entry(name=name, provenance=row["provenance"], source=row["source"])


def surface(name: str) -> SurfacePair:
    """Look up a pair of surfaces by name, for example "fine_steel"."""
    return _read_surface(name) if name in own_entries("surface") else _packaged_surface(name)


@functools.cache
def _packaged_surface(name: str) -> SurfacePair:
    return _read_surface(name)


def _read_surface(name: str) -> SurfacePair:
    row = find("surface", name, rows("surfaces", "surface", "name"))
    return SurfacePair(
        name=name,
        first=material(row["first"]),
        second=material(row["second"]),
        fractal_dimension=row["fractal_dimension"],
        fractal_roughness=row["fractal_roughness"],
        friction=row["friction"],
    )


Named.tables.update(
    {
        "reducer": reducer_names,
        "bearing": bearing_names,
        "belt": belt_names,
        "flange pattern": flange_names,
        "bolt": bolt_sizes,
        "bolt grade": bolt_grades,
        "set screw": set_screw_sizes,
        "material": lambda: read_table("surfaces")["materials"],
        "clamped material": lambda: read_table("fastening")["material"],
        "coating": coating_names,
        "shaft material": lambda: read_table("fastening")["shaft"],
    }
)
