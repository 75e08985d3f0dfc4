"""The sector that one bolt presses: as many as there are bolts make the whole ring."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from elements import FINE, ROUGH, flange

from stiffopt.exact.connection import tangent_compliance

SHARES = np.array([0.0, 0.05, 0.3, 0.7, 0.94])


def cut(ring):
    """Sector of one bolt; it carries its share of the largest torque."""
    n = ring.bolt_count
    return replace(ring, bolt_count=1, sectors=n, torque_max=ring.torque_max / n)


@pytest.mark.parametrize("shear", ["mindlin", "load"])
@pytest.mark.parametrize("surface", [FINE, ROUGH])
@pytest.mark.parametrize("count", [2, 6, 9])
def test_sectors_in_parallel_are_the_ring(shear, surface, count):
    ring = flange(bolt_count=count, shear=shear, surface=surface)
    sector = cut(ring)
    assert count * sector.area == pytest.approx(ring.area, rel=1e-13)
    assert count * sector.polar_moment == pytest.approx(ring.polar_moment, rel=1e-13)
    for name in ("slip_torque", "first_slip_torque"):
        whole, part = getattr(ring, name)(2750.0), getattr(sector, name)(2750.0)
        assert count * part == pytest.approx(whole, rel=1e-13), name
    torque = SHARES * ring.slip_torque()
    each = torque / count
    assert sector.windup(each) == pytest.approx(ring.windup(torque), rel=1e-12)
    smooth = sector.tangent_compliance(each), ring.tangent_compliance(torque)
    exact = tangent_compliance(sector, each), tangent_compliance(ring, torque)
    for part, whole in (smooth, exact):
        assert part / count == pytest.approx(whole, rel=1e-12)


def test_loose_bolt_loosens_its_sector():
    ring = flange()
    sector = cut(ring)
    torque = np.array([0.1])
    tight = 1 / tangent_compliance(sector, torque)
    loose = 1 / tangent_compliance(sector, torque, preload=0.3 * ring.preload)
    assert 0.3 < loose / tight < 0.5
    assert sector.slip_torque(0.3 * ring.preload) == pytest.approx(0.3 * sector.slip_torque())


def test_slip_of_a_sector():
    sector = cut(flange())
    past = np.array([1.01 * sector.slip_torque()])
    assert np.isinf(tangent_compliance(sector, past)).all()
