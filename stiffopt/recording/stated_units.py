"""Units that names of columns state: "q1 [deg]", "q1_deg"."""

from __future__ import annotations

import re

# Names of loggers and their names in `[signals.scale]`; "" is SI. "A", "%" and "counts" need a
# factor from the user.
UNITS = {
    "deg": "deg", "degree": "deg", "degrees": "deg", "°": "deg", "grad": "deg", "rad": "",
    "mrad": "mrad", "rev": "turn", "revs": "turn", "turn": "turn", "turns": "turn", "u": "turn",
    "deg/s": "deg/s", "°/s": "deg/s", "rad/s": "", "mrad/s": "mrad/s", "rpm": "rpm",
    "1/min": "rpm", "min-1": "rpm", "u/min": "rpm", "nm": "", "n m": "", "n*m": "", "n.m": "",
    "n-m": "", "n·m": "", "mnm": "mN*m", "knm": "kN*m", "ncm": "N*cm", "a": "A", "ma": "mA",
    "arms": "A", "%": "%", "percent": "%", "inc": "counts", "incs": "counts", "cts": "counts",
    "counts": "counts", "ticks": "counts", "ms": "ms", "msec": "ms", "us": "us", "µs": "us",
    "ns": "ns", "s": "", "sec": "", "m": "", "mm": "mm", "cm": "cm", "mm/s": "mm/s", "m/s": "",
    "um": "um", "µm": "um", "μm": "um", "n": "", "kn": "kN", "-": "",
}  # fmt: skip
BRACKET_PATTERN = re.compile(r"[\[(]\s*([^\])]+)\s*[\])](?=\s*\d*\s*$)")
# Content of brackets that is an entry of a vector, not a unit: q[0], position[elbow].
_ENTRY_PATTERN = re.compile(r"\d+|[A-Za-z_][\w.\- ]{2,}")
_SUFFIX_UNITS = (
    "deg", "rad", "mrad", "nm", "mnm", "ms", "us", "ns", "rpm", "mm", "um", "kn", "%", "counts",
    "percent",
)  # fmt: skip


def stated_unit(name: str) -> str | None:
    """Return the unit in brackets or as the last word: "q1 [deg]", "q1_deg"; None without."""
    if unit := bracketed_unit(name):
        return UNITS.get(unit)
    last = re.split(r"[_\s]", name.strip().lower())[-1]
    return UNITS[last] if last in _SUFFIX_UNITS else None


def bracketed_unit(name: str) -> str:
    """Return the unit in the brackets of a name, "" without."""
    found = BRACKET_PATTERN.search(name)
    unit = "" if found is None else found[1].strip().lower()
    return unit if unit in UNITS or not _ENTRY_PATTERN.fullmatch(unit) else ""
