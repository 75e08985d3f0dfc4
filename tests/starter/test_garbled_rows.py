"""Rows that a logger garbled are left out of a set, and told."""

from __future__ import annotations

import numpy as np
from small_arms import ROOT

from stiffopt.recording.readers.columns import UNNAMED_COLUMN
from stiffopt.robot.files import load_robot
from stiffopt.starter.table_layouts import drop_garbled_rows, longest_increasing, name_blocks

TIME = np.arange(0.0, 5.0, 0.01)


def table():
    return {"time": TIME.copy(), "q1": np.sin(TIME)}


def test_rows_of_impossible_values_and_times_are_dropped_with_their_numbers():
    log = table()
    log["q1"][4] = 3e154
    log["time"][[7, 8]] = [-0.12, 47.5]
    kept, dropped = drop_garbled_rows(log)
    assert dropped == [5, 8, 9]
    np.testing.assert_array_equal(kept["time"], np.delete(TIME, [4, 7, 8]))
    assert len(kept["q1"]) == len(kept["time"])


def test_few_rows_before_a_long_gap_are_dropped_and_not_the_rows_before_them():
    log = {"time": 3000.0 + TIME, "q1": np.sin(TIME)}
    log["time"][[1, 2, 3]] = [-0.12, 0.8, 47.5]
    kept, dropped = drop_garbled_rows(log)
    assert {2, 3, 4} <= set(dropped) <= {1, 2, 3, 4}
    assert np.all(kept["time"] >= 3000.0)


def test_clean_tables_and_restarting_clocks_are_left_as_they_are():
    clean = table()
    assert drop_garbled_rows(clean) == (clean, [])
    twice = {name: np.concatenate([column, column]) for name, column in clean.items()}
    assert drop_garbled_rows(twice) == (twice, [])


def test_longest_increasing_keeps_equal_stamps():
    values = np.array([0.0, 1.0, 9.0, 1.0, 2.0, -3.0, 3.0])
    np.testing.assert_array_equal(values[longest_increasing(values)], [0.0, 1.0, 1.0, 2.0, 3.0])


def test_blocks_are_recognised_in_spite_of_garbled_rows_and_further_signals():
    robot = load_robot(ROOT / "problems" / "recordings" / "two_link_friction" / "robot.urdf")
    position = np.column_stack([np.sin(TIME), np.cos(2.0 * TIME)])
    speed = np.column_stack([np.cos(TIME), -2.0 * np.sin(2.0 * TIME)])
    blocks = [position, speed, *(np.sin(5.0 * k * position) for k in (1, 2, 3))]
    rows = np.column_stack([TIME, *blocks])
    rows[3, 1:] = 1e200
    named, reason = name_blocks(
        {f"{UNNAMED_COLUMN} {k}": column for k, column in enumerate(rows.T)}, robot
    )
    assert "time, position, velocity, torque, other 1, other 2" in reason
    assert {"t", "position[0]", "velocity[1]", "torque[1]", "other 2[0]"} <= set(named)


def test_velocities_are_recognised_where_a_logger_is_late_by_parts_of_a_row():
    robot = load_robot(ROOT / "problems" / "recordings" / "two_link_friction" / "robot.urdf")
    draw = np.random.default_rng(0)
    step = 0.005
    time = step * np.arange(6000)
    read = time + step * draw.uniform(-1.0, 1.0, len(time))
    position = np.column_stack([np.sin(read), np.cos(2.0 * read)])
    speed = np.column_stack([np.cos(time), -2.0 * np.sin(2.0 * time)])
    torque = draw.standard_normal(position.shape)
    rows = np.column_stack([time, position, speed, torque])
    named, reason = name_blocks(
        {f"{UNNAMED_COLUMN} {k}": column for k, column in enumerate(rows.T)}, robot
    )
    assert "time, position, velocity, torque" in reason
    assert "QUESTION" not in reason
    assert "velocity[1]" in named
