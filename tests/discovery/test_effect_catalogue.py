"""Every effect of the catalogue: linear, dimensioned, dissipative."""

import math
import re
from itertools import product

import numpy as np
import pint
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stiffopt.closed_loop.parameters import JOINT_PARAMETERS
from stiffopt.discovery.catalogue import CATALOGUE, confused_with, effect
from stiffopt.discovery.catalogue.common import WEIGHT
from stiffopt.discovery.signals import JointConstants
from stiffopt.discovery.user_effects import (
    constants_at,
    find_faults,
    sample_signals,
    sample_signals_of,
    stack_term,
)
from stiffopt.errors import InputError
from stiffopt.report.common.citations import references
from stiffopt.units import joint_unit

REPORTED = {
    "coulomb": {"dFc": "N m"},
    "viscous": {"dFv": "N m s/rad"},
    "stribeck": {"A": "N m", "vs": "rad/s"},
    "load_friction": {"mu": ""},
    "asym_friction": {"dFc": "N m", "dFv": "N m s/rad"},
    "position_friction": {"A": "N m", "q0": "rad", "width": "rad"},
    "thermal_friction": {"b": "1/K"},
    "lubricated_friction": {
        "mu": "",
        "mu_slow": "",
        "A": "N m",
        "A_T": "N m/K",
        "vs": "rad/s",
        "b": "1/K",
    },
    "friction_drift": {"dFc_spread": "N m", "dFv_spread": "N m s/rad"},
    "friction_in_runs": {"dFc": "N m", "dFv": "N m s/rad", "first": "", "last": ""},
    "cold_start": {"dFc": "N m", "dFv": "N m s/rad", "tau_w": "s"},
    "untimed_cold_start": {"dFc": "N m", "dFv": "N m s/rad", "tau_w": "s", "period": "s"},
    "friction_warmup": {"dFc": "N m", "dFv": "N m s/rad"},
    "stroke_friction": {"A": "N m", "q0": "rad", "q1": "rad"},
    "quadratic_drag": {"D": "N m s^2/rad^2"},
    "coupled_drive": {"Fc": "N m", "Fv": "N m s/rad", "J": "kg m^2", "c": ""},
    "backlash": {"width": "rad"},
    "hysteresis": {"h": "N m", "s": "rad"},
    "stiffness_linear": {"factor": ""},
    "k1_softening": {"k1_factor": "", "t1_factor": ""},
    "preload_loss": {"tp": "N m", "windup": "rad"},
    "joint_damping": {"dD": "N m s/rad"},
    "belt_creep": {"C": "rad/(N m)", "tau_r": "s"},
    "transmission_error": {"A1": "rad", "A2": "rad", "A4": "rad"},
    "torque_ripple": {"B1": "N m", "B6": "N m"},
    "rotor_ripple": {"B": "N m", "waves": ""},
    "rotor_inertia": {"dJ": "kg m^2"},
    "payload": {"dm": "kg", "cx": "m", "cy": "m", "cz": "m"},
    "carried_part": {"m": "kg", "cx": "m", "cy": "m", "cz": "m"},
    "gravity_spring": {"k": "N m/rad", "offset": "rad"},
    "cable_spring": {"k1": "N m/rad", "k3": "N m/rad^3", "q0": "rad"},
    "end_stop": {"k": "N m/rad", "q0": "rad"},
    "torque_gain": {"eps": ""},
    "torque_offset": {"off": "N m"},
    "encoder_offset": {"off": "rad"},
    "time_delay": {"d": "s"},
    "joint_delay": {"d": "s"},
    "reading_filter": {"T": "s"},
    "saturation": {"limit": "N m"},
    "reading_limit": {"limit": "N m"},
    "clock_drift": {"e": "", "d": "s"},
    "run_clock": {"d": "s"},
    "common_gain_drift": {"per_run": "", "spread": ""},
    "gain_drift": {"per_run": "", "spread": ""},
    "gain_warmup": {"eps": ""},
    "base_tilt": {"rx": "rad", "ry": "rad"},
    "joint_zero": {"dq": "rad"},
    "crosstalk": {"c": "", "from_joint": ""},
    "tool_force": {"fx": "N", "fy": "N", "fz": "N"},
    "turning_tool_force": {"fx": "N", "fy": "N", "fz": "N"},
    "wrist_coupling": {"c": ""},
    "output_backlash": {"width": "rad"},
    "command_delay": {"d": "s"},
    "deadband": {"width": "rad"},
    "external_contact": {"k": "N/m", "z": "m"},
    "inertial_error": {
        "dm": "kg",
        "dmc": "kg m",
        "dI": "kg m^2",
        "dmcx": "kg m",
        "dmcy": "kg m",
        "dmcz": "kg m",
    },
    "encoder_skew": {"d": "s"},
    "encoder_zero_change": {"off": "rad"},
}
ROBOT = sample_signals()
BY_NAME = [pytest.param(e, id=e.name) for e in CATALOGUE]
DISSIPATING = ("coulomb", "viscous", "stribeck", "load_friction", "position_friction")


def first_shapes(entry, signals):
    return [s.grid(constants_at(entry, signals))[-1] for s in entry.shapes]


def sizes(entry, signals):
    return np.array([a.size(constants_at(entry, signals)) for a in entry.amplitudes])


def test_catalogue_names_units_and_parameters_match_reference():
    assert [e.name for e in CATALOGUE if REPORTED.get(e.name) is None] == []
    assert len(CATALOGUE) == len(REPORTED)
    for entry in CATALOGUE:
        signals = sample_signals_of(entry, ROBOT)
        values = entry.parameters(
            list(sizes(entry, signals)), first_shapes(entry, signals), constants_at(entry, signals)
        )
        assert {name: entry.unit_of(name) for name in values} == REPORTED[entry.name], entry.name
        assert all(math.isfinite(v) for v in values.values())


@pytest.mark.parametrize("entry", BY_NAME)
def test_effect_passes_soundness_checks(entry):
    assert list(find_faults(entry)) == []


@pytest.mark.parametrize("entry", BY_NAME)
def test_effect_has_signature_and_bounds(entry):
    signals = sample_signals_of(entry, ROBOT)
    assert len(entry.signature) > 30
    assert len(entry.separate) > 30
    assert entry.equation
    assert entry.family in (
        "friction",
        "elastic",
        "periodic",
        "inertial",
        "geometry",
        "sensor",
        "spring",
        "contact",
    )
    for amplitude in entry.amplitudes:
        size = amplitude.size(constants_at(entry, signals))
        assert math.isfinite(amplitude.lower * size)
        assert math.isfinite(amplitude.upper * size)
        assert amplitude.lower <= 0.0 < amplitude.upper
    for shape in entry.shapes:
        assert math.isfinite(shape.lower)
        assert math.isfinite(shape.upper)
    combinations = math.prod(len(s.grid(constants_at(entry, signals))) for s in entry.shapes)
    assert combinations <= (30 if entry.name == "position_friction" else 12)


def test_effect_units_are_known():
    registry = pint.UnitRegistry()
    for entry in CATALOGUE:
        for unit in REPORTED[entry.name].values():
            assert registry.parse_units(unit.replace(" ", "*")) is not None
        for each in (*entry.amplitudes, *entry.shapes):
            assert registry.parse_units(each.unit.replace(" ", "*")) is not None


@settings(max_examples=25, deadline=None)
@given(
    index=st.integers(0, len(CATALOGUE) - 1),
    factors=st.lists(st.floats(-3.0, 3.0), min_size=10, max_size=10),
    others=st.lists(st.floats(-3.0, 3.0), min_size=10, max_size=10),
    share=st.floats(-4.0, 4.0),
)
def test_terms_are_linear_in_amplitudes(index, factors, others, share):
    entry = CATALOGUE[index]
    signals = sample_signals_of(entry, ROBOT)
    size = sizes(entry, signals)
    shapes = first_shapes(entry, signals)
    a, b = (size * np.array(x[: len(size)]) for x in (factors, others))

    def value(amplitudes):
        # Constant zeros drop out of `stacked`; the longest reply is the whole one.
        return stack_term(entry.term(signals, list(amplitudes), shapes))

    whole = value(a + share * b)
    parts = value(a) + share * value(b)
    scale = sum(np.abs(value(s * np.eye(len(size))[i])).max() for i, s in enumerate(size))
    np.testing.assert_allclose(whole, parts, atol=1e-11 * 20.0 * scale, rtol=0.0)


@pytest.mark.parametrize("name", DISSIPATING)
def test_friction_dissipates(name):
    entry, signals = effect(name), ROBOT.of_joint(4)
    w = signals.motor_velocity
    for shapes in product(*(s.grid(constants_at(entry, signals)) for s in entry.shapes)):
        term = entry.term(signals, list(sizes(entry, signals)), shapes)
        assert np.all(np.asarray(term.drive_torque) * w >= 0.0)
        assert np.max(np.asarray(term.drive_torque) * w) > 0.0


@pytest.mark.parametrize("name", ["coulomb", "viscous", "asym_friction", "thermal_friction"])
def test_friction_within_bounds_is_dissipative(name):
    entry, signals = effect(name), ROBOT.of_joint(4)
    c, w = signals.constants, signals.motor_velocity
    nominal = c.coulomb * np.tanh(w / 0.01) + c.viscous * w
    corners = product(*((a.lower, min(a.upper, 3.0)) for a in entry.amplitudes))
    for corner in corners:
        if entry.amplitudes[0] == WEIGHT:
            corner = (1.0, min(corner[1], 3.3))
        amplitudes = list(np.array(corner) * sizes(entry, signals))
        shapes = first_shapes(entry, signals)
        total = nominal + np.asarray(entry.term(signals, amplitudes, shapes).drive_torque)
        assert np.min(total * w) >= -1e-9


def test_effect_applies_only_to_suitable_joints():
    rigid = JointConstants(
        joint=1,
        ratio=1.0,
        coulomb=0.0,
        viscous=0.0,
        torque_rated=20.0,
        torque_max=60.0,
        rotor_inertia=0.0,
    )
    left_out = {e.name for e in CATALOGUE if e.applies is not None and not e.applies(rigid)}
    assert left_out == {
        "backlash",
        "hysteresis",
        "stiffness_linear",
        "k1_softening",
        "preload_loss",
        "belt_creep",
        "joint_damping",
        "transmission_error",
        "torque_ripple",
        "rotor_ripple",
        "wrist_coupling",
        "coupled_drive",
        "crosstalk",
        "joint_delay",
        "saturation",
        "reading_limit",
    }
    for entry in CATALOGUE:
        if entry.scope in ("joint", "run") and entry.name not in left_out:
            assert all(0.0 < a.size(rigid) < math.inf for a in entry.amplitudes), entry.name


def test_log_prior_depends_on_joint():
    first, last = ROBOT.constants.joints[0], ROBOT.constants.joints[5]
    assert effect("cable_spring").log_prior(first) < effect("cable_spring").log_prior(last)
    assert effect("gravity_spring").log_prior(first) > effect("gravity_spring").log_prior(last)
    assert effect("wrist_coupling").log_prior(first) < effect("wrist_coupling").log_prior(last)


def test_confused_effects_and_references_exist():
    names = {e.name for e in CATALOGUE}
    for entry in CATALOGUE:
        assert set(entry.confused_with) <= names - {entry.name}, entry.name
        assert all(entry.name in confused_with(effect(other)) for other in confused_with(entry))
        assert not entry.reference or entry.reference in references(), entry.name
        assert entry.needs, entry.name
        assert entry.title
        assert entry.phrase


def test_unknown_effect_suggests_nearest_name():
    with pytest.raises(InputError, match=r"'colomb'.*Did you mean 'coulomb'"):
        effect("colomb")


def test_every_unit_of_a_joint_has_that_of_a_prismatic_one() -> None:
    entries = [each for each in CATALOGUE if each.scope in ("joint", "run")]
    told = {own.unit for each in entries for own in (*each.amplitudes, *each.shapes)}
    told |= {unit for each in entries for unit in each.units.values()}
    rotary = {unit for unit in told | set(JOINT_PARAMETERS.values()) if re.search("N m|rad", unit)}
    assert {"N m", "rad", "N m s^2/rad^2"} <= rotary
    units = pint.UnitRegistry()
    for unit in rotary:
        slides = joint_unit(unit, prismatic=True)
        assert not re.search("N m|rad", slides), unit
        # A rotation becomes a way, and a torque a force over the lever of a metre.
        turned = units.parse_units(unit.replace("N m", "N").replace("rad", "m"))
        assert units.parse_units(slides).dimensionality == turned.dimensionality
