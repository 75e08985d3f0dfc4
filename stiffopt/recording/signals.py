"""Which column of a run file holds which signal."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

Kind = Literal["position", "velocity", "link_position", "torque"]
KINDS: tuple[Kind, ...] = ("position", "velocity", "link_position", "torque")


@dataclass(frozen=True, kw_only=True)
class Signals:
    """Column names of a recording set, one a joint; "" where a joint lacks that signal.

    Parameters
    ----------
    time : str
    position, torque : tuple of str (n,)
    velocity, link_position : tuple of str (n,) or None
    torque_side : str
        "motor": before friction, from current; "link": a joint torque sensor.

    Notes
    -----
    In a file of messages a name is the topic and a field of its messages:
    "/joint_states.position[2]", or "/joint_states.position[elbow]" where the message names its
    entries.
    """

    time: str
    position: tuple[str, ...]
    velocity: tuple[str, ...] | None
    link_position: tuple[str, ...] | None
    torque: tuple[str, ...]
    torque_side: Literal["motor", "link"] = "motor"

    def of(self, kind: Kind) -> tuple[str, ...] | None:
        """Column names of one kind of channel."""
        names: tuple[str, ...] | None = getattr(self, kind)
        return names

    def columns(self) -> Iterator[tuple[Kind, int, str]]:
        """Kind, joint (from 0) and column name of every channel there is."""
        for kind in KINDS:
            for joint, name in enumerate(self.of(kind) or ()):
                if name:
                    yield kind, joint, name

    @property
    def wanted(self) -> tuple[str, ...]:
        """Every column name but that of the time."""
        return tuple(name for _, _, name in self.columns())
