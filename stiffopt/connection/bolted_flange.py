"""Ring face held by bolts: friction carries the torque, rough surfaces yield a little."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar, Literal

from stiffopt.connection.connection import ContactConnection
from stiffopt.connection.fastener import Bolt, FlangeRing
from stiffopt.contact.shear import ShearLaw, shear_softening, shear_travel
from stiffopt.contact.surface import LOWEST_PRESSURE, SurfacePair
from stiffopt.contact.surrogate import ContactLaw, LawName, contact_law
from stiffopt.contact.validate import require_ordered
from stiffopt.declaration import (
    FRICTION,
    PART,
    POSITIVE,
    ROUGHNESS,
    Bounds,
    Doc,
    Length,
    Ratio,
    Torque,
)
from stiffopt.symbolic import Quantity

# Ring faces of reducers are pressed harder than key flanks.
_HIGHEST_PRESSURE = 1e9

BoltCount = Annotated[int, POSITIVE, Doc("Number of bolts.")]
CircleDiameter = Annotated[Length, PART, Doc("Pitch circle of the bolts.")]


@dataclass(frozen=True, kw_only=True)
class BoltedFlange(ContactConnection):
    """Annular face under the even pressure p = n F/A of its bolts.

    Without slip the torsional stiffness is k_t(p) J_p with J_p = pi/2 (Ro^4 - Ri^4); towards the
    slip torque it falls by the shear law. A sector of the ring has its share of A and J_p.

    Notes
    -----
    Valid up to 0.95 of the slip torque; beyond, the wind-up continues smoothly with growing
    compliance, while the exact compliance is infinite from slip on.
    """

    kind: ClassVar[str] = "bolted_flange"
    references: ClassVar[tuple[str, ...]] = (*ContactConnection.references, "VDI2230")
    takes_preload: ClassVar[bool] = True
    needs_preload: ClassVar[bool] = True
    bolt_count: BoltCount
    circle_diameter: CircleDiameter
    inner_radius: Annotated[Length, PART, Doc("Inner radius Ri of the pressed ring.")]
    outer_radius: Annotated[Length, PART, Doc("Outer radius Ro of the pressed ring.")]
    surface: Annotated[SurfacePair, Doc("Pair of surfaces of the ring.")]
    friction: Annotated[
        Ratio | None,
        FRICTION,
        Doc("Coefficient of friction of the ring; default that of the surface."),
    ] = None
    shear: ShearLaw = "mindlin"
    contact_law: LawName | ContactLaw = "log_cubic"
    bolt: Annotated[
        Bolt | None,
        Doc("What one of the bolts is; sets its limits and its loss of preload, not stiffness."),
    ] = None
    preload_is: Annotated[
        Literal["assembly", "net", "assumed"],
        Doc(
            "What `preload` means: the largest that assembly leaves, or the least that is there in "
            "service, scatter and embedding taken off, as a maker's transmissible torque implies; "
            "or a number to begin with, at assembly, where nobody knows the present one."
        ),
    ] = "assembly"
    tightening_torque: Annotated[
        Torque | None,
        POSITIVE,
        Doc("Setting of the wrench for the present bolts, where their maker states it."),
    ] = None
    bearing: Annotated[
        Literal["none", "beside"],
        Doc(
            "Whether the ring carries all six components of the joint's load, which is taken "
            "where nothing is known, or a bearing beside it all but the torque."
        ),
    ] = "none"
    face_position: Annotated[
        Length,
        Doc("Of the pressed face along the joint's axis, from the origin of the joint."),
    ] = 0.0
    fixed_pattern: Annotated[
        bool,
        Doc("Whether a purchased part fixes size, number and circle of the bolts."),
    ] = False
    roughness: Annotated[
        Length, ROUGHNESS, Doc("Rz of the faces; sets how far they settle, not the stiffness.")
    ] = 16e-6
    interfaces: Annotated[
        int, Bounds(least=1), Doc("Faces between the clamped parts that settle.")
    ] = 1
    load_introduction: Annotated[
        Ratio | None,
        Bounds(least=0.0, most=1.0),
        Doc(
            "n, how far from the face the load enters; default the unfavourable end of every "
            "check: 1 for the bolt, 0 for what it clamps."
        ),
    ] = None
    ring: Annotated[
        FlangeRing | None,
        Doc("Where the flange bends: bolts near the ribs bear more; default a rigid flange."),
    ] = None
    # How many such connections share the ring: with bolt_count 1 and as many sectors as there are
    # bolts this is the sector that one bolt presses. Sectors are parallel springs.
    sectors: Annotated[int, Bounds(least=1)] = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        POSITIVE.check(f"{self.owner}: friction", self.friction_coefficient)
        require_ordered(self.owner, inner_radius=self.inner_radius, outer_radius=self.outer_radius)

    @cached_property
    def law(self) -> ContactLaw:
        """Smooth contact law of the face."""
        return contact_law(self.surface, self.contact_law, LOWEST_PRESSURE, _HIGHEST_PRESSURE)

    @property
    def friction_coefficient(self) -> float:
        """Coefficient of friction in use [-]."""
        return self.surface.friction if self.friction is None else self.friction

    @property
    def area(self) -> float:
        """Area of the ring, or of the sector [m^2]."""
        return math.pi * (self.outer_radius**2 - self.inner_radius**2) / self.sectors

    @property
    def polar_moment(self) -> float:
        """J_p of the ring, or of the sector [m^4]."""
        return math.pi / 2 * (self.outer_radius**4 - self.inner_radius**4) / self.sectors

    def pressure(self, torque: Quantity, preload: Quantity | None = None) -> Quantity:
        """Pressure n F/A of the ring [Pa], whatever the torque."""
        return self.bolt_count * self._preload_or_own(preload) / self.area + 0.0 * torque

    def slip_torque(self, preload: Quantity | None = None) -> Quantity:
        """Torque at which the whole ring slips, mu p 2 pi/3 (Ro^3 - Ri^3) [N m]."""
        pressure = self.bolt_count * self._preload_or_own(preload) / self.area
        lever = 2 * math.pi / 3 * (self.outer_radius**3 - self.inner_radius**3) / self.sectors
        return self.friction_coefficient * pressure * lever

    def slip_torque_circle(self, preload: Quantity | None = None) -> Quantity:
        """Slip torque with all friction on the bolt circle, mu n F PCD/2 [N m]."""
        force = self.bolt_count * self._preload_or_own(preload)
        return self.friction_coefficient * force * self.circle_diameter / 2

    def first_slip_torque(self, preload: Quantity | None = None) -> Quantity:
        """Torque at which the rim begins to slip, mu p J_p/Ro [N m]."""
        pressure = self.bolt_count * self._preload_or_own(preload) / self.area
        return self.friction_coefficient * pressure * self.polar_moment / self.outer_radius

    def _unsheared_stiffness(self, preload: Quantity) -> Quantity:
        pressure = self.bolt_count * preload / self.area
        return self.surface.shear_ratio * self.law.stiffness(pressure) * self.polar_moment

    def loading_windup(self, torque: Quantity, preload: Quantity) -> Quantity:
        """T_slip/K0 times the shear travel [rad]."""
        slip = self.slip_torque(preload)
        pressure = self.bolt_count * preload / self.area
        travel = shear_travel(self.law, pressure, torque / slip, self.shear)
        return slip / self._unsheared_stiffness(preload) * travel

    def loading_compliance(self, torque: Quantity, preload: Quantity) -> Quantity:
        """Softening by shear over K0 [rad/(N m)]."""
        ratio = torque / self.slip_torque(preload)
        pressure = self.bolt_count * preload / self.area
        softening = shear_softening(self.law, pressure, ratio, self.shear)
        return softening / self._unsheared_stiffness(preload)
