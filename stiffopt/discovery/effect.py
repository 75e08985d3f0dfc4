"""What an effect of the catalogue is: a term of the balances, with all that is known of it.

Terms are plain NumPy formulas in the signals of a joint or of the robot; they accept arrays of
samples and CasADi symbols alike. They are linear in their amplitudes and vanish with them; what
enters otherwise (a speed, a place, a time constant) is a shape. Whatever else is said of an effect
(words, what recordings need to show it, its source, what it does to a robot) stands beside its term
and nowhere else: reports, `recording check`, the catalogue's page and the planner ask for it here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, Protocol

from stiffopt.symbolic import Quantity

if TYPE_CHECKING:
    from stiffopt.discovery.signals import JointConstants, RobotConstants
    from stiffopt.robot.robot import Robot

    # Constants of the joint for an effect of a joint, else of the robot.
    Constants = JointConstants | RobotConstants

Scope = Literal["joint", "robot", "link", "run"]
# Values of the reported parameters from amplitudes and shapes.
Report = Callable[[Sequence[float], Sequence[float], Any], Mapping[str, float]]
# What recordings must hold to show an effect: a fact of the joint or of the set.
Need = Literal[
    "torque",
    "link",
    "sensor",
    "windup",
    "moves",
    "reverses",
    "slow",
    "speeds",
    "load_changes_sign",
    "rotor_slow",
    "ripple_slow",
    "warmer",
    "gear_ratio",
    "pole_pairs",
    "tool_frame",
    "before",
    "runs",
    "three_runs",
]


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
        Added to motor angle minus link angle, by what displaces the link [rad]; the link swings
        after it.
    reading
        Added to motor angle minus link angle as they are read alone [rad].
    previous_torque
        Added to the drive torque of the joint before [N m]; effects of a joint only.

    Notes
    -----
    Of an effect of a joint each is one number a sample; of the robot, one a sample and joint.
    """

    drive_torque: Quantity = 0.0
    link_torque: Quantity = 0.0
    deflection: Quantity = 0.0
    reading: Quantity = 0.0
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
    changed : float
        How many times larger it is typically where it has changed since a model was made.
    own : bool
        Whether the effect has it where other entries have the rest: unless one of these stands out
        the effect is not there.
    """

    name: str
    unit: str
    scale: Callable[[Any], float] | float = 1.0
    lower: float = -float("inf")
    upper: float = float("inf")
    changed: float = 1.0
    own: bool = False

    def size(self, constants: Constants) -> float:
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
    usual : float, optional
        Where a file states none [unit]; without it a file must.
    """

    name: str
    unit: str
    starts: Callable[[Any], Sequence[float]] | tuple[float, ...]
    lower: float = -float("inf")
    upper: float = float("inf")
    usual: float | None = None

    def asked(self, ranges: Constants) -> tuple[float, ...]:
        """Values to start from as the entry has them."""
        values = self.starts(ranges) if callable(self.starts) else self.starts
        return tuple(float(v) for v in values)

    def grid(self, ranges: Constants) -> tuple[float, ...]:
        """Values to start from, each once and within the bounds, wherever the ranges lie."""
        within = (min(max(v, self.lower), self.upper) for v in self.asked(ranges))
        return tuple(dict.fromkeys(within))


@dataclass(frozen=True)
class RobotChange:
    """A robot with a finding in it.

    Parameters
    ----------
    robot : Robot or None
        None where there is no such robot.
    sentence : str
        What was changed, or why it cannot be.
    """

    robot: Robot | None
    sentence: str


class FittedEffect(Protocol):
    """An effect of the catalogue with fitted amplitudes and shapes, at a joint, link or run."""

    @property
    def effect(self) -> Effect:
        """Entry of the catalogue."""

    @property
    def amplitudes(self) -> tuple[float, ...]:
        """Fitted amplitudes in their own units."""

    @property
    def shapes(self) -> tuple[float, ...]:
        """Fitted shapes in their own units."""


# (robot, finding, joint of the robot from 0, constants at the fit) -> the changed robot; None where
# a planner's model has no such effect. The joint is that of the finding, the one that moves its
# link, or the last.
ChangeRobot = Callable[["Robot", FittedEffect, int, "JointConstants"], RobotChange | None]


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
    possible : callable, optional
        (shapes, constants) -> bool; False for shapes that the recordings themselves rule out.
    usual : bool
        Whether every real robot has a little of it, so that it is fitted from the start where
        nobody vouches for the nominal model.
    lags : bool
        Whether what it does to a wind-up follows the load later: the spring's slope is then that of
        a load that changes at once.
    is_play : bool
        Whether it is free travel of a joint, by its spring torque alone: links are followed across.
    only_changed : bool
        Whether it is sought only as a change since an extended model was made: a form so free fits
        something of all that a nominal model lacks.
    separate : str
        The motion that separates it from what looks alike.
    log_prior : callable, optional
        (constants) -> logarithm of how usual it is at that joint, 0 at most; default 0.
    title : str
        Name as people write it; default: the name with spaces.
    phrase : str or (str, str)
        What is missing, in a headline; two where it depends on the sign of the first amplitude,
        above zero first. Default: the title.
    nominal : str
        Nominal value of every joint (a field of `Nominal` and of `Robot`) that the first amplitude
        adds to; "" where there is none. Where a set does not state it, the effect stands for it.
    nominal_words : str
        That value as people write it; default: the field with spaces.
    needs : tuple of Need
        What recordings must hold of a joint to show it there, the most basic first. Default: the
        sensor that the term acts on, and motion.
    confused_with : tuple of str
        Names of effects that ordinary motions separate poorly from it; one side says it.
    twin : str
        Name of an effect that says much the same in another form, one with an amplitude where the
        other has a shape. Evidence prices amplitudes and no shapes, so that between the two the
        fits count, and what the data determine of either; one side says it.
    beside : Effect, optional
        What it must stand out beside: amplitudes so free that laws which are not quite those of the
        catalogue are among them. It is fitted for that judgement only and never named.
    likelier_than : Effect, optional
        What it must have clearly more evidence than, both beside that: the same with a freedom that
        it claims not to be there. Fitted for that judgement only as well.
    reference : str
        Source of its form: a key of references.bib, or the source in words.
    drawn : callable, optional
        (amplitudes, shapes, constants) -> by name, what a reported value may be off by since few
        runs were drawn of all [its unit].
    of_runs : callable, optional
        (names) -> the entry with an amplitude for each of some runs, drawn about a mean that all
        share; (names, seen=False) -> where runs of these names are others.
    change_robot : callable, optional
        Puts a finding into the robot that a planner computes with.
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
    possible: Callable[[Sequence[float], Any], bool] | None = None
    usual: bool = False
    lags: bool = False
    is_play: bool = False
    only_changed: bool = False
    separate: str = ""
    log_prior: Callable[[Any], float] | None = None
    title: str = ""
    phrase: str | tuple[str, str] = ""
    nominal: str = ""
    nominal_words: str = ""
    needs: tuple[Need, ...] = ()
    confused_with: tuple[str, ...] = ()
    twin: str = ""
    beside: Effect | None = None
    likelier_than: Effect | None = None
    reference: str = ""
    drawn: Report | None = None
    of_runs: Callable[..., Effect] | None = None
    change_robot: ChangeRobot | None = None

    def __post_init__(self) -> None:
        for field_name, default in (
            ("title", self.name.replace("_", " ")),
            ("phrase", self.title or self.name.replace("_", " ")),
            ("nominal_words", self.nominal.replace("_", " ")),
        ):
            if not getattr(self, field_name):
                object.__setattr__(self, field_name, default)

    @property
    def has_distinctive(self) -> bool:
        """Whether some amplitudes tell it from other effects."""
        return any(each.own for each in self.amplitudes)

    @property
    def distinctive_amplitudes(self) -> list[int]:
        """Places of the amplitudes that tell it from other effects."""
        return [k for k, each in enumerate(self.amplitudes) if each.own]

    def is_twin(self, other: Effect) -> bool:
        """Whether both say much the same in other forms."""
        return self.twin == other.name or other.twin == self.name

    def phrase_of(self, amplitudes: Sequence[float]) -> str:
        """What is missing, in a headline."""
        if isinstance(self.phrase, str):
            return self.phrase
        return self.phrase[amplitudes[0] < 0.0]

    def parameters(
        self, amplitudes: Sequence[float], shapes: Sequence[float], constants: Constants
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
