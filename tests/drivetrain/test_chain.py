"""Composition rules of drivetrains, and their derivatives."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stiffopt.connection import BoltedFlange, Constant, Key, Reducer
from stiffopt.drivetrain import catalogue
from stiffopt.drivetrain.chain import Chain, Stage
from stiffopt.errors import InputError
from stiffopt.exact.chain import (
    breakpoints,
    compliance_shares,
    exact_compliance,
    exact_windup,
    windup_shares,
)
from stiffopt.robot.files import load_robot


def spring(name: str, stiffness: float) -> Constant:
    return Constant(name=name, torque_max=10.0, stiffness=stiffness)


def reducer(name: str = "reducer") -> Reducer:
    data = catalogue.reducer("harmonic_17_100")
    return Reducer(
        name=name,
        torque_max=38.0,
        K1=data.K1,
        K2=data.K2,
        K3=data.K3,
        T1=data.T1,
        T2=data.T2,
    )


def key(name: str = "key", length: float = 20e-3) -> Key:
    return Key(
        name=name,
        torque_max=38.0,
        shaft_diameter=25e-3,
        length=length,
        shaft_flank_height=4e-3,
        hub_flank_height=3.3e-3,
        surface=catalogue.surface("rough_steel"),
        prepressure=0.1e6,
    )


def flange(name: str = "flange") -> BoltedFlange:
    data = catalogue.flange("flexspline_17")
    return BoltedFlange(
        name=name,
        torque_max=38.0,
        bolt_count=data.count,
        circle_diameter=data.circle_diameter,
        inner_radius=data.inner_radius,
        outer_radius=data.outer_radius,
        preload=data.preload,
        surface=catalogue.surface("fine_steel"),
    )


MIXED = Chain(
    (
        Stage(key("motor_key"), ratio=50.0),
        Stage(reducer()),
        Stage(key("left"), group="output"),
        Stage(flange("right"), group="output"),
    )
)


@given(st.integers(1, 8), st.floats(1e2, 1e6), st.floats(-50, 50))
@settings(max_examples=40, deadline=None)
def test_series_of_equal_springs(count, stiffness, torque):
    chain = Chain(tuple(Stage(spring(f"s{k}", stiffness)) for k in range(count)))
    assert chain.windup(torque) == pytest.approx(count * torque / stiffness, rel=1e-12)
    assert chain.tangent_stiffness(torque) == pytest.approx(stiffness / count, rel=1e-12)
    assert chain.secant_stiffness(torque) == pytest.approx(stiffness / count, rel=1e-12)


@given(st.floats(0.1, 500.0), st.floats(0.3, 1.0), st.floats(0.1, 50))
@settings(max_examples=40, deadline=None)
def test_ratio_round_trip(ratio, efficiency, torque):
    chain = Chain((Stage(spring("s", 1e4), ratio, efficiency),))
    # The element carries T/(i eta); its wind-up counts 1/i.
    assert chain.windup(torque) == pytest.approx(torque / (ratio**2 * efficiency * 1e4), rel=1e-12)
    back = Chain((Stage(spring("s", 1e4 * ratio**2 * efficiency)),))
    assert chain.tangent_compliance(torque) == pytest.approx(
        back.tangent_compliance(torque), rel=1e-12
    )


@given(st.lists(st.floats(1e3, 1e6), min_size=2, max_size=4), st.floats(-20, 20))
@settings(max_examples=40, deadline=None)
def test_parallel_springs_add_their_stiffness(stiffnesses, torque):
    chain = Chain(tuple(Stage(spring(f"s{k}", v), group="g") for k, v in enumerate(stiffnesses)))
    assert chain.tangent_stiffness(torque) == pytest.approx(sum(stiffnesses), rel=1e-12)
    assert chain.tangent_stiffness(torque) > max(stiffnesses)
    assert chain.windup(torque) == pytest.approx(torque / sum(stiffnesses), rel=1e-12)


@pytest.mark.parametrize("torque", [0.01, 0.3, 2.0, 11.0, 35.0])
def test_parallel_contacts_wind_up_alike(torque):
    group = Chain(MIXED.stages[2:])
    windup = float(group.windup(torque))
    parts = [Chain((s,)) for s in MIXED.stages[2:]]
    # Torques that give that wind-up, found independently, must add to the whole.
    carried = sum(_torque_for(part.windup, windup, torque) for part in parts)
    assert carried == pytest.approx(torque, rel=1e-9)
    assert group.tangent_stiffness(torque) > 0
    stiffest = max(float(part.secant_stiffness(torque)) for part in parts)
    assert group.secant_stiffness(torque) > stiffest


def _torque_for(law, windup, upper):
    low, high = 0.0, upper
    for _ in range(100):
        middle = (low + high) / 2
        low, high = (middle, high) if law(middle) < windup else (low, middle)
    return (low + high) / 2


def test_exact_parallel_split_agrees_with_the_smooth_one():
    torque = np.array([-30.0, 0.0, 1.0, 10.0, 35.0])
    group = Chain(MIXED.stages[2:])
    exact, smooth = exact_windup(group, torque), group.windup(torque)
    # The fit of the contact law is within 1.5 % of the exact one.
    np.testing.assert_allclose(exact, smooth, rtol=0.015, atol=1e-12)
    rate = exact_compliance(group, torque)
    np.testing.assert_allclose(rate, group.tangent_compliance(torque), rtol=0.02)


def test_windup_is_the_sum_of_its_elements():
    chain = load_robot("er3a_c60").chains[2]
    torque = np.linspace(-38, 38, 9)
    parts = sum(s.element.windup(torque / s.ratio) / s.ratio for s in chain.stages)
    np.testing.assert_allclose(chain.windup(torque), parts, rtol=1e-13)
    shares = windup_shares(chain, 20.0)
    assert sum(shares.values()) == pytest.approx(1.0, abs=1e-12)
    assert set(shares) == set(chain.elements)
    assert sum(compliance_shares(MIXED, 5.0).values()) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("chain", [MIXED, load_robot("er3a_c60_contact").chains[2]])
def test_derivatives(chain):
    torque = np.array([-30.0, -2.0, -0.01, 0.0, 0.05, 1.0, 3.9, 20.0])
    step = 1e-5 * np.maximum(1.0, np.abs(torque))
    for smoothing in (1.0, 4.0):
        difference = chain.windup(torque + step, smoothing=smoothing)
        difference = (difference - chain.windup(torque - step, smoothing=smoothing)) / (2 * step)
        rate = chain.tangent_compliance(torque, smoothing=smoothing)
        np.testing.assert_allclose(rate, difference, rtol=1e-6)
    for kind in (ca.SX, ca.MX):
        t, s = kind.sym("t"), kind.sym("s")
        windup = chain.windup(t, smoothing=s)
        function = ca.Function("f", [t, s], [windup, ca.gradient(windup, t)])
        values = np.array([[float(v) for v in function(x, 1.0)] for x in torque])
        np.testing.assert_allclose(values[:, 0], chain.windup(torque), rtol=1e-12, atol=1e-16)
        np.testing.assert_allclose(values[:, 1], chain.tangent_compliance(torque), rtol=1e-9)


def test_derivative_with_respect_to_a_preload():
    preload = ca.SX.sym("F")
    windup = MIXED.windup(20.0, preloads={"right": preload})
    slope = ca.Function("f", [preload], [ca.gradient(windup, preload)])
    step = 1.0
    difference = MIXED.windup(20.0, preloads={"right": 4800.0 + step})
    difference = (difference - MIXED.windup(20.0, preloads={"right": 4800.0 - step})) / (2 * step)
    assert float(slope(4800.0)) == pytest.approx(difference, rel=1e-6)
    assert float(slope(4800.0)) < 0


def test_exact_windup_is_the_integral_of_the_exact_compliance():
    chain = load_robot("er3a_c60_contact").chains[5]
    upper = 12.5
    # Independent: composite Gauss-Legendre on 4000 geometric panels with the kinks as nodes.
    edges = np.concatenate(([0.0], np.geomspace(1e-10, upper, 4000), breakpoints(chain)))
    edges = np.unique(edges)
    points, weights = np.polynomial.legendre.leggauss(5)
    half, middle = np.diff(edges) / 2, (edges[1:] + edges[:-1]) / 2
    nodes = middle[:, None] + half[:, None] * points
    values = exact_compliance(chain, nodes.ravel()).reshape(nodes.shape)
    expected = float(np.sum(values * weights * half[:, None]))
    assert float(exact_windup(chain, np.array([upper]))[0]) == pytest.approx(expected, rel=1e-9)
    odd = exact_windup(chain, np.array([-3.0, 3.0]))
    assert odd[0] == -odd[1]


def test_without_prepressure_the_exact_windup_is_infinite():
    loose = Key(
        name="loose",
        torque_max=1.0,
        shaft_diameter=25e-3,
        length=20e-3,
        shaft_flank_height=4e-3,
        hub_flank_height=3.3e-3,
        surface=catalogue.surface("rough_steel"),
        prepressure=0.0,
    )
    assert np.isinf(exact_windup(Chain((Stage(loose),)), np.array([1.0])))[0]


def test_a_flange_stays_finite_up_to_its_slip_torque():
    chain = Chain((Stage(flange()),))
    slip = chain.slip_torques()["flange"]
    below, above = (
        exact_windup(chain, np.array([0.999 * slip])),
        exact_windup(chain, np.array([1.1 * slip])),
    )
    assert np.isfinite(below[0])
    assert np.isinf(above[0])
    assert below[0] == pytest.approx(float(exact_windup(chain, np.array([0.999 * slip]))[0]))


def test_empty_chain_is_rigid():
    assert Chain(()).windup(3.0) == 0.0
    assert exact_windup(Chain(()), np.array([3.0]))[0] == 0.0


def test_reducer_only_keeps_reducers():
    assert list(MIXED.reducer_only().elements) == ["reducer"]
    assert breakpoints(MIXED.reducer_only()) == (3.9, 12.0)


def test_messages_of_wrong_chains():
    with pytest.raises(InputError, match="used twice: s"):
        Chain((Stage(spring("s", 1.0)), Stage(spring("s", 2.0))))
    with pytest.raises(InputError, match=r"'s': ratio = -1 .* allowed is a finite number above 0"):
        Stage(spring("s", 1.0), ratio=-1.0)
    with pytest.raises(InputError, match=r"efficiency = 1\.5 .* above 0 and at most 1"):
        Stage(spring("s", 1.0), efficiency=1.5)
    with pytest.raises(InputError, match="Did you mean 'right'"):
        MIXED.windup(1.0, preloads={"rigth": 1.0})
