"""The catalogue as a recording set can show it: what is asked of it, and where."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from stiffopt.discovery.comparison.located_effect import Extension, LocatedEffect
from stiffopt.discovery.effect import Amplitude, Effect
from stiffopt.discovery.identifiable import EffectCheck, needs
from stiffopt.discovery.signals import JointConstants
from stiffopt.recording.recording_set import RecordingSet


def identifiable_effects(
    catalogue: Sequence[Effect], checks: Sequence[EffectCheck]
) -> tuple[Effect, ...]:
    """The catalogue, each entry only where the recordings can tell it.

    What `recording check` says cannot be told of a joint is never claimed there.

    Parameters
    ----------
    catalogue : sequence of Effect
    checks : sequence of EffectCheck
        Of every entry at every joint.
    """
    told: dict[str, set[int | None]] = {}
    for check in checks:
        joints = told.setdefault(check.effect.name, set())
        if check.possible:
            joints.add(check.joint)
    return tuple(_only(entry, told.get(entry.name, set())) for entry in catalogue)


def _only(entry: Effect, joints: set[int | None]) -> Effect:
    own = entry.applies

    def applies(constants: Any) -> bool:
        if own is not None and not own(constants):
            return False
        # Of a link or the robot one joint that shows it is enough.
        joint = getattr(constants, "joint", None)
        return bool(joints) if joint is None else joint in joints

    return replace(entry, applies=applies)


def unstated_effects(
    catalogue: Sequence[Effect],
    recordings: RecordingSet,
    joints: Sequence[JointConstants],
    usual: bool,
) -> tuple[LocatedEffect, ...]:
    """Effects that stand for values the set does not give.

    They are tried together before anything else; what the recordings do not bear out is dropped.
    """
    return tuple(
        LocatedEffect(effect=_unbounded(effect), joint=j)
        for effect in catalogue
        if _stands_for_unstated(effect, recordings) or (usual and effect.usual)
        for j, constants in enumerate(joints)
        if effect.applies is None or effect.applies(constants)
    )


def of_unseen(
    effects: Sequence[LocatedEffect], unseen: np.ndarray, model: Extension
) -> tuple[LocatedEffect, ...]:
    """Those of channels that an extended model has seen nothing of, and says nothing of.

    Parameters
    ----------
    effects : sequence of LocatedEffect
    unseen : array (2 n,) of bool
        Torques, then link positions.
    model : Extension
    """
    torque, link = np.split(unseen, 2)
    known = [each.located for each in model.effects]
    return tuple(
        located
        for located in effects
        if (link if "link" in needs(located.effect) else torque)[located.joint]
        and not any(located.same_place(other) for other in known)
    )


def without_bounds(catalogue: Sequence[Effect], recordings: RecordingSet) -> tuple[Effect, ...]:
    """The catalogue, where what the nominal model does not state may be of any size."""
    return tuple(
        _unbounded(each) if _stands_for_unstated(each, recordings) else each for each in catalogue
    )


def of_changes(catalogue: Sequence[Effect]) -> tuple[Effect, ...]:
    """The catalogue as a change since an extended model was made may be: by far larger at times.

    Tools are exchanged and bodies rebuilt; what nobody has weighed yet is off by less.
    """

    def wider(each: Amplitude) -> Amplitude:
        own, times = each.scale, each.changed
        scale = (lambda constants: times * own(constants)) if callable(own) else times * own
        return replace(each, scale=scale)

    return tuple(
        replace(entry, amplitudes=tuple(map(wider, entry.amplitudes))) for entry in catalogue
    )


def _stands_for_unstated(effect: Effect, recordings: RecordingSet) -> bool:
    return effect.nominal in recordings.unstated


def _unbounded(entry: Effect) -> Effect:
    """The effect without the upper bounds that compare it with a nominal value."""
    amplitudes = tuple(replace(a, upper=float("inf")) for a in entry.amplitudes)
    return replace(entry, amplitudes=amplitudes)
