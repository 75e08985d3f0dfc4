"""Names of measured channels and of nominal values, as they are written in files."""

from __future__ import annotations

import re
from typing import NamedTuple


class Channel(NamedTuple):
    """A measured channel."""

    kind: str  # "torque" or "link_position"
    joint: int  # from 1

    @classmethod
    def read(cls, name: str) -> Channel:
        """Return the channel of a name."""
        kind, _, joint = name.rpartition("_")
        return cls(kind, int(joint))

    @property
    def sensor(self) -> str:
        """Sensor that measures it, in words."""
        return "torque" if self.kind == "torque" else "link encoder"

    def number(self, joints: int) -> int:
        """Return its number among the torques, then the deflections, of all joints."""
        return self.joint - 1 + (0 if self.kind == "torque" else joints)


def channel_name(channel: int, joints: int) -> str:
    """Return the name of a channel by its number."""
    kind = "torque" if channel < joints else "link_position"
    return f"{kind}_{channel % joints + 1}"


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
