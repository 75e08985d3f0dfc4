"""Signal kinds of columns by their names, and columns grouped by joint."""

from __future__ import annotations

import re
from collections.abc import Sequence

from stiffopt.recording.signals import is_set_point, may_be_set_point
from stiffopt.recording.stated_units import BRACKET_PATTERN, bracketed_unit

KINDS = ("velocity", "torque", "link_position", "position")
# Words of each kind, in order of precedence; names are split at other characters than letters and
# digits.
_WORDS_BY_KIND = {
    "velocity": ("velocity", "velocities", "vel", "speed", "qd", "dq", "omega", "geschwindigkeit",
                 "drehzahl", "speeds", "velo", "qvel"),
    "torque": (
        "torque", "torques", "tau", "trq", "moment", "effort", "drehmoment", "current", "currents",
        "strom", "amps", "tq", "load", "qfrc",
    ),
    "link_position": ("link", "linkside", "ql", "secondary", "outputside"),
    "position": ("position", "positions", "pos", "q", "angle", "angles", "theta", "winkel", "lage",
                 "ist", "qpos", "axis", "joint", "a", "j", "state", "present", "actual",
                 "measured"),
}  # fmt: skip
TIME_WORDS = ("t", "time", "timestamp", "stamp", "zeit", "seconds", "clock")
CURRENT_WORDS = ("current", "currents", "strom", "amps", "i")
# Words that other signals of a joint share.
_VAGUE_WORDS = ("axis", "joint", "a", "j", "state", "present", "actual", "measured")
_AMPERE_UNITS = ("a", "ma", "arms")
_ACCELERATION_WORDS = ("acceleration", "accelerations", "accel", "acc", "qdd", "ddq")
# With shares of a torque that models or observers compute; names of MuJoCo and libfranka.
_OTHER_SIGNAL_WORDS = (
    *_ACCELERATION_WORDS, "temperature", "temp", "temperatur", "temperatures", "voltage",
    "voltages", "mode", "status", "error", "err", "ext", "external", "gravity",
    "coriolis", "bias", "passive", "constraint", "applied", "contact", "enable", "enabled",
)  # fmt: skip
# Words that make a kind together.
_PAIRS_BY_KIND = {"torque": (("actuator", "force"), ("actuator", "forces"))}
_UNITS_BY_KIND = {
    "position": ("deg", "degree", "degrees", "°", "grad", "rad", "mrad", "rev", "revs", "turns"),
    "velocity": ("deg/s", "°/s", "rad/s", "mrad/s", "rpm", "1/min", "min-1", "u/min"),
    "torque": ("nm", "n m", "n*m", "n.m", "n·m", "mnm", "knm", "ncm", *_AMPERE_UNITS),
}
_WORD_PATTERN = re.compile(r"[a-zµ°]+|\d+")


def columns_of_kind(
    names: Sequence[str], kind: str, joints: Sequence[str]
) -> list[tuple[str, ...]]:
    """Return the columns of a kind, one a joint, for each matching family, the best first."""
    fitting = [name for name in names if _is_kind(name, kind)]
    # i1, i2, ... are currents if there is no torque.
    short = [n for n in names if kind == "torque" and split_words(n)[:1] == ["i"]]
    # Names in other languages are recognised by their units.
    foreign = [n for n in names if _kind_by_unit(n) == kind]
    measured = [[n for n in every if not may_be_set_point(n)] for every in (fitting, foreign)]
    # Measured torque takes precedence over current.
    torques = [[n for n in every if not _is_current(n)] for every in measured]
    plain = [
        n for n in torques[0] if set(split_words(n)) & set(_WORDS_BY_KIND[kind]) - set(_VAGUE_WORDS)
    ]
    for candidates in (plain, *torques, measured[0], fitting, short, measured[1], foreign):
        found = _column_families(candidates, joints)
        if found:
            return found
    return []


def command_columns(names: Sequence[str], joints: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the columns of commanded positions, one a joint, for each family, the best first."""
    found = [
        name
        for name in names
        if is_set_point(name) and not any(_is_kind(name, kind) for kind in ("velocity", "torque"))
    ]
    of_positions = [name for name in found if _is_kind(name, "position")]
    for candidates in (of_positions, found):
        if families := _column_families(candidates, joints):
            return families
    return []


def acceleration_columns(names: Sequence[str], joints: Sequence[str]) -> tuple[str, ...]:
    """Return the columns of accelerations, one a joint; none unless all joints have one."""
    fitting = [name for name in names if set(split_words(name)) & set(_ACCELERATION_WORDS)]
    found = _column_families(fitting, joints)
    return found[0] if found and all(found[0]) else ()


def split_words(name: str) -> list[str]:
    """Split a column name into words without its unit: "Actual_Q_0 [rad]" to actual, q, 0."""
    bare = BRACKET_PATTERN.sub("", name) if bracketed_unit(name) else name
    bare = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", bare)
    return _WORD_PATTERN.findall(bare.lower())


def _is_current(name: str) -> bool:
    return (
        bool(set(split_words(name)) & set(CURRENT_WORDS)) or bracketed_unit(name) in _AMPERE_UNITS
    )


def _column_families(names: Sequence[str], joints: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the columns, one a joint, of each family whose names differ by the joint only."""
    families: dict[tuple[str, ...], list[str]] = {}
    for name in names:
        bare = name
        for joint in joints:
            bare = re.sub(_word_pattern(joint), " ", bare, flags=re.IGNORECASE)
        family = split_words(bare)
        digits = [k for k, word in enumerate(family) if word.isdigit()]
        if digits:
            del family[digits[-1]]
        families.setdefault((*family, bracketed_unit(bare)), []).append(name)
    found = [order_by_joint(own, joints) for own in families.values()]
    fitting = [each for each in found if each is not None]
    # Families that lack joints are combined if they complete each other.
    together = None if fitting else order_by_joint(names, joints)
    return fitting if together is None else [together]


def is_signal(name: str) -> bool:
    """Return True if a column name is that of a joint signal."""
    return any(_is_kind(name, kind) for kind in KINDS)


def _is_kind(name: str, kind: str) -> bool:
    said = set(split_words(name))
    if said & set(_OTHER_SIGNAL_WORDS):
        return False
    if kind == "torque" and said & set(CURRENT_WORDS) - {"i"}:
        return True
    measured = _kind_by_unit(name)
    if measured is not None and measured != kind.removeprefix("link_"):
        return False  # "axis 1 [Nm]"
    for other, pairs in _PAIRS_BY_KIND.items():
        if any(said >= set(pair) for pair in pairs):
            return other == kind
    for other in KINDS:
        if said & set(_WORDS_BY_KIND[other]):
            return other == kind
    return False


def _kind_by_unit(name: str) -> str | None:
    """Return the kind by the unit in brackets: "Achswinkel 1 [°]" is a position."""
    unit = bracketed_unit(name)
    if set(split_words(name)) & set(_OTHER_SIGNAL_WORDS):
        return None
    return next((kind for kind, own in _UNITS_BY_KIND.items() if unit in own), None)


def order_by_joint(names: Sequence[str], joints: Sequence[str]) -> tuple[str, ...] | None:
    """Order columns by joint names in them, else by their last number, from 0 or 1."""
    n = len(joints)
    by_name = {}
    for joint in joints:
        own = [name for name in names if re.search(_word_pattern(joint), name, flags=re.IGNORECASE)]
        if len(own) == 1:
            by_name[joint] = own[0]
    if len(by_name) == n and len(set(by_name.values())) == n:
        return tuple(by_name[joint] for joint in joints)
    numbered: dict[int, str] = {}
    for name in names:
        digits = [word for word in split_words(name) if word.isdigit()]
        if digits and int(digits[-1]) not in numbered:
            numbered[int(digits[-1])] = name
    # Joints are counted from 0 where a column is: what follows them is a gripper.
    first = 0 if 0 in numbered else 1
    if all(k in numbered for k in range(first, first + n)):
        return tuple(numbered[k] for k in range(first, first + n))
    return tuple(names) if len(names) == n else None


def _word_pattern(joint: str) -> str:
    """Return the pattern of a joint name as a whole word."""
    return rf"(?<![a-zA-Z0-9]){re.escape(joint)}(?![a-zA-Z0-9])"
