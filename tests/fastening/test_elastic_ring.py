"""Bolts of a ring that bends: in balance, rigid where it is stiff, as a frame of beams has them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fastened_parts import flange

from stiffopt.connection import FlangeRing
from stiffopt.errors import InputError
from stiffopt.fastening.elastic_ring import ElasticRing, elastic_ring, torsion_constant
from stiffopt.fastening.flange_load import FlangeLoads, axial_forces, bolt_angles
from stiffopt.fastening.tightening import Tightening
from stiffopt.fastening.vdi_rows import vdi_rows
from stiffopt.fastening.verification import Verification

LOAD = np.array([300.0, -200.0, 900.0, 60.0, -25.0, 20.0])
RING = ElasticRing(count=9, supports=4, radius=15e-3, bending=180.0, torsion=150.0, spring=5e8)


def on_circle(forces, radius, angles):
    """Force and moment of axial forces on a circle about its middle."""
    return np.array(
        [forces.sum(), radius * forces @ np.sin(angles), -radius * forces @ np.cos(angles)]
    )


def test_bolts_balance_force_and_moment():
    rng = np.random.default_rng(1)
    for _ in range(50):
        ring = ElasticRing(
            count=int(rng.integers(3, 13)),
            supports=int(rng.integers(3, 8)),
            radius=rng.uniform(8e-3, 80e-3),
            bending=10 ** rng.uniform(0, 4),
            torsion=10 ** rng.uniform(0, 4),
            spring=10 ** rng.uniform(7.5, 9),
        )
        angles = bolt_angles(ring.count)
        for forces in (ring.bolt_forces(LOAD), ring.shares(rng.uniform(0, 7)) @ LOAD[2:5]):
            found = on_circle(forces, ring.radius, angles)
            assert found == pytest.approx(LOAD[2:5], rel=1e-6, abs=1e-6)


def test_a_stiff_ring_is_rigid():
    stiff = replace(RING, bending=1e7, torsion=1e7)
    assert stiff.factors == pytest.approx((1.0, 1.0), abs=1e-4)
    rigid = axial_forces(LOAD, 9, 30e-3, bolt_angles(9))
    assert stiff.bolt_forces(LOAD) == pytest.approx(rigid, abs=1e-3 * np.abs(rigid).max())


def test_ribs_at_every_bolt_share_as_a_rigid_flange():
    # Whatever the ring, all bolts then stand alike.
    for supports in (9, 18):
        assert replace(RING, supports=supports, bending=5.0).factors == pytest.approx((1, 1))


def test_thinner_rings_load_their_worst_bolt_more():
    factors = [replace(RING, bending=b, torsion=b).factors for b in (3e3, 3e2, 30.0, 3.0)]
    for axial, tilting in np.diff(factors, axis=0):
        assert axial > 0.0
        assert tilting > 0.0
    # A limp ring leaves all to the bolts at the ribs: at most as many carry as there are ribs.
    limp = replace(RING, count=12, supports=3, bending=1e-3, torsion=1e-3)
    assert limp.factors[0] == pytest.approx(12 / 3, rel=0.02)


def by_beams(ring, rib_angle, load, pieces=720):
    """The same ring as a polygon of straight beams that bend and twist, and springs at its bolts.

    Three degrees of freedom a node: axial motion, rotation about x and about y. The link pushes
    its ribs by a penalty.
    """
    angle = 2 * np.pi / pieces * np.arange(pieces)
    x, y = ring.radius * np.cos(angle), ring.radius * np.sin(angle)
    size = 3 * pieces + 3
    stiffness = np.zeros((size, size))
    for a in range(pieces):
        b = (a + 1) % pieces
        along = np.array([x[b] - x[a], y[b] - y[a]])
        length = np.hypot(*along)
        t = along / length
        # Local: w, twist about t, slope dw/ds; rotation (rx, ry) gives slope rx t_y - ry t_x.
        e, g = ring.bending / length**3, ring.torsion / length
        turn = np.array([[1, 0, 0], [0, t[0], t[1]], [0, t[1], -t[0]]])
        bend = e * np.array(
            [
                [12, 6 * length, -12, 6 * length],
                [6 * length, 4 * length**2, -6 * length, 2 * length**2],
                [-12, -6 * length, 12, -6 * length],
                [6 * length, 2 * length**2, -6 * length, 4 * length**2],
            ]
        )
        local = np.zeros((6, 6))
        places = [0, 2, 3, 5]
        local[np.ix_(places, places)] += bend
        local[np.ix_([1, 4], [1, 4])] += g * np.array([[1, -1], [-1, 1]])
        both = np.kron(np.eye(2), turn)
        nodes = [3 * a, 3 * a + 1, 3 * a + 2, 3 * b, 3 * b + 1, 3 * b + 2]
        stiffness[np.ix_(nodes, nodes)] += both.T @ local @ both
    bolts = np.rint(bolt_angles(ring.count) / angle[1]).astype(int)
    stiffness[3 * bolts, 3 * bolts] += ring.spring
    ribs = np.rint((rib_angle + bolt_angles(ring.supports)) / angle[1]).astype(int) % pieces
    for rib in ribs:
        held = np.zeros(size)
        held[3 * rib] = 1.0
        held[-3:] = -1.0, -np.cos(angle[rib]), -np.sin(angle[rib])
        stiffness += 1e3 * ring.spring * np.outer(held, held)
    force = np.zeros(size)
    force[-3:] = load[2], -load[4] / ring.radius, load[3] / ring.radius
    return ring.spring * np.linalg.solve(stiffness, force)[3 * bolts]


@pytest.mark.parametrize(("count", "supports", "rib_angle"), [(9, 4, 0.0), (12, 3, np.pi / 12)])
def test_a_frame_of_beams_shares_the_same(count, supports, rib_angle):
    ring = replace(RING, count=count, supports=supports, bending=60.0, torsion=35.0)
    found = ring.shares(rib_angle) @ LOAD[2:5]
    beams = by_beams(ring, rib_angle, LOAD)
    assert found == pytest.approx(beams, abs=2e-3 * np.abs(beams).max())
    rigid = axial_forces(LOAD, count, 2 * ring.radius, bolt_angles(count))
    # The comparison says something: this ring is far from rigid.
    assert np.abs(found - rigid).max() > 0.1 * rigid.max()


def test_torsion_of_rectangles():
    # Square 0.1406 a^4 and thin strip a b^3/3 (handbooks).
    assert torsion_constant(2.0, 2.0) == pytest.approx(0.1406 * 16, rel=2e-3)
    assert torsion_constant(1.0, 100.0) == pytest.approx(100 / 3, rel=1e-2)
    assert torsion_constant(3.0, 1.0) == torsion_constant(1.0, 3.0)


def test_a_flange_that_bends_needs_more_preload():
    loads = FlangeLoads(names=("load",), values=LOAD[None])
    rigid = Verification(flange(), Tightening(), loads)
    previous = rigid
    for thickness in (20e-3, 5e-3, 2e-3):
        thin = flange(ring=FlangeRing(thickness=thickness, supports=4))
        steps = Verification(thin, Tightening(), loads)
        assert elastic_ring(thin) is elastic_ring(thin)
        assert steps.least_preload >= previous.least_preload
        assert steps.largest_preload <= previous.largest_preload
        mine = {c.kind: c.utilisation for c in vdi_rows(steps, 9e3)}
        for check in vdi_rows(rigid, 9e3):
            assert mine[check.kind] >= check.utilisation * (1 - 1e-12)
        # No bolt, wherever the ribs stand, has more than was said.
        for rib_angle in np.linspace(0, np.pi, 23):
            shares = elastic_ring(thin).shares(rib_angle) @ LOAD[2:5]
            assert shares.max() <= steps.opening.max() * (1 + 1e-3)
        previous = steps
    assert previous.least_preload > 1.01 * rigid.least_preload


def test_two_ribs_are_refused():
    with pytest.raises(InputError, match="supports"):
        FlangeRing(thickness=5e-3, supports=2)


def test_two_bolts_are_statically_determinate():
    few = flange(bolt_count=2, ring=FlangeRing(thickness=8e-3, supports=3))
    pulled = FlangeLoads(names=("pull",), values=np.array([[0.0, 0.0, 900.0, 0.0, 0.0, 20.0]]))
    steps = Verification(few, Tightening(), pulled)
    assert steps.axial == pytest.approx(np.full_like(steps.axial, 450.0))
