"""Worst arms within an uncertainty, by exchange of the corners of its parameters.

In flight errors are almost additive in the parameters; after arrival they depend on the phases of
the modes, and no arm with all joints alike is the worst. From the worst corners with joints alike,
parameters whose change alone makes the error larger are changed together, those of most gain first.
"""

from __future__ import annotations

import functools

import numpy as np

from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.uncertain_arms import Member, UncertainArms
from stiffopt.elastic.uncertainty import ParameterBox

# Rounds of exchanges: most searches end after three.
_MAX_ROUNDS = 5
# Relative increase of a peak that counts.
_MIN_INCREASE = 1e-3


def peaks_on_levels(
    many: UncertainArms, command: MotorMotion, box: ParameterBox, levels: np.ndarray
) -> np.ndarray:
    """Peaks (2, ..) on arms of levels (.., 2 n + 3), where it is searched [m]."""
    flat = levels.reshape(-1, levels.shape[-1])
    peaks = many.position_peaks(_members(command, box, flat), searched=True)
    return peaks.reshape(2, *levels.shape[:-1])


def corner_peaks(many: UncertainArms, command: MotorMotion, box: ParameterBox) -> np.ndarray:
    """Peaks (2, c) [m] on the corners with joints alike; from now on searched are theirs."""
    return many.search_where_worst(_members(command, box, box.alike_corners()))


def _members(command: MotorMotion, box: ParameterBox, levels: np.ndarray) -> list[Member]:
    return [Member(command=command, departure=box.departure(each)) for each in levels]


def worst_levels(
    many: UncertainArms, command: MotorMotion, box: ParameterBox, peaks: np.ndarray | None = None
) -> np.ndarray:
    """Search the levels of the worst arms of a command: the worst in flight, then after arrival.

    Levels (s, 2 n + 3) are those of s searches, of which each phase has one from soft and one from
    stiff joints. `peaks` (2, c): as of `corner_peaks`, where they are known.
    """
    simulated = functools.partial(peaks_on_levels, many, command, box)
    corners = box.alike_corners()
    peaks = corner_peaks(many, command, box) if peaks is None else peaks
    # The first half of the corners is soft, the second stiff.
    halves = np.array_split(np.arange(len(corners)), 2 if len(corners) > 1 else 1)
    chosen = [half[np.argmax(own[half])] for own in peaks for half in halves]
    phase = np.repeat([0, 1], len(halves))
    levels, worst = corners[chosen], peaks[phase, chosen]
    searches, flips = np.arange(len(levels)), len(box.free)
    active = searches if flips else searches[:0]
    for _ in range(_MAX_ROUNDS):
        if not active.size:
            break
        own = phase[active, None], np.arange(len(active))[:, None]
        # Each parameter alone, then the first, the first two, ... in order of gain.
        alone = np.repeat(levels[active, None], flips, axis=1)
        alone[:, np.arange(flips), box.free] *= -1.0
        single = simulated(alone)[(*own, np.arange(flips))]
        order = np.argsort(-single, axis=1)
        turned = np.repeat(levels[active, None], flips, axis=1)
        for k in range(flips):
            turned[own[1][:, 0], k:, box.free[order[:, k]]] *= -1.0
        gaining = int(np.max(np.sum(single > worst[active, None], axis=1), initial=0))
        together = turned[:, : max(gaining, 1)]
        joined = simulated(together)[(*own, np.arange(together.shape[1]))]
        best = np.argmax(joined, axis=1)
        found = joined[np.arange(len(active)), best]
        better = found > (1.0 + _MIN_INCREASE) * worst[active]
        levels[active[better]] = together[better, best[better]]
        worst[active[better]] = found[better]
        active = active[better]
    return levels
