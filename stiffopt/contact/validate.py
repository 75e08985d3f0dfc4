"""Checks of the numbers that describe surfaces and connections, with one wording for all."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable

from stiffopt.errors import InputError, OutOfValidityError, nearest


def require_positive(owner: str, **values: float) -> None:
    """Raise `InputError` unless every value is a finite number above zero."""
    for name, value in values.items():
        if not math.isfinite(value) or value <= 0.0:
            raise InputError(
                f"{owner}: {name} = {value:g} cannot be used; allowed is a finite number above 0. "
                f"Correct {name} (SI units)."
            )


def require_not_negative(owner: str, **values: float) -> None:
    """Raise `InputError` unless every value is a finite number, zero or above."""
    for name, value in values.items():
        if not math.isfinite(value) or value < 0.0:
            raise InputError(
                f"{owner}: {name} = {value:g} cannot be used; allowed is a finite number, 0 or "
                f"above. Correct {name} (SI units)."
            )


def require_at_least(owner: str, bound: float, **values: float) -> None:
    """Raise `InputError` unless every value is finite and `bound` or above."""
    for name, value in values.items():
        if not math.isfinite(value) or value < bound:
            raise InputError(
                f"{owner}: {name} = {value:g} cannot be used; allowed is a finite number, "
                f"{bound:g} or above. Correct {name}."
            )


def require_between(owner: str, lower: float, upper: float, **values: float) -> None:
    """Raise `OutOfValidityError` unless every value lies strictly between the two bounds."""
    for name, value in values.items():
        if not lower < value < upper:
            raise OutOfValidityError(
                f"{owner}: {name}", value, lower, upper, "Both bounds are excluded."
            )


def require_ordered(owner: str, **values: float) -> None:
    """Raise `InputError` unless the values, in the order given, strictly increase."""
    items = list(values.items())
    for (name, value), (next_name, next_value) in itertools.pairwise(items):
        if not value < next_value:
            raise InputError(
                f"{owner}: {name} = {value:g} must be smaller than {next_name} = {next_value:g}. "
                f"Correct one of the two."
            )


def require_one_of(owner: str, allowed: Iterable[object], **values: object) -> None:
    """Raise `InputError` unless every value is one of the allowed words."""
    words = list(allowed)
    for name, value in values.items():
        if value not in words:
            raise InputError(
                f"{owner}: {name} = {value!r} is not known. "
                f"{nearest(str(value), [str(word) for word in words])}"
            )
