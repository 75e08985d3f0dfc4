"""Commanded and measured positions by the names that loggers give them."""

from __future__ import annotations

import numpy as np
import pytest

from stiffopt.starter.column_names import columns_of_kind, command_columns

JOINTS = ("first", "second")
NAMES = {
    "Dynamixel": ("goal_position_{}", "present_position_{}"),
    "LeRobot": ("action[{}]", "observation.state[{}]"),
    "libfranka": ("q_d[{}]", "q[{}]"),
    "legged gym": ("des_dof_pos_{}", "dof_pos_{}"),
    "MuJoCo": ("ctrl[{}]", "qpos[{}]"),
    "plain": ("command_{}", "position_{}"),
}


@pytest.mark.parametrize("logger", NAMES)
def test_commands_are_told_from_positions(logger: str) -> None:
    command, position = ([name.format(j) for j in (0, 1)] for name in NAMES[logger])
    names = ["t", *command, *position, "tau_d[0]", "tau_d[1]"]
    assert command_columns(names, JOINTS)[0] == tuple(command)
    assert columns_of_kind(names, "position", JOINTS)[0] == tuple(position)


def test_set_points_of_other_kinds_are_no_commanded_positions() -> None:
    names = ["target_velocity_0", "target_velocity_1", "tau_cmd_0", "tau_cmd_1"]
    assert command_columns(names, JOINTS) == []
    assert np.array(command_columns(["q0", "q1"], JOINTS)).size == 0
