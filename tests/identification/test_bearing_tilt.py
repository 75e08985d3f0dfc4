"""Tilt of bearings from static sets of arms that turn about transverse axes by Rodrigues."""

from dataclasses import replace

import numpy as np
import pytest

from stiffopt.identification.stiffness import identify_stiffness
from stiffopt.recording.static_set import load_static_set
from tests.identification.static_arms import THREE, BentArm, measure, rodrigues

TILT, NOISE = 4e-7, 2e-5


def identify(measured, folder):
    return identify_stiffness(load_static_set(measured.write(folder)), torque=False, draws=20)


def tilted(measured, joint, compliance):
    """The same set of an arm whose bearing of a joint (from 0) tilts as well."""
    moved = []
    for q, force in zip(measured.q, measured.force, strict=True):
        axes, origins, _, tip = measured.arm.places(q)
        lever = tip - origins[joint]
        moment = np.cross(lever, force)
        turn = compliance * (moment - (moment @ axes[joint]) * axes[joint])
        angle = float(np.linalg.norm(turn))
        moved.append(rodrigues(turn / angle, angle) @ lever - lever)
    return replace(measured, displacement=measured.displacement + np.array(moved))


@pytest.mark.parametrize(("arm", "joint"), [(BentArm(), 2), (THREE, 2)])
def test_tilt_of_a_bearing_is_told_from_torsion(tmp_path, arm, joint):
    found = identify(tilted(measure(arm, 40, 3, noise=NOISE), joint, TILT), tmp_path)
    (tilt,) = found.tilt
    assert tilt.joint == joint + 1
    assert abs(tilt.compliance - TILT) < 3.0 * tilt.sd
    assert tilt.sd < 0.1 * TILT
    # Only the sensor's noise is left, within three standard deviations of 120 values.
    assert tilt.left_out == pytest.approx(NOISE, rel=0.2)
    assert found.errors.left_out > 1.3 * NOISE


def test_rigid_bearings_are_not_found_to_tilt(tmp_path):
    found = [identify(measure(BentArm(), 25, seed), tmp_path / str(seed)).tilt for seed in range(6)]
    assert found == [()] * 6
