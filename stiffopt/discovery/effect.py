"""What an effect of the catalogue is: a term of the balances, with parameters and bounds.

Terms are plain NumPy formulas in the signals of a joint or of the robot; they accept arrays of
samples and CasADi symbols alike. They are linear in their amplitudes and vanish with them; what
enters otherwise (a speed, a place, a time constant) is a shape.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from stiffopt.symbolic import Quantity

Scope = Literal["joint", "robot", "link", "run"]
# Values of the reported parameters from amplitudes and shapes.
Report = Callable[[Sequence[float], Sequence[float], Any], Mapping[str, float]]


@dataclass(frozen=True, kw_only=True)
class Term:
    """Contributions of an effect to what is measured; zero where left out.

    Parameters
    ----------
    drive_torque
        Added to the torque that the drive must give [N m].
    link_torque
        Added to the torque in the spring [N m]: the drive has to give it, and the joint winds up
        under it.
    deflection
        Added to motor angle minus link angle [rad].
    previous_torque
        Added to the drive torque of the joint before [N m]; effects of a joint only.

    Notes
    -----
    Of an effect of a joint each is one number a sample; of the robot, one a sample and joint.
    """

    drive_torque: Quantity = 0.0
    link_torque: Quantity = 0.0
    deflection: Quantity = 0.0
    previous_torque: Quantity = 0.0


@dataclass(frozen=True, kw_only=True)
class Amplitude:
    """A parameter that an effect's term is linear in.

    Parameters
    ----------
    name : str
    unit : str
    scale : callable or float
        Typical size, from the constants of the joint where callable; the prior's standard
        deviation.
    lower, upper : float
        Physical bounds over the scale.
    """

    name: str
    unit: str
    scale: Callable[[Any], float] | float = 1.0
    lower: float = -float("inf")
    upper: float = float("inf")

    def size(self, constants: Any) -> float:
        """Typical size for a joint or robot."""
        return float(self.scale(constants) if callable(self.scale) else self.scale)


@dataclass(frozen=True, kw_only=True)
class Shape:
    """A parameter that an effect's term depends on in another way.

    Parameters
    ----------
    name : str
    unit : str
    starts : callable or tuple of float
        Values to start a fit from, from the signals' ranges where callable.
    lower, upper : float
        Bounds [unit].
    """

    name: str
    unit: str
    starts: Callable[[Any], Sequence[float]] | tuple[float, ...]
    lower: float = -float("inf")
    upper: float = float("inf")

    def grid(self, ranges: Any) -> tuple[float, ...]:
        """Values to start from."""
        values = self.starts(ranges) if callable(self.starts) else self.starts
        return tuple(float(v) for v in values)


@dataclass(frozen=True, kw_only=True)
class Effect:
    """An entry of the catalogue.

    Parameters
    ----------
    name : str
    family : str
        friction, elastic, periodic, inertial, sensor, spring, contact.
    scope : {"joint", "robot", "link", "run"}
        What a finding names: a joint, the robot as a whole, a link or a run.
    equation : str
        For reports.
    signature : str
        How it shows, for people.
    term : callable
        (signals, amplitudes, shapes) -> Term.
    amplitudes : tuple of Amplitude
    shapes : tuple of Shape
    report : callable, optional
        (amplitudes, shapes, constants) -> named values; default: the parameters themselves.
    units : mapping of str to str
        Of reported values that are no amplitude and no shape.
    applies : callable, optional
        (constants) -> bool; False where the joint cannot have it (no pole pairs known).
    separate : str
        The motion that separates it from what looks alike.
    log_prior : callable, optional
        (constants) -> logarithm of how usual it is at that joint, 0 at most; default 0.
    """

    name: str
    family: str
    scope: Scope
    equation: str
    signature: str
    term: Callable[[Any, Sequence[Quantity], Sequence[Quantity]], Term]
    amplitudes: tuple[Amplitude, ...]
    shapes: tuple[Shape, ...] = ()
    report: Report | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    applies: Callable[[Any], bool] | None = None
    separate: str = ""
    log_prior: Callable[[Any], float] | None = None

    def parameters(
        self, amplitudes: Sequence[float], shapes: Sequence[float], constants: Any
    ) -> dict[str, float]:
        """Reported parameters by name."""
        if self.report is not None:
            return dict(self.report(amplitudes, shapes, constants))
        named = dict(zip((a.name for a in self.amplitudes), amplitudes, strict=True))
        return named | dict(zip((s.name for s in self.shapes), shapes, strict=True))

    def unit_of(self, parameter: str) -> str:
        """Unit of a reported parameter."""
        own: tuple[Amplitude | Shape, ...] = (*self.amplitudes, *self.shapes)
        for each in own:
            if each.name == parameter:
                return each.unit
        return self.units.get(parameter, "")
