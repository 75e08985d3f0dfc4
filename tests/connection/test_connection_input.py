"""Wrong numbers in connections: one message with the field, the value and what is allowed."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from elements import belt, flange, gears, key, pins, reducer

from stiffopt.connection import Connection, Constant, Shaft
from stiffopt.errors import InputError


def constant(**changes: object) -> Constant:
    return Constant(**({"name": "spring", "torque_max": 1.0, "stiffness": 1e4} | changes))


def shaft(**changes: object) -> Shaft:
    settings = {"name": "shaft", "torque_max": 1.0, "diameter": 8e-3, "length": 60e-3}
    return Shaft(**(settings | changes))


POSITIVE = [
    (key, "torque_max"),
    (key, "shaft_diameter"),
    (key, "length"),
    (key, "shaft_flank_height"),
    (key, "hub_flank_height"),
    (flange, "bolt_count"),
    (flange, "circle_diameter"),
    (flange, "inner_radius"),
    (flange, "preload"),
    (flange, "friction"),
    (pins, "count"),
    (pins, "shaft_diameter"),
    (pins, "tip_diameter"),
    (pins, "preload"),
    (pins, "friction"),
    (belt, "teeth"),
    (belt, "pitch"),
    (belt, "width"),
    (belt, "tooth_height"),
    (belt, "span_stiffness"),
    (belt, "span_length"),
    (belt, "tooth_modulus"),
    (belt, "preload"),
    (gears, "module"),
    (gears, "teeth"),
    (gears, "face_width"),
    (gears, "mesh_stiffness"),
    (reducer, "K1"),
    (reducer, "K2"),
    (reducer, "K3"),
    (reducer, "T1"),
    (constant, "stiffness"),
    (shaft, "diameter"),
    (shaft, "length"),
    (shaft, "shear_modulus"),
]


@pytest.mark.parametrize(
    ("make", "field"), POSITIVE, ids=[f"{make.__name__}-{field}" for make, field in POSITIVE]
)
@pytest.mark.parametrize("value", [-1.0, 0.0, math.nan, math.inf])
def test_numbers_above_zero(make: Callable[..., Connection], field: str, value: float) -> None:
    with pytest.raises(InputError) as caught:
        make(**{field: value})
    message = str(caught.value)
    assert f"{field}" in message
    assert f"= {value:g}" in message
    assert "allowed is a finite number above 0" in message
    assert message.startswith(f"{make().kind} {make().name!r}")


@pytest.mark.parametrize(
    ("make", "changes", "text"),
    [
        (reducer, {"T2": 3.0}, "T1 = 3.9 must be smaller than T2 = 3"),
        (flange, {"outer_radius": 4e-3}, "inner_radius = 0.0055 must be smaller than outer_radius"),
        (key, {"prepressure": -1.0}, "prepressure = -1 cannot be used"),
        (key, {"flanks": "paralel"}, "Did you mean 'parallel'"),
        (
            key,
            {"shaft_flank_height": 20e-3},
            "shaft_flank_height = 0.02 must be smaller than shaft_diameter",
        ),
        (key, {"preload": 100.0}, "takes no preload; remove it"),
        (flange, {"preload": None}, "preload is missing"),
        (flange, {"shear": "mindlinn"}, "Did you mean 'mindlin'"),
        (shaft, {"bore": 9e-3}, "bore = 0.009 must be smaller than diameter = 0.008"),
        (
            belt,
            {"tooth_poisson": 0.5},
            "tooth_poisson = 0.5 is outside the validity range 0 to 0.5",
        ),
        (belt, {"wrap": 7.0}, "wrap = 7 is outside"),
        (gears, {"contact_ratio": 0.5}, "contact_ratio = 0.5"),
        (gears, {"pressure_angle": 1.0}, "pressure_angle = 1 is outside"),
    ],
)
def test_other_limits(
    make: Callable[..., Connection], changes: dict[str, object], text: str
) -> None:
    with pytest.raises(InputError, match=text):
        make(**changes)


@pytest.mark.parametrize("law", ["log_cubik", "fractal"])
@pytest.mark.parametrize("make", [key, flange, pins, gears])
def test_unknown_contact_law_is_refused(make: Callable[..., Connection], law: str) -> None:
    with pytest.raises(InputError, match=f"contact_law = '{law}' is not known"):
        make(contact_law=law)


def test_new_preload_is_checked() -> None:
    with pytest.raises(InputError, match="preload = -5"):
        flange().with_preload(-5.0)
    with pytest.raises(InputError, match="takes no preload"):
        key().with_preload(100.0)
