"""Names of nominal values: what they are of which joint or body."""

from __future__ import annotations

import re
from typing import NamedTuple

_WRITTEN_NAME = re.compile(r"(?P<kind>[A-Za-z].*?) (?P<place>[1-9]\d*)(?: (?P<part>\w+))?")


class ValueName(NamedTuple):
    """Name of a nominal value."""

    kind: str  # field of `Tolerance`, "body", or a property of a reducer ("T1", "rounding T1")
    place: int  # joint, or joint that carries the body, from 0
    part: str = ""  # component of a body's value: "x", "mx"

    def __str__(self) -> str:
        """Return the name as it is written in files, with places from 1: "com 2 x"."""
        return f"{self.kind} {self.place + 1} {self.part}".rstrip()

    @classmethod
    def read(cls, text: str) -> ValueName:
        """Read a name from a file.

        Raises `ValueError`: no such name.
        """
        found = _WRITTEN_NAME.fullmatch(text)
        if found is None:
            raise ValueError(f'{text!r} is no nominal value; write one such as "coulomb 3".')
        return cls(found["kind"], int(found["place"]) - 1, found["part"] or "")
