"""Names of columns that say what an arm was told to do, not what it did."""

from __future__ import annotations

import itertools
import re

_WORDS = ("target", "cmd", "command", "desired", "des", "soll", "ref", "reference", "setpoint",
          "sollwert", "consigne", "consigna", "riferimento")  # fmt: skip
# Of these longer words begin: commanded, Sollposition, setpoints.
_BEGINNINGS = ("target", "command", "desired", "soll", "setpoint", "consign")


def is_set_point(name: str) -> bool:
    """Whether a column's name is that of a set point: "q_cmd_1", "Sollposition A1 [Grad]"."""
    words = re.findall(r"[a-z]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower())
    if " " in name.strip():
        # "Winkel des Gelenks 1" is no desired one.
        words = [word for word in words if word != "des"]
    words += [one + two for one, two in itertools.pairwise(words) if (one, two) == ("set", "point")]
    return any(word in _WORDS or word.startswith(_BEGINNINGS) for word in words)
