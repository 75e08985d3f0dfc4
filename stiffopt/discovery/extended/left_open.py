"""What an extended model leaves of the recordings that it was made from, and how fast it follows.

No model of a real robot is whole. A diagnosis that starts from an extended model looks for what has
changed since, and what the model left of its own recordings is no change: it counts as noise, seen
through the same bands.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.discovery.extended.schema import LeftOpenSection
from stiffopt.recording.assumptions import not_given
from stiffopt.units import joint_unit

if TYPE_CHECKING:
    from stiffopt.discovery.comparison.rows import ChannelNoise
    from stiffopt.discovery.settings import Settings
    from stiffopt.recording.nominal import Tolerance


def left_open_section(
    ratio: np.ndarray,
    noise: ChannelNoise,
    settings: Settings,
    suspects: Mapping[str, float],
    leanings: Mapping[str, tuple[float, ...]],
    before: LeftOpenSection | None = None,
    rate: float | None = None,
) -> LeftOpenSection:
    """Section of extended.toml.

    Parameters
    ----------
    ratio : array (2 n,)
        What is left in every channel over its noise; nan without rows.
    noise : ChannelNoise
    settings : Settings
        With the bands that were chosen.
    suspects : mapping of str to float
        What is left hints at, with log evidence for a row.
    leanings : mapping of str to tuple of float
        Amplitudes that effects alone would take of it.
    before : LeftOpenSection, optional
        Of the model that was started from: what these recordings do not show stays as it was.
    rate : float, optional
        Clock of these recordings [Hz].
    """
    spread = np.nan_to_num(ratio) * np.nan_to_num([*noise.torque, *noise.deflection])
    if before is not None:
        spread = np.where(spread > 0.0, spread, [*before.torque, *before.link_position])
    torque, link = np.split(spread, 2)
    return LeftOpenSection(
        cutoff=settings.fit_band,
        predict=settings.predict,
        torque=tuple(map(float, torque)),
        link_position=tuple(map(float, link)),
        suspects=dict(suspects),
        sampling_rate=rate,
        leanings=dict(leanings),
    )


def rescale_to_rate(section: LeftOpenSection, rate: float) -> LeftOpenSection:
    """The section as noise of samples at another clock [Hz].

    What is left within a band is as large however often it is sampled: of white noise it would be
    the less, the faster samples come. Of a file that tells no clock it is taken to be the same.
    """
    factor = 1.0 if section.sampling_rate is None else (rate / section.sampling_rate) ** 0.5
    changed = {
        "torque": tuple(factor * value for value in section.torque),
        "link_position": tuple(factor * value for value in section.link_position),
        "sampling_rate": rate,
    }
    return section.model_copy(update=changed)


def noise_factors(section: LeftOpenSection | None, noise: ChannelNoise) -> np.ndarray | None:
    """Factors (2 n,) on the noise of every channel that make it what a model left open.

    nan where the model's own recordings show nothing of a channel, as of a joint that stood still.
    """
    if section is None:
        return None
    left = np.array([*section.torque, *section.link_position])
    known = np.array([*noise.torque, *noise.deflection])
    return np.where(left > 0.0, np.maximum(1.0, np.nan_to_num(left / known)), np.nan)


def adopt_bands(settings: Settings, section: LeftOpenSection | None) -> Settings:
    """Settings with the bands of a model, where they state none and the model chose some."""
    if section is None or section.predict is None or settings.cutoff is not None:
        return settings
    return replace(settings, cutoff=section.cutoff, predict=section.predict)


def describe_assumptions(
    section: LeftOpenSection | None,
    least: np.ndarray | None,
    noise: ChannelNoise,
    asked: Settings,
    tolerance: Tolerance,
    prismatic: np.ndarray,
) -> list[str]:
    """Sentences on what holds where a diagnosis starts from an extended model.

    Parameters
    ----------
    section : LeftOpenSection or None
        Of the model.
    least : array (2 n,) or None
        Factors that the noise is raised by; None where it is not.
    noise : ChannelNoise
    asked : Settings
        Before the model's bands were taken over.
    tolerance : Tolerance
        That the set states.
    prismatic : array (n,) of bool
    """
    found = []
    if silent := ", ".join(not_given(tolerance)):
        kept = "nominal values stay as the model has them"
        near = "narrow defaults about the values of the model hold"
        found.append(f"Tolerances not given, {near if least is None else kept}: {silent}.")
    if least is not None:
        raised = np.where(least > 1.0, least * [*noise.torque, *noise.deflection], np.nan)
        for name, values, unit in zip(
            ("torques", "link positions"), np.split(raised, 2), ("N m", "rad"), strict=True
        ):
            each = ", ".join(
                f"{j + 1}: {values[j]:.3g} {joint_unit(unit, bool(prismatic[j]))}"
                for j in np.flatnonzero(np.isfinite(values))
            )
            if each:
                found.append(f"What the model left open of {name} counts as noise (joint {each}).")
    taken = adopt_bands(asked, section)
    if taken is not asked and taken.predict is not None:
        each = ", ".join(f"{j}: {band:g}" for j, band in enumerate(taken.predict, start=1))
        found.append(
            f"Fits follow the recordings up to {taken.fit_band:g} Hz, predicted torques up to"
            f" (joint {each}) Hz: bands of the model."
        )
    return found
