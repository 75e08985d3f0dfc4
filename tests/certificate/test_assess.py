"""The certificate against quadrature, pinocchio and hand calculation, apart from the optimiser."""

import ast
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import quad
from small_arms import ROOT, load

from stiffopt.certificate.assess import assess, largest_via_miss
from stiffopt.exact.chain import breakpoints, exact_compliance, exact_windup
from stiffopt.result.trajectory import Trajectory

FORBIDDEN = (
    "stiffopt.transcription",
    "stiffopt.solver",
    "stiffopt.problem.stage_model",
    "stiffopt.problem.formulation",
    "stiffopt.problem.coordinates",
    "stiffopt.dynamics",
    "stiffopt.drivetrain.compact",
    "casadi",
)


def imports(path, package):
    """Modules that a file imports when it is loaded or run, type checking aside."""
    tree = ast.parse(path.read_text())
    guarded = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        if id(node) in guarded:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def test_imports_nothing_of_the_optimiser():
    package, seen = ROOT / "stiffopt", set()
    # The registries read the files of objectives and limits at run time.
    folders = (package / "certificate", package / "problem/objectives", package / "problem/limits")
    waiting = [path for folder in folders for path in sorted(folder.glob("*.py"))]
    while waiting:
        path = waiting.pop()
        if path in seen:
            continue
        seen.add(path)
        for module in imports(path, path.parent):
            assert not module.startswith(FORBIDDEN), (path.name, module)
            file = ROOT / Path(*module.split(".")).with_suffix(".py")
            if module.startswith("stiffopt") and file.exists():
                waiting.append(file)
    names = {path.stem for path in seen}
    assert {"assess", "rigid_body", "violations", "objective", "deflection", "assessment"} <= names


def polynomial(start, end, duration, bulge=0.0):
    """A quintic from rest to rest in one interval, with a sideways bulge."""
    d, T = np.asarray(end, float) - start, duration
    a = np.stack([0 * d, 60 * d / T**3, -180 * d / T**4, 120 * d / T**5])
    # b(s) = s^3 (1 - s)^3: velocity and acceleration vanish at both ends.
    b = np.array([0.0, 6.0, -36.0, 60.0, -30.0])
    powers = T ** -(2.0 + np.arange(5))
    a = np.vstack([a, 0 * d[None]]) + bulge * (b * powers)[:, None]
    return Trajectory([0.0, T], a[None], start, np.zeros_like(d))


@pytest.fixture
def planar(tmp_path):
    problem = load(tmp_path, "planar", extra="[tool]\nprocess_force = [10, 0, -30.0]")
    motion = polynomial(problem.start.joints, problem.end.joints, 0.5, bulge=20.0)
    return problem, motion, assess(problem, motion)


def test_windup_is_the_integral_of_the_exact_compliance(planar):
    problem, _, result = planar
    for j, chain in enumerate(problem.robot.chains):
        for k in range(0, len(result.time), 1500):
            torque = result.spring_torque[k, j]
            marks = [t for t in breakpoints(chain) if t < abs(torque)]
            area, _ = quad(
                lambda t, c=chain: float(exact_compliance(c, np.array([t]))[0]),
                0.0,
                abs(torque),
                points=marks or None,
            )
            assert result.windup[k, j] == pytest.approx(np.sign(torque) * area, rel=1e-8)


def test_windup_through_contacts(tmp_path):
    """The same for a joint with keys, flanges and pins, over the torque's whole range."""
    from stiffopt import load_robot

    robot = load_robot("er3a_c60_contact")
    chain, limit = robot.chains[1], float(robot.torque_max[1])
    for torque in (0.01 * limit, -0.6 * limit):
        marks = [t for t in breakpoints(chain) if t < abs(torque)]
        edges = [0.0, *np.geomspace(1e-4 * abs(torque), abs(torque), 9), *marks]
        edges = np.unique(edges)
        area = sum(
            quad(lambda t: float(exact_compliance(chain, np.array([t]))[0]), a, b, epsrel=1e-6)[0]
            for a, b in pairwise(edges)
        )
        windup = float(exact_windup(chain, np.array([torque]))[0])
        assert windup == pytest.approx(np.sign(torque) * area, rel=1e-5)


def test_parts_of_the_deflection_add_up(planar):
    _, _, result = planar
    parts = result.deflection
    assert parts["static"] + parts["dynamic"] + parts["process"] == pytest.approx(
        parts["total"], abs=1e-15
    )
    for part in parts.values():
        assert np.max(np.abs(part)) > 1e-5
    summary = result.deflection_summary()
    length = np.linalg.norm(parts["total"], axis=1)
    assert summary["total"].peak == np.max(length)
    rms = np.sqrt(np.trapezoid(length**2, result.time) / result.duration)
    assert summary["total"].rms == pytest.approx(rms, rel=1e-6)


def test_torques_are_those_of_pinocchio(planar):
    problem, _, result = planar
    model, force = problem.robot.model, problem.process_force
    data = model.createData()
    frame = model.getFrameId("tip")
    for k in range(0, len(result.time), 700):
        q, v, a = result.position[k], result.velocity[k], result.acceleration[k]
        links = pin.rnea(model, data, q, v, a)
        jacobian = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)[:3]
        pin.framesForwardKinematics(model, data, q)
        assert result.spring_torque[k] == pytest.approx(links - jacobian.T @ force, abs=1e-12)
        assert result.tool[k] == pytest.approx(data.oMf[frame].translation, abs=1e-14)
        assert result.tool_speed[k] == pytest.approx(np.linalg.norm(jacobian @ v), abs=1e-12)
        assert result.deflection["total"][k] == pytest.approx(-jacobian @ result.windup[k])


def test_one_link_by_hand(tmp_path):
    """2 kg at 0.2 m, tool at 0.4 m, a first slope of 8e3 below 7 N m: all parts by hand."""
    problem = load(tmp_path, "pendulum")
    motion = polynomial([-0.6], [0.6], 1.0)
    result = assess(problem, motion)
    inertia = 2.0 * 0.2**2 + 1e-2
    gravity = -2.0 * 9.81 * 0.2 * np.cos(result.position[:, 0])
    dynamic = inertia * result.acceleration[:, 0]
    assert np.max(np.abs(gravity + dynamic)) < 7.0
    assert result.spring_torque[:, 0] == pytest.approx(gravity + dynamic, abs=1e-12)
    assert result.windup[:, 0] == pytest.approx((gravity + dynamic) / 8e3, rel=1e-9)
    assert result.stiffness[:, 0] == pytest.approx(8e3, rel=1e-12)
    for part, torque in (("static", gravity), ("dynamic", dynamic)):
        length = np.linalg.norm(result.deflection[part], axis=1)
        assert length == pytest.approx(0.4 * np.abs(torque) / 8e3, abs=1e-12)
    # It sags: the elastic tool lies below the planned one.
    assert np.all(result.deflection["static"][:, 2] < 0)


def test_rotors_and_friction_load_the_drive_only(tmp_path):
    from small_arms import joint, reducer, write_problem, write_robot

    from stiffopt.problem.files import load_problem

    path = write_problem(tmp_path, "pendulum")
    heavy = joint("shoulder", reducer(), rotor_inertia=0.5, coulomb=3.0, viscous=2.0)
    plain = assess(load_problem(path).problem, polynomial([-0.6], [0.6], 1.0))
    write_robot(tmp_path, "pendulum", joints=[heavy])
    result = assess(load_problem(path).problem, polynomial([-0.6], [0.6], 1.0))
    assert result.spring_torque == pytest.approx(plain.spring_torque, abs=1e-12)
    moving = result.velocity[:, 0] > 1e-6
    extra = (result.torque - result.spring_torque)[moving, 0]
    expected = 0.5 * result.acceleration[:, 0] + 3.0 + 2.0 * result.velocity[:, 0]
    assert extra == pytest.approx(expected[moving], abs=1e-12)


def test_a_rigid_joint(tmp_path):
    from small_arms import JOINTS, joint, write_problem, write_robot

    from stiffopt.problem.files import load_problem

    path = write_problem(tmp_path)
    write_robot(tmp_path, joints=[joint("shoulder", ""), JOINTS["planar"][1]])
    problem = load_problem(path).problem
    result = assess(problem, polynomial(problem.start.joints, problem.end.joints, 0.5))
    assert np.all(result.windup[:, 0] == 0)
    assert np.all(np.isinf(result.stiffness[:, 0]))
    assert result.min_stiffness.joint == 2


SHARE = 0.07


def exceeded(problem, motion, name, limits):
    """The limits of a problem, with one set so that the motion exceeds it by a known share."""
    from dataclasses import replace

    stricter = replace(problem, limits=replace(problem.active_limits, **limits))
    result = assess(stricter, motion)
    worst = result.worst_violation
    assert worst.limit == name
    assert worst.value == pytest.approx(SHARE, rel=1e-6)
    return worst


@pytest.mark.parametrize("name", ["velocity", "acceleration", "jerk", "torque"])
def test_excess_over_a_joint_limit(name, planar):
    problem, motion, result = planar
    series = np.abs(getattr(result, name))
    limits = np.full(2, 1e9)
    limits[1] = np.max(series[:, 1]) / (1 + SHARE)
    worst = exceeded(problem, motion, name, {name: limits})
    assert worst.joint == 2
    assert series[np.argmin(np.abs(result.time - worst.time)), 1] == np.max(series[:, 1])


def test_excess_over_the_range(planar):
    problem, motion, result = planar
    high = np.max(result.position[:, 0])
    # The excess counts against the whole range.
    upper = (high + SHARE * -3.0) / (1 + SHARE)
    worst = exceeded(problem, motion, "position", {"position_upper": np.array([upper, 3.0])})
    assert worst.joint == 1
    assert worst.time == result.time[np.argmax(result.position[:, 0])]


@pytest.mark.parametrize("name", ["tool_speed", "dynamic_deflection", "total_deflection"])
def test_excess_over_a_limit_of_the_tool(name, planar):
    problem, motion, result = planar
    series = result.tool_speed
    if name != "tool_speed":
        series = np.linalg.norm(result.deflection[name.removesuffix("_deflection")], axis=1)
    worst = exceeded(problem, motion, name, {name: float(np.max(series)) / (1 + SHARE)})
    assert worst.joint is None
    assert worst.time == result.time[np.argmax(series)]


def test_excess_below_a_stiffness_floor(planar):
    problem, motion, result = planar
    floor = float(np.min(result.stiffness[:, 0])) / (1 - SHARE)
    worst = exceeded(problem, motion, "joint_stiffness", {"joint_stiffness": {1: floor}})
    assert worst.joint == 1


def test_excess_over_a_speed_map(planar):
    problem, motion, result = planar
    positions = np.array([[-3.0, -3.0], [0.0, 0.0], [3.0, 3.0]])
    shape = np.array([1.0, 2.0, 4.0])
    ratio = np.max(
        np.abs(result.velocity[:, 1]) / np.interp(result.position[:, 1], *[positions[:, 1], shape])
    )
    speeds = np.stack([np.full(3, 1e3), shape * ratio / (1 + SHARE)], axis=1)
    worst = exceeded(problem, motion, "velocity_by_position", {"velocity_map": (positions, speeds)})
    assert worst.joint == 2


def test_missed_targets(tmp_path):
    from dataclasses import replace

    from stiffopt import Target

    problem = load(tmp_path, "planar")
    motion = polynomial(problem.start.joints, problem.end.joints, 0.5)
    middle = motion(0.25)
    pitch = float(np.sum(middle))
    place = assess(problem, motion, times=np.array([0.0, 0.25, 0.5])).tool[1]
    off = Target(joints=middle + np.array([0.0, 0.3]), tolerance=0.1)
    near = Target(position=place, tolerance=1e-3)
    turned = Target(position=place, rpy=[0, pitch + 0.2, 0], tolerance=1e3, angle_tolerance=0.1)
    right = Target(position=place, rpy=[0, pitch, 0], tolerance=1e-3, angle_tolerance=0.01)
    for via, least, most in ((off, 0.2, 2.0), (near, -1, -0.9), (right, -1, -0.9)):
        result = assess(replace(problem, vias=(via,)), motion)
        value = {v.limit: v.value for v in result.violations}["via_1"]
        assert least <= value <= most
    # An orientation that is nowhere taken to within twice its tolerance near the place.
    result = assess(replace(problem, vias=(turned,)), motion)
    angle = np.abs(np.sum(result.position, axis=1) - pitch - 0.2)
    expected = np.min(angle) / 0.1 - 1
    assert {v.limit: v.value for v in result.violations}["via_1"] == pytest.approx(
        expected, abs=1e-3
    )
    moved = replace(problem, end=Target(joints=problem.end.joints + 1e-3))
    worst = assess(moved, motion).worst_violation
    assert worst.limit == "end"
    assert worst.value == pytest.approx(1e-3 / 1e-4 - 1, rel=1e-6)


def test_vias_are_passed_in_order_where_a_motion_passes_one_nearer_later(tmp_path):
    from dataclasses import replace

    from stiffopt import Target

    problem = load(tmp_path, "planar")
    there, back = (Target(joints=np.array([a, 0.0]), tolerance=0.05) for a in (0.1, 0.5))
    times = np.linspace(0.0, 1.0, 11)
    # To `there` within half of its tolerance, to `back`, and over `there` exactly.
    angles = np.interp(times, [0.0, 0.2, 0.6, 1.0], [-0.5, 0.125, 0.5, 0.1])

    def motion(at, order=0):
        turned = np.interp(at, times, angles) if order == 0 else np.zeros(len(at))
        return np.stack([turned, np.zeros(len(at))], axis=1)

    def misses(*vias):
        result = assess(replace(problem, vias=vias), motion, times=times)
        return [v.value for n in (1, 2) for v in result.violations if v.limit == f"via_{n}"]

    assert misses(there, back) == pytest.approx([-0.5, -1.0])
    assert misses(back, there) == pytest.approx([-1.0, -1.0])
    far = replace(back, joints=np.array([0.6, 0.0]))
    assert misses(there, far) == pytest.approx([-0.5, 1.0])
    motion.duration, motion.times = 1.0, times
    for vias, miss in (((there, back), -1.0), ((there, far), 1.0), ((), -np.inf)):
        assert largest_via_miss(replace(problem, vias=vias), motion) == pytest.approx(
            miss, abs=0.01
        )
