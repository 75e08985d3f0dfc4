"""Residuals of held-out runs beyond those of every training run: states that training lacks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.discovery.judging.episodes import ONSET_RATIO, Episode, ResidualTrack
from stiffopt.discovery.judging.unexplained import HeldOutExcess, Unexplained
from stiffopt.discovery.names import channel_name


@dataclass(frozen=True)
class ChannelExcess:
    """The strongest residual of a held-out run, over that of every training run."""

    channel: int  # torques of the joints, then motor less link angles
    times_training: float
    run: HeldOutExcess


def find_excess(
    track: ResidualTrack, known: Sequence[ResidualTrack], episodes: Sequence[Episode]
) -> ChannelExcess | None:
    """Return the channel in which a held-out run differs most from all training runs.

    `known`: of the training runs. `episodes`: contact intervals, which do not count. None where no
    window is stronger than any of training by the ratio that starts a contact interval.
    """
    if not known:
        return None
    most = np.maximum(1.0, np.max([each.strength().max(axis=0) for each in known], axis=0))
    over = track.strength() / most
    for each in episodes:
        over[each.holds(track.time)] = 0.0
    channel = int(np.argmax(over.max(axis=0)))
    strong = np.flatnonzero(over[:, channel] > ONSET_RATIO)
    if not strong.size:
        return None
    ratio = float(np.nanmax(np.abs(track.left[strong, channel])))
    begin, end = (float(track.time[strong[k]]) for k in (0, -1))
    return ChannelExcess(
        channel, float(over[:, channel].max()), HeldOutExcess(track.run, begin, end, ratio)
    )


def describe_excess(excess: Sequence[ChannelExcess], n: int) -> Unexplained | None:
    """Return the residual beyond training of the held-out run that differs most; None without."""
    if not excess:
        return None
    worst = max(excess, key=lambda each: each.times_training)
    return Unexplained(
        channels=(channel_name(worst.channel, n),),
        regressors=(),
        period=None,
        gain=0.0,
        ratio=worst.run.ratio,
        held_out=worst.run,
    )
