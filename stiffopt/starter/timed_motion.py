"""Timed joint motions from files of controllers and planners: columns and units guessed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stiffopt.errors import InputError, InputFileError
from stiffopt.improvement.given_motion import are_derivatives
from stiffopt.recording.readers.columns import Table, is_unnamed
from stiffopt.recording.readers.read import is_messages, read_tables
from stiffopt.recording.recorded_arm import check_range
from stiffopt.recording.run import counted
from stiffopt.recording.signals import may_be_set_point
from stiffopt.recording.stated_units import stated_unit
from stiffopt.robot.robot import Robot
from stiffopt.starter import guessing
from stiffopt.starter.column_names import acceleration_columns, columns_of_kind
from stiffopt.starter.table_layouts import read_message_table
from stiffopt.units import to_si

# Factors of angles to rad.
_RADIANS_PER_UNIT = {"": 1.0, "rad": 1.0, "deg": np.pi / 180.0, "mrad": 1e-3}
# Factors of angular speeds to rad/s, and the ratio to the speed of the positions up to which a
# column is in a unit.
_SPEED_UNITS = {
    **{unit: to_si(f"1 {unit}", "angular velocity") for unit in ("rad/s", "deg/s", "rpm")},
    "mrad/s": 1e-3,
}
_MAX_SPEED_RATIO = 1.25


@dataclass(frozen=True, kw_only=True)
class TimedMotion:
    """Joint positions over time, as a file gives them."""

    time: np.ndarray  # (K,) from 0, strictly increasing [s]
    position: np.ndarray  # (K, n) [rad], [m] of prismatic joints
    velocity: np.ndarray | None  # (K, n) of planned points; None where the file has none
    acceleration: np.ndarray | None  # (K, n) as the velocity
    reasons: tuple[str, ...]  # how columns and units were chosen


def read_timed_motion(path: Path, robot: Robot, rate: float | None = None) -> TimedMotion:
    """Read a motion of the joints of a robot from any file that recordings are read from.

    Set points take precedence over measured positions: they are what can be changed. `rate` [Hz] is
    needed if no column is a time. Raises `InputError` without positions of all joints, and for rows
    out of order or jumps, with the place.
    """
    if rate is not None and not 0.0 < rate < 1e6:
        raise InputError(f"--rate {rate:g} must be above 0 and below 1e6 rows a second.")
    table = _read_table(path, robot)
    table = table if rate is None else guessing.with_time(table, rate)
    try:
        clock = guessing.find_time_column(table)
        unit, why = guessing.guess_time_unit(table[clock], clock)
    except InputError as error:
        raise InputFileError(path, "", str(error)) from error
    if rate is not None:
        unit, why = "", f"time: counted, {rate:g} rows a second"
    names = _position_columns(path, table, clock, robot)
    values = np.column_stack([table[name] for name in names])
    time = table[clock] * guessing.SECONDS_PER_UNIT[unit]
    # Loggers write a row twice; another position at the same instant is a fault.
    row = np.column_stack([time, values])
    new = np.append(True, (row[1:] != row[:-1]).any(axis=1))
    _check_rows(path, time, values, names, new)
    time, values = time[new], values[new]
    factor, told = _angle_factor(path, names, values, robot)
    factors = np.where(robot.prismatic, 1.0, factor)
    position = values * factors
    rows = {name: column[new] for name, column in table.items()}
    velocity, acceleration, used = _rates(rows, names, robot, time, position)
    reasons: tuple[str, ...] = (why, f"position: {', '.join(names)}; {told}", *used)
    if not new.all():
        reasons += (f"{counted(int(np.sum(~new)), 'row')} that repeat the row before: left out",)
    return _checked_motion(path, robot, time, (position, velocity, acceleration), reasons)


def _read_table(path: Path, robot: Robot) -> Table:
    if is_messages(path):
        return dict(read_message_table(path, robot.joint_names))
    tables = read_tables(path)
    if len(tables) > 1:
        first = f"{path.name}#{next(iter(tables))}"
        raise InputFileError(
            path, "", f"holds the runs {', '.join(tables)}. Save one of them, such as {first}, "
            "as a file of its own."
        )  # fmt: skip
    (table,) = tables.values()
    if not is_unnamed(table):
        return table
    n, columns = robot.n, list(table.values())
    if len(columns) not in (n, n + 1) and len(columns) % n > 1:
        raise InputFileError(
            path, "", f"has {len(columns)} columns without names, which are no time and positions "
            f"of {n} joints. Write their names, such as t, q1, q2, above the numbers."
        )  # fmt: skip
    timed = len(columns) % n if n > 1 else len(columns) - 1
    found = {"t": columns[0]} if timed else {}
    return found | {f"position[{j}]": columns[timed + j] for j in range(n)}


def _position_columns(path: Path, table: Table, clock: str, robot: Robot) -> Sequence[str]:
    names = [name for name in table if name != clock]
    asked = [name for name in names if may_be_set_point(name)]
    for chosen in (asked, names):
        found = columns_of_kind(chosen, "position", robot.joint_names)
        if found and all(found[0]):
            return found[0]
    raise InputFileError(
        path, "", f"has no position for each of the {robot.n} joints "
        f"{', '.join(robot.joint_names)} among the columns {', '.join(list(table)[:40])}. Name "
        "them like q1, q2, ... or JOINT_position."
    )  # fmt: skip


def _check_rows(
    path: Path, time: np.ndarray, values: np.ndarray, names: Sequence[str], new: np.ndarray
) -> None:
    """Raise `InputFileError` for a faulty row; `new` (K,) are those that do not repeat another."""
    if new.sum() < guessing.MIN_ROWS:
        raise InputFileError(
            path, "", f"has {new.sum()} row(s); a motion has {guessing.MIN_ROWS} or more."
        )
    for row, k in np.argwhere(~np.isfinite(values)):
        raise InputFileError(
            path, f"row {row + 1}, {names[k]}", "is no number. Complete the row, or delete it."
        )
    for row in np.flatnonzero(~np.isfinite(time)):
        raise InputFileError(path, f"row {row + 1}", "has no time. Complete the row, or delete it.")
    for row in np.flatnonzero((np.diff(time) <= 0.0) & new[1:]):
        same = "repeats" if time[row + 1] == time[row] else "lies before"
        raise InputFileError(
            path, f"row {row + 2}", f"its time {time[row + 1]:.6g} s {same} that of the row before,"
            f" {time[row]:.6g} s. Times must increase from row to row."
        )  # fmt: skip


def _angle_factor(
    path: Path, names: Sequence[str], values: np.ndarray, robot: Robot
) -> tuple[float, str]:
    """Return the factor of angles to rad, with the reason."""
    stated = {stated_unit(name) for name in names}
    if len(stated) == 1 and None not in stated:
        unit, why = str(next(iter(stated))), "unit by their names"
    elif robot.prismatic.any():
        unit, why = "", "taken as rad and m"
    else:
        unit, why = guessing.guess_angle_unit(values, robot)
    if unit not in _RADIANS_PER_UNIT:
        raise InputFileError(
            path, names[0], f"is in {unit}, which are no angles. Convert positions to rad or deg."
        )
    return _RADIANS_PER_UNIT[unit], why


def _rates(
    rows: Mapping[str, np.ndarray],
    positions: Sequence[str],
    robot: Robot,
    time: np.ndarray,
    position: np.ndarray,
) -> tuple[np.ndarray | None, np.ndarray | None, tuple[str, ...]]:
    """Return velocities and accelerations that belong to the positions, and what was found.

    Those of set points if the positions are set points, else measured ones. Rates that are no
    derivatives of the positions are None. Accelerations without velocities are not looked for.
    """
    planned = may_be_set_point(positions[0])
    names = [name for name in rows if may_be_set_point(name) == planned]
    found = columns_of_kind(names, "velocity", robot.joint_names)
    if not found or not all(found[0]):
        return None, None, ()
    velocity = np.column_stack([rows[name] for name in found[0]])
    # Points of a joint trajectory may be too far apart to tell.
    is_trajectory = positions[0] == f"position[{robot.joint_names[0]}]"
    unit = "rad/s" if is_trajectory else _speed_unit(velocity, time, position, robot)
    told = f"speed: {', '.join(found[0])}; "
    if not unit:
        return None, None, (f"{told}in no unit of the positions' speed, not used",)
    told += f"in {unit}"
    told += "" if is_trajectory else " by the steps of the positions"
    factors = np.where(robot.prismatic, 1.0, _SPEED_UNITS[unit])
    velocity = velocity * factors
    if not is_trajectory and not are_derivatives(velocity, time, position):
        return None, None, (f"{told}; measured, not used",)
    twice = acceleration_columns(names, robot.joint_names)
    acceleration = np.column_stack([rows[name] for name in twice]) * factors if twice else None
    if acceleration is not None and not are_derivatives(acceleration, time, velocity):
        acceleration = None
    return velocity, acceleration, (told,)


def _speed_unit(
    velocity: np.ndarray, time: np.ndarray, position: np.ndarray, robot: Robot
) -> str | None:
    """Return the unit in which columns are the speed of the positions, None if in no known one."""
    if robot.prismatic.all():
        return "rad/s"
    speed = (np.diff(position, axis=0) / np.diff(time)[:, None])[:, ~robot.prismatic]
    stated = (0.5 * (velocity[1:] + velocity[:-1]))[:, ~robot.prismatic]
    size = float(np.sum(stated * stated))
    slope = float(np.sum(stated * speed)) / size if size > 0.0 else 0.0
    fitting = (
        unit
        for unit, factor in _SPEED_UNITS.items()
        if factor / _MAX_SPEED_RATIO < slope < factor * _MAX_SPEED_RATIO
    )
    return next(fitting, None)


def _checked_motion(
    path: Path,
    robot: Robot,
    time: np.ndarray,
    rows: tuple[np.ndarray, np.ndarray | None, np.ndarray | None],
    reasons: tuple[str, ...],
) -> TimedMotion:
    """Return the motion from its first to its last movement, checked for jumps.

    `rows`: positions, velocities and accelerations (K, n).
    """
    position = rows[0]
    steps = np.abs(np.diff(position, axis=0))
    ratio = steps / np.diff(time)[:, None] / robot.velocity_max
    # Speed of a joint between two rows over its limit from which the file is wrong: a jump.
    if ratio.max() > 20.0:
        row, j = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
        raise InputFileError(
            path, f"row {row + 2}", f"{robot.joint_names[j]} jumps by "
            f"{steps[row, j]:.4g} rad within {1e3 * (time[row + 1] - time[row]):.4g} ms, "
            f"{ratio[row, j]:.3g} times its speed limit. Check the unit, or cut the file there."
        )  # fmt: skip
    # Largest step of a joint between two rows at rest [rad] or [m]
    moving = np.flatnonzero((steps > 1e-6).any(axis=1))
    if not moving.size:
        raise InputFileError(path, "", "holds an arm at rest: no joint moves.")
    kept = slice(moving[0], moving[-1] + 2)
    # Errors of the encoders' zeros.
    slack = float(np.radians(1.0))
    check_range(path, robot, position[kept], slack=slack, first_row=int(moving[0]) + 1)
    rest = time[moving[0]] - time[0], time[-1] - time[kept][-1]
    if max(rest) > 0.0:
        reasons += (f"rest of {rest[0]:.3g} s before and {rest[1]:.3g} s after it: left out",)
    velocity, acceleration = (None if each is None else each[kept] for each in rows[1:])
    return TimedMotion(
        time=time[kept] - time[moving[0]],
        position=position[kept],
        velocity=velocity,
        acceleration=acceleration,
        reasons=reasons,
    )
