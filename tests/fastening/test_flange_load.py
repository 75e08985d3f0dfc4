"""What comes to each bolt of a flange: by balance of forces and by published examples."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stiffopt.fastening.flange_load import (
    axial_forces,
    bolt_angles,
    ring_opening_load,
    ring_section,
    transverse_forces,
)

LOADS = st.lists(st.floats(-1e3, 1e3), min_size=6, max_size=6)


@given(LOADS, st.integers(3, 16), st.floats(0.01, 0.3))
def test_bolts_balance_the_load(load, count, diameter):
    load, angles = np.array(load), bolt_angles(count)
    places = diameter / 2 * np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    forces = np.zeros((count, 3))
    forces[:, 2] = axial_forces(load, count, diameter, angles)
    forces[:, :2] = transverse_forces(load, count, diameter / 2, angles)
    moment = np.cross(places, forces).sum(axis=0)
    assert forces.sum(axis=0) == pytest.approx(load[:3], abs=1e-9)
    assert moment == pytest.approx(load[3:], abs=1e-9 * (1 + np.abs(load).max()))


def test_most_loaded_bolt_has_four_moments_over_bolts_and_circle():
    # 4 M/(n d), for a bolt on the line that the moment loads most: here the second of four.
    forces = axial_forces(np.array([0, 0, 0, 50.0, 0, 0]), 4, 0.1, bolt_angles(4))
    assert forces == pytest.approx([0.0, 4 * 50.0 / (4 * 0.1), 0.0, -500.0], abs=1e-9)


def test_tower_on_anchor_bolts():
    # Worked example of tilting with axial load, zhclg.com, "Anchor bolt check": 24 bolts on 4.53 m,
    # moment 1.6 x 262.94 t m, weight 0.9 x 77.24 t: 12.58 t at the most loaded bolt.
    tonne = 9806.65
    load = np.array([0, 0, -0.9 * 77.24, 1.6 * 262.94, 0, 0]) * tonne
    forces = axial_forces(load, 24, 4.53, bolt_angles(24))
    assert forces.max() / tonne == pytest.approx(12.58, rel=1e-3)


def test_shear_and_torque_add_as_vectors():
    # A force of 400 N along x and 20 N m on four bolts of a circle of 100 mm: 100 N each, and 100 N
    # each along the circle. The bolt at -90 degrees has both the same way, the opposite one none.
    forces = transverse_forces(np.array([400.0, 0, 0, 0, 0, 20.0]), 4, 0.05, bolt_angles(4))
    sizes = np.linalg.norm(forces, axis=-1)
    assert sizes == pytest.approx([math.sqrt(2) * 100, 0.0, math.sqrt(2) * 100, 200.0], abs=1e-9)


@given(st.floats(0, 1e4), st.floats(0, 500.0), st.integers(3, 12))
def test_rim_opens_where_the_pressure_ends(axial, tilting, count):
    inner, outer, circle, hole = 10e-3, 20e-3, 30e-3, 5.5e-3
    force = float(
        ring_opening_load(
            np.array([axial]),
            np.array([tilting]),
            inner=inner,
            outer=outer,
            count=count,
            circle=circle,
            hole=hole,
        )[0]
    )
    rims = []
    for size in (hole, 0.0):
        area, moment = ring_section(inner, outer, count, circle, size)
        rims.append((count * force - axial) / area - tilting * outer / moment)
    # At the rim of the drilled or of the undrilled ring the pressure just ends.
    assert min(rims) == pytest.approx(0.0, abs=1e-12 * (1 + count * force / area))


def test_section_of_a_drilled_ring_by_counting_points():
    inner, outer, circle, hole, count = 10e-3, 20e-3, 30e-3, 5.5e-3, 6
    line = np.linspace(-outer, outer, 801)
    x, y = np.meshgrid(line, line)
    inside = (np.hypot(x, y) < outer) & (np.hypot(x, y) > inner)
    for angle in bolt_angles(count):
        at = circle / 2 * np.array([math.cos(angle), math.sin(angle)])
        inside &= np.hypot(x - at[0], y - at[1]) > hole / 2
    cell = (line[1] - line[0]) ** 2
    area, moment = ring_section(inner, outer, count, circle, hole)
    assert area == pytest.approx(inside.sum() * cell, rel=5e-3)
    assert moment == pytest.approx((x**2 * inside).sum() * cell, rel=5e-3)
    assert moment == pytest.approx((y**2 * inside).sum() * cell, rel=5e-3)
