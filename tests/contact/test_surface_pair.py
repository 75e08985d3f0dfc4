from __future__ import annotations

import math

import pytest
from surfaces import ALUMINIUM, FINE, IRON, STEEL, steel_surface

from stiffopt.contact.surface import Material, SurfacePair
from stiffopt.errors import InputError, OutOfValidityError


# Published moduli [GPa], three digits.
@pytest.mark.parametrize(
    ("second", "normal", "shear", "ratio"),
    [
        (STEEL, 115.4, 23.8, 0.824),
        (ALUMINIUM, 59.2, 12.0, 0.808),
        (IRON, 82.9, 17.3, 0.836),
    ],
)
def test_contact_moduli(second: Material, normal: float, shear: float, ratio: float) -> None:
    pair = steel_surface(2.4, 1.29e-9, second=second)
    assert pair.contact_modulus / 1e9 == pytest.approx(normal, abs=0.06)
    assert pair.contact_shear_modulus / 1e9 == pytest.approx(shear, abs=0.06)
    assert pair.shear_ratio == pytest.approx(ratio, abs=6e-4)


def test_shear_ratio_of_equal_bodies() -> None:
    nu = STEEL.poisson
    assert FINE.shear_ratio == pytest.approx(2 * (1 - nu) / (2 - nu), rel=1e-14)


def test_softer_body_decides() -> None:
    assert steel_surface(2.4, 1.29e-9, second=ALUMINIUM).softer is ALUMINIUM


@pytest.mark.parametrize("dimension", [2.0, 3.0, 1.4, 3.2, math.nan])
def test_dimension_outside_validity(dimension: float) -> None:
    with pytest.raises(OutOfValidityError, match=r"fractal_dimension = .* range 2 to 3"):
        steel_surface(dimension, 1e-9)


@pytest.mark.parametrize("roughness", [0.0, -1e-9, math.nan, math.inf])
def test_roughness_must_be_above_zero(roughness: float) -> None:
    with pytest.raises(InputError, match=r"fractal_roughness = .* finite number above 0"):
        steel_surface(2.4, roughness)


def test_surface_without_elastic_spots_at_light_load() -> None:
    with pytest.raises(OutOfValidityError, match=r"all spots plastic.*smaller fractal_roughness"):
        steel_surface(2.3, 1e-8, reference_area=1e-6)
    with pytest.raises(OutOfValidityError):
        steel_surface(2.0001, 1e-9)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"reference_area": -1e-4}, "reference_area = -0.0001"),
        ({"friction": -0.1}, "friction = -0.1"),
        ({"friction": math.nan}, "friction = nan"),
        ({"gamma": 1.0}, "gamma = 1"),
    ],
)
def test_wrong_settings_are_named(change: dict[str, float], text: str) -> None:
    with pytest.raises(InputError, match=text):
        steel_surface(2.4, 1.29e-9, **change)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"modulus": -1.0}, "modulus = -1 cannot be used; allowed is a finite number above 0"),
        ({"hardness": math.nan}, "hardness = nan"),
        ({"poisson": 0.5}, "poisson = 0.5 is outside"),
    ],
)
def test_wrong_material_is_named(change: dict[str, float], text: str) -> None:
    settings = {"name": "soft", "modulus": 1e9, "poisson": 0.3, "hardness": 1e9} | change
    with pytest.raises(InputError, match=text) as caught:
        Material(**settings)
    assert "material 'soft'" in str(caught.value)


def test_pair_can_serve_as_key_of_a_cache() -> None:
    assert hash(FINE) == hash(steel_surface(2.4, 1.29e-9))
    assert isinstance(FINE, SurfacePair)
