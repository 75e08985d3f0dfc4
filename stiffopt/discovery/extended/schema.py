"""Schema of extended.toml."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from stiffopt.declaration import NOT_NEGATIVE, POSITIVE, Bounds, Doc, Frequency, Unit
from stiffopt.recording.schema import (
    JointPosition,
    JointStiffness,
    JointTorque,
    JointVelocity,
    JointViscous,
    Names,
    NominalSection,
    Ratio,
    Time,
)
from stiffopt.validation import Section

# Far above the bands of arm motions [Hz], and above amplitudes over their scales.
_BAND_BOUNDS = Bounds(above=0.0, most=1e4)
_STEP_BOUNDS = Bounds(least=-1e6, most=1e6)


class ParameterSection(Section):
    """Reported value of an effect."""

    value: Annotated[float, Doc("Value, in `unit`.")]
    sd: Annotated[float | None, Doc("One standard deviation, in `unit`.")] = None
    unit: Annotated[str, Doc("Unit of value and sd.")] = ""


class LawFactorSection(Section):
    """Factor of a law: a form of one signal."""

    signal: Annotated[str, Doc("Kind of signal, such as position, speed, load or height.")]
    joint: Annotated[int | None, Doc("Joint of the signal, numbered from 1.")] = None
    form: Annotated[
        str, Doc("Form of the law in it, such as linear or step, or the sum lag+linear.")
    ]
    bounds: Annotated[
        tuple[tuple[Ratio, Ratio], ...], Doc("Lowest and highest value of its shapes.")
    ] = ()


class LawSection(Section):
    """A law beyond the catalogue: product of forms of signals."""

    place: Annotated[
        Literal["drive_torque", "link_torque", "deflection"], Doc("What the law adds to.")
    ]
    factors: Annotated[tuple[LawFactorSection, ...], Doc("At most three; none for a constant.")]


class ResidualSection(Section):
    """Residual that no law explains, as a table of a signal; no planner uses it."""

    joint: Annotated[int, Doc("Joint, numbered from 1.")]
    place: Annotated[Literal["drive_torque", "deflection"], Doc("What the table adds to.")]
    times: Annotated[
        tuple[LawFactorSection, ...], Doc("Factors without shapes; none for the table alone.")
    ] = ()
    signal: Annotated[LawFactorSection, Doc('Signal of the table; its form is "linear".')]
    at: Annotated[tuple[Ratio, ...], Field(min_length=2), Doc("Values of the signal, rising.")]
    values: Annotated[
        tuple[Ratio, ...], Doc("Residual at these; beyond the ends that of the nearest end.")
    ]


class EffectSection(Section):
    """An effect at a place."""

    name: Annotated[str, Doc("Effect of the catalogue, or of a user's Python file.")]
    joint: Annotated[int | None, Doc("Joint, numbered from 1.")] = None
    link: Annotated[str | None, Doc("Link of the robot.")] = None
    run: Annotated[str | None, Doc("Run that it belongs to.")] = None
    probability: Annotated[Ratio | None, Doc("Probability against its rivals.")] = None
    step: Annotated[
        Ratio,
        _STEP_BOUNDS,
        Doc("Part of the first amplitude by which it was off the fit; of earlier versions."),
    ] = 0.0
    law: Annotated[
        LawSection | None, Doc("Form of an effect that is a law beyond the catalogue.")
    ] = None
    term: Annotated[
        dict[str, Ratio],
        Doc("Amplitudes and shapes of the effect's term, over the scales; read by `solve`."),
    ]
    parameters: Annotated[
        dict[str, ParameterSection], Doc("Reported parameters of the effect, for information.")
    ] = Field(default_factory=dict)


class ScalesSection(Section):
    """Scales of the terms of effects, one number a joint."""

    torque_rated: Annotated[tuple[Annotated[JointTorque, POSITIVE], ...], Doc("Rated torques.")]
    torque_max: Annotated[tuple[Annotated[JointTorque, POSITIVE], ...], Doc("Largest torques.")]
    fastest: Annotated[
        tuple[Annotated[JointVelocity, POSITIVE], ...],
        Doc("Fastest velocities of the training runs."),
    ]
    shown_coulomb: Annotated[
        tuple[Annotated[JointTorque, NOT_NEGATIVE], ...] | None,
        Doc("Dry friction that the training runs show; scales effects where none is stated."),
    ] = None
    shown_viscous: Annotated[
        tuple[Annotated[JointViscous, NOT_NEGATIVE], ...] | None,
        Doc("Viscous friction that the training runs show, likewise."),
    ] = None


class MadeForSection(Section):
    """Robot that the model was made for; another one is refused."""

    name: Annotated[str, Doc("Name of the robot.")]
    lengths: Annotated[
        tuple[Annotated[float, Unit("length", bare=True)], ...],
        Doc("Distance from each joint to the next."),
    ]
    masses: Annotated[
        tuple[Annotated[float, Unit("mass", bare=True)], ...],
        Doc("Masses of the bodies behind the joints, the last with its payload."),
    ]


class LeftOpenSection(Section):
    """Residual of the model in its own recordings."""

    cutoff: Annotated[Frequency, _BAND_BOUNDS, Doc("Cutoff of the filter of the fit.")]
    predict: Annotated[
        tuple[Annotated[Frequency, _BAND_BOUNDS], ...] | None,
        Doc("Cutoff of the motion that the torque of each joint is predicted from."),
    ] = None
    torque: Annotated[
        tuple[Annotated[JointTorque, NOT_NEGATIVE], ...],
        Doc("Standard deviation of each torque, as unfiltered noise; 0 without recordings."),
    ]
    link_position: Annotated[
        tuple[Annotated[JointPosition, NOT_NEGATIVE], ...], Doc("Likewise of each link encoder.")
    ]
    suspects: Annotated[
        dict[str, Ratio],
        Doc("Effects that the residual suggests, with log evidence per row of the fit."),
    ] = Field(default_factory=dict)
    sampling_rate: Annotated[
        Frequency | None,
        Bounds(above=0.0),
        Doc(
            "Sampling rate at which `torque` and `link_position` are noise of single samples: the"
            " residual lies within the band, and is larger noise at a higher rate. Default: that"
            " of the recordings to compare with."
        ),
    ] = None
    leanings: Annotated[
        dict[str, tuple[Ratio, ...]],
        Doc(
            "Amplitudes that single effects would have in the residual, in their units: possible"
            " errors of changes found later."
        ),
    ] = Field(default_factory=dict)


class ClosedLoopSection(Section):
    """Simulation of the arm from commanded positions, as `stiffopt rollout` uses it.

    Lists have one number a joint.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=True)

    stiffness: Annotated[
        tuple[JointStiffness, ...], Doc("Torque per position error; nan where it is not known.")
    ]
    damping: Annotated[tuple[JointViscous, ...], Doc("Torque per velocity.")]
    drive_max: Annotated[
        tuple[JointTorque, ...], Doc("Bound on the torque from the error; inf without.")
    ]
    torque_max: Annotated[tuple[JointTorque, ...], Doc("Bound on the torque; inf without.")]
    delay: Annotated[Time, NOT_NEGATIVE, Doc("Of commands, before the fit.")]
    tolerance: Annotated[
        tuple[Ratio, ...], Doc("One standard deviation of the gains before the fit, relative.")
    ]
    middle: Annotated[
        tuple[JointPosition, ...], Doc("Positions about which `friction_slope` turns.")
    ]
    values: Annotated[
        dict[str, tuple[Ratio, ...]],
        Doc("Fitted parameters in SI: of joints, changes of their bodies, and the delay."),
    ]
    deviations: Annotated[
        dict[str, tuple[Ratio, ...]], Doc("One standard deviation of each; 0 if not fitted.")
    ]
    expected: Annotated[
        dict[str, tuple[Ratio, ...]], Doc("The parameters before the fit, in SI.")
    ] = Field(default_factory=dict)
    expected_deviations: Annotated[
        dict[str, tuple[Ratio, ...]], Doc("One standard deviation of each; 0 if not fitted.")
    ] = Field(default_factory=dict)
    ratios: Annotated[
        dict[str, tuple[Ratio, ...]],
        Doc("Parameters over the gain in SI, of joints whose torque has no scale; else nan."),
    ] = Field(default_factory=dict)
    ratio_deviations: Annotated[
        dict[str, tuple[Ratio, ...]], Doc("One standard deviation of each.")
    ] = Field(default_factory=dict)
    integral: Annotated[
        tuple[Ratio, ...],
        Doc("Integral over proportional gain before the fit, in 1/s; none if left out."),
    ] = ()
    without: Annotated[
        tuple[str, ...], Doc("Effects of this model without which it simulates the runs as well.")
    ] = ()


class ExtendedFile(Section):
    """Nominal model with the findings of a diagnosis."""

    schema_: Annotated[int, Doc("Version of the format: 1.")] = Field(alias="schema")
    kind: Annotated[str, Doc('Kind of file: "extended".')]
    name: Annotated[str, Doc("Name of the recording set.")]
    joints: Annotated[
        Names, Field(min_length=1), Doc("Joints of the robot, in the order of every list.")
    ]
    links: Annotated[Names, Field(min_length=1), Doc("Links behind these joints.")]
    robot: MadeForSection | None = None
    nominal: NominalSection = NominalSection()
    scales: ScalesSection
    calibration: Annotated[
        dict[str, Ratio],
        Doc("Nominal values as estimated within their tolerances, over their tolerances."),
    ] = Field(default_factory=dict)
    left_open: LeftOpenSection | None = None
    closed_loop: ClosedLoopSection | None = None
    effect: Annotated[tuple[EffectSection, ...], Doc("Findings.")] = ()
    residual: Annotated[
        tuple[ResidualSection, ...], Doc("Tables of what no finding explains.")
    ] = ()
