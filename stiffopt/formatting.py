"""Formatting of quantities with unit and standard deviation, and of lists, for sentences.

Values are SI.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

DASH = "–"
# Units requested by name, alone or before a slash, in SI.
_UNIT_FACTORS = {
    "kN": 1e3,
    "MPa": 1e6,
    "mm": 1e-3,
    "µm": 1e-6,
    "mrad": 1e-3,
    "deg": math.pi / 180.0,
    "min": 60.0,
}
# Prefixes of SI units: the first row whose least magnitude is reached applies.
_UNIT_SCALES: dict[str, tuple[tuple[float, float, str], ...]] = {
    "m": ((0.5, 1.0, "m"), (5e-5, 1e-3, "mm"), (0.0, 1e-6, "µm")),
    "rad": ((0.5, 1.0, "rad"), (5e-4, 1e-3, "mrad"), (0.0, 1e-6, "µrad")),
    "s": ((0.1, 1.0, "s"), (0.0, 1e-3, "ms")),
    "rad/(N m)": (
        (0.5, 1.0, "rad/(N m)"),
        (5e-4, 1e-3, "mrad/(N m)"),
        (0.0, 1e-6, "µrad/(N m)"),
    ),
    "m/N": ((0.5, 1.0, "m/N"), (5e-4, 1e-3, "mm/N"), (0.0, 1e-6, "µm/N")),
}
# Least number written in the smallest unit of a scale: a nanometre, a microsecond.
_MIN_SCALED_VALUE = 1e-3


def scale(largest: float, unit: str) -> tuple[float, str]:
    """Return the factor from SI and the unit that suits a value's magnitude.

    >>> scale(3e-4, "m"), scale(20.0, "kN"), scale(0.2, "mm/s"), scale(0.2, "N m")
    ((1000.0, 'mm'), (0.001, 'kN'), (1000.0, 'mm/s'), (1.0, 'N m'))
    """
    base = unit.partition("/")[0]
    if base in _UNIT_FACTORS:
        return 1.0 / _UNIT_FACTORS[base], unit
    for least, size, name in _UNIT_SCALES.get(unit, ()):
        if abs(largest) >= least:
            return 1.0 / size, name
    return 1.0, unit


def si(value: float | None, unit: str, digits: int = 4) -> str:
    """Format a value [SI] with a unit that suits its magnitude; a dash for None.

    >>> si(2.97e-4, "m"), si(9100.0, "N m/rad"), si(7812.0, "kN", 3), si(None, "m")
    ('0.297 mm', '9100 N m/rad', '7.81 kN', '–')
    >>> si(6.99e-11, "m")
    'below 0.001 µm'
    """
    if value is None or not math.isfinite(value):
        return DASH
    factor, name = scale(value, unit)
    size = abs(factor * value)
    if unit in _UNIT_SCALES and 0.0 < size < _MIN_SCALED_VALUE:
        # Smaller than any measurable quantity of an arm.
        return f"below {_MIN_SCALED_VALUE:g} {name}"
    return f"{significant(factor * value, digits)} {name}".strip()


def pm(value: float, sd: float, unit: str) -> str:
    """Format a value with its standard deviation, in one unit and with the same decimals.

    >>> pm(6.2134, 0.1312, "N m"), pm(3.2e-4, 2e-6, "rad")
    ('6.21 ± 0.13 N m', '320 ± 2 µrad')
    """
    factor, name = scale(value, unit)
    value, sd = factor * value, factor * sd
    if not (math.isfinite(sd) and sd > 0.0):
        return f"{significant(value, 3)} {name}".strip()
    digits = 2 if f"{sd:.1e}"[0] == "1" else 1
    places = digits - 1 - math.floor(math.log10(sd))
    if not -3 <= places <= 6:
        return f"{significant(value, 3)} ± {significant(sd, 2)} {name}".strip()
    # Plus zero: no minus before a value that rounds to zero.
    shown = [f"{round(v, places) + 0.0:.{max(places, 0)}f}" for v in (value, sd)]
    return f"{shown[0]} ± {shown[1]} {name}".strip()


def significant(value: float | None, digits: int = 4) -> str:
    """Format a number with significant digits; no exponent between 1e-4 and 1e7.

    >>> significant(12345.678), significant(0.00123456), significant(0.0)
    ('12350', '0.001235', '0')
    """
    if value is None or not math.isfinite(value):
        return DASH
    if value == 0:
        return "0"
    size = math.floor(math.log10(abs(value)))
    if not -5 < size < 7:
        return f"{value:.{digits - 1}e}"
    rounded = round(value, digits - 1 - size)
    text = f"{rounded:.{max(digits - 1 - size, 0)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def listed(items: Iterable[str]) -> str:
    """Join with commas and an "and".

    >>> listed(["slip", "head pressure", "stiffness"]), listed(["slip"]), listed([])
    ('slip, head pressure and stiffness', 'slip', '')
    """
    every = list(items)
    return f"{', '.join(every[:-1])} and {every[-1]}" if len(every) > 1 else "".join(every)


def capital(text: str) -> str:
    """Capitalise the first letter only."""
    return text[:1].upper() + text[1:]
