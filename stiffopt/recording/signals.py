"""Columns and units of the signals in run files; names of set points."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from stiffopt.errors import InputFileError, UnitError
from stiffopt.recording.schema import ScaleSection, SignalsSection
from stiffopt.units import joint_to_si

Kind = Literal["position", "velocity", "link_position", "torque", "command"]
KINDS: tuple[Kind, ...] = ("position", "velocity", "link_position", "torque", "command")
_SIGNAL_DIMENSIONS = {
    "time": "time",
    "position": "angle",
    "velocity": "angular velocity",
    "link_position": "angle",
    "torque": "torque",
    "command": "angle",
}


@dataclass(frozen=True, kw_only=True)
class Signals:
    """Column names of a recording set, one a joint; "" where a joint lacks that signal.

    In a file of messages a name consists of the topic and a field of its messages:
    "/joint_states.position[2]", or "/joint_states.position[elbow]" where messages name entries.
    """

    time: str
    # position and torque: (n,).
    position: tuple[str, ...]
    # velocity, link_position and command: (n,).
    velocity: tuple[str, ...] | None
    link_position: tuple[str, ...] | None
    torque: tuple[str, ...]
    # "motor": before friction, from current; "link": a joint torque sensor.
    torque_side: Literal["motor", "link"] = "motor"
    # By kind of signal (n,), of "time" to a number: factors of columns to SI; absent where they are
    # in SI.
    scale: Mapping[str, np.ndarray] = field(default_factory=dict)
    torque_delay: float = 0.0  # delay of recorded torques after positions [s]
    # (n,) joint (from 1) whose position is contained in that of each; negative where subtracted, 0
    # for none.
    includes: tuple[int, ...] = ()
    offset: np.ndarray | None = None  # (n,) added to positions [rad]
    at_rest: bool | None = None  # each row is a pose at rest; None where not stated
    # (n,) unit of torques without a factor to N m, such as "A"; "" where it has one.
    torque_units: tuple[str, ...] = ()
    command: tuple[str, ...] | None = None

    @property
    def commanded(self) -> bool:
        """True where torques are to be derived from commands, as none is recorded."""
        return self.command is not None and not any(self.torque)

    @property
    def unscaled_joints(self) -> tuple[int, ...]:
        """Joints (from 0) whose torques have no factor to N m, as currents."""
        return tuple(joint for joint, unit in enumerate(self.torque_units) if unit)

    @property
    def unscaled(self) -> bool:
        """True where a torque has no factor to N m."""
        return any(self.torque_units)

    @property
    def partly_unscaled(self) -> bool:
        """True where some torques have no factor to N m, but not all."""
        return 0 < len(self.unscaled_joints) < sum(map(bool, self.torque))

    def scale_of(self, kind: str, n: int) -> np.ndarray:
        """Factors (n,) of the columns of a kind to SI."""
        return np.asarray(self.scale.get(kind, np.ones(n)))

    def to_si(self, columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Convert columns of a file to SI and remove the delay of torques."""
        out = dict(columns)
        if "time" in self.scale:
            out[self.time] = out[self.time] * float(self.scale["time"])
        for kind, joint, name in self.columns():
            if kind in self.scale:
                out[name] = out[name] * self.scale[kind][joint]
            if kind == "torque" and self.torque_delay:
                out[name] = _shift_earlier(out[self.time], out[name], self.torque_delay)
        self._separate_sums(out, -1.0)
        for name, offset in self._offset_columns():
            if name in out:
                out[name] = out[name] + offset
        return out

    def _offset_columns(self) -> Iterator[tuple[str, float]]:
        """Iterate over the columns of positions and commands with their offsets."""
        if self.offset is not None:
            for names in (self.position, self.command or ()):
                yield from zip(names, self.offset, strict=False)

    def _separate_sums(self, columns: dict[str, np.ndarray], sign: float) -> None:
        """Add (1) to positions, or take from them (-1), those of joints that they include."""
        for kind in ("position", "velocity", "command"):
            names = getattr(self, kind) or ("",) * len(self.includes)
            found = {
                name: columns[name] + sign * np.sign(other) * columns[names[abs(other) - 1]]
                for name, other in zip(names, self.includes or (0,) * len(names), strict=True)
                if other and {name, names[abs(other) - 1]} <= columns.keys()
            }
            columns |= found

    def as_recorded(self, columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Convert columns in SI to units and delay of the files, the inverse of `to_si`."""
        out = dict(columns)
        for name, offset in self._offset_columns():
            if name in out:
                out[name] = out[name] - offset
        self._separate_sums(out, 1.0)
        for kind, joint, name in self.columns():
            if name not in out:
                continue
            if kind == "torque" and self.torque_delay and self.time in out:
                out[name] = np.interp(out[self.time] - self.torque_delay, out[self.time], out[name])
            if kind in self.scale:
                out[name] = out[name] / self.scale[kind][joint]
        if "time" in self.scale and self.time in out:
            out[self.time] = out[self.time] / float(self.scale["time"])
        return out

    def of(self, kind: Kind) -> tuple[str, ...] | None:
        """Column names of one kind of channel."""
        names: tuple[str, ...] | None = getattr(self, kind)
        return names

    def columns(self) -> Iterator[tuple[Kind, int, str]]:
        """Iterate over kind, joint (from 0) and column name of every recorded channel."""
        for kind in KINDS:
            for joint, name in enumerate(self.of(kind) or ()):
                if name:
                    yield kind, joint, name

    @property
    def wanted(self) -> tuple[str, ...]:
        """Column names of all channels, without that of the time."""
        return tuple(name for _, _, name in self.columns())


def build_signals(section: SignalsSection, n: int, path: Path) -> Signals:
    """Build and check column names: one per joint, each used once, all positions, some torque."""

    def fail(key: str, reason: str) -> InputFileError:
        return InputFileError(path, f"signals.{key}", reason)

    used: dict[str, str] = {section.time: "time"} if section.time else {}
    for kind in KINDS:
        names = getattr(section, kind)
        for joint, name in enumerate(names or ()):
            if name and name in used:
                raise fail(kind, f"the column {name!r} is already used for {used[name]}.")
            used[name] = f"{kind} of joint {joint + 1}"
        if names is not None and len(names) != n:
            raise fail(
                kind,
                f'needs one column a joint ({n}), got {len(names)}; "" where a joint lacks it.',
            )
    if not all(section.position):
        raise fail("position", "every joint needs a position; leave other joints out of `joints`.")
    torque = section.torque or ("",) * n
    if not any(torque) and not any(section.command or ()):
        raise fail(
            "torque",
            "no joint has a torque or a command, and positions alone do not tell what moved the"
            " arm. Name the columns of torques (or currents) as torque, or those of commanded"
            " positions as command.",
        )
    for key in ("offset", "position_includes"):
        given = getattr(section, key)
        if given is not None and len(given) != n:
            raise fail(key, f"needs one number a joint ({n}), got {len(given)}; 0 for none.")
    includes = section.position_includes or ()
    for joint, other in enumerate(includes, start=1):
        if other and (abs(other) > n or abs(other) == joint or includes[abs(other) - 1]):
            raise fail(
                "position_includes",
                f"joint {joint} cannot contain joint {abs(other)}: give another joint of 1 to {n}"
                " that contains none itself, or 0.",
            )
    return Signals(
        time=section.time,
        position=section.position,
        velocity=_none_if_unnamed(section.velocity),
        link_position=_none_if_unnamed(section.link_position),
        torque=torque,
        torque_side=section.torque_side or "motor",
        scale=_scale_factors(section.scale, n, path),
        torque_delay=section.torque_delay,
        includes=includes,
        offset=None if section.offset is None else np.array(section.offset, dtype=float),
        at_rest=section.at_rest,
        torque_units=_unscaled_units(section, n),
        command=_none_if_unnamed(section.command),
    )


_COUNTS_UNIT = "counts"
# Torques in these units are read as they are, but a diagnosis needs N m per unit first.
_UNITS_WITHOUT_FACTOR = ("A", "mA", "%", _COUNTS_UNIT)


def _unscaled_units(section: SignalsSection, n: int) -> tuple[str, ...]:
    entries = _entry_list(section.scale.torque)
    each = entries * n if len(entries) == 1 else entries
    return tuple(
        str(entry) if name and entry in _UNITS_WITHOUT_FACTOR else ""
        for entry, name in zip(each, section.torque or (), strict=False)
    )


def _scale_factors(section: ScaleSection, n: int, path: Path) -> dict[str, np.ndarray]:
    """Factors to SI of the section's entries, which are numbers or names of units."""
    factors: dict[str, np.ndarray] = {}
    for kind, dimension in _SIGNAL_DIMENSIONS.items():
        entry = getattr(section, kind)
        if entry is None and kind == "command":
            # Commands are logged in the unit of positions unless stated.
            entry = section.position
        if entry is None:
            continue
        where = f"signals.scale.{kind}"
        count = 1 if kind == "time" else n
        values = [
            1.0
            if kind == "torque" and one in _UNITS_WITHOUT_FACTOR
            else unit_factor(one, dimension, path, where)
            for one in entries_of_columns(entry, count, path, where)
        ]
        factors[kind] = np.array(values[0] if kind == "time" else values)
    return factors


def _entry_list(entry: Any) -> list[float | str]:
    if entry is None:
        return []
    return list(entry) if isinstance(entry, tuple) else [entry]


def entries_of_columns(entry: Any, count: int, path: Path, where: str) -> list[float | str]:
    """Return the entries of `count` columns: one holds for all, a list has one a column."""
    entries = _entry_list(entry)
    if not isinstance(entry, tuple):
        entries = entries * count
    if len(entries) != count:
        raise InputFileError(
            path, where, f"needs one entry, or one a column ({count}), got {len(entries)}."
        )
    return entries


_COUNTS_HINT = (
    "is in counts of an encoder, whose angle is not known. Put 2 pi over the counts of a turn of"
    " the joint, one number a joint (4096 counts: 0.001533981), and the angle at count 0 as"
    " offset in [signals], one a joint (-3.14159 where count 2048 is zero)."
)


def unit_factor(
    entry: float | str,
    dimension: str,
    path: Path,
    where: str,
    convert: Callable[[str, str], float] = joint_to_si,
) -> float:
    """Return the factor to SI of a number or the name of a unit; `convert` tells that of a text."""
    if entry == _COUNTS_UNIT and dimension.startswith("ang"):
        raise InputFileError(path, where, _COUNTS_HINT)
    try:
        value = convert(f"1 {entry}", dimension) if isinstance(entry, str) else entry
    except UnitError as error:
        told = f"{error} Where no unit fits, give the number that one of it is in SI."
        raise InputFileError(path, where, told) from None
    if not value or not np.isfinite(value):
        raise InputFileError(path, where, f"got {entry}; a factor is finite and not 0.")
    return float(value)


def _shift_earlier(time: np.ndarray, values: np.ndarray, delay: float) -> np.ndarray:
    """Interpolate values recorded `delay` [s] later; NaN beyond the end of the recording."""
    known = np.isfinite(time) & np.isfinite(values)
    if known.sum() < 2:
        return values
    later = np.interp(time + delay, time[known], values[known], left=np.nan, right=np.nan)
    return np.asarray(later)


def _none_if_unnamed(names: tuple[str, ...] | None) -> tuple[str, ...] | None:
    return names if names is not None and any(names) else None


_SET_POINT_WORDS = ("target", "cmd", "command", "desired", "planned", "soll", "setpoint",
          "consigne", "consigna", "riferimento", "action", "actions", "goal", "leader",
          "ctrl", "control")  # fmt: skip
# Prefixes of longer words: commanded, setpoints.
_SET_POINT_PREFIXES = ("target", "command", "desired", "setpoint", "consign")
_SOLL_PATTERN = r"soll(wert|pos|winkel|lage|stell|dreh|achs|gelenk|bahn|weg)"
# Quantities with which short words are combined: qref1, pos_set, des_angle.
_QUANTITY_WORDS = ("q", "theta", "phi", "pos", "position", "positions", "angle", "angles")
_AXIS_WORDS = ("axis", "joint", "jnt", "j", "ax", "achse")
_SHORT_WORDS = ("soll", "target", "cmd", "des", "ref", "reference", "set")
_COMPOUND_PATTERN = rf"({'|'.join((*_QUANTITY_WORDS, *_AXIS_WORDS[:3]))})({'|'.join(_SHORT_WORDS)})"
_UNIT_WORDS = ("deg", "rad", "grad", "m", "mm")
_REFERENCE_WORDS = ("ref", "reference")
_DESIRED_QUANTITIES = (*_QUANTITY_WORDS, "dq", "qd", "ddq", "qdd", "tau", "j", "vel", "torque")


def is_set_point(name: str) -> bool:
    """Return whether a column name is that of a set point: "q_cmd_1", "Sollposition A1"."""
    words = _split_words(name)
    letters = [word for word in words if word.isalpha()]
    return (
        _has_desired_suffix(words)
        or any(word in _SET_POINT_WORDS or word.startswith(_SET_POINT_PREFIXES) for word in letters)
        or any(
            re.match(_SOLL_PATTERN, word) or re.fullmatch(_COMPOUND_PATTERN, word)
            for word in letters
        )
        or _has_desired(words)
        or _has_set(letters, spaced=" " in name.strip())
        or _is_quantity_reference(letters, spaced=" " in name.strip())
    )


def may_be_set_point(name: str) -> bool:
    """Return whether a column name is that of a set point or contains "ref"."""
    return is_set_point(name) or bool(set(_split_words(name)) & set(_REFERENCE_WORDS))


def _split_words(name: str) -> list[str]:
    """Split a name into lower-case words and numbers."""
    # QTarget, jointAngle; a word of capitals such as QSOLL1 stays whole.
    apart = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", name)
    return re.findall(r"[a-z]+|\d+", apart.lower())


def _has_desired_suffix(words: list[str]) -> bool:
    """Return whether "d" stands for "desired" after a quantity: "q_d[0]", "tau_J_d"."""
    return any(two == "d" and one in _DESIRED_QUANTITIES for one, two in itertools.pairwise(words))


def _has_desired(words: list[str]) -> bool:
    """Return whether "des" abbreviates "desired", unlike in "Winkel_des_Gelenks_1"."""
    for k, word in enumerate(words):
        if word != "des":
            continue
        after = words[k + 1] if k + 1 < len(words) else ""
        beside = not after.isalpha() or after in (*_QUANTITY_WORDS, *_AXIS_WORDS, *_UNIT_WORDS)
        # Shorter words before "des" are no German noun followed by a genitive.
        if beside or k == 0 or len(words[k - 1]) < 4:
            return True
    return False


def _has_set(letters: list[str], *, spaced: bool) -> bool:
    """Return whether "set" refers to a position: "set_pos_1", "AXIS_SET1", not "data_set_1"."""
    pairs = list(itertools.pairwise(letters))
    before = any(
        one == "set" and two in ("point", "points", *_QUANTITY_WORDS[1:]) for one, two in pairs
    )
    last = [word for word in letters if word not in _UNIT_WORDS][-2:]
    return before or (
        not spaced and last[-1:] == ["set"] and last[0] in (*_QUANTITY_WORDS, *_AXIS_WORDS)
    )


def _is_quantity_reference(letters: list[str], *, spaced: bool) -> bool:
    """Return whether only a quantity and "ref" are named: "q_ref_1", not "encoder_ref_1"."""
    rest = [word for word in letters if word not in (*_REFERENCE_WORDS, *_UNIT_WORDS)]
    referred = any(word in _REFERENCE_WORDS for word in letters)
    return referred and not spaced and bool(rest) and all(word in _QUANTITY_WORDS for word in rest)
