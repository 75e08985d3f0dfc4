"""Effects that a recording set can identify, and the data missing for the others."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stiffopt.discovery.catalogue import CATALOGUE
from stiffopt.discovery.comparison.located_effect import Extension, LocatedEffect
from stiffopt.discovery.effect import NEEDS, Amplitude, Effect
from stiffopt.discovery.signals import JointConstants
from stiffopt.discovery.user_effects import acts_at_rest, sample_term
from stiffopt.recording.joint_facts import JointFacts
from stiffopt.recording.recording_set import RecordingSet

# Where one of these is missing, further missing data are not listed.
_PREREQUISITE_NEEDS: tuple[str, ...] = (
    "torque",
    "link",
    "sensor",
    "torque_sensor",
    "commanded",
    "stated_gain",
    "windup",
    "moves",
    "gear_ratio",
)
# Properties of a motion, which poses at rest replace by effects that act at rest.
_MOTION_NEEDS: tuple[str, ...] = (
    "moves",
    "reverses",
    "slow",
    "speeds",
    "load_changes_sign",
    "rotor_slow",
    "ripple_slow",
)


@dataclass(frozen=True, kw_only=True)
class EffectCheck:
    """Result of the check if recordings can identify an effect."""

    effect: Effect
    joint: int | None  # from 1; None for an effect of the whole robot
    lacks: tuple[str, ...]  # missing data, a clause each; empty if the effect is identifiable

    @property
    def possible(self) -> bool:
        """True if no data are missing."""
        return not self.lacks

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {
            "effect": self.effect.name,
            "joint": self.joint,
            "lacks": list(self.lacks),
            "possible": self.possible,
        }


def required_signals(effect: Effect) -> tuple[str, ...]:
    """Return the data that an effect needs: as declared, else by the channels that it acts on."""
    if effect.needs:
        return effect.needs
    term = sample_term(effect)
    acts_on_torque = any(
        np.any(part) for part in (term.drive_torque, term.link_torque, term.previous_torque)
    )
    own: tuple[str, ...] = ("torque" if acts_on_torque else "link", "moves")
    return (*own, "runs") if effect.scope in ("run", "recording") else own


def effect_checks(
    recordings: RecordingSet,
    facts: Sequence[JointFacts],
    training_runs: int,
    effects: Sequence[Effect] = CATALOGUE,
) -> tuple[EffectCheck, ...]:
    """Check every effect at every joint, then those of the whole robot.

    `facts` (n,): of the training runs.
    """
    nominal, law = recordings.nominal, recordings.actuator
    of_set: dict[str, bool] = {
        "torque_sensor": not recordings.signals.commanded,
        "commanded": recordings.signals.commanded,
        "gear_ratio": nominal.gear_ratio is not None,
        "pole_pairs": nominal.pole_pairs is not None,
        "tool_frame": recordings.tool_frame is not None,
        "runs": training_runs > 1,
        "three_runs": training_runs >= 3,
        "session": training_runs > 1
        and all(run.session_time is not None for run in recordings.with_role("train")),
        "untimed_session": training_runs >= 3
        and all(run.session_time is None for run in recordings.runs),
    }

    def met(need: str, joint: int | None) -> bool:
        if need in of_set:
            return of_set[need]
        if need == "before":
            return bool(joint)
        if need == "stated_gain":
            return law is None or law.estimated is None or not law.estimated[joint]
        joints = facts if joint is None else facts[joint : joint + 1]
        return any(getattr(one, need) for one in joints)

    still = any(one.at_rest for one in facts)

    def check(effect: Effect, wanted: Iterable[str], joint: int | None) -> EffectCheck:
        """Check an effect; with poses at rest it must act without motion."""
        missing = [need for need in wanted if not met(need, joint)]
        if still:
            missing = [need for need in missing if need not in _MOTION_NEEDS]
        elif missing and missing[0] in _PREREQUISITE_NEEDS:
            missing = missing[:1]
        lacks = [NEEDS[need].missing for need in missing]
        if still and not lacks and (effect.of_runs is not None or not acts_at_rest(effect)):
            lacks = ["all poses are at rest"]
        place = None if joint is None else joint + 1
        return EffectCheck(effect=effect, joint=place, lacks=tuple(lacks))

    wanted = [(effect, required_signals(effect)) for effect in effects]
    robot = [pair for pair in wanted if pair[0].of_robot]
    joints = [pair for pair in wanted if not pair[0].of_robot]
    return (
        *(check(*pair, j) for j in range(recordings.n) for pair in joints),
        *(check(*pair, None) for pair in robot),
    )


def restrict_to_identifiable(
    catalogue: Sequence[Effect], checks: Sequence[EffectCheck]
) -> tuple[Effect, ...]:
    """Return the catalogue with every effect restricted to joints where it is identifiable.

    An effect that `recording check` calls not identifiable at a joint is never found there.

    `checks`: of every effect at every joint.
    """
    told: dict[str, set[int | None]] = {}
    for check in checks:
        joints = told.setdefault(check.effect.name, set())
        if check.possible:
            joints.add(check.joint)
    return tuple(_restrict_joints(entry, told.get(entry.name, set())) for entry in catalogue)


def _restrict_joints(entry: Effect, joints: set[int | None]) -> Effect:
    own = entry.applies

    def applies(constants: Any) -> bool:
        if own is not None and not own(constants):
            return False
        # For effects of a link or the robot one joint is enough.
        joint = getattr(constants, "joint", None)
        return bool(joints) if joint is None else joint in joints

    return replace(entry, applies=applies)


def locate_unstated(
    catalogue: Sequence[Effect],
    recordings: RecordingSet,
    joints: Sequence[JointConstants],
    usual: bool,
) -> tuple[LocatedEffect, ...]:
    """Return the effects at joints that replace nominal values which the set does not state.

    They belong to the calibrated nominal model: effects are sought beside them, not in their place.
    """
    return tuple(
        LocatedEffect(effect=_remove_upper_bounds(effect), joint=j, calibrated=True)
        for effect in catalogue
        if not effect.only_in
        and (effect.nominal in recordings.unstated or (usual and effect.usual))
        for j, constants in enumerate(joints)
        if effect.applies is None or effect.applies(constants)
    )


def select_unseen(
    effects: Sequence[LocatedEffect], unseen: np.ndarray, model: Extension
) -> tuple[LocatedEffect, ...]:
    """Return the effects in channels that an extended model has no recordings and effects of.

    `unseen` (2 n,) of bool: channels without recordings: torques, then link positions.
    """
    torque, link = np.split(unseen, 2)
    known = [each.located for each in model.effects]
    return tuple(
        located
        for located in effects
        if (link if "link" in required_signals(located.effect) else torque)[located.joint]
        and not any(located.same_place(other) for other in known)
    )


def remove_bounds(catalogue: Sequence[Effect], recordings: RecordingSet) -> tuple[Effect, ...]:
    """Return the catalogue without upper bounds on values that the nominal model does not state."""
    return tuple(
        _remove_upper_bounds(each) if each.nominal in recordings.unstated else each
        for each in catalogue
    )


def widen_for_changes(catalogue: Sequence[Effect]) -> tuple[Effect, ...]:
    """Return the catalogue with the wider amplitudes of changes since an extended model.

    Tools are exchanged and bodies rebuilt, which exceeds errors of a nominal model.
    """

    def wider(each: Amplitude) -> Amplitude:
        own, times = each.scale, each.changed
        scale = (lambda constants: times * own(constants)) if callable(own) else times * own
        return replace(each, scale=scale)

    return tuple(
        replace(entry, amplitudes=tuple(map(wider, entry.amplitudes))) for entry in catalogue
    )


def _remove_upper_bounds(entry: Effect) -> Effect:
    """Remove upper bounds, which are relative to a nominal value."""
    amplitudes = tuple(replace(a, upper=float("inf")) for a in entry.amplitudes)
    return replace(entry, amplitudes=amplitudes)
