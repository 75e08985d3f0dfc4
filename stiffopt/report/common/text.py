"""Formatting of numbers with units and of lists, for sentences, the terminal and pages.

Values are SI. The functions are also the filters of the templates: `{{ length | si("mm", 3) }}`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

from markupsafe import Markup

from stiffopt.errors import format_factor, is_factor
from stiffopt.units import joint_unit

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
UNCHANGED = 5e-5  # relative change that is written as 0 %


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


def number(value: float, unit: str, digits: int = 4) -> str:
    """Format a value [SI] without its unit, which the column heading has.

    >>> number(0.0123, "mm")
    '12.3'
    """
    return significant(scale(value, unit)[0] * value, digits)


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


def decades(value: float | None, digits: int = 3) -> str:
    """Format a number such as 2.67e5, for columns that span decades."""
    if value is None:
        return DASH
    mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
    return f"{mantissa}e{int(exponent)}"


def whole(number: int) -> str:
    """Format an integer with thin spaces; from 1e12 on as a power of ten."""
    return f"{number:,}".replace(",", "\u202f") if number < 10**12 else f"{number:.2e}"


def fixed(value: float, places: int) -> str:
    """Format a number with fixed decimals."""
    return f"{value:.{places}f}"


def percent(value: float | None, digits: int = 2) -> str:
    """Format a relative value as percentage, from 1000 % on as factor.

    >>> percent(0.0012), percent(-0.25), percent(12.0)
    ('0.12 %', '-25 %', '12 times')
    """
    if value is None or not math.isfinite(value):
        return DASH
    return format_factor(value) if is_factor(value) else f"{significant(100 * value, digits)} %"


def change(ratio: float) -> str:
    """Format a relative change with its sign; a dash where it is not finite.

    >>> change(1.0031), change(0.98), change(1.0)
    ('+0.31 %', '−2 %', '0 %')
    """
    if not math.isfinite(ratio):
        return DASH
    size = ratio - 1.0
    if abs(size) < UNCHANGED:
        return "0 %"
    if is_factor(size):
        return f"{format_factor(ratio)} as much"
    return f"{'+' if size > 0 else '−'}{significant(100 * abs(size), 2)} %"


def words(name: str) -> str:
    """Return a key as words: "tool_speed" becomes "tool speed"."""
    return name.replace("_", " ")


def breakable(text: str) -> Markup:
    """Allow line breaks after the dots of a text, such as a key's place in a column heading.

    >>> breakable("limits.jerk & more")
    Markup('limits.<wbr>jerk &amp; more')
    """
    return Markup("<wbr>").join(re.split(r"(?<=\.)(?=\w)", text))


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


FILTERS = {
    function.__name__: function
    for function in (
        scale,
        joint_unit,
        si,
        number,
        pm,
        significant,
        decades,
        whole,
        fixed,
        percent,
        change,
        words,
        breakable,
        listed,
        capital,
    )
}
