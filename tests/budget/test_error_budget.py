"""The error budget against sampled arms: perturbed models of pinocchio, and exact wind-ups."""

import json
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from small_arms import ROOT

from stiffopt.budget.budget import (
    ORIENTATION,
    POSITION,
    ErrorModel,
    error_budget,
    magnitude_bound,
    semi_axes,
)
from stiffopt.budget.floor import geometry_floor
from stiffopt.budget.identified_stiffness import narrow_stiffness
from stiffopt.budget.measurements import TRACKER_DEVIATION, rank_measurements
from stiffopt.budget.sources import States
from stiffopt.cli import run
from stiffopt.drivetrain.bearing import OutputBearing
from stiffopt.elastic.uncertainty import Uncertainty
from stiffopt.errors import InputFileError
from stiffopt.exact.chain import exact_windup
from stiffopt.report.pages.budget import bounds_figure
from stiffopt.robot.bearings import bearing_deflections
from stiffopt.robot.files import load_robot
from stiffopt.robot.tolerances import Tolerances

TOLERANCES = Tolerances(
    frame_position=8e-5,
    frame_orientation=2e-4,
    joint_zero=3e-4,
    tool_position=1e-4,
    tool_orientation=5e-4,
    base_position=2e-4,
    base_orientation=1e-4,
    thermal_growth=0.0,
)
EXACT = Uncertainty(stiffness=0.0, payload=0.0)
# Sampled standard deviations and quantiles then have a random error of about 1 %.
DRAWS = 6000


def arm(name="ur10", mass=5.0):
    return load_robot(name).with_payload(mass, (0.02, 0.0, 0.06), (0.01, 0.01, 0.01))


def without_hysteresis(robot):
    """The robot with a stated loop that is negligible: a typical one would be assumed."""
    return replace(robot, hysteresis=np.full(robot.n, 1e-15))


def budget(robot, poses, tolerances, uncertainty, **given):
    model = ErrorModel(
        robot=robot,
        tolerances=tolerances,
        uncertainty=uncertainty,
        process_force=np.zeros(3),
        **given,
    )
    return error_budget(model, States.at_rest(np.asarray(poses)))


def perturbation(random, position, orientation):
    """Placement that a frame is off by, normally distributed in its own axes."""
    return pin.SE3(
        pin.exp3(orientation * random.standard_normal(3)), position * random.standard_normal(3)
    )


def sampled_errors(robot, poses, tolerances, draws, seed):
    """Errors (draws, K, 6) of arms with perturbed frames, zeros, tool and base."""
    random = np.random.default_rng(seed)
    half = {k: 0.5 * v for k, v in vars(tolerances).items() if isinstance(v, float)}
    model = robot.model
    tool = pin.SE3(robot.tool.rotation, robot.tool.offset)
    nominal, data = [], model.createData()
    for q in poses:
        pin.forwardKinematics(model, data, q)
        nominal.append(data.oMi[robot.tool.joint] * tool)
    placements = [pin.SE3(each) for each in model.jointPlacements]
    changed = model.copy()
    data, errors = changed.createData(), np.empty((draws, len(poses), 6))
    for draw in errors:
        for j in range(1, model.njoints):
            off = perturbation(random, half["frame_position"], half["frame_orientation"])
            changed.jointPlacements[j] = placements[j] * off
        base = perturbation(random, half["base_position"], half["base_orientation"])
        end = tool * perturbation(random, half["tool_position"], half["tool_orientation"])
        zero = half["joint_zero"] * random.standard_normal(model.nq)
        for k, q in enumerate(poses):
            pin.forwardKinematics(changed, data, q + zero)
            found = base * data.oMi[robot.tool.joint] * end
            draw[k, :3] = found.translation - nominal[k].translation
            draw[k, 3:] = pin.log3(found.rotation @ nominal[k].rotation.T)
    return errors


@pytest.mark.parametrize(("name", "reference"), [("er3a_c60", "base"), ("ur10", "start")])
def test_geometry_agrees_with_perturbed_kinematics(name, reference):
    robot = without_hysteresis(arm(name, 1.0))
    random = np.random.default_rng(3)
    poses = random.uniform(-1.2, 1.2, (3, robot.n))
    tolerances = replace(TOLERANCES, reference=reference)
    found = budget(robot, poses, tolerances, EXACT, compensated=True)
    drawn = sampled_errors(robot, poses, tolerances, DRAWS, seed=7)
    if reference == "start":
        drawn = drawn - drawn[:, :1]
        assert not np.any(found.bound(POSITION)[:1])
    for k in range(1, 3):
        for rows in (POSITION, ORIENTATION):
            sampled = np.cov(drawn[:, k, rows].T)
            lengths, _ = semi_axes(found.covariance[k : k + 1, rows, rows])
            expected, _ = semi_axes(sampled[None])
            assert lengths == pytest.approx(expected, rel=0.03)
            quantile = np.quantile(np.linalg.norm(drawn[:, k, rows], axis=1), 0.95)
            assert found.bound(rows)[k] == pytest.approx(quantile, rel=0.03)


def test_torsion_and_payload_agree_with_sampled_arms():
    robot = without_hysteresis(arm())
    pose = np.array([0.3, -0.7, 1.1, -0.4, 0.6, 0.2])
    uncertainty = Uncertainty(stiffness=0.2, payload=0.1)
    nothing = Tolerances(**{k: 0.0 for k, v in vars(Tolerances()).items() if isinstance(v, float)})
    found = budget(robot, [pose], nothing, uncertainty)
    random = np.random.default_rng(11)
    jacobian = robot.rigid_bodies().jacobian(robot.tool, pose)
    # The torque is linear in the payload.
    light = robot.with_payload_times(0.0).rigid_bodies().gravity_torque(pose)
    load = robot.rigid_bodies().gravity_torque(pose) - light
    torque = light + (1.0 + random.uniform(-0.1, 0.1, (2000, 1))) * load
    windup = np.stack(
        [exact_windup(c, t) for c, t in zip(robot.chains, torque.T, strict=True)], axis=1
    )
    errors = -(windup / (1.0 + random.uniform(-0.2, 0.2, windup.shape))) @ jacobian.T
    assert found.mean[0] == pytest.approx(errors.mean(axis=0), rel=0.03, abs=1e-7)
    quantile = np.quantile(np.linalg.norm(errors[:, :3], axis=1), 0.95)
    assert found.bound(POSITION)[0] == pytest.approx(quantile, rel=0.03)
    led = budget(robot, [pose], nothing, uncertainty, compensated=True)
    assert not led.mean.any()
    assert led.bound(POSITION)[0] < found.bound(POSITION)[0]


def test_shares_sum_to_one_and_name_the_groups():
    found = budget(arm(), [np.full(6, 0.4)], Tolerances(), Uncertainty())
    shares = found.shares(POSITION)
    assert sum(shares.values()) == pytest.approx(1.0)
    assert set(shares) == {"geometry", "torsion", "payload", "hysteresis", "thermal growth"}


@pytest.mark.parametrize("offset", [0.0, 0.7, 3.0])
def test_bound_of_a_length_is_its_quantile(offset):
    random = np.random.default_rng(5)
    spread = np.array([[1.0, 0.2, 0.0], [0.0, 0.5, 0.1], [0.0, 0.0, 0.05]])
    mean = offset * np.array([0.5, -0.4, 0.8])
    drawn = mean + random.standard_normal((200_000, 3)) @ spread.T
    bound = magnitude_bound(mean[None], (spread @ spread.T)[None])[0]
    assert bound == pytest.approx(np.quantile(np.linalg.norm(drawn, axis=1), 0.95), rel=0.015)


def test_bound_without_spread_is_the_length_of_the_mean():
    mean = np.array([[3.0, 0.0, 4.0]])
    assert magnitude_bound(mean, np.zeros((1, 3, 3))) == pytest.approx([5.0])


def test_calibration_leaves_about_the_error_of_the_tracker():
    robot = without_hysteresis(arm("er3a_c60", 1.0))
    model = ErrorModel(
        robot=robot, tolerances=TOLERANCES, uncertainty=EXACT, process_force=np.zeros(3),
        compensated=True,
    )  # fmt: skip
    found = error_budget(model, States.at_rest(np.full((1, robot.n), 0.3)))
    ranked = {each.name.split(":")[0]: each for each in rank_measurements(model, found)}
    calibrated = ranked["calibration"]
    # 30 poses at 0.02 mm determine the position at another pose to about the tracker's error.
    assert 2e-6 < calibrated.bound < 2.8 * TRACKER_DEVIATION
    assert calibrated.gain > 0.8
    assert "payload" not in "".join(ranked)


def test_command_writes_page_and_numbers_and_narrows_with_identified_stiffness(tmp_path, capsys):
    problem = tmp_path / "move.toml"
    text = (ROOT / "problems" / "ur10_tool_deviation.toml").read_text(encoding="utf-8")
    problem.write_text(text + "\n[tolerances]\nframe_position = '0.1 mm'\nreference = 'start'\n")
    assert run(["budget", str(problem), "-o", str(tmp_path / "wide")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "of the bound is a known error" in said
    assert "measurement that narrows the bound most" in said
    identified = tmp_path / "known"
    identified.mkdir()
    joints = [
        {"name": f"J{j}", "status": "identified", "stiffness": 1e4, "sd": 10.0} for j in range(6)
    ]
    (identified / "stiffness.json").write_text(json.dumps({"joints": joints}))
    narrow = ["budget", str(problem), "-o", str(tmp_path / "narrow"), "--stiffness"]
    assert run([*narrow, str(identified)]) == 0
    wide, known = (
        json.loads((tmp_path / name / "budget.json").read_text()) for name in ("wide", "narrow")
    )
    assert max(known["motion"]["position"]["bound"]) < max(wide["motion"]["position"]["bound"])
    assert wide["motion"]["position"]["bound"][0] == 0.0
    assert (tmp_path / "wide" / "report.html").is_file()
    (identified / "stiffness.json").write_text(json.dumps({"joints": joints + joints}))
    assert run([*narrow, str(identified)]) == 2
    assert "Give the stiffness of the same arm" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("joints", "said"),
    [
        ('[{"status": "identified", "stiffness": 0, "sd": 1}]', "joints[0].stiffness: is 0;"),
        ('[{"status": "identified", "stiffness": 1, "sd": NaN}]', "joints[0].sd: is nan;"),
        ('[{"status": "identified", "stiffness": 1}]', "joints[0].sd: is None;"),
        ("{}", "joints: is not a list of joints."),
        ("[3]", "joints: is not a list of joints."),
    ],
)
def test_corrupt_numbers_of_an_identified_stiffness_are_named(joints, said, tmp_path):
    (tmp_path / "stiffness.json").write_text(f'{{"joints": {joints}}}')
    model = SimpleNamespace(robot=SimpleNamespace(joint_names=["J1"], name="arm"))
    with pytest.raises(InputFileError, match=re.escape(said) + ".*Run identify-stiffness again"):
        narrow_stiffness(model, tmp_path)


def test_tilt_of_bearings_agrees_with_sampled_arms():
    robot = replace(arm(), bearings=(OutputBearing(moment_stiffness=4e5),) * 6)
    poses = [[0.3, -1.2, 1.4, -1.7, -1.5, 0.0], [0.8, -0.7, 1.0, -1.2, -1.0, 0.4]]
    unsure = replace(EXACT, bearing_stiffness=0.2)
    nothing = Tolerances(**{k: 0.0 for k, v in vars(Tolerances()).items() if isinstance(v, float)})
    found = budget(without_hysteresis(robot), poses, nothing, unsure)
    random = np.random.default_rng(4)
    factors = 1.0 + random.uniform(-0.2, 0.2, (300, 6))
    # The tilt is linear in the compliance, 1 / factor to first order 2 - factor.
    errors = np.array(
        [
            bearing_deflections(robot.with_bearings_times(1.0 / (2.0 - each)), np.array(poses))
            for each in factors
        ]
    ).sum(axis=2)
    # 300 draws of the standard deviation are within 4 %.
    spread = np.sqrt(np.trace(found.covariance[:, :3, :3], axis1=1, axis2=2))
    sampled = np.sqrt(np.sum(np.var(errors[:, :, :3], axis=0), axis=1))
    assert spread == pytest.approx(sampled, rel=0.1)
    whole = bearing_deflections(robot, np.array(poses)).sum(axis=1)
    assert np.mean(errors, axis=0) == pytest.approx(whole, abs=0.02 * np.abs(whole).max())
    tilt = next(each for each in found.known if each.group == "tilt")
    assert tilt.effect == pytest.approx(whole)
    # Six joints correct the tilt: what is left is its uncertain part.
    led = budget(without_hysteresis(robot), poses, nothing, unsure, compensated=True)
    left = next(each for each in led.known if each.group == "tilt").effect[:, :3]
    assert np.linalg.norm(left, axis=1).max() < 0.02 * np.linalg.norm(whole[:, :3], axis=1).max()


def test_geometry_is_a_floor_of_the_commanded_error():
    robot, poses = arm(), np.array([[0.3, -1.2, 1.4, -1.7, -1.5, 0.0]])
    errors = sampled_errors(robot, poses, TOLERANCES, DRAWS, seed=8)[:, 0, :3]
    floor = geometry_floor(robot, TOLERANCES, poses)
    assert floor == pytest.approx(np.quantile(np.linalg.norm(errors, axis=1), 0.95), rel=0.03)
    taught = replace(TOLERANCES, reference="start")
    assert geometry_floor(robot, taught, poses) == pytest.approx(0.0, abs=1e-12)


def test_arm_that_carries_no_weight_is_measured_under_a_horizontal_pull(tmp_path, capsys):
    problem = str(ROOT / "problems" / "two_link.toml")
    assert run(["budget", problem, "-o", str(tmp_path / "out")]) == 0
    told = json.loads((tmp_path / "out" / "budget.json").read_text())
    names = [each["name"] for each in told["measurements"]]
    assert any("along x" in name or "along y" in name for name in names)
    assert all(np.isfinite(each["bound"]) for each in told["measurements"])


def test_legend_of_the_bounds_stands_above_their_axes():
    found = budget(
        arm(), np.linspace(0.2, 0.9, 5)[:, None] * np.ones(6), Tolerances(), Uncertainty()
    )
    figure = bounds_figure(replace(found, states=replace(found.states, time=np.arange(5.0))))
    figure.canvas.draw()
    upper = figure.axes[0]
    legend = upper.get_legend().get_window_extent()
    assert legend.y0 >= upper.get_window_extent().y1
    assert not legend.overlaps(upper.title.get_window_extent())
