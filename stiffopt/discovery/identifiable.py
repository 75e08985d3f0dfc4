"""Which effects a recording set can show, and what it lacks for the others."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stiffopt.discovery.catalogue import CATALOGUE
from stiffopt.discovery.effect import Effect, Need
from stiffopt.discovery.soundness import probed
from stiffopt.recording.joint_facts import JointFacts
from stiffopt.recording.recording_set import RecordingSet

# Without these there is nothing more to ask.
_BASIC: tuple[Need, ...] = ("torque", "link", "sensor", "windup", "moves", "gear_ratio")
LACKS: dict[Need, str] = {
    "torque": "its torque is not recorded",
    "link": "it has no link encoder",
    "sensor": "neither its torque nor its link angle is recorded",
    "windup": "it has no link encoder, and not every joint has a spring and damping to swing on",
    "moves": "it does not move",
    "reverses": "it moves in one direction only",
    "slow": "it never moves slowly (0.005 to 0.1 rad/s)",
    "speeds": "it moves at one speed only",
    "load_changes_sign": "neither gravity nor inertia changes the sign of its load",
    "rotor_slow": "it moves too fast for the sampling rate to resolve turns of the rotor",
    "ripple_slow": "it moves too fast for the sampling rate to resolve the motor's poles",
    "warmer": "all runs are equally warm, or their session times are not given",
    "gear_ratio": "nominal.gear_ratio is not given",
    "pole_pairs": "nominal.pole_pairs is not given",
    "tool_frame": "tool_frame is not given",
    "before": "there is no joint before it",
    "runs": "there is only one training run",
    "three_runs": "there are fewer than three training runs",
}


@dataclass(frozen=True, kw_only=True)
class EffectCheck:
    """Whether an effect could be found with a set.

    Parameters
    ----------
    effect : Effect
    joint : int or None
        From 1; None for an effect of the whole robot.
    lacks : tuple of str
        Why not, a clause each; empty if it can be found.
    """

    effect: Effect
    joint: int | None
    lacks: tuple[str, ...]

    @property
    def possible(self) -> bool:
        """Whether nothing is lacking."""
        return not self.lacks

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {
            "effect": self.effect.name,
            "joint": self.joint,
            "lacks": list(self.lacks),
            "possible": self.possible,
        }


def needs(effect: Effect) -> tuple[Need, ...]:
    """What an effect needs of recordings; by the channels that its term acts on if it says none."""
    if effect.needs:
        return effect.needs
    term = probed(effect)
    acts_on_torque = any(
        np.any(part) for part in (term.drive_torque, term.link_torque, term.previous_torque)
    )
    own: tuple[Need, ...] = ("torque" if acts_on_torque else "link", "moves")
    return (*own, "runs") if effect.scope == "run" else own


def effect_checks(
    recordings: RecordingSet,
    facts: Sequence[JointFacts],
    training_runs: int,
    effects: Sequence[Effect] = CATALOGUE,
) -> tuple[EffectCheck, ...]:
    """Every effect of every joint, then those of the whole robot.

    Parameters
    ----------
    recordings : RecordingSet
    facts : sequence of JointFacts (n,)
        Of the training runs.
    training_runs : int
    effects : sequence of Effect
    """
    nominal = recordings.nominal
    of_set: dict[Need, bool] = {
        "gear_ratio": nominal.gear_ratio is not None,
        "pole_pairs": nominal.pole_pairs is not None,
        "tool_frame": recordings.tool_frame is not None,
        "runs": training_runs > 1,
        "three_runs": training_runs >= 3,
    }

    def met(need: Need, joint: int | None) -> bool:
        if need in of_set:
            return of_set[need]
        if need == "before":
            return bool(joint)
        joints = facts if joint is None else facts[joint : joint + 1]
        return any(getattr(one, need) for one in joints)

    def check(effect: Effect, wanted: Iterable[Need], joint: int | None) -> EffectCheck:
        missing = [need for need in wanted if not met(need, joint)]
        if missing and missing[0] in _BASIC:
            missing = missing[:1]
        return EffectCheck(
            effect=effect,
            joint=None if joint is None else joint + 1,
            lacks=tuple(LACKS[need] for need in missing),
        )

    wanted = [(effect, needs(effect)) for effect in effects]
    robot = [pair for pair in wanted if pair[0].scope == "robot"]
    joints = [pair for pair in wanted if pair[0].scope != "robot"]
    return (
        *(check(*pair, j) for j in range(recordings.n) for pair in joints),
        *(check(*pair, None) for pair in robot),
    )
