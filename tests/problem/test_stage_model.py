"""Smooth stage model against the certificate and pinocchio."""

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from small_arms import load

from stiffopt import load_robot
from stiffopt.certificate.assess import joint_compliance, joint_windup
from stiffopt.certificate.rigid_body import rigid_body_history
from stiffopt.exact.chain import breakpoints
from stiffopt.problem.stage_model import StageModel

FORCE = np.array([20.0, -10.0, -50.0])
FINEST = 0.05


@pytest.fixture(scope="module")
def er3a():
    """Torques, wind-ups, compliances and deflections as one function of q, v, a."""
    robot = load_robot("er3a_c60").with_payload(1.0, (0.0, 0.0, 0.05))
    n = robot.n
    q, v, a = (ca.SX.sym(name, n) for name in "qva")
    model = StageModel(robot, q, v, a, FORCE, FINEST, np.zeros(n))
    outputs = [
        model.torques.spring,
        model.drive_torque,
        model.windup(model.torques.spring),
        ca.vertcat(*(model.compliance(j) for j in range(1, n + 1))),
        ca.horzcat(*(getattr(model.deflection, p) for p in ("static", "dynamic", "process"))),
        model.tool_velocity,
    ]
    return robot, ca.Function("stage", [q, v, a], outputs)


def states(robot, count=12):
    rng = np.random.default_rng(4)
    for _ in range(count):
        q = rng.uniform(robot.position_lower, robot.position_upper)
        yield q, rng.uniform(-1, 1, robot.n), rng.uniform(-3, 3, robot.n)


def test_torques_are_those_of_pinocchio(er3a):
    robot, stage = er3a
    for q, v, a in states(robot):
        spring, drive, *_, tool = (np.asarray(x.full()) for x in stage(q, v, a))
        body = rigid_body_history(robot, q[None], v[None], a[None])
        wanted = body.link_torque[0] - body.jacobian[0].T @ FORCE
        assert spring[:, 0] == pytest.approx(wanted, abs=1e-10 * np.max(np.abs(wanted)))
        assert tool[:, 0] == pytest.approx(body.jacobian[0] @ v, abs=1e-12)
        friction = robot.coulomb * np.tanh(1e9 * v) + robot.viscous * v
        exact = wanted + robot.rotor_inertia * a + friction
        # Dry friction is smoothed about standstill only.
        moving = np.abs(v) > 0.1 * np.min(robot.velocity_max)
        assert drive[moving, 0] == pytest.approx(exact[moving], rel=1e-2, abs=1e-2)


def test_windup_and_deflection_within_a_percent_of_the_exact_law(er3a):
    robot, stage = er3a
    for q, v, a in states(robot):
        spring, _, windup, _, deflection, _ = (np.asarray(x.full()) for x in stage(q, v, a))
        exact = joint_windup(robot, spring.T)[0]
        assert windup[:, 0] == pytest.approx(exact, rel=1e-2, abs=1e-2 * np.max(np.abs(exact)))
        body = rigid_body_history(robot, q[None], v[None], a[None])
        static = joint_windup(robot, body.gravity_torque)
        links = joint_windup(robot, body.link_torque)
        parts = np.stack([static[0], (links - static)[0], exact - links[0]], axis=1)
        wanted = -body.jacobian[0] @ parts
        assert deflection == pytest.approx(wanted, abs=1e-2 * np.max(np.abs(wanted)))


def test_compliance_within_a_percent_away_from_jumps(er3a):
    robot, stage = er3a
    for q, v, a in states(robot):
        spring, _, _, compliance, _, _ = (np.asarray(x.full()) for x in stage(q, v, a))
        exact = joint_compliance(robot, spring.T)[0]
        for j, chain in enumerate(robot.chains):
            size = abs(float(spring[j, 0]))
            away = [abs(size - t) > 0.1 * t for t in breakpoints(chain)]
            if all(away) and size > 0.01 * robot.torque_max[j] and size < robot.torque_max[j]:
                assert compliance[j, 0] == pytest.approx(exact[j], rel=1e-2)


def test_stiffness_of_a_robot_without_drivetrain_is_refused(tmp_path):
    from small_arms import joint, write_problem, write_robot

    from stiffopt import solve
    from stiffopt.errors import ProblemError
    from stiffopt.problem.files import load_problem

    for goal in ("dynamic_deflection", "mean_compliance"):
        path = write_problem(tmp_path, minimise=f'objective = "{goal}"')
        write_robot(tmp_path, joints=[joint("shoulder", ""), joint("elbow", "")])
        with pytest.raises(ProblemError, match="no drivetrain"):
            solve(load_problem(path).problem)


def test_tool_jacobian_of_an_arm_with_a_slide(tmp_path):
    """As pinocchio has it."""
    robot = load(tmp_path, "slide").robot
    q, v, a = (ca.SX.sym(name, robot.n) for name in "qva")
    model = StageModel(robot, q, v, a, np.zeros(3), 1.0, np.zeros(robot.n))
    symbolic = ca.Function("jacobian", [q], [model.jacobian])
    data = robot.model.createData()
    for at in ([0.1, 0.4], [-0.5, -1.2]):
        frame = robot.model.getFrameId("tip")
        axes = pin.LOCAL_WORLD_ALIGNED
        whole = pin.computeFrameJacobian(robot.model, data, np.array(at), frame, axes)
        assert symbolic(at).full() == pytest.approx(whole[:3], abs=1e-14)


def test_convexity_changes_second_derivatives_of_the_friction_charge_alone():
    robot = load_robot("er3a_c60")
    n = robot.n
    q, v, a = (ca.SX.sym(name, n) for name in "qva")
    charges = []
    for convexity in (0.0, 1.0):
        model = StageModel(robot, q, v, a, np.zeros(3), 1.0, np.zeros(n), (1.0, 0.0, convexity))
        curvature, slope = ca.hessian(ca.sum1(model.squared_drive_torque), v)
        given = ca.sum1(model.squared_drive_torque), slope, curvature
        charges.append(ca.Function("charge", [q, v, a], given))
    most = 0.0
    width = 0.01 * robot.velocity_max
    for position, speed, acceleration in states(robot):
        point = position, speed * width, acceleration
        (value, slope, curvature), (same, same_slope, convex) = (
            [np.asarray(each) for each in charge(*point)] for charge in charges
        )
        assert same == pytest.approx(value, rel=1e-12)
        assert same_slope == pytest.approx(slope, rel=1e-9, abs=1e-9)
        added = convex - curvature
        assert np.linalg.eigvalsh(added).min() >= -1e-6 * np.abs(curvature).max()
        most = max(most, np.abs(added).max() / np.abs(curvature).max())
    assert most > 0.1
