"""Nominal wind-up of a joint from its drivetrain."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from stiffopt.discovery.signals import JointConstants
from stiffopt.drivetrain.chain import Chain
from stiffopt.exact.chain import exact_compliance, exact_windup
from stiffopt.recording.nominal_files import build_joint_chain
from stiffopt.robot.files import load_robot

CURVE = (1.6e4, 2.5e4, 2.9e4, 7.0, 25.0)
TORQUE = np.array([-60.0, -25.5, -10.0, -3.0, 0.0, 1e-3, 5.0, 7.1, 24.0, 80.0])


def constants(chain: Chain | None) -> JointConstants:
    return JointConstants(
        joint=1,
        ratio=100.0,
        coulomb=1.0,
        viscous=1.0,
        torque_rated=30.0,
        torque_max=90.0,
        rotor_inertia=0.1,
        chain=chain,
    )


@pytest.mark.parametrize("contacts", [6.5e4, np.inf])
@pytest.mark.parametrize("curve", [CURVE, None])
def test_windup_of_reducer_and_spring_is_exact(
    curve: tuple[float, ...] | None, contacts: float
) -> None:
    chain = build_joint_chain(curve, contacts, 90.0)
    own = constants(chain)
    if chain is None:
        assert not own.elastic
        assert np.all(own.windup(TORQUE) == 0.0)
        return
    assert own.contact_stiffness == pytest.approx(contacts, rel=1e-12)
    np.testing.assert_allclose(own.windup(TORQUE), exact_windup(chain, TORQUE), rtol=1e-12)
    np.testing.assert_allclose(own.compliance(TORQUE), exact_compliance(chain, TORQUE), rtol=1e-12)


def test_windup_with_symbols_matches_arrays() -> None:
    own = constants(build_joint_chain(CURVE, 6.5e4, 90.0))
    torque = ca.SX.sym("torque")
    function = ca.Function("windup", [torque], [own.windup(torque), own.compliance(torque)])
    for value in TORQUE:
        angle, slope = (float(x) for x in function(value))
        assert angle == pytest.approx(float(own.windup(value)), rel=1e-12)
        assert slope == pytest.approx(float(own.compliance(value)), rel=1e-12)


def test_windup_with_contacts_adds_reducer_and_smooth_law() -> None:
    robot = load_robot("er3a_c60_contact")
    chain = robot.chains[1]
    assert chain is not None
    own = constants(chain)
    (stage,) = (s for s in chain.stages if s.element.kind == "reducer")
    assert own.slopes == pytest.approx([stage.element.K1, stage.element.K2, stage.element.K3])
    torque = np.linspace(-0.8, 0.8, 41) * robot.torque_max[1]
    # 2.1 % is the error of a smoothed reducer; the smooth law of contacts is far closer.
    np.testing.assert_allclose(own.windup(torque), exact_windup(chain, torque), rtol=5e-3)
    assert 0.0 < own.contact_stiffness < np.inf
