"""Flanges and pins that the tests of fasteners share."""

from __future__ import annotations

from stiffopt.connection import Bolt, BoltedFlange, ClampingPins, SetScrew
from stiffopt.drivetrain import catalogue


def flange(size: str = "M5", grade: str = "12.9", **changes: object) -> BoltedFlange:
    """Flexspline flange of a size 25 reducer."""
    bolt_keys = ("clamp_length", "engagement", "head_material", "thread_material")
    bolt = {key: changes.pop(key) for key in bolt_keys if key in changes}
    settings = {
        "name": "flexspline_flange",
        "torque_max": 110.0,
        "preload": 7800.0,
        "bolt_count": 9,
        "circle_diameter": 30e-3,
        "inner_radius": 10e-3,
        "outer_radius": 20e-3,
        "surface": catalogue.surface("fine_steel"),
        "bolt": Bolt(size=size, grade=grade, **bolt),
    }
    return BoltedFlange(**(settings | changes))


def pins(**changes: object) -> ClampingPins:
    """Two set screws M4 on a shaft of 8 mm."""
    settings = {
        "name": "pulley_pins",
        "torque_max": 0.38,
        "count": 2,
        "shaft_diameter": 8e-3,
        "tip_diameter": 2e-3,
        "preload": 1500.0,
        "surface": catalogue.surface("fine_steel"),
        "screw": SetScrew(size="M4"),
    }
    return ClampingPins(**(settings | changes))
