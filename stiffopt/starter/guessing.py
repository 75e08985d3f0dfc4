"""What the columns of a recording are, by their names and by their values."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from stiffopt.errors import InputError
from stiffopt.robot.robot import Robot
from stiffopt.starter.tables import UNITS

KINDS = ("velocity", "torque", "link_position", "position")
# Words of each kind, the first that fits wins; a name is cut at what is neither letter nor digit.
_WORDS = {
    "velocity": ("velocity", "velocities", "vel", "speed", "qd", "dq", "omega", "geschwindigkeit",
                 "drehzahl", "speeds"),
    "torque": (
        "torque", "torques", "tau", "trq", "moment", "effort", "drehmoment", "current", "currents",
        "strom", "amps", "tq", "load",
    ),
    "link_position": ("link", "linkside", "ql", "secondary", "outputside"),
    "position": ("position", "positions", "pos", "q", "angle", "angles", "theta", "winkel", "lage",
                 "ist", "axis", "joint", "a", "j"),
}  # fmt: skip
_CURRENT = ("current", "currents", "strom", "amps", "i")
_TIME = ("t", "time", "timestamp", "stamp", "zeit", "seconds", "clock")
# Of several columns of one kind: measured before wanted.
_WANTED = ("target", "cmd", "command", "desired", "des", "soll", "ref", "reference", "setpoint")
_OTHER = (
    "temperature",
    "temp",
    "temperatur",
    "voltage",
    "acceleration",
    "accel",
    "acc",
    "qdd",
    "mode",
    "status",
)
# What only the user can turn into SI, and what to put there.
FACTORS = {
    "A": "a current: put N m per A at the joint (torque constant times gear ratio)",
    "mA": "a current: put N m per mA at the joint (torque constant times gear ratio)",
    "%": "a share: put N m per % (a hundredth of the rated torque)",
    "counts": "counts of an encoder: put rad per count, one number a joint",
}
# Of a rad (rad/s): positions and speeds whose change is compared.
_PER_RAD = {"": 1.0, "deg": np.degrees(1.0), "mrad": 1e3, "turn": 0.5 / np.pi}
_PER_RAD_S = {"": 1.0, "deg/s": np.degrees(1.0)}
# Logarithms of ratios nearer than this are one unit; columns that reach so many times less than
# others may be in another one.
_ALIKE, _MIXED = 0.5, 10.0
# Rows below which nothing can be told.
_FEWEST = 3
# A joint turns no farther [rad].
_MOST_TURNS = 40.0 * np.pi
_IN_NAME = re.compile(r"[\[(]\s*([^\])]+)\s*[\])](?=\s*\d*\s*$)")
_UNITS_OF = {
    "position": ("deg", "degree", "degrees", "°", "grad", "rad", "mrad", "rev", "revs", "turns"),
    "velocity": ("deg/s", "°/s", "rad/s", "mrad/s", "rpm", "1/min", "min-1", "u/min"),
    "torque": ("nm", "n m", "n*m", "n.m", "n·m", "mnm", "knm", "ncm", "a", "ma", "arms"),
}
_WORD = re.compile(r"[a-zµ°]+|\d+")


@dataclass(frozen=True, kw_only=True)
class GuessedColumns:
    """Columns of a recording and their units.

    Parameters
    ----------
    time : str
    columns : mapping of kind to tuple of str (n,)
        In the order of the joints; "" where one has none.
    units : mapping of "time" or kind to str or tuple of str (n,)
        Of `[signals.scale]`, one a joint where they differ; "" is SI. "A" and "mA" are no torque
        yet.
    reasons : tuple of str
        Why, a sentence each.
    rate : float
        Of the samples [Hz].
    """

    time: str
    columns: Mapping[str, tuple[str, ...]]
    units: Mapping[str, str | tuple[str, ...]]
    reasons: tuple[str, ...] = field(default=())
    rate: float = 0.0


def guess(
    table: Mapping[str, np.ndarray], robot: Robot, rate: float | None = None
) -> GuessedColumns:
    """GuessedColumns what is what.

    Parameters
    ----------
    table : mapping of column name to array (K,)
    robot : Robot
    rate : float, optional
        Of the samples [Hz], where no column is a time; `with_time` adds one.

    Raises
    ------
    InputError
        No time, or not one position and some torque a joint, with the columns there are.
    """
    reasons: list[str] = []
    time = _time(table) if rate is None else CLOCK
    if len(table[time]) < _FEWEST:
        raise InputError(f"a recording of {len(table[time])} row(s) shows no motion; record more.")
    columns: dict[str, tuple[str, ...]] = {}
    left = [name for name in table if name != time]
    for kind in KINDS:
        found = _of_kind(left, kind, robot.joint_names)
        if found is not None:
            columns[kind] = found
            left = [name for name in left if name not in found]
    for kind in ("position", "torque"):
        if kind not in columns:
            raise InputError(
                f"no {kind} was recognised for {robot.n} joints among the columns"
                f" {', '.join(list(table)[:40])}. Name them like {_EXAMPLES[kind]}, or write"
                " [signals] of recordings.toml by hand."
            )
    unit, why = _time_unit(table[time], time)
    if rate is not None:
        unit, why = "", f"time: counted, {rate:g} rows a second"
    units: dict[str, str | tuple[str, ...]] = {"time": unit}
    reasons.append(why)
    seconds = table[time] * _SECONDS[unit]
    for kind in ("position", "velocity", "link_position", "torque"):
        if kind in columns:
            units[kind], why = _unit(kind, columns, table, robot, seconds, units)
            reasons.append(f"{kind}: {', '.join(c for c in columns[kind] if c)}; {why}")
    if left:
        reasons.append(f"not used: {', '.join(left[:20])}{', ...' if len(left) > 20 else ''}")
    step = _step(seconds)
    return GuessedColumns(
        time=time, columns=columns, units=units, reasons=tuple(reasons), rate=1.0 / max(step, 1e-9)
    )


_EXAMPLES = {
    "position": "q1, q2, ... or JOINT_position",
    "torque": "tau1, tau2, ... or JOINT_effort",
}
_SECONDS = {"": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


def _words(name: str) -> list[str]:
    """Words of a column's name, its unit left out: "Actual_Q_0 [rad]" is actual, q, 0."""
    bare = _IN_NAME.sub("", name)
    bare = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", bare)
    return _WORD.findall(bare.lower())


def _stated_unit(name: str) -> str | None:
    """Unit in brackets, or as the last word: "q1 [deg]", "q1_deg"; None where none is there."""
    bracketed = _IN_NAME.search(name)
    if bracketed is not None:
        return UNITS.get(bracketed[1].strip().lower())
    last = re.split(r"[_\s]", name.strip().lower())[-1]
    return UNITS[last] if last in _LAST else None


_LAST = ("deg", "rad", "mrad", "nm", "mnm", "ms", "us", "ns", "rpm", "%", "counts", "percent")


CLOCK = "counted_time"


def with_time(table: Mapping[str, np.ndarray], rate: float) -> dict[str, np.ndarray]:
    """Table with a column `CLOCK` of so many rows a second [Hz]."""
    rows = len(next(iter(table.values())))
    return {CLOCK: np.arange(rows) / rate, **table}


def _time(table: Mapping[str, np.ndarray]) -> str:
    named = [name for name in table if set(_words(name)) & set(_TIME)]
    # Stamps may be repeated; what rises from row to row, and does not begin anew, goes before.
    for steady in (True, False):
        for name in named:
            steps = np.diff(table[name])
            rising = steps > 0.0 if steady else steps >= 0.0
            net = np.nansum(steps) > (0.5 * np.nansum(np.abs(steps)) if steady else 0.0)
            if len(steps) and rising.mean() > 0.95 and net:
                return name
    for name, values in table.items():
        steps = np.diff(values)
        even = len(steps) > 1 and np.all(steps > 0.0) and np.std(steps) < 0.5 * np.mean(steps)
        # What counts the rows is no time.
        if even and not np.all(steps == 1.0):
            return name
    raise InputError(
        f"no column rises as a time does among {', '.join(list(table)[:40])}. Give --rate HZ, the"
        " rows a second, or add a column of seconds."
    )


def _step(stamps: np.ndarray) -> float:
    """Usual step between stamps, repeated ones left out."""
    steps = np.diff(stamps)
    return float(np.median(steps[steps > 0.0]))


def _time_unit(values: np.ndarray, name: str) -> tuple[str, str]:
    stated = _stated_unit(name)
    step = _step(values)
    if stated in ("ms", "us", "ns"):
        return stated, f"time: {name}, in {stated} by its name"
    for unit, factor in _SECONDS.items():
        if 1e-4 <= step * factor <= 0.25:
            return unit, f"time: {name}, in {unit or 's'} by its steps of {step:g}"
    return "", f"time: {name}, taken as s; its steps of {step:g} are unusual: check"


def _of_kind(names: Sequence[str], kind: str, joints: Sequence[str]) -> tuple[str, ...] | None:
    """Columns of a kind, one a joint; None where there are not as many."""
    fitting = [name for name in names if _is_kind(name, kind)]
    measured = [n for n in fitting if not set(_words(n)) & set(_WANTED)]
    # i1, i2, ... are currents where nothing is a torque.
    short = [n for n in names if kind == "torque" and _words(n)[:1] == ["i"]]
    # Words of another language are known by their units.
    foreign = [n for n in names if _measured_in(n) == kind]
    for candidates in (measured, fitting, short, foreign):
        found = _by_joint(candidates, joints)
        if found is not None:
            return found
    return None


def _is_kind(name: str, kind: str) -> bool:
    words = set(_words(name))
    if words & set(_OTHER):
        return False
    if kind == "torque" and words & set(_CURRENT) - {"i"}:
        return True
    measured = _measured_in(name)
    if measured is not None and measured != kind.removeprefix("link_"):
        return False  # "axis 1 [Nm]"
    for other in KINDS:
        if words & set(_WORDS[other]):
            return other == kind
    return False


def _measured_in(name: str) -> str | None:
    """Kind that the unit in the brackets of a name is of: "Achswinkel 1 [°]" is a position."""
    bracketed = _IN_NAME.search(name)
    if bracketed is None or set(_words(name)) & set(_OTHER):
        return None
    unit = bracketed[1].strip().lower()
    return next((kind for kind, own in _UNITS_OF.items() if unit in own), None)


def _by_joint(names: Sequence[str], joints: Sequence[str]) -> tuple[str, ...] | None:
    """By the joint's name inside the column's, else by the last number, from 0 or 1."""
    n = len(joints)
    by_name = {}
    for joint in joints:
        own = [name for name in names if _contains(name, joint)]
        if len(own) == 1:
            by_name[joint] = own[0]
    if len(by_name) == n and len(set(by_name.values())) == n:
        return tuple(by_name[joint] for joint in joints)
    numbered: dict[int, str] = {}
    for name in names:
        digits = [word for word in _words(name) if word.isdigit()]
        if digits and int(digits[-1]) not in numbered:
            numbered[int(digits[-1])] = name
    for first in (1, 0):
        if all(k in numbered for k in range(first, first + n)):
            return tuple(numbered[k] for k in range(first, first + n))
    return tuple(names) if len(names) == n else None


def _contains(name: str, joint: str) -> bool:
    return (
        re.search(rf"(?<![a-z0-9]){re.escape(joint.lower())}(?![a-z0-9])", name.lower()) is not None
    )


def _unit(
    kind: str,
    columns: Mapping[str, tuple[str, ...]],
    table: Mapping[str, np.ndarray],
    robot: Robot,
    seconds: np.ndarray,
    units: Mapping[str, str | tuple[str, ...]],
) -> tuple[str | tuple[str, ...], str]:
    """Unit of a kind by the names, else by the values, and why."""
    names = [name for name in columns[kind] if name]
    stated = {_stated_unit(name) for name in names}
    if len(stated) == 1 and None not in stated:
        unit = str(stated.pop())
        told = f"; {FACTORS[unit]} in [signals.scale]" if unit in FACTORS else ""
        return unit, f"in {unit or 'SI'} by their names{told}"
    values = np.column_stack([table[name] for name in names])
    if kind in ("position", "link_position") and not robot.prismatic.any():
        unit, why = _angle_unit(values, robot)
        return _mixed(kind, columns, table, seconds, why) if unit == "deg" else (unit, why)
    if kind == "velocity" and not robot.prismatic.any():
        position = np.column_stack([table[name] for name in columns["position"]])
        return _speed_unit(values, position, seconds, units["position"])
    if kind == "torque":
        if any(set(_words(name)) & set(_CURRENT) for name in names):
            return "A", f"{FACTORS['A']} in [signals.scale]"
        most, allowed = float(np.nanmax(np.abs(values))), float(np.nanmax(robot.torque_max))
        if most > 30.0 * allowed:
            return (
                "mN*m",
                f"taken as mN m: they reach {most:.3g}, the drives {allowed:.3g} N m",
            )
    return "", "taken as SI"


def _speed_unit(
    values: np.ndarray, position: np.ndarray, seconds: np.ndarray, unit: str | tuple[str, ...]
) -> tuple[str, str]:
    """Unit of speeds (K, m) beside the change of positions (K, n), and why."""
    each = (unit,) * position.shape[1] if isinstance(unit, str) else unit
    found = _ratios(values, position, seconds)
    if all(name in _PER_RAD for name in each) and np.isfinite(found).any():
        found = found * [_PER_RAD[name] for name in each]
        ratio = max(float(np.nanmedian(found)), 1e-12)
        for name, factor in _PER_RAD_S.items():
            if abs(np.log(ratio / factor)) < _ALIKE:
                return name, f"in {name or 'rad/s'}, as the positions' change shows"
    return "", "taken as rad/s, which the positions' change does not show: check"


def _ratios(values: np.ndarray, position: np.ndarray, seconds: np.ndarray) -> np.ndarray:
    """Speeds (K, n) over the change of positions (n,); nan where nothing can be told."""
    new = np.flatnonzero(np.diff(seconds, prepend=-np.inf) > 0.0)
    if len(new) < _FEWEST or values.shape != position.shape:
        return np.full(position.shape[1], np.nan)
    turning = np.nanstd(np.gradient(position[new], seconds[new], axis=0), axis=0)
    moving = np.where(turning > 0.0, turning, np.nan)
    return np.asarray(np.nanstd(values[new], axis=0) / moving)


def _mixed(
    kind: str,
    columns: Mapping[str, tuple[str, ...]],
    table: Mapping[str, np.ndarray],
    seconds: np.ndarray,
    why: str,
) -> tuple[str | tuple[str, ...], str]:
    """Degrees for all joints, unless some are in rad beside them; why, and what is open."""
    names = [name for name in columns[kind] if name]
    values = np.column_stack([table[name] for name in names])
    reach = np.nanmax(np.abs(values), axis=0)
    small = (reach <= np.pi) & (reach > 0.0) & (_MIXED * reach < np.max(reach))
    if not small.any() or len(names) < len(columns[kind]):
        return "deg", why
    told = ", ".join(name for name, own in zip(names, small, strict=True) if own)
    if "velocity" in columns and all(columns["velocity"]):
        speeds = np.column_stack([table[name] for name in columns["velocity"]])
        ratio = _ratios(speeds, values, seconds)
        apart = np.log(ratio / np.nanmedian(ratio[~small])) - np.log(_PER_RAD["deg"])
        rad = small & (np.abs(apart) < _ALIKE)
        if rad.any():
            own = ", ".join(name for name, each in zip(names, rad, strict=True) if each)
            each = tuple("" if one else "deg" for one in rad)
            return each, f"{why}; but {own} in rad, as their velocities show"
    scale = ", ".join("1.0" if own else '"deg"' for own in small)
    return "deg", (
        f"{why}. QUESTION: {told} reach no more than {np.max(reach[small]):.3g}: in rad? Then write"
        f" {kind} = [{scale}] in [signals.scale], and the velocity likewise"
    )


def _angle_unit(values: np.ndarray, robot: Robot) -> tuple[str, str]:
    most = float(np.nanmax(np.abs(values)))
    low, high = robot.position_lower, robot.position_upper
    finite = np.isfinite(high - low) & (np.arange(robot.n) < values.shape[1])
    beyond = bool(
        np.any(np.nanmax(values, axis=0)[finite] > high[finite] + 0.1)
        or np.any(np.nanmin(values, axis=0)[finite] < low[finite] - 0.1)
    )
    if most > np.degrees(_MOST_TURNS):
        return "counts", f"they reach {most:.4g}, {FACTORS['counts']} in [signals.scale]"
    if most > 4.0 * np.pi or (beyond and most > np.pi):
        return "deg", f"in deg: they reach {most:.4g}, beyond what rad would be"
    return "", f"in rad: they reach {most:.3g}"
