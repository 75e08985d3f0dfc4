"""Signals that a law may depend on: name, unit, value, and expression in a file of effects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stiffopt.discovery.laws import operators
from stiffopt.discovery.signals import JointSignals, RobotSignals
from stiffopt.symbolic import Quantity


@dataclass(frozen=True)
class SourceKind:
    """Kind of signal."""

    # Field of `RobotSignals`, or an expression in `signals` for the robot as a whole.
    attribute: str
    # symbol, unit, words: for equations, values and sentences; "{}" is the joint.
    symbol: str
    unit: str
    words: str
    forms: tuple[str, ...]  # names of the forms that a law may take in it
    # Kind of the signal of its joint that it is a function of; "" for a signal of its own.
    function_of: str = ""
    per_joint: bool = True  # False for a signal of the robot as a whole
    of_own_joint: bool = False  # True where only laws of that joint may depend on it
    # Operator for its values before the first sample, which forms with memory ask for: a robot that
    # moves has started from rest, though not in the recording. "": that of the first sample, as of
    # the load by gravity.
    before: str = ""


_PLACE_FORMS = (
    "linear",
    "offset",
    "stiffening",
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
    "square",
    "signed_square",
    "power",
    "signed_power",
    "saturating",
    "saturating_even",
    "fading",
    "peaked",
)
SOURCE_KINDS = {
    "position": SourceKind(
        "motor_position",
        "q_{}",
        "rad",
        "position of joint {}",
        (*_PLACE_FORMS, "lever", "harmonic", "stop", "stops", "play"),
    ),
    "speed": SourceKind(
        "motor_velocity",
        "w_{}",
        "rad/s",
        "speed of joint {}",
        (*_SIGNED_FORMS, "lag", "slip", "sprung"),
        before="speed_before",
    ),
    "direction": SourceKind(
        "motor_direction",
        "sg(w_{})",
        "",
        "direction of motion of joint {}",
        ("linear",),
        function_of="speed",
    ),
    "acceleration": SourceKind(
        "motor_acceleration",
        "a_{}",
        "rad/s^2",
        "acceleration of joint {}",
        ("linear", "magnitude", "saturating", "sprung", "mode", "loose"),
        before="acceleration_before",
    ),
    "load": SourceKind(
        "spring_torque",
        "T_{}",
        "N m",
        "load of joint {}",
        (
            *(*_SIGNED_FORMS, "hinge_above", "hinge_below"),
            *("lag", "stop", "stops", "sprung", "mode", "loose"),
        ),
    ),
    "windup": SourceKind(
        "windup",
        "D_{}",
        "rad",
        "nominal wind-up of joint {}",
        ("linear",),
        function_of="load",
        of_own_joint=True,
    ),
    "friction": SourceKind(
        "nominal_friction",
        "F_{}",
        "N m",
        "nominal friction of joint {}",
        ("linear",),
        function_of="speed",
        of_own_joint=True,
    ),
    "drive": SourceKind("drive_torque", "u_{}", "N m", "drive torque of joint {}", ("linear",)),
    "temperature": SourceKind(
        "temperature_rise",
        "dT_{}",
        "K",
        "temperature of joint {}",
        ("linear", "decay", "hinge_above"),
    ),
    "session_time": SourceKind(
        "session_time",
        "t_on",
        "s",
        "time since power-on",
        ("linear", "decay", "approach", "wave"),
        per_joint=False,
    ),
    "run_time": SourceKind(
        "time",
        "t",
        "s",
        "time since the begin of the motion",
        ("linear", "decay", "approach"),
        per_joint=False,
    ),
    "height": SourceKind(
        "tool_position[:, 2]",
        "z",
        "m",
        "height of the tool",
        (*_PLACE_FORMS, "magnitude"),
        per_joint=False,
    ),
    "tool_x": SourceKind(
        "tool_position[:, 0]", "x", "m", "place of the tool along x", _PLACE_FORMS, per_joint=False
    ),
    "tool_y": SourceKind(
        "tool_position[:, 1]", "y", "m", "place of the tool along y", _PLACE_FORMS, per_joint=False
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
    def origin(self) -> LawSource:
        """The signal that it is a function of."""
        return LawSource(self.own.function_of or self.kind, self.joint)

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

    def value_before(self, signals: RobotSignals | JointSignals) -> np.ndarray | None:
        """Return the signal before the first sample; None where it has always been that sample."""
        if not self.own.before:
            return None
        motion = [LawSource(kind, self.joint).value(signals) for kind in ("speed", "acceleration")]
        found: np.ndarray = getattr(operators, self.own.before)(*motion, signals.dt)
        return found

    def expression_before(self, joint: int, *, of_robot: bool) -> str:
        """Return the Python expression of that, see `expression`."""
        if not self.own.before:
            return "None"
        motion = (
            LawSource(kind, self.joint).expression(joint, of_robot=of_robot)
            for kind in ("speed", "acceleration")
        )
        return f"{self.own.before}({', '.join(motion)}, signals.dt)"

    def expression(self, joint: int, *, of_robot: bool) -> str:
        """Return the Python expression in `signals` for a law at a joint."""
        if self.joint is None or not of_robot:
            return f"signals.{self.own.attribute}"
        index = "signals.link" if self.joint == joint else str(self.joint)
        return f"signals.{self.own.attribute}[:, {index}]"


def _column(values: Any, index: int) -> Quantity:
    column = values[:, index]
    return np.ascontiguousarray(column) if isinstance(column, np.ndarray) else column
