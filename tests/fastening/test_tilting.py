"""Tilting of a bolted flange: closed forms while closed, balance of springs once it opens."""

from __future__ import annotations

import math

import numpy as np
import pytest
from fastened_parts import flange

from stiffopt.contact.fractal import FractalLaw
from stiffopt.fastening import bolts
from stiffopt.fastening.tilting import tilting_flange


def test_closed_flange_by_hand():
    ring = flange()
    tilt = tilting_flange(ring, 4000.0)
    area = math.pi * (20e-3**2 - 10e-3**2)
    moment = math.pi / 4 * (20e-3**4 - 10e-3**4)
    rough = float(FractalLaw(ring.surface).normal_stiffness_per_area(9 * 4000.0 / area))
    delta_s, delta_p = bolts.joint_compliances(ring)
    face = 1 / (delta_p / 9 + 1 / (rough * area))
    expected = face * moment / area + 9 / delta_s * (15e-3) ** 2 / 2
    assert tilt.closed_stiffness == pytest.approx(expected, rel=1e-9)
    assert tilt.rotation(10.0) == pytest.approx(10.0 / expected, rel=1e-9)
    # At the opening moment the pressure at the rim ends: clamp force over area, less what tilting
    # takes there of the springs of the face.
    angle = tilt.opening_moment / tilt.closed_stiffness
    assert 9 * 4000.0 / area == pytest.approx(face / area * angle * 20e-3)
    # VDI 2230 leaves the bolts out of it and has it open earlier.
    assert tilt.opening_moment > 9 * 4000.0 * moment / (area * 20e-3)
    assert tilt.opening_moment < tilt.lift_off_moment
    assert tilt.rotation(-10.0) == -tilt.rotation(10.0)


def test_more_preload_is_stiffer_and_opens_later():
    tilts = [tilting_flange(flange(), force) for force in (500.0, 2000.0, 8000.0)]
    stiffness = [tilt.closed_stiffness for tilt in tilts]
    opening = [tilt.opening_moment for tilt in tilts]
    assert stiffness == sorted(stiffness)
    assert opening == sorted(opening)
    # Once a flange opens its preload decides: at a moment that opens the loosest alone.
    moment = 1.5 * tilts[0].lift_off_moment
    turns = [tilt.rotation(moment) for tilt in tilts]
    assert turns[0] > 1.2 * turns[1]
    assert turns[1] > turns[2]


@pytest.mark.parametrize("share", [0.5, 0.999, 1.001, 1.5, 3.0, 10.0])
def test_springs_balance_force_and_moment(share):
    tilt = tilting_flange(flange(), 3000.0)
    moment = share * tilt.lift_off_moment
    angle = tilt.rotation(moment)
    place = 2 * np.pi * (np.arange(20_000) + 0.5) / 20_000
    # Lift of the middle from the axial balance, by bisection of our own.
    low, high = -1e-3, 1e-3
    for _ in range(200):
        lift = (low + high) / 2
        press = tilt.clamp / tilt.face - lift - angle * tilt.radius * np.cos(place)
        face = tilt.face * np.maximum(press, 0.0) / len(place)
        if face.sum() > tilt.clamp + tilt.bolts * lift:
            low = lift
        else:
            high = lift
    pull = tilt.bolts * (lift + angle * tilt.bolt_radius * np.cos(place)) / len(place)
    found = (pull @ np.cos(place)) * tilt.bolt_radius - (face @ np.cos(place)) * tilt.radius
    assert found == pytest.approx(moment, rel=1e-3)
    if share < 1.0:
        assert (press > 0).all()
    if share > 1.1:
        assert (press < 0).any()
        assert angle > 1.001 * moment / tilt.closed_stiffness
        assert angle < moment / tilt.open_stiffness
