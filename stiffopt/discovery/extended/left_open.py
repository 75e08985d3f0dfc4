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

if TYPE_CHECKING:
    from stiffopt.discovery.comparison.rows import ChannelNoise
    from stiffopt.discovery.settings import Settings


def left_open(
    ratio: np.ndarray, noise: ChannelNoise, settings: Settings, suspects: Mapping[str, float]
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
    """
    spread = np.nan_to_num(ratio) * np.nan_to_num([*noise.torque, *noise.deflection])
    torque, link = np.split(spread, 2)
    return LeftOpenSection(
        cutoff=settings.fit_band,
        predict=settings.predict,
        torque=tuple(map(float, torque)),
        link_position=tuple(map(float, link)),
        suspects=dict(suspects),
    )


def least_factors(section: LeftOpenSection | None, noise: ChannelNoise) -> np.ndarray | None:
    """Factors (2 n,) on the noise of every channel that make it what a model left open."""
    if section is None:
        return None
    left = np.array([*section.torque, *section.link_position])
    known = np.array([*noise.torque, *noise.deflection])
    return np.asarray(np.maximum(1.0, np.nan_to_num(left / known)))


def with_bands(settings: Settings, section: LeftOpenSection | None) -> Settings:
    """Settings with the bands of a model, where they state none and the model chose some."""
    if section is None or section.predict is None or settings.cutoff is not None:
        return settings
    return replace(settings, cutoff=section.cutoff, predict=section.predict)
