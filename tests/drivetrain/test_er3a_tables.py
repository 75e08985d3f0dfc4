"""Joint stiffness tables of the ER3A reference model, reproduced to their rounding.

The tables were made with series flanks and no pre-pressure, which are set here explicitly.
"""

import math
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from er3a_tables import table_chain

from stiffopt.connection import ClampingPins
from stiffopt.drivetrain import catalogue
from stiffopt.exact.chain import compliance_shares, exact_compliance, exact_windup
from stiffopt.exact.connection import tangent_compliance
from stiffopt.robot.files import load_robot
from stiffopt.robot.stiffness_study import with_flanks

RATIOS = np.array([0.001, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0])

# K_total / K_reducer by the power law; rounded to 0.001.
RATIO_TABLE = {
    ("fine_steel", 1): ".835 .951 .971 .982 .990 .993 .991 .992 .991 .991 .990",
    ("fine_steel", 2): ".822 .947 .969 .981 .990 .993 .992 .993 .992 .992 .992",
    ("fine_steel", 3): ".640 .870 .920 .949 .970 .978 .976 .976 .977 .978 .977",
    ("fine_steel", 4): ".507 .800 .875 .924 .959 .973 .975 .981 .980 .981 .981",
    ("fine_steel", 5): ".507 .800 .875 .924 .959 .973 .975 .981 .980 .981 .981",
    ("fine_steel", 6): ".412 .734 .832 .898 .949 .969 .973 .982 .982 .984 .985",
    ("rough_steel", 1): ".628 .869 .921 .952 .973 .982 .978 .981 .979 .978 .976",
    ("rough_steel", 4): ".258 .584 .718 .819 .904 .939 .948 .962 .962 .965 .966",
    ("rough_steel", 6): ".191 .492 .639 .762 .874 .924 .937 .959 .960 .965 .968",
}

# K_total [N m/rad] by the exact law, fine surface, rounded to 1.
STIFFNESS_RATIOS = np.array([0.01, 0.05, 0.1, 0.2, 0.4, 0.6, 1.0])
STIFFNESS_TABLE = {
    1: [15490, 15837, 15885, 24784, 24811, 28750, 28718],
    2: [29977, 30681, 30784, 49580, 49647, 56556, 56515],
    3: [9151, 9700, 9782, 13664, 15621, 15637, 15639],
    4: [4084, 4505, 4573, 5949, 5982, 6956, 6966],
    5: [4084, 4505, 4573, 5949, 5982, 6956, 6966],
    6: [2806, 3224, 3294, 4574, 4615, 5596, 5613],
}

# Scale on all preloads; bolt faces [1e6 N m/rad], joint [N m/rad], slip safety at T_max.
# Rough surface, exact law, 0.6 T_max.
PRELOAD_SCALES = [0.5, 0.75, 1.0, 1.5, 2.0, 3.0]
PRELOAD_TABLE = {
    2: (
        [1.41, 2.62, 3.64, 5.48, 7.22, 10.5],
        [54576, 55563, 55894, 56185, 56323, 56461],
        [0.74, 1.12, 1.49, 2.23, 2.98, 4.47],
    ),
    3: (
        [0.395, 0.701, 0.963, 1.44, 1.89, 2.75],
        [15055, 15310, 15401, 15484, 15524, 15564],
        None,
    ),
    6: (
        [0.243, 0.372, 0.492, 0.718, 0.931, 1.34],
        [5415, 5457, 5477, 5496, 5506, 5516],
        None,
    ),
}


# Width and height of the output-side keys by the diameter of their shafts [m].
SECTIONS = {30e-3: (8e-3, 7e-3), 25e-3: (8e-3, 7e-3), 16e-3: (5e-3, 5e-3)}


@pytest.fixture(scope="module")
def er3a():
    return load_robot("er3a_c60")


@pytest.fixture(scope="module")
def er3a_contact():
    return load_robot("er3a_c60_contact")


@pytest.mark.parametrize(("surface", "joint"), RATIO_TABLE)
def test_ratio_to_reducer(er3a, surface, joint):
    chain = table_chain(er3a.chains[joint - 1], surface, law="power")
    torque = er3a.torque_max[joint - 1] * RATIOS
    # The tables are not smoothed; a factor of 1e-6 leaves nothing of the smoothing.
    total = chain.tangent_stiffness(torque, smoothing=1e-6)
    reducer = chain.reducer_only().tangent_stiffness(torque, smoothing=1e-6)
    published = [float(v) for v in RATIO_TABLE[surface, joint].split()]
    np.testing.assert_allclose(total / reducer, published, rtol=0, atol=0.5e-3)


@pytest.mark.parametrize("joint", STIFFNESS_TABLE)
def test_exact_joint_stiffness(er3a, joint):
    chain = table_chain(er3a.chains[joint - 1], "fine_steel")
    compliance = exact_compliance(chain, er3a.torque_max[joint - 1] * STIFFNESS_RATIOS)
    # Half a unit of rounding, and as much again of the next digit.
    np.testing.assert_allclose(1 / compliance, STIFFNESS_TABLE[joint], rtol=0, atol=0.505)


def test_shares_of_the_compliance(er3a):
    chain = table_chain(er3a.chains[5], "fine_steel", law="power")
    torque = np.array([0.001, 0.1]) * er3a.torque_max[5]
    keys = sum(
        s.tangent_compliance(torque, None, 1e-6) for s in chain.stages if s.element.kind == "key"
    )
    # Keys carry more than half at a thousandth of the torque, 2 to 3 % at a tenth.
    share = keys / chain.tangent_compliance(torque, smoothing=1e-6)
    assert 0.55 < share[0] < 0.60
    assert 0.02 < share[1] < 0.03
    belts = compliance_shares(er3a.chains[3], 0.1 * 16.0)["belt"]
    pins = compliance_shares(er3a.chains[3], 0.1 * 16.0)["pulley_pins"]
    assert 0.003 < belts < 0.015
    assert pins < 1e-3


@pytest.mark.parametrize("joint", PRELOAD_TABLE)
def test_preload_table(er3a, joint):
    faces, totals, safeties = PRELOAD_TABLE[joint]
    chain = table_chain(er3a.chains[joint - 1], "rough_steel")
    torque_max = er3a.torque_max[joint - 1]
    at = np.array([0.6 * torque_max])
    for k, scale in enumerate(PRELOAD_SCALES):
        preloads = {n: scale * e.preload for n, e in chain.elements.items() if e.preload}
        scaled = chain.with_preloads(preloads)
        bolts = sum(
            float(tangent_compliance(scaled.elements[name], at)[0])
            for name in ("circular_spline_flange", "flexspline_flange")
        )
        assert 1e-6 / bolts == pytest.approx(faces[k], rel=5e-3)  # three digits
        total = float(exact_compliance(scaled, at)[0])
        assert 1 / total == pytest.approx(totals[k], abs=0.505)
        # Preloads given at the call do the same as a copy.
        assert exact_compliance(chain, at, preloads=preloads)[0] == pytest.approx(total)
        if safeties:
            safety = min(scaled.slip_torques().values()) / torque_max
            assert safety == pytest.approx(safeties[k], abs=0.0051)


def test_slip_safety_of_the_flexspline_faces(er3a):
    published = [1.41, 1.49, 1.56, 2.05, 2.05, 2.53]
    safety = [
        chain.slip_torques()["flexspline_flange"] / limit
        for chain, limit in zip(er3a.chains, er3a.torque_max, strict=True)
    ]
    np.testing.assert_allclose(safety, published, rtol=0, atol=0.0051)


@pytest.mark.parametrize(
    ("surface", "ranges"),
    [
        # Ratio to the reducer over the six joints, to the printed digits.
        ("fine_steel", [(0.20, 0.36), (0.50, 0.69), (0.65, 0.80), (0.82, 0.89), (0.89, 0.93)]),
        ("rough_steel", [(0.09, 0.17), (0.28, 0.46), (0.42, 0.61), (0.64, 0.76), (0.77, 0.85)]),
    ],
)
def test_output_side_keys(er3a_contact, surface, ranges):
    at = np.array([0.01, 0.05, 0.1, 0.4, 1.0])
    found = []
    for chain, limit in zip(er3a_contact.chains, er3a_contact.torque_max, strict=True):
        whole = table_chain(chain, surface)
        found.append(
            exact_compliance(whole.reducer_only(), at * limit) / exact_compliance(whole, at * limit)
        )
    # Two digits are printed, and the exact and the power law differ by up to 0.007 here.
    for column, (low, high) in zip(np.array(found).T, ranges, strict=True):
        assert column.min() == pytest.approx(low, abs=0.0055)
        assert column.max() == pytest.approx(high, abs=0.0055)


@pytest.mark.parametrize(
    ("surface", "low", "high"), [("fine_steel", 1.21, 1.42), ("rough_steel", 1.56, 2.07)]
)
def test_windup_with_output_side_keys(er3a_contact, surface, low, high):
    ratios = []
    for chain, limit in zip(er3a_contact.chains, er3a_contact.torque_max, strict=True):
        whole, at = table_chain(chain, surface, prepressure=0.1e6), np.array([limit])
        alone = exact_windup(whole.reducer_only(), at)
        ratios.append(float((exact_windup(whole, at) / alone)[0]))
    assert min(ratios) == pytest.approx(low, abs=0.0051)
    assert max(ratios) == pytest.approx(high, abs=0.0051)


def test_without_reflection_the_motor_side_dominates(er3a):
    # Torque divided by the ratio, stiffness not multiplied by its square; from 5 % of the torque
    # to shortly before the first flange slips at the larger torques of this variant.
    limits, at = [82.0, 157.0, 54.0, 23.0, 23.0, 18.0], np.array([0.05, 0.1, 0.2, 0.4, 0.6, 0.9])
    found = []
    for chain, limit in zip(er3a.chains, limits, strict=True):
        flat = replace(table_chain(chain, "fine_steel"), reflect=False)
        stages = tuple(
            replace(s, element=replace(s.element, half_space=False))
            if isinstance(s.element, ClampingPins)
            else s
            for s in flat.stages
        )
        flat = replace(flat, stages=stages)
        alone = exact_compliance(flat.reducer_only(), at * limit)
        found.append(alone / exact_compliance(flat, at * limit))
    big, wrist = np.array(found[:2]), np.array(found[2:])
    # Printed: 0.02 to 0.12 and 0.005 to 0.04, to one or two digits.
    assert big.min() == pytest.approx(0.02, abs=0.005)
    assert big.max() == pytest.approx(0.12, abs=0.005)
    assert wrist.min() == pytest.approx(0.005, abs=0.0006)
    assert wrist.max() == pytest.approx(0.04, abs=0.005)


def test_parallel_flanks_are_about_four_times_stiffer(er3a):
    at = np.array([0.1 * 0.57])
    own = er3a.chains[0].elements["motor_key"]
    series = with_flanks(er3a.chains[0], "series").elements["motor_key"]
    ratio = tangent_compliance(series, at) / tangent_compliance(own, at)
    assert 3.5 < ratio[0] < 4.5


def test_shipped_robots_carry_the_reference_inputs(er3a, er3a_contact):
    inputs = Path(__file__).parents[3] / "shared" / "design" / "er3a_inputs.toml"
    if not inputs.is_file():
        pytest.skip("er3a_inputs.toml is not beside the repository")
    data = tomllib.loads(inputs.read_text())
    for j, chain in enumerate(er3a_contact.chains, start=1):
        joint = data["joint"][f"J{j}"]
        reducer = data["reducer"][str(joint["reducer"])]
        reducer = reducer["class_80" if joint["ratio"] >= 80 else "class_50"]
        own = chain.elements["reducer"]
        assert reducer["K_Nm_per_rad"] == [own.K1, own.K2, own.K3]
        assert (reducer["T1_Nm"], reducer["T2_Nm"]) == (own.T1, own.T2)
        assert er3a_contact.torque_max[j - 1] == joint["T_max_Nm"]
        first = chain.stages[0]
        assert first.ratio == joint["ratio"]
        key = data["key"][joint["input"][0]]
        for stage, expected in ((first, key), (chain.stages[-1], data["output_key"][f"J{j}"])):
            e = stage.element
            given = [e.shaft_diameter, e.length, e.shaft_flank_height, e.hub_flank_height]
            wanted = [expected[k] for k in ("d_m", "length_m", "h1_m", "h2_m")]
            if e.name == "output_key":
                # The inputs are the keyways, together higher than the key; less of them bears.
                assert sum(given[2:]) < catalogue.key(*SECTIONS[e.shaft_diameter]).height
                assert sum(wanted[2:]) > catalogue.key(*SECTIONS[e.shaft_diameter]).height
                given, wanted = given[:2], wanted[:2]
            np.testing.assert_allclose(given, wanted, rtol=1e-12)
        for which, short in (("circular_spline", "cs"), ("flexspline", "fs")):
            flange = chain.elements[f"{which}_flange"]
            pattern = f"{short}_{joint['reducer']}"
            count, size, circle = data["rings"]["patterns"][pattern]
            assert flange.bolt_count == count
            assert flange.bolt.size == f"M{size}"
            assert flange.preload == data["rings"]["preload_N"][flange.bolt.size]
            outer, inner = data["rings"]["radii_mm"][pattern]
            radii = [1e3 * flange.outer_radius, 1e3 * flange.inner_radius]
            np.testing.assert_allclose(radii, [outer, inner], rtol=1e-12)
            assert math.isclose(flange.circle_diameter, circle * 1e-3)
        assert [e.kind for e in chain.elements.values()][:-1] == [
            e.kind for e in er3a.chains[j - 1].elements.values()
        ]
    belt = er3a.chains[2].elements["belt"]
    assert belt.span_stiffness == data["belt"]["span_stiffness_N"]
    assert belt.tooth_height == pytest.approx(data["belt"]["tooth_height_m"])
    pins = er3a.chains[2].elements["pulley_pins"]
    assert pins.preload == data["pins"]["preload_N"]
    assert pins.tip_diameter == pytest.approx(data["pins"]["tip_diameter_m"])
