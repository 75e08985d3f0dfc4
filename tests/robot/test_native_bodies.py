"""Compiled inverse dynamics against pinocchio's."""

import numpy as np
import pytest
from small_arms import write_robot

from stiffopt import native
from stiffopt.robot import rigid_body
from stiffopt.robot.body_tree import body_tree
from stiffopt.robot.files import load_robot
from stiffopt.robot.rigid_body import NativeBodies, inverse_dynamics_along, without_rotors

pytestmark = pytest.mark.skipif(native.library() is None, reason="needs the compiled core")


@pytest.mark.parametrize("name", ["er3a_c60", "ur10", "planar", "slide", "spatial"])
@pytest.mark.parametrize("count", [16, 403])
def test_compiled_torques_equal_pinocchio(tmp_path, name, count):
    robot = load_robot(name if name in ("er3a_c60", "ur10") else write_robot(tmp_path, name))
    model = without_rotors(robot.model)
    random = np.random.default_rng(count)
    q, v, a = (size * random.normal(size=(count, robot.n)) for size in (3.0, 2.0, 30.0))
    # Far angles, and what is no number at all.
    q[3, 0], q[5, -1] = -3e6, 2e4
    expected = inverse_dynamics_along(model, q, v, a)
    found = NativeBodies(body_tree(model)).torque(q, v, a)
    assert found is not None
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12 * np.max(np.abs(expected)))
    v[7, 0] = np.nan
    found = NativeBodies(body_tree(model)).torque(q, v, a)
    assert found is not None
    assert not np.isfinite(found[7]).all()
    assert np.isfinite(np.delete(found, 7, axis=0)).all()


def test_torque_change_equals_difference_of_models(monkeypatch):
    robot = load_robot("ur10")
    random = np.random.default_rng(1)
    change = random.normal(size=(robot.n, 10))
    q, v, a = random.normal(size=(3, 60, robot.n))
    bodies = robot.bodies_in_motion()
    quick = bodies.changed_torque(change, q, v, a)
    monkeypatch.setattr(rigid_body, "MIN_INSTANTS", 61)
    np.testing.assert_allclose(quick, bodies.changed_torque(change, q, v, a), rtol=0.0, atol=1e-10)
