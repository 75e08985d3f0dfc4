"""One connection of every kind and option, for the tests that hold for all."""

from __future__ import annotations

import math

from stiffopt.connection import (
    BoltedFlange,
    ClampingPins,
    Connection,
    Constant,
    GearPair,
    Key,
    Reducer,
    Shaft,
    TimingBelt,
)
from stiffopt.contact.surface import Material, SurfacePair

STEEL = Material(name="steel", modulus=210e9, poisson=0.3, hardness=2.2e9)
FINE = SurfacePair(
    name="fine", first=STEEL, second=STEEL, fractal_dimension=2.4, fractal_roughness=10**-8.89
)
ROUGH = SurfacePair(
    name="rough", first=STEEL, second=STEEL, fractal_dimension=2.4, fractal_roughness=10**-8.33
)


def key(**changes: object) -> Key:
    """Key 5x5x20 on a shaft of 14 mm at a motor."""
    settings = {
        "name": "key",
        "torque_max": 0.57,
        "shaft_diameter": 14e-3,
        "length": 20e-3,
        "shaft_flank_height": 2.5e-3,
        "hub_flank_height": 2.0e-3,
        "surface": FINE,
        "prepressure": 1e5,
    }
    return Key(**(settings | changes))


def flange(**changes: object) -> BoltedFlange:
    """Flexspline flange of a size 14 reducer."""
    settings = {
        "name": "flange",
        "torque_max": 16.0,
        "bolt_count": 9,
        "circle_diameter": 17e-3,
        "inner_radius": 5.5e-3,
        "outer_radius": 11.5e-3,
        "preload": 2750.0,
        "surface": FINE,
    }
    return BoltedFlange(**(settings | changes))


def pins(**changes: object) -> ClampingPins:
    """Two set screws M4 on a shaft of 8 mm."""
    settings = {
        "name": "pins",
        "torque_max": 0.38,
        "count": 2,
        "shaft_diameter": 8e-3,
        "tip_diameter": 2e-3,
        "preload": 1500.0,
        "surface": FINE,
    }
    return ClampingPins(**(settings | changes))


def gears(**changes: object) -> GearPair:
    settings = {
        "name": "gears",
        "torque_max": 20.0,
        "module": 1e-3,
        "teeth": 40,
        "teeth_driven": 80,
        "face_width": 15e-3,
        "surface": FINE,
    }
    return GearPair(**(settings | changes))


def belt(**changes: object) -> TimingBelt:
    settings = {
        "name": "belt",
        "torque_max": 0.38,
        "teeth": 28,
        "teeth_driven": 28,
        "pitch": 3e-3,
        "width": 10e-3,
        "tooth_height": 1.2e-3,
        "tooth_root_width": 1.9e-3,
        "span_stiffness": 80e3,
        "span_length": 0.1,
    }
    return TimingBelt(**(settings | changes))


def reducer(**changes: object) -> Reducer:
    settings = {
        "name": "reducer",
        "torque_max": 38.0,
        "K1": 1.0e4,
        "K2": 1.4e4,
        "K3": 1.6e4,
        "T1": 3.9,
        "T2": 12.0,
    }
    return Reducer(**(settings | changes))


ELEMENTS: dict[str, Connection] = {
    "key_series": key(),
    "key_parallel": key(flanks="parallel"),
    "key_rough": key(surface=ROUGH),
    "key_power_law": key(contact_law="power_law"),
    "key_tight": key(prepressure=20e6),
    "key_light": key(prepressure=0.03e6, flanks="parallel"),
    "key_loose": key(prepressure=0.0),
    "key_loose_parallel": key(prepressure=0.0, flanks="parallel"),
    "key_loose_power_law": key(prepressure=0.0, contact_law="power_law"),
    "flange": flange(),
    "flange_rough": flange(surface=ROUGH),
    "flange_load": flange(shear="load"),
    "flange_power_law": flange(shear="load", contact_law="power_law"),
    "flange_near_slip": flange(preload=1500.0),
    "pins": pins(),
    "pins_opposed": pins(both_sides=False, half_space=False, shear="load"),
    "gears": gears(),
    "gears_tight": gears(prepressure=30e6),
    "gears_loose": gears(prepressure=0.0),
    "belt": belt(),
    "belt_step_down": belt(teeth_driven=56, wrap=math.radians(165), wrap_driven=3.4, preload=80.0),
    "reducer": reducer(),
    "shaft": Shaft(name="shaft", torque_max=0.38, diameter=8e-3, length=60e-3),
    "constant": Constant(name="spring", torque_max=50.0, stiffness=5e4),
}
