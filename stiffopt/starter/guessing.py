"""Guess the signal kinds of a recording's columns by name, and their units by name and value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from stiffopt.errors import InputError
from stiffopt.recording.channel import are_magnitudes, are_whole
from stiffopt.recording.channel_faults import MIN_CORRELATION, compare_velocity
from stiffopt.recording.clock import are_unordered
from stiffopt.recording.signals import may_be_set_point
from stiffopt.recording.stated_units import stated_unit
from stiffopt.robot.robot import Robot
from stiffopt.starter.column_names import (
    CURRENT_WORDS,
    KINDS,
    TIME_WORDS,
    columns_of_kind,
    command_columns,
    is_signal,
    split_words,
)
from stiffopt.units import to_si

# Units without a known factor to SI, and the factor to ask for.
_FACTOR_REQUESTS = {
    "A": "a current: put N m per A at the joint (torque constant times gear ratio)",
    "mA": "a current: put N m per mA at the joint (torque constant times gear ratio)",
    "%": "a share: put N m per % (a hundredth of the rated torque)",
    "counts": "counts of an encoder: put rad per count, one number a joint",
}
_TORQUE_COUNTS_REQUEST = (
    "counts of the drive: put N m per count at the joint (rated torque / 1000 if per mille)"
)
# Least reach of counts [counts]: whole degrees and whole N m reach less.
_MIN_COUNTED_REACH = {"position": 720.0, "torque": 100.0}
# Counts of one turn of encoders that are read as they are: 12 to 16 bits.
_COUNTS_PER_TURN = (4096, 8192, 16384, 32768, 65536)
# Units per rad and per rad/s, for comparing position changes with speeds.
_ANGLE_UNITS_PER_RAD = {"": 1.0, "deg": np.degrees(1.0), "mrad": 1e3, "turn": 0.5 / np.pi}
_SPEED_UNITS_PER_RAD_S = {"": 1.0} | {
    unit: 1.0 / to_si(f"1 {unit}", "angular velocity") for unit in ("deg/s", "rpm")
}
# Largest log ratio of values in the same unit; ratio of magnitudes above which columns may have
# different units.
_UNIT_LOG_TOLERANCE, _MIXED_UNIT_RATIO = 0.5, 10.0
# Fewest rows of a motion.
MIN_ROWS = 3
# Largest plausible joint angle [rad].
_MAX_JOINT_ANGLE = 40.0 * np.pi


class UnrecognisedError(InputError):
    """A required signal kind has no columns, one a joint."""


@dataclass(frozen=True, kw_only=True)
class GuessedColumns:
    """Columns of a recording and their units."""

    time: str
    # By kind (n,): in the order of the joints; "" for a joint without one.
    columns: Mapping[str, tuple[str, ...]]
    # By "time" or kind (n,): values of `[signals.scale]`, one a joint where they differ; "" is SI.
    # "A" and "mA" still need a torque constant.
    units: Mapping[str, str | tuple[str, ...]]
    reasons: tuple[str, ...] = field(default=())  # reason of each choice, one sentence each
    rate: float = 0.0  # sampling rate [Hz]
    asked: tuple[str, ...] = ()  # alternative columns to ask the user about
    at_rest: bool = False  # rows are poses at rest


def guess_columns(
    table: Mapping[str, np.ndarray], robot: Robot, rate: float | None = None
) -> GuessedColumns:
    """Guess kinds and units of the columns of a table.

    `table` (K,). `rate`: sampling rate [Hz], if no column is a time; `with_time` adds one. Raises
    `InputError`: no time column, or no position or torque for each joint; lists the columns found.
    """
    reasons: list[str] = []
    time = find_time_column(table) if rate is None else COUNTED_TIME
    if len(table[time]) < MIN_ROWS:
        raise InputError(f"a recording of {len(table[time])} row(s) shows no motion; record more.")
    columns, others, told = _assign_columns(table, time, robot)
    reasons += told
    taken = {name for own in columns.values() for name in own}
    left = [name for name in table if name != time and name not in taken]
    _require_kinds(columns, table, robot)
    if "velocity" in columns and _is_counted(_column_values(table, columns["position"])):
        reasons.append(
            f"velocity: {columns.pop('velocity')[0]}, ... are counts per an unknown time and not"
            " used: positions tell the speed"
        )
    unit, why = guess_time_unit(table[time], time)
    if rate is not None:
        unit, why = "", f"time: counted, {rate:g} rows a second"
    # Weight at rest is told by torques alone.
    at_rest = "torque" in columns and are_unordered(
        np.column_stack([table[name] for name in columns["position"]])
    )
    if at_rest:
        unit, why = "", f"poses at rest: positions do not follow one another, {time} numbers them"
    units: dict[str, str | tuple[str, ...]] = {"time": unit}
    reasons.append(why)
    seconds = table[time] * SECONDS_PER_UNIT[unit]
    for kind in ("position", "velocity", "link_position", "torque"):
        if kind in columns:
            units[kind], why = _guess_unit(kind, columns, table, robot, seconds, units)
            why += _ask_alternatives(kind, others[kind]) + _ask_measured_columns(
                kind, columns[kind]
            )
            reasons.append(f"{kind}: {', '.join(c for c in columns[kind] if c)}; {why}")
    if "command" in columns:
        units["command"], why = _guess_command_unit(columns, table)
        why += _ask_alternatives("command", others["command"])
        reasons.append(
            f"command: {', '.join(columns['command'])}; set points by their names, {why}. The"
            " law of [actuator] gives torque from command and position"
        )
    if left:
        reasons.append(f"not used: {', '.join(left[:20])}{', ...' if len(left) > 20 else ''}")
    step = _median_step(seconds)
    asked = (name for each in others.values() for own in each for name in own if name not in taken)
    return GuessedColumns(
        time=time,
        columns=columns,
        units=units,
        reasons=tuple(reasons),
        rate=1.0 / max(step, 1e-9),
        asked=tuple(dict.fromkeys(asked)),
        at_rest=at_rest,
    )


def _assign_columns(
    table: Mapping[str, np.ndarray], time: str, robot: Robot
) -> tuple[dict[str, tuple[str, ...]], dict[str, list[tuple[str, ...]]], list[str]]:
    """Return the columns of each kind, other families that may be it, and reasons.

    Commands are taken where no column is a torque.
    """
    columns: dict[str, tuple[str, ...]] = {}
    others: dict[str, list[tuple[str, ...]]] = {}
    reasons: list[str] = []
    left = [name for name in table if name != time]
    for kind in KINDS:
        found = columns_of_kind(left, kind, robot.joint_names)
        if found:
            columns[kind], others[kind] = found[0], found[1:]
            left = [name for name in left if name not in found[0]]
    commands = command_columns(left, robot.joint_names)
    if commands and "torque" in columns and (fault := _find_torque_fault(columns["torque"], table)):
        unused = columns.pop("torque")
        reasons.append(f"no torque: {', '.join(unused)}, {fault}; commands take its place")
    if commands and "torque" not in columns:
        columns["command"], others["command"] = commands[0], commands[1:]
    return columns, others, reasons


def _require_kinds(
    columns: Mapping[str, tuple[str, ...]],
    table: Mapping[str, np.ndarray],
    robot: Robot,
) -> None:
    """Raise `UnrecognisedError` without positions, and torques or commands, of all joints."""
    for kind in ("position", "torque"):
        if kind not in columns and not (kind == "torque" and "command" in columns):
            commands = " or commands like q_cmd1, q_cmd2, ..." if kind == "torque" else ""
            raise UnrecognisedError(
                f"no {kind} was recognised for {robot.n} joints among the columns"
                f" {', '.join(list(table)[:40])}. Name them like"
                f" {_NAME_EXAMPLES[kind]}{commands}, or write [signals] of recordings.toml by hand."
            )


def _find_torque_fault(names: Sequence[str], table: Mapping[str, np.ndarray]) -> str:
    """Return why columns are no torques that a model could explain; "" where they may be."""
    values = _column_values(table, names)
    if np.all(np.fmax.reduce(values) == np.fmin.reduce(values)):
        return "which never changes"
    if are_magnitudes(values):
        return "never negative: magnitudes without a sign"
    said = {word for name in names for word in split_words(name)}
    unnamed = not said & set(CURRENT_WORDS) and all(stated_unit(name) is None for name in names)
    if unnamed and _is_counted(values, "torque"):
        return "whole numbers: a drive's own count of its output"
    return ""


_NAME_EXAMPLES = {
    "position": "q1, q2, ... or JOINT_position",
    "torque": "tau1, tau2, ... or JOINT_effort",
}
SECONDS_PER_UNIT = {"": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
COUNTED_TIME = "counted_time"


def _ask_alternatives(kind: str, others: Sequence[tuple[str, ...]]) -> str:
    """Return the question about other column families of the same kind; "" without."""
    if not others:
        return ""
    told = "; or ".join(", ".join(each) for each in others[:3])
    return (
        f". QUESTION: {told} may be the {kind} as well: which is measured, and neither a set point"
        f" nor an error? Its columns go to {kind} in [signals]"
    )


def _ask_measured_columns(kind: str, names: Sequence[str]) -> str:
    """Return the question if all columns are set points; "" otherwise."""
    if not any(name and may_be_set_point(name) for name in names):
        return ""
    return (
        f". QUESTION: set points by their names, and no measured {kind} was found. A commanded"
        f" signal is not a measurement: log the measured {kind}"
    )


def _guess_command_unit(
    columns: Mapping[str, tuple[str, ...]], table: Mapping[str, np.ndarray]
) -> tuple[str, str]:
    """Return the unit of commands by their travel beside that of positions, with the reason.

    "" is the unit of the positions.
    """
    travel = [
        _standard_deviations(_column_values(table, columns[kind]))
        for kind in ("command", "position")
    ]
    with np.errstate(invalid="ignore", divide="ignore"):
        ratios = travel[0] / travel[1]
    ratio = float(np.nanmedian(np.where(np.isfinite(ratios), ratios, np.nan)))
    alike = [
        _correlate(table[one], table[two])
        for one, two in zip(columns["command"], columns["position"], strict=True)
    ]
    # Median correlation of commands and positions below which these are other commands.
    if float(np.median(alike)) < 0.5:
        return "", (
            "QUESTION: they do not go with the positions: increments, velocities or torques? Only"
            " commanded positions belong here"
        )
    degree = _ANGLE_UNITS_PER_RAD["deg"]
    if abs(np.log(ratio / degree)) < 2.0 * _UNIT_LOG_TOLERANCE:
        return "deg", "in deg, as they travel beside the positions in rad"
    if abs(np.log(ratio)) < 2.0 * _UNIT_LOG_TOLERANCE:
        return "", "in the unit of the positions"
    return "", (
        f"QUESTION: they travel {ratio:.3g} times as far as the positions: in which unit? Put it as"
        " command in [signals.scale]"
    )


def _correlate(one: np.ndarray, two: np.ndarray) -> float:
    """Return the correlation of two columns; 0 where one of them does not change."""
    known = np.isfinite(one) & np.isfinite(two)
    if known.sum() < MIN_ROWS or np.ptp(one[known]) == 0.0 or np.ptp(two[known]) == 0.0:
        return 0.0
    return float(np.corrcoef(one[known], two[known])[0, 1])


def with_time(table: Mapping[str, np.ndarray], rate: float) -> dict[str, np.ndarray]:
    """Add a time column `COUNTED_TIME` at a sampling rate [Hz]."""
    rows = len(next(iter(table.values())))
    return {COUNTED_TIME: np.arange(rows) / rate, **table}


def are_poses(table: Mapping[str, np.ndarray], robot: Robot) -> bool:
    """Return True for a table without a time whose positions do not follow one another."""
    try:
        find_time_column(table)
    except InputError:
        found = columns_of_kind(list(table), "position", robot.joint_names)
        return bool(found) and are_unordered(np.column_stack([table[name] for name in found[0]]))
    return False


def find_time_column(table: Mapping[str, np.ndarray]) -> str:
    """Return the name of the column of times.

    Raises `InputError`: no column increases as a time does.
    """
    named = [name for name in table if set(split_words(name)) & set(TIME_WORDS)]
    # Columns that rise in every row without restart take precedence over repeated stamps.
    for steady in (True, False):
        for name in named:
            steps = np.diff(table[name])
            rising = steps > 0.0 if steady else steps >= 0.0
            net = np.nansum(steps) > (0.5 * np.nansum(np.abs(steps)) if steady else 0.0)
            if len(steps) and rising.mean() > 0.95 and net:
                return name
    for name, values in table.items():
        if is_signal(name):
            # A joint at constant speed rises like a clock.
            continue
        steps = np.diff(values)
        even = len(steps) > 1 and np.all(steps > 0.0) and np.std(steps) < 0.5 * np.mean(steps)
        # A row counter is no time.
        if even and not np.all(steps == 1.0):
            return name
    if named:
        raise InputError(
            f"no column increases as a time does: {named[0]}, a time by its name, does not."
            " Write the rows in the order of time, or give --rate HZ, the rows a second."
        )
    raise InputError(
        f"no column increases as a time does among {', '.join(list(table)[:40])}. Give --rate HZ,"
        " the rows a second (--rate 1 for poses at rest), or add a column of seconds."
    )


def _median_step(stamps: np.ndarray) -> float:
    """Return the median step between stamps, without repeated ones."""
    steps = np.diff(stamps)
    return float(np.median(steps[steps > 0.0]))


def guess_time_unit(values: np.ndarray, name: str) -> tuple[str, str]:
    """Return the unit of times by their name, else by their steps, with the reason."""
    stated = stated_unit(name)
    step = _median_step(values)
    if stated in ("ms", "us", "ns"):
        return stated, f"time: {name}, in {stated} by its name"
    for unit, factor in SECONDS_PER_UNIT.items():
        if 1e-4 <= step * factor <= 0.25:
            return unit, f"time: {name}, in {unit or 's'} by its steps of {step:g}"
    return "", f"time: {name}, taken as s; its steps of {step:g} are unusual: check"


def _guess_unit(
    kind: str,
    columns: Mapping[str, tuple[str, ...]],
    table: Mapping[str, np.ndarray],
    robot: Robot,
    seconds: np.ndarray,
    units: Mapping[str, str | tuple[str, ...]],
) -> tuple[str | tuple[str, ...], str]:
    """Guess the unit of a kind by names, else by values; return it with the reason."""
    names = [name for name in columns[kind] if name]
    stated = {stated_unit(name) for name in names}
    if len(stated) == 1 and None not in stated:
        unit = str(stated.pop())
        request = request_factor(kind, unit)
        told = f"; {request} in [signals.scale]" if request else ""
        return unit, f"in {unit or 'SI'} by their names{told}"
    values = _column_values(table, names)
    if kind in ("position", "link_position") and not robot.prismatic.any():
        unit, why = guess_angle_unit(values, robot)
        return (
            _guess_mixed_units(kind, columns, table, seconds, why) if unit == "deg" else (unit, why)
        )
    if kind == "velocity" and not robot.prismatic.any():
        position = _column_values(table, columns["position"])
        return _guess_speed_unit(values, position, seconds, units["position"])
    if kind == "torque":
        if any(set(split_words(name)) & set(CURRENT_WORDS) for name in names):
            return "A", f"{request_factor(kind, 'A')} in [signals.scale]"
        if _is_counted(values, "torque"):
            return "counts", f"whole numbers, {_TORQUE_COUNTS_REQUEST} in [signals.scale]"
        most, allowed = _largest_magnitude(values), float(np.nanmax(robot.torque_max))
        if most > 30.0 * allowed:
            return (
                "mN*m",
                f"taken as mN m: they reach {most:.3g}, the drives {allowed:.3g} N m",
            )
    return "", "taken as SI"


def request_factor(kind: str, unit: str) -> str:
    """Return the factor to ask for; "" for units with a known factor to SI."""
    if (kind, unit) == ("torque", "counts"):
        return _TORQUE_COUNTS_REQUEST
    return _FACTOR_REQUESTS.get(unit, "")


def _is_counted(values: np.ndarray, kind: str = "position") -> bool:
    """Return True if values (K, m) of a kind are whole numbers beyond those of its units."""
    reach = _MIN_COUNTED_REACH[kind]
    return are_whole(values) and bool(np.ptp(values[np.isfinite(values)]) > reach)


def _column_values(table: Mapping[str, np.ndarray], names: Sequence[str]) -> np.ndarray:
    """Return columns (K, m); nan for values that are not finite."""
    values = np.column_stack([table[name] for name in names])
    return np.where(np.isfinite(values), values, np.nan)


def _largest_magnitude(values: np.ndarray) -> float:
    """Return the largest magnitude of all values; nan without any."""
    return float(np.fmax.reduce(np.abs(values), axis=None))


def _standard_deviations(values: np.ndarray) -> np.ndarray:
    """Return the standard deviation of each column of (K, n) over its finite values."""
    found = np.full(values.shape[1], np.nan)
    there = np.isfinite(values).any(axis=0)
    found[there] = np.nanstd(values[:, there], axis=0)
    return found


def _guess_speed_unit(
    values: np.ndarray, position: np.ndarray, seconds: np.ndarray, unit: str | tuple[str, ...]
) -> tuple[str, str]:
    """Guess the unit of speeds (K, m) from the rate of positions (K, n), with the reason."""
    each = (unit,) * position.shape[1] if isinstance(unit, str) else unit
    found = _speed_ratios(values, position, seconds)
    if all(name in _ANGLE_UNITS_PER_RAD for name in each) and np.isfinite(found).any():
        found = found * [_ANGLE_UNITS_PER_RAD[name] for name in each]
        ratio = max(float(np.nanmedian(found)), 1e-12)
        for name, factor in _SPEED_UNITS_PER_RAD_S.items():
            if abs(np.log(ratio / factor)) < _UNIT_LOG_TOLERANCE:
                return name, f"in {name or 'rad/s'}, as the positions' change shows"
    return "", "taken as rad/s, which the positions' change does not show: check"


def _speed_ratios(values: np.ndarray, position: np.ndarray, seconds: np.ndarray) -> np.ndarray:
    """Return the ratio of speeds to the rate of positions (n,); nan if undetermined."""
    new = np.flatnonzero(np.diff(seconds, prepend=-np.inf) > 0.0)
    if len(new) < MIN_ROWS or values.shape != position.shape:
        return np.full(position.shape[1], np.nan)
    pairs = zip(values[new].T, position[new].T, strict=True)
    found = np.abs([compare_velocity(*own, seconds[new]) for own in pairs])
    # The noise of a joint at rest determines no unit.
    return np.where(found[:, 1] > MIN_CORRELATION, found[:, 0], np.nan)


def _guess_mixed_units(
    kind: str,
    columns: Mapping[str, tuple[str, ...]],
    table: Mapping[str, np.ndarray],
    seconds: np.ndarray,
    why: str,
) -> tuple[str | tuple[str, ...], str]:
    """Return degrees for all joints, or a unit each if some are in rad, with the reason."""
    names = [name for name in columns[kind] if name]
    values = _column_values(table, names)
    reach = np.fmax.reduce(np.abs(values), axis=0)
    small = (
        (reach <= np.pi) & (reach > 0.0) & (_MIXED_UNIT_RATIO * reach < _largest_magnitude(reach))
    )
    if not small.any() or len(names) < len(columns[kind]):
        return "deg", why
    told = ", ".join(name for name, own in zip(names, small, strict=True) if own)
    if "velocity" in columns and all(columns["velocity"]):
        ratio = _speed_ratios(_column_values(table, columns["velocity"]), values, seconds)
        large = ratio[~small & np.isfinite(ratio)]
        usual = float(np.median(large)) if len(large) else np.nan
        apart = np.log(ratio / usual) - np.log(_ANGLE_UNITS_PER_RAD["deg"])
        rad = small & (np.abs(apart) < _UNIT_LOG_TOLERANCE)
        if rad.any():
            own = ", ".join(name for name, each in zip(names, rad, strict=True) if each)
            each = tuple("" if one else "deg" for one in rad)
            return each, f"{why}; but {own} in rad, as their velocities show"
    scale = ", ".join("1.0" if own else '"deg"' for own in small)
    return "deg", (
        f"{why}. QUESTION: {told} reach no more than {np.max(reach[small]):.3g}: in rad? Then write"
        f" {kind} = [{scale}] in [signals.scale], and the velocity likewise"
    )


def guess_angle_unit(values: np.ndarray, robot: Robot) -> tuple[str, str]:
    """Return the unit of joint angles (K, n) by their reach, with the reason."""
    most = _largest_magnitude(values)
    low, high = robot.position_lower, robot.position_upper
    finite = np.isfinite(high - low) & (np.arange(robot.n) < values.shape[1])
    # A zero of another convention, or a sum of two joints, is beyond the limits as well.
    beyond = bool(
        np.any(np.fmax.reduce(values, axis=0)[finite] > high[finite] + np.pi)
        or np.any(np.fmin.reduce(values, axis=0)[finite] < low[finite] - np.pi)
    )
    if _is_counted(values):
        turn = next((c for c in _COUNTS_PER_TURN if most < c), 0)
        told = f"counts: whole numbers that reach {most:.4g}"
        if turn:
            told += (
                f", so {2.0 * np.pi / turn:.6g} rad per count if one turn has {turn}, and zero"
                f" perhaps at {turn // 2}"
            )
        return "counts", f"{told}; {_FACTOR_REQUESTS['counts']} in [signals.scale]"
    if most > np.degrees(_MAX_JOINT_ANGLE):
        return "counts", f"they reach {most:.4g}, {_FACTOR_REQUESTS['counts']} in [signals.scale]"
    if most > 4.0 * np.pi or beyond:
        return "deg", f"in deg: they reach {most:.4g}, beyond plausible rad"
    return "", f"in rad: they reach {most:.3g}"
