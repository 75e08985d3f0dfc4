"""Worth of a preload and shares of the wind-up, against differences and quadrature."""

import numpy as np
import pytest
from preload_studies import case, er3a, study, with_elements

from stiffopt.exact.chain import compliance_shares, windup_shares
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.sensitivity import (
    compliance_slopes,
    largest_torque,
    sensitivity,
)

LOADS = (case("lift", j2=55.0, j3=-14.0), case("rest"), case("back", j2=-20.0, j3=6.0))


def designed(**fields):
    model = PreloadModel(study(*LOADS, **{"joints": (2, 3), **fields}))
    return model, 0.8 * model.spread([e.capacity for e in model.elements])


def test_slope_is_the_difference_of_the_exact_law():
    model, preloads = designed()
    worth = {(w.key, w.case): w for w in sensitivity(model, preloads).worth}
    assert len(worth) == 5 * 3
    joints = list(model.problem.joints)
    for index, element in enumerate(model.elements):
        step = 1e-3 * preloads * (np.arange(model.size) == index)
        ahead, behind = (model.exact_stiffness(preloads + s) for s in (step, -step))
        slopes = (ahead - behind)[joints.index(element.joint)] / (2 * step[index])
        middle = model.exact_stiffness(preloads)[joints.index(element.joint)]
        for slope, stiffness, load in zip(slopes, middle, LOADS, strict=True):
            found = worth[element.key, load.name]
            assert found.stiffness == stiffness
            assert found.slope == pytest.approx(slope, rel=0.03)
            assert found.elasticity == pytest.approx(slope * preloads[index] / stiffness, rel=0.03)
            assert found.joint == element.joint


def test_gain_is_share_of_the_compliance_times_the_exponent_of_the_contact():
    # Unloaded, K_bolt ~ F_min^m; F_min = F/alpha - loss grows faster than F in per cent.
    model, preloads = designed(joints=(2,))
    result = sensitivity(model, preloads)
    shares = {s.element: s.compliance_share for s in result.shares if s.case == "rest"}
    for index, element in enumerate(model.elements):
        worth = next(w for w in result.worth if w.key == element.key and w.case == "rest")
        least = element.least(preloads[index])
        leverage = preloads[index] / 1.6 / least
        exponent = worth.elasticity / (shares[element.name] * leverage)
        assert 0.8 < exponent < 0.95


def test_slope_does_not_depend_on_other_joints():
    model, preloads = designed()
    slopes = compliance_slopes(model, preloads)
    assert slopes.shape == (2, 3, 5)
    for row, joint in enumerate((2, 3)):
        own = [e.joint == joint for e in model.elements]
        assert (slopes[row][:, own] < 0.0).all()
        assert (slopes[row][:, np.logical_not(own)] == 0.0).all()


def test_shares_are_those_of_the_chain_as_tightened():
    model, preloads = designed()
    result = sensitivity(model, preloads)
    for joint in (2, 3):
        chain = (
            er3a()
            .chains[joint - 1]
            .with_preloads(
                {
                    e.name: float(e.least(preloads[i]))
                    for i, e in enumerate(model.elements)
                    if e.joint == joint
                }
            )
        )
        for load in LOADS:
            torque = float(load.torque[joint - 1])
            own = [s for s in result.shares if s.joint == joint and s.case == load.name]
            assert [s.element for s in own] == list(chain.elements)
            assert [s.kind for s in own] == [e.kind for e in chain.elements.values()]
            by_angle, by_slope = windup_shares(chain, torque), compliance_shares(chain, torque)
            for s in own:
                assert s.share == pytest.approx(by_angle[s.element], rel=1e-9)
                assert s.compliance_share == pytest.approx(by_slope[s.element], rel=1e-9)
            assert sum(s.share for s in own) == pytest.approx(1.0, abs=1e-12)


def test_weakest_spring_is_the_reducer_until_another_is_weaker():
    model, preloads = designed()
    assert sensitivity(model, preloads).weakest == {2: "reducer", 3: "reducer"}
    stiff = dict.fromkeys(("K1", "K2", "K3"), 1e8)
    model = PreloadModel(study(*LOADS, robot=with_elements(2, reducer=stiff)))
    result = sensitivity(model, model.design)
    shares = {s.element: s.share for s in result.shares if s.case == "lift"}
    assert result.weakest == {2: max(shares, key=shares.get)} == {2: "flexspline_flange"}


def test_individual_bolts_count_together():
    loads = (case("turn", j6=6.0),)
    one = PreloadModel(study(*loads, joints=(6,)))
    each = PreloadModel(study(*loads, joints=(6,), individual=True))
    forces = [0.9 * e.capacity for e in one.elements]
    whole, parts = (sensitivity(m, m.spread(forces)) for m in (one, each))
    assert [w.key for w in parts.worth] == [w.key for w in whole.worth]
    for a, b in zip(whole.worth, parts.worth, strict=True):
        assert b.slope == pytest.approx(a.slope, rel=1e-4)
        assert b.elasticity == pytest.approx(a.elasticity, rel=1e-4)
    for a, b in zip(whole.shares, parts.shares, strict=True):
        assert (b.element, b.kind) == (a.element, a.kind)
        assert b.share == pytest.approx(a.share, rel=1e-6)
        assert b.compliance_share == pytest.approx(a.compliance_share, rel=1e-6)
    assert parts.weakest == whole.weakest


def test_slipping_element_has_full_share_and_zero_slope():
    model = PreloadModel(study(case("over", j2=150.0)))
    preloads = np.array([4000.0, 6000.0])
    result = sensitivity(model, preloads)
    assert model.slip_torque(preloads, 1) < 150.0 < model.slip_torque(preloads, 0)
    by_name = {s.element: s for s in result.shares}
    assert by_name["flexspline_flange"].share == 1.0
    assert by_name["flexspline_flange"].compliance_share == 1.0
    assert by_name["reducer"].share == 0.0
    assert result.weakest == {2: "flexspline_flange"}
    assert all(w.slope == w.elasticity == w.stiffness == 0.0 for w in result.worth)


def test_slipping_element_has_the_full_compliance():
    chain = with_elements(2).chains[1]
    torque = 1.01 * min(chain.slip_torques().values())
    slips = min(chain.slip_torques(), key=chain.slip_torques().get)
    for shares in (compliance_shares(chain, torque), windup_shares(chain, -torque)):
        assert shares == {name: float(name == slips) for name in chain.elements}


def test_largest_torque_counts_either_sign():
    model = PreloadModel(study(case("up", j2=30.0), case("down", j2=-40.0)))
    assert largest_torque(model, 2).name == "down"
