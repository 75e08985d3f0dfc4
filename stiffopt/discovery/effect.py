"""Effects of the catalogue: terms of the equations of the channels and their properties.

Terms are plain NumPy formulas in the signals of a joint or of the robot. They are linear in their
amplitudes and vanish with them; parameters that enter otherwise (a speed, an angle, a time
constant) are shapes. Everything else known of an effect (words, the recordings it needs, its
source, how it changes a robot) is stated with its term and nowhere else: reports, `recording
check`, the catalogue's page and the planner read it here.
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

Scope = Literal["joint", "robot", "link", "run", "recording"]
# Fit of a shape: free; held at initial values, as the number of a joint; or a secant: equal to
# the amplitude of the same index.
ShapeFit = Literal["free", "held", "secant"]
# Amplitudes or shapes of an effect, in the order of its entry: numbers or symbols.
Values = Sequence[Quantity]
Reported = Mapping[str, float]
# Values of the reported parameters from amplitudes, shapes and constants.
Report = Callable[[Values, Values, Any], Reported]
# What to do, from amplitudes, shapes and constants.
Remedy = Callable[[Values, Values, Any], str]
# Property of the joint or the recording set without which an effect cannot show.
Need = Literal[
    "torque",
    "link",
    "sensor",
    "torque_sensor",
    "commanded",
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
    """Contributions of an effect to the equations of the measured channels; zero by default.

    Parameters
    ----------
    drive_torque
        Added to the drive torque [N m].
    link_torque
        Added to the spring torque [N m]: the drive has to give it, and the joint winds up under it.
    deflection
        Added to motor angle minus link angle by displacing the link [rad]; the link vibrates about
        it.
    reading
        Added to the reading of motor angle minus link angle alone [rad].
    previous_torque
        Added to the drive torque of the previous joint [N m]; effects of a joint only.

    Notes
    -----
    Each is one value per sample for an effect of a joint, and one per sample and joint for an
    effect of the robot.
    """

    drive_torque: Quantity = 0.0
    link_torque: Quantity = 0.0
    deflection: Quantity = 0.0
    reading: Quantity = 0.0
    previous_torque: Quantity = 0.0


@dataclass(frozen=True)
class Amplitude:
    """Parameter in which an effect's term is linear.

    Parameters
    ----------
    scale : callable or float
        Typical size, a function of the joint's constants where callable; standard deviation of the
        prior.
    lower, upper : float
        Physical bounds over the scale.
    changed : float
        Ratio of the typical size of a change since a model was made to `scale`.
    own : bool
        Amplitude that distinguishes the effect from other entries: unless one of these is
        significant, the effect is rejected.
    """

    name: str
    unit: str
    scale: Callable[[Any], float] | float = 1.0
    lower: float = -float("inf")
    upper: float = float("inf")
    changed: float = 1.0
    own: bool = False

    def size(self, constants: Constants) -> float:
        """Return the typical size for a joint or robot."""
        return float(self.scale(constants) if callable(self.scale) else self.scale)


@dataclass(frozen=True)
class Shape:
    """Parameter on which an effect's term depends nonlinearly.

    Parameters
    ----------
    starts : callable or tuple of float
        Initial values of a fit, a function of the signals' ranges where callable.
    lower, upper : float
        Bounds [unit].
    usual : float, optional
        Default where a file gives no value [unit]; without a default a file must give one.
    fit : {"free", "held", "secant"}
        "secant": the term is exact where the shape equals the amplitude of the same index.
    reported : bool
        False for a value that says nothing of the arm, such as a point of linearisation.
    """

    name: str
    unit: str
    starts: Callable[[Any], Sequence[float]] | tuple[float, ...]
    lower: float = -float("inf")
    upper: float = float("inf")
    usual: float | None = None
    fit: ShapeFit = "free"
    reported: bool = True

    def start_values(self, ranges: Constants) -> tuple[float, ...]:
        """Return the initial values as the entry defines them."""
        values = self.starts(ranges) if callable(self.starts) else self.starts
        return tuple(float(v) for v in values)

    def grid(self, ranges: Constants) -> tuple[float, ...]:
        """Return the distinct initial values, clipped to the bounds."""
        within = (min(max(v, self.lower), self.upper) for v in self.start_values(ranges))
        return tuple(dict.fromkeys(within))


@dataclass(frozen=True)
class RobotChange:
    """Robot changed by a finding.

    Parameters
    ----------
    robot : Robot or None
        None where the robot cannot be changed so.
    sentence : str
        Change that was made, or the reason why none can be.
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
    family : str
        friction, elastic, periodic, inertial, geometry, sensor, spring, contact.
    scope : {"joint", "robot", "link", "run", "recording"}
        Place that a finding names: a joint, the robot as a whole, a link, a joint in one run, or
        the robot in one run.
    equation : str
        For reports.
    signature : str
        Visible sign of it in the recordings, in words.
    term : callable
        (signals, amplitudes, shapes) -> Term.
    report : callable, optional
        (amplitudes, shapes, constants) -> named values; default: amplitudes and reported shapes.
    units : mapping of str to str
        Units of reported values that are neither amplitudes nor shapes.
    applies : callable, optional
        (constants) -> bool; False where the joint cannot have the effect (no pole pairs known).
    possible : callable, optional
        (shapes, constants) -> bool; False for shapes that contradict the recordings.
    usual : bool
        True where every real robot has a little of it: it is fitted from the start unless the
        nominal model is vouched for.
    couples_joints : bool
        True for an effect of a joint that acts on other joints too: its term takes the signals of
        the robot, where `link` is the joint, and returns values of all joints.
    shifts_weight : bool
        True where it changes the weight that several joints carry: a single one competes with
        re-identified masses.
    moves_zero : bool
        True where its first amplitude is the position of the joint at which its encoder reads 0.
    yields : bool
        True where its deflection depends on the load of its joint: the spring is softer or stiffer
        by it; default: in the family elastic.
    lags : bool
        True where its wind-up lags the load: the tangent stiffness is then that under a sudden
        change of load.
    is_play : bool
        True for free travel of a joint as a function of its spring torque alone, across which links
        are simulated.
    linear_about : bool
        True where the first shape is the value of the first amplitude about which the term is
        linear: the amplitude has to agree with it.
    only_changed : bool
        True where it is sought only as a change since an extended model was made: a form so free
        fits part of everything that a nominal model lacks.
    separate : str
        Motion that separates it from similar effects.
    log_prior : callable, optional
        (constants) -> logarithm of its prior probability at that joint relative to other effects, 0
        at most; default 0.
    title : str
        Name in prose; default: the name with spaces.
    phrase : str or (str, str)
        Missing physics, for a headline, with its values as placeholders: "{dm}" is the value with
        its standard deviation, "{eps:%}" the same in percent, "{cx/cy/cz}" values in one unit. Two
        phrases where it depends on the sign of the first amplitude, positive first: values are then
        without sign. Default: the title.
    remedy : str or callable
        What to do: the value to enter, the part to look at. Placeholders as in `phrase`, and
        "{where}" for the place and "{new}" for the nominal value with the change; or
        (amplitudes, shapes, constants) -> the sentence. Default: a look at the place.
    nominal : str
        Nominal value of every joint (a field of `Nominal` and of `Robot`) that the first amplitude
        adds to; "" where there is none. Where a set does not state it, the effect takes its place.
    nominal_words : str
        Name of that value in prose; default: the field with spaces.
    signals_key : str
        Key of [signals] in recordings.toml that undoes it: its first parameter adds to that value.
    tolerances : tuple of str
        Nominal values (fields of `Tolerance`) that it changes beyond what their tolerances allow;
        default: `nominal`.
    needs : tuple of Need
        Properties of the recordings without which it cannot show at a joint, the most basic first.
        Default: the sensor that the term acts on, and motion.
    only_without : tuple of Need
        Nominal values with which another entry takes its place.
    confused_with : tuple of str
        Names of effects that ordinary motions separate poorly from it; declared on one side.
    twin : str
        Name of an effect that is nearly equivalent, with an amplitude where the other has a shape.
        The evidence penalises amplitudes but not shapes, so the two are compared by fit and by how
        well the data determine each; declared on one side.
    at_motor : Effect, optional
        The same law where the encoder reads the motor: this effect is its torque on a motor that
        moves unseen, and a simulation of both sides takes the law from there.
    beside : Effect, optional
        Competing effect with so many amplitudes that unlisted laws are among its forms. It is
        fitted only to test this effect against it and is never reported.
    likelier_than : Effect, optional
        Alternative that relaxes an assumption of this effect, which needs clearly more evidence
        than it, both fitted together with `beside`. Never reported either.
    reference : str
        Source of its form: a key of references.bib, or the source in words.
    drawn : callable, optional
        (amplitudes, shapes, constants) -> sampling error of reported values by name, from the small
        number of runs [its unit].
    of_runs : callable, optional
        (names) -> the entry with one amplitude per run, random about a common mean; (names,
        seen=False) -> the same for runs that were not recorded; (names, states=states) -> random
        about the mean of each state of the robot.
    change_robot : callable, optional
        Changes the robot that a planner computes with.
    only_in : tuple of str
        Names of the runs in which it acts: those of one state of the robot. Default: all runs.
    """

    name: str
    family: str
    scope: Scope
    equation: str
    signature: str
    term: Callable[[Any, Values, Values], Term]
    amplitudes: tuple[Amplitude, ...]
    shapes: tuple[Shape, ...] = ()
    report: Report | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    applies: Callable[[Any], bool] | None = None
    possible: Callable[[Sequence[float], Any], bool] | None = None
    usual: bool = False
    couples_joints: bool = False
    shifts_weight: bool = False
    moves_zero: bool = False
    yields: bool = False
    lags: bool = False
    is_play: bool = False
    linear_about: bool = False
    only_changed: bool = False
    separate: str = ""
    log_prior: Callable[[Any], float] | None = None
    title: str = ""
    phrase: str | tuple[str, str] = ""
    remedy: str | Remedy = ""
    nominal: str = ""
    nominal_words: str = ""
    signals_key: str = ""
    tolerances: tuple[str, ...] = ()
    needs: tuple[Need, ...] = ()
    only_without: tuple[Need, ...] = ()
    confused_with: tuple[str, ...] = ()
    twin: str = ""
    at_motor: Effect | None = None
    beside: Effect | None = None
    likelier_than: Effect | None = None
    reference: str = ""
    drawn: Report | None = None
    of_runs: Callable[..., Effect] | None = None
    change_robot: ChangeRobot | None = None
    only_in: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for field_name, default in (
            ("title", self.name.replace("_", " ")),
            ("phrase", self.title or self.name.replace("_", " ")),
            ("remedy", f"Look for the cause at {{where}}: {self.title or self.name}."),
            ("nominal_words", self.nominal.replace("_", " ")),
            ("tolerances", (self.nominal,) if self.nominal else ()),
            ("yields", self.family == "elastic"),
        ):
            if not getattr(self, field_name):
                object.__setattr__(self, field_name, default)

    @property
    def of_robot(self) -> bool:
        """True where its term acts on all joints, in every run or in one."""
        return self.scope in ("robot", "recording")

    @property
    def identity(self) -> tuple[str, tuple[str, ...]]:
        """Name and runs: a value common to all runs is another one than its change in some."""
        return (self.name, self.only_in)

    def at_instant(self, signals: Any, amplitudes: Values, shapes: Values) -> Term:
        """Return the term of a simulation, in which motor and link move by themselves."""
        entry = self.at_motor or self
        own = shapes[len(shapes) - len(entry.shapes) :]
        return entry.term(signals, amplitudes, own)

    def acts_in(self, run: str) -> bool:
        """Return True where the effect acts in a run of this name."""
        return not self.only_in or run in self.only_in

    @property
    def has_distinctive(self) -> bool:
        """True where some amplitudes distinguish it from other effects."""
        return any(each.own for each in self.amplitudes)

    @property
    def distinctive_amplitudes(self) -> list[int]:
        """Indices of the amplitudes that distinguish it from other effects."""
        return [k for k, each in enumerate(self.amplitudes) if each.own]

    def is_twin(self, other: Effect) -> bool:
        """Return True where both are the same, or nearly equivalent forms.

        Such are compared by fit, not by the prior of their amplitudes: the inertia of one link that
        equals a mass on another is far from its usual size, which says nothing of the place.
        """
        same = self.identity == other.identity
        return same or self.twin == other.name or other.twin == self.name

    def phrase_of(self, amplitudes: Sequence[float]) -> str:
        """Return the missing physics for a headline."""
        if isinstance(self.phrase, str):
            return self.phrase
        return self.phrase[amplitudes[0] < 0.0]

    def parameters(
        self, amplitudes: Sequence[float], shapes: Sequence[float], constants: Constants
    ) -> dict[str, float]:
        """Return the reported parameters by name."""
        if self.report is not None:
            return dict(self.report(amplitudes, shapes, constants))
        named = dict(zip((a.name for a in self.amplitudes), amplitudes, strict=True))
        pairs = zip(self.shapes, shapes, strict=True)
        return named | {shape.name: value for shape, value in pairs if shape.reported}

    def unit_of(self, parameter: str) -> str:
        """Return the unit of a reported parameter."""
        own: tuple[Amplitude | Shape, ...] = (*self.amplitudes, *self.shapes)
        for each in own:
            if each.name == parameter:
                return each.unit
        return self.units.get(parameter, "")
