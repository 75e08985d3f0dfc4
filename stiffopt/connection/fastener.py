"""Fasteners of connections: bolt, elastic flange ring, set screw."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from stiffopt.declaration import (
    DETAIL,
    NOT_NEGATIVE,
    Bounds,
    Doc,
    Length,
    Named,
    check_fields,
)


@dataclass(frozen=True, kw_only=True)
class Bolt:
    """One of the equal bolts of a flange, in a tapped hole or through both parts with a nut.

    Sizes, grades and materials are names of the catalogue.
    """

    size: Annotated[str, Named("bolt"), Doc("Size, such as M5.")]
    grade: Annotated[
        str,
        Named("bolt grade"),
        Doc("Property class of ISO 898-1, or of ISO 3506-1: A2-70, A4-80."),
    ] = "12.9"
    clamp_length: Annotated[
        Length | None,
        DETAIL,
        Doc("Clamp length l_K; default two bolt diameters, an estimate."),
    ] = None
    engagement: Annotated[
        Length | None,
        DETAIL,
        Doc(
            "Effective thread engagement m_eff; default by the material of the thread, an estimate."
        ),
    ] = None
    washer: Annotated[bool, Doc("Hardened washers under head and nut: ISO 7089, 300 HV.")] = False
    head: Annotated[
        Literal["socket", "hexagon"],
        Doc("Head of the bolt: socket head of ISO 4762, hexagon head of ISO 4014."),
    ] = "socket"
    nut: Annotated[
        bool,
        Doc("Hexagon nut of the bolt's class (ISO 4032) in place of a tapped hole."),
    ] = False
    shank_length: Annotated[
        Length | None,
        NOT_NEGATIVE,
        Doc(
            "Length of the bolt without thread within the clamp length; default none, with "
            "`shank_diameter` the whole clamp length."
        ),
    ] = None
    shank_diameter: Annotated[
        Length | None,
        DETAIL,
        Doc(
            "Diameter d_T of the part without thread; default the bolt's own, of necked-down bolts "
            "usually 0.9 d3."
        ),
    ] = None
    rolled: Annotated[
        Literal["before", "after"],
        Doc("Thread rolled before or after heat treatment; after has the higher endurance limit."),
    ] = "before"
    head_material: Annotated[
        str, Named("clamped material"), Doc("Material of the part under the head.")
    ] = "steel"
    thread_material: Annotated[
        str,
        Named("clamped material"),
        Doc("Material of the part with the tapped hole, or under the nut."),
    ] = "steel"

    def __post_init__(self) -> None:
        check_fields(self, f"bolt {self.size}")

    @property
    def added(self) -> str:
        """Further parts, such as "with nuts and washers"; "" if there are none."""
        parts = [name for name, has in (("nuts", self.nut), ("washers", self.washer)) if has]
        return f"with {' and '.join(parts)}" if parts else ""


@dataclass(frozen=True, kw_only=True)
class FlangeRing:
    """Elastic flange ring with the supports of its link."""

    thickness: Annotated[Length, DETAIL, Doc("Thickness of the flange, along the joint's axis.")]
    supports: Annotated[
        int,
        Bounds(least=3),
        Doc("Evenly spaced ribs or walls of the link that load the ring."),
    ]

    def __post_init__(self) -> None:
        check_fields(self, "ring")


@dataclass(frozen=True, kw_only=True)
class SetScrew:
    """Set screw behind the tip of a pin, or used as the pin."""

    size: Annotated[str, Named("set screw"), Doc("Size, such as M4.")]
    length: Annotated[
        Length | None,
        DETAIL,
        Doc("Length; default one and a half diameters, an estimate."),
    ] = None
    shaft_material: Annotated[
        str, Named("shaft material"), Doc("Material of the shaft under the tip.")
    ] = "hardened_steel"

    def __post_init__(self) -> None:
        check_fields(self, f"set screw {self.size}")
