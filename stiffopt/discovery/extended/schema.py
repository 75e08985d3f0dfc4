"""Schema of extended.toml."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from stiffopt.declaration import NOT_NEGATIVE, POSITIVE, Bounds, Doc, Frequency, Unit
from stiffopt.recording.schema import (
    JointPosition,
    JointTorque,
    JointVelocity,
    Names,
    NominalSection,
    Ratio,
)
from stiffopt.validation import Section

# Far above the bands that motions of arms have, and amplitudes over their scales.
_BAND_BOUNDS = Bounds(above=0.0, most=1e4)
_STEP_BOUNDS = Bounds(least=-1e6, most=1e6)


class ParameterSection(Section):
    """Reported value of an effect."""

    value: Annotated[float, Doc("Value, in `unit`.")]
    sd: Annotated[float | None, Doc("One standard deviation, in `unit`.")] = None
    unit: Annotated[str, Doc("Unit of value and sd.")] = ""


class EffectSection(Section):
    """An effect at a place."""

    name: Annotated[str, Doc("Effect of the catalogue, or of one's own file.")]
    joint: Annotated[int | None, Doc("Joint, numbered from 1.")] = None
    link: Annotated[str | None, Doc("Link of the URDF.")] = None
    run: Annotated[str | None, Doc("Run that it belongs to.")] = None
    probability: Annotated[Ratio | None, Doc("Of the effect against its rivals.")] = None
    step: Annotated[
        Ratio,
        _STEP_BOUNDS,
        Doc("Of the first amplitude, from what the fit found to what all moving samples say."),
    ] = 0.0
    term: Annotated[
        dict[str, Ratio],
        Doc("Amplitudes and shapes of the effect's terms, over the scales; read by `solve`."),
    ]
    parameters: Annotated[
        dict[str, ParameterSection], Doc("Parameters of the effect, for people.")
    ] = Field(default_factory=dict)


class ScalesSection(Section):
    """What the terms of effects are measured against, one number a joint."""

    torque_rated: Annotated[tuple[Annotated[JointTorque, POSITIVE], ...], Doc("Rated torques.")]
    torque_max: Annotated[tuple[Annotated[JointTorque, POSITIVE], ...], Doc("Largest torques.")]
    fastest: Annotated[
        tuple[Annotated[JointVelocity, POSITIVE], ...],
        Doc("Fastest velocities of the training runs."),
    ]


class MadeForSection(Section):
    """Robot that the model was made for; another one is refused."""

    name: Annotated[str, Doc("Name of the robot.")]
    lengths: Annotated[
        tuple[Annotated[float, Unit("length", bare=True)], ...],
        Doc("From each joint to the next."),
    ]
    masses: Annotated[
        tuple[Annotated[float, Unit("mass", bare=True)], ...],
        Doc("Of the bodies behind the joints, the last with its payload."),
    ]


class LeftOpenSection(Section):
    """What the model leaves of the recordings that it was fitted to."""

    cutoff: Annotated[Frequency, _BAND_BOUNDS, Doc("Of the filter that it was fitted through.")]
    predict: Annotated[
        tuple[Annotated[Frequency, _BAND_BOUNDS], ...] | None,
        Doc("Of the motion that the torque of each joint is predicted from."),
    ] = None
    torque: Annotated[
        tuple[Annotated[JointTorque, NOT_NEGATIVE], ...],
        Doc("One standard deviation of each torque, as unfiltered noise; 0 where none is."),
    ]
    link_position: Annotated[
        tuple[Annotated[JointPosition, NOT_NEGATIVE], ...],
        Doc("Likewise of each link encoder."),
    ]
    suspects: Annotated[
        dict[str, Ratio],
        Doc("Effects that what is left hints at, with log evidence for a row of the fit."),
    ] = Field(default_factory=dict)
    sampling_rate: Annotated[
        Frequency | None,
        Bounds(above=0.0),
        Doc(
            "Clock that `torque` and `link_position` are noise of single samples at: what is left"
            " lies within the band, and is noise of more where samples come faster. Default: that"
            " of the recordings it is compared with."
        ),
    ] = None
    leanings: Annotated[
        dict[str, tuple[Ratio, ...]],
        Doc(
            "Amplitudes that effects alone would take of what is left, in their own units: so far"
            " off what is found of a change may be."
        ),
    ] = Field(default_factory=dict)


class ExtendedFile(Section):
    """The nominal model with what a diagnosis found."""

    schema_: Annotated[int, Doc("Version of the format: 1.")] = Field(alias="schema")
    kind: Annotated[str, Doc('Kind of file: "extended".')]
    name: Annotated[str, Doc("Name of the recording set.")]
    joints: Annotated[
        Names, Field(min_length=1), Doc("Joints of the URDF, in the order of every list.")
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
    effect: Annotated[tuple[EffectSection, ...], Doc("Effects that were found.")] = ()
