"""Preload, torque and their scatter."""

from __future__ import annotations

import math

import numpy as np
import pint
import pytest
from fastened_parts import flange, pins
from formula_checks import check_derivative
from hypothesis import given
from hypothesis import strategies as st

from stiffopt.drivetrain import catalogue
from stiffopt.drivetrain.fasteners import BoltData
from stiffopt.errors import InputError
from stiffopt.fastening.bolts import permissible_assembly_preload
from stiffopt.fastening.limits import workshop_torque
from stiffopt.fastening.tightening import (
    SCATTER_BY_METHOD,
    Tightening,
    preload_at_torque,
    standard_torques,
    tightening_torque,
)
from stiffopt.symbolic import Quantity, elementwise_derivative

SIZES = catalogue.bolt_sizes()
FRICTIONS = st.floats(0.02, 0.6)


@given(st.sampled_from(SIZES), st.floats(1.0, 1e5), FRICTIONS, FRICTIONS)
def test_torque_and_preload_are_inverse(
    size: str, preload: float, thread: float, head: float
) -> None:
    bolt = catalogue.bolt(size)
    torque = tightening_torque(bolt, preload, thread, head)
    assert preload_at_torque(bolt, torque, thread, head) == pytest.approx(preload, rel=1e-12)
    # More friction anywhere asks for more torque.
    assert tightening_torque(bolt, preload, thread + 0.01, head) > torque
    assert tightening_torque(bolt, preload, thread, head + 0.01) > torque


def test_without_friction_the_thread_is_a_wedge() -> None:
    bolt = catalogue.bolt("M6")
    # One turn of work, 2 pi M, lifts the load by one pitch.
    work = 2 * math.pi * tightening_torque(bolt, 1000.0, 0.0, 0.0)
    assert work == pytest.approx(1000.0 * bolt.pitch, rel=1e-12)


@given(st.sampled_from(SIZES), st.sampled_from(["8.8", "10.9", "12.9"]), FRICTIONS)
def test_strength_is_that_of_tension_and_torsion(size: str, grade: str, friction: float) -> None:
    bolt, proof = catalogue.bolt(size), catalogue.proof_stress(grade)
    force = permissible_assembly_preload(bolt, proof, friction)
    # Von Mises stress of the tension and of the thread's torque, the round core fully plastic.
    tension = force / bolt.stress_area
    torque = tightening_torque(bolt, force, friction, 0.0)
    torsion = torque / (math.pi * bolt.stress_diameter**3 / 12)
    equivalent = math.hypot(tension, math.sqrt(3) * torsion)
    # The stress area is a printed number, the stress diameter follows from the thread.
    assert equivalent == pytest.approx(0.9 * proof, rel=2e-3)
    assert permissible_assembly_preload(bolt, proof, friction + 0.01) < force


def test_grades_and_sizes_are_ordered() -> None:
    forces = [
        [
            permissible_assembly_preload(catalogue.bolt(s), catalogue.proof_stress(g), 0.12)
            for s in SIZES
        ]
        for g in catalogue.bolt_grades()
    ]
    # A2 and A4 of one class bear the same.
    assert (np.diff(forces, axis=0) >= 0).all()
    assert (np.diff(forces, axis=1) > 0).all()
    assert permissible_assembly_preload(catalogue.bolt("M5"), 1100e6, 0.12, 0.45) == pytest.approx(
        forces[-1][2] / 2
    )


def test_units_come_out_right() -> None:
    units = pint.UnitRegistry()
    plain = catalogue.bolt("M5")
    lengths = ("diameter", "pitch", "pitch_diameter", "minor_diameter", "hole")
    heads = ("head_diameter", "bearing_diameter")
    bolt = BoltData(
        name="M5",
        provenance="",
        source="",
        stress_area=plain.stress_area * units.m**2,
        **{key: 1e3 * getattr(plain, key) * units.mm for key in (*lengths, *heads)},
    )
    force = permissible_assembly_preload(bolt, 1100 * units.MPa, 0.12)
    assert force.to("N").magnitude == pytest.approx(
        permissible_assembly_preload(plain, 1.1e9, 0.12)
    )
    torque = tightening_torque(bolt, force, 0.12, 0.1)
    assert torque.to("N*m").magnitude == pytest.approx(
        tightening_torque(plain, force.to("N").magnitude, 0.12, 0.1)
    )
    assert preload_at_torque(bolt, torque, 0.12, 0.1).check("[force]")


def test_standard_torques_are_preferred_numbers() -> None:
    r20 = standard_torques(1.0, 10.0)
    assert len(r20) == 21
    # Each step is the 20th root of 10; ISO 3 rounds by up to 1.3 %.
    assert r20 == pytest.approx(10 ** (np.arange(21) / 20), rel=0.014)
    assert standard_torques(0.9, 2.3).tolist() == [
        *(0.9, 1.0, 1.12, 1.25, 1.4, 1.6, 1.8, 2.0, 2.24),
    ]
    assert standard_torques(0.28, 0.3).tolist() == [0.28]
    assert standard_torques(95.0, 130.0).tolist() == [100.0, 112.0, 125.0]
    assert standard_torques(1.01, 1.1).size == 0
    with pytest.raises(InputError, match="lower"):
        standard_torques(0.0, 1.0)


def test_scatter_by_method() -> None:
    # The unfavourable ends of VDI 2230 Table A8.
    assert Tightening().alpha == SCATTER_BY_METHOD["torque_wrench"] == 2.0
    assert Tightening(method="torque_wrench_tested").alpha == 1.6
    assert Tightening(method="angle").alpha == 1.4
    assert Tightening(method="yield").alpha == 1.4
    assert Tightening(method="yield", scatter=1.0).alpha == 1.0


def test_workshop_band_leaves_the_preloads_it_promises() -> None:
    tightening = Tightening(scatter=1.5, thread_friction=0.1, head_friction=0.14)
    bolt = catalogue.bolt("M5")
    torque = workshop_torque(flange(), 7000.0, tightening)

    def left(setting: float, factor: float = 1.0) -> float:
        return preload_at_torque(bolt, setting, 0.1 * factor, 0.14 * factor)

    assert left(torque.nominal) == left(torque.upper) == pytest.approx(7000.0)
    assert left(torque.lower) == pytest.approx(7000.0 / 1.5)
    # At the highest friction that the scatter covers, the nominal torque leaves F/alpha.
    assert left(torque.nominal, torque.friction_factor) == pytest.approx(7000.0 / 1.5)
    assert torque.friction_factor > 1.5
    screw = workshop_torque(pins(), 1500.0, tightening)
    assert screw.nominal == pytest.approx(0.2 * 4e-3 * 1500.0)
    assert screw.lower == pytest.approx(screw.nominal / 1.5)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"method": "torque_wrensh"}, "Did you mean 'torque_wrench'"),
        ({"scatter": 0.9}, "scatter = 0.9 cannot be used; allowed is a finite number, 1 or above"),
        ({"scatter": math.inf}, "scatter"),
        ({"thread_friction": 0.0}, "thread_friction = 0 is outside the validity range 0 to 1"),
        ({"head_friction": 0.0}, "head_friction = 0 is outside the validity range 0 to 1"),
        ({"thread_friction": -0.1}, "Both bounds are excluded"),
        ({"head_friction": 1.2}, "head_friction = 1.2 is outside the validity range 0 to 1"),
        ({"embedding": -1e-6}, "embedding"),
        ({"embedding": math.nan}, "embedding"),
    ],
)
def test_wrong_tightening(changes: dict[str, object], text: str) -> None:
    with pytest.raises(InputError, match=text):
        Tightening(**changes)


def test_derivatives_in_the_preload() -> None:
    bolt = catalogue.bolt("M5")

    def torque(preload: Quantity) -> Quantity:
        return tightening_torque(bolt, preload, 0.12, 0.12)

    slope = elementwise_derivative(torque, np.array([100.0, 7000.0]))
    assert slope == pytest.approx(np.full(2, torque(1.0)), rel=1e-12)
    assert elementwise_derivative(torque, 7000.0, order=2) == 0.0

    def strength(friction: Quantity) -> Quantity:
        return permissible_assembly_preload(bolt, 1100e6, friction)

    check_derivative(
        strength, lambda x: elementwise_derivative(strength, x), [0.08, 0.12, 0.3], scale=0.1
    )
