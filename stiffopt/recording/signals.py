"""Which column of a run file holds which signal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from stiffopt.errors import InputFileError, UnitError
from stiffopt.recording.schema import ScaleSection, SignalsSection
from stiffopt.units import joint_to_si

Kind = Literal["position", "velocity", "link_position", "torque"]
KINDS: tuple[Kind, ...] = ("position", "velocity", "link_position", "torque")
_DIMENSIONS = {
    "time": "time",
    "position": "angle",
    "velocity": "angular velocity",
    "link_position": "angle",
    "torque": "torque",
}


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
    scale : mapping of kind of signal to array (n,), of "time" to a number
        What columns are multiplied with to be SI; left out where they are.
    torque_delay : float
        By which torques were recorded later than positions [s].
    currents : bool
        Whether torques are stated in A, without what one A is at the joint.

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
    scale: Mapping[str, np.ndarray] = field(default_factory=dict)
    torque_delay: float = 0.0
    currents: bool = False

    def scale_of(self, kind: str, n: int) -> np.ndarray:
        """Factors (n,) that columns of a kind are multiplied with to be SI."""
        return np.asarray(self.scale.get(kind, np.ones(n)))

    def to_si(self, columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Columns of a file in SI, torques at the time at which they acted."""
        out = dict(columns)
        if "time" in self.scale:
            out[self.time] = out[self.time] * float(self.scale["time"])
        for kind, joint, name in self.columns():
            if kind in self.scale:
                out[name] = out[name] * self.scale[kind][joint]
            if kind == "torque" and self.torque_delay:
                out[name] = _earlier(out[self.time], out[name], self.torque_delay)
        return out

    def as_recorded(self, columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Columns in SI in the units and with the delay of the files: what `to_si` undoes."""
        out = dict(columns)
        for kind, joint, name in self.columns():
            if name not in out:
                continue
            if kind == "torque" and self.torque_delay and self.time in out:
                out[name] = np.interp(out[self.time] - self.torque_delay, out[self.time], out[name])
            if kind in self.scale:
                out[name] = out[name] / self.scale[kind][joint]
        if "time" in self.scale and self.time in out:
            out[self.time] = out[self.time] / float(self.scale["time"])
        return out

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
        scale=_scale(section.scale, n, path),
        torque_delay=section.torque_delay,
        currents=any(entry in _CURRENTS for entry in _entries(section.scale.torque)),
    )


# Currents [A] may stand for torques, but nothing is diagnosed from them until they are torques.
_CURRENTS = {"A": 1.0, "mA": 1e-3}


def _scale(section: ScaleSection, n: int, path: Path) -> dict[str, np.ndarray]:
    """Factors of the section's entries: numbers, or units by name."""
    factors: dict[str, np.ndarray] = {}
    for kind, dimension in _DIMENSIONS.items():
        entry = getattr(section, kind)
        if entry is None:
            continue
        where = f"signals.scale.{kind}"
        entries = _entries(entry)
        if len(entries) == 1 and not isinstance(entry, tuple):
            entries = entries * (1 if kind == "time" else n)
        if kind != "time" and len(entries) != n:
            raise InputFileError(
                path, where, f"needs one entry, or one a joint ({n}), got {len(entries)}."
            )
        values = [
            _CURRENTS[str(one)]
            if kind == "torque" and one in _CURRENTS
            else _factor(one, dimension, path, where)
            for one in entries
        ]
        factors[kind] = np.array(values[0] if kind == "time" else values)
    return factors


def _entries(entry: Any) -> list[float | str]:
    if entry is None:
        return []
    return list(entry) if isinstance(entry, tuple) else [entry]


def _factor(entry: float | str, dimension: str, path: Path, where: str) -> float:
    try:
        value = joint_to_si(f"1 {entry}", dimension) if isinstance(entry, str) else entry
    except UnitError as error:
        raise InputFileError(
            path, where, f"{error} Where no unit fits, give the number that one of it is in SI."
        ) from None
    if not value or not np.isfinite(value):
        raise InputFileError(path, where, f"got {entry}; a factor is finite and not 0.")
    return float(value)


def _earlier(time: np.ndarray, values: np.ndarray, delay: float) -> np.ndarray:
    """What was recorded `delay` later; nan beyond the end of the recording."""
    known = np.isfinite(time) & np.isfinite(values)
    if known.sum() < 2:
        return values
    later = np.interp(time + delay, time[known], values[known], left=np.nan, right=np.nan)
    return np.asarray(later)


def _some(names: tuple[str, ...] | None) -> tuple[str, ...] | None:
    return names if names is not None and any(names) else None
