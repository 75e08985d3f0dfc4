"""Formatting of numbers with units and of lists, for sentences, the terminal and pages.

Values are SI. The functions are also the filters of the templates: `{{ length | si("mm", 3) }}`.
"""

from __future__ import annotations

import math
import re

from markupsafe import Markup

from stiffopt.errors import format_factor, is_factor
from stiffopt.formatting import DASH as DASH
from stiffopt.formatting import capital as capital
from stiffopt.formatting import listed as listed
from stiffopt.formatting import pm as pm
from stiffopt.formatting import scale as scale
from stiffopt.formatting import si as si
from stiffopt.formatting import significant as significant
from stiffopt.units import joint_unit as joint_unit

# Rows of a list or table that a page or a terminal shows; the files have all.
MAX_LISTED = 12
UNCHANGED = 5e-5  # relative change that is written as 0 %


def number(value: float, unit: str, digits: int = 4) -> str:
    """Format a value [SI] without its unit, which the column heading has.

    >>> number(0.0123, "mm")
    '12.3'
    """
    return significant(scale(value, unit)[0] * value, digits)


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
