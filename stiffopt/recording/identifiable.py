"""Which effects a set can tell, and what it lacks for the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from stiffopt.recording.facts import JointFacts
from stiffopt.recording.recording_set import RecordingSet

# Needs of each effect: names of facts of the joint, or of the set (see `_LACKS`).
_JOINT_EFFECTS: dict[str, tuple[str, ...]] = {
    "coulomb": ("torque", "moves", "reverses"),
    "viscous": ("torque", "moves", "speeds"),
    "stribeck": ("torque", "moves", "reverses", "slow"),
    "load_friction": ("torque", "moves", "reverses"),
    "asym_friction": ("torque", "moves", "reverses"),
    "position_friction": ("torque", "moves", "reverses"),
    "thermal_friction": ("torque", "moves", "warmer"),
    "backlash": ("link", "moves", "load_changes_sign"),
    "hysteresis": ("link", "moves", "reverses"),
    "stiffness_linear": ("link", "moves"),
    "k1_softening": ("link", "moves", "load_changes_sign"),
    "preload_loss": ("link", "moves"),
    "belt_creep": ("link", "moves"),
    "transmission_error": ("link", "moves", "gear_ratio", "rotor_slow"),
    "torque_ripple": ("torque", "moves", "gear_ratio", "pole_pairs", "ripple_slow"),
    "rotor_inertia": ("torque", "moves"),
    "gravity_spring": ("torque", "moves"),
    "cable_spring": ("torque", "moves"),
    "torque_gain": ("torque", "moves"),
    "torque_offset": ("torque", "moves", "reverses"),
    "encoder_offset": ("link", "moves"),
    "saturation": ("torque", "moves"),
    "wrist_coupling": ("link", "moves", "before"),
    "inertial_error": ("torque", "moves"),
    "encoder_skew": ("link", "moves"),
    "encoder_zero_change": ("link", "runs"),
}
_ROBOT_EFFECTS: dict[str, tuple[str, ...]] = {
    "payload": ("torque", "moves"),
    "time_delay": ("torque", "moves"),
    "base_tilt": ("torque", "moves"),
    "external_contact": ("torque", "moves", "tool_frame"),
}
# Without these there is nothing more to ask.
_BASIC = ("torque", "link", "moves", "gear_ratio")
_LACKS = {
    "torque": "its torque is not recorded",
    "link": "it has no link encoder",
    "moves": "it does not move",
    "reverses": "it moves in one direction only",
    "slow": "it never moves slowly (0.005 to 0.1 rad/s)",
    "speeds": "it moves at one speed only",
    "load_changes_sign": "gravity never changes sign on it",
    "rotor_slow": "it moves too fast for the sampling rate to resolve turns of the rotor",
    "ripple_slow": "it moves too fast for the sampling rate to resolve the motor's poles",
    "warmer": "all runs are equally warm, or their session times are not given",
    "gear_ratio": "nominal.gear_ratio is not given",
    "pole_pairs": "nominal.pole_pairs is not given",
    "tool_frame": "tool_frame is not given",
    "before": "there is no joint before it",
    "runs": "there is only one training run",
}


@dataclass(frozen=True, kw_only=True)
class EffectCheck:
    """Whether an effect could be told with a set.

    Parameters
    ----------
    effect : str
        Name in the catalogue.
    joint : int or None
        From 1; None for an effect of the whole robot.
    lacks : tuple of str
        Why not, a clause each; empty if it can be told.
    """

    effect: str
    joint: int | None
    lacks: tuple[str, ...]

    @property
    def possible(self) -> bool:
        """Whether nothing is lacking."""
        return not self.lacks


def balances(facts: JointFacts) -> tuple[str, ...]:
    """Balances that can be drawn up for a joint."""
    if not facts.torque:
        return ("deflection",) if facts.link else ()
    return ("motor", "link", "deflection") if facts.link else ("torque",)


def effect_checks(
    recordings: RecordingSet, facts: Sequence[JointFacts], training_runs: int
) -> tuple[EffectCheck, ...]:
    """Every effect of every joint, then those of the whole robot."""
    nominal = recordings.nominal
    of_set = {
        "gear_ratio": nominal.gear_ratio is not None,
        "pole_pairs": nominal.pole_pairs is not None,
        "tool_frame": recordings.tool_frame is not None,
        "runs": training_runs > 1,
    }

    def lacking(needs: Sequence[str], joint: int | None) -> tuple[str, ...]:
        found = []
        for need in needs:
            if need in of_set:
                met = of_set[need]
            elif need == "before":
                met = bool(joint)
            elif joint is None:
                met = any(getattr(one, need) for one in facts)
            else:
                met = bool(getattr(facts[joint], need))
            if not met:
                found.append(_LACKS[need])
        basic = [_LACKS[need] for need in _BASIC]
        return tuple(found[:1] if found and found[0] in basic else found)

    checks = [
        EffectCheck(effect=effect, joint=j + 1, lacks=lacking(needs, j))
        for j in range(recordings.n)
        for effect, needs in _JOINT_EFFECTS.items()
    ]
    checks += [
        EffectCheck(effect=effect, joint=None, lacks=lacking(needs, None))
        for effect, needs in _ROBOT_EFFECTS.items()
    ]
    return tuple(checks)
