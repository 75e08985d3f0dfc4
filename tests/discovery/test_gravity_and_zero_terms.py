"""Torques of a tilted base and of a wrong joint zero against pinocchio, exact at large angles."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from simulated_sets import short_case, simulated

from benchmarks.simulator import write_case
from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.catalogue.geometry import BASE_TILT, JOINT_ZERO, tilt_axes, tilted_gravity
from stiffopt.discovery.comparison.extended_run import extend_run, linearise_run
from stiffopt.discovery.comparison.extension_change import extension_change
from stiffopt.discovery.comparison.inertial_parameters import all_body_parameter_names
from stiffopt.discovery.comparison.located_effect import EstimatedEffect, Extension, LocatedEffect
from stiffopt.discovery.comparison.nominal_robot import LazyArmSignals, RobotModel
from stiffopt.discovery.comparison.prepared_run import prepare_run
from stiffopt.discovery.diagnose import diagnose
from stiffopt.discovery.sanity.doubt import DoubtfulRecordings
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.signals import RobotConstants
from stiffopt.discovery.training import open_training_runs
from stiffopt.recording.recording_set import load_recordings


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    case = simulated(short_case(seed=72, robot="small3", train=3, link_encoders=False))
    return write_case(case, tmp_path_factory.mktemp("geometry") / "set")


@pytest.fixture(scope="module")
def robot(folder):
    return RobotModel(load_recordings(folder))


class Signals:
    """The signals of an arm along random states that both terms need."""

    def __init__(self, robot, link=0):
        rng = np.random.default_rng(8)
        self.motion = [rng.uniform(-1.5, 1.5, (6, robot.n)) for _ in range(3)]
        arm = LazyArmSignals(robot, *self.motion)
        self.weight, self.zero_harmonics = arm.weight, arm.zero_harmonics
        self.constants: RobotConstants = robot.constants
        self.link = link


@pytest.mark.parametrize("angle", [0.01, 0.4, 1.3, 2.2])
@pytest.mark.parametrize("azimuth", [0.0, 1.1, 3.7])
def test_tilt_term_is_exact(robot, angle, azimuth):
    signals = Signals(robot)
    axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    turned = 2.0 * np.tan(0.5 * angle) * axis
    amplitudes = [float(turned @ each) for each in tilt_axes(signals.constants.gravity)]
    term = BASE_TILT.term(signals, amplitudes, amplitudes)
    # The base turns by the angle, gravity in its axes by the opposite one.
    gravity = pin.exp3(-angle * axis) @ signals.constants.gravity
    q = signals.motion[0]
    expected = robot.gravity_torque(q, gravity) - robot.gravity_torque(q, signals.constants.gravity)
    np.testing.assert_allclose(term.link_torque, expected, atol=1e-12 * np.abs(expected).max())
    told = tilted_gravity(amplitudes, signals.constants.gravity)
    np.testing.assert_allclose(told, gravity, atol=1e-12)
    reported = BASE_TILT.parameters(amplitudes, amplitudes, signals.constants)
    np.testing.assert_allclose([reported["rx"], reported["ry"]], angle * axis[:2], atol=1e-12)


def test_changed_bodies_hang_in_the_gravity_of_a_tilted_base(robot):
    """A mass off by 3 % has no torque about an upright axis, but one about a tilted axis."""
    rng = np.random.default_rng(4)
    motion = [rng.uniform(-1.5, 1.5, (5, robot.n)) for _ in range(3)]
    change = rng.uniform(0.1, 0.3, (robot.n, 10))
    gravity = tilted_gravity((0.3, -0.2), robot.constants.gravity)
    added = gravity - robot.constants.gravity
    signals = LazyArmSignals(robot, *motion).with_geometry(added, np.zeros(robot.n))
    expected = []
    for times in (1.0, 0.0):
        model = robot.arm.model.copy()
        model.gravity.linear = gravity
        for joint, own in enumerate(change, start=1):
            parameters = model.inertias[joint].toDynamicParameters() + times * own
            model.inertias[joint] = pin.Inertia.FromDynamicParameters(parameters)
        data = model.createData()
        expected.append([pin.rnea(model, data, *state) for state in zip(*motion, strict=True)])
    wanted = np.array(expected[0]) - np.array(expected[1])
    regressor = signals.body_regressor
    np.testing.assert_allclose(regressor.torque(change), wanted, atol=1e-9)
    columns = sum(regressor.torque_of_body(body, own) for body, own in enumerate(change))
    np.testing.assert_allclose(columns, wanted, atol=1e-9)


@pytest.mark.parametrize(("name", "joint"), [("base_tilt", None), ("joint_zero", 1)])
def test_effects_act_on_the_weight_of_changed_bodies(folder, robot, name, joint):
    """Predictions and columns against the arm with these bodies: its nominal weight is not its."""
    (recorded, *_) = open_training_runs(robot.recordings, lambda text: None)
    run = prepare_run(robot, recorded, 0, None, Settings(), vibrating=False)
    change = np.random.default_rng(6).uniform(0.2, 0.9, (robot.n, 10))
    names = all_body_parameter_names(robot)
    bodies = Extension(calibration=dict(zip(names, change.ravel().tolist(), strict=True)))
    at = (0.25, -0.1) if joint is None else (0.2,)
    located = LocatedEffect(effect=effect(name), joint=joint, shapes=at)
    estimated = EstimatedEffect(located=located, amplitudes=at)
    s = run.signals
    q, v, a = s.link_position, s.link_velocity, s.link_acceleration
    if joint is None:
        gravity, moved = tilted_gravity(at, robot.constants.gravity), q
    else:
        gravity, moved = robot.constants.gravity, q + 0.2 * np.eye(robot.n)[joint]
    more = gravity - robot.constants.gravity
    expected = robot.spring_torque(moved, v, a) + robot.changed_torque(change, moved, v, a, more)
    expected += robot.gravity_torque(moved, more)
    found = replace(bodies, effects=(estimated,))
    size = np.abs(expected).max()
    extended = extend_run(run, found)
    np.testing.assert_allclose(extended.signals.spring_torque, expected, atol=1e-8 * size)
    about, own, _ = linearise_run(run, Extension(), found)
    np.testing.assert_allclose(about.signals.spring_torque, expected, atol=1e-8 * size)
    # The column is that of these bodies, from no change of the geometry to this one.
    column = extension_change(about, Extension(effects=(estimated,))).link_torque
    plain = robot.spring_torque(q, v, a) + robot.changed_torque(change, q, v, a)
    np.testing.assert_allclose(column, expected - plain, atol=1e-8 * size)
    # What the linearisation takes back is what its columns add at the point itself.
    regressor = about.signals.body_regressor.torque(change)
    np.testing.assert_allclose(own, column + regressor, atol=1e-8 * size)


def test_tilt_axes_are_normal_to_any_gravity():
    for gravity in ([0, 0, -9.81], [9.81, 0, 0], [0, -6.9, -6.9], [3.0, 4.0, -8.0]):
        down = np.array(gravity) / np.linalg.norm(gravity)
        axes = np.array([*tilt_axes(np.array(gravity, dtype=float)), down])
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("joint", [0, 1, 2])
@pytest.mark.parametrize("angle", [1e-3, -0.3, 1.6, 3.0])
def test_zero_term_is_exact(robot, joint, angle):
    signals = Signals(robot, link=joint)
    q, v, a = signals.motion
    moved = q.copy()
    moved[:, joint] += angle
    expected = robot.spring_torque(moved, v, a) - robot.spring_torque(q, v, a)
    term = JOINT_ZERO.term(signals, [angle], [angle])
    scale = np.abs(robot.spring_torque(q, v, a)).max()
    np.testing.assert_allclose(term.link_torque, expected, atol=1e-8 * angle**2 + 1e-12 * scale)


def changed_set(folder, there, change):
    there.mkdir()
    for file in folder.iterdir():
        if file.suffix == ".npz":
            with np.load(file) as stored:
                columns = dict(stored)
            change(columns)
            np.savez(there / file.name, **columns)
        elif file.is_file():
            (there / file.name).write_bytes(file.read_bytes())
    return there


def lines_of(folder):
    with pytest.raises(DoubtfulRecordings) as raised:
        diagnose(folder, experiment=False)
    return [doubt.line for doubt in raised.value.doubts]


def test_sum_and_difference_of_joints_are_told(folder, tmp_path):
    def add(columns):
        columns["q3"] = columns["q3"] + columns["q2"]
        columns["qd3"] = columns["qd3"] + columns["qd2"]

    def take(columns):
        columns["q3"] = columns["q3"] - columns["q2"]
        columns["qd3"] = columns["qd3"] - columns["qd2"]

    added, taken = (
        lines_of(changed_set(folder, tmp_path / name, change))
        for name, change in (("sum", add), ("difference", take))
    )
    assert added == ["position_includes = [0, 0, 2] in [signals]"]
    assert taken == ["position_includes = [0, 0, -2] in [signals]"]


def test_quarter_turn_of_a_zero_is_told(folder, tmp_path):
    def turn(columns):
        columns["q2"] = columns["q2"] + 0.5 * np.pi

    lines = lines_of(changed_set(folder, tmp_path / "turned", turn))
    assert lines[0] == "offset = [0.0, -1.5708, 0.0] in [signals]"


def test_opposite_axis_with_a_quarter_turn_is_told(folder, tmp_path):
    def turn(columns):
        columns["q2"] = 0.5 * np.pi - columns["q2"]
        columns["qd2"], columns["tau2"] = -columns["qd2"], -columns["tau2"]

    lines = " ".join(lines_of(changed_set(folder, tmp_path / "opposite", turn)))
    assert "offset = [0.0, 1.5708, 0.0]" in lines
    assert "position = [1.0, -1.0, 1.0]" in lines
    assert "torque = [1.0, -1.0, 1.0]" in lines


def test_torque_of_another_joint_in_a_reading_has_its_friction(folder):
    """The other joint's torque leaks as it is, not as its model predicts it."""
    recordings = load_recordings(folder)
    robot = RobotModel(recordings)
    (recorded, *_) = open_training_runs(recordings, lambda text: None)
    run = prepare_run(robot, recorded, 0, None, Settings())
    leak = EstimatedEffect(
        located=LocatedEffect(effect=effect("crosstalk"), joint=2, shapes=(2.0,)), amplitudes=(0.1,)
    )
    friction = EstimatedEffect(
        located=LocatedEffect(effect=effect("coulomb"), joint=1), amplitudes=(5.0,)
    )
    alone = extension_change(run, Extension(effects=(leak,))).torque
    both = extension_change(run, Extension(effects=(leak, friction))).torque
    own = extension_change(run, Extension(effects=(friction,))).torque
    np.testing.assert_allclose(both[:, 2] - alone[:, 2], 0.1 * own[:, 1], atol=1e-9)
    assert np.abs(own[:, 1]).max() == pytest.approx(5.0, rel=0.1)
