"""Bounds on the preload of bolts and pins, and what is said when they are broken."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from fastened_parts import flange, pins

from stiffopt import load_robot
from stiffopt.connection import Bolt, Key, SetScrew, Shaft
from stiffopt.drivetrain import catalogue
from stiffopt.errors import InputError
from stiffopt.fastening.bolts import permissible_assembly_preload
from stiffopt.fastening.limits import (
    check_preload,
    fastener_count,
    key_pressure_limit,
    preload_limits,
    preload_loss,
    workshop_torque,
)
from stiffopt.fastening.tightening import Tightening
from stiffopt.symbolic import elementwise_derivative

WRENCH = Tightening()


def limits(element, tightening=WRENCH):
    return {limit.name: limit for limit in preload_limits(element, tightening)}


def test_names_of_the_limits():
    bolt_names = ["bolt utilisation", "head pressure", "thread engagement"]
    assert list(limits(flange())) == [*bolt_names, "bolt spacing", "hole in ring"]
    assert list(limits(pins())) == ["screw torque", "tip indentation"]
    assert list(limits(pins(screw=None))) == ["tip indentation"]
    assert fastener_count(flange()) == 9
    assert fastener_count(pins()) == 2


@pytest.mark.parametrize("element", [flange(), pins(), pins(screw=None), flange("M3", "8.8")])
def test_utilisation_is_affine_in_the_preload(element):
    forces = np.array([0.0, 1000.0, 5000.0])
    for limit in preload_limits(element, WRENCH):
        used = limit.utilisation(forces)
        assert used == pytest.approx([limit.fixed + f / limit.capacity for f in forces])
        assert elementwise_derivative(limit.utilisation, 5000.0) == pytest.approx(
            1 / limit.capacity
        )
        assert limit.depends_on_preload == (used[2] > used[0])
        if limit.depends_on_preload:
            assert limit.utilisation(limit.largest_preload) == pytest.approx(1.0)
        assert limit.provenance in ("catalogue", "estimated")
        assert limit.source
        assert limit.remedy


def test_bolt_and_head():
    mine = limits(flange("M5", "10.9", head_material="aluminium"))
    bolt = catalogue.bolt("M5")
    assert mine["bolt utilisation"].capacity == pytest.approx(
        permissible_assembly_preload(bolt, 940e6, 0.12)
    )
    # 200 MPa on the annulus from 5.5 to 8.03 mm.
    area = math.pi / 4 * (8.03**2 - 5.5**2)
    assert mine["head pressure"].capacity == pytest.approx(200 * area, rel=1e-12)
    slippery = limits(flange("M5", "10.9"), Tightening(thread_friction=0.08))
    assert slippery["bolt utilisation"].capacity > mine["bolt utilisation"].capacity
    assert slippery["head pressure"].capacity > 2 * mine["head pressure"].capacity


@pytest.mark.parametrize(
    ("material", "grade", "length", "used"),
    [
        # A steel of which nothing is known is taken for S235.
        ("steel", "12.9", 7e-3, 1.0),
        ("S235", "12.9", 10e-3, 0.7),
        ("S235", "8.8", 5e-3, 1.0),
        ("C45", "12.9", 5e-3, 1.0),
        ("iron", "8.8", None, 1 / 1.5),
        ("aluminium", "8.8", 10e-3, 0.75),
        ("aluminium", "12.9", 8e-3, 1.25),
        ("aluminium", "12.9", None, 1.0),
    ],
)
def test_thread_engagement(material, grade, length, used):
    limit = limits(flange("M5", grade, thread_material=material, engagement=length))[
        "thread engagement"
    ]
    assert limit.utilisation(123.0) == pytest.approx(used)
    assert ("assumed" in limit.source) == (length is None)
    assert limit.largest_preload == (math.inf if used <= 1 + 1e-9 else 0.0)


def test_bolt_spacing_by_drawing_the_heads():
    # Nine heads of 8.5 mm on a circle of 30 mm: distance of two neighbours from coordinates.
    angles = 2 * np.pi * np.arange(9) / 9
    points = 15e-3 * np.column_stack([np.cos(angles), np.sin(angles)])
    gap = np.linalg.norm(points[0] - points[1])
    assert limits(flange())["bolt spacing"].fixed == pytest.approx(1.05 * 8.5e-3 / gap)
    assert limits(flange(bolt_count=10))["bolt spacing"].fixed <= 1.0
    # Eleven would overlap: their centres are 8.45 mm apart.
    assert limits(flange(bolt_count=11))["bolt spacing"].fixed > 1.05
    # The sector of one bolt has the same neighbours.
    sector = replace(flange(), bolt_count=1, sectors=9)
    assert limits(sector)["bolt spacing"] == limits(flange())["bolt spacing"]


def test_hole_stays_in_the_ring():
    assert limits(flange("M8"))["hole in ring"].fixed == pytest.approx(19.5 / 20)
    assert limits(flange("M8", inner_radius=12e-3))["hole in ring"].fixed > 1.0
    assert limits(flange("M5", outer_radius=17e-3))["hole in ring"].fixed > 1.0
    assert limits(flange("M5", circle_diameter=50e-3))["hole in ring"].fixed > 1.0


def test_pin_limits():
    mine = limits(pins())
    assert mine["screw torque"].capacity == pytest.approx(2750.0)
    area = math.pi / 4 * (2e-3) ** 2
    assert mine["tip indentation"].capacity == pytest.approx(0.9 * 2.8 * 500e6 * area)
    soft = limits(pins(screw=SetScrew(size="M4", shaft_material="steel_45")))
    unknown = limits(pins(screw=None))
    assert soft["tip indentation"].capacity == unknown["tip indentation"].capacity
    # The customary mean tip pressures: 0.8 GPa on 45 steel, 1.0 to 1.5 GPa on a hardened shaft.
    assert soft["tip indentation"].capacity / area == pytest.approx(0.8e9, rel=0.01)
    assert 1.0e9 < mine["tip indentation"].capacity / area < 1.5e9
    assert "assumed" in unknown["tip indentation"].source


def test_key_pressures():
    steady, provenance, source = key_pressure_limit("steel", False)
    assert (steady, provenance) == (150e6, "estimated")
    assert "DIN 6892" in source
    assert key_pressure_limit("steel", True)[0] == 100e6
    assert key_pressure_limit("aluminium", True)[0] == 50e6
    with pytest.raises(InputError, match="Did you mean 'steel'"):
        key_pressure_limit("stel", True)


@pytest.mark.parametrize("name", ["er3a_c60", "er3a_c60_contact", "ur10"])
def test_shipped_robots_are_within_their_limits(name):
    seen = 0
    for chain in load_robot(name).chains:
        for stage in chain.stages:
            element = stage.element
            if element.kind in ("bolted_flange", "clamping_pins"):
                seen += 1
                check_preload(element, WRENCH)
                for limit in preload_limits(element, WRENCH):
                    assert limit.utilisation(element.preload) <= 1.0, (element.name, limit.name)
                # Something is left to carry torque after scatter and settling.
                assert element.preload / WRENCH.alpha > preload_loss(element, WRENCH)
                assert workshop_torque(element, element.preload, WRENCH).nominal > 0.0
            if isinstance(element, Key):
                key_pressure_limit(element.hub_material, True)
    assert seen >= 12


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: preload_limits(flange("M7"), WRENCH), "no bolt 'M7' in the catalogue. .*M6"),
        (lambda: preload_limits(flange("M5", "12.8"), WRENCH), "Did you mean '12.9'"),
        (
            lambda: preload_limits(flange(head_material="aluminum"), WRENCH),
            "Did you mean 'aluminium'",
        ),
        (lambda: preload_limits(flange(thread_material="wood"), WRENCH), "no material 'wood'"),
        (
            lambda: preload_limits(flange(bolt=None), WRENCH),
            "bolted_flange 'flexspline_flange': its bolts are not given.*Add `bolt =",
        ),
        (lambda: preload_loss(flange(bolt=None), WRENCH), "Add `bolt ="),
        (lambda: workshop_torque(flange(bolt=None), 1e3, WRENCH), "Add `bolt ="),
        (lambda: workshop_torque(pins(screw=None), 1e3, WRENCH), "Add `screw ="),
        (lambda: workshop_torque(pins(), -1.0, WRENCH), "preload = -1 cannot be used"),
        (
            lambda: preload_limits(pins(screw=SetScrew(size="M7")), WRENCH),
            "no set screw 'M7' in the catalogue",
        ),
        (
            lambda: preload_limits(pins(screw=SetScrew(size="M4", shaft_material="hard")), WRENCH),
            "no shaft material 'hard' in the catalogue",
        ),
        (
            lambda: preload_limits(
                Shaft(name="s", torque_max=1.0, diameter=8e-3, length=0.06), WRENCH
            ),
            "shaft 's' has no bolts and no pins",
        ),
        (lambda: Bolt(size="M5", clamp_length=0.0), "bolt M5: clamp_length = 0 cannot be used"),
        (lambda: Bolt(size="M5", engagement=-1e-3), "engagement = -0.001"),
        (lambda: SetScrew(size="M4", length=0.0), "set screw M4: length = 0"),
        (lambda: flange(sectors=0), "sectors = 0 cannot be used"),
    ],
)
def test_wrong_input(call, text):
    with pytest.raises(InputError, match=text):
        call()


def test_preload_above_capacity_is_refused():
    check_preload(flange(), WRENCH)
    with pytest.raises(
        InputError,
        match=r"preload 14 kN of flexspline_flange is above the largest assembly preload "
        r"12\.38 kN of M5 12\.9 \(VDI 2230, thread friction 0\.12\)\. Lower the preload, or take",
    ):
        check_preload(flange(preload=14e3), WRENCH)
    check_preload(flange(preload=12.37e3), WRENCH)
    with pytest.raises(InputError, match=r"thread friction 0\.2"):
        check_preload(flange(preload=12.37e3), Tightening(thread_friction=0.2))
    with pytest.raises(
        InputError, match=r"preload 3 kN of pulley_pins is above the 2\.75 kN that a set screw M4"
    ):
        check_preload(pins(preload=3e3), WRENCH)
    # Nobody knows what holds these, so nothing can be said.
    check_preload(pins(preload=3e3, screw=None), WRENCH)
