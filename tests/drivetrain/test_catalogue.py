"""Packaged data: values, provenance, and messages for unknown names."""

import math

import pytest

from stiffopt.drivetrain import catalogue
from stiffopt.errors import InputError


def test_reducers_cover_sizes_and_ratios():
    names = catalogue.reducer_names()
    for size in (14, 17, 20, 25, 32):
        for ratio in (30, 50, 80, 100):
            assert f"harmonic_{size}_{ratio}" in names
    for name in names:
        data = catalogue.reducer(name)
        assert 0 < data.T1 < data.T2
        assert 0 < data.K1 <= data.K2 <= data.K3
        assert data.provenance in ("catalogue", "estimated")
        assert data.source
        if data.ratings:
            assert data.ratings[0] < data.ratings[1] < data.ratings[2]
    big = catalogue.reducer("harmonic_32_100")
    assert (big.K1, big.K2, big.K3, big.T1, big.T2) == (67e3, 110e3, 120e3, 29.0, 108.0)
    assert big.provenance == "catalogue"
    small = catalogue.reducer("harmonic_14_50")
    assert (small.K1, small.K2, small.K3) == (3400.0, 4700.0, 5700.0)
    assert small.estimated == ("K3",)


def test_stiffer_with_size_and_ratio():
    for ratio in (30, 50, 100):
        stiffness = [catalogue.reducer(f"harmonic_{s}_{ratio}").K3 for s in (14, 17, 20, 25, 32)]
        assert stiffness == sorted(stiffness)


def test_large_reducers():
    """Strain-wave sizes by the cube of the size, within a sixth; cycloidal ones by rigidity."""
    for ratio in (50, 100):
        own = [catalogue.reducer(f"harmonic_{s}_{ratio}").K3 / s**3 for s in (32, 40, 50, 58, 65)]
        assert max(own) < 1.35 * min(own)
    assert "harmonic_40_30" not in catalogue.reducer_names()
    rv = catalogue.reducer("rv_20e_121")
    arcmin = math.pi / 180.0 / 60.0
    assert pytest.approx(49.0 / arcmin) == rv.K3
    # The loop at 3 % of the rated torque to both sides is the lost motion, one arc minute.
    assert pytest.approx(1.0 * arcmin) == 2.0 * 0.03 * 167.0 / rv.K1
    assert catalogue.reducer("rv_450e_171").ratings == (4410.0, 11025.0, 22050.0)


def test_bolts():
    assert catalogue.bolt_sizes() == [
        *("M3", "M4", "M5", "M6", "M8", "M10", "M12", "M16", "M20", "M24")
    ]
    assert catalogue.bolt_grades()[-3:] == ["8.8", "10.9", "12.9"]
    stress = [catalogue.proof_stress(grade) for grade in catalogue.bolt_grades()]
    assert stress == sorted(stress)
    assert catalogue.proof_stress("12.9") == 1100e6
    for size in catalogue.bolt_sizes():
        bolt = catalogue.bolt(size)
        # ISO 724: d2 and d3 from the pitch; ISO 898-1: stress area from both, to printed digits.
        assert bolt.pitch_diameter == pytest.approx(bolt.diameter - 0.6495 * bolt.pitch, abs=1e-6)
        assert bolt.minor_diameter == pytest.approx(bolt.diameter - 1.2269 * bolt.pitch, abs=1e-6)
        area = math.pi / 4 * bolt.stress_diameter**2
        assert area == pytest.approx(bolt.stress_area, rel=2e-3)
        # The flat under the head is smaller than the head and larger than the hole.
        assert bolt.diameter < bolt.hole < bolt.bearing_diameter < bolt.head_diameter
    # Bearing areas of socket heads as VDI 2230 tables them [mm^2].
    for size, head_area in (("M4", 17.6), ("M5", 26.9), ("M6", 34.9), ("M8", 55.8)):
        assert catalogue.bolt(size).head_area == pytest.approx(head_area * 1e-6, rel=3e-3)


def test_set_screws_and_materials():
    forces = []
    for size in catalogue.set_screw_sizes():
        screw = catalogue.set_screw(size)
        assert screw.minor_diameter == pytest.approx(catalogue.bolt(size).minor_diameter)
        assert screw.provenance == "estimated"
        forces.append(screw.tightening_torque / (screw.nut_factor * screw.diameter))
    assert forces == pytest.approx([1500.0, 2750.0, 4500.0, 6250.0])
    steel, aluminium = map(catalogue.clamped_material, ("steel", "aluminium"))
    assert steel.head_pressure > aluminium.head_pressure
    assert aluminium.modulus == catalogue.material("aluminium").modulus
    for name in ("steel", "iron", "aluminium"):
        data = catalogue.clamped_material(name)
        lengths = [data.engagement_for(grade) for grade in catalogue.bolt_grades()]
        assert lengths == sorted(lengths)
        assert data.engagement_for("A2-70") == data.engagement["8.8"]
        assert data.key_pressure["reversing"] < data.key_pressure["steady"]
        assert data.provenance == "estimated"


def test_flanges_carry_their_catalogue_torque():
    # Preloads were rounded from these torques (friction circle, 0.15).
    for name in catalogue.flange_names():
        data = catalogue.flange(name)
        torque = 0.15 * data.count * data.preload * data.circle_diameter / 2
        assert torque == pytest.approx(data.transmissible_torque, rel=0.06)
        assert data.inner_radius < data.circle_diameter / 2 < data.outer_radius
        assert "preload" in data.estimated


def test_keys_and_belts():
    key = catalogue.key(5e-3, 5e-3)
    assert (key.shaft_min, key.shaft_max) == (12e-3, 17e-3)
    assert key.shaft_depth + key.hub_depth > key.height
    belt = catalogue.belt("HTD3M")
    assert belt.span_stiffness_at(10e-3) == 80e3
    assert belt.span_stiffness_at(12.5e-3) == pytest.approx((80e3 + 127.5e3) / 2)
    assert belt.span_stiffness_at(5e-3) == pytest.approx(40e3)
    assert belt.span_stiffness_at(50e-3) == pytest.approx(450e3)


def test_surfaces():
    for name in ("fine_steel", "rough_steel", "fine_steel_aluminium", "fine_steel_iron"):
        assert catalogue.surface(name).friction == 0.15
        assert catalogue.surface_entry(name).provenance == "estimated"
    assert catalogue.surface("fine_steel_d23").fractal_dimension == 2.3
    assert catalogue.surface("fine_steel_d25").fractal_dimension == 2.5
    assert catalogue.surface("fine_steel").fractal_roughness == pytest.approx(1.29e-9, rel=2e-3)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: catalogue.reducer("harmonic_25_1000"), "Did you mean 'harmonic_25_100'"),
        (lambda: catalogue.bolt("M7"), "no bolt 'M7' in the catalogue"),
        (lambda: catalogue.key(5e-3, 4e-3), "no key '5x4'"),
        (lambda: catalogue.belt("HTD3"), "Did you mean 'HTD3M'"),
        (lambda: catalogue.surface("fine_stel"), "Did you mean 'fine_steel'"),
        (lambda: catalogue.flange("flexspline_26"), "Did you mean 'flexspline_"),
        (lambda: catalogue.proof_stress("12.8"), "Did you mean '12.9'"),
        (lambda: catalogue.set_screw("M7"), "no set screw 'M7' in the catalogue"),
        (lambda: catalogue.clamped_material("aluminum"), "Did you mean 'aluminium'"),
        (lambda: catalogue.shaft_proof_stress("hard_steel"), "Did you mean 'hardened_steel'"),
    ],
)
def test_unknown_names(call, text):
    with pytest.raises(InputError, match=text):
        call()
