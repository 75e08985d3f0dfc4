"""Numbers for people: SI values in the unit that reads best, with the digits that matter."""

from __future__ import annotations

import math

# Largest scale first: the first one that the value reaches is taken, else the last.
_SCALES: dict[str, tuple[tuple[float, str], ...]] = {
    "rad": ((1.0, "rad"), (1e-3, "mrad"), (1e-6, "µrad")),
    "rad/(N m)": ((1e-3, "mrad/(N m)"), (1e-6, "µrad/(N m)")),
}
# A deflection below this is read in micrometres [m].
MICROMETRES_BELOW = 5e-5


def length_scale(largest: float) -> tuple[float, str]:
    """Factor from metres and unit that suit a deflection of this size [m]."""
    return (1e6, "µm") if abs(largest) < MICROMETRES_BELOW else (1e3, "mm")


def engineering(value: float | None, unit: str, digits: int = 4) -> str:
    """Value [SI] as text with a unit that suits its size; a dash where there is none.

    >>> engineering(2.97e-4, "m"), engineering(9100.0, "N m/rad"), engineering(None, "m")
    ('0.297 mm', '9100 N m/rad', '–')
    """
    if value is None or not math.isfinite(value):
        return "–"
    factor, name = 1.0, unit
    if unit == "m":
        if abs(value) < 0.5:
            factor, name = length_scale(value)
    elif unit in _SCALES:
        scale, name = next(
            (each for each in _SCALES[unit] if abs(value) >= each[0]), _SCALES[unit][-1]
        )
        factor = 1.0 / scale
    return f"{significant(value * factor, digits)} {name}".strip()


def significant(value: float, digits: int = 4) -> str:
    """Give a number its significant digits, no exponent between 1e-4 and 1e7.

    >>> significant(12345.678), significant(0.00123456), significant(0.0)
    ('12350', '0.001235', '0')
    """
    if not math.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    size = math.floor(math.log10(abs(value)))
    if not -5 < size < 7:
        return f"{value:.{digits - 1}e}"
    rounded = round(value, digits - 1 - size)
    text = f"{rounded:.{max(digits - 1 - size, 0)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def percent(value: float, digits: int = 2) -> str:
    """Relative value as a percentage.

    >>> percent(0.0012), percent(-0.25)
    ('0.12 %', '-25 %')
    """
    return f"{significant(100 * value, digits)} %"
