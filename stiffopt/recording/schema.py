"""Schema of recordings.toml and static.toml; bare numbers in SI, lists with one per joint."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from stiffopt.actuator.kinds import ActuatorKind
from stiffopt.declaration import NOT_NEGATIVE, POSITIVE, Bounds, Doc, Unit
from stiffopt.recording.nominal import Tolerance
from stiffopt.validation import Section

Names = tuple[str, ...]
Text = Annotated[str, Field(min_length=1)]

Ratio = Annotated[float, Unit("ratio", bare=True)]
Time = Annotated[float, Unit("time", bare=True)]
Acceleration = Annotated[float, Unit("acceleration", bare=True)]
Temperature = Annotated[float, Unit("temperature", bare=True)]
JointPosition = Annotated[float, Unit("angle", joint=True, bare=True)]
JointVelocity = Annotated[float, Unit("angular velocity", joint=True, bare=True)]
JointTorque = Annotated[float, Unit("torque", joint=True, bare=True)]
JointInertia = Annotated[float, Unit("inertia", joint=True, bare=True)]
JointViscous = Annotated[float, Unit("viscous friction", joint=True, bare=True)]
JointStiffness = Annotated[float, Unit("stiffness", joint=True, bare=True)]

# An infinite stiffness is rigid.
_RIGID_BOUNDS = Bounds(above=0.0, finite=False)

_Position = Annotated[JointPosition, NOT_NEGATIVE]
_Velocity = Annotated[JointVelocity, NOT_NEGATIVE]
_Torque = Annotated[JointTorque, NOT_NEGATIVE]
_Limits = tuple[Annotated[JointTorque, POSITIVE], ...]
_Viscous = Annotated[JointViscous, NOT_NEGATIVE]
_RigidStiffness = tuple[Annotated[JointStiffness, _RIGID_BOUNDS], ...]
_RigidTorque = tuple[Annotated[JointTorque, _RIGID_BOUNDS], ...]


Factor = Annotated[float, Unit("ratio", bare=True)] | Text
Factors = Factor | tuple[Factor, ...]


class ScaleSection(Section):
    """Factors of columns to SI: a number, or the unit of the recording.

    One entry applies to all joints, a list has one per joint; a negative number reverses the sign.
    """

    time: Annotated[Factor | None, Doc('Of the time, such as "ms".')] = None
    position: Annotated[Factors | None, Doc('Of positions, such as "deg" or [1, -1].')] = None
    velocity: Annotated[Factors | None, Doc('Of velocities, such as "deg/s".')] = None
    link_position: Annotated[Factors | None, Doc("Of the encoders on the link's side.")] = None
    command: Annotated[
        Factors | None, Doc("Of commanded positions; default that of positions.")
    ] = None
    torque: Annotated[
        Factors | None,
        Doc(
            'Of torques: "mN*m", or N m per recorded unit, as of a motor current in A; "A", "mA", '
            '"%" or "counts" where that is not known yet, to have it estimated from the weight.'
        ),
    ] = None


class SignalsSection(Section):
    """Columns of the run files, "" where a joint lacks that signal."""

    time: Annotated[str, Doc("Time in s, increasing; may be jittered and have gaps.")] = ""
    position: Annotated[Names, Doc("Motor encoders through the ratios, in rad.")]
    velocity: Annotated[Names | None, Doc("Velocities in rad/s.")] = None
    link_position: Annotated[Names | None, Doc("Encoders on the link's side, in rad.")] = None
    torque: Annotated[
        Names | None,
        Doc(
            "Torques of the drives at the output side, in N m, or motor currents with N m per A in"
            " signals.scale. Where none is recorded, commands tell them by [actuator]."
        ),
    ] = None
    command: Annotated[
        Names | None,
        Doc(
            "Commanded positions in rad, as sent to the joints' controllers; each holds until the"
            " next. In place of torques: the law of [actuator] gives these from commands."
        ),
    ] = None
    torque_side: Annotated[
        Literal["motor", "link"] | None,
        Doc(
            'Where torque is measured: "motor" before friction, from the current; "link" by a '
            "joint torque sensor."
        ),
    ] = None
    torque_delay: Annotated[Time, Doc("By which torques were recorded later than positions.")] = 0.0
    position_includes: Annotated[
        tuple[int, ...] | None,
        Doc(
            "Joint whose position is contained in that of each joint: its number from 1, negative "
            "where it is subtracted, 0 for none. [0, 0, 2, 0, 0, 0] where joint 3 is reported as "
            "joint 2 + joint 3."
        ),
    ] = None
    offset: Annotated[
        tuple[JointPosition, ...] | None,
        Doc("Added to the positions of each joint, in rad: where its zero is off or another one."),
    ] = None
    at_rest: Annotated[
        bool | None,
        Doc(
            "True where each row is a pose at rest and time only numbers the poses, as in tables "
            "for gravity compensation; left out, it is seen from the rows."
        ),
    ] = None
    scale: ScaleSection = ScaleSection()


class ReducerCurvesSection(Section):
    """Catalogue curve of each reducer: slopes K between torques T; infinite is rigid."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=True)

    K1: Annotated[_RigidStiffness, Doc("Slopes below T1.")]
    K2: Annotated[_RigidStiffness, Doc("Slopes between T1 and T2.")]
    K3: Annotated[_RigidStiffness, Doc("Slopes above T2.")]
    T1: Annotated[_RigidTorque, Doc("Torques where the first range ends.")]
    T2: Annotated[_RigidTorque, Doc("Torques where the second range ends.")]


_BALANCED_JOINT_DOC = Doc("Joint that is balanced: its name, or its number from 1.")


class SpringSection(Section):
    """Spring that balances a joint."""

    type: Literal["spring"]
    joint: Annotated[int | str, _BALANCED_JOINT_DOC]
    stiffness: Annotated[JointStiffness, Doc("Stiffness of the spring.")]
    offset: Annotated[JointPosition, Doc("Position at which it is relaxed.")] = 0.0


class TableSection(Section):
    """Torque that balances a joint, by its position."""

    type: Literal["table"]
    joint: Annotated[int | str, _BALANCED_JOINT_DOC]
    angle: Annotated[tuple[JointPosition, ...], Doc("Positions, increasing; two or more.")]
    torque: Annotated[
        tuple[JointTorque, ...],
        Doc("Torques at these positions, of which the drive is relieved."),
    ]


CounterbalanceSection = Annotated[SpringSection | TableSection, Field(discriminator="type")]


class NominalSection(Section):
    """Nominal values of the simulation; every key is optional.

    Defaults are those of a shipped robot or robot TOML (drivetrain, friction, rotor inertia), or
    bodies and limits of a URDF. A reducer or a contact stiffness replaces the whole drivetrain.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=True)

    gear_ratio: Annotated[
        tuple[Ratio, ...] | None, Doc("Turns of the motor for one turn of the joint.")
    ] = None
    rotor_inertia: Annotated[
        tuple[Annotated[JointInertia, NOT_NEGATIVE], ...] | None,
        Doc("Inertia of the rotors, at the output side."),
    ] = None
    coulomb: Annotated[tuple[_Torque, ...] | None, Doc("Coulomb friction, at the output side.")] = (
        None
    )
    viscous: Annotated[
        tuple[_Viscous, ...] | None, Doc("Viscous friction, at the output side.")
    ] = None
    friction_temperature: Annotated[
        Temperature | None, Doc("Temperature at which friction was identified.")
    ] = None
    torque_max: Annotated[_Limits | None, Doc("Largest torques, at the output side.")] = None
    torque_rated: Annotated[_Limits | None, Doc("Rated torques, at the output side.")] = None
    pole_pairs: Annotated[Ratio | None, POSITIVE, Doc("Pole pairs of the motors.")] = None
    joint_damping: Annotated[tuple[_Viscous, ...] | None, Doc("Damping of the elastic joints.")] = (
        None
    )
    contact_stiffness: Annotated[
        _RigidStiffness | None,
        Doc("Healthy connections of each joint, lumped in series; infinite is rigid."),
    ] = None
    connections: Annotated[
        Names | None, Doc('Elements of each drivetrain, such as "belt+key+bolts".')
    ] = None
    reducer: ReducerCurvesSection | None = None
    counterbalance: Annotated[
        CounterbalanceSection | tuple[CounterbalanceSection, ...],
        Doc("Known elements that balance gravity."),
    ] = ()


class NoiseSection(Section):
    """One standard deviation of the sensors' noise; one number holds for all joints."""

    torque: Annotated[_Torque | tuple[_Torque, ...] | None, Doc("Of torques.")] = None
    velocity: Annotated[
        _Velocity | tuple[_Velocity, ...] | None,
        Doc("Of velocities."),
    ] = None
    link_position: Annotated[
        _Position | tuple[_Position, ...] | None, Doc("Of the encoders on the link's side.")
    ] = None
    position_resolution: Annotated[
        _Position | tuple[_Position, ...] | None, Doc("One count of the motor encoders.")
    ] = None
    link_position_resolution: Annotated[
        _Position | tuple[_Position, ...] | None,
        Doc("One count of the encoders on the link's side."),
    ] = None


class RunSection(Section):
    """One run file."""

    file: Annotated[
        Text,
        Doc(
            "Text, JSON, NPZ, Parquet, MATLAB, Excel, HDF5, MCAP, rosbag2 or .dat of a KUKA trace, "
            "relative to this file; FILE#PART for one of several runs in it, such as an episode of "
            "a LeRobot dataset (FILE.parquet#3), a group of HDF5 or a sheet."
        ),
    ]
    role: Annotated[
        Literal["train", "test", "extrapolate"],
        Doc("Test runs are never used to fit; extrapolate: test outside the training range."),
    ]
    session_time: Annotated[
        Annotated[Time, NOT_NEGATIVE] | None,
        Doc("Since the robot was switched on, at the run's beginning."),
    ] = None
    housing_temperature: Annotated[
        Temperature | tuple[Temperature, ...] | None,
        Doc("Of the joints' housings; one number holds for all."),
    ] = None


class ArmSection(Section):
    """Arm that was recorded, and where the recordings come from."""

    schema_: Annotated[int, Doc("Version of the format: 1.")] = Field(alias="schema")
    name: Annotated[Text, Doc("Name of the set.")]
    title: Annotated[str, Doc("Title in reports.")] = ""
    citation: Annotated[str, Doc("Who recorded it, and where it is published.")] = ""
    licence: Annotated[str, Doc("Licence of the recordings.")] = ""
    robot: Annotated[
        Text, Doc("A shipped robot, or the path of a robot file, URDF or MJCF beside this file.")
    ]
    joints: Annotated[
        Names, Field(min_length=1), Doc("Joints of the robot, in the order of every list.")
    ]
    gravity: Annotated[
        tuple[Acceleration, Acceleration, Acceleration] | None,
        Doc("Gravity in the base frame; default 9.81 m/s^2 along -z."),
    ] = None


class RecordingsFile(ArmSection):
    """Recordings of a robot, and the nominal model that a simulation of it uses today."""

    tool_frame: Annotated[str | None, Doc("Link or frame of the tool.")] = None
    signals: SignalsSection
    nominal: NominalSection = NominalSection()
    tolerance: Tolerance = Tolerance()
    noise: NoiseSection = NoiseSection()
    actuator: Annotated[
        ActuatorKind | None,
        Doc("Law by which the joints follow commands; default a position servo of unknown gain."),
    ] = None
    runs: Annotated[tuple[RunSection, ...], Field(min_length=1), Doc("The runs.")]


class StaticNominalSection(Section):
    """Nominal stiffness of the joints."""

    stiffness: Annotated[
        tuple[Annotated[JointStiffness, POSITIVE], ...] | None, Doc("Stiffness of each joint.")
    ] = None


class StaticScaleSection(Section):
    """Factors of columns to SI: a number, or the unit, where names of columns state none."""

    position: Annotated[Factors | None, Doc('Of joint positions, such as "deg".')] = None
    force: Annotated[Factors | None, Doc('Of forces, such as "kN"; one or one an axis.')] = None
    displacement: Annotated[
        Factors | None, Doc('Of displacements, such as "mm"; one or one an axis.')
    ] = None


class StaticFile(ArmSection):
    """Poses with a known force and a measured displacement of the tool."""

    kind: Annotated[Literal["static"], Doc("Kind of file.")]
    tool_frame: Annotated[str, Doc("Link or frame of the tool.")]
    poses: Annotated[
        Text,
        Doc("Table with a row a pose, relative to this file: text, Excel, NPZ, Parquet, MATLAB."),
    ]
    position: Annotated[
        Names,
        Doc('Columns of the joint positions, in rad or the unit of [scale] or of "q1 [deg]".'),
    ]
    force: Annotated[
        tuple[str, str, str],
        Doc(
            'Columns of the force on the tool, base frame, in N or the unit of [scale] or "F [kN]".'
        ),
    ]
    displacement: Annotated[
        tuple[str, str, str],
        Doc('Columns of its displacement, base frame, in m or the unit of [scale] or "x [mm]".'),
    ]
    difference: Annotated[
        bool, Doc("True: each line is a difference of two load states, without gravity.")
    ]
    scale: StaticScaleSection = StaticScaleSection()
    nominal: StaticNominalSection = StaticNominalSection()
