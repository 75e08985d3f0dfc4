"""Timed motions of controllers and planners: formats, units, and faults with their place."""

import json

import numpy as np
import pytest
import yaml

from stiffopt.errors import InputError
from stiffopt.export.formats.sampled_points import Ros2
from stiffopt.export.motion import SampledMotion
from stiffopt.robot.files import load_robot
from stiffopt.starter.timed_motion import read_timed_motion

TIME = np.linspace(0.0, 1.0, 21)
START = np.array([0.2, -1.0, 1.2, -0.9, -1.2, 0.3])
SHAPE = 10 * TIME**3 - 15 * TIME**4 + 6 * TIME**5
POSITION = START + SHAPE[:, None] * np.array([0.9, 0.3, -0.4, 0.5, 0.2, -0.8])


@pytest.fixture(scope="module")
def arm():
    return load_robot("ur10")


def write_table(path, header, *columns):
    table = np.column_stack(columns)
    path.write_text(header + "\n" + "\n".join(",".join(map(repr, row)) for row in table.tolist()))
    return path


def joint_names(count):
    return ",".join(f"J{j}" for j in range(1, count + 1))


def trajectory_message(arm, order):
    points = [
        {
            "positions": POSITION[k, order].tolist(),
            "velocities": np.zeros(6).tolist(),
            "time_from_start": {"sec": int(t), "nanosec": round(1e9 * (t % 1.0))},
        }
        for k, t in enumerate(TIME.tolist())
    ]
    return {"joint_names": [arm.joint_names[j] for j in order], "points": points}


def test_table_of_degrees_and_milliseconds(arm, tmp_path):
    """Columns as RoboDK and teach pendants write them."""
    path = write_table(
        tmp_path / "m.csv", f"{joint_names(6)},TIME [ms]", np.degrees(POSITION), 1e3 * TIME
    )
    read = read_timed_motion(path, arm)
    np.testing.assert_allclose(read.time, TIME, atol=1e-12)
    np.testing.assert_allclose(read.position, POSITION, atol=1e-12)


def test_rest_around_the_motion_is_left_out_and_told(arm, tmp_path):
    rows = np.vstack([POSITION[:1], POSITION, POSITION[-1:]])
    time = np.concatenate([[0.0], TIME + 0.5, [2.0]])
    read = read_timed_motion(
        write_table(tmp_path / "m.csv", f"t,{joint_names(6)}", time, rows), arm
    )
    assert read.time[-1] == pytest.approx(1.0)
    assert read.reasons[-1] == "rest of 0.5 s before and 0.5 s after it: left out"


@pytest.mark.parametrize("form", ["json", "yaml", "flow"])
def test_joint_trajectory_is_read_in_the_order_of_its_names(arm, tmp_path, form):
    order = [5, 2, 0, 1, 4, 3]
    message = trajectory_message(arm, order)
    if form == "json":
        path = tmp_path / "plan.json"
        path.write_text(json.dumps({"trajectory": {"joint_trajectory": message}}))
    else:
        path = tmp_path / "plan.yaml"
        path.write_text(
            yaml.safe_dump(message, default_flow_style=None if form == "flow" else False)
        )
    read = read_timed_motion(path, arm)
    np.testing.assert_allclose(read.position, POSITION, atol=1e-12)
    np.testing.assert_allclose(read.time, TIME, atol=1e-9)
    assert read.velocity is not None


def test_own_ros_export_is_read_back(arm, tmp_path):
    motion = SampledMotion(
        title="t",
        which="motor",
        joint_names=arm.joint_names,
        prismatic=arm.prismatic,
        velocity_max=arm.velocity_max,
        time=TIME,
        position=POSITION,
        velocity=0.0 * POSITION,
        acceleration=0.0 * POSITION,
    )
    (text,) = Ros2().files(motion, 500.0).values()
    path = tmp_path / "joint_trajectory.yaml"
    path.write_text(text)
    np.testing.assert_allclose(read_timed_motion(path, arm).position, POSITION, atol=1e-12)


def test_rows_written_twice_are_left_out_and_told(arm, tmp_path):
    twice = np.sort(np.append(np.arange(len(TIME)), [3, 3, 7]))
    path = write_table(tmp_path / "m.csv", f"t,{joint_names(6)}", TIME[twice], POSITION[twice])
    read = read_timed_motion(path, arm)
    np.testing.assert_array_equal(read.time, TIME)
    np.testing.assert_array_equal(read.position, POSITION)
    assert "3 rows that repeat the row before: left out" in read.reasons


def test_set_points_are_preferred_to_measured_positions(arm, tmp_path):
    names = [f"{kind}_{j}" for kind in ("actual_q", "target_q") for j in range(6)]
    path = write_table(
        tmp_path / "log.csv", ",".join(["timestamp", *names]), TIME, POSITION + 0.01, POSITION
    )
    np.testing.assert_allclose(read_timed_motion(path, arm).position, POSITION, atol=1e-12)


def test_faults_are_told_with_their_row(arm, tmp_path):
    repeated = TIME.copy()
    repeated[7] = repeated[6]
    jump = POSITION.copy()
    jump[9:, 3] += 1.5 * np.pi
    hole = POSITION.copy()
    hole[4, 2] = np.nan
    cases = (
        ((repeated, POSITION), r"row 8: its time 0.3 s repeats"),
        ((TIME, jump), r"row 10: .* jumps by 4.\d+ rad"),
        ((TIME, hole), r"row 5, J3"),
        ((TIME, 0.0 * POSITION + START), "at rest"),
        ((TIME, POSITION[:, :5]), "no position for each of the 6 joints"),
    )
    for number, (columns, words) in enumerate(cases):
        head = f"t,{joint_names(columns[1].shape[1])}"
        path = write_table(tmp_path / f"{number}.csv", head, *columns)
        with pytest.raises(InputError, match=words):
            read_timed_motion(path, arm)


def test_velocities_of_a_table_are_taken_where_they_are_those_of_its_positions(arm, tmp_path):
    time = np.linspace(0.0, 1.0, 501)
    shape = 10 * time**3 - 15 * time**4 + 6 * time**5
    rate = 30 * time**2 * (1.0 - time) ** 2
    travel = np.array([0.9, 0.3, -0.4, 0.5, 0.2, -0.8])
    header = "t," + ",".join([*(f"q{j}" for j in range(1, 7)), *(f"qd{j}" for j in range(1, 7))])
    positions, velocities = START + shape[:, None] * travel, rate[:, None] * travel
    noise = np.random.default_rng(3).normal(0.0, 5e-3, velocities.shape)
    twice = (60 * time - 180 * time**2 + 120 * time**3)[:, None] * travel
    header += "," + ",".join(f"qdd{j}" for j in range(1, 7))
    for name, rates, accelerations, taken in (
        ("planned", velocities, twice, (True, True)),
        ("measured", velocities + noise, twice, (False, False)),
        ("degrees", np.degrees(velocities), np.degrees(twice), (True, True)),
        ("other", 3.0 * velocities, 3.0 * twice, (False, False)),
        ("filtered", velocities, 0.8 * twice, (True, False)),
    ):
        path = write_table(tmp_path / f"{name}.csv", header, time, positions, rates, accelerations)
        read = read_timed_motion(path, arm)
        assert (read.velocity is not None, read.acceleration is not None) == taken, name
        if read.velocity is not None:
            sizes = [np.ptp(each, axis=0) for each in (read.velocity, velocities)]
            np.testing.assert_allclose(*sizes, rtol=1e-3)
        unit = {"degrees": "in deg/s by", "other": "in no unit"}.get(name, "in rad/s by")
        assert any(each.startswith("speed: qd1") and unit in each for each in read.reasons)
