"""Catalogue of the user: parts that the package does not have, named by a robot file."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from stiffopt.contact.surface import FRACTAL_ROUGHNESS
from stiffopt.declaration import (
    DETAIL,
    FRICTION,
    MODULUS,
    PART,
    POSITIVE,
    Angle,
    Area,
    Bounds,
    Doc,
    Force,
    JointStiffness,
    Length,
    Named,
    Pressure,
    Ratio,
    Torque,
)
from stiffopt.drivetrain.fasteners import bolt, bolt_sizes
from stiffopt.drivetrain.tables import OwnEntries, with_own
from stiffopt.errors import InputError, InputFileError, nearest
from stiffopt.files import read_document
from stiffopt.robot.elements import Cited
from stiffopt.validation import Section

# Bolts from M1 to M240 [m^2].
_STRESS_AREA_BOUNDS = Bounds(above=0.0, plausible=(1e-7, 0.05))
# ISO metric thread: pitch and core diameter are d less so many pitches.
_PITCH_DIAMETER_PITCHES, _CORE_DIAMETER_PITCHES = 0.649519, 1.226869


class OwnPart(Cited):
    """Part of a kind; `entry` returns a row of the form of the packaged tables."""

    kind: ClassVar[str]

    @property
    def called(self) -> str:
        """Name of the part in other files."""
        return str(getattr(self, "name"))  # noqa: B009

    def entry(self) -> dict[str, Any]:
        """Return the fields of the part with derived ones."""
        return self.model_dump()


class OwnReducer(OwnPart):
    """A reducer by the three slopes of its torsional stiffness; they may be equal."""

    kind = "reducer"
    name: Annotated[str, Doc("Name in robot files.")]
    ratio: Annotated[int, POSITIVE, Doc("Turns of the input for one turn of the output.")]
    K1: Annotated[JointStiffness, POSITIVE, Doc("Slope up to T1.")]
    K2: Annotated[JointStiffness, POSITIVE, Doc("Slope from T1 to T2.")]
    K3: Annotated[JointStiffness, POSITIVE, Doc("Slope above T2.")]
    T1: Annotated[Torque, POSITIVE, Doc("First corner.")]
    T2: Annotated[Torque, POSITIVE, Doc("Second corner, not below the first.")]
    ratings: Annotated[
        tuple[Torque, Torque, Torque] | None,
        Doc("Rated, repeated peak and momentary peak torque; `init robot` chooses by the second."),
    ] = None

    def entry(self) -> dict[str, Any]:
        """Check that corners and ratings increase."""
        if self.T2 < self.T1:
            raise InputError(f"T2: must not be below T1 = {self.T1:g}.")
        if self.ratings is not None and np.any(np.diff(self.ratings) < 0.0):
            raise InputError("ratings: must rise: rated, repeated, momentary.")
        return super().entry()


class OwnBolt(OwnPart):
    """A bolt; omitted values of its thread are those of an ISO metric one."""

    kind = "bolt"
    size: Annotated[str, Doc("Name in robot and study files.")]
    diameter: Annotated[Length, PART, Doc("Nominal diameter d.")]
    pitch: Annotated[Length, DETAIL, Doc("Pitch P.")]
    pitch_diameter: Annotated[Length | None, DETAIL, Doc("d2; default d - 0.6495 P.")] = None
    minor_diameter: Annotated[Length | None, DETAIL, Doc("d3; default d - 1.2269 P.")] = None
    stress_area: Annotated[
        Area | None, _STRESS_AREA_BOUNDS, Doc("A_S; default of (d2 + d3)/2.")
    ] = None
    head_diameter: Annotated[Length, DETAIL, Doc("d_k, diameter of the space of the head.")]
    bearing_diameter: Annotated[Length, DETAIL, Doc("d_w, diameter of the bearing face.")]
    hole: Annotated[Length, DETAIL, Doc("d_h, diameter of the clearance hole.")]

    @property
    def called(self) -> str:
        """Size of the bolt."""
        return self.size

    def entry(self) -> dict[str, Any]:
        """Check that diameters increase from thread to shank, hole and head; derive the thread."""
        d, pitch = self.diameter, self.pitch
        d2 = self.pitch_diameter or d - _PITCH_DIAMETER_PITCHES * pitch
        d3 = self.minor_diameter or d - _CORE_DIAMETER_PITCHES * pitch
        area = self.stress_area or math.pi / 16.0 * (d2 + d3) ** 2
        order = {
            "minor_diameter": d3, "pitch_diameter": d2, "diameter": d, "hole": self.hole,
            "bearing_diameter": self.bearing_diameter,
        }  # fmt: skip
        names, values = list(order), list(order.values())
        for k in range(1, len(values)):
            if not 0.0 < values[k - 1] < values[k]:
                raise InputError(
                    f"{names[k]}: {1e3 * values[k]:g} mm must be above {names[k - 1]}, which is"
                    f" {1e3 * values[k - 1]:g} mm."
                )
        if self.head_diameter < self.bearing_diameter:
            raise InputError("head_diameter: must not be below bearing_diameter.")
        if not 0.5 < area / (math.pi / 4.0 * d2**2) < 1.0:
            raise InputError(
                f"stress_area: {1e6 * area:.4g} mm^2 is none of a thread of d = {1e3 * d:g} mm."
            )
        known = {"pitch_diameter": d2, "minor_diameter": d3, "stress_area": area}
        return super().entry() | known


class OwnWasher(OwnPart):
    """A hardened washer; without one a bolt has that of ISO 7089 for its diameter."""

    kind = "washer"
    size: Annotated[str, Doc("Size of its bolt, of this file or packaged.")]
    diameter: Annotated[Length, PART, Doc("Outer diameter.")]
    thickness: Annotated[Length, DETAIL, Doc("Thickness h_S.")]
    pressure: Annotated[
        Pressure | None, MODULUS, Doc("Permissible pressure; default that of 300 HV.")
    ] = None

    @property
    def called(self) -> str:
        """Size of its bolt."""
        return self.size


class OwnKey(OwnPart):
    """A parallel key, named by its width and height."""

    kind = "key"
    width: Annotated[Length, DETAIL, Doc("Width.")]
    height: Annotated[Length, DETAIL, Doc("Height.")]
    shaft_min: Annotated[Length, PART, Doc("Least shaft diameter, exclusive.")]
    shaft_max: Annotated[Length, PART, Doc("Largest shaft diameter, inclusive.")]
    shaft_depth: Annotated[Length, DETAIL, Doc("Depth of the keyway in the shaft.")]
    hub_depth: Annotated[Length, DETAIL, Doc("Depth of the keyway in the hub.")]
    shaft_flank_height: Annotated[Length, DETAIL, Doc("Bearing flank height in the shaft.")]
    hub_flank_height: Annotated[Length, DETAIL, Doc("Bearing flank height in the hub.")]

    @property
    def called(self) -> str:
        """Width and height in mm."""
        return f"{self.width * 1e3:g}x{self.height * 1e3:g}"

    def entry(self) -> dict[str, Any]:
        """Check that flanks fit the key and the range of shafts is not empty."""
        if self.shaft_flank_height + self.hub_flank_height > self.height * (1.0 + 1e-9):
            raise InputError("hub_flank_height: both flanks together are higher than the key.")
        if self.shaft_max <= self.shaft_min:
            raise InputError("shaft_max: must be above shaft_min.")
        return super().entry() | {"size": self.called}


class OwnBelt(OwnPart):
    """A synchronous belt profile."""

    kind = "belt"
    name: Annotated[str, Doc("Name of the profile in robot files.")]
    pitch: Annotated[Length, PART, Doc("Pitch of the teeth.")]
    tooth_height: Annotated[Length, DETAIL, Doc("Height of a tooth.")]
    tooth_root_width: Annotated[Length, DETAIL, Doc("Width of a tooth at its root.")]
    flank_angle: Annotated[Angle, POSITIVE, Doc("Angle of a flank against the height.")]
    tooth_modulus: Annotated[Pressure, MODULUS, Doc("Young's modulus of the teeth.")]
    tooth_poisson: Annotated[Ratio, POSITIVE, Doc("Poisson's ratio of the teeth.")] = 0.48
    teeth_in_mesh_max: Annotated[float, POSITIVE, Doc("Teeth counted in mesh, at most.")] = 6.0
    span_stiffness: Annotated[
        dict[str, Force],
        POSITIVE,
        Field(min_length=1),
        Doc('Force for a unit strain of one span, by width in m: { "10e-3" = 80e3 }.'),
    ]

    def entry(self) -> dict[str, Any]:
        """Check that widths are numbers."""
        for width in self.span_stiffness:
            try:
                wide = float(width)
            except ValueError:
                wide = math.nan
            if not 0.0 < wide < math.inf:
                raise InputError(f"span_stiffness: {width!r} is no width in m, such as 10e-3.")
        return super().entry()


class OwnSurface(OwnPart):
    """A pair of rough surfaces."""

    kind = "surface"
    name: Annotated[str, Doc("Name in robot files.")]
    first: Annotated[str, Named("material"), Doc("Material of one body.")]
    second: Annotated[str, Named("material"), Doc("Material of the other.")]
    fractal_dimension: Annotated[float, Doc("D of the combined surface, above 2, below 3.")]
    fractal_roughness: Annotated[Length, FRACTAL_ROUGHNESS, Doc("G of the combined surface.")]
    friction: Annotated[Ratio, FRICTION, Doc("Coefficient of static friction.")]

    def entry(self) -> dict[str, Any]:
        """Check the fractal dimension."""
        if not 2.0 < self.fractal_dimension < 3.0:
            raise InputError("fractal_dimension: must lie between 2 and 3.")
        return super().entry()


class CatalogueFile(Section):
    """Parts of the user, named by `catalogue` of a robot file."""

    schema_: Annotated[int, Doc("Version of the format: 1.")] = Field(alias="schema")
    kind: Annotated[Literal["catalogue"], Doc("Kind of file.")]
    reducer: Annotated[
        tuple[OwnReducer, ...], Doc("Reducers, before packaged ones of the same name.")
    ] = ()
    bolt: Annotated[tuple[OwnBolt, ...], Doc("Bolts, before packaged ones of the same size.")] = ()
    washer: Annotated[tuple[OwnWasher, ...], Doc("Washers, by the size of their bolts.")] = ()
    key: Annotated[tuple[OwnKey, ...], Doc("Keys, by width and height.")] = ()
    belt: Annotated[tuple[OwnBelt, ...], Doc("Belt profiles.")] = ()
    surface: Annotated[tuple[OwnSurface, ...], Doc("Pairs of surfaces.")] = ()


def read_own_catalogue(path: str | os.PathLike[str]) -> OwnEntries:
    """Read a catalogue file: rows of the form of the packaged tables, by kind and name."""
    path = Path(path)
    document = read_document(path, CatalogueFile, "catalogue")
    found: dict[str, dict[str, Any]] = {}
    parts: tuple[OwnPart, ...] = (
        *document.reducer, *document.bolt, *document.washer, *document.key, *document.belt,
        *document.surface,
    )  # fmt: skip
    for part in parts:
        where, own = f"{part.kind}[{part.called}]", found.setdefault(part.kind, {})
        if part.called in own:
            raise InputFileError(path, where, "is given twice. Keep one.")
        try:
            own[part.called] = part.entry()
        except InputError as error:
            key, _, text = str(error).partition(": ")
            raise InputFileError(path, f"{where}.{key}", text) from error
    with with_own(found):
        for washer in document.washer:
            _check_washer(washer, path)
    return found


def _check_washer(washer: OwnWasher, path: Path) -> None:
    """Raise `InputFileError` unless a washer has a bolt and is as wide as its head."""
    where, sizes = f"washer[{washer.size}]", bolt_sizes()
    if washer.size not in sizes:
        raise InputFileError(
            path, f"{where}.size", f"no bolt has this size. {nearest(washer.size, sizes)}"
        )
    least = bolt(washer.size).bearing_diameter
    if washer.diameter < least:
        raise InputFileError(
            path,
            f"{where}.diameter",
            f"{1e3 * washer.diameter:g} mm must be at least {1e3 * least:g} mm, on which the head"
            f" of {washer.size} bears.",
        )
