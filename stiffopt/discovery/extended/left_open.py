"""Open residual of an extended model in its own recordings, with the bands of the fit.

A diagnosis that starts from an extended model searches for changes since. The residual of the model
in its own recordings is no change: it counts as noise, in the same bands.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.discovery.extended.schema import LeftOpenSection
from stiffopt.recording.nominal_files import missing_tolerances
from stiffopt.units import joint_unit

if TYPE_CHECKING:
    from stiffopt.discovery.comparison.channel_rows import ChannelNoise
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
    """Return the section `left_open` of extended.toml.

    `ratio` (2 n,): normalised residual of every channel; nan without rows. `settings`: with the
    chosen bands. `suspects`: effects that the residual suggests, with log evidence per row.
    `leanings`: amplitudes that single effects would have in it. `before`: section of the starting
    model, kept for channels without recordings. `rate`: sampling rate of these recordings [Hz].
    """
    spread = np.nan_to_num(ratio) * np.nan_to_num(noise.stacked)
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
    """Return the section with noise of single samples at another sampling rate [Hz].

    The residual lies within a band, so that its size does not depend on the rate, while white noise
    within a band falls with it. Without a stated rate the same one is assumed.
    """
    factor = 1.0 if section.sampling_rate is None else (rate / section.sampling_rate) ** 0.5
    changed = {
        "torque": tuple(factor * value for value in section.torque),
        "link_position": tuple(factor * value for value in section.link_position),
        "sampling_rate": rate,
    }
    return section.model_copy(update=changed)


def noise_factors(section: LeftOpenSection | None, noise: ChannelNoise) -> np.ndarray | None:
    """Return factors (2 n,) that raise the noise of every channel to the open residual of a model.

    nan for channels that the model's own recordings lack, as of a stationary joint.
    """
    if section is None:
        return None
    left = np.array([*section.torque, *section.link_position])
    return np.where(left > 0.0, np.maximum(1.0, np.nan_to_num(left / noise.stacked)), np.nan)


def adopt_bands(settings: Settings, section: LeftOpenSection | None) -> Settings:
    """Return settings with the bands of a model, if they state none themselves."""
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
    """Return sentences about the assumptions of a diagnosis from an extended model.

    `section`: section of the model. `least` (2 n,): factors on the noise; None if it is not raised.
    `asked`: settings before the model's bands were adopted. `tolerance`: tolerances that the set
    states. `prismatic` (n,) of bool.
    """
    found = []
    if silent := ", ".join(missing_tolerances(tolerance)):
        kept = "values of the model are fixed"
        near = "narrow defaults about values of the model are used"
        found.append(f"Tolerances not given, {near if least is None else kept}: {silent}.")
    if least is not None:
        raised = np.where(least > 1.0, least * noise.stacked, np.nan)
        for name, values, unit in zip(
            ("torques", "link positions"), np.split(raised, 2), ("N m", "rad"), strict=True
        ):
            each = ", ".join(
                f"{j + 1}: {values[j]:.3g} {joint_unit(unit, bool(prismatic[j]))}"
                for j in np.flatnonzero(np.isfinite(values))
            )
            if each:
                found.append(f"The model's open residual of {name} counts as noise (joint {each}).")
    taken = adopt_bands(asked, section)
    if taken is not asked and taken.predict is not None:
        each = ", ".join(f"{j}: {band:g}" for j, band in enumerate(taken.predict, start=1))
        found.append(
            f"Fits follow the recordings up to {taken.fit_band:g} Hz, predicted torques up to"
            f" (joint {each}) Hz: bands of the model."
        )
    return found
