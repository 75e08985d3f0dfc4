"""Noise of the channels: as the set states it, from the recordings where it states none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.discovery.comparison.prepare import PreparedRun
from stiffopt.discovery.comparison.rows import ChannelNoise
from stiffopt.recording.channel import DEVIATION_PER_MAD
from stiffopt.recording.nominal import Noise

# Standard deviation of what rounding to one count leaves.
_ROUNDING = 12.0**-0.5
# Least noise that is estimated, of a channel's own range: recordings that were smoothed hold less,
# and no model of a robot is better.
_LEAST = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownNoise:
    """Noise that a diagnosis works with, and where it comes from.

    Parameters
    ----------
    channels : ChannelNoise
        Torque [N m] and deflection [rad], one standard deviation each (n,).
    torque_stated, deflection_stated : array (n,) of bool
        Taken from the set; otherwise estimated.
    """

    channels: ChannelNoise
    torque_stated: np.ndarray
    deflection_stated: np.ndarray

    def assumptions(self) -> list[str]:
        """Sentences about what was estimated."""
        found = []
        for name, values, stated, unit in (
            ("Torque", self.channels.torque, self.torque_stated, "N m"),
            ("Link encoder", self.channels.deflection, self.deflection_stated, "rad"),
        ):
            guessed = np.flatnonzero(~stated & np.isfinite(values))
            if guessed.size:
                each = ", ".join(f"{j + 1}: {values[j]:.3g} {unit}" for j in guessed)
                found.append(
                    f"{name} noise is what the training runs hold above the filter's cutoff"
                    f" (joint {each})."
                )
        return found


def known_noise(stated: Noise, runs: Sequence[PreparedRun]) -> KnownNoise:
    """Noise of unfiltered channels.

    Parameters
    ----------
    stated : Noise
    runs : sequence of PreparedRun
        Training runs, for what is not stated.

    Notes
    -----
    An estimate is the spread of what the zero-phase low-pass takes away, for white noise of that
    spread; by medians, so that jerks at reversals hardly count. What moves above the cutoff counts
    as noise. A channel that no run has is nan. Rounding to a count is the least there is.
    """
    torque, torque_stated = _channels(
        stated.torque, None, [run.torque for run in runs], runs, (None,)
    )
    deflection, deflection_stated = _channels(
        stated.link_position,
        stated.link_position_resolution,
        [run.deflection for run in runs],
        runs,
        (stated.link_position_resolution, stated.position_resolution),
    )
    return KnownNoise(
        channels=ChannelNoise(torque, deflection),
        torque_stated=torque_stated,
        deflection_stated=deflection_stated,
    )


def above_cutoff(runs: Sequence[PreparedRun]) -> np.ndarray:
    """Noise (2 n,) that runs hold above the filter's cutoff, torques first; nan without samples."""
    n = runs[0].torque.shape[1]
    kinds = ([run.torque for run in runs], [run.deflection for run in runs])
    return np.array(
        [_estimate([samples[:, j] for samples in kind], runs) for kind in kinds for j in range(n)]
    )


def _channels(
    stated: np.ndarray | None,
    count: np.ndarray | None,
    samples: Sequence[np.ndarray],
    runs: Sequence[PreparedRun],
    counts: Sequence[np.ndarray | None],
) -> tuple[np.ndarray, np.ndarray]:
    n = samples[0].shape[1]
    own = np.zeros(n) if stated is None else np.nan_to_num(stated)
    rounding = np.sqrt(sum((np.zeros(n) if c is None else c) ** 2 for c in counts)) * _ROUNDING
    floor = np.zeros(n) if count is None else count * _ROUNDING
    values, known = np.maximum(own, floor), own > 0.0
    for j in np.flatnonzero(~known):
        guess = _estimate([s[:, j] for s in samples], runs)
        values[j] = np.maximum(guess, rounding[j])
    return values, known


def _estimate(channels: Sequence[np.ndarray], runs: Sequence[PreparedRun]) -> float:
    spreads, extent = [], 0.0
    for run, channel in zip(runs, channels, strict=True):
        known = np.isfinite(channel)
        if known.sum() < 10:
            continue
        places = np.arange(len(channel))
        filled = np.interp(places, places[known], channel[known])
        rest = (filled - run.low_pass(filled))[known]
        pulse = np.zeros(2 * run.low_pass.settling + 201)
        pulse[len(pulse) // 2] = 1.0
        gain = float(np.linalg.norm(pulse - run.low_pass(pulse)))
        spreads.append(DEVIATION_PER_MAD * float(np.median(np.abs(rest - np.median(rest)))) / gain)
        extent = max(extent, float(np.ptp(filled)))
    if not spreads:
        return float("nan")
    return max(float(np.median(spreads)), _LEAST * extent, np.finfo(float).tiny)
