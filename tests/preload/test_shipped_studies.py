"""Shipped preload studies: what they expect comes from closed forms and dense grids.

Slip and least preload give closed forms. Where a joint must be stiffer than that, the compliances
of its two flanges are tabulated by the exact law on dense grids and searched for the least sum of
clamping forces.
"""

import numpy as np
import pytest
from small_arms import ROOT

from stiffopt.exact.chain import exact_compliance
from stiffopt.exact.connection import tangent_compliance
from stiffopt.fastening.limits import preload_loss
from stiffopt.fastening.tightening import Tightening
from stiffopt.preload.files import load_study
from stiffopt.preload.study import named_values, preload_study
from stiffopt.units import convert

FILES = sorted((ROOT / "problems").glob("er3a_preload_*.toml"))
IDS = [path.stem for path in FILES]
ALPHA, SAFETY, FRICTION, LEAST_SHARE = 1.6, 1.2, 0.15, 0.3
PEAK = {1: 57.0, 2: 110.0, 3: 38.0, 4: 16.0, 5: 16.0, 6: 13.0}


def study(name):
    return load_study(ROOT / "problems" / f"er3a_preload_{name}.toml")


def assert_expected(loaded, found):
    """Every expected value is among the independent ones, and agrees."""
    for name, expected in loaded.expected.items():
        value, unit = found[name]
        assert convert(value, unit, expected.unit) == pytest.approx(
            expected.value, rel=expected.rtol
        ), name


def assembled(least, element):
    """Largest preload that leaves `least` after scatter and settling [N]."""
    return ALPHA * (least + preload_loss(element, Tightening(embedding=3e-6)))


def least_of(force, element):
    return force / ALPHA - preload_loss(element, Tightening(embedding=3e-6))


def ring_slip(flange, torque):
    """Preload of a bolt at which an evenly pressed ring keeps the slip safety [N]."""
    inner, outer = flange.inner_radius, flange.outer_radius
    lever = 2 / 3 * (outer**3 - inner**3) / (outer**2 - inner**2)
    return assembled(SAFETY * torque / (FRICTION * flange.bolt_count * lever), flange)


def test_flange_of_joint_2():
    loaded = study("j2_flexspline")
    flange = loaded.problem.elements[0].stage.element
    force = ring_slip(flange, 110.0)
    # M5: P = 0.8 mm, d2 = 4.48 mm; the head bears from 5.5 mm to 8.03 mm.
    thread = 0.8e-3 / (2 * np.pi) + 4.48e-3 / (2 * np.cos(np.pi / 6)) * 0.12
    found = {
        "least_preload_flexspline_flange": (44e3 / 7, "N"),
        "preload_flexspline_flange": (force, "N"),
        "total_preload": (9 * force, "N"),
        "tightening_torque_flexspline_flange": (
            force * (thread + (8.03e-3 + 5.5e-3) / 4 * 0.12),
            "N*m",
        ),
    }
    assert_expected(loaded, found)


def test_pins_of_joints_3_to_5():
    loaded = study("pins")
    found, total = {}, 0.0
    for free in loaded.problem.elements:
        pins = free.stage.element
        # Two tips at 90 degrees and their reaction in the bore, on a shaft of 8 mm that turns 100
        # times.
        contacts = 2 + np.sqrt(2)
        slip = assembled(SAFETY * PEAK[free.joint] / 100 / (FRICTION * 4e-3 * contacts), pins)
        # Set screw M4 45H: 2.2 N m over 0.2 d.
        force = max(slip, LEAST_SHARE * 2.2 / (0.2 * 4e-3))
        found[f"preload_joint_{free.joint}_pulley_pins"] = (force, "N")
        total += 2 * force
    assert_expected(loaded, found | {"total_preload": (total, "N")})


def least_pair(flanges, rest, torque, needed, low, high):
    """Least clamping force of two flanges for a joint stiffness, over all pairs of two grids."""
    first, last = np.array(low), np.array(high)
    for _ in range(4):
        grids = [np.linspace(a, b, 201) for a, b in zip(first, last, strict=True)]
        soft = [
            np.array(
                [
                    float(tangent_compliance(f, torque, preload=least_of(force, f))[0])
                    for force in grid
                ]
            )
            for f, grid in zip(flanges, grids, strict=True)
        ]
        feasible = soft[0][:, None] + soft[1][None, :] + rest <= 1.0 / needed
        total = flanges[0].bolt_count * grids[0][:, None] + flanges[1].bolt_count * grids[1][None]
        total = np.where(feasible, total, np.inf)
        best = np.unravel_index(np.argmin(total), total.shape)
        forces = np.array([grid[i] for grid, i in zip(grids, best, strict=True)])
        # The least sum is flat along the edge of the feasible pairs: the window stays wide.
        width = 0.1 * (last - first)
        first, last = np.maximum(forces - width, low), np.minimum(forces + width, high)
    return forces, float(total[best])


def test_bolts_under_a_wrench():
    """Twelve M5 on 84 mm: the worst place of the circle, each with its own tension and shear."""
    loaded = study("wrench")
    place = np.linspace(0, 2 * np.pi, 100_001)
    radius, shear, tilting, torque, face = 42e-3, 200.0, 40.0, 110.0, 25e-3
    inner, outer = 36e-3, 48e-3
    lever = 2 / 3 * (outer**3 - inner**3) / (outer**2 - inner**2)
    # Shear along -x at the joint's origin tilts the face, which lies 25 mm out, about y as well.
    tension = (tilting * np.sin(place) - face * shear * np.cos(place)) * 2 / (12 * radius)
    across = np.hypot(
        -shear / 12 - torque / (12 * lever) * np.sin(place), torque / (12 * lever) * np.cos(place)
    )
    needed = (1.8 * across / 0.15 + np.maximum(tension, 0.0)).max()
    assert_expected(loaded, {"least_preload_joint_2_link_flange": (float(needed), "N")})


@pytest.mark.slow
def test_all_bolts():
    loaded = study("all_bolts")
    problem = loaded.problem
    pressing = problem.load_cases[1]
    found, sums = {}, 0.0
    for joint in problem.joints:
        own = [e for e in problem.elements if e.joint == joint]
        flanges = [e.stage.element for e in own]
        forces = np.array([ring_slip(f, PEAK[joint]) for f in flanges])
        total = sum(f.bolt_count * force for f, force in zip(flanges, forces, strict=True))
        if joint in problem.requirements.joint_stiffness:
            torque = np.abs(pressing.torque[joint - 1 : joint])
            chain = problem.robot.chains[joint - 1]
            rest = float(exact_compliance(chain, torque)[0]) - sum(
                float(tangent_compliance(f, torque)[0]) for f in flanges
            )
            needed = problem.requirements.joint_stiffness[joint]
            forces, total = least_pair(
                flanges, rest, torque, needed, forces, [e.capacity for e in own]
            )
            found[f"stiffness_joint_{joint}"] = (needed, "N*m/rad")
        for flange, force in zip(flanges, forces, strict=True):
            found[f"preload_joint_{joint}_{flange.name}"] = (force, "N")
        sums += total
    assert_expected(loaded, found | {"total_preload": (sums, "N")})


@pytest.mark.parametrize("path", FILES, ids=IDS)
def test_every_expected_value_has_a_source(path):
    loaded = load_study(path)
    assert loaded.expected
    assert all(len(each.source) > 10 for each in loaded.expected.values())


def test_optimum_matches_expected_values():
    """Of one study; all of them are verified with the other problem files."""
    loaded = study("pins")
    done = preload_study(loaded.problem, front_points=0)
    assert_expected(loaded, named_values(done))
    assert done.solution.kkt_residual < 1e-8
    assert {row.kind for row in done.solution.rows if row.active} == {
        "slip safety",
        "least preload",
    }
