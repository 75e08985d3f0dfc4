"""Checks of the numbers that describe surfaces and connections, with one wording for all."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping

from stiffopt.declaration import NOT_NEGATIVE, POSITIVE, Bounds
from stiffopt.errors import InputError, nearest


def require_positive(owner: str, **values: float) -> None:
    """Raise `InputError` unless every value is a finite number above zero."""
    _require(POSITIVE, owner, values)


def require_not_negative(owner: str, **values: float) -> None:
    """Raise `InputError` unless every value is a finite number, zero or above."""
    _require(NOT_NEGATIVE, owner, values)


def require_at_least(owner: str, bound: float, **values: float) -> None:
    """Raise `InputError` unless every value is finite and `bound` or above."""
    _require(Bounds(least=bound), owner, values)


def require_between(owner: str, lower: float, upper: float, **values: float) -> None:
    """Raise `OutOfValidityError` unless every value lies strictly between the two bounds."""
    _require(Bounds(above=lower, below=upper), owner, values)


def _require(bounds: Bounds, owner: str, values: Mapping[str, float]) -> None:
    for name, value in values.items():
        bounds.check(f"{owner}: {name}", value)


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
