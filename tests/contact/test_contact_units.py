"""The algebra of contacts with quantities instead of numbers: units must come out right."""

from __future__ import annotations

import math

import pint
import pytest

from stiffopt.connection.gear_pair import mean_pressure
from stiffopt.contact.spots import spot_laws
from stiffopt.contact.surface import Material, SurfacePair

UNITS = pint.UnitRegistry()
GPA = UNITS.gigapascal


class Quantified:
    """A material or a surface with units, without the checks of plain numbers."""

    def __init__(self, **fields: object) -> None:
        self.__dict__.update(fields)


BODY = Quantified(modulus=210 * GPA, poisson=0.3, hardness=2.2 * GPA)
BODY.shear_modulus = Material.shear_modulus.fget(BODY)
PAIR = Quantified(first=BODY, second=BODY)


def test_contact_moduli_units() -> None:
    assert BODY.shear_modulus.check("[pressure]")
    modulus = SurfacePair.contact_modulus.fget(PAIR)
    shear = SurfacePair.contact_shear_modulus.fget(PAIR)
    assert modulus.check("[pressure]")
    assert shear.check("[pressure]")
    PAIR.contact_modulus, PAIR.contact_shear_modulus = modulus, shear
    ratio = SurfacePair.shear_ratio.fget(PAIR)
    assert ratio.check("[]")
    assert ratio.to("").magnitude == pytest.approx(1.4 / 1.7)


def test_line_contact_units() -> None:
    load, radius, modulus = 100 * UNITS.newton / UNITS.mm, 10 * UNITS.mm, 115.4 * GPA
    pressure = mean_pressure(load, radius, modulus)
    assert pressure.check("[pressure]")
    assert pressure.to("MPa").magnitude == pytest.approx(
        1e-6 * mean_pressure(1e5, 0.01, 115.4e9), rel=1e-12
    )


def test_single_spot_units() -> None:
    # Tip radius, interference and force of one spot: G^(D-2) carries a fractional length.
    dimension, roughness, area = 2.4, 1.29e-9 * UNITS.m, 1e-8 * UNITS.m**2
    scale = roughness ** (dimension - 2) * math.sqrt(math.log(1.5))
    interference = 2 ** (4 - dimension) * scale * (area / math.pi) ** ((3 - dimension) / 2)
    tip = area / math.pi / (2 * interference)
    force = 4 / 3 * 115.4 * GPA * tip**0.5 * interference**1.5
    assert interference.check("[length]")
    assert tip.check("[length]")
    assert force.check("[force]")
    law = spot_laws(dimension, 1.29e-9, 1.5, 115.4e9, 2.2e9, 0.3)[-1]
    assert law.force_factor * 1e-8**law.force_exponent == pytest.approx(
        force.to("N").magnitude, rel=1e-12
    )
