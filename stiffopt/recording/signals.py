"""Which column of a run file holds which signal."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from stiffopt.errors import InputFileError
from stiffopt.recording.schema import SignalsSection

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


def as_signals(section: SignalsSection, n: int, path: Path) -> Signals:
    """Column names, checked: one a joint, each used once, positions complete, some torque."""

    def fail(key: str, reason: str) -> InputFileError:
        return InputFileError(path, f"signals.{key}", reason)

    used: dict[str, str] = {section.time: "time"} if section.time else {}
    for kind in KINDS:
        names = getattr(section, kind)
        for joint, name in enumerate(names or ()):
            if name and name in used:
                raise fail(kind, f"the column {name!r} already stands for {used[name]}.")
            used[name] = f"{kind} of joint {joint + 1}"
        if names is not None and len(names) != n:
            raise fail(
                kind,
                f'needs one column a joint ({n}), got {len(names)}; "" where a joint lacks it.',
            )
    if not all(section.position):
        raise fail("position", "every joint needs a position; leave other joints out of `joints`.")
    if not any(section.torque):
        raise fail("torque", "no joint has a torque, and torque is what a recording must explain.")
    return Signals(
        time=section.time,
        position=section.position,
        velocity=_some(section.velocity),
        link_position=_some(section.link_position),
        torque=section.torque,
        torque_side=section.torque_side or "motor",
    )


def _some(names: tuple[str, ...] | None) -> tuple[str, ...] | None:
    return names if names is not None and any(names) else None
