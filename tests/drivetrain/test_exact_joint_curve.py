"""The curve of a whole joint against the exact law, torque by torque."""

import numpy as np
import pytest

from stiffopt.connection import BoltedFlange, Reducer
from stiffopt.drivetrain import catalogue
from stiffopt.drivetrain.chain import Chain, Stage
from stiffopt.exact.chain import (
    breakpoints,
    compliance_along,
    exact_compliance,
    exact_windup,
    windup_along,
)
from stiffopt.robot.files import load_robot


@pytest.mark.parametrize("joint", [0, 2, 5])
@pytest.mark.parametrize("name", ["ur10", "er3a_c60"])
def test_curve_is_the_exact_law(name, joint):
    robot = load_robot(name)
    chain, most = robot.chains[joint], robot.torque_max[joint]
    random = np.random.default_rng(joint)
    corners = np.array(breakpoints(chain))
    torque = np.concatenate(
        [
            # Beyond the rated torque, over all magnitudes, at kinks, at zero.
            random.uniform(-2.5, 2.5, 300) * most,
            most * 10.0 ** random.uniform(-14.0, 0.0, 300),
            corners,
            -corners,
            [0.0],
        ]
    )
    np.testing.assert_allclose(windup_along(chain, torque), exact_windup(chain, torque), rtol=1e-9)
    np.testing.assert_allclose(
        compliance_along(chain, torque), exact_compliance(chain, torque), rtol=1e-8
    )


def test_slipping_windup_is_infinite():
    flange = BoltedFlange(
        name="flange",
        torque_max=50.0,
        surface=catalogue.surface("fine_steel"),
        inner_radius=0.02,
        outer_radius=0.03,
        circle_diameter=0.05,
        bolt_count=6,
        preload=500.0,
    )
    chain = Chain(
        (
            Stage(Reducer(name="gear", torque_max=50.0, K1=1e4, K2=2e4, K3=3e4, T1=5.0, T2=9.0)),
            Stage(flange),
        )
    )
    slip = chain.slip_torques()["flange"]
    torque = slip * np.array([-1.1, 0.5, 0.999, 1.001])
    for along, exact in ((windup_along, exact_windup), (compliance_along, exact_compliance)):
        found = along(chain, torque)
        assert list(np.isinf(found)) == [True, False, False, True]
        np.testing.assert_allclose(found[1:3], exact(chain, torque[1:3]), rtol=1e-8)
