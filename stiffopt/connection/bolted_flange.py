"""Bolted ring interface: friction carries the torque, rough surfaces are compliant."""

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
from stiffopt.errors import InputError
from stiffopt.symbolic import Quantity

# Upper end of the fitted contact law [Pa]: ring interfaces of reducers exceed key flanks.
_HIGHEST_PRESSURE = 1e9

BoltCount = Annotated[int, POSITIVE, Doc("Number of bolts on the circle, two or more.")]
CircleDiameter = Annotated[Length, PART, Doc("Pitch circle of the bolts.")]


@dataclass(frozen=True, kw_only=True)
class BoltedFlange(ContactConnection):
    """Annular interface under the uniform pressure p = n F/A of its bolts.

    That holds for two bolts or more, whose resultant is on the axis, and a flange stiff between
    them. Without slip the torsional stiffness is k_t(p) J_p with J_p = pi/2 (Ro^4 - Ri^4); towards
    the slip torque it falls by the shear law. A sector of the ring has its share of A and J_p.
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
        Doc("One of the bolts; sets limits and loss of the preload, not the stiffness."),
    ] = None
    preload_is: Annotated[
        Literal["assembly", "net", "assumed"],
        Doc(
            "Meaning of `preload`: the largest at assembly, or the least in service after scatter "
            "and embedding, as a maker's transmissible torque implies, or an assumed value at "
            "assembly if the present one is unknown."
        ),
    ] = "assembly"
    tightening_torque: Annotated[
        Torque | None,
        POSITIVE,
        Doc("Wrench setting of the present bolts, if their maker states it."),
    ] = None
    bearing: Annotated[
        Literal["none", "beside"],
        Doc(
            "none: the ring carries all six components of the joint's load. beside: a bearing "
            "beside it carries all but the torque."
        ),
    ] = "none"
    face_position: Annotated[
        Length,
        Doc("Position of the interface along the joint's axis, from the origin of the joint."),
    ] = 0.0
    fixed_pattern: Annotated[
        bool,
        Doc("A purchased part fixes size, number and circle of the bolts."),
    ] = False
    roughness: Annotated[
        Length, ROUGHNESS, Doc("Rz of the faces; sets the embedding, not the stiffness.")
    ] = 16e-6
    interfaces: Annotated[
        int, Bounds(least=1), Doc("Faces between the clamped parts that settle.")
    ] = 1
    load_introduction: Annotated[
        Ratio | None,
        Bounds(least=0.0, most=1.0),
        Doc(
            "Load introduction factor n; default the unfavourable bound of every check: 1 for the "
            "bolt, 0 for the clamped parts."
        ),
    ] = None
    ring: Annotated[
        FlangeRing | None,
        Doc("Elastic flange, whose bolts near the ribs carry more; default a rigid flange."),
    ] = None
    # Number of equal parallel connections that share the ring: with bolt_count 1 and one sector a
    # bolt this is the sector of one bolt.
    sectors: Annotated[int, Bounds(least=1)] = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        POSITIVE.check(f"{self.owner}: friction", self.friction_coefficient)
        require_ordered(self.owner, inner_radius=self.inner_radius, outer_radius=self.outer_radius)
        if self.bolt_count * self.sectors == 1:
            raise InputError(
                f"{self.owner}: bolt_count = 1: one bolt beside the axis presses one side of the "
                "ring and opens the other (VDI 2230, eccentric clamping), which is not modelled. "
                "Give two or more bolts, or a 'constant' spring in place of the ring."
            )

    @cached_property
    def law(self) -> ContactLaw:
        """Smooth contact law of the interface."""
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

    def slip_torque(self, preload: Quantity | None = None) -> Quantity:
        """Return the torque of full slip, mu p 2 pi/3 (Ro^3 - Ri^3) [N m]."""
        pressure = self.bolt_count * self._preload_or_own(preload) / self.area
        lever = 2 * math.pi / 3 * (self.outer_radius**3 - self.inner_radius**3) / self.sectors
        return self.friction_coefficient * pressure * lever

    def first_slip_torque(self, preload: Quantity | None = None) -> Quantity:
        """Return the torque at which the rim begins to slip, mu p J_p/Ro [N m]."""
        pressure = self.bolt_count * self._preload_or_own(preload) / self.area
        return self.friction_coefficient * pressure * self.polar_moment / self.outer_radius

    def _unsheared_stiffness(self, preload: Quantity) -> Quantity:
        pressure = self.bolt_count * preload / self.area
        return self.surface.shear_ratio * self.law.stiffness(pressure) * self.polar_moment

    def loading_windup(self, torque: Quantity, preload: Quantity) -> Quantity:
        """Return T_slip/K0 times the normalised shear travel [rad]."""
        slip = self.slip_torque(preload)
        pressure = self.bolt_count * preload / self.area
        travel = shear_travel(self.law, pressure, torque / slip, self.shear)
        return slip / self._unsheared_stiffness(preload) * travel

    def loading_compliance(self, torque: Quantity, preload: Quantity) -> Quantity:
        """Return the shear softening over K0 [rad/(N m)]."""
        ratio = torque / self.slip_torque(preload)
        pressure = self.bolt_count * preload / self.area
        softening = shear_softening(self.law, pressure, ratio, self.shear)
        return softening / self._unsheared_stiffness(preload)
