"""Tilt of bearings from static sets of arms that turn about transverse axes by Rodrigues."""

from dataclasses import replace

import numpy as np
import pytest

from stiffopt.identification.stiffness import identify_stiffness
from stiffopt.recording.static_set import load_static_set
from stiffopt.report.pages.identification import tilt_sentence
from tests.identification.static_arms import THREE, BentArm, G, measure, rodrigues

TILT, NOISE = 4e-7, 2e-5


def identify(measured, folder):
    return identify_stiffness(load_static_set(measured.write(folder)), torque=False, draws=20)


def tilted(measured, joint, compliance):
    """The same set of an arm whose bearing of a joint (from 0) tilts as well."""
    moved = []
    for q, force in zip(measured.q, measured.force, strict=True):
        axes, origins, centres, tip = measured.arm.places(q)
        lever = tip - origins[joint]
        moment = np.cross(lever, force)
        for link, mass in enumerate(() if measured.difference else measured.arm.masses):
            if link >= joint:
                moment += np.cross(centres[link] - origins[joint], (0.0, 0.0, -mass * G))
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
    assert tilt.rivals == ()
    # Only the sensor's noise is left, within three standard deviations of 120 values.
    assert found.errors.left_out == pytest.approx(NOISE, rel=0.2)
    assert found.errors.rigid_bearings > 1.3 * NOISE


def soften(arm):
    """Wind-up by three slopes, as of a worn reducer: 0.45, 1 and 1.3 times the stiffness."""
    stiffness, first = np.array(arm.stiffness), 80.0

    def law(torque):
        size = np.abs(torque)
        parts = np.minimum(size, first) / 0.45
        parts = parts + np.clip(size - first, 0.0, 3.0 * first)
        parts = parts + np.maximum(size - 4.0 * first, 0.0) / 1.3
        return np.sign(torque) * parts / stiffness

    return law


def test_tilt_is_told_from_softening_torsion(tmp_path):
    arm = BentArm()
    for joint in (0, 1, 2):
        softened = measure(arm, 30, 1, law=soften(arm))
        found = identify(tilted(softened, joint, TILT), tmp_path / str(joint)).tilt
        assert [each.joint for each in found] == [joint + 1]


def test_bearing_that_acts_as_another_is_told_as_its_rival(tmp_path):
    found = identify(tilted(measure(BentArm(), 30, 2), 1, TILT / 4.0), tmp_path)
    (tilt,) = found.tilt
    assert tilt.joint == 2
    assert tilt.rivals == (1,)
    assert "or that of J1)" in tilt_sentence(found)


def test_intervals_hold_the_stiffness_beside_a_bearing_that_tilts(tmp_path):
    # Torsion alone takes the tilt of joint 2 into joint 1, whose stiffness it misses by a third.
    arm, held = BentArm(), []
    for seed in range(8):
        found = identify(tilted(measure(arm, 30, 50 + seed), 1, TILT), tmp_path / str(seed))
        held.append(
            [
                own.lower <= true <= (own.upper or np.inf)
                for own, true in zip(found.joints, arm.stiffness, strict=True)
            ]
        )
    assert np.mean(held) > 0.85
    assert np.all(np.sum(held, axis=0) >= 6)


def test_rival_bearing_widens_the_intervals(tmp_path):
    # The tilts of joints 1 and 2 differ in which torsion, of joint 1 or 2, is the stiffer.
    found = identify(tilted(measure(BentArm(), 30, 2), 1, TILT / 4.0), tmp_path)
    (tilt,) = found.tilt
    assert tilt.rivals == (1,)
    # Standard deviation of the compliance with the rival over that of the bearing found alone.
    wider = [
        own.sd * own.compliance**2 / max(own.compliance_sd, own.compliance_sd_alike)
        for own in found.joints
        if own.sd
    ]
    assert min(wider[:2]) > 2.0


def test_softening_torsion_alone_is_not_taken_for_tilt(tmp_path):
    # In each of these, beside constant torsion, the tilt of a bearing predicted better.
    for poses, seed in ((25, 116), (30, 137), (40, 154)):
        alone = measure(THREE, poses, seed, law=soften(THREE))
        assert identify(alone, tmp_path / str(seed)).tilt == ()


def test_tilt_shows_where_weight_is_in_the_displacements(tmp_path):
    arm = replace(THREE, masses=(80.0, 60.0, 40.0))
    found = identify(tilted(measure(arm, 40, 3, difference=False), 1, TILT), tmp_path)
    (tilt,) = found.tilt
    assert tilt.joint == 2


def test_rigid_bearings_are_not_found_to_tilt(tmp_path):
    found = [identify(measure(BentArm(), 25, seed), tmp_path / str(seed)).tilt for seed in range(6)]
    assert found == [()] * 6
