"""The simulator against physics that is known: balance, energy, standstill, noise, format."""

import ast
import hashlib
import json
import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.ndimage import gaussian_filter1d

from benchmarks import simulator
from benchmarks.simulator import ROBOTS, CaseSpec, build_world, simulate, write_case, write_truth
from benchmarks.simulator.elasticity import Creep, Sliders, SpringTable, Windup, nominal_windups
from benchmarks.simulator.integrator import integrate
from stiffopt.recording.recording_set import load_recordings

SHORT = CaseSpec(robot="planar2", seed=4, train=1, test=1, extrapolate=1, seconds=3.0)


@cache
def short_case():
    return simulate(SHORT)


def held(seed=4, **changes):
    """A world whose drives are asked to hold their first angle."""
    world, _ = build_world(replace(SHORT, seed=seed, test=0, extrapolate=0, seconds=0.4, **changes))
    world.reference[:] = world.reference[:, :1]
    world.nominal_torque[:] = world.nominal_torque[:, :1]
    return world


def test_imports_nothing_of_the_package():
    for file in Path(simulator.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module or ""]
            for name in names:
                assert name.split(".")[0] != "stiffopt", file


def test_at_rest_the_springs_carry_the_weight():
    world = held()
    trace = integrate(world)
    data = world.model.createData()
    weight = pin.computeGeneralizedGravity(world.model, data, trace.link[0, -1])
    np.testing.assert_allclose(trace.spring[0, -1], weight, rtol=1e-5)
    assert np.abs(trace.link_velocity).max() < 1e-5


def test_dry_friction_holds_a_motor_exactly_still_until_it_is_overcome():
    for share, moves in ((0.9, False), (1.1, True)):
        world = held()
        trace = integrate(world)
        slack = trace.friction[0, -1, 0]  # what friction holds already
        push = share * world.coulomb[0] - slack

        def load(state, torque, push=push):
            torque[:, 0] -= push

        world = held()
        world.motor_loads.append(load)
        # Without the position loop, which would push back.
        feed = world.nominal_torque[:, 0].copy()
        world.drive.append(lambda asked, step, feed=feed: feed.copy())
        motor = integrate(world).motor[0, :, 0]
        assert (np.ptp(motor) > 0.0) == moves


def test_friction_is_within_its_level_at_rest_and_at_it_in_motion():
    case = short_case()
    world, _ = build_world(SHORT)
    trace = case.trace
    dry = trace.friction - world.viscous * trace.motor_velocity
    still = trace.motor_velocity == 0.0
    assert 0.002 < still.mean() < 0.2
    assert np.all(
        np.abs(trace.friction[still]) <= np.broadcast_to(world.coulomb, still.shape)[still]
    )
    moving = np.abs(trace.motor_velocity) > 0.03
    level = np.broadcast_to(world.coulomb, moving.shape)
    np.testing.assert_allclose(
        dry[moving],
        (np.sign(trace.motor_velocity) * level)[moving],
        atol=0.002 * world.coulomb.max(),
    )


def test_energy_of_a_free_arm_is_kept():
    world, _ = build_world(replace(SHORT, test=0, extrapolate=0, seconds=1.0))
    world.reference[:] = [0.7, 0.9]  # it hangs, and swings from here
    world.robot = replace(world.robot, joint_damping=np.zeros(2))
    world.coulomb[:] = 0.0
    world.viscous[:] = 0.0
    world.drive.append(lambda asked, step: 0.0 * asked)
    trace = integrate(world)
    table = SpringTable(world.windups, world.robot.torque_max)
    data = world.model.createData()
    grid = np.linspace(-0.02, 0.02, 40001)
    torque = table.torque(np.repeat(grid[:, None], 2, axis=1))
    stored = np.cumsum((torque[1:] + torque[:-1]) / 2, axis=0) * (grid[1] - grid[0])
    energy, kinetic = [], []
    for k in range(0, trace.motor.shape[1], 40):
        q, v = trace.link[0, k], trace.link_velocity[0, k]
        kinetic.append(pin.computeKineticEnergy(world.model, data, q, v))
        total = kinetic[-1] + pin.computePotentialEnergy(world.model, data, q)
        total += 0.5 * np.sum(world.rotor_inertia * trace.motor_velocity[0, k] ** 2)
        wound = trace.motor[0, k] - q
        total += sum(np.interp(wound[j], grid[1:], stored[:, j]) for j in range(2))
        energy.append(total)
    assert np.ptp(kinetic) > 1.0
    assert np.ptp(energy) < 2e-3 * np.ptp(kinetic)


def test_stiffer_joints_come_to_the_rigid_robot():
    errors = []
    for factor in (1.0, 4.0, 16.0):
        spec = replace(SHORT, test=0, extrapolate=0, seconds=0.6, substeps=12, tolerance=0.0)
        world, _ = build_world(spec)
        for windup in world.windups:
            windup.factor *= factor
        trace = integrate(world)
        data = world.model.createData()
        inside = slice(1, -1)
        acceleration = np.diff(trace.motor[0], 2, axis=0) / trace.step**2
        states = zip(
            trace.motor[0, inside], trace.motor_velocity[0, inside], acceleration, strict=True
        )
        rigid = np.array([pin.rnea(world.model, data, *state).copy() for state in states])
        lacking = (trace.torque - trace.friction)[0, inside] - rigid
        lacking -= world.rotor_inertia * acceleration
        # The ringing of the springs aside, which a rigid robot has not.
        errors.append(gaussian_filter1d(lacking, 0.01 / trace.step, axis=0)[500:-500].std())
    # What a rigid robot leaves unexplained is the wind-up's, in proportion to the compliance.
    assert errors[0] < 0.005 * ROBOTS["planar2"].torque_rated[0]
    np.testing.assert_allclose(errors, errors[0] / np.array([1.0, 4.0, 16.0]), rtol=0.15)


@pytest.mark.parametrize("name", sorted(ROBOTS))
def test_windup_table_follows_the_curve_of_the_catalogue(name):
    robot = ROBOTS[name]
    table = SpringTable(nominal_windups(robot), robot.torque_max)
    k1, k2, k3 = robot.slopes
    t1, t2 = robot.corners
    torque = 1.4 * t2
    by_hand = t1 / k1 + (t2 - t1) / k2 + 0.4 * t2 / k3 + torque / robot.contact_stiffness
    np.testing.assert_allclose(table.torque(by_hand), torque, rtol=1e-4)
    np.testing.assert_allclose(table.torque(-by_hand), -torque, rtol=1e-4)


def test_play_transmits_nothing():
    robot = ROBOTS["planar2"]
    windups = nominal_windups(robot)
    windups[0].gap = 4e-4
    table = SpringTable(windups, robot.torque_max)
    assert table.torque(np.array([1.8e-4, 0.0]))[0] == 0.0
    beyond = nominal_windups(robot)[0].deflection(np.array([20.0]))[0]
    assert table.torque(np.array([beyond + 2e-4, 0.0]))[0] == pytest.approx(20.0, rel=1e-3)


def test_sliders_close_their_loop_and_creep_settles():
    sliders = Sliders(0, height=2.0, reach=1e-4)

    def go(target, here=[0.0]):  # noqa: B006 - the place between the calls
        torque = np.zeros((1, 1))
        for place in np.linspace(here[0], target, 50):
            torque[:] = 0.0
            sliders.add(np.array([[place]]), torque)
        here[0] = target
        return torque[0, 0]

    go(0.0)
    assert go(5e-4) == pytest.approx(2.0)
    assert go(-5e-4) == pytest.approx(-2.0)
    corner = go(0.2e-4)
    go(-0.1e-4)
    assert go(0.2e-4) == pytest.approx(corner)  # an inner loop comes back to where it left
    creep = Creep(0, compliance=1e-5, time=0.2, step=1e-3)
    torque = np.full((1, 1), 8.0)
    creep.deflection(1)
    for _ in range(5000):
        creep.advance(torque)
    assert creep.deflection(1)[0] == pytest.approx(8e-5, rel=1e-6)


def test_softening_pieces_are_monotone():
    for name in ("preload_loss", "k1_softening", "belt_creep", "stiffness_linear", "backlash"):
        world, _ = build_world(replace(SHORT, effects=((name, 1, 3.0),), seconds=0.5))
        windup: Windup = world.windups[0]
        torque = np.linspace(-150.0, 150.0, 4001)
        assert np.all(np.diff(windup.deflection(torque)) > 0.0), name


def test_noise_and_counts_are_those_stated():
    case = short_case()
    robot = case.robot
    for j in range(robot.joints):
        for letter, level in (
            ("tau", robot.torque_noise[j]),
            ("qd", robot.velocity_noise),
            ("ql", np.hypot(robot.link_noise, robot.link_count / np.sqrt(12))),
        ):
            errors = np.concatenate(
                [r.columns[f"{letter}{j + 1}"] - r.clean[f"{letter}{j + 1}"] for r in case.runs]
            )
            # 4500 samples: one standard deviation of the estimate is 1 %.
            assert errors.std() == pytest.approx(level, rel=0.04)
            assert abs(errors.mean()) < 4 * level / np.sqrt(len(errors))
        counts = case.runs[0].columns[f"q{j + 1}"] / robot.motor_count[j]
        np.testing.assert_allclose(counts, np.round(counts), atol=1e-4)


def test_tolerances_have_their_size_and_none_without():
    draws = [
        build_world(replace(SHORT, seed=s, train=1, test=0, extrapolate=0, seconds=0.2))[1]
        for s in range(60)
    ]
    for key, size in (("mass", 0.002), ("jm", 0.005), ("fc", 0.015), ("fv", 0.02), ("k", 0.01)):
        values = np.array([d["true_tolerances"][key] for d in draws])
        assert values.std() == pytest.approx(size, rel=0.25)
        assert abs(values.mean() - 1.0) < 4 * size / np.sqrt(values.size)
    _, exact = build_world(replace(SHORT, tolerance=0.0, seconds=0.2))
    assert exact["true_tolerances"]["mass"] == [1.0, 1.0]


def test_motions_are_within_limits_and_varied():
    spec = replace(SHORT, robot="arm6", train=2, test=1, seconds=8.0)
    world, _ = build_world(spec)
    velocity = np.gradient(world.reference, world.step, axis=1)
    robot = world.robot
    train, beyond = velocity[:3], velocity[3:]
    assert np.all(np.abs(train).max(axis=(0, 1)) < robot.speed_max)
    assert np.all(np.abs(beyond).max(axis=(0, 1)) > np.abs(train).max(axis=(0, 1)) * 0.9)
    assert np.abs(beyond).max() > np.abs(train).max()
    slow = (np.abs(train) < 0.15) & (np.abs(train) > 0.01)
    assert np.all(slow.mean(axis=(0, 1)) > 0.05)
    still = np.abs(train) < 1e-6
    assert np.all(still.any(axis=(0, 1)))
    assert still.mean() > 0.01
    turns = (np.diff(np.sign(np.where(np.abs(train) < 1e-6, 0.0, train)), axis=1) != 0).sum(axis=1)
    assert np.all(turns >= 4)
    for run, limit in ((0, 0.62), (3, 0.75)):
        assert np.all(
            np.abs(world.nominal_torque[run]).max(axis=0) <= limit * robot.torque_max * 1.01
        )


def test_the_same_seed_gives_the_same_case_and_an_effect_changes_only_itself():
    spec = replace(SHORT, test=0, extrapolate=0, seconds=0.5)
    first, again = simulate(spec), simulate(spec)
    other = simulate(replace(spec, effects=(("torque_offset", 1, 1.0),)))
    for name, values in first.runs[0].columns.items():
        np.testing.assert_array_equal(values, again.runs[0].columns[name])
        if name != "tau1":
            np.testing.assert_array_equal(values, other.runs[0].columns[name])
    off = other.truth["effects"][0]["params"]["off"]
    moved = other.runs[0].columns["tau1"] - first.runs[0].columns["tau1"]
    np.testing.assert_allclose(moved, off, rtol=1e-9)
    assert first.truth["true_tolerances"] == other.truth["true_tolerances"]
    assert not np.array_equal(
        simulate(replace(spec, seed=5)).runs[0].columns["q1"], first.runs[0].columns["q1"]
    )


@pytest.mark.parametrize("encoders", [True, False])
def test_case_is_written_as_a_recording_set_and_its_truth_apart(tmp_path, encoders):
    spec = replace(
        SHORT,
        effects=(("backlash", 2, 1.0),),
        seconds=0.4,
        link_encoders=encoders,
        stated_noise=2.0,
    )
    case = simulate(spec)
    folder = write_case(case, tmp_path / "set")
    truth = write_truth(case, tmp_path / "truth" / "case.json")
    with (folder / "recordings.toml").open("rb") as file:
        text = tomllib.load(file)
    assert text["schema"] == 1
    assert text["joints"] == ["joint1", "joint2"]
    assert ("link_position" in text["signals"]) == encoders
    assert text["noise"]["torque"] == pytest.approx((2 * case.robot.torque_noise).tolist())
    assert text["nominal"]["reducer"]["K3"] == case.robot.slopes[2].tolist()
    assert [run["role"] for run in text["runs"]] == ["train", "test", "extrapolate"]
    for entry, run in zip(text["runs"], case.runs, strict=True):
        with np.load(folder / entry["file"]) as columns:
            assert set(columns) == set(run.columns)
            for name in columns:
                np.testing.assert_array_equal(columns[name], run.columns[name])
    model = pin.buildModelFromUrdf(str(folder / "robot.urdf"))
    assert model.nv == 2
    assert model.existFrame("tool0")
    digest = hashlib.sha256(truth.read_bytes()).hexdigest()
    assert (folder / "commitment.txt").read_text().strip() == digest
    assert json.loads(truth.read_text())["effects"][0]["effect"] == "backlash"
    for file in folder.glob("*.*"):
        assert b"backlash" not in file.read_bytes()


def test_a_written_case_is_read_without_faults_or_assumptions(tmp_path):
    case = simulate(replace(SHORT, seconds=1.0))
    recordings = load_recordings(write_case(case, tmp_path))
    assert recordings.assumptions == ()
    for entry, made in zip(recordings.runs, case.runs, strict=True):
        run = recordings.open(entry)
        assert run.faults == ()
        np.testing.assert_array_equal(run.torque[:, 1], made.columns["tau2"])
        np.testing.assert_array_equal(run.link_position[:, 0], made.columns["ql1"])
