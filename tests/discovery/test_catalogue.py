"""Every effect of the catalogue: linear, differentiable, dimensioned, dissipative, remembered."""

import math
from dataclasses import fields, replace
from itertools import product

import casadi as ca
import numpy as np
import pint
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stiffopt.discovery.catalogue import CATALOGUE, confusion_groups, effect
from stiffopt.discovery.catalogue.common import WEIGHT
from stiffopt.discovery.catalogue.elastic import reducer_windup
from stiffopt.discovery.catalogue.soundness import (
    PARTS,
    faults,
    sample_signals,
    signals_for,
    stacked,
    symbolic_values,
)
from stiffopt.discovery.signals import JointConstants
from stiffopt.errors import InputError

REPORTED = {
    "coulomb": {"dFc": "N m"},
    "viscous": {"dFv": "N m s/rad"},
    "stribeck": {"A": "N m", "vs": "rad/s"},
    "load_friction": {"mu": ""},
    "asym_friction": {"dFc": "N m", "dFv": "N m s/rad"},
    "position_friction": {"A": "N m", "q0": "rad", "width": "rad"},
    "thermal_friction": {"b": "1/K"},
    "backlash": {"width": "rad"},
    "hysteresis": {"h": "N m", "s": "rad"},
    "stiffness_linear": {"factor": ""},
    "k1_softening": {"k1_factor": "", "t1_factor": ""},
    "preload_loss": {"tp": "N m"},
    "belt_creep": {"C": "rad/(N m)", "tau_r": "s"},
    "transmission_error": {"A1": "rad", "A2": "rad", "A4": "rad"},
    "torque_ripple": {"B1": "N m", "B6": "N m"},
    "rotor_inertia": {"dJ": "kg m^2"},
    "payload": {"dm": "kg", "cx": "m", "cy": "m", "cz": "m"},
    "gravity_spring": {"k": "N m/rad", "offset": "rad"},
    "cable_spring": {"k1": "N m/rad", "k3": "N m/rad^3", "q0": "rad"},
    "torque_gain": {"eps": ""},
    "torque_offset": {"off": "N m"},
    "encoder_offset": {"off": "rad"},
    "time_delay": {"d": "s"},
    "saturation": {"limit": "N m"},
    "base_tilt": {"rx": "rad", "ry": "rad"},
    "wrist_coupling": {"c": ""},
    "external_contact": {"k": "N/m", "z": "m"},
    "inertial_error": {"dm": "kg", "dmc": "kg m", "dmcx": "kg m", "dmcy": "kg m", "dmcz": "kg m"},
    "encoder_skew": {"d": "s"},
    "encoder_zero_change": {"off": "rad"},
}
ROBOT = sample_signals()
BY_NAME = [pytest.param(e, id=e.name) for e in CATALOGUE]
OF_JOINTS = [pytest.param(e, id=e.name) for e in CATALOGUE if e.scope in ("joint", "run")]
MEMORY = ("hysteresis", "belt_creep")
DISSIPATING = ("coulomb", "viscous", "stribeck", "load_friction", "position_friction")


def first_shapes(entry, signals):
    return [s.grid(signals.constants)[-1] for s in entry.shapes]


def sizes(entry, signals):
    return np.array([a.size(signals.constants) for a in entry.amplitudes])


def symbols_of(signals):
    names = [f.name for f in fields(signals) if isinstance(getattr(signals, f.name), np.ndarray)]
    channels = {name: ca.SX.sym(name, len(signals.time)) for name in names}
    numbers = np.concatenate([getattr(signals, name) for name in names])
    return replace(signals, **channels), ca.vertcat(*channels.values()), numbers


def test_names_units_and_parameters_are_those_of_the_answer_file():
    assert [e.name for e in CATALOGUE if REPORTED.get(e.name) is None] == []
    assert len(CATALOGUE) == len(REPORTED) == 30
    for entry in CATALOGUE:
        signals = signals_for(entry, ROBOT)
        values = entry.values(
            list(sizes(entry, signals)), first_shapes(entry, signals), signals.constants
        )
        assert {name: entry.unit_of(name) for name in values} == REPORTED[entry.name], entry.name
        assert all(math.isfinite(v) for v in values.values())


@pytest.mark.parametrize("entry", BY_NAME)
def test_effect_is_sound(entry):
    assert list(faults(entry)) == []


@pytest.mark.parametrize("entry", BY_NAME)
def test_effect_says_how_it_shows_and_is_bounded(entry):
    signals = signals_for(entry, ROBOT)
    assert len(entry.signature) > 30
    assert len(entry.separate) > 30
    assert entry.equation
    assert entry.family in (
        "friction",
        "elastic",
        "periodic",
        "inertial",
        "sensor",
        "spring",
        "contact",
    )
    for amplitude in entry.amplitudes:
        size = amplitude.size(signals.constants)
        assert math.isfinite(amplitude.lower * size)
        assert math.isfinite(amplitude.upper * size)
        assert amplitude.lower <= 0.0 < amplitude.upper
    for shape in entry.shapes:
        assert math.isfinite(shape.lower)
        assert math.isfinite(shape.upper)
    combinations = math.prod(len(s.grid(signals.constants)) for s in entry.shapes)
    assert combinations <= (30 if entry.name == "position_friction" else 12)


def test_units_are_known():
    registry = pint.UnitRegistry()
    for entry in CATALOGUE:
        for unit in REPORTED[entry.name].values():
            assert registry.parse_units(unit.replace(" ", "*")) is not None
        for each in (*entry.amplitudes, *entry.shapes):
            assert registry.parse_units(each.unit.replace(" ", "*")) is not None


@settings(max_examples=25, deadline=None)
@given(
    index=st.integers(0, len(CATALOGUE) - 1),
    factors=st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6),
    others=st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6),
    share=st.floats(-4.0, 4.0),
)
def test_terms_are_linear_in_amplitudes(index, factors, others, share):
    entry = CATALOGUE[index]
    signals = signals_for(entry, ROBOT)
    size = sizes(entry, signals)
    shapes = first_shapes(entry, signals)
    a, b = (size * np.array(x[: len(size)]) for x in (factors, others))

    def value(amplitudes):
        # Constant zeros drop out of `stacked`; the longest reply is the whole one.
        return stacked(entry.term(signals, list(amplitudes), shapes))

    whole = value(a + share * b)
    parts = value(a) + share * value(b)
    scale = sum(np.abs(value(s * np.eye(len(size))[i])).max() for i, s in enumerate(size))
    np.testing.assert_allclose(whole, parts, atol=1e-11 * 20.0 * scale, rtol=0.0)


@pytest.mark.parametrize("entry", OF_JOINTS)
def test_symbols_in_every_signal_give_the_same_numbers(entry):
    short = sample_signals(count=20)
    signals = signals_for(entry, short)
    symbolic, symbols, numbers = symbols_of(signals)
    amplitudes, shapes = list(sizes(entry, signals)), first_shapes(entry, signals)
    term = entry.term(symbolic, amplitudes, shapes)
    expressions = [getattr(term, p) for p in PARTS if isinstance(getattr(term, p), ca.SX)]
    function = ca.Function("term", [symbols], [ca.densify(ca.vertcat(*expressions))])
    expected = stacked(entry.term(signals, amplitudes, shapes))
    np.testing.assert_allclose(
        np.asarray(function(numbers)).ravel(), expected, atol=1e-12 * np.abs(expected).max()
    )


def test_symbols_of_one_sample_serve_the_terms_of_the_robot():
    joints = 6
    body, tilt = ca.SX.sym("Y", joints, 60), ca.SX.sym("g", joints, 2)
    lever, tool = ca.SX.sym("J", 3, joints), ca.SX.sym("p", 1, 3)
    one = replace(ROBOT, body_regressor=body, tilt=tilt, tool_jacobian=lever, tool_position=tool)
    symbols = [body, tilt, lever, tool]
    k = 7
    numbers = [
        ROBOT.body_regressor[k],
        ROBOT.tilt[k],
        ROBOT.tool_jacobian[k],
        ROBOT.tool_position[k].reshape(1, 3),
    ]
    for name in ("payload", "base_tilt", "external_contact"):
        entry = effect(name)
        amplitudes, shapes = list(sizes(entry, ROBOT)), first_shapes(entry, ROBOT)
        value = ca.Function("term", symbols, [entry.term(one, amplitudes, shapes).link_torque])
        expected = entry.term(ROBOT, amplitudes, shapes).link_torque[k]
        np.testing.assert_allclose(
            np.asarray(value(*numbers)).ravel(), expected, rtol=1e-12, err_msg=name
        )


@pytest.mark.parametrize("entry", [e for e in BY_NAME if e.values[0].shapes])
def test_derivatives_with_respect_to_shapes_match_differences(entry):
    signals = signals_for(entry, ROBOT)
    amplitudes = list(sizes(entry, signals))
    for shapes in list(product(*(s.grid(signals.constants) for s in entry.shapes)))[::3]:
        symbols = ca.MX.sym("p", len(shapes))
        term = entry.term(signals, amplitudes, [symbols[i] for i in range(len(shapes))])
        values = [ca.vec(v) for p in PARTS if isinstance(v := getattr(term, p), ca.MX)]
        jacobian = np.asarray(
            ca.Function("J", [symbols], [ca.jacobian(ca.vertcat(*values), symbols)])(list(shapes))
        )
        fixed = [p for p in PARTS if isinstance(getattr(term, p), ca.MX)]
        for i, shape in enumerate(shapes):
            # A place at zero is moved by a part of what the signals span.
            step = 1e-6 * (abs(shape) or 1.0)

            def moved(by, i=i, shapes=shapes, fixed=fixed):
                at = list(shapes)
                at[i] += by
                changed = entry.term(signals, amplitudes, at)
                return np.concatenate([np.ravel(getattr(changed, p), order="F") for p in fixed])

            differences = (moved(step) - moved(-step)) / (2.0 * step)
            largest = np.abs(differences).max()
            # Next to a corner of a piecewise law the two sides of a difference disagree.
            off = np.abs(jacobian[:, i] - differences) > 1e-5 * largest + 1e-10
            assert np.mean(off) <= (0.02 if entry.name in ("k1_softening", "hysteresis") else 0.0)


@pytest.mark.parametrize("name", DISSIPATING)
def test_friction_takes_power_out_of_the_motion(name):
    entry, signals = effect(name), ROBOT.of_joint(4)
    w = signals.motor_velocity
    for shapes in product(*(s.grid(signals.constants) for s in entry.shapes)):
        term = entry.term(signals, list(sizes(entry, signals)), shapes)
        assert np.all(np.asarray(term.drive_torque) * w >= 0.0)
        assert np.max(np.asarray(term.drive_torque) * w) > 0.0


@pytest.mark.parametrize("name", ["coulomb", "viscous", "asym_friction", "thermal_friction"])
def test_friction_within_bounds_never_drives_the_joint(name):
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


def test_hysteresis_is_dahl_friction_beside_the_spring():
    signals = sample_signals(count=1500, dt=0.002).of_joint(4)
    h, reach = 1.3, 3e-4
    side, states = 0.0, []
    # Many small steps of dy/dd, by Euler: no formula shared with the term.
    for before, after in zip(signals.windup[:-1], signals.windup[1:], strict=True):
        states.append(side)
        for travel in np.full(200, (after - before) / 200):
            side += travel / reach * (1.0 - side * np.sign(travel))
    states.append(side)
    size = np.abs(signals.spring_torque)
    slopes = 1.0 / 6.5e4 + np.select([size < 7.0, size < 25.0], [1 / 1.6e4, 1 / 2.5e4], 1 / 2.9e4)
    expected = -h * slopes * np.array(states)
    found = np.asarray(effect("hysteresis").term(signals, [h], [reach]).deflection)
    np.testing.assert_allclose(found, expected, atol=3e-3 * np.abs(expected).max())


def test_hysteresis_loses_energy_and_not_more_when_fast():
    losses = []
    for dt in (0.002, 0.0005):
        signals = sample_signals(count=3000, dt=0.002).of_joint(4)
        signals = replace(signals, dt=dt, time=dt * np.arange(3000))
        d = effect("hysteresis").term(signals, [1.3], [3e-4]).deflection
        angle = signals.windup + d
        losses.append(
            float(
                np.sum(
                    0.5 * (signals.spring_torque[1:] + signals.spring_torque[:-1]) * np.diff(angle)
                )
            )
        )
    assert losses[0] > 0.0
    assert losses[0] == pytest.approx(losses[1], rel=1e-12)


def test_belt_creep_is_a_standard_linear_solid():
    signals = sample_signals(count=1000, dt=0.002).of_joint(4)
    now, later, lag = 2e-5, 3e-5, 0.15
    s, slow, expected = signals.spring_torque, signals.spring_torque[0], []
    for before, after in zip([s[0], *s[:-1]], s, strict=True):
        for k in range(1, 51):
            load = before + (after - before) * k / 50
            slow += (load - slow) * 0.002 / 50 / lag
        expected.append(now * after + later * slow)
    found = np.asarray(effect("belt_creep").term(signals, [now, later], [lag]).deflection)
    # The law holds the load through a step of the clock: off by half a step.
    np.testing.assert_allclose(found, expected, atol=1.0e-2 * np.abs(expected).max())


def test_belt_that_carries_a_steady_load_has_crept_altogether():
    signals = sample_signals(count=400).of_joint(4)
    signals = replace(signals, spring_torque=np.full(400, 12.0))
    found = effect("belt_creep").term(signals, [2e-5, 3e-5], [0.2]).deflection
    np.testing.assert_allclose(found, 12.0 * 5e-5, rtol=1e-12)


def test_reducer_windup_agrees_with_the_nominal_one_and_with_its_slopes():
    c = ROBOT.constants.joints[0]
    torque = np.linspace(-60.0, 60.0, 4001)
    contacts = torque / c.contact_stiffness
    np.testing.assert_allclose(
        reducer_windup(c, torque, 1.0, 1.0) + contacts, c.windup(torque), atol=1e-15
    )
    changed = reducer_windup(c, torque, 0.5, 2.0)
    slopes = np.gradient(changed, torque)
    for load, slope in ((5.0, 1 / 8e3), (13.0, 1 / 8e3), (20.0, 1 / 2.5e4), (40.0, 1 / 2.9e4)):
        assert np.interp(load, torque, slopes) == pytest.approx(slope, rel=1e-6)
    # A first corner beyond the second leaves no middle slope.
    wide = np.gradient(reducer_windup(c, torque, 1.0, 5.0), torque)
    assert np.interp(30.0, torque, wide) == pytest.approx(1 / 1.6e4, rel=1e-6)
    assert np.interp(45.0, torque, wide) == pytest.approx(1 / 2.9e4, rel=1e-6)


def test_backlash_is_its_full_width_from_side_to_side():
    signals = ROBOT.of_joint(4)
    signals = replace(signals, spring_torque=np.linspace(-40.0, 40.0, 60))
    jump = effect("backlash").term(signals, [4e-4], [0.005]).deflection
    assert jump[-1] - jump[0] == pytest.approx(4e-4, rel=1e-4)
    assert np.all(np.diff(jump) >= 0.0)


def test_preload_loss_is_odd_softest_at_zero_and_never_flat():
    torque = np.linspace(-40.0, 40.0, 801)
    signals = replace(ROBOT.of_joint(4), spring_torque=torque)
    angle = effect("preload_loss").term(signals, [1.0], [0.05, 0.5]).deflection
    slope = np.gradient(angle, torque)
    np.testing.assert_allclose(angle, -angle[::-1], atol=1e-18)
    assert np.all(slope > 0.0)
    assert np.all(np.diff(slope[402:-1]) < 0.0)


def test_ripple_and_transmission_error_have_their_orders():
    turn = np.linspace(0.0, 2.0 * np.pi / 101.0, 4096, endpoint=False)
    signals = replace(ROBOT.of_joint(4), motor_position=turn, spring_torque=np.ones_like(turn))
    error = effect("transmission_error")
    amplitudes = [3e-5, 4e-5, 0.0, 1.2e-4, 0.0, 0.0]
    term = error.term(signals, amplitudes, [])
    lines = np.abs(np.fft.rfft(term.deflection)) / 2048
    assert np.flatnonzero(lines > 1e-9).tolist() == [1, 2]
    assert error.values(amplitudes, [], signals.constants) == pytest.approx(
        {"A1": lines[1], "A2": lines[2], "A4": 0.0}
    )
    # Virtual work: what the drive gives less is the slope of the error.
    np.testing.assert_allclose(
        term.drive_torque[1:-1], -np.gradient(term.deflection, turn)[1:-1], atol=1e-4
    )
    ripple = effect("torque_ripple").term(signals, [0.5, 0.0, 0.0, 0.2], []).drive_torque
    lines = np.abs(np.fft.rfft(ripple)) / 2048
    assert np.flatnonzero(lines > 1e-9).tolist() == [4, 24]


def test_wrist_coupling_does_no_work():
    signals = ROBOT.of_joint(4)
    term = effect("wrist_coupling").term(signals, [0.02], [])
    before = ROBOT.motor_velocity[:, 3]
    # The link turns by -c of the joint before, so the spring's work is what that joint gives.
    given = term.previous_torque * before
    taken = signals.spring_torque * (-0.02 * before)
    np.testing.assert_allclose(given, taken, rtol=1e-12)


def test_saturation_holds_the_torque_at_its_limit():
    asked = np.linspace(-120.0, 120.0, 60)
    signals = replace(ROBOT.of_joint(4), drive_torque=asked)
    entry = effect("saturation")
    real = asked + entry.term(signals, [1.0], [0.5]).drive_torque
    np.testing.assert_allclose(real, np.clip(asked, -60.0, 60.0), atol=1.0)
    assert np.abs(real).max() <= 60.0 + 1e-6
    assert entry.values([1.0], [0.5], signals.constants) == {"limit": 60.0}


def test_contact_pushes_the_tool_up_and_only_where_it_is_low():
    entry = effect("external_contact")
    torque = entry.term(ROBOT, [1e4], [0.35]).link_torque
    depth = np.maximum(0.35 - ROBOT.tool_position[:, 2], 0.0)
    high = ROBOT.tool_position[:, 2] > 0.37
    assert high.any()
    assert (~high).any()
    assert np.abs(torque[high]).max() < 1e4 * 2e-7
    # Power: the drives give what the force does not do by itself.
    given = np.sum(torque * ROBOT.link_velocity, axis=1)
    tool = np.einsum("kj,kj->k", ROBOT.tool_jacobian[:, 2], ROBOT.link_velocity)
    np.testing.assert_allclose(given, -1e4 * depth * tool, atol=1e4 * 1e-4 * np.abs(tool).max())


def test_payload_and_link_errors_sum_the_columns_of_their_bodies():
    for name, body in (("payload", 5), ("inertial_error", 2)):
        amplitudes = [0.7, 0.01, -0.02, 0.03]
        columns = ROBOT.body_regressor[:, :, 10 * body : 10 * body + 4]
        found = effect(name).term(ROBOT, amplitudes, []).link_torque
        np.testing.assert_allclose(found, columns @ np.array(amplitudes), rtol=1e-12, atol=1e-14)
    values = effect("payload").values([0.5, 0.01, 0.0, -0.02], [], ROBOT.constants)
    assert values == pytest.approx({"dm": 0.5, "cx": 0.02, "cy": 0.0, "cz": -0.04})
    link = effect("inertial_error").values([0.5, 0.03, 0.0, -0.04], [], ROBOT.constants)
    assert link["dmc"] == pytest.approx(0.05)


def test_readings_and_springs_have_their_signs():
    signals = ROBOT.of_joint(4)
    for name in ("encoder_offset", "encoder_zero_change"):
        np.testing.assert_allclose(effect(name).term(signals, [2e-4], []).deflection, -2e-4)
    shift = effect("encoder_skew").term(ROBOT, [2e-3], []).deflection
    np.testing.assert_allclose(shift, 2e-3 * ROBOT.motor_velocity)
    late = effect("time_delay").term(ROBOT, [1e-3], []).drive_torque
    np.testing.assert_allclose(late, -1e-3 * ROBOT.drive_torque_rate)
    spring = effect("gravity_spring")
    assert spring.values([5.0, 2.0], [], signals.constants) == {"k": 5.0, "offset": 0.4}
    torque = spring.term(signals, [5.0, 2.0], []).link_torque
    np.testing.assert_allclose(torque, 5.0 * (signals.link_position - 0.4), atol=1e-12)


def test_where_an_effect_cannot_be():
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
        "transmission_error",
        "torque_ripple",
        "wrist_coupling",
    }
    for entry in CATALOGUE:
        if entry.scope in ("joint", "run") and entry.name not in left_out:
            assert all(0.0 < a.size(rigid) < math.inf for a in entry.amplitudes), entry.name


def test_usual_places_of_springs_and_couplings():
    first, last = ROBOT.constants.joints[0], ROBOT.constants.joints[5]
    assert effect("cable_spring").log_prior(first) < effect("cable_spring").log_prior(last)
    assert effect("gravity_spring").log_prior(first) > effect("gravity_spring").log_prior(last)
    assert effect("wrist_coupling").log_prior(first) < effect("wrist_coupling").log_prior(last)


def test_confusion_groups_name_entries_of_the_catalogue():
    names = {e.name for e in CATALOGUE}
    assert all(group <= names for group in confusion_groups)
    assert all(len(group) > 1 for group in confusion_groups)


def test_an_unknown_effect_is_answered_with_the_nearest():
    with pytest.raises(InputError, match=r"'colomb'.*Did you mean 'coulomb'"):
        effect("colomb")


def test_symbolic_values_of_memory_effects():
    for name in MEMORY:
        entry, signals = effect(name), ROBOT.of_joint(4)
        amplitudes, shapes = list(sizes(entry, signals)), first_shapes(entry, signals)
        np.testing.assert_allclose(
            symbolic_values(entry, signals, amplitudes, shapes),
            stacked(entry.term(signals, amplitudes, shapes)),
            rtol=1e-12,
        )
