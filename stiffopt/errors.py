"""Errors of stiffopt: each message states fault, place, allowed values and remedy.

Errors that a user can cause derive from `InputError`; the command line prints their message and
returns exit code 2. Errors carry their data as attributes for programs.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class StiffoptError(Exception):
    """Root of all errors raised on purpose."""


class InputError(StiffoptError, ValueError):
    """Input that cannot be used.

    A ValueError, so that pydantic reports the place in a file at which an object raised it.
    """


class InputFileError(InputError):
    """A file cannot be read or has a wrong entry.

    `path`: the file. `where`: dotted key inside the file, "" for the file as a whole. `reason`:
    fault, allowed values and remedy.
    """

    def __init__(self, path: object, where: str, reason: str) -> None:
        self.path = str(path)
        self.where = where
        self.reason = reason
        place = f"{path}, {where}" if where else f"{path}"
        super().__init__(f"{place}: {reason}")


class NoNumbersError(InputFileError):
    """A text file without a row of numbers: notes, names or events beside recordings."""


class UnitError(InputError):
    """A quantity has a unit of the wrong kind, or none that is known."""


class ImplausibleError(InputError):
    """A bare number of a file whose magnitude is implausible in SI units."""


class RobotError(InputError):
    """A robot description cannot be used."""


class NotSimulatedError(RobotError):
    """An arm can be planned with, but not simulated as an elastic one."""


class ProblemError(InputError):
    """A problem statement that is contradictory or incomplete."""


class OutOfValidityError(InputError):
    """A value lies outside the range in which a model holds.

    `name`: the quantity. `value`, `lower` and `upper`: in SI units. `hint`: remedy.
    """

    def __init__(self, name: str, value: float, lower: float, upper: float, hint: str = "") -> None:
        self.name, self.value, self.lower, self.upper = name, value, lower, upper
        text = f"{name} = {value:g} is outside the validity range {lower:g} to {upper:g}"
        super().__init__(f"{text}. {hint}" if hint else f"{text}.")


class NoSolutionFound(StiffoptError):
    """A solve ended without a usable motion; `solution` holds the best iterate."""

    def __init__(self, message: str, solution: object = None) -> None:
        self.solution = solution
        super().__init__(message)


def shortened(value: object) -> str:
    """Value or error as messages show it; the middle of long texts is omitted.

    >>> shortened("x" * 1000)[:4], len(shortened("x" * 1000))
    ("'xxx", 100)
    """
    try:
        text = str(value) if isinstance(value, BaseException) else repr(value)
    except (ValueError, RecursionError):  # an integer of too many digits, too deep a list
        return f"a {type(value).__name__} too long to show"
    text = " ".join(text.split()) if isinstance(value, BaseException) else text
    text = text.rstrip(".") if isinstance(value, BaseException) else text
    return (
        text
        if len(text) <= _MAX_SHOWN_CHARACTERS
        else f"{text[: _MAX_SHOWN_CHARACTERS - 33]}...{text[-30:]}"
    )


# Length of a value in a message [characters].
_MAX_SHOWN_CHARACTERS = 100


def format_relative(value: float, places: int = 2, sign: str = "") -> str:
    """Format a relative value: a percentage with `places` decimals, a factor from 1000 % on.

    >>> relative(0.0123), relative(0.4, 0, "+"), relative(79926.0)
    ('1.23%', '+40%', '80,000 times')
    """
    return format_factor(value) if is_factor(value) else f"{value:{sign}.{places}%}"


def format_increase(after: float, before: float, digits: int) -> str:
    """Format the relative increase from `before`, which is not 0, to `after`.

    >>> more(1.1, 1.0, 2), more(0.5, 1.0, 3), more(12.0, 1.0, 2)
    ('+10 %', '-50 %', '12 times as much')
    """
    ratio = after / before
    size = ratio - 1.0
    return f"{format_factor(ratio)} as much" if is_factor(size) else f"{100.0 * size:+.{digits}g} %"


def is_factor(value: float) -> bool:
    """Return whether a relative value is written as a factor, not in percent."""
    return _MIN_FACTOR <= abs(value) < float("inf")


def format_factor(value: float) -> str:
    """Format a large factor with two significant digits.

    >>> times(12.0), times(79926.2761), times(3.5e9)
    ('12 times', '80,000 times', '3.5e+09 times')
    """
    rounded = float(f"{value:.2g}")
    return f"{rounded:,.0f} times" if abs(rounded) < _MAX_PLAIN_FACTOR else f"{rounded:g} times"


# Relative values from here on are written as factors; factors from `_MAX_PLAIN_FACTOR` on in
# exponential notation.
_MIN_FACTOR = 10.0
_MAX_PLAIN_FACTOR = 1e6


def nearest(name: str, allowed: Iterable[str]) -> str:
    """Sentence that suggests the closest allowed word and lists the others."""
    names = sorted(str(a) for a in allowed)
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    guess = f"Did you mean {close[0]!r}? " if close else ""
    if len(names) > _MAX_LISTED_NAMES:
        near = sorted(names, key=lambda n: -difflib.SequenceMatcher(None, name, n).ratio())
        return f"{guess}Allowed are {len(names)}, such as {', '.join(near[:_NEAREST_NAMES])}."
    return f"{guess}Allowed: {', '.join(names)}."


# Names that a message lists at most, and those nearest to the given one where there are more.
_MAX_LISTED_NAMES, _NEAREST_NAMES = 40, 12
