"""Measured channels by name: "torque_3" and "link_position_3" are those of the third joint."""

from __future__ import annotations

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
