"""What a nominal model says nothing about, although every joint has it: friction, rotor inertia."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.effect import Effect
from stiffopt.recording.recording_set import RecordingSet


def unstated_effects(
    catalogue: Sequence[Effect], recordings: RecordingSet
) -> tuple[LocatedEffect, ...]:
    """Effects that stand for values the set does not give.

    They are tried together before anything else; what the recordings do not bear out is dropped.
    """
    return tuple(
        LocatedEffect(effect=_unbounded(effect), joint=j)
        for effect in catalogue
        if _stands_for_unstated(effect, recordings)
        for j in range(len(recordings.joints))
    )


def without_bounds(catalogue: Sequence[Effect], recordings: RecordingSet) -> tuple[Effect, ...]:
    """The catalogue, where what the nominal model does not state may be of any size."""
    return tuple(
        _unbounded(each) if _stands_for_unstated(each, recordings) else each for each in catalogue
    )


def _stands_for_unstated(effect: Effect, recordings: RecordingSet) -> bool:
    return effect.nominal in recordings.unstated


def _unbounded(entry: Effect) -> Effect:
    """The effect without the upper bounds that compare it with a nominal value."""
    amplitudes = tuple(replace(a, upper=float("inf")) for a in entry.amplitudes)
    return replace(entry, amplitudes=amplitudes)
