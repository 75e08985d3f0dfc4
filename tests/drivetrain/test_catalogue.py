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


@pytest.mark.parametrize(
    ("size", "limits"),
    [
        ("M3", (2545, 3739, 4375)),
        ("M4", (4421, 6494, 7599)),
        ("M5", (7202, 10578, 12378)),
        ("M6", (10182, 14955, 17500)),
        ("M8", (18627, 27359, 32016)),
    ],
)
def test_bolts(size, limits):
    bolt = catalogue.bolt(size)
    assert tuple(bolt.assembly_preload_max[g] for g in ("8.8", "10.9", "12.9")) == limits
    # Stress area from the pitch and the minor diameter, to the printed digits.
    area = math.pi / 4 * ((bolt.pitch_diameter + bolt.minor_diameter) / 2) ** 2
    assert area == pytest.approx(bolt.stress_area, rel=2e-3)
    assert catalogue.proof_stress("12.9") == 1100e6


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
    ],
)
def test_unknown_names(call, text):
    with pytest.raises(InputError, match=text):
        call()
