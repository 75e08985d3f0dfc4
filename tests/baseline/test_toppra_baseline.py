from __future__ import annotations

import json
import logging
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from stiffopt.baseline.toppra_motion import toppra_baseline
from stiffopt.problem.limit import Limits
from stiffopt.result.joint_path import JointPath
from stiffopt.result.trajectory import Trajectory
from stiffopt.robot.frames import LinkFrame
from stiffopt.robot.rigid_body import RigidBodies

BENCHMARKS = Path(__file__).resolve().parents[3] / "shared" / "benchmarks"


def robot(model: pin.Model, coulomb: float = 0, viscous: float = 0, rotor: float = 0) -> Any:
    n = model.nv
    return SimpleNamespace(
        model=model,
        rotor_inertia=np.full(n, float(rotor)),
        coulomb=np.full(n, float(coulomb)),
        viscous=np.full(n, float(viscous)),
        tool=LinkFrame(n, np.array([0.0, 0.0922, 0.0]), np.eye(3)),
        n=n,
        added_torques=(),
        rigid_bodies=lambda: RigidBodies(model),
    )


def limits(n: int, **given: Any) -> Limits:
    names = ("position_upper", "velocity", "acceleration", "jerk", "torque")
    free = {name: np.full(n, np.inf) for name in names}
    return Limits(**{**free, "position_lower": np.full(n, -np.inf), **given})


def slider(mass: float = 2.0) -> pin.Model:
    """A mass on a horizontal slide."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    body = pin.Inertia(mass, np.zeros(3), np.eye(3))
    model.appendBodyToJoint(joint, body, pin.SE3.Identity())
    return model


def ur10() -> tuple[pin.Model, dict[str, Any], Limits]:
    file = BENCHMARKS / "ur10.json"
    if not file.exists():
        pytest.skip(f"{file} is not beside this repository")
    data = json.loads(file.read_text())
    model = pin.buildModelFromUrdf(str(BENCHMARKS / data["urdf"]))
    velocity, torque = np.array(data["velocity_max"]), np.array(data["torque_max"])
    return model, data, limits(6, velocity=velocity, torque=torque)


def drive_torque(arm: Any, motion: Trajectory, t: np.ndarray) -> np.ndarray:
    q, v, a = (motion(t, order) for order in range(3))
    data = arm.model.createData()
    links = [pin.rnea(arm.model, data, *state).copy() for state in zip(q, v, a, strict=True)]
    # Rounding leaves speeds of 1e-15 at rest, which have no direction.
    direction = np.where(np.abs(v) > 1e-9, np.sign(v), 0.0)
    friction = arm.coulomb * direction + arm.viscous * v
    return np.array(links) + arm.rotor_inertia * a + friction


def test_force_limited_slide_takes_the_bang_bang_time() -> None:
    # Mass and rotor make 2.5 kg; friction of 1 N takes from the push and adds to the brake.
    arm = robot(slider(2.0), coulomb=1.0, rotor=0.5)
    baseline = toppra_baseline(
        arm, limits(1, torque=np.array([11.0])), JointPath.through([[0.0], [1.0]])
    )
    push, brake = 10.0 / 2.5, 12.0 / 2.5
    # Speed at the switch from v^2/(2 push) + v^2/(2 brake) = 1.
    speed = np.sqrt(2.0 / (1.0 / push + 1.0 / brake))
    assert baseline.fastest == pytest.approx(speed / push + speed / brake, rel=1e-3)
    assert baseline.motion is not None
    assert baseline.motion(baseline.motion.duration, 1)[0] == pytest.approx(0.0, abs=1e-9)


def test_acceleration_and_velocity_limited_slide() -> None:
    # Trapezoidal profile: 1 m at 0.5 m/s with 2 m/s^2 takes 2 s + 0.25 s.
    given = limits(1, velocity=np.array([0.5]), acceleration=np.array([2.0]))
    baseline = toppra_baseline(robot(slider()), given, JointPath.through([[0.0], [1.0]]))
    assert baseline.fastest == pytest.approx(2.25, rel=1e-3)


def test_tool_speed_and_speed_map_limit_the_slide() -> None:
    path = JointPath.through([[0.0], [1.0]])
    arm = robot(slider())
    slow = limits(1, acceleration=np.array([2.0]), tool_speed=0.5)
    assert toppra_baseline(arm, slow, path).fastest == pytest.approx(2.25, rel=1e-3)
    position = np.array([[0.0], [0.5], [0.5001], [1.0]])
    allowed = np.array([[0.5], [0.5], [100.0], [100.0]])
    mapped = limits(1, acceleration=np.array([2.0]), velocity_map=(position, allowed))
    # Half the way as above, then on from 0.5 m/s: up to v and down to rest within 0.5 m.
    top = np.sqrt(0.5 * 2.0 + 0.25 / 2.0)
    expected = (0.25 + (0.5 - 0.0625) / 0.5) + (top - 0.5) / 2.0 + top / 2.0
    assert toppra_baseline(arm, mapped, path).fastest == pytest.approx(expected, rel=1e-3)


def test_viscous_friction_alone_limits_the_speed() -> None:
    # 10 N against 5 N s/m: 1 m/s of the 2 m/s possible leaves half the force to accelerate.
    arm = robot(slider(2.0), viscous=5.0)
    given = limits(1, torque=np.array([10.0]), velocity=np.array([2.5]))
    path = JointPath.through([[0.0], [3.0]])
    baseline = toppra_baseline(arm, given, path)
    assert baseline.motion is not None
    t = np.linspace(0.0, baseline.motion.duration, 4001)
    load = np.abs(drive_torque(arm, baseline.motion, t)) / 10.0
    assert np.max(load) < 1.005
    # Exact: m v' = 10 - 5 v, then braking by m v' = -10 - 5 v, switched so that 3 m are covered.
    dt = 1e-5
    v, x = [0.0], [0.0]
    while x[-1] < 3.0:
        v.append(v[-1] + dt * (10.0 - 5.0 * v[-1]) / 2.0)
        x.append(x[-1] + dt * v[-1])
    speed = np.array(v)
    # Distance of braking from v by the integral of m v / (10 + 5 v).
    braking = 2.0 * (speed / 5.0 - 2.0 / 5.0 * np.log1p(speed / 2.0))
    switch = int(np.argmax(np.array(x) + braking >= 3.0))
    exact = switch * dt + 2.0 / 5.0 * np.log1p(speed[switch] / 2.0)
    # Never faster than possible; the safe bound while braking costs a little.
    assert exact * 0.999 < baseline.fastest < exact * 1.1


def test_fixed_path_minimum_time_of_the_benchmark() -> None:
    model, data, given = ur10()
    path = JointPath.through(data["fixed_path"]["waypoints"])
    arm = robot(model)
    baseline = toppra_baseline(arm, given, path, intervals=2000)
    assert baseline.fastest == pytest.approx(data["fixed_path"]["minimum_time"], rel=1e-4)
    line = JointPath.through([data["start"], data["end"]])
    expected = data["free_path_minimum_time"]["straight_line_toppra"]
    assert toppra_baseline(arm, given, line).fastest == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("friction", [(0.0, 0.0, 0.0), (3.0, 3.0, 0.3)])
@pytest.mark.parametrize("waypoints", ["line", "spline"])
def test_limits_hold_between_grid_points(
    friction: tuple[float, float, float], waypoints: str
) -> None:
    model, data, given = ur10()
    points = data["fixed_path"]["waypoints"]
    path = JointPath.through(points if waypoints == "spline" else [data["start"], data["end"]])
    arm = robot(model, *friction)
    motion = toppra_baseline(arm, given, path).motion
    assert motion is not None
    t = np.linspace(0.0, motion.duration, 5001)
    torque = np.abs(drive_torque(arm, motion, t)) / given.torque
    assert 0.99 < np.max(torque) < 1.003
    assert np.max(np.abs(motion(t, 1)) / given.velocity) < 1.001
    assert motion(0.0) == pytest.approx(path(np.array([0.0]))[0], abs=1e-12)
    assert motion(motion.duration) == pytest.approx(path(np.array([1.0]))[0], abs=1e-10)


def test_slowed_to_the_duration_it_keeps_path_and_limits() -> None:
    model, data, given = ur10()
    path = JointPath.through([data["start"], data["end"]])
    arm = robot(model)
    fast = toppra_baseline(arm, given, path)
    slow = toppra_baseline(arm, given, path, data["duration"])
    assert fast.motion is not None
    assert slow.motion is not None
    assert slow.motion.duration == data["duration"]
    assert slow.fastest == fast.fastest
    x = np.linspace(0, 1, 501)
    ratio = data["duration"] / fast.motion.duration
    same = fast.motion(x * fast.motion.duration)
    assert slow.motion(x * slow.motion.duration) == pytest.approx(same, abs=1e-12)
    speed = fast.motion(x * fast.motion.duration, 1) / ratio
    assert slow.motion(x * slow.motion.duration, 1) == pytest.approx(speed, abs=1e-11)
    t = np.linspace(0.0, data["duration"], 2001)
    assert np.all(np.abs(drive_torque(arm, slow.motion, t)) < given.torque)


def test_a_force_on_the_tool_loads_the_drives() -> None:
    arm = robot(slider(2.0))
    path = JointPath.through([[0.0], [1.0]])
    given = limits(1, torque=np.array([10.0]))
    pushed = toppra_baseline(arm, given, path, process_force=[4.0, 0.0, 0.0])
    # The force helps to start (14 N) and hinders to stop (6 N).
    speed = np.sqrt(2.0 / (2.0 / 14.0 + 2.0 / 6.0))
    assert pushed.fastest == pytest.approx(speed * (2.0 / 14.0 + 2.0 / 6.0), rel=1e-3)


def test_too_short_a_duration_gives_the_reason() -> None:
    given = limits(1, velocity=np.array([0.5]), acceleration=np.array([2.0]))
    path = JointPath.through([[0.0], [1.0]])
    baseline = toppra_baseline(robot(slider()), given, path, duration=1.0)
    assert baseline.motion is None
    assert baseline.fastest == pytest.approx(2.25, rel=1e-3)
    assert "takes 2.25 s, longer than the 1 s asked for" in baseline.reason


def test_a_load_that_cannot_be_held_gives_the_reason() -> None:
    model, data, given = ur10()
    weak = limits(6, velocity=given.velocity, torque=0.5 * given.torque)
    path = JointPath.through([data["start"], data["end"]])
    baseline = toppra_baseline(robot(model), weak, path, duration=5.0)
    assert baseline.motion is None
    assert "At rest at 100 % of the path the torque of joint 2 would be" in baseline.reason


def test_toppra_output_is_suppressed(
    capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.DEBUG):
        given = limits(1, torque=np.array([1e-9]), velocity=np.array([1.0]))
        toppra_baseline(robot(slider()), given, JointPath.through([[0.0], [1.0]]))
        given = limits(1, torque=np.array([1.0]), velocity=np.array([1.0]))
        assert toppra_baseline(robot(slider()), given, JointPath.through([[0.0], [1.0]])).motion
    assert not [record for record in caplog.records if record.name.startswith("toppra")]
    assert capfd.readouterr() == ("", "")
