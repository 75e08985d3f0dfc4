"""Names of columns that say what an arm was told to do, not what it did."""

from __future__ import annotations

import itertools
import re

_WORDS = ("target", "cmd", "command", "desired", "planned", "soll", "setpoint", "consigne",
          "consigna", "riferimento", "action")  # fmt: skip
# Of these longer words begin: commanded, setpoints; Sollposition, and not the town of Solleck.
_BEGINNINGS = ("target", "command", "desired", "setpoint", "consign")
_SOLL = r"soll(wert|pos|winkel|lage|stell|dreh|achs|gelenk|bahn|weg)"
# Quantities, with which short words stand together or in one: qref1, pos_set, des_angle.
_SYMBOLS = ("q", "theta", "phi", "pos", "position", "positions", "angle", "angles")
_AXES = ("axis", "joint", "jnt", "j", "ax", "achse")
_SHORT = ("soll", "target", "cmd", "des", "ref", "reference", "set")
_GLUED = rf"({'|'.join((*_SYMBOLS, *_AXES[:3]))})({'|'.join(_SHORT)})"
_UNITS = ("deg", "rad", "grad", "m", "mm")
_REFERENCES = ("ref", "reference")
# Shorter words before "des" are no noun whose genitive follows.
_NOUN = 4


def is_set_point(name: str) -> bool:
    """Whether a column's name is that of a set point: "q_cmd_1", "Sollposition A1 [Grad]"."""
    words = _words(name)
    letters = [word for word in words if word.isalpha()]
    return (
        any(word in _WORDS or word.startswith(_BEGINNINGS) for word in letters)
        or any(re.match(_SOLL, word) or re.fullmatch(_GLUED, word) for word in letters)
        or _desired(words)
        or _set(letters, spaced=" " in name.strip())
        or _of_reference_alone(letters, spaced=" " in name.strip())
    )


def may_be_set_point(name: str) -> bool:
    """Whether it is one, or speaks of a reference, which may be a mark or a frame as well."""
    return is_set_point(name) or bool(set(_words(name)) & set(_REFERENCES))


def _words(name: str) -> list[str]:
    """Words in small letters, and numbers between them."""
    # QTarget, jointAngle, QSOLL1; a word of capitals stays one.
    apart = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", name)
    return re.findall(r"[a-z]+|\d+", apart.lower())


def _desired(words: list[str]) -> bool:
    """Whether "des" is short for desired: no genitive, as in "Winkel_des_Gelenks_1"."""
    for k, word in enumerate(words):
        if word != "des":
            continue
        after = words[k + 1] if k + 1 < len(words) else ""
        beside = not after.isalpha() or after in (*_SYMBOLS, *_AXES, *_UNITS)
        if beside or k == 0 or len(words[k - 1]) < _NOUN:
            return True
    return False


def _set(letters: list[str], *, spaced: bool) -> bool:
    """Whether "set" is said of a position: "set_pos_1", "AXIS_SET1", no "data_set_1"."""
    pairs = list(itertools.pairwise(letters))
    before = any(one == "set" and two in ("point", "points", *_SYMBOLS[1:]) for one, two in pairs)
    last = [word for word in letters if word not in _UNITS][-2:]
    return before or (not spaced and last[-1:] == ["set"] and last[0] in (*_SYMBOLS, *_AXES))


def _of_reference_alone(letters: list[str], *, spaced: bool) -> bool:
    """Whether a reference of a quantity is all that is named: "q_ref_1", no "encoder_ref_1"."""
    rest = [word for word in letters if word not in (*_REFERENCES, *_UNITS)]
    referred = any(word in _REFERENCES for word in letters)
    return referred and not spaced and bool(rest) and all(word in _SYMBOLS for word in rest)
