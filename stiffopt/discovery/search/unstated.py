"""What a nominal model says nothing about, although every joint has it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.effect import Effect
from stiffopt.recording.recording_set import RecordingSet

_OF_EVERY_JOINT = ("coulomb", "viscous", "rotor_inertia")


def unstated_effects(recordings: RecordingSet) -> tuple[LocatedEffect, ...]:
    """Effects that stand for values the set does not give: friction and rotor inertia.

    They are tried together before anything else; what the recordings do not bear out is dropped.
    """
    found = []
    for name in _OF_EVERY_JOINT:
        if getattr(recordings.nominal, name) is None:
            entry = _unbounded(effect(name))
            found += [LocatedEffect(effect=entry, joint=j) for j in range(len(recordings.joints))]
    return tuple(found)


def without_bounds(catalogue: Sequence[Effect], recordings: RecordingSet) -> tuple[Effect, ...]:
    """The catalogue, where what the nominal model does not state may be of any size."""
    unstated = {name for name in _OF_EVERY_JOINT if getattr(recordings.nominal, name) is None}
    return tuple(_unbounded(each) if each.name in unstated else each for each in catalogue)


def _unbounded(entry: Effect) -> Effect:
    """The effect without the upper bounds that compare it with a nominal value."""
    amplitudes = tuple(replace(a, upper=float("inf")) for a in entry.amplitudes)
    return replace(entry, amplitudes=amplitudes)
