"""Checks of several values against each other or against a list of words."""

from __future__ import annotations

import itertools
from collections.abc import Iterable

from stiffopt.declaration import POSITIVE
from stiffopt.errors import InputError, nearest


def require_positive(owner: str, **values: float) -> None:
    """Raise `InputError` unless every value is a finite number above zero."""
    for name, value in values.items():
        POSITIVE.check(f"{owner}: {name}", value)


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
