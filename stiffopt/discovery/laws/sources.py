"""Signals that a law may depend on: name, unit, value, and expression in a file of effects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stiffopt.discovery.signals import JointSignals, RobotSignals
from stiffopt.symbolic import Quantity


@dataclass(frozen=True, kw_only=True)
class SourceKind:
    """Kind of signal."""

    # Field of `RobotSignals`, or an expression in `signals` for the robot as a whole.
    attribute: str
    # symbol, unit, words: for equations, values and sentences; "{}" is the joint.
    symbol: str
    unit: str
    words: str
    forms: tuple[str, ...]  # names of the forms that a law may take in it
    per_joint: bool = True  # False for a signal of the robot as a whole
    of_own_joint: bool = False  # True where only laws of that joint may depend on it


_PLACE_FORMS = (
    "linear",
    "offset",
    "step",
    "step_down",
    "bend",
    "bump",
    "hinge_above",
    "hinge_below",
)
_SIGNED_FORMS = (
    "linear",
    "magnitude",
    "power",
    "signed_power",
    "saturating",
    "saturating_even",
    "fading",
    "peaked",
)
SOURCE_KINDS = {
    "position": SourceKind(
        attribute="motor_position",
        symbol="q_{}",
        unit="rad",
        words="position of joint {}",
        forms=(*_PLACE_FORMS, "harmonic", "stop", "play"),
    ),
    "speed": SourceKind(
        attribute="motor_velocity",
        symbol="w_{}",
        unit="rad/s",
        words="speed of joint {}",
        forms=(*_SIGNED_FORMS, "lag", "slip", "sprung"),
    ),
    "direction": SourceKind(
        attribute="motor_direction",
        symbol="sg(w_{})",
        unit="",
        words="direction of motion of joint {}",
        forms=("linear",),
    ),
    "acceleration": SourceKind(
        attribute="motor_acceleration",
        symbol="a_{}",
        unit="rad/s^2",
        words="acceleration of joint {}",
        forms=("linear", "magnitude", "saturating", "sprung", "mode", "loose"),
    ),
    "load": SourceKind(
        attribute="spring_torque",
        symbol="T_{}",
        unit="N m",
        words="load of joint {}",
        forms=(
            *_SIGNED_FORMS,
            *("hinge_above", "hinge_below", "lag", "stop", "sprung", "mode", "loose"),
        ),
    ),
    "windup": SourceKind(
        attribute="windup",
        symbol="D_{}",
        unit="rad",
        words="nominal wind-up of joint {}",
        forms=("linear",),
        of_own_joint=True,
    ),
    "friction": SourceKind(
        attribute="nominal_friction",
        symbol="F_{}",
        unit="N m",
        words="nominal friction of joint {}",
        forms=("linear",),
        of_own_joint=True,
    ),
    "drive": SourceKind(
        attribute="drive_torque",
        symbol="u_{}",
        unit="N m",
        words="drive torque of joint {}",
        forms=("linear",),
    ),
    "temperature": SourceKind(
        attribute="temperature_rise",
        symbol="dT_{}",
        unit="K",
        words="temperature of joint {}",
        forms=("linear", "decay", "hinge_above"),
    ),
    "session_time": SourceKind(
        attribute="session_time",
        symbol="t_on",
        unit="s",
        words="time since power-on",
        forms=("linear", "decay", "approach", "wave"),
        per_joint=False,
    ),
    "run_time": SourceKind(
        attribute="time",
        symbol="t",
        unit="s",
        words="time since the begin of the motion",
        forms=("linear", "decay", "approach"),
        per_joint=False,
    ),
    "height": SourceKind(
        attribute="tool_position[:, 2]",
        symbol="z",
        unit="m",
        words="height of the tool",
        forms=(*_PLACE_FORMS, "magnitude"),
        per_joint=False,
    ),
    "tool_x": SourceKind(
        attribute="tool_position[:, 0]",
        symbol="x",
        unit="m",
        words="place of the tool along x",
        forms=_PLACE_FORMS,
        per_joint=False,
    ),
    "tool_y": SourceKind(
        attribute="tool_position[:, 1]",
        symbol="y",
        unit="m",
        words="place of the tool along y",
        forms=_PLACE_FORMS,
        per_joint=False,
    ),
}


@dataclass(frozen=True)
class LawSource:
    """A signal."""

    kind: str  # key of `SOURCE_KINDS`
    joint: int | None = None  # from 0; None for a signal of the robot as a whole

    @property
    def own(self) -> SourceKind:
        """Properties of its kind."""
        return SOURCE_KINDS[self.kind]

    @property
    def symbol(self) -> str:
        """Symbol in equations, such as "q_4"."""
        return self.own.symbol.format(self._number)

    @property
    def words(self) -> str:
        """Name in sentences."""
        return self.own.words.format(self._number)

    @property
    def _number(self) -> str:
        return "" if self.joint is None else str(self.joint + 1)

    def is_of_joint(self, joint: int) -> bool:
        """Return True where the signals of one joint are enough to know it."""
        return self.joint == joint or self.kind in ("session_time", "run_time")

    def value(self, signals: RobotSignals | JointSignals) -> Quantity:
        """Return the signal (K,)."""
        name, _, index = self.own.attribute.partition("[:, ")
        values: Any = getattr(signals, name)
        if index:
            return _column(values, int(index[:-1]))
        if self.joint is None or isinstance(signals, JointSignals):
            return values
        return _column(values, self.joint)

    def value_in(self, run: Any) -> np.ndarray:
        """Return the signal (K,) in a run."""
        return np.broadcast_to(np.asarray(self.value(run.signals)), run.time.shape)

    def expression(self, joint: int, *, of_robot: bool) -> str:
        """Return the Python expression in `signals` for a law at a joint."""
        if self.joint is None or not of_robot:
            return f"signals.{self.own.attribute}"
        index = "signals.link" if self.joint == joint else str(self.joint)
        return f"signals.{self.own.attribute}[:, {index}]"


def _column(values: Any, index: int) -> Quantity:
    column = values[:, index]
    return np.ascontiguousarray(column) if isinstance(column, np.ndarray) else column
