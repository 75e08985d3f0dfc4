"""Errors of stiffopt: each message says what, where, what is allowed and what to do next.

Everything a user can cause derives from `InputError`; the command line turns it into one message
and exit code 2. Errors carry the data a program needs to react, not only a text.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class StiffoptError(Exception):
    """Root of all errors raised on purpose."""


class InputError(StiffoptError, ValueError):
    """Something the user gave cannot be used.

    Being a ValueError, it is located by pydantic where an object of a file raises it.
    """


class InputFileError(InputError):
    """A file cannot be read or has a wrong entry.

    Parameters
    ----------
    path : str
        The file.
    where : str
        Dotted key inside the file, "" for the file as a whole.
    reason : str
        What is wrong, what is allowed, and what to do next.
    """

    def __init__(self, path: object, where: str, reason: str) -> None:
        self.path = str(path)
        self.where = where
        self.reason = reason
        place = f"{path}, {where}" if where else f"{path}"
        super().__init__(f"{place}: {reason}")


class UnitError(InputError):
    """A quantity has a unit of the wrong kind, or none that is known."""


class ImplausibleError(InputError):
    """A bare number of a file that is hardly meant in SI: asked back instead of believed."""


class RobotError(InputError):
    """A robot description cannot be used."""


class NotSimulatedError(RobotError):
    """An arm cannot be simulated as an elastic one, though it can be planned with."""


class ProblemError(InputError):
    """A problem is stated in a way that cannot be solved, or not honestly."""


class OutOfValidityError(InputError):
    """A value lies outside the range in which a model holds.

    Parameters
    ----------
    name : str
        The quantity.
    value, lower, upper : float
        In SI units.
    hint : str
        What to do next.
    """

    def __init__(self, name: str, value: float, lower: float, upper: float, hint: str = "") -> None:
        self.name, self.value, self.lower, self.upper = name, value, lower, upper
        text = f"{name} = {value:g} is outside the validity range {lower:g} to {upper:g}"
        super().__init__(f"{text}. {hint}" if hint else f"{text}.")


class NoSolutionFound(StiffoptError):
    """A solve ended without a motion that can be used; `solution` holds the best so far."""

    def __init__(self, message: str, solution: object = None) -> None:
        self.solution = solution
        super().__init__(message)


def shortened(value: object) -> str:
    """Value or error as a message shows it: what is long loses its middle.

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


_MAX_SHOWN_CHARACTERS = 100


def format_relative(value: float, places: int = 2, sign: str = "") -> str:
    """Relative value: a percentage with this many decimals, a factor from 1000 % on.

    >>> relative(0.0123), relative(0.4, 0, "+"), relative(79926.0)
    ('1.23%', '+40%', '80,000 times')
    """
    return format_factor(value) if is_factor(value) else f"{value:{sign}.{places}%}"


def format_increase(after: float, before: float, digits: int) -> str:
    """How much more one is than the other, which is not 0.

    >>> more(1.1, 1.0, 2), more(0.5, 1.0, 3), more(12.0, 1.0, 2)
    ('+10 %', '-50 %', '12 times as much')
    """
    ratio = after / before
    size = ratio - 1.0
    return f"{format_factor(ratio)} as much" if is_factor(size) else f"{100.0 * size:+.{digits}g} %"


def is_factor(value: float) -> bool:
    """Whether a relative value is so large that it is told as a factor, not in percent."""
    return _MIN_FACTOR <= abs(value) < float("inf")


def format_factor(value: float) -> str:
    """Large factor in two digits.

    >>> times(12.0), times(79926.2761), times(3.5e9)
    ('12 times', '80,000 times', '3.5e+09 times')
    """
    rounded = float(f"{value:.2g}")
    return f"{rounded:,.0f} times" if abs(rounded) < _MAX_PLAIN_FACTOR else f"{rounded:g} times"


_MIN_FACTOR = 10.0
_MAX_PLAIN_FACTOR = 1e6


def nearest(name: str, allowed: Iterable[str]) -> str:
    """Sentence that names the closest allowed word and lists the rest."""
    names = sorted(str(a) for a in allowed)
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    guess = f"Did you mean {close[0]!r}? " if close else ""
    if len(names) > _MAX_LISTED_NAMES:
        near = sorted(names, key=lambda n: -difflib.SequenceMatcher(None, name, n).ratio())
        return f"{guess}Allowed are {len(names)}, such as {', '.join(near[:_NEAREST_NAMES])}."
    return f"{guess}Allowed: {', '.join(names)}."


# Names that a message lists, and how many of more.
_MAX_LISTED_NAMES, _NEAREST_NAMES = 40, 12
