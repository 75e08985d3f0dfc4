"""Materials and pairs of machined surfaces in contact."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Literal, get_args

import numpy as np

from stiffopt.contact.spots import Loading, SpotLaw, spot_laws, total_force
from stiffopt.contact.validate import require_one_of
from stiffopt.declaration import (
    FRICTION,
    MODULUS,
    POSITIVE,
    Area,
    Bounds,
    Doc,
    Length,
    Pressure,
    Ratio,
    check_fields,
)
from stiffopt.errors import OutOfValidityError

# Lowest nominal pressure [Pa] for which a surface must still have elastic spots.
LOWEST_PRESSURE = 0.1e6
# How many times larger than the all-plastic limit the largest spot must be at that pressure.
_SPOT_RESERVE = 10.0


@dataclass(frozen=True, kw_only=True)
class Material:
    """One of two bodies in contact."""

    name: Annotated[str, Doc("Name, for messages.")] = "material"
    modulus: Annotated[Pressure, MODULUS, Doc("Young's modulus.")]
    poisson: Annotated[Ratio, Bounds(above=0.0, below=0.5), Doc("Poisson's ratio.")]
    hardness: Annotated[
        Pressure, MODULUS, Doc("Indentation hardness, about 2.8 times the yield stress.")
    ]

    def __post_init__(self) -> None:
        check_fields(self, f"material {self.name!r}")

    @property
    def shear_modulus(self) -> float:
        """E/(2 (1 + nu)) [Pa]."""
        return self.modulus / (2 * (1 + self.poisson))


_FRICTION_BOUNDS = replace(FRICTION, above=-math.inf, least=0.0)
# Of measured surfaces 1e-13 to 1e-8 m.
FRACTAL_ROUGHNESS = Bounds(above=0.0, plausible=(0.0, 1e-3))


@dataclass(frozen=True, kw_only=True)
class SurfacePair:
    """Two rough surfaces pressed together, with the fractal description of their roughness.

    Refused when at 0.1 MPa the largest spot is not at least ten times above the all-plastic limit:
    such a surface would have no stiffness at light load, which is an artefact of the model.
    """

    name: str = "surface"
    first: Annotated[Material, Doc("One of the two bodies.")]
    second: Annotated[Material, Doc("The other body.")]
    fractal_dimension: Annotated[
        Ratio,
        Bounds(above=2.0, below=3.0),
        Doc("Fractal dimension D of the surface: that of a profile plus one."),
    ]
    fractal_roughness: Annotated[Length, FRACTAL_ROUGHNESS, Doc("Fractal roughness G.")]
    friction: Annotated[
        Ratio, _FRICTION_BOUNDS, Doc("Coefficient of friction of the interface.")
    ] = 0.15
    reference_area: Annotated[
        Area,
        POSITIVE,
        Doc(
            "Patch A0 for which D and G were found. The sum over spots does not grow in proportion "
            "to the area, so stiffness per area belongs to this patch and is then used for joint "
            "faces of any size."
        ),
    ] = 1e-4
    gamma: Annotated[
        Ratio,
        Bounds(above=1.0),
        Doc("Ratio of successive frequencies of the fractal surface; customary is 1.5."),
    ] = 1.5
    # Whether the contact has been loaded before; a robot file says it for all of its contacts.
    loading: Literal["first", "cyclic"] = "first"

    def __post_init__(self) -> None:
        owner = f"surface {self.name!r}"
        check_fields(self, owner)
        require_one_of(owner, get_args(get_args(Loading)[0]), loading=self.loading)
        self._require_elastic_spots(owner)

    def _require_elastic_spots(self, owner: str) -> None:
        smallest = _SPOT_RESERVE * self.spots[0].upper
        needed = float(total_force(self.spots, np.array(smallest), self.fractal_dimension))
        needed /= self.reference_area
        if not needed <= LOWEST_PRESSURE:
            raise OutOfValidityError(
                f"{owner}: lowest pressure with elastic spots",
                needed,
                0.0,
                LOWEST_PRESSURE,
                f"D = {self.fractal_dimension:g} with G = {self.fractal_roughness:g} m on "
                f"{self.reference_area:g} m^2 makes all spots plastic at light load; take a "
                f"smaller fractal_roughness or a larger fractal_dimension.",
            )

    @property
    def softer(self) -> Material:
        """The body with the smaller hardness."""
        return min(self.first, self.second, key=lambda body: body.hardness)

    @property
    def contact_modulus(self) -> float:
        """E* [Pa]: 1/E* = (1 - nu1^2)/E1 + (1 - nu2^2)/E2."""
        return 1 / sum((1 - body.poisson**2) / body.modulus for body in (self.first, self.second))

    @property
    def contact_shear_modulus(self) -> float:
        """G* [Pa]: 1/G* = (2 - nu1)/G1 + (2 - nu2)/G2."""
        return 1 / sum(
            (2 - body.poisson) / body.shear_modulus for body in (self.first, self.second)
        )

    @property
    def shear_ratio(self) -> float:
        """Tangential over normal stiffness of a spot without slip, 4 G*/E* [-] (Mindlin)."""
        return 4 * self.contact_shear_modulus / self.contact_modulus

    @cached_property
    def spots(self) -> tuple[SpotLaw, ...]:
        """Laws of the plastic, elastic-plastic and elastic spots."""
        return spot_laws(
            self.fractal_dimension,
            self.fractal_roughness,
            self.gamma,
            self.contact_modulus,
            self.softer.hardness,
            self.softer.poisson,
            loading=self.loading,
        )
