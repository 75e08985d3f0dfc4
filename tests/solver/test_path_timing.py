"""Fastest timing of joint paths: against toppra and ruckig, and within every limit."""

from dataclasses import replace

import numpy as np
import pytest
from ruckig import InputParameter, Ruckig
from ruckig import Trajectory as RuckigTrajectory

from stiffopt.baseline.toppra_motion import toppra_baseline
from stiffopt.certificate.rigid_body import rigid_body_history
from stiffopt.errors import ProblemError
from stiffopt.path.path_timing import PathDemands, fastest_timing
from stiffopt.path.timed_path import timed_motion
from stiffopt.problem.limit import Limits
from stiffopt.problem.limits.joint_curve import curve_at
from stiffopt.problem.limits.travel import with_bounded_travel
from stiffopt.problem.objective import Objective
from stiffopt.problem.resolve import resolve
from stiffopt.problem.trajectory import Target, TrajectoryProblem
from stiffopt.result.joint_path import JointPath
from stiffopt.robot.files import load_robot

FREE = np.full(6, np.inf)
WAYPOINTS = np.array(
    [
        [0.3, -1.2, 1.4, -1.1, -1.5, 0.4],
        [0.8, -1.5, 1.9, -1.8, -1.1, 0.1],
        [1.5, -0.9, 1.2, -1.4, -1.3, 0.9],
        [1.1, -0.7, 1.6, -2.1, -1.9, 0.2],
    ]
)


def largest_shares(motion, limits):
    """Largest share of the limits of velocity, acceleration and jerk that a motion uses."""
    time = np.linspace(0.0, motion.duration, 5001)
    orders = ((1, limits.velocity), (2, limits.acceleration), (3, limits.jerk))
    return [float(np.max(np.abs(motion(time, k)) / limit)) for k, limit in orders]


def test_duration_is_that_of_toppra_where_only_its_limits_are_asked():
    arm = load_robot("ur10")
    own = Limits.of(arm)
    path = JointPath.through(WAYPOINTS)
    for limits in (
        Limits({**own.values, "jerk": FREE}),
        Limits({**own.values, "jerk": FREE, "acceleration": FREE, "tool_speed": 0.8}),
    ):
        reference = toppra_baseline(arm, limits, path, intervals=2000).fastest
        law = fastest_timing(arm, limits, path, PathDemands(eased=False))
        assert law.duration == pytest.approx(reference, rel=5e-3)


@pytest.mark.parametrize("seed", [1, 4])
def test_certified_duration_is_that_of_toppra_where_torque_and_tool_speed_limit(seed):
    """Torque and tool speed are kept between the stages too: nothing is backed off as a whole."""
    arm = load_robot("er3a_c60")
    limits = {"jerk": FREE, "acceleration": FREE, "tool_speed": 1.0}
    lower, upper = np.clip([arm.position_lower, arm.position_upper], -2.0, 2.0)
    waypoints = np.random.default_rng(seed).uniform(0.6 * lower, 0.6 * upper, (5, 6))
    problem = TrajectoryProblem(
        robot=arm,
        start=Target(joints=waypoints[0]),
        end=Target(joints=waypoints[-1]),
        duration=(0.01, np.inf),
        objectives=(Objective(name="duration"),),
        limits=Limits({**Limits.of(arm).values, **limits}),
        boundary_acceleration="free",
        path=waypoints,
    )
    reference = toppra_baseline(arm, problem.limits, problem.path, intervals=2000).fastest
    found = timed_motion(problem)
    assert found.assessment.feasible(5e-3)
    assert found.assessment.duration == pytest.approx(reference, rel=5e-3)


def test_duration_on_a_straight_path_is_that_of_an_s_curve():
    arm = load_robot("er3a_c60")
    own = Limits.of(arm)
    limits = Limits({**own.values, "torque": FREE})
    start, end = np.zeros(6), np.array([0.9, 0.2, -0.1, 0.3, 0.1, 0.0])
    asked = InputParameter(1)
    asked.current_position, asked.target_position = [0.0], [1.0]
    share = np.abs(end - start) + 1e-12
    for name in ("velocity", "acceleration", "jerk"):
        setattr(asked, f"max_{name}", [float(np.min(getattr(limits, name) / share))])
    reference = RuckigTrajectory(1)
    Ruckig(1).calculate(asked, reference)
    law = fastest_timing(arm, limits, JointPath.through([start, end]))
    assert law.duration == pytest.approx(reference.duration, rel=5e-3)


def test_every_limit_is_used_and_none_exceeded_on_a_curved_path():
    arm = load_robot("ur10")
    limits = Limits.of(arm)
    path = JointPath.through(WAYPOINTS)
    motion = path.follow(fastest_timing(arm, limits, path))
    shares = largest_shares(motion, limits)
    assert max(shares) <= 1.005
    assert shares[1] > 0.99
    np.testing.assert_allclose(motion(np.array([0.0, motion.duration]), 2), 0.0, atol=1e-6)


def test_speed_of_the_path_and_of_the_tool_are_kept_where_asked():
    arm = load_robot("ur10")
    path = JointPath.through(WAYPOINTS)
    path = replace(path, speeds=np.array([0.3, 0.6, 0.6]))
    law = fastest_timing(arm, Limits.of(arm), path)
    motion, time = path.follow(law), np.linspace(0.0, law.duration, 2001)
    bodies = arm.rigid_bodies()
    speed = [
        np.linalg.norm(bodies.jacobian(arm.tool, q)[:3] @ v)
        for q, v in zip(motion(time), motion(time, 1), strict=True)
    ]
    slow_part = law(time)[:, 0] < path.knots[1]
    assert max(np.array(speed)[slow_part]) <= 0.3 * 1.005
    assert max(speed) == pytest.approx(0.6, rel=1e-2)


def test_path_on_which_a_drive_cannot_hold_the_arm_is_refused_with_its_joint_and_torque():
    arm = load_robot("ur10")
    path = JointPath.through(WAYPOINTS)
    weight = [arm.rigid_bodies().gravity_torque(q) for q in path(np.linspace(0.0, 1.0, 2001))]
    need = np.max(np.abs(weight), axis=0)[1] + arm.coulomb[1]
    own = Limits.of(arm)
    for share in (0.95, 1.05):
        torque = np.where(np.arange(6) == 1, share * need, own.torque)
        limits = Limits({**own.values, "torque": torque})
        if share > 1.0:
            assert fastest_timing(arm, limits, path).duration > 0.0
            continue
        with pytest.raises(ProblemError, match=r"N m at joint 2, above its torque limit"):
            fastest_timing(arm, limits, path)


def test_torque_of_the_drives_falls_with_their_speed():
    arm = load_robot("ur10")
    own, path = Limits.of(arm), JointPath.through(WAYPOINTS)
    speeds = np.stack([np.zeros(6), own.velocity])
    torques = np.stack([own.torque, 0.45 * own.torque])
    free = {**own.values, "jerk": FREE, "acceleration": FREE}
    limits = Limits({**free, "torque_map": (speeds, torques)})
    law = fastest_timing(arm, limits, path, PathDemands(eased=False))
    motion, time = path.follow(law), np.linspace(0.0, law.duration, 4001)
    torque = rigid_body_history(arm, *(motion(time, k) for k in range(3))).link_torque
    torque = torque + arm.rotor_inertia * motion(time, 2)
    used = np.abs(torque) / curve_at((speeds, torques), np.abs(motion(time, 1)))
    assert 0.97 < used.max() < 1.005
    plain = fastest_timing(arm, Limits(free), path, PathDemands(eased=False))
    assert law.duration > plain.duration


def test_a_closed_path_is_timed_though_its_ends_are_one_place():
    arm = load_robot("ur10")
    closed = np.concatenate([WAYPOINTS, WAYPOINTS[:1]])
    problem = TrajectoryProblem(
        robot=arm,
        start=Target(joints=closed[0]),
        end=Target(joints=closed[-1]),
        duration=(0.01, np.inf),
        objectives=(Objective(name="duration"),),
        path=closed,
    )
    assert with_bounded_travel(problem, resolve(problem)) is problem
    assert timed_motion(problem).feasible
