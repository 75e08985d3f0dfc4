"""Steps of VDI 2230: each formula against published numbers or by physics of its own."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from fastened_parts import flange

from stiffopt.connection import Bolt
from stiffopt.drivetrain import catalogue
from stiffopt.drivetrain.fasteners import BoltData
from stiffopt.errors import InputError, OutOfValidityError
from stiffopt.fastening import bolts
from stiffopt.fastening.bolt_strength import (
    endurance_limit,
    head_bearing,
    largest_working_preload,
    stress_amplitude,
    transverse_slip_limit,
    working_stress,
)
from stiffopt.fastening.bolts import permissible_assembly_preload
from stiffopt.fastening.compliance import (
    embedding,
    load_factor,
    thermal_change,
)
from stiffopt.fastening.flange_load import FlangeLoads, friction_clamp_load
from stiffopt.fastening.tightening import Tightening, preload_at_torque, tightening_torque
from stiffopt.fastening.utilisation import UtilisationRow
from stiffopt.fastening.vdi_rows import vdi_rows
from stiffopt.fastening.verification import Verification

TESTED = Tightening(scatter=1.6, embedding=3e-6)


def thread(size, pitch, head=None, hole=None, diameter=None):
    """Bolt of any metric thread, ISO 724."""
    d = diameter or float(size) * 1e-3
    d2, d3 = d - 0.649519 * pitch, d - 1.226869 * pitch
    return BoltData(
        name=f"M{d * 1e3:g}",
        provenance="catalogue",
        source="ISO 724",
        diameter=d,
        pitch=pitch,
        pitch_diameter=d2,
        minor_diameter=d3,
        stress_area=math.pi / 4 * ((d2 + d3) / 2) ** 2,
        head_diameter=1.5 * d,
        bearing_diameter=head or 1.45 * d,
        hole=hole or 1.1 * d,
    )


# ---- tables A1 and A2: largest assembly preload, kN at mu_G = 0.10, 0.12, 0.14


@pytest.mark.parametrize(
    ("diameter", "pitch", "grade", "forces"),
    [
        # Table A2, fine threads, as Mastik's catalogue page 685 prints it.
        (8, 1.0, "8.8", (20.7, 20.2, 19.7)),
        (8, 1.0, "10.9", (30.4, 29.7, 28.9)),
        (8, 1.0, "12.9", (35.6, 34.7, 33.9)),
        (10, 1.25, "12.9", (55.6, 54.3, 52.9)),
        (12, 1.25, "10.9", (72.1, 70.5, 68.7)),
        (14, 1.5, "12.9", (114.1, 111.4, 108.7)),
        (16, 1.5, "10.9", (131.6, 128.7, 125.5)),
        # Table A1, coarse threads: M12 8.8 at 0.14 has 41.9 kN, Bossard "VDI 2230 tables" step 4.
        (12, 1.75, "8.8", (None, None, 41.9)),
    ],
)
def test_tables_of_assembly_preload(diameter, pitch, grade, forces):
    bolt = thread(diameter, pitch * 1e-3)
    for friction, force in zip((0.10, 0.12, 0.14), forces, strict=True):
        if force is not None:
            found = permissible_assembly_preload(bolt, catalogue.proof_stress(grade), friction)
            assert found / 1e3 == pytest.approx(force, rel=0.01)


@pytest.mark.parametrize(
    ("diameter", "pitch", "head", "hole", "torque"),
    [
        # Table A2, 8.8, mu = 0.12: tightening torques of Mastik's page 685 [N m].
        (8, 1.0, 11.63e-3, 9.0e-3, 26.1),
        (10, 1.25, 14.63e-3, 11.0e-3, 51.0),
        (12, 1.25, 16.63e-3, 13.5e-3, 90.0),
        (16, 1.5, 22.49e-3, 17.5e-3, 218.0),
    ],
)
def test_tables_of_tightening_torque(diameter, pitch, head, hole, torque):
    bolt = thread(diameter, pitch * 1e-3, head, hole)
    force = permissible_assembly_preload(bolt, 640e6, 0.12)
    assert tightening_torque(bolt, force, 0.12, 0.12) == pytest.approx(torque, rel=0.02)


# ---- R1 to R6


def test_bossard_example_of_the_tightening_factor():
    # Bossard "VDI 2230 tables", steps 2 to 4: M12 8.8, mu = 0.14, alpha_A 1.8: 41.9 kN, of which
    # 23.3 kN are left.
    largest = permissible_assembly_preload(thread(12, 1.75e-3), 640e6, 0.14)
    assert largest / 1.8 / 1e3 == pytest.approx(23.3, rel=0.01)


def test_vdi_example_1_of_the_piston():
    # VDI 2230 example B1 as published at github.com/h18340637145/vdi2230 (steps R5, R6): F_A = 24.9
    # kN, Phi = 0.0122, F_Z = 3073 N and no clamp load at the end: F_Mmin = 27668 N.
    factor = load_factor(1.0, 0.0122 / (1 - 0.0122), 1.0)
    assert factor.most == pytest.approx(0.0122)
    least = (1 - factor.most) * 24_900.0 + 3073.0
    assert least == pytest.approx(27_668.0, rel=1e-3)


def test_unknown_load_introduction_uses_both_bounds():
    factor = load_factor(8e-9, 2e-9, None)
    assert (factor.most, factor.least) == (pytest.approx(0.2), 0.0)
    known = load_factor(8e-9, 2e-9, 0.5)
    assert known.most == known.least == pytest.approx(0.1)


def test_embedding_of_table_5():
    # Rz below 10 um under shear: 3 in the thread, 3 at the head, 2 at the face.
    assert embedding(6.3e-6, 1) == pytest.approx(8e-6)
    assert embedding(16e-6, 1) == pytest.approx(10e-6)
    assert embedding(16e-6, 3) == pytest.approx(15e-6)
    assert embedding(63e-6, 1) == pytest.approx(13e-6)
    with pytest.raises(OutOfValidityError, match="Table 5"):
        embedding(200e-6, 1)


def test_aluminium_on_steel_loses_more_by_temperature_than_embedding():
    # M5, 10 mm clamped, 30 K: the parts of aluminium shrink 3.57 um more than their bolt.
    ring = flange("M5", head_material="aluminium", thread_material="steel")
    lost = bolts.thermal_preload(ring, TESTED)
    free = 10e-3 * (23.4e-6 - 11.5e-6) * 30.0
    assert lost == pytest.approx(free / sum(bolts.joint_compliances(ring)), rel=1e-9)
    assert lost > 3e-6 / sum(bolts.joint_compliances(ring))
    assert thermal_change(10e-3, 11.5e-6, 23.4e-6, -30.0, 6.67e-9) == pytest.approx(535.0, rel=0.01)
    assert bolts.thermal_preload(flange("M5"), TESTED) == 0.0


# ---- eccentric clamping and load


# ---- R8 to R12


def test_working_stress_has_half_of_the_torsion():
    bolt = catalogue.bolt("M5")
    full = 7000.0 / 14.18e-6
    friction = 0.12
    torque = 7000.0 * (0.8e-3 / (2 * math.pi) + 4.48e-3 / 2 * friction / math.cos(math.pi / 6))
    tau = torque / (math.pi / 16 * ((4.480e-3 + 4.019e-3) / 2) ** 3)
    assert working_stress(bolt, 7000.0, 0.0, friction) == pytest.approx(
        math.hypot(full, math.sqrt(3) * 0.5 * tau)
    )
    most = largest_working_preload(bolt, 1100e6, 500.0, friction)
    assert working_stress(bolt, most, 500.0, friction) == pytest.approx(1100e6, rel=1e-12)
    assert largest_working_preload(bolt, 1100e6, 1100e6 * 14.18e-6, friction) == 0.0


def test_endurance_of_threads():
    # 0.85 (150/d + 45): 50.6 MPa for M10, 63.75 for M5 rolled before heat treatment.
    assert endurance_limit(catalogue.bolt("M5"), "before") == pytest.approx(63.75e6)
    assert endurance_limit(thread(10, 1.5e-3), "before") == pytest.approx(51.0e6)
    bolt = catalogue.bolt("M8")
    before = endurance_limit(bolt, "before")
    half = 0.5 * 1100e6 * bolt.stress_area
    assert endurance_limit(bolt, "after", half, 1100e6) == pytest.approx(1.5 * before)
    assert endurance_limit(bolt, "after", 0.0, 1100e6) == pytest.approx(1.7 * before)
    assert stress_amplitude(bolt, 3000.0, 1000.0) == pytest.approx(1000.0 / bolt.stress_area)


def test_washer_spreads_the_head():
    bare = Bolt(size="M5", head_material="aluminium")
    data = catalogue.bolt("M5")
    assert head_bearing(bare).capacity == pytest.approx(200e6 * data.head_area)
    wide = head_bearing(replace(bare, washer=True))
    outer = min(10e-3, 8.03e-3 + 1.6 * 1e-3)
    assert wide.capacity == pytest.approx(200e6 * math.pi / 4 * (outer**2 - 5.5e-3**2))
    # On hard parts the head itself presses the washer.
    hard = head_bearing(Bolt(size="M5", head_material="34CrMo4", washer=True))
    assert hard.capacity == pytest.approx(900e6 * data.head_area)
    assert "head on its washer" in hard.source


def test_transverse_slip_limit_is_that_of_a_clamped_beam():
    bolt = catalogue.bolt("M6")
    length, preload = 20e-3, 8000.0
    moved = transverse_slip_limit(bolt, length, preload, 0.1, 205e9)
    inertia = math.pi * (4.773e-3 / 2) ** 4 / 4
    # Force of a beam clamped at both ends that is moved across.
    assert 12 * 205e9 * inertia * moved / length**3 == pytest.approx(0.1 * preload, rel=1e-9)


# ---- the flange as a whole


def loads(*values, alternating=False):
    return FlangeLoads(
        names=tuple(f"case {i}" for i in range(len(values))),
        values=np.array(values, dtype=float),
        alternating=alternating,
    )


def test_torque_only_requires_clamp_load_of_the_ring():
    ring = flange()
    steps = Verification(ring, TESTED, loads([0, 0, 0, 0, 0, 110.0]))
    lever = 2 / 3 * (20e-3**3 - 10e-3**3) / (20e-3**2 - 10e-3**2)
    needed = 1.2 * 110.0 / (0.15 * 9 * lever)
    assert float(steps.clamp_needed[0]) == pytest.approx(needed, rel=1e-12)
    assert steps.least_preload == pytest.approx(1.6 * (needed + steps.loss), rel=1e-12)
    turning = Verification(ring, TESTED, loads([0, 0, 0, 0, 0, 110.0], alternating=True))
    assert float(turning.clamp_needed[0]) == pytest.approx(1.5 * needed, rel=1e-12)
    names = [check.kind for check in vdi_rows(steps, 11e3)]
    assert "slip under the whole load" not in names


def test_wrench_by_hand():
    # Nine M5 on 30 mm: 60 N m tilting, 900 N pulling, 300 N shear, 20 N m torque; n unknown.
    ring = flange()
    steps = Verification(ring, TESTED, loads([300.0, 0, 900.0, 60.0, 0, 20.0]))
    pull = 900.0 / 9 + 4 * 60.0 / (9 * 30e-3)
    assert float(steps.opening.max()) == pytest.approx(pull, rel=1e-4)
    lever = steps.friction_radius
    friction = (300.0 / 9 + 20.0 / (9 * lever)) / 0.15
    found = float(steps.clamp_needed[0])
    # The moment pulls where shear and torque add up, if the carried part lies on that side.
    assert found == pytest.approx(pull + 1.2 * friction, rel=1e-4)
    # Which side that is nobody says: a moment the other way is the same.
    other = Verification(ring, TESTED, loads([300.0, 0, 900.0, -60.0, 0, 20.0]))
    assert float(other.clamp_needed[0]) == pytest.approx(found, rel=1e-12)
    # About the other axis pull and friction are at their worst at bolts a quarter turn apart.
    across = Verification(ring, TESTED, loads([300.0, 0, 900.0, 0, 60.0, 20.0]))
    needed = float(across.clamp_needed[0])
    assert max(pull, 1.2 * friction) < needed < 0.95 * (pull + 1.2 * friction)
    for check in vdi_rows(steps, 9000.0):
        if check.kind == "one-sided opening":
            assert check.limit == pytest.approx(float(steps.clamp_against_opening[0]))
            assert check.value == pytest.approx(9000.0 / 1.6 - steps.loss)
    compliance = steps.compliances
    phi = compliance[1] / sum(compliance)
    assert steps.additional == pytest.approx(phi * pull, rel=1e-4)
    # Tilting there and back: the amplitude is of the load on and off.
    assert steps.alternating_force == pytest.approx(phi * pull, rel=1e-4)
    back = Verification(ring, TESTED, loads([0, 0, 0, 60.0, 0, 0], [0, 0, 0, -60.0, 0, 0]))
    assert back.alternating_force == pytest.approx(2 * phi * 4 * 60.0 / (9 * 30e-3), rel=1e-4)


def test_preload_bounds_are_at_utilisation_one():
    ring = flange(bolt=Bolt(size="M5", rolled="after"))
    steps = Verification(ring, TESTED, loads([300.0, 0, 900.0, 60.0, 0, 20.0]))
    at_least = {c.kind: c for c in vdi_rows(steps, steps.least_preload)}
    below = ("slip under the whole load", "one-sided opening")
    assert max(at_least[name].utilisation for name in below) == pytest.approx(1.0, rel=1e-9)
    at_most = {c.kind: c for c in vdi_rows(steps, steps.largest_preload)}
    above = ("working stress", "head pressure in service", "alternating stress")
    assert max(at_most[name].utilisation for name in above) == pytest.approx(1.0, rel=1e-9)


def test_bearing_beside_carries_all_but_torque():
    wrench = loads([300.0, 0, 900.0, 60.0, 0, 20.0])
    beside = Verification(flange(bearing="beside"), TESTED, wrench)
    alone = Verification(flange(), TESTED, loads([0, 0, 0, 0, 0, 20.0]))
    assert beside.least_preload == alone.least_preload
    assert beside.largest_preload == alone.largest_preload


def test_two_bolts_with_tilting_are_refused():
    with pytest.raises(InputError, match="2 bolts carry no tilting moment"):
        Verification(flange(bolt_count=2), TESTED, loads([0, 0, 0, 60.0, 0, 20.0]))


def test_pressure_of_few_bolts_is_not_taken_for_even():
    with pytest.raises(InputError, match="one bolt beside the axis presses one side"):
        flange(bolt_count=1)
    torque = loads([0, 0, 0, 0, 0, 20.0])

    def extent(count):
        rows = vdi_rows(Verification(flange(bolt_count=count), TESTED, torque), 9000.0)
        return next(row.value for row in rows if row.kind == "validity of even pressure")

    ring = flange()
    assert extent(2) == ring.circle_diameter
    assert extent(3) == pytest.approx(ring.outer_radius - ring.inner_radius)


def test_warnings_do_not_reject_designs():
    steps = Verification(flange(outer_radius=30e-3), TESTED, loads([0, 0, 0, 0, 0, 20.0]))
    warned = {c.kind: c for c in vdi_rows(steps, 9000.0, shift=1e-3) if not c.binding}
    assert set(warned) == {"validity of even pressure", "self-loosening"}
    assert all(check.utilisation > 1.0 for check in warned.values())


def test_row_is_satisfied_within_rounding():
    row = UtilisationRow(kind="slip safety", value=1.0, limit=1.0, unit="", utilisation=1.0)
    assert row.satisfied
    assert row.active
    assert replace(row, utilisation=1.0 + 5e-7).satisfied
    assert not replace(row, utilisation=1.0 + 2e-6).satisfied
    assert replace(row, utilisation=2.0, binding=False).satisfied
    assert not replace(row, utilisation=2.0, binding=False).active
    assert not replace(row, utilisation=0.999).active


def test_highest_friction_raises_tightening_factor():
    bolt = catalogue.bolt("M5")
    wide = Tightening(scatter=1.0, thread_friction=0.08, head_friction=0.08, friction_highest=0.16)
    low, high = (preload_at_torque(bolt, 8.0, mu, mu) for mu in (0.08, 0.16))
    assert wide.alpha_of(bolt) == pytest.approx(low / high * 1.05 / 0.95)
    assert wide.alpha_of(None) == 1.0
    assert Tightening(friction_highest=0.12).alpha_of(bolt) == 2.0


def test_clamp_load_of_friction():
    assert friction_clamp_load(np.array([[3.0, 4.0]]), 0.1) == pytest.approx([50.0])
