"""What holds a bolted flange or a pinned shaft together: one bolt, one set screw."""

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

    Names of sizes, grades and materials are those of the catalogue; they are looked up where they
    are needed.
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
        Doc("Thickness l_K that the bolt clamps; default two bolt diameters, an estimate."),
    ] = None
    engagement: Annotated[
        Length | None,
        DETAIL,
        Doc(
            "Length m_eff of thread that carries; default by the material of the thread, an "
            "estimate."
        ),
    ] = None
    washer: Annotated[
        bool, Doc("Whether a hardened washer lies under head and nut: ISO 7089, 300 HV.")
    ] = False
    head: Annotated[
        Literal["socket", "hexagon"],
        Doc("Head of the bolt: socket head of ISO 4762, hexagon head of ISO 4014."),
    ] = "socket"
    nut: Annotated[
        bool,
        Doc(
            "Whether a hexagon nut of the bolt's own class (ISO 4032) holds it, in place of a "
            "tapped hole."
        ),
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
        Doc("Thread rolled before or after heat treatment; after bears more alternating stress."),
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
        """Parts beside the bolt itself: "with nuts and washers"; "" in a tapped hole without."""
        parts = [name for name, has in (("nuts", self.nut), ("washers", self.washer)) if has]
        return f"with {' and '.join(parts)}" if parts else ""


@dataclass(frozen=True, kw_only=True)
class FlangeRing:
    """Flange that is not rigid: a ring, and how its link is joined to it."""

    thickness: Annotated[Length, DETAIL, Doc("Thickness of the flange, along the joint's axis.")]
    supports: Annotated[
        int,
        Bounds(least=3),
        Doc("Ribs or walls of the link, at even distances, that bring the load to the ring."),
    ]

    def __post_init__(self) -> None:
        check_fields(self, "ring")


@dataclass(frozen=True, kw_only=True)
class SetScrew:
    """Set screw that presses the tip of a pin on a shaft, or is the pin itself."""

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
