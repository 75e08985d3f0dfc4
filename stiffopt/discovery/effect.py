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
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol

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


class Need(NamedTuple):
    """Property of the joint or the recording set without which an effect cannot show."""

    phrase: str  # for the catalogue's page
    missing: str  # clause about a joint, or a set, without it


NEEDS = {
    "torque": Need("torque", "its torque is neither recorded nor given by a known gain"),
    "link": Need("link encoder", "it has no link encoder"),
    "sensor": Need("torque or link encoder", "neither its torque nor its link angle is recorded"),
    "torque_sensor": Need(
        "measured, not derived from commands",
        "torques are derived from commands, by their clock and scale",
    ),
    "commanded": Need(
        "torques derived from commands", "its torque is measured, or its actuator is not known"
    ),
    "stated_gain": Need(
        "no gain that is estimated from the recordings", "its gain is not stated but estimated"
    ),
    "windup": Need(
        "link encoder, or elastic vibration",
        "it has no link encoder, and not every joint has stiffness and damping",
    ),
    "moves": Need("motion", "it does not move"),
    "reverses": Need("both directions", "it moves in one direction only"),
    "slow": Need("slow motion", "it never moves slowly (0.005 to 0.1 rad/s)"),
    "speeds": Need("several speeds", "it moves at one speed only"),
    "load_changes_sign": Need(
        "load on both sides", "neither gravity nor inertia changes the sign of its load"
    ),
    "rotor_slow": Need(
        "slow turns of the rotor",
        "it moves too fast for the sampling rate to resolve turns of the rotor",
    ),
    "ripple_slow": Need(
        "slow turns of the motor's poles",
        "it moves too fast for the sampling rate to resolve the motor's poles",
    ),
    "warmer": Need(
        "cold and warm runs", "all runs are equally warm, or their session times are not given"
    ),
    "gear_ratio": Need("gear ratio", "nominal.gear_ratio is not given"),
    "pole_pairs": Need("pole pairs", "nominal.pole_pairs is not given"),
    "tool_frame": Need("tool frame", "tool_frame is not given"),
    "before": Need("a joint before it", "there is no joint before it"),
    "runs": Need("several runs", "there is only one training run"),
    "session": Need(
        "several runs at known times of a session",
        "there is one training run, or session_time of the runs is not given",
    ),
    "untimed_session": Need(
        "three runs whose session times are not given",
        "there are fewer than three training runs, or session_time of a run is given",
    ),
    "three_runs": Need("three runs", "there are fewer than three training runs"),
}


@dataclass(frozen=True, kw_only=True)
class Term:
    """Contributions of an effect to the equations of the measured channels; zero by default.

    Each is one value per sample for an effect of a joint, and one per sample and joint for an
    effect of the robot.
    """

    drive_torque: Quantity = 0.0  # added to the drive torque [N m]
    # Added to the spring torque [N m]: the drive has to give it, and the joint winds up under it.
    link_torque: Quantity = 0.0
    # Added to motor angle minus link angle by displacing the link [rad]; the link vibrates about
    # it.
    deflection: Quantity = 0.0
    reading: Quantity = 0.0  # added to the reading of motor angle minus link angle alone [rad]
    # Added to the drive torque of the previous joint [N m]; effects of a joint only.
    previous_torque: Quantity = 0.0


@dataclass(frozen=True)
class Amplitude:
    """Parameter in which an effect's term is linear."""

    name: str
    unit: str
    # Typical size, a function of the joint's constants where callable; standard deviation of the
    # prior.
    scale: Callable[[Any], float] | float = 1.0
    # lower, upper: physical bounds over the scale.
    lower: float = -float("inf")
    upper: float = float("inf")
    changed: float = 1.0  # ratio of the typical size of a change since a model was made to `scale`
    # Amplitude that distinguishes the effect from other entries: unless one of these is
    # significant, the effect is rejected.
    own: bool = False

    def size(self, constants: Constants) -> float:
        """Return the typical size for a joint or robot."""
        return float(self.scale(constants) if callable(self.scale) else self.scale)


@dataclass(frozen=True)
class Shape:
    """Parameter on which an effect's term depends nonlinearly."""

    name: str
    unit: str
    # Initial values of a fit, a function of the signals' ranges where callable.
    starts: Callable[[Any], Sequence[float]] | tuple[float, ...]
    # lower, upper: bounds [unit].
    lower: float = -float("inf")
    upper: float = float("inf")
    # Default where a file gives no value [unit]; without a default a file must give one.
    usual: float | None = None
    # "secant": the term is exact where the shape equals the amplitude of the same index.
    fit: ShapeFit = "free"
    # False for a value that says nothing of the arm, such as a point of linearisation.
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
    """Robot changed by a finding."""

    robot: Robot | None  # None where the robot cannot be changed so
    sentence: str  # change that was made, or the reason why none can be


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
    """An entry of the catalogue."""

    name: str
    family: str  # friction, elastic, periodic, inertial, geometry, sensor, spring, contact
    # Place that a finding names: a joint, the robot as a whole, a link, a joint in one run, or the
    # robot in one run.
    scope: Scope
    equation: str  # for reports
    signature: str  # visible sign of it in the recordings, in words
    term: Callable[[Any, Values, Values], Term]  # (signals, amplitudes, shapes) -> Term
    amplitudes: tuple[Amplitude, ...]
    shapes: tuple[Shape, ...] = ()
    # (amplitudes, shapes, constants) -> named values; default: amplitudes and reported shapes.
    report: Report | None = None
    # Units of reported values that are neither amplitudes nor shapes.
    units: Mapping[str, str] = field(default_factory=dict)
    # (constants) -> bool; False where the joint cannot have the effect (no pole pairs known).
    applies: Callable[[Any], bool] | None = None
    # (shapes, constants) -> bool; False for shapes that contradict the recordings.
    possible: Callable[[Sequence[float], Any], bool] | None = None
    # True where every real robot has a little of it: it is fitted from the start unless the nominal
    # model is vouched for.
    usual: bool = False
    # True for an effect of a joint whose term takes the signals of the robot, where `link` is the
    # joint, and returns values of all joints: it acts on others too, or reads their torques.
    couples_joints: bool = False
    # True where it changes the weight that several joints carry: a single one competes with
    # re-identified masses.
    shifts_weight: bool = False
    # True where it moves a torque reading in time, or to another joint: a reading of the torque
    # with all other effects that were found, friction included.
    reads_torque: bool = False
    # (amplitudes, stated gravity) -> gravity in the axes of the base (3,): bodies of other masses
    # and centres than the nominal ones hang in it too.
    turned_gravity: Callable[[Values, Any], Any] | None = None
    # True where its first amplitude is the position of the joint at which its encoder reads 0:
    # bodies of other masses than the nominal ones are elsewhere too.
    moves_zero: bool = False
    # True where its term with an amplitude of one is the part of the recorded torque of which the
    # motion tells nothing: the amplitude is known, and each sample of that part is an observation
    # of its own.
    takes_recorded: bool = False
    # True where its deflection depends on the load of its joint: the spring is softer or stiffer by
    # it; default: in the family elastic.
    yields: bool = False
    # True where its wind-up lags the load: the tangent stiffness is then that under a sudden change
    # of load.
    lags: bool = False
    # (signals, amplitudes, shapes) -> change of its deflection with that between motor and link
    # (K,), at most 0: friction beside the spring, which depends on that deflection itself.
    deflection_slope: Callable[[Any, Values, Values], Any] | None = None
    # True where its parameter "limit" is the largest torque of the joint's drive.
    limits_drive: bool = False
    # True if it acts at times that the recorded torques alone tell, such as from grasp to release.
    acts_for_a_while: bool = False
    # Nominal value of the joint of which the last amplitude is a share that is lost.
    loses: str = ""
    # True for free travel of a joint as a function of its spring torque alone, across which links
    # are simulated.
    is_play: bool = False
    # True where the first shape is the value of the first amplitude about which the term is linear:
    # the amplitude has to agree with it.
    linear_about: bool = False
    # True where it is sought only as a change since an extended model was made: a form so free fits
    # part of everything that a nominal model lacks.
    only_changed: bool = False
    separate: str = ""  # motion that separates it from similar effects
    # (constants) -> logarithm of its prior probability at that joint relative to other effects, 0
    # at most; default 0.
    log_prior: Callable[[Any], float] | None = None
    title: str = ""  # name in prose; default: the name with spaces
    # Missing physics, for a headline, with its values as placeholders: "{dm}" is the value with its
    # standard deviation, "{eps:%}" the same in percent, "{cx/cy/cz}" values in one unit. Two
    # phrases where it depends on the sign of the first amplitude, positive first: values are then
    # without sign. Default: the title.
    phrase: str | tuple[str, str] = ""
    # What to do: the value to enter, the part to look at. Placeholders as in `phrase`, and
    # "{where}" for the place and "{new}" for the nominal value with the change; or (amplitudes,
    # shapes, constants) -> the sentence with these. Default: a look at the place.
    remedy: str | Remedy = ""
    # Nominal value of every joint (a field of `Nominal` and of `Robot`) that the first amplitude
    # adds to; "" where there is none. Where a set does not state it, the effect takes its place.
    nominal: str = ""
    nominal_words: str = ""  # name of that value in prose; default: the field with spaces
    # Key of [signals] in recordings.toml that undoes it: its first parameter adds to that value.
    signals_key: str = ""
    # Nominal values (fields of `Tolerance`) that it changes beyond what their tolerances allow;
    # default: `nominal`.
    tolerances: tuple[str, ...] = ()
    # Keys of `NEEDS` without which it cannot show at a joint, the most basic first.
    # Default: the sensor that the term acts on, and motion.
    needs: tuple[str, ...] = ()
    only_without: tuple[str, ...] = ()  # nominal values with which another entry takes its place
    # Names of effects that ordinary motions separate poorly from it; declared on one side.
    confused_with: tuple[str, ...] = ()
    # Name of an effect that is nearly equivalent, with an amplitude where the other has a shape.
    # The evidence penalises amplitudes but not shapes, so the two are compared by fit and by how
    # well the data determine each; declared on one side.
    twin: str = ""
    # The same law where the encoder reads the motor: this effect is its torque on a motor that
    # moves unseen, and a simulation of both sides takes the law from there.
    at_motor: Effect | None = None
    # Competing effect with so many amplitudes that unlisted laws are among its forms. It is fitted
    # only to test this effect against it and is never reported.
    beside: Effect | None = None
    # Alternative that relaxes an assumption of this effect, which needs clearly more evidence than
    # it, both fitted together with `beside`. Never reported either.
    likelier_than: Effect | None = None
    reference: str = ""  # source of its form: a key of references.bib, or the source in words
    # (amplitudes, shapes, constants) -> sampling error of reported values by name, from the small
    # number of runs [its unit].
    drawn: Report | None = None
    # (names, states) -> the entry with one amplitude per run, random about the mean of each state
    # of the robot; of one state by default.
    of_runs: Callable[..., Effect] | None = None
    change_robot: ChangeRobot | None = None  # changes the robot that a planner computes with
    # Names of the runs in which it acts: those of one state of the robot. Default: all runs.
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
    def changes_geometry(self) -> bool:
        """True where bodies of any mass are elsewhere, or hang otherwise, than in the model."""
        return self.moves_zero or self.turned_gravity is not None

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
